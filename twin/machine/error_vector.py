"""The errors of a model as one vector, the input of `twin.machine.chain`."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, final

import casadi as ca

from twin.machine.effects import Effect, assemble, summed
from twin.machine.machine import Machine


def error_vector(
    machine: Machine, effects: tuple[Effect, ...], q: Any, channels: Mapping[str, Any] | None = None
) -> Any:
    """Return the errors (6·frames,) of a model at positions ``q`` (metres, radians); ``channels``: numbers or expressions by name."""
    return _vector(assemble(effects, machine.frames, _state(machine, q, channels or {})))


@final
class ErrorTerms:
    """Errors of the effects of a model as expressions, built once for all models that have some of these effects.

    Args:
        machine: the machine.
        effects: the effects.
        constant: numbers, by channel.
        varying: names of channels that are symbols.

    Attributes:
        q: (axes,) symbols of the positions, metres and radians.
        channels: (varying,) symbols of these channels.
    """

    def __init__(
        self, machine: Machine, effects: tuple[Effect, ...], constant: Mapping[str, float], varying: Sequence[str]
    ) -> None:
        self._frames = machine.frames
        self.q, self.channels = ca.SX.sym("q", len(machine.axes)), ca.SX.sym("approach", len(varying))
        named = dict(constant) | dict(zip(varying, ca.vertsplit(self.channels), strict=True))
        state = _state(machine, self.q, named)
        self._terms = [(effect.name, effect.frame, effect.components(state)) for effect in effects]

    def vector(self, names: Collection[str]) -> Any:
        """Return the errors (6·frames,) of the effects of these names."""
        terms = [(frame, components) for name, frame, components in self._terms if name in names]
        return _vector(summed(terms, self._frames))


def _state(machine: Machine, q: Any, channels: Mapping[str, Any]) -> dict[str, Any]:
    return {axis.name: q[i] / axis.scale for i, axis in enumerate(machine.axes)} | dict(channels)


def _vector(frames: list[list[Any]]) -> Any:
    return ca.vertcat(*[component for frame in frames for component in frame])
