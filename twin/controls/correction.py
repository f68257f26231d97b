"""Compensations that a control makes: shifts of the commanded positions as a function of these positions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, Final, Literal, Self, final

import casadi as ca
import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.units import MM, TURN
from twin.compute.along import BatchFunction
from twin.machine.chain import frame_pose, joint_in_base
from twin.machine.error_names import DIRECTIONS
from twin.machine.machine import Axis, Machine
from twin.numerics.functions import floor, fmax


@final
@dataclass(frozen=True)
class TableSummary:
    """Summary of one table of a control: its nodes (mm, degrees) and its largest value in ``unit`` (``um``, ``urad``)."""

    name: str
    low: float
    high: float
    nodes: int
    step: float
    largest: float
    unit: str

    @classmethod
    def over(cls, name: str, at: Sequence[float], largest: float, unit: str) -> TableSummary:
        """Return the summary of a table with nodes at the positions ``at``."""
        step = at[1] - at[0] if len(at) > 1 else 0.0
        return cls(name, at[0], at[-1], len(at), step, largest, unit)


MM_PER_UM: Final = 1e-3


class Correction(ABC):
    """Correction that a control adds to the commanded positions of its axes, according to its tables.

    The machine then moves to q + c(q). A table that corrects a positioning error E_XX of +5 µm has c = −5 µm; the sign in the file
    depends on the format.
    """

    machine: Machine

    @property
    @abstractmethod
    def axes(self) -> tuple[str, ...]:
        """Names of the axes it moves, in the machine's command order."""

    def with_tool(self, tool_length_mm: float) -> Correction:
        """Return the correction for another tool length: the same, unless the control uses the length of the active tool."""
        return self

    @abstractmethod
    def shift(self, axis: str, positions: Mapping[str, Any]) -> Any:
        """Return the value added to the command of one axis: µm for a linear axis, µrad for a rotary one.

        It is interpolated, and continued beyond the ends of a table, in the same way as in the control. ``positions``: commanded
        position of every axis by name, mm or degrees: arrays or CasADi (SX) expressions, of one shape; for tables that depend on the
        direction of approach also ``approach_<axis>`` (+1, −1; 0 if unknown, which gives the mean).
        """

    @abstractmethod
    def contents(self) -> tuple[TableSummary, ...]:
        """Return the summaries of all its tables."""

    @abstractmethod
    def plus(self, old: Self) -> Self:
        """Return tables with the sum of these and older corrections, on the nodes of the older ones."""

    @abstractmethod
    def rounded(self, axis: str) -> int:
        """Return the largest number of rounded values that are added in the correction of an axis."""


# --- Curves of a control's tables: values at nodes with linear interpolation, and products of such curves

Direction = Literal[-1, 0, 1]
UP: Direction = 1
BOTH: Direction = 0
DOWN: Direction = -1


@final
@dataclass(frozen=True)
class ControlCurve:
    """Values at positions of one axis, with linear interpolation and constant continuation beyond the ends.

    Attributes:
        argument: name of the axis of which it is a function.
        at: nodes, mm or degrees, increasing; at least one.
        period: period of an unlimited rotary axis, into which positions are wrapped from the first node on; None for no wrapping.
        direction: +1 or −1: applies only to that direction of approach; 0: always. If the direction of approach is unknown, both
            directions have weight one half.
    """

    argument: str
    at: tuple[float, ...]
    values: tuple[float, ...]
    period: float | None = None
    direction: Direction = 0

    def __call__(self, positions: Mapping[str, Any]) -> Any:
        """Return the value at positions of the machine; see `Correction.shift`."""
        value = self.along(positions[self.argument])
        if self.direction == 0:
            return value
        name = f"approach_{self.argument}"
        side = positions[name] if name in positions else 0.0
        return 0.5 * (1.0 + self.direction * side) * value

    def along(self, q: Any) -> Any:
        """Return the value at positions of its axis, independent of the direction of approach."""
        if self.period is not None:
            q = q - self.period * floor((q - self.at[0]) / self.period)
        if not isinstance(q, ca.SX):
            return np.interp(q, self.at, self.values)
        # Without branches: a constant and a hinge function at every node where the slope changes.
        slopes = np.diff(self.values) / np.diff(self.at)
        bends = np.diff(slopes, prepend=0.0, append=0.0) if len(slopes) else np.zeros(len(self.at))
        value: Any = ca.SX(self.values[0])
        for node, bend in zip(self.at, bends, strict=True):
            if bend != 0.0:
                value = value + float(bend) * fmax(q - node, 0.0)
        return value

    @property
    def peak(self) -> float:
        """Largest absolute value."""
        return max(abs(value) for value in self.values)

    def scaled(self, by: float) -> ControlCurve:
        """Return the curve times a number."""
        return replace(self, values=tuple(value * by for value in self.values))


def period_of(axis: Axis) -> float | None:
    """Return one turn in degrees for an unlimited axis, None for others."""
    return TURN if axis.lower is None else None


@final
@dataclass(frozen=True)
class ControlTerm:
    """One table that moves an axis, or the product of two: the first factor in µm or µrad, the others without unit."""

    axis: str
    factors: tuple[ControlCurve, ...]

    def __call__(self, positions: Mapping[str, Any]) -> Any:
        """Return the value added to the command of its axis, µm or µrad; see `Correction.shift`."""
        value = self.factors[0](positions)
        for factor in self.factors[1:]:
            value = value * factor(positions)
        return value

    @property
    def peak(self) -> float:
        """Upper bound of the absolute value, µm or µrad."""
        return float(np.prod([factor.peak for factor in self.factors]))

    @property
    def key(self) -> tuple[object, ...]:
        """Identity of the table: the axis moved, and axis and direction of every factor."""
        return (self.axis, *((curve.argument, curve.direction) for curve in self.factors))

    @property
    def name(self) -> str:
        """``Y by X``, ``X by X times Z``, ``X by X, X moving up``."""
        first = self.factors[0]
        side = {0: "", 1: f", {first.argument} moving up", -1: f", {first.argument} moving down"}[first.direction]
        return (
            f"{self.axis} by {first.argument}{''.join(f' times {other.argument}' for other in self.factors[1:])}{side}"
        )


@final
@dataclass(frozen=True, eq=False)
class TableSum(Correction):
    """Sum of tables of one axis each, and of products of such tables."""

    terms: tuple[ControlTerm, ...]
    machine: Machine

    @property
    def axes(self) -> tuple[str, ...]:
        """See `Correction.axes`."""
        moved = {term.axis for term in self.terms}
        return tuple(name for name in self.machine.names if name in moved)

    def shift(self, axis: str, positions: Mapping[str, Any]) -> Any:
        """See `Correction.shift`."""
        total: Any = 0.0
        for term in self.terms:
            if term.axis == axis:
                total = total + term(positions)
        return total

    def contents(self) -> tuple[TableSummary, ...]:
        """See `Correction.contents`."""
        units = {axis.name: "um" if axis.linear else "urad" for axis in self.machine.axes}
        return tuple(
            TableSummary.over(term.name, term.factors[0].at, term.peak, units[term.axis]) for term in self.terms
        )

    def plus(self, old: TableSum) -> TableSum:
        """Add values to a table that exists already, append other tables; see `Correction.plus`."""
        singles: dict[tuple[str, str], list[ControlTerm]] = {}
        products: list[ControlTerm] = []
        for term in (*old.terms, *self.terms):
            alike = (
                singles.setdefault((term.axis, term.factors[0].argument), []) if len(term.factors) == 1 else products
            )
            alike.append(term)
        found: list[ControlTerm] = []
        for terms in singles.values():
            curves = [term.factors[0] for term in terms]
            sides: tuple[Direction, ...] = (BOTH,) if all(curve.direction == 0 for curve in curves) else (UP, DOWN)
            for side in sides:
                values = np.sum([curve.values for curve in curves if curve.direction in (0, side)], axis=0)
                whole = replace(curves[0], values=tuple(values.tolist()), direction=side)
                found.append(ControlTerm(terms[0].axis, (whole,)))
        return TableSum((*found, *products), self.machine)

    def rounded(self, axis: str) -> int:
        """See `Correction.rounded`."""
        return sum(term.axis == axis for term in self.terms)


# --- Component errors for a control with a model of the machine: the linear axes correct the functional point, to first order

DIRECTION_TOLERANCE: Final = 1e-12
_SIGN: Final = {"tool": 1.0, "work": -1.0, "both": 0.0}
"""Sign of the motion of the tool relative to the workpiece, by the side that moves."""


@final
@dataclass(frozen=True)
class AxisErrors:
    """Six error motions of one axis as in a file, µm and µrad, by index of the component in ``XYZABC``."""

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

    It raises `InputError` if there are not three linear axes, or the direction of one changes when another axis moves.
    """
    inverse = np.linalg.inv(_directions(machine, np.zeros(len(machine.axes))))
    rng = np.random.default_rng(0)
    for _ in range(3):
        there = np.array([rng.uniform(*axis.domain) for axis in machine.axes]) * machine.scale
        if np.abs(_directions(machine, there) @ inverse - np.eye(3)).max() > DIRECTION_TOLERANCE:
            what = f"{machine.name}: the direction of a linear axis changes when another axis moves"
            raise InputError(what, expected="linear axes that keep their direction", file=machine.path)
    return read_only(inverse)


def _directions(machine: Machine, q: np.ndarray) -> np.ndarray:
    """Return the tool displacement (3, 3) in the base frame, one column per linear axis."""
    turns = _poses(machine)(q)[::2]
    axes = [machine.axes[i] for i in machine.linear]
    columns = [_SIGN[machine.axes[i].side] * np.array(turns[i]) @ machine.axes[i].direction for i in machine.linear]
    if len(axes) != 3 or abs(np.linalg.det(np.array(columns))) < DIRECTION_TOLERANCE:
        what = f"{machine.name} does not have three independent linear axes"
        expected = "three linear axes, or a format with tables of single axes (linuxcnc, heidenhain, siemens)"
        raise InputError(what, expected=expected, file=machine.path)
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
        errors: list[AxisErrors] = []
        for name in self.machine.names:
            own = [
                curve
                for axis_errors in (*old.errors, *self.errors)
                if axis_errors.axis == name
                for curve in axis_errors.curves.items()
            ]
            if own:
                widest = max((curve for _, curve in own), key=lambda curve: len(curve.at))
                errors.append(AxisErrors(name, _summed(own, widest)))
        return replace(self, errors=tuple(errors))

    def rounded(self, axis: str) -> int:
        """See `Correction.rounded`."""
        return 6 * len(self.machine.axes)


def _summed(curves: Sequence[tuple[int, ControlCurve]], widest: ControlCurve) -> dict[int, ControlCurve]:
    """Return the sums of the curves of each component, on the nodes of ``widest``."""
    values: dict[int, np.ndarray] = {}
    for i, curve in curves:
        values[i] = values.get(i, np.zeros(len(widest.at))) + curve.along(np.array(widest.at))
    return {i: replace(widest, values=tuple(one.tolist())) for i, one in values.items()}


# --- Corrections of the three linear axes at the points of a spatial grid, with trilinear interpolation

EXACT_UM: Final = 0.005
"""Largest difference between the expression of a grid and its points, far below the resolution of a machine."""


@final
@dataclass(frozen=True, eq=False)
class CorrectionGrid(Correction):
    """Corrections at the points of a spatial grid.

    Attributes:
        at: positions of each linear axis in command order, mm, increasing.
        values: (nodes of the first, of the second, of the third, 3) µm.
    """

    machine: Machine
    at: tuple[tuple[float, ...], ...]
    values: np.ndarray

    def __post_init__(self) -> None:
        read_only(self.values)

    @property
    def axes(self) -> tuple[str, ...]:
        """See `Correction.axes`: the three linear axes."""
        return tuple(self.machine.axes[i].name for i in self.machine.linear)

    def shift(self, axis: str, positions: Mapping[str, Any]) -> Any:
        """See `Correction.shift`."""
        table = self.values[..., self.axes.index(axis)]
        q = [positions[name] for name in self.axes]
        if any(isinstance(value, ca.SX) for value in q):
            return self._expression(self.axes.index(axis), q)
        q = [np.asarray(value, dtype=float) for value in np.broadcast_arrays(*q)]
        shift: Any = np.zeros(q[0].shape)
        places = [_place(nodes, one) for nodes, one in zip(self.at, q, strict=True)]
        for corner in np.ndindex(2, 2, 2):
            weight: Any = 1.0
            index = []
            for (start, part), far in zip(places, corner, strict=True):
                weight = weight * (part if far else 1.0 - part)
                index.append(start + far)
            shift = shift + weight * table[tuple(index)]
        return shift

    def contents(self) -> tuple[TableSummary, ...]:
        """See `Correction.contents`."""
        peaks = np.abs(self.values).max(axis=(0, 1, 2))
        return tuple(
            TableSummary.over(f"d{name} over the box", nodes, float(peak), "um")
            for name, nodes, peak in zip(self.axes, self.at, peaks, strict=True)
        )

    def plus(self, old: CorrectionGrid) -> CorrectionGrid:
        """Add the values at the same nodes; see `Correction.plus`."""
        return replace(self, values=old.values + self.values)

    def rounded(self, axis: str) -> int:
        """See `Correction.rounded`."""
        return 1

    def _expression(self, output: int, q: Sequence[Any]) -> Any:
        """Return the same correction within `EXACT_UM` as a sum of products of curves of one axis each."""
        cores, shapes = self._products
        factors = [
            [ControlCurve(name, nodes, tuple(column)).along(one) for column in shape.T.tolist()]
            for name, nodes, shape, one in zip(self.axes, self.at, shapes, q, strict=True)
        ]
        total: Any = 0.0
        for i, first in enumerate(factors[0]):
            middle: Any = 0.0
            for j, second in enumerate(factors[1]):
                inner: Any = 0.0
                for k, third in enumerate(factors[2]):
                    inner = inner + third * float(cores[i, j, k, output])
                middle = middle + second * inner
            total = total + first * middle
        return total

    @cached_property
    def _products(self) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """Tucker decomposition of the grid: cores (r, s, t, 3), and for every axis a matrix with one column per curve.

        The correction of a machine consists of a few curves times straight lines: some ten products replace all points of the grid.
        Between the points both are weighted means of their values at the points, so that the tolerance holds everywhere.
        """
        spectra = []
        for i in range(3):
            flat = np.moveaxis(self.values, i, 0).reshape(len(self.at[i]), -1)
            u, s, _ = np.linalg.svd(flat, full_matrices=False)
            spectra.append((u, s))
        limit = 1.0
        while True:
            shapes = tuple(u[:, : max(1, int(np.sum(s > limit)))] for u, s in spectra)
            cores = np.einsum("xyzo,xi,yj,zk->ijko", self.values, *shapes, optimize=True)
            again = np.einsum("ijko,xi,yj,zk->xyzo", cores, *shapes, optimize=True)
            if np.abs(again - self.values).max() <= EXACT_UM or limit < 1e-12:
                return cores, shapes
            limit *= 0.5


def _place(nodes: tuple[float, ...], q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the index of the node before, and the position between it and the next, from 0 to 1."""
    at = np.array(nodes)
    inside = np.clip(q, at[0], at[-1])
    start = np.clip(np.searchsorted(at, inside, side="right") - 1, 0, len(at) - 2)
    return start, (inside - at[start]) / (at[start + 1] - at[start])


# --- Corrections that are linear in the positions of the linear axes: skew and scale of a firmware ---


@final
@dataclass(frozen=True, eq=False)
class MatrixCorrection(Correction):
    """Correction c = M q of the linear axes: skew and scale settings, zero at the zero of the machine.

    Attributes:
        matrix: (n, n) in mm per mm, rows and columns by the linear axes in command order.
        scale: by axis, the entry of `matrix` on the diagonal that the format cannot hold; for instructions only.
    """

    machine: Machine
    matrix: np.ndarray
    scale: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        read_only(self.matrix)

    @property
    def linear(self) -> tuple[str, ...]:
        """Names of the linear axes."""
        return tuple(self.machine.axes[i].name for i in self.machine.linear)

    @property
    def axes(self) -> tuple[str, ...]:
        """See `Correction.axes`."""
        return tuple(name for name, row in zip(self.linear, self.matrix, strict=True) if row.any())

    def shift(self, axis: str, positions: Mapping[str, Any]) -> Any:
        """See `Correction.shift`."""
        row = self.matrix[self.linear.index(axis)]
        total: Any = 0.0
        for name, value in zip(self.linear, row.tolist(), strict=True):
            if value != 0.0:
                total = total + positions[name] * (value / MM_PER_UM)
        return total

    @property
    def entries(self) -> tuple[tuple[str, str, float], ...]:
        """Entries of the matrix that are not zero: the axis moved, the axis it depends on, the value."""
        return tuple(
            (moved, by, float(self.matrix[i, j]))
            for i, moved in enumerate(self.linear)
            for j, by in enumerate(self.linear)
            if self.matrix[i, j] != 0.0
        )

    def contents(self) -> tuple[TableSummary, ...]:
        """See `Correction.contents`."""
        found = []
        for moved, by, value in self.entries:
            at = self.machine.by_name[by].domain
            found.append(TableSummary.over(f"{moved} by {by}", at, abs(value) * max(map(abs, at)) / MM_PER_UM, "um"))
        return tuple(found)

    def plus(self, old: MatrixCorrection) -> MatrixCorrection:
        """Add the entries; see `Correction.plus`."""
        return replace(self, matrix=old.matrix + self.matrix)

    def rounded(self, axis: str) -> int:
        """See `Correction.rounded`."""
        return int(np.count_nonzero(self.matrix[self.linear.index(axis)]))
