"""twin: a digital twin of a five-axis machine tool that finds out, from measurements, where its own model is wrong.

The names a script needs; everything else lives in the room its name says.
"""

from twin.calibration import Calibration
from twin.changes import Changes, compare
from twin.channels import Conditions
from twin.compensation import Compensation, Compensator, Options, compensate, compensate_file
from twin.diagnosis import Diagnosis, diagnose
from twin.errors import InputError
from twin.identification import Identification, identify
from twin.inverse import Inverse, Solution, Status
from twin.iso16907 import Scope
from twin.kinematics import Kinematics, Poses
from twin.machine import Axis, Machine
from twin.measurement import Measurements
from twin.motion_curve import Curve
from twin.nc import read_program
from twin.parallel import Workers
from twin.paths import Refit, refit
from twin.population import Population, draw_machines
from twin.programs import compensate_files
from twin.toolpath import Setup
from twin.uncertainty import ToolUncertainty

__all__ = [
    "Axis",
    "Calibration",
    "Changes",
    "Compensation",
    "Compensator",
    "Conditions",
    "Curve",
    "Diagnosis",
    "Identification",
    "InputError",
    "Inverse",
    "Kinematics",
    "Machine",
    "Measurements",
    "Options",
    "Population",
    "Poses",
    "Refit",
    "Scope",
    "Setup",
    "Solution",
    "Status",
    "ToolUncertainty",
    "Workers",
    "compare",
    "compensate",
    "compensate_file",
    "compensate_files",
    "diagnose",
    "draw_machines",
    "identify",
    "read_program",
    "refit",
]
