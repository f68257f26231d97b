"""Raw cells of a table file: text of any usual encoding, delimiter and decimal sign, or a sheet of a workbook."""

from __future__ import annotations

import csv
import io
import re
import zipfile
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import date, datetime, time
from hashlib import sha256
from itertools import islice
from pathlib import Path
from typing import Any, Final, final
from xml.etree.ElementTree import ParseError

from twin._common.counts import count_with_noun
from twin._common.errors import InputError, closest_name
from twin._common.files import read_bytes

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
SAMPLE_ROWS: Final = 2000
"""Number of rows that show the delimiter."""
DELIMITERS: Final = {"\t": "tab", ";": "semicolon", "|": "bar", ",": "comma", " ": "space"}
"""Delimiters in the order in which they are tried, with their names in a mapping file."""
_UTF16: Final = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
_WORKBOOK_ERRORS: Final = (
    zipfile.BadZipFile,
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


@final
@dataclass(frozen=True)
class RawTable:
    """Cells of a file as text, without any interpretation.

    Attributes:
        path: the file.
        digest: SHA-256 of the file, hexadecimal.
        size: its size, bytes.
        rows: rows with their 1-based lines, cells without surrounding blanks; empty rows are left out.
        comments: text of the comment lines, without their mark.
        encoding: encoding of a text file; empty for a workbook.
        delimiter: name of the delimiter (`DELIMITERS`); empty for a workbook.
        sheet: name of the sheet; empty for a text file.
    """

    path: Path
    digest: str
    size: int
    rows: tuple[tuple[int, tuple[str, ...]], ...]
    comments: tuple[str, ...]
    encoding: str = ""
    delimiter: str = ""
    sheet: str = ""

    @property
    def origin(self) -> str:
        """Name, size and SHA-256 of the file, and its sheet."""
        sheet = f", sheet {self.sheet}" if self.sheet else ""
        return f"{self.path.name}{sheet}, {self.size} bytes, SHA-256 {self.digest[:16]}"


def read_cells(path: Path, *, sheet: str | None = None, encoding: str = "", delimiter: str = "") -> RawTable:
    """Return the cells of a text file or of one sheet of an Excel workbook.

    Args:
        path: the file.
        sheet: sheet of a workbook; None for the only one that is not empty.
        encoding: encoding of a text file; empty to find it from the content.
        delimiter: name of the delimiter (`DELIMITERS`); empty to find it from the content.

    Raises:
        InputError: the file cannot be read, is too large, is a damaged or old workbook, has several sheets and none is named, has no
            cells.
    """
    data = read_bytes(path, most_bytes=MAX_BYTES)
    digest = sha256(data).hexdigest()
    if data.startswith(b"\xd0\xcf\x11\xe0"):
        raise InputError("an old Excel workbook (.xls)", expected="a workbook saved as .xlsx, or as CSV", file=path)
    if data.startswith(b"PK"):
        name, rows = _sheet_rows(data, path, sheet)
        kept, comments = _without_comments(rows, " ")
        raw = RawTable(path, digest, len(data), kept, comments, sheet=name)
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

    Raises:
        InputError: too many rows, or too many cells in a row or in all.
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
    """Return a text and the name of its encoding.

    Raises:
        InputError: it is not text, or not of the encoding given.
    """
    found = encoding or _encoding(data)
    try:
        text = data.decode(found).removeprefix("\ufeff")
    except (UnicodeDecodeError, LookupError) as error:
        if not encoding and found == "cp1252":
            found, text = "latin-1", data.decode("latin-1")
        else:
            raise InputError("not text of this encoding", expected=f"{found} text", file=path, value=error) from error
    odd = re.search("[\0-\x08\x0e-\x1f]", text)
    if odd is not None:
        line = text.count("\n", 0, odd.start()) + 1
        raise InputError("not a text file", expected="a text file or an Excel workbook (.xlsx)", file=path, line=line)
    return text.replace("\r\n", "\n").replace("\r", "\n"), found


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
    best, found = 0.0, "comma"
    for delimiter, name in DELIMITERS.items():
        try:
            rows = [row for _, row in islice(_split(text, delimiter), SAMPLE_ROWS) if any(row)]
        except csv.Error:
            continue
        widths = Counter(len(row) for row in rows if len(row) > 1)
        # Empty cells at the end of title rows do not count for a delimiter.
        same = widths.most_common(1)[0][1] if widths else 0
        share = same / max(len(rows), 1)
        if share > 1.2 * best:
            best, found = share, name
    return found


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
        if mark and not cells[0][mark.end() :].isdecimal() and not (mark[1] == "#" and len(mark[0]) == len(cells[0])):
            comments.append(joiner.join(filter(None, cells))[mark.end() :].strip())
        else:
            kept.append((line, tuple(cells)))
    return tuple(kept), tuple(comments)


def _sheet_rows(data: bytes, path: Path, wanted: str | None) -> tuple[str, list[tuple[int, list[str]]]]:
    """Return the name of a workbook's sheet and its rows.

    Raises:
        InputError: the workbook is damaged or too large, or the sheet is not known.
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
            filled = [name for name, sheet in sheets.items() if wanted is not None or _is_filled(sheet)]
            name = wanted if wanted is not None else filled[0] if len(filled) == 1 else None
            rows = [] if name not in sheets else _cells_of(sheets[name], path)
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
        raise InputError(what, expected=f"one of {', '.join(filled or sheets)}", file=path, setting="sheet")
    if name not in sheets:
        raise InputError(
            "no such sheet",
            expected=f"one of {', '.join(sheets)}",
            file=path,
            value=name,
            nearest=closest_name(name, sheets),
            setting="sheet",
        )
    return name, rows


def _check_cells(parts: zipfile.ZipFile, path: Path) -> None:
    """Refuse a workbook with a sheet of too many cells before openpyxl, which is a hundred times slower than counting, reads any.

    Raises:
        InputError: it has one.
    """
    for part in parts.infolist():
        if not re.fullmatch(r"xl/worksheets/[^/]+\.xml", part.filename):
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


def _is_filled(sheet: Any) -> bool:
    return any(value is not None for row in islice(sheet.iter_rows(values_only=True), 200) for value in row)


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
