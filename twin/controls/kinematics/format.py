"""Base class of the kinematics of a control's transformation: one final class per format, each in its own file.

Geometry of the rotary axes of a table in the transformation of a control, and the correction that it makes.

Coordinates are those of the machine: a point has the coordinates (X, Y, Z) if the spindle nose is there with the linear axes at X, Y, Z
and the table at zero. A point x of the workpiece, with the table at zero, is moved by the two rotary axes to

    m(x) = p1 + R(a1, q1) · (p2 + R(a2, q2) · (g(x) − p2) − p1),    g(x) = c + s + Exp(t) · (x − c)

with the lines (p, a) of the axis near the bed and of the axis near the workpiece, and the place of the workpiece on the table (shift s,
rotation vector t, about the nominal origin c of the work frame). A control with this geometry sends the linear axes to m(x) less the
vector of the tool. Against the nominal geometry the commands are shifted by D⁻¹ (m(x) − m_nominal(x)), D the directions of the linear
axes. The commands of the rotary axes are the same. Linear axes are taken with their nominal directions: squareness is left to tables.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, Final, final

import casadi as ca
import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.files import scratch_folder
from twin._common.units import MM
from twin.compute.along import BatchFunction
from twin.controls.correction import Correction, TableSummary, check_linear, rest_geometry
from twin.controls.format import TableLine, table_lines
from twin.machine.chain import frame_pose, joint_in_base, joint_twist
from twin.machine.machine import Axis, Machine
from twin.numerics.spatial import rotation_exp

PARTS = 6
"""Number of vectors of a geometry: two points, two directions, shift and turn of the workpiece."""


@final
@dataclass(frozen=True, eq=False)
class TableGeometry:
    """Lines of the two rotary axes of a table, and the place of the workpiece on it; see the module.

    Attributes:
        points: (2, 3) a point of each axis, mm; the axis near the bed first.
        directions: (2, 3) about which the table turns right-handed with a positive command.
        shift: (3,) shift of the workpiece, mm.
        turn: (3,) rotation vector of the workpiece, rad.
    """

    points: np.ndarray
    directions: np.ndarray
    shift: np.ndarray
    turn: np.ndarray

    def __post_init__(self) -> None:
        for part in (self.points, self.directions, self.shift, self.turn):
            read_only(part)

    @property
    def vector(self) -> np.ndarray:
        """All numbers (18,): points, directions, shift, turn."""
        return np.concatenate([self.points.ravel(), self.directions.ravel(), self.shift, self.turn])


def rotary_axes(machine: Machine) -> tuple[Axis, Axis]:
    """Return the two rotary axes of the table, the one near the bed first; raise `InputError` for another structure.

    Required are three linear axes of constant direction and two rotary axes that carry the workpiece.
    """
    check_linear(machine)
    machine.check_tool_along_z()
    rotary = [i for i, axis in enumerate(machine.axes) if not axis.linear]
    if len(rotary) != 2 or any(machine.axes[i].side != "work" for i in rotary):
        what = f"{machine.name}: the kinematics of a control can be written for a table with two rotary axes only"
        shown = " ".join(f"{machine.axes[i].name} ({machine.axes[i].side})" for i in rotary) or "none"
        raise InputError(what, expected="two rotary axes that carry the workpiece", file=machine.path, value=shown)
    first, second = sorted(rotary, key=lambda i: machine.axis_joints[i])
    return machine.axes[first], machine.axes[second]


def table_geometry(machine: Machine, errors: np.ndarray | None = None) -> TableGeometry:
    """Return the geometry of a machine with all axes at zero; raise `InputError` as `rotary_axes`.

    ``errors``: (6·frames,) constant errors of the error frames, metres and radians; None for the nominal machine.
    """
    zero, nose = np.zeros(len(machine.axes)), rest_geometry(machine).nose
    points, directions = [], []
    for axis in rotary_axes(machine):
        joint = machine.axis_joints[machine.names.index(axis.name)]
        pose = joint_in_base(machine, joint, zero, errors)
        points.append(_numbers(pose.translation) / MM - nose)
        directions.append(_numbers(pose.rotation @ joint_twist(machine.model.joints[joint])[0]))
    real, nominal = (frame_pose(machine, machine.work_frame, zero, e) for e in (errors, None))
    turned = np.array(ca.DM(real.rotation)) @ np.array(ca.DM(nominal.rotation)).T
    shift = (_numbers(real.translation) - _numbers(nominal.translation)) / MM
    return TableGeometry(np.array(points), np.array(directions), shift, rotation_vector(turned))


def _numbers(expression: Any) -> np.ndarray:
    return np.array(ca.DM(expression)).ravel()


def rotation_vector(turned: np.ndarray) -> np.ndarray:
    """Return the rotation vector (3,) of a rotation matrix by less than half a turn."""
    sine = 0.5 * np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]])
    size = float(np.linalg.norm(sine))
    angle = float(np.arctan2(size, 0.5 * (np.trace(turned) - 1.0)))
    return sine * (angle / size) if size > 0.0 else sine


def work_origin(machine: Machine) -> np.ndarray:
    """Return the origin (3,) of the nominal work frame in machine coordinates, mm."""
    pose = frame_pose(machine, machine.work_frame, np.zeros(len(machine.axes)), None)
    return _numbers(pose.translation) / MM - rest_geometry(machine).nose


@lru_cache(maxsize=16)
def _shift_function(machine: Machine) -> tuple[ca.Function, BatchFunction]:
    """Return the function (q mm and degrees, geometry (18,), tool length mm) → shift of the linear axes (3,) µm."""
    q, given, length = ca.SX.sym("q", len(machine.axes)), ca.SX.sym("geometry", 3 * PARTS), ca.SX.sym("length")
    nominal = ca.DM(table_geometry(machine).vector)
    angles = [q[machine.names.index(axis.name)] * (np.pi / 180.0) for axis in rotary_axes(machine)]
    inverse, rest = check_linear(machine), rest_geometry(machine)
    linear = ca.vertcat(*(q[i] for i in machine.linear))
    tip = ca.DM(np.linalg.inv(inverse)) @ linear + ca.DM(rest.tool) * length

    def lines(vector: Any) -> list[tuple[Any, Any]]:
        parts = ca.vertsplit(vector, 3)
        return [(point, _about(axis, angle)) for point, axis, angle in zip(parts[:2], parts[2:4], angles, strict=True)]

    (p1, first), (p2, second) = lines(ca.SX(nominal))
    piece = p2 + second.T @ (p1 + first.T @ (tip - p1) - p2)
    shift, turn = ca.vertsplit(given, 3)[4:]
    centre = ca.DM(work_origin(machine))
    placed = centre + shift + rotation_exp(turn) @ (piece - centre)
    (p1, first), (p2, second) = lines(given)
    there = p1 + first @ (p2 + second @ (placed - p2) - p1)
    function = ca.Function("shift", [q, given, length], [1e3 * (ca.DM(inverse) @ (there - tip))])
    return function, BatchFunction(function)


def _about(direction: Any, angle: Any) -> Any:
    """Return the rotation (3, 3) about a direction, of any length."""
    cross = ca.skew(direction / ca.norm_2(direction))
    return ca.SX.eye(3) + ca.sin(angle) * cross + (1.0 - ca.cos(angle)) * (cross @ cross)


def linear_shift(machine: Machine, geometry: TableGeometry, q: np.ndarray, tool_length_mm: float) -> np.ndarray:
    """Return the shifts (n, 3) of the linear axes in µm at (n, axes) commands, mm and degrees."""
    (linear_shift,) = _shift_function(machine)[1](q, geometry.vector, np.array([tool_length_mm]))
    return linear_shift


@final
@dataclass(frozen=True, eq=False)
class KinematicCorrection(Correction):
    """Shift of the commands by a transformation whose geometry differs from the nominal one; only while it is active."""

    machine: Machine
    geometry: TableGeometry
    tool_length_mm: float

    @property
    def axes(self) -> tuple[str, ...]:
        """See `Correction.axes`."""
        return tuple(self.machine.axes[i].name for i in self.machine.linear)

    def with_tool(self, tool_length_mm: float) -> KinematicCorrection:
        """See `Correction.with_tool`: a transformation uses the length of the active tool."""
        return self if tool_length_mm == self.tool_length_mm else replace(self, tool_length_mm=tool_length_mm)

    def shift(self, axis: str, positions: Mapping[str, Any]) -> Any:
        """See `Correction.shift`."""
        q, row = [positions[name] for name in self.machine.names], self.axes.index(axis)
        if any(isinstance(value, ca.SX) for value in q):
            function = _shift_function(self.machine)[0]
            return function(ca.vertcat(*q), self.geometry.vector, self.tool_length_mm)[row]
        rows = np.stack(np.broadcast_arrays(*q), axis=-1)
        shifts = linear_shift(self.machine, self.geometry, rows.reshape(-1, len(q)), self.tool_length_mm)
        return shifts[:, row].reshape(rows.shape[:-1])

    def contents(self) -> tuple[TableSummary, ...]:
        """Empty: there are no tables."""
        return ()

    def plus(self, old: KinematicCorrection) -> KinematicCorrection:
        """Return these kinematics: new ones always replace the old ones."""
        return self

    def rounded(self, axis: str) -> int:
        """See `Correction.rounded`."""
        return 2 * PARTS


SHORTEST: Final = 1e-6
"""Length below which a vector has no direction."""
Values = Mapping[str, float]
"""Values of a control's parameters, by their own names."""


class KinematicsFormat(ABC):
    """One way in which a control stores the lines of the rotary axes of its five-axis transformation.

    Attributes:
        name: name in options and calibration files.
        title: name of the control in messages.
        what: kind of file; with the next two a row of the manual's table.
        carries: description of the constants that it holds.
        leaves: description of the constants that it does not hold.
        file: name of its file.
        unchecked: assumptions that could not be checked against a public description; listed in the file and in the account.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    what: ClassVar[str]
    carries: ClassVar[str]
    leaves: ClassVar[str]
    file: ClassVar[str]
    unchecked: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def nominal(self, machine: Machine) -> Values:
        """Return the parameters of the nominal machine, which `twin.compensation.tables.axis_tables` fits.

        It raises `InputError` if the transformation cannot represent the structure of the machine.
        """

    @abstractmethod
    def geometry(self, values: Values, machine: Machine) -> TableGeometry:
        """Return the geometry that the control derives from its parameters."""

    @abstractmethod
    def write(self, values: Values, machine: Machine, notes: Sequence[str] = ()) -> str:
        """Return the text of the file; ``values``: the parameters, as `nominal`; ``notes``: texts for comments."""

    @abstractmethod
    def read(self, path: Path, machine: Machine) -> TableGeometry:
        """Return the geometry in a file; raise `InputError` if it is invalid, or the machine cannot have this transformation."""

    def values(self, path: Path, machine: Machine) -> Values:
        """Return the parameters in a file of the control by their names; `InputError` as `read`, or if the format has no such names."""
        what = f"single values of {self.title} cannot be read"
        raise InputError(what, expected="the machine file's own geometry, and the differences from it", file=path)

    def label(self, name: str, machine: Machine) -> str:
        """Return the control's own name of a parameter, as its operator finds it."""
        return name

    @abstractmethod
    def loading(self, machine: Machine) -> tuple[str, ...]:
        """Return instructions to enter and activate the parameters, one text per step."""

    def read_back(self, text: str, machine: Machine) -> TableGeometry:
        """Return the geometry of a control with this text."""
        with scratch_folder() as folder:
            (folder / self.file).write_text(text, encoding="utf-8")
            return self.read(folder / self.file, machine)


def code_lines(path: Path, comment: str) -> list[TableLine]:
    """Return the lines of a file that are not empty, without what follows a comment's mark."""
    lines = [
        TableLine(path, table_line.number, table_line.text.partition(comment)[0].strip())
        for table_line in table_lines(path)
    ]
    return [line for line in lines if line.text]


def numbers_of(path: Path, found: Mapping[str, TableLine], names: Sequence[str]) -> dict[str, float]:
    """Return the numbers of all named parameters of a file; raise `InputError` if one is missing or not a number."""
    for name in names:
        if name not in found:
            raise InputError(f"the parameter {name} is missing", expected="all parameters of the format", file=path)
    return {name: found[name].decimal(name) for name in names}


def assign(found: dict[str, TableLine], name: str, value: TableLine) -> None:
    """Add the value of a parameter; raise `InputError` if it has one already."""
    if name in found:
        raise value.error(f"{name} is assigned twice", "one assignment", value.text)
    found[name] = value
