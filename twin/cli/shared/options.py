"""Options shared by several commands, and the conversion of their values."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin._common.bundled import find_program
from twin._common.errors import InputError, closest_name
from twin._common.families import ProgramLanguage
from twin.cli.shared import complete
from twin.cli.shared.command import EXISTING, MACHINE, POSITIVE, PROGRAM
from twin.cli.shared.terminal import axis_values, number, pairs, three_numbers

if TYPE_CHECKING:
    from twin.compensation.programs.words import Setup
    from twin.compute.parallel import Workers
    from twin.machine.machine import Machine
    from twin.model.calibration import Calibration
    from twin.model.conditions import Conditions


class Mode(StrEnum):
    """Meaning of the words of an NC program: axis positions, or tool-tip coordinates that the control transforms."""

    axis = "axis"
    tcp = "tcp"


ProgramsArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="PROGRAM",
        help="One or more NC programs: ISO, Heidenhain .h, APT .cls, or the name of a bundled one.",
        autocompletion=complete.programs,
    ),
    PROGRAM,
]
LanguageOption = Annotated[
    ProgramLanguage | None,
    typer.Option("--language", help="Language of the programs; default: recognised by content, then by suffix."),
]
SubprogramsOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--subprograms",
        help="Folders in which subprograms are searched after the program's own (M98, G65, EXTCALL, CALL PGM TNC:\\…).",
    ),
    EXISTING,
]
HarmlessOption = Annotated[
    list[str] | None,
    typer.Option(
        "--harmless",
        help="Words and subprograms that leave positions, frame, offsets and modes unchanged (M77 O9021 L900 FIN): macros of the "
        "machine's builder that are not given. The machine file can name them, too.",
    ),
]
AuxiliaryOption = Annotated[
    list[str] | None,
    typer.Option(
        "--auxiliary-axes",
        help="Axes that the program names and the machine's model does not have (W, U): left as written, at rest in all feeds.",
    ),
]
ProgramArgument = Annotated[
    Path, typer.Argument(help="NC program, or the name of a bundled one.", autocompletion=complete.programs), PROGRAM
]
MachineOption = Annotated[
    str,
    typer.Option(
        "--machine", "-m", help="Machine file, or the name of a bundled machine.", autocompletion=complete.machines
    ),
    MACHINE,
]
CalibrationOption = Annotated[
    Path | None,
    typer.Option(
        "--calibration",
        "-c",
        help="Calibration file; default: the one that the machine file names.",
        autocompletion=complete.calibrations,
    ),
    EXISTING,
]
ToolOption = Annotated[
    float | None,
    typer.Option(
        "--tool-length", help="Tool length from spindle nose to tool tip, mm; default: the machine file's, else 0."
    ),
]
OffsetOption = Annotated[
    list[str] | None,
    typer.Option("--work-offset", help="Offset added to the axis words, mm and degrees: X=… Y=… B=…; default: 0."),
]
OriginOption = Annotated[
    str | None,
    typer.Option("--work-origin", help="Program zero x,y,z in the work frame, mm; with --mode tcp; default: 0,0,0."),
]
OffsetsOption = Annotated[
    Path | None,
    typer.Option(
        "--offsets",
        help="Table of the machine's work offsets (G54 …), from which the program selects: CSV, LinuxCNC .var, SINUMERIK $P_UIFR, "
        "Fanuc G10 L2, Heidenhain .pr. They are those of the spindle nose: the tool's length is added (--tools, else --tool-length).",
    ),
]
ToolsOption = Annotated[
    Path | None,
    typer.Option(
        "--tools",
        help="Table of the tools' lengths, by which the program calls them: CSV, LinuxCNC .tbl, SINUMERIK $TC_DP3, Fanuc G10 L10, "
        "Heidenhain .t. --work-offset is then that of the spindle nose.",
    ),
]
ModeOption = Annotated[
    Mode,
    typer.Option(
        "--mode", help="Meaning of the program's words: axis: axis positions; tcp: tool-tip coordinates (RTCP)."
    ),
]
TemperatureOption = Annotated[
    list[str] | None,
    typer.Option("--temperature", help="Constant temperature of an axis's scale or of a sensor, °C: X=23.1 bed=21."),
]
TimeOption = Annotated[
    float | None,
    typer.Option(
        "--time",
        help="Time for thermal drift effects, s since the cold start (clock of the table's time_s); constant over the program, "
        "so give its mid-time. Warm machine: a large number. With --log, or speeds of the program: when the program begins.",
    ),
]
RpmOption = Annotated[
    float | None,
    typer.Option(
        "--rpm",
        help="Constant spindle speed, 1/min, for growth with spindle speed; with --time since the cold start. `twin compensate` "
        "without it: the program's S words.",
    ),
]
LogOption = Annotated[
    Path | None,
    typer.Option(
        "--log",
        help="CSV file of the machine over time: time_s, T_<sensor>_degC, spindle_rpm, before and during the program, which begins at "
        "--time; every block is compensated for its own temperatures and speed.",
    ),
]
LoadOption = Annotated[
    float | None,
    typer.Option(
        "--load", help="Mass carried in the spindle or gripper, or on the table, kg, for compliances under it."
    ),
]
ScopeOption = Annotated[
    list[str] | None,
    typer.Option(
        "--scope",
        help="ISO/TR 16907 classes to compensate: {classes}; default: all that can be corrected.",
        autocompletion=complete.classes,
    ),
]
StrictOption = Annotated[
    bool,
    typer.Option(
        "--strict", help="Exit with status 3 if anything was not corrected, including rapid moves and orientation."
    ),
]
RotaryLimitOption = Annotated[
    float, typer.Option("--rotary-limit", help="Largest correction of a rotary axis, degrees."), POSITIVE
]
MeasuredArgument = Annotated[
    list[Path],
    typer.Argument(help="Measurement table, or several of one machine.", autocompletion=complete.tables),
    EXISTING,
]
WorkersOption = Annotated[
    int | None, typer.Option("--workers", help="Number of local processes; default: one per core; 1: no child process.")
]
SchedulerOption = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        help="Address of a Dask scheduler whose workers to use instead: tcp://host:8786. Trusted like local code.",
    ),
]
TlsCaOption = Annotated[
    Path | None,
    typer.Option(
        "--tls-ca", help="Certificate authority (PEM) for a scheduler at tls://host:8786; default: Dask's setting."
    ),
]
TlsCertOption = Annotated[
    Path | None, typer.Option("--tls-cert", help="This computer's certificate (PEM) for the scheduler.")
]
TlsKeyOption = Annotated[
    Path | None, typer.Option("--tls-key", help="Private key (PEM) of --tls-cert, if in another file.")
]


def machine(name: str) -> Machine:
    """Return the machine of a machine file or of a bundled name."""
    from twin.machine.machine import Machine

    return Machine.load(name)


def calibration_of(path: Path | None, machine: Machine) -> Calibration:
    """Load a calibration, or the machine's default if no path is given."""
    from twin.model.calibration import Calibration

    return Calibration.default(machine) if path is None else Calibration.load(path, machine)


def record_path(path: Path) -> Path:
    """Return a record of a machine by its path, or a bundled one by its name."""
    from twin.samples import RECORDS

    return next((one for one in RECORDS if path == Path(one.name) and not path.exists()), path)


def unused(at: Conditions, errors: Calibration) -> list[str]:
    """Return one line for each condition that the calibration does not need."""
    return [f"{name} has no effect: the calibration does not need it" for name in at.unused(errors)]


def bundled_sample(path: Path, what: str, kind: str, known: Sequence[str]) -> Path:
    """Return a file by its path, or a bundled one by its name; ``what`` in one word, ``kind`` and ``known`` are for the message."""
    try:
        return find_program(path)  # finds any kind of file
    except InputError:
        raise InputError(
            f"no such {what}",
            expected=f"a {kind}, or a bundled {what}: {' '.join(known)}",
            file=path,
            nearest=closest_name(path.name, known),
        ) from None


def plan_file(path: Path) -> Path:
    """Return a plan by its path, or a bundled plan by its name; `InputError` if there is none."""
    from twin.samples import PLANS

    return bundled_sample(path, "plan", "measurement table", [plan.name for plan in PLANS])


def part_file(path: Path) -> Path:
    """Return a file of a part by its path, or a bundled one by its name; `InputError` if there is none."""
    from twin.samples import PARTS

    return bundled_sample(path, "part", "file of features (twin.part/1)", [f"{name}.part.yaml" for name in PARTS])


def need_pictures(what: str) -> None:
    """Raise `InputError` if matplotlib is missing, before any computation."""
    try:
        import_module("matplotlib.figure")
    except ImportError as error:
        raise InputError(
            f"{what} cannot be drawn: matplotlib is not installed", expected="pip install 'twin[plots]'", value=error
        ) from error


def setup(
    machine: Machine,
    offset: list[str] | None,
    origin: str | None,
    offsets: Path | None = None,
    tools: Path | None = None,
    harmless: Sequence[str] | None = None,
    auxiliary_axes: Sequence[str] | None = None,
) -> Setup:
    """Return work offsets (words ``AXIS=value`` or a table), work origin, tools, harmless words and auxiliary axes of a program."""
    from twin.compensation.programs.words import Setup
    from twin.controls.offsets import load_offsets, load_tools

    return Setup(
        work_offset=axis_values("--work-offset", offset, machine.names),
        work_origin_mm=(0.0, 0.0, 0.0)
        if origin is None
        else three_numbers("--work-origin", origin, origin, "x,y,z in mm"),
        offsets=None if offsets is None else load_offsets(offsets),
        tools=None if tools is None else load_tools(tools),
        harmless=tuple(harmless or ()),
        auxiliary_axes=tuple(auxiliary_axes or ()),
    )


def conditions(
    temperatures: list[str] | None,
    time_s: float | None,
    rpm: float | None,
    load_kg: float | None,
    log: Path | None = None,
    *,
    by_block: bool = False,
) -> Conditions:
    """Return temperatures (``NAME=°C``), time, speed and load of a program, or its record; ``by_block``: its S words apply."""
    from twin.model.conditions import Conditions, MachineLog

    words = pairs("--temperature", temperatures, "axis or sensor and °C: X=23.1")
    found = {name: number("--temperature", text, entry) for name, text, entry in words}
    record = None if log is None else MachineLog.load(record_path(log))
    return Conditions(found, time_s, rpm, load_kg, record, speed_of_program=by_block)


def workers(
    processes: int | None, scheduler: str | None, ca: Path | None, cert: Path | None, key: Path | None
) -> Workers:
    """Return the workers, local processes or a Dask cluster; `InputError` for incomplete TLS files, or a scheduler without TLS."""
    from twin.compute.parallel import Tls, Workers

    if ca is None and cert is None and key is None:
        return Workers(processes, scheduler)
    if ca is None or cert is None:
        raise InputError(
            "incomplete TLS files",
            expected="--tls-ca and --tls-cert, and --tls-key if the certificate file holds no key",
        )
    return Workers(processes, scheduler, Tls(ca, cert, key))
