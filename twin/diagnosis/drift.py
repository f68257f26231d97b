"""Drifts of the machine and of the instrument: the same functions of time for both, so that the shape never decides between them.

A drift is a first-order exponential with a time constant within the record, or a straight line. A time constant longer than the record
cannot be distinguished from infinity.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from twin._common.units import UM
from twin.diagnosis.functions import Functions, Rows
from twin.diagnosis.signatures import LARGEST, Column, Part, of_units
from twin.machine.effects import SteadyDrift, ThermalDrift
from twin.machine.machine import Machine

TIME_CONSTANTS: Final = 36
SHORTEST: Final = 1.0 / 40.0
"""Smallest time constant that is tried, as a share of the record."""
STRAIGHT: Final = np.inf
"""Time constant of a straight line."""


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


def constants(time_s: np.ndarray) -> tuple[float, ...]:
    """Time constants that are tried: none longer than the record."""
    span = max(float(np.ptp(time_s)), 1.0)
    return tuple(np.geomspace(SHORTEST * span, span, TIME_CONSTANTS).tolist())


def of_machine(effect: ThermalDrift, machine: Machine, state: Mapping[str, Any]) -> Drift:
    """A drift of the tool side.

    Args:
        effect: along its direction, with any numbers.
        machine: the machine.
        state: of all readings, with ``time_s``.
    """

    def unit(constant: float) -> ThermalDrift | SteadyDrift:
        return effect.steady(1.0) if constant == STRAIGHT else effect.changed(1.0, constant)

    tried = constants(state["time_s"])
    # The functions of those that are tried are evaluated together.
    known = dict(zip(tried, of_units([unit(tau) for tau in tried], machine, state), strict=True))

    def columns(constant: float) -> tuple[Column, ...]:
        return (known[constant] if constant in known else of_units([unit(constant)], machine, state)[0],)

    return Drift(columns, tried, straight=False)


def of_station(time_s: np.ndarray, mask: np.ndarray) -> Drift:
    """A drift of a station along the axes of the base; a parameter is its rate at the beginning of the record, µm/h.

    Args:
        time_s: (n,) of all readings.
        mask: (n,) whether a reading is the station's.
    """
    hours = (time_s - time_s.min()) / 3600.0
    tried = constants(time_s)

    def of(several: Sequence[float]) -> list[tuple[Column, ...]]:
        tau = np.array(several) / 3600.0

        def values(rows: Rows) -> np.ndarray:
            at = np.where(mask[rows], hours[rows], 0.0)[:, None]
            bent = np.where(np.isinf(tau), 1.0, tau)
            return np.where(np.isinf(tau), at, -bent * np.expm1(-at / bent))

        functions = Functions(len(hours), len(several), values, mask)
        scale = LARGEST / np.maximum(functions.largest, 1e-9)
        return [
            tuple(Column((Part(("base", i), functions, k, -UM),), float(scale[k])) for i in range(3))
            for k in range(len(several))
        ]

    every = (STRAIGHT, *tried)
    known = dict(zip(every, of(every), strict=True))
    return Drift(lambda constant: known[constant] if constant in known else of([constant])[0], tried, straight=True)
