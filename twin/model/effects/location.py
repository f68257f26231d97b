"""Constant errors: location of a rotary axis's average line, squareness of linear axes, zero offset."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, final

import numpy as np

from twin._common.messages import Message
from twin.machine.machine import Axis
from twin.model.effects.base import (
    AlongAxis,
    Effect,
    Frame,
    Parameter,
    along,
    direction_of,
    motion_in_words,
    split_name,
    unit_of,
)
from twin.model.effects.specification import (
    EXTENDED,
    EXTENDING,
    NOT_TWICE,
    Advice,
    Drawing,
    Specification,
    all_axes,
    single_parameter_form,
)


@final
class AxisLocation(Effect):
    """``E_X0C``, ``E_Y0C`` (µm), ``E_A0C``, ``E_B0C`` (µrad): constant, in the frame that precedes the axis's error motions."""

    def __init__(self, name: str, offset: float) -> None:
        self.name = name
        self.offset = offset
        self._component, _, self._axis = split_name(name)
        self.frame = Frame(self._axis, "location")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The offset."""
        return (Parameter(self.name, unit_of(self.name), self.offset),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        return ({self._component: 0.0 * positions[self._axis] + 1.0},)


AXIS_LOCATION: Final = Specification(
    name="axis_location",
    kind="machine",
    title=motion_in_words,
    family="locations of rotary axes",
    advice=Advice(
        "Set-up: position and orientation of rotary axis {axis} in the control's kinematics, and how they were "
        "measured.",
        f"Enter the new values in the control, or {EXTENDING}.",
        NOT_TWICE,
    ),
    evidence=lambda fit: Message("the axis average line differs from the model by {measure}", measure=fit.measure),
    limits={"um": 20_000.0, "urad": 20_000.0},
    places=lambda machine: machine.location_names,
    forms=lambda machine, where, state, payloads: single_parameter_form(
        ("offset", unit_of(where)), lambda value: AxisLocation(where, value)
    ),
    constant=True,
    drawing=Drawing(beyond=True),
)


@final
class Squareness(Effect):
    """``E_C0Y``, ``E_A0Z``, ``E_B0Z``: the axis's direction n turns right-handed by the angle, e = q · (ω × n).

    With n = y: E_XY −= y·E_C0Y; with n = z: E_XZ += z·E_B0Z and E_YZ −= z·E_A0Z. The angle turns about x, y or z of the machine frame,
    even if the axis's error frame is inclined to it.
    """

    def __init__(self, name: str, angle_urad: float, axis: Axis) -> None:
        self.name = name
        self.angle_urad = angle_urad
        component, _, self._axis = split_name(name)
        self.frame = Frame(self._axis, "motion")
        self._lever = np.cross(axis.machine_axes[component - 3], axis.direction)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The angle."""
        return (Parameter(self.name, "urad", self.angle_urad),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        # An angle in µrad over a distance in mm gives 1e-3 µm.
        q = positions[self._axis]
        return ({i: q * (1e-3 * self._lever[i]) for i in range(3) if self._lever[i] != 0.0},)


def _title(where: str) -> str:
    _, _, axis = split_name(where)
    others = [letter for letter in "XYZ" if letter not in (axis, direction_of(where).upper())]
    return (
        Message("{axis} out of square to {others}", axis=axis, others=others[0])
        if len(others) == 1
        else Message("{axis} out of square about {direction}", axis=axis, direction=direction_of(where))
    )


SQUARENESS: Final = Specification(
    name="squareness",
    kind="machine",
    title=_title,
    advice=Advice(
        "Service: levelling of the machine, fixing of column and guideways; ask whether the machine was moved or had "
        "a collision.",
        f"{EXTENDED}. After levelling, measure again.",
        "Do not keep the present values after levelling the machine.",
    ),
    evidence=lambda fit: Message("the squareness error differs from the model by {measure}", measure=fit.measure),
    limits={"urad": 10_000.0},
    places=lambda machine: machine.squareness_names,
    forms=lambda machine, where, state, payloads: single_parameter_form(
        ("angle", "urad"), lambda value: Squareness(where, value, machine.by_name[split_name(where)[2]])
    ),
    constant=True,
)


@final
class ZeroOffset(AlongAxis):
    """Zero offset of an axis: E_aa += offset, the actual minus the commanded position along the command."""

    def __init__(self, axis: Axis, offset: float) -> None:
        super().__init__("zero_offset", axis)
        self.offset = offset
        self.units = (("offset", self.unit),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        return (along(self.axis, 0.0 * positions[self.axis.name] + 1.0),)


ZERO_OFFSET: Final = Specification(
    name="zero_offset",
    kind="machine",
    title=lambda where: Message("zero offset of {where}", where=where),
    family="zero offsets",
    advice=Advice(
        "Set-up: reference mark and homing of {axis}; ask whether there was a collision.",
        f"Set the zero of {{axis}} in the control, or {EXTENDING}.",
        NOT_TWICE,
    ),
    evidence=lambda fit: Message("the zero of {where} is off by {measure}", where=fit.where, measure=fit.measure),
    parameters=("offset",),
    limits={"um": 20_000.0, "urad": 50_000.0},
    places=all_axes,
    make=lambda machine, where, numbers, payloads: ZeroOffset(machine.by_name[where], numbers["offset"]),
    constant=True,
)
