"""Share of a change of the readings that known effects can explain, computed by the truth machine to first order in their size.

A pattern outside the catalogue must not be explained mostly by a known effect, because then that effect would be a right answer.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre

from tests.scored_cases.plan import Plan, TruthAxis
from tests.truth.any_chain import rotations
from tests.truth.any_machine import TruthMachine, absorbed
from tests.truth.hidden import STATIONS, Hidden

Key = tuple[str, str]
DEGREES = 8
ORDERS = 30
WAVES = 60
"""Largest number of periods over an axis's travel."""
TIME_CONSTANTS = 12
SMALL = 1e-7
"""Smallest share of a column's sum of squares outside the set-up's column space, relative to rounding."""


def shares(machine: TruthMachine, plan: Plan, change: np.ndarray) -> dict[Key, float]:
    """Return the largest share of a change's noncentrality λ that each effect can explain, over all forms of the effect.

    Args:
        machine: the machine.
        plan: the measurement plan.
        change: (n, 3) change of the readings, mm.
    """
    wanted = machine.left_over(plan, change)
    found: dict[Key, float] = {}
    for key, directions in _directions(machine, plan):
        share = float(np.sum((directions.T @ wanted) ** 2) / (wanted @ wanted))
        found[key] = max(found.get(key, 0.0), share)
    return found


def largest(machine: TruthMachine, plan: Plan, change: np.ndarray) -> tuple[Key, float]:
    """Return the effect with the largest of the `shares`, and that share."""
    found = shares(machine, plan, change)
    best = max(found, key=lambda key: found[key])
    return best, found[best]


@lru_cache(maxsize=1)
def _directions(machine: TruthMachine, plan: Plan) -> tuple[tuple[Key, np.ndarray], ...]:
    """Return (3n, k) orthonormal bases of the readings of each form of each effect, orthogonal to the set-up."""
    setup = absorbed(machine, plan)
    found = []
    for key, columns in _columns(machine, plan):
        flat = columns.reshape(3 * len(plan), -1)
        length = np.linalg.norm(flat, axis=0)
        flat = flat[:, length > 0.0] / length[length > 0.0]
        left = flat - setup @ (setup.T @ flat)
        values, vectors = np.linalg.eigh(left.T @ left)
        # Columns that the set-up absorbs leave rounding errors.
        kept = values > SMALL
        if kept.any():
            found.append((key, left @ (vectors[:, kept] / np.sqrt(values[kept]))))
    return tuple(found)


class _Unit:
    """Effect of unit errors on the readings of a plan."""

    def __init__(self, machine: TruthMachine, plan: Plan) -> None:
        self.machine = machine
        self.plan = plan
        self.seen = machine.readings(plan)
        self.into = rotations(np.array([STATIONS[name][1] for name in plan.station])).transpose(0, 2, 1)

    def change(self, effect: str, where: str, **numbers: float) -> np.ndarray:
        """Return (n, 3) the change of the readings by an effect."""
        return self.machine.readings(self.plan, [Hidden(effect, where, numbers)]) - self.seen

    def shift(self, vectors: np.ndarray) -> np.ndarray:
        """Return (n, 3) the change of the readings by a shift, (n, 3) or (3,), of the targets in the base."""
        return np.einsum("nij,nj->ni", self.into, np.broadcast_to(vectors, self.seen.shape))


def _times(change: np.ndarray, functions: np.ndarray) -> np.ndarray:
    """Return (n, 3, k) a change (n, 3) multiplied by functions (n, k) or (n,) of the row."""
    return change[:, :, None] * functions.reshape(len(change), 1, -1)


def _columns(machine: TruthMachine, plan: Plan) -> Iterator[tuple[Key, np.ndarray]]:
    """Yield (n, 3, k) changes of the readings for every form of every effect."""
    unit = _Unit(machine, plan)
    for axis in machine.axes:
        offset = unit.change("zero_offset", axis.name, offset=1.0)
        yield ("zero_offset", axis.name), offset[:, :, None]
        yield ("reversal", axis.name), _times(offset, plan.approach_of(axis.name))
        yield from _linear(unit, axis) if axis.linear else _rotary(unit, axis)
    yield from _slow(unit)
    yield from _instrument(unit)


def _linear(unit: _Unit, axis: TruthAxis) -> Iterator[tuple[Key, np.ndarray]]:
    machine, plan = unit.machine, unit.plan
    q = plan.at(axis.name)
    u = (2.0 * q - axis.low - axis.high) / (axis.high - axis.low)
    curves, own = legendre.legvander(u, DEGREES), int(np.argmax(np.abs(machine.direction(axis.name))))
    for i, letter in enumerate("XYZABC"):
        where = f"E_{letter}{axis.name}"
        kind = "angular_error_motion" if i > 2 else "positioning" if i == own else "straightness"
        change = unit.change(kind, where, c0=1.0)
        yield (kind, where), _times(change, curves)
        for by in machine.axes:
            if by.linear and by is not axis:
                yield ("cross_axis", f"{where} by {by.name}"), _times(change, plan.at(by.name) * (q if i < 3 else 1.0))
        if i == own:
            for wave in np.arange(1.0, WAVES + 0.5, 0.5):
                angle = 2.0 * np.pi * wave * q / (axis.high - axis.low)
                yield ("pitch_error", axis.name), _times(change, np.stack([np.sin(angle), np.cos(angle)], axis=1))
            if axis.name in plan.warm:
                yield ("thermal_expansion", axis.name), _times(change, q * (plan.warm[axis.name] - 20.0))


def _rotary(unit: _Unit, axis: TruthAxis) -> Iterator[tuple[Key, np.ndarray]]:
    angle = np.radians(unit.plan.at(axis.name))
    for letter in "XYZABC":
        where = f"E_{letter}{axis.name}"
        change = unit.change("harmonic", where, order=0.0, cos=1.0, sin=0.0)
        yield ("axis_location", f"E_{letter}0{axis.name}"), change[:, :, None]
        for order in range(1, ORDERS + 1):
            waves = np.stack([np.cos(order * angle), np.sin(order * angle)], axis=1)
            yield ("harmonic", where), _times(change, waves)


def _slow(unit: _Unit) -> Iterator[tuple[Key, np.ndarray]]:
    plan, span = unit.plan, float(np.ptp(unit.plan.time_s))
    for letter, direction in zip("XYZ", np.eye(3), strict=True):
        change = unit.shift(direction) * (plan.carrier == "tool")[:, None]
        for sensor, warm in plan.warm.items():
            yield ("thermal_growth", f"{letter} by {sensor}"), _times(change, warm - 20.0)
        for constant in np.geomspace(span / 40.0, 3.0 * span, TIME_CONSTANTS):
            yield ("thermal_drift", letter), _times(change, 1.0 - np.exp(-plan.time_s / constant))


def _instrument(unit: _Unit) -> Iterator[tuple[Key, np.ndarray]]:
    plan, seen = unit.plan, unit.seen
    shifts = [np.broadcast_to(one, seen.shape) for one in np.eye(3)]
    frame = np.stack([*shifts, *(np.cross(one, seen) for one in np.eye(3))], axis=2)
    place = np.stack([unit.shift(unit.machine.carried(plan, one)) for one in np.eye(3)], axis=2)
    for name in list(dict.fromkeys(plan.round.tolist()))[1:]:
        later = plan.round.astype(int) >= int(name)
        yield ("frame_shift", f"round {name}"), frame * later[:, None, None]
        for target in np.unique(plan.target):
            yield (
                ("target_shift", f"{target} from round {name}"),
                place * (later & (plan.target == target))[:, None, None],
            )
    for station in np.unique(plan.station):
        drifting = plan.time_s * (plan.station == station)
        yield ("station_drift", str(station)), frame[:, :, :3] * drifting[:, None, None]
    yield ("refraction_scale", "—"), seen[:, :, None]
