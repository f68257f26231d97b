"""One linear axis measured by a multi-axis interferometer: readings in, six error motions and their curves out.

    twin simulate-run --layout nine_beams_x.yaml --positions 0,500,21 -o run.csv
    twin axis-run run.csv --layout nine_beams_x.yaml -o x.yaml

Six error motions at every position and their curves, with the joint covariance. A layout file (`schema: twin.interferometer/1`)
gives beams, mirrors, their place on the carriage and how well each is known. The beams alone do not determine x and y, however
many positions there are (Wen et al. 2023 say they do; `twin.measurement.instruments.multi_axis` has the null move), so the stated
installation is in every uncertainty. A beam or mirror 1 mrad askew biases by some 0.25 µm over 500 mm, which is not in it.
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
