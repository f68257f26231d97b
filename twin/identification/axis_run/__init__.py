"""Six error motions of one linear axis from the readings of a multi-axis interferometer.

    twin simulate-run --layout nine_beams_x.yaml --positions 0,500,21 -o run.csv
    twin axis-run run.csv --layout nine_beams_x.yaml -o x.yaml

The result are six error motions at every position and their curves, with the joint covariance. A layout file
(`schema: twin.interferometer/1`) gives the beams, the mirrors, their places on the carriage, and all uncertainties. The beams alone
do not determine x and y, whatever the number of positions (Wen et al. 2023 claim they do; `twin.measurement.instruments.multi_axis`
gives the undetermined motion). The uncertainty of the installation is therefore part of every uncertainty. A beam or mirror that is
tilted by 1 mrad gives a bias of some 0.25 µm over 500 mm, which is not included.
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
