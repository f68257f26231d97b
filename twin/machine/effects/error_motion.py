"""Error motions: one curve a component, a function of the axis's own position (ISO 230-1, 3.4)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, final

from twin.machine.effects.base import Effect, Frame, Parameter
from twin.machine.effects.names import direction_of, split_name, unit_of
from twin.machine.effects.specification import EXTENDED, Advice, Specification
from twin.machine.machine import Axis
from twin.numerics.curves import Basis
from twin.numerics.elementary import floor


@final
class ErrorMotion(Effect):
    """``E_XX`` … ``E_CC`` as Σ c_k f_k(q).

    Args:
        name: ISO 230-1 name.
        basis: family of functions.
        domain: (lo, hi) in mm or degrees.
        coefficients: µm or µrad.
        wrapped: whether the axis turns without end, so that its position is wrapped into the domain.
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
        """Its coefficients, ``E_XX[0]`` and on."""
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


_ANEW: Final = Advice(
    "Whether the calibration is still this machine's: its date, and what was repaired, moved or levelled since. Then service: guideway "
    "and bearings of {axis}.",
    f"{EXTENDED}, or measure {{axis}} again (twin identify).",
    "Do not shift a zero against it: it changes along the travel, a zero does not.",
)

POSITIONING: Final = Specification(
    name="positioning",
    kind="machine",
    title=lambda where: f"positioning of {split_name(where)[2]}",
    advice=Advice(_ANEW.look, _ANEW.do, "Do not fill the control's pitch table as well: it would be corrected twice."),
    evidence=lambda of: f"{of.where}: the axis stands elsewhere along its travel than the model says",
    curve=True,
)

STRAIGHTNESS: Final = Specification(
    name="straightness",
    kind="machine",
    title=lambda where: f"straightness of {split_name(where)[2]} in {direction_of(where)}",
    advice=_ANEW,
    evidence=lambda of: f"{of.where}: the axis runs along another curve than the model says",
    curve=True,
)

ANGULAR_ERROR_MOTION: Final = Specification(
    name="angular_error_motion",
    kind="machine",
    title=lambda where: f"{split_name(where)[2]} tilts about {direction_of(where)} as it travels",
    family="tilts along the travel",
    advice=_ANEW,
    evidence=lambda of: f"{of.where}: the axis turns as it travels, otherwise than the model says",
    curve=True,
)


def _turns(where: str) -> str:
    component, _, axis = split_name(where)
    if component < 3:
        return f"{axis} shifts along {direction_of(where)} as it turns"
    return f"{axis} tilts about {direction_of(where)} as it turns"


ROTARY_ERROR_MOTION: Final = Specification(
    name="error_motion",
    kind="machine",
    title=_turns,
    family="errors of rotary axes",
    advice=_ANEW,
    evidence=lambda of: f"{of.where}: the axis errs along another curve than the model says",
    curve=True,
    seldom=True,
    plain_forms=0,
)


def specification_of(axis: Axis, component: int) -> Specification:
    """What a wrong curve of an axis is, by the component it errs in."""
    if not axis.linear:
        return ROTARY_ERROR_MOTION
    if component >= 3:
        return ANGULAR_ERROR_MOTION
    along = max(range(3), key=lambda i: abs(axis.direction[i]))
    return POSITIONING if component == along else STRAIGHTNESS
