"""Shifts of the whole tool side along a direction of the base frame."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from twin.machine.effects.base import Effect, Frame, Vector, base_vector, rest_orientation
from twin.machine.machine import Machine


class ToolSide(NamedTuple):
    """The tool side and one direction of the base frame.

    Attributes:
        frame: the error frame on the tool side that is nearest the base.
        direction: ``X``, ``Y`` or ``Z`` of the base frame.
        vector: that direction in the frame.
    """

    frame: Frame
    direction: str
    vector: Vector


class ToolSideShift(Effect):
    """Shift of the tool side along a direction of the base frame, proportional to the first parameter.

    Args:
        name: name of the effect.
        side: tool side and direction.
    """

    def __init__(self, name: str, side: ToolSide) -> None:
        self.name = name
        self.frame = side.frame
        self._side = side

    def _shifted(self, shape: Any) -> dict[int, Any]:
        """Return a shift of ``shape`` along the direction, by component."""
        return {i: part * shape for i, part in enumerate(self._side.vector) if part != 0.0}


class HistoryShift(ToolSideShift):
    """A shift of the tool side that depends on what the machine did before.

    Its derivatives by the parameters follow from readings in the order of time. At single poses, as those of a program, they are given
    as the channels `factor_channels`.
    """

    history = True

    @property
    def factor_channels(self) -> tuple[str, ...]:
        """Names of the channels that hold the derivative by each parameter."""
        return tuple(f"factor:{parameter.name}" for parameter in self.parameters)

    @abstractmethod
    def factors(self, state: Mapping[str, Any]) -> Sequence[np.ndarray]:
        """Return the derivative of the shift by each parameter at readings, in any order of time: µm per unit of the parameter.

        Args:
            state: the channels of the readings, (n,) or single values.

        Raises:
            InputError: a channel that the effect needs is missing.
        """

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`; needs the channels of `factors`, or `factor_channels`."""
        given = [positions.get(name) for name in self.factor_channels]
        factors = self.factors(positions) if given[0] is None else given
        return tuple(self._shifted(factor) for factor in factors)


def directions(machine: Machine) -> tuple[str, ...]:
    """Return the directions of the base frame; empty if no axis is on the tool side."""
    return ("X", "Y", "Z") if _first(machine) is not None else ()


def tool_side(machine: Machine, direction: str) -> ToolSide | None:
    """Return the tool side with a direction of the base frame; None if no axis is on it or the direction is unknown."""
    first = _first(machine)
    if first is None or direction not in tuple("XYZ"):
        return None
    return ToolSide(first[0], direction, base_vector(first[1], direction))


def _first(machine: Machine) -> tuple[Frame, np.ndarray] | None:
    """Return the tool side's error frame nearest the base and the base's directions in it (rows) with all axes at zero, or None."""
    supports = machine.model.supports[machine.model.frames[machine.tool_frame].parentJoint].tolist()
    sides = [frame for frame in machine.frames if machine.by_name[frame.axis].side == "tool"]
    if not sides:
        return None
    first = min(sides, key=lambda frame: supports.index(frame.joint))
    return Frame(first.axis, first.role), rest_orientation(machine, first.joint)
