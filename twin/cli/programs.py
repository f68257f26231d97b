"""Commands on NC programs: ``twin compensate``, ``check``, ``verify`` and ``path``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator, Iterable, Mapping
from contextlib import closing
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin._common.bundled import DEFAULT, DEFAULT_ACCELERATION, DEFAULT_ROTARY_LIMIT_DEG, DEFAULT_TOLERANCE_MM
from twin._common.errors import InputError
from twin._common.families import Language
from twin._common.files import write_atomic
from twin._common.messages import Message, say
from twin._common.provenance import warning_texts
from twin._common.units import count_with_noun
from twin.cli.shared import complete, options
from twin.cli.shared.command import ANY, POSITIVE, PROGRAM, CommandResult, JsonOption, Output, command, progress_bar
from twin.cli.shared.installation import BAD_INPUT, INTERRUPTED, NOT_ALL_MET
from twin.cli.shared.paper import PrintedOption

if TYPE_CHECKING:
    from twin.compensation import Compensator, Options
    from twin.compensation.programs.compensator import ProgramOutcome
    from twin.compute.parallel import Workers
    from twin.machine.machine import Machine
    from twin.model.calibration import Calibration


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
    "twin compensate bore.nc -o out.nc --harmless O9021 M77 --auxiliary-axes W",
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
    harmless: options.HarmlessOption = None,
    auxiliary_axes: options.AuxiliaryOption = None,
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
        setup=options.setup(loaded, work_offset, work_origin, offsets, tools, harmless, auxiliary_axes),
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
        lambda: {
            "schema": "twin.compensations/1",
            "exit_status": status,
            "programs": [outcome.to_dict() for outcome in outcomes_done],
        },
        written=None,
        after=[f"written: {folder} (each with {TEXT_SUFFIX} and {JSON_SUFFIX})"]
        if len(failed) < len(outcomes_done)
        else [],
        errors=errors,
        status=status,
    )


@command(
    "twin check cone_frustum.nc --tool-length 120",
    "twin check cone_frustum.nc cone_frustum.cls --machine dmu50 --json checked.json",
    "twin check part.h --offsets preset.pr --tools tool.t --subprograms macros",
)
def check(
    programs: options.ProgramsArgument,
    machine: options.MachineOption = DEFAULT,
    mode: options.ModeOption = options.Mode.axis,
    language: options.LanguageOption = None,
    subprograms: options.SubprogramsOption = None,
    harmless: options.HarmlessOption = None,
    auxiliary_axes: options.AuxiliaryOption = None,
    tool_length: options.ToolOption = None,
    work_offset: options.OffsetOption = None,
    work_origin: options.OriginOption = None,
    offsets: options.OffsetsOption = None,
    tools: options.ToolsOption = None,
    json_file: JsonOption = None,
    lang: PrintedOption = Language.en,
) -> CommandResult:
    """Examine NC programs before anything is computed.

    Language and control, tools, work offsets, planes, travel, time, and what would not be corrected. Nothing is corrected or written.
    One program is described in full, several in one line each. The exit status is the worst of all: 2 if `twin compensate` would
    refuse a program, 3 if it would leave feeds as written or an axis leaves its range, else 0.
    """
    from twin.compensation import Options
    from twin.compensation.programs.check import check_program

    loaded = options.machine(machine)
    settings = Options(
        setup=options.setup(loaded, work_offset, work_origin, offsets, tools, harmless, auxiliary_axes),
        tool_length_mm=tool_length,
        tcp=mode is options.Mode.tcp,
        language=language,
        subprograms=tuple(subprograms or ()),
    )
    found = [check_program(program, loaded, options=settings) for program in programs]
    count = Counter(one.verdict for one in found)
    status = BAD_INPUT if count["refused"] else NOT_ALL_MET if count["in part"] else 0
    refused = [f"twin: {one.error}" for one in found if one.error is not None]
    if len(found) == 1:
        text = found[0].to_text()
    else:
        wide = max(len(str(program)) for program in programs)
        lines = [f"{one.program!s:<{wide}}  {say(one.brief)}" for one in found]
        total = Message(
            "{all} programs: {ready} ready, {part} in part, {refused} refused",
            all=len(found),
            ready=count["ready"],
            part=count["in part"],
            refused=count["refused"],
        )
        text = "\n".join([*lines, "", say(total), ""])
    return CommandResult(
        text,
        lambda: {"schema": "twin.checks/1", "exit_status": status, "programs": [one.to_dict() for one in found]},
        errors=refused,
        status=status,
    )


class Control(StrEnum):
    """Control that executes the program."""

    linuxcnc = "linuxcnc"


@command(
    "twin verify cone_frustum.nc --control linuxcnc --tool-length 120",
    "twin verify part.ngc --control linuxcnc --calibration mine.yaml --offsets linuxcnc.var --tools tool.tbl --json verified.json",
)
def verify(
    program: Annotated[
        Path,
        typer.Argument(
            metavar="PROGRAM",
            help="NC program of LinuxCNC, or the name of a bundled one.",
            autocompletion=complete.programs,
        ),
        PROGRAM,
    ],
    control: Annotated[Control, typer.Option("--control", help="Control that executes the program.")],
    machine: options.MachineOption = DEFAULT,
    calibration: options.CalibrationOption = None,
    tool_length: options.ToolOption = None,
    work_offset: options.OffsetOption = None,
    offsets: options.OffsetsOption = None,
    tools: options.ToolsOption = None,
    rotary_limit: options.RotaryLimitOption = DEFAULT_ROTARY_LIMIT_DEG,
    temperature: options.TemperatureOption = None,
    time: options.TimeOption = None,
    rpm: options.RpmOption = None,
    load: options.LoadOption = None,
    tolerance: Annotated[
        float | None, typer.Option("--tolerance", help="Largest permitted error over the motion, mm."), POSITIVE
    ] = None,
    acceleration: Annotated[
        float, typer.Option("--acceleration", help="Acceleration of the control's axes, mm/s² and °/s²."), POSITIVE
    ] = DEFAULT_ACCELERATION,
    user: Annotated[
        str, typer.Option("--user", help="User who runs the control, if twin runs as root; the control refuses root.")
    ] = "",
    json_file: JsonOption = None,
) -> CommandResult:
    """Let a control on this computer execute a program and its compensated form, and evaluate the error over the whole motion.

    LinuxCNC runs without a display, in real time: as long as the program runs on the machine, three times (original, compensated, and
    with G61). The positions of its motors are sampled every millisecond; the report says what remains at the tool, where, and how much
    of it is the control's own path.
    """
    from twin._common.bundled import find_program
    from twin.compensation import Compensator, Options
    from twin.compensation.verification import verify as verified

    loaded = options.machine(machine)
    settings = Options(
        setup=options.setup(loaded, work_offset, None, offsets, tools),
        tool_length_mm=tool_length,
        rotary_limit_deg=rotary_limit,
        conditions=options.conditions(temperature, time, rpm, load),
    )
    compensator = Compensator(loaded, options.calibration_of(calibration, loaded), settings)
    found = verified(find_program(program), compensator, user=user, acceleration=acceleration)
    met = tolerance is None or found.after.largest_um <= 1e3 * tolerance
    return CommandResult(found.to_text(), found.to_dict, met=met)


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
