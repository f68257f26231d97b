"""``twin path``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin._common.files import write_json, write_whole
from twin.cli import complete
from twin.cli.app import (
    NOT_ALL_MET,
    CalibrationOption,
    MachineOption,
    Mode,
    ModeOption,
    OffsetOption,
    OriginOption,
    RotaryLimitOption,
    ScopeOption,
    StrictOption,
    TemperatureOption,
    TimeOption,
    ToolOption,
    calibration_of,
    progress,
)
from twin.cli.options import conditions, positive, setup
from twin.cli.outputs import ANY, JsonOption, command
from twin.cli.terminal import echo
from twin.compensation import Options
from twin.compensation.fewer_blocks import refit
from twin.compensation.fewer_blocks.points import is_points
from twin.compensation.fewer_blocks.refit import DEFAULT_TOLERANCE_MM
from twin.kinematics.inverse import DEFAULT_ROTARY_LIMIT_DEG
from twin.machine.iso16907 import Scope
from twin.machine.machine import DEFAULT, Machine
from twin.nc import find_program


@command(
    "twin path cone_frustum.nc -o fewer.nc --tolerance 0.02 --tool-length 120 --json fewer.json",
    "twin path points.csv -o points.nc --no-compensate --feed 2000",
)
def path(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="INPUT",
            help="NC program: ISO, Heidenhain .h, APT .cls, or one that comes with twin; or points: .csv with x_mm,y_mm,z_mm and "
            "nothing more, one column a rotary axis (B_deg,C_deg), or a tool vector i,j,k.",
            autocompletion=lambda incomplete: complete.programs(incomplete) + complete.tables(incomplete),
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The program with fewer blocks."), ANY],
    machine: MachineOption = DEFAULT,
    calibration: CalibrationOption = None,
    tolerance: Annotated[
        float, typer.Option("--tolerance", help="mm the executed path may be from the input's, everything included.")
    ] = DEFAULT_TOLERANCE_MM,
    compensated: Annotated[
        bool,
        typer.Option("--compensate/--no-compensate", help="Whether the machine's errors are compensated, too."),
    ] = True,
    mode: ModeOption = Mode.axis,
    tool_length: ToolOption = None,
    work_offset: OffsetOption = None,
    work_origin: OriginOption = None,
    feed: Annotated[float | None, typer.Option("--feed", help="mm/min, for points: a program has its own.")] = None,
    scope: ScopeOption = None,
    rotary_limit: RotaryLimitOption = DEFAULT_ROTARY_LIMIT_DEG,
    temperature: TemperatureOption = None,
    time: TimeOption = None,
    strict: StrictOption = False,
    json_file: JsonOption = None,
) -> None:
    """Write the same path with fewer blocks: runs of short ones fitted by curves, and those cut as coarsely as a tolerance allows.

    The tolerance holds for the path the machine with its errors executes; corners stay corners, everything that is no run passes
    through as it is.
    """
    loaded = Machine.load(machine)
    positive("--tolerance", tolerance)
    positive("--rotary-limit", rotary_limit)
    if feed is not None:
        positive("--feed", feed)
    found = source if is_points(source) else find_program(source)
    outputs = [one for one in (output, json_file) if one is not None]
    options = Options(
        setup=setup(loaded, work_offset, work_origin),
        tool_length_mm=tool_length,
        tcp=mode is Mode.tcp,
        scope=None if scope is None else Scope.parse(scope),
        tolerance_mm=tolerance,
        rotary_limit_deg=rotary_limit,
        conditions=conditions(temperature, time),
    )
    errors = calibration_of(calibration, loaded)
    with progress() as say:
        result = refit(
            found, loaded, errors, options=options, compensated=compensated, output=output, feed=feed, progress=say
        )
    write_whole(output, result.text.encode("latin-1"))
    if json_file is not None:
        write_json(json_file, result.report.to_dict())
    echo(result.report.to_text(), end="")
    echo(f"\nwritten: {', '.join(str(one) for one in outputs)}")
    if not (result.report.strictly_complete if strict else result.report.complete):
        raise typer.Exit(NOT_ALL_MET)
