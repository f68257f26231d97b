"""Which test part would show the errors of the machine that matter most at the tool, once it is cut and measured."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from twin._common.files import write_atomic
from twin._common.units import count_with_noun
from twin.compensation.programs.prepared import Options
from twin.display.results import Result
from twin.machine.machine import Machine
from twin.measurement.instruments import instrument_named
from twin.measurement.simulate import Placement
from twin.model.calibration import Calibration
from twin.nc import read_program
from twin.part.features import PartDrawing
from twin.part.measured import measure_part, points_of_program
from twin.part.measured_table import MeasuredTable
from twin.planning.design import covariance_of, inverse
from twin.planning.kit import EXPECTED_UM, FALL, PlanModel
from twin.planning.task import POSES, SEED, LinearAim
from twin.tool.uncertainty import volume

SHOWN: Final = 0.25
"""Share of an error's expected variance that may remain where a part shows it: half of its size."""
MOST_NAMED: Final = 12


@final
@dataclass(frozen=True)
class ShownError:
    """An error of the machine under one part.

    Attributes:
        name: ISO 230-1 name.
        tool_um: RMS of its expected effect at the tool point over the volume.
        remaining: share of its expected variance that remains after the part was measured.
    """

    name: str
    tool_um: float
    remaining: float


@final
@dataclass(frozen=True, repr=False)
class PartEvidence(Result):
    """Evidence of one test part about the errors of the machine.

    Attributes:
        name: of the program.
        points: to measure.
        readings: that the points give.
        minutes: to cut it, by path and feed; NaN if unknown.
        before_um, after_um: RMS of the tool point's error over the volume, from the errors of the axes that move, before and after.
        errors: those of these axes, largest at the tool first.
    """

    name: str
    points: MeasuredTable
    readings: int
    minutes: float
    before_um: float
    after_um: float
    errors: tuple[ShownError, ...]

    @property
    def found_um(self) -> float:
        """RMS of the part of the tool point's error that the measured part makes known."""
        return float(np.sqrt(max(self.before_um**2 - self.after_um**2, 0.0)))

    @property
    def brief(self) -> str:
        """Size of the error of the tool point that becomes known."""
        return f"{self.name}: makes known {self.found_um:.1f} µm of the tool point's error ({self.before_um:.1f} µm expected)"

    def to_text(self) -> str:
        """Return the errors that it shows, and the largest that it does not."""
        seen = [one for one in self.errors if one.remaining < SHOWN]
        unseen = [one for one in self.errors if one.remaining >= SHOWN]
        time = "" if np.isnan(self.minutes) else f", {self.minutes:.0f} min of cutting by path and feed"
        return (
            f"{self.brief}\n  {count_with_noun(len(self.points.points), 'point')}{time}\n"
            f"  shows each of              {_listed(seen)}\n  only with others, or not   {_listed(unseen)}\n"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object."""
        return {
            "part": self.name,
            "points": len(self.points.points),
            "readings": self.readings,
            "minutes": None if np.isnan(self.minutes) else self.minutes,
            "tool_before_um": self.before_um,
            "tool_after_um": self.after_um,
            "made_known_um": self.found_um,
            "errors": [{"name": one.name, "tool_um": one.tool_um, "remaining": one.remaining} for one in self.errors],
        }

    def save(self, path: Path) -> None:
        """Write the points to measure: feature, nominal place and normal, and empty columns for what was measured."""
        text = io.StringIO()
        out = csv.writer(text, lineterminator="\n")
        roles = [f"{role} {axis} [mm]" for role in ("Nominal", "Measured") for axis in "XYZ"]
        out.writerow(["Feature", *roles[:3], "I", "J", "K", *roles[3:]])
        for point in self.points.points:
            numbers = (*point.nominal_mm, *point.normal)
            out.writerow([point.feature, *(f"{value + 0.0:.6g}" for value in numbers), "", "", ""])
        write_atomic(path, text.getvalue())


def _listed(errors: Sequence[ShownError]) -> str:
    names = [f"{one.name} ({one.tool_um:.1f} µm)" for one in errors[:MOST_NAMED]]
    more = f" and {len(errors) - MOST_NAMED} more" if len(errors) > MOST_NAMED else ""
    return (", ".join(names) + more) or "nothing"


@final
@dataclass(frozen=True, repr=False)
class PartComparison(Result):
    """Test parts, the most informative first."""

    parts: tuple[PartEvidence, ...]

    @property
    def brief(self) -> str:
        """The best one."""
        return f"cut {self.parts[0].brief}"

    def to_text(self) -> str:
        """Return what each part shows."""
        head = "What a measured part would show, of errors of the sizes that are expected; the tool point over the whole volume:\n\n"
        tail = f"\nMost is made known by {self.parts[0].name}. Errors of axes that stand still while it is cut are not counted.\n"
        return head + "\n".join(one.to_text() for one in self.parts) + tail

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object."""
        return {"schema": "twin.plan/1", "parts": [one.to_dict() for one in self.parts]}


def compare_parts(
    parts: Sequence[tuple[Path, Path]],
    machine: Machine,
    expected: Calibration,
    options: Options,
) -> PartComparison:
    """Return what each of some parts would show, measured on a coordinate measuring machine.

    Args:
        parts: program and file of features of each.
        machine: the machine.
        expected: errors of the sizes that are expected.
        options: set-up and tool length of the programs.

    Raises:
        InputError: a program or a part that cannot be read; no block makes a feature.
    """
    found = [_judged(program, features, machine, expected, options) for program, features in parts]
    return PartComparison(tuple(sorted(found, key=lambda one: -one.found_um)))


def _sizes(model: PlanModel, expected: Calibration) -> np.ndarray:
    """Return the expected size (p,) of every unknown: of a curve that of the calibration, or a typical one, falling with the order."""
    sizes = np.array(model.plausible)
    for name, space in model.curves.items():
        columns = model.unknowns.of(name)
        curve = expected.curves.get(name)
        fall = FALL ** np.arange(len(columns))
        q, w = space.grid()
        of_curve = 0.0 if curve is None else float(np.sqrt(w @ curve(q) ** 2 / w.sum()))
        sizes[columns] = max(of_curve, EXPECTED_UM) * np.sqrt(fall / fall.sum())
    given = {**expected.squareness, **expected.location}
    for name in model.unknowns.constants:
        sizes[model.unknowns.of(name)] = max(abs(given.get(name, 0.0)), EXPECTED_CONSTANT)
    return sizes


EXPECTED_CONSTANT: Final = 20.0
"""Size of a squareness or a location, µrad or µm, if the calibration has a smaller one: typical of a machine in good order."""


def _judged(program: Path, features: Path, machine: Machine, expected: Calibration, options: Options) -> PartEvidence:
    read, part = read_program(program), PartDrawing(features)
    table = points_of_program(part, read, machine, options)
    data = measure_part(table, part, read, machine, options).measurements
    setting = Placement.draw(data, np.random.default_rng(0))
    model = PlanModel.of(machine, data, setting, instrument_named("cmm"), expected, known=[*setting.places_mm])
    precision = model.free.T @ ((model.plausible / _sizes(model, expected))[:, None] ** 2 * model.free)
    prior, after = inverse(precision), covariance_of(precision, model.rows)
    positions, length = volume(machine, POSES, SEED), model.tool_length(options.tool_length_mm)
    names = model.unknowns.entities
    aims = {name: LinearAim(model.at_tool(positions, length, {*names} - {name})) for name in names}
    errors = []
    for name, aim in aims.items():
        own = model.plausible[model.unknowns.of(name), None] * model.free[model.unknowns.of(name)]
        left, was = (float(np.einsum("kf,fg,kg->", own, cov, own)) for cov in (after, prior))
        errors.append(ShownError(name, aim.value(prior), left / was if was > 0.0 else 1.0))
    whole = LinearAim(model.at_tool(positions, length))
    time = float(np.max(data.time_s)) / 60.0
    return PartEvidence(
        program.stem,
        table,
        len(data),
        time,
        whole.value(prior),
        whole.value(after),
        tuple(sorted(errors, key=lambda one: -one.tool_um)),
    )
