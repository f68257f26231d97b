"""What is asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, final

from twin.machine.conditions import Conditions
from twin.machine.control import BasicClass, TableFormat, format_named
from twin.machine.iso16907 import BASIC


@final
@dataclass(frozen=True)
class Request:
    """Tables of one format.

    Attributes:
        kind: name of one of `twin.machine.control.FORMATS`.
        at: mm, degrees by axis: where the other axes stand while one moves; the middle of their ranges where none is given.
        tool_length_mm: at which length the point is corrected; None: the machine file's.
        classes: basic classes to correct.
        tolerance_um: of the interpolation.
        step: mm or degrees between nodes; None: as wide as the tolerance allows.
        most: tables the control has; None: as the format has them.
        products: whether two tables may be multiplied, where the format has that.
        conditions: temperatures and time.
        add: whether the calibration's errors are those left under tables that are to be kept, the new ones added to them.
        notes: lines for the comments of every file.
    """

    kind: str
    at: Mapping[str, float] = field(default_factory=dict)
    tool_length_mm: float | None = None
    classes: frozenset[str] = frozenset(BASIC)
    tolerance_um: float = 1.0
    step: float | None = None
    most: int | None = None
    products: bool = True
    conditions: Conditions = field(default_factory=Conditions)
    add: bool = False
    notes: tuple[str, ...] = ()

    @property
    def form(self) -> TableFormat[Any]:
        """The format.

        Raises:
            InputError: there is none of that name.
        """
        return format_named(self.kind)

    @property
    def carried_classes(self) -> tuple[BasicClass, ...]:
        """Classes the format takes out, as far as it can, of those asked for."""
        return tuple(name for name in self.form.classes if name in self.classes)
