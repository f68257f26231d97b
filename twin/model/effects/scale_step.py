"""Step in the position of a linear axis, at the joint of two sections of a scale or a rack, or where it is damaged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, final

import numpy as np

from twin._common.messages import Message
from twin.machine.machine import Axis, Machine
from twin.model.effects.base import AlongAxis, Frame, Payload, along
from twin.model.effects.specification import (
    EXTENDED,
    NOT_TWICE,
    Advice,
    FittedCause,
    Forms,
    SharedColumns,
    Specification,
    State,
    linear_axes,
    linear_forms,
)
from twin.numerics.functions import Functions, Rows, cached_in_state, fmax

LEAST_POSITIONS: Final = 8
"""Number of positions of an axis below which no step is sought: a curve through them explains as much."""
ON_EITHER_SIDE: Final = 2
"""Number of positions on either side of a step, at least: a single one beyond it may be an outlier."""
MOST_PLACES: Final = 200
"""Largest number of places tried on an axis."""
TRIED_TRAVEL: Final = 0.99
"""Share of the measured travel that the intervals tried make up: steps between repeated positions are not sought."""
SHARPEST_MM: Final = 1e-3
"""Smallest width of a step, mm, where a file states a smaller one."""


@final
class ScaleStep(AlongAxis):
    """Step in the position of a linear axis: E_aa += A·s, where s rises from 0 to 1 over the width of an interval about the place.

    The interval is that between two measured positions, anywhere in which the step may be.
    """

    units = (("size", "um"),)

    def __init__(self, axis: Axis, size: float, place: float, width: float) -> None:
        super().__init__("scale_step", axis)
        self.name += f"[{place:g}]"
        self.size = size
        self.place = place
        self.width = width

    @property
    def numbers(self) -> dict[str, float]:
        """Size, place and width."""
        return {**super().numbers, "place": self.place, "width": self.width}

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        width = max(self.width, SHARPEST_MM)
        share = (positions[self.axis.name] - self.place) / width + 0.5
        return (along(self.axis, fmax(share, 0.0) - fmax(share - 1.0, 0.0)),)


def _intervals(q: np.ndarray) -> np.ndarray:
    """Return the lower and upper ends (places, 2) of the intervals between measured positions in which a step is sought."""
    positions = np.unique(np.round(q, 3))
    if len(positions) < LEAST_POSITIONS:
        return np.zeros((0, 2))
    gaps = np.diff(positions)
    longest_first = np.argsort(-gaps, kind="stable")
    enough = int(np.searchsorted(np.cumsum(gaps[longest_first]), TRIED_TRAVEL * gaps.sum())) + 1
    tried = np.sort(longest_first[: min(enough, MOST_PLACES)])
    tried = tried[(tried >= ON_EITHER_SIDE - 1) & (tried <= len(gaps) - ON_EITHER_SIDE)]
    return np.stack([positions[tried], positions[tried + 1]], axis=1)


def _tried(state: State, where: str) -> np.ndarray:
    return cached_in_state(state, ("intervals", where), lambda: _intervals(state[where]))


def _candidates(machine: Machine, state: State) -> tuple[list[str], list[tuple[str, str]]]:
    return [where for where in linear_axes(machine) if len(_tried(state, where)) > 0], []


def _forms(machine: Machine, where: str, state: State, payloads: Sequence[Payload] | None) -> Forms:
    axis, q = machine.by_name[where], state[where]
    low, high = _tried(state, where).T

    def steps(rows: Rows) -> np.ndarray:
        return np.clip((q[rows][:, None] - low) / (high - low), 0.0, 1.0)

    return linear_forms(
        ScaleStep.units,
        lambda values, fixed: ScaleStep(axis, values[0], fixed["place"], fixed["width"]),
        tuple({"place": float(a + b) / 2.0, "width": float(b - a)} for a, b in zip(low, high, strict=True)),
        # The functions of all places at once.
        together=SharedColumns(
            Functions(len(q), len(low), steps),
            [(k,) for k in range(len(low))],
            Frame(where, "motion"),
            tuple(along(axis, 1.0).items()),
        ),
    )


def _evidence(fit: FittedCause) -> str:
    place, width = (fit.numbers.get(name, 0.0) for name in ("place", "width"))
    between = Message("{place:.6g} and {place2:.6g} mm", place=place - width / 2.0, place2=place + width / 2.0)
    return Message(
        "the position of {where} jumps by {measure} between {between}",
        where=fit.where,
        measure=fit.measure,
        between=between,
    )


SCALE_STEP: Final = Specification(
    name="scale_step",
    kind="machine",
    title=lambda where: Message("step in the scale or rack of {where}", where=where),
    family="steps in scales and racks",
    advice=Advice(
        "Service: the scale or rack of {axis} at that position: a joint of two sections, dirt, a damaged place, a "
        "counting error.",
        f"{EXTENDED}, and measure {{axis}} in small steps about that position.",
        "Do not correct it with a smooth curve: it would be wrong on both sides of the step. " + NOT_TWICE,
    ),
    evidence=_evidence,
    parameters=("size", "place", "width"),
    fixed={"place": "mm", "width": "mm"},
    # A joint that is off by more than 2 mm stops the pinion; 100 m is more than the travel of any machine.
    limits={"um": 2000.0, "mm": 100_000.0},
    places=linear_axes,
    make=lambda machine, where, numbers, payloads: ScaleStep(machine.by_name[where], *numbers.values()),
    forms=_forms,
    candidates=_candidates,
    curve=True,
    most=2,
    plain_forms=0,
)
