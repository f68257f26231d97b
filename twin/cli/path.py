"""Command ``twin path``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin._common.bundled import DEFAULT, DEFAULT_ROTARY_LIMIT_DEG, DEFAULT_TOLERANCE_MM
from twin._common.files import write_atomic
from twin.cli.shared import complete, options
from twin.cli.shared.command import ANY, POSITIVE, PROGRAM, CommandResult, JsonOption, command, progress_bar

SourceArgument = Annotated[
    Path,
    typer.Argument(
        metavar="INPUT",
        help="NC program (ISO, Heidenhain .h, APT .cls, or a bundled one), or points: .csv with x_mm,y_mm,z_mm and optionally "
        "one column per rotary axis (B_deg,C_deg) or a tool vector i,j,k.",
        autocompletion=lambda incomplete: complete.programs(incomplete) + complete.tables(incomplete),
    ),
    PROGRAM,
]


@command(
    "twin path cone_frustum.nc -o fewer.nc --tolerance 0.02 --tool-length 120 --json fewer.json",
    "twin path points.csv -o points.nc --no-compensate --feed 2000",
)
def path(
    source: SourceArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="Program with fewer blocks."), ANY],
    machine: options.MachineOption = DEFAULT,
    calibration: options.CalibrationOption = None,
    tolerance: Annotated[
        float,
        typer.Option("--tolerance", help="Largest total deviation of the executed path from the programmed one, mm."),
        POSITIVE,
    ] = DEFAULT_TOLERANCE_MM,
    compensated: Annotated[
        bool, typer.Option("--compensate/--no-compensate", help="Also compensate the machine's errors.")
    ] = True,
    mode: options.ModeOption = options.Mode.axis,
    language: options.LanguageOption = None,
    tool_length: options.ToolOption = None,
    work_offset: options.OffsetOption = None,
    work_origin: options.OriginOption = None,
    feed: Annotated[
        float | None, typer.Option("--feed", help="Feed, mm/min; for a table of points only."), POSITIVE
    ] = None,
    scope: options.ScopeOption = None,
    rotary_limit: options.RotaryLimitOption = DEFAULT_ROTARY_LIMIT_DEG,
    temperature: options.TemperatureOption = None,
    time: options.TimeOption = None,
    rpm: options.RpmOption = None,
    load: options.LoadOption = None,
    strict: options.StrictOption = False,
    json_file: JsonOption = None,
) -> CommandResult:
    """Reduce the number of blocks of a program: fit curves to runs of short blocks and split them again within a tolerance.

    The tolerance applies to the path executed by the machine with its errors. Corners and blocks outside such runs are kept.
    """
    from twin._common.bundled import find_program
    from twin.compensation import Options
    from twin.compensation.fewer_blocks import refit
    from twin.compensation.fewer_blocks.emit import is_points
    from twin.model.iso16907 import Scope

    loaded = options.machine(machine)
    found = source if is_points(source) else find_program(source)
    settings = Options(
        setup=options.setup(loaded, work_offset, work_origin),
        tool_length_mm=tool_length,
        tcp=mode is options.Mode.tcp,
        scope=None if scope is None else Scope.parse(scope),
        tolerance_mm=tolerance,
        rotary_limit_deg=rotary_limit,
        conditions=options.conditions(temperature, time, rpm, load),
        language=language,
    )
    errors = options.calibration_of(calibration, loaded)
    with progress_bar() as bar:
        result = refit(
            found, loaded, errors, options=settings, compensated=compensated, output=output, feed=feed, progress=bar
        )
    write_atomic(output, result.text.encode("latin-1"))
    report = result.report
    return CommandResult(report.to_text(), report.to_dict, met=report.strictly_complete if strict else report.complete)
