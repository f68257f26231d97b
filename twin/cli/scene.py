"""``twin scene``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

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
    app,
    calibration_of,
    progress,
    tell_unused,
)
from twin.errors import InputError
from twin.execute import execute
from twin.files import check_writable, write_whole
from twin.kinematics import Kinematics
from twin.machine import Machine
from twin.nc import find_program, read_program
from twin.options import conditions, positive, setup
from twin.toolpath import WordSpace, follow


@app.command()
def scene(
    program: Annotated[Path, typer.Argument(help="NC program, or one that comes with twin.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The scene: one HTML file.")],
    machine: MachineOption = "dmu50",
    calibration: CalibrationOption = None,
    mode: ModeOption = Mode.axis,
    tool_length: ToolOption = None,
    work_offset: OffsetOption = None,
    work_origin: OriginOption = None,
    exaggeration: Annotated[float | None, typer.Option("--exaggeration", help="Factor on the drawn deviation.")] = None,
    temperature: TemperatureOption = None,
    time: TimeOption = None,
) -> None:
    """Draw the machine running a program: meant and actual tool path, in one HTML file that needs no network.

    twin scene part.nc -o scene.html --tool-length 120
    """
    from twin.scene import ScenePath, scene_html  # meshcat takes its time, and only this command needs it

    loaded = Machine.load(machine)
    source = find_program(program)
    read, dialect = read_program(source)
    check_writable([output])
    if exaggeration is not None:
        positive("--exaggeration", exaggeration)
    errors = calibration_of(calibration, loaded)
    at = conditions(temperature, time)
    at.require(errors)
    real = Kinematics(loaded, errors, tool_length_mm=tool_length, conditions=at)
    space = WordSpace(loaded, setup(loaded, work_offset, work_origin), tool_length)
    with progress() as say:
        say("reading", 0.0)
        path = follow(read, dialect.moves(read, space.axes, tcp=mode is Mode.tcp), space)
        say("running", 0.2)
        run = execute(read, path, space, real)
        if len(run.positions) < 2:
            raise InputError(
                "nothing to draw: no motion within the machine's ranges", expected="a program with motion", file=source
            )
        say("drawing", 0.5)
        drawn = ScenePath(run.positions, run.meant_mm, run.reached_mm, run.cutting, run.lines)
        html = scene_html(
            real,
            drawn,
            title=f"{source.name} on {loaded.name}",
            exaggeration=exaggeration,
            illustrative=errors.illustrative,
        )
    write_whole(output, html)
    left = f" ({run.left_out} points outside the ranges left out)" if run.left_out else ""
    print(f"written: {output}{left}")
    tell_unused(at, errors)
    if run.left_out:
        raise typer.Exit(NOT_ALL_MET)
