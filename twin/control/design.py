"""How the tables of one kind of correction are worked out: one class a kind, for all formats that hold it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Generic, Literal, TypeVar, final

import numpy as np

from twin.control.request import Request
from twin.control.wanted import Wanted
from twin.machine.control import Content, Correction
from twin.machine.effects import Effect
from twin.machine.machine import Axis

C = TypeVar("C", bound=Correction)
Share = Literal["whole", "line", "no"]
URAD_A_UM: Final = 2.0
"""Tolerance of an angle for each µm of the tolerance: a µm at half a metre."""
WORTH: Final = 0.1
"""A table whose largest value is no more than this share of the tolerance is not written."""
CHECKS: Final = 997
"""Positions of every table, drawn, at which it is compared with the model."""
SEED: Final = 16907


def tolerance_of(axis: Axis, tolerance_um: float) -> float:
    """µm, or µrad of a rotary axis."""
    return tolerance_um if axis.linear else tolerance_um * URAD_A_UM


def drawn(low: float, high: float) -> np.ndarray:
    """(`CHECKS`,) positions of a table, drawn: the same for every table of that range."""
    return np.random.default_rng(SEED).uniform(low, high, CHECKS)


@final
@dataclass(frozen=True)
class Table:
    """One table as it was read back; the numbers in its own unit.

    Attributes:
        content: its nodes and its largest value.
        off: the truth is no farther from the straight lines between the nodes.
        rounding: of the written digits.
        tolerance: of the interpolation.
        back: largest distance between the table as read back and the model at positions drawn.
    """

    content: Content
    off: float
    rounding: float
    tolerance: float
    back: float

    @property
    def holds(self) -> bool:
        """Whether the text says what was meant."""
        return self.back <= self.off + self.rounding

    @property
    def fine(self) -> bool:
        """Whether its nodes are dense enough for the tolerance."""
        return self.off <= self.tolerance * (1.0 + 1e-9)

    @property
    def unmet(self) -> tuple[str, ...]:
        """What could not be met, in words."""
        name, unit = self.content.name, self.content.unit
        found = []
        if not self.holds:
            found.append(
                f"{name}: as read back {self.back:.4f} {unit} from the model, more than {self.off:.4f} + {self.rounding:.4f}"
            )
        if not self.fine:
            found.append(f"{name}: {self.off:.3f} {unit} between the nodes, more than the tolerance {self.tolerance:g}")
        return tuple(found)


@final
@dataclass(frozen=True)
class TablePlan(Generic[C]):
    """Tables as they will be written.

    Attributes:
        correction: the tables.
        compared: with what is read back of them: one table for each of the correction's `Correction.contents`, in that order.
        left_out: tables there was no room for.
    """

    correction: C
    compared: Callable[[C], tuple[Table, ...]]
    left_out: tuple[str, ...] = ()


class Design(ABC, Generic[C]):
    """How tables of one kind are worked out.

    Attributes:
        correction: the kind.
    """

    correction: type[C]

    @abstractmethod
    def plan(self, wanted: Wanted, request: Request, old: C | None) -> TablePlan[C]:
        """The tables, on the nodes of old ones where there are any.

        Raises:
            InputError: a machine that cannot have such tables; old ones that cannot be added to; a step that does not do.
        """

    @abstractmethod
    def share(self, wanted: Wanted, effect: Effect, others: Sequence[Axis], request: Request) -> tuple[Share, str]:
        """What the tables do with one error, and why where they do not take out the whole of it.

        Args:
            wanted: the machine and its errors.
            effect: the error.
            others: axes it depends on beside its own.
            request: the format, and whether two tables are multiplied.
        """


def depending(others: Sequence[Axis]) -> tuple[Share, str]:
    """The whole of an error that depends on no other axes, else what stands in one line."""
    return ("line", f"depends on {' '.join(axis.name for axis in others)} too") if others else ("whole", "")
