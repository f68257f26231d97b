"""Thermal tests after ISO 230-3: displacements of the tool relative to the work over time."""

from twin.standards.drift.tests import evaluate_drift

__all__ = ["evaluate_drift"]
