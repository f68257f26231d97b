"""Command ``twin info``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, final

import typer

from twin._common.bundled import DEFAULT
from twin._common.errors import InputError, printable
from twin._common.provenance import warning_texts, warnings_to_json
from twin.cli.shared import options
from twin.cli.shared.command import CALIBRATION, URDF, CommandResult, JsonOption, command, progress_bar

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from twin.model.calibration import Calibration
    from twin.tool.forward import Kinematics
    from twin.tool.uncertainty import BudgetRow, UncertaintyMap

SCHEMA = "twin.info/1"


class DatumChoice(StrEnum):
    """Datum to which a calibration is converted."""

    mean_lines = "mean lines"
    end_points = "end points"


@command(
    "twin info",
    "twin info --machine trunnion_ac",
    "twin info --calibration mine.yaml --tool-length 120 --json budget.json",
    "twin info --calibration other.yaml --datum 'mean lines' -o mine.yaml",
    "twin info --calibration mine.yaml --urdf calibrated.urdf",
)
def info(
    machine: options.MachineOption = DEFAULT,
    calibration: options.CalibrationOption = None,
    tool_length: options.ToolOption = None,
    temperature: options.TemperatureOption = None,
    time: options.TimeOption = None,
    rpm: options.RpmOption = None,
    load: options.LoadOption = None,
    datum: Annotated[
        DatumChoice | None,
        typer.Option("--datum", help="Datum to which the calibration is converted first (twin doc datum)."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write the converted calibration, with --datum."), CALIBRATION
    ] = None,
    urdf: Annotated[
        Path | None,
        typer.Option("--urdf", help="Write the machine's URDF with squareness, axis locations and zero offsets."),
        URDF,
    ] = None,
    json_file: JsonOption = None,
) -> CommandResult:
    """Show axes, ranges, frames and error budget of a machine; convert its calibration to another datum, or calibrate its URDF."""
    if output is not None and datum is None:
        raise InputError("--output needs --datum", expected="--datum with --output", file=output)
    from twin.model.calibrated_urdf import calibrated_urdf
    from twin.tool.forward import Kinematics
    from twin.tool.uncertainty import ToolUncertainty, error_budget, without_missing_channels

    loaded = options.machine(machine)
    given = options.calibration_of(calibration, loaded)
    errors = given if datum is None else given.in_datum(datum.value)
    at = options.conditions(temperature, time, rpm, load)
    at.check(errors)
    known, missing = without_missing_channels(at, errors)
    kinematics = Kinematics(loaded, known, tool_length_mm=tool_length, conditions=at)
    with progress_bar() as bar:
        bar("budget", 0.0)
        rows, classes = error_budget(loaded, known, tool_length_mm=tool_length, conditions=at)
        bar("uncertainty", 0.8)
        uncertainty = ToolUncertainty(kinematics)
        over = uncertainty.over_volume() if uncertainty.parameters else None
    if output is not None:
        errors.save(output)
    after = []
    if urdf is not None:
        calibrated = calibrated_urdf(errors)
        calibrated.save(urdf)
        after.append(calibrated.brief)
    info = _Info(given, errors, kinematics, missing, rows, classes, over, list(uncertainty.without_uncertainty))
    return CommandResult("", info.to_dict, show=info.show, after=after)


@final
@dataclass(frozen=True)
class _Info:
    """Content of the output of `twin info`."""

    given: Calibration  # the calibration as in its file
    errors: Calibration  # the calibration in the requested datum
    kinematics: Kinematics  # with the errors that can be evaluated at the conditions
    missing: Mapping[str, tuple[str, ...]]  # effects omitted for want of a channel, by channel
    rows: tuple[BudgetRow, ...]  # the error budget by error and by class
    classes: tuple[BudgetRow, ...]
    over: UncertaintyMap | None  # U of the tool point over the volume; None without a covariance
    without: list[str]  # names of the errors without a covariance

    def to_dict(self) -> dict[str, Any]:
        """Return the printed content for JSON; null for unknown values."""
        from importlib.metadata import version

        from twin._common.records import json_form
        from twin.compute.native.compiler import solver_description

        machine, errors = self.errors.machine, self.errors
        return {
            "schema": SCHEMA,
            "twin": version("twin"),
            "machine": machine.name,
            "machine_file": str(machine.path),
            "urdf": str(machine.urdf),
            "source": errors.source,
            "illustrative": errors.illustrative,
            "warnings": warnings_to_json(errors.warnings),
            "inverse": solver_description(),
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
            "tool_length_mm": self.kinematics.tool_length_mm,
            "conditions": dict(self.kinematics.conditions.channels),
            **{
                key: [json_form(row, rename={"iso_class": "class"}) | {"unit": row.unit or None} for row in rows]
                for key, rows in (("errors", self.rows), ("classes", self.classes))
            },
            "uncertainty": (self.over.to_dict() if self.over is not None else {"known": False})
            | {"without_uncertainty": self.without},
            "calibration": None if self.given.path is None else str(self.given.path),
            "datum": {"given": self.given.datum, "shown": errors.datum},
            "left_out": json_form(self.missing),
        }

    def show(self) -> None:
        """Print the content."""
        from rich.console import Console

        from twin.model.conditions import needed_values
        from twin.model.datum import EXPLANATION

        console = Console(markup=False, emoji=False, highlight=False)  # names and sources in files are plain text
        self._show_machine(console)
        title = f"Error budget at the tool over the volume, tool length {self.kinematics.tool_length_mm:g} mm"
        console.print(_budget_table(title, self.rows, peak=True))
        console.print(_budget_table("By class (ISO/TR 16907)", self.classes, peak=False))
        at = self.kinematics.conditions
        lines = [EXPLANATION[self.errors.datum]]
        if any(row.illustrative for row in self.rows):
            lines.append("* illustrative: assumed, not measured")
        lines += warning_texts(self.errors.warnings)
        if any(row.name.startswith("reversal") for row in self.rows):
            lines.append("a reversal value contributes ± half its size")
        if at.channels:
            lines.append(f"conditions: {', '.join(f'{name} {value:g}' for name, value in at.channels.items())}")
        lines += options.unused(at, self.errors)
        for channel, effects in self.missing.items():
            lines.append(f"omitted: {', '.join(effects)} (needs {needed_values([channel])})")
        if not self.kinematics.calibration.empty:
            lines += _uncertainty_lines(self.over, self.without)
        for line in lines:
            console.print(line, soft_wrap=True)

    def _show_machine(self, console: Console) -> None:
        from importlib.metadata import version

        from rich.table import Table

        from twin.compute.native.compiler import solver_description

        machine, given, shown = self.errors.machine, self.given, self.errors
        console.print(machine.name, style="bold", end="")
        console.print(f"   twin {version('twin')}")
        files = f"machine file  {machine.path}\nURDF          {machine.urdf}\ncalibration   {given.path or 'none'}\n{shown.source}\n"
        console.print(printable(files))
        datum = shown.datum if shown is given else f"{shown.datum}, converted from {given.datum}"
        console.print(f"datum         {datum}", soft_wrap=True)
        console.print(f"inverse       {solver_description()}\n", soft_wrap=True)
        headers = ("axis", "kind", "range", "least increment", "side", "joint")
        axes = Table(*headers, title="Axes, in command order", title_justify="left")
        for axis in machine.axes:
            kind = "linear" if axis.linear else "rotary"
            span = "unlimited" if axis.lower is None else f"{axis.lower:g} … {axis.upper:g} {axis.unit}"
            axes.add_row(axis.name, kind, span, f"{axis.increment:g} {axis.unit}", axis.side, axis.joint)
        console.print(axes)
        frames = Table("frame", "of axis", "components", title="Error frames", title_justify="left")
        for frame in machine.frames:
            kind = "error motion" if frame.role == "motion" else "location"
            frames.add_row(kind, frame.axis, " ".join(machine.error_names(frame)))
        console.print(frames)
        tool, work = (machine.model.frames[frame].name for frame in (machine.tool_frame, machine.work_frame))
        console.print(
            f"tool frame {tool}, work frame {work}, squareness {' '.join(machine.squareness_names) or 'none'}, "
            f"locations {' '.join(machine.location_names) or 'none'}\n"
        )


def _uncertainty_lines(over: UncertaintyMap | None, without: list[str]) -> list[str]:
    from twin.tool.uncertainty import DEFINITION

    missing = ", ".join(without)
    if over is None:
        return ["uncertainty of the tool point: unknown (no covariance in the calibration)"]
    place = ", ".join(f"{name} {round(value)}" for name, value in over.where.items())
    least = "at least " if missing else ""
    lines = [
        f"uncertainty of the tool point over the volume: U {least}{over.rms_um:.2f} µm RMS, {over.max_um:.2f} µm largest "
        f"(at {place}) over {len(over.positions)} poses; {DEFINITION}"
    ]
    return [*lines, f"not included (no covariance in the calibration): {missing}"] if missing else lines


def _budget_table(title: str, rows: tuple[BudgetRow, ...], *, peak: bool) -> Table:
    from rich.table import Table

    known = any(isfinite(row.peak_u) for row in rows)
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
            start.append(f"{row.peak_u:.2f} {unit}" if isfinite(row.peak_u) else "unknown")
        leans = [] if peak else ["{:.1f} / {:.1f} µrad".format(*row.tilt_rms_urad)]
        table.add_row(*start, f"{row.tool_rms_um:.2f} µm", f"{row.tool_max_um:.2f} µm", *leans)
    return table
