"""Presets and tools of a Heidenhain control: tables ``.pr`` and ``.t`` with columns of fixed width.

Source: TNC 640 user's manual Setup, "Managing presets" and "Tool table": the second line names the columns, each value begins where its
column's name begins. Lengths are in the unit of the first line.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final, final

from twin._common.errors import InputError
from twin.controls.offsets.table import TableForm, rotated, value_of
from twin.nc.text import MM_PER_INCH

_BEGIN: Final = re.compile(r"\s*BEGIN\s+(\S+?)\s*\.(PR|T)\s+(MM|INCH)?", re.IGNORECASE)
_TURNS: Final = ("SPA", "SPB", "SPC")
_LINEAR: Final = "XYZUVW"
_ROTARY: Final = "ABC"


@final
class PresetsAndTools(TableForm):
    """Preset table and tool table."""

    description = "Heidenhain preset table .pr or tool table .t"

    def is_offsets(self, lines: Sequence[str]) -> bool:
        """See `TableForm.is_offsets`."""
        return _kind(lines) == "PR"

    def is_tools(self, lines: Sequence[str]) -> bool:
        """See `TableForm.is_tools`."""
        return _kind(lines) == "T"

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


def _kind(lines: Sequence[str]) -> str:
    found = _BEGIN.match(lines[0]) if lines else None
    return "" if found is None else found.group(2).upper()


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
