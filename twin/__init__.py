"""twin: a digital twin of a five-axis machine tool that finds, from measurements, where its own model is wrong.

`import twin` gives every name that notebooks and scripts need (`dir(twin)`); each is imported when it is first used (PEP 562). Every
bad input raises `twin.InputError`, with file, line, value and what was expected. Pictures and pages need the extra ``plots``, pandas,
xarray and sliders the extra ``notebook``.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

# The public API: these imports are what type checkers and editors see, and where `__getattr__` finds a name when it is first used.
if TYPE_CHECKING:
    from twin._common.bundled import find_program
    from twin._common.errors import InputError
    from twin.compensation import Compensator, Options, compensate, compensate_file
    from twin.compensation.fewer_blocks import refit

    # What the functions return, for annotations and `isinstance`.
    from twin.compensation.fewer_blocks.refit import Refit as Refit
    from twin.compensation.programs.check import ProgramCheck as ProgramCheck
    from twin.compensation.programs.check import check_program
    from twin.compensation.programs.comparison import ThesisMethod
    from twin.compensation.programs.compensator import Compensation as Compensation
    from twin.compensation.programs.compensator import ProgramOutcome as ProgramOutcome
    from twin.compensation.programs.compensator import compensate_files
    from twin.compensation.programs.execute import Execution as Execution
    from twin.compensation.programs.execute import execute_file
    from twin.compensation.programs.report import Report as Report
    from twin.compensation.programs.words import Setup
    from twin.compute.parallel import Workers
    from twin.controls.offsets import OffsetTable as OffsetTable
    from twin.controls.offsets import ToolTable as ToolTable
    from twin.controls.offsets import load_offsets, load_tools
    from twin.diagnosis import diagnose
    from twin.diagnosis import plots as diagnosis_plots
    from twin.diagnosis.answer import Diagnosis as Diagnosis
    from twin.diagnosis.page import diagnosis_html
    from twin.diagnosis.result import Cause as Cause
    from twin.identification import identify
    from twin.identification import plots as identification_plots
    from twin.identification.result import Identification as Identification
    from twin.identification.thesis import ThesisIdentification as ThesisIdentification
    from twin.identification.thesis import identify_as_thesis
    from twin.machine.machine import Machine
    from twin.measurement import instruments
    from twin.measurement.certificate import Artefact
    from twin.measurement.formats import ConvertedFiles as ConvertedFiles
    from twin.measurement.formats import convert
    from twin.measurement.importing import import_table
    from twin.measurement.importing.importer import ImportedTable as ImportedTable
    from twin.measurement.simulate import Placement, simulate
    from twin.measurement.table import Measurements
    from twin.model.calibrated_urdf import CalibratedUrdf as CalibratedUrdf
    from twin.model.calibrated_urdf import calibrated_urdf
    from twin.model.calibration import Calibration
    from twin.model.conditions import Conditions, MachineLog
    from twin.model.effects.base import Effect as Effect
    from twin.model.effects.entries import effect_named
    from twin.model.iso16907 import Scope
    from twin.model.motion_curve import Curve
    from twin.monitoring import WatchSettings, compare, confirm, watch, written_values
    from twin.monitoring.comparison import Changes as Changes
    from twin.monitoring.confirmed import Confirmation as Confirmation
    from twin.monitoring.watch_page import watch_html
    from twin.monitoring.watched import Watch as Watch
    from twin.monitoring.written import WrittenValue as WrittenValue
    from twin.nc import read_program
    from twin.nc.blocks import Program as Program
    from twin.nc.dialect import Dialect as Dialect
    from twin.part.features import PartDrawing
    from twin.part.forecast import forecast
    from twin.part.forecasted import PartForecast as PartForecast
    from twin.planning import (
        InstrumentSizes,
        Kit,
        duration,
        judge,
        measuring_sequence,
        plan,
        plan_confirmation,
        separate,
    )
    from twin.planning import plots as planning_plots
    from twin.planning.confirmation import ConfirmationPlan as ConfirmationPlan
    from twin.planning.drift import DriftPlan as DriftPlan
    from twin.planning.drift import drift_plan
    from twin.planning.measure import SequencePlan as SequencePlan
    from twin.planning.plan import Forecast as Forecast
    from twin.planning.plan import Plan as Plan
    from twin.reporting.notebook import (
        axis_sliders,
        calibration_from_frame,
        error_field,
        measurements_from_frame,
        plot_curve,
        plot_field,
        plot_machine,
        to_frame,
    )
    from twin.reporting.result import MachineReport as MachineReport
    from twin.reporting.result import machine_report as report
    from twin.reporting.scene.draw import Scene as Scene
    from twin.reporting.scene.draw import draw_program as scene
    from twin.samples import thesis_plan
    from twin.standards import evaluate, evaluate_drift
    from twin.standards.page import evaluation_html
    from twin.standards.result import EvaluationResult as EvaluationResult
    from twin.thermal import ThermalRecord, fit_thermal
    from twin.thermal.model import ThermalModel as ThermalModel
    from twin.tool.forward import Kinematics
    from twin.tool.inverse import Inverse, Status
    from twin.tool.population import Population as Population
    from twin.tool.population import draw_machines
    from twin.tool.uncertainty import ToolUncertainty

__all__ = [
    "Artefact",
    "Calibration",
    "Compensator",
    "Conditions",
    "Curve",
    "InputError",
    "InstrumentSizes",
    "Inverse",
    "Kinematics",
    "Kit",
    "Machine",
    "MachineLog",
    "Measurements",
    "Options",
    "PartDrawing",
    "Placement",
    "Scope",
    "Setup",
    "Status",
    "ThermalRecord",
    "ThesisMethod",
    "ToolUncertainty",
    "WatchSettings",
    "Workers",
    "__version__",
    "axis_sliders",
    "calibrated_urdf",
    "calibration_from_frame",
    "check_program",
    "compare",
    "compensate",
    "compensate_file",
    "compensate_files",
    "confirm",
    "convert",
    "diagnose",
    "diagnosis_html",
    "diagnosis_plots",
    "draw_machines",
    "drift_plan",
    "duration",
    "effect_named",
    "error_field",
    "evaluate",
    "evaluate_drift",
    "evaluation_html",
    "execute_file",
    "find_program",
    "fit_thermal",
    "forecast",
    "identification_plots",
    "identify",
    "identify_as_thesis",
    "import_table",
    "instruments",
    "judge",
    "load_offsets",
    "load_tools",
    "measurements_from_frame",
    "measuring_sequence",
    "plan",
    "plan_confirmation",
    "planning_plots",
    "plot_curve",
    "plot_field",
    "plot_machine",
    "read_program",
    "refit",
    "report",
    "scene",
    "separate",
    "simulate",
    "thesis_plan",
    "to_frame",
    "watch",
    "watch_html",
    "written_values",
]


@cache
def _homes() -> dict[str, tuple[str, str]]:
    """Return module and attribute of every name that the imports above would give."""
    import ast  # a start of 6 ms that most commands do not need
    from pathlib import Path

    source = ast.parse(Path(__file__).read_text(encoding="utf-8"))
    imports = [node for block in source.body if isinstance(block, ast.If) for node in block.body]
    return {
        name.asname or name.name: (node.module or "", name.name)
        for node in imports
        if isinstance(node, ast.ImportFrom)
        for name in node.names
    }


def __getattr__(name: str) -> Any:
    """Import a name of the API from the module that defines it."""
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("twin")
    elif name in _homes():
        module, attribute = _homes()[name]
        value = getattr(import_module(module), attribute, None) or import_module(f"{module}.{attribute}")
    else:
        raise AttributeError(f"module 'twin' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({"__version__", *_homes()})
