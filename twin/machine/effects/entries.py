"""Effects beside the named error motions, as a calibration file has them: ``effects:`` entries to and from `Effect`.

    effects:
      - {effect: reversal, where: Y, parameters: {size: 5.1}}

Names, places and parameters are those of the contract's table (§5), and stand in each effect's specification. A payload is no effect by
itself: it is part of the load of every `gravity_compliance` in the file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from twin._common.errors import InputError, nearest
from twin.machine.effects.base import Effect
from twin.machine.effects.cross_axis import CROSS_AXIS
from twin.machine.effects.error_motion import ANGULAR_ERROR_MOTION, POSITIONING, ROTARY_ERROR_MOTION, STRAIGHTNESS
from twin.machine.effects.gravity_compliance import GRAVITY_COMPLIANCE, PAYLOAD, GravityCompliance
from twin.machine.effects.harmonic import HARMONIC
from twin.machine.effects.location import AXIS_LOCATION
from twin.machine.effects.payload import Payload
from twin.machine.effects.pitch_error import PITCH_ERROR
from twin.machine.effects.reversal import REVERSAL
from twin.machine.effects.reversal_curve import REVERSAL_CURVE
from twin.machine.effects.specification import Specification
from twin.machine.effects.spindle_growth import SPINDLE_GROWTH
from twin.machine.effects.squareness import SQUARENESS
from twin.machine.effects.table_load import TABLE_LOAD
from twin.machine.effects.thermal_drift import THERMAL_DRIFT
from twin.machine.effects.thermal_expansion import THERMAL_EXPANSION
from twin.machine.effects.thermal_growth import THERMAL_GROWTH
from twin.machine.effects.zero_offset import ZERO_OFFSET
from twin.machine.machine import Machine

MACHINE_EFFECTS: Final[tuple[Specification, ...]] = (
    REVERSAL,
    ZERO_OFFSET,
    PITCH_ERROR,
    THERMAL_EXPANSION,
    REVERSAL_CURVE,
    SQUARENESS,
    AXIS_LOCATION,
    POSITIONING,
    STRAIGHTNESS,
    ANGULAR_ERROR_MOTION,
    ROTARY_ERROR_MOTION,
    HARMONIC,
    CROSS_AXIS,
    THERMAL_GROWTH,
    THERMAL_DRIFT,
    SPINDLE_GROWTH,
    TABLE_LOAD,
    GRAVITY_COMPLIANCE,
    PAYLOAD,
)
"""Everything a machine can have."""


def effect_named(
    effect: str, where: str, numbers: Mapping[str, float], machine: Machine, payloads: Sequence[Payload] = ()
) -> Effect:
    """An effect of the contract's table.

    Args:
        effect: its name.
        where: its place.
        numbers: its parameters by name.
        machine: the machine.
        payloads: what the machine carries beside what the URDF says.

    Raises:
        InputError: no such effect, place or parameter; a parameter that is missing.
    """
    made = {one.name: one for one in MACHINE_EFFECTS if one.make is not None}
    found = made.get(effect)
    if found is None or found.make is None:
        known = list(made)
        raise InputError(
            "no such effect", expected=f"one of {', '.join(known)}", value=effect, nearest=nearest(effect, known)
        )
    values = found.numbers_of(where, numbers)
    if not found.open_places and where not in found.places(machine):
        raise found.no_place(machine, where)
    return found.make(machine, where, values, payloads)


def payload_named(where: str, numbers: Mapping[str, float], machine: Machine) -> Payload:
    """A payload of the contract's table.

    Args:
        where: ``tool`` or ``work``.
        numbers: its parameters by name.
        machine: the machine.

    Raises:
        InputError: no such place or parameter; a parameter that is missing, or that no payload can have.
    """
    side = next((one for one in ("tool", "work") if one == where), None)
    if side is None:
        raise PAYLOAD.no_place(machine, where)
    return Payload.of(side, PAYLOAD.numbers_of(where, numbers)).checked()


def payload_entries(effects: Sequence[Effect]) -> list[dict[str, Any]]:
    """The entries that `payload_named` reads back, of the payloads some effects have in their load."""
    carried = [payload for effect in effects if isinstance(effect, GravityCompliance) for payload in effect.payloads]
    return [
        {"effect": PAYLOAD.name, "where": payload.side, "parameters": payload.numbers}
        for payload in dict.fromkeys(carried)
    ]


def entry_of(effect: Effect) -> dict[str, Any]:
    """The entry that `effect_named` reads back."""
    name, _, where = effect.name.partition(":")
    return {"effect": name, "where": where.partition("[")[0], "parameters": effect.numbers}
