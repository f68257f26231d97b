"""Six error motions of one linear axis from the readings of a multi-axis interferometer.

Manual: `twin doc interferometer`.
"""

from twin.identification.axis_run.motions import AxisCurves, Motions, axis_curves, error_motions, to_dict, to_text
from twin.identification.axis_run.readings import AxisLayout, BeamReadings, carriage_poses, load_readings, simulate_run

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
