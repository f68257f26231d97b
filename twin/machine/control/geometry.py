"""What small errors of the axes do at the tool point, to first order, as a control that knows the machine works it out.

Below the room of the machine's full expression (`twin.machine.chain`), which contains the effects and so the tables themselves: a
second, plainer walk along the same placements. Arrays and CasADi expressions alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, final

import numpy as np

from twin._common.errors import InputError
from twin._common.units import MM
from twin.machine.machine import ErrorFrame, Machine
from twin.numerics.elementary import cos, sin

Vector = tuple[Any, Any, Any]
Turn = tuple[Vector, Vector, Vector]
"""A rotation by its rows."""
CONSTANT = 1e-12


def cross(a: Sequence[Any], b: Sequence[Any]) -> Vector:
    """The vector product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def turned(turn: Turn, vector: Sequence[Any]) -> Vector:
    """A vector turned."""
    return tuple(sum(row[k] * vector[k] for k in range(3) if not _zero(row[k])) for row in turn)


def back(turn: Turn, vector: Sequence[Any]) -> Vector:
    """A vector turned the other way."""
    return turned(tuple(zip(*turn, strict=True)), vector)  # type: ignore[arg-type]


def plus(a: Sequence[Any], b: Sequence[Any]) -> Vector:
    """The sum."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def minus(a: Sequence[Any], b: Sequence[Any]) -> Vector:
    """The difference."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _zero(value: Any) -> bool:
    return isinstance(value, float) and value == 0.0


@final
class Geometry:
    """The machine as drawn.

    Args:
        machine: three linear axes, and rotary ones.
        tool_length_mm: from the tool frame to the tip.

    Attributes:
        frames: the frames of error motions, one an axis.
        nose: the tool frame's place (mm) with all axes at zero, in the base frame.
        solve: (3, 3) linear axes' commands a tool displacement in the base frame.

    Raises:
        InputError: not three linear axes, or one whose direction changes as another axis turns.
    """

    def __init__(self, machine: Machine, tool_length_mm: float) -> None:
        self.machine = machine
        self.tool_length_mm = tool_length_mm
        self.frames = tuple(frame for frame in machine.frames if frame.role == "motion")
        self._axis_of = dict(zip(machine.axis_joints, machine.axes, strict=True))
        zero = {axis.name: 0.0 for axis in machine.axes}
        self.nose = self._tool(zero)[1]
        self._zero = {frame.axis: self.pose(frame, zero) for frame in self.frames}
        self.solve = np.linalg.inv(self._directions(zero))
        rng = np.random.default_rng(0)
        for _ in range(3):
            there = {axis.name: float(rng.uniform(*axis.domain)) for axis in machine.axes}
            if np.abs(self._directions(there) @ self.solve - np.eye(3)).max() > CONSTANT:
                raise InputError(
                    f"{machine.name}: a linear axis changes its direction as another one moves",
                    expected="linear axes that keep their direction",
                    file=machine.path,
                )

    def pose(self, frame: ErrorFrame, positions: Mapping[str, Any]) -> tuple[Turn, Vector]:
        """Rotation and place (mm) of an error frame in the base frame."""
        return self._joint(frame.joint, positions)

    def at_zero(self, frame: ErrorFrame) -> tuple[Turn, Vector]:
        """`pose` with all axes at zero."""
        return self._zero[frame.axis]

    def tip(self, positions: Mapping[str, Any]) -> Vector:
        """The tool tip in the base frame, mm."""
        turn, place = self._tool(positions)
        return plus(place, turned(turn, (0.0, 0.0, -self.tool_length_mm)))

    def centre(self, frame: ErrorFrame) -> Vector:
        """The point an axis's errors are given at, all axes at zero: the nose for a linear axis, its own origin for a rotary one."""
        return self.nose if self.machine.by_name[frame.axis].linear else self.at_zero(frame)[1]

    def moved(self, frame: ErrorFrame, positions: Mapping[str, Any], twist: Sequence[Any]) -> Vector:
        """How the tool tip moves against the work when an axis errs by a twist: µm, in the base frame.

        Args:
            frame: of the axis.
            positions: mm and degrees by axis.
            twist: three translations (µm) of the point `centre` and three rotations (µrad), along the base frame's axes with all
                axes at zero.
        """
        turn, place = self.pose(frame, positions)
        zero_turn, zero_place = self.at_zero(frame)
        carried = plus(place, turned(turn, back(zero_turn, minus(self.centre(frame), zero_place))))
        shift, spin = (turned(turn, back(zero_turn, twist[i : i + 3])) for i in (0, 3))
        # µrad times mm are nanometres.
        lever = tuple(1e-3 * part for part in minus(self.tip(positions), carried))
        total = plus(shift, cross(spin, lever))
        side = self.machine.by_name[frame.axis].side
        sign = {"tool": 1.0, "work": -1.0, "both": 0.0}[side]
        return (sign * total[0], sign * total[1], sign * total[2])

    def _directions(self, positions: Mapping[str, float]) -> np.ndarray:
        """(3, 3) tool displacement in the base frame, a column a linear axis."""
        columns = []
        for frame in self.frames:
            axis = self.machine.by_name[frame.axis]
            if axis.linear:
                sign = {"tool": 1.0, "work": -1.0, "both": 0.0}[axis.side]
                columns.append(sign * np.array(turned(self.pose(frame, positions)[0], axis.direction)))
        if len(columns) != 3 or abs(np.linalg.det(np.array(columns))) < CONSTANT:
            raise InputError(
                f"{self.machine.name} has not three linear axes across one another",
                expected="three; linuxcnc, heidenhain and siemens have tables of single axes",
                file=self.machine.path,
            )
        order = [frame.axis for frame in self.frames if self.machine.by_name[frame.axis].linear]
        linear = [self.machine.axes[i].name for i in self.machine.linear]
        return np.array([columns[order.index(name)] for name in linear]).T

    def _tool(self, positions: Mapping[str, Any]) -> tuple[Turn, Vector]:
        placed = self.machine.model.frames[self.machine.tool_frame]
        turn, place = self._joint(placed.parentJoint, positions)
        own, offset = _constant(placed.placement)
        return _product(turn, own), plus(place, turned(turn, offset))

    def _joint(self, joint: int, positions: Mapping[str, Any]) -> tuple[Turn, Vector]:
        model = self.machine.model
        chain = []
        while joint != 0:
            chain.append(joint)
            joint = model.parents[joint]
        turn: Turn = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        place: Vector = (0.0, 0.0, 0.0)
        for index in reversed(chain):
            own, offset = _constant(model.jointPlacements[index])
            place = plus(place, turned(turn, offset))
            turn = _product(turn, own)
            axis = self._axis_of.get(index)
            if axis is None:
                continue
            data = model.joints[index].createData()
            model.joints[index].calc(
                data, np.zeros(model.joints[index].idx_q + 1), np.zeros(model.joints[index].idx_v + 1)
            )
            motion = [float(part) for part in np.asarray(data.S).reshape(6)]
            q = positions[axis.name]
            if axis.linear:
                place = plus(place, turned(turn, tuple(part * q if part else 0.0 for part in motion[:3])))
            else:
                turn = _product(turn, _about(motion[3:], q * axis.scale))
        return turn, place


def _about(axis: Sequence[float], angle: Any) -> Turn:
    """Rodrigues' rotation about a unit vector."""
    s, c = sin(angle), cos(angle)
    x, y, z = axis
    skew = ((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))
    rows = []
    for i in range(3):
        row = []
        for k in range(3):
            square = sum(skew[i][m] * skew[m][k] for m in range(3))
            value: Any = 1.0 if i == k else 0.0
            value = value + skew[i][k] * s if skew[i][k] else value
            row.append(value + square * (1.0 - c) if square else value)
        rows.append(tuple(row))
    return tuple(rows)  # type: ignore[return-value]


def _product(a: Turn, b: Turn) -> Turn:
    columns = [turned(a, column) for column in zip(*b, strict=True)]
    return tuple(zip(*columns, strict=True))  # type: ignore[return-value]


def _constant(placement: Any) -> tuple[Turn, Vector]:
    turn = tuple(tuple(float(part) for part in row) for row in placement.rotation)
    return turn, tuple(float(part) / MM for part in placement.translation)  # type: ignore[return-value]
