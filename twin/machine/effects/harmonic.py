"""Harmonics of the error motions of a rotary axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import pi
from typing import Any, Final, final

import numpy as np

from twin.machine.effects.base import Effect, Frame, Parameter
from twin.machine.effects.names import direction_of, split_name, unit_of
from twin.machine.effects.payload import Payload
from twin.machine.effects.specification import EXTENDED, Advice, Drawing, Forms, SharedColumns, Specification, State
from twin.machine.error_names import DIRECTIONS
from twin.machine.machine import Machine
from twin.numerics.elementary import cos, sin
from twin.numerics.functions import Functions, cached_in_state
from twin.numerics.waves import highest_order, waves

MAX_ORDER: Final = 30
"""Highest order tried for an error motion."""
MAX_ANGLE_ORDER: Final = 200
"""Highest order tried for the axis's own angle error (gears, encoders), if the measured positions separate it from lower orders."""
MIN_ANGLES: Final = 4
"""Minimum number of angles for any harmonic to be tried."""


@final
class Harmonic(Effect):
    """One harmonic of an error motion of a rotary axis: a·cos(nθ) + b·sin(nθ).

    Args:
        name: the error motion, ``E_XB``.
        order: n.
        cosine: a, µm or µrad.
        sine: b, µm or µrad.
    """

    def __init__(self, name: str, order: int, cosine: float, sine: float) -> None:
        self.name = f"harmonic:{name}[{order}]"
        self.order = order
        self.cosine = cosine
        self.sine = sine
        self._unit = unit_of(name)
        self._component, _, self._axis = split_name(name)
        self.frame = Frame(self._axis, "motion")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Coefficients of cosine and sine."""
        return self._number("cos", self._unit, self.cosine), self._number("sin", self._unit, self.sine)

    @property
    def numbers(self) -> dict[str, float]:
        """Order and coefficients."""
        return {"order": self.order, **super().numbers}

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`."""
        angle = positions[self._axis] * (self.order * pi / 180.0)
        return {self._component: self.cosine * cos(angle) + self.sine * sin(angle)}

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        angle = positions[self._axis] * (self.order * pi / 180.0)
        return ({self._component: cos(angle)}, {self._component: sin(angle)})


def _places(machine: Machine) -> tuple[str, ...]:
    return tuple(name for name in machine.motion_names if not machine.by_name[name[3:]].linear)


def _make(machine: Machine, where: str, numbers: Mapping[str, float], payloads: Sequence[Payload]) -> Harmonic:
    return Harmonic(where, round(numbers["order"]), numbers["cos"], numbers["sin"])


def _angles(state: State, axis: str) -> np.ndarray:
    return np.unique(np.round(np.mod(state[axis], 360.0), 3))


def _candidates(machine: Machine, state: State) -> tuple[list[str], list[tuple[str, str]]]:
    return [where for where in _places(machine) if len(_angles(state, where[3:])) >= MIN_ANGLES], []


def _turns(state: State, name: str) -> tuple[int, int, Functions]:
    """Return the highest order tried for any error motion, that for the axis's own angle, and their functions."""
    distinct = _angles(state, name)
    most = min(MAX_ORDER, (len(distinct) - 1) // 2 if len(distinct) < 2 * MAX_ORDER else MAX_ORDER)
    teeth = max(highest_order(distinct, MAX_ANGLE_ORDER), most)
    return most, teeth, waves(np.radians(state[name]), 1.0, 1.0, teeth)


def _forms(machine: Machine, where: str, state: State, payloads: Sequence[Payload] | None) -> Forms:
    component, _, name = split_name(where)
    axis = machine.by_name[name]
    # The six error motions of an axis share these functions.
    most, teeth, functions = cached_in_state(state, ("turns", name), lambda: _turns(state, name))
    tried = range(1, (teeth if component == 3 + int(np.argmax(np.abs(axis.direction))) else most) + 1)

    def build(values: np.ndarray, fixed: Mapping[str, float]) -> tuple[Harmonic, ...]:
        return (Harmonic(where, round(fixed["order"]), float(values[0]), float(values[1])),)

    def units(fixed: Mapping[str, float]) -> tuple[Harmonic, ...]:
        order = round(fixed["order"])
        return Harmonic(where, order, 1.0, 0.0), Harmonic(where, order, 0.0, 1.0)

    unit = unit_of(where)
    columns = [(teeth + n - 1, n - 1) for n in tried]
    return Forms(
        (("cos", unit), ("sin", unit)),
        build,
        units,
        tuple({"order": float(n)} for n in tried),
        together=SharedColumns(functions, columns, Frame(name, "motion"), ((component, 1.0),)),
    )


def _title(where: str) -> str:
    component, _, axis = split_name(where)
    if component < 3:
        return f"shift of {axis} along {direction_of(where)} that repeats with its rotation"
    if DIRECTIONS[component] == axis:
        return f"angle error of {axis} that repeats with its rotation"
    return f"wobble of {axis} about {direction_of(where)} that repeats with its rotation"


HARMONIC: Final = Specification(
    name="harmonic",
    kind="machine",
    title=_title,
    family="errors that repeat with the rotation",
    advice=Advice(
        "Service: parts that rotate with {axis}: bearing and encoder (once per turn), worm or gear teeth (many times per turn).",
        f"{EXTENDED}, or identify the errors again with this error motion included (twin identify).",
        "Do not check {axis} in steps of this period or a multiple of it: the error would not show.",
    ),
    evidence=lambda fit: f"{fit.where}: the error repeats with the rotation of the axis",
    parameters=("order", "cos", "sin"),
    places=_places,
    expected=lambda machine: "an error motion of a rotary axis",
    make=_make,
    forms=_forms,
    candidates=_candidates,
    curve=True,
    plain_forms=6,
    drawing=Drawing(period=lambda numbers: 360.0 / numbers.get("order", 1.0)),
)
