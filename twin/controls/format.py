"""Base class of a control's table formats: one final class per format, each in its own file (`twin.controls.formats`)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Final, Generic, TypeVar, final

import numpy as np

from twin._common.errors import InputError
from twin._common.families import BasicClass
from twin._common.files import read_lines, scratch_folder
from twin.controls.correction import Correction
from twin.machine.machine import Axis, Machine

C = TypeVar("C", bound=Correction)


class TableFormat(ABC, Generic[C]):
    """One format of compensation tables.

    Attributes:
        name: name in options and calibration files.
        title: name of the control in messages.
        what: kind of file; with the next two a row of the manual's table.
        carries: description of the errors that it corrects.
        leaves: description of the errors that it does not correct.
        written: names of its files; ``{}`` stands for an axis.
        correction: class of the correction that they are read as.
        classes: classes of ISO/TR 16907 whose errors it corrects, completely or in part.
        points: largest number of nodes along an axis.
        rounding: half of the last digit written, µm and µrad.
        across: for tables of axes, whether a table can move another axis than its argument.
        wraps: whether positions of an unlimited rotary axis are wrapped into one turn.
        directions: whether tables may depend on the direction of approach.
        crossed_directions: whether tables that move another axis may depend on it too.
        knows_machine: whether the control uses a model of the machine: it corrects errors of all axes at the functional point, with the
            active tool.
        unread: files that are written but not needed to read the tables.
        tolerance_um: default tolerance of the interpolation.
        tables: default number of tables in the control; None if it is not limited.
        fewer_tables: controls with fewer tables, as ``828D: 8``.
        products: whether two tables can be multiplied.
        unchecked: assumptions that could not be checked against a public description; listed in every file and report.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    what: ClassVar[str]
    carries: ClassVar[str]
    leaves: ClassVar[str]
    written: ClassVar[tuple[str, ...]]
    correction: type[C]
    classes: ClassVar[tuple[BasicClass, ...]]
    points: ClassVar[int]
    rounding: ClassVar[tuple[float, float]]
    across: ClassVar[bool] = False
    wraps: ClassVar[bool] = False
    directions: ClassVar[bool] = False
    crossed_directions: ClassVar[bool] = False
    knows_machine: ClassVar[bool] = False
    unread: ClassVar[tuple[str, ...]] = ()
    tolerance_um: ClassVar[float] = 1.0
    tables: ClassVar[int | None] = None
    fewer_tables: ClassVar[str] = ""
    products: ClassVar[bool] = False
    unchecked: ClassVar[tuple[str, ...]] = ()

    @property
    def defaults(self) -> str:
        """Default tolerance and number of tables in words."""
        count = (
            ""
            if self.tables is None
            else f"; {self.tables} tables" + f" ({self.fewer_tables})" * bool(self.fewer_tables)
        )
        return f"{1e-3 * self.tolerance_um:g} mm{count}{'; products of two' if self.products else ''}"

    def files(self, machine: Machine) -> tuple[str, ...]:
        """Return the names of all files that may be written."""
        return tuple(
            file.format(axis)
            for file in self.written
            for axis in (machine.names if "{}" in file else machine.names[:1])
        )

    @abstractmethod
    def write(self, correction: C, notes: Sequence[str] = ()) -> dict[str, str]:
        """Return the texts of the files by name, with notes as comments; raise `InputError` for a correction that does not fit."""

    @abstractmethod
    def read(self, files: Sequence[Path], machine: Machine) -> C:
        """Return the tables from all files of the control, including those that assign tables to axes.

        It raises `InputError` if a file is invalid, or the control would refuse it.
        """

    @abstractmethod
    def loading(self, correction: C, largest: Mapping[str, float]) -> tuple[str, ...]:
        """Return instructions to load and activate the tables, one text per step; ``largest`` correction by axis, µm or µrad."""

    def to_read(self, written: Mapping[str, str]) -> tuple[str, ...]:
        """Return the names of those written files that `read` needs."""
        return tuple(name for name in written if name not in self.unread)

    def read_back(self, written: Mapping[str, str], machine: Machine) -> C:
        """Return the correction that a control applies with these files."""
        with scratch_folder() as folder:
            for name, text in written.items():
                (folder / name).write_text(text, encoding="utf-8")
            return self.read([folder / name for name in self.to_read(written)], machine)


# --- Lines of a control's file, with checks of the numbers and axes in them -----------------------

UM_IN_MM: Final = 1e-3
URAD_IN_DEG: Final = 180e-6 / 3.141592653589793
LARGEST: Final = 1e9
"""Largest magnitude of a number in a control's file: a thousand kilometres, more than the increments of any scale."""
LETTERS: Final = tuple("XYZABCUVW")
"""Axis names of controls that name axes by a letter."""


@final
@dataclass(frozen=True)
class TableLine:
    """A line of a file, or a part of it, without leading and trailing blanks; numbers begin with 1, None is a missing line."""

    path: Path
    number: int | None
    text: str

    def error(self, what: str, expected: str, value: object = None) -> InputError:
        """Return an error at this line."""
        return InputError(what, expected=expected, file=self.path, line=self.number, value=value)

    def decimal(self, what: str, text: str | None = None) -> float:
        """Return a number, of the whole line if ``text`` is None; raise `InputError`, which says ``what``, beyond `LARGEST`."""
        shown = self.text if text is None else text
        try:
            value = float(shown)
        except ValueError:
            value = float("nan")
        if not abs(value) <= LARGEST:
            raise self.error(f"{what} is not a number", f"a number of at most {LARGEST:g}", shown)
        return value

    def axis(self, name: str, machine: Machine) -> Axis:
        """Return the axis of that name; raise `InputError` if the machine has none."""
        if name not in machine.by_name:
            raise self.error(f"{machine.name} has no such axis", f"one of {' '.join(machine.names)}", name)
        return machine.by_name[name]


def table_lines(path: Path) -> list[TableLine]:
    """Return all lines of a file; raise `InputError` if it cannot be read."""
    return [TableLine(path, number, text.strip()) for number, text in enumerate(read_lines(path), start=1)]


def check_increasing(at: Sequence[float], lines: Sequence[TableLine]) -> None:
    """Raise `InputError` unless positions increase from line to line."""
    for before, after, line in zip(at, at[1:], lines[1:], strict=False):
        if after <= before:
            raise line.error("positions do not increase", f"more than {before:g}", f"{after:g}")


def single_file(files: Sequence[Path], suffix: str, what: str, expected: str) -> Path:
    """Return the only file with a suffix; raise `InputError` if none, or more than one, has it."""
    matching = [file for file in files if file.suffix.lower() == suffix]
    if len(matching) != 1:
        raise InputError(what, expected=expected, value=" ".join(file.name for file in files))
    return matching[0]


def check_letters(names: Iterable[str], control: str) -> None:
    """Raise `InputError` unless all names are axis names of controls that name axes by a letter."""
    for name in names:
        if name not in LETTERS:
            what = f"{control} has no such axis"
            raise InputError(what, expected=f"axes named by one of {' '.join(LETTERS)}", value=name)


def unit_of(axis: Axis) -> float:
    """Return the factor from twin's units to those of a control's file: mm per µm for a linear axis, degrees per µrad for others."""
    return UM_IN_MM if axis.linear else URAD_IN_DEG


def fixed_decimals(value: float, digits: int) -> str:
    """Return a number with ``digits`` decimals, without a minus sign before zero."""
    return f"{round(value, digits) + 0.0:.{digits}f}"


def rotation_about_axis(axis: int, angle: float) -> np.ndarray:
    """Return the rotation (3, 3) about an axis of a system, 0 to 2; the angle in radians."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    about = np.eye(3)
    about[i, i] = about[j, j] = np.cos(angle)
    about[j, i], about[i, j] = np.sin(angle), -np.sin(angle)
    return about
