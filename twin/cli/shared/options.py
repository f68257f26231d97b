"""Options that several commands share: how each is given, and what it stands for."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from twin._common.errors import InputError, nearest
from twin.cli.shared import complete
from twin.cli.shared.command import POSITIVE
from twin.cli.shared.terminal import echo
from twin.cli.shared.words import number, three_numbers
from twin.compensation.toolpath import Setup
from twin.compute.parallel import Tls, Workers
from twin.machine.calibration import Calibration
from twin.machine.conditions import Conditions
from twin.machine.iso16907 import NAMES
from twin.machine.machine import Machine
from twin.measurement.instruments import INSTRUMENTS, Instrument
from twin.nc import find_program
from twin.samples import PLANS


class Mode(StrEnum):
    """Who does the kinematics."""

    axis = "axis"
    tcp = "tcp"


MachineOption = Annotated[
    str,
    typer.Option(
        "--machine",
        "-m",
        help="Machine file, or the name of one that comes with twin.",
        autocompletion=complete.machines,
    ),
]
CalibrationOption = Annotated[
    Path | None,
    typer.Option(
        "--calibration",
        "-c",
        help="Calibration file; the machine file's own if not given.",
        autocompletion=complete.calibrations,
    ),
]
ToolOption = Annotated[float | None, typer.Option("--tool-length", help="mm from spindle nose to tool tip.")]
OffsetOption = Annotated[
    list[str] | None, typer.Option("--work-offset", help="Added to axis words: X=… Y=… Z=… B=… C=… (mm, degrees).")
]
OriginOption = Annotated[
    str | None, typer.Option("--work-origin", help="x,y,z of the program's zero in the work frame (mm), in mode tcp.")
]
ModeOption = Annotated[Mode, typer.Option("--mode", help="axis: words are axis positions; tcp: tool-tip coordinates.")]
TemperatureOption = Annotated[
    list[str] | None,
    typer.Option("--temperature", help="°C of an axis's scale or of a sensor, over the whole program: X=23.1 bed=21."),
]
TimeOption = Annotated[
    float | None,
    typer.Option(
        "--time",
        help="For a warm-up: seconds on the clock of the measured table's time_s, which starts with the cold machine; held over "
        "the whole program, so take its middle. A machine warmed through: a large number.",
    ),
]
ScopeOption = Annotated[
    list[str] | None,
    typer.Option("--scope", help=f"ISO/TR 16907 classes: {' '.join(NAMES)}.", autocompletion=complete.classes),
]
StrictOption = Annotated[
    bool,
    typer.Option(
        "--strict", help="Exit with status 3 for anything that could not be corrected, rapids and orientation included."
    ),
]
RotaryLimitOption = Annotated[
    float, typer.Option("--rotary-limit", help="Degrees a rotary axis may move to repair an orientation."), POSITIVE
]
MeasuredArgument = Annotated[
    list[Path], typer.Argument(help="The measurement table, or several of one machine.", autocompletion=complete.tables)
]
WorkersOption = Annotated[
    int | None,
    typer.Option("--workers", help="Processes of this computer: one a core if not given; 1: no other than this one."),
]
SchedulerOption = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        help="Address of a Dask scheduler (tcp://host:8786): its workers do it instead. It is trusted like your own code.",
    ),
]
TlsCaOption = Annotated[
    Path | None,
    typer.Option(
        "--tls-ca", help="Certificate authority (PEM) of a scheduler at tls://host:8786; Dask's setting if not given."
    ),
]
TlsCertOption = Annotated[Path | None, typer.Option("--tls-cert", help="This computer's certificate (PEM) for it.")]
TlsKeyOption = Annotated[
    Path | None, typer.Option("--tls-key", help="The certificate's key (PEM), where it is not in the same file.")
]


def calibration_of(path: Path | None, machine: Machine) -> Calibration:
    """The calibration of that file, or the machine file's own."""
    return Calibration.default(machine) if path is None else Calibration.load(path, machine)


def unused(at: Conditions, errors: Calibration) -> list[str]:
    """What was given and not needed, a line each."""
    return [f"{name} was given and the calibration does not need it" for name in at.unused(errors)]


def tell_unused(at: Conditions, errors: Calibration) -> None:
    """Print `unused`."""
    for line in unused(at, errors):
        echo(line)


def bundled_sample(path: Path, what: str, kind: str, known: Sequence[str]) -> Path:
    """A file by its path, or one that comes with twin by its bare name.

    Args:
        path: as it was given.
        what: what it should be, in a word.
        kind: the same, of the user's own.
        known: names of those that come with twin.

    Raises:
        InputError: it is neither.
    """
    try:
        return find_program(path)  # looks for a file of any kind
    except InputError:
        raise InputError(
            f"no such {what}",
            expected=f"a {kind}, or one that comes with twin: {' '.join(known)}",
            file=path,
            nearest=nearest(path.name, known),
        ) from None


def plan_file(path: Path) -> Path:
    """A plan by its path, or one that comes with twin.

    Raises:
        InputError: it is neither.
    """
    return bundled_sample(path, "plan", "measurement table", [plan.name for plan in PLANS])


def need_pictures(what: str) -> None:
    """Find out before the work whether pictures can be drawn.

    Raises:
        InputError: matplotlib does not import.
    """
    try:
        import_module("matplotlib.figure")
    except ImportError as error:
        raise InputError(
            f"{what} draws pictures, and matplotlib is not installed", expected="pip install 'twin[plots]'", value=error
        ) from error


def instrument_named(name: str) -> Instrument:
    """An instrument by its name.

    Raises:
        InputError: it is not; with what was expected.
    """
    known = {one.name: one for one in INSTRUMENTS}
    if name in known:
        return known[name]
    raise InputError(
        "no such instrument", expected=f"one of {', '.join(known)}", value=name, nearest=nearest(name, known)
    )


def setup(machine: Machine, offsets: list[str] | None, origin: str | None) -> Setup:
    """Offsets and origin of a program.

    Raises:
        InputError: it is not; with what was expected.
    """
    found = {}
    for entry in offsets or []:
        name, _, text = entry.partition("=")
        if name not in machine.by_name:
            raise InputError(
                "--work-offset of an unknown axis",
                expected=f"one of {', '.join(machine.names)}",
                value=entry,
                nearest=nearest(name, machine.names),
            )
        if name in found:
            raise InputError("--work-offset given twice", expected="each axis once", value=entry)
        found[name] = number("--work-offset", text, entry)
    if origin is None:
        return Setup(found)
    return Setup(found, three_numbers("--work-origin", origin, origin, "x,y,z in mm"))


def conditions(temperatures: list[str] | None, time_s: float | None) -> Conditions:
    """Temperatures and time of a program.

    Raises:
        InputError: it is not; with what was expected.
    """
    found = {}
    for entry in temperatures or []:
        name, equals, text = entry.partition("=")
        if not equals or not name:
            raise InputError("--temperature does not fit", expected="an axis or sensor and °C: X=23.1", value=entry)
        if name in found:
            raise InputError("--temperature given twice", expected="each axis or sensor once", value=entry)
        found[name] = number("--temperature", text, entry)
    return Conditions(found, time_s)


def workers(
    processes: int | None, scheduler: str | None, ca: Path | None, cert: Path | None, key: Path | None
) -> Workers:
    """Return who does the work.

    Raises:
        InputError: TLS files that are not complete, or without a scheduler that uses TLS.
    """
    if ca is None and cert is None and key is None:
        return Workers(processes, scheduler)
    if ca is None or cert is None:
        raise InputError(
            "TLS files that are not complete",
            expected="--tls-ca and --tls-cert, and --tls-key where the certificate's file holds no key",
        )
    return Workers(processes, scheduler, Tls(ca, cert, key))
