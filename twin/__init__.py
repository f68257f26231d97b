"""twin: a digital twin of a five-axis machine tool that finds out, from measurements, where its own model is wrong.

The names a script needs; everything else lives in the room its name says. Each is imported when it is first used, so that `twin doctor`
runs where a package is broken.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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

_HOMES = {
    "Axis": "twin.machine",
    "Calibration": "twin.calibration",
    "Changes": "twin.changes",
    "Compensation": "twin.compensation",
    "Compensator": "twin.compensation",
    "Conditions": "twin.channels",
    "Curve": "twin.motion_curve",
    "Diagnosis": "twin.diagnosis",
    "Identification": "twin.identification",
    "InputError": "twin.errors",
    "Inverse": "twin.inverse",
    "Kinematics": "twin.kinematics",
    "Machine": "twin.machine",
    "Measurements": "twin.measurement",
    "Options": "twin.compensation",
    "Population": "twin.population",
    "Poses": "twin.kinematics",
    "Refit": "twin.paths",
    "Scope": "twin.iso16907",
    "Setup": "twin.toolpath",
    "Solution": "twin.inverse",
    "Status": "twin.inverse",
    "ToolUncertainty": "twin.uncertainty",
    "Workers": "twin.parallel",
    "compare": "twin.changes",
    "compensate": "twin.compensation",
    "compensate_file": "twin.compensation",
    "compensate_files": "twin.programs",
    "diagnose": "twin.diagnosis",
    "draw_machines": "twin.population",
    "identify": "twin.identification",
    "read_program": "twin.nc",
    "refit": "twin.paths",
}


def __getattr__(name: str) -> Any:
    """Import a name from the module that defines it."""
    if name not in _HOMES:
        raise AttributeError(f"module 'twin' has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_HOMES[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
