"""``twin info``."""

from __future__ import annotations

from importlib.metadata import version

import numpy as np
from rich.console import Console
from rich.table import Table

from twin.budget import BudgetRow, error_budget, known_at
from twin.channels import options_of
from twin.cli.app import (
    CalibrationOption,
    MachineOption,
    TemperatureOption,
    TimeOption,
    ToolOption,
    app,
    calibration_of,
    tell_unused,
)
from twin.kinematics import Kinematics
from twin.machine import Machine
from twin.native import in_use
from twin.options import conditions
from twin.uncertainty import DEFINITION, ToolUncertainty


@app.command()
def info(
    machine: MachineOption = "dmu50",
    calibration: CalibrationOption = None,
    tool_length: ToolOption = None,
    temperature: TemperatureOption = None,
    time: TimeOption = None,
) -> None:
    """Axes, ranges, frames and the error budget of a machine."""
    loaded = Machine.load(machine)
    errors = calibration_of(calibration, loaded)
    at = conditions(temperature, time)
    at.check(errors)
    console = Console()
    console.print(f"[bold]{loaded.name}[/bold]   twin {version('twin')}")
    console.print(
        f"machine file  {loaded.path}\nURDF          {loaded.urdf}\ncalibration   {errors.path or 'none'}\n{errors.source}\n",
        highlight=False,
    )
    console.print(f"inverse       {in_use()}\n", highlight=False, markup=False, soft_wrap=True)
    axes = Table(
        "axis",
        "kind",
        "range",
        "least increment",
        "side",
        "joint",
        title="Axes, in command order",
        title_justify="left",
    )
    for axis in loaded.axes:
        span = "unlimited" if axis.lower is None else f"{axis.lower:g} … {axis.upper:g} {axis.unit}"
        axes.add_row(
            axis.name,
            "linear" if axis.linear else "rotary",
            span,
            f"{axis.increment:g} {axis.unit}",
            axis.side,
            axis.joint,
        )
    console.print(axes)
    frames = Table("frame", "of axis", "components", title="Error frames", title_justify="left")
    for frame in loaded.frames:
        frames.add_row(
            "error motion" if frame.role == "motion" else "location", frame.axis, " ".join(loaded.error_names(frame))
        )
    console.print(frames)
    console.print(
        f"tool frame {loaded.model.frames[loaded.tool_frame].name}, work frame {loaded.model.frames[loaded.work_frame].name}, "
        f"squareness {' '.join(loaded.squareness_names) or 'none'}, locations {' '.join(loaded.location_names) or 'none'}\n",
        highlight=False,
    )
    known, missing = known_at(at, errors)
    rows, classes = error_budget(loaded, known, tool_length_mm=tool_length, conditions=at)
    length = loaded.tool_length_mm if tool_length is None else tool_length
    console.print(
        _budget_table(f"Error budget at the tool over the volume, tool length {length:g} mm", rows, peak=True)
    )
    console.print(_budget_table("By class (ISO/TR 16907)", classes, peak=False))
    if any(row.illustrative for row in rows):
        console.print("* illustrative: drawn, not measured")
    if any(row.name.startswith("reversal:") for row in rows):
        console.print("a reversal counts as ± half its size", highlight=False)
    if at.channels:
        console.print(
            f"taken at: {', '.join(f'{name} {value:g}' for name, value in at.channels.items())}", highlight=False
        )
    tell_unused(at, errors)
    for channel, effects in missing.items():
        console.print(f"left out: {', '.join(effects)} (needs {options_of([channel])})", highlight=False)
    for line in _uncertainty_lines(Kinematics(loaded, known, tool_length_mm=tool_length, conditions=at)):
        console.print(line, highlight=False, soft_wrap=True)


def _uncertainty_lines(kinematics: Kinematics) -> list[str]:
    """What is known of the tool point over the volume, and what is not."""
    if kinematics.calibration.empty:
        return []
    found = ToolUncertainty(kinematics)
    missing = ", ".join(found.without_uncertainty)
    if not found.parameters:
        return ["uncertainty of the tool point: unknown (no covariance in the calibration)"]
    over = found.over_volume()
    place = ", ".join(f"{name} {round(value)}" for name, value in over.where.items())
    least = "at least " if missing else ""
    lines = [
        f"uncertainty of the tool point over the volume: U {least}{over.rms_um:.2f} µm RMS, {over.max_um:.2f} µm largest "
        f"(at {place}) over {len(over.positions)} poses; {DEFINITION}"
    ]
    return [*lines, f"not in it (no covariance in the calibration): {missing}"] if missing else lines


def _budget_table(title: str, rows: tuple[BudgetRow, ...], *, peak: bool) -> Table:
    known = any(np.isfinite(row.peak_u) for row in rows)
    headers = ["error", "class", "peak", *(["peak u (k = 1)"] if known else [])] if peak else ["class"]
    tilt = [] if peak else ["tool axis tilt RMS, about x / y"]
    table = Table(*headers, "tool RMS", "tool max", *tilt, title=title, title_justify="left")
    for row in rows:
        unit = "µm" if row.unit == "um" else "µrad"
        start = (
            [row.name + ("*" if row.illustrative and peak else ""), row.iso_class, f"{row.peak:.1f} {unit}"]
            if peak
            else [row.name]
        )
        if peak and known:
            start.append(f"{row.peak_u:.2f} {unit}" if np.isfinite(row.peak_u) else "unknown")
        leans = [] if peak else ["{:.1f} / {:.1f} µrad".format(*row.tilt_rms_urad)]
        table.add_row(*start, f"{row.tool_rms_um:.2f} µm", f"{row.tool_max_um:.2f} µm", *leans)
    return table
