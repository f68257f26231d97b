"""Drilling cycles of ISO programs, block by block: their words, their strokes at every place, and polar words of LinuxCNC."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from twin._common.errors import InputError
from twin.nc.arcs import PLANES
from twin.nc.blocks import Kind, Move
from twin.nc.iso import cycles, vocabulary
from twin.nc.iso.cycles import Drilling, Kept, Stroke
from twin.nc.iso.frame import IsoBlock, IsoShift, Item
from twin.nc.modal import CORRECTION_DEG, AxisWord, Span
from twin.nc.text import MM_PER_INCH, SAME_MM, number

INCH_CODES: Final = frozenset({"20", "70", "700"})
CODES: Final = cycles.FANUC | cycles.FANUC_KEPT
_AT_REFERENCE: Final = "after a reference return: programs: {references: …} in the machine file"
_MODAL: Final = frozenset("RQP")
_REPEATS: Final = frozenset("LK")
TAP: Final = "33.1"
"""G code of rigid tapping by a spindle that turns (LinuxCNC)."""
AT_POLE_MM: Final = 1e-6
"""Distance from the zero of the coordinates below which a point has no angle."""
_DRILLING: Final = {17: 2, 18: 1, 19: 0}
"""The linear axis that drills, by plane."""


class IsoDrilling(IsoShift):
    """Drilling cycles: those of Fanuc and LinuxCNC, and calls of SINUMERIK by ``MCALL``.

    Attributes:
        plane: 17, 18 or 19.
        cycle: the cycle executed after every positioning, or None.
        code: G code of a Fanuc cycle in force, empty if there is none.
    """

    plane = 17
    incremental = False
    cycle: Drilling | None = None
    code = ""
    _cycle_plane = 17
    _motion_before: int | None = None
    _tapped = False
    _to_initial = True
    _level_stated = _level_given = False
    _stated_incremental = False
    _initial = math.nan
    _words = _feed = ""
    _repeats = 1
    _below: tuple[float, ...] = ()
    """The position from which LinuxCNC raises the tool before it goes to the hole of the block; empty if it does not."""

    @property
    def drilling(self) -> int:
        """The linear axis that drills in the plane in force."""
        return _DRILLING[self.plane]

    def cycle_code(self, block: IsoBlock, span: Span, group: str) -> bool:
        """Apply a G word to the Fanuc cycle in force; return whether it begins one.

        ``G80`` and the motion codes end a cycle; after ``G80`` the motion code before the cycle applies again.
        """
        code = span.name
        self._tapped = code == TAP or (self._tapped and group != "motion")
        if code == TAP:
            self.code, self.cycle, self.motion, self.control = "", None, None, "LinuxCNC"
            block.cycle_words.append(span)
            return True
        if group == "units" and self.cycle is not None and self.inch != (code in INCH_CODES):
            raise self.error("another unit while a drilling cycle is in force", "G80 or MCALL before the unit changes")
        if code in CODES:
            if not self.code:
                self._motion_before, self._initial = self.motion, math.nan
                self._height: dict[str, float] = {}
            if not self.code or (code != self.code and self.control == "LinuxCNC"):
                self._texts: dict[str, str] = {}
            self.code, self.motion = code, 0  # positions between holes are rapid
            block.cycle_words.append(span)
            return True
        if group == "return":
            self._to_initial, self._level_stated, self._level_given = code == "98", True, True
        elif self.code and (group == "motion" or code == "80"):
            self.code, self.cycle = "", None
            self.motion = self._motion_before
        return False

    def tap(self, block: IsoBlock) -> None:
        """Leave the rigid tapping ``G33.1 Z K`` of LinuxCNC to the control, which returns to the height where it begins."""
        depth, at = self.names[self.drilling].upper(), self.position[self.drilling]
        pitch = [item for item in block.others if item.name == "K"]
        if [item.name for item in block.items] != [depth] or not pitch or len(pitch) < len(block.others) or block.names:
            raise self.error(f"thread G{TAP}", f"G{TAP} with {depth} and K alone")
        word = self.axis_word(block.items[0], machine=False)
        if at != at or self.tcp or self.plane != 17:
            raise self.error(f"thread G{TAP} from an unknown height", f"a position of {depth} before it, in G17")
        to = at + word.value if word.incremental else word.value
        shown = f" {block.text[pitch[0].start : pitch[0].end].strip()}"
        kept = Kept(at, (f"G{TAP} {depth}", to, shown), (f"G{TAP} {depth}", to - at, shown))
        items = (*block.items, *block.others)
        block.cycle_words = [*block.cycle_words, *(Span(one.start, one.end, one.name) for one in items)]
        self.note_kept(f"G{TAP}")
        self.cycle, self._cycle_plane, block.positions = (
            Drilling((Stroke(math.nan, Kind.LINEAR, kept=kept),)),
            17,
            False,
        )
        self.drill(block, self.cycle)
        self.cycle = None

    def take_cycle_words(self, block: IsoBlock) -> bool:
        """Take the words of a Fanuc cycle from a block; return whether the block executes the cycle.

        A block with an axis word or R does. P and Q in any other block belong to another word (``G4 P1``, ``G64 P0.01``, ``G5.1 Q1``).
        """
        level_stated, self._level_stated = self._level_stated, False
        self._repeats, self._below = 1, ()
        if not self.code:
            return False
        stated = bool(block.cycle_words)
        if not (block.items or any(item.name == "R" for item in block.others)):
            if stated:
                raise self._refused("no place", "an axis word or R in the block of the cycle")
            if level_stated and self.cycle is not None:
                self.cycle = self._cycle()
            return False
        for word in filter(block.own_of, block.m_words):
            raise self._refused(f"a word of {word} beside it", f"{word} in a block of its own, or after G80")
        if not self._height:
            self._initial, self._stated_incremental = self.position[self.drilling], self.incremental
        stated |= self._take_values(block)
        if self._left:
            self._kept_words(block, stated=stated)
            stated |= block.feed is not None
        self._check_increments()
        if stated or (level_stated and self.cycle is not None):
            self.cycle, self._cycle_plane = self._cycle(), self.plane
        at, top = self.position[self.drilling], self._height.get("R", math.nan)
        first = abs(at - top) > 1e-9 if self._initial < top - 1e-9 else at < min(top + 2e-9, self._retract) - 1e-9
        if self.control == "LinuxCNC" and first:
            self._below = tuple(self.position)
        return self._repeats > 0 or self._only_defines(block)

    def _take_values(self, block: IsoBlock) -> bool:
        """Move the values of the cycle from a block's words to the cycle; return whether there is one."""
        unit, depth = MM_PER_INCH if self.inch else 1.0, self.names[self.drilling].upper()
        own = _MODAL | set(cycles.FANUC_WORDS.get(self.code, ""))
        found: dict[str, float] = {}
        kept = list[Item]()
        for item in (*block.items, *block.others):
            if item.name in _REPEATS:
                self._repeats = self._number_of_holes(item)
            elif item.name == depth or item.name in own:
                value = self.known_value(item.name, item.value, "a number")
                found["Z" if item.name == depth else item.name] = value * unit
                if item.name not in ("R", depth):
                    self._texts[item.name] = item.value.strip()
            else:
                kept.append(item)
                continue
            block.cycle_words.append(Span(item.start, item.end, item.name))
        self._set_heights(found)
        block.items = [item for item in kept if item.name in self.index]
        block.others = [item for item in kept if item.name not in self.index]
        return bool(found)

    def _number_of_holes(self, item: Item) -> int:
        value = self.known_value(item.name, item.value, "a whole number")
        if value != int(value) or not 0 <= value <= cycles.MOST_STROKES:
            raise self._refused("repeats", f"a whole number of holes, up to {cycles.MOST_STROKES}", item.value)
        return int(value)

    def _set_heights(self, found: dict[str, float]) -> None:
        """Take over the values of a block: in G91, R counts from the initial level, and the depth from R."""
        if "R" in found or "Z" in found:
            if self.incremental and ("R" not in found or "Z" not in found):
                raise self._refused("increments", "R and the depth in the same block with G91")
            if self.incremental:
                found["R"] += self._initial
                found["Z"] += found["R"]
            elif self._stated_incremental and self._height and ("R" not in found or "Z" not in found):
                raise self._refused("increments", "R and the depth in the same block after G91")
            self._stated_incremental = self.incremental
        self._height |= found

    def _check_increments(self) -> None:
        """Raise `InputError` unless R and the depth mean the same on every control after G90 or G91.

        Fanuc and Haas take them over where they are stated; LinuxCNC reads the numbers again as increments or positions.
        """
        if self.incremental == self._stated_incremental:
            return
        if self.control != "Fanuc":
            expected = "R and the depth in the block after G90 or G91, or a program number (Fanuc, Haas: O1234)"
            raise self._refused("heights stated before G90 or G91", expected)
        self.note(
            "G90 or G91 within a drilling cycle: R and the depth are those of the block that states them (Fanuc, Haas); LinuxCNC reads "
            "their numbers again in the new mode",
            once=True,
        )

    def _only_defines(self, block: IsoBlock) -> bool:
        """Return False for a block with L0 or K0, which defines a cycle but drills nothing.

        Another place in it is refused: whether the tool goes there depends on the control.
        """
        for item in block.items:
            word = self.axis_word(item, machine=False)
            at = self.position[word.axis]
            if (word.value if word.incremental else word.value - at) != 0.0:
                raise self._refused("another place with L0 or K0", "the place in the next block", item.value)
            block.cycle_words.append(Span(item.start, item.end, item.name))
        block.items = []
        return False

    def polar_words(self, block: IsoBlock) -> None:
        """Take polar words of LinuxCNC as words of X and Y (form `vocabulary.POLAR`, value in mm), in their place in the text.

        ``@`` is the distance from the zero of the program's coordinates, ``^`` the angle; what is not given is that of the present
        position (LinuxCNC, "G-Code Overview", "Polar Coordinates").
        """
        given = {item.name: self.known_value(item.name, item.value, vocabulary.KNOWN_VALUE) for item in block.polar}
        twice = len(given) < len(block.polar) or any(item.name in "XY" for item in block.items)
        if twice or any(
            vocabulary.GROUP_OF.get(span.name) in ("machine", "reference", "still") for span in block.codes
        ):
            raise self.error(
                "polar words beside X, Y or machine coordinates", "either polar words or X and Y, without G53"
            )
        unit = MM_PER_INCH if self.inch else 1.0
        x, y = self.position[:2]
        if (self.incremental or len(given) < 2) and (x != x or y != y):
            raise self.error("polar words from an unknown position", "a position of X and Y before them")
        if math.hypot(x, y) < AT_POLE_MM and (self.incremental or "^" not in given):
            raise self.error("polar words from the zero of the coordinates", "both @ and ^ there, with G90")
        self.control = "LinuxCNC"
        step = given.get("@", 0.0) * unit, given.get("^", 0.0)
        if self.incremental:
            block.polar_step = step
            to = polar_place(step, x, y)
        else:
            radius = step[0] if "@" in given else math.hypot(x, y)
            angle = math.radians(step[1]) if "^" in given else math.atan2(y, x)
            to = radius * math.cos(angle), radius * math.sin(angle)
        first, last = block.polar[0], block.polar[-1]
        spans = [(first.start, first.end), (last.start, last.end)]
        spans = spans if len(given) > 1 else [(first.start, first.start + 1), (first.start + 1, first.end)]
        for name, (start, end), place, at in zip("XY", spans, to, (x, y), strict=True):
            value = place - at if self.incremental else place
            block.items.append(Item(name, start, end, start, end, f"{vocabulary.POLAR}{value!r}"))

    def axis_word(self, item: Item, *, machine: bool) -> AxisWord:
        """Return an axis word with its value; raise `InputError` if that is unknown and not in machine coordinates."""
        name, start, end, value_start, value_end, text = item
        axis = self.index[name]
        if text[0] == vocabulary.POLAR:
            return AxisWord(axis, start, end, start, end, vocabulary.POLAR, self.incremental, float(text[1:]))
        form = ""
        value = number(text)
        if value != value:
            wrapped = vocabulary.WRAPPED.fullmatch(text)
            if wrapped is not None:
                form, text = wrapped.group(1).upper(), wrapped.group(2)
                value_start, value_end = value_start + wrapped.start(2), value_start + wrapped.end(2)
            value = self.value_of(text)
            if value != value and not machine:
                if vocabulary.LITERAL.fullmatch(text):
                    raise self.missing_number(name, text)
                what = f"the value of {name} is unknown"
                raise self.error(what, "a number, or a variable set to a number before", text)
        if self.inch and axis < self.linear:
            value *= MM_PER_INCH
        incremental = form == "IC" or (form == "" and self.incremental)
        return tuple.__new__(AxisWord, (axis, start, end, value_start, value_end, form, incremental, value))

    @property
    def _left(self) -> bool:
        """Whether the cycle is left to the control."""
        pecks = self.code in cycles.FANUC_PECKING and self._height.get("Q") == 0.0
        return self.code in cycles.FANUC_KEPT or pecks

    @property
    def _retract(self) -> float:
        top = self._height.get("R", math.nan)
        if self._to_initial and self.control == "LinuxCNC":
            return max(self._initial, top)
        return self._initial if self._to_initial else top

    def _kept_words(self, block: IsoBlock, *, stated: bool) -> None:
        """Take over the words of a cycle left to the control other than depth and R, which are written again with it."""
        if block.feed is not None:
            self._feed = f"F{block.text[block.feed.start : block.feed.end]}"
        if not stated:
            return
        depth = self.names[self.drilling].upper()
        names = {span.name for span in block.cycle_words}
        if not {depth, "R"} <= names:
            what = "thread" if self.code in cycles.FANUC_TAPPING else "boring"
            raise self._refused(what, f"{depth} and R in the block of the cycle")
        if self.code == "76" and {"J", "K"} <= names:
            raise self._refused("thread of LinuxCNC", vocabulary.LINEAR)
        if self.code in cycles.FANUC_TAPPING and self.plane != 17 and self.control == "LinuxCNC":
            raise self._refused(f"thread in G{self.plane}, which LinuxCNC 2.9 taps along another axis", "G17")
        own = _MODAL | set(cycles.FANUC_WORDS.get(self.code, ""))
        self._words = " ".join(f"{name}{text}" for name, text in self._texts.items() if name in own)
        self._feed = self._feed if block.feed is not None else ""

    def _cycle(self) -> Drilling:
        if self.vector is not None:
            raise self._refused("cycle", "drilling with rotary axes in place of a tool vector")
        top, at = self._height.get("R", math.nan), self.position[self.drilling]
        axis = self.names[self.drilling]
        if self.unknown:
            what = f"in force where {self.unknown}"
            raise self._refused(what, "the words named as harmless in the machine file, or G80 before")
        to_initial = self._to_initial or self.code == cycles.FROM_INITIAL
        if self._initial != self._initial and (to_initial or self.incremental):
            raise self._refused(
                f"position of {axis} unknown", f"a position of {axis} before the cycle ({_AT_REFERENCE}), or G99"
            )
        retract = self._initial if self.code == cycles.FROM_INITIAL else self._retract
        if to_initial and retract < top - 1e-9:
            raise self._refused(
                f"{axis} is below R",
                f"{axis} at R or above before the cycle, or G99: controls differ in the height to which G98 returns",
            )
        if not self._level_given:
            self.note("drilling cycle without G98 or G99: G98 is assumed (retract to the initial level)", once=True)
        self._check_height(at, top)
        if self._left:
            self.note_kept(f"G{self.code}")
        if self.code == cycles.FROM_INITIAL and (self.incremental or at != self._initial):
            raise self._refused("increments, or not at the initial level", f"G90 and {axis} at the initial level")
        try:
            words = axis, f"{self._words} {self._feed}".strip()
            return cycles.of_fanuc(self.code, self._height, self._texts.get("P", ""), retract, words)
        except ValueError as error:
            raise self._refused("cycle", str(error)) from None

    def _check_height(self, at: float, top: float) -> None:
        """Note a cycle from below the height at which the tool goes on, which LinuxCNC raises first."""
        if (
            self.control != "LinuxCNC"
            and at < max(top, self._retract) - 1e-9
            and (self.cycle is not None or at < top - 1e-9)
        ):
            self.note(
                "the tool goes to this hole at the height of the one before (Fanuc); LinuxCNC raises it first to the new R "
                "or, after G98, to the initial level",
                once=True,
            )

    def note_kept(self, name: str) -> None:
        """Note that a cycle is left to the control."""
        self.note(
            f"{name} is left to the control: its place and its heights have the correction of the height at which it begins",
            once=True,
        )

    def _refused(self, what: str, expected: str, value: object = None) -> InputError:
        return self.error(f"canned cycle G{self.code}: {what}", f"{expected}; or {vocabulary.EXPANDED_CYCLE}", value)

    def call(self, name: str, arguments: str) -> Drilling:
        """Return the cycle that ``MCALL`` calls, with its argument list in parentheses."""
        shown = f"{name}{arguments}"
        unit = MM_PER_INCH if self.inch else 1.0
        try:
            cycle = cycles.of_sinumerik(name, arguments[1:-1], self.value_of, unit)
        except ValueError as error:
            expected = f"{error}; or {vocabulary.EXPANDED_CYCLE}"
            raise self.error(f"canned cycle {name}", expected, shown) from None
        if cycle.level == cycle.level:
            self.note_kept(name)
        self._cycle_plane = self.plane
        return cycle

    def call_once(self, block: IsoBlock, item: Item) -> None:
        """Execute a cycle of SINUMERIK at the present position, or the one in force at the places of a pattern."""
        self._check_one_control(item.name)
        block.cycle_word = Span(item.start, len(block.text.rstrip("\r\n")))
        if item.name not in cycles.PATTERNS:
            block.calls, self.cycle = True, self.call(item.name, item.value)
            return
        try:
            places = cycles.places_of(item.name, item.value[1:-1], self.value_of, MM_PER_INCH if self.inch else 1.0)
        except ValueError as error:
            raise self.error(f"pattern of holes {item.name}", str(error)) from None
        a, b, _ = PLANES[self.plane]
        block.pattern = [{a: u, b: v} for u, v in places]

    def mcall(self, block: IsoBlock, item: Item, *, last: bool) -> None:
        """Apply ``MCALL`` or the cycle after it, the ``last`` statement of its block."""
        self._check_one_control(item.name)
        if item.name == "MCALL":
            block.cycle_word = Span(item.start, len(block.text.rstrip("\r\n")))
            if last:
                self.cycle = None
            return
        if not last:
            raise self.error(f"canned cycle {item.name}", vocabulary.EXPANDED_CYCLE, block.text[item.start :].strip())
        self.cycle = self.call(item.name, item.value)

    def _check_one_control(self, name: str) -> None:
        """Raise `InputError` for a cycle of SINUMERIK while one of Fanuc is in force."""
        if self.code:
            raise self.error(f"{name} while G{self.code} is in force", "cycles of one control, or G80 before it")

    @property
    def steady(self) -> bool:
        """Whether no cycle is in force, or one that is the same at every following place because it ends at the present height."""
        if self.cycle is None:
            return True
        ends = [stroke.height for stroke in self.cycle.strokes if stroke.height == stroke.height]
        same = bool(ends) and ends[-1] == self.position[2] and self.cycle.level != self.cycle.level
        return same and self.plane == self._cycle_plane == 17 and not self.tcp and not self._stated_incremental

    def strokes(self) -> list[Stroke]:
        """Return the strokes of the cycle from the present height, without those that do not move; only their blocks behind stay."""
        height, strokes = self.position[self.drilling], list[Stroke]()
        for stroke in () if self.cycle is None else self.cycle.strokes:
            if stroke.height == stroke.height and (abs(stroke.height - height) > SAME_MM or height != height):
                height = stroke.height
                strokes.append(stroke)
            elif stroke.after or stroke.kept is not None:
                strokes.append(stroke._replace(height=math.nan))
        return strokes

    @property
    def repeated(self) -> tuple[tuple[float, bool], ...] | None:  # type: ignore[override]
        """See `Interpreter`."""
        if self.cycle is None:
            return None
        return tuple(
            (stroke.height, stroke.kind is Kind.RAPID) for stroke in self.strokes() if stroke.height == stroke.height
        )

    def drill(self, block: IsoBlock, cycle: Drilling) -> None:
        """Add the strokes of a cycle to the moves of a block, except those that do not move, and the holes after the first one."""
        if self.unknown or self.plane != self._cycle_plane or self.vector is not None or block.end_m_words:
            raise self.error("canned cycle", vocabulary.EXPANDED_CYCLE)
        turned = [
            name
            for name, value in zip(self.names[self.linear :], self.position[self.linear :], strict=True)
            if name[0] != "C" and not abs(value) <= CORRECTION_DEG
        ]
        if self.tcp and turned and self.frame.turn is None:
            what = f"canned cycle under tool centre point control with {turned[0]} turned"
            raise self.error(what, f"{turned[0]}0 (the cycle drills along the program's axis), or coordinates turned")
        if (block.pattern or self._repeats > 1) and any(value != value for value in self.position[: self.linear]):
            raise self.error("several holes from an unknown position", "a position of every linear axis before them")
        self.use_set_up(Kind.LINEAR)
        done: list[Stroke] = []
        block.repeats, places = self._repeats, block.pattern or self._places(block)
        if self._below:
            self._raise_first(block, places, done)
        for hole, place in enumerate(places):
            if hole or not block.positions:
                self._go_to(block, done, place)
            done += self._strike(block, self.strokes())
            if cycle.level == cycle.level:
                self.position[self.drilling] = cycle.level
        block.drilling, block.drilling_axis = Drilling(tuple(done), cycle.level), self.drilling
        self.drilled.append(range(self._line, self._line + 1))

    def _places(self, block: IsoBlock) -> list[dict[int, float]]:
        """Return the places of a block's holes by axis, each further than the one before by the increments of its words."""
        places = [{word.axis: self.position[word.axis] for word in block.words}]
        increments = {word.axis: word.value for word in block.words if word.incremental}
        for _ in range(1, self._repeats):
            last = places[-1]
            to = {axis: last[axis] + value for axis, value in increments.items()}
            places.append(
                to | dict(enumerate(polar_place(block.polar_step, last[0], last[1]))) if block.polar_step else to
            )
        return places

    def _raise_first(self, block: IsoBlock, places: list[dict[int, float]], done: list[Stroke]) -> None:
        """Raise the tool before or while it goes to the first hole of a block: its positioning becomes one of the moves of the cycle.

        From an initial level below R, LinuxCNC goes straight to R first, else on the way.
        """
        if block.words:
            block.moves, block.positions = block.moves[:-1], False
            block.cycle_words += (Span(word.start, word.end, "") for word in block.words)
        block.repeats, block.pattern, self.position = 1, places, list(self._below)
        if self._initial < self._height["R"]:
            done += self._strike(block, [Stroke(self._height["R"], Kind.RAPID)])
        else:
            places[0][self.drilling] = self._retract

    def _go_to(self, block: IsoBlock, done: list[Stroke], place: Mapping[int, float]) -> None:
        """Add the positioning over the next hole to the moves and strokes of a block, if it moves."""
        if all(abs(value - self.position[axis]) <= 1e-9 for axis, value in place.items()):
            return
        for axis, value in place.items():
            self.position[axis] = value
        kind = Kind.LINEAR if self.motion == 1 else Kind.RAPID
        named = frozenset(self.names[axis] for axis in place)
        block.moves += (Move(self._line, kind, self.tcp, tuple(self.position), named),)
        done.append(Stroke(self.position[self.drilling], kind))

    def _strike(self, block: IsoBlock, strokes: list[Stroke]) -> list[Stroke]:
        """Add strokes at one hole to the moves of a block and return them."""
        named = frozenset(self.names[self.drilling : self.drilling + 1])
        for stroke in strokes:
            if stroke.height == stroke.height:
                self.position[self.drilling] = stroke.height
                block.moves += (Move(self._line, stroke.kind, self.tcp, tuple(self.position), named),)
        return strokes


def polar_place(step: tuple[float, float], x: float, y: float) -> tuple[float, float]:
    """Return the place whose distance and angle, degrees, are larger by a step than those of another one."""
    radius, angle = math.hypot(x, y) + step[0], math.atan2(y, x) + math.radians(step[1])
    return radius * math.cos(angle), radius * math.sin(angle)
