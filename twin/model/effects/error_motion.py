"""Error motions: one curve per component, a function of the axis's own position (ISO 230-1, 3.4)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final, final

from twin._common.messages import Message
from twin.machine.machine import Axis, Machine
from twin.model.effects.base import Effect, Frame, Parameter, direction_of, split_name, unit_of
from twin.model.effects.specification import EXTENDED, Advice, Specification
from twin.numerics.curves import Basis
from twin.numerics.functions import floor


@final
class ErrorMotion(Effect):
    """``E_XX`` … ``E_CC`` as Σ c_k f_k(q), µm or µrad, over a domain in mm or degrees.

    The position of an axis of unlimited rotation is ``wrapped`` into the domain.
    """

    def __init__(
        self, name: str, basis: Basis, domain: tuple[float, float], coefficients: tuple[float, ...], *, wrapped: bool
    ) -> None:
        self.name = name
        self.basis = basis
        self.domain = domain
        self.coefficients = coefficients
        self.wrapped = wrapped and not basis.periodic
        self._component, _, self._axis = split_name(name)
        self.frame = Frame(self._axis, "motion")

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`."""
        return {self._component: self.basis.value(self._inside(positions), self.domain, self.coefficients)}

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Coefficients, named ``E_XX[0]``, ``E_XX[1]`` and so on."""
        unit = unit_of(self.name)
        return tuple(Parameter(f"{self.name}[{k}]", unit, value) for k, value in enumerate(self.coefficients))

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        functions = self.basis.functions(self._inside(positions), self.domain, len(self.coefficients))
        return tuple({self._component: function} for function in functions)

    def _inside(self, positions: Mapping[str, Any]) -> Any:
        q = positions[self._axis]
        if self.wrapped:
            lo, hi = self.domain
            q = q - (hi - lo) * floor((q - lo) / (hi - lo))
        return q


def _places(machine: Machine, name: str) -> tuple[str, ...]:
    """Return the error motions of one of the kinds below."""
    motions = [(motion, *split_name(motion)) for motion in machine.motion_names]
    return tuple(
        motion
        for motion, component, _, axis in motions
        if specification_of(machine.by_name[axis], component).name == name
    )


_REMEASURE: Final = Advice(
    "Check that the calibration still applies to this machine: its date, and what has been repaired, moved or "
    "levelled since. Then "
    "service: guideway and bearings of {axis}.",
    f"{EXTENDED}, or identify the errors again with this error motion included (twin identify).",
    "Do not correct it with a zero offset: the error changes along the travel, an offset does not.",
)

POSITIONING: Final = Specification(
    name="positioning",
    kind="machine",
    title=lambda where: Message("positioning error of {axis}", axis=split_name(where)[2]),
    advice=Advice(
        _REMEASURE.look,
        _REMEASURE.do,
        "Do not also enter it in the control's pitch-error table: it would be corrected twice.",
    ),
    evidence=lambda fit: Message("the positioning error of the axis differs from the model"),
    # Those of a location: beyond 20 mm or 20 mrad the machine description is wrong, not the machine.
    limits={"um": 20_000.0, "urad": 20_000.0},
    places=lambda machine: _places(machine, "positioning"),
    curve=True,
)

STRAIGHTNESS: Final = replace(
    POSITIONING,
    name="straightness",
    title=lambda where: Message(
        "straightness error of {axis} in {direction}", axis=split_name(where)[2], direction=direction_of(where)
    ),
    advice=_REMEASURE,
    evidence=lambda fit: Message("the straightness error of the axis differs from the model"),
    places=lambda machine: _places(machine, "straightness"),
)

ANGULAR_ERROR_MOTION: Final = replace(
    STRAIGHTNESS,
    name="angular_error_motion",
    title=lambda where: Message(
        "tilt of {axis} about {direction} along its travel", axis=split_name(where)[2], direction=direction_of(where)
    ),
    family="tilts of axes along their travel",
    evidence=lambda fit: Message("the tilt of the axis along its travel differs from the model"),
    places=lambda machine: _places(machine, "angular_error_motion"),
)


def _rotary_title(where: str) -> str:
    component, _, axis = split_name(where)
    if component < 3:
        return Message("shift of {axis} along {direction} as it turns", axis=axis, direction=direction_of(where))
    return Message("tilt of {axis} about {direction} as it turns", axis=axis, direction=direction_of(where))


ROTARY_ERROR_MOTION: Final = replace(
    STRAIGHTNESS,
    name="error_motion",
    title=_rotary_title,
    family="error motions of rotary axes",
    evidence=lambda fit: Message("the error motion of the axis differs from the model"),
    places=lambda machine: _places(machine, "error_motion"),
    rare=True,
    plain_forms=0,
)


def specification_of(axis: Axis, component: int) -> Specification:
    """Return the specification of a wrong error-motion curve of an axis, by component."""
    if not axis.linear:
        return ROTARY_ERROR_MOTION
    if component >= 3:
        return ANGULAR_ERROR_MOTION
    along = max(range(3), key=lambda i: abs(axis.direction[i]))
    return POSITIONING if component == along else STRAIGHTNESS
