"""Where effects can act on a machine: the lists that specifications share."""

from __future__ import annotations

from collections.abc import Callable

from twin.machine.effects.base import Effect
from twin.machine.effects.specification import Forms
from twin.machine.machine import Machine


def axes(machine: Machine) -> tuple[str, ...]:
    """All axes."""
    return machine.names


def linear(machine: Machine) -> tuple[str, ...]:
    """Linear axes."""
    return tuple(axis.name for axis in machine.axes if axis.linear)


def rotary(machine: Machine) -> tuple[str, ...]:
    """Rotary axes."""
    return tuple(axis.name for axis in machine.axes if not axis.linear)


def approach(where: str) -> tuple[str, ...]:
    """The column that says from which side an axis came."""
    return (f"approach_{where}",)


def single(names: tuple[str, str], of: Callable[[float], Effect]) -> Forms:
    """The one form of an effect that is proportional to one parameter.

    Args:
        names: its name and unit.
        of: the parameter → the effect.
    """
    return Forms((names,), lambda values, fixed: (of(float(values[0])),), lambda fixed: (of(1.0),))
