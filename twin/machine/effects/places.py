"""Places where effects can act on a machine: functions shared by the specifications."""

from __future__ import annotations

from collections.abc import Callable

from twin.machine.effects.base import Effect
from twin.machine.effects.specification import Forms
from twin.machine.machine import Machine


def axes(machine: Machine) -> tuple[str, ...]:
    """Return the names of all axes."""
    return machine.names


def linear(machine: Machine) -> tuple[str, ...]:
    """Return the names of the linear axes."""
    return tuple(axis.name for axis in machine.axes if axis.linear)


def rotary(machine: Machine) -> tuple[str, ...]:
    """Return the names of the rotary axes."""
    return tuple(axis.name for axis in machine.axes if not axis.linear)


def approach(where: str) -> tuple[str, ...]:
    """Return the column with an axis's direction of approach."""
    return (f"approach_{where}",)


def single_parameter_form(names: tuple[str, str], make: Callable[[float], Effect]) -> Forms:
    """Return the single form of an effect that is proportional to its one parameter.

    Args:
        names: name and unit of the parameter.
        make: value of the parameter → the effect.
    """
    return Forms((names,), lambda values, fixed: (make(float(values[0])),), lambda fixed: (make(1.0),))
