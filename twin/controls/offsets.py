"""Tables of work offsets and tools, as controls write them and as CSV."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.csv_tables import Cells, read_table
from twin._common.errors import InputError, closest_name
from twin._common.files import read_lines
from twin.display.numbers import listed
from twin.display.results import Result
from twin.nc.text import MM_PER_INCH, number


@final
@dataclass(frozen=True, repr=False)
class OffsetTable(Result):
    """Work offsets of a machine by name (``G54``, ``G54.1 P3``, ``G505``, the number of a preset) and axis, mm and degrees."""

    path: Path
    rows: Mapping[str, Mapping[str, float]]

    @property
    def assumed(self) -> str:
        """Name of the offset in force before the program selects one: that of G54, or the only one; empty if it is unknown."""
        return "G54" if "G54" in self.rows else next(iter(self.rows)) if len(self.rows) == 1 else ""

    def of(self, name: str, source: str, line: int) -> Mapping[str, float]:
        """Return one offset, that which is `assumed` for an empty name; raise `InputError`, with file and line, if there is none."""
        name = name or self.assumed
        if name in self.rows:
            return self.rows[name]
        known = ", ".join(list(self.rows)[:10])
        what = f"no such work offset in {self.path}" if name else "the program moves before it selects a work offset"
        raise InputError(what, expected=f"one of {known}", file=source, line=line, value=name or None)

    @property
    def brief(self) -> str:
        """File and names."""
        return f"work offsets of {self.path.name}: {listed(list(self.rows))}"


@final
@dataclass(frozen=True, repr=False)
class ToolTable(Result):
    """Tool lengths of a machine: from the spindle nose to the tool tip, by number and by name; of a further edge as ``5 D2``."""

    path: Path
    lengths_mm: Mapping[str, float]

    def of(self, name: str, source: str, line: int) -> float:
        """Return the length of a tool in mm by its number or name; raise `InputError`, with file and line, if there is none."""
        if name in self.lengths_mm:
            return self.lengths_mm[name]
        known = [*self.lengths_mm]
        what, expected = f"no such tool in {self.path}", f"one of {', '.join(known[:10])}"
        raise InputError(what, expected=expected, file=source, line=line, value=name, nearest=closest_name(name, known))

    @property
    def brief(self) -> str:
        """File and names."""
        return f"tools of {self.path.name}: {listed(list(self.lengths_mm))}"


class TableForm(ABC):
    """One form of these tables, with its name in messages. A new form is such a class, and an entry in `FORMS`."""

    description: str

    @abstractmethod
    def holds(self, lines: Sequence[str]) -> tuple[bool, bool]:
        """Return whether the lines of a file hold work offsets, and whether they hold tools, in this form."""

    @abstractmethod
    def offsets(self, path: Path, lines: Sequence[str]) -> dict[str, dict[str, float]]:
        """Return the work offsets by name and axis, mm and degrees; raise `InputError` with file, line and value."""

    @abstractmethod
    def tools(self, path: Path, lines: Sequence[str]) -> dict[str, float]:
        """Return the tool lengths in mm by number and by name; raise `InputError` with file, line and value."""


def value_of(path: Path, line: int, text: str, what: str = "not a number") -> float:
    """Return the value of a number with a decimal point or comma; raise `InputError` if it is not one."""
    value = number(text)
    if value != value:
        raise InputError(what, expected="a number", file=path, line=line, value=text)
    return value


def rotated(path: Path, line: int, name: str, value: object) -> InputError:
    """Return the error for an offset that turns, mirrors or scales the coordinates."""
    what = f"the work offset {name} turns, mirrors or scales the coordinates"
    return InputError(what, expected="offsets that only shift the axes", file=path, line=line, value=value)


# --- CSV ------------------------------------------------------------------------------------------

_AXIS: Final = re.compile(r"(\w+?)_(mm|deg)", re.ASCII)


@final
class CsvForm(TableForm):
    """``offset,X_mm,Y_mm,Z_mm,B_deg,C_deg`` and ``tool,length_mm`` (optional ``name``)."""

    description = "CSV: offset,X_mm,… or tool,length_mm"

    def holds(self, lines: Sequence[str]) -> tuple[bool, bool]:
        """See `TableForm.holds`."""
        first = next((line for line in lines if line.strip() and not line.lstrip().startswith("#")), "")
        name = first.split(",")[0].strip()
        return name == "offset", name == "tool"

    def offsets(self, path: Path, lines: Sequence[str]) -> dict[str, dict[str, float]]:
        """See `TableForm.offsets`."""
        header, rows, _ = read_table(path)
        cells = Cells(path, {name: i for i, name in enumerate(header)}, rows)
        offsets: dict[str, dict[str, float]] = {_key(path, line, row[0]): {} for line, row in rows}
        _check_once(path, offsets, rows)
        for name in header[1:]:
            axis = _AXIS.fullmatch(name)
            if axis is None:
                raise InputError("unknown column", expected="offset, then X_mm … C_deg", file=path, line=1, value=name)
            for key, value in zip(offsets, _numbers(cells, name), strict=True):
                offsets[key][axis.group(1)] = value
        return offsets

    def tools(self, path: Path, lines: Sequence[str]) -> dict[str, float]:
        """See `TableForm.tools`."""
        header, rows, _ = read_table(path)
        columns = {name: i for i, name in enumerate(header)}
        if "length_mm" not in columns:
            what = "no column length_mm"
            raise InputError(what, expected="tool,length_mm", file=path, line=1, value=",".join(header))
        lengths = _numbers(Cells(path, columns, rows), "length_mm")
        tools = {_key(path, line, row[0]): value for (line, row), value in zip(rows, lengths, strict=True)}
        _check_once(path, tools, rows)
        if "name" in columns:
            tools |= {row[columns["name"]]: value for (_, row), value in zip(rows, lengths, strict=True)}
        return tools


def _key(path: Path, line: int, cell: str) -> str:
    if not cell:
        raise InputError("row without a name", expected="a name in the first column", file=path, line=line)
    return cell.upper() if re.fullmatch(r"g\d.*", cell) else cell


def _check_once(path: Path, found: Collection[str], rows: Sequence[tuple[int, list[str]]]) -> None:
    if len(found) < len(rows):
        keys = [_key(path, line, row[0]) for line, row in rows]
        second = next(i for i, key in enumerate(keys) if key in keys[:i])
        what = "row given twice"
        raise InputError(what, expected="each name once", file=path, line=rows[second][0], value=keys[second])


def _numbers(cells: Cells, name: str) -> list[float]:
    values = cells.numbers(name)
    cells.refuse(~np.isfinite(values), values, name, "a number")
    return [float(value) for value in values]


# --- Fanuc, as it punches them out: programs of ``G10`` blocks -------------------------------------
# Source: Fanuc Series 30i operator's manual, "Setting of data by G10": ``G10 L2 P1`` to ``P6`` are G54 to G59, ``P0`` is the external
# offset that is added to all, ``G10 L20 P1`` to ``P300`` are G54.1 P1 to P300; ``G10 L10 P R`` is the geometry and ``L11`` the wear of
# length offset P.

_WORD: Final = re.compile(r"([A-Z])\s*([+-]?(?:\d+\.?\d*|\.\d+))", re.IGNORECASE)
_COMMENT: Final = re.compile(r"\([^()]*\)|;.*")
_G10: Final = re.compile(r"G10\s*L(2|20|10|11)(?!\d)", re.IGNORECASE)
_NOT_AXES: Final = frozenset("GLPRN")


@final
class Fanuc(TableForm):
    """``G10`` blocks."""

    description = "Fanuc offsets as G10 L2 or G10 L10 blocks"

    def holds(self, lines: Sequence[str]) -> tuple[bool, bool]:
        """See `TableForm.holds`."""
        kinds = {found.group(1) for found in map(_G10.search, lines) if found is not None}
        return bool(kinds & {"2", "20"}), bool(kinds & {"10", "11"})

    def offsets(self, path: Path, lines: Sequence[str]) -> dict[str, dict[str, float]]:
        """See `TableForm.offsets`."""
        rows: dict[str, dict[str, float]] = {}
        external: dict[str, float] = {}
        for line, words in _blocks(path, lines, ("2", "20")):
            row = {axis: value for axis, value in words.items() if axis not in _NOT_AXES}
            place = int(words["P"])
            if words["L"] == 20:
                rows[f"G54.1 P{place}"] = row
            elif place == 0:
                external = row
            elif place <= 6:
                rows[f"G{53 + place}"] = row
            else:
                raise InputError("no such work offset", expected="P0 to P6", file=path, line=line, value=f"P{place}")
        return {
            name: {axis: row.get(axis, 0.0) + external.get(axis, 0.0) for axis in {**row, **external}}
            for name, row in rows.items()
        }

    def tools(self, path: Path, lines: Sequence[str]) -> dict[str, float]:
        """See `TableForm.tools`."""
        tools: dict[str, float] = {}
        for line, words in _blocks(path, lines, ("10", "11")):
            if "R" not in words:
                raise InputError("length offset without a value", expected="G10 L10 P1 R120.5", file=path, line=line)
            name = str(int(words["P"]))
            tools[name] = tools.get(name, 0.0) + words["R"]
        return tools


def _blocks(path: Path, lines: Sequence[str], wanted: Sequence[str]) -> list[tuple[int, dict[str, float]]]:
    """Return line number and words of every ``G10`` block of some kinds."""
    blocks = []
    for line, text in enumerate(lines, 1):
        bare = _COMMENT.sub("", text)
        block = _G10.search(bare)
        if block is None or block.group(1) not in wanted:
            continue
        words = {letter.upper(): value_of(path, line, value) for letter, value in _WORD.findall(bare)}
        if "P" not in words:
            raise InputError("G10 without P", expected="G10 L2 P1 X… Y… Z…", file=path, line=line, value=text.strip())
        blocks.append((line, words))
    return blocks


# --- Heidenhain: tables ``.pr`` and ``.t`` with columns of fixed width -----------------------------
# Source: TNC 640 user's manual Setup, "Managing presets" and "Tool table": the second line names the columns, each value begins where
# its column's name begins. Lengths are in the unit of the first line.

_BEGIN: Final = re.compile(r"\s*BEGIN\s+(\S+?)\s*\.(PR|T)\s+(MM|INCH)?", re.IGNORECASE)
_TURNS: Final = ("SPA", "SPB", "SPC")
_LINEAR: Final = "XYZUVW"
_ROTARY: Final = "ABC"


@final
class PresetsAndTools(TableForm):
    """Preset table and tool table."""

    description = "Heidenhain preset table .pr or tool table .t"

    def holds(self, lines: Sequence[str]) -> tuple[bool, bool]:
        """See `TableForm.holds`."""
        found = _BEGIN.match(lines[0]) if lines else None
        kind = "" if found is None else found.group(2).upper()
        return kind == "PR", kind == "T"

    def offsets(self, path: Path, lines: Sequence[str]) -> dict[str, dict[str, float]]:
        """See `TableForm.offsets`. An empty cell (``-``) leaves the axis without an offset."""
        unit, rows = _rows(path, lines)
        offsets: dict[str, dict[str, float]] = {}
        for line, row in rows:
            name = row.get("NO", "")
            turned = next((column for column in _TURNS if _number(path, line, row, column)), None)
            if turned is not None:
                raise rotated(path, line, name, f"{turned} {row[turned]}")
            axes = [axis for axis in _LINEAR + _ROTARY if axis in row]
            offsets[name] = {axis: _number(path, line, row, axis) * (unit if axis in _LINEAR else 1.0) for axis in axes}
        return offsets

    def tools(self, path: Path, lines: Sequence[str]) -> dict[str, float]:
        """See `TableForm.tools`: length L and its delta DL."""
        unit, rows = _rows(path, lines)
        tools: dict[str, float] = {}
        for line, row in rows:
            length = (_number(path, line, row, "L") + _number(path, line, row, "DL")) * unit
            tools[row.get("T", "")] = length
            if row.get("NAME"):
                tools[row["NAME"]] = length
        return tools


def _rows(path: Path, lines: Sequence[str]) -> tuple[float, list[tuple[int, dict[str, str]]]]:
    """Return the unit of lengths in mm, and the rows with their line numbers, by column."""
    begin = _BEGIN.match(lines[0])
    unit = MM_PER_INCH if begin is not None and (begin.group(3) or "").upper() == "INCH" else 1.0
    columns = list(re.finditer(r"\S+", lines[1])) if len(lines) > 1 else []
    if not columns:
        raise InputError("table without column names", expected="the names in its second line", file=path, line=2)
    ends = [*(column.start() for column in columns[1:]), None]
    rows = []
    for line, text in enumerate(lines[2:], 3):
        if text.strip().upper() == "[END]":
            break
        row = {
            column.group().upper(): text[column.start() : end].strip()
            for column, end in zip(columns, ends, strict=True)
        }
        if text.strip():
            rows.append((line, {name: cell for name, cell in row.items() if cell not in ("", "-")}))
    return unit, rows


def _number(path: Path, line: int, row: dict[str, str], column: str) -> float:
    """Return the value of a cell, 0 if it is empty."""
    return value_of(path, line, row.get(column, "0"), f"{column} is not a number")


# --- LinuxCNC: the parameter file (``.var``) and the tool table (``.tbl``) -------------------------
# Source: LinuxCNC user manual, "G-code overview: numbered parameters" and "Tool table". The numbers are in the machine's units, which
# the files do not state: millimetres are assumed.

SYSTEMS: Final = ("G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3")
_AXES: Final = "XYZABCUVW"
_FIRST: Final = 5221
_STEP: Final = 20
_ACTIVE: Final = 5220
"""Parameter with the number of the work offset in force."""
_RETURNS: Final = {"G28": 5161, "G30": 5181}
"""First parameters of the positions of reference returns."""
_ADDED: Final = 5210
"""Parameter that says whether the offset of G92 (the nine parameters after it) is active."""
_PARAMETER: Final = re.compile(r"\s*(\d+)\s+([+-]?[\d.]+(?:[eE][+-]?\d+)?)\s*")
_TOOL: Final = re.compile(r"\s*T(\d+)\s+P\d+\b(.*)", re.IGNORECASE)
_LENGTH: Final = re.compile(r"\bZ\s*([+-]?[\d.]+)", re.IGNORECASE)


def parameter_file(
    offsets: Mapping[str, Mapping[str, float]], in_force: str, references: Mapping[str, Mapping[str, float]]
) -> str:
    """Return a parameter file, without the work offsets that the control does not have.

    ``offsets`` by name and axis, mm and degrees; ``in_force``: the name of one, that of G54 if the control does not have it;
    ``references``: positions of the axes after ``G28`` and ``G30``.
    """
    values: dict[int, float] = {_ACTIVE: SYSTEMS.index(in_force) + 1 if in_force in SYSTEMS else 1}
    rows = [(_FIRST + _STEP * SYSTEMS.index(name), row) for name, row in offsets.items() if name in SYSTEMS]
    rows += [(first, references.get(word, {})) for word, first in _RETURNS.items()]
    for first, row in rows:
        values |= {first + _AXES.index(axis): value for axis, value in row.items() if axis in _AXES}
    return "".join(f"{number} {value:.6f}\n" for number, value in sorted(values.items()))


@final
class LinuxCncTables(TableForm):
    """Parameter file and tool table."""

    description = "LinuxCNC parameter file or tool table"

    def holds(self, lines: Sequence[str]) -> tuple[bool, bool]:
        """See `TableForm.holds`."""
        return any(line.split()[:1] == [str(_FIRST)] for line in lines), any(map(_TOOL.match, lines))

    def offsets(self, path: Path, lines: Sequence[str]) -> dict[str, dict[str, float]]:
        """See `TableForm.offsets`."""
        values: dict[int, float] = {}
        line_of: dict[int, int] = {}
        for line, text in enumerate(lines, 1):
            match = _PARAMETER.fullmatch(text)
            if match is not None:
                parameter = int(match.group(1))
                values[parameter], line_of[parameter] = value_of(path, line, match.group(2)), line
            elif text.strip():
                raise InputError("not a parameter", expected="5221 12.500000", file=path, line=line, value=text)
        if values.get(_ADDED) and any(values.get(_ADDED + 1 + i) for i in range(len(_AXES))):
            expected = "a parameter file saved after G92.1"
            raise InputError("a further offset (G92) is active", expected=expected, file=path, line=line_of[_ADDED])
        rows: dict[str, dict[str, float]] = {}
        for place, name in enumerate(SYSTEMS):
            first = _FIRST + _STEP * place
            if values.get(first + len(_AXES)):
                raise rotated(path, line_of[first + len(_AXES)], name, values[first + len(_AXES)])
            if first in values:
                rows[name] = {axis: values[first + i] for i, axis in enumerate(_AXES) if first + i in values}
        return rows

    def tools(self, path: Path, lines: Sequence[str]) -> dict[str, float]:
        """See `TableForm.tools`."""
        tools: dict[str, float] = {}
        for line, text in enumerate(lines, 1):
            entry = text.partition(";")[0]
            tool = _TOOL.match(entry)
            if tool is None:
                if entry.strip():
                    raise InputError("not a tool", expected="T1 P1 Z+120.5", file=path, line=line, value=text)
                continue
            length = _LENGTH.search(tool.group(2))
            tools[tool.group(1)] = 0.0 if length is None else value_of(path, line, length.group(1))
        return tools


# --- SINUMERIK 840D: archives with ``$P_UIFR`` and ``$TC_`` variables ------------------------------
# Source: SINUMERIK 840D sl, Programming Manual Job Planning (frames), and Parameter Manual System Variables. ``$P_UIFR[n, axis, TR]``
# is the translation and ``FI`` the fine offset of settable work offset n (1 to 4: G54 to G57; 5 and higher: G505 and higher).
# ``$TC_DP3[t, d]`` is length 1 of edge d of tool t, ``$TC_DP12`` its wear, ``$TC_TP2[t]`` the tool's name.

_NUMBER: Final = r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
_SHIFT: Final = re.compile(
    rf"(?:N\d+\s+)?\$P_(?:CH)?UIFR\[\s*(\d+)\s*,\s*([A-Z]\w*)\s*,\s*([A-Z]+)\s*\]\s*=\s*{_NUMBER}\s*(?:;.*)?",
    re.IGNORECASE,
)
_WHOLE: Final = re.compile(r"(?:N\d+\s+)?\$P_(?:CH)?UIFR\[\s*(\d+)\s*\]\s*=\s*(.*?)\s*(?:;.*)?", re.IGNORECASE)
_PARTS: Final = re.compile(r"(C[A-Z]+)\(([^()]*)\)", re.IGNORECASE)
_TOOL_LENGTH: Final = re.compile(
    rf"(?:N\d+\s+)?\$TC_(DP3|DP12)\[\s*(\d+)\s*,\s*(\d+)\s*\]\s*=\s*{_NUMBER}\s*(?:;.*)?", re.IGNORECASE
)
_NAME: Final = re.compile(r"(?:N\d+\s+)?\$TC_TP2\[\s*(\d+)\s*\]\s*=\s*\"([^\"]*)\"\s*(?:;.*)?", re.IGNORECASE)


@final
class Sinumerik(TableForm):
    """Variables of an archive."""

    description = "SINUMERIK archive with $P_UIFR or $TC_DP3"

    def holds(self, lines: Sequence[str]) -> tuple[bool, bool]:
        """See `TableForm.holds`."""
        offsets, tools = (any(text in line.upper() for line in lines) for text in ("UIFR[", "$TC_DP3["))
        return offsets, tools

    def offsets(self, path: Path, lines: Sequence[str]) -> dict[str, dict[str, float]]:
        """See `TableForm.offsets`."""
        rows: dict[str, dict[str, float]] = {}
        for line, text in enumerate(lines, 1):
            shift, whole = _SHIFT.fullmatch(text.strip()), _WHOLE.fullmatch(text.strip())
            if shift is not None:
                parts = [(shift.group(3).upper(), shift.group(2), shift.group(4))]
                name = _offset_name(int(shift.group(1)))
            elif whole is not None:
                name, parts = _offset_name(int(whole.group(1))), _parts(path, line, whole.group(2))
            elif "UIFR[" in text.upper():
                raise InputError("not a work offset", expected="$P_UIFR[1,X,TR]=12.5", file=path, line=line, value=text)
            else:
                continue
            row = rows.setdefault(name, {})
            for kind, axis, written in parts:
                if kind not in ("TR", "FI"):
                    if value_of(path, line, written) != (1.0 if kind == "SC" else 0.0):
                        raise rotated(path, line, name, text.strip())
                    continue
                row[axis.upper()] = row.get(axis.upper(), 0.0) + value_of(path, line, written)
        return rows

    def tools(self, path: Path, lines: Sequence[str]) -> dict[str, float]:
        """See `TableForm.tools`."""
        lengths: dict[tuple[str, str], float] = {}
        names: dict[str, str] = {}
        for line, text in enumerate(map(str.strip, lines), 1):
            tool, named = _TOOL_LENGTH.fullmatch(text), _NAME.fullmatch(text)
            if tool is not None:
                key = tool.group(2), tool.group(3)
                lengths[key] = lengths.get(key, 0.0) + value_of(path, line, tool.group(4))
            elif named is not None:
                names[named.group(1)] = named.group(2)
        tools: dict[str, float] = {}
        for (tool_number, edge), length in lengths.items():
            for tool_name in {tool_number, names.get(tool_number, tool_number)}:
                tools[tool_name if edge == "1" else f"{tool_name} D{edge}"] = length
        return tools


def _offset_name(index: int) -> str:
    return "G500" if index == 0 else f"G{53 + index}" if index <= 4 else f"G{500 + index}"


def _parts(path: Path, line: int, text: str) -> list[tuple[str, str, str]]:
    """Return the parts of a frame written as ``CTRANS(X,1.5,Y,2):CFINE(..)``: kind, axis and number of each."""
    parts = []
    for function, arguments in _PARTS.findall(text):
        cells = [cell.strip() for cell in arguments.split(",")] if arguments.strip() else []
        kind = {"CTRANS": "TR", "CFINE": "FI", "CSCALE": "SC"}.get(function.upper(), "RT")
        if len(cells) % 2:
            expected = 'an axis and a number each: "CTRANS(X,1.5,Y,2)"'
            raise InputError("not a frame", expected=expected, file=path, line=line, value=text)
        parts += [(kind, axis, number) for axis, number in zip(cells[::2], cells[1::2], strict=True)]
    return parts


# --- Tables in any of these forms -----------------------------------------------------------------

FORMS: Final[tuple[TableForm, ...]] = (PresetsAndTools(), Sinumerik(), Fanuc(), LinuxCncTables(), CsvForm())


def load_offsets(path: str | Path) -> OffsetTable:
    r"""Read the work offsets of a machine.

    Args:
        path: CSV (``offset,X_mm,Y_mm,Z_mm,B_deg,C_deg``), LinuxCNC ``.var``, SINUMERIK ``$P_UIFR``, Fanuc ``G10 L2`` or Heidenhain
            ``.pr``.

    Raises:
        InputError: it cannot be read, has none of these forms, or holds an offset that does more than shift the axes.

    Examples:
        >>> from pathlib import Path
        >>> _ = Path("offsets.csv").write_text("offset,X_mm,Y_mm,Z_mm\nG54,250,225,-370\nG55,200,180,-360\n")
        >>> offsets = twin.load_offsets("offsets.csv")
        >>> offsets.assumed, sorted(offsets.rows)
        ('G54', ['G54', 'G55'])
        >>> setup = twin.Setup(offsets=offsets)
    """
    path = Path(path)
    lines = read_lines(path)
    for form in FORMS:
        if form.holds(lines)[0]:
            rows = form.offsets(path, lines)
            _check(path, [value for row in rows.values() for value in row.values()])
            if rows:
                return OffsetTable(path, rows)
    raise _unknown(path, "work offsets")


def load_tools(path: str | Path) -> ToolTable:
    r"""Read the tool lengths of a machine.

    Args:
        path: CSV (``tool,length_mm``), LinuxCNC ``.tbl``, SINUMERIK ``$TC_DP3``, Fanuc ``G10 L10``, Heidenhain ``.t``.

    Raises:
        InputError: it cannot be read, or has none of these forms.

    Examples:
        >>> from pathlib import Path
        >>> _ = Path("tools.csv").write_text("tool,length_mm\n1,80.25\n2,112.5\n")
        >>> tools = twin.load_tools("tools.csv")
        >>> dict(tools.lengths_mm)
        {'1': 80.25, '2': 112.5}
        >>> setup = twin.Setup(tools=tools)
    """
    path = Path(path)
    lines = read_lines(path)
    for form in FORMS:
        if form.holds(lines)[1]:
            lengths = form.tools(path, lines)
            _check(path, [*lengths.values()])
            if lengths:
                return ToolTable(path, lengths)
    raise _unknown(path, "tools")


def _check(path: Path, values: list[float]) -> None:
    for value in values:
        if not math.isfinite(value) or abs(value) > 1e6:
            raise InputError("value out of range", expected="mm or degrees below 1,000,000", file=path, value=value)


def _unknown(path: Path, what: str) -> InputError:
    known = "; ".join(form.description for form in FORMS)
    return InputError(f"not a table of {what} in a known form", expected=known, file=path)
