"""Computation of tables: one subclass of `Design` for each kind of correction, shared by all formats of that kind."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Final, Generic, Literal, TypeVar, final

import numpy as np

from twin.control.request import Request
from twin.control.required import RequiredCorrections
from twin.display.numbers import COVERAGE_FACTOR
from twin.machine.control import Correction, TableSummary
from twin.machine.effects import Effect
from twin.machine.machine import Axis

C = TypeVar("C", bound=Correction)
Share = Literal["whole", "line", "no"]
URAD_PER_UM: Final = 2.0
"""Angular tolerance in µrad per µm of tolerance: 1 µm at half a metre."""
NEGLIGIBLE_SHARE: Final = 0.1
"""Tables with a largest value up to this share of the tolerance are not written."""
CHECKS: Final = 997
"""Number of random positions at which every table is compared with the model."""
SEED: Final = 16907
U_EVERY: Final = 8
"""U of a table is evaluated at every eighth of these positions: it varies slowly."""


def tolerance_of(axis: Axis, tolerance_um: float) -> float:
    """Return the tolerance of an axis: µm, or µrad for a rotary axis."""
    return tolerance_um if axis.linear else tolerance_um * URAD_PER_UM


def check_positions(low: float, high: float) -> np.ndarray:
    """Return (`CHECKS`,) random positions of a table, the same for every table of that range."""
    return np.random.default_rng(SEED).uniform(low, high, CHECKS)


@final
@dataclass(frozen=True)
class Table:
    """One table compared with the model; all numbers in the table's unit.

    Attributes:
        content: nodes and largest value.
        deviation: largest deviation of the model from the interpolation between nodes.
        rounding: rounding error of the written digits.
        tolerance: tolerance of the interpolation.
        read_back_deviation: largest deviation of the table read back from the model, at random positions.
    """

    content: TableSummary
    deviation: float
    rounding: float
    tolerance: float
    read_back_deviation: float

    @property
    def holds(self) -> bool:
        """Whether the file read back agrees with the model within interpolation and rounding."""
        return self.read_back_deviation <= self.deviation + self.rounding

    @property
    def within_tolerance(self) -> bool:
        """Whether the interpolation error is within the tolerance."""
        return self.deviation <= self.tolerance * (1.0 + 1e-9)

    @property
    def unmet(self) -> tuple[str, ...]:
        """Requirements that are not met, one sentence each."""
        name, unit = self.content.name, self.content.unit
        found = []
        if not self.holds:
            found.append(
                f"{name}: read back, it deviates from the model by {self.read_back_deviation:.4f} {unit}, "
                f"more than {self.deviation:.4f} + {self.rounding:.4f}"
            )
        if not self.within_tolerance:
            found.append(
                f"{name}: deviation between nodes {self.deviation:.3f} {unit}, more than the tolerance {self.tolerance:g}"
            )
        return tuple(found)


@final
@dataclass(frozen=True)
class Unproven:
    """A table that is not shown to be an improvement: U of its correction exceeds the correction (RMS over the table).

    A machine without that error would get such a table in 95 % of cases. Below U, the table may increase the error.

    Attributes:
        name: name of the table.
        axes: axes whose errors it corrects.
        unit: ``um`` or ``urad``.
        rms: RMS of the correction over the table.
        u_rms: RMS of its U (95 %) over the table.
        not_identified: errors in the correction that the calibration could not determine; if none, it is known to be small.
    """

    name: str
    axes: tuple[str, ...]
    unit: str
    rms: float
    u_rms: float
    not_identified: tuple[str, ...]

    @property
    def text(self) -> str:
        """Name and numbers, without a sentence's end."""
        why = f"; not identified: {' '.join(self.not_identified)}" if self.not_identified else ""
        return f"{self.name}: correction {self.rms:.2f} {self.unit}, its U {self.u_rms:.2f} {self.unit} (RMS){why}"


@final
class ProofOfTables:
    """Comparison of the corrections of tables with their uncertainty.

    Args:
        required: the required corrections.
        keep_all: whether unproven tables are kept.

    Attributes:
        unproven: the tables that are not shown to be an improvement, so far.
    """

    def __init__(self, required: RequiredCorrections, *, keep_all: bool) -> None:
        self._required, self._keep_all = required, keep_all
        self.unproven: list[Unproven] = []

    def keeps(
        self,
        content: TableSummary,
        axes: Sequence[str],
        classes: Collection[str],
        values: np.ndarray,
        factor: np.ndarray,
    ) -> bool:
        """Return whether a table is to be written; an unproven one is noted.

        Without a covariance U is unknown and nothing is refused; a warning says so.

        Args:
            content: name and unit of the table.
            axes: axes whose errors it corrects.
            classes: classes of these errors.
            values: (n,) the correction at positions of the table.
            factor: (m, r) factor of its covariance at some of them.
        """
        rms = float(np.sqrt(np.mean(np.square(values))))
        u_rms = COVERAGE_FACTOR * float(np.sqrt(np.mean(np.sum(np.square(factor), axis=1))))
        if u_rms <= rms:
            return True
        unknown = self._required.not_identified(axes, classes)
        self.unproven.append(Unproven(content.name, tuple(axes), content.unit, rms, u_rms, unknown))
        return self._keep_all


@final
@dataclass(frozen=True)
class TablePlan(Generic[C]):
    """Tables to be written.

    Attributes:
        correction: the tables.
        compared: function that compares them with the files read back: one `Table` for each of `Correction.contents`, in that order.
        left_out: tables left out because the control has too few.
        unproven: tables that are not shown to be an improvement; they are not written unless the request says so.
    """

    correction: C
    compared: Callable[[C], tuple[Table, ...]]
    left_out: tuple[str, ...] = ()
    unproven: tuple[Unproven, ...] = ()


class Design(ABC, Generic[C]):
    """Computation of the tables of one kind of correction.

    Attributes:
        correction: the kind.
    """

    correction: type[C]

    @abstractmethod
    def plan(self, required: RequiredCorrections, request: Request, old: C | None) -> TablePlan[C]:
        """Return the tables; on the nodes of the old ones if there are any.

        Raises:
            InputError: the machine cannot have such tables, the new ones cannot be added to the old ones, or the step is unusable.
        """

    @abstractmethod
    def share(
        self, required: RequiredCorrections, effect: Effect, others: Sequence[Axis], request: Request
    ) -> tuple[Share, str]:
        """Return which share of one error the tables correct, and the reason if it is not the whole.

        Args:
            required: the required corrections.
            effect: the error.
            others: axes it depends on, except its own.
            request: the format, and whether two tables are multiplied.
        """


def share_depending_on(others: Sequence[Axis]) -> tuple[Share, str]:
    """Return ``whole`` for an error that depends on no other axes, else ``line`` and the reason."""
    return ("line", f"also depends on {' '.join(axis.name for axis in others)}") if others else ("whole", "")
