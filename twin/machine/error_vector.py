"""The errors of a model as one vector, the input of `twin.machine.chain`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from twin.machine.effects import Effect, assemble
from twin.machine.machine import Machine


def error_vector(
    machine: Machine, effects: tuple[Effect, ...], q: Any, channels: Mapping[str, Any] | None = None
) -> Any:
    """Return the errors (6·frames,) of a model at positions ``q`` (metres, radians); ``channels``: numbers or expressions by name."""
    positions = {axis.name: q[i] / axis.scale for i, axis in enumerate(machine.axes)} | dict(channels or {})
    rows = assemble(effects, machine.frames, positions)
    return ca.vertcat(*[component for row in rows for component in row])
