"""Component errors for a control that knows the machine: the linear axes move so that the tool point stays, to first order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final, final

import casadi as ca
import numpy as np

from twin._common.arrays import locked
from twin._common.errors import InputError
from twin._common.units import MM
from twin.compute.batch import BatchFunction
from twin.machine.chain import frame_pose, joint_in_base
from twin.machine.control.correction import Content, Correction
from twin.machine.control.curve import ControlCurve
from twin.machine.machine import DIRECTIONS, Axis, Machine

CONSTANT: Final = 1e-12
_SIGN: Final = {"tool": 1.0, "work": -1.0, "both": 0.0}
"""Of a motion of the tool against the work, by the side that moves."""


@final
@dataclass(frozen=True)
class AxisErrors:
    """Six error motions of one axis as a file has them, µm and µrad.

    Attributes:
        axis: the axis.
        curves: by component in ``XYZABC``.
    """

    axis: str
    curves: Mapping[int, ControlCurve]


@final
@dataclass(frozen=True)
class Rest:
    """The machine as drawn with all axes at zero, in its base frame, mm.

    Attributes:
        nose: (3,) the tool frame's place.
        tool: (3,) unit vector from there to the tip.
        turns: (3, 3) rotation of every axis's error frame, by axis.
        places: (3,) its place, by axis.
    """

    nose: np.ndarray
    tool: np.ndarray
    turns: Mapping[str, np.ndarray]
    places: Mapping[str, np.ndarray]

    def centre(self, axis: Axis) -> np.ndarray:
        """(3,) the point an axis's errors are given at: the nose for a linear axis, its own origin for a rotary one."""
        return self.nose if axis.linear else self.places[axis.name]


def at_rest(machine: Machine) -> Rest:
    """Return the machine as drawn with all axes at zero."""
    pairs = _poses(machine)(np.zeros(len(machine.axes)))
    turns, places = ([np.array(one) for one in pairs[k::2]] for k in (0, 1))
    named = [axis.name for axis in machine.axes]
    places = [place.ravel() / MM for place in places]
    return Rest(places[-1], -turns[-1][:, 2], *(dict(zip(named, part, strict=False)) for part in (turns, places)))


@lru_cache(maxsize=16)
def _poses(machine: Machine) -> ca.Function:
    """Rotation and place (m) of the error frame of every axis, then of the tool frame, in the base frame: of q (axes,) m and rad."""
    q = ca.SX.sym("q", len(machine.axes))
    joints = {frame.axis: frame.joint for frame in machine.frames if frame.role == "motion"}
    poses = [joint_in_base(machine, joints[axis.name], q, None) for axis in machine.axes]
    poses.append(frame_pose(machine, machine.tool_frame, q, None))
    return ca.Function("poses", [q], [part for pose in poses for part in pose])


@lru_cache(maxsize=16)
def check_linear(machine: Machine) -> np.ndarray:
    """Return (3, 3) the linear axes' commands that move the tool along the axes of the base frame.

    Raises:
        InputError: not three linear axes, or one whose direction changes as another axis moves.
    """
    inverse = np.linalg.inv(_directions(machine, np.zeros(len(machine.axes))))
    rng = np.random.default_rng(0)
    for _ in range(3):
        there = np.array([rng.uniform(*axis.domain) for axis in machine.axes]) * machine.scale
        if np.abs(_directions(machine, there) @ inverse - np.eye(3)).max() > CONSTANT:
            raise InputError(
                f"{machine.name}: a linear axis changes its direction as another one moves",
                expected="linear axes that keep their direction",
                file=machine.path,
            )
    return locked(inverse)


def _directions(machine: Machine, q: np.ndarray) -> np.ndarray:
    """(3, 3) tool displacement in the base frame, a column a linear axis."""
    turns = _poses(machine)(q)[::2]
    axes = [machine.axes[i] for i in machine.linear]
    columns = [_SIGN[machine.axes[i].side] * np.array(turns[i]) @ machine.axes[i].direction for i in machine.linear]
    if len(axes) != 3 or abs(np.linalg.det(np.array(columns))) < CONSTANT:
        raise InputError(
            f"{machine.name} has not three linear axes across one another",
            expected="three; linuxcnc, heidenhain and siemens have tables of single axes",
            file=machine.path,
        )
    return np.array(columns).T


@lru_cache(maxsize=16)
def _undone(machine: Machine) -> tuple[ca.Function, BatchFunction]:
    """What the linear axes do against errors of all: (q m and rad, (6, axes) µm and µrad, length m) → (3,) µm.

    Errors of an axis are a shift of the point `Rest.centre` carried along with it and a turn, along the base frame's directions with
    all axes at zero.
    """
    q, errors = ca.SX.sym("q", len(machine.axes)), ca.SX.sym("errors", 6, len(machine.axes))
    length, rest, parts = ca.SX.sym("length"), at_rest(machine), _poses(machine)(q)
    tip = parts[-1] - parts[-2][:, 2] * length
    total = ca.SX(3, 1)
    for i, axis in enumerate(machine.axes):
        turn, place = parts[2 * i : 2 * i + 2]
        back = turn @ ca.sparsify(ca.DM(rest.turns[axis.name].T))
        centre = place + back @ ca.DM((rest.centre(axis) - rest.places[axis.name]) * MM)
        shift, spin = back @ errors[:3, i], back @ errors[3:, i]
        total = total + _SIGN[axis.side] * (shift + ca.cross(spin, tip - centre))
    function = ca.Function(
        "undone", [q, errors, length], [ca.densify(-(ca.sparsify(ca.DM(check_linear(machine))) @ total))]
    )
    return function, BatchFunction(function)


@final
@dataclass(frozen=True, eq=False)
class Volumetric(Correction):
    """What the control makes of component errors, with the tool it knows.

    Attributes:
        errors: of every axis, each at `Rest.centre`.
        machine: three linear axes, and rotary ones.
        tool_length_mm: from the tool frame to the tip.

    Raises:
        InputError: as of `check_linear`.
    """

    errors: tuple[AxisErrors, ...]
    machine: Machine
    tool_length_mm: float

    def __post_init__(self) -> None:
        check_linear(self.machine)

    @property
    def axes(self) -> tuple[str, ...]:
        """See `Correction.axes`."""
        return tuple(self.machine.axes[i].name for i in self.machine.linear) if self.errors else ()

    def with_tool(self, tool_length_mm: float) -> Volumetric:
        """See `Correction.with_tool`: this control counts the active tool's length."""
        return self if tool_length_mm == self.tool_length_mm else replace(self, tool_length_mm=tool_length_mm)

    def shift(self, axis: str, positions: Mapping[str, Any]) -> Any:
        """See `Correction.shift`."""
        machine, length = self.machine, self.tool_length_mm * MM
        q = [positions[name] * scale for name, scale in zip(machine.names, machine.scale, strict=True)]
        curves = {one.axis: one.curves for one in self.errors}
        errors = [
            curves[name][i](positions) if i in curves.get(name, {}) else 0.0 for name in machine.names for i in range(6)
        ]
        (expression, batch), row = _undone(machine), self.axes.index(axis)
        if any(isinstance(one, ca.SX) for one in q):
            return expression(ca.vertcat(*q), ca.reshape(ca.vertcat(*errors), 6, -1), length)[row]
        rows = np.stack(np.broadcast_arrays(*q, *errors), axis=-1)
        flat = rows.reshape(-1, rows.shape[-1])
        (found,) = batch(flat[:, : len(q)], flat[:, len(q) :], np.array([length]))
        return found[:, row].reshape(rows.shape[:-1])

    def contents(self) -> tuple[Content, ...]:
        """See `Correction.contents`."""
        return tuple(
            Content.over(f"E_{DIRECTIONS[i]}{one.axis}", curve.at, curve.peak, "um" if i < 3 else "urad")
            for one in self.errors
            for i, curve in one.curves.items()
        )

    def plus(self, old: Volumetric) -> Volumetric:
        """All components of an axis on the nodes of the one with the most; see `Correction.plus`."""
        found: list[AxisErrors] = []
        for name in self.machine.names:
            own = [curve for one in (*old.errors, *self.errors) if one.axis == name for curve in one.curves.items()]
            if own:
                widest = max((curve for _, curve in own), key=lambda curve: len(curve.at))
                found.append(AxisErrors(name, _summed(own, widest)))
        return replace(self, errors=tuple(found))

    def rounded(self, axis: str) -> int:
        """See `Correction.rounded`."""
        return 6 * len(self.machine.axes)


def _summed(curves: Sequence[tuple[int, ControlCurve]], widest: ControlCurve) -> dict[int, ControlCurve]:
    """Curves of the same component added up, on the nodes of one of them."""
    values: dict[int, np.ndarray] = {}
    for i, curve in curves:
        values[i] = values.get(i, np.zeros(len(widest.at))) + curve.along(np.array(widest.at))
    return {i: replace(widest, values=tuple(one.tolist())) for i, one in values.items()}
