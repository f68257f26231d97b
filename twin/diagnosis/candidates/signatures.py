"""What each candidate cause would do to the readings: whitened, in plausible sizes, before anything is projected out.

A signature is a sum of products: the derivative of the reading by something that can move (an error component, the target in the base
frame, the point in its station's frame) times a function of the state.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from twin._common.units import UM
from twin.identification.network import View
from twin.machine.effects import Effect
from twin.machine.effects.base import along
from twin.machine.machine import Axis, Machine
from twin.numerics.functions import Functions, Rows, given, of_state, pieces
from twin.numerics.spatial import cross_matrix

LARGEST: Final = 1000.0
"""µm or µrad: how much an effect may do at most anywhere; a column is scaled to it."""

STRAINS: Final = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Components of a strain, by the two directions each is of."""

Field = tuple[str, int]
"""What moves, and along or about which of its directions."""

_FIELDS: Final[Mapping[str, Callable[[View, Rows], np.ndarray]]] = {
    # Of every error frame, six components each.
    "error": lambda view, rows: view.by_error[rows],
    # The target, along an axis of the base frame and about one through its origin.
    "base": lambda view, rows: view.by_base[rows],
    "base turn": lambda view, rows: -(view.by_base[rows] @ cross_matrix(view.points[rows])),
    # The point in its station's frame, likewise.
    "station": lambda view, rows: view.by_seen[rows],
    "station turn": lambda view, rows: -(view.by_seen[rows] @ cross_matrix(view.seen[rows])),
    # The target on its carrier.
    "place": lambda view, rows: view.by_place[rows],
    # The point in its station's frame, by a strain of that frame about its origin: x, y, z, then the right angles xy, xz, yz.
    "strain": lambda view, rows: view.by_seen[rows] @ strained(view.seen[rows]),
    # All lengths from the station.
    "length": lambda view, rows: view.by_seen[rows] @ view.seen[rows][:, :, None],
}


def strained(points: np.ndarray) -> np.ndarray:
    """(n, 3, 6) displacement of points by a symmetric strain: of x, y, z, and half each change of a right angle, xy, xz, yz."""
    found = np.zeros((*points.shape, len(STRAINS)))
    for k, (i, j) in enumerate(STRAINS):
        share = 1.0 if i == j else 0.5
        found[:, i, k], found[:, j, k] = share * points[:, j], share * points[:, i]
    return found


@final
class ReadingDerivatives:
    """Derivatives of some readings, each worked out once.

    Args:
        view: of all readings.
        rows: some of them.
    """

    def __init__(self, view: View, rows: Rows) -> None:
        self._view = view
        self._rows = rows
        self._found: dict[str, np.ndarray] = {}

    def __getitem__(self, field: Field) -> np.ndarray:
        """(rows, 3) whitened, a metre or radian of it."""
        name, direction = field
        return np.asarray(self.of(name)[:, :, direction])

    def of(self, name: str) -> np.ndarray:
        """(rows, 3, directions) all of one kind."""
        if name not in self._found:
            self._found[name] = _FIELDS[name](self._view, self._rows)
        return self._found[name]


@final
@dataclass(frozen=True, eq=False)
class SignatureTerm:
    """One product of a signature.

    Attributes:
        field: what moves.
        functions: of the state.
        index: of the function among them.
        weight: metres or radians a unit of it.
    """

    field: Field
    functions: Functions
    index: int
    weight: float


@final
@dataclass(frozen=True, eq=False)
class Column:
    """One column of a signature.

    Attributes:
        parts: which add up, a unit of the parameter.
        scale: units of the parameter that make it as large as plausible.
    """

    parts: tuple[SignatureTerm, ...]
    scale: float


def of_effect(effect: Effect, machine: Machine, state: Mapping[str, Any]) -> list[Column]:
    """Columns of a machine's effect, one a parameter.

    Args:
        effect: with whatever values its non-linear parameters have.
        machine: the machine.
        state: positions and channels of all points.
    """
    return _of_shapes([effect], machine, state, effect.derivatives)


def of_unit(effect: Effect, machine: Machine, state: Mapping[str, Any]) -> Column:
    """The column of a machine's effect that is proportional to its first parameter, which is one: cheaper than all its derivatives."""
    return of_units([effect], machine, state)[0]


def of_units(effects: Sequence[Effect], machine: Machine, state: Mapping[str, Any]) -> list[Column]:
    """The same of several effects in one frame, whose functions are worked out together."""
    return _of_shapes(effects, machine, state, lambda some: [effect.components(some) for effect in effects])


def _of_shapes(
    effects: Sequence[Effect],
    machine: Machine,
    state: Mapping[str, Any],
    shapes: Callable[[Mapping[str, Any]], Sequence[Mapping[int, Any]]],
) -> list[Column]:
    frame = effects[0].frame
    at = first_component(machine, frame.axis, frame.role)
    functions, each = of_state(state, shapes, whole=any(effect.history for effect in effects))
    return [of_components([(at + i, functions, k, 1.0) for i, k in own]) for own in each]


def first_component(machine: Machine, axis: str, role: str = "motion") -> int:
    """Index of the first error component of a frame."""
    return 6 * next(i for i, one in enumerate(machine.frames) if (one.axis, one.role) == (axis, role))


def along_command(machine: Machine, axis: Axis) -> list[tuple[int, float]]:
    """The error components of a motion along an axis's command, and the share of it in each."""
    at = first_component(machine, axis.name)
    return [(at + i, part) for i, part in along(axis, 1.0).items()]


def of_components(parts: Sequence[tuple[int, Functions, int, float]]) -> Column:
    """A column from functions of the state in error components.

    Args:
        parts: component, functions, which of them, and µm or µrad a unit of it.
    """
    return scaled_to([SignatureTerm(("error", at), functions, k, weight * UM) for at, functions, k, weight in parts])


def of_base(direction: int, functions: Functions, index: int) -> Column:
    """A shift of the target along a direction of the base, µm a unit of a function."""
    return scaled_to([SignatureTerm(("base", direction), functions, index, UM)])


def of_values(parts: Mapping[int, np.ndarray]) -> Column:
    """A column from (n,) values in error components, µm or µrad a unit."""
    functions = given(np.stack([np.asarray(values, dtype=float) for values in parts.values()], axis=1))
    return of_components([(at, functions, k, 1.0) for k, at in enumerate(parts)])


def reading(fields: Sequence[Field], mask: np.ndarray, weight: float, scale: float = LARGEST) -> tuple[Column, ...]:
    """One column a field, moved by ``weight`` wherever a (n,) mask is set.

    Args:
        fields: what moves.
        mask: of the readings.
        weight: metres or radians a unit of it.
        scale: units that make a column as large as plausible.
    """
    function = given(mask[:, None].astype(float))
    return tuple(Column((SignatureTerm(field, function, 0, weight),), scale) for field in fields)


def scaled_to(parts: Sequence[SignatureTerm]) -> Column:
    """Scaled so that what moves most moves by `LARGEST`, µm or µrad, where it does so most."""
    alike: dict[tuple[Field, Functions], list[SignatureTerm]] = {}
    for part in parts:
        alike.setdefault((part.field, part.functions), []).append(part)
    largest = max((_largest(functions, own) for (_, functions), own in alike.items()), default=0.0) / UM
    return Column(tuple(parts), float(LARGEST / largest) if largest > 0.0 else 1.0)


def _largest(functions: Functions, parts: Sequence[SignatureTerm]) -> float:
    """Of the sum of some parts that move the same."""
    if len(parts) == 1:
        return float(abs(parts[0].weight) * functions.largest[parts[0].index])
    weights = np.zeros(functions.count)
    for part in parts:
        weights[part.index] += part.weight
    return max(float(np.abs(functions.values(rows) @ weights).max()) for rows in pieces(functions.points))
