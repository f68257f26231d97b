"""How the tables of one kind of correction are worked out: one class a kind, for all formats that hold it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Generic, Literal, TypeVar, final

import numpy as np

from twin.control.request import Request
from twin.control.wanted import Wanted
from twin.machine.control import Correction, TableFormat
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
class Check:
    """What a table is to be when it is read back, µm or µrad.

    Attributes:
        off: the truth is no farther from the straight lines between the nodes.
        rounding: of the written digits.
        tolerance: of the interpolation.
        distance: of the correction as read back from the truth at places drawn, at most.
    """

    off: float
    rounding: float
    tolerance: float
    distance: Callable[[Any], float]


@final
@dataclass(frozen=True)
class Plan(Generic[C]):
    """Tables as they will be written.

    Attributes:
        correction: the tables.
        checks: one for each of its `Correction.contents`, in that order.
        left_out: tables there was no room for.
    """

    correction: C
    checks: tuple[Check, ...]
    left_out: tuple[str, ...] = ()


@final
@dataclass(frozen=True)
class Acting:
    """One error of the calibration, as far as a format has to know it.

    Attributes:
        axis: whose error it is.
        iso_class: its class.
        others: axes it depends on beside its own.
        beyond: share of what it does to the point that no linear axis can undo (`Wanted.beyond`).
    """

    axis: Axis
    iso_class: str
    others: tuple[Axis, ...]
    beyond: Callable[[], float]


class Design(ABC, Generic[C]):
    """How tables of one kind are worked out.

    Attributes:
        correction: the kind.
    """

    correction: type[C]

    @abstractmethod
    def plan(self, wanted: Wanted, request: Request, old: C | None) -> Plan[C]:
        """The tables, on the nodes of old ones where there are any.

        Raises:
            InputError: a machine that cannot have such tables; old ones that cannot be added to; a step that does not do.
        """

    @abstractmethod
    def share(self, error: Acting, form: TableFormat[C], *, products: bool) -> tuple[Share, str]:
        """What the tables do with one error, and why where they do not take out the whole of it.

        Args:
            error: the error.
            form: the format.
            products: whether two tables are multiplied.
        """


def depending(others: Sequence[Axis]) -> tuple[Share, str]:
    """The whole of an error that depends on no other axes, else what stands in one line."""
    return ("line", f"depends on {' '.join(axis.name for axis in others)} too") if others else ("whole", "")
