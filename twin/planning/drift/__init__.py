"""Drift tests after ISO 230-3 as sequences of readings over time.

A new one is one file and one entry in `twin._common.families.DRIFTS`.
"""

from __future__ import annotations

from typing import Any, Final

from twin._common import families
from twin._common.errors import require_name
from twin.machine.machine import Machine
from twin.planning.drift.plan import DriftPlan, make_drift_plan
from twin.planning.drift.tests import DriftSequence
from twin.planning.kit import Kit

DRIFTS: Final[tuple[DriftSequence, ...]] = families.members(__name__, families.DRIFTS)
"""All drift sequences."""


def drift_plan(
    machine: Machine, name: str, instrument: str = "probe", kit: Kit | None = None, **more: Any
) -> DriftPlan:
    """Plan the drift test of a name; further arguments as of `make_drift_plan`.

    Raises:
        InputError: an unknown name, and as `make_drift_plan`.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> plan = twin.drift_plan(machine, "spindle", "probe", options={"highest_rpm": 8000})
        >>> plan.minutes
        300.0
        >>> plan.save("spindle.csv")

    References:
        - ISO 230-3:2020, Determination of thermal effects.
    """
    require_name("drift test", name, families.DRIFTS)
    return make_drift_plan(machine, next(drift for drift in DRIFTS if drift.name == name), instrument, kit, **more)


__all__ = ["DRIFTS", "DriftPlan", "drift_plan"]
