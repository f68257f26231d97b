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
from twin.control import Request, compared, deliver, make, outputs_of, written_by
from twin.machine.control import FORMATS
from twin.machine.iso16907 import BASIC, Scope
from twin.machine.machine import DEFAULT, Machine
from twin.uncertainty.budget import known_at

Kind = StrEnum("Kind", {name: name for name in FORMATS})  # type: ignore[misc]
GRID_TOLERANCE_MM = 0.005


@command(
    "twin control --to siemens -o tables/ --tool-length 120",
    "twin control --to linuxcnc -o tables/ -c mine.yaml --at Y=225 Z=-200 --tolerance 0.0005 --json tables.json",
    "twin control --read X.comp Y.comp joints.ini --format linuxcnc -c mine.yaml",
)
def control(
    files: Annotated[
        list[Path] | None, typer.Argument(metavar="FILES", help="With --read: the files of the control.")
    ] = None,
    to: Annotated[Kind | None, typer.Option("--to", help="The format to write.")] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="The folder they go to."), Output(folder=True)
    ] = None,
    read: Annotated[
        bool, typer.Option("--read", help="Say what existing tables do, and how the model differs.")
    ] = False,
    kind: Annotated[Kind | None, typer.Option("--format", help="Of the files that are read.")] = None,
    machine: MachineOption = DEFAULT,
    calibration: CalibrationOption = None,
    tool_length: ToolOption = None,
    at: Annotated[
        list[str] | None,
        typer.Option(
            "--at",
            help="Where the other axes stand while one moves: X=250 Y=225 Z=-200 B=0 C=0; the middle of the linear, zero of the "
            "rotary ranges if not given.",
        ),
    ] = None,
    scope: ScopeOption = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            "--tolerance",
            help=f"mm the model may be off the straight lines between nodes; 0.001, of a grid {GRID_TOLERANCE_MM:g}, if not given.",
        ),
    ] = None,
    step: Annotated[
        float | None,
        typer.Option("--step", help="mm (degrees) between nodes; as wide as the tolerance allows if not given."),
    ] = None,
    tables: Annotated[
        int | None, typer.Option("--tables", min=1, help="Tables the control has (siemens: 62 if not given; 828D: 8).")
    ] = None,
    products: Annotated[
        bool,
        typer.Option("--products/--no-products", help="Whether siemens tables may be multiplied, for angular errors."),
    ] = True,
    add: Annotated[
        bool,
        typer.Option(
            "--add", help="The calibration's errors are left under its tables: write those and the new ones together."
        ),
    ] = False,
    temperature: TemperatureOption = None,
    time: TimeOption = None,
    json_file: JsonOption = None,
) -> None:
    """Compensation tables for the machine's own control, from a calibration; or what existing ones say.

    The folder gets the control's files, README.txt (how to load them, what they leave) and calibration.yaml, the same calibration
    that also says
    what the control now takes out by itself. Every file is read back and compared with the model before it is there. `twin doc control`
    has the formats.
    """
    loaded = Machine.load(machine)
    errors = calibration_of(calibration, loaded)
    around = conditions(temperature, time)
    around.check(errors)
    known, missing = known_at(around, errors)
    place = _place(at)
    if read:
        if to is not None or output is not None or kind is None or not files:
            raise InputError(
                "--read does not fit",
                expected="FILES --format F, and neither --to nor -o",
                value=" ".join(map(str, files or [])),
            )
        found = compared(loaded, known, kind.value, files, place, tool_length, around)
        if json_file is not None:
            write_json(json_file, found.to_dict())
        echo(found.to_text(), end="")
        tell_unused(around, errors)
        return
    if to is None or output is None or files or kind is not None:
        raise InputError("what to do", expected=f"--to {'|'.join(FORMATS)} -o FOLDER, or --read FILES --format F")
    chosen = None if scope is None else Scope.parse(scope)
    if chosen is not None and (chosen.orientation or not chosen.classes):
        raise InputError(
            "--scope FOR: tables correct the point, not the orientation",
            expected=f"some of {' '.join(BASIC)}",
            value="FOR",
        )
    default = GRID_TOLERANCE_MM if to.value == "grid" else 1e-3
    if step is not None:
        positive("--step", step)
    positive("--tolerance", default if tolerance is None else tolerance)
    notes = (f"twin: {loaded.name}, calibration {errors.path or 'none'}".encode("ascii", "replace").decode(),)
    request = Request(
        kind=to.value,
        at=place,
        tool_length_mm=tool_length,
        classes=frozenset(BASIC) if chosen is None else chosen.classes,
        tolerance_um=1e3 * (default if tolerance is None else tolerance),
        step=step,
        most=tables if tables is not None else Request(to.value).most,
        products=products,
        conditions=around,
        add=add,
        notes=notes,
    )
    room = next(path for path in (output.absolute(), *output.absolute().parents) if path.exists())
    if not room.is_dir():
        raise InputError("cannot be written", expected="a folder, or a place for one", file=room)
    check_folder(room, output)
    if output.is_dir():
        check_writable(outputs_of(output, to.value, loaded))
    with progress() as say:
        say("tables", 0.0)
        made = make(loaded, known, request)
        say("what remains", 0.6)
        account = deliver(made, errors, known, missing, output)
    if json_file is not None:
        write_json(json_file, account.to_dict())
    echo(account.to_text(), end="")
    tell_unused(around, errors)
    echo(f"\nwritten: {output}/ {' '.join(written_by(made))}")
    strange = sorted(
        {path.name for path in output.iterdir()} - {*written_by(made), "" if json_file is None else json_file.name}
    )
    if strange:
        echo(f"also there, and not of these tables: {' '.join(strange)}")
    if account.unmet:
        raise typer.Exit(NOT_ALL_MET)


def _place(at: list[str] | None) -> dict[str, float]:
    found: dict[str, float] = {}
    for entry in at or []:
        name, equals, text = entry.partition("=")
        if not equals or name in found:
            raise InputError("--at does not fit", expected="X=250 Y=225 …, each axis once", value=entry)
        found[name] = number("--at", text, entry)
    return found
