"""Work offsets and tools as CSV."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.csv_tables import Cells, read_table
from twin._common.errors import InputError
from twin.nc.tables.table import TableForm

_AXIS: Final = re.compile(r"(\w+?)_(mm|deg)", re.ASCII)


@final
class CsvForm(TableForm):
    """``offset,X_mm,Y_mm,Z_mm,B_deg,C_deg`` and ``tool,length_mm`` (optional ``name``)."""

    description = "CSV: offset,X_mm,… or tool,length_mm"

    def is_offsets(self, lines: Sequence[str]) -> bool:
        """See `TableForm.is_offsets`."""
        return _header(lines)[:1] == ["offset"]

    def is_tools(self, lines: Sequence[str]) -> bool:
        """See `TableForm.is_tools`."""
        return _header(lines)[:1] == ["tool"]

    def offsets(self, path: Path, lines: Sequence[str]) -> dict[str, dict[str, float]]:
        """See `TableForm.offsets`."""
        header, rows, _ = read_table(path)
        cells = Cells(path, {name: i for i, name in enumerate(header)}, rows)
        found: dict[str, dict[str, float]] = {_key(path, line, row[0]): {} for line, row in rows}
        _check_once(path, found, rows)
        for name in header[1:]:
            axis = _AXIS.fullmatch(name)
            if axis is None:
                raise InputError("unknown column", expected="offset, then X_mm … C_deg", file=path, line=1, value=name)
            for key, value in zip(found, _numbers(cells, name), strict=True):
                found[key][axis.group(1)] = value
        return found

    def tools(self, path: Path, lines: Sequence[str]) -> dict[str, float]:
        """See `TableForm.tools`."""
        header, rows, _ = read_table(path)
        columns = {name: i for i, name in enumerate(header)}
        if "length_mm" not in columns:
            raise InputError(
                "no column length_mm", expected="tool,length_mm", file=path, line=1, value=",".join(header)
            )
        lengths = _numbers(Cells(path, columns, rows), "length_mm")
        found = {_key(path, line, row[0]): value for (line, row), value in zip(rows, lengths, strict=True)}
        _check_once(path, found, rows)
        if "name" in columns:
            found |= {row[columns["name"]]: value for (_, row), value in zip(rows, lengths, strict=True)}
        return found


def _header(lines: Sequence[str]) -> list[str]:
    first = next((line for line in lines if line.strip() and not line.lstrip().startswith("#")), "")
    return [cell.strip() for cell in first.split(",")]


def _key(path: Path, line: int, cell: str) -> str:
    if not cell:
        raise InputError("row without a name", expected="a name in the first column", file=path, line=line)
    return cell.upper() if re.fullmatch(r"g\d.*", cell) else cell


def _check_once(
    path: Path,
    found: Sequence[str] | dict[str, float] | dict[str, dict[str, float]],
    rows: Sequence[tuple[int, list[str]]],
) -> None:
    if len(found) < len(rows):
        keys = [_key(path, line, row[0]) for line, row in rows]
        second = next(i for i, key in enumerate(keys) if key in keys[:i])
        raise InputError(
            "row given twice", expected="each name once", file=path, line=rows[second][0], value=keys[second]
        )


def _numbers(cells: Cells, name: str) -> list[float]:
    values = cells.numbers(name)
    cells.refuse(~np.isfinite(values), values, name, "a number")
    return [float(value) for value in values]
