"""Evaluate the tests of ISO 230 and ISO 10791-6 for which a measurement table has the runs.

Manual: `twin doc evaluate`.
"""

from twin.standards.drift import evaluate_drift
from twin.standards.evaluate import evaluate
from twin.standards.result import EvaluationResult, NotEvaluated, StandardTest, StandardValue, ToleranceCheck

__all__ = [
    "EvaluationResult",
    "NotEvaluated",
    "StandardTest",
    "StandardValue",
    "ToleranceCheck",
    "evaluate",
    "evaluate_drift",
]
