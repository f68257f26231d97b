"""Command ``twin compensate``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator, Iterable, Mapping
from contextlib import closing
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin._common.bundled import DEFAULT, DEFAULT_ROTARY_LIMIT_DEG
from twin._common.errors import InputError
from twin._common.files import write_atomic
from twin._common.provenance import warning_texts
from twin._common.units import count_with_noun
from twin.cli.shared import options
from twin.cli.shared.command import ANY, POSITIVE, CommandResult, JsonOption, Output, command, progress_bar
from twin.cli.shared.installation import BAD_INPUT, INTERRUPTED, NOT_ALL_MET

if TYPE_CHECKING:
    from twin.compensation import Compensator, Options
    from twin.compensation.programs.compensator import ProgramOutcome
    from twin.compute.parallel import Workers
    from twin.machine.machine import Machine
    from twin.model.calibration import Calibration

SCHEMA = "twin.compensations/1"


class Method(StrEnum):
    """Method by which compensated commands are computed."""

    exact = "exact"
    thesis = "thesis"


OutputOption = Annotated[
    Path,
    typer.Option("--output", "-o", help="Compensated program to write; for several programs, a folder."),
    Output(folder=True),
]
ToleranceOption = Annotated[
    float, typer.Option("--tolerance", help="Largest permitted error between the end points of a block, mm."), POSITIVE
]
MethodOption = Annotated[
    Method, typer.Option("--method", help="exact: inverse kinematics with errors; thesis: Ellingsdalen (2021).")
]


@command(
    "twin compensate cone_frustum.nc -o compensated.nc --tool-length 120 --json report.json",
    "twin compensate part.nc -o part.compensated.nc --calibration mine.yaml --scope L-VOL R-VOL",
    "twin compensate warm.h -o warm.compensated.h -c better.yaml --temperature X=23.1 bed=21 --time 7200",
    "twin compensate warm.nc -o warm.compensated.nc -c better.yaml --log machine.csv --time 7200",
    "twin compensate a.nc b.nc c.h -o out/ --workers 2",
    "twin compensate main.h -o out.h --subprograms macros cycles",
)
def compensate(
    programs: options.ProgramsArgument,
    output: OutputOption,
    machine: options.MachineOption = DEFAULT,
    calibration: options.CalibrationOption = None,
    scope: options.ScopeOption = None,
    mode: options.ModeOption = options.Mode.axis,
    language: options.LanguageOption = None,
    subprograms: options.SubprogramsOption = None,
    tolerance: ToleranceOption = 1e-3,
    json_file: JsonOption = None,
    report_file: Annotated[Path | None, typer.Option("--report", help="Write the report as text, too."), ANY] = None,
    tool_length: options.ToolOption = None,
    work_offset: options.OffsetOption = None,
    work_origin: options.OriginOption = None,
    offsets: options.OffsetsOption = None,
    tools: options.ToolsOption = None,
    method: MethodOption = Method.exact,
    rotary_limit: options.RotaryLimitOption = DEFAULT_ROTARY_LIMIT_DEG,
    temperature: options.TemperatureOption = None,
    time: options.TimeOption = None,
    rpm: options.RpmOption = None,
    log: options.LogOption = None,
    load: options.LoadOption = None,
    workers: options.WorkersOption = None,
    scheduler: options.SchedulerOption = None,
    strict: options.StrictOption = False,
    tls_ca: options.TlsCaOption = None,
    tls_cert: options.TlsCertOption = None,
    tls_key: options.TlsKeyOption = None,
) -> CommandResult:
    """Rewrite NC programs so that the machine with its errors produces the programmed path.

    An extended calibration may need temperatures (--temperature X=23.1 bed=21), a time (--time), speed, a load (--load). They hold for
    the whole program, or are read from a log of the machine (--log). The speed of every block is that of the program's S words unless
    --rpm gives one. Backlash needs none.

    Several programs are written to a folder under their own names, each with its report (.report.txt, .report.json); --json and
    --report then hold a summary. A program that cannot be compensated does not stop the others. The exit status is the worst of all:
    2, then 3, then 0. With --scheduler the workers of a Dask cluster compensate them.
    """
    from twin.compensation import Options
    from twin.model.iso16907 import Scope

    loaded = options.machine(machine)
    settings = Options(
        setup=options.setup(loaded, work_offset, work_origin, offsets, tools),
        tool_length_mm=tool_length,
        tcp=mode is options.Mode.tcp,
        scope=None if scope is None else Scope.parse(scope),
        tolerance_mm=tolerance,
        rotary_limit_deg=rotary_limit,
        method=method.value,
        conditions=options.conditions(temperature, time, rpm, load, log, by_block=True),
        language=language,
        subprograms=tuple(subprograms or ()),
    )
    errors = options.calibration_of(calibration, loaded)
    own = options.workers(workers, scheduler, tls_ca, tls_cert, tls_key)
    result = _compensated(programs, output, loaded, errors, settings, own, strict=strict)
    if report_file is not None:
        write_atomic(report_file, result.text)
    return result


def _compensated(
    programs: list[Path],
    output: Path,
    machine: Machine,
    errors: Calibration,
    settings: Options,
    own: Workers,
    *,
    strict: bool,
) -> CommandResult:
    """Compensate one program, or several into a folder."""
    from twin.compensation import Compensator
    from twin.compensation.programs.compensator import compensate_files

    if len(programs) > 1 or (output.is_dir() and not output.suffix):
        with progress_bar() as bar:
            every = compensate_files(programs, output, machine, errors, options=settings, workers=own, progress=bar)
            outcomes_done, interrupted = _collect(every, strict)
        result = _summary(programs, outcomes_done, output, warning_texts(errors.warnings), interrupted=interrupted)
    elif own.scheduler is not None:
        raise InputError(
            "--scheduler needs several programs", expected="several programs, and -o with a folder", value=own.scheduler
        )
    else:
        result = _compensate_one(programs[0], output, Compensator(machine, errors, settings), strict=strict)
    return result


def _compensate_one(program: Path, output: Path, compensator: Compensator, *, strict: bool) -> CommandResult:
    from twin._common.bundled import find_program
    from twin.nc import dialect_of, dialect_to_write

    source = find_program(program)
    dialect = dialect_of(source, compensator.prepared.options.language)
    target = dialect_to_write(output, source, dialect)
    if not dialect.can_post_to(target):
        raise InputError(
            f"the program cannot be converted from {dialect.name} to {target.name}",
            expected=f"-o with {' '.join(dialect.suffixes)}",
            file=output,
        )
    with progress_bar() as bar:
        report = compensator.compensate_file(source, output, bar, into=target)
    return CommandResult(report.to_text(), report.to_dict, met=report.strictly_complete if strict else report.complete)


def _collect(outcomes: Generator[ProgramOutcome, None, None], strict: bool) -> tuple[dict[Path, ProgramOutcome], bool]:
    """Return the outcome of every finished program, and whether a signal interrupted the work."""
    found: dict[Path, ProgramOutcome] = {}
    try:
        with closing(outcomes):
            for outcome in outcomes:
                found[outcome.program] = replace(outcome, strict=strict)
    except KeyboardInterrupt:
        return found, True
    return found, False


def _summary(
    programs: list[Path],
    found: Mapping[Path, ProgramOutcome],
    folder: Path,
    warnings: Iterable[str],
    *,
    interrupted: bool,
) -> CommandResult:
    from twin.compensation.programs.compensator import JSON_SUFFIX, TEXT_SUFFIX

    outcomes_done = [found[program] for program in programs if program in found]
    wide = max((len(str(program)) for program in programs), default=0)
    count = Counter(outcome.verdict for outcome in outcomes_done)
    lines = [*warnings, *(f"{outcome.program!s:<{wide}}  {outcome.brief}" for outcome in outcomes_done)]
    lines.append(
        f"\n{count_with_noun(len(programs), 'program')}: {count['done']} done, {count['not met']} done in part, "
        f"{count['failed']} failed" + (f", {len(programs) - len(outcomes_done)} not finished" if interrupted else "")
    )
    failed = [outcome for outcome in outcomes_done if outcome.error is not None]
    errors = [f"twin: {outcome.error}" for outcome in failed]
    status = 0
    if interrupted:
        status = INTERRUPTED
        errors.append(
            f"twin: {len(outcomes_done) - len(failed)} of {count_with_noun(len(programs), 'program')} written"
        )
    elif any(isinstance(outcome.error, InputError) for outcome in failed):
        status = BAD_INPUT
    elif failed or count["not met"]:
        status = NOT_ALL_MET
    return CommandResult(
        "\n".join([*lines, ""]),
        lambda: {"schema": SCHEMA, "exit_status": status, "programs": [outcome.to_dict() for outcome in outcomes_done]},
        written="",
        after=[f"written: {folder} (each with {TEXT_SUFFIX} and {JSON_SUFFIX})"]
        if len(failed) < len(outcomes_done)
        else [],
        errors=errors,
        status=status,
    )
