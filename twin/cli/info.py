"""``twin info``."""

from __future__ import annotations

from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from twin._common.errors import InputError, printable
from twin._common.files import write_json
from twin._common.provenance import texts, to_json
from twin.cli.app import (
    CalibrationOption,
    MachineOption,
    TemperatureOption,
    TimeOption,
    ToolOption,
    calibration_of,
    progress,
    tell_unused,
)
from twin.cli.options import conditions
from twin.cli.outputs import CALIBRATION, JsonOption, command
from twin.compute.native import in_use
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.machine.conditions import options_of
from twin.machine.datum import MEANING
from twin.machine.machine import DEFAULT, Machine
from twin.uncertainty.at_tool import DEFINITION, ToolUncertainty, UncertaintyMap
from twin.uncertainty.budget import BudgetRow, error_budget, known_at

SCHEMA = "twin.info/1"


class DatumChoice(StrEnum):
    """A datum to convert to."""

    mean_lines = "mean lines"
    end_points = "end points"


@command(
    "twin info",
    "twin info --machine trunnion_ac",
    "twin info --calibration mine.yaml --tool-length 120 --json budget.json",
    "twin info --calibration other.yaml --datum 'mean lines' -o mine.yaml",
)
def info(
    machine: MachineOption = DEFAULT,
    calibration: CalibrationOption = None,
    tool_length: ToolOption = None,
    temperature: TemperatureOption = None,
    time: TimeOption = None,
    datum: Annotated[
        DatumChoice | None,
        typer.Option("--datum", help="Convert the calibration to this datum first; the same machine (twin doc datum)."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write the calibration in that datum."), CALIBRATION
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Axes, ranges, frames and the error budget of a machine, and its calibration in another datum."""
    loaded = Machine.load(machine)
    outputs = [str(path) for path in (output, json_file) if path is not None]
    if output is not None and datum is None:
        raise InputError("nothing to convert to", expected="--datum beside --output", file=output)
    given = calibration_of(calibration, loaded)
    errors = given if datum is None else given.in_datum(datum.value)
    at = conditions(temperature, time)
    at.check(errors)
    known, missing = known_at(at, errors)
    kinematics = Kinematics(loaded, known, tool_length_mm=tool_length, conditions=at)
    with progress() as say:
        say("budget", 0.0)
        rows, classes = error_budget(loaded, known, tool_length_mm=tool_length, conditions=at)
        say("uncertainty", 0.8)
        over, without = _uncertainty(kinematics)
    if output is not None:
        errors.save(output)
    if json_file is not None:
        told = _told(loaded, errors, kinematics, rows, classes)
        told["uncertainty"] = {
            **(over.to_dict() if over is not None else {"known": False}),
            "without_uncertainty": without,
        }
        told["calibration"] = None if given.path is None else str(given.path)
        told["datum"] = {"given": given.datum, "shown": errors.datum}
        told["left_out"] = {channel: list(by) for channel, by in missing.items()}
        write_json(json_file, told)
    console = Console(markup=False, emoji=False, highlight=False)  # names and sources of files are text as it stands
    console.print(loaded.name, style="bold", end="")
    console.print(f"   twin {version('twin')}")
    files = f"machine file  {loaded.path}\nURDF          {loaded.urdf}\ncalibration   {given.path or 'none'}\n{errors.source}\n"
    console.print(printable(files))
    console.print(f"datum         {_datum_text(given, errors)}", soft_wrap=True)
    console.print(f"inverse       {in_use()}\n", soft_wrap=True)
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
        f"squareness {' '.join(loaded.squareness_names) or 'none'}, locations {' '.join(loaded.location_names) or 'none'}\n"
    )
    title = f"Error budget at the tool over the volume, tool length {kinematics.tool_length_mm:g} mm"
    console.print(_budget_table(title, rows, peak=True))
    console.print(_budget_table("By class (ISO/TR 16907)", classes, peak=False))
    console.print(MEANING[errors.datum], soft_wrap=True)
    if any(row.illustrative for row in rows):
        console.print("* illustrative: drawn, not measured")
    for text in texts(errors.warnings):
        console.print(text, highlight=False, markup=False, soft_wrap=True)
    if any(row.name.startswith("reversal") for row in rows):
        console.print("a reversal counts as ± half its size")
    if at.channels:
        console.print(f"taken at: {', '.join(f'{name} {value:g}' for name, value in at.channels.items())}")
    tell_unused(at, errors)
    for channel, effects in missing.items():
        console.print(f"left out: {', '.join(effects)} (needs {options_of([channel])})")
    if not known.empty:
        for line in _uncertainty_lines(over, without):
            console.print(line, soft_wrap=True)
    if outputs:
        console.print(printable(f"\nwritten: {', '.join(outputs)}"), soft_wrap=True)


def _uncertainty(kinematics: Kinematics) -> tuple[UncertaintyMap | None, list[str]]:
    """U over the volume, None if nothing has a covariance; and what has none."""
    found = ToolUncertainty(kinematics)
    return found.over_volume() if found.parameters else None, list(found.without_uncertainty)


def _datum_text(given: Calibration, shown: Calibration) -> str:
    return shown.datum if shown is given else f"{shown.datum}, converted from {given.datum}"


def _told(
    machine: Machine,
    calibration: Calibration,
    kinematics: Kinematics,
    rows: tuple[BudgetRow, ...],
    classes: tuple[BudgetRow, ...],
) -> dict[str, Any]:
    """For JSON: what is printed; null where it is unknown."""
    return {
        "schema": SCHEMA,
        "twin": version("twin"),
        "machine": machine.name,
        "machine_file": str(machine.path),
        "urdf": str(machine.urdf),
        "source": calibration.source,
        "illustrative": calibration.illustrative,
        "warnings": to_json(calibration.warnings),
        "inverse": in_use(),
        "axes": [
            {
                "name": axis.name,
                "kind": "linear" if axis.linear else "rotary",
                "range": None if axis.lower is None else [axis.lower, axis.upper],
                "unit": axis.unit,
                "least_increment": axis.increment,
                "side": axis.side,
                "joint": axis.joint,
            }
            for axis in machine.axes
        ],
        "error_frames": [
            {"axis": frame.axis, "role": frame.role, "components": list(machine.error_names(frame))}
            for frame in machine.frames
        ],
        "squareness": list(machine.squareness_names),
        "location": list(machine.location_names),
        "tool_length_mm": kinematics.tool_length_mm,
        "conditions": dict(kinematics.conditions.channels),
        "errors": [_row(row) for row in rows],
        "classes": [_row(row) for row in classes],
    }


def _row(row: BudgetRow) -> dict[str, Any]:
    return {
        "name": row.name,
        "class": row.iso_class,
        "unit": row.unit or None,
        "peak": row.peak if np.isfinite(row.peak) else None,
        "peak_u": row.peak_u if np.isfinite(row.peak_u) else None,
        "tool_rms_um": row.tool_rms_um,
        "tool_max_um": row.tool_max_um,
        "tilt_rms_urad": list(row.tilt_rms_urad),
        "tilt_max_urad": list(row.tilt_max_urad),
        "illustrative": row.illustrative,
    }


def _uncertainty_lines(over: UncertaintyMap | None, without: list[str]) -> list[str]:
    """What is known of the tool point over the volume, and what is not."""
    missing = ", ".join(without)
    if over is None:
        return ["uncertainty of the tool point: unknown (no covariance in the calibration)"]
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
