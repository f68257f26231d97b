"""Sag of a table's cradle as it swivels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import pi
from typing import Any, Final, final

import numpy as np

from twin.machine.effects import places
from twin.machine.effects.base import Effect, Frame, Parameter, Vector, base_vector, motion_joint, rest_orientation
from twin.machine.effects.payload import Payload
from twin.machine.effects.specification import EXTENDED, Advice, Specification, State
from twin.machine.machine import Machine
from twin.numerics.elementary import sin


@final
class TableLoad(Effect):
    """Sag of a cradle about the x direction of the base frame: a rotation of tilt·sin of its angle (contract §5).

    Args:
        axis: name of the rotary axis.
        vector: x direction of the base frame in its error frame.
        tilt: µrad at 90°.
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


def _make(machine: Machine, where: str, numbers: Mapping[str, float], payloads: Sequence[Payload]) -> TableLoad:
    return TableLoad(where, base_vector(rest_orientation(machine, motion_joint(machine, where)), "X"), numbers["tilt"])


def _candidates(machine: Machine, state: State) -> tuple[list[str], list[tuple[str, str]]]:
    """Return the rotary axes on the work side, except vertical ones: they move no weight against gravity."""
    found = []
    for axis in machine.axes:
        if not axis.linear and axis.side != "tool":
            upright = rest_orientation(machine, motion_joint(machine, axis.name)) @ np.array(axis.direction)
            if abs(float(upright[2])) < 1.0 - 1e-9:
                found.append(axis.name)
    return found, []


TABLE_LOAD: Final = Specification(
    name="table_load",
    kind="machine",
    title=lambda where: f"table on {where} sags as {where} turns",
    family="sag of the table",
    advice=Advice(
        "Set-up: load on the table during the calibration, and load on it now. Service: bearings of {axis}.",
        f"{EXTENDED}, with this load only.",
        "Do not use that calibration with another load.",
    ),
    evidence=lambda fit: f"the cradle on {fit.where} sags by {fit.measure} when turned by 90°",
    parameters=("tilt",),
    limits={"urad": 2000.0},
    places=places.rotary,
    make=_make,
    candidates=_candidates,
)
