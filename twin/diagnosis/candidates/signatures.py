"""Signatures of candidate causes: their effect on the whitened readings, in plausible sizes, before projection.

A signature is a sum of terms: the derivative of the reading by a degree of freedom (an error component, a movement of the target in the
base frame or of the point in its station's frame) times a function of the state.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from twin._common.units import UM
from twin.identification.network import LinearisedReadings
from twin.machine.effects import Effect
from twin.machine.effects.base import along
from twin.machine.machine import Axis, Machine
from twin.numerics.functions import Functions, Rows, functions_of_state, pieces, tabulated
from twin.numerics.spatial import cross_matrix

LARGEST: Final = 1000.0
"""µm or µrad: largest plausible error anywhere due to one effect; columns are scaled to it."""

STRAINS: Final = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Components of a strain tensor by their two directions."""

Freedom = tuple[str, int]
"""A degree of freedom: what moves, and the index of the direction along or about which it moves."""

_DERIVATIVES: Final[Mapping[str, Callable[[LinearisedReadings, Rows], np.ndarray]]] = {
    # All error frames, six components each.
    "error": lambda view, rows: view.by_error[rows],
    # The target, along an axis of the base frame and about one through its origin.
    "base": lambda view, rows: view.base(rows),
    # One side of the machine, along the axes of the base frame and of its own frame.
    "tool base": lambda view, rows: view.side("tool", rows),
    "work base": lambda view, rows: view.side("work", rows),
    "tool place": lambda view, rows: view.side_frame("tool", rows),
    "work place": lambda view, rows: view.side_frame("work", rows),
    "base turn": lambda view, rows: -(view.base(rows) @ cross_matrix(view.base_points(rows))),
    # The point in its station's frame: along an axis of that frame and about one through its origin.
    "station": lambda view, rows: view.by_seen[rows],
    "station turn": lambda view, rows: -(view.by_seen[rows] @ cross_matrix(view.seen[rows])),
    # The target's place on its carrier.
    "place": lambda view, rows: view.by_place[rows],
    # A strain of the station's frame about its origin: scales x, y, z, then shears xy, xz, yz.
    "strain": lambda view, rows: view.by_seen[rows] @ strain_displacements(view.seen[rows]),
    # A scale of all lengths from the station.
    "length": lambda view, rows: view.by_seen[rows] @ view.seen[rows][:, :, None],
}


def strain_displacements(points: np.ndarray) -> np.ndarray:
    """Return the displacement (n, 3, 6) of points by unit strains: scales x, y, z, and shears xy, xz, yz (change of a right angle)."""
    found = np.zeros((*points.shape, len(STRAINS)))
    for k, (i, j) in enumerate(STRAINS):
        share = 1.0 if i == j else 0.5
        found[:, i, k], found[:, j, k] = share * points[:, j], share * points[:, i]
    return found


@final
class ReadingDerivatives:
    """Derivatives of some readings by the degrees of freedom, each computed once.

    Args:
        view: linearisation of the readings.
        rows: the readings wanted.
    """

    def __init__(self, view: LinearisedReadings, rows: Rows) -> None:
        self._view = view
        self._rows = rows
        self._cache: dict[str, np.ndarray] = {}

    def __getitem__(self, freedom: Freedom) -> np.ndarray:
        """Return the whitened derivative (rows, 3) by one degree of freedom, for each metre or radian."""
        name, direction = freedom
        return np.asarray(self.of(name)[:, :, direction])

    def of(self, name: str) -> np.ndarray:
        """Return the derivatives (rows, 3, directions) by all directions of one kind."""
        if name not in self._cache:
            self._cache[name] = _DERIVATIVES[name](self._view, self._rows)
        return self._cache[name]


@final
@dataclass(frozen=True, eq=False)
class SignatureTerm:
    """One term of a signature: a derivative times a function of the state.

    Attributes:
        freedom: degree of freedom of the derivative.
        functions: functions of the state.
        index: index of the function among them.
        weight: metres or radians for each unit of the function.
    """

    freedom: Freedom
    functions: Functions
    index: int
    weight: float


@final
@dataclass(frozen=True, eq=False)
class Column:
    """One column of a signature, linear in one parameter.

    Attributes:
        terms: their sum is the effect of one unit of the parameter.
        scale: the largest plausible value of the parameter, in its unit.
    """

    terms: tuple[SignatureTerm, ...]
    scale: float


def effect_columns(effect: Effect, machine: Machine, state: Mapping[str, Any]) -> list[Column]:
    """Return the columns of a machine effect, one for each parameter.

    Args:
        effect: the effect, linearised at its parameters' values.
        machine: the machine.
        state: positions and channels of all points.
    """
    return _of_shapes([effect], machine, state, effect.derivatives)


def unit_column(effect: Effect, machine: Machine, state: Mapping[str, Any]) -> Column:
    """Return the column of an effect that is proportional to its first parameter, whose value is one; no derivatives are needed."""
    return unit_columns([effect], machine, state)[0]


def unit_columns(effects: Sequence[Effect], machine: Machine, state: Mapping[str, Any]) -> list[Column]:
    """Return `unit_column` of several effects in one frame, whose functions are evaluated together."""
    return _of_shapes(effects, machine, state, lambda some: [effect.components(some) for effect in effects])


def _of_shapes(
    effects: Sequence[Effect],
    machine: Machine,
    state: Mapping[str, Any],
    shapes: Callable[[Mapping[str, Any]], Sequence[Mapping[int, Any]]],
) -> list[Column]:
    frame = effects[0].frame
    at = first_component(machine, frame.axis, frame.role)
    functions, each = functions_of_state(state, shapes, whole=any(effect.history for effect in effects))
    return [component_column([(at + i, functions, k, 1.0) for i, k in own]) for own in each]


def first_component(machine: Machine, axis: str, role: str = "motion") -> int:
    """Return the index of the first error component of a frame."""
    return 6 * next(i for i, one in enumerate(machine.frames) if (one.axis, one.role) == (axis, role))


def along_command(machine: Machine, axis: Axis) -> list[tuple[int, float]]:
    """Return (error component, share) of a unit motion along an axis's command."""
    at = first_component(machine, axis.name)
    return [(at + i, part) for i, part in along(axis, 1.0).items()]


def component_column(parts: Sequence[tuple[int, Functions, int, float]]) -> Column:
    """Return a column from functions of the state in error components.

    Args:
        parts: component, functions, index of the function, and µm or µrad for each unit of it.
    """
    return scaled_column(
        [SignatureTerm(("error", at), functions, k, weight * UM) for at, functions, k, weight in parts]
    )


def base_column(direction: int, functions: Functions, index: int) -> Column:
    """Return the column of a shift of the target along a direction of the base, in µm for each unit of a function."""
    return scaled_column([SignatureTerm(("base", direction), functions, index, UM)])


def tabulated_column(parts: Mapping[int, np.ndarray]) -> Column:
    """Return a column from tabulated values (n,) in error components, in µm or µrad."""
    functions = tabulated(np.stack([np.asarray(values, dtype=float) for values in parts.values()], axis=1))
    return component_column([(at, functions, k, 1.0) for k, at in enumerate(parts)])


def masked_columns(
    freedoms: Sequence[Freedom], mask: np.ndarray, weight: float, scale: float = LARGEST
) -> tuple[Column, ...]:
    """Return one column for each degree of freedom, active where a mask is set.

    Args:
        freedoms: the degrees of freedom.
        mask: (n,) the readings that are affected.
        weight: metres or radians for each unit of the parameter.
        scale: largest plausible value of the parameter.
    """
    function = tabulated(mask[:, None].astype(float))
    return tuple(Column((SignatureTerm(freedom, function, 0, weight),), scale) for freedom in freedoms)


def scaled_column(parts: Sequence[SignatureTerm]) -> Column:
    """Return the sum of some terms, scaled so that the largest movement at any point is `LARGEST`, µm or µrad."""
    by_freedom: dict[tuple[Freedom, Functions], list[SignatureTerm]] = {}
    for part in parts:
        by_freedom.setdefault((part.freedom, part.functions), []).append(part)
    largest = max((_largest(functions, own) for (_, functions), own in by_freedom.items()), default=0.0) / UM
    return Column(tuple(parts), float(LARGEST / largest) if largest > 0.0 else 1.0)


def _largest(functions: Functions, parts: Sequence[SignatureTerm]) -> float:
    """Return the largest magnitude over all points of the sum of some terms of one degree of freedom."""
    if len(parts) == 1:
        return float(abs(parts[0].weight) * functions.largest[parts[0].index])
    weights = np.zeros(functions.count)
    for part in parts:
        weights[part.index] += part.weight
    return max(float(np.abs(functions.values(rows) @ weights).max()) for rows in pieces(functions.points))
