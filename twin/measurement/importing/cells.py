"""Raw cells of a table file: text of any usual encoding, delimiter and decimal sign, or a sheet of a workbook."""

from __future__ import annotations

import csv
import io
import re
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date, datetime, time
from hashlib import sha256
from itertools import islice
from pathlib import Path
from typing import Any, Final, final
from xml.etree.ElementTree import ParseError

from twin._common.errors import InputError, closest_name
from twin._common.files import read_bytes
from twin._common.units import count_with_noun
from twin._common.yaml_files import quoted
from twin.measurement.importing.quantities import looks_like_number, split_unit, unit_named

MAX_BYTES: Final = 2**26
"""Largest file; a measurement of a machine has less than 10 MB."""
MAX_UNPACKED_BYTES: Final = 2**29
"""Largest content of a workbook with its parts unpacked."""
MAX_ROWS: Final = 500_000
MAX_COLUMNS: Final = 1000
MAX_CELLS: Final = 3_000_000
"""Largest number of cells, empty ones included: a measurement of a machine has less than a tenth of it."""
CELL_MARKS: Final = (b"<c ", b":c ", b"<c>")
"""Beginnings of a cell in the XML of a sheet, with or without attributes or a prefix."""
_SHEET_PART: Final = re.compile(r"xl/worksheets/[^/]+\.xml")
SAMPLE_ROWS: Final = 2000
"""Number of rows that show the delimiter."""
DELIMITERS: Final = {"\t": "tab", ";": "semicolon", "|": "bar", ",": "comma", " ": "space"}
"""Delimiters in the order in which they are tried, with their names in a mapping file."""
_UTF16: Final = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
_WORKBOOK_ERRORS: Final = (
    zipfile.BadZipFile,
    zlib.error,
    ParseError,
    KeyError,
    ValueError,
    TypeError,
    AttributeError,
    IndexError,
    EOFError,
    NotImplementedError,
)
"""Exceptions that openpyxl and zipfile raise for damaged workbooks."""


def yaml_list(names: Iterable[str]) -> str:
    """Return names as a list of YAML."""
    return f"[{', '.join(map(quoted, names))}]"


Merged = tuple[tuple[int, int, int], ...]
"""Merged cells of several rows: first and last line, and index of the first column."""


@final
@dataclass(frozen=True)
class RawTable:
    """Cells of a file as text, without any interpretation.

    Attributes:
        digest: SHA-256 of the file, hexadecimal.
        rows: rows with their 1-based lines, cells without surrounding blanks; empty rows are left out.
        comments: text of the comment lines, without their mark.
        encoding: encoding of a text file; empty for a workbook.
        delimiter: name of the delimiter (`DELIMITERS`); empty for a workbook.
        sheet: name of the sheet; empty for a text file.
        merged: merged cells of several rows, as first and last line and index of the column.
    """

    path: Path
    digest: str
    size: int
    rows: tuple[tuple[int, tuple[str, ...]], ...]
    comments: tuple[str, ...]
    encoding: str = ""
    delimiter: str = ""
    sheet: str = ""
    merged: Merged = ()

    @property
    def origin(self) -> str:
        """Name, size and SHA-256 of the file, and its sheet."""
        sheet = f", sheet {self.sheet}" if self.sheet else ""
        return f"{self.path.name}{sheet}, {self.size} bytes, SHA-256 {self.digest[:16]}"


def read_cells(path: Path, *, sheet: str | None = None, encoding: str = "", delimiter: str = "") -> RawTable:
    """Return the cells of a text file or of one sheet of an Excel workbook.

    ``sheet``: sheet of a workbook; None for the only one that is not empty; ``encoding``: encoding of a text file; empty to find it
    from the content; ``delimiter``: name of the delimiter (`DELIMITERS`); empty to find it from the content.

    Raises `InputError`: the file cannot be read, is too large, is a damaged or old workbook, has several sheets and none is named, has
    no cells.
    """
    data = read_bytes(path, most_bytes=MAX_BYTES)
    digest = sha256(data).hexdigest()
    if data.startswith(b"\xd0\xcf\x11\xe0"):
        raise InputError("an old Excel workbook (.xls)", expected="a workbook saved as .xlsx, or as CSV", file=path)
    if data.startswith(b"PK"):
        name, rows, merged = _sheet_rows(data, path, sheet)
        kept, comments = _without_comments(rows, " ")
        raw = RawTable(path, digest, len(data), kept, comments, sheet=name, merged=merged)
    else:
        if sheet is not None:
            raise InputError(
                "a text file has no sheets", expected="no sheet, or an Excel workbook", file=path, value=sheet
            )
        text, encoding = _decoded(data, path, encoding)
        delimiter = delimiter or _delimiter_name(text)
        joiner = next((sign for sign, name in DELIMITERS.items() if name == delimiter), " ").strip()
        kept, comments = _without_comments(_text_rows(text, delimiter, path), f"{joiner} ")
        raw = RawTable(path, digest, len(data), kept, comments, encoding, delimiter)
    if not raw.rows:
        raise InputError("no cells", expected="a table of measured points", file=path)
    return raw


def _bounded(rows: Iterable[tuple[int, Sequence[Any]]], path: Path) -> Iterator[tuple[int, Sequence[Any]]]:
    """Yield the rows of a table; refuse it at the row where it becomes larger than any measurement.

    Raises `InputError`: too many rows, or too many cells in a row or in all.
    """
    widest = count = cells = 0
    for line, row in rows:
        if len(row) > MAX_COLUMNS:
            # Programs that fill whole sheets end rows with empty cells.
            width = max((i + 1 for i, cell in enumerate(row) if cell not in (None, "")), default=0)
            row = row[:width]
        widest, count, cells = max(widest, len(row)), count + 1, cells + len(row)
        if widest > MAX_COLUMNS or count > MAX_ROWS or cells > MAX_CELLS:
            size = (
                f"too large: more than {count_with_noun(count - 1, 'row')} of up to {count_with_noun(widest, 'cell')}"
            )
            limits = f"{MAX_ROWS:,} rows, {MAX_COLUMNS:,} columns and {MAX_CELLS:,} cells"
            raise InputError(size, expected=f"a table of measured points, at most {limits}", file=path)
        yield line, row


def _decoded(data: bytes, path: Path, encoding: str) -> tuple[str, str]:
    """Return a text and the name of its encoding. Raises `InputError`: it is not text, or not of the encoding given."""
    coding = encoding or _encoding(data)
    try:
        text = data.decode(coding).removeprefix("\ufeff")
    except (UnicodeDecodeError, LookupError) as error:
        if not encoding and coding == "cp1252":
            coding, text = "latin-1", data.decode("latin-1")
        else:
            what, other = "not text of this encoding", "encoding: latin-1"
            raise InputError(what, expected=f"{coding} text", file=path, value=error, cure=other) from error
    odd = re.search("[\0-\x08\x0e-\x1f]", text)
    if odd is not None:
        line = text.count("\n", 0, odd.start()) + 1
        raise InputError("not a text file", expected="a text file or an Excel workbook (.xlsx)", file=path, line=line)
    return text.replace("\r\n", "\n").replace("\r", "\n"), coding


def _encoding(data: bytes) -> str:
    """Return the encoding of a text from its byte order mark, its zero bytes, or whether it is valid UTF-8."""
    if data.startswith(b"\xef\xbb\xbf"):
        return "utf-8-sig"
    if data[:2] in _UTF16:
        return _UTF16[data[:2]]
    zeros = [data[start:4000:2].count(0) for start in (0, 1)]
    if max(zeros) > len(data[:4000]) / 6 and min(zeros) == 0:
        return "utf-16-be" if zeros[0] else "utf-16-le"
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


def _delimiter_name(text: str) -> str:
    """Return the name of the delimiter that gives most rows the same number of cells, two or more."""
    best, delimiter_name = 0.0, "comma"
    for delimiter, name in DELIMITERS.items():
        try:
            rows = [row for _, row in islice(_split(text, delimiter), SAMPLE_ROWS) if any(row)]
        except csv.Error:
            continue
        widths = Counter(len(row) for row in rows if len(row) > 1)
        # Empty cells at the end of title rows do not count for a delimiter.
        same = widths.most_common(1)[0][1] if widths else 0
        share = same / max(len(rows), 1)
        if not any(sum(map(looks_like_number, map(str.strip, row))) >= 2 for row in rows[:200]):
            share /= 2.0  # names such as X=1;Y=2 have delimiters, and no numbers between them
        if share > 1.2 * best:
            best, delimiter_name = share, name
    return delimiter_name


def _split(text: str, delimiter: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows of a text with their lines; a quoted cell may contain line breaks."""
    if delimiter == " ":
        lines = enumerate(text.split("\n"), start=1)
        yield from ((number, re.split(r"\s+(?![\[(])", line.strip())) for number, line in lines)
        return
    reader = csv.reader(io.StringIO(text, newline="\n"), delimiter=delimiter)
    line = 1
    for row in reader:
        yield line, row
        line = reader.line_num + 1


def _text_rows(text: str, delimiter: str, path: Path) -> list[tuple[int, list[str]]]:
    sign = next((sign for sign, name in DELIMITERS.items() if name == delimiter), None)
    if sign is None:
        known = tuple(DELIMITERS.values())
        raise InputError(
            "unknown delimiter",
            expected=f"one of {', '.join(known)}",
            value=delimiter,
            nearest=closest_name(delimiter, known),
        )
    rows: list[tuple[int, list[str]]] = []
    try:
        rows.extend((line, list(row)) for line, row in _bounded(_split(text, sign), path))
    except csv.Error as error:
        line = rows[-1][0] + 1 if rows else 1
        raise InputError(
            f"not a table row ({error})", expected="cells with closed quotes", file=path, line=line
        ) from None
    return rows


def _without_comments(
    rows: Sequence[tuple[int, Sequence[str]]], joiner: str
) -> tuple[tuple[tuple[int, tuple[str, ...]], ...], tuple[str, ...]]:
    """Return the rows that are not empty, with clean cells and without comment rows, and the text of the comments."""
    kept, comments = [], []
    for line, row in rows:
        cells = [" ".join(cell.split()) for cell in row]
        while cells and not cells[-1]:
            cells.pop()
        if not cells:
            continue
        mark = re.match(r"(#+|//+|%+|!+)\s*(?=\S)", next(filter(None, cells)))
        is_error = re.fullmatch(r"#(?:n/a|nv|[a-z/0ä]+[!?])", cells[0].lower()) is not None
        if (
            mark
            and not is_error
            and not cells[0][mark.end() :].isdecimal()
            and not (mark[1] == "#" and len(mark[0]) == len(cells[0]))
        ):
            comments.append(joiner.join(filter(None, cells))[mark.end() :].strip())
        else:
            kept.append((line, tuple(cells)))
    return tuple(kept), tuple(comments)


def _sheet_rows(data: bytes, path: Path, wanted: str | None) -> tuple[str, list[tuple[int, list[str]]], Merged]:
    """Return the name of a workbook's sheet, its rows, and its merged cells of several rows.

    Raises `InputError`: the workbook is damaged or too large, or the sheet is not known.
    """
    from openpyxl import load_workbook  # slow to import, and needed for workbooks only

    try:
        with zipfile.ZipFile(io.BytesIO(data)) as parts:
            unpacked = sum(part.file_size for part in parts.infolist())
            if unpacked <= MAX_UNPACKED_BYTES:
                _check_cells(parts, path)
        if unpacked <= MAX_UNPACKED_BYTES:
            book = load_workbook(io.BytesIO(data), read_only=True, data_only=True)
            sheets = {sheet.title: sheet for sheet in book.worksheets}
            first = {name: islice(sheet.iter_rows(values_only=True), 200) for name, sheet in sheets.items()}
            filled = [name for name, rows in first.items() if any(value is not None for row in rows for value in row)]
            name = wanted if wanted is not None else filled[0] if len(filled) == 1 else None
            rows = [] if name not in sheets else _cells_of(sheets[name], path)
            _check_formulas(data, name, rows, path)
            merged = () if name is None or name not in sheets else _merged_cells(data, name)
    except InputError:
        raise
    except _WORKBOOK_ERRORS as error:
        message = "a damaged workbook, or a zip file of another kind"
        raise InputError(message, expected="an Excel workbook (.xlsx)", file=path, value=error) from error
    if unpacked > MAX_UNPACKED_BYTES:
        size = f"a workbook of {unpacked / 2**20:,.0f} MB when unpacked"
        raise InputError(size, expected=f"at most {MAX_UNPACKED_BYTES // 2**20} MB", file=path)
    if name is None:
        what = "several sheets" if filled else "no sheet with cells"
        line = f"sheet: {quoted(max(filled, key=_count_numbers(sheets)))}" if filled else None
        raise InputError(what, expected=f"one of {', '.join(filled or sheets)}", file=path, setting="sheet", cure=line)
    if name not in sheets:
        raise InputError(
            "no such sheet",
            expected=f"one of {', '.join(sheets)}",
            file=path,
            value=name,
            nearest=closest_name(name, sheets),
            setting="sheet",
            cure=f"sheet: {quoted(max(filled, key=_count_numbers(sheets)))}" if filled else None,
        )
    return name, rows, merged


def _check_cells(parts: zipfile.ZipFile, path: Path) -> None:
    """Refuse a workbook with a sheet of too many cells before openpyxl, which is a hundred times slower than counting, reads any.

    Raises `InputError`: it has one.
    """
    for part in parts.infolist():
        if not _SHEET_PART.fullmatch(part.filename):
            continue
        cells, end = 0, b""
        with parts.open(part) as stream:
            while block := stream.read(1 << 20):
                data = end + block
                cells += sum(data.count(mark) for mark in CELL_MARKS)
                end = data[-2:]  # shorter than any mark
                if cells > MAX_CELLS:
                    raise InputError(
                        f"too large: a sheet of more than {MAX_CELLS:,} cells",
                        expected="a sheet of measured points alone",
                        file=path,
                        value=part.filename,
                    )


def _check_formulas(data: bytes, name: str | None, rows: Sequence[tuple[int, Sequence[str]]], path: Path) -> None:
    """Refuse a sheet with a formula whose value is not stored: programs that write workbooks do not compute them.

    Raises `InputError`: it has one.
    """
    from openpyxl import load_workbook
    from openpyxl.utils import get_column_letter

    if name is None or not rows or not _has_tag(data, b"<f>", b"<f ", b":f>", b":f "):
        return
    sheet = load_workbook(io.BytesIO(data), read_only=True).worksheets
    formulas = next(one for one in sheet if one.title == name)
    formulas.reset_dimensions()
    for (number, row), cells in zip(rows, formulas.iter_rows(values_only=True), strict=False):
        for i, cell in enumerate(cells):
            if isinstance(cell, str) and cell.startswith("=") and (i >= len(row) or not row[i]):
                raise InputError(
                    f"the formula in cell {get_column_letter(i + 1)}{number} has no stored value",
                    expected="a workbook that was computed and saved by a spreadsheet program",
                    file=path,
                    line=number,
                    value=cell,
                )


def _has_tag(data: bytes, *tags: bytes) -> bool:
    """Return whether a sheet of a workbook has one of some elements."""
    with zipfile.ZipFile(io.BytesIO(data)) as parts:
        sheets = (parts.read(name) for name in parts.namelist() if _SHEET_PART.fullmatch(name))
        return any(tag in sheet for sheet in sheets for tag in tags)


def _merged_cells(data: bytes, name: str) -> Merged:
    """Return the merged cells of several rows of a sheet: first and last line, and index of the first column."""
    from openpyxl.utils import range_boundaries

    if not _has_tag(data, b"mergeCell "):
        return ()
    from openpyxl import load_workbook

    sheet = load_workbook(io.BytesIO(data))[name]
    bounds = [range_boundaries(str(one)) for one in sheet.merged_cells.ranges]
    return tuple((top, bottom, left - 1) for left, top, _, bottom in bounds if bottom > top)


def _count_numbers(sheets: Mapping[str, Any]) -> Callable[[str], int]:
    """Return the function that counts the numbers in the first rows of a sheet, by its name."""

    def count(name: str) -> int:
        rows = islice(sheets[name].iter_rows(values_only=True), 200)
        return sum(isinstance(value, int | float) for row in rows for value in row)

    return count


def _cells_of(sheet: Any, path: Path) -> list[tuple[int, list[str]]]:
    sheet.reset_dimensions()  # some programs write a wrong size of the sheet
    rows = _bounded(enumerate(sheet.iter_rows(values_only=True), start=1), path)
    return [(number, [_cell_text(value) for value in row]) for number, row in rows]


def _cell_text(value: Any) -> str:
    """Return a cell of a workbook as text: numbers with a decimal point, dates as ISO 8601."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return repr(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)
    if isinstance(value, datetime):
        return value.isoformat(sep=" ")
    if isinstance(value, date | time):
        return value.isoformat()
    return str(value)


# --- Parts of a raw table: title rows, header, row of units, rows of measured points --------------

SHARE: Final = 0.6
"""Share of rows that have a number in a column of numbers."""

Row = tuple[int, tuple[str, ...]]


@final
@dataclass(frozen=True)
class Layout:
    """A raw table with its parts identified.

    Attributes:
        header_line: line of the header; 0 if the file has none.
        names: names of the columns, each one once: as in the header, or ``column 1`` and so on.
        units: unit of each column from the row of units; empty where it gives none.
        rows: rows of measured points with their lines, each with as many cells as there are names.
        left_out: rows below the header that hold no number, with their text.
        derived: names of the columns that were made from others (positions in names); their numbers have decimal points.
    """

    raw: RawTable
    header_line: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[Row, ...]
    titles: tuple[str, ...]
    left_out: tuple[tuple[int, str], ...]
    derived: tuple[str, ...] = ()

    def with_columns(self, columns: Mapping[str, Sequence[str]]) -> Layout:
        """Return the layout with further columns, made from others."""
        added = zip(*columns.values(), strict=True)
        return replace(
            self,
            names=(*self.names, *columns),
            units=(*self.units, *[""] * len(columns)),
            rows=tuple((line, (*cells, *more)) for (line, cells), more in zip(self.rows, added, strict=True)),
            derived=(*self.derived, *columns),
        )

    def cell_units(self, name: str) -> dict[str, int]:
        """Return the units behind the numbers of a column, as spelt, each with its first line."""
        found: dict[str, int] = {}
        for (line, _), cell in zip(self.rows, self.column(name), strict=True):
            unit = split_unit(cell)[1]
            if unit:
                found.setdefault(unit, line)
        return found

    def column(self, name: str) -> list[str]:
        """Return the cells of a column."""
        place = self.names.index(name)
        return [cells[place] for _, cells in self.rows]


def layout_of(raw: RawTable, given: Sequence[str] = ()) -> Layout:
    """Return the parts of a raw table.

    ``given``: names of the columns, in place of the header.

    Raises `InputError`: no row with two numbers or more; a row with more cells than the header.
    """
    numeric = [[looks_like_number(cell) for cell in row] for _, row in raw.rows]
    candidates = [mask for mask in numeric if sum(mask) >= 2]
    if not candidates:
        line = raw.rows[0][0]
        raise InputError(
            "no row with numbers", expected="a table with one row for each measured point", file=raw.path, line=line
        )
    counts = Counter(i for mask in candidates for i, is_number in enumerate(mask) if is_number)
    columns = {i for i, count in counts.items() if count >= SHARE * len(candidates)} or set(counts)
    # A row of data has numbers in at least half of the columns of numbers.
    is_data = [2 * sum(i < len(mask) and mask[i] for i in columns) >= len(columns) for mask in numeric]
    first = is_data.index(True) if any(is_data) else numeric.index(candidates[0])
    width = max(len(row) for (_, row), used in zip(raw.rows, is_data, strict=True) if used)
    header, units, titles = _header(raw.rows[:first], len(columns), width)
    header = list(given) or header
    last = max((i for i, used in enumerate(is_data) if used), default=len(is_data)) - first
    rows, left_out = [], []
    for place, (line, row) in enumerate(raw.rows[first:]):
        if (
            place <= last
            and any(looks_like_number(cell) for cell in row[:1000])
            and not (header and list(row) == list(header)[: len(row)])
        ):
            rows.append((line, row))
        else:
            left_out.append((line, " ".join(filter(None, row))))
    rows = _with_merged(rows, raw.merged)
    if header and len(header) < width:
        line, row = next((line, row) for line, row in rows if len(row) > len(header))
        extra = [f"column {i + 1}" for i in range(len(header), width)]
        raise InputError(
            f"{len(row)} cells, more than the {len(header)} of the header",
            expected="one cell for each column",
            file=raw.path,
            line=line,
            value=" | ".join(row),
            cure=f"names: {yaml_list([*header, *extra])}",
        )
    names = _unique([header[i] if i < len(header) and header[i] else f"column {i + 1}" for i in range(width)])
    return Layout(
        raw=raw,
        header_line=raw.rows[max(first - 1 - bool(any(units)), 0)][0] if header else 0,
        names=tuple(names),
        units=tuple(units[i] if i < len(units) else "" for i in range(width)),
        rows=tuple((line, (*row, *[""] * (width - len(row)))[:width]) for line, row in rows),
        titles=tuple(" ".join(filter(None, row)) for _, row in titles),
        left_out=tuple(left_out),
    )


def _with_merged(rows: Sequence[Row], merged: Sequence[tuple[int, int, int]]) -> list[Row]:
    """Return rows of measured points in which every row of a merged cell has its value."""
    if not merged:
        return list(rows)
    own = {line: list(cells) for line, cells in rows}
    for top, bottom, column in merged:
        value = own[top][column] if top in own and column < len(own[top]) else ""
        for line in range(top + 1, bottom + 1):
            if line in own and column < len(own[line]) and not own[line][column]:
                own[line][column] = value
    return [(line, tuple(own[line])) for line, _ in rows]


def _header(above: Sequence[Row], numbers: int, width: int) -> tuple[list[str], list[str], Sequence[Row]]:
    """Return the names of columns, their units, and the rows above, from the rows before the first measured point."""
    units: list[str] = []
    rest = list(above)
    if rest and _is_units(rest[-1][1]):
        units = [cell.strip("[]() ") if cell else "" for cell in rest.pop()[1]]
    if not rest or sum(bool(cell) for cell in rest[-1][1]) < max(2, numbers / 2):
        return [], units, rest
    header = [*rest.pop()[1], *[""] * width][: max(width, len(above[-1][1]))]
    while header and not header[-1]:
        header.pop()
    upper = [*rest[-1][1], *[""] * width][:width] if rest else []
    if _is_upper_header(upper, [*header, *[""] * width][:width]):
        # Two rows of headers: "nominal" above X, Y, Z and "actual" above X, Y, Z; a title above an empty cell stands for itself.
        rest.pop()
        header, lower, group = [], [*header, *[""] * width][:width], ""
        for over, under in zip(upper, lower, strict=True):
            group = over or (group if under else "")
            header.append(f"{group} {under}".strip())
        while header and not header[-1]:
            header.pop()
    return header, units, rest


def _is_upper_header(upper: Sequence[str], lower: Sequence[str]) -> bool:
    """Return whether a row is the upper one of two rows of headers: equal names are below it, or columns without a name."""
    if sum(map(bool, upper)) < 2 or any(map(looks_like_number, upper)):
        return False
    named = [name for name in lower if name]
    return len(set(named)) < len(named) or any(over and not under for over, under in zip(upper, lower, strict=True))


def _is_units(row: Sequence[str]) -> bool:
    """Return whether all cells of a row that are not empty are units, and two or more are."""
    cells = [cell.strip("[]() ") for cell in row if cell]
    known = [cell for cell in cells if unit_named(cell) is not None]
    return len(known) >= 2 and len(known) == len([cell for cell in cells if cell.strip("-–")])


def _unique(names: Sequence[str]) -> list[str]:
    """Return names with a number appended to those that repeat an earlier one."""
    seen: Counter[str] = Counter()
    unique = []
    for name in names:
        seen[name] += 1
        unique.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return unique
