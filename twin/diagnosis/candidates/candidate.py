"""Candidate causes: an effect at one place and the variants it can take."""

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
from twin.measurement.state import machine_state
from twin.measurement.table import Measurements
from twin.numerics.curves import CurveSpace
from twin.numerics.functions import CachingState

Build = Callable[[np.ndarray, Mapping[str, float]], tuple[Effect, ...]]
Units = Callable[[Mapping[str, float]], tuple[Effect, ...]]
Missing = tuple[str, str, str]
"""Effect, place, and the column of the table that is missing."""
STRAIGHT: Final = np.inf
"""Time constant that stands for a straight line."""


@final
@dataclass(frozen=True)
class Variant:
    """One variant of a candidate: columns at fixed values of its non-linear parameters.

    Attributes:
        columns: columns of its signature.
        fixed: non-linear parameters by name.
    """

    columns: tuple[Column, ...]
    fixed: Mapping[str, float] = field(default_factory=dict)


@final
@dataclass(frozen=True)
class Drift:
    """Columns of a drift as a function of its time constant.

    Attributes:
        columns: function from time constant (s; `STRAIGHT` for a straight line) to columns, one for each linear parameter.
        constants: time constants tried, s, ascending.
        straight: whether a straight line is the usual form: an exponential is reported only where it fits significantly better.
    """

    columns: Callable[[float], tuple[Column, ...]]
    constants: tuple[float, ...]
    straight: bool

    @property
    def variants(self) -> tuple[Variant, ...]:
        """Variants: a straight line, then exponentials."""
        bent = (Variant(self.columns(constant), {"time_constant": constant}) for constant in self.constants)
        return (Variant(self.columns(STRAIGHT)), *bent)


@final
@dataclass(frozen=True)
class Candidate:
    """A candidate cause: one effect at one place.

    Attributes:
        specification: the effect.
        where: the place, as in contract §5.
        names: (name, unit) of its linear parameters; a variant with fewer columns has the first of them.
        variants: the forms it can take.
        tests: number of independent variants, for the correction for multiple testing.
        build: function from linear and fixed parameters to the effects that extend the model; None for instrument effects.
        units: function from fixed parameters to one effect for each linear parameter, with that parameter equal to one; None where
            the columns are not made from effects.
        space: functions of the columns, if the candidate is a curve.
        drift: columns at any time constant, if it is a drift.
        reported: linear parameters → the parameters reported, if they are others; ``names`` are those of the latter.
    """

    specification: Specification
    where: str
    names: tuple[tuple[str, str], ...]
    variants: tuple[Variant, ...]
    tests: float
    build: Build | None = None
    units: Units | None = None
    space: CurveSpace | None = None
    drift: Drift | None = None
    reported: Callable[[np.ndarray], np.ndarray] | None = None

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
    """The candidates that these data allow to be tested, and those that lack data.

    Attributes:
        candidates: the candidates to test.
        not_evaluated: (effect, place, missing column) of the others.
    """

    candidates: tuple[Candidate, ...]
    not_evaluated: tuple[Missing, ...] = ()


@final
@dataclass(frozen=True)
class CandidateInputs:
    """Inputs that candidates are generated from.

    Attributes:
        machine: the machine.
        data: the measurements.
        calibration: the model under test.
    """

    machine: Machine
    data: Measurements
    calibration: Calibration

    @cached_property
    def state(self) -> Mapping[str, Any]:
        """Positions and channels of all readings."""
        return CachingState(machine_state(self.data, self.machine))


@final
@dataclass(frozen=True)
class CandidateSource:
    """A generator of candidates.

    Attributes:
        specifications: the effects it generates.
        candidates: function from the inputs to the candidates, and those for which data are missing.
    """

    specifications: tuple[Specification, ...]
    candidates: Callable[[CandidateInputs], Catalogue]
