"""Six error motions of one linear axis from the readings of a multi-axis interferometer.

Manual: `twin doc interferometer`.
"""

from twin.identification.axis_run.layout import AxisLayout
from twin.identification.axis_run.motions import AxisCurves, Motions, axis_curves, error_motions
from twin.identification.axis_run.readings import BeamReadings, load_readings
from twin.identification.axis_run.report import to_dict, to_text
from twin.identification.axis_run.simulate import carriage_poses, simulate_run

__all__ = [
    "AxisCurves",
    "AxisLayout",
    "BeamReadings",
    "Motions",
    "axis_curves",
    "carriage_poses",
    "error_motions",
    "load_readings",
    "simulate_run",
    "to_dict",
    "to_text",
]
