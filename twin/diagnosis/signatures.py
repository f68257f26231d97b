"""What each candidate cause would do to the readings: whitened, in plausible sizes, before anything is projected out.

A machine's effect acts in error frames, so its signature is a reading's derivative by one component times a function of the state; an
instrument's effect acts on the reading itself. Both come out as (n, 3, columns).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from twin.effects import Effect
from twin.identification.network import View
from twin.machine import Machine
from twin.units import UM

LARGEST: Final = 1000.0
"""µm or µrad: how much an effect may do at most anywhere; a column is scaled to it."""


@final
@dataclass(frozen=True, eq=False)
class Column:
    """One column of a signature.

    Attributes:
        reading: view → (n, 3) whitened, a unit of the parameter.
        scale: units of the parameter that make it as large as plausible.
    """

    reading: Callable[[View], np.ndarray]
    scale: float


def of_effect(effect: Effect, machine: Machine, state: Mapping[str, Any]) -> list[Column]:
    """Columns of a machine's effect, one a parameter.

    Args:
        effect: with whatever values its non-linear parameters have.
        machine: the machine.
        state: positions and channels of all points.
    """
    at = _first_component(effect, machine)
    return [of_components({at + i: v for i, v in shape.items()}) for shape in effect.derivatives(state)]


def of_unit(effect: Effect, machine: Machine, state: Mapping[str, Any]) -> Column:
    """The column of a machine's effect that is proportional to its first parameter, which is one: cheaper than all its derivatives."""
    at = _first_component(effect, machine)
    return of_components({at + i: values for i, values in effect.components(state).items()})


def _first_component(effect: Effect, machine: Machine) -> int:
    """Index of the first error component of the frame an effect acts in."""
    frame = effect.frame
    return 6 * next(i for i, one in enumerate(machine.frames) if (one.axis, one.role) == (frame.axis, frame.role))


def of_components(parts: Mapping[int, np.ndarray]) -> Column:
    """A column from functions of the state in error components (µm or µrad a unit)."""
    fixed = {at: np.asarray(values, dtype=float) for at, values in parts.items()}
    largest = max((float(np.abs(values).max(initial=0.0)) for values in fixed.values()), default=0.0)

    def reading(view: View) -> np.ndarray:
        found = np.zeros((len(view.rows), 3))
        for at, values in fixed.items():
            found += view.by_error[:, :, at] * (values[view.rows, None] * UM)
        return found

    return Column(reading, LARGEST / largest if largest > 0.0 else 1.0)


def of_base(direction: int, values: np.ndarray) -> Column:
    """A shift of the target along a direction of the base, ``values`` µm a unit."""
    largest = float(np.abs(values).max(initial=0.0))

    def reading(view: View) -> np.ndarray:
        return view.by_base[:, :, direction] * (values[view.rows, None] * UM)

    return Column(reading, LARGEST / largest if largest > 0.0 else 1.0)
