"""Sag of a table's cradle as it swivels."""

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
    Frame,
    Payload,
    Vector,
    base_vector,
    channel,
    loads,
    loads_per_kg,
    motion_joint,
    rest_orientation,
)
from twin.model.effects.gravity_compliance import loads_of
from twin.model.effects.specification import (
    EXTENDED,
    Advice,
    Forms,
    Specification,
    State,
    rotary_axes,
    single_parameter_form,
)
from twin.numerics.functions import sin

MOMENT: Final = "moment"
"""Parameter of an entry whose tilt grows with the load on the table."""
LEAST_MOMENT: Final = 1e-6
"""N·m: smaller moments are rounding errors."""


@final
class TableLoad(Effect):
    """Sag of a cradle about the x direction of the base frame: a rotation of tilt·sin of its angle (contract §5).

    With a stated moment M the tilt is that under M, the torque of gravity about the axis at +90° (all others at zero), and grows with
    the torque m of payload and carried load on the work side in that position: tilt·(1 + m/M). Without it the tilt is constant.

    If the axis lies along base x and the centre of gravity below or above it (a trunnion A), this is the same rotation as that of
    `gravity_compliance` of the axis. For an inclined axis (B at 45°) it is not: compliance turns about the axis, the sag about base x.
    The direction and the sine are a convention; they do not follow from the moment about base x.

    Args:
        vector: x direction of the base frame in the axis's error frame.
        moment: M, N·m, negative against the axis's positive direction; None if not stated.
        added: (2,) torque at +90° by the payload, N·m, and per kg of the carried load, N·m/kg.
    """

    units = (("tilt", "urad"),)

    def __init__(
        self,
        axis: str,
        vector: Vector,
        tilt: float,
        moment: float | None = None,
        payloads: tuple[Payload, ...] = (),
        added: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.name = f"table_load:{axis}"
        self.tilt = tilt
        self.moment = moment
        self.payloads = payloads
        self.frame = Frame(axis, "motion")
        self._vector = vector
        self._added = added

    @property
    def numbers(self) -> dict[str, float]:
        """The tilt and the moment, if it is stated."""
        return super().numbers | ({} if self.moment is None else {MOMENT: self.moment})

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`; needs ``load_kg`` if a carried load acts on a stated moment."""
        wave = sin(positions[self.frame.axis] * (pi / 180.0))
        if self.moment is not None:
            constant, per_kg = self._added
            torque = constant + (per_kg * channel(positions, LOAD, self.name) if per_kg != 0.0 else 0.0)
            wave = wave * (1.0 + torque / self.moment)
        return ({3 + i: part * wave for i, part in enumerate(self._vector) if part != 0.0},)


def _make(machine: Machine, where: str, numbers: Mapping[str, float], payloads: Sequence[Payload]) -> TableLoad:
    vector = base_vector(rest_orientation(machine, motion_joint(machine, where)), "X")
    moment = numbers.get(MOMENT)
    if moment is None:
        return TableLoad(where, vector, numbers["tilt"])
    if abs(moment) < LEAST_MOMENT:
        raise InputError(f"moment of table_load {where}", expected="N·m, other than zero", value=moment)
    own = tuple(payload for payload in payloads if payload.side == "work")
    torque = _torques(machine, where)
    added = float(torque @ loads(own)) - float(torque[0]), float(torque @ loads_per_kg(own, "work"))
    return TableLoad(where, vector, numbers["tilt"], moment, own, added)


def with_payloads(machine: Machine, effects: Sequence[Effect], payloads: Sequence[Payload]) -> list[Effect]:
    """Return effects whose table loads with a stated moment carry the given payloads, as in a calibration file."""
    return [
        _make(machine, effect.frame.axis, effect.numbers, payloads)
        if isinstance(effect, TableLoad) and payloads
        else effect
        for effect in effects
    ]


def _torques(machine: Machine, where: str) -> np.ndarray:
    """Return the (9,) loads of `twin.machine.chain.gravity_load` along an axis at +90°, all others at zero."""
    positions = {name: np.array([90.0 if name == where else 0.0]) for name in machine.names}
    return np.array([float(values[0]) for values in loads_of(machine)(positions)[where]])


def _forms(machine: Machine, where: str, state: State, known: Sequence[Payload] | None) -> Forms:
    """Return the form: with the moment of the URDF's masses if the calibration has loads on the table, else with a constant tilt."""
    numbers: dict[str, float] = {}
    own = tuple(known or ())
    if any(one.side == "work" for one in own) and abs(moment := float(_torques(machine, where)[0])) > LEAST_MOMENT:
        numbers[MOMENT] = moment
    return single_parameter_form(("tilt", "urad"), lambda tilt: _make(machine, where, {"tilt": tilt, **numbers}, own))


def _candidates(machine: Machine, state: State) -> tuple[list[str], list[tuple[str, str]]]:
    """Return the rotary axes on the work side, except vertical ones: they move no weight against gravity."""
    found = []
    for axis in machine.axes:
        if not axis.linear and axis.side != "tool":
            upright = rest_orientation(machine, motion_joint(machine, axis.name)) @ np.array(axis.direction)
            if abs(float(machine.upright[2] @ upright)) < 1.0 - 1e-9:
                found.append(axis.name)
    return found, []


TABLE_LOAD: Final = Specification(
    name="table_load",
    kind="machine",
    title=lambda where: Message("table on {where} sags as {where} turns", where=where),
    family="sag of the table",
    advice=Advice(
        "Set-up: load on the table during the calibration, and load on it now. Service: bearings of {axis}.",
        f"{EXTENDED}, with this load only.",
        "Do not use that calibration with another load.",
    ),
    evidence=lambda fit: Message(
        "the cradle on {where} sags by {measure} when turned by 90°", where=fit.where, measure=fit.measure
    ),
    parameters=("tilt",),
    fixed={MOMENT: "N.m"},
    limits={"urad": 2000.0},
    places=rotary_axes,
    required=lambda names: ("tilt", MOMENT) if MOMENT in names else ("tilt",),
    make=_make,
    forms=_forms,
    candidates=_candidates,
)
