"""Tilt of the base under an arm: the whole arm rotates about the base frame as one of its axes turns or its load changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import pi
from typing import Any, Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.messages import Message
from twin.machine.machine import Machine
from twin.model.effects.base import (
    LOAD,
    Effect,
    Parameter,
    Payload,
    channel,
    directions,
    is_carrying,
    motion_joint,
    rest_placement,
)
from twin.model.effects.specification import EXTENDED, Advice, Drawing, Forms, Specification, State, linear_forms
from twin.numerics.functions import cos, sin

TILTS: Final = ("A", "B")
"""Rotations about x and y of the base frame."""
BY_LOAD: Final = "load"
"""Name of the load that the readings carry, in a place: ``A by load``."""
LEAST_TRAVEL_DEG: Final = 60.0
"""Smallest travel over which a turn with an axis differs from a straight line and from a constant."""
TURNING: Final = ("cos", "sin")
LOADED: Final = ("coefficient",)


@final
class BaseTilt(Effect):
    """The tool side rotates about x or y of the base frame, through its origin.

    By a·cos θ + b·sin θ, µrad, with an axis at the angle θ (``A by J2``), or by c·m, µrad/kg, with the carried load m (``B by load``).
    """

    def __init__(self, machine: Machine, where: str, values: Sequence[float]) -> None:
        self.name = f"base_tilt:{where}"
        self._tilt, _, self._by = where.partition(" by ")
        self._values = tuple(values)
        side = BASE_TILT.tool_side(machine, where, "XYZ"["ABC".index(self._tilt)])
        self.frame = side.frame
        self._parts = _rotation_about_base(machine, side.frame.axis, np.array(side.vector))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Coefficients of cosine and sine, or the tilt per kilogram."""
        names, unit = (LOADED, "urad/kg") if self._by == BY_LOAD else (TURNING, "urad")
        return tuple(self._number(name, unit, value) for name, value in zip(names, self._values, strict=True))

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`."""
        tilt = sum(value * shape for value, shape in zip(self._values, self._shapes(positions), strict=True))
        return {i: part * tilt for i, part in self._parts.items()}

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`; needs ``load_kg`` if it depends on the load."""
        return tuple({i: part * shape for i, part in self._parts.items()} for shape in self._shapes(positions))

    def _shapes(self, positions: Mapping[str, Any]) -> tuple[Any, ...]:
        if self._by == BY_LOAD:
            return (channel(positions, LOAD, self.name),)
        angle = positions[self._by] * (pi / 180.0)
        return cos(angle), sin(angle)


def _rotation_about_base(machine: Machine, axis: str, direction: np.ndarray) -> dict[int, float]:
    """Return a unit rotation about a direction through the base's origin as components of the error frame nearest the base.

    The direction (3,) is given in that frame, of an axis.
    """
    rest = rest_placement(machine, motion_joint(machine, axis))
    origin = np.asarray(rest.rotation).T @ np.asarray(rest.translation)
    parts = np.concatenate([np.cross(direction, origin), direction])
    return {i: float(part) for i, part in enumerate(parts) if abs(part) > 1e-12}


def _places(machine: Machine) -> tuple[str, ...]:
    by = (BY_LOAD, *(axis.name for axis in machine.axes if not axis.linear)) if directions(machine) else ()
    return tuple(f"{tilt} by {name}" for tilt in TILTS for name in by)


def _make(machine: Machine, where: str, numbers: Mapping[str, float], payloads: Sequence[Payload]) -> BaseTilt:
    names = LOADED if where.endswith(f" by {BY_LOAD}") else TURNING
    if set(numbers) != set(names):
        raise InputError(f"parameters of base_tilt {where}", expected=", ".join(names), value=", ".join(numbers))
    return BaseTilt(machine, where, list(numbers.values()))


def _candidates(machine: Machine, state: State) -> tuple[list[str], list[tuple[str, str]]]:
    """Return the places on an arm: the base of another machine does not turn its tool side alone."""
    arm = {axis.name for axis in machine.axes if not axis.linear and axis.side == "tool"}
    carrying = is_carrying(state) and bool(np.ptp(state[LOAD]) > 0.0)
    found, missing = [], []
    for where in _places(machine) if arm else ():
        by = where.partition(" by ")[2]
        if by == BY_LOAD and not carrying:
            missing.append((where, f"readings at different {LOAD}"))
        elif by == BY_LOAD or (by in arm and np.ptp(state[by]) >= LEAST_TRAVEL_DEG):
            found.append(where)
    return found, missing


def _forms(machine: Machine, where: str, state: State, payloads: Sequence[Payload] | None) -> Forms:
    names = (("coefficient", "urad/kg"),) if where.endswith(f" by {BY_LOAD}") else (("cos", "urad"), ("sin", "urad"))
    return linear_forms(names, lambda values, fixed: BaseTilt(machine, where, values))


def _title(where: str) -> str:
    tilt, _, by = where.partition(" by ")
    direction = "xyz"["ABC".index(tilt)]
    if by == BY_LOAD:
        return Message("tilt of the base about {direction} with the load", direction=direction)
    return Message("tilt of the base about {direction} with {by}", direction=direction, by=by)


BASE_TILT: Final = Specification(
    name="base_tilt",
    kind="machine",
    title=_title,
    family="tilts of the base",
    advice=Advice(
        "Service: the bolts, pedestal and floor under the base, and its levelling.",
        f"{EXTENDED}.",
        "Do not correct it in a single joint: the whole arm tilts.",
    ),
    evidence=lambda fit: Message(
        "the whole arm tilts about its base ({where}), by {measure}", where=fit.where, measure=fit.measure
    ),
    parameters=TURNING,
    required=lambda names: LOADED if set(names) == set(LOADED) else TURNING,
    # As for an inclined axis: a base that rocks by 5 mrad is loose. 100 µrad/kg is 20 mrad under 200 kg.
    limits={"urad": 5000.0, "urad/kg": 100.0},
    places=_places,
    make=_make,
    forms=_forms,
    candidates=_candidates,
    drawing=Drawing(
        columns=lambda where: (LOAD if where.endswith(BY_LOAD) else where.partition(" by ")[2],), spread=True
    ),
)
