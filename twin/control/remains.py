"""What tables leave: the error at the tool over the volume, and the error motions they do not carry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from twin._common.json_form import json_form
from twin.control.design import Design, Share
from twin.control.request import Request
from twin.control.wanted import Wanted, step_back
from twin.display import UNKNOWN
from twin.kinematics.forward import Kinematics, Poses, rms_and_max
from twin.machine.calibration import Calibration
from twin.machine.conditions import APPROACH, Listening
from twin.machine.effects import ControlCorrection
from twin.uncertainty.at_tool import DEFINITION, ToolUncertainty
from twin.uncertainty.budget import drawn_sides, known_volume

STEPS: Final = 2
"""Of the linear axes, so that what they can take out is gone to a nanometre."""


@final
@dataclass(frozen=True)
class LeftByTables:
    """The error at the tool over the volume.

    Attributes:
        rms_um, max_um: of the point, by the model.
        expected_rms_um: of the point, with the uncertainty of the calibration counted in; NaN where that is unknown.
        tilt_rms_urad: of the tool axis, about x and about y.
    """

    rms_um: float
    max_um: float
    expected_rms_um: float
    tilt_rms_urad: tuple[float, float]


@final
@dataclass(frozen=True)
class KnownTo:
    """How well the point is known over the volume: the calibration's uncertainty, which no correction reduces.

    Attributes:
        rms_um, max_um: U of the point (`twin.uncertainty.at_tool.DEFINITION`), over the poses; NaN where it is unknown.
        standard_rms_um: standard uncertainty (k = 1) of the distance, RMS over the poses; NaN likewise.
        without_uncertainty: errors that have a value and no uncertainty; if any, all of these are lower bounds.
    """

    rms_um: float
    max_um: float
    standard_rms_um: float
    without_uncertainty: tuple[str, ...]

    @classmethod
    def of(cls, real: Kinematics, q: np.ndarray, sides: np.ndarray) -> KnownTo:
        """Return it at (n, axes) poses, come to from these sides."""
        tool = ToolUncertainty(real)
        if not tool.parameters:
            return cls(np.nan, np.nan, np.nan, tool.without_uncertainty)
        found = tool.at(q, sides)
        u, variance = found.expanded_um, found.standard_um**2
        rms, standard = (float(np.sqrt(np.mean(one))) for one in (u**2, variance.sum(axis=1)))
        return cls(rms, float(u.max()), standard, tool.without_uncertainty)

    @property
    def least(self) -> str:
        """What stands before a number that is a lower bound."""
        return "at least " if self.without_uncertainty else ""

    def to_dict(self) -> dict[str, Any]:
        """For JSON; null where it is unknown."""
        return {"definition": DEFINITION, **json_form(self, leave_out=("standard_rms_um",))}


@final
@dataclass(frozen=True)
class Remains:
    """Before, after the tables, after a compensated program on top of them.

    Attributes:
        poses: over how many.
        before, tables, program: the errors; ``program`` is None for a machine that runs none.
        known_to: how well the point is known: U of all three.
        at_limits: of the poses, in how many an axis would have to leave its range to correct the rest.
    """

    poses: int
    before: LeftByTables
    tables: LeftByTables
    program: LeftByTables | None
    known_to: KnownTo
    at_limits: int

    @property
    def worth(self) -> float:
        """Share of the RMS error that the tables take away; with its uncertainty counted in, where that is known."""
        before, after = self.before.expected_rms_um, self.tables.expected_rms_um
        if not np.isfinite(before):
            before, after = self.before.rms_um, self.tables.rms_um
        return 1.0 - after / before if before > 0.0 else 0.0

    def to_lines(self) -> list[str]:
        """As the account says it."""
        u = self.known_to
        rows = [("as it is", self.before), ("with the tables", self.tables)]
        rows += [] if self.program is None else [("with the tables and a program compensated on top", self.program)]
        lines = [
            f"Error of the point at the tool over the volume ({self.poses} poses), µm",
            f"{'':<52}{'by the model':>12}  {'± U (95 %)':>11}  {'expected':>9}  {'largest':>9}   tool axis leans",
            f"{'':<52}{'RMS':>12}  {'RMS':>11}  {'RMS':>9}  {'by model':>9}   µrad RMS about x / y",
        ]
        lines += [_row(name, left, u) for name, left in rows]
        if not np.isfinite(u.rms_um):
            lines.append("  U is unknown: the calibration gives no uncertainty. What really remains may be any size.")
        else:
            lines.append(
                f"  {DEFINITION}; up to {u.least}{u.max_um:.2f} µm. It is the calibration's: no table and no program makes it smaller."
            )
            lines.append("  expected: with the uncertainty of the calibration counted in.")
            if u.without_uncertainty:
                lines.append(f"  U is a lower bound: no uncertainty of {' '.join(u.without_uncertainty)}.")
        if self.at_limits:
            lines.append(
                f"  at {self.at_limits} of the poses an axis would have to leave its range to correct the rest"
            )
        return lines

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        names = {"tables": "with_tables", "program": "with_tables_and_program", "known_to": "uncertainty"}
        return json_form(self, rename=names | {"at_limits": "poses_at_limits"})


def _row(name: str, left: LeftByTables, u: KnownTo) -> str:
    about_x, about_y = left.tilt_rms_urad
    numbers = f"{left.rms_um:>12.2f}  {_or_unknown(u.rms_um):>11}  {_or_unknown(left.expected_rms_um):>9}  {left.max_um:>9.2f}"
    return f"  {name:<50}{numbers}   {about_x:.1f} / {about_y:.1f}"


def _or_unknown(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else UNKNOWN


def remains(wanted: Wanted, calibration: Calibration) -> Remains:
    """The error at the tool as the control with its tables leaves it.

    Args:
        wanted: the machine, its errors alone, tool length and conditions.
        calibration: the same errors under the control with its tables; none whose channel nobody gave.
    """
    with_tables = wanted.under(calibration)
    q = known_volume(calibration)
    sides, goal = drawn_sides(q), wanted.meant.forward(q)
    real = wanted.under(wanted.calibration)
    known_to = KnownTo.of(real, q, sides)
    program, limited = None, 0
    if wanted.machine.runs_programs:
        reached, limited = _program(wanted, with_tables, q, sides, goal)
        program = _left(reached, goal, known_to)
    before, tables = (_left(one.forward(q, sides), goal, known_to) for one in (real, with_tables))
    return Remains(len(q), before, tables, program, known_to, limited)


def _program(
    wanted: Wanted, with_tables: Kinematics, q: np.ndarray, sides: np.ndarray, goal: Poses
) -> tuple[Poses, int]:
    """Return the poses with a program that corrects what the tables leave, and at how many of them an axis has no room for it."""
    machine, commands, limited = wanted.machine, q.copy(), np.zeros(len(q), dtype=bool)
    linear = list(machine.linear)
    limits = np.array([wanted.range_of(machine.axes[i]) for i in linear])
    for _ in range(STEPS):
        step = commands[:, linear] + step_back(with_tables, commands, sides, goal.point_mm)
        commands[:, linear] = np.clip(step, *limits.T)
        limited = np.abs(commands[:, linear] - step).max(axis=1) > 1e-6
    return with_tables.forward(commands, sides), int(limited.sum())


def _left(reached: Poses, goal: Poses, known_to: KnownTo) -> LeftByTables:
    off = np.linalg.norm(reached.point_mm - goal.point_mm, axis=1) * 1e3
    tilt, _ = rms_and_max(reached.tilt_urad(goal))
    rms = float(np.sqrt(np.mean(off**2)))
    return LeftByTables(rms, float(off.max()), float(np.hypot(rms, known_to.standard_rms_um)), tilt)


@final
@dataclass(frozen=True)
class Carried:
    """One error of the calibration, and what the format does with it.

    Attributes:
        name: of the error.
        iso_class: its class.
        share: ``whole``; ``line``: where the other axes stand as the tables have them, elsewhere in part; ``no``.
        why: in words, where it is not whole.
    """

    name: str
    iso_class: str
    share: Share
    why: str


def carried(wanted: Wanted, request: Request, design: Design[Any]) -> tuple[Carried, ...]:
    """Every error of the calibration.

    Args:
        wanted: the machine and its errors.
        request: the format, classes, and whether two tables are multiplied.
        design: how the tables of the format are worked out.
    """
    found, by_name = [], wanted.machine.by_name
    for effect in wanted.calibration.effects:
        if isinstance(effect, ControlCorrection):
            continue
        iso_class, axis = wanted.class_of(effect), by_name[effect.frame.axis]
        heard = _Heard(wanted)
        effect.components(heard)
        others = [by_name[name] for name in sorted(heard.used) if name != axis.name and name in by_name]
        share: tuple[Share, str]
        if iso_class not in request.classes:
            share = "no", "not in --scope"
        elif not request.form.directions and f"{APPROACH}{axis.name}" in heard.used:
            share = "no", "the format has no directions: the mean of both is taken"
        else:
            share = design.share(wanted, effect, others, request)
        found.append(Carried(effect.name, iso_class, *share))
    return tuple(found)


@final
class _Heard(dict[str, Any]):
    """One pose, and any channel an effect asks for: it remembers which of both are used."""

    def __init__(self, wanted: Wanted) -> None:
        self._source = Listening(wanted.machine)
        self.used: set[str] = set()
        super().__init__(self._source)

    def __contains__(self, name: object) -> bool:
        return True

    def __getitem__(self, name: str) -> Any:
        self.used.add(name)
        return self._source[name]
