"""One cause at one place, the forms it can take, and what is known of the data when candidates are made."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final, final

import numpy as np

from twin.diagnosis.candidates.signatures import Column
from twin.machine.calibration import Calibration
from twin.machine.effects import Effect, Specification
from twin.machine.machine import Machine
from twin.measurement.table import Measurements, state_of
from twin.numerics.curves import CurveSpace
from twin.numerics.functions import Remembering

Build = Callable[[np.ndarray, Mapping[str, float]], tuple[Effect, ...]]
Units = Callable[[Mapping[str, float]], tuple[Effect, ...]]
Missing = tuple[str, str, str]
"""Effect, where, and what is missing."""
STRAIGHT: Final = np.inf
"""Time constant of a straight line."""


@final
@dataclass(frozen=True)
class Cell:
    """One form a candidate can take: some columns, some fixed non-linear parameters.

    Attributes:
        columns: their signatures.
        fixed: non-linear parameters by name.
    """

    columns: tuple[Column, ...]
    fixed: Mapping[str, float] = field(default_factory=dict)


@final
@dataclass(frozen=True)
class Drift:
    """What a candidate's columns are at any time constant.

    Attributes:
        columns: time constant (s; `STRAIGHT` for a straight line) → columns, one a linear parameter.
        constants: time constants that are tried, ascending.
        straight: whether a straight line is the usual form: an exponential is reported only where it fits significantly better.
    """

    columns: Callable[[float], tuple[Column, ...]]
    constants: tuple[float, ...]
    straight: bool

    @property
    def variants(self) -> tuple[Cell, ...]:
        """A straight line, and exponentials."""
        bent = (Cell(self.columns(constant), {"time_constant": constant}) for constant in self.constants)
        return (Cell(self.columns(STRAIGHT)), *bent)


@final
@dataclass(frozen=True)
class Candidate:
    """One cause at one place.

    Attributes:
        specification: of the effect.
        where: contract §5.
        names: (name, unit) of its linear parameters, the first of as many as a variant has.
        variants: the forms it can take.
        tests: how many independent ones that is, for the price of the search.
        build: linear parameters and fixed ones → the effects that extend the model; None for the instrument's.
        units: fixed parameters → one effect a linear parameter, that one being one; None where columns are not made so.
        space: the functions a curve's columns are, if it is one.
        drift: its columns at any time constant, if it is one.
    """

    specification: Specification
    where: str
    names: tuple[tuple[str, str], ...]
    variants: tuple[Cell, ...]
    tests: float
    build: Build | None = None
    units: Units | None = None
    space: CurveSpace | None = None
    drift: Drift | None = None

    @property
    def effect(self) -> str:
        """Contract §5."""
        return self.specification.name

    @property
    def origin(self) -> str:
        """``machine`` or ``instrument``."""
        return "instrument" if self.specification.kind == "instrument" else "machine"

    @property
    def key(self) -> tuple[str, str]:
        """Effect and where."""
        return self.effect, self.where

    @property
    def largest(self) -> float:
        """Magnitude its linear parameters can have on a real machine, in their unit."""
        return self.specification.bound([unit for _, unit in self.names])

    def range(self, name: str) -> float:
        """The largest value of a fixed parameter that is tried; infinite if it has none."""
        return max((variant.fixed[name] for variant in self.variants if name in variant.fixed), default=np.inf)


@final
@dataclass(frozen=True)
class Catalogue:
    """What can be tried on these data, and what cannot.

    Attributes:
        candidates: tried.
        not_evaluated: (effect, where, what is missing).
    """

    candidates: tuple[Candidate, ...]
    not_evaluated: tuple[Missing, ...] = ()


@final
@dataclass(frozen=True)
class Given:
    """What candidates are made from.

    Attributes:
        machine: the machine.
        data: the measurements.
        calibration: the model that is judged.
    """

    machine: Machine
    data: Measurements
    calibration: Calibration

    @cached_property
    def state(self) -> Mapping[str, Any]:
        """Positions and channels of all readings."""
        return Remembering(state_of(self.data, self.machine))


@final
@dataclass(frozen=True)
class CandidateSource:
    """Where candidates come from.

    Attributes:
        specifications: of the effects they are of.
        candidates: what is known → those that are tried, and what is missing for the others.
    """

    specifications: tuple[Specification, ...]
    candidates: Callable[[Given], Catalogue]
