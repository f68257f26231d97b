"""What is known of a control's table format: one final class a format, in a file of its own (`twin.machine.control.FORMATS`)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar, Generic, TypeVar

from twin._common.files import scratch_folder
from twin.machine.control.correction import BasicClass, Correction
from twin.machine.machine import Machine

C = TypeVar("C", bound=Correction)


class TableFormat(ABC, Generic[C]):
    """One format of compensation tables.

    Attributes:
        name: as options and calibration files have it.
        title: of the control, in messages.
        what: kind of file; with the next two a line of the manual's table.
        carries: what it takes out, in words.
        leaves: what it does not.
        written: names of its files; ``{}`` stands for an axis.
        correction: what they are read as.
        classes: classes of ISO/TR 16907 whose errors it takes out, as far as it can.
        points: most nodes along an axis.
        rounding: half of the last digit written, µm and µrad.
        tolerance_um: of the interpolation, where nobody says otherwise.
        tables: how many tables the control has, where nobody says otherwise; None: as many as there are.
        fewer_tables: what is said of controls that have fewer.
        across: of tables of axes, whether an axis can move another one.
        products: whether two of them can be multiplied.
        wraps: whether positions of an axis that turns without end are wrapped into a turn.
        directions: whether its tables may differ by the direction an axis comes from.
        crossed_directions: whether those of another axis may, and not only those of an axis over itself.
        knows_machine: whether the control knows the machine's kinematics: errors of all axes act at the point, the active tool counts.
        unread: files that are written and that the tables are not read from.
        unchecked: what could not be checked against a public description; said in every file and in the account.
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
    tolerance_um: ClassVar[float] = 1.0
    tables: ClassVar[int | None] = None
    fewer_tables: ClassVar[str] = ""
    across: ClassVar[bool] = False
    products: ClassVar[bool] = False
    wraps: ClassVar[bool] = False
    directions: ClassVar[bool] = False
    crossed_directions: ClassVar[bool] = False
    knows_machine: ClassVar[bool] = False
    unread: ClassVar[tuple[str, ...]] = ()
    unchecked: ClassVar[tuple[str, ...]] = ()

    def files(self, machine: Machine) -> tuple[str, ...]:
        """Names of all files that may be written."""
        return tuple(
            file.format(axis)
            for file in self.written
            for axis in (machine.names if "{}" in file else machine.names[:1])
        )

    @abstractmethod
    def write(self, correction: C, notes: Sequence[str] = ()) -> dict[str, str]:
        """Texts by the names of their files.

        Args:
            correction: the tables.
            notes: said in comments, where the control reads none of them.

        Raises:
            InputError: what such tables cannot hold.
        """

    @abstractmethod
    def read(self, files: Sequence[Path], machine: Machine) -> C:
        """The tables of the control's files, all of them together: those that say which table belongs to which axis too.

        Raises:
            InputError: whatever does not fit in a file, or the control would refuse.
        """

    @abstractmethod
    def loading(self, correction: C, largest: Mapping[str, float]) -> tuple[str, ...]:
        """How the tables get into the control and are switched on, step by step.

        Args:
            correction: the tables.
            largest: correction of every axis that is moved, µm or µrad.
        """

    def to_read(self, written: Mapping[str, str]) -> tuple[str, ...]:
        """Names of the files that `read` wants of what was written."""
        return tuple(name for name in written if name not in self.unread)

    def read_back(self, written: Mapping[str, str], machine: Machine) -> C:
        """What a control that is given these texts does."""
        with scratch_folder() as folder:
            for name, text in written.items():
                (folder / name).write_text(text, encoding="utf-8")
            return self.read([folder / name for name in self.to_read(written)], machine)
