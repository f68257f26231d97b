"""Drift tests after ISO 230-3 as sequences of readings over time; a new one is one file and one entry in `DRIFTS`."""

from __future__ import annotations

from typing import Any, Final

from twin._common.errors import InputError, closest_name
from twin.machine.machine import Machine
from twin.planning.drift.axes import AXES
from twin.planning.drift.environment import ENVIRONMENT
from twin.planning.drift.plan import DriftPlan, make_drift_plan
from twin.planning.drift.specification import INSTRUMENTS
from twin.planning.drift.spindle import SPINDLE
from twin.planning.kit import Kit

DRIFTS: Final = (ENVIRONMENT, SPINDLE, AXES)
"""All drift sequences."""


def drift_plan(
    machine: Machine, name: str, instrument: str = "probe", kit: Kit | None = None, **more: Any
) -> DriftPlan:
    """Plan the drift test of a name; further arguments as of `make_drift_plan`.

    Raises:
        InputError: an unknown name, and as `make_drift_plan`.
    """
    names = [one.name for one in DRIFTS]
    if name not in names:
        raise InputError(
            "no such drift test", expected=f"one of {', '.join(names)}", value=name, nearest=closest_name(name, names)
        )
    return make_drift_plan(machine, DRIFTS[names.index(name)], instrument, kit, **more)


__all__ = ["DRIFTS", "INSTRUMENTS", "DriftPlan", "drift_plan"]
