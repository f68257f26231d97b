"""Effects of ISO blocks on drilling: which cycle is in force, and the moves that it adds to a block."""

from __future__ import annotations

import math
from typing import Final

from twin._common.errors import InputError
from twin.nc.block import Span
from twin.nc.blocks import Kind, Move
from twin.nc.iso import cycles, vocabulary
from twin.nc.iso.block import IsoBlock, Item
from twin.nc.iso.cycles import Drilling, Stroke
from twin.nc.iso.tilt import IsoTilt
from twin.nc.text import MM_PER_INCH

CODES: Final = cycles.FANUC | cycles.FANUC_TAPPING
_MODAL: Final = frozenset("RQP")
_REPEATS: Final = frozenset("LK")


class IsoDrilling(IsoTilt):
    """Drilling cycles: those of Fanuc and LinuxCNC, and calls of SINUMERIK by ``MCALL``.

    Attributes:
        plane: 17, 18 or 19.
        incremental: whether words are relative.
        cycle: the cycle executed after every positioning, or None.
        code: G code of a Fanuc cycle in force, empty if there is none.
    """

    plane = 17
    incremental = False
    cycle: Drilling | None = None
    code = ""
    _motion_before: int | None = None
    _to_initial = True
    _level_stated = False
    _initial = math.nan
    _words = ""

    def cycle_code(self, block: IsoBlock, span: Span, group: str) -> bool:
        """Apply a G word to the Fanuc cycle in force; return whether it begins one.

        ``G80`` and the motion codes end a cycle; after ``G80`` the motion code before the cycle applies again.
        """
        code = span.name
        if code in CODES:
            if not self.code:
                self._motion_before, self._initial = self.motion, self.position[2]
                self._height: dict[str, float] = {}
                self._dwell = ""
            self.code, self.motion = code, 0  # positions between holes are rapid
            block.cycle_words.append(span)
            return True
        if group == "return":
            self._to_initial, self._level_stated = code == "98", True
        elif self.code and (group == "motion" or code == "80"):
            self.code, self.cycle = "", None
            self.motion = self._motion_before
        return False

    def take_cycle_words(self, block: IsoBlock) -> bool:
        """Take the words of a Fanuc cycle from a block; return whether the block executes the cycle.

        A block with an axis word or R does. P and Q in any other block belong to another word (``G4 P1``, ``G64 P0.01``,
        ``G5.1 Q1``).

        Raises:
            InputError: a value is missing, contradicts another, or depends on a mode that is not expanded.
        """
        level_stated, self._level_stated = self._level_stated, False
        if not self.code:
            return False
        if not (block.items or any(item.name == "R" for item in block.others)):
            if block.cycle_words:
                raise self._refused("no place", "an axis word or R in the block of the cycle")
            if level_stated and self.cycle is not None:
                self.cycle = self._cycle()
            return False
        if self._take_heights(block):
            if self.code in cycles.FANUC_TAPPING:
                self._thread_words(block)
            self.cycle = self._cycle()
        elif level_stated and self.cycle is not None:
            self.cycle = self._cycle()
        return True

    def _take_heights(self, block: IsoBlock) -> bool:
        """Take heights, step and dwell of a Fanuc cycle from a block; return whether it states any of them or the cycle.

        Raises:
            InputError: repeats, or an unknown value.
        """
        stated = bool(block.cycle_words)
        unit = MM_PER_INCH if self.inch else 1.0
        kept: list[Item] = []
        for item in (*block.items, *block.others):
            if item.name in _REPEATS:
                if self.value_of(item.value) != 1.0:
                    raise self._refused("repeats", "one hole a block, without L or K", item.value)
            elif item.name == "Z" or item.name in _MODAL:
                value = self.known_value(item.name, item.value, "a number")
                stated = True
                self._height[item.name] = value * unit
                if item.name == "P":
                    self._dwell = item.value.strip()
            else:
                kept.append(item)
                continue
            block.cycle_words.append(Span(item.start, item.end, item.name))
        block.items = [item for item in kept if item.name in self.index]
        block.others = [item for item in kept if item.name not in self.index]
        return stated

    @property
    def _retract(self) -> float:
        return self._initial if self._to_initial else self._height.get("R", math.nan)

    def _thread_words(self, block: IsoBlock) -> None:
        """Take over the words of a thread other than Z and R, which are written again with it."""
        if not {"Z", "R"} <= {span.name for span in block.cycle_words}:
            raise self._refused("thread", "Z and R in the block of the cycle")
        others = [span for span in block.cycle_words if span.name not in (self.code, "Z", "R")]
        words = [block.text[span.start : span.end].strip() for span in others]
        feed = [] if block.feed is None else [f"F{block.text[block.feed.start : block.feed.end]}"]
        self._words = " ".join([*words, *feed])

    def _cycle(self) -> Drilling:
        if self.plane != 17 or self.incremental or self.tcp or self.vector is not None:
            raise self._refused("cycle", "drilling along Z in G17, G90, without tool centre point control")
        top = self._height.get("R", math.nan)
        if self._initial != self._initial:
            raise self._refused("position of Z unknown", "a position of Z before the cycle")
        if self._initial < top - 1e-9:
            raise self._refused("Z is below R", "Z at R or above before the cycle")
        try:
            return cycles.of_fanuc(self.code, self._height, self._dwell, self._retract, self._words)
        except ValueError as error:
            raise self._refused("cycle", str(error)) from None

    def _refused(self, what: str, expected: str, value: object = None) -> InputError:
        return self.error(f"canned cycle G{self.code}: {what}", f"{expected}; or {vocabulary.EXPANDED_CYCLE}", value)

    def call(self, name: str, arguments: str) -> Drilling:
        """Return the cycle that ``MCALL`` calls.

        Args:
            name: the cycle.
            arguments: its argument list, with parentheses.

        Raises:
            InputError: it is not expanded.
        """
        shown = f"{name}{arguments}"
        if self.plane != 17 or self.tcp:
            expected = "drilling along Z in G17, without TRAORI"
            raise self.error(f"canned cycle {name}", f"{expected}; or {vocabulary.EXPANDED_CYCLE}", shown)
        try:
            return cycles.of_sinumerik(name, arguments[1:-1], self.value_of, MM_PER_INCH if self.inch else 1.0)
        except ValueError as error:
            expected = f"{error}; or {vocabulary.EXPANDED_CYCLE}"
            raise self.error(f"canned cycle {name}", expected, shown) from None

    def call_once(self, block: IsoBlock, item: Item) -> None:
        """Execute a cycle of SINUMERIK at the present position.

        Raises:
            InputError: it is not expanded.
        """
        block.cycle_word, block.calls = Span(item.start, len(block.text.rstrip("\r\n"))), True
        self.cycle = self.call(item.name, item.value)

    def mcall(self, block: IsoBlock, item: Item, *, last: bool) -> None:
        """Apply ``MCALL`` or the cycle after it, the ``last`` statement of its block.

        Raises:
            InputError: it is not expanded.
        """
        if item.name == "MCALL":
            block.cycle_word = Span(item.start, len(block.text.rstrip("\r\n")))
            if last:
                self.cycle = None
            return
        if not last:
            raise self.error(f"canned cycle {item.name}", vocabulary.EXPANDED_CYCLE, block.text[item.start :].strip())
        self.cycle = self.call(item.name, item.value)

    @property
    def steady(self) -> bool:
        """Whether no cycle is in force, or one that is the same at every following place because it ends at the present height."""
        if self.cycle is None:
            return True
        ends = [stroke.height for stroke in self.cycle.strokes if stroke.height == stroke.height]
        same = bool(ends) and ends[-1] == self.position[2] and self.cycle.level != self.cycle.level
        return same and self.plane == 17 and not self.tcp

    def strokes(self) -> list[Stroke]:
        """Return the strokes of the cycle from the present height, without those that do not move; only their blocks behind stay."""
        height, found = self.position[2], list[Stroke]()
        for stroke in () if self.cycle is None else self.cycle.strokes:
            if stroke.height == stroke.height and (abs(stroke.height - height) > 1e-9 or height != height):
                height = stroke.height
                found.append(stroke)
            elif stroke.after or stroke.thread is not None:
                found.append(stroke._replace(height=math.nan))
        return found

    @property
    def repeated(self) -> tuple[tuple[float, bool], ...] | None:  # type: ignore[override]
        """See `Interpreter`."""
        if self.cycle is None:
            return None
        return tuple((one.height, one.kind is Kind.RAPID) for one in self.strokes() if one.height == one.height)

    def drill(self, block: IsoBlock, cycle: Drilling) -> None:
        """Add the strokes of a cycle to the moves of a block, except those that do not move."""
        if (
            self.unknown
            or self.plane != 17
            or self.incremental
            or self.tcp
            or self.vector is not None
            or block.end_m_words
        ):
            raise self.error("canned cycle", vocabulary.EXPANDED_CYCLE)
        named = frozenset(self.names[2:3])
        strokes = self.strokes()
        for stroke in strokes:
            if stroke.height == stroke.height:
                self.position[2] = stroke.height
                block.moves += (Move(self._line, stroke.kind, False, tuple(self.position), named),)
        if cycle.level == cycle.level:
            self.position[2] = cycle.level
        block.drilling = Drilling(tuple(strokes), cycle.level)
        self.drilled.append(range(self._line, self._line + 1))
