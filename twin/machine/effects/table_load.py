"""A tilted cradle that droops as it turns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import pi
from typing import Any, Final, final

import numpy as np

from twin.machine.effects import places
from twin.machine.effects.base import Effect, Frame, Parameter, Vector, at_rest, base_vector, motion_joint
from twin.machine.effects.payload import Payload
from twin.machine.effects.specification import EXTENDED, Advice, Specification, State
from twin.machine.machine import Machine
from twin.numerics.elementary import sin


@final
class TableLoad(Effect):
    """A tilted cradle droops about the base's x as it turns: a rotation of tilt·sin of its angle (contract §5).

    Args:
        axis: name of the rotary axis.
        vector: the base's x in its error frame.
        tilt: µrad.
    """

    def __init__(self, axis: str, vector: Vector, tilt: float) -> None:
        self.name = f"table_load:{axis}"
        self.tilt = tilt
        self.frame = Frame(axis, "motion")
        self._vector = vector

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The tilt."""
        return (self._number("tilt", "urad", self.tilt),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        wave = sin(positions[self.frame.axis] * (pi / 180.0))
        return ({3 + i: part * wave for i, part in enumerate(self._vector) if part != 0.0},)


def _made(machine: Machine, where: str, numbers: Mapping[str, float], payloads: Sequence[Payload]) -> TableLoad:
    return TableLoad(where, base_vector(at_rest(machine, motion_joint(machine, where)), "X"), numbers["tilt"])


def _candidates(machine: Machine, state: State) -> tuple[list[str], list[tuple[str, str]]]:
    """Of the axes that carry the work those that do not stand upright: such a one turns nothing against gravity."""
    found = []
    for axis in machine.axes:
        if not axis.linear and axis.side != "tool":
            upright = at_rest(machine, motion_joint(machine, axis.name)) @ np.array(axis.direction)
            if abs(float(upright[2])) < 1.0 - 1e-9:
                found.append(axis.name)
    return found, []


TABLE_LOAD: Final = Specification(
    name="table_load",
    kind="machine",
    title=lambda where: f"table on {where} droops as {where} turns",
    family="droop of the table",
    advice=Advice(
        "Set-up: what lay on the table when the calibration was made, and what lies there now. Service: bearings of {axis}.",
        f"{EXTENDED}, for this load.",
        "Do not use it for another load.",
    ),
    evidence=lambda of: f"the cradle on {of.where} droops by {of.measure} when turned",
    parameters=("tilt",),
    largest={"urad": 2000.0},
    places=places.rotary,
    make=_made,
    candidates=_candidates,
)
