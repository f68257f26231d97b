"""twin: a digital twin of a five-axis machine tool that finds out, from measurements, where its own model is wrong.

The names a script needs; everything else lives in the room its name says. Each is imported when it is first used, so that `twin doctor`
runs where a package is broken.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin._common.errors import InputError
    from twin.comparison import Changes, compare
    from twin.compensation import Compensation, Compensator, Options, compensate, compensate_file
    from twin.compensation.fewer_blocks import Refit, refit
    from twin.compensation.many import compensate_files
    from twin.compensation.toolpath import Setup
    from twin.compute.parallel import Workers
    from twin.diagnosis import Diagnosis, diagnose
    from twin.identification import Identification, identify
    from twin.kinematics.forward import Kinematics, Poses
    from twin.kinematics.inverse import Inverse, Solution, Status
    from twin.machine.calibration import Calibration
    from twin.machine.conditions import Conditions
    from twin.machine.iso16907 import Scope
    from twin.machine.machine import Axis, Machine
    from twin.machine.motion_curve import Curve
    from twin.measurement.table import Measurements
    from twin.nc import read_program
    from twin.uncertainty.at_tool import ToolUncertainty
    from twin.uncertainty.population import Population, draw_machines

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
    "Axis": "twin.machine.machine",
    "Calibration": "twin.machine.calibration",
    "Changes": "twin.comparison",
    "Compensation": "twin.compensation",
    "Compensator": "twin.compensation",
    "Conditions": "twin.machine.conditions",
    "Curve": "twin.machine.motion_curve",
    "Diagnosis": "twin.diagnosis",
    "Identification": "twin.identification",
    "InputError": "twin._common.errors",
    "Inverse": "twin.kinematics.inverse",
    "Kinematics": "twin.kinematics.forward",
    "Machine": "twin.machine.machine",
    "Measurements": "twin.measurement.table",
    "Options": "twin.compensation",
    "Population": "twin.uncertainty.population",
    "Poses": "twin.kinematics.forward",
    "Refit": "twin.compensation.fewer_blocks",
    "Scope": "twin.machine.iso16907",
    "Setup": "twin.compensation.toolpath",
    "Solution": "twin.kinematics.inverse",
    "Status": "twin.kinematics.inverse",
    "ToolUncertainty": "twin.uncertainty.at_tool",
    "Workers": "twin.compute.parallel",
    "compare": "twin.comparison",
    "compensate": "twin.compensation",
    "compensate_file": "twin.compensation",
    "compensate_files": "twin.compensation.many",
    "diagnose": "twin.diagnosis",
    "draw_machines": "twin.uncertainty.population",
    "identify": "twin.identification",
    "read_program": "twin.nc",
    "refit": "twin.compensation.fewer_blocks",
}


def __getattr__(name: str) -> Any:
    """Import a name from the module that defines it."""
    if name not in _HOMES:
        raise AttributeError(f"module 'twin' has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_HOMES[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
