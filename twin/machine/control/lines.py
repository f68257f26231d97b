"""Lines of a control's file, with checks of the numbers and axes in them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

from twin._common.errors import InputError
from twin._common.files import read_lines
from twin.machine.machine import Axis, Machine

UM_IN_MM: Final = 1e-3
URAD_IN_DEG: Final = 180e-6 / 3.141592653589793
LARGEST: Final = 1e9
"""Largest magnitude of a number in a control's file: a thousand kilometres, more than the increments of any scale."""
LETTERS: Final = tuple("XYZABCUVW")
"""Axis names of controls that name axes by a letter."""


@final
@dataclass(frozen=True)
class TableLine:
    """A line of a file, or a part of it.

    Attributes:
        path: the file.
        number: number of the line, from 1 on; None for a missing line.
        text: text without leading and trailing blanks.
    """

    path: Path
    number: int | None
    text: str

    def error(self, what: str, expected: str, value: object = None) -> InputError:
        """Return an error at this line."""
        return InputError(what, expected=expected, file=self.path, line=self.number, value=value)

    def decimal(self, what: str, text: str | None = None) -> float:
        """Return a number of magnitude up to `LARGEST`.

        Args:
            what: name of the number, for the message.
            text: text of the number; the whole line if None.

        Raises:
            InputError: the text is not such a number.
        """
        shown = self.text if text is None else text
        try:
            value = float(shown)
        except ValueError:
            value = float("nan")
        if not abs(value) <= LARGEST:
            raise self.error(f"{what} is not a number", f"a number of at most {LARGEST:g}", shown)
        return value

    def axis(self, name: str, machine: Machine) -> Axis:
        """Return the axis of that name.

        Raises:
            InputError: the machine has no such axis.
        """
        if name not in machine.by_name:
            raise self.error(f"{machine.name} has no such axis", f"one of {' '.join(machine.names)}", name)
        return machine.by_name[name]


def table_lines(path: Path) -> list[TableLine]:
    """Return all lines of a file.

    Raises:
        InputError: the file cannot be read.
    """
    return [TableLine(path, number, text.strip()) for number, text in enumerate(read_lines(path), start=1)]


def check_increasing(at: Sequence[float], lines: Sequence[TableLine]) -> None:
    """Raise `InputError` unless positions increase from line to line."""
    for before, after, line in zip(at, at[1:], lines[1:], strict=False):
        if after <= before:
            raise line.error("positions do not increase", f"more than {before:g}", f"{after:g}")


def single_file(files: Sequence[Path], suffix: str, what: str, expected: str) -> Path:
    """Return the only file with a suffix.

    Raises:
        InputError: no file, or more than one, has it.
    """
    found = [file for file in files if file.suffix.lower() == suffix]
    if len(found) != 1:
        raise InputError(what, expected=expected, value=" ".join(file.name for file in files))
    return found[0]


def check_letters(names: Iterable[str], control: str) -> None:
    """Raise `InputError` unless all names are axis names of controls that name axes by a letter."""
    for name in names:
        if name not in LETTERS:
            raise InputError(
                f"{control} has no such axis", expected=f"axes named by one of {' '.join(LETTERS)}", value=name
            )


def unit_of(axis: Axis) -> float:
    """Return the factor from twin's units to those of a control's file: mm per µm for a linear axis, degrees per µrad for others."""
    return UM_IN_MM if axis.linear else URAD_IN_DEG


def fixed_decimals(value: float, digits: int) -> str:
    """Return a number with ``digits`` decimals, without a minus sign before zero."""
    return f"{round(value, digits) + 0.0:.{digits}f}"
