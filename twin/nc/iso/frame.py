"""Effects of ISO blocks on the frame: work offset, tool in the spindle, and the length that the control adds."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple, final

from twin.nc.arcs import FROM_START, CentreWords
from twin.nc.blocks import Plane, Rows, rotation_about
from twin.nc.iso import vocabulary
from twin.nc.iso.cycles import Drilling
from twin.nc.modal import Block, Interpreter, Span
from twin.nc.text import MM_PER_INCH


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
        names: statements and their arguments.
        motion_word: the G word of the motion group, if the block has one.
        feed: the value of the F word.
        motion: motion code in force (0 to 3), None before the first.
        inverse_time: whether the feed is an inverse time.
        centres: what I, J, K of an arc give.
        vector_names: names of the tool vector's words here, with their ``=``, or None if there is no vector.
        cycle_word: the range of a call or the end of a drilling cycle of SINUMERIK.
        cycle_words: words of a drilling cycle of Fanuc, which are not needed once it is expanded.
        drilling: the cycle that the block executes, at all its holes.
        drilling_axis: the linear axis that drills.
        approaches: whether its axis words name axes that go to a reference or fixed point of SINUMERIK.
        calls: whether the block executes a cycle of SINUMERIK at the present position.
        positions: whether the block moves the axes to the place of the hole before.
        repeats: number of holes that it drills, each by the increments of its words further than the one before.
        pattern: places of the holes of a pattern of SINUMERIK, by axis.
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

    def own_of(self, word: str) -> str:
        """Return the letters of the words here that belong to an M word; an angle to M19 only without axis words (``G2 X5 R7 M19``)."""
        own = "" if word == "M19" and self.items else vocabulary.OWN_OF_M.get(word, "")
        return "".join(item.name for item in self.others if item.name in own)


# --- Effects of ISO blocks on the frame: work offset, tool in the spindle, and the length that the control adds

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
        """Select a work offset by its G code.

        Raises:
            InputError: ``G58`` and ``G59`` that shift coordinates.
        """
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
        changes |= self._length(said, codes, tool)
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

    def _length(self, said: dict[str, Item], codes: set[str], tool: str) -> dict[str, str]:
        """Return the change of the length in force, empty if there is none."""
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
            return {
                "length": ""
                if edge == "0"
                else tool
                if edge == "1" and (tool or self.tools_known)
                else f"{tool} D{edge}"
            }
        return {}

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


# --- Tilted planes of ISO programs: ``G68.2`` with ``G53.1`` (Fanuc), ``CYCLE800`` (SINUMERIK) ----

_ORDER: Final = {1: "X", 2: "Y", 3: "Z"}
_PLANE_WORDS: Final = tuple("XYZIJKPQSTDHF")
_POSITIONING_WORDS: Final = tuple("PSTDHF")
"""Words of a block with G68.2, and with G53.1: those of the plane, and of spindle, tool and feed."""
TILTS: Final = frozenset(vocabulary.GROUPS["plane tilt"])
_DESELECTED: Final = (["0", '"0"'], ["0", '""'], ["", '"0"'])
"""Arguments of CYCLE800 that deselect the swivel data."""
_CHOICES: Final = {"0": 0, "1": 1, "2": -1}


class IsoTilt(IsoFrame):
    """The tilted plane in force, and one that is defined while the rotary axes are not yet positioned."""

    inch = False
    pending: Plane | None = None

    def tilt_words(self, block: IsoBlock) -> None:
        """Apply ``G68.2``, ``G53.1``, ``G53.6``, ``G69``, ``G254`` and ``G255``, and take their words from a block.

        Raises:
            InputError: another way to define a plane, a plane within a plane, or an unknown value.
        """
        codes = {span.name for span in block.codes}
        if not codes & TILTS:
            return
        words = _PLANE_WORDS if "68.2" in codes else _POSITIONING_WORDS
        stray = next((item for item in (*block.items, *block.others) if item.name not in words), None)
        if stray is not None and "69" not in codes:
            shown = block.text[stray.start : stray.end].strip()
            raise self.error("unknown word in a block with a tilted plane", f"no words but {' '.join(words)}", shown)
        if codes & {"69", "255"}:
            self.pending = None
            self._check_unshifted()
            self.select(block, plane=None)
            return
        if "68.2" in codes:
            self._check_allowed(block)
            values = {
                item.name: self._plane_value(item) for item in (*block.items, *block.others) if item.name in "XYZIJKPQ"
            }
            unit = MM_PER_INCH if self.inch else 1.0
            x, y, z = (values.get(letter, 0.0) * unit for letter in "XYZ")
            self.pending = Plane((x, y, z), self._turned_plane(values))
        elif "254" in codes:
            self._check_allowed(block)
            at = self.stands("G254")
            self._tilt(block, Plane((0.0, 0.0, 0.0), None, at_deg=at))
            self.position[self.linear :] = at
        else:
            word = "G53.1" if "53.1" in codes else "G53.6"
            if self.pending is None:
                raise self.error(f"{word} without a tilted plane", "G68.2 before it")
            choice = next((item.value.strip() for item in block.others if item.name == "P"), "0")
            if choice not in _CHOICES:
                raise self.error(f"{word} with an unknown P", "P0, P1 or P2", choice)
            self._tilt(block, replace(self.pending, choice=_CHOICES[choice], stays=word == "G53.1"))
        block.items, block.others = [], []

    def _turned_plane(self, values: dict[str, float]) -> Rows:
        """Return the axes of a plane by ``G68.2``: Euler angles, or with P1 an angle about X, Y or Z.

        Raises:
            InputError: another P, or several angles with P1: public descriptions differ in whether the axes turn with each other.
        """
        angles = [values.get(letter, 0.0) for letter in "IJK"]
        if not values.get("P"):
            if "Q" in values:
                raise self.error("G68.2 with Q", "Euler angles I, J, K (without P and Q)")
            return rotation_about("ZXZ", angles)
        if values["P"] != 1.0 or sum(map(bool, angles)) > 1:
            raise self.error(f"G68.2 with P{values['P']:g}", "Euler angles I, J, K (without P), or P1 with one angle")
        return rotation_about("XYZ", angles)

    def stand_at_plane(self, block: IsoBlock) -> bool:
        """Apply a pending plane where the program itself positions the rotary axes; return whether a block does nothing else.

        Args:
            block: a block that moves axes; one that names rotary axes only positions them, any other one finds them in position.

        Raises:
            InputError: it names both, an unknown position, or under tool centre point control.
        """
        plane, rotary = self.pending, [word for word in block.words if word.axis >= self.linear]
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
        """Apply ``CYCLE800(FR, TC, ST, MODE, X0, Y0, Z0, A, B, C, X1, Y1, Z1, DIR, …)``.

        Raises:
            InputError: a form of the cycle whose effect is not modelled.
        """
        texts = [part.strip() for part in arguments.strip()[1:-1].split(",")]
        if not any(texts) or texts in _DESELECTED:
            self.pending = None
            self._check_unshifted()
            self.select(block, plane=None)
            return
        self._check_allowed(block)
        shown = f"CYCLE800{arguments}"
        texts += [""] * (14 - len(texts))
        values = [self.value_of(text) if text else 0.0 for text in (texts[0], *texts[2:14])]
        if any(value != value for value in values):
            raise self.error("CYCLE800 with an unknown value", "numbers, or variables set to numbers before", shown)
        retract, new, mode = (int(value) for value in values[:3])
        order = "".join(_ORDER.get(mode >> shift & 3, "") for shift in (0, 2, 4))
        if mode >> 6 or len(order) != 3 or new % 10:
            expected = "rotations axis by axis (MODE 27, 39, 45, 54 or 57) of a new plane (ST 0)"
            raise self.error("CYCLE800 of this kind", expected, shown)
        if values[12] not in (-1.0, 0.0, 1.0):
            raise self.error("CYCLE800 with an unknown DIR", "DIR 1, -1 or 0", shown)
        unit = MM_PER_INCH if self.inch else 1.0
        turned = rotation_about(order, values[6:9])
        before, after = ([value * unit for value in values[i : i + 3]] for i in (3, 9))
        x, y, z = (
            before[i] + sum(part * value for part, value in zip(turned[i], after, strict=True)) for i in range(3)
        )
        plane = Plane((x, y, z), turned, int(values[12]), stays=retract == 0)
        if values[12]:
            self._tilt(block, plane)
        else:
            self.pending = replace(plane, stays=True)

    def _tilt(self, block: IsoBlock, plane: Plane) -> None:
        self.pending = None
        self.select(block, plane=plane)

    def _check_unshifted(self) -> None:
        """Raise `InputError` where the program has shifted or turned the coordinates: controls treat that differently."""
        if self.frame.shift or self.frame.turn:
            raise self.error(
                "tilted plane while the coordinates are shifted or turned", "the shift ended before (TRANS, G52, G92.1)"
            )

    def _check_allowed(self, block: IsoBlock) -> None:
        self._check_unshifted()
        if self.tcp:
            raise self.error("tilted plane under tool centre point control", "tool centre point control off before it")
        if self.frame.plane is not None:
            raise self.error("tilted plane within a tilted plane", "the first one cancelled (G69, CYCLE800()) before")

    def _plane_value(self, item: Item) -> float:
        return self.known_value(item.name, item.value, vocabulary.KNOWN_VALUE)
