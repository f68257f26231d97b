"""All table formats, one file each; to add one, write its file and add it to `twin._common.families.TABLE_FORMATS`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from twin._common import families
from twin._common.errors import InputError
from twin.machine.control.correction import Correction
from twin.machine.control.format import TableFormat
from twin.machine.machine import Machine

FORMATS: Final[tuple[TableFormat[Any], ...]] = families.members(__name__, families.TABLE_FORMATS)
"""All formats."""


def format_named(name: str) -> TableFormat[Any]:
    """Return the format of that name.

    Raises:
        InputError: there is no such format.
    """
    for form in FORMATS:
        if form.name == name:
            return form
    names = " ".join(form.name for form in FORMATS)
    raise InputError("no such format of control tables", expected=f"one of {names}", value=name)


def read_tables(kind: str, files: Sequence[Path], machine: Machine) -> Correction:
    """Return the tables of one control from its files.

    Args:
        kind: name of one of `FORMATS`.
        files: all files of the control, including those that assign tables to axes.
        machine: the machine whose axes they move.

    Raises:
        InputError: there is no such format, or a file is invalid.
    """
    return format_named(kind).read(files, machine)
