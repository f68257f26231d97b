"""Write the output folder: the control's files, README.txt, and the calibration that records what the control corrects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from twin._common.errors import InputError
from twin._common.files import check_writable, scratch_folder, write_atomic
from twin.control.account import Account
from twin.control.make import ControlTables, design_of
from twin.control.remains import corrected_shares, remaining_errors
from twin.machine.calibration import Calibration
from twin.machine.control import ControlSection, TableEntry, TableFormat, format_named
from twin.machine.machine import Machine

README: Final = "README.txt"
CALIBRATION: Final = "calibration.yaml"
ADDED: Final = "added"


def outputs_of(folder: Path, kind: str, machine: Machine) -> list[Path]:
    """Return every file that may be written into a folder for a format."""
    names = format_named(kind).files(machine)
    return [folder / name for name in (*names, README, CALIBRATION)]


def written_by(made: ControlTables) -> tuple[str, ...]:
    """Return the names of the files written into the folder; other files in it do not belong to these tables."""
    return (*made.files, README, CALIBRATION, *([ADDED] if made.increment else []))


def account_of(
    made: ControlTables, errors: Calibration, known: Calibration, missing: Mapping[str, tuple[str, ...]]
) -> Account:
    """Return the account of the tables; the remaining error is computed from the files as read back.

    Args:
        made: the tables.
        errors: the calibration they were made from.
        known: the same without effects whose channel is not given.
        missing: the effects left out, by channel.
    """
    with scratch_folder() as folder:
        section = _section(made, _write(made.increment or made.files, folder, made.request.form))
        remaining = remaining_errors(made.required, known.with_control(section))
    request = made.request
    return Account(
        made,
        remaining,
        corrected_shares(
            made.required,
            replace(request, products=request.products and not made.left_out),
            design_of(request.form),
            made.unproven,
        ),
        missing,
        errors,
    )


def write_folder(
    made: ControlTables, errors: Calibration, known: Calibration, missing: Mapping[str, tuple[str, ...]], folder: Path
) -> Account:
    """Write the folder, created if necessary: the control's files first, the calibration that refers to them last.

    Args:
        made: the tables.
        errors: the calibration they were made from.
        known: the same without effects whose channel is not given.
        missing: the effects left out, by channel.
        folder: the output folder.

    Raises:
        InputError: an output is also an input, or cannot be written.
    """
    outputs = outputs_of(folder, made.request.kind, made.required.machine)
    inputs = [errors.path] if errors.path is not None else []
    inputs += [entry.file for entry in errors.control.tables] if errors.control is not None and made.increment else []
    for path in outputs:
        if path.resolve() in {one.resolve() for one in inputs}:
            raise InputError("an output is one of the inputs", expected="another folder", file=path)
    account = account_of(made, errors, known, missing)
    folder.mkdir(parents=True, exist_ok=True)
    paths = _write(made.files, folder, made.request.form)
    if made.increment:
        (folder / ADDED).mkdir(exist_ok=True)
        check_writable([folder / ADDED / name for name in made.increment])
        paths = _write(made.increment, folder / ADDED, made.request.form)
    write_atomic(folder / README, account.to_text())
    marked = replace(errors, source=f"{errors.source}; the control has compensation tables ({made.request.kind})")
    section = _section(made, paths)
    # Kinematics that the control holds already stay as they are.
    held = () if errors.control is None else errors.control.kinematics
    marked.with_control(replace(section, kinematics=held)).save(folder / CALIBRATION)
    return account


def _write(files: Mapping[str, str], folder: Path, form: TableFormat[Any]) -> list[Path]:
    """Write the files and return the paths of those that are read back."""
    for name, text in files.items():
        write_atomic(folder / name, text)
    return [folder / name for name in form.to_read(files)]


def _section(made: ControlTables, paths: Sequence[Path]) -> ControlSection:
    """Return the ``control:`` section of the calibration for these table files."""
    request = made.request
    return ControlSection(
        "uncorrected", tuple(TableEntry.of(path, request.kind, request.carried_classes) for path in paths)
    )
