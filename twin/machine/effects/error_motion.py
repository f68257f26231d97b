"""Error motions: one curve a component, a function of the axis's own position (ISO 230-1, 3.4)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, final

from twin.machine.effects.base import Effect, Frame, Parameter, split_name
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

    @property
    def frame(self) -> Frame:
        """The motion frame of its axis."""
        return Frame(self._axis, "motion")

    def components(self, positions: Mapping[str, Any]) -> Mapping[int, Any]:
        """See `Effect.components`."""
        return {self._component: self.basis.value(self._inside(positions), self.domain, self.coefficients)}

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its coefficients, ``E_XX[0]`` and on."""
        unit = "um" if self._component < 3 else "urad"
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
