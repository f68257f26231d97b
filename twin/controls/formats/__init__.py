"""All table formats, one file each; to add one, write its file and add it to `twin._common.families.TABLE_FORMATS`."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from twin._common import families
from twin._common.errors import InputError
from twin.controls.correction import Correction
from twin.controls.format import TableFormat
from twin.machine.machine import Machine


def table_formats() -> tuple[TableFormat[Any], ...]:
    """Return all formats."""
    return tuple(map(format_named, families.TABLE_FORMATS))


@cache
def format_named(name: str) -> TableFormat[Any]:
    """Return the format of that name, without importing the others; raise `InputError` if there is none."""
    if name not in families.TABLE_FORMATS:
        expected = f"one of {' '.join(families.TABLE_FORMATS)}"
        raise InputError("no such format of control tables", expected=expected, value=name)
    form: TableFormat[Any] = families.member(__name__, families.TABLE_FORMATS, name)
    return form


def read_tables(kind: str, files: Sequence[Path], machine: Machine) -> Correction:
    """Return the tables of one control from all of its files; raise `InputError` for an unknown format or an invalid file."""
    return format_named(kind).read(files, machine)
