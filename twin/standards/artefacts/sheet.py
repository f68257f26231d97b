"""The sheet of an artefact: a CSV file that ``twin plan --artefact`` writes, the user fills in, and ``twin evaluate`` reads.

Comments state what the budget needs, each as ``# key: value unit`` or ``# key: value ± limit unit``. A default is marked
``(assumed)``; whoever knows better changes the value and removes the mark. Readings are in columns ``reading_1_mm`` … (or ``_in``).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.csv_tables import read_table
from twin._common.errors import InputError, closest_name
from twin._common.families import ARTEFACTS
from twin._common.messages import Message
from twin.measurement.columns import RowNote

UNITS: Final[Mapping[str, Mapping[str, float]]] = {
    "mm": {"mm": 1.0, "um": 1e-3, "µm": 1e-3, "in": 25.4, "inch": 25.4},
    "mm/m": {"mm/m": 1.0, "um/m": 1e-3, "µm/m": 1e-3, "urad": 1e-3, "µrad": 1e-3},
    "°C": {"°C": 1.0, "degC": 1.0},
    "µm/(m·K)": {"µm/(m·K)": 1.0, "um/(m.K)": 1.0, "um/(m K)": 1.0, "ppm/K": 1.0},
}
"""Units that are read, with their factor to the one that is written."""
ASCII: Final = {"mm": "mm", "mm/m": "mm/m", "°C": "degC", "µm/(m·K)": "um/(m.K)"}
"""Units as written: a spreadsheet that saves the sheet in another encoding changes other letters."""
ASSUMED: Final = "(assumed)"
READING: Final = re.compile(r"reading_\d+_(mm|in)")
INCH_MM: Final = 25.4
_STATED: Final = re.compile(
    r"(?P<value>[-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*(?:(?:±|\+/-)\s*(?P<limit>[\d.]+(?:[eE][-+]?\d+)?)\s*)?(?P<unit>[^\s\d(][^(]*|)"
    r"(?:\((?P<factor>m[·. ]K\)))?\s*(?P<assumed>\(assumed\))?"
)


@final
@dataclass(frozen=True)
class SheetQuantity:
    """One statement that the budget of an artefact needs.

    Attributes:
        key: its name in the sheet.
        unit: one of `UNITS`.
        value: default; the limit itself for a quantity that is a limit.
        limit: default of its limit (rectangular), or None if it has none.
        meaning: what is to be stated, for the comments of the sheet.
    """

    key: str
    unit: str
    value: float
    limit: float | None
    meaning: str

    def text(self, value: float | None = None) -> str:
        """Return the comment line with the default, or with another value."""
        spread = "" if self.limit is None else f" +/- {self.limit:g}"
        return f"# {self.key}: {self.value if value is None else value:g}{spread} {ASCII[self.unit]} {ASSUMED}"


@final
@dataclass(frozen=True)
class SheetStatement:
    """A quantity as stated: value and limit in its unit, and whether it is still the default."""

    value: float
    limit: float
    assumed: bool
    text: str


@final
@dataclass(frozen=True)
class SheetRow:
    """One row with its line number."""

    path: Path
    line: int
    cells: Mapping[str, str]

    def error(self, name: str, what: str, expected: str, value: object = None) -> InputError:
        """Return an error at one cell."""
        shown = self.cells.get(name, "") if value is None else value
        return InputError(f"{name}: {what}", expected=expected, file=self.path, line=self.line, value=shown)

    def number(self, name: str) -> float:
        """Return a cell as number; `InputError` if it is none."""
        text = self.cells[name]
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not np.isfinite(value):
            raise self.error(name, "not a number", "a number with a decimal point, without its unit")
        return value

    def word(self, name: str, allowed: Sequence[str]) -> str:
        """Return a cell that is one of some words."""
        if self.cells[name] not in allowed:
            raise self.error(name, "unknown word", f"one of {' '.join(allowed)}")
        return self.cells[name]

    @property
    def readings(self) -> np.ndarray:
        """Readings of the row in mm; empty if there are none."""
        names = [name for name in self.cells if READING.fullmatch(name) and self.cells[name]]
        return np.array([self.number(name) * (INCH_MM if name.endswith("_in") else 1.0) for name in names])


@final
@dataclass(frozen=True, eq=False)
class ArtefactSheet:
    """A sheet that was filled in; rows without a reading are left out."""

    path: Path
    artefact: str
    machine: str
    plane: str
    stated: Mapping[str, SheetStatement]
    rows: tuple[SheetRow, ...]
    set_aside: tuple[RowNote, ...]

    def value(self, key: str) -> float:
        """Return a stated value."""
        return self.stated[key].value

    def limit(self, key: str) -> float:
        """Return the limit of a stated value."""
        return self.stated[key].limit

    @property
    def assumed(self) -> tuple[str, ...]:
        """Statements that are still the default."""
        return tuple(f"{key} {one.text}" for key, one in self.stated.items() if one.assumed)


LONGEST_KEY: Final = 80  # characters of the first line that are read to know a sheet


def is_sheet(path: Path) -> bool:
    """Return whether a file says that it is the sheet of an artefact; a pipe, which can be read once only, is a table."""
    try:
        if not path.is_file():
            return False
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            return re.match(r"#\s*artefact\s*:", file.readline(LONGEST_KEY)) is not None
    except OSError:
        return False


def read_sheet(
    path: Path, quantities: Mapping[str, Sequence[SheetQuantity]], columns: Mapping[str, Sequence[str]]
) -> ArtefactSheet:
    """Read a sheet.

    ``quantities`` and ``columns``: what each artefact needs. It raises `InputError` with line and value for an unknown artefact, key,
    unit or column, and for a statement that is missing.
    """
    header, rows, comments = read_table(path)
    given = _given(path, comments)
    for key in ("artefact", "machine", "plane"):
        if key not in given:
            raise InputError(f"the line `# {key}: …` is missing", expected="a sheet of twin plan --artefact", file=path)
    artefact, machine, plane = (given.pop(key)[1] for key in ("artefact", "machine", "plane"))
    if artefact not in ARTEFACTS:
        raise InputError(
            "unknown artefact", expected=f"one of {' '.join(ARTEFACTS)}", file=path, line=1, value=artefact
        )
    stated = _all_stated(path, given, quantities[artefact])
    _check_columns(path, header, columns[artefact])
    every = [SheetRow(path, line, dict(zip(header, cells, strict=True))) for line, cells in rows]
    filled = tuple(row for row in every if len(row.readings))
    if not filled:
        what = "no readings: the sheet is not filled in"
        raise InputError(what, expected="numbers in the columns reading_1_mm …", file=path)
    empty = tuple(RowNote(row.line, Message("no reading")) for row in every if not len(row.readings))
    return ArtefactSheet(path, artefact, machine, plane, stated, filled, empty)


Given = dict[str, tuple[int | None, str]]
"""Line and text of every comment of the form ``key: text``, by key."""


def _given(path: Path, comments: Sequence[str]) -> Given:
    given: Given = {}
    for text in comments:
        match = re.match(r"([a-z][a-z0-9 ]*?)\s*:\s*(.*)$", text)
        if match:
            line = _line_of(path, text)
            if match[1] in given:
                raise InputError(f"{match[1]} is stated twice", expected="one line", file=path, line=line, value=text)
            given[match[1]] = (line, match[2].strip(" ,"))
    return given


def _all_stated(path: Path, given: Given, quantities: Sequence[SheetQuantity]) -> dict[str, SheetStatement]:
    stated = {}
    for own in quantities:
        if own.key not in given:
            expected = own.text().removesuffix(f" {ASSUMED}") + f" ({own.meaning})"
            raise InputError(f"{own.key} is not stated", expected=expected, file=path)
        stated[own.key] = _statement(own, *given.pop(own.key), path)
    for key, (line, text) in given.items():
        near = closest_name(key, [own.key for own in quantities])
        if near is not None:
            raise InputError(f"unknown statement {key}", expected=near, file=path, line=line, value=text)
    return stated


def _check_columns(path: Path, header: Sequence[str], columns: Sequence[str]) -> None:
    for name in columns:
        if name not in header:
            raise InputError(f"the column {name} is missing", expected=" ".join(columns), file=path)
    for name in header:
        if name not in columns and not READING.fullmatch(name):
            expected = f"{' '.join(columns)} reading_1_mm … (or reading_1_in …)"
            raise InputError("unknown column, or one without its unit", expected=expected, file=path, value=name)


def _statement(own: SheetQuantity, line: int | None, text: str, path: Path) -> SheetStatement:
    match = _STATED.fullmatch(text)
    units = UNITS[own.unit]
    unit = "" if match is None else (match["unit"] + (f"({match['factor']}" if match["factor"] else "")).strip()
    expected = own.text().removesuffix(f" {ASSUMED}").removeprefix("# ") + f" ({own.meaning})"
    if match is None or unit not in units or (match["limit"] is None) is not (own.limit is None):
        missing = match is not None and not unit
        what = f"{own.key}: the unit is missing" if missing else f"{own.key} cannot be read"
        raise InputError(what, expected=expected, file=path, line=line, value=text)
    try:
        value, limit = float(match["value"]), float(match["limit"] or 0.0)
    except ValueError:
        raise InputError(f"{own.key} is not a number", expected=expected, file=path, line=line, value=text) from None
    if own.limit is None and value < 0.0:
        raise InputError(f"{own.key} is a limit", expected="not negative", file=path, line=line, value=text)
    factor = units[unit]
    return SheetStatement(
        value * factor, limit * factor, match["assumed"] is not None, text.replace(ASSUMED, "").strip()
    )


def _line_of(path: Path, text: str) -> int | None:
    """Return the first line of a comment."""
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    return next((k for k, line in enumerate(lines, start=1) if line.strip().lstrip("# ") == text), None)


def sheet_text(
    artefact: str,
    machine: str,
    plane: str,
    quantities: Sequence[str],
    steps: Sequence[str],
    rows: Sequence[Mapping[str, str]],
    repeats: int,
) -> str:
    """Return the text of an empty sheet: statements, steps, and a row for every reading."""
    columns = [*rows[0], *(f"reading_{k + 1}_mm" for k in range(repeats))]
    lines = [f"# artefact: {artefact}", f"# machine: {machine}", f"# plane: {plane}", *quantities]
    lines += [f"# {k}) {text}" for k, text in enumerate(steps, start=1)]
    lines += [",".join(columns), *(",".join([*row.values(), *[""] * repeats]) for row in rows)]
    return "\n".join(lines) + "\n"
