"""twin: a digital twin of a five-axis machine tool that finds, from measurements, where its own model is wrong.

`import twin` gives every name that notebooks and scripts need; each is imported when it is first used (PEP 562):

- machine and model: `Machine`, `Calibration`, `Curve`, `Conditions`, `MachineLog`, `effect_named`, `Kinematics`, `Inverse`;
- measurements: `Measurements`, `import_table`, `convert`, `instruments`, `simulate`, `Placement`, `Kit`, `plan`, `judge`, `separate`,
  `duration`, `measuring_sequence`, `InstrumentSizes`, `thesis_plan`;
- identification: `identify`, `ToolUncertainty`, `compare`, `calibrated_urdf`, `draw_machines`, `identify_as_thesis`;
- checks over time: `watch`, `WatchSettings`, `watch_html`;
- standard tests (ISO 230, ISO 10791-6): `evaluate`, `evaluate_drift`, `evaluation_html`;
- thermal models: `ThermalRecord`, `fit_thermal`;
- diagnosis: `diagnose`, `diagnosis_html`;
- programs: `compensate`, `compensate_file`, `compensate_files`, `Compensator`, `Options`, `Scope`, `Setup`, `Workers`, `execute_file`,
  `read_program`, `find_program`, `load_offsets`, `load_tools`, `refit`, `ThesisMethod`;
- notebooks: `to_frame`, `calibration_from_frame`, `measurements_from_frame` (pandas), `error_field` (xarray), `plot_curve`,
  `plot_field`, `plot_machine` (matplotlib axes), `axis_sliders` (ipywidgets); extra ``notebook``;
- pages and pictures: `report`, `scene`, `identification_plots`, `diagnosis_plots`, `planning_plots` (modules; extra ``plots``);
- `InputError`: raised for every bad input, with file, line, value and what was expected.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin._common.bundled import find_program
    from twin._common.errors import InputError
    from twin.comparison import compare
    from twin.compensation import Compensator, Options, compensate, compensate_file
    from twin.compensation.execute import execute_file
    from twin.compensation.fewer_blocks import refit
    from twin.compensation.many import compensate_files
    from twin.compensation.thesis import ThesisMethod
    from twin.compensation.toolpath import Setup
    from twin.compute.parallel import Workers
    from twin.diagnosis import diagnose
    from twin.diagnosis.wording import plots as diagnosis_plots
    from twin.diagnosis.wording.report import diagnosis_html
    from twin.identification import identify
    from twin.identification import plots as identification_plots
    from twin.identification.thesis.identify import identify_as_thesis
    from twin.kinematics.forward import Kinematics
    from twin.kinematics.inverse import Inverse, Status
    from twin.machine.calibrated_urdf import calibrated_urdf
    from twin.machine.calibration import Calibration
    from twin.machine.conditions import Conditions
    from twin.machine.effects.entries import effect_named
    from twin.machine.iso16907 import Scope
    from twin.machine.machine import Machine
    from twin.machine.machine_log import MachineLog
    from twin.machine.motion_curve import Curve
    from twin.measurement import instruments
    from twin.measurement.formats import convert
    from twin.measurement.importing import import_table
    from twin.measurement.simulate import Placement, simulate
    from twin.measurement.table import Measurements
    from twin.nc import read_program
    from twin.nc.tables import load_offsets, load_tools
    from twin.notebook.field import error_field
    from twin.notebook.frames import calibration_from_frame, measurements_from_frame, to_frame
    from twin.notebook.plots import plot_curve, plot_field, plot_machine
    from twin.notebook.sliders import axis_sliders
    from twin.planning import InstrumentSizes, Kit, duration, judge, measuring_sequence, plan, separate
    from twin.planning import plots as planning_plots
    from twin.planning.drift import drift_plan
    from twin.reporting import machine_report as report
    from twin.reporting.scene.program import draw_program as scene
    from twin.samples import thesis_plan
    from twin.standards import evaluate, evaluate_drift
    from twin.standards.page import evaluation_html
    from twin.thermal import ThermalRecord, fit_thermal
    from twin.uncertainty.at_tool import ToolUncertainty
    from twin.uncertainty.population import draw_machines
    from twin.watching import WatchSettings, watch
    from twin.watching.page import watch_html

__all__ = [
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
    "compare",
    "compensate",
    "compensate_file",
    "compensate_files",
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
]

_MODULES = {
    "diagnosis_plots": "twin.diagnosis.wording.plots",
    "identification_plots": "twin.identification.plots",
    "instruments": "twin.measurement.instruments",
    "planning_plots": "twin.planning.plots",
    "thesis_plan": "twin.samples.thesis_plan",
}
_HOMES = {
    "Calibration": ("twin.machine.calibration", "Calibration"),
    "Compensator": ("twin.compensation", "Compensator"),
    "Conditions": ("twin.machine.conditions", "Conditions"),
    "Curve": ("twin.machine.motion_curve", "Curve"),
    "InputError": ("twin._common.errors", "InputError"),
    "Inverse": ("twin.kinematics.inverse", "Inverse"),
    "Kinematics": ("twin.kinematics.forward", "Kinematics"),
    "Kit": ("twin.planning", "Kit"),
    "Machine": ("twin.machine.machine", "Machine"),
    "MachineLog": ("twin.machine.machine_log", "MachineLog"),
    "Measurements": ("twin.measurement.table", "Measurements"),
    "Options": ("twin.compensation", "Options"),
    "Placement": ("twin.measurement.simulate", "Placement"),
    "InstrumentSizes": ("twin.planning", "InstrumentSizes"),
    "Scope": ("twin.machine.iso16907", "Scope"),
    "Setup": ("twin.compensation.toolpath", "Setup"),
    "Status": ("twin.kinematics.inverse", "Status"),
    "ThermalRecord": ("twin.thermal", "ThermalRecord"),
    "ThesisMethod": ("twin.compensation.thesis", "ThesisMethod"),
    "ToolUncertainty": ("twin.uncertainty.at_tool", "ToolUncertainty"),
    "WatchSettings": ("twin.watching", "WatchSettings"),
    "Workers": ("twin.compute.parallel", "Workers"),
    "calibrated_urdf": ("twin.machine.calibrated_urdf", "calibrated_urdf"),
    "compare": ("twin.comparison", "compare"),
    "compensate": ("twin.compensation", "compensate"),
    "compensate_file": ("twin.compensation", "compensate_file"),
    "compensate_files": ("twin.compensation.many", "compensate_files"),
    "convert": ("twin.measurement.formats", "convert"),
    "diagnose": ("twin.diagnosis", "diagnose"),
    "diagnosis_html": ("twin.diagnosis.wording.report", "diagnosis_html"),
    "draw_machines": ("twin.uncertainty.population", "draw_machines"),
    "drift_plan": ("twin.planning.drift", "drift_plan"),
    "duration": ("twin.planning", "duration"),
    "effect_named": ("twin.machine.effects.entries", "effect_named"),
    "evaluate": ("twin.standards", "evaluate"),
    "evaluate_drift": ("twin.standards", "evaluate_drift"),
    "evaluation_html": ("twin.standards.page", "evaluation_html"),
    "execute_file": ("twin.compensation.execute", "execute_file"),
    "find_program": ("twin._common.bundled", "find_program"),
    "fit_thermal": ("twin.thermal", "fit_thermal"),
    "identify": ("twin.identification", "identify"),
    "identify_as_thesis": ("twin.identification.thesis.identify", "identify_as_thesis"),
    "import_table": ("twin.measurement.importing", "import_table"),
    "judge": ("twin.planning", "judge"),
    "measuring_sequence": ("twin.planning", "measuring_sequence"),
    "plan": ("twin.planning", "plan"),
    "error_field": ("twin.notebook.field", "error_field"),
    "calibration_from_frame": ("twin.notebook.frames", "calibration_from_frame"),
    "measurements_from_frame": ("twin.notebook.frames", "measurements_from_frame"),
    "to_frame": ("twin.notebook.frames", "to_frame"),
    "plot_curve": ("twin.notebook.plots", "plot_curve"),
    "plot_field": ("twin.notebook.plots", "plot_field"),
    "plot_machine": ("twin.notebook.plots", "plot_machine"),
    "axis_sliders": ("twin.notebook.sliders", "axis_sliders"),
    "load_offsets": ("twin.nc.tables", "load_offsets"),
    "load_tools": ("twin.nc.tables", "load_tools"),
    "read_program": ("twin.nc", "read_program"),
    "refit": ("twin.compensation.fewer_blocks", "refit"),
    "report": ("twin.reporting", "machine_report"),
    "scene": ("twin.reporting.scene.program", "draw_program"),
    "separate": ("twin.planning", "separate"),
    "simulate": ("twin.measurement.simulate", "simulate"),
    "watch": ("twin.watching", "watch"),
    "watch_html": ("twin.watching.page", "watch_html"),
}
"""Modules of the API, and module and attribute of every other name."""


def __getattr__(name: str) -> Any:
    """Import a name of the API from the module that defines it."""
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("twin")
    elif name in _MODULES:
        value = import_module(_MODULES[name])
    elif name in _HOMES:
        module, attribute = _HOMES[name]
        value = getattr(import_module(module), attribute)
    else:
        raise AttributeError(f"module 'twin' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
