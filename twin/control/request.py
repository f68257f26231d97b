"""Format and settings of the tables to be made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, final

from twin.machine.classes import BASIC, BasicClass
from twin.machine.conditions import Conditions
from twin.machine.control import TableFormat, format_named


@final
@dataclass(frozen=True)
class Request:
    """Format and settings of the tables to be made.

    Attributes:
        kind: name of a format of `twin.machine.control`.
        at: positions of the other axes while one moves, mm or degrees by axis; by default the middle of a linear range, 0° of a rotary.
        tool_length_mm: tool length for which the point is corrected; None: that of the machine file.
        classes: basic classes to correct (ISO/TR 16907).
        tolerance_um: tolerance of the interpolation.
        step: mm or degrees between nodes; None: as wide as the tolerance allows.
        most: number of tables the control has; None: the format's default.
        products: whether two tables may be multiplied, if the format can do that.
        conditions: temperatures and time.
        unproven: whether tables are written although U of their correction exceeds the correction.
        add: whether the calibration was measured with tables switched on, and the new tables are added to those.
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
    unproven: bool = False
    add: bool = False
    notes: tuple[str, ...] = ()

    @property
    def form(self) -> TableFormat[Any]:
        """The format.

        Raises:
            InputError: no format has that name.
        """
        return format_named(self.kind)

    @property
    def carried_classes(self) -> tuple[BasicClass, ...]:
        """Selected classes that the format can correct, wholly or in part."""
        return tuple(name for name in self.form.classes if name in self.classes)
