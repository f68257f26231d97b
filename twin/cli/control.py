"""``twin control``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from twin._common.errors import InputError
from twin._common.files import check_folder, check_writable, write_json
from twin.cli.shared.command import JsonOption, Output, command, progress
from twin.cli.shared.installation import NOT_ALL_MET
from twin.cli.shared.options import (
    CalibrationOption,
    MachineOption,
    ScopeOption,
    TemperatureOption,
    TimeOption,
    ToolOption,
    calibration_of,
    conditions,
    tell_unused,
)
from twin.cli.shared.terminal import echo
from twin.cli.shared.words import number, positive
from twin.control import Account, Existing, Request, compared, deliver, make, outputs_of, written_by
from twin.machine.calibration import Calibration
from twin.machine.conditions import Conditions
from twin.machine.control import FORMATS, format_named
from twin.machine.iso16907 import BASIC, Scope
from twin.machine.machine import DEFAULT, Machine
from twin.uncertainty.budget import known_at

NAMES = [form.name for form in FORMATS]
Kind = StrEnum("Kind", {name: name for name in NAMES})  # type: ignore[misc]
TOLERANCE_UM = 1.0
OTHER_TOLERANCES = "".join(
    f", of a {form.name} {form.tolerance_um * 1e-3:g}" for form in FORMATS if form.tolerance_um != TOLERANCE_UM
)
COUNTED = "; ".join(f"{form.name}: {form.tables} if not given; {form.fewer_tables}" for form in FORMATS if form.tables)
MULTIPLIED = " ".join(form.name for form in FORMATS if form.products)


Files = Annotated[list[Path] | None, typer.Argument(metavar="FILES", help="With --read: the files of the control.")]
To = Annotated[Kind | None, typer.Option("--to", help="The format to write.")]
OutputFolder = Annotated[
    Path | None, typer.Option("--output", "-o", help="The folder they go to."), Output(folder=True)
]
Read = Annotated[bool, typer.Option("--read", help="Say what existing tables do, and how the model differs.")]
FormatRead = Annotated[Kind | None, typer.Option("--format", help="Of the files that are read.")]
AT_HELP = (
    "Where the other axes stand while one moves: X=250 Y=225 Z=-200 B=0 C=0; the middle of the linear, zero of the rotary ranges if "
    "not given."
)
At = Annotated[list[str] | None, typer.Option("--at", help=AT_HELP)]
TOLERANCE_HELP = f"mm the model may be off the straight lines between nodes; 0.001{OTHER_TOLERANCES}, if not given."
Tolerance = Annotated[float | None, typer.Option("--tolerance", help=TOLERANCE_HELP)]
STEP_HELP = "mm (degrees) between nodes; as wide as the tolerance allows if not given."
Step = Annotated[float | None, typer.Option("--step", help=STEP_HELP)]
Tables = Annotated[int | None, typer.Option("--tables", min=1, help=f"Tables the control has ({COUNTED}).")]
PRODUCTS_HELP = f"Whether {MULTIPLIED} tables may be multiplied, for angular errors."
Products = Annotated[bool, typer.Option("--products/--no-products", help=PRODUCTS_HELP)]
ADD_HELP = "The calibration's errors are left under its tables: write those and the new ones together."
Add = Annotated[bool, typer.Option("--add", help=ADD_HELP)]


@command(
    "twin control --to siemens -o tables/ --tool-length 120",
    "twin control --to linuxcnc -o tables/ -c mine.yaml --at Y=225 Z=-200 --tolerance 0.0005 --json tables.json",
    "twin control --read X.comp Y.comp joints.ini --format linuxcnc -c mine.yaml",
)
def control(
    files: Files = None,
    to: To = None,
    output: OutputFolder = None,
    read: Read = False,
    kind: FormatRead = None,
    machine: MachineOption = DEFAULT,
    calibration: CalibrationOption = None,
    tool_length: ToolOption = None,
    at: At = None,
    scope: ScopeOption = None,
    tolerance: Tolerance = None,
    step: Step = None,
    tables: Tables = None,
    products: Products = True,
    add: Add = False,
    temperature: TemperatureOption = None,
    time: TimeOption = None,
    json_file: JsonOption = None,
) -> None:
    """Compensation tables for the machine's own control, from a calibration; or what existing ones say.

    The folder gets the control's files, README.txt (how to load them, what they leave) and calibration.yaml, the same calibration
    that also says what the control now takes out by itself. Every file is read back and compared with the model before it is there.
    `twin doc control` has the formats.
    """
    loaded = Machine.load(machine)
    errors = calibration_of(calibration, loaded)
    around = conditions(temperature, time)
    around.check(errors)
    place = _place(at)
    if read:
        if to is not None or output is not None or kind is None or not files:
            expected = "FILES --format F, and neither --to nor -o"
            raise InputError("--read does not fit", expected=expected, value=" ".join(map(str, files or [])))
        known, _ = known_at(around, errors)
        _tell(compared(loaded, known, kind.value, files, place, tool_length, around), errors, around, json_file)
        return
    if to is None or output is None or files or kind is not None:
        raise InputError("what to do", expected=f"--to {'|'.join(NAMES)} -o FOLDER, or --read FILES --format F")
    if step is not None:
        positive("--step", step)
    if tolerance is not None:
        positive("--tolerance", tolerance)
    request = Request(
        kind=to.value,
        at=place,
        tool_length_mm=tool_length,
        classes=_classes(scope),
        tolerance_um=format_named(to.value).tolerance_um if tolerance is None else 1e3 * tolerance,
        step=step,
        most=tables,
        products=products,
        conditions=around,
        add=add,
        notes=(f"twin: {loaded.name}, calibration {errors.path or 'none'}".encode("ascii", "replace").decode(),),
    )
    _write(loaded, errors, request, output, json_file)


def _write(machine: Machine, errors: Calibration, request: Request, output: Path, json_file: Path | None) -> None:
    """Make the tables, write the folder, and tell."""
    room = next(path for path in (output.absolute(), *output.absolute().parents) if path.exists())
    if not room.is_dir():
        raise InputError("cannot be written", expected="a folder, or a place for one", file=room)
    check_folder(room, output)
    if output.is_dir():
        check_writable(outputs_of(output, request.kind, machine))
    known, missing = known_at(request.conditions, errors)
    with progress() as say:
        say("tables", 0.0)
        made = make(machine, known, request)
        say("what remains", 0.6)
        account = deliver(made, errors, known, missing, output)
    _tell(account, errors, request.conditions, json_file)
    own = written_by(made)
    echo(f"\nwritten: {output}/ {' '.join(own)}")
    strange = {path.name for path in output.iterdir()} - {*own, "" if json_file is None else json_file.name}
    if strange:
        echo(f"also there, and not of these tables: {' '.join(sorted(strange))}")
    if account.unmet:
        raise typer.Exit(NOT_ALL_MET)


def _tell(found: Account | Existing, errors: Calibration, around: Conditions, json_file: Path | None) -> None:
    """Print what was found, and write it as JSON."""
    if json_file is not None:
        write_json(json_file, found.to_dict())
    echo(found.to_text(), end="")
    tell_unused(around, errors)


def _classes(scope: list[str] | None) -> frozenset[str]:
    """The basic classes of a scope; all of them if none is given."""
    if scope is None:
        return frozenset(BASIC)
    chosen = Scope.parse(scope)
    if chosen.orientation or not chosen.classes:
        raise InputError(
            "--scope FOR: tables correct the point, not the orientation",
            expected=f"some of {' '.join(BASIC)}",
            value="FOR",
        )
    return chosen.classes


def _place(at: list[str] | None) -> dict[str, float]:
    found: dict[str, float] = {}
    for entry in at or []:
        name, equals, text = entry.partition("=")
        if not equals or name in found:
            raise InputError("--at does not fit", expected="X=250 Y=225 …, each axis once", value=entry)
        found[name] = number("--at", text, entry)
    return found
