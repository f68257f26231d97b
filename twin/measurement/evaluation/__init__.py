"""Evaluations according to ISO 230-1, ISO 230-2, ISO 230-3, ISO 230-4 and ISO 230-7.

Pure functions from arrays to named results, independent of machines and files. The plots (`twin.measurement.evaluation.plots`) need the
extra ``plots`` and are imported separately.
"""

from twin.measurement.evaluation.angular import AngularError, angular_error
from twin.measurement.evaluation.circular import MotionHarmonic, RotaryMotion, error_motion
from twin.measurement.evaluation.drift import DriftSeries, drift_series
from twin.measurement.evaluation.iso230_2 import (
    Positioning,
    UnidirectionalPositioning,
    linear_axis,
    linear_deviations_um,
    rotary_axis,
    rotary_deviations_urad,
    unidirectional,
)
from twin.measurement.evaluation.iso230_4 import CircularPath, CircularTest, circular_test
from twin.measurement.evaluation.squareness import SquarenessError, squareness
from twin.measurement.evaluation.straightness import ReferenceLine, Straightness, straightness

__all__ = [
    "AngularError",
    "CircularPath",
    "CircularTest",
    "DriftSeries",
    "MotionHarmonic",
    "Positioning",
    "ReferenceLine",
    "RotaryMotion",
    "SquarenessError",
    "Straightness",
    "UnidirectionalPositioning",
    "angular_error",
    "circular_test",
    "drift_series",
    "error_motion",
    "linear_axis",
    "linear_deviations_um",
    "rotary_axis",
    "rotary_deviations_urad",
    "squareness",
    "straightness",
    "unidirectional",
]
