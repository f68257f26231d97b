"""``twin scene``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from twin._common.files import write_json
from twin._common.provenance import texts, to_json
from twin.cli import complete
from twin.cli.app import (
    NOT_ALL_MET,
    CalibrationOption,
    MachineOption,
    Mode,
    ModeOption,
    OffsetOption,
    OriginOption,
    TemperatureOption,
    TimeOption,
    ToolOption,
    calibration_of,
    progress,
    tell_unused,
)
from twin.cli.options import conditions, positive, setup
from twin.cli.outputs import HTML, JsonOption, command
from twin.cli.terminal import echo
from twin.machine.machine import DEFAULT, Machine
from twin.nc import find_program


@command(
    "twin scene cone_frustum.nc -o scene.html --tool-length 120",
    "twin scene part.nc -o scene.html --calibration mine.yaml --exaggeration 500 --json scene.json",
)
def scene(
    program: Annotated[
        Path, typer.Argument(help="NC program, or one that comes with twin.", autocompletion=complete.programs)
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The scene: one HTML file."), HTML],
    machine: MachineOption = DEFAULT,
    calibration: CalibrationOption = None,
    mode: ModeOption = Mode.axis,
    tool_length: ToolOption = None,
    work_offset: OffsetOption = None,
    work_origin: OriginOption = None,
    exaggeration: Annotated[float | None, typer.Option("--exaggeration", help="Factor on the drawn deviation.")] = None,
    temperature: TemperatureOption = None,
    time: TimeOption = None,
    json_file: JsonOption = None,
) -> None:
    """Draw the machine running a program: meant and actual tool path, in one HTML file that needs no network."""
    from twin.report.scene import draw_program  # meshcat takes its time, and only this command needs it

    loaded = Machine.load(machine)
    source = find_program(program)
    outputs = [path for path in (output, json_file) if path is not None]
    if exaggeration is not None:
        positive("--exaggeration", exaggeration)
    errors = calibration_of(calibration, loaded)
    at = conditions(temperature, time)
    with progress() as say:
        drawn = draw_program(
            source,
            loaded,
            errors,
            tool_length_mm=tool_length,
            tcp=mode is Mode.tcp,
            setup=setup(loaded, work_offset, work_origin),
            conditions=at,
            exaggeration=exaggeration,
            progress=say,
        )
    run = drawn.execution
    drawn.save(output)
    if json_file is not None:
        distance = np.linalg.norm(run.reached_mm - run.meant_mm, axis=1) * 1e3
        told = {
            "schema": "twin.scene/1",
            "scene": str(output),
            "program": str(source),
            "machine": loaded.name,
            "calibration": None if errors.path is None else str(errors.path),
            "illustrative": errors.illustrative,
            "warnings": to_json(errors.warnings),
            "tool_length_mm": loaded.tool_length_mm if tool_length is None else tool_length,
            "points": len(run.positions),
            "left_out": run.left_out,
            "deviation_um": {"rms": float(np.sqrt(np.mean(distance**2))), "max": float(distance.max())},
            "largest_at_line": int(run.lines[int(np.argmax(distance))]),
        }
        write_json(json_file, told)
    left = f" ({run.left_out} points outside the ranges left out)" if run.left_out else ""
    for text in texts(errors.warnings):
        echo(text)
    echo(f"written: {', '.join(str(path) for path in outputs)}{left}")
    tell_unused(at, errors)
    if run.left_out:
        raise typer.Exit(NOT_ALL_MET)
