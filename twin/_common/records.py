"""Records over time: temperatures and spindle speed in rows of a CSV file."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence, Set
from dataclasses import fields, is_dataclass
from math import isfinite
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np

from twin._common.csv_tables import Cells, read_table, unused_column_note
from twin._common.errors import InputError
from twin._common.messages import Message
from twin._common.units import count_with_noun

TIME: Final = "time_s"
SPEED: Final = "spindle_rpm"
APPROACH: Final = "approach_"
"""Beginning of the name of a column with an axis's direction of approach: +1 from below, −1 from above, 0 unknown."""
RECORD_OF_CONTROL: Final = "record of the control"
"""Beginning of the first comment of a record that a control with live compensation writes (`twin doc control`)."""
MAX_CELLS: Final = 5_000_000


class LogColumns(NamedTuple):
    """Columns of a record, complete and checked."""

    cells: Cells
    numbers: Mapping[str, np.ndarray]  # (n,) values of every column that was read, by its name
    notices: tuple[Message, ...]  # names of columns that were not read, in words


def is_temperature(name: str) -> bool:
    """Return whether a column is ``T_<sensor>_degC``."""
    return name.startswith("T_") and name.endswith("_degC") and len(name) > len("T__degC")


def sensor_of(name: str) -> str:
    """Return the sensor of a column of temperatures."""
    return name[len("T_") : -len("_degC")]


def read_record(path: str | Path) -> tuple[Cells, tuple[str, ...]]:
    """Return cells and comments of a record over time; raise `InputError` without a column of times or with fewer than two rows."""
    file = Path(path)
    header, rows, comments = read_table(file)
    if TIME not in header:
        raise InputError("no column of times", expected=f"a column {TIME}", file=file, line=1, value=",".join(header))
    if len(rows) < 2:
        raise InputError(count_with_noun(len(rows), "row"), expected="at least 2 rows below the header", file=file)
    return Cells(file, {name: i for i, name in enumerate(header)}, rows), tuple(comments)


def check_course(cells: Cells, numbers: Mapping[str, np.ndarray]) -> None:
    """Raise `InputError` unless times increase from row to row and no speed is negative."""
    cells.refuse(np.r_[False, np.diff(numbers[TIME]) <= 0.0], numbers[TIME], TIME, "a later time in every row")
    if SPEED in numbers:
        cells.refuse(numbers[SPEED] < 0.0, numbers[SPEED], SPEED, "0 or above")


def read_log(path: str | Path, also: Callable[[str], bool] = lambda name: False) -> LogColumns:
    """Read the columns ``time_s``, ``T_<sensor>_degC``, ``spindle_rpm`` of a record, and those whose name ``also`` accepts.

    Raises `InputError` with line and value: no times, neither temperature nor speed, a cell that is empty or no number, a time that
    does not increase, a negative speed, too few or too many rows.
    """
    cells, _ = read_record(path)
    header, rows, file = list(cells.columns), cells.rows, cells.path
    if SPEED not in header and not any(map(is_temperature, header)):
        expected = f"columns T_<sensor>_degC, {SPEED} or both"
        raise InputError("no temperature and no speed", expected=expected, file=file, line=1, value=",".join(header))
    if len(rows) * len(header) > MAX_CELLS:
        raise InputError(count_with_noun(len(rows), "row"), expected=f"at most {MAX_CELLS} cells", file=file)
    known = [name for name in header if name in (TIME, SPEED) or is_temperature(name) or also(name)]
    numbers = {name: cells.numbers(name) for name in known}
    for name, values in numbers.items():
        cells.refuse(~np.isfinite(values), values, name, "a number in every row")
    check_course(cells, numbers)
    unused = tuple(unused_column_note(name, sorted(known)) for name in header if name not in known)
    return LogColumns(cells, MappingProxyType(numbers), unused)


# --- Conversion of results to JSON data by one rule for all dataclasses ---------------------------

_NONE: Mapping[str, str] = MappingProxyType({})


def json_form(value: Any, *, rename: Mapping[str, str] = _NONE, leave_out: Collection[str] = ()) -> Any:
    """Return a value as numbers, text, lists and dictionaries; null for a number that is not finite; `TypeError` if it cannot be.

    A dataclass becomes a dictionary of its fields in their order, without ``leave_out`` and with the keys of ``rename``; a part with
    a method `to_dict` becomes what that returns.
    """
    if is_dataclass(value) and not isinstance(value, type):
        kept = [field.name for field in fields(value) if field.name not in leave_out]
        return {rename.get(name, name): _part(getattr(value, name)) for name in kept}
    return _part(value)


def _part(value: Any) -> Any:
    if hasattr(value, "to_dict"):
        return value.to_dict()
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _part(item) for key, item in value.items()}
    if isinstance(value, Sequence | Set):
        return [_part(item) for item in value]
    if is_dataclass(value) and not isinstance(value, type):
        return json_form(value)
    raise TypeError(f"cannot convert {type(value).__name__} to JSON")
