"""What a program makes of a part's tolerances on a machine with the errors of a calibration (`twin forecast`).

The points that a program makes of each feature (`twin.part.contact`) are displaced by the machine's errors. Machines are drawn from the
covariance of the calibration (JCGM 101:2008); on each of them every tolerance is evaluated as on a measured part
(`twin.part.zones`), for the program as it is and for the compensated one. The share of machines within the tolerance is the probability
of conformity (JCGM 106:2012, 3.3.7); from 95 % on the tolerance is held, up to 5 % it is not, and in between nothing is promised
(ISO 14253-1:2017).

Not contained: deflection, wear, size and run-out of the tool, clamping, forces, vibration, the dynamics of the control, and whatever
the calibration does not know of.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, final

import numpy as np
from scipy.spatial import cKDTree

from twin._common.errors import InputError
from twin._common.provenance import warning_texts
from twin._common.resources import Progress, one_blas_thread, silent
from twin._common.records import json_form
from twin._common.units import MM, UM, count_with_noun
from twin.compensation.programs.compensator import Compensator
from twin.compensation.programs.execute import Execution, execute_program
from twin.compensation.programs.prepared import Options
from twin.compensation.programs.words import Setup, WordSpace
from twin.controls.offsets import ToolTable
from twin.display.numbers import listed
from twin.display.results import Result
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc.blocks import Program
from twin.nc.dialect import Dialect
from twin.part.contact import Contacts, contacts
from twin.part.features import LOCATED, ORIENTED, Part, Plane, Surface, Tolerance, ToolShape, _Turned, across
from twin.part.zones import MOST_CENTRES, Aligned, Points, align, around_axis_um, band_um, best_place, both_sides_um, independent
from twin.tool.forward import Kinematics
from twin.tool.uncertainty import ToolUncertainty, errors_in, state_at

MACHINES: Final = 1000
SEED: Final = 14253
MOST_POINTS: Final = 400
"""Points of a feature that are evaluated, spread over those that the program makes."""
CONFORMS, FAILS = 0.95, 0.05
LARGEST_GAP: Final = np.pi
"""Angle around an axis without points, from which on a section has no centre."""
NOT_CONTAINED: Final = (
    "Not contained: deflection, wear, size and run-out of the tool, clamping, cutting forces, vibration, dynamics of the control, and "
    "errors that the calibration does not know."
)


@final
@dataclass(frozen=True)
class Conformity:
    """A tolerance's value on the machines that the calibration allows.

    Attributes:
        value_um: on the machine as calibrated.
        upper_um: value that 95 % of the machines do not exceed.
        probability: share of the machines on which the tolerance is held.

    ``upper_um`` and ``probability`` are NaN if the calibration gives no uncertainty.
    """

    value_um: float
    upper_um: float
    probability: float

    @property
    def verdict(self) -> str:
        """``held``, ``exceeded`` or ``open``."""
        if np.isnan(self.probability):
            return "open"
        return "held" if self.probability >= CONFORMS else "exceeded" if self.probability <= FAILS else "open"


@final
@dataclass(frozen=True)
class ForecastTolerance:
    """The forecast of one tolerance.

    Attributes:
        tolerance: as in the part's file.
        before: with the program as it is.
        after: with the compensated program; None if the program cannot be compensated.
        by_error: what each error of the machine adds to the value before, µm: largest first.
        worst: the feature of a pattern that decides.
    """

    tolerance: Tolerance
    before: Conformity
    after: Conformity | None
    by_error: tuple[tuple[str, float], ...]
    worst: str


@final
@dataclass(frozen=True)
class MadeFeature:
    """What a program makes of a feature.

    Attributes:
        points: number of its points that were evaluated.
        lines: first and last line of the program that makes it.
        tool: number or name of the tool.
        program_um: largest distance of the program itself from the nominal surface.
        drilled: whether a tool's tip makes it.
    """

    points: int
    lines: tuple[int, int]
    tool: str
    program_um: float
    drilled: bool


@final
@dataclass(frozen=True, eq=False)
class _Made:
    """Points of the features under one program, on all machines, and by error of the machine as calibrated."""

    surface: Mapping[str, Points]
    axis: Mapping[str, Points]
    by_error: Mapping[str, Mapping[str, Points]]  # feature to error to points, one column, of surface
    described: Mapping[str, MadeFeature]


@final
class Maker:
    """A machine with a calibration that makes a part, for one program after another."""

    def __init__(self, part: Part, machine: Machine, calibration: Calibration, options: Options, machines: int, seed: int) -> None:
        self.part, self.machine, self.calibration = part, machine, calibration
        self.options = self._with_tools(options)
        self._of_length: dict[float, tuple[Kinematics, ToolUncertainty]] = {}
        # Without uncertainty there is one machine, and no probability.
        self._seed, self._machines = seed, machines if self.kinematics(0.0)[1].parameters else 1

    def _with_tools(self, options: Options) -> Options:
        lengths = {name: tool.length for name, tool in self.part.tools.items() if tool.length is not None}
        if not lengths or options.setup.tools is not None:
            return options
        if len(lengths) < len(self.part.tools):
            missing = [i for i, name in enumerate(self.part.tools) if name not in lengths]
            raise self.part.refused(("tools", missing[0]), "some tools have a length and some have none", "length: of all tools, mm")
        return replace(options, setup=replace(options.setup, tools=ToolTable(self.part.path, lengths)))

    def kinematics(self, length: float) -> tuple[Kinematics, ToolUncertainty]:
        """Return the machine with a tool of some length, and the uncertainty of its poses."""
        if length not in self._of_length:
            real = Kinematics(self.machine, self.calibration, tool_length_mm=length, conditions=self.options.conditions)
            self._of_length[length] = real, ToolUncertainty(real)
        return self._of_length[length]

    @cached_property
    def draws(self) -> np.ndarray:
        """(r, machines) standard normal numbers; the first machine is the calibrated one."""
        width = len(self.kinematics(0.0)[1].parameters)
        drawn = np.random.default_rng(self._seed).standard_normal((width, self._machines))
        drawn[:, 0] = 0.0
        return drawn

    @cached_property
    def placed(self) -> np.ndarray:
        """(6, machines) shift (µm) and rotation (mrad) of the part in its set-up; none of the first machine."""
        drawn = np.random.default_rng([self._seed, 1]).standard_normal((6, self._machines))
        drawn[:, 0] = 0.0
        return drawn * self.part.setup.standard[:, None]

    def run(self, read: Program, dialect: Dialect) -> Execution:
        """Execute a program."""
        used = self.options.setup, self.options.tool_length_mm
        return execute_program(
            read, dialect, self.machine, self.calibration, used, tcp=self.options.tcp, conditions=self.options.conditions
        )

    def zero_mm(self, run: Execution) -> np.ndarray:
        """Return the place (3,) of the part's zero in the work frame, mm."""
        if not isinstance(self.part.zero, str):
            return np.array(self.part.zero)
        if self.part.zero == "table":
            return np.zeros(3)
        setup = self.options.setup
        if setup.offsets is not None:
            name = setup.offsets.assumed or next(iter(setup.offsets.rows))
            setup = Setup(work_offset=setup.offsets.rows[name])
        space = WordSpace(self.machine, setup, float(run.lengths_mm[0]))
        words = np.zeros((1, len(self.machine.names)))
        return np.array(space.nominal.forward(space.commands(words, np.array([self.options.tcp]))).point_mm[0])

    def made(self, run: Execution, *, compensated: bool, zero_mm: np.ndarray, progress: Progress = silent) -> _Made:
        """Return the points that an executed program makes of every feature, and how they lie on each machine."""
        surface, axis, described, by_error = {}, {}, {}, {}
        names = [*self.part.features]
        for i, name in enumerate(names):
            feature = self.part.features[name]
            progress(i, len(names))
            if feature.made == "elsewhere":
                surface[name] = self._elsewhere(feature)
            else:
                surface[name], described[name], by_error[name] = self._feature(name, run, zero_mm, compensated=compensated)
            if isinstance(feature, _Turned):
                axis[name] = axis_points(feature, surface[name])
                if not len(axis[name].place_mm):
                    del axis[name]
        return _Made(surface, axis, by_error, described)

    def _elsewhere(self, feature: Surface) -> Points:
        points = feature.samples()
        normal = feature.signed_mm(points)[1]
        return Points(points, np.array(normal), np.zeros((len(points), self._machines)), isinstance(feature, _Turned))

    def _feature(
        self, name: str, run: Execution, zero_mm: np.ndarray, *, compensated: bool
    ) -> tuple[Points, MadeFeature, dict[str, Points]]:
        """Return one feature's points on all machines."""
        feature = self.part.features[name]
        parts, errors, lines, off, used = [], [], [], 0.0, ""
        nearest = (np.inf, 0)
        depth = getattr(feature, "depth", None)
        run = finely(run, self._chosen(name, run), STEP_MM if depth is None else min(STEP_MM, depth / DEPTH_STEPS))
        for number, tool, rows in self._samples(name, run):
            length = float(run.lengths_mm[rows[0]])
            real, uncertainty = self.kinematics(length)
            meant = real if compensated else self._nominal(length)
            for some in np.array_split(rows, max(1, len(rows) // ROWS)):
                poses = meant.forward(run.positions[some], run.sides[some]) if compensated else meant.forward(run.positions[some])
                tips = poses.point_mm - zero_mm
                found = contacts(feature, tool, tips, poses.axis, self.part.touch_mm)
                found = found.part(_along_surface(found, tips, run.ends[some]))
                if not len(found):
                    distance = np.abs(contacts(feature, tool, tips, poses.axis, np.inf).off_mm)
                    if len(distance) and distance.min() < nearest[0]:
                        nearest = float(distance.min()), int(run.lines[some[int(distance.argmin() % len(some))]])
                    continue
                parts.append((found, some, poses.axis, real, uncertainty))
                lines += [run.lines[some[found.sample]]]
                off = max(off, float(np.abs(found.off_mm).max()))
                used = number
        if not parts:
            near = f"; the nearest block, line {nearest[1]}, stays {nearest[0]:.3f} mm away" if np.isfinite(nearest[0]) else ""
            raise self.part.refused(
                ("features", name), f"no block of the program makes the feature {name}{near}",
                "a surface that the program cuts, in the part's frame, and the tool that cuts it; else made: elsewhere",
            )  # fmt: skip
        total = sum(len(found) for found, *_ in parts)
        points, by_error = [], []
        for found, some, axis, real, uncertainty in parts:
            kept = found.part(_spread(found, MOST_POINTS * len(found) // total + 1))
            one, each = self._deviations(feature, kept, (some, axis, run, zero_mm), real, uncertainty)
            points.append(one)
            by_error.append(each)
        all_lines = np.concatenate(lines)
        described = MadeFeature(
            sum(len(one.place_mm) for one in points),
            (int(all_lines.min()), int(all_lines.max())),
            used,
            off * MM / UM,
            parts[0][0].drilled,
        )
        joined = {key: Points.joined([each[key] for each in by_error]) for key in by_error[0]}
        return Points.joined(points), described, joined

    def _nominal(self, length: float) -> Kinematics:
        return Kinematics(self.machine, Calibration.zero(self.machine), tool_length_mm=length)

    def _samples(self, name: str, run: Execution) -> Iterator[tuple[str, ToolShape, np.ndarray]]:
        """Yield number, shape and (n,) samples of the tools that may make a feature."""
        feature, tools, chosen = self.part.features[name], self.part.tools, self._chosen(name, run)
        followed = bool(np.any(run.tools != ""))
        numbers = [str(feature.tool)] if feature.tool is not None else [*tools]
        if not followed and len(numbers) > 1:
            raise self.part.refused(
                ("features", name), f"which tool makes {name} is not known", "tool: its number; or the length of every tool"
            )
        for number in numbers:
            own = chosen & (run.tools == number) if followed else chosen
            for length in np.unique(run.lengths_mm[own]):
                yield number, tools[number], np.flatnonzero(own & (run.lengths_mm == length))

    def _chosen(self, name: str, run: Execution) -> np.ndarray:
        """Return (n,) the samples of cutting blocks in a feature's lines."""
        feature, chosen = self.part.features[name], run.cutting
        if feature.lines is not None:
            chosen = chosen & (run.lines >= feature.lines[0]) & (run.lines <= feature.lines[1])
        return np.asarray(chosen)

    def _deviations(
        self, feature: Surface, found: Contacts, at: tuple[np.ndarray, np.ndarray, Execution, np.ndarray], real: Kinematics,
        uncertainty: ToolUncertainty,
    ) -> tuple[Points, dict[str, Points]]:  # fmt: skip
        """Return points with their deviations on all machines, and those that each error causes on the calibrated one."""
        some, axis, run, zero_mm = at
        rows = some[found.sample]
        q, sides = run.positions[rows], run.sides[rows]
        poses = real.forward(q, sides)
        mean = found.deviation_mm(feature, poses.point_mm - zero_mm, poses.axis, axis[found.sample]) * MM / UM
        sensitive = real.sensitivities(q, sides).error
        components, spread = uncertainty.frame_factors(q, sides)
        # Along the normal: the point's displacement, and the tool's rotation by its lever (µrad·mm are nm).
        lever = np.cross(found.lever_mm, found.normal) * 1e-3
        seen = np.einsum("nf,nfe->ne", np.hstack([found.normal, lever]), sensitive)
        root = np.einsum("ne,ner->nr", seen[:, components], spread)
        motion = np.hstack([found.normal, np.cross(found.place_mm, found.normal)])
        values = mean[:, None] + root @ self.draws + motion @ self.placed
        sized = not (found.drilled or isinstance(feature, Plane))
        points = Points(found.place_mm, found.normal, values, sized, found.drilled)
        state = state_at(self.machine, q, sides, self.options.conditions)
        each: dict[str, np.ndarray] = {}
        for effect in self.calibration.effects:
            own = errors_in(state, [effect], self.machine, len(q)) 
            each[effect.name] = each.get(effect.name, 0.0) + (seen * own).sum(axis=1) / UM
        return points, {key: points.with_deviation(value[:, None]) for key, value in each.items()}


ROWS: Final = 100_000
STEP_MM: Final = 1.0
"""Largest distance of two samples of the tool's way along a straight block."""
DEPTH_STEPS: Final = 100


def finely(run: Execution, chosen: np.ndarray, step_mm: float) -> Execution:
    """Return an execution with more samples on the straight ways to some of them, (n,) booleans."""
    way = np.diff(run.meant_mm, axis=0, prepend=run.meant_mm[:1])
    length = np.linalg.norm(way, axis=1)
    unit = way / np.maximum(length, 1e-12)[:, None]
    # A way is straight if it does not turn within its block: samples of arcs are dense already.
    turns = (np.linalg.norm(np.diff(unit, axis=0), axis=1) > STRAIGHT) & (run.lines[1:] == run.lines[:-1]) & (length[:-1] > 0.0)
    turns[~chosen[:-1] | run.gaps[:-1]] = False
    straight = ~(np.append(turns, False) | np.append(False, turns))
    parts = np.where(chosen & ~run.gaps & straight, np.clip(np.ceil(length / step_mm), 1, MOST_PARTS), 1).astype(int)
    of = np.repeat(np.arange(len(parts)), parts)
    share = (np.arange(len(of)) - np.repeat(np.cumsum(parts) - parts, parts) + 1.0) / parts[of]
    last = share >= 1.0 - 1e-12
    before = np.maximum(of - 1, 0)
    positions = run.positions[of]
    positions[~last] += (share[~last, None] - 1.0) * (run.positions[of] - run.positions[before])[~last]
    names = ("meant_mm", "sides", "reached_mm", "tilt_urad", "cutting", "lines", "gaps", "tools", "lengths_mm")
    return replace(run, positions=positions, ends=run.ends[of] & last, **{name: getattr(run, name)[of] for name in names})


STRAIGHT: Final = 1e-5
MOST_PARTS: Final = 1000


def _along_surface(found: Contacts, tips: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return the rows at which the tool goes along the surface, or a block ends on it: others only pass through."""
    if found.drilled or len(tips) < 2:
        return np.arange(len(found))
    way = np.gradient(tips, axis=0)
    length = np.linalg.norm(way, axis=1)
    way = way / np.maximum(length, 1e-12)[:, None]
    through = np.abs((way[found.sample] * found.normal).sum(axis=1)) > PASSING
    return np.flatnonzero(~through | ends[found.sample])


PASSING: Final = 0.2
"""Component of the tool's way along the normal of a surface, from which on it passes through: 12°."""


def _spread(found: Contacts, count: int) -> np.ndarray:
    """Return rows spread over those found, in the program's order; both rows of a point of a drilled hole."""
    step = 2 if found.drilled else 1
    total = len(found) // step
    if total <= count:
        return np.arange(len(found))
    chosen = np.unique(np.linspace(0, total - 1, count).round().astype(int))
    return np.asarray((chosen[:, None] * step + np.arange(step)).ravel())


def axis_points(feature: _Turned, surface: Points) -> Points:
    """Return the points of the axis of a surface of revolution: centres of least-squares circles of its sections."""
    if surface.axis:
        return surface
    u = np.array(feature.direction) / np.linalg.norm(feature.direction)
    sides = np.array(across(u))
    along = feature.along_mm(surface.place_mm)
    places, values = [], []
    for rows in sections(along):
        lateral = surface.normal[rows] @ sides.T
        angle = np.sort(np.arctan2(lateral[:, 1], lateral[:, 0]))
        gap = np.max(np.diff(np.append(angle, angle[0] + 2.0 * np.pi)), initial=0.0)
        if len(rows) < 3 or gap > LARGEST_GAP:
            continue
        fit = np.linalg.lstsq(np.column_stack([lateral, np.ones(len(rows))]), surface.deviation_um[rows], rcond=None)[0]
        places += [feature.axis_point(along[rows].mean()[None])] * 2
        values.append(fit[:2])
    if not places:
        return Points(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, surface.deviation_um.shape[1])), axis=True)
    return Points(np.concatenate(places), np.tile(sides, (len(values), 1)), np.concatenate(values), axis=True)


def sections(along: np.ndarray) -> list[np.ndarray]:
    """Return the points of each section across an axis: at the same place along it, or in equal parts of its length."""
    different = np.unique(along.round(3))
    if len(different) <= MOST_CENTRES:
        return [np.flatnonzero(np.abs(along - place) < 1e-3) for place in different]
    edges = np.linspace(along.min(), along.max(), MOST_CENTRES + 1)
    part = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, MOST_CENTRES - 1)
    return [np.flatnonzero(part == k) for k in np.unique(part)]


# --- Tolerances ----------------------------------------------------------------------------------------------------------


@final
class Judge:
    """Evaluates the tolerances of a part on features that have been made."""

    def __init__(self, part: Part) -> None:
        self.part = part

    def values_um(self, tolerance: Tolerance, surface: Mapping[str, Points], axis: Mapping[str, Points]) -> Mapping[str, np.ndarray]:
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
        self, tolerance: Tolerance, name: str, surface: Mapping[str, Points], axis: Mapping[str, Points]
    ) -> Points:
        """Return the points of a feature that a tolerance judges: its axis, or its surface."""
        turned = isinstance(self.part.features[name], _Turned)
        if turned and tolerance.kind in (*LOCATED, *ORIENTED):
            return self._axis(name, axis)
        points = surface[name]
        if points.axis:
            raise self.part.refused(
                ("features", name), f"{tolerance.kind} of {name}, a hole that a drill or reamer makes by its own shape",
                "position, or orientation",
            )  # fmt: skip
        return points

    def _axis(self, name: str, axis: Mapping[str, Points]) -> Points:
        if name not in axis:
            raise self.part.refused(("features", name), f"no section of {name} is made all round", "a surface whose axis is determined")
        return axis[name]

    def _datum(self, name: str, surface: Mapping[str, Points], axis: Mapping[str, Points]) -> Points:
        return self._axis(name, axis) if isinstance(self.part.features[name], _Turned) else surface[name]

    def _located(self, tolerance: Tolerance, seen: Mapping[str, Points], aligned: Aligned) -> Mapping[str, np.ndarray]:
        """Return values of location and profile: the pattern is placed as a whole where the datums leave it free."""
        joined = Points.joined([*seen.values()])
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
        none = np.zeros((0, 0))
        found = {}
        for name, one, left in zip(seen, seen.values(), np.split(joined.deviation_um, ends), strict=True):
            own = one.with_deviation(left)
            columns = np.zeros((len(left), none.shape[1]))
            found[name] = around_axis_um(own, columns, placed=True) if own.axis else both_sides_um(own, columns)
        return found

    def _of_form_or_direction(self, tolerance: Tolerance, name: str, points: Points, aligned: Aligned) -> np.ndarray:
        feature, association = self.part.features[name], self.part.association
        if tolerance.kind == "flatness":
            return band_um(points, independent(points.motion), association)
        if tolerance.kind == "roundness":
            return self._roundness(name, points)
        free = aligned.free_columns(points)
        if isinstance(feature, _Turned):
            return around_axis_um(points, free, placed=False)
        shift = points.normal @ np.array(feature.normal) if hasattr(feature, "normal") else np.ones(len(points.normal))
        return band_um(points, independent(np.column_stack([shift, free])), "minimum-zone")

    def _roundness(self, name: str, points: Points) -> np.ndarray:
        """Return the largest roundness of the sections of a surface of revolution, or that of a sphere as a whole."""
        feature = self.part.features[name]
        if not isinstance(feature, _Turned):
            return band_um(points, independent(np.column_stack([points.normal, np.ones(len(points.normal))])), self.part.association)
        u = np.array(feature.direction) / np.linalg.norm(feature.direction)
        lateral = points.normal @ np.array(across(u)).T
        largest = np.zeros(points.deviation_um.shape[1])
        for rows in sections(feature.along_mm(points.place_mm)):
            if len(rows) > 3:
                columns = np.column_stack([lateral[rows], np.ones(len(rows))])
                one = Points(points.place_mm[rows], points.normal[rows], points.deviation_um[rows])
                largest = np.maximum(largest, band_um(one, columns, self.part.association))
        return largest


def _absorbs(free: np.ndarray, parts: Sequence[Points]) -> bool:
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


SCHEMA: Final = "twin.forecast/1"
SMALLEST_SHARE: Final = 0.02
"""Share of a value below which an error's part in it is not printed."""


def _in_words(found: Conformity, tolerance: Tolerance) -> str:
    zone = tolerance.zone * MM / UM
    text = f"{found.value_um:.1f} of {zone:g} µm"
    if np.isnan(found.probability):
        return f"{text}; its uncertainty is not known"
    words = {"held": "held", "exceeded": "not held", "open": "open"}[found.verdict]
    return f"{text}, up to {found.upper_um:.1f} µm (95 %): {words}, probability {100.0 * found.probability:.3g} %"


def _as_json(found: Conformity) -> dict[str, Any]:
    known = not np.isnan(found.probability)
    return {
        "value_um": found.value_um,
        "upper_um": found.upper_um if known else None,
        "probability": found.probability if known else None,
        "verdict": found.verdict,
    }


@final
@dataclass(frozen=True, eq=False, repr=False)
class Forecast(Result):
    """What a program makes of the tolerances of a part, on a machine with the errors of a calibration.

    Attributes:
        part, program, machine: names.
        tolerances: the forecast of each, as in the part's file.
        features: what the program makes of each feature that it cuts.
        compensated: why there is no compensated program, in words; empty if there is one.
        machines: number of machines drawn.
        warnings: of the calibration.
        without_uncertainty: errors whose uncertainty is not known: probabilities do not contain it.
    """

    part: str
    program: str
    machine: str
    tolerances: tuple[ForecastTolerance, ...]
    features: Mapping[str, MadeFeature]
    compensated: str
    machines: int
    warnings: tuple[str, ...]
    without_uncertainty: tuple[str, ...]

    def to_text(self) -> str:
        """Return the forecast in words."""
        lines = [
            f"Forecast of {self.part}: {self.program} on {self.machine}"
            + (f", {self.machines} machines drawn from the calibration's covariance" if self.machines > 1 else ""),
            *self.warnings,
        ]
        if self.without_uncertainty and self.machines > 1:
            lines.append(f"without uncertainty, so that probabilities are too certain: {listed([*self.without_uncertainty], most=6)}")
        for one in self.tolerances:
            lines += ["", one.tolerance.title]
            for what, found in (("as programmed", one.before), ("compensated", one.after)):
                if found is not None:
                    lines.append(f"  {what:<14}{_in_words(found, one.tolerance)}")
            largest = [f"{name} {value:.1f} µm" for name, value in one.by_error[:3] if value > SMALLEST_SHARE * one.before.value_um]
            if largest:
                lines.append(f"  {'without':<14}{', '.join(largest)} less")
            if len(one.tolerance.features) > 1:
                lines.append(f"  {'decided by':<14}{one.worst}")
        lines.append("")
        for name, made in self.features.items():
            how = "where the tip of the tool goes" if made.drilled else "by the tool's shape"
            own = f", the program itself up to {made.program_um:.1f} µm away" if made.program_um >= 0.05 else ""
            lines.append(
                f"{name}: {count_with_noun(made.points, 'point')} {how}, tool {made.tool}, lines {made.lines[0]} to {made.lines[1]}{own}"
            )
        if self.compensated:
            lines.append(f"no compensated program: {self.compensated}")
        return "\n".join([*lines, NOT_CONTAINED, ""])

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object; unknown numbers are null."""
        return {
            "schema": SCHEMA,
            "part": self.part,
            "program": self.program,
            "machine": self.machine,
            "machines": self.machines,
            "tolerances": [
                {
                    "title": one.tolerance.title,
                    "kind": one.tolerance.kind,
                    "zone_um": one.tolerance.zone * MM / UM,
                    "before": _as_json(one.before),
                    "after": None if one.after is None else _as_json(one.after),
                    "worst": one.worst,
                    "by_error_um": dict(one.by_error),
                }
                for one in self.tolerances
            ],
            "features": {name: json_form(made) for name, made in self.features.items()},
            "without_uncertainty": list(self.without_uncertainty),
            "not_contained": NOT_CONTAINED,
            "warnings": list(self.warnings),
        }

    @property
    def met(self) -> bool:
        """Whether every tolerance is held by one of the programs."""
        return all("held" in {one.before.verdict, one.after.verdict if one.after else ""} for one in self.tolerances)

    @property
    def brief(self) -> str:
        """Number of tolerances that are held, before and after."""
        held = sum(one.before.verdict == "held" for one in self.tolerances)
        after = [one.after for one in self.tolerances if one.after is not None]
        text = f"{held} of {count_with_noun(len(self.tolerances), 'tolerance')} held"
        return f"{text}; compensated: {sum(one.verdict == 'held' for one in after)}" if after else text


def forecast(
    part: Part, read: Program, dialect: Dialect, machine: Machine, calibration: Calibration, options: Options | None = None, *,
    machines: int = MACHINES, seed: int = SEED, progress: Progress = silent,
) -> Forecast:  # fmt: skip
    """Return the forecast of a part's tolerances.

    Raises:
        InputError: the program cannot be executed; a feature that no block makes; datums that do not fix the part.
    """
    maker = Maker(part, machine, calibration, Options() if options is None else options, machines, seed)
    judge = Judge(part)
    with one_blas_thread():
        run = maker.run(read, dialect)
        zero_mm = maker.zero_mm(run)
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
        rows = tuple(_forecast_of(judge, one, before, after) for one in part.tolerances)
    unknown = maker.kinematics(float(run.lengths_mm[0]))[1].without_uncertainty
    return Forecast(
        part.name, read.source, machine.name, rows, before.described, why, len(maker.draws.T),
        tuple(warning_texts(calibration.warnings)), unknown,
    )  # fmt: skip


def _forecast_of(judge: Judge, tolerance: Tolerance, before: _Made, after: _Made | None) -> ForecastTolerance:
    by_feature = judge.values_um(tolerance, before.surface, before.axis)
    worst = max(by_feature, key=lambda name: float(by_feature[name][0]))
    return ForecastTolerance(
        tolerance,
        _conformity(tolerance, by_feature),
        None if after is None else _conformity(tolerance, judge.values_um(tolerance, after.surface, after.axis)),
        _by_error(judge, tolerance, before),
        worst,
    )


def _conformity(tolerance: Tolerance, by_feature: Mapping[str, np.ndarray]) -> Conformity:
    values = np.max([*by_feature.values()], axis=0)
    limit = tolerance.zone * MM / UM
    if len(values) == 1:
        return Conformity(float(values[0]), np.nan, np.nan)
    return Conformity(float(values[0]), float(np.quantile(values[1:], CONFORMS)), float(np.mean(values[1:] <= limit)))


def _by_error(judge: Judge, tolerance: Tolerance, made: _Made) -> tuple[tuple[str, float], ...]:
    """Return what the value of the calibrated machine loses without each error, µm, largest first."""
    errors = sorted({key for each in made.by_error.values() for key in each})
    if not errors:
        return ()
    surface = {}
    for name, points in made.surface.items():
        whole, each = points.deviation_um[:, :1], made.by_error.get(name, {})
        without = [whole - each[key].deviation_um if key in each else whole for key in errors]
        surface[name] = points.with_deviation(np.hstack([whole, *without]))
    axis = {name: axis_points(judge.part.features[name], surface[name]) for name in made.axis}
    values = np.max([*judge.values_um(tolerance, surface, axis).values()], axis=0)
    found = {key: float(values[0] - value) for key, value in zip(errors, values[1:], strict=True)}
    return tuple(sorted(found.items(), key=lambda one: -one[1]))
