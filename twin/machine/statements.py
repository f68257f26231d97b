"""Statements on a machine that a person can check at the machine, and positions that its control displays, compared with the files.

Directions are those of an operator who faces the column: +X right, +Y back, +Z up; with a horizontal spindle +X left, +Y up, +Z back.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Final, NamedTuple, final

import numpy as np
import pinocchio as pin

from twin._common.errors import InputError
from twin._common.files import read_lines
from twin._common.messages import Message, joined
from twin._common.units import DEG, MM
from twin.display.numbers import listed
from twin.machine.machine import Axis, Machine

ANGLES: Final = (90.0, -90.0, 45.0, -45.0, 30.0, -30.0, 15.0, -15.0, 5.0, -5.0)
"""Commands of a rotary axis that statements prefer, degrees."""
WORDS: Final = (
    (Message("left"), Message("right")),
    (Message("front"), Message("back")),
    (Message("down"), Message("up")),
)
TOWARDS: Final = (
    (Message("to the left"), Message("to the right")),
    (Message("to the front"), Message("to the back")),
    (Message("down"), Message("up")),
)
TIP_MM: Final = 100.0
"""Length of the tool in statements."""
LIFT_MM: Final = TIP_MM + 50.0
"""Height of the spindle nose above the table in statements."""


class AxisStatement(NamedTuple):
    """One statement.

    Attributes:
        text: what is seen if the files are right.
        contradicted: the answer that a "no" contradicts, and the statement with the other answer.
        command: axis positions, mm and degrees, in command order.
    """

    text: str
    contradicted: str
    command: tuple[float, ...]


def statements(machine: Machine) -> list[AxisStatement]:
    """Return the statements on every axis of a machine, in command order: its direction, and for rotary axes its place."""
    found = []
    for axis in machine.axes:
        found += [_slide(machine, axis)] if axis.linear else _turn(machine, axis)
    return found


def at_rest(machine: Machine, **offsets: float) -> tuple[float, ...]:
    """Return a command: the spindle nose above the centre of the table by more than the tool, all rotary axes at zero.

    Args:
        machine: the machine.
        offsets: added to these axes, mm and degrees.
    """
    lifted = {name: LIFT_MM if name[0] == "Z" and machine.by_name[name].linear else 0.0 for name in machine.names}
    return tuple(machine.origin_mm.get(name, 0.0) + lifted[name] + offsets.get(name, 0.0) for name in machine.names)


def poses(
    machine: Machine, command: Sequence[float] | np.ndarray, errors: np.ndarray | None = None
) -> tuple[pin.SE3, pin.SE3]:
    """Return the tool frame (at the spindle nose) and the work frame in the base frame, metres.

    Args:
        machine: the machine.
        command: axis positions, mm and degrees.
        errors: (frames, 6) as in `Machine.configuration`.
    """
    data = machine.model.createData()
    q = machine.configuration(np.array(command) * machine.scale, errors)
    pin.framesForwardKinematics(machine.model, data, q)
    return data.oMf[machine.tool_frame].copy(), data.oMf[machine.work_frame].copy()


def tip_and_axis(
    machine: Machine, command: Sequence[float] | np.ndarray, tool_length_mm: float, errors: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the tool tip (3,) in mm and the tool axis (3,), from tip to spindle, in the work frame."""
    tool, work = poses(machine, command, errors)
    tip = work.actInv(tool.act(np.array([0.0, 0.0, -tool_length_mm * MM])))
    return tip / MM, work.rotation.T @ tool.rotation[:, 2]


def direction_words(vector: np.ndarray, upright: np.ndarray | None = None) -> str:
    """Return a direction in words: ``to the right (+X)``, or ``left and up (−0.707, +0.000, +0.707)``, the largest part first.

    Args:
        vector: (3,) in the directions of the machine.
        upright: (3, 3) `Machine.upright`; None: z is up.
    """
    seen = vector if upright is None else upright @ vector
    order = [i for i in np.argsort(-np.abs(seen), kind="stable") if abs(seen[i]) > 0.02]
    if len(order) == 1:
        k = int(np.argmax(np.abs(vector)))
        sign = "+" if vector[k] > 0.0 else "−"
        return joined("", [TOWARDS[order[0]][int(seen[order[0]] > 0.0)], f" ({sign}{'XYZ'[k]})"])
    parts = ", ".join(f"{round(value, 3) + 0.0:+.3f}" for value in vector).replace("-", "−")
    return joined("", [listed([WORDS[i][int(seen[i] > 0.0)] for i in order]), f" ({parts})"])


def _slide(machine: Machine, axis: Axis) -> AxisStatement:
    """Return the statement on the direction of a linear axis."""
    index = 0 if axis.side == "tool" else 1
    start = at_rest(machine)
    end = at_rest(machine, **{axis.name: 100.0})
    moved = (poses(machine, end)[index].translation - poses(machine, start)[index].translation) / (100.0 * MM)
    what = Message("the spindle") if axis.side == "tool" else Message("the table")
    text = Message(
        "{name} to a larger position: {what} moves {direction}",
        name=axis.name,
        what=what,
        direction=direction_words(moved, machine.upright),
    )
    return AxisStatement(
        text, Message("axes.{name}.positive, or the side: {name} in `tool` or `work`", name=axis.name), end
    )


def _turn(machine: Machine, axis: Axis) -> list[AxisStatement]:
    """Return the statements on the direction and on the place of a rotary axis."""
    low, high = (-math.inf, math.inf) if axis.lower is None or axis.upper is None else (axis.lower, axis.upper)
    angles = [one for one in ANGLES if low <= one <= high] or [high if high > 0.0 else low]
    command = at_rest(machine, **{axis.name: angles[0]})
    other = _seen(machine, axis, at_rest(machine, **{axis.name: -angles[0]}))
    text = Message(
        "{name} to {angle:g}, the other rotary axes at 0: {seen}",
        name=axis.name,
        angle=angles[0],
        seen=_seen(machine, axis, command),
    )
    answer = Message("axes.{name}.positive; with the other answer, {other}. Else `about`", name=axis.name, other=other)
    found = [AxisStatement(text, answer, command)]
    ball = next((one for angle in angles if (one := _ball(machine, axis.name, angle)) is not None), None)
    if ball is not None:
        words = [
            " ".join(f"{n}{round(v, 3) + 0.0:.3f}" for n, v in zip(machine.names, one, strict=True)) for one in ball
        ]
        text = Message(
            "A ball on the table that a probe of {length:g} mm from the spindle nose touches centrally at {first} is "
            "found at {second}",
            length=TIP_MM,
            first=words[0],
            second=words[1],
        )
        found.append(
            AxisStatement(text, Message("axes.{name}.at (or `table`)", name=axis.name), tuple(ball[1].tolist()))
        )
    return found


def _seen(machine: Machine, axis: Axis, command: Sequence[float] | np.ndarray) -> str:
    """Return what an operator sees of a rotary axis at a command."""
    index = 0 if axis.side == "tool" else 1
    still, turned = (poses(machine, q)[index].rotation for q in (at_rest(machine), command))
    (_, axis_at_rest), (_, axis_in_work) = (tip_and_axis(machine, q, 0.0) for q in (at_rest(machine), command))
    # What a person sees best: where the nose or the table's surface points; a turn about that direction, by its sense.
    shown = -still[:, 2] if index == 0 else machine.upright[2]
    now = turned @ still.T @ shown
    if now @ shown < 1.0 - 1e-4:
        direction = direction_words(now, machine.upright)
        seen = (
            Message("the table's surface faces {direction}", direction=direction)
            if index
            else Message("the spindle's nose points {direction}", direction=direction)
        )
    else:
        about = pin.log3(turned @ still.T)
        above = abs(shown @ machine.upright[2]) > 0.99
        right_handed = about @ (machine.upright[2] if above else -shown) > 0.0
        sense = Message("counter-clockwise") if right_handed else Message("clockwise")
        part, place = (
            (Message("the head"), Message("the table"))[index],
            (Message("the spindle"), Message("above"))[int(above)],
        )
        seen = Message("{part} turns {sense}, seen from {place}", part=part, sense=sense, place=place)
    if axis_in_work @ axis_at_rest > 1.0 - 1e-4:
        return seen
    return Message(
        "{seen}; in the workpiece the tool's axis (tip to spindle) points {direction}",
        seen=seen,
        direction=direction_words(axis_in_work, machine.upright),
    )


def _ball(machine: Machine, name: str, angle: float) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the positions (axes,) at which one point of the workpiece is touched with a rotary axis at zero and at an angle.

    None if there is no such point within the ranges, or without three linear axes.
    """
    linear, index = list(machine.linear), machine.names.index(name)
    limits = machine.limits / machine.scale[:, None]
    if len(linear) != 3:
        return None
    # Above the table, and off a horizontal spindle's table towards the spindle.
    above = "Z" if machine.upright[2, 2] > 0.5 else "YZ"
    for up in (0.0, 0.2, 0.4, 0.6, 0.8):
        start = np.array(at_rest(machine))
        for i in linear:
            low, high = limits[i] - start[i]
            # Away from the middle, so that every rotary axis moves the ball.
            start[i] += up * high if machine.names[i][0] in above else 0.15 * (high if high >= -low else low)
        goal, _ = tip_and_axis(machine, start, TIP_MM)
        there = start.copy()
        there[index] = angle
        place, _ = tip_and_axis(machine, there, TIP_MM)
        columns = []
        for i in linear:
            moved = there.copy()
            moved[i] += 100.0
            columns.append((tip_and_axis(machine, moved, TIP_MM)[0] - place) / 100.0)
        there[linear] += np.linalg.solve(np.array(columns).T, goal - place)
        if all(np.all((limits[:, 0] <= one) & (one <= limits[:, 1])) for one in (start, there)):
            return start, there
    return None


# --- Positions that the control displays -------------------------------------------------------------


@final
@dataclass(frozen=True, eq=False)
class Displayed:
    """Positions that a control displays, and the differences of the machine's files from them.

    Attributes:
        rows: line of the file, difference of the tool tip (3,) in mm, and of the tool axis in degrees (NaN if not given), by row.
        origin_mm: (3,) origin of the displayed coordinates in the work frame: given, or the mean that was subtracted.
        fitted: whether the origin was fitted.
        cures: answers that would make all rows agree, in words.
    """

    rows: tuple[tuple[int, np.ndarray, float], ...]
    origin_mm: np.ndarray
    fitted: bool
    cures: tuple[str, ...]

    @property
    def worst(self) -> tuple[float, float]:
        """Largest difference of the tip in mm and of the axis in degrees."""
        angles = [angle for *_, angle in self.rows if math.isfinite(angle)]
        return max(float(np.linalg.norm(off)) for _, off, _ in self.rows), max(angles, default=0.0)


def read_positions(path: Path, machine: Machine) -> list[tuple[int, np.ndarray, np.ndarray, np.ndarray | None]]:
    """Return the rows of a table of positions: line, axis positions, tool tip (3,) in mm, and tool axis (3,) or None.

    The columns are the machine's axes, ``x``, ``y``, ``z`` and, if displayed, ``i``, ``j``, ``k``.

    Raises:
        InputError: a column is missing, a cell is not a number, or there are fewer than two rows.
    """
    lines = [
        (n, text) for n, text in enumerate(read_lines(path), 1) if text.strip() and not text.lstrip().startswith("#")
    ]
    delimiter = ";" if lines and ";" in lines[0][1] else ","
    table = list(csv.reader([text for _, text in lines], delimiter=delimiter))
    header = [cell.strip() for cell in table[0]] if table else []
    needed = [*machine.names, "x", "y", "z"]
    if any(name not in header for name in needed):
        raise InputError(
            "columns are missing", expected=f"columns {' '.join(needed)}, and i j k if displayed", file=path, line=1
        )
    if len(table) < 3:
        raise InputError("too few positions", expected="two or more rows, better five", file=path, value=len(table) - 1)
    found = []
    for (line, _), cells in zip(lines[1:], table[1:], strict=True):
        values = {}
        for name, cell in zip(header, cells, strict=False):
            try:
                values[name] = float(cell.replace(",", ".") if delimiter == ";" else cell)
            except ValueError:
                values[name] = math.nan
        vector = [values.get(name, math.nan) for name in "ijk"] if "i" in header else None
        bad = [name for name in [*needed, *("ijk" if vector else "")] if not math.isfinite(values.get(name, math.nan))]
        if bad:
            what, column = f"column {bad[0]} is not a number", header.index(bad[0])
            value = cells[column] if column < len(cells) else None
            raise InputError(what, expected="mm or degrees", file=path, line=line, value=value)
        q, tip = (np.array([values[name] for name in names]) for names in (machine.names, "xyz"))
        found.append((line, q, tip, None if vector is None else np.array(vector) / max(np.linalg.norm(vector), 1e-9)))
    return found


def compare_positions(
    path: Path, machine: Machine, tool_length_mm: float, origin_mm: Sequence[float] | None, tolerance: float
) -> Displayed:
    """Return the differences of a machine from the positions in a table.

    Args:
        path: the table (`read_positions`).
        machine: the machine.
        tool_length_mm: length of the active tool.
        origin_mm: (3,) zero of the displayed coordinates in the work frame; None: fitted as a constant shift.
        tolerance: differences that count, mm and degrees.

    Raises:
        InputError: as `read_positions`.
    """
    rows = read_positions(path, machine)

    def residuals(signs: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        factor = np.array([signs.get(name, 1.0) for name in machine.names])
        found = [tip_and_axis(machine, q * factor, tool_length_mm) for _, q, _, _ in rows]
        off = np.array([tip for tip, _ in found]) - [tip for _, _, tip, _ in rows]
        origin = off.mean(axis=0) if origin_mm is None else np.array(origin_mm)
        angles = [
            math.nan
            if axis is None
            else float(np.linalg.norm(np.cross(mine, axis)) / DEG if mine @ axis > 0.0 else 90.0)
            for (_, mine), (_, _, _, axis) in zip(found, rows, strict=True)
        ]
        return off - origin, np.array(angles), origin

    off, angles, origin = residuals({})
    cures: list[str] = []
    if _beyond(off, angles, tolerance):
        rotary = [machine.names[i] for i in machine.rotary]
        for some in (some for size in (1, 2) for some in combinations(rotary, size)):
            other, turned, _ = residuals(dict.fromkeys(some, -1.0))
            if not _beyond(other, turned, tolerance):
                cures.append(" and ".join(f"axes.{name}.positive: the other answer" for name in some))
        if not cures:
            cures = _shifted(machine, np.array([q for _, q, _, _ in rows]), off, origin_mm is None, tolerance)
    found = tuple((line, row, float(angle)) for (line, *_), row, angle in zip(rows, off, angles, strict=True))
    return Displayed(found, origin, origin_mm is None, tuple(cures))


def _beyond(off: np.ndarray, angles: np.ndarray, tolerance: float) -> bool:
    return bool(np.linalg.norm(off, axis=1).max() > tolerance or np.nan_to_num(angles).max() > tolerance)


def _shifted(machine: Machine, q: np.ndarray, off: np.ndarray, free: bool, tolerance: float) -> list[str]:
    """Return the changes of the tool's length, or of the place of the rotary axes, after which all rows agree, in words.

    Args:
        machine: the machine.
        q: (rows, axes) positions, mm and degrees.
        off: (rows, 3) differences of the tip, mm.
        free: whether a constant shift was fitted.
        tolerance: largest difference that remains, mm.
    """
    columns = {machine.names[i]: np.concatenate([_moved_line(machine, one, i) for one in q]) for i in machine.rotary}
    sides = [[name for name in columns if machine.by_name[name].side == side] for side in ("tool", "work")]
    candidates = {f"axes.{name}.at": one for name, one in columns.items()}
    candidates |= {
        " and ".join(f"axes.{name}.at" for name in names): np.sum([columns[name] for name in names], axis=0)
        for names in sides
        if len(names) == 2
    }
    longer = [tip_and_axis(machine, one, 1.0)[0] - tip_and_axis(machine, one, 0.0)[0] for one in q]
    cures = []
    for name, unknown in {"the length of the tool": np.concatenate(longer)[:, None], **candidates}.items():
        free_unknown = np.hstack([unknown, np.tile(np.eye(3), (len(q), 1))]) if free else unknown
        shift = np.linalg.lstsq(free_unknown, -off.ravel(), rcond=1e-9)[0]
        left = (off.ravel() + free_unknown @ shift).reshape(-1, 3)
        if np.linalg.matrix_rank(free_unknown) < off.size and np.linalg.norm(left, axis=1).max() <= tolerance:
            by = " ".join(f"{round(value, 3) + 0.0:+.3f}" for value in shift[: unknown.shape[1]])
            cures.append(f"{name}: changed by {by} mm")
    return cures


def _moved_line(machine: Machine, command: np.ndarray, index: int) -> np.ndarray:
    """Return the derivative (3, 3) of the tip in the work frame by the place of a rotary axis, given in the base frame at rest.

    The line of the axis alone moves: before its motion by δ, and what it carries back by δ.
    """
    joint, axis = machine.axis_joints[index], machine.axes[index]

    def turned(q: np.ndarray) -> np.ndarray:
        data = machine.model.createData()
        pin.forwardKinematics(machine.model, data, machine.configuration(q * machine.scale))
        return np.array(data.oMi[joint].rotation)

    still = command.copy()
    still[index] = 0.0
    at_zero = turned(np.zeros(len(command)))
    _, work = poses(machine, command)
    moved = (turned(still) - turned(command)) @ at_zero.T
    return work.rotation.T @ moved * (1.0 if axis.side == "tool" else -1.0)


# --- Pictures ----------------------------------------------------------------------------------------

_VIEW: Final = np.array([[0.87, 0.5, 0.0], [-0.25, 0.43, 0.87]])
"""Rows: directions of the picture's x and y, seen from the front, the left and above."""


def picture(machine: Machine, command: Sequence[float] | np.ndarray) -> str:
    """Return an SVG of the table (with a mark at the front) and the tool at rest, pale, and at a command, with the machine's axes."""
    shapes, corners, view = [], [], _VIEW @ machine.upright
    for pale, q in ((True, at_rest(machine)), (False, tuple(command))):
        tool, work = poses(machine, q)
        angles = np.linspace(0.0, 2.0 * np.pi, 49)
        disc = 0.12 * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1) @ machine.upright
        mark = np.array([[-0.015, -0.12, 0.0], [0.015, -0.12, 0.0], [0.0, -0.06, 0.0]]) @ machine.upright
        thin, thick = np.array([[0, 0, -TIP_MM * MM], [0, 0, 0]]), np.array([[0, 0, 0], [0, 0, 0.16]])
        for points, frame, style in (
            (disc, work, "fill:#b8c4d0;stroke:#456"), (mark, work, "fill:#d22"), (thick, tool, "stroke:#333;stroke-width:16"),
            (thin, tool, "stroke:#e67300;stroke-width:5"),
        ):  # fmt: skip
            flat = np.array([view @ frame.act(point) for point in points.astype(float)])
            corners.append(flat)
            shapes.append((flat, style + (";opacity:0.25" if pale else "")))
    every = np.concatenate(corners)
    low, high = every.min(axis=0), every.max(axis=0)
    scale = 230.0 / float(max(high - low))

    def placed(points: np.ndarray) -> str:
        return " ".join(f"{20 + scale * (x - low[0]):.1f},{260 - scale * (y - low[1]):.1f}" for x, y in points)

    parts = []
    for flat, style in shapes:
        kind = "polygon" if len(flat) > 2 else "polyline"
        parts.append(f'<{kind} points="{placed(flat)}" style="{style}"/>')
    for name, direction, colour in zip("XYZ", np.eye(3), ("#c00", "#080", "#00c"), strict=True):
        x, y = view @ direction * 30.0
        parts.append(
            f'<line x1="30" y1="250" x2="{30 + x:.1f}" y2="{250 - y:.1f}" stroke="{colour}" stroke-width="2"/>'
        )
        parts.append(f'<text x="{32 + 1.25 * x:.1f}" y="{254 - 1.25 * y:.1f}" fill="{colour}">{name}</text>')
    return f'<svg viewBox="0 0 280 280" width="280" height="280">{"".join(parts)}</svg>'
