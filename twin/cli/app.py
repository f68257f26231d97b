"""What all commands share: the application, its common options, exit statuses, and one line of progress."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from twin._common.errors import InputError
from twin.cli import complete
from twin.cli.installation import BAD_INPUT as BAD_INPUT
from twin.cli.installation import NOT_ALL_MET as NOT_ALL_MET
from twin.cli.terminal import echo
from twin.machine.calibration import Calibration
from twin.machine.conditions import Conditions
from twin.machine.iso16907 import NAMES
from twin.machine.machine import Machine

INTERRUPTED = 130


app = typer.Typer(
    help="A digital twin of a five-axis machine tool that finds out, from measurements, where its own model is wrong.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
)


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
    typer.Option(
        "--temperature",
        help="°C of an axis's scale or of a sensor, over the whole program: X=23.1 bed=21.",
    ),
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
    float, typer.Option("--rotary-limit", help="Degrees a rotary axis may move to repair an orientation.")
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


def tell_unused(at: Conditions, errors: Calibration) -> None:
    """Name what was given and not needed."""
    for name in at.unused(errors):
        echo(f"{name} was given and the calibration does not need it")


def calibration_of(path: Path | None, machine: Machine) -> Calibration:
    """The calibration of that file, or the machine file's own."""
    return Calibration.default(machine) if path is None else Calibration.load(path, machine)


def need_pictures(what: str) -> None:
    """Find out before the work whether pictures can be drawn.

    Raises:
        InputError: matplotlib does not import.
    """
    try:
        import_module("matplotlib.figure")
    except ImportError as error:
        raise InputError(
            f"{what} draws pictures, and matplotlib is not installed",
            expected="pip install 'twin[plots]'",
            value=error,
        ) from error


@contextmanager
def progress() -> Iterator[Any]:
    """One line on stderr while it lasts; nothing where stderr is not a terminal."""
    console = Console(stderr=True)
    if not console.is_terminal:  # a disabled `Progress` of rich before 14.1 writes an empty line
        yield lambda stage, fraction: None
        return
    with Progress(
        TextColumn("{task.description:>10}"),
        BarColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    ) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda stage, fraction: bar.update(task, description=stage, completed=fraction)
