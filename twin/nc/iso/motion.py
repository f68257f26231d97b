"""Effects of ISO blocks on the axes: values of words, targets, arcs, tool vectors, machine coordinates."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from twin._common.errors import InputError
from twin.nc.arcs import (
    ABSOLUTE,
    FROM_START,
    MOST_TURNS,
    PLANES,
    ArcMisfit,
    CentreWords,
    arc_by_centre,
    arc_by_radius,
    centres_that_fit,
    meets,
)
from twin.nc.blocks import Arc, AxisWords, Kind, Move
from twin.nc.iso import cycles, vocabulary
from twin.nc.iso.cycles import Drilling, Stroke
from twin.nc.iso.frame import IsoBlock, IsoShift, Item
from twin.nc.modal import BESIDE, CORRECTION_DEG, AxisWord, Span
from twin.nc.text import MM_PER_INCH, number

INCH_CODES: Final = frozenset({"20", "70", "700"})
CODES: Final = cycles.FANUC | cycles.FANUC_KEPT
_AT_REFERENCE: Final = "after a reference return: programs: {references: …} in the machine file"
_MODAL: Final = frozenset("RQP")
_REPEATS: Final = frozenset("LK")
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
    _to_initial = True
    _level_stated = _level_given = False
    _stated_incremental = False
    _initial = math.nan
    _words = _feed = ""
    _repeats = 1

    @property
    def drilling(self) -> int:
        """The linear axis that drills in the plane in force."""
        return _DRILLING[self.plane]

    def cycle_code(self, block: IsoBlock, span: Span, group: str) -> bool:
        """Apply a G word to the Fanuc cycle in force; return whether it begins one.

        ``G80`` and the motion codes end a cycle; after ``G80`` the motion code before the cycle applies again.
        """
        code = span.name
        if group == "units" and self.cycle is not None and self.inch != (code in INCH_CODES):
            raise self.error("another unit while a drilling cycle is in force", "G80 or MCALL before the unit changes")
        if code in CODES:
            if not self.code:
                self._motion_before, self._initial = self.motion, math.nan
                self._height: dict[str, float] = {}
                self._dwell = ""
            self.code, self.motion = code, 0  # positions between holes are rapid
            block.cycle_words.append(span)
            return True
        if group == "return":
            self._to_initial, self._level_stated, self._level_given = code == "98", True, True
        elif self.code and (group == "motion" or code == "80"):
            self.code, self.cycle = "", None
            self.motion = self._motion_before
        return False

    def take_cycle_words(self, block: IsoBlock) -> bool:
        """Take the words of a Fanuc cycle from a block; return whether the block executes the cycle.

        A block with an axis word or R does. P and Q in any other block belong to another word (``G4 P1``, ``G64 P0.01``, ``G5.1 Q1``).
        """
        level_stated, self._level_stated = self._level_stated, False
        self._repeats = 1
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
        if self.code in cycles.FANUC_KEPT:
            self._kept_words(block, stated=stated)
            stated |= block.feed is not None
        self._check_increments()
        if stated or (level_stated and self.cycle is not None):
            self.cycle, self._cycle_plane = self._cycle(), self.plane
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
                if item.name == "P":
                    self._dwell = item.value.strip()
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

    def axis_word(self, item: Item, *, machine: bool) -> AxisWord:
        """Return an axis word with its value; raise `InputError` if that is unknown and not in machine coordinates."""
        name, start, end, value_start, value_end, text = item
        axis = self.index[name]
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
        others = [span for span in block.cycle_words if span.name not in (self.code, depth, "R", *_REPEATS)]
        self._words = " ".join(block.text[span.start : span.end].strip() for span in others)
        self._feed = self._feed if block.feed is not None else ""

    def _cycle(self) -> Drilling:
        if self.vector is not None:
            raise self._refused("cycle", "drilling with rotary axes in place of a tool vector")
        top, at = self._height.get("R", math.nan), self.position[self.drilling]
        axis = self.names[self.drilling]
        if self.unknown:
            what = f"in force where {self.unknown}"
            raise self._refused(what, "the words named as harmless in the machine file, or G80 before")
        if self._initial != self._initial and (self._to_initial or self.incremental):
            raise self._refused(
                f"position of {axis} unknown", f"a position of {axis} before the cycle ({_AT_REFERENCE}), or G99"
            )
        if self._to_initial and self._retract < top - 1e-9:
            raise self._refused(
                f"{axis} is below R",
                f"{axis} at R or above before the cycle, or G99: controls differ in the height to which G98 returns",
            )
        if not self._level_given:
            self.note("drilling cycle without G98 or G99: G98 is assumed (retract to the initial level)", once=True)
        if at < max(top, self._retract) - 1e-9 and (self.cycle is not None or at < top - 1e-9):
            if self.control == "LinuxCNC":
                raise self._refused(
                    f"{axis} is below R", f"{axis} at R or above: the control would raise it before it goes to the hole"
                )
            self.note(
                "the tool goes to this hole at the height of the one before (Fanuc); LinuxCNC raises it first to the new R "
                "or, after G98, to the initial level",
                once=True,
            )
        if self.code in cycles.FANUC_KEPT:
            self.note_kept(f"G{self.code}")
        try:
            return cycles.of_fanuc(
                self.code, self._height, self._dwell, self._retract, (axis, f"{self._words} {self._feed}".strip())
            )
        except ValueError as error:
            raise self._refused("cycle", str(error)) from None

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
            if stroke.height == stroke.height and (abs(stroke.height - height) > 1e-9 or height != height):
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
        increments = {word.axis: word.value for word in block.words if word.incremental}
        done: list[Stroke] = []
        block.repeats = self._repeats
        for hole in range(len(block.pattern) or block.repeats):
            if block.pattern:
                self._go_to(block, done, block.pattern[hole])
            elif hole:
                self._go_to(block, done, {axis: self.position[axis] + value for axis, value in increments.items()})
            done += self._strike(block)
            if cycle.level == cycle.level:
                self.position[self.drilling] = cycle.level
        block.drilling, block.drilling_axis = Drilling(tuple(done), cycle.level), self.drilling
        self.drilled.append(range(self._line, self._line + 1))

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

    def _strike(self, block: IsoBlock) -> list[Stroke]:
        """Add the strokes at one hole to the moves of a block and return them."""
        named, strokes = frozenset(self.names[self.drilling : self.drilling + 1]), self.strokes()
        for stroke in strokes:
            if stroke.height == stroke.height:
                self.position[self.drilling] = stroke.height
                block.moves += (Move(self._line, stroke.kind, self.tcp, tuple(self.position), named),)
        return strokes


# --- Effects of ISO blocks on the axes: values of words, targets, arcs, tool vectors, machine coordinates

CENTRE: Final = {"I": 0, "J": 1, "K": 2}
SPINDLE_VECTOR: Final = {"A3": 0, "B3": 1, "C3": 2}
_KINDS: Final = (Kind.RAPID, Kind.LINEAR, Kind.ARC, Kind.ARC)
MACHINE_INCREMENTS: Final = (
    "G53 in G91: Mitsubishi moves by the increments, Fanuc leaves the move out, LinuxCNC refuses it; the block stays as written, and "
    "the positions of its axes are unknown afterwards"
)


_FORMS: Final = {"AC": ABSOLUTE}
"""Forms of a centre of SINUMERIK, ``I=AC(…)``; all others count from the start."""


class IsoMotion(IsoDrilling):
    """The modal state that determines the meaning of axis words, and its changes by blocks."""

    def __init__(self, source: str, axes: AxisWords, *, tcp: bool) -> None:
        on = vocabulary.TCP_ON | {vocabulary.canonical(word) for word in axes.tcp_on}
        off = vocabulary.TCP_OFF | {vocabulary.canonical(word) for word in axes.tcp_off}
        super().__init__(source, axes, tcp=tcp, tcp_on=on, tcp_off=off)
        self.centres: CentreWords | None = None
        """Meaning of I, J, K: as a G word says, or as the first arc by them shows; None before."""
        self.side = 40
        self._on_contour = False
        self.feed_mode = "94"
        self.length_vector = self.of_machine = False

    @property
    def beside(self) -> bool:  # type: ignore[override]
        """See `Interpreter`."""
        return self.side != 40

    @property
    def runs_allowed(self) -> bool:
        """See `Interpreter.runs_allowed`: no pending work offset, incremental mode or tool vector, nor a cycle that changes."""
        plain = not (
            self.beside
            or self._on_contour
            or self.incremental
            or self.pending
            or self.points
            or self._listing
            or self.end.word
        )
        return plain and self.steady and self.set_up and self.vector is None

    def leave_contour(self) -> None:
        """Raise `InputError` if cutter radius compensation is still selected at a reference return."""
        if self.beside:
            raise self.error("reference return under cutter radius compensation", "G40 before it")
        self._on_contour = False

    def _compensated(self, block: IsoBlock, rotary: list[float]) -> bool:
        """Return whether a block is under cutter radius compensation, or leads in or out; ``rotary``: the axes before it."""
        compensated = self.beside or self._on_contour
        if not compensated:
            return False
        here = self.position[self.linear :]
        turns = any(not abs(a - b) <= CORRECTION_DEG for a, b in zip(here, rotary, strict=True) if a == a or b == b)
        if self.tcp or self.vector is not None or turns or self.cycle is not None:
            what = f"cutter radius compensation G{self.side} with a tool that turns, or in a cycle"
            raise self.error(what, "the tool centre path from the CAM system (G40)")
        self.note(BESIDE, once=True)
        a, b, _ = PLANES[self.plane]
        if block.axis_bits & (1 << a | 1 << b) or self.motion in (2, 3):
            self._on_contour = self.beside
        return True

    def move(self, block: IsoBlock, centre: list[Item], *, machine: bool) -> None:  # noqa: C901, PLR0912
        """Add the moves of a block whose axis words are known.

        ``centre``: its words for a centre, a radius, full turns or a tool vector; ``machine``: whether its axis words are machine
        coordinates.
        """
        motion = self.motion
        if not machine and not self.unknown and self.stand_at_plane(block):
            return
        self.check_plane(block.axis_bits >> self.linear != 0 and self.pending is None)
        if machine:
            if centre or self.cycle is not None:
                raise self.error("machine coordinates in an arc or a cycle", "a straight move")
            self.leave_contour()
            if self.incremental and any(span.name == "53" for span in block.codes):
                self.note(MACHINE_INCREMENTS, once=True)
            kind = Kind.RAPID if motion == 0 else Kind.LINEAR
            position = self.machine_position(block)
            block.moves += (Move(self._line, kind, self.tcp, position, self.named(block.axis_bits), machine=True),)
            return
        kind = Kind.LINEAR if motion is None else _KINDS[motion]
        if self.unknown:
            if self.cycle is not None:
                raise self.error(f"a cycle in force where {self.unknown}", "G80 or MCALL before")
            block.moves += (self.unknown_move(kind, block.axis_bits),)
            block.unknown_axes = tuple(range(len(self.names)))
            return
        if self.parks and kind is Kind.RAPID and self.cycle is None and not (centre or self.vector):
            block.moves += (self.parking_move(block),)
            return
        if kind is Kind.ARC and not centre and all(word.incremental and word.value == 0.0 for word in block.words):
            self.note("increments of zero where G2 or G3 is in force: nothing moves")
            return
        start, rotary = self.position[: self.linear], self.position[self.linear :]
        self.apply_words(block)
        vector = self._vector(block, centre) if centre else None
        arc: Arc | None = None
        if motion is None:
            self.note("axes move before any of G0, G1, G2, G3: assumed to be a linear move", once=True)
        elif motion >= 2:
            if vector is not None or (self.length_vector and self.tcp):
                raise self.error("arc with a tool vector", vocabulary.LINEAR)
            if self.arc_from_unknown(block, start, PLANES[self.plane][:2]):
                return
            arc = self._arc(block, centre, start)
        elif centre and vector is None:
            first = centre[0]
            shown = block.text[first.start : first.end]
            raise self.error(f"{first.name} outside a circular block", "arcs with G2 or G3", shown)
        self.use_set_up(kind)
        if vector is not None:
            self.set_tool_vector(block.axis_bits, vector)
        elif block.axis_bits >> self.linear:
            self.vector = None
        if self.vector is not None:
            block.vector_names = ("I", "J", "K") if self.length_vector else ("A3=", "B3=", "C3=")
        named, whole = self.named(block.axis_bits), self._compensated(block, rotary)
        move = Move(self._line, kind, self.tcp, tuple(self.position), named, False, self.vector, None, arc, "", whole)
        block.moves += (move,)
        if self.cycle is not None:
            self.drill(block, self.cycle)

    def apply_words(self, block: IsoBlock) -> None:  # type: ignore[override]
        """Set the position from the axis words, rotary axes the shortest way or in the given direction (``DC``, ``ACP``, ``ACN``)."""
        turning = [word for word in block.words if word.form and word.form in vocabulary.DIRECTION_FORMS]
        before = [self.position[word.axis] for word in turning]
        super().apply_words(block)
        for word, last in zip(turning, before, strict=True):
            if last == last:
                turn = (word.value - last) % 360.0
                if (word.form == "ACN" and turn > 0.0) or (word.form == "DC" and turn > 180.0):
                    turn -= 360.0
                self.position[word.axis] = round(last + turn, 9)

    # ------------------------------------------------------------------ words

    def _vector(self, block: IsoBlock, centre: list[Item]) -> tuple[float, float, float] | None:
        by_length = self.length_vector and self.tcp and self.motion in (None, 0, 1)
        components = [0.0, 0.0, 0.0]
        for name, start, end, value_start, value_end, text in centre:
            index = SPINDLE_VECTOR.get(name)
            if index is None and by_length:
                index = CENTRE.get(name)
            if index is None:
                continue
            if not self.tcp:
                raise self.error(f"tool vector {name} while tool centre point control is off", "TRAORI before it", text)
            if self.of_machine:
                raise self.error(f"tool vector {name} in coordinates of the machine (ORIMKS)", "ORIWKS before it", text)
            components[index] = self.value_of(text)
            if components[index] != components[index]:
                raise self.missing_number(name, text)
            if index in block.vector_words:
                raise self.error(f"{name} twice in one block", "each word once")
            block.vector_words[index] = Span(value_start, value_end, block.text[start:end])
        return self.unit_direction("tool vector", components) if block.vector_words else None

    def _arc(self, block: IsoBlock, items: list[Item], start: list[float]) -> Arc:
        a, b, _ = plane = PLANES[self.plane]
        scale = MM_PER_INCH if self.inch else 1.0
        words: dict[int, tuple[float, CentreWords | None]] = {}
        radius: float | None = None
        turns = 0
        for name, begin, end, _, _, text in items:
            block.arc_words.append(Span(begin, end, name))
            wrapped = vocabulary.WRAPPED.fullmatch(text)
            value = self.value_of(wrapped.group(2) if wrapped else text)
            if value != value:
                raise self.missing_number(name, text)
            if name in ("R", "CR"):
                radius = value * scale
            elif name not in CENTRE:
                turns = self._full_turns(name, value, text)
            elif CENTRE[name] in words:
                raise self.error(f"{name} twice in one block", "each word once")
            elif CENTRE[name] not in (a, b):
                raise self.error(f"{name} outside the plane G{self.plane}", "a centre in the plane")
            else:
                words[CENTRE[name]] = (
                    value * scale,
                    _FORMS.get(wrapped.group(1).upper(), FROM_START) if wrapped else None,
                )
        clockwise = self.motion == 2
        from_, to = (start[a], start[b]), (self.position[a], self.position[b])
        if radius is not None and not words:
            return self.valid_arc(arc_by_radius(plane, from_, to, radius, clockwise, turns))
        if not words or radius is not None:
            return self.valid_arc(
                ArcMisfit(
                    "arc without centre or radius, or with both", "either I, J, K or R (CR=): controls differ without"
                )
            )
        plain = {axis: value for axis, (value, form) in words.items() if form is None}
        block.centres, hint = self._centre_words(from_, to, (plain.get(a), plain.get(b))) if plain else (FROM_START, "")
        middle = list(start)
        for axis, (value, form) in words.items():
            middle[axis] = (form or block.centres).centre(start[axis], value)
        arc = arc_by_centre(plane, from_, to, (middle[a], middle[b]), clockwise, turns)
        return self.valid_arc(arc._replace(expected=arc.expected + hint) if isinstance(arc, ArcMisfit) else arc)

    def _full_turns(self, name: str, value: float, text: str) -> int:
        """Return the full turns beyond the arc: ``TURN=`` counts these, P of Fanuc the last one too."""
        if value != int(value) or not 0 <= value <= MOST_TURNS:
            raise self.error(f"{name} is not a number of turns", f"a whole number up to {MOST_TURNS}", text)
        return int(value) if name == "TURN" else max(0, int(value) - 1)

    def _centre_words(
        self, start: tuple[float, float], end: tuple[float, float], words: tuple[float | None, float | None]
    ) -> tuple[CentreWords, str]:
        """Return what I, J, K of an arc give, and which other meaning would make it fit.

        Unless a G word says it, the first arc by I, J, K shows it: if it meets its ends in one way only, all arcs are read in this way.
        A full circle would meet them in any way: it is read as controls do.
        """
        usual = self.centres or FROM_START
        about = [at if word is None else usual.centre(at, word) for at, word in zip(start, words, strict=True)]
        if meets(start, end, (about[0], about[1])):
            self.centres = usual
            return usual, ""
        others = centres_that_fit(start, end, words)
        if self.centres is None and len(others) == 1:
            self.centres = others[0]
            self.note(
                f"I, J, K are read as {others[0].meaning}: only so does the first arc meet its ends; "
                f"a control that reads them as {usual.meaning} stops at this block",
                once=True,
            )
            return others[0], ""
        return usual, "".join(f" (it would fit if I, J, K were {other.meaning})" for other in others[:1])
