"""Tolerances of a part as a program holds them on a machine with the errors of a calibration (`twin forecast`).

The points that a program makes of each feature (`twin.part.contact`) are displaced by the machine's errors. Machines are drawn from the
covariance of the calibration (JCGM 101:2008); on each of them every tolerance is evaluated as on a measured part
(`twin.part.zones`), for the program as it is and for the compensated one. The share of machines within the tolerance is the probability
of conformity (JCGM 106:2012, 3.3.7); from 95 % on the tolerance is held, up to 5 % it is not, and in between nothing is promised
(ISO 14253-1:2017).

Not contained: deflection, wear, size and run-out of the tool, clamping, forces, vibration, the dynamics of the control, and whatever
the calibration does not know of.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final, final

import numpy as np
from scipy.spatial import cKDTree

from twin._common.errors import InputError
from twin._common.resources import Progress, one_blas_thread, silent
from twin._common.units import MM, UM
from twin.compensation.programs.compensator import Compensator
from twin.compensation.programs.prepared import Options
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc.blocks import Program
from twin.nc.dialect import Dialect
from twin.part.features import LOCATED, ORIENTED, PartDrawing, Tolerance, Turned, across
from twin.part.forecasted import CONFORMS, Conformity, ForecastTolerance, PartForecast
from twin.part.improvements import PlaceSearch, remeasured
from twin.part.made import SEED, Made, Maker, axis_points, sections
from twin.part.zones import (
    Aligned,
    FeaturePoints,
    align,
    around_axis_um,
    band_um,
    best_place,
    both_sides_um,
    independent,
)

MACHINES: Final = 1000


@final
class Judge:
    """Evaluates the tolerances of a part on features that have been made."""

    def __init__(self, part: PartDrawing) -> None:
        self.part = part

    def values_um(
        self, tolerance: Tolerance, surface: Mapping[str, FeaturePoints], axis: Mapping[str, FeaturePoints]
    ) -> Mapping[str, np.ndarray]:
        """Return the value of a tolerance on every machine, (machines,) µm, by feature."""
        made = {name: self._judged(tolerance, name, surface, axis) for name in tolerance.features}
        count = next(iter(made.values())).deviation_um.shape[1]
        datums = [self._datum(name, surface, axis) for name in tolerance.datums]
        aligned = align(datums, count)
        seen = {name: aligned.seen(points) for name, points in made.items()}
        if tolerance.kind in LOCATED or tolerance.kind == "profile":
            return self._located(tolerance, seen, aligned)
        return {name: self._of_form_or_direction(tolerance, name, points, aligned) for name, points in seen.items()}

    def _judged(
        self, tolerance: Tolerance, name: str, surface: Mapping[str, FeaturePoints], axis: Mapping[str, FeaturePoints]
    ) -> FeaturePoints:
        """Return the points of a feature that a tolerance judges: its axis, or its surface."""
        turned = isinstance(self.part.features[name], Turned)
        if turned and tolerance.kind in (*LOCATED, *ORIENTED):
            return self._axis(name, axis)
        points = surface[name]
        if points.axis:
            raise self.part.refused(
                ("features", name), f"{tolerance.kind} of {name}, a hole that a drill or reamer makes by its own shape",
                "position, or orientation",
            )  # fmt: skip
        return points

    def _axis(self, name: str, axis: Mapping[str, FeaturePoints]) -> FeaturePoints:
        if name not in axis:
            raise self.part.refused(
                ("features", name), f"no section of {name} is made all round", "a surface whose axis is determined"
            )
        return axis[name]

    def _datum(
        self, name: str, surface: Mapping[str, FeaturePoints], axis: Mapping[str, FeaturePoints]
    ) -> FeaturePoints:
        return self._axis(name, axis) if isinstance(self.part.features[name], Turned) else surface[name]

    def _located(
        self, tolerance: Tolerance, seen: Mapping[str, FeaturePoints], aligned: Aligned
    ) -> Mapping[str, np.ndarray]:
        """Return values of location and profile: the pattern is placed as a whole where the datums leave it free."""
        joined = FeaturePoints.joined([*seen.values()])
        free = aligned.free_columns(joined)
        i = self.part.tolerances.index(tolerance)
        if tolerance.kind in LOCATED and free.shape[1] and _absorbs(free, [*seen.values()]):
            raise self.part.refused(
                ("tolerances", i, "datums"), f"the datums of {tolerance.title} do not fix the part: they leave its place free",
                "more datums, or the holes of a pattern together", tolerance.datums,
            )  # fmt: skip
        if len(seen) == 1:
            name = next(iter(seen))
            value = around_axis_um(joined, free, placed=True) if joined.axis else both_sides_um(joined, free)
            return {name: value}
        if free.shape[1]:
            joined = joined.with_deviation(joined.deviation_um - free @ best_place(joined, free))
        ends = np.cumsum([len(one.place_mm) for one in seen.values()])[:-1]
        found = {}
        for name, one, left in zip(seen, seen.values(), np.split(joined.deviation_um, ends), strict=True):
            own = one.with_deviation(left)
            columns = np.zeros((len(left), 0))
            found[name] = around_axis_um(own, columns, placed=True) if own.axis else both_sides_um(own, columns)
        return found

    def _of_form_or_direction(
        self, tolerance: Tolerance, name: str, points: FeaturePoints, aligned: Aligned
    ) -> np.ndarray:
        feature, association = self.part.features[name], self.part.association
        if tolerance.kind == "flatness":
            return band_um(points, independent(points.motion), association)
        if tolerance.kind == "roundness":
            return self._roundness(name, points)
        free = aligned.free_columns(points)
        if isinstance(feature, Turned):
            return around_axis_um(points, free, placed=False)
        shift = points.normal @ np.array(feature.normal) if hasattr(feature, "normal") else np.ones(len(points.normal))
        return band_um(points, independent(np.column_stack([shift, free])), "minimum-zone")

    def _roundness(self, name: str, points: FeaturePoints) -> np.ndarray:
        """Return the largest roundness of the sections of a surface of revolution, or that of a sphere as a whole."""
        feature = self.part.features[name]
        if not isinstance(feature, Turned):
            return band_um(
                points,
                independent(np.column_stack([points.normal, np.ones(len(points.normal))])),
                self.part.association,
            )
        lateral = points.normal @ np.array(across(feature.unit)).T
        largest = np.zeros(points.deviation_um.shape[1])
        for rows in sections(feature.along_mm(points.place_mm)):
            if len(rows) > 3:
                columns = np.column_stack([lateral[rows], np.ones(len(rows))])
                one = FeaturePoints(points.place_mm[rows], points.normal[rows], points.deviation_um[rows])
                largest = np.maximum(largest, band_um(one, columns, self.part.association))
        return largest


def _absorbs(free: np.ndarray, parts: Sequence[FeaturePoints]) -> bool:
    """Return whether free motions can shift some feature to its place while the others of its pattern stay where they are."""
    begin = 0
    for one in parts:
        shift = np.zeros((len(free), 3))
        shift[begin : begin + len(one.normal)] = one.normal
        begin += len(one.normal)
        shift = independent(shift)
        if np.linalg.norm(shift - free @ (free.T @ shift)) < 1e-6 * max(shift.shape[1], 1):
            return True
    return False


def forecast(
    part: PartDrawing,
    program: tuple[Program, Dialect],
    machine: Machine,
    calibration: Calibration,
    options: Options | None = None,
    *,
    machines: int = MACHINES,
    place: bool = False,
    progress: Progress = silent,
) -> PartForecast:
    r"""Return the forecast of a part's tolerances.

    Args:
        part: features, tolerances and tools (`twin.PartDrawing`).
        program: a program with its language (`twin.read_program`).
        machine: the machine it runs on.
        calibration: its errors, with their covariance.
        options: set-up, tool length, mode and conditions, as for `twin.compensate`.
        machines: number of machines drawn.
        place: whether to search for a better place and orientation of the part in the working volume.
        progress: called with the number of features done.

    Raises:
        InputError: the program cannot be executed; a feature that no block makes; datums that do not fix the part.

    Examples:
        >>> import json
        >>> from pathlib import Path
        >>> hole = {"kind": "hole", "depth": 30, "diameter": 8}
        >>> part = {
        ...     "schema": "twin.part/1",
        ...     "units": "mm",
        ...     "zero": "table",
        ...     "tools": [{"number": 1, "diameter": 8}],
        ...     "features": {
        ...         "A": {"kind": "plane", "point": [0, 0, 30], "normal": [0, 0, 1], "made": "elsewhere"},
        ...         "H1": {**hole, "point": [-20, -25, 30]},
        ...         "H2": {**hole, "point": [20, 25, 30]},
        ...     },
        ...     "tolerances": [{"kind": "position", "of": ["H1", "H2"], "zone": 0.05, "datums": ["A"]}],
        ... }
        >>> _ = Path("part.yaml").write_text(json.dumps(part))
        >>> _ = Path("part.nc").write_text("G0 X230 Y200 Z-150\nG81 Z-280 R-250 F200\nX270 Y250\nG80\n")
        >>> machine = twin.Machine.load("dmu50")
        >>> found = twin.forecast(
        ...     twin.PartDrawing(Path("part.yaml")),
        ...     twin.read_program("part.nc"),
        ...     machine,
        ...     twin.Calibration.default(machine),
        ...     twin.Options(tool_length_mm=120),
        ... )
        >>> round(found.tolerances[0].before.value_um)
        38
        >>> found.tolerances[0].after.value_um < 1.5
        True
    """
    maker = Maker(part, machine, calibration, Options() if options is None else options, (machines, SEED))
    return _found(maker, *program, progress, place=place)


def _found(maker: Maker, read: Program, dialect: Dialect, progress: Progress, *, place: bool) -> PartForecast:
    part, machine, calibration = maker.part, maker.machine, maker.calibration
    judge = Judge(part)
    with one_blas_thread():
        run = maker.run(read, dialect)
        zero_mm = maker.zero_mm(run)
        maker.settle(run, zero_mm)
        before = maker.made(run, compensated=False, zero_mm=zero_mm, progress=progress)
        after, why = None, ""
        try:
            compensation = Compensator(machine, calibration, maker.options).compensate(read, dialect)
        except InputError as error:
            why = str(error)
        else:
            again = maker.run(dialect.read(compensation.text.encode("latin-1"), read.source), dialect)
            again = replace(again, lines=run.lines[cKDTree(run.meant_mm).query(again.reached_mm)[1]])
            after = maker.made(again, compensated=True, zero_mm=zero_mm)
        rows = tuple(_forecast_of(maker, judge, one, (before, after), zero_mm) for one in part.tolerances)
        better = PlaceSearch(maker, judge.values_um, before, run, zero_mm).best() if place else None
    unknown = maker.kinematics(float(run.lengths_mm[0]))[1].without_uncertainty
    return PartForecast(
        part=part.name,
        program=read.source,
        machine=machine.name,
        tolerances=rows,
        features=before.described,
        omitted=run.omitted,
        compensated=why,
        machines=maker.machines,
        warnings=calibration.warnings,
        without_uncertainty=unknown,
        better_place=better,
        searched=place,
        points_mm={name: points.place_mm for name, points in before.surface.items()},
        zero_mm=zero_mm,
    )


def _forecast_of(
    maker: Maker, judge: Judge, tolerance: Tolerance, made: tuple[Made, Made | None], zero_mm: np.ndarray
) -> ForecastTolerance:
    before, after = made
    by_feature = judge.values_um(tolerance, before.surface, before.axis)
    row = ForecastTolerance(
        tolerance,
        _conformity(tolerance, by_feature),
        None if after is None else _conformity(tolerance, judge.values_um(tolerance, after.surface, after.axis)),
        _by_error(judge, tolerance, before),
        max(by_feature, key=lambda name: float(by_feature[name][0])),
    )
    if row.verdict != "open":
        return row
    return replace(row, remeasured=remeasured(maker, judge.values_um, tolerance, after or before, zero_mm))


def _conformity(tolerance: Tolerance, by_feature: Mapping[str, np.ndarray]) -> Conformity:
    values = np.max([*by_feature.values()], axis=0)
    limit = tolerance.zone * MM / UM
    if len(values) == 1:
        return Conformity(float(values[0]), np.nan, np.nan)
    return Conformity(float(values[0]), float(np.quantile(values[1:], CONFORMS)), float(np.mean(values[1:] <= limit)))


def _by_error(judge: Judge, tolerance: Tolerance, made: Made) -> tuple[tuple[str, float], ...]:
    """Return what the value of the calibrated machine loses without each error, µm, largest first."""
    errors = sorted({key for each in made.by_error.values() for key in each})
    if not errors:
        return ()
    surface = {}
    for name, points in made.surface.items():
        whole, each = points.deviation_um[:, :1], made.by_error.get(name, {})
        without = [whole - each[key].deviation_um if key in each else whole for key in errors]
        surface[name] = points.with_deviation(np.hstack([whole, *without]))
    axis = {name: axis_points(judge.part.features[name], surface[name]) for name in made.axis}  # type: ignore[arg-type]
    values = np.max([*judge.values_um(tolerance, surface, axis).values()], axis=0)
    found = {key: float(values[0] - value) for key, value in zip(errors, values[1:], strict=True)}
    return tuple(sorted(found.items(), key=lambda one: -one[1]))
