"""Effects of ISO blocks on the frame: work offset, tool and its length, tilted plane, constant shifts and rotations.

Sources: LinuxCNC user manual ("Coordinate systems", "G-Codes"), Fanuc Series 30i operator's manual ("Workpiece coordinate system",
"Local coordinate system"), SINUMERIK 840D sl Programming Manual Fundamentals ("Coordinate transformations (frames)").
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal, NamedTuple, final

import numpy as np

from twin._common.errors import InputError
from twin.nc.arcs import FROM_START, CentreWords
from twin.nc.blocks import (
    STATED_LENGTH,
    AxisWords,
    Plane,
    Rows,
    WordFrame,
    product,
    rotation_about,
    rotation_along,
    rotation_through,
)
from twin.nc.iso import vocabulary
from twin.nc.iso.cycles import Drilling
from twin.nc.modal import AxisWord, Block, Interpreter, Span
from twin.nc.text import MM_PER_INCH, unit_vector


class Item(NamedTuple):
    """A word to be interpreted with the rest of its block: its name, its range, the range of its value, and the text of the value."""

    name: str
    start: int
    end: int
    value_start: int
    value_end: int
    value: str


@final
@dataclass(slots=True)
class IsoBlock(Block):
    """One block: `twin.nc.modal.Block` with the attributes of ISO blocks.

    Attributes:
        skip: the skip mark (``/``) and its digit, or empty.
        codes: G words, named by their code.
        items: axis words, before their values are known.
        others: words that are not axis words.
        motion: motion code in force (0 to 3), None before the first.
        vector_names: names of the tool vector's words here, with their ``=``, or None if there is no vector.
        cycle_word: the range of a call or the end of a drilling cycle of SINUMERIK.
        cycle_words: words of a drilling cycle of Fanuc, which are not needed once it is expanded.
        drilling: the cycle that the block executes, at all its holes.
        approaches: whether its axis words name axes that go to a reference or fixed point of SINUMERIK.
        calls: whether the block executes a cycle of SINUMERIK at the present position.
        positions: whether the block moves the axes to the place of the hole before.
        repeats: number of holes that it drills, each by the increments of its words further than the one before.
        pattern: places of the holes of a pattern of SINUMERIK, by axis.
        path_words, polar: words in place of an end point: of SINUMERIK, and ``@`` and ``^`` (``polar_step``: what they add in G91).
    """

    skip: str = ""
    codes: list[Span] = field(default_factory=list)
    items: list[Item] = field(default_factory=list)
    others: list[Item] = field(default_factory=list)
    m_words: list[str] = field(default_factory=list)
    names: list[Item] = field(default_factory=list)
    motion_word: Span | None = None
    feed: Span | None = None
    motion: int | None = None
    inverse_time: bool = False
    centres: CentreWords = FROM_START
    vector_names: tuple[str, str, str] | None = None
    cycle_word: Span | None = None
    cycle_words: list[Span] = field(default_factory=list)
    drilling: Drilling | None = None
    drilling_axis: int = 2
    approaches: bool = False
    calls: bool = False
    positions: bool = True
    repeats: int = 1
    pattern: list[dict[int, float]] = field(default_factory=list)
    path_words: list[Span] = field(default_factory=list)
    polar: list[Item] = field(default_factory=list)
    polar_step: tuple[float, float] | None = None

    def own_of(self, word: str) -> str:
        """Return the letters of the words here that belong to an M word; an angle to M19 only without axis words (``G2 X5 R7 M19``)."""
        own = "" if word == "M19" and self.items else vocabulary.OWN_OF_M.get(word, "")
        return "".join(item.name for item in self.others if item.name in own)


# --- Work offset, tool in the spindle, and the length that the control adds ------------------------

_LENGTH_ON: Final = frozenset({"43", "44", "43.4", "43.5", "234", "169"})
_OF_TOOL: Final = frozenset("THD")
TOOL_CHANGE: Final = "M6"


class IsoFrame(Interpreter):
    """Work offset and tool.

    ``T`` selects a tool and ``M6`` puts it into the spindle. Its length acts from ``G43 H`` on (Fanuc, LinuxCNC) until ``G49``, or with
    its cutting edge ``D1`` until ``D0`` (SINUMERIK; for a tool called by name from the tool change on, as its machine data have it by
    default).
    """

    without_frames = False
    """Whether the program has words that no program of SINUMERIK has, so that G58 and G59 select work offsets."""
    _next_tool = ""
    _length_by_h = _by_name = False

    def choose_offset(self, block: IsoBlock, code: str) -> None:
        """Select a work offset by its G code; ``G58`` and ``G59`` that shift coordinates are refused."""
        shifts = code in ("58", "59") and not self.without_frames
        if shifts and block.items and not any(span.name in "0123" for span in block.codes):
            raise self.error(f"coordinate transformation G{code}", vocabulary.NO_TRANSFORMATION, f"G{code}")
        if code in ("54.1", "154"):
            for item in block.others:
                if item.name == "P":
                    value = self.value_of(item.value)
                    code += f" P{value:g}" if value == value else f" P{item.value.strip()}"
        if code == "15":
            item = next(item for item in block.others if item.name == "H")
            code += f" H{self.known_value('H', item.value, vocabulary.KNOWN_VALUE):g}"
        self.select_offset(block, f"G{code}")

    def choose_tool(self, block: IsoBlock, words: frozenset[str]) -> None:
        """Apply the words for tool and length of a block; ``words``: its M words."""
        codes = {span.name for span in block.codes}
        said = {item.name: item for item in block.others if item.name in (_OF_TOOL if "15" not in codes else "T")}
        if not (said or codes or words):
            return
        if codes & {"170", "49", *_LENGTH_ON}:
            self.doubtful = "the length of the tool behind G170 is not stated (G56 H, or G53)" if "170" in codes else ""
        changes: dict[str, Any] = {}
        tool = self.frame.tool if self.tools_known else self._held_tool
        tools = [item for item in block.others if item.name == "T"]
        if tools:
            self._next_tool, self._by_name = self._name_of(tools[0]), '"' in tools[0].value
        if TOOL_CHANGE in words:
            if not self._next_tool and self.tools_known:
                raise self.error("tool change without a tool", "T with a number or a name before M6")
            tool = changes["tool"] = self._next_tool or f"of line {self._line + 1}"
            if self._by_name:
                changes["length"] = tool
            self._next_tool = self._name_of(tools[-1]) if len(tools) > 1 else self._next_tool  # Mazak: T1 T2 M6
        elif "M61" in words:
            tool = changes["tool"] = self._in_spindle(block, tool)
        changes |= self._length(block, said, codes, tool)
        if changes and self.tools_known:
            self.select(block, **changes)
        elif changes:
            length = changes.get("length", self._held_length)
            self.hold_tool(block, "" if tool == "0" else tool, "" if length == "0" else length)

    def _in_spindle(self, block: IsoBlock, tool: str) -> str:
        """Return the tool in the spindle by ``M61 Q`` of LinuxCNC; ``tool``: that before, which M61 of a builder leaves there."""
        item = next((item for item in block.others if item.name == "Q"), None)
        if item is None:
            self.take_auxiliary("M61")
        return tool if item is None else self._name_of(item)

    def _length(self, block: IsoBlock, said: dict[str, Item], codes: set[str], tool: str) -> dict[str, str]:
        """Return the change of the length in force, empty if there is none."""
        if "43.1" in codes:
            return {"length": self._stated_length(block)}
        if "44" in codes and self.tools_known:
            raise self.error("tool length by G44", "G43 with an H word, whose length is in the table of tools")
        height = self._name_of(said["H"]) if "H" in said else None
        in_force = self._length_by_h and (self.frame.length or self._held_length) and "49" not in codes
        if codes & _LENGTH_ON or (in_force and height not in (None, "0")):
            self._length_by_h = True
            if not (height or tool) and self.tools_known:
                raise self.error("tool length without a tool", "G43 with an H word, or a tool change before it")
            return {"length": height or tool}
        if codes & {"49", "170"} or (self._length_by_h and height == "0"):
            return {"length": ""}
        radius_only = codes & {"41", "42"} and not (self.frame.length or self._held_length)
        if "D" in said and not self._length_by_h and not radius_only:
            edge = self._name_of(said["D"])
            own = tool if edge == "1" and (tool or self.tools_known) else f"{tool} D{edge}"
            return {"length": "" if edge == "0" else own}
        return {}

    def _stated_length(self, block: IsoBlock) -> str:
        """Take the length that ``G43.1 Z`` of LinuxCNC states, and return its name."""
        depth = self.names[self.linear - 1].upper()
        moves = any(vocabulary.GROUP_OF.get(span.name) == "motion" for span in block.codes)
        if moves or [item.name for item in block.items] != [depth] or any(item.name == "H" for item in block.others):
            raise self.error("tool length by G43.1", f"G43.1 with {depth} alone (LinuxCNC), or G43 with an H word")
        value = self.known_value(depth, block.items[0].value, vocabulary.KNOWN_VALUE)
        block.items, self._length_by_h = [], True
        return f"{STATED_LENGTH}{value * (MM_PER_INCH if self.inch else 1.0)!r}"

    def _name_of(self, item: Item) -> str:
        """Return the number or the name of a tool, an offset of its length, or an edge."""
        text = item.value.strip()
        if text.startswith('"'):
            return text.strip('"')
        if not self.tools_known and self.value_of(text) != self.value_of(text):
            return text
        value = self.known_value(item.name, text, "a whole number, or a name in quotes")
        if value < 0 or value != int(value):
            raise self.error(f"{item.name} names no tool", "a whole number, or a name in quotes", text)
        return str(int(value))


# --- Tilted planes of ISO programs: ``G68.2`` with ``G53.1`` (Fanuc), ``G268`` with ``G253`` (Haas), ``CYCLE800`` (SINUMERIK) ----
# Public descriptions beside the manuals: LinuxCNC's remap "Tilted Work Plane" (G68.2 P2 and P3, G53.3); Autodesk's and FreeCAD's posts
# for Haas (G268 Q123: about the fixed axes X, Y, Z, in this order).

_ORDER: Final = {1: "X", 2: "Y", 3: "Z"}
_PLANE_WORDS: Final = frozenset("XYZIJKPQRSTDHF")
_POSITIONING_WORDS: Final = frozenset("PSTDHF")
"""Words of a block that defines a plane, and of one that positions the axes: those of the plane, and of spindle, tool and feed."""
_FRAME_WORDS: Final = frozenset("XYZIJKPQR")
TILTS: Final = frozenset(vocabulary.GROUPS["plane tilt"])
_DEFINING: Final = frozenset({"68.2", "268"})
_ENDING: Final = frozenset({"69", "255", "269"})
_STEPS: Final[dict[float, tuple[str, ...]]] = {2.0: ("XYZ", "XYZ", "XYZ"), 3.0: ("XYZIJK", "IJK")}
"""Words of the blocks with Q1, Q2, … that define a plane by three points (P2), and by the directions of x and z (P3)."""
_SQUARE: Final = 1e-5
"""Cosine of the angle between the directions of x and z up to which it does not matter which of them a control corrects."""
_CHOICES: Final = {"0": 0, "1": 1, "2": -1}
_SOLID_ANGLE: Final = 64
"""MODE of CYCLE800: about Z, then about the turned Y."""


class IsoTilt(IsoFrame):
    """The tilted plane in force, and one that is defined while the rotary axes are not yet positioned.

    ``points``: the blocks of a plane by several blocks (G68.2 P2, P3) that is not yet complete.
    """

    inch = False
    pending: Plane | None = None
    points: tuple[list[float], ...] = ()
    _form = 0.0

    def tilt_words(self, block: IsoBlock) -> None:
        """Apply a G word of tilted planes and take its words from a block; the positions behind ``G53.3`` stay for the motion."""
        code = next((span.name for span in block.codes if span.name in TILTS), "")
        if not code:
            return
        positions = code == "53.3"
        words = _PLANE_WORDS if code in _DEFINING else _POSITIONING_WORDS | frozenset("XYZ" if positions else "")
        stray = next((item for item in (*block.items, *block.others) if item.name not in words), None)
        if stray is not None and code != "69":
            shown = block.text[stray.start : stray.end].strip()
            raise self.error(
                "unknown word in a block with a tilted plane", f"no words but {' '.join(sorted(words))}", shown
            )
        if self.points and code not in (*_DEFINING, *_ENDING):
            raise self._incomplete()
        if code in _ENDING:
            self.pending, self.points = None, ()
            self._check_unshifted()
            self.select(block, plane=None)
            return
        if code in _DEFINING:
            self._check_allowed(within=False)
            self._define(block, code)
        elif code == "254":
            self._check_allowed(within=False)
            at = self.stands("G254")
            self._tilt(block, Plane((0.0, 0.0, 0.0), None, at_deg=at))
            self.position[self.linear :] = at
        else:
            self._position(block, code)
        if positions:
            self.note(
                "G53.3 turns the rotary axes and goes to its X, Y, Z at rapid; G0 is in force after it (LinuxCNC)"
            )
            self.motion = 0
        block.items, block.others = block.items if positions else [], []

    def _position(self, block: IsoBlock, code: str) -> None:
        """Let the control position the rotary axes: ``G53.1``, ``G53.3``, ``G53.6``, ``G253``."""
        if self.pending is None:
            raise self.error(
                f"G{code} without a tilted plane", "G268 before it" if code == "253" else "G68.2 before it"
            )
        choice = next((item.value.strip() for item in block.others if item.name == "P"), "0")
        if choice not in _CHOICES:
            raise self.error(f"G{code} with an unknown P", "P0, P1 or P2", choice)
        self._tilt(block, replace(self.pending, choice=_CHOICES[choice], stays=code == "53.1"))

    def _define(self, block: IsoBlock, code: str) -> None:
        """Take the definition of a plane, or one block of several."""
        items = [item for item in (*block.items, *block.others) if item.name in _FRAME_WORDS]
        values = {item.name: self.known_value(item.name, item.value, vocabulary.KNOWN_VALUE) for item in items}
        unit = MM_PER_INCH if self.inch else 1.0
        values |= {letter: values[letter] * unit for letter in "XYZ" if letter in values}
        form = values.pop("P", 0.0)
        if form in _STEPS and code == "68.2":
            self.pending = self._by_blocks(form, values)
            return
        if self.points:
            raise self._incomplete()
        x, y, z = (values.get(letter, 0.0) for letter in "XYZ")
        self.pending = Plane((x, y, z), self._turned_plane(code, form, values))

    def _turned_plane(self, code: str, form: float, values: dict[str, float]) -> Rows:
        """Return the axes of a plane by angles: Euler angles of ``G68.2``, with P1 one about X, Y or Z; fixed axes of ``G268 Q123``.

        Several angles with P1 are refused: public descriptions differ in whether the axes turn with each other.
        """
        angles = [values.get(letter, 0.0) for letter in "IJK"]
        if values.get("R"):
            raise self.error(f"tilted plane by G{code} with R", "the plane without a further rotation")
        if code == "268":
            if form or values.get("Q") != 123.0:
                raise self.error("G268 without Q123", "Q123: angles I, J, K about the fixed axes X, Y, Z")
            return rotation_about("ZYX", angles[::-1])
        if not form:
            if "Q" in values:
                raise self.error("G68.2 with Q", "Euler angles I, J, K (without P and Q)")
            return rotation_about("ZXZ", angles)
        if form != 1.0 or sum(map(bool, angles)) > 1:
            expected = "Euler angles I, J, K (without P), P1 with one angle, three points (P2) or two vectors (P3)"
            raise self.error(f"G68.2 with P{form:g}", expected)
        return rotation_about("XYZ", angles)

    def _by_blocks(self, form: float, values: dict[str, float]) -> Plane | None:
        """Take one block of a plane by three points or two vectors; return the plane when it is complete."""
        steps, step = _STEPS[form], values.pop("Q", 0.0)
        if form == 2.0 and step == 0.0 and not self.points:
            if any(values.values()):
                raise self.error("G68.2 P2 Q0 with a shift or an angle", "zeros, or no such block: controls differ")
            return None
        words = steps[len(self.points)]
        if (self.points and form != self._form) or step != len(self.points) + 1 or values.keys() != {*words}:
            expected = f"G68.2 P{form:g} with " + ", ".join(f"Q{i} {' '.join(one)}" for i, one in enumerate(steps, 1))
            raise self.error("block of a tilted plane out of order, or with other words", expected)
        self._form = form
        self.points = *self.points, [values[letter] for letter in words]
        if len(self.points) < len(steps):
            return None
        points, self.points = self.points, ()
        x, y, z = points[0][:3]
        try:
            if form == 2.0:
                self.note("G68.2 P2: the zero of the plane is its first point (Fanuc)")
                return Plane((x, y, z), rotation_through(points))
            first, normal = (unit_vector((one[0], one[1], one[2]))[0] for one in (points[0][3:], points[1]))
            if abs(sum(a * b for a, b in zip(first, normal, strict=True))) > _SQUARE:
                raise self.error("two vectors that are not perpendicular", "perpendicular ones: controls differ")
            return Plane((x, y, z), rotation_along(first, normal))
        except ValueError as error:
            raise self.error(f"G68.2 P{form:g} with {error}", "two directions across each other") from None

    def _incomplete(self) -> InputError:
        return self.error(
            f"tilted plane by G68.2 P{self._form:g} that is not complete", "all its blocks one after another"
        )

    def stand_at_plane(self, block: IsoBlock) -> bool:
        """Apply a pending plane where the program itself positions the rotary axes; return whether a block does nothing else.

        A block that names rotary axes only positions them, any other one finds them in position.
        """
        plane, rotary = self.pending, [word for word in block.words if word.axis >= self.linear]
        if self.points:
            raise self._incomplete()
        if plane is None:
            return False
        if self.tcp or (rotary and len(rotary) < len(block.words)):
            expected = "G53.1 directly after G68.2, or the rotary axes alone in the block that positions them"
            raise self.error("move between G68.2 and G53.1", expected)
        if rotary:
            self.apply_words(block)
        at = self.stands("tilted plane")
        self._tilt(block, replace(plane, at_deg=at))
        self.position[self.linear :] = at
        return bool(rotary)

    def swivel(self, block: IsoBlock, arguments: str) -> None:
        """Apply ``CYCLE800(FR, TC, ST, MODE, X0, Y0, Z0, A, B, C, X1, Y1, Z1, DIR, …)``; TC ``"0"``, or nothing, ends the plane."""
        texts = [part.strip() for part in arguments.strip()[1:-1].split(",")]
        texts += [""] * (14 - len(texts))
        shown = f"CYCLE800{arguments}"
        values = [self.value_of(text) if text else 0.0 for text in (texts[0], *texts[2:14])]
        deselects = texts[1] == '"0"' or (texts[:2] == ["0", '""'] and not any(texts[2:]))
        if not any(texts) or (deselects and not any(values[3:12])):
            self.pending = None
            self._check_unshifted()
            self.select(block, plane=None)
            return
        self._check_allowed(within=True)
        if any(value != value for value in values):
            raise self.error("CYCLE800 with an unknown value", "numbers, or variables set to numbers before", shown)
        retract, new, mode = (int(value) for value in values[:3])
        # ST: units 0 new, 1 added to the plane in force; tens: the tool tip is tracked; 100,000 and 200,000: how DIR selects.
        if new % 10 > 1 or new // 10 % 10 > 1 or new // 100 not in (0, 1000, 2000) or deselects:
            raise self.error("CYCLE800 of this kind", "ST 0 (new plane) or 1 (added), and a swivel data record", shown)
        if values[12] not in (-1.0, 0.0, 1.0):
            raise self.error("CYCLE800 with an unknown DIR", "DIR 1, -1 or 0", shown)
        unit = MM_PER_INCH if self.inch else 1.0
        turned = self._swivelled(mode, values[6:9], shown)
        before, after = (np.array(values[i : i + 3]) * unit for i in (3, 9))
        zero, below = before + np.array(turned) @ after, self.frame.plane
        if new % 10 and below is not None and below.rotation is not None:
            zero = np.array(below.origin_mm) + np.array(below.rotation) @ zero
            turned = product(below.rotation, turned) or turned
        x, y, z = zero.tolist()
        stays = retract == 0 and not new // 10 % 10
        plane = Plane((x, y, z), turned, int(values[12]), stays=stays)
        if values[12]:
            self._tilt(block, plane)
        else:
            self.pending = replace(plane, stays=True)

    def _swivelled(self, mode: int, angles: list[float], shown: str) -> Rows:
        """Return the axes of a plane by three angles of CYCLE800; ``shown``: the block."""
        order = "".join(_ORDER.get(mode >> shift & 3, "") for shift in (0, 2, 4))
        if mode == _SOLID_ANGLE and not angles[2]:
            return rotation_about("ZY", angles[:2])
        if mode >> 6 or len(order) != 3:
            expected = "rotations axis by axis (MODE 27, 30, 39, 45, 54, 57), or solid angles (MODE 64)"
            raise self.error("CYCLE800 of this kind", expected, shown)
        return rotation_about(order, angles)

    def _tilt(self, block: IsoBlock, plane: Plane) -> None:
        self.pending = None
        self.select(block, plane=plane)

    def _check_unshifted(self) -> None:
        """Raise `InputError` where the program has shifted or turned the coordinates: controls treat that differently."""
        if self.frame.shift or self.frame.turn:
            what = "tilted plane while the coordinates are shifted or turned"
            raise self.error(what, "the shift ended before (TRANS, G52, G92.1)")

    def _check_allowed(self, *, within: bool) -> None:
        """Raise `InputError` where no plane can be defined; ``within``: one may be in force."""
        self._check_unshifted()
        if self.tcp:
            raise self.error("tilted plane under tool centre point control", "tool centre point control off before it")
        if self.frame.plane is not None and not within:
            raise self.error("tilted plane within a tilted plane", "the first one cancelled (G69, CYCLE800()) before")


# --- Shifts and rotations: ``G92`` and ``G52``, ``G10 L2`` and ``L20``, the programmable frame of SINUMERIK (``TRANS``, ``ROT``)

PROGRAMMED: Final = frozenset({"TRANS", "ATRANS", "ROT", "AROT"})
"""Statements of SINUMERIK that shift or turn the coordinates."""
_GROUPS: Final = frozenset({"shift", "distance", "units", "plane", "feed"})
"""Groups of G words that a block with a shift may have."""
_OFFSETS: Final = ("G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3")
"""The work offset of each P word of ``G10 L2``, from 1 on."""
_BESIDE_OFFSET: Final = frozenset({"0", "1", "17", "18", "19", "20", "21", "40", "49", "69", "80", "90", "91", "94"})
"""G words without a P word of their own."""
_TURNED: Final = {17: 2, 18: 1, 19: 0}
Control = Literal["", "LinuxCNC", "Fanuc"]


class IsoShift(IsoTilt):
    """The shifts in force, and the values of work offsets that the program has set.

    ``control``: that whose words the program has used so far, where the meaning of a word depends on it; empty if it is unknown.
    """

    plane: int
    incremental: bool
    code: str
    cycle: Drilling | None
    control: Control = ""
    _present: tuple[float, ...] = ()
    _saved: tuple[float, ...] | None = None
    _shifted_by = ""
    _declared_start = False
    _programmed: tuple[tuple[float, ...], Rows | None] = (), None

    def __init__(self, source: str, axes: AxisWords, **how: Any) -> None:
        super().__init__(source, axes, **how)
        self._moved: dict[str, tuple[float, ...]] = {}
        self._turns: dict[str, Rows | None] = {}

    def shift_words(self, block: IsoBlock, groups: frozenset[str]) -> bool:
        """Apply G10, G52, G92 and the end of the latter, and take their words; return whether the block may have others."""
        code = next(span.name for span in block.codes if vocabulary.GROUP_OF[span.name] == "shift")
        what = f"G{code}"
        if code in ("92.1", "92.2") and not (block.items or any(self._present) or self._saved or self._declared_start):
            return True  # nothing to end
        if code == "92" and not block.items and {item.name for item in block.others} == {"S"}:
            return False  # highest spindle speed
        stray = [item for item in block.others if code != "10" or item.name not in "LPR"]
        if groups - _GROUPS or block.names or block.m_words or block.feed is not None or stray:
            raise self.error(f"{what} with other words", f"{what} and its axis words in a block of its own")
        self._check_shift(what)
        words = [self._declared(item) for item in block.items]
        given = {item.name: self.known_value(item.name, item.value, vocabulary.KNOWN_VALUE) for item in block.others}
        block.items, block.others = [], []
        if code == "10":
            self._set_offset(block, words, given)
        elif code in ("52", "92"):
            self._shift(block, code, words)
        elif words:
            raise self.error(f"{what} with axis words", f"{what} without them: controls differ")
        elif code == "92.3":
            if self._saved is None:
                raise self.error("G92.3 without a G92", "G92 with positions before it")
            self._present = self._saved
        else:
            self._end_shift(code)
        self._refresh(block)
        return False

    def _end_shift(self, code: str) -> None:
        """End G92 (``G92.1``, ``G92.2``); the coordinates before a first one at the start of the program are not known."""
        if self._declared_start:
            self.doubtful = f"{code} ends the G92 at the start: the coordinates before it are not known"
        self._saved = () if code == "92.1" else self._saved
        self._present = ()

    def _check_shift(self, what: str) -> None:
        """Raise `InputError` where a shift cannot be followed."""
        state = (
            (self.incremental and what in ("G10", "G52", "G92"), "in G91", "G90 before it"),
            (bool(self.code or self.cycle), "within a drilling cycle", "G80 before it"),
            (self.tcp, "under tool centre point control", "tool centre point control off before it"),
            (self.frame.plane is not None, "in a tilted plane", "G69 before it"),
            (any((*self._programmed,)), "after TRANS or ROT", "one of them"),
        )
        for found, where, expected in state:
            if found:
                raise self.error(f"{what} {where}", expected)

    def _declared(self, item: Item) -> AxisWord:
        axis = self.index[item.name]
        value = self.known_value(item.name, item.value, vocabulary.KNOWN_VALUE)
        value *= MM_PER_INCH if self.inch and axis < self.linear else 1.0
        return AxisWord(axis, item.start, item.end, item.value_start, item.value_end, "", False, value)

    def _shift(self, block: IsoBlock, code: str, words: list[AxisWord]) -> None:
        """Apply G92 or G52, which are one shift on LinuxCNC and two on Fanuc."""
        if any(self._present) and self._shifted_by != code:
            what = f"G{code} after G{self._shifted_by}"
            raise self.error(what, f"G{self._shifted_by} ended before it: controls differ")
        if not words:
            raise self.error(f"G{code} without axis words", f"axis words, such as G{code} X0")
        present = [*(self._present or self._zeros)]
        for word in words:
            if code == "92":
                present[word.axis] += self._start_position(block, word) - word.value
            else:
                present[word.axis] = word.value
        self._present = self._saved = tuple(present)
        self._shifted_by = code

    def _start_position(self, block: IsoBlock, word: AxisWord) -> float:
        """Return the position that G92 declares anew: where nothing has moved an axis or selected a work offset, that of the program.

        The operator has placed the machine there: the zero of the program is that of the set-up.
        """
        known = self.position[word.axis] == self.position[word.axis]
        if known or self.offset is not None or self.unknown or self.lost_positions:
            return self._present_position(block, word)
        self.note(
            "G92 states where the axes stand at the start: its zero is taken as that of the set-up (work offset)",
            once=True,
        )
        self._declared_start, self.position[word.axis] = True, word.value
        return word.value

    def _present_position(self, block: IsoBlock, word: AxisWord) -> float:
        """Return the position that a word declares anew; raise `InputError` if it is unknown."""
        at, name = self.position[word.axis], self.names[word.axis]
        if at != at or self.unknown:
            what = f"{self._block_text.split()[0]} declares the present position of {name}, which is unknown"
            raise self.error(what, f"a move to a position of {name} before it")
        block.declared.append((word, at))
        return at

    def _set_offset(self, block: IsoBlock, words: list[AxisWord], given: dict[str, float]) -> None:
        """Apply ``G10 L2 P.. R..``: values of a work offset; ``G10 L20 P..``: LinuxCNC, so that the present position has values."""
        kind, number, turn = given.get("L"), given.get("P", 0.0), given.get("R")
        if kind not in (2.0, 20.0):
            raise self.error("coordinate transformation G10", "G10 L2 with P and axis words")
        if number != int(number) or number < 1:
            raise self.error("G10 without the number of a work offset", "P1 to P9: for P0 controls differ", number)
        if kind == 20.0 and not (control := "Fanuc" if number > len(_OFFSETS) else self.control):
            what = "G10 L20 means the present position (LinuxCNC) or a further work offset (Fanuc)"
            raise self.error(what, "G10 L2, or a program with words of one of these controls before it")
        further = kind == 20.0 and control == "Fanuc"
        if number > len(_OFFSETS) and not further:
            raise self.error("G10 L2 with an unknown work offset", "P1 to P9", number)
        name = f"G54.1 P{int(number)}" if further else _OFFSETS[int(number) - 1]
        if kind == 2.0 or further:
            self.note(f"the program sets work offset {name}: its values replace those of the set-up", once=True)
            for one in (name, f"G154 P{int(number)}") if further else (name,):  # of Fanuc and of Haas
                self._state(one, words, turn)
            return
        if name != (self.offset or _OFFSETS[0]) or turn is not None or self.frame.turn is not None:
            expected = "the work offset in force, without rotation"
            raise self.error("G10 L20 for another work offset, or a turned one", expected, name)
        by = [*self._moved.get(name, self._zeros)]
        for word in words:
            by[word.axis] += self._present_position(block, word) - word.value
        self._moved[name] = tuple(by)

    def _state(self, name: str, words: list[AxisWord], turn: float | None) -> None:
        """Set values of a work offset, and its rotation about Z in degrees."""
        stated = [*self.stated_offsets.get(name, (None,) * len(self.names))]
        by = [*self._moved.get(name, self._zeros)]
        for word in words:
            stated[word.axis], by[word.axis] = word.value, 0.0
        self.stated_offsets[name], self._moved[name] = tuple(stated), tuple(by)
        if turn is not None and any(self._present):
            raise self.error("G10 L2 with R after G92", "G92.1 before it: LinuxCNC moves the axes then")
        if turn is not None:
            self._turns[name] = rotation_about("Z", [turn]) if turn else None

    @property
    def _zeros(self) -> tuple[float, ...]:
        return (0.0,) * len(self.names)

    def choose_offset(self, block: IsoBlock, code: str) -> None:
        """As `IsoFrame.choose_offset`, with the values that the program has set; ``G54 P3`` of Fanuc is ``G54.1 P3``."""
        others = {span.name for span in block.codes} - {"54"}
        own_p = not (self.code or others - _BESIDE_OFFSET) and any(item.name == "P" for item in block.others)
        if code == "54" and own_p:
            code = "54.1"
        if self.code:
            what = "another work offset within a drilling cycle: R, the depth and the initial level are read in it, as by LinuxCNC"
            self.note(what, once=True)
        super().choose_offset(block, code)
        self._refresh(block)

    def _refresh(self, block: IsoBlock) -> None:
        """Put the shifts in force into the frame."""
        name = self.offset or _OFFSETS[0]
        shift, turn = self._programmed
        if not (shift or turn):
            turn = self._turns.get(name)
            by = zip(self._moved.get(name, self._zeros), self._turned(turn), strict=True)
            shift = tuple(one + other for one, other in by)
        stated = self.stated_offsets.get(name, ())
        stated = stated if any(value is not None for value in stated) else ()
        self.reframe(
            block, carried=not any(self._programmed), stated=stated, shift=shift if any(shift) else (), turn=turn
        )

    def _turned(self, turn: Rows | None) -> list[float]:
        """Return the shift by G92 or G52, which is along the turned axes, along those of the machine."""
        return WordFrame(turn=turn).converted(self._present or self._zeros, WordFrame())

    # ------------------------------------------------------------------ SINUMERIK

    def program_frame(self, block: IsoBlock, name: str) -> None:
        """Apply ``TRANS``, ``ATRANS``, ``ROT``, ``AROT``, or the end of a transformation, and take their words from a block."""
        added = name.startswith("A")
        if not (block.items or block.others):
            self._program(block, (), None)
            return
        if block.codes or len(block.names) > 1 or block.m_words or block.feed is not None or self.cycle is not None:
            raise self.error(f"{name} with other words, or within a cycle", f"{name} in a block of its own")
        if any((*self._present, *self._moved, *self.stated_offsets)):
            raise self.error(f"{name} after G92, G52 or G10", "one of them")
        shift, turn = self._programmed if added else ((), None)
        if name.endswith("TRANS"):
            if block.others:
                raise self.error(f"{name} with other words", f"axis words behind {name}")
            values = list(self._zeros)
            for word in map(self._declared, block.items):
                values[word.axis] = word.value
            along = WordFrame(turn=turn).converted(values, WordFrame())
            shift = tuple(one + other for one, other in zip(shift or self._zeros, along, strict=True))
        else:
            turn = product(turn, self._rotation(block, name))
        block.items, block.others = [], []
        self._program(block, shift, turn)

    def _rotation(self, block: IsoBlock, name: str) -> Rows | None:
        angles: dict[str, float] = {}
        for item in (*block.items, *block.others):
            axis = _TURNED[self.plane] if item.name == "RPL" else self.index.get(item.name, self.linear)
            if axis >= self.linear:
                raise self.error(f"{name} with other words", f"angles X, Y, Z or RPL behind {name}", item.name)
            letter = "XYZ"[axis]
            angles[letter] = self.known_value(item.name, item.value, vocabulary.KNOWN_VALUE)
        turns = [(letter, angle) for letter, angle in angles.items() if angle]
        if len(turns) > 1 or len(angles) < len(block.items) + len(block.others):
            what = f"{name} about several axes"
            raise self.error(what, "one axis a block: their order depends on the control's setting")
        return rotation_about(turns[0][0], [turns[0][1]]) if turns else None

    def _program(self, block: IsoBlock, shift: tuple[float, ...], turn: Rows | None) -> None:
        shift = shift if any(shift) else ()
        if self.frame.plane is not None and any(shift[self.linear :]):
            raise self.error("shift of a rotary axis in a tilted plane", "shifts of the linear axes")
        ended = any(self._programmed)
        self._programmed = shift, turn
        if ended or shift or turn:
            self.reframe(block, carried=False, shift=shift, turn=turn)
