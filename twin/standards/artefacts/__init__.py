"""Squareness and scale with simple means: artefacts, a dial gauge, a ruler, a probe.

To add one, write its class and add it to `twin._common.families.ARTEFACTS`. Manual: `twin doc artefacts`.
"""

from twin.standards.artefacts.evaluate import (
    artefact_named,
    artefacts,
    calibration_of,
    evaluate_sheets,
    plan_sheet,
)
from twin.standards.artefacts.sheet import is_sheet

__all__ = ["artefact_named", "artefacts", "calibration_of", "evaluate_sheets", "is_sheet", "plan_sheet"]
