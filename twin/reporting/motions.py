"""Error motions along their axes: value, 95 % interval, both directions of approach, and compensation by the control."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.json_form import json_form
from twin.display.numbers import COVERAGE_FACTOR
from twin.kinematics.forward import Kinematics
from twin.machine.conditions import APPROACH
from twin.machine.display import combined_uncertainty
from twin.machine.effects import Effect, PitchError, unit_of
from twin.machine.error_names import DIRECTIONS
from twin.reporting.readings import curve_ranges, is_motion, sum_of_effects
from twin.reporting.words import named

FINE: Final = 361
A_PERIOD: Final = 16
"""Points per period of a periodic error."""
MOST: Final = 4001


@final
@dataclass(frozen=True)
class Motion:
    """One error motion of an axis over its range, with the other axes at mid-range.

    Attributes:
        name: ISO 230-1 name.
        words: name in words.
        axis: name of the axis.
        linear: whether the axis is linear.
        unit: ``um`` or ``urad``.
        position: (k,) mm or degrees.
        value: (k,) mean of both directions of approach.
        half: (k,) half width of the 95 % interval; NaN if unknown.
        ways: (2, k) value on approach from below and from above; None if they are equal.
        corrected: (k,) value after compensation by the control's tables; None if they do not act on it.
        order: degree, or number of harmonics, of its curve; None without a curve.
        basis: basis of its curve, or empty.
        source: source of its curve.
        added: names of effects added to its curve.
        illustrative: whether it is assumed, not measured.
    """

    name: str
    words: str
    axis: str
    linear: bool
    unit: str
    position: np.ndarray
    value: np.ndarray
    half: np.ndarray
    ways: np.ndarray | None
    corrected: np.ndarray | None
    order: int | None
    basis: str
    source: str
    added: tuple[str, ...]
    illustrative: bool

    @property
    def peak(self) -> tuple[float, float]:
        """Value of largest magnitude over both directions, and its position."""
        values = self.value[None] if self.ways is None else self.ways
        row, column = np.unravel_index(int(np.argmax(np.abs(values))), values.shape)
        return float(values[row, column]), float(self.position[column])

    @property
    def widest(self) -> float:
        """Half width of its widest 95 % interval; NaN if unknown."""
        return float(self.half.max())

    @property
    def axis_unit(self) -> str:
        """Unit of the axis position, for display."""
        return "mm" if self.linear else "°"

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        peak, at = self.peak
        below, above = (None, None) if self.ways is None else self.ways
        return json_form(
            {
                "name": self.name,
                "words": self.words,
                "axis": self.axis,
                "unit": self.unit,
                "peak": peak,
                "peak_at": at,
                "half_95_max": self.widest,
                "order": self.order,
                "basis": self.basis,
                "source": self.source,
                "added": self.added,
                "illustrative": self.illustrative,
                "position": self.position,
                "value": self.value,
                "half_95": self.half,
                "from_below": below,
                "from_above": above,
                "with_control": self.corrected,
            }
        )


def motions(kinematics: Kinematics) -> tuple[Motion, ...]:
    """Return every error motion with a value in the calibration, in the order of the machine's names.

    Args:
        kinematics: machine, errors, conditions.
    """
    return tuple(found for name in kinematics.machine.motion_names if (found := _motion(kinematics, name)) is not None)


def _motion(kinematics: Kinematics, name: str) -> Motion | None:
    machine, calibration = kinematics.machine, kinematics.calibration
    component, axis = DIRECTIONS.index(name[2]), machine.by_name[name[3:]]
    own = [e for e in calibration.effects if e not in calibration.corrections and is_motion(e, axis.name, calibration)]
    q = _positions(kinematics, axis.name, own)
    state = _state(kinematics, axis.name, q)
    parts = [effect for effect in own if component in effect.components(state)]
    if not parts:
        return None
    value = sum_of_effects(parts, state, component)
    sides = [state | {f"{APPROACH}{axis.name}": np.full(len(q), side)} for side in (1.0, -1.0)]
    ways = np.stack([sum_of_effects(parts, side, component) for side in sides])
    tables = [table for table in calibration.corrections if table.axis.name == axis.name]
    taken = sum_of_effects(tables, state, component)
    curve = calibration.curves.get(name)
    added = tuple(effect.name for effect in parts if effect.name != name)
    return Motion(
        name=name,
        words=named(name, machine),
        axis=axis.name,
        linear=axis.linear,
        unit=unit_of(name),
        position=read_only(q),
        value=read_only(value),
        half=read_only(
            COVERAGE_FACTOR * combined_uncertainty(parts, calibration.covariance, state, component, q.shape)
        ),
        ways=read_only(ways) if np.any(ways[0] != ways[1]) else None,
        corrected=read_only(value + taken) if np.any(taken) else None,
        order=None if curve is None else curve.family.order(len(curve.coefficients)),
        basis="" if curve is None else curve.basis,
        source="" if curve is None else curve.source,
        added=added,
        illustrative=curve is not None and curve.illustrative,
    )


def _positions(kinematics: Kinematics, axis: str, effects: Sequence[Effect]) -> np.ndarray:
    """Return positions over the domain of the curves, dense enough for periodic errors."""
    low, high = curve_ranges(kinematics)[kinematics.machine.names.index(axis)]
    periods = [abs(effect.period) for effect in effects if isinstance(effect, PitchError)]
    count = max([FINE, *(int((high - low) / period * A_PERIOD) + 1 for period in periods)])
    return np.linspace(low, high, min(count, MOST))


def _state(kinematics: Kinematics, axis: str, q: np.ndarray) -> dict[str, Any]:
    machine = kinematics.machine
    middle = {one.name: np.full(len(q), 0.0 if one.lower is None else sum(one.domain) / 2.0) for one in machine.axes}
    state: dict[str, Any] = middle | {axis: q} | {f"{APPROACH}{one.name}": np.zeros(len(q)) for one in machine.axes}
    return state | dict(kinematics.conditions.channels)
