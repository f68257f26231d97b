"""Tables of work offsets and tools, and the interface of the forms in which they are read."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.csv_tables import Cells, read_table
from twin._common.errors import InputError, closest_name
from twin.display.numbers import listed
from twin.display.results import Result
from twin.nc.text import number


@final
@dataclass(frozen=True, repr=False)
class OffsetTable(Result):
    """Work offsets of a machine.

    Attributes:
        rows: by name (``G54``, ``G54.1 P3``, ``G505``, the number of a preset): offset by axis, mm and degrees.
    """

    path: Path
    rows: Mapping[str, Mapping[str, float]]

    @property
    def assumed(self) -> str:
        """Name of the offset in force before the program selects one: that of G54, or the only one; empty if it is unknown."""
        return "G54" if "G54" in self.rows else next(iter(self.rows)) if len(self.rows) == 1 else ""

    def of(self, name: str, source: str, line: int) -> Mapping[str, float]:
        """Return one offset.

        Args:
            name: its name; empty if the program has selected none: the one that is `assumed`.
            source: the program, for the message.

        Raises:
            InputError: there is no such offset.
        """
        name = name or self.assumed
        if name in self.rows:
            return self.rows[name]
        known = ", ".join(list(self.rows)[:10])
        raise InputError(
            f"no such work offset in {self.path}" if name else "the program moves before it selects a work offset",
            expected=f"one of {known}",
            file=source,
            line=line,
            value=name or None,
        )

    @property
    def brief(self) -> str:
        """File and names."""
        return f"work offsets of {self.path.name}: {listed(list(self.rows))}"


@final
@dataclass(frozen=True, repr=False)
class ToolTable(Result):
    """Tool lengths of a machine.

    Attributes:
        lengths_mm: by number and by name: length from the spindle nose to the tool tip; of a further edge as ``5 D2``.
    """

    path: Path
    lengths_mm: Mapping[str, float]

    def of(self, name: str, source: str, line: int) -> float:
        """Return the length of a tool in mm.

        Args:
            name: its number or name.
            source: the program, for the message.

        Raises:
            InputError: there is no such tool.
        """
        if name in self.lengths_mm:
            return self.lengths_mm[name]
        known = [*self.lengths_mm]
        raise InputError(
            f"no such tool in {self.path}",
            expected=f"one of {', '.join(known[:10])}",
            file=source,
            line=line,
            value=name,
            nearest=closest_name(name, known),
        )

    @property
    def brief(self) -> str:
        """File and names."""
        return f"tools of {self.path.name}: {listed(list(self.lengths_mm))}"


class TableForm(ABC):
    """One form of these tables. A new form is a module with such a class, and an entry in `twin.controls.offsets.FORMS`.

    Attributes:
        description: its name in messages.
    """

    description: str

    @abstractmethod
    def is_offsets(self, lines: Sequence[str]) -> bool:
        """Return whether the lines of a file are work offsets in this form."""

    @abstractmethod
    def is_tools(self, lines: Sequence[str]) -> bool:
        """Return whether the lines of a file are tools in this form."""

    @abstractmethod
    def offsets(self, path: Path, lines: Sequence[str]) -> dict[str, dict[str, float]]:
        """Return the work offsets by name and axis, mm and degrees.

        Raises:
            InputError: with file, line and value.
        """

    @abstractmethod
    def tools(self, path: Path, lines: Sequence[str]) -> dict[str, float]:
        """Return the tool lengths in mm by number and by name.

        Raises:
            InputError: with file, line and value.
        """


def value_of(path: Path, line: int, text: str, what: str = "not a number") -> float:
    """Return the value of a number with a decimal point or comma.

    Raises:
        InputError: it is not one.
    """
    value = number(text)
    if value != value:
        raise InputError(what, expected="a number", file=path, line=line, value=text)
    return value


def rotated(path: Path, line: int, name: str, value: object) -> InputError:
    """Return the error for an offset that turns, mirrors or scales the coordinates."""
    return InputError(
        f"the work offset {name} turns, mirrors or scales the coordinates",
        expected="offsets that only shift the axes",
        file=path,
        line=line,
        value=value,
    )


# --- Work offsets and tools as CSV ----------------------------------------------------------------

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
            raise InputError(
                "no column length_mm", expected="tool,length_mm", file=path, line=1, value=",".join(header)
            )
        lengths = _numbers(Cells(path, columns, rows), "length_mm")
        tools = {_key(path, line, row[0]): value for (line, row), value in zip(rows, lengths, strict=True)}
        _check_once(path, tools, rows)
        if "name" in columns:
            tools |= {row[columns["name"]]: value for (_, row), value in zip(rows, lengths, strict=True)}
        return tools


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
