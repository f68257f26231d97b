"""Base class of the kinematics of a control's transformation: one final class per format, each in its own file."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar, Final

from twin._common.errors import InputError
from twin._common.files import scratch_folder
from twin.machine.control.kinematics.geometry import TableGeometry
from twin.machine.control.lines import TableLine, table_lines
from twin.machine.machine import Machine

SHORTEST: Final = 1e-6
"""Length below which a vector has no direction."""
Values = Mapping[str, float]
"""Values of a control's parameters, by their own names."""


class KinematicsFormat(ABC):
    """One way in which a control stores the lines of the rotary axes of its five-axis transformation.

    Attributes:
        name: name in options and calibration files.
        title: name of the control in messages.
        what: kind of file; with the next two a row of the manual's table.
        carries: description of the constants that it holds.
        leaves: description of the constants that it does not hold.
        file: name of its file.
        unchecked: assumptions that could not be checked against a public description; listed in the file and in the account.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    what: ClassVar[str]
    carries: ClassVar[str]
    leaves: ClassVar[str]
    file: ClassVar[str]
    unchecked: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def nominal(self, machine: Machine) -> Values:
        """Return the parameters of the nominal machine: those that `geometry` reads and `twin.control.constants` fits.

        Raises:
            InputError: the transformation cannot represent the structure of the machine.
        """

    @abstractmethod
    def geometry(self, values: Values, machine: Machine) -> TableGeometry:
        """Return the geometry that the control derives from its parameters."""

    @abstractmethod
    def write(self, values: Values, machine: Machine, notes: Sequence[str] = ()) -> str:
        """Return the text of the file.

        Args:
            values: the parameters, as `nominal`.
            machine: the machine.
            notes: texts for comments.
        """

    @abstractmethod
    def read(self, path: Path, machine: Machine) -> TableGeometry:
        """Return the geometry in a file.

        Raises:
            InputError: the file is invalid, a parameter is missing, or the machine cannot have this transformation.
        """

    @abstractmethod
    def loading(self, machine: Machine) -> tuple[str, ...]:
        """Return instructions to enter and activate the parameters, one text per step."""

    def read_back(self, text: str, machine: Machine) -> TableGeometry:
        """Return the geometry of a control with this text."""
        with scratch_folder() as folder:
            (folder / self.file).write_text(text, encoding="utf-8")
            return self.read(folder / self.file, machine)


def code_lines(path: Path, comment: str) -> list[TableLine]:
    """Return the lines of a file that are not empty, without what follows a comment's mark.

    Raises:
        InputError: the file cannot be read.
    """
    lines = [TableLine(path, one.number, one.text.partition(comment)[0].strip()) for one in table_lines(path)]
    return [line for line in lines if line.text]


def numbers_of(path: Path, found: Mapping[str, TableLine], names: Sequence[str]) -> dict[str, float]:
    """Return the numbers of all named parameters of a file.

    Raises:
        InputError: one is missing or not a number.
    """
    for name in names:
        if name not in found:
            raise InputError(f"the parameter {name} is missing", expected="all parameters of the format", file=path)
    return {name: found[name].decimal(name) for name in names}


def assign(found: dict[str, TableLine], name: str, value: TableLine) -> None:
    """Add the value of a parameter.

    Raises:
        InputError: it has one already.
    """
    if name in found:
        raise value.error(f"{name} is assigned twice", "one assignment", value.text)
    found[name] = value
