"""Lines of a control's file: numbered, and numbers in them that must be numbers."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from twin._common.errors import InputError
from twin._common.files import read_lines
from twin.machine.machine import Axis, Machine

UM_IN_MM = 1e-3
URAD_IN_DEG = 180e-6 / 3.141592653589793
LARGEST = 1e9
"""Of any number in a control's file: a thousand kilometres, more than the increments of any scale."""
LETTERS = tuple("XYZABCUVW")
"""What LinuxCNC and HEIDENHAIN call axes."""


def numbered(path: Path) -> list[tuple[int, str]]:
    """Every line with its number from 1 on, without blanks at its ends.

    Raises:
        InputError: the file cannot be read.
    """
    return [(number, text.strip()) for number, text in enumerate(read_lines(path), start=1)]


def number(text: str, path: Path, line: int, what: str) -> float:
    """Return a number of magnitude up to `LARGEST`.

    Raises:
        InputError: it is none.
    """
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) <= LARGEST:
        raise InputError(
            f"{what} is no number", expected=f"a number of at most {LARGEST:g}", file=path, line=line, value=text
        )
    return value


def rising(at: tuple[float, ...], lines: tuple[int, ...], path: Path) -> None:
    """Nothing, if positions rise from line to line.

    Raises:
        InputError: one does not.
    """
    for before, after, line in zip(at, at[1:], lines[1:], strict=False):
        if after <= before:
            raise InputError(
                "positions do not rise", expected=f"more than {before:g}", file=path, line=line, value=f"{after:g}"
            )


def axis_named(name: str, machine: Machine, path: Path, line: int | None) -> Axis:
    """An axis of the machine.

    Raises:
        InputError: it has none of that name.
    """
    if name not in machine.by_name:
        raise InputError(
            f"{machine.name} has no such axis",
            expected=f"one of {' '.join(machine.names)}",
            file=path,
            line=line,
            value=name,
        )
    return machine.by_name[name]


def check_letters(names: Iterable[str], control: str) -> None:
    """That a control which names its axes by a letter has them.

    Raises:
        InputError: a name that is none of its letters.
    """
    for name in names:
        if name not in LETTERS:
            raise InputError(
                f"{control} has no such axis", expected=f"axes named by one of {' '.join(LETTERS)}", value=name
            )


def unit_of(axis: Axis) -> float:
    """Mm a µm for a linear axis, degrees a µrad for a rotary one: what a control's file has for one of ours."""
    return UM_IN_MM if axis.linear else URAD_IN_DEG


def plain(value: float, digits: int) -> str:
    """A number with so many digits behind the point; no minus before a zero."""
    return f"{round(value, digits) + 0.0:.{digits}f}"
