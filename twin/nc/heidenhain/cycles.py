"""Machining cycles of Heidenhain programs that make holes: the control executes them at a corrected place.

Sources: HEIDENHAIN TNC 640, user's manual "Programming of machining cycles" (200 to 209, 240, 241; calls by ``CYCL CALL``, ``M99`` and
``M89``), iTNC 530, "Cycles" (1, 2, 17 and 18). A cycle from 200 on goes at rapid to the set-up clearance Q200 above the surface Q203,
and returns to it, or to the second set-up clearance Q204 above the surface if that is higher. The older ones begin and end where the
tool is.
"""

from __future__ import annotations

import math
from typing import Final

from twin.nc.blocks import Kind, Move
from twin.nc.heidenhain import vocabulary
from twin.nc.heidenhain.calls import Cycle, CycleCall, PathBlock
from twin.nc.modal import Interpreter, Span
from twin.nc.text import MM_PER_INCH

HOLES: Final = frozenset({*range(200, 210), 240, 241})
AT_PRESENT_HEIGHT: Final = frozenset({1, 2, 17, 18})
_SURFACE: Final = "Q203"


class HeidenhainCycles(Interpreter):
    """The machining cycle in force and its calls.

    Attributes:
        plane: in-plane axes and the drilling axis.
        modal: whether every positioning calls the cycle (``M89``).
    """

    plane = (0, 1, 2)
    modal = False
    _in_force: Cycle | None = None

    def define(self, number: int, part: str | None, body: str) -> None:
        """Begin the definition of a machining cycle, or take a further line of an older one (``1.1``)."""
        if part not in (None, "0"):
            if self._in_force is not None and self._in_force.number == number:
                self._in_force.texts.append(body)
        elif number in HOLES or number in AT_PRESENT_HEIGHT:
            self._in_force = Cycle(number, [body], {name.upper() for name, _ in vocabulary.ASSIGNED.findall(body)})
        elif number not in vocabulary.BESIDE_CYCLES:
            self._in_force = None

    def take_parameters(self, body: str) -> None:
        """Take a line that only sets parameters: it belongs to the definition of a cycle directly before it, else it may change it."""
        names = {name.upper() for name, _ in vocabulary.ASSIGNED.findall(body)}
        cycle = self._in_force
        if cycle is not None and cycle.open and cycle.number in HOLES:
            cycle.texts.append(body)
            cycle.given |= names
        elif cycle is not None and cycle.given & names:
            cycle.changed = True

    def close_definition(self) -> None:
        """End the definition of a cycle: another statement follows."""
        if self._in_force is not None:
            self._in_force.open = False

    def call_cycle(self, block: PathBlock) -> None:
        """Add the approach of the cycle in force to the moves of a block.

        Raises:
            InputError: no cycle is in force, its heights are unknown, or the mode does not allow it.
        """
        cycle, axis = self._in_force, self.plane[2]
        if cycle is None:
            expected = f"cycle 200 to 209, 240, 241, 1, 2, 17 or 18 defined before it; or {vocabulary.EXPANDED_CYCLE}"
            raise self.error("cycle call without a cycle that is known", expected)
        what, name = f"cycle call of cycle {cycle.number}", self.names[axis]
        if self.unknown:
            raise self.error(f"{what} where {self.unknown}", "the words named as harmless in the machine file")
        if self.tcp or self.vector is not None:
            raise self.error(what, "a position without tool centre point control (M129)")
        if cycle.changed:
            raise self.error(what, "a new CYCL DEF instead of its parameters set after it")
        at = self.position[axis]
        if at != at:
            raise self.error(f"{what} while the position of {name} is unknown", f"a position of {name} before it")
        surface, top, level = math.nan, at, at
        if cycle.number in HOLES:
            unit = MM_PER_INCH if self.inch else 1.0
            clearance, surface = (self._parameter(what, name) * unit for name in ("Q200", _SURFACE))
            second = self._parameter(what, "Q204") * unit if "Q204" in cycle.given else clearance
            top, level = surface + clearance, surface + max(second, clearance)
        if abs(top - at) > 1e-9:
            self.position[axis] = top
            named = frozenset((name,))
            block.moves += (Move(self._line, Kind.RAPID, False, tuple(self.position), named),)
        self.use_set_up(Kind.LINEAR)
        block.call = CycleCall(cycle, top, surface, level, axis)
        self.position[axis] = level
        self.drilled.append(range(self._line, self._line + 1))
        self.note(
            f"cycle {cycle.number} is left to the control: its place and its heights have the correction of the height where it begins",
            once=True,
        )

    def _parameter(self, what: str, name: str) -> float:
        cycle = self._in_force
        if cycle is None or name not in cycle.given:
            raise self.error(what, f"{name} in its definition")
        value = self.value_of(name)
        if value != value:
            raise self.error(f"{what} with an unknown {name}", "a number, or a Q parameter set to a number before")
        return value

    def take_call_word(self, block: PathBlock, code: int, span: Span) -> None:
        """Take ``M89`` or ``M99``: the block calls the cycle after its motion."""
        block.call_words.append(span)
        block.calls = True
        self.modal = code == 89
