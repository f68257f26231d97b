"""Names of errors and classes in words, for readers who do not know the symbols."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from twin.display.sentences import capital
from twin.machine.effects import MACHINE_EFFECTS, split_name
from twin.machine.effects.names import motion_in_words
from twin.machine.effects.specification import title_of
from twin.machine.machine import Machine

CLASSES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "L-POS": "positioning of the linear axes",
        "L-STR": "straightness of the linear axes",
        "L-SQU": "squareness between the linear axes",
        "L-ANG": "angular error motions of the linear axes",
        "R-POS": "angular positioning of the rotary axes",
        "R-RAX": "radial and axial error motions of the rotary axes",
        "R-POR": "position and orientation of the rotary axes",
        "R-ANG": "tilt error motions of the rotary axes",
        "control": "compensation by the control",
        "all": "all errors together",
    }
)


def named(name: str, machine: Machine) -> str:
    """Return an error, an effect or a class in words, or its symbol if there are no words for it.

    Args:
        name: ISO 230-1 name, ``reversal:Y``, or the class of ISO/TR 16907.
        machine: the machine it belongs to.
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
    return _title(effect, where.partition("[")[0])


def motion_kind(name: str, machine: Machine) -> str:
    """Return the kind of an error of an axis.

    ``positioning``, ``straightness``, ``pitch`` (any angle), ``square``, ``displaced``, ``tilted``, ``angular_positioning``, ``tilt``,
    ``axial`` or ``radial``.

    Args:
        name: ISO 230-1 name.
        machine: the machine it belongs to.
    """
    component, average, axis = split_name(name)
    one = machine.by_name[axis]
    if average:
        return "square" if one.linear else "displaced" if component < 3 else "tilted"
    along = max(range(3), key=lambda i: abs(one.direction[i]))
    if one.linear:
        return "pitch" if component >= 3 else "positioning" if component == along else "straightness"
    if component >= 3:
        return "angular_positioning" if component == along + 3 else "tilt"
    return "axial" if component == along else "radial"


_MOTIONS: Final = {
    "positioning": "Positioning of {axis}",
    "straightness": "Straightness of {axis} in {direction}",
    "pitch": "Angular error motion of {axis} about {direction}",
    "angular_positioning": "Angular positioning of {axis}",
    "tilt": "Tilt error motion of {axis} about {direction}",
    "axial": "Axial error motion of {axis} in {direction}",
    "radial": "Radial error motion of {axis} in {direction}",
}


def _of_motion(name: str, machine: Machine) -> str:
    component, average, axis = split_name(name)
    if average:
        return _title("squareness", name) if machine.by_name[axis].linear else capital(motion_in_words(name))
    return _MOTIONS[motion_kind(name, machine)].format(axis=axis, direction="xyz"[component % 3])


def _title(effect: str, where: str) -> str:
    """Return the name of a machine effect at a place; a calibration holds no effects of instruments."""
    return title_of({one.name: one for one in MACHINE_EFFECTS}.get(effect), effect, where)
