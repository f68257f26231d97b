"""One linear axis measured by a multi-axis interferometer: readings in, six error motions and their curves out."""

from twin.axis_run.layout import AxisLayout
from twin.axis_run.motions import AxisCurves, Motions, axis_curves, error_motions
from twin.axis_run.readings import Readings, load_readings
from twin.axis_run.report import to_dict, to_text
from twin.axis_run.simulate import carriage_poses, simulate_run

__all__ = [
    "AxisCurves",
    "AxisLayout",
    "Motions",
    "Readings",
    "axis_curves",
    "carriage_poses",
    "error_motions",
    "load_readings",
    "simulate_run",
    "to_dict",
    "to_text",
]
