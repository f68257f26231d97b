"""What errors and classes are called where nobody knows the symbols."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from twin.diagnosis.wording.words import capital, plain
from twin.machine.effects import split_name
from twin.machine.effects.names import motion
from twin.machine.machine import Machine

CLASSES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "L-POS": "positioning of the linear axes",
        "L-STR": "straightness of the linear axes",
        "L-SQU": "squareness between the linear axes",
        "L-ANG": "tilts of the linear axes along their travel",
        "R-POS": "angle of the rotary axes",
        "R-RAX": "shifts of the rotary axes as they turn",
        "R-POR": "where the rotary axes lie",
        "R-ANG": "tilts of the rotary axes as they turn",
        "control": "what the control takes out by itself",
        "all": "everything together",
    }
)


def named(name: str, machine: Machine) -> str:
    """An error, an effect or a class in words; what has none is called as it is.

    Args:
        name: ISO 230-1 name, ``reversal:Y``, or the class of ISO/TR 16907.
        machine: whose it is.
    """
    if name in CLASSES:
        return capital(CLASSES[name])
    if name.startswith("E_"):
        return _of_motion(name, machine)
    effect, colon, where = name.partition(":")
    if not colon:
        return name
    if effect == "control":
        return f"Table in the control: {where}"
    return plain(effect, where.partition("[")[0])


def _of_motion(name: str, machine: Machine) -> str:
    component, average, axis = split_name(name)
    one, direction = machine.by_name[axis], "xyz"[component % 3]
    if average:
        return plain("squareness", name) if one.linear else capital(motion(name))
    along = max(range(3), key=lambda i: abs(one.direction[i]))
    if one.linear and component < 3:
        return f"Positioning of {axis}" if component == along else f"Straightness of {axis} in {direction}"
    if one.linear:
        return f"{axis} tilts about {direction} as it travels"
    if component == along + 3:
        return f"Angle of {axis}"
    return f"{axis} {'shifts along' if component < 3 else 'tilts about'} {direction} as it turns"
