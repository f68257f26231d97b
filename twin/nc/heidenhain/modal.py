"""Modal state of a Heidenhain program: machining cycle, pole and contour, preset, tool, tilted plane, shift and rotation.

Sources: HEIDENHAIN TNC 640, user's manuals "Programming of machining cycles" (200 to 209, 240, 241; calls by ``CYCL CALL``, ``M99`` and
``M89``) and "Klartext programming", chapter "Programming contours" (``CC``, ``LP``, ``CP``, ``RL``, ``RR``); iTNC 530, "Cycles" (1, 2,
17 and 18).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple, final

from twin.nc import patterns
from twin.nc.arcs import MOST_TURNS, ArcMisfit, arc_by_centre, arc_by_radius
from twin.nc.blocks import Arc, Kind, Move, Plane, Rows, product, rotation_about, rotation_along, rotation_through
from twin.nc.heidenhain import vocabulary
from twin.nc.modal import BESIDE, CORRECTION_DEG, Block, Interpreter, Span
from twin.nc.text import MM_PER_INCH, SAME_MM

# --- Data of one block ----------------------------------------------------------------------------

_SURFACE: Final = "Q203"
_VALUE: Final = re.compile(r"(Q20[034])([ \t]*=[ \t]*)([^;~\r\n]*?)([ \t]*(?:[;~].*)?)$", re.ASCII | re.IGNORECASE)


@final
@dataclass
class Cycle:
    """A machining cycle that the next calls execute.

    Attributes:
        texts: the lines of its definition without block number and line ending.
        given: the parameters that these set.
        open: whether the next line may set a further one.
        changed: whether one of them has been set after the definition.
    """

    number: int
    texts: list[str]
    given: set[str] = field(default_factory=set)
    open: bool = True
    changed: bool = False

    def lines(self, values: Mapping[str, str]) -> list[str]:
        """Return the lines of the definition with other texts for Q200, Q203 and Q204."""

        def replaced(found: re.Match[str]) -> str:
            return found[1] + found[2] + values.get(found[1].upper(), found[3]) + found[4]

        texts = [_VALUE.sub(replaced, text).rstrip() for text in self.texts]
        return [text if text.endswith("~") else f"{text} ~" for text in texts[:-1]] + [texts[-1].rstrip("~ \t")]


class CycleCall(NamedTuple):
    """The call of a cycle in a block.

    Attributes:
        top: height at which it begins, mm.
        surface: height of the surface, mm; NaN: it begins and ends where the tool is.
        level: height at which it ends, mm.
        moves: number of moves of the block up to its beginning.
        defined: height of the surface in its definition, mm.
        texts: clearances Q200 and Q204 of a pattern, in place of those of its definition.
    """

    cycle: Cycle
    top: float
    surface: float
    level: float
    axis: int
    moves: int = 0
    defined: float = math.nan
    texts: tuple[tuple[str, str], ...] = ()


@final
@dataclass(slots=True)
class PathBlock(Block):
    """One block: `twin.nc.modal.Block` with the attributes of Heidenhain blocks.

    Attributes:
        keyword: ``L``, ``LN``, ``LP``, ``C``, ``CP``, ``CR``, or ``""`` for a paraxial block.
        rapid_text: ``FMAX`` as written, or empty.
        normal_text: the words ``NX NY NZ`` as written.
        normal: their components, or None.
        tool: the components of ``TX TY TZ``, or None.
        elsewhere: whether these count from a point of the machine's builder (M92).
        polar: radius and angle of the end point about the pole: value in mm or degrees, and whether it is an increment.
        polar_words: the words that give them.
        calls: whether it calls the machining cycle in force behind its motion.
        call_words: its words that say so (``M99``, ``M89``).
        places: its calls, in order.
        pattern: whether these are elsewhere than where the tool is (``CYCL CALL POS``, ``PAT``, cycles 220 and 221).
        replaced: whether it is part of a statement whose calls are written out in its place.
        head: the text before the first line of a statement of several lines.
        positions: whether its first move is that of its own words.
        beside: words of auxiliary axes: name, value and whether it is an increment.
        leads: whether the control itself finds the path to its end: a lead-in or lead-out, a tangential arc.
    """

    numbered: bool = False
    keyword: str = ""
    keyword_end: int = 0
    rapid_text: str = ""
    normal_text: list[str] = field(default_factory=list)
    normal: list[float] | None = None
    tool: list[float] | None = None
    clockwise: bool | None = None
    radius: float | None = None
    machine: bool = False
    elsewhere: bool = False
    retracts: bool = False
    polar: dict[str, tuple[float, bool]] = field(default_factory=dict)
    polar_words: list[Span] = field(default_factory=list)
    calls: bool = False
    call_words: list[Span] = field(default_factory=list)
    places: list[CycleCall] = field(default_factory=list)
    pattern: bool = False
    replaced: bool = False
    head: str = ""
    positions: bool = True
    leads: bool = False
    beside: list[tuple[str, float, bool]] = field(default_factory=list)

    @property
    def indent(self) -> str:
        """The text before a line inserted beside it: its number, or its blanks."""
        return (
            self.head or self.text[: self.head_end] if self.numbered or not self.text[: self.head_end].strip() else ""
        )


# --- Machining cycles that make holes: the control executes them at a corrected place --------------
# A cycle from 200 on goes at rapid to the set-up clearance Q200 above the surface Q203, and returns to it, or to the second set-up
# clearance Q204 above the surface if that is higher. The older ones begin and end where the tool is.

HOLES: Final = frozenset({*range(200, 210), 240, 241})
AT_PRESENT_HEIGHT: Final = frozenset({1, 2, 17, 18})


class HeidenhainCycles(Interpreter):
    """The machining cycle in force and its calls; ``modal``: whether every positioning calls it (``M89``)."""

    plane = (0, 1, 2)
    modal = False
    pending: Plane | None = None
    _in_force: Cycle | None = None
    _pattern: Cycle | None = None
    """The pattern 220 or 221 whose definition is not complete."""
    _points = ""
    """The text of ``PATTERN DEF``."""

    def define(self, number: int, part: str | None, body: str) -> None:
        """Begin the definition of a machining cycle, or take a further line of an older one (``1.1``)."""
        if part not in (None, "0"):
            if self._in_force is not None and self._in_force.number == number:
                self._in_force.texts.append(body)
        elif number in patterns.CYCLES:
            self._pattern = Cycle(number, [body])
        elif number in HOLES or number in AT_PRESENT_HEIGHT:
            self._in_force = Cycle(number, [body], {name.upper() for name, _ in vocabulary.ASSIGNED.findall(body)})
        elif number not in vocabulary.BESIDE_CYCLES:
            self._in_force = None

    def take_parameters(self, body: str) -> None:
        """Take a line that only sets parameters: it belongs to the definition of a cycle directly before it, else it may change it."""
        names = {name.upper() for name, _ in vocabulary.ASSIGNED.findall(body)}
        cycle = self._in_force
        if self._pattern is not None:
            self._pattern.texts.append(body)
        elif cycle is not None and cycle.open and cycle.number in HOLES:
            cycle.texts.append(body)
            cycle.given |= names
        elif cycle is not None and cycle.given & names:
            cycle.changed = True

    def close_definition(self) -> None:
        """End the definition of a cycle: another statement follows."""
        if self._in_force is not None:
            self._in_force.open = False

    def take_points(self, body: str, *, begins: bool) -> None:
        """Take a line of ``PATTERN DEF``."""
        self._points = body.rstrip("~") if begins else f"{self._points} {body.rstrip('~')}"

    @property
    def takes_pattern(self) -> bool:
        """Whether the definition of a pattern 220 or 221 is not complete."""
        return self._pattern is not None

    def end_pattern(self, block: PathBlock) -> None:
        """Execute the cycle in force at the places of a pattern 220 or 221 that is complete."""
        pattern, self._pattern = self._pattern, None
        if pattern is None:
            return
        given = {
            name.upper(): text.strip() for text in pattern.texts for name, text in vocabulary.ASSIGNED.findall(text)
        }
        what = f"pattern of cycle {pattern.number}"
        unit = MM_PER_INCH if self.inch else 1.0
        try:
            places = patterns.of_cycle(
                pattern.number, {name: self.value_of(text) for name, text in given.items()}, unit
            )
        except ValueError as error:
            raise self.error(what, f"{error}; or {vocabulary.EXPANDED_CYCLE}") from None
        self.call_at(block, places, what, tuple((name, given[name]) for name in ("Q200", "Q203", "Q204")))
        if self._in_force is not None:
            self._in_force.changed = True

    def call_pattern(self, block: PathBlock) -> None:
        """Execute the cycle in force at the places of ``PATTERN DEF``."""
        try:
            places = patterns.of_points(self._points, self.value_of, MM_PER_INCH if self.inch else 1.0)
        except ValueError as error:
            raise self.error("CYCL CALL PAT", f"{error}; or {vocabulary.EXPANDED_CYCLE}") from None
        self.call_at(block, places, "CYCL CALL PAT", ())

    def call_at(
        self,
        block: PathBlock,
        places: Sequence[tuple[float, float, float]],
        what: str,
        texts: tuple[tuple[str, str], ...],
    ) -> None:
        """Call the cycle in force at places in the plane, each with its shift of the surface; ``texts``: Q200, Q203, Q204 of a pattern.

        Between them the tool is at the height before or at the second set-up clearance, whichever is higher.
        """
        a, b, axis = self.plane
        cycle, at = self._in_force, self.position[axis]
        if cycle is None or cycle.number not in HOLES or at != at or self.tcp or self.unknown:
            raise self.error(what, "a cycle 200 to 209, 240 or 241 and a position of the tool axis before it")
        if self.beside or self.pending is not None:
            raise self.error(
                f"{what} under RL or RR, or between PLANE with STAY and its positioning", "R0, or a move before it"
            )
        self.check_plane(False)
        block.positions, block.pattern = False, True
        for x, y, shift in places:
            surface, _, level = self._heights(what, shift, texts)
            height = max(at, level) if len(places) > 1 or at < surface else at
            for moved in ((axis, height),), ((a, x), (b, y)):
                if any(not abs(self.position[one] - value) <= 1e-9 for one, value in moved):
                    for one, value in moved:
                        self.position[one] = value
                    named = frozenset(self.names[one] for one, _ in moved)
                    block.moves += (Move(self._line, Kind.RAPID, False, tuple(self.position), named),)
            self.call_cycle(block, shift, texts)

    def _heights(
        self, what: str, shift: float = 0.0, texts: tuple[tuple[str, str], ...] = ()
    ) -> tuple[float, float, float]:
        """Return the heights of the surface, of the set-up clearance and of the end of a cycle from 200 on, mm."""
        unit, cycle = MM_PER_INCH if self.inch else 1.0, self._in_force
        given = {name: self.value_of(text) * unit for name, text in texts}
        clearance, surface = (given.get(name) or self._parameter(what, name) * unit for name in ("Q200", _SURFACE))
        second = clearance
        if "Q204" in given or (cycle is not None and "Q204" in cycle.given):
            second = given["Q204"] if given else self._parameter(what, "Q204") * unit
        surface += shift
        return surface, surface + clearance, surface + max(second, clearance)

    def call_cycle(self, block: PathBlock, shift: float = 0.0, texts: tuple[tuple[str, str], ...] = ()) -> None:
        """Add the approach of the cycle in force to the moves of a block; ``shift`` of the surface, ``texts``: those of a pattern."""
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
            surface, top, level = self._heights(what, shift, texts)
        if abs(top - at) > SAME_MM:
            self.position[axis] = top
            named = frozenset((name,))
            block.moves += (Move(self._line, Kind.RAPID, False, tuple(self.position), named),)
        self.use_set_up(Kind.LINEAR)
        own = {name: text for name, text in texts if name != _SURFACE}
        defined = (
            math.nan if surface != surface else self._parameter(what, _SURFACE) * (MM_PER_INCH if self.inch else 1.0)
        )
        block.places.append(CycleCall(cycle, top, surface, level, axis, len(block.moves), defined, tuple(own.items())))
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


# --- Arcs, end points about the pole, and cutter radius compensation ------------------------------


class HeidenhainPaths(HeidenhainCycles):
    """Arcs, the pole in force (``CC``, by axis), and whether the last block in the plane was compensated (``on_contour``)."""

    centre: Mapping[int, float] = {}
    on_contour = False
    plane_of_pole: tuple[int, int, int] | None = None
    """The plane of the pole, if ``CC`` names two axes; None: that of the tool."""
    _in_space = False

    @property
    def arc_plane(self) -> tuple[int, int, int]:
        """The plane of arcs about the pole, and of angles and radii; raise `InputError` for a pole in space."""
        if self._in_space:
            raise self.error("arc about a pole with three coordinates", "CC with the two axes of the plane of the arc")
        return self.plane_of_pole or self.plane

    def take_tool_axis(self, plane: tuple[int, int, int]) -> None:
        """Set the plane of the tool; another one has no pole yet."""
        if plane != self.plane:
            self.centre, self.plane_of_pole, self._in_space = {}, None, False
        self.plane = plane

    def set_pole(self, found: Mapping[int, float]) -> None:
        """Set the pole from the words of ``CC``: two axes name the plane, one keeps the others, none takes the position."""
        planes = {frozenset(plane[:2]): plane for plane in PLANES.values()}
        if len(found) == 2:
            self.centre, self.plane_of_pole = dict(found), planes[frozenset(found)]
        elif len(found) == 1:
            self.centre = {**self.centre, **found}
        else:
            self.centre = found or dict(enumerate(self.position[: self.linear]))
            self.plane_of_pole, self._in_space = None, bool(found)
            return
        self._in_space = False

    def leave_contour(self) -> None:
        """Raise `InputError` if radius compensation is selected where the control leaves the contour."""
        if self.beside:
            raise self.error("machine coordinates under cutter radius compensation", "R0 before them")
        self.on_contour = False

    def compensated(self, block: PathBlock, rotary: list[float]) -> bool:
        """Return whether a block is under cutter radius compensation, or leads in or out; ``rotary``: the axes before it."""
        if not (self.beside or self.on_contour or block.leads):
            return False
        here = self.position[self.linear :]
        turns = any(not abs(a - b) <= CORRECTION_DEG for a, b in zip(here, rotary, strict=True) if a == a or b == b)
        if self.tcp or self.vector is not None or block.normal is not None or turns or block.calls or self.modal:
            what = "cutter radius compensation with a tool that turns, or in a cycle"
            raise self.error(what, "the tool centre path (R0)")
        self.note(BESIDE, once=True)
        a, b, _ = self.plane
        if block.polar or block.axis_bits & (1 << a | 1 << b) or block.keyword in vocabulary.ARCS:
            self.on_contour = self.beside
        return True

    def polar_end(self, block: PathBlock, start: list[float]) -> float | None:
        """Set the end point of a block given about the pole, and return its sweep in radians if that is given."""
        a, b, _ = self.arc_plane
        if not (a in self.centre and b in self.centre):
            raise self.error(f"{block.keyword} without a pole", "CC before it")
        if block.axis_bits & (1 << a | 1 << b) or (
            block.keyword == "CP" and ("R" in block.polar or "A" not in block.polar)
        ):
            expected = "CP with PA or IPA" if block.keyword == "CP" else "PR and PA without axis words of the plane"
            raise self.error(f"{block.keyword} with other words", expected)
        u, v = start[a] - self.centre[a], start[b] - self.centre[b]
        if math.hypot(u, v) < 1e-9 and (
            block.keyword == "CP" or block.polar.keys() != {"R", "A"} or block.polar["A"][1]
        ):
            raise self.error(f"{block.keyword} from the pole itself", "PR and PA")
        values = {"R": math.hypot(u, v), "A": math.degrees(math.atan2(v, u))}
        begin = math.radians(values["A"])
        for name, (value, incremental) in block.polar.items():
            values[name] = value + (values[name] if incremental else 0.0)
        if not all(map(math.isfinite, values.values())):
            raise self.error(f"{block.keyword} from an unknown position", "a position of both axes before it")
        angle = math.radians(values["A"])
        self.position[a] = self.centre[a] + values["R"] * math.cos(angle)
        self.position[b] = self.centre[b] + values["R"] * math.sin(angle)
        if block.keyword != "CP" or not block.polar["A"][1]:
            return None
        if block.clockwise is not None and (angle < begin) != block.clockwise:
            raise self.error("CP whose angle and sense differ", "IPA with the sign of DR")
        if abs(angle - begin) > math.radians(360.0 * MOST_TURNS):
            raise self.error("arc of too many turns", f"at most {MOST_TURNS} turns")
        return angle - begin

    def arc(self, block: PathBlock, start: list[float], sweep: float | None) -> Arc:
        """Return the arc of a block; ``sweep``: in radians, if the block gives it."""
        if block.clockwise is None:
            raise self.error("circular block without its sense", "DR+ or DR-")
        a, b, third = plane = self.plane if block.keyword == "CR" else self.arc_plane
        from_, to = (start[a], start[b]), (self.position[a], self.position[b])
        if block.keyword == "CR":
            if block.radius is None:
                raise self.error("CR without a radius", "R+10 or R-10")
            if block.axis_bits >> third & 1 and not block.axis_bits >> a & block.axis_bits >> b & 1:
                what = "CR with a word of the tool axis and one of the plane"
                raise self.error(what, "CC and C: the plane of the arc is that of CC")
            return self.valid_arc(arc_by_radius(plane, from_, to, block.radius, block.clockwise))
        if plane != self.plane and (self.beside or block.axis_bits >> third & 1):
            what = "arc in another plane than that of the tool under cutter radius compensation, or as a helix"
            raise self.error(what, "the tool centre path (R0), and CC with the axes of the words")
        if a in self.centre and b in self.centre:
            centre = (self.centre[a], self.centre[b])
            if sweep:
                return Arc(plane, centre, sweep)
            return self.valid_arc(arc_by_centre(plane, from_, to, centre, block.clockwise))
        return self.valid_arc(ArcMisfit("circular block without its centre", "CC before it"))


# --- Preset, tool, tilted plane, shift and rotation -----------------------------------------------

_PRESET: Final = "Q339"
PLANES: Final = {"Z": (0, 1, 2), "Y": (2, 0, 1), "X": (1, 2, 0)}
_DEFINITIONS: Final = {
    "SPATIAL": ("SPA", "SPB", "SPC"),
    "EULER": ("EULPR", "EULNU", "EULROT"),
    "VECTOR": ("BX", "BY", "BZ", "NX", "NY", "NZ"),
    "POINTS": tuple(f"P{point}{axis}" for point in (1, 2, 3) for axis in "XYZ"),
    "RELATIVE": ("SPA", "SPB", "SPC"),
}
"""Ways to define a plane, and their words."""
_PLANE_VALUE: Final = re.compile(
    r"(?<![A-Z\d])(SP[ABC]|EUL(?:PR|NU|ROT)|[BN][XYZ]|P[123][XYZ]|PRO(?:PR|MIN)|ROT)[ \t]*([+-]?[ \t]*(?:[\d.,]+|Q[LR]?\d+))",
    re.ASCII | re.IGNORECASE,
)
_ALONG: Final = 1e-12
_CHOICE: Final = re.compile(r"(?:SEQ|SYM)[ \t]*([+-])", re.ASCII | re.IGNORECASE)


class HeidenhainFrame(HeidenhainPaths):
    """Preset by cycle 247, tool by ``TOOL CALL``, tilted plane; ``continued``: whether the next line continues the block."""

    heidenhain = True
    variant = "HEIDENHAIN"
    continued = False
    plane = PLANES["Z"]
    _selects_preset = False
    _shift_below: tuple[float, ...] = ()
    _stated: frozenset[int] = frozenset()
    """Axes with an absolute shift since the shift became doubtful."""
    _turned_deg = 0.0

    def lose(self, block: Block, statement: str) -> None:
        """As `Interpreter.lose`; the pole is unknown too, and a statement that the machine file names as harmless has no effect."""
        upper = " ".join(statement.split(";")[0].upper().split())
        if not any(f"{upper} ".startswith(f"{words} ") for words in self.harmless):
            super().lose(block, statement)
            self.centre = {}

    def begin_preset(self) -> None:
        """Begin cycle 247, whose parameter may follow on the next line."""
        if not self.offsets_known:
            self.note("CYCL DEF 247 selects a preset: its offset must be given as work_offset")
        self.assign(_PRESET, math.nan)
        self._selects_preset = True

    def end_preset(self, block: PathBlock) -> None:
        """Select the preset of a cycle 247 that is complete."""
        if self._selects_preset and not self.continued:
            self._selects_preset, self.doubtful = False, ""
            self._shift_to(block, (), None)
            row = self.value_of(_PRESET)
            if not self.offsets_known and row != row:
                self.select_offset(block, f"preset of line {self._line + 1}")
                return
            if row != row or row != int(row):
                raise self.error("preset without a number", "Q339=+1 with the row of the preset table")
            self.select_offset(block, str(int(row)))

    def select_tool(self, block: PathBlock, body: str) -> None:
        """Put the tool of a ``TOOL CALL`` into the spindle, with its ``DL``."""
        match = vocabulary.TOOL.match(body)
        if match is None:
            return
        delta = vocabulary.TOOL_LENGTH.search(body.split(";")[0])
        tool = match.group(1) if match.group(2) is None else match.group(2)
        if not self.tools_known:
            row = self.value_of(tool)
            held = "" if row == 0.0 else f"{row:g}" if row == row else tool
            axis = vocabulary.TOOL_AXIS.match(body)
            along = None if axis is None else self.index.get(axis.group(1).upper())
            length = held and f"{held}{'' if delta is None else f' DL{delta.group(1)}'}"
            self.hold_tool(block, held, length, along=along)
            return
        if tool[:1] in "qQ":
            tool = f"{self.known('TOOL CALL', tool):g}"
        length = 0.0 if delta is None else self.known("DL", delta.group(1))
        self.select(block, tool=tool, length="" if tool == "0" else tool, delta_mm=length)

    def tilt(self, block: PathBlock, upper: str) -> None:
        """Apply a ``PLANE`` statement."""
        words = upper.split()
        if words[1:2] == ["RESET"]:
            self._end_plane(block, words)
            return
        way = next((word for word in words if word in ("TURN", "MOVE", "STAY")), "")
        if self.tcp or not way:
            what = "PLANE under tool centre point control, or that says nothing of the rotary axes"
            raise self.error(what, "TURN, MOVE or STAY")
        turned = self._rotation(upper, words[1] if len(words) > 1 else "")
        if turned[2][2] > 1.0 - _ALONG and turned[0][0] < 1.0 - _ALONG and "COORD ROT" not in upper:
            expected = "COORD ROT; TABLE ROT turns the table"
            raise self.error("PLANE that only turns about the tool axis", expected)
        choice = _CHOICE.search(upper)
        sign = 0 if choice is None else 1 if choice.group(1) == "+" else -1
        stays = way == "STAY" or ("TURN" in words and not any(word.startswith("MB") for word in words))
        self.pending = Plane(self._zero_of_plane(), turned, sign, stays)
        if way != "STAY":
            self._enter_plane(block, self.pending)

    def _zero_of_plane(self) -> tuple[float, float, float]:
        """Return the zero of a tilted plane: the datum shift before the first one."""
        if self.frame.plane is None:
            self._shift_below = self.frame.shift
        elif self.frame.shift or self.frame.turn:
            raise self.error("another tilted plane while this one is shifted or turned", "the shift cancelled before")
        shift = self._shift_below
        if self.frame.turn or any(shift[self.linear :]):
            what = "tilted plane in turned coordinates, or after a shift of a rotary axis"
            raise self.error(what, "these cancelled before")
        x, y, z = shift[:3] or (0.0, 0.0, 0.0)
        return x, y, z

    def working_plane(self, block: PathBlock, rest: str) -> None:
        """Apply ``CYCL DEF 19.1 A+30 B+0 C+15``, without angles its end; the program positions the rotary axes.

        The builder of the machine decides whether its angles are spatial angles or positions of the rotary axes (HEIDENHAIN, user's
        manuals of TNC 320 and iTNC 530, "Working plane, cycle 19"). Both must be the same plane.
        """
        found = vocabulary.TILT.findall(rest)
        if not vocabulary.TILT_REST.fullmatch(vocabulary.TILT.sub("", rest)):
            raise self.error("CYCL DEF 19 with other words", "angles such as A+30 B+0 C+15", rest)
        values = {name.upper(): self.known(name, text) for name, text in found}
        if not any(values.values()):
            if self.pending is not None or self.frame.plane is not None:
                self._end_plane(block, ())
            return
        if self.tcp:
            raise self.error("CYCL DEF 19 under tool centre point control", "M129 before it")
        turned = rotation_about("ZYX", [values.get(name, 0.0) for name in "CBA"])
        rotary = self.names[self.linear :]
        of_axes = {name for name, value in values.items() if value} <= {*rotary}
        read = tuple(values.get(name, 0.0) for name in rotary) if of_axes else None
        self.pending = Plane(self._zero_of_plane(), turned, read_deg=read)

    def _end_plane(self, block: PathBlock, words: Sequence[str]) -> None:
        """Apply ``PLANE RESET``; ``words``: those of the block."""
        self.pending = None
        if self.frame.plane is not None:
            if self.frame.shift or self.frame.turn:
                raise self.error("end of a tilted plane while it is shifted or turned", "the shift cancelled before")
            self.select(block, plane=None, shift=self._shift_below)
        if "STAY" not in words:
            self.note("the end of the plane may move the rotary axes; their positions are unknown afterwards")
            self.mark_unknown(block, range(self.linear, len(self.names)), moved=bool(self.frames))

    def _enter_plane(self, block: PathBlock, plane: Plane) -> None:
        self.pending = None
        self.select(block, plane=plane, shift=())

    def stand_at_plane(self, block: PathBlock) -> bool:
        """Apply a plane defined with ``STAY``; return whether a block that moves axes does nothing else.

        One that names rotary axes only positions them, by the parameters Q120 to Q122 where the control has computed them or by
        numbers; any other one finds them in position.
        """
        plane, rotary = self.pending, [word for word in block.words if word.axis >= self.linear]
        if plane is None:
            return False
        what = "move between PLANE with STAY and its positioning"
        if self.tcp or (rotary and (len(rotary) < len(block.words) or block.polar)):
            raise self.error(what, "the rotary axes alone, such as L A+Q120 C+Q122")
        computed = [word for word in rotary if word.form]
        if computed:
            if len(computed) < len(self.names) - self.linear:
                raise self.error(what, "every rotary axis by its own parameter, such as L A+Q120 C+Q122")
            self._enter_plane(block, plane)
            return True
        if rotary:
            self.apply_words(block)
        at = self.stands("tilted plane")
        self._enter_plane(block, replace(plane, at_deg=at))
        self.position[self.linear :] = at
        return bool(rotary)

    def _rotation(self, upper: str, way: str) -> Rows:
        """Return the rotation of a ``PLANE`` statement: its name and its words."""
        kind = next((name for name in _DEFINITIONS if way and name.startswith(way[:7]) and len(way) >= 5), "")
        if not kind:
            raise self.error(f"coordinate transformation PLANE {way}", f"PLANE {', '.join(_DEFINITIONS)}")
        values = {name: self.known(name, text) for name, text in _PLANE_VALUE.findall(upper)}
        wanted = _DEFINITIONS[kind]
        if not values.keys() <= {*wanted} or (kind in ("VECTOR", "POINTS", "EULER") and len(values) < len(wanted)):
            raise self.error(f"PLANE {way} with other words", " ".join(wanted))
        numbers = [values.get(name, 0.0) for name in wanted]
        if kind == "SPATIAL":
            # About the fixed X, then Y, then Z: the same as about Z, then the turned Y, then the turned X.
            return rotation_about("ZYX", numbers[::-1])
        if kind == "EULER":
            return rotation_about("ZXZ", numbers)
        if kind == "RELATIVE":
            if len(values) != 1:
                raise self.error("PLANE RELATIVE about several axes", "one of SPA, SPB and SPC")
            plane = self.frame.plane
            turned = rotation_about("XYZ", numbers)
            return turned if plane is None else product(plane.rotation, turned) or turned
        points = [numbers[i : i + 3] for i in range(0, len(numbers), 3)]
        try:
            return rotation_through(points) if kind == "POINTS" else rotation_along(*points)
        except ValueError as error:
            raise self.error(f"PLANE {way} with {error}", "two directions across each other") from None

    def shift(self, block: PathBlock, words: str, what: str) -> None:
        """Shift the datum by axis words, each absolute or incremental (``IX``); the other axes keep their shift."""
        if self.pending is not None:
            raise self.error(f"{what} between PLANE with STAY and its positioning", "the shift before it")
        shift = [*(self.frame.shift or (0.0,) * len(self.names))]
        found = list(vocabulary.SHIFT.finditer(words))
        if not found or vocabulary.SHIFT.sub("", words).strip():
            how = "by a row of a datum table" if "#" in words else "without axis words"
            raise self.error(f"{what} {how}", "axis words such as X+10 or IX+10", words.strip() or None)
        for match in found:
            axis = self.index.get(match[2].upper(), -1)
            if axis < 0:
                raise self.unknown_axis(match[0].strip())
            value = self.known(match[2], match[3]) * (MM_PER_INCH if self.inch and axis < self.linear else 1.0)
            shift[axis] = value + (shift[axis] if match[1] else 0.0)
            if match[1] and self.doubtful:
                raise self.error(f"{what} by an increment where {self.doubtful}", "an absolute shift of X, Y and Z")
        self._stated |= {self.index[match[2].upper()] for match in found if not match[1]}
        if self.frame.plane is not None and self._shift_below and not any(shift):
            self.doubtful = "the datum shift from before the tilted plane is cancelled within it"
            self._stated = frozenset()
            return
        if self.frame.plane is not None and (self._shift_below or any(shift[self.linear :])):
            raise self.error(f"{what} in a tilted plane", "a shift of the linear axes, and none before the plane")
        if self.frame.turn and any(shift) and tuple(shift) != self.frame.shift:
            raise self.error(f"{what} in turned coordinates", "the rotation after the shift")
        self._shift_to(block, tuple(shift) if any(shift) else (), self.frame.turn)
        if self.frame.plane is None and self._stated >= {*range(self.linear)}:
            self.doubtful = ""

    def turn(self, block: PathBlock, words: str, what: str) -> None:
        """Turn the coordinates in the working plane by ``ROT``, absolute or incremental."""
        match = vocabulary.ROTATION.fullmatch(words.strip())
        if match is None:
            raise self.error(f"{what} without an angle", "ROT+30", words.strip() or None)
        if self.plane != PLANES["Z"]:
            raise self.error(f"{what} about another axis than Z", "tool axis Z")
        angle = self.known("ROT", match[2])
        self._turned_deg = angle + (self._turned_deg if match[1] else 0.0)
        self._shift_to(block, self.frame.shift, rotation_about("Z", [self._turned_deg]) if self._turned_deg else None)

    def _shift_to(self, block: PathBlock, shift: tuple[float, ...], turn: Rows | None) -> None:
        if turn is None:
            self._turned_deg = 0.0
        if (shift, turn) != (self.frame.shift, self.frame.turn):
            self.centre = {}
        self.reframe(block, carried=False, shift=shift, turn=turn)

    def known(self, name: str, written: str) -> float:
        """Return the value of a word; raise `InputError` if it is unknown."""
        if "Q" in written.upper():
            return self.known_value(name, written, "a number, or a Q parameter set to a number before")
        value = self.value_of(written)
        if value != value:
            raise self.missing_number(name, written)
        return value
