"""Error at the tool over the volume that remains with the tables, and the error motions they do not correct."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, final

import numpy as np

from twin._common.records import APPROACH, json_form
from twin.compensation.tables.design import Design, Request, RequiredCorrections, Share, Unproven
from twin.display import UNKNOWN
from twin.model.calibration import Calibration
from twin.model.effects import ControlCorrection
from twin.model.effects.base import RecordingState
from twin.tool.forward import Kinematics, Poses, rms_and_max
from twin.tool.uncertainty import DEFINITION, ToolUncertainty


@final
@dataclass(frozen=True)
class VolumeError:
    """Error at the tool over the volume."""

    # rms_um, max_um: error of the tool centre point according to the model, RMS and maximum over the poses
    rms_um: float
    max_um: float
    expected_rms_um: float  # expected RMS error, including the uncertainty of the calibration; NaN if that is unknown
    tilt_rms_urad: tuple[float, float]  # RMS tilt of the tool axis about x and about y


@final
@dataclass(frozen=True)
class PointUncertainty:
    """Uncertainty of the tool centre point over the volume; it comes from the calibration and no correction reduces it."""

    # rms_um, max_um: U of the point (`twin.tool.uncertainty.DEFINITION`), RMS and maximum over the poses; NaN if unknown
    rms_um: float
    max_um: float
    standard_rms_um: float  # standard uncertainty (k = 1) of the distance, RMS over the poses; NaN if unknown
    identified_rms_um: float  # U of the identified errors alone, RMS over the poses; NaN if unknown
    identified_standard_rms_um: float  # standard uncertainty of these alone, as ``standard_rms_um``
    unknown: tuple[str, ...]  # errors that could not be determined; U includes their plausible size
    # errors that have a value but no uncertainty; if there are any, the numbers are lower bounds
    without_uncertainty: tuple[str, ...]

    @classmethod
    def of(cls, real: Kinematics, q: np.ndarray, sides: np.ndarray) -> PointUncertainty:
        """Return the uncertainty at (n, axes) poses, approached from the directions ``sides`` (+1, −1, 0 unknown)."""
        tool = ToolUncertainty(real)
        if not tool.parameters:
            return cls(np.nan, np.nan, np.nan, np.nan, np.nan, (), tool.without_uncertainty)
        found = tool.at(q, sides)
        of_identified = ToolUncertainty(real, "identified").at(q, sides) if tool.unknown else found
        rms, standard, identified, identified_standard = (
            float(np.sqrt(np.mean(squares)))
            for one in (found, of_identified)
            for squares in (one.expanded_um**2, (one.standard_um**2).sum(axis=1))
        )
        largest = float(found.expanded_um.max())
        return cls(rms, largest, standard, identified, identified_standard, tool.unknown, tool.without_uncertainty)

    @property
    def unknown_text(self) -> str:
        """Sentence on the errors that could not be determined; empty if there are none."""
        if not self.unknown:
            return ""
        return (
            f"U includes the plausible size of errors that were not identified: {' '.join(self.unknown)}; without them it is "
            f"{or_unknown(self.identified_rms_um)} µm RMS."
        )

    @property
    def least(self) -> str:
        """Prefix of a number that is a lower bound; empty if it is not one."""
        return "at least " if self.without_uncertainty else ""

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object; unknown numbers are null."""
        hidden = ("standard_rms_um", "identified_standard_rms_um")
        return {"definition": DEFINITION, **json_form(self, leave_out=hidden, rename={"unknown": "not_identified"})}


@final
@dataclass(frozen=True)
class RemainingErrors:
    """Error at the tool without tables, with tables, and with tables and a compensated NC program."""

    poses: int
    # before, tables, program: the errors; ``program`` is None for a machine that runs no NC programs
    before: VolumeError
    tables: VolumeError
    program: VolumeError | None
    uncertainty: PointUncertainty  # uncertainty of the point, the same for all three
    at_limits: int  # number of poses at which an axis would have to leave its range to correct the remaining error

    @property
    def reduction(self) -> float:
        """Share of the RMS error, or of the expected one of identified errors where U is known, that the tables correct."""
        known = self.uncertainty.identified_standard_rms_um
        before, after = (
            float(np.hypot(one.rms_um, known)) if np.isfinite(known) else one.rms_um
            for one in (self.before, self.tables)
        )
        return 1.0 - after / before if before > 0.0 else 0.0

    def to_lines(self) -> list[str]:
        """Return the lines of the account: a table of errors and what its columns mean."""
        u = self.uncertainty
        rows = [("without tables", self.before), ("with the tables", self.tables)]
        rows += [] if self.program is None else [("with the tables and a compensated NC program", self.program)]
        lines = [
            f"Error of the tool centre point over the volume ({self.poses} poses), µm",
            f"{'':<52}{'by the model':>12}  {'± U (95 %)':>11}  {'expected':>9}  {'largest':>9}   tool axis tilt",
            f"{'':<52}{'RMS':>12}  {'RMS':>11}  {'RMS':>9}  {'by model':>9}   µrad RMS about x / y",
        ]
        lines += [_row(name, error, u) for name, error in rows]
        if not np.isfinite(u.rms_um):
            lines.append(
                "  U is unknown: the calibration gives no uncertainty. The error that really remains may have any size."
            )
        else:
            lines.append(
                f"  {DEFINITION}; up to {u.least}{u.max_um:.2f} µm. "
                "It comes from the calibration: neither tables nor programs reduce it."
            )
            lines.append("  expected: including the uncertainty of the calibration.")
            lines += [f"  {u.unknown_text}"] if u.unknown else []
            if u.without_uncertainty:
                lines.append(f"  U is a lower bound: no uncertainty is given for {' '.join(u.without_uncertainty)}.")
        if self.at_limits:
            lines.append(
                f"  at {self.at_limits} of the poses the rest cannot be corrected: an axis would leave its range"
            )
        return lines

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object."""
        names = {"tables": "with_tables", "program": "with_tables_and_program"}
        return json_form(self, rename=names | {"at_limits": "poses_at_limits"})


def _row(name: str, error: VolumeError, u: PointUncertainty) -> str:
    about_x, about_y = error.tilt_rms_urad
    numbers = f"{error.rms_um:>12.2f}  {or_unknown(u.rms_um):>11}  {or_unknown(error.expected_rms_um):>9}  {error.max_um:>9.2f}"
    return f"  {name:<50}{numbers}   {about_x:.1f} / {about_y:.1f}"


def or_unknown(value: float) -> str:
    """Return a number with two decimals, or the word for an unknown one."""
    return f"{value:.2f}" if np.isfinite(value) else UNKNOWN


def remaining_errors(required: RequiredCorrections, calibration: Calibration) -> RemainingErrors:
    """Return the error at the tool over the volume without tables, with those of ``calibration``, and with a compensated program."""
    reach, at = partial(required.poses_with, calibration), required.volume
    uncertainty, before = _without_tables(required)
    reached = reach(at.q)
    program, limited = None, 0
    if required.machine.runs_programs:
        commands, limited = required.corrected_commands(reach, reached)
        program = volume_error(reach(commands), at.goal, uncertainty)
    tables = volume_error(reached, at.goal, uncertainty)
    return RemainingErrors(len(at.q), before, tables, program, uncertainty, limited)


@lru_cache(maxsize=1)
def _without_tables(required: RequiredCorrections) -> tuple[PointUncertainty, VolumeError]:
    """Return uncertainty and error without tables; every format asks for the same ones."""
    real, at = required.kinematics_with(required.calibration), required.volume
    uncertainty = PointUncertainty.of(real, at.q, at.sides)
    return uncertainty, volume_error(real.forward(at.q, at.sides), at.goal, uncertainty)


def volume_error(reached: Poses, goal: Poses, uncertainty: PointUncertainty) -> VolumeError:
    """Return the error of poses against the nominal ones."""
    off = np.linalg.norm(reached.point_mm - goal.point_mm, axis=1) * 1e3
    tilt, _ = rms_and_max(reached.tilt_urad(goal))
    rms = float(np.sqrt(np.mean(off**2)))
    return VolumeError(rms, float(off.max()), float(np.hypot(rms, uncertainty.standard_rms_um)), tilt)


@final
@dataclass(frozen=True)
class CorrectedShare:
    """One error of the calibration and whether the tables correct it."""

    name: str  # name of the error
    iso_class: str  # its class (ISO/TR 16907)
    # ``whole``: corrected; ``line``: corrected with the other axes at the positions of the tables, elsewhere in part; ``no``
    share: Share
    why: str  # the reason if it is not ``whole``


def corrected_shares(
    required: RequiredCorrections, request: Request, design: Design[Any], unproven: Sequence[Unproven] = ()
) -> tuple[CorrectedShare, ...]:
    """Return every error of the calibration with the share of it that the tables of the request correct."""
    not_written: dict[str, list[str]] = {}
    for one in () if request.unproven else unproven:
        for name in one.axes:
            not_written.setdefault(name, []).append(one.name)
    corrected_shares, by_name = [], required.machine.by_name
    for effect in required.calibration.effects:
        if isinstance(effect, ControlCorrection):
            continue
        iso_class, axis = required.class_of(effect), by_name[effect.frame.axis]
        recorded = _RecordingState(required)
        effect.components(recorded)
        others = [by_name[name] for name in sorted(recorded.used) if name != axis.name and name in by_name]
        share: tuple[Share, str]
        if iso_class not in request.classes:
            share = "no", "its class is not selected"
        elif not request.form.directions and f"{APPROACH}{axis.name}" in recorded.used:
            share = (
                "no",
                "the format does not distinguish the direction of approach: the mean of both directions is used",
            )
        else:
            share = design.share(required, effect, others, request)
        if share[0] != "no" and axis.name in not_written:
            share = "line", f"not written, because U exceeds the correction: {', '.join(not_written[axis.name])}"
        corrected_shares.append(CorrectedShare(effect.name, iso_class, *share))
    return tuple(corrected_shares)


@final
class _RecordingState(dict[str, Any]):
    """One pose with every channel an effect reads; it records the axes and channels that are read."""

    def __init__(self, required: RequiredCorrections) -> None:
        self._source = RecordingState(required.machine)
        self.used: set[str] = set()
        super().__init__(self._source)

    def __contains__(self, name: object) -> bool:
        return True

    def __getitem__(self, name: str) -> Any:
        self.used.add(name)
        return self._source[name]
