"""Names of errors, effects and classes in words."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from types import MappingProxyType
from typing import Final

from twin._common.messages import Message
from twin.display.numbers import capital
from twin.machine.machine import Machine
from twin.model.effects import MACHINE_EFFECTS, split_name
from twin.model.effects.specification import title_of

CLASSES: Final[Mapping[str, Message]] = MappingProxyType(
    {
        "L-POS": Message("positioning of the linear axes"),
        "L-STR": Message("straightness of the linear axes"),
        "L-SQU": Message("squareness between the linear axes"),
        "L-ANG": Message("angular error motions of the linear axes"),
        "R-POS": Message("angular positioning of the rotary axes"),
        "R-RAX": Message("radial and axial error motions of the rotary axes"),
        "R-POR": Message("position and orientation of the rotary axes"),
        "R-ANG": Message("tilt error motions of the rotary axes"),
        "control": Message("compensation by the control"),
        "all": Message("all errors together"),
    }
)
_ITEMS: Final = MappingProxyType(
    {
        "tool": Message("Largest error of the tool point, uncompensated"),
        "tool_after": Message("Largest error of the tool point, expected after compensation"),
    }
)
"""Error of the tool point before compensation, and as expected after it."""
_KINDS: Final = MappingProxyType(
    {
        "positioning": partial(Message, "Positioning of {axis}"),
        "straightness": partial(Message, "Straightness of {axis} in {direction}"),
        "roll": partial(Message, "Roll of {axis} (about {direction})"),
        "pitch": partial(Message, "Pitch of {axis} (about {direction})"),
        "yaw": partial(Message, "Yaw of {axis} (about {direction})"),
        "angular_positioning": partial(Message, "Angular positioning of {axis}"),
        "tilt": partial(Message, "Tilt error motion of {axis} about {direction}"),
        "axial": partial(Message, "Axial error motion of {axis} in {direction}"),
        "radial": partial(Message, "Radial error motion of {axis} in {direction}"),
        "square": partial(Message, "Squareness of {axis} to {to}"),
        "square_about": partial(Message, "Squareness of {axis}, about {direction}"),
        "displaced": partial(Message, "Axis of {axis} displaced along {direction}"),
        "tilted": partial(Message, "Axis of {axis} tilted about {direction}"),
    }
)


def named(name: str, machine: Machine) -> str:
    """Return an error (ISO 230-1), an effect (``reversal:Y``) or a class of ISO/TR 16907 in words, or its symbol if there are none."""
    if name in CLASSES:
        return capital(CLASSES[name])
    if name.startswith("E_"):
        kind = motion_kind(name, machine)
        return _title("squareness", name) if kind == "square" else _of_kind(kind, name)
    effect, colon, where = name.partition(":")
    if not colon:
        return name
    if effect == "control":
        return Message("Table in the control: {file}", file=where)
    return _title(effect, where.partition("[")[0])


def item_named(name: str, machine: Machine, to: str = "") -> str:
    """Return an item of the first page in words: as `named`, but a squareness to its reference axis, if that is known."""
    if name in _ITEMS:
        return _ITEMS[name]
    if name.startswith("E_") and motion_kind(name, machine) == "square":
        return _of_kind("square" if to else "square_about", name, to)
    return named(name, machine)


def motion_kind(name: str, machine: Machine) -> str:
    """Return the kind of an error of an axis: a key of `_KINDS`.

    Roll is about the axis itself; of the others, yaw is about z, for a vertical axis about y, and pitch is the third.
    """
    component, average, axis = split_name(name)
    one = machine.by_name[axis]
    if average:
        return "square" if one.linear else "displaced" if component < 3 else "tilted"
    along = max(range(3), key=lambda i: abs(one.direction[i]))
    if one.linear:
        if component >= 3:
            yaw = 4 if along == 2 else 5
            return "roll" if component == along + 3 else "yaw" if component == yaw else "pitch"
        return "positioning" if component == along else "straightness"
    if component >= 3:
        return "angular_positioning" if component == along + 3 else "tilt"
    return "axial" if component == along else "radial"


def _of_kind(kind: str, name: str, to: str = "") -> Message:
    component, _, axis = split_name(name)
    return _KINDS[kind](axis=axis, direction="xyz"[component % 3], to=to)


def _title(effect: str, where: str) -> str:
    return title_of(
        {machine_effect.name: machine_effect for machine_effect in MACHINE_EFFECTS}.get(effect), effect, where
    )
