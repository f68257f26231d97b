"""Component errors for a control with a model of the machine: the linear axes correct the functional point, to first order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final, final

import casadi as ca
import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.units import MM
from twin.compute.batch import BatchFunction
from twin.machine.chain import frame_pose, joint_in_base
from twin.machine.control.correction import Correction, TableSummary
from twin.machine.control.curve import ControlCurve
from twin.machine.error_names import DIRECTIONS
from twin.machine.machine import Axis, Machine

DIRECTION_TOLERANCE: Final = 1e-12
_SIGN: Final = {"tool": 1.0, "work": -1.0, "both": 0.0}
"""Sign of the motion of the tool relative to the workpiece, by the side that moves."""


@final
@dataclass(frozen=True)
class AxisErrors:
    """Six error motions of one axis as in a file, µm and µrad.

    Attributes:
        axis: the axis.
        curves: curves by index of the component in ``XYZABC``.
    """

    axis: str
    curves: Mapping[int, ControlCurve]


@final
@dataclass(frozen=True)
class RestGeometry:
    """Geometry of the nominal machine with all axes at zero, in its base frame, mm.

    Attributes:
        nose: (3,) origin of the tool frame.
        tool: (3,) unit vector from there to the tool tip.
        turns: (3, 3) orientation of every axis's error frame, by axis.
        places: (3,) origin of every axis's error frame, by axis.
    """

    nose: np.ndarray
    tool: np.ndarray
    turns: Mapping[str, np.ndarray]
    places: Mapping[str, np.ndarray]

    def centre(self, axis: Axis) -> np.ndarray:
        """Return the point (3,) to which an axis's errors refer: the spindle nose for a linear axis, else its own origin."""
        return self.nose if axis.linear else self.places[axis.name]


def rest_geometry(machine: Machine) -> RestGeometry:
    """Return the geometry of the nominal machine with all axes at zero."""
    pairs = _poses(machine)(np.zeros(len(machine.axes)))
    turns, places = ([np.array(part) for part in pairs[k::2]] for k in (0, 1))
    named = [axis.name for axis in machine.axes]
    places = [place.ravel() / MM for place in places]
    return RestGeometry(
        places[-1], -turns[-1][:, 2], *(dict(zip(named, part, strict=False)) for part in (turns, places))
    )


@lru_cache(maxsize=16)
def _poses(machine: Machine) -> ca.Function:
    """Return the function q (axes,), m and rad → rotation and origin (m), in the base, of all axes' error frames and the tool frame."""
    q = ca.SX.sym("q", len(machine.axes))
    joints = {frame.axis: frame.joint for frame in machine.frames if frame.role == "motion"}
    poses = [joint_in_base(machine, joints[axis.name], q, None) for axis in machine.axes]
    poses.append(frame_pose(machine, machine.tool_frame, q, None))
    return ca.Function("poses", [q], [part for pose in poses for part in pose])


@lru_cache(maxsize=16)
def check_linear(machine: Machine) -> np.ndarray:
    """Return the commands (3, 3) of the linear axes that move the tool by one unit along the axes of the base frame.

    Raises:
        InputError: there are not three linear axes, or the direction of one changes when another axis moves.
    """
    inverse = np.linalg.inv(_directions(machine, np.zeros(len(machine.axes))))
    rng = np.random.default_rng(0)
    for _ in range(3):
        there = np.array([rng.uniform(*axis.domain) for axis in machine.axes]) * machine.scale
        if np.abs(_directions(machine, there) @ inverse - np.eye(3)).max() > DIRECTION_TOLERANCE:
            raise InputError(
                f"{machine.name}: the direction of a linear axis changes when another axis moves",
                expected="linear axes that keep their direction",
                file=machine.path,
            )
    return read_only(inverse)


def _directions(machine: Machine, q: np.ndarray) -> np.ndarray:
    """Return the tool displacement (3, 3) in the base frame, one column per linear axis."""
    turns = _poses(machine)(q)[::2]
    axes = [machine.axes[i] for i in machine.linear]
    columns = [_SIGN[machine.axes[i].side] * np.array(turns[i]) @ machine.axes[i].direction for i in machine.linear]
    if len(axes) != 3 or abs(np.linalg.det(np.array(columns))) < DIRECTION_TOLERANCE:
        raise InputError(
            f"{machine.name} does not have three independent linear axes",
            expected="three linear axes, or a format with tables of single axes (linuxcnc, heidenhain, siemens)",
            file=machine.path,
        )
    return np.array(columns).T


@lru_cache(maxsize=16)
def _correction_function(machine: Machine) -> tuple[ca.Function, BatchFunction]:
    """Return the function of the linear axes' correction: (q m and rad, errors (6, axes) µm and µrad, length m) → (3,) µm.

    Errors of an axis are a shift of the point `RestGeometry.centre` that moves with it and a rotation, along the directions of the base
    frame with all axes at zero.
    """
    q, errors = ca.SX.sym("q", len(machine.axes)), ca.SX.sym("errors", 6, len(machine.axes))
    length, rest, parts = ca.SX.sym("length"), rest_geometry(machine), _poses(machine)(q)
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
class VolumetricCorrection(Correction):
    """Correction that the control calculates from component errors and the active tool.

    Attributes:
        errors: component errors of every axis, at `RestGeometry.centre`.
        machine: a machine with three linear axes.
        tool_length_mm: distance from the tool frame to the tool tip.

    Raises:
        InputError: see `check_linear`.
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

    def with_tool(self, tool_length_mm: float) -> VolumetricCorrection:
        """See `Correction.with_tool`: this control uses the length of the active tool."""
        return self if tool_length_mm == self.tool_length_mm else replace(self, tool_length_mm=tool_length_mm)

    def shift(self, axis: str, positions: Mapping[str, Any]) -> Any:
        """See `Correction.shift`."""
        machine, length = self.machine, self.tool_length_mm * MM
        q = [positions[name] * scale for name, scale in zip(machine.names, machine.scale, strict=True)]
        curves = {axis_errors.axis: axis_errors.curves for axis_errors in self.errors}
        errors = [
            curves[name][i](positions) if i in curves.get(name, {}) else 0.0 for name in machine.names for i in range(6)
        ]
        (expression, batch), row = _correction_function(machine), self.axes.index(axis)
        if any(isinstance(value, ca.SX) for value in q):
            return expression(ca.vertcat(*q), ca.reshape(ca.vertcat(*errors), 6, -1), length)[row]
        rows = np.stack(np.broadcast_arrays(*q, *errors), axis=-1)
        flat = rows.reshape(-1, rows.shape[-1])
        (found,) = batch(flat[:, : len(q)], flat[:, len(q) :], np.array([length]))
        return found[:, row].reshape(rows.shape[:-1])

    def contents(self) -> tuple[TableSummary, ...]:
        """See `Correction.contents`."""
        return tuple(
            TableSummary.over(f"E_{DIRECTIONS[i]}{axis_errors.axis}", curve.at, curve.peak, "um" if i < 3 else "urad")
            for axis_errors in self.errors
            for i, curve in axis_errors.curves.items()
        )

    def plus(self, old: VolumetricCorrection) -> VolumetricCorrection:
        """Add all components of an axis on the nodes of the curve with the most nodes; see `Correction.plus`."""
        found: list[AxisErrors] = []
        for name in self.machine.names:
            own = [
                curve
                for axis_errors in (*old.errors, *self.errors)
                if axis_errors.axis == name
                for curve in axis_errors.curves.items()
            ]
            if own:
                widest = max((curve for _, curve in own), key=lambda curve: len(curve.at))
                found.append(AxisErrors(name, _summed(own, widest)))
        return replace(self, errors=tuple(found))

    def rounded(self, axis: str) -> int:
        """See `Correction.rounded`."""
        return 6 * len(self.machine.axes)


def _summed(curves: Sequence[tuple[int, ControlCurve]], widest: ControlCurve) -> dict[int, ControlCurve]:
    """Return the sums of the curves of each component, on the nodes of ``widest``."""
    values: dict[int, np.ndarray] = {}
    for i, curve in curves:
        values[i] = values.get(i, np.zeros(len(widest.at))) + curve.along(np.array(widest.at))
    return {i: replace(widest, values=tuple(one.tolist())) for i, one in values.items()}
