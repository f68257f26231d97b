"""Conversion between `Effect` and the ``effects:`` entries of a calibration file.

    effects:
      - {effect: reversal, where: Y, parameters: {size: 5.1}}

Names, places and parameters are those of the contract's table (§5) and are defined in each effect's specification. A payload and a
carried load are not effects by themselves: they are part of the load of every `gravity_compliance` in the file, and
of every `table_load` with a stated moment.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from twin._common import families
from twin._common.errors import InputError, closest_name
from twin._common.messages import Message
from twin.machine.machine import Machine
from twin.model.effects.base import MASS, OWN_WEIGHT, Effect, Payload, Side, moving_mass_kg, numbered
from twin.model.effects.gravity_compliance import CARRIED_LOAD, PAYLOAD, GravityCompliance
from twin.model.effects.specification import Specification
from twin.model.effects.table_load import TableLoad
from twin.numerics.covariance import Covariance

MACHINE_EFFECTS: Final[tuple[Specification, ...]] = families.members("twin.model.effects", families.EFFECTS)
"""Specifications of all machine effects."""


def effect_named(
    effect: str, where: str, numbers: Mapping[str, float], machine: Machine, payloads: Sequence[Payload] = ()
) -> Effect:
    """Create an effect from its name, place and parameters.

    Args:
        effect: its name.
        where: its place.
        numbers: its parameters by name.
        machine: the machine.
        payloads: loads that the URDF does not contain.

    Raises:
        InputError: the effect, place or a parameter is unknown, or a parameter is missing.

    Examples:
        >>> from dataclasses import replace
        >>> machine = twin.Machine.load("dmu50")
        >>> effect = twin.effect_named("cross_axis", "E_AX by Z", {"coefficient": 110.0}, machine)
        >>> effect.coefficient
        110.0
        >>> calibration = replace(twin.Calibration.default(machine), extra=(effect,))
    """
    specifications = {
        specification.name: specification for specification in MACHINE_EFFECTS if specification.make is not None
    }
    specification = specifications.get(effect)
    if specification is None or specification.make is None:
        known = list(specifications)
        raise InputError(
            "no such effect", expected=f"one of {', '.join(known)}", value=effect, nearest=closest_name(effect, known)
        )
    values = specification.numbers_of(where, numbers)
    if not specification.open_places and where not in specification.places(machine):
        raise specification.no_place(machine, where)
    return specification.make(machine, where, values, payloads)


def payload_named(specification: Specification, where: str, numbers: Mapping[str, float], machine: Machine) -> Payload:
    """Create a payload or a carried load, whose specification is given, from its parameters.

    Relative to own weight, of which the control leaves only a share, a load acts as a mass that is larger by the inverse of it.
    """
    side = next((name for name in ("tool", "work") if name == where), None)
    if side is None:
        raise specification.no_place(machine, where)
    carried, given = specification is CARRIED_LOAD, specification.numbers_of(where, numbers)
    share = given.pop(OWN_WEIGHT, 1.0)
    if not 0.0 < share <= 1.0:
        raise InputError(f"{OWN_WEIGHT} of payload {side}", expected="above 0, at most 1", value=share)
    if share != 1.0:
        given[MASS] /= share
    return Payload.of(side, given, carried=carried).checked()


def payloads_on(effects: Sequence[Effect]) -> tuple[Payload, ...]:
    """Return the payloads and carried loads that act on the given effects; of a compliance before those of a table's sag."""
    loaded = [effect for kind in (GravityCompliance, TableLoad) for effect in effects if isinstance(effect, kind)]
    kinds: dict[tuple[Side, bool], Payload] = {}
    for effect in loaded:
        for payload in effect.payloads:
            kinds.setdefault((payload.side, payload.carried), payload)
    return tuple(kinds.values())


def load_notices(effects: Sequence[Effect], machine: Machine) -> list[Message]:
    """Return a notice on each load that is no mass (`payload_entries`)."""
    return [
        Message(
            "the load on the {where} side is not a mass: the control corrects a part of the deflection under own weight, and only the "
            "ratio of the load to the remaining share is known. A calibration states it as {mass:.3g} kg, as heavy as the moving "
            "parts, with {parameter} {share:.2g}; weigh the load and change both in proportion",
            where=entry["where"],
            mass=entry["parameters"][MASS],
            parameter=OWN_WEIGHT,
            share=entry["parameters"][OWN_WEIGHT],
        )
        for entry in payload_entries(effects, machine)
        if OWN_WEIGHT in entry["parameters"]
    ]


def payload_entries(effects: Sequence[Effect], machine: Machine) -> list[dict[str, Any]]:
    """Return the entries of the payloads and carried loads that act on the given effects, as `payload_named` reads them.

    A payload heavier than the moving parts is none that the machine could carry: only its ratio to the share of own weight that the
    control leaves is known, and the entry has that share for a load as heavy as these parts.
    """
    entries = []
    for payload in payloads_on(effects):
        numbers, most = payload.numbers, moving_mass_kg(machine)
        if not payload.carried and payload.mass_kg > most > 0.0:
            numbers = numbers | {MASS: most, OWN_WEIGHT: most / payload.mass_kg}
        name = (CARRIED_LOAD if payload.carried else PAYLOAD).name
        entries.append({"effect": name, "where": payload.side, "parameters": numbers})
    return entries


def distinguished(
    present: Sequence[Effect], effects: Sequence[Effect], covariance: Covariance
) -> tuple[Sequence[Effect], Covariance]:
    """Return effects, and the covariance of their parameters, under names that effects already present do not have (`numbered`)."""
    own = numbered([*present, *effects])[len(present) :]
    pairs = [
        pair for old, new in zip(effects, own, strict=True) for pair in zip(old.parameters, new.parameters, strict=True)
    ]
    names = {old.name: new.name for old, new in pairs}
    return own, Covariance(tuple(names.get(name, name) for name in covariance.names), covariance.matrix)


def drawn_period(effect: Effect) -> float:
    """Return the period of an effect along the position of its axis, mm or degrees; 0 if it has none."""
    periods = {specification.name: specification.drawing.period for specification in MACHINE_EFFECTS}
    period = periods.get(effect.name.partition(":")[0])
    return 0.0 if period is None else period(effect.numbers)


def entry_of(effect: Effect) -> dict[str, Any]:
    """Return the entry of an effect, as `effect_named` reads it."""
    name, _, where = effect.name.partition(":")
    return {"effect": name, "where": where.partition("[")[0], "parameters": effect.numbers}
