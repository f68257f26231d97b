"""Harmonics of the error motions of a rotary axis, and the functions of table columns of which empirical effects are sums (`Waves`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import pi
from typing import Any, Final, Literal, final

import numpy as np

from twin._common.messages import Message
from twin._common.units import TURN
from twin.machine.error_names import DIRECTIONS
from twin.machine.machine import Machine
from twin.model.effects.base import Effect, Frame, Parameter, Payload, direction_of, split_name, unit_of
from twin.model.effects.specification import (
    EXTENDED,
    Advice,
    Drawing,
    Forms,
    SharedColumns,
    Specification,
    State,
    linear_forms,
)
from twin.numerics.functions import Functions, cached_in_state, cos, floor, highest_order, sin, waves

MAX_ORDER: Final = 30
"""Highest order tried for an error motion."""
MAX_ANGLE_ORDER: Final = 200
"""Highest order tried for the axis's own angle error (gears, encoders), if the measured positions separate it from lower orders."""
MIN_ANGLES: Final = 4
"""Minimum number of angles for any harmonic to be tried."""


@final
class Harmonic(Effect):
    """One harmonic of an error motion of a rotary axis, such as ``E_XB``: a·cos(nθ) + b·sin(nθ), µm or µrad."""

    linear = 2

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

    unit = unit_of(where)
    columns = [(teeth + n - 1, n - 1) for n in tried]
    return linear_forms(
        (("cos", unit), ("sin", unit)),
        lambda values, fixed: Harmonic(where, round(fixed["order"]), *values),
        tuple({"order": float(n)} for n in tried),
        together=SharedColumns(functions, columns, Frame(name, "motion"), ((component, 1.0),)),
    )


def _title(where: str) -> str:
    component, _, axis = split_name(where)
    if component < 3:
        return Message(
            "shift of {axis} along {direction} that repeats with its rotation", axis=axis, direction=direction_of(where)
        )
    if DIRECTIONS[component] == axis:
        return Message("angle error of {axis} that repeats with its rotation", axis=axis)
    return Message(
        "wobble of {axis} about {direction} that repeats with its rotation", axis=axis, direction=direction_of(where)
    )


HARMONIC: Final = Specification(
    name="harmonic",
    kind="machine",
    title=_title,
    family="errors that repeat with the rotation",
    advice=Advice(
        "Service: parts that rotate with {axis}: bearing and encoder (once per turn), worm or gear teeth (many times "
        "per turn).",
        f"{EXTENDED}, or identify the errors again with this error motion included (twin identify).",
        "Do not check {axis} in steps of this period or a multiple of it: the error would not show.",
    ),
    evidence=lambda fit: Message("the error repeats with the rotation of the axis"),
    parameters=("order", "cos", "sin"),
    fixed={"order": "1"},
    # As for the location of the axis: an eccentric or inclined part is the largest harmonic, once per turn.
    limits={"um": 20_000.0, "urad": 20_000.0},
    places=_places,
    expected=lambda machine: "an error motion of a rotary axis",
    make=_make,
    forms=_forms,
    candidates=_candidates,
    curve=True,
    plain_forms=6,
    drawing=Drawing(period=lambda numbers: 360.0 / numbers.get("order", 1.0)),
)

# --- Smooth functions of the columns of a table, of which empirical effects and patterns of unknown cause are sums

ROUNDING: Final = 1e-6
"""Tolerance for leaving a range, as a fraction of it."""
Kind = Literal["half_waves", "whole_turns", "direction"]


@final
@dataclass(frozen=True)
class Waves:
    """Smooth functions of one column of a table, without the constant.

    ``half_waves`` of a column x over a range: cos(k π (x − low)/(high − low)), k = 1 … order; ``whole_turns`` of a rotary axis at the
    angle θ: cos(k θ) and sin(k θ); ``direction``: the direction of approach of an axis, +1 or −1. Two columns have the functions of
    each and all their products. With a direction, each function contains the direction.
    """

    column: str  # its name in the table (``X_mm``, ``T_bed_degC``, ``approach_X``)
    kind: Kind
    order: int  # highest k; one for a direction
    # lowest and highest value measured, mm, degrees or °C; None where the functions need none
    range: tuple[float, float] | None = None
    # whether the axis has unlimited rotation, so that whole turns are first subtracted from its position
    wrapped: bool = False

    @property
    def half_waves(self) -> tuple[int, ...]:
        """Number of half waves of each function; one for a direction."""
        orders = range(1, self.order + 1)
        return tuple(2 * k for k in orders for _ in range(2)) if self.kind == "whole_turns" else tuple(orders)

    @property
    def labels(self) -> tuple[str, ...]:
        """Name of each function in a calibration file."""
        if self.kind == "whole_turns":
            return tuple(f"{part}{k}" for k in range(1, self.order + 1) for part in "cs")
        return tuple(str(k) for k in range(1, self.order + 1))

    def up_to(self, half_waves: int) -> Waves:
        """Return the same column with only the functions of at most ``half_waves`` half waves."""
        most = half_waves // 2 if self.kind == "whole_turns" else half_waves
        return replace(self, order=min(self.order, most))

    def values(self, x: Any) -> list[Any]:
        """Return the functions at values ``x`` of the column: arrays or CasADi expressions."""
        if self.kind == "direction":
            return [x]
        orders = range(1, self.order + 1)
        if self.kind == "whole_turns":
            return [f(k * (x * (pi / 180.0))) for k in orders for f in (cos, sin)]
        share = self.share(x)
        return [cos(k * pi * share) for k in orders]

    def share(self, x: Any) -> Any:
        """Return the position of values in the range, 0 to 1 inside; only for half waves."""
        if self.range is None:
            raise ValueError(f"{self.column} has no range")
        low, high = self.range
        if self.wrapped:
            first = 0.5 * (low + high - TURN)
            x = x - TURN * floor((x - first) / TURN)
        return (x - low) / (high - low)

    def outside(self, x: Any) -> Any:
        """Return whether values leave the range by more than rounding; False if there is no range."""
        if self.range is None:
            return x != x
        share = self.share(x)
        return (share < -ROUNDING) | (share > 1.0 + ROUNDING)


def terms(columns: Sequence[Waves]) -> list[tuple[int, ...]]:
    """Return every function of one or two columns, as the number of each column's function from 1; 0 for the constant."""
    first = range(1, len(columns[0].half_waves) + 1)
    if len(columns) == 1:
        return [(i,) for i in first]
    second = range(1, len(columns[1].half_waves) + 1)
    if columns[0].kind == "direction":
        return [(i, j) for i in first for j in (0, *second)]
    return [*((i, 0) for i in first), *((0, j) for j in second), *((i, j) for i in first for j in second)]


def label(columns: Sequence[Waves], term: Sequence[int]) -> str:
    """Return the name of a function in a calibration file: ``3``, ``3,1``, ``c2,0``."""
    return ",".join("0" if i == 0 else own.labels[i - 1] for own, i in zip(columns, term, strict=True))
