"""Reversal: the position of an axis depends on the direction of approach, by a constant or along the travel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, final

import numpy as np

from twin._common.messages import Message
from twin.machine.machine import Axis, Machine
from twin.model.effects.base import AlongAxis, Frame, Parameter, Payload, along, channel
from twin.model.effects.specification import (
    EXTENDED,
    NOT_TWICE,
    Advice,
    Drawing,
    FittedCause,
    Forms,
    SharedColumns,
    Specification,
    State,
    all_axes,
    approach_column,
)
from twin.numerics.curves import POWER, CurveSpace
from twin.numerics.functions import Functions, Rows


@final
class Reversal(AlongAxis):
    """Backlash: E_aa += ± size/2, by the direction of approach.

    The size is the actual position approached in the + direction minus that approached in the − direction, along the command.
    """

    def __init__(self, axis: Axis, size: float) -> None:
        super().__init__("reversal", axis)
        self.size = size
        self.units = (("size", self.unit),)

    @property
    def reversal_value(self) -> float:
        """See `Effect.reversal_value`."""
        return self.size

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`; needs ``approach_<axis>``."""
        return (along(self.axis, 0.5 * channel(positions, f"approach_{self.axis.name}", self.name)),)


REVERSAL: Final = Specification(
    name="reversal",
    kind="machine",
    title=lambda where: Message("backlash of {where}", where=where),
    family="backlash",
    advice=Advice(
        "Service: screw nut and preload of {axis} (rotary axis: worm or gear), thrust bearing, coupling, mounting of "
        "the scale.",
        f"{EXTENDED}: it takes the direction of approach of {{axis}} into account. Or enter the value as backlash in the control.",
        f"{NOT_TWICE} Do not shift the zero of {{axis}}: that moves the error but does not reduce it.",
    ),
    evidence=lambda fit: Message(
        "{where} has {size:.3g} {unit} of backlash: its position depends on the direction of approach",
        where=fit.where,
        size=abs(fit.size),
        unit=fit.unit,
    ),
    parameters=("size",),
    limits={"um": 1000.0, "urad": 5000.0},
    places=all_axes,
    channels=approach_column,
    make=lambda machine, where, numbers, payloads: Reversal(machine.by_name[where], numbers["size"]),
    drawing=Drawing(split=lambda where: f"approach_{where}", depends_on=approach_column),
)

MAX_DEGREE: Final = 4
"""Highest degree of polynomial tried."""
SAMPLES: Final = 201
"""Number of positions at which the extremes of a curve are searched."""


@final
class ReversalCurve(AlongAxis):
    """Backlash that varies along the travel: the curve measured in the + direction minus that in the − direction, Σ c_k u^k.

    u = (2q − lo − hi)/(hi − lo) over the range of the axis, which must be limited; c_k in µm or µrad, along the command.
    """

    def __init__(self, axis: Axis, coefficients: tuple[float, ...]) -> None:
        super().__init__("reversal_curve", axis)
        self.coefficients = coefficients

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The coefficients."""
        return tuple(self._number(f"c{k}", self.unit, value) for k, value in enumerate(self.coefficients))

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`; needs ``approach_<axis>``."""
        side = 0.5 * channel(positions, f"approach_{self.axis.name}", self.name)
        return along(self.axis, side * POWER.value(positions[self.axis.name], self.axis.domain, self.coefficients))

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        side = 0.5 * channel(positions, f"approach_{self.axis.name}", self.name)
        functions = POWER.functions(positions[self.axis.name], self.axis.domain, len(self.coefficients))
        return tuple(along(self.axis, side * function) for function in functions)

    @property
    def reversal_value(self) -> float:
        """See `Effect.reversal_value`: the effect itself gives the error at each position."""
        return max(self.reversal_range(), key=abs)

    def reversal_range(self) -> tuple[float, float]:
        """Return the smallest and largest reversal value over the axis's range, µm or µrad."""
        q = np.linspace(*self.axis.domain, SAMPLES)
        sizes = np.broadcast_to(POWER.value(q, self.axis.domain, self.coefficients), SAMPLES)
        return float(sizes.min()), float(sizes.max())


def _limited(machine: Machine) -> tuple[str, ...]:
    return tuple(axis.name for axis in machine.axes if axis.lower is not None and axis.upper is not None)


def _candidates(machine: Machine, state: State) -> tuple[list[str], list[tuple[str, str]]]:
    return [where for where in _limited(machine) if _degrees(state, where) >= 1], []


def _degrees(state: State, where: str) -> int:
    """Return the highest degree tried: a curve through every position would not predict any held-out position."""
    side = state.get(f"approach_{where}")
    if side is None:
        return 0
    places = [np.unique(np.round(state[where][side == sign], 3)) for sign in (1.0, -1.0)]
    return min(MAX_DEGREE, min(len(positions) for positions in places) - 2)


def _forms(machine: Machine, where: str, state: State, payloads: Sequence[Payload] | None) -> Forms:
    """Return the forms: half the direction of approach times orthonormal functions of the position, of degree 1 and higher."""
    axis, side, q = machine.by_name[where], state[f"approach_{where}"], state[where]
    space = CurveSpace(REVERSAL_CURVE.name, POWER, axis.domain, 0, _degrees(state, where) + 1)

    def values(rows: Rows) -> np.ndarray:
        return np.asarray(0.5 * side[rows, None] * space.functions(np.clip(q[rows], *axis.domain)))

    def build(values: np.ndarray, fixed: Mapping[str, float]) -> tuple[ReversalCurve, ...]:
        n = len(values)
        return (ReversalCurve(axis, tuple(float(v) for v in space.transform[:n, :n] @ values)),)

    columns = [tuple(range(degree + 1)) for degree in range(1, space.count)]
    functions = Functions(len(q), space.count, values)
    together = SharedColumns(functions, columns, Frame(where, "motion"), tuple(along(axis, 1.0).items()))
    names = tuple((f"g{k}", "um" if axis.linear else "urad") for k in range(space.count))
    trials: tuple[Mapping[str, float], ...] = tuple({} for _ in columns)
    return Forms(names, build, None, trials, together=together, space=space)


def _evidence(fit: FittedCause) -> str:
    effect = fit.effects[0] if fit.effects else None
    if not isinstance(effect, ReversalCurve):
        return ""
    low, high = effect.reversal_range()
    return Message(
        "the backlash of {where} varies along its travel, from {low:.3g} {unit} to {high:.3g} {unit}",
        where=fit.where,
        low=low,
        unit=fit.unit,
        high=high,
    )


REVERSAL_CURVE: Final = replace(
    REVERSAL,
    name="reversal_curve",
    title=lambda where: Message("backlash of {where} that varies along its travel", where=where),
    family="backlash that varies along the travel",
    advice=Advice(
        "Service: wear of the screw and nut of {axis} where it is used most, tension of the screw, friction of the "
        "guideway.",
        f"{EXTENDED}: it takes direction of approach and position of {{axis}} into account.",
        f"{NOT_TWICE} Do not enter a single backlash value in the control: it would be right at one position only.",
    ),
    evidence=_evidence,
    parameters=("c0", "c1"),
    required=lambda names: tuple(f"c{k}" for k in range(len(names) or 2)),
    places=_limited,
    expected=lambda machine: "an axis with a limited range",
    make=lambda machine, where, numbers, payloads: ReversalCurve(machine.by_name[where], tuple(numbers.values())),
    forms=_forms,
    candidates=_candidates,
    curve=True,
    variant_of="reversal",
    drawing=Drawing(split=lambda where: f"approach_{where}", depends_on=lambda where: (f"approach_{where}", where)),
)
