"""Command ``twin control``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin._common.bundled import DEFAULT
from twin._common.errors import InputError
from twin._common.families import LIVE_FORMATS
from twin._common.files import check_folder, check_writable
from twin.cli.shared import options
from twin.cli.shared.command import POSITIVE, CommandResult, JsonOption, Output, command, progress_bar
from twin.cli.shared.complete import LISTS, one_of
from twin.cli.shared.terminal import number, pairs

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
    machine: options.MachineOption = DEFAULT,
    calibration: options.CalibrationOption = None,
    tool_length: options.ToolOption = None,
    at: At = None,
    scope: options.ScopeOption = None,
    tolerance: Tolerance = None,
    step: Step = None,
    tables: Tables = None,
    products: Products = True,
    add: Add = False,
    force: Force = False,
    temperature: options.TemperatureOption = None,
    time: options.TimeOption = None,
    rpm: options.RpmOption = None,
    load: options.LoadOption = None,
    json_file: JsonOption = None,
) -> CommandResult:
    """Write compensation tables and kinematics for the machine's control from a calibration, or check existing ones.

    The folder contains the control's files, README.txt (how to load them, and the remaining errors) and calibration.yaml, which also
    lists what the control now corrects. Every file is read back and compared with the model before it is written.
    `twin doc control` describes the formats.
    """
    _check_use(read, files, kind, to, kinematics, output)
    from twin.compensation.tables import KinematicsRequest, Request
    from twin.controls import format_named

    loaded = options.machine(machine)
    errors = options.calibration_of(calibration, loaded)
    around = options.conditions(temperature, time, rpm, load)
    around.check(errors)
    words = pairs("--at", at, "X=250 Y=225 …, each axis once")
    fixed = {name: number("--at", text, entry) for name, text, entry in words}
    if read and kind is not None and files:
        return _result(_read(errors, kind, files, fixed, tool_length, around), options.unused(around, errors))
    folder = Path() if output is None else output
    if to in LIVE_FORMATS:
        of_tables = {"--kinematics": kinematics, "--at": at, "--scope": scope, "--tolerance": tolerance, "--step": step}
        at_pins = {"--temperature": temperature, "--time": time, "--rpm": rpm, "--load": load}
        _check_live({**of_tables, "--tables": tables, **at_pins})
        return _write_live(errors, add, force, tool_length, folder)
    head = f"twin: {loaded.name}, calibration {errors.path or 'none'}"
    notes = (head.encode("ascii", "replace").decode(),)
    request = None
    if to is not None:
        request = Request(
            kind=to,
            tolerance_um=format_named(to).tolerance_um if tolerance is None else 1e3 * tolerance,
            at=fixed,
            tool_length_mm=tool_length,
            classes=_classes(scope),
            step=step,
            most=tables,
            products=products,
            conditions=around,
            add=add,
            notes=notes,
            unproven=force,
        )
    account: Account | KinematicsAccount
    if kinematics is None and request is not None:
        account, own = _write(loaded, errors, request, folder)
    else:
        both = KinematicsRequest(str(kinematics), request, tool_length, around, force, notes)
        account, own = _write_kinematics(errors, both, folder)
    others = {path.name for path in folder.iterdir()} - {*own, "" if json_file is None else json_file.name}
    after = [f"other files in this folder: {' '.join(sorted(others))}"] if others else []
    return _result(account, [*options.unused(around, errors), _written(folder, own), *after], met=not account.unmet)


def _result(
    found: Account | Existing | KinematicsAccount | ReadKinematics, after: list[str], *, met: bool = True
) -> CommandResult:
    return CommandResult(found.to_text(), found.to_dict, met=met, written=None, after=after)


def _written(folder: Path, names: Iterable[str]) -> str:
    return f"\nwritten: {folder}/ {' '.join(names)}"


def _check_use(
    read: bool, files: list[Path] | None, kind: str | None, to: str | None, kinematics: str | None, output: Path | None
) -> None:
    if read and (to is not None or kinematics is not None or output is not None or kind is None or not files):
        expected = "FILES --format F, and neither --to nor --kinematics nor -o"
        raise InputError("invalid use of --read", expected=expected, value=" ".join(map(str, files or [])))
    if not read and ((to is None and kinematics is None) or output is None or files or kind is not None):
        formats = f"--to {'|'.join(LISTS['written_formats'])} or --kinematics {'|'.join(LISTS['kinematics_formats'])}"
        raise InputError("no output chosen", expected=f"{formats} with -o FOLDER, or --read FILES --format F")


def _read(
    errors: Calibration,
    kind: str,
    files: list[Path],
    fixed: dict[str, float],
    tool_length: float | None,
    around: Conditions,
) -> Existing | ReadKinematics:
    from twin.compensation.tables import compare_kinematics, compare_tables
    from twin.tool.uncertainty import without_missing_channels

    if kind in LISTS["table_formats"]:
        known, _ = without_missing_channels(around, errors)
        return compare_tables(errors.machine, known, kind, files, fixed, tool_length, around)
    if len(files) != 1:
        raise InputError("kinematics are a single file", expected="one file", value=" ".join(map(str, files)))
    return compare_kinematics(errors, kind, files[0], tool_length)


def _write(machine: Machine, errors: Calibration, request: Request, output: Path) -> tuple[Account, tuple[str, ...]]:
    """Make the tables and write the folder; return the account and the names of the files."""
    from twin.compensation.tables import make, outputs_of, write_folder, written_by
    from twin.tool.uncertainty import without_missing_channels

    _check_folder(output, outputs_of(output, request.kind, machine))
    known, missing = without_missing_channels(request.conditions, errors)
    with progress_bar() as bar:
        bar("tables", 0.0)
        made = make(machine, known, request)
        bar("what remains", 0.6)
        account = write_folder(made, errors, known, missing, output)
    return account, written_by(made)


def _check_live(given: Mapping[str, object]) -> None:
    """Raise `InputError` if an option is given that means nothing for a kinematics module."""
    for option, value in given.items():
        if value is not None:
            raise InputError(
                f"{option} means nothing for a kinematics module: it corrects all errors, and conditions come to its pins",
                expected="--to linuxcnc-kinematics with -o, -m, -c, --tool-length, --add, --json",
                setting=option.removeprefix("--"),
            )


def _write_live(errors: Calibration, add: bool, force: bool, tool_length: float | None, output: Path) -> CommandResult:
    from twin.compensation.live import earlier_of, make_module, outputs_of, write_module

    _check_folder(output, outputs_of(output))
    with progress_bar() as bar:
        bar("kinematics module", 0.0)
        made = make_module(errors, tool_length_mm=tool_length, earlier=earlier_of(errors, add=add), force=force)
        write_module(made, output)
    after = [_written(output, (path.name for path in outputs_of(output)))]
    return CommandResult(made.to_text(), made.to_dict, written=None, after=after)


def _write_kinematics(
    errors: Calibration, request: KinematicsRequest, output: Path
) -> tuple[KinematicsAccount, tuple[str, ...]]:
    """Make kinematics and tables and write the folder; return the account, the names of the files."""
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
    return account, kinematics_written(made)


def _check_folder(output: Path, outputs: list[Path]) -> None:
    """Raise `InputError` unless the outputs can be written into the folder."""
    existing = next(path for path in (output.absolute(), *output.absolute().parents) if path.exists())
    if not existing.is_dir():
        raise InputError("cannot be written", expected="a folder", file=existing)
    check_folder(existing, output)
    if output.is_dir():
        check_writable(outputs)


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
