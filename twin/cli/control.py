"""Command ``twin control``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from twin._common.bundled import DEFAULT
from twin._common.errors import InputError
from twin._common.families import LIVE_FORMATS
from twin._common.files import check_folder, check_writable, write_json
from twin.cli.shared.command import POSITIVE, JsonOption, Output, command, progress_bar
from twin.cli.shared.complete import LISTS, one_of
from twin.cli.shared.installation import NOT_ALL_MET
from twin.cli.shared.options import (
    CalibrationOption,
    LoadOption,
    MachineOption,
    RpmOption,
    ScopeOption,
    TemperatureOption,
    TimeOption,
    ToolOption,
    calibration_of,
    conditions,
    print_unused,
)
from twin.cli.shared.options import (
    machine as machine_of,
)
from twin.cli.shared.terminal import echo, number, pairs

if TYPE_CHECKING:
    from twin.compensation.tables import (
        Account,
        Existing,
        KinematicsAccount,
        KinematicsRequest,
        ReadKinematics,
        Request,
    )
    from twin.machine.machine import Machine
    from twin.model.calibration import Calibration
    from twin.model.conditions import Conditions

Files = Annotated[list[Path] | None, typer.Argument(metavar="FILES", help="Files of the control, with --read.")]
To = Annotated[
    str | None,
    typer.Option("--to", help="Format of the tables, or kinematics module, to write.", **one_of("written_formats")),
]
OutputFolder = Annotated[
    Path | None, typer.Option("--output", "-o", help="Folder for the tables."), Output(folder=True)
]
Read = Annotated[bool, typer.Option("--read", help="Read existing tables and compare them with the calibration.")]
KINEMATICS_HELP = "Format of the control's kinematics to write: position and direction of the rotary axes."
ToKinematics = Annotated[str | None, typer.Option("--kinematics", help=KINEMATICS_HELP, **one_of("kinematics_formats"))]
FormatRead = Annotated[
    str | None, typer.Option("--format", help="Format of the files, with --read.", **one_of("control_formats"))
]
AT_HELP = (
    "Position of the other axes while one moves, mm and degrees: X=250 Y=225 Z=-200 B=0 C=0; default: middle of the linear ranges, "
    "zero of the rotary axes."
)
At = Annotated[list[str] | None, typer.Option("--at", help=AT_HELP)]
TOLERANCE_HELP = "Largest interpolation error between nodes, mm; default: that of the format (twin doc control)."
Tolerance = Annotated[float | None, typer.Option("--tolerance", help=TOLERANCE_HELP), POSITIVE]
STEP_HELP = "Distance between nodes, mm or degrees; default: as large as --tolerance allows."
Step = Annotated[float | None, typer.Option("--step", help=STEP_HELP), POSITIVE]
Tables = Annotated[
    int | None,
    typer.Option(
        "--tables", min=1, help="Number of tables in the control; default: that of the format (twin doc control)."
    ),
]
PRODUCTS_HELP = "Use products of two tables for angular errors, in formats that have them (twin doc control)."
Products = Annotated[bool, typer.Option("--products/--no-products", help=PRODUCTS_HELP)]
ADD_HELP = "Add to the tables or the kinematics module that were active when the calibration was measured."
Add = Annotated[bool, typer.Option("--add", help=ADD_HELP)]
FORCE_HELP = (
    "Also write tables and kinematics modules whose uncertainty exceeds their correction, and kinematics with locations that were "
    "not identified; the files say so."
)
Force = Annotated[bool, typer.Option("--force", help=FORCE_HELP)]


@command(
    "twin control --to siemens -o tables/ --tool-length 120",
    "twin control --to linuxcnc -o tables/ -c mine.yaml --at Y=225 Z=-200 --tolerance 0.0005 --json tables.json",
    "twin control --kinematics siemens-chain --to siemens -o control/ --tool-length 120",
    "twin control --to linuxcnc-kinematics -o live/ -c mine.yaml --tool-length 120",
    "twin control --read X.comp Y.comp joints.ini --format linuxcnc -c mine.yaml",
)
def control(
    files: Files = None,
    to: To = None,
    kinematics: ToKinematics = None,
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
    force: Force = False,
    temperature: TemperatureOption = None,
    time: TimeOption = None,
    rpm: RpmOption = None,
    load: LoadOption = None,
    json_file: JsonOption = None,
) -> None:
    """Write compensation tables and kinematics for the machine's control from a calibration, or check existing ones.

    The folder contains the control's files, README.txt (how to load them, and the remaining errors) and calibration.yaml, which also
    lists what the control now corrects. Every file is read back and compared with the model before it is written.
    `twin doc control` describes the formats.
    """
    _check_use(read, files, kind, to, kinematics, output)
    from twin.compensation.tables import KinematicsRequest

    loaded = machine_of(machine)
    errors = calibration_of(calibration, loaded)
    around = conditions(temperature, time, rpm, load)
    around.check(errors)
    fixed = _positions(at)
    if read and kind is not None and files:
        _read(errors, kind, files, fixed, tool_length, around, json_file)
        return
    if to in LIVE_FORMATS and output is not None:
        of_tables = {"--kinematics": kinematics, "--at": at, "--scope": scope, "--tolerance": tolerance, "--step": step}
        at_pins = {"--temperature": temperature, "--time": time, "--rpm": rpm, "--load": load}
        _check_live({**of_tables, "--tables": tables, **at_pins})
        _write_live(errors, add, force, tool_length, output, json_file)
        return
    notes = _notes(loaded, errors)
    own: dict[str, Any] = {
        "at": fixed,
        "tool_length_mm": tool_length,
        "classes": _classes(scope),
        "step": step,
        "most": tables,
    }
    own |= {"products": products, "conditions": around, "add": add, "notes": notes, "unproven": force}
    request = None if to is None else _request(to, None if tolerance is None else 1e3 * tolerance, own)
    if kinematics is not None and output is not None:
        both = KinematicsRequest(kinematics, request, tool_length, around, force, notes)
        _write_kinematics(errors, both, output, json_file)
    elif request is not None and output is not None:
        _write(loaded, errors, request, output, json_file)


def _request(to: str, tolerance_um: float | None, more: Mapping[str, Any]) -> Request:
    """Return the request for tables of a format; ``tolerance_um``: None for the format's own; ``more``: further arguments."""
    from twin.compensation.tables import Request
    from twin.controls import format_named

    return Request(
        kind=to, tolerance_um=format_named(to).tolerance_um if tolerance_um is None else tolerance_um, **more
    )


def _check_use(
    read: bool,
    files: list[Path] | None,
    kind: str | None,
    to: str | None,
    kinematics: str | None,
    output: Path | None,
) -> None:
    """Raise `InputError` unless the options are those of reading, or those of writing."""
    if read and (to is not None or kinematics is not None or output is not None or kind is None or not files):
        expected = "FILES --format F, and neither --to nor --kinematics nor -o"
        raise InputError("invalid use of --read", expected=expected, value=" ".join(map(str, files or [])))
    if not read and ((to is None and kinematics is None) or output is None or files or kind is not None):
        formats = f"--to {'|'.join(LISTS['written_formats'])} or --kinematics {'|'.join(LISTS['kinematics_formats'])}"
        raise InputError("no output chosen", expected=f"{formats} with -o FOLDER, or --read FILES --format F")


def _notes(machine: Machine, errors: Calibration) -> tuple[str, ...]:
    """Return the comment at the head of every file."""
    text = f"twin: {machine.name}, calibration {errors.path or 'none'}"
    return (text.encode("ascii", "replace").decode(),)


def _read(
    errors: Calibration,
    kind: str,
    files: list[Path],
    fixed: dict[str, float],
    tool_length: float | None,
    around: Conditions,
    json_file: Path | None,
) -> None:
    """Compare existing tables or kinematics with the calibration and print the result."""
    from twin.compensation.tables import compare_kinematics, compare_tables
    from twin.tool.uncertainty import without_missing_channels

    if kind in LISTS["table_formats"]:
        known, _ = without_missing_channels(around, errors)
        compared = compare_tables(errors.machine, known, kind, files, fixed, tool_length, around)
        _print(compared, errors, around, json_file)
        return
    if len(files) != 1:
        raise InputError("kinematics are a single file", expected="one file", value=" ".join(map(str, files)))
    _print(compare_kinematics(errors, kind, files[0], tool_length), errors, around, json_file)


def _write(machine: Machine, errors: Calibration, request: Request, output: Path, json_file: Path | None) -> None:
    """Make the tables, write the folder and print the result."""
    from twin.compensation.tables import make, outputs_of, write_folder, written_by
    from twin.tool.uncertainty import without_missing_channels

    _check_folder(output, outputs_of(output, request.kind, machine))
    known, missing = without_missing_channels(request.conditions, errors)
    with progress_bar() as bar:
        bar("tables", 0.0)
        made = make(machine, known, request)
        bar("what remains", 0.6)
        account = write_folder(made, errors, known, missing, output)
    _print(account, errors, request.conditions, json_file)
    _finish(account, output, written_by(made), json_file)


def _check_live(given: Mapping[str, object]) -> None:
    """Raise `InputError` if an option is given that means nothing for a kinematics module."""
    for option, value in given.items():
        if value is not None:
            raise InputError(
                f"{option} means nothing for a kinematics module: it corrects all errors, and conditions come to its pins",
                expected="--to linuxcnc-kinematics with -o, -m, -c, --tool-length, --add, --json",
                setting=option.removeprefix("--"),
            )


def _write_live(
    errors: Calibration, add: bool, force: bool, tool_length: float | None, output: Path, json_file: Path | None
) -> None:
    """Make the kinematics module, write the folder and print the account."""
    from twin.compensation.live import earlier_of, make_module, outputs_of, write_module

    _check_folder(output, outputs_of(output))
    with progress_bar() as bar:
        bar("kinematics module", 0.0)
        made = make_module(errors, tool_length_mm=tool_length, earlier=earlier_of(errors, add=add), force=force)
        write_module(made, output)
    if json_file is not None:
        write_json(json_file, made.to_dict())
    echo(made.to_text(), end="")
    echo(f"\nwritten: {output}/ {' '.join(path.name for path in outputs_of(output))}")


def _write_kinematics(errors: Calibration, request: KinematicsRequest, output: Path, json_file: Path | None) -> None:
    """Make kinematics and tables, write the folder and print the result."""
    from twin.compensation.tables import kinematics_outputs, kinematics_written, make_both, write_kinematics
    from twin.tool.uncertainty import without_missing_channels

    # Kinematics hold mean lines; tables made beside them must refer to the same ones.
    errors = replace(errors.in_datum("mean lines"), path=errors.path)
    known, missing = without_missing_channels(request.conditions, errors)
    with progress_bar() as bar:
        bar("kinematics and tables", 0.0)
        made = make_both(errors, known, request)
        _check_folder(output, kinematics_outputs(output, request, made[0]))
        bar("what remains", 0.6)
        account = write_kinematics(made, errors, known, missing, request, output)
    _print(account, errors, request.conditions, json_file)
    _finish(account, output, kinematics_written(made), json_file)


def _check_folder(output: Path, outputs: list[Path]) -> None:
    """Raise `InputError` unless the outputs can be written into the folder."""
    existing = next(path for path in (output.absolute(), *output.absolute().parents) if path.exists())
    if not existing.is_dir():
        raise InputError("cannot be written", expected="a folder", file=existing)
    check_folder(existing, output)
    if output.is_dir():
        check_writable(outputs)


def _finish(account: Account | KinematicsAccount, output: Path, own: tuple[str, ...], json_file: Path | None) -> None:
    """Print the files in the folder; exit with `NOT_ALL_MET` if a requirement is not met."""
    echo(f"\nwritten: {output}/ {' '.join(own)}")
    others = {path.name for path in output.iterdir()} - {*own, "" if json_file is None else json_file.name}
    if others:
        echo(f"other files in this folder: {' '.join(sorted(others))}")
    if account.unmet:
        raise typer.Exit(NOT_ALL_MET)


def _print(
    found: Account | Existing | KinematicsAccount | ReadKinematics,
    errors: Calibration,
    around: Conditions,
    json_file: Path | None,
) -> None:
    """Write the result as JSON and print it."""
    if json_file is not None:
        write_json(json_file, found.to_dict())
    echo(found.to_text(), end="")
    print_unused(around, errors)


def _classes(scope: list[str] | None) -> frozenset[str]:
    """Return the basic classes of a scope; all if none is given."""
    from twin._common.families import BASIC
    from twin.model.iso16907 import Scope

    if scope is None:
        return frozenset(BASIC)
    chosen = Scope.parse(scope)
    if chosen.orientation or not chosen.classes:
        raise InputError(
            "--scope FOR is not possible: tables correct the tool point, not the orientation",
            expected=f"one or more of {' '.join(BASIC)}",
            value="FOR",
        )
    return chosen.classes


def _positions(at: list[str] | None) -> dict[str, float]:
    words = pairs("--at", at, "X=250 Y=225 …, each axis once")
    return {name: number("--at", text, entry) for name, text, entry in words}
