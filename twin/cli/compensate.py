"""``twin compensate``."""

from __future__ import annotations

from collections import Counter
from contextlib import closing
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from twin._common.errors import InputError
from twin._common.files import write_json, write_whole
from twin.cli import complete
from twin.cli.app import (
    BAD_INPUT,
    INTERRUPTED,
    NOT_ALL_MET,
    CalibrationOption,
    MachineOption,
    Mode,
    ModeOption,
    OffsetOption,
    OriginOption,
    RotaryLimitOption,
    SchedulerOption,
    ScopeOption,
    StrictOption,
    TemperatureOption,
    TimeOption,
    TlsCaOption,
    TlsCertOption,
    TlsKeyOption,
    ToolOption,
    WorkersOption,
    calibration_of,
    progress,
)
from twin.cli.options import conditions, positive, setup
from twin.cli.options import workers as workers_of
from twin.cli.outputs import ANY, JsonOption, Output, command
from twin.cli.terminal import echo, tell_error
from twin.compensation import Compensator, Options
from twin.compensation.many import JSON, TEXT, Outcome, compensate_files
from twin.compute.parallel import Workers
from twin.kinematics.inverse import DEFAULT_ROTARY_LIMIT_DEG
from twin.machine.calibration import Calibration
from twin.machine.iso16907 import Scope
from twin.machine.machine import DEFAULT, Machine
from twin.nc import dialect_for, dialect_of, find_program

SCHEMA = "twin.compensations/1"


class Method(StrEnum):
    """How commands are found."""

    exact = "exact"
    thesis = "thesis"


@command(
    "twin compensate cone_frustum.nc -o compensated.nc --tool-length 120 --json report.json",
    "twin compensate part.nc -o part.compensated.nc --calibration mine.yaml --scope L-VOL R-VOL",
    "twin compensate warm.h -o warm.compensated.h -c better.yaml --temperature X=23.1 bed=21 --time 7200",
    "twin compensate a.nc b.nc c.h -o out/ --workers 2",
)
def compensate(
    programs: Annotated[
        list[Path],
        typer.Argument(
            metavar="PROGRAM",
            help="NC program: ISO, Heidenhain .h, APT .cls; or one that comes with twin. Or several.",
            autocompletion=complete.programs,
        ),
    ],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="The compensated program; of several, the folder they go to."),
        Output(folder=True),
    ],
    machine: MachineOption = DEFAULT,
    calibration: CalibrationOption = None,
    scope: ScopeOption = None,
    mode: ModeOption = Mode.axis,
    tolerance: Annotated[
        float, typer.Option("--tolerance", help="mm of error allowed between the ends of a block.")
    ] = 1e-3,
    json_file: JsonOption = None,
    report_file: Annotated[Path | None, typer.Option("--report", help="Write the report as text, too."), ANY] = None,
    tool_length: ToolOption = None,
    work_offset: OffsetOption = None,
    work_origin: OriginOption = None,
    method: Annotated[
        Method, typer.Option("--method", help="exact: the inverse with errors; thesis: the baseline.")
    ] = Method.exact,
    rotary_limit: RotaryLimitOption = DEFAULT_ROTARY_LIMIT_DEG,
    temperature: TemperatureOption = None,
    time: TimeOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    strict: StrictOption = False,
    tls_ca: TlsCaOption = None,
    tls_cert: TlsCertOption = None,
    tls_key: TlsKeyOption = None,
) -> None:
    """Write the program whose execution on the machine with errors lands where the given one meant.

    A calibration extended by twin diagnose may need more: temperatures (--temperature X=23.1 bed=21) and, for a warm-up, the time
    (--time). Reversals need nothing: the side each axis comes from follows from the program.

    Several programs go into a folder, each under its own name, with its report beside it (.report.txt, .report.json); --json and
    --report then take the account of all of them. One that cannot be compensated does not stop the others. The exit status is the
    worst: 2 before 3 before 0. With --scheduler they travel to the workers of a Dask cluster and back.
    """
    loaded = Machine.load(machine)
    positive("--tolerance", tolerance)
    positive("--rotary-limit", rotary_limit)
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
    errors = calibration_of(calibration, loaded)
    own = workers_of(workers, scheduler, tls_ca, tls_cert, tls_key)
    if len(programs) > 1 or (output.is_dir() and not output.suffix):
        _several(programs, output, json_file, report_file, loaded, errors, options, own, strict)
    elif scheduler is not None:
        raise InputError("one program for a cluster", expected="several, and -o with a folder", value=scheduler)
    else:
        _one(programs[0], output, json_file, report_file, loaded, errors, options, strict)


def _one(
    program: Path,
    output: Path,
    json_file: Path | None,
    report_file: Path | None,
    machine: Machine,
    calibration: Calibration,
    options: Options,
    strict: bool,
) -> None:
    source = find_program(program)
    dialect = dialect_of(source)
    target = dialect_for(output)
    if not dialect.becomes(target):
        raise InputError(
            f"a {dialect.name} program cannot be written as {target.name}",
            expected=f"-o with {' '.join(dialect.suffixes)}",
            file=output,
        )
    outputs = [path for path in (output, json_file, report_file) if path is not None]
    compensator = Compensator(machine, calibration, options)
    with progress() as say:
        report = compensator.compensate_file(source, output, say, into=target)
    account = report.to_text()
    if json_file is not None:
        write_json(json_file, report.to_dict())
    if report_file is not None:
        write_whole(report_file, account)
    echo(account, end="")
    echo(f"\nwritten: {', '.join(str(path) for path in outputs)}")
    if not (report.strictly_complete if strict else report.complete):
        raise typer.Exit(NOT_ALL_MET)


def _several(
    programs: list[Path],
    folder: Path,
    json_file: Path | None,
    report_file: Path | None,
    machine: Machine,
    calibration: Calibration,
    options: Options,
    workers: Workers,
    strict: bool,
) -> None:
    found: dict[Path, Outcome] = {}
    interrupted = False
    try:
        with (
            progress() as say,
            closing(
                compensate_files(programs, folder, machine, calibration, options=options, workers=workers, progress=say)
            ) as outcomes,
        ):
            for outcome in outcomes:
                found[outcome.program] = replace(outcome, strict=strict)
    except KeyboardInterrupt:
        interrupted = True
    told = [found[program] for program in programs if program in found]
    wide = max((len(str(program)) for program in programs), default=0)
    count = Counter(outcome.verdict for outcome in told)
    lines = [f"{outcome.program!s:<{wide}}  {outcome.line}" for outcome in told]
    lines.append(
        f"\n{len(programs)} programs: {count['done']} done, {count['not met']} done with something not met, {count['failed']} failed"
        + (f", {len(programs) - len(told)} not begun or not finished" if interrupted else "")
    )
    failed = [outcome for outcome in told if outcome.error is not None]
    status = (
        INTERRUPTED
        if interrupted
        else BAD_INPUT
        if any(isinstance(outcome.error, InputError) for outcome in failed)
        else NOT_ALL_MET
        if failed or count["not met"]
        else 0
    )
    if json_file is not None:
        data = {"schema": SCHEMA, "exit_status": status, "programs": [outcome.to_dict() for outcome in told]}
        write_json(json_file, data)
    if report_file is not None:
        write_whole(report_file, "\n".join(lines) + "\n")
    echo("\n".join(lines))
    if len(failed) < len(told):
        echo(f"written: {folder} (each with {TEXT} and {JSON})")
    for outcome in failed:
        tell_error(f"twin: {outcome.error}")
    if interrupted:
        tell_error(f"twin: {len(told) - len(failed)} of {len(programs)} programs written")
        raise KeyboardInterrupt
    if status:
        raise typer.Exit(status)
