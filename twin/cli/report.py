"""``twin report``."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from twin._common.files import write_json, write_whole
from twin._common.provenance import texts
from twin.cli.app import (
    NOT_ALL_MET,
    CalibrationOption,
    MachineOption,
    TemperatureOption,
    TimeOption,
    ToolOption,
    calibration_of,
    need_pictures,
    progress,
    tell_unused,
)
from twin.cli.options import conditions
from twin.cli.outputs import HTML, JsonOption, command
from twin.cli.terminal import echo
from twin.machine.machine import DEFAULT, Machine
from twin.measurement.table import load as load_measurements
from twin.report import MachineReport, machine_report


@command(
    "twin report -o machine.html --calibration mine.yaml --tool-length 120",
    "twin report -o machine.html -c mine.yaml --identified identified.json --measured measured.csv --json machine.json",
    "twin report -o warm.html -c better.yaml --temperature X=23.1 bed=21 --time 7200",
)
def report(
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The report: one HTML file, for screen and paper."), HTML
    ],
    machine: MachineOption = DEFAULT,
    calibration: CalibrationOption = None,
    tool_length: ToolOption = None,
    identified: Annotated[
        Path | None, typer.Option("--identified", help="What `twin identify --json` wrote beside the calibration.")
    ] = None,
    measured: Annotated[
        list[Path] | None,
        typer.Option("--measured", help="A measurement table to show against it; may be given again."),
    ] = None,
    temperature: TemperatureOption = None,
    time: TimeOption = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the draws of what is not known.")] = 0,
    json_file: JsonOption = None,
) -> None:
    """One page about a machine: what is wrong most, what it makes at the tool, what to do and what not, and what it rests on."""
    need_pictures("the report")
    loaded = Machine.load(machine)
    outputs = [path for path in (output, json_file) if path is not None]
    tables = measured or []
    errors = calibration_of(calibration, loaded)
    at = conditions(temperature, time)
    with progress() as say:
        say("reading", 0.0)
        found = machine_report(
            loaded,
            errors,
            made=datetime.now().astimezone(),
            tool_length_mm=tool_length,
            conditions=at,
            identified=identified,
            measured=[(path, load_measurements(path, loaded)) for path in tables],
            seed=seed,
            say=lambda stage, part: say(stage, 0.5 * part),
        )
        from twin.report.page import (
            machine_html,
        )  # matplotlib and meshcat take their time, and only this command needs them

        say("drawing", 0.5)
        page = machine_html(found)
    if json_file is not None:
        write_json(json_file, found.to_dict())
    write_whole(output, page)
    _tell(found)
    tell_unused(at, errors)
    echo(f"\nwritten: {', '.join(str(path) for path in outputs)}")
    if found.unmet:
        echo("\n".join(f"not met: {text}" for text in found.unmet))
        raise typer.Exit(NOT_ALL_MET)


def _tell(found: MachineReport) -> None:
    """The first screen, in a terminal."""
    if found.warnings:
        echo("\n".join(texts(found.warnings)) + "\n")
    echo(found.advice.headline)
    for line in found.advice.wrong:
        echo(f"  {line}")
    names = {"do": "do", "measure": "measure", "never": "do not", "unknown": "not known"}
    for step in found.advice.steps:
        echo(f"{names[step.kind]}: {step.title}. {step.text}")
    echo(found.datum)
