"""``twin compensate``."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from twin.cli.app import (
    NOT_ALL_MET,
    CalibrationOption,
    JsonOption,
    MachineOption,
    Mode,
    ModeOption,
    OffsetOption,
    OriginOption,
    RotaryLimitOption,
    ScopeOption,
    TemperatureOption,
    TimeOption,
    ToolOption,
    app,
    calibration_of,
    progress,
)
from twin.compensation import Compensator, Options
from twin.errors import InputError
from twin.files import check_writable, write_whole
from twin.inverse import DEFAULT_ROTARY_LIMIT_DEG
from twin.iso16907 import Scope
from twin.machine import Machine
from twin.nc import dialect_for, dialect_of, find_program
from twin.options import conditions, positive, setup


class Method(StrEnum):
    """How commands are found."""

    exact = "exact"
    thesis = "thesis"


@app.command()
def compensate(
    program: Annotated[
        Path, typer.Argument(help="NC program: ISO, Heidenhain .h, APT .cls; or one that comes with twin.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The compensated program.")],
    machine: MachineOption = "dmu50",
    calibration: CalibrationOption = None,
    scope: ScopeOption = None,
    mode: ModeOption = Mode.axis,
    tolerance: Annotated[
        float, typer.Option("--tolerance", help="mm of error allowed between the ends of a block.")
    ] = 1e-3,
    json_file: JsonOption = None,
    report_file: Annotated[Path | None, typer.Option("--report", help="Write the report as text, too.")] = None,
    tool_length: ToolOption = None,
    work_offset: OffsetOption = None,
    work_origin: OriginOption = None,
    method: Annotated[
        Method, typer.Option("--method", help="exact: the inverse with errors; thesis: the baseline.")
    ] = Method.exact,
    rotary_limit: RotaryLimitOption = DEFAULT_ROTARY_LIMIT_DEG,
    temperature: TemperatureOption = None,
    time: TimeOption = None,
) -> None:
    """Write the program whose execution on the machine with errors lands where the given one meant.

    twin compensate part.nc -o part.compensated.nc --tool-length 120 --json report.json

    A calibration extended by twin diagnose may need more: temperatures (--temperature X=23.1 bed=21) and, for a warm-up, the time
    (--time). Reversals need nothing: the side each axis comes from follows from the program.
    """
    loaded = Machine.load(machine)
    source = find_program(program)
    positive("--tolerance", tolerance)
    positive("--rotary-limit", rotary_limit)
    dialect = dialect_of(source)
    target = dialect_for(output)
    if target.name != dialect.name and dialect.name != "apt":
        raise InputError(
            f"a {dialect.name} program cannot be written as {target.name}",
            expected=f"-o with {' '.join(dialect.suffixes)}",
            file=output,
        )
    outputs = [path for path in (output, json_file, report_file) if path is not None]
    check_writable(outputs)
    if source.resolve() in {path.resolve() for path in outputs}:
        raise InputError("the output is the program itself", expected="another file", file=output)
    options = Options(
        setup=setup(loaded, work_offset, work_origin),
        tool_length_mm=tool_length,
        tcp=mode is Mode.tcp,
        scope=None if scope is None else Scope.parse(scope),
        tolerance_mm=tolerance,
        rotary_limit_deg=rotary_limit,
        method=method.value,
        conditions=conditions(temperature, time),
    )
    compensator = Compensator(loaded, calibration_of(calibration, loaded), options)
    with progress() as say:
        report = compensator.compensate_file(source, output, say, into=target)
    account = report.to_text()
    if json_file is not None:
        write_whole(json_file, json.dumps(report.to_dict(), indent=1) + "\n")
    if report_file is not None:
        write_whole(report_file, account)
    print(account, end="")
    print(f"\nwritten: {', '.join(str(path) for path in outputs)}")
    if not report.complete:
        raise typer.Exit(NOT_ALL_MET)
