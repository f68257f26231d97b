"""Make the kinematics module, check it over the volume, and write its folder."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.families import BASIC
from twin._common.files import write_atomic
from twin._common.provenance import ILLUSTRATIVE, SourceWarning, merge_warnings, warning_texts, warnings_to_json
from twin._common.records import APPROACH, SPEED, TIME, json_form, sensor_of
from twin._common.units import URAD
from twin.compensation.live.module import (
    COMPONENT,
    FORMAT,
    LETTERS,
    NAME,
    Damping,
    LiveCorrection,
    SuppliedChannel,
    c_file,
    channel_of,
    channels_of,
    component_file,
    temperatures_of,
)
from twin.compute.along import BatchFunction
from twin.controls import ControlSection, TableEntry, file_sha256
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions
from twin.model.effects.base import HistoryShift, RecordingState
from twin.model.unknown_errors import check_locations_identified, nominal_locations
from twin.tool.forward import Kinematics
from twin.tool.uncertainty import ToolUncertainty, random_approach, volume_inside_domains

SCHEMA: Final = "twin.compensation.live/1"
README: Final = "README.txt"
CALIBRATION: Final = "calibration.yaml"
CORRECTED: Final = "corrected.yaml"
FILES: Final = (
    f"{NAME}.c",
    f"{NAME}.hal",
    f"{NAME}.ini",
    f"{COMPONENT}.py",
    f"{COMPONENT}.hal",
    README,
    CORRECTED,
    CALIBRATION,
)
MARGIN: Final = 1.5
"""Factor on the largest tilt and the largest correction seen over the volume: temperatures and tools differ from those tried."""
LEAST_BOUND: Final = 1e-9
"""Metres and radians."""
LEAST_TILT_URAD: Final = 1e-6
LONGEST_MM: Final = 500.0
"""A correction of a tool up to this length, or up to that stated if it is longer, stays below its bound."""
PIN_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,30}")
"""Characters of a pin of HAL; its name has at most 47 with the prefix."""
TEXT_OF_SOURCE: Final = "This file holds the numbers and formulas of your machine, and the code of the module."
TEXT_OF_LICENCE: Final = "MODULE_LICENSE is what LinuxCNC asks of every module."


@final
@dataclass(frozen=True)
class Proof:
    """The correction over the volume, evaluated from the functions in the file."""

    poses: int  # number of poses, each with random directions of approach and random values of the channels
    # point_before_um, point_after_um: RMS and largest error of the tool centre point, without the correction and with it
    point_before_um: tuple[float, float]
    point_after_um: tuple[float, float]
    tilt_before_urad: tuple[float, float]  # tilt_before_urad, tilt_after_urad: RMS and largest tilt of the tool axis
    tilt_after_urad: tuple[float, float]
    # share of the poses that are close to a singular position, where the orientation is corrected in part
    damped: float
    largest: tuple[float, ...]  # (axes,) largest correction, mm and degrees
    # (axes,) what no correction exceeds in the control, with any tool, with the orientation or without
    bound: tuple[float, ...]
    steepest: float  # largest change of the correction with a position; below 1 the forward kinematics exists


@final
@dataclass(frozen=True)
class LiveKinematics:
    """The module and what it does."""

    live: LiveCorrection
    proof: Proof  # its effect over the volume
    errors: Calibration  # the calibration it was made from
    # calibrations that the control corrected already when that one was measured; their errors are added
    earlier: tuple[Calibration, ...]
    whole: Calibration  # all errors that it corrects: those of the machine with the module switched off
    text: str  # the C file
    component: str  # the HAL component that supplies the temperatures
    tool_length_mm: float
    unproven: str = ""  # why the correction is not shown to be an improvement; empty if it is

    @property
    def warnings(self) -> tuple[SourceWarning, ...]:
        """Warnings about the source of the numbers."""
        return merge_warnings(self.whole.warnings, nominal_locations(self.whole))

    def to_dict(self) -> dict[str, Any]:
        """Return the account as JSON."""
        return {
            "schema": SCHEMA,
            "format": FORMAT,
            "machine": self.live.machine.name,
            "calibration": str(self.errors.path or "no file"),
            "illustrative": ILLUSTRATIVE in self.whole.warnings,
            "warnings": warnings_to_json(self.warnings),
            "tool_length_mm": self.tool_length_mm,
            "unproven": self.unproven,
            "pins": [one.pin for one in channels_of(self.live)],
            "files": list(FILES),
            **json_form(self.proof),
        }

    def to_text(self) -> str:
        """Return README.txt, which is also printed."""
        machine, proof, names = self.live.machine, self.proof, self.live.machine.names
        corrections = ", ".join(
            f"{name} {size:.4f} {'mm' if axis.linear else '°'}"
            for name, size, axis in zip(names, proof.largest, machine.axes, strict=True)
        )
        lines = [
            f"LinuxCNC kinematics with the errors of {machine.name}",
            *warning_texts(self.warnings),
            *([f"FORCED: {self.unproven}"] if self.unproven else []),
            *(f"calibration: {one.path or 'no file: the nominal machine'}" for one in (*self.earlier, self.errors)),
            "",
            f"Error at the tool over the volume ({proof.poses} poses, tool {self.tool_length_mm:g} mm), by the model",
            f"{'':12}{'point, µm RMS':>16}{'largest':>12}{'tool axis, µrad RMS':>22}{'largest':>12}",
            *(
                f"  {name:10}{point[0]:>16.4f}{point[1]:>12.4f}{tilt[0]:>22.2f}{tilt[1]:>12.2f}"
                for name, point, tilt in (
                    ("without", proof.point_before_um, proof.tilt_before_urad),
                    ("with", proof.point_after_um, proof.tilt_after_urad),
                )
            ),
            f"  largest correction: {corrections}",
        ]
        if proof.damped > 0.0:
            lines.append(
                f"  At {100 * proof.damped:.1f} % of the poses, close to a singular one, the position is corrected in full and the "
                "orientation in part."
            )
        lines += [
            "  The uncertainty of the calibration is not reduced by any correction: see `twin volume`.",
            *_loading(machine, proof),
            *_supplying(self.live),
            *_trusting(machine, self.tool_length_mm),
        ]
        return "\n".join(lines) + "\n"


def _loading(machine: Machine, proof: Proof) -> list[str]:
    """Return the part of README.txt on building, loading, checking and switching off."""
    largest = [
        max((size for size, axis in zip(proof.bound, machine.axes, strict=True) if axis.linear is kind), default=0.0)
        for kind in (True, False)
    ]
    room = f"{ceil(10.0 * largest[0]) / 10.0 or 0.1:g} mm"
    if machine.rotary:
        room += f" and {ceil(100.0 * largest[1]) / 100.0 or 0.01:g} °"
    return [
        "",
        "Build and load (LinuxCNC 2.9)",
        f"  1. sudo halcompile --install {NAME}.c, and again for every new {NAME}.c, with the control ended.",
        f"  2. INI file: the lines of {NAME}.ini; [KINS] replaces the present section. {NAME}.hal lies beside the INI file and comes "
        "after the HAL file with `loadrt [KINS]KINEMATICS` and `loadrt [EMCMOT]EMCMOT … num_joints=[KINS]JOINTS`. Joint 0 is the "
        "first letter of COORDINATES; every axis has one joint (no gantry with two).",
        f"  3. INI file: the limits of every [JOINT_N] lie outside those of its [AXIS_L] by {room} or more, and the stops outside of "
        "them: a joint moves beyond its axis by the correction.",
        "  4. Home the machine with the correction off (it is off until the pin is set).",
        f"  5. halcmd setp {NAME}.enable 1: the correction is faded in, within 1 s (parameter fade-rate, 1/s). To have it switched on "
        f"after homing, replace the last line of {NAME}.hal: net {NAME}-homed motion.is-all-homed => {NAME}.enable",
        "  6. Move every axis once: before that its direction of approach is unknown, and the mean of both is corrected.",
        "",
        "Check before cutting",
        f"  halcmd show pin {NAME}: correction-N, in mm and degrees, must have the sizes above; out-of-range must be FALSE.",
        f"  halcmd show pin servo-thread.time and {NAME}.update.time (clock cycles) with the correction on: the thread must end well "
        "within its period.",
        "  Touch a sphere or a gauge in several positions of the rotary axes with the correction off, and again with it on: the "
        "deviations must become smaller. If they grow, switch it off and compare the signs of the axes with the machine file.",
        "",
        "Switch off",
        f"  halcmd setp {NAME}.enable 0, or {NAME}.orientation 0 for the position alone. The module can stay loaded: off, it is "
        "`trivkins`.",
    ]


def _supplying(live: LiveCorrection) -> list[str]:
    """Return the part of README.txt on the pins that must be supplied, and on the component that does it."""
    channels, sensors = channels_of(live), [sensor_of(one.name) for one in temperatures_of(live)]
    lines = []
    if channels:
        lines += [
            "",
            "Pins that must be supplied (of a value outside the range the last one within is used, and out-of-range is TRUE)",
            *(
                f"  {NAME}.{one.pin}: {one.unit}, {one.low:g} to {one.high:g}; unconnected: {one.start:g}"
                for one in channels
            ),
        ]
    lines += [
        "",
        f"{'Temperatures from a file, and the' if sensors else 'The'} record for `twin watch`",
        f"  {COMPONENT}.hal and {COMPONENT}.py beside the INI file, HALFILE = {COMPONENT}.hal after {NAME}.hal, and in the INI file:",
        "    [TWIN]",
    ]
    if sensors:
        columns = " ".join(f"T_{name}_degC" for name in sensors)
        lines += [
            f"    # a CSV file that your logger writes, with a header and the columns {columns}",
            "    SENSORS = temperatures.csv",
            "    # if the columns have other names: SENSOR=COLUMN, SENSOR=COLUMN",
            *(f"    # COLUMNS = {name}=name of its column" for name in sensors[:1]),
            "    # s: a last row older than this is no value",
            "    STALE = 60",
            "    # degC: other values are those of a broken sensor (without these lines: the ranges above)",
            "    LOW = 5",
            "    HIGH = 45",
        ]
    lines += [
        "    # the folder of checks that `twin watch` reads, and s between two rows of the record",
        "    RECORD = checks",
        "    EVERY = 10",
    ]
    if sensors:
        lines += [
            "  The last complete row of the file counts. Its time is that of a column `time` (ISO 8601, or seconds since 1970), or "
            "else of the file's last change. Commas, semicolons and tabs separate cells.",
            "  A sensor without a value, with one out of range, or without a new row keeps its last value. The operator is warned, "
            f"{NAME}.stale becomes TRUE, and the record shows it. It becomes TRUE too if {COMPONENT} has ended, or never began. To "
            f"hold the program then: net {NAME}-stale {NAME}.stale => halui.program.pause",
        ]
    return lines


def _trusting(machine: Machine, length_mm: float) -> list[str]:
    """Return the part of README.txt on programs, limits and the licence."""
    lines = [
        "",
        "Programs",
        "  In axis words: as they are; do not compensate them by twin as well. The correction counts the tool by motion.tooloffset "
        "(G43). If the lengths are in the program instead, without G43, take the lines of tool-x, -y, -z out of the HAL file and set "
        f"{NAME}.tool-z to the length.",
    ]
    if machine.rotary:
        lines += [
            "  In coordinates of the workpiece (tool centre point): M68 E3 Q1, then M66 E0 L0, with G43; back with M68 E3 Q0. At "
            "rotary zero both are the same.",
        ]
    return [
        *lines,
        "  G64 and its tolerance act before the correction and do not reduce it. G38 stops at corrected positions.",
        "",
        "What it does not do",
        "  Positions outside the range of a curve are corrected as at the end of the range; out-of-range is TRUE there. It is TRUE too "
        f"where the correction reaches its bound, with a tool much longer than {max(length_mm, LONGEST_MM):g} mm.",
        "  The position is corrected in the same cycle. Directions of approach, temperatures and the spindle's speed act one cycle "
        "later and are limited in rate, so that no axis jumps: from one side to the other in 0.1 s, 0.2 K/s, the tool 500 mm/s.",
        f"  {CALIBRATION} records that the control corrects these errors; {CORRECTED} holds their numbers.",
        "",
        "Licence",
        f"  {NAME}.c and {COMPONENT}.py hold the numbers and formulas of your machine, and the code of the module; nothing else of "
        "twin. MODULE_LICENSE in the first is what LinuxCNC asks of every module.",
    ]


def make_module(
    errors: Calibration,
    *,
    tool_length_mm: float | None = None,
    earlier: Sequence[Calibration] = (),
    force: bool = False,
) -> LiveKinematics:
    """Make the module; `InputError` for errors that it cannot hold, or that are not shown to be an improvement, unless ``force``.

    ``earlier``: errors that the control corrected already when ``errors`` were measured. ``force``: whether it is made although
    locations of rotary axes were not identified, or the errors are smaller than their uncertainty.
    """
    machine = errors.machine
    _check(errors)
    length = machine.tool_length_mm if tool_length_mm is None else tool_length_mm
    whole, unproven = _sum(earlier, errors), _unproven(errors, length)
    if not force:
        check_locations_identified(whole)
        if unproven:
            expected = "the control as it is, a calibration with smaller uncertainties, or a module without proof"
            raise InputError(unproven, expected=expected, file=errors.path, setting="force")
    plain = _channels(whole)
    trial = LiveCorrection(whole, plain, Damping.for_tilt(0.0))
    _check_ranges(trial, errors.path)
    live = LiveCorrection(whole, plain, Damping.for_tilt(MARGIN * _largest_tilt(trial, length)))
    proof = _proof(live, length)
    if proof.steepest >= 1.0:
        raise InputError(
            "the correction changes by more than the position does",
            expected="errors whose slope is far below 1: a curve of this calibration is not one of a machine",
            file=errors.path,
            value=f"{proof.steepest:.2f}",
        )
    largest = np.array(proof.bound) * machine.scale
    header = [
        f"LinuxCNC kinematics with the errors of {machine.name}, written by twin. Build: halcompile --install {NAME}.c",
        *warning_texts(merge_warnings(whole.warnings, nominal_locations(whole))),
        *([f"FORCED: {unproven}"] if unproven else []),
        *(f"calibration: {one.path or 'nominal'}" for one in (*earlier, errors)),
        TEXT_OF_SOURCE,
    ]
    about = [f"Temperatures and record of {NAME} for {machine.name}, written by twin (README.txt).", *header[1:]]
    texts = c_file(live, largest, [*header, TEXT_OF_LICENCE]), component_file(live, about)
    return LiveKinematics(live, proof, errors, tuple(earlier), whole, *texts, length, unproven)


def _sum(earlier: Sequence[Calibration], errors: Calibration) -> Calibration:
    """Return the errors of the machine without the module, from those that it corrected and those that then remained.

    What was measured again is as uncertain as the last measurement of it: the corrections before it are known.
    """
    whole, *parts = (one.with_control(None) for one in (*earlier, errors))
    for part in parts:
        unknown = {error.name for error in part.not_identifiable}
        again = {name.partition("[")[0] for name in part.covariance.names}
        known = {effect.name for effect in whole.effects} - {error.name for error in whole.not_identifiable}
        first = replace(
            whole,
            curves=MappingProxyType({name: replace(curve, covariance=None) for name, curve in whole.curves.items()}),
            joint=whole.covariance.where(lambda name, again=again: name.partition("[")[0] not in again),  # type: ignore[misc]
        )
        open_before = {error.name: error for error in whole.not_identifiable if error.name not in again - unknown}
        open_now = {error.name: error for error in part.not_identifiable if error.name not in known}
        whole = replace(
            first.extended(part.effects, part.covariance, part.source, simulated=part.simulated),
            path=part.path,
            not_identifiable=(*(open_before | open_now).values(),),
            not_estimated=tuple(name for name in whole.not_estimated if name in part.not_estimated),
            misfit=part.misfit,
            set_up=part.set_up,
            instruments=tuple(dict.fromkeys((*whole.instruments, *part.instruments))),
        )
    return whole


def held_by_module(path: Path, machine: Machine) -> tuple[TableEntry, ...]:
    """Return the calibrations whose errors a module corrects, from its `calibration.yaml`; `InputError` if a file has changed since."""
    errors = Calibration.load(path, machine)
    if errors.control is None or not errors.control.live:
        expected = f"{CALIBRATION} of a folder that `twin control --to {FORMAT}` wrote"
        raise InputError("not the calibration of a kinematics module", expected=expected, file=path)
    for entry in errors.control.live:
        entry.check()
    return errors.control.live


def errors_while_on(errors: Calibration) -> Calibration:
    """Return the errors of the machine while the module corrects these: none, as uncertain as these are."""
    zero = {
        name: replace(curve, coefficients=(0.0,) * len(curve.coefficients)) for name, curve in errors.curves.items()
    }
    kept = {number.name for effect in errors.effects if effect not in errors.extra for number in effect.parameters}
    return replace(
        errors,
        curves=MappingProxyType(zero),
        squareness=MappingProxyType(dict.fromkeys(errors.squareness, 0.0)),
        location=MappingProxyType(dict.fromkeys(errors.location, 0.0)),
        joint=None if errors.joint is None else errors.joint.where(lambda name: name in kept),
        extra=(),
        control=None,
    )


def earlier_of(errors: Calibration, *, add: bool) -> tuple[Calibration, ...]:
    """Return the errors that a module in the control corrected already when a calibration was measured.

    `InputError` if the control corrects these very errors, or if ``add`` does not say whether a module was active.
    """
    errors.check_not_live()
    section = errors.control
    if section is None or not section.live:
        if add:
            raise InputError(
                "a module was not active when these errors were measured: there is nothing to add them to",
                expected="a calibration identified with the module's calibration.yaml; without it the new module replaces an old one",
                file=errors.path,
                setting="add",
            )
        return ()
    if not add:
        raise InputError(
            "these errors were measured with the module active: a new module must hold the old ones as well",
            expected="old and new errors in one module",
            file=errors.path,
            setting="add",
        )
    for entry in section.live:
        entry.check()
    return tuple(Calibration.load(entry.file, errors.machine) for entry in section.live)


def _check(errors: Calibration) -> None:
    machine = errors.machine
    errors.check_settled()
    errors.check_not_live()
    for axis in machine.axes:
        if axis.name not in LETTERS:
            raise InputError(
                f"{machine.name}: an axis has no word in LinuxCNC",
                expected=f"one of {' '.join(LETTERS)}",
                value=axis.name,
            )
    section = errors.control
    if section is not None and (section.tables or section.kinematics):
        raise InputError(
            "the control has tables or kinematics: with the module in addition their errors would be corrected twice",
            expected="a calibration measured without tables, or tables and kinematics taken out of the control",
            file=errors.path,
        )


def _unproven(errors: Calibration, length_mm: float) -> str:
    """Return why the correction of these errors is not shown to be an improvement; empty if it is, or the uncertainty is unknown.

    Where their uncertainty exceeds them over the volume, at the tool point and of its axis, the correction may increase the error.
    Effects of channels (temperatures, spindle speed) were found significant when they were identified: with them the result is empty.
    """
    if not errors.covariance.names or Conditions().missing(errors):
        return ""
    real = Kinematics(errors.machine, errors, tool_length_mm=length_mm)
    nominal = Kinematics(errors.machine, Calibration.zero(errors.machine), tool_length_mm=length_mm)
    q = volume_inside_domains(errors)
    sides = random_approach(q)
    goal, reached, u = nominal.forward(q), real.forward(q, sides), ToolUncertainty(real, "identified").at(q, sides)
    sizes = [
        np.linalg.norm(reached.point_mm - goal.point_mm, axis=1) * 1e3,
        np.linalg.norm(reached.tilt_urad(goal), axis=1),
    ]
    found = [_rms_and_largest(values)[0] for values in (*sizes, u.expanded_um, u.axis_expanded_urad)]
    # An error without a tilt has one of rounding.
    if found[0] > found[2] or found[1] > found[3] + LEAST_TILT_URAD or not np.isfinite(found).all():
        return ""
    return (
        "U (95 %) of the correction exceeds the correction, which may increase the error: "
        f"tool point {found[0]:.2f} µm, U {found[2]:.2f} µm; tool axis {found[1]:.2f} µrad, U {found[3]:.2f} µrad (RMS over the volume)"
    )


def _check_ranges(live: LiveCorrection, file: Path | None) -> None:
    """Raise `InputError` unless there are positions and values of the pins at which every empirical effect was measured."""
    turning = {axis.name: live.range_of(axis.name, -np.inf, np.inf) for axis in live.machine.axes if axis.lower is None}
    for name, found in turning.items():
        if np.isfinite(found).any():
            raise InputError(
                f"an empirical effect was measured over a part of {name}, which turns without a limit",
                expected="one that repeats with every turn (whole_turns), or a calibration without it",
                file=file,
                value=f"{found[0]:g} to {found[1]:g}",
            )
    channels = ((one.name, one.low, one.high) for one in channels_of(live))
    axes = ((name, *span) for name, span in zip(live.machine.names, live.domains, strict=True))
    for name, low, high in (*channels, *axes):
        if not low < high:
            raise InputError(
                f"no value of {name} is within the ranges of all errors",
                expected="an empirical effect that was measured where the other errors are known and the pins can be",
                file=file,
            )


def _channels(errors: Calibration) -> tuple[str, ...]:
    """Return the channels that the control must supply. Raises `InputError`: a channel without a pin."""
    asked = RecordingState(errors.machine)
    for effect in errors.effects:
        if isinstance(effect, HistoryShift):
            effect.driven(asked)
        else:
            effect.components(asked)
    names = dict.fromkeys(name for name in asked.asked if not name.startswith(APPROACH))
    for name in names:
        if not PIN_NAME.fullmatch(channel_of(name).pin):
            raise InputError(
                "the name of a sensor cannot be the name of a pin",
                expected="letters, digits, - and _, at most 18",
                file=errors.path,
                value=name,
            )
    return tuple(names)


def _states(live: LiveCorrection, poses: int) -> np.ndarray:
    """Return random channels (poses, channels): directions of approach, values within the ranges of the pins."""
    rng = np.random.default_rng(20)
    values = [random_approach(np.zeros((poses, len(live.machine.axes))))]
    values += [rng.uniform(*_usual(one), (poses, 1)) for one in channels_of(live)]
    plain = np.hstack(values) if live.plain else values[0]
    held = np.hstack([plain, np.zeros((poses, len(live.lags)))])
    if not live.lags:
        return held
    (drives,) = BatchFunction(live.drives)(held)
    return np.hstack([plain, drives])


def _usual(channel: SuppliedChannel) -> tuple[float, float]:
    """Return a range of a channel as it occurs in a shop, within the range over which its errors are known."""
    if channel.unit == "degC":
        low, high = max(15.0, channel.low), min(35.0, channel.high)
        return (low, high) if low < high else (channel.low, channel.high)
    return (
        (0.0, 28800.0) if channel.pin == "time" else (0.0, 12000.0) if channel.pin == "spindle-speed" else (0.0, 100.0)
    )


def _poses(live: LiveCorrection) -> tuple[np.ndarray, np.ndarray]:
    """Return poses (n, axes) over the volume, mm and degrees, and random channels (n, channels)."""
    q = volume_inside_domains(live.calibration)
    return q, _states(live, len(q))


def _largest_tilt(live: LiveCorrection, length_mm: float) -> float:
    """Return the largest tilt of the tool axis over the volume without a correction, radians."""
    q, states = _poses(live)
    nominal = Kinematics(live.machine, Calibration.zero(live.machine), tool_length_mm=length_mm)
    off = nominal.with_errors(q, _errors(live, q, states)).tilt_urad(nominal.forward(q))
    return float(np.linalg.norm(off, axis=1).max()) * URAD


def _errors(live: LiveCorrection, q: np.ndarray, states: np.ndarray) -> np.ndarray:
    (errors,) = BatchFunction(live.errors)(q * live.machine.scale, states)
    return np.asarray(errors)


def _proof(live: LiveCorrection, length_mm: float) -> Proof:
    machine = live.machine
    q, states = _poses(live)
    nominal = Kinematics(machine, Calibration.zero(machine), tool_length_mm=length_mm)
    goal, before = nominal.forward(q), nominal.with_errors(q, _errors(live, q, states))
    tool = np.tile([0.0, 0.0, 1e-3 * length_mm], (len(q), 1))
    found = [
        BatchFunction(live.correction)(q * machine.scale, states, one, np.full((len(q), 1), orientation))[0]
        for one in (tool, np.tile([0.0, 0.0, 1e-3 * max(length_mm, LONGEST_MM)], (len(q), 1)))
        for orientation in (1.0, 0.0)
    ]
    correction = found[0]
    # Not zero: what rounding leaves of no correction is none that exceeds its bound.
    bound = MARGIN * np.abs(found).max(axis=(0, 1)) + LEAST_BOUND
    corrected = q + correction / machine.scale
    after = nominal.with_errors(
        corrected, _errors(live, np.clip(corrected, *(live.domains / machine.scale[:, None]).T), states)
    )
    off = [1e3 * np.linalg.norm(one.point_mm - goal.point_mm, axis=1) for one in (before, after)]
    tilts = [np.linalg.norm(one.tilt_urad(goal), axis=1) for one in (before, after)]
    (smallest, slopes) = BatchFunction(live.slopes)(q * machine.scale, states, tool)
    return Proof(
        poses=len(q),
        point_before_um=_rms_and_largest(off[0]),
        point_after_um=_rms_and_largest(off[1]),
        tilt_before_urad=_rms_and_largest(tilts[0]),
        tilt_after_urad=_rms_and_largest(tilts[1]),
        damped=float(np.mean(smallest < live.damping.region)) if machine.rotary else 0.0,
        largest=tuple((np.abs(correction) / machine.scale).max(axis=0).tolist()),
        bound=tuple((bound / machine.scale).tolist()),
        steepest=float(np.abs(slopes).max()),
    )


def _rms_and_largest(values: np.ndarray) -> tuple[float, float]:
    return float(np.sqrt(np.mean(values**2))), float(values.max())


def outputs_of(folder: Path) -> list[Path]:
    """Return every file that is written into a folder."""
    return [folder / name for name in FILES]


def write_module(made: LiveKinematics, folder: Path) -> None:
    """Write the folder, `calibration.yaml` last; `InputError` if an output is also an input, or cannot be written."""
    errors = made.errors
    inputs = {one.path.resolve() for one in (errors, *made.earlier) if one.path is not None}
    for path in outputs_of(folder):
        if path.resolve() in inputs:
            raise InputError("an output is one of the inputs", expected="another folder", file=path)
    folder.mkdir(parents=True, exist_ok=True)
    write_atomic(folder / f"{NAME}.c", made.text)
    write_atomic(folder / f"{NAME}.hal", hal_lines(made.live))
    write_atomic(folder / f"{NAME}.ini", ini_lines(made.live.machine))
    write_atomic(folder / f"{COMPONENT}.py", made.component)
    write_atomic(folder / f"{COMPONENT}.hal", component_lines(made.live))
    write_atomic(folder / README, made.to_text())
    made.whole.save(folder / CORRECTED)
    entry = TableEntry(folder / CORRECTED, FORMAT, BASIC, file_sha256(folder / CORRECTED))
    marked = replace(made.whole, source=f"{made.whole.source}; the control has the kinematics module {NAME}")
    marked.with_control(ControlSection("uncorrected", (), (), (entry,))).save(folder / CALIBRATION)


def hal_lines(live: LiveCorrection) -> str:
    """Return the HAL file."""
    lines = [
        "# After the HAL file that loads [KINS]KINEMATICS and motmod.",
        "# The module works before the motion controller in every cycle:",
        f"addf {NAME}.update servo-thread 1",
        *(f"net {NAME}-command-{i} joint.{i}.pos-cmd => {NAME}.command-{i}" for i in range(len(live.machine.axes))),
        *(f"net {NAME}-tool-{letter} motion.tooloffset.{letter} => {NAME}.tool-{letter}" for letter in "xyz"),
    ]
    if live.machine.rotary:
        lines += [
            "# M68 E3 Q1 (then M66 E0 L0): tool centre point; M68 E3 Q0: axis words",
            f"net {NAME}-type motion.analog-out-03 => motion.switchkins-type",
        ]
    for one in channels_of(live):
        if one.name == SPEED:
            lines.append(f"net {NAME}-{one.pin} spindle.0.speed-out-abs => {NAME}.{one.pin}")
        else:
            lines.append(f"# net {NAME}-{one.pin} YOUR-SENSOR => {NAME}.{one.pin}  # {one.unit}")
    return "\n".join([*lines, "# off until everything is homed:", f"setp {NAME}.enable 0"]) + "\n"


def component_lines(live: LiveCorrection) -> str:
    """Return the HAL file of the component that supplies the temperatures."""
    lines = [
        f"# After {NAME}.hal; the settings are in the section [TWIN] of the INI file (README.txt).",
        f"loadusr -Wn {COMPONENT} /usr/bin/python3 ./{COMPONENT}.py",
        *(f"net {NAME}-{one.pin} {COMPONENT}.{one.pin} => {NAME}.{one.pin}" for one in temperatures_of(live)),
        f"net {NAME}-heartbeat {COMPONENT}.heartbeat => {NAME}.heartbeat",
        "# seconds without a new value of every sensor after which the pin stale is set:",
        f"setp {NAME}.heartbeat-timeout 5",
    ]
    if any(one.name == TIME for one in channels_of(live)):
        lines.append(
            f"# If the measurement began when the control was started: net {NAME}-time {COMPONENT}.time => {NAME}.time"
        )
    return "\n".join(lines) + "\n"


def ini_lines(machine: Machine) -> str:
    """Return the lines of the INI file."""
    letters = " ".join(machine.names)
    return (
        f"[KINS]\nKINEMATICS = {NAME}\nJOINTS = {len(machine.axes)}\n\n[TRAJ]\nCOORDINATES = {letters}\n\n[HAL]\n"
        f"# after the other HALFILE lines\nHALFILE = {NAME}.hal\n"
        f"# with temperatures from a file and a record for `twin watch`, in addition:\n# HALFILE = {COMPONENT}.hal\n"
        "# [TWIN]\n# SENSORS = temperatures.csv\n# RECORD = checks\n"
    )
