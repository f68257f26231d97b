"""Conversion between `Empirical` and its `effects:` entry in a calibration file.

    effects:
    - effect: empirical
      where: tool by X_mm, Y_mm
      cause: unknown
      note: …
      along: base
      columns:
      - {column: X_mm, functions: half_waves, order: 8, range: [0.0, 500.0]}
      - {column: Y_mm, functions: half_waves, order: 8, range: [0.0, 450.0]}
      parameters: {'x[1,0]': 0.42, 'x[1,3]': -1.7}

The shift of that side along x, y, z of `along` in µm is the sum of the parameters times their functions. `x[1,3]` belongs to function 1
of the first column times function 3 of the second. 0 is the constant function; `c2` and `s2` are cosine and sine of twice the angle.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import pi
from typing import Any, Final, Literal, final

import numpy as np
import pinocchio as pin

from twin._common.errors import InputError, closest_name
from twin.machine.effects import Empirical, Frame
from twin.machine.effects.base import rest_orientation
from twin.machine.effects.empirical import FrameRotation, channel_name
from twin.machine.effects.waves import APPROACH, Kind, Waves
from twin.machine.machine import ErrorFrame, Machine

NAME: Final = "empirical"
NOTE: Final = (
    "Measured, cause unknown. Valid only inside these ranges. "
    "x[j,k] is um along x, times function j of the first column, times function k of the second; 0 means 1. "
    "half_waves k: cos(k pi (value - low)/(high - low)); whole_turns ck, sk: cos, sin of k times the angle; direction: +1 or -1."
)
"""Explanation for readers of the file; not evaluated."""
MAX_COEFFICIENT_UM: Final = 20_000.0
MAX_ORDER: Final = 64
"""Largest coefficient and highest order accepted in a file."""
Along = Literal["base", "tool", "work"]


@final
@dataclass(frozen=True)
class ColumnSpec:
    """One column of an entry.

    Attributes:
        column: name of the column in the table.
        functions: kind of functions.
        order: highest order; None for a direction.
        range: range of the measured values; None if the functions need none.
    """

    column: str
    functions: Kind
    order: int | None
    range: tuple[float, float] | None


def empirical_named(
    where: str, along: Along, columns: Sequence[ColumnSpec], numbers: Mapping[str, float], machine: Machine
) -> Empirical:
    """Create an empirical effect from its entry in a calibration file.

    Args:
        where: its place: ``tool by X_mm, Y_mm``.
        along: frame whose axes the directions are.
        columns: one or two columns.
        numbers: coefficients, µm.
        machine: the machine.

    Raises:
        InputError: the entry is inconsistent or does not fit the machine.
    """
    match = re.fullmatch(r"(tool|work) by (.+?)( \(\d+\))?", where)
    named = ", ".join(column.column for column in columns)
    if match is None or match[2] != named:
        raise InputError(
            f"no such place for {NAME}", expected=f"tool or work by the columns, such as tool by {named}", value=where
        )
    side = match[1]
    if along not in ("base", side):
        raise InputError(f"{NAME} {where} along the axes of the other side", expected=f"base or {side}", value=along)
    if len(columns) not in (1, 2) or len({column.column for column in columns}) < len(columns):
        raise InputError(f"columns of {NAME} {where}", expected="one column, or two", value=named)
    waves = [_waves(where, column, machine) for column in columns]
    known = [name for own in Empirical.names(waves) for name in own]
    for name, value in numbers.items():
        if name not in known:
            expected = f"{known[0]} … {known[-1]}"
            raise InputError(
                f"no such parameter of {NAME} {where}",
                expected=expected,
                value=name,
                nearest=closest_name(name, known),
            )
        if abs(value) > MAX_COEFFICIENT_UM:
            expected = f"at most {MAX_COEFFICIENT_UM:g} µm"
            raise InputError(f"{name} of {NAME} {where} is no error of a machine", expected=expected, value=value)
    if not numbers:
        raise InputError(f"{NAME} {where} has no parameters", expected=f"some of {known[0]} … {known[-1]}")
    frame, turning = acting_frame(side, along, machine)
    return Empirical(where, along, waves, numbers, frame, turning)


def acting_frame(side: str, along: Along, machine: Machine) -> tuple[Frame, FrameRotation]:
    """Return the error frame in which a shift of one side acts, and the rotation to it from the axes along which the shift is given.

    Args:
        side: ``tool`` or ``work``.
        along: ``base`` for the error frame nearest the base, which does not turn; else the last one before the targets of that side.
        machine: the machine.

    Raises:
        InputError: no axis moves that side, or an axis nearer to the base turns both sides.
    """
    target = machine.tool_frame if side == "tool" else machine.work_frame
    supports = machine.model.supports[machine.model.frames[target].parentJoint].tolist()
    frames = [frame for frame in machine.frames if machine.by_name[frame.axis].side == side]
    if not frames:
        raise InputError(f"no axis of {machine.name} moves the {side}", expected="an error frame on that side")
    order = [supports.index(frame.joint) for frame in frames]
    if along == "base":
        first = frames[int(np.argmin(order))]
        turns = [a.name for a in machine.axes if not a.linear and a.side == "both"]
        if turns:
            raise InputError(
                f"{', '.join(turns)} turns both sides of {machine.name}",
                expected="a machine whose base directions are fixed on both sides",
            )
        none = np.zeros((3, 3))
        return Frame(first.axis, first.role), FrameRotation(rest_orientation(machine, first.joint).T, None, none, none)
    last = frames[int(np.argmax(order))]
    axis = machine.by_name[last.axis]
    start, half, quarter = (_seen_from(machine, last, target, angle) for angle in (0.0, pi, pi / 2.0))
    constant = 0.5 * (start + half)
    if axis.linear:
        return Frame(last.axis, last.role), FrameRotation(start, None, np.zeros((3, 3)), np.zeros((3, 3)))
    return Frame(last.axis, last.role), FrameRotation(constant, axis.name, 0.5 * (start - half), quarter - constant)


def unused_place(side: str, columns: Sequence[Waves], taken: Sequence[str]) -> str:
    """Return the place of a new effect, with a number if the place is already in use.

    Args:
        side: ``tool`` or ``work``.
        columns: one or two columns.
        taken: names of existing effects.
    """
    where = f"{side} by {', '.join(column.column for column in columns)}"
    number, found = 1, where
    while f"{NAME}:{found}" in taken:
        number += 1
        found = f"{where} ({number})"
    return found


def entry_of_empirical(effect: Empirical) -> dict[str, Any]:
    """Return the entry of an empirical effect, as `empirical_named` reads it."""
    columns: list[dict[str, Any]] = []
    for column in effect.columns:
        entry: dict[str, Any] = {"column": column.column, "functions": column.kind}
        if column.kind != "direction":
            entry["order"] = column.order
        if column.range is not None:
            entry["range"] = [float(bound) for bound in column.range]
        columns.append(entry)
    return {
        "effect": NAME,
        "where": effect.where,
        "cause": "unknown",
        "note": NOTE,
        "along": effect.along,
        "columns": columns,
        "parameters": {name: float(value) for name, value in effect.coefficients.items()},
    }


def available_in_programs(column: str, machine: Machine) -> bool:
    """Return whether a column is available when a program is compensated: positions, directions of approach, temperatures; not time."""
    axes = [f"{axis.name}_{axis.unit}" for axis in machine.axes]
    return column in axes or column.removeprefix(APPROACH) in machine.names or _temperature(column)


def _temperature(column: str) -> bool:
    return re.fullmatch(r"T_.+_degC", column) is not None


def _waves(where: str, given: ColumnSpec, machine: Machine) -> Waves:
    """Return one column after checking it."""
    name, what = given.column, f"{given.column} of {NAME} {where}"
    axis = machine.by_name.get(channel_name(name))
    if not available_in_programs(name, machine):
        columns = [f"{axis_entry.name}_{axis_entry.unit}" for axis_entry in machine.axes]
        columns += [f"{APPROACH}{axis_name}" for axis_name in machine.names]
        raise InputError(
            f"no such column for {NAME} {where}",
            expected=f"{', '.join(columns)} or T_<sensor>_degC",
            value=name,
            nearest=closest_name(name, columns),
        )
    allowed: tuple[Kind, ...] = ("half_waves",)
    if name.startswith(APPROACH):
        allowed = ("direction",)
    elif axis is not None and not axis.linear:
        allowed = ("half_waves", "whole_turns")
    if given.functions not in allowed:
        raise InputError(f"functions of {what}", expected=" or ".join(allowed), value=given.functions)
    if given.functions == "direction":
        if given.order is not None or given.range is not None:
            raise InputError(
                f"{what} is a direction", expected="neither order nor range", value=given.order or given.range
            )
        return Waves(name, "direction", 1)
    if given.order is None or not 1 <= given.order <= MAX_ORDER:
        raise InputError(f"order of {what}", expected=f"1 to {MAX_ORDER}", value=given.order)
    if given.functions == "whole_turns":
        if given.range is not None:
            raise InputError(f"{what} is periodic", expected="no range", value=list(given.range))
        return Waves(name, "whole_turns", given.order)
    if given.range is None or not given.range[0] < given.range[1]:
        value = None if given.range is None else list(given.range)
        raise InputError(f"range of {what}", expected="[low, high] with low < high", value=value)
    wrapped = axis is not None and axis.lower is None
    if wrapped and given.range[1] - given.range[0] >= 360.0:
        raise InputError(
            f"range of {what}", expected="less than one turn, or functions whole_turns", value=list(given.range)
        )
    return Waves(name, "half_waves", given.order, given.range, wrapped)


def _seen_from(machine: Machine, frame: ErrorFrame, target: int, angle: float) -> np.ndarray:
    """Return the orientation (3, 3) of a frame in an error frame, with that error frame's axis at ``angle`` and all others at zero."""
    q = np.zeros(len(machine.axes))
    if not machine.by_name[frame.axis].linear:
        q[machine.names.index(frame.axis)] = angle
    data = machine.model.createData()
    pin.framesForwardKinematics(machine.model, data, machine.configuration(q))
    return np.asarray(data.oMi[frame.joint].rotation.T @ data.oMf[target].rotation)
