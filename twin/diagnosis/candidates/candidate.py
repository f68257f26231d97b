"""Candidate causes: an effect at one place and the variants it can take, with their signatures on the whitened readings.

A signature, in plausible sizes and before projection, is a sum of terms: the derivative of the reading by a degree of freedom (an error
component, a movement of the target in the base frame or of the point in its station's frame) times a function of the state.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final, final

import numpy as np

from twin._common.units import UM
from twin.identification.network import LinearisedReadings
from twin.machine.machine import Axis, Machine
from twin.measurement.observation import machine_state
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import Effect, Specification
from twin.model.effects.base import along
from twin.numerics.curves import CurveSpace
from twin.numerics.functions import CachingState, Functions, Rows, functions_of_state, pieces, tabulated
from twin.numerics.spatial import cross_matrix

LARGEST_ERROR: Final = 1000.0  # µm or µrad: largest plausible error due to one effect; columns are scaled to it

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
    # A shift along the axes of the base that grows with the square of the distance from the station, by square metres.
    "bend": lambda view, rows: view.base(rows) * np.sum(view.seen[rows] ** 2, axis=1)[:, None, None],
    # A scale of all lengths from the station.
    "length": lambda view, rows: view.by_seen[rows] @ view.seen[rows][:, :, None],
}


def strain_displacements(points: np.ndarray) -> np.ndarray:
    """Return the displacement (n, 3, 6) of points by unit strains: scales x, y, z, and shears xy, xz, yz (change of a right angle)."""
    strain_displacements = np.zeros((*points.shape, len(STRAINS)))
    for k, (i, j) in enumerate(STRAINS):
        share = 1.0 if i == j else 0.5
        strain_displacements[:, i, k], strain_displacements[:, j, k] = share * points[:, j], share * points[:, i]
    return strain_displacements


@final
class ReadingDerivatives:
    """Derivatives of some readings of a view by the degrees of freedom, each computed once."""

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
    """One term of a signature: a derivative times a function of the state."""

    freedom: Freedom
    functions: Functions  # of the state
    index: int  # of the function among them
    weight: float  # metres or radians for each unit of the function


@final
@dataclass(frozen=True, eq=False)
class Column:
    """One column of a signature, linear in one parameter."""

    terms: tuple[SignatureTerm, ...]  # their sum is the effect of one unit of the parameter
    scale: float  # the largest plausible value of the parameter, in its unit


def effect_columns(effect: Effect, machine: Machine, state: Mapping[str, Any]) -> list[Column]:
    """Return the columns of a machine effect, linearised at its parameters' values, one for each parameter."""
    return _of_shapes([effect], machine, state, effect.derivatives)


def unit_columns(effects: Sequence[Effect], machine: Machine, state: Mapping[str, Any]) -> list[Column]:
    """Return the column of each of some effects in one frame that is proportional to its first parameter, whose value is one.

    No derivatives are needed; the functions of all are evaluated together.
    """
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
    """Return a column from (error component, functions, index of the function, µm or µrad for each unit of it)."""
    return scaled_column(
        [SignatureTerm(("error", at), functions, k, weight * UM) for at, functions, k, weight in parts]
    )


def tabulated_column(parts: Mapping[int, np.ndarray]) -> Column:
    """Return a column from tabulated values (n,) in error components, in µm or µrad."""
    functions = tabulated(np.stack([np.asarray(values, dtype=float) for values in parts.values()], axis=1))
    return component_column([(at, functions, k, 1.0) for k, at in enumerate(parts)])


def masked_columns(
    freedoms: Sequence[Freedom], mask: np.ndarray, weight: float, scale: float = LARGEST_ERROR
) -> tuple[Column, ...]:
    """Return one column for each degree of freedom, active where a mask (n,) is set; ``weight`` metres or radians a unit."""
    function = tabulated(mask[:, None])
    return tuple(Column((SignatureTerm(freedom, function, 0, weight),), scale) for freedom in freedoms)


def scaled_column(parts: Sequence[SignatureTerm]) -> Column:
    """Return the sum of some terms, scaled so that the largest movement at any point is `LARGEST_ERROR`, µm or µrad."""
    by_freedom: dict[tuple[Freedom, Functions], list[SignatureTerm]] = {}
    for part in parts:
        by_freedom.setdefault((part.freedom, part.functions), []).append(part)
    largest = max((_largest(functions, own) for (_, functions), own in by_freedom.items()), default=0.0) / UM
    return Column(tuple(parts), float(LARGEST_ERROR / largest) if largest > 0.0 else 1.0)


def _largest(functions: Functions, parts: Sequence[SignatureTerm]) -> float:
    """Return the largest magnitude over all points of the sum of some terms of one degree of freedom."""
    if len(parts) == 1:
        return float(abs(parts[0].weight) * functions.largest[parts[0].index])
    weights = np.zeros(functions.count)
    for part in parts:
        weights[part.index] += part.weight
    return max(float(np.abs(functions.values(rows) @ weights).max()) for rows in pieces(functions.points))


Build = Callable[[np.ndarray, Mapping[str, float]], tuple[Effect, ...]]
Units = Callable[[Mapping[str, float]], tuple[Effect, ...]]
Missing = tuple[str, str, str]  # effect, place, and the column of the table that is missing
STRAIGHT_LINE: Final = np.inf  # time constant that stands for a straight line


@final
@dataclass(frozen=True)
class Variant:
    """One variant of a candidate: columns at fixed values of its non-linear parameters."""

    columns: tuple[Column, ...]
    fixed: Mapping[str, float] = field(default_factory=dict)


@final
@dataclass(frozen=True)
class Drift:
    """Columns of a drift as a function of its time constant."""

    columns: Callable[[float], tuple[Column, ...]]  # of a time constant, s; one column for each linear parameter
    constants: tuple[float, ...]  # tried, s, ascending
    straight: bool  # the usual form is a straight line; an exponential must fit significantly better
    name: str  # of the time constant among the fixed parameters of a variant

    @property
    def variants(self) -> tuple[Variant, ...]:
        """Variants: a straight line, then exponentials."""
        return tuple(self.variant(constant) for constant in (STRAIGHT_LINE, *self.constants))

    def variant(self, constant: float) -> Variant:
        """Return the variant with a time constant, s; `STRAIGHT_LINE` for a straight line."""
        return Variant(self.columns(constant), {} if constant == STRAIGHT_LINE else {self.name: constant})


@final
@dataclass(frozen=True)
class Candidate:
    """A candidate cause: one effect at one place (contract §5)."""

    specification: Specification
    where: str
    # and units of the linear parameters; a variant with fewer columns has the first of them
    names: tuple[tuple[str, str], ...]
    variants: tuple[Variant, ...]
    tests: float  # number of independent variants, for the correction for multiple testing
    build: Build | None = None  # linear and fixed parameters → effects that extend the model; None for an instrument
    units: Units | None = None  # fixed parameters → one effect for each linear parameter, of size one
    space: CurveSpace | None = None  # functions of the columns of a curve
    drift: Drift | None = None
    # linear parameters → those reported, which have the ``names``
    reported: Callable[[np.ndarray], np.ndarray] | None = None
    # what happened at its moment: at another moment it is the same event, and no alternative. Each of its n variants is one of n
    # moments, and n times less likely
    event: str = ""

    @property
    def moments(self) -> int:
        """Number of moments of its event."""
        return len(self.variants) if self.event else 1

    def is_same_event(self, other: Candidate) -> bool:
        """Return whether another is the same event at another moment."""
        return self.effect == other.effect and self.event == other.event and max(self.moments, other.moments) > 1

    @property
    def varies_in_time(self) -> bool:
        """Return whether it is a variant that changes with time of a plain effect: a growth that lags behind its sensor."""
        return bool(self.specification.variant_of) and self.specification.varies == "with time"

    def is_variant_in_time_of(self, other: Candidate) -> bool:
        """Return whether it is such a variant of another cause, at the same place."""
        plain = self.specification.variant_of, self.where
        return self.varies_in_time and plain in {other.key, (other.specification.variant_of, other.where)}

    @property
    def effect(self) -> str:
        """Name of the effect, as in contract §5."""
        return self.specification.name

    @property
    def origin(self) -> str:
        """``machine`` or ``instrument``."""
        return "instrument" if self.specification.kind == "instrument" else "machine"

    @property
    def key(self) -> tuple[str, str]:
        """Effect name and place."""
        return self.effect, self.where

    @property
    def largest(self) -> float:
        """Largest plausible magnitude of its linear parameters, in their unit."""
        return self.specification.bound([unit for _, unit in self.names])

    def range(self, name: str) -> float:
        """Return the largest value tried of a fixed parameter; infinite if there is no such parameter."""
        return max((variant.fixed[name] for variant in self.variants if name in variant.fixed), default=np.inf)


@final
@dataclass(frozen=True)
class Catalogue:
    """The candidates that these data allow to be tested, and those that lack data."""

    candidates: tuple[Candidate, ...]
    not_evaluated: tuple[Missing, ...] = ()  # those that lack data


@final
@dataclass(frozen=True)
class CandidateInputs:
    """Inputs that candidates are generated from."""

    machine: Machine
    data: Measurements
    calibration: Calibration  # the model under test

    @cached_property
    def state(self) -> Mapping[str, Any]:
        """Positions and channels of all readings."""
        return CachingState(machine_state(self.data, self.machine))
