"""The folder: files of the control, the text beside them, and the calibration that says what the control takes out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from twin._common.errors import InputError
from twin._common.files import check_writable, scratch_folder, write_whole
from twin.control.account import Account
from twin.control.make import Made, design_of
from twin.control.remains import carried, remains
from twin.machine.calibration import Calibration
from twin.machine.control import ControlSection, TableEntry, TableFormat, format_named
from twin.machine.machine import Machine

README: Final = "README.txt"
CALIBRATION: Final = "calibration.yaml"
ADDED: Final = "added"


def outputs_of(folder: Path, kind: str, machine: Machine) -> list[Path]:
    """Every file that may be written into a folder."""
    names = format_named(kind).files(machine)
    return [folder / name for name in (*names, README, CALIBRATION)]


def written_by(made: Made) -> tuple[str, ...]:
    """Names in the folder that these tables have: what else lies there is of another run, or somebody else's."""
    return (*made.files, README, CALIBRATION, *([ADDED] if made.increment else []))


def account_of(made: Made, errors: Calibration, known: Calibration, missing: Mapping[str, tuple[str, ...]]) -> Account:
    """What there is to say of the tables, with what they leave worked out through their files.

    Args:
        made: the tables.
        errors: the calibration they were made from.
        known: the same without effects whose channel nobody gave.
        missing: these, by channel.
    """
    with scratch_folder() as folder:
        section = _section(made, _write(made.increment or made.files, folder, made.request.form))
        left = remains(made.wanted, known.with_control(section))
    request = made.request
    return Account(
        made,
        left,
        carried(
            made.wanted, replace(request, products=request.products and not made.left_out), design_of(request.form)
        ),
        missing,
        errors,
    )


def deliver(
    made: Made, errors: Calibration, known: Calibration, missing: Mapping[str, tuple[str, ...]], folder: Path
) -> Account:
    """Write the folder, made if it is not there: the control's files first, the calibration that names them last.

    Args:
        made: the tables.
        errors: the calibration they were made from.
        known: the same without effects whose channel nobody gave.
        missing: these, by channel.
        folder: where to.

    Raises:
        InputError: an output is one of the inputs, or cannot be written.
    """
    outputs = outputs_of(folder, made.request.kind, made.wanted.machine)
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
    write_whole(folder / README, account.to_text())
    told = replace(errors, source=f"{errors.source}; its control has compensation tables ({made.request.kind})")
    told.with_control(_section(made, paths)).save(folder / CALIBRATION)
    return account


def _write(files: Mapping[str, str], folder: Path, form: TableFormat[Any]) -> list[Path]:
    """Write all, and say which of them are read back."""
    for name, text in files.items():
        write_whole(folder / name, text)
    return [folder / name for name in form.to_read(files)]


def _section(made: Made, paths: Sequence[Path]) -> ControlSection:
    request = made.request
    return ControlSection(
        "uncorrected", tuple(TableEntry.of(path, request.kind, request.carried_classes) for path in paths)
    )
