"""Tables of work offsets and tools, and the interface of the forms in which they are read."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

from twin._common.errors import InputError, closest_name
from twin.display import card, pairs
from twin.nc.text import number


@final
@dataclass(frozen=True)
class OffsetTable:
    """Work offsets of a machine.

    Attributes:
        path: its file.
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
            line: its line.

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

    def _repr_html_(self) -> str:
        rows = [
            (name, ", ".join(f"{axis} {value:g}" for axis, value in row.items())) for name, row in self.rows.items()
        ]
        return card(f"Work offsets of {self.path.name} (mm, °)", pairs(rows)).text


@final
@dataclass(frozen=True)
class ToolTable:
    """Tool lengths of a machine.

    Attributes:
        path: its file.
        lengths_mm: by number and by name: length from the spindle nose to the tool tip; of a further edge as ``5 D2``.
    """

    path: Path
    lengths_mm: Mapping[str, float]

    def of(self, name: str, source: str, line: int) -> float:
        """Return the length of a tool in mm.

        Args:
            name: its number or name.
            source: the program, for the message.
            line: its line.

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

    def _repr_html_(self) -> str:
        rows = [(name, f"{length:g} mm") for name, length in self.lengths_mm.items()]
        return card(f"Tools of {self.path.name}", pairs(rows)).text


class TableForm(ABC):
    """One form of these tables. A new form is a module with such a class, and an entry in `twin.nc.tables.load.FORMS`.

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
