"""Squareness error: deviation of an axis's mean direction from square to the datum (ISO 230-1, 3.6; contract §1)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, final

import numpy as np

from twin.machine.effects.base import Effect, Frame, Parameter
from twin.machine.effects.names import direction_of, split_name
from twin.machine.effects.places import single_parameter_form
from twin.machine.effects.specification import EXTENDED, Advice, Specification
from twin.machine.machine import Axis


@final
class Squareness(Effect):
    """``E_C0Y``, ``E_A0Z``, ``E_B0Z``: the axis's direction n turns right-handed by the angle, e = q · (ω × n).

    With n = y: E_XY −= y·E_C0Y; with n = z: E_XZ += z·E_B0Z and E_YZ −= z·E_A0Z. The angle turns about x, y or z of the machine frame,
    even if the axis's error frame is inclined to it.

    Args:
        name: ISO 230-1 name.
        angle_urad: the angle.
        axis: the axis whose direction turns.
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
        f"{axis} out of square to {others[0]}"
        if len(others) == 1
        else f"{axis} out of square about {direction_of(where)}"
    )


SQUARENESS: Final = Specification(
    name="squareness",
    kind="machine",
    title=_title,
    advice=Advice(
        "Service: levelling of the machine, fixing of column and guideways; ask whether the machine was moved or had a collision.",
        f"{EXTENDED}. After levelling, measure again.",
        "Do not keep the present values after levelling the machine.",
    ),
    evidence=lambda fit: f"{fit.where}: the squareness error differs from the model by {fit.measure}",
    limits={"urad": 10_000.0},
    places=lambda machine: machine.squareness_names,
    forms=lambda machine, where, state, payloads: single_parameter_form(
        ("angle", "urad"), lambda value: Squareness(where, value, machine.by_name[split_name(where)[2]])
    ),
    constant=True,
)
