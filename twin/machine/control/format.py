"""Base class of a control's table formats: one final class per format, each in its own file (`twin.machine.control.formats`)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar, Generic, TypeVar

from twin._common import families
from twin._common.files import scratch_folder
from twin.machine.classes import BasicClass
from twin.machine.control.correction import Correction
from twin.machine.machine import Machine

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
    unchecked: ClassVar[tuple[str, ...]] = ()

    @property
    def tolerance_um(self) -> float:
        """Default tolerance of the interpolation."""
        return families.TABLE_TOLERANCES_UM.get(self.name, families.USUAL_TOLERANCE_UM)

    @property
    def tables(self) -> int | None:
        """Default number of tables in the control; None if it is not limited."""
        return families.TABLE_COUNTS[self.name][0] if self.name in families.TABLE_COUNTS else None

    @property
    def products(self) -> bool:
        """Whether two tables can be multiplied."""
        return self.name in families.PRODUCT_FORMATS

    def files(self, machine: Machine) -> tuple[str, ...]:
        """Return the names of all files that may be written."""
        return tuple(
            file.format(axis)
            for file in self.written
            for axis in (machine.names if "{}" in file else machine.names[:1])
        )

    @abstractmethod
    def write(self, correction: C, notes: Sequence[str] = ()) -> dict[str, str]:
        """Return the texts of the files by file name.

        Args:
            correction: the tables.
            notes: texts for comments, placed where the control ignores them.

        Raises:
            InputError: the format cannot represent the correction.
        """

    @abstractmethod
    def read(self, files: Sequence[Path], machine: Machine) -> C:
        """Return the tables from all files of the control, including those that assign tables to axes.

        Raises:
            InputError: a file is invalid, or the control would refuse it.
        """

    @abstractmethod
    def loading(self, correction: C, largest: Mapping[str, float]) -> tuple[str, ...]:
        """Return instructions to load and activate the tables, one text per step.

        Args:
            correction: the tables.
            largest: largest correction of every axis that is moved, µm or µrad.
        """

    def to_read(self, written: Mapping[str, str]) -> tuple[str, ...]:
        """Return the names of those written files that `read` needs."""
        return tuple(name for name in written if name not in self.unread)

    def read_back(self, written: Mapping[str, str], machine: Machine) -> C:
        """Return the correction that a control applies with these files."""
        with scratch_folder() as folder:
            for name, text in written.items():
                (folder / name).write_text(text, encoding="utf-8")
            return self.read([folder / name for name in self.to_read(written)], machine)
