"""Modal interpreter of Heidenhain programs."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin.nc.arcs import ArcMisfit, arc_by_centre, arc_by_radius
from twin.nc.blocks import Arc, AxisWords, Kind, Move, MoveColumns, Notice, Plane, Rows, rotation_about
from twin.nc.heidenhain import vocabulary
from twin.nc.heidenhain.calls import PathBlock
from twin.nc.modal import AxisWord, Block, Interpreter, Span
from twin.nc.text import BLANK, MM_PER_INCH, number
from twin.nc.writer import Vector

LONGEST_TURN_DEG: Final = 180.5
"""Turn of a rotary axis up to which its shortest way is that of its words; a correction may turn half a turn a little further."""
_PRESET: Final = "Q339"
_PLANES: Final = {"Z": (0, 1, 2), "Y": (2, 0, 1), "X": (1, 2, 0)}
_ANGLE: Final = re.compile(r"SP([ABC])[ \t]*([+-]?[ \t]*(?:[\d.,]+|Q[LR]?\d+))", re.ASCII | re.IGNORECASE)
_CHOICE: Final = re.compile(r"(?:SEQ|SYM)[ \t]*([+-])", re.ASCII | re.IGNORECASE)


class HeidenhainFrame(Interpreter):
    """Preset by cycle 247, tool by ``TOOL CALL``, tilted plane by ``PLANE SPATIAL``.

    Attributes:
        centre: the pole in force (``CC``), by axis.
        continued: whether the next line continues the current block (parameters of a cycle).
    """

    heidenhain = True
    continued = False
    plane = _PLANES["Z"]
    _selects_preset = False
    _shift_below: tuple[float, ...] = ()
    _turned_deg = 0.0
    centre: Mapping[int, float] = {}

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
        """Select the preset of a cycle 247 that is complete.

        Raises:
            InputError: its number is unknown.
        """
        if self._selects_preset and not self.continued:
            self._selects_preset = False
            self._shift_to(block, (), None)
            row = self.value_of(_PRESET)
            if not self.offsets_known and row != row:
                self.select_offset(block, f"preset of line {self._line + 1}")
                return
            if row != row or row != int(row):
                raise self.error("preset without a number", "Q339=+1 with the row of the preset table")
            self.select_offset(block, str(int(row)))

    def select_tool(self, block: PathBlock, body: str) -> None:
        """Put the tool of a ``TOOL CALL`` into the spindle.

        Raises:
            InputError: its number or ``DL`` is unknown.
        """
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
        """Apply ``PLANE SPATIAL`` or ``PLANE RESET``.

        Raises:
            InputError: another way to define a plane, or one that leaves the rotary axes to the program.
        """
        words = upper.split()
        if words[1:2] == ["RESET"]:
            if self.frame.plane is not None:
                if self.frame.shift or self.frame.turn:
                    raise self.error(
                        "end of a tilted plane while it is shifted or turned", "the shift cancelled before"
                    )
                self.select(block, plane=None, shift=self._shift_below)
            if "STAY" not in words:
                self.note("PLANE RESET may move the rotary axes; their positions are unknown afterwards")
                self.mark_unknown(block, range(self.linear, len(self.names)), moved=bool(self.frames))
            return
        if words[1:2] != ["SPATIAL"]:
            raise self.error("coordinate transformation PLANE", "PLANE SPATIAL with SPA, SPB and SPC")
        if self.tcp or self.frame.plane is not None:
            raise self.error("tilted plane within another", "M129 and PLANE RESET before it")
        if "STAY" in words or not {"TURN", "MOVE"} & set(words):
            raise self.error("PLANE SPATIAL that does not position the rotary axes", "TURN or MOVE")
        angles = {letter: self.known(f"SP{letter}", text) for letter, text in _ANGLE.findall(upper)}
        # About the fixed X, then Y, then Z: the same as about Z, then the turned Y, then the turned X.
        turned = rotation_about("ZYX", [angles.get(letter, 0.0) for letter in "CBA"])
        choice = _CHOICE.search(upper)
        sign = 0 if choice is None else 1 if choice.group(1) == "+" else -1
        stays = "TURN" in words and not any(word.startswith("MB") for word in words)
        self._shift_below = shift = self.frame.shift
        if self.frame.turn or any(shift[self.linear :]):
            raise self.error(
                "tilted plane in turned coordinates, or after a shift of a rotary axis", "these cancelled before"
            )
        x, y, z = shift[:3] or (0.0, 0.0, 0.0)
        self.select(block, plane=Plane((x, y, z), turned, sign, stays), shift=())

    def shift(self, block: PathBlock, words: str, what: str) -> None:
        """Shift the datum by axis words, each absolute or incremental (``IX``); the other axes keep their shift.

        Raises:
            InputError: other words, or a shift that cannot be followed.
        """
        shift = [*(self.frame.shift or (0.0,) * len(self.names))]
        found = list(vocabulary.SHIFT.finditer(words))
        if not found or vocabulary.SHIFT.sub("", words).strip():
            raise self.error(f"{what} without axis words", "axis words such as X+10 or IX+10", words.strip() or None)
        for match in found:
            axis = self.index.get(match[2].upper(), -1)
            if axis < 0:
                raise self.unknown_axis(match[0].strip())
            value = self.known(match[2], match[3]) * (MM_PER_INCH if self.inch and axis < self.linear else 1.0)
            shift[axis] = value + (shift[axis] if match[1] else 0.0)
        if self.frame.plane is not None and (self._shift_below or any(shift[self.linear :])):
            raise self.error(f"{what} in a tilted plane", "a shift of the linear axes, and none before the plane")
        if self.frame.turn and any(shift) and tuple(shift) != self.frame.shift:
            raise self.error(f"{what} in turned coordinates", "the rotation after the shift")
        self._shift_to(block, tuple(shift) if any(shift) else (), self.frame.turn)

    def turn(self, block: PathBlock, words: str, what: str) -> None:
        """Turn the coordinates in the working plane by ``ROT``, absolute or incremental.

        Raises:
            InputError: other words, or a rotation that cannot be followed.
        """
        match = vocabulary.ROTATION.fullmatch(words.strip())
        if match is None:
            raise self.error(f"{what} without an angle", "ROT+30", words.strip() or None)
        if self.plane != _PLANES["Z"]:
            raise self.error(f"{what} about another axis than Z", "tool axis Z")
        angle = self.known("ROT", match[2])
        self._turned_deg = angle + (self._turned_deg if match[1] else 0.0)
        self._shift_to(block, self.frame.shift, rotation_about("Z", [self._turned_deg]) if self._turned_deg else None)

    def _shift_to(self, block: PathBlock, shift: tuple[float, ...], turn: Rows | None) -> None:
        if turn is None:
            self._turned_deg = 0.0
        self.reframe(block, carried=False, shift=shift, turn=turn)

    def known(self, name: str, written: str) -> float:
        """Return the value of a word.

        Raises:
            InputError: it is unknown.
        """
        if "Q" in written.upper():
            return self.known_value(name, written, "a number, or a Q parameter set to a number before")
        value = self.value_of(written)
        if value != value:
            raise self.missing_number(name, written)
        return value


# --- Modal interpreter of Heidenhain programs -----------------------------------------------------

_new = tuple.__new__


@final
class HeidenhainInterpreter(HeidenhainFrame):
    """Interpreter of blocks in order, with their modal state."""

    def __init__(self, source: str, axes: AxisWords, *, tcp: bool) -> None:
        on = {"M128", *(word.upper() for word in axes.tcp_on)}
        off = {"M129", *(word.upper() for word in axes.tcp_off)}
        super().__init__(source, axes, tcp=tcp, tcp_on=on, tcp_off=off)
        self._simple = vocabulary.simple_pattern(self.names)
        self._shortest_way: list[tuple[int, bool]] = [(-1, False)]
        self._turned_to = np.full((1, len(self.names) - self.linear), np.nan)

    def step(self, line: int, text: str, known: Move | None = None) -> PathBlock:
        """Interpret one line.

        Args:
            line: 0-based index of the line.
            known: its move, if it has been interpreted before.

        Raises:
            InputError: with file, line and value.
        """
        found = self._found(line, text)
        return self._block(text) if found is None else self._simple_block(found, known)

    def checked(self, moves: MoveColumns, text_of: Callable[[int], str]) -> MoveColumns:
        """See `Interpreter.checked`: with ``M126`` a rotary axis may turn in the opposite direction. A rapid that does is noted.

        Raises:
            InputError: a feed that turns so: the blocks that it is split into would turn the axis the long way.
        """
        turned_to = np.concatenate([self._turned_to, moves.position[:, self.linear :]])
        self._turned_to = turned_to[-1:]
        if len(self._shortest_way) > 1:
            lines, on = (np.array(column) for column in zip(*self._shortest_way, strict=True))
            in_force = on[np.searchsorted(lines, moves.line, side="right") - 1]
            far = np.flatnonzero((np.abs(np.diff(turned_to, axis=0)) > LONGEST_TURN_DEG).any(axis=1) & in_force)
            for line in moves.line[far[~moves.rapid[far]]][:1].tolist():
                raise self.error(
                    "a rotary axis turns by more than half a turn, or in the opposite direction (M126)",
                    "M127, or positions within half a turn of each other, such as C+370 after C+350",
                    text_of(line).strip(),
                    line + 1,
                )
            text = "M126: a rotary axis turns in the opposite direction on this rapid; its end point is the same"
            self.late_notices += [Notice(line, text) for line in moves.line[far].tolist()]
        return moves

    @property
    def runs_allowed(self) -> bool:
        """See `Interpreter.runs_allowed`: no tool vector, and no block that continues."""
        return self.set_up and self.vector is None and not self.continued

    def moves(self, line: int, text: str) -> tuple[Move, ...]:
        """See `Interpreter.moves`; as `step` does, without the words that only a writer needs."""
        if text in BLANK and not self.continued:
            return ()
        found = self._found(line, text)
        return self._block(text).moves if found is None else (self._simple_move(found, self._simple_words(found)),)

    def _found(self, line: int, text: str) -> re.Match[str] | None:
        """Begin a line and return its match if it is a simple block; only ``LN`` can have vectors."""
        self._line, self._block_text = line, text
        found = None if self.continued or self.parks else self._simple.pattern.fullmatch(text)
        if found is not None and found[2] in ("L", "l") and any(found.groups()[self._simple.behind]):
            return None
        return found

    def _block(self, text: str) -> PathBlock:
        """Interpret a line that is not a simple block."""
        head = vocabulary.HEAD.match(text)
        begin = head.end() if head else 0
        block = PathBlock(text, begin, self.inch, numbered=head is not None and head.group(1) is not None)
        block.keyword_end = begin
        body = text[begin:].strip(" \t\r\n\f\x1a")
        if self.continued:
            block.numbered = False
            self.continued = body.endswith("~")
            self._assignments(body)
            self.end_preset(block)
        elif body and body[0] not in ";*%":
            self._body(block, body)
        return block

    def _simple_block(self, match: re.Match[str], known: Move | None) -> PathBlock:
        """Interpret a simple block from the groups of its pattern."""
        text, spans = match.string, match.regs
        start, end = spans[2]
        move = self._simple_move(match, self._simple_words(match)) if known is None else known
        if known is not None:
            self.use_set_up(move.kind)
        self.position, self.vector = list(move.position), move.vector
        block = PathBlock(text, start, self.inch, moves=(move,), numbered=spans[1][1] >= 0)
        if move.unknown:
            block.unknown_axes = tuple(range(len(self.names)))
        words, position = block.words, move.position
        for group, axis in self._simple.axes:
            at, to = spans[group]
            if to >= 0:
                block.axis_bits |= 1 << axis
                words.append(_new(AxisWord, (axis, at - 1, to, at, to, "", False, position[axis])))
        block.keyword, block.keyword_end = text[start:end].upper(), end
        block.rapid_text = _rapid(match)
        for place, (group, name) in enumerate(self._simple.others if end - start > 1 else ()):
            at, to = spans[group]
            if to >= 0 and place < 3:
                block.normal_text.append(text[at - 2 : to])
            elif to >= 0:
                block.vector_words[place - 3] = Span(at, to, name)
        return block

    def _simple_words(self, match: re.Match[str]) -> int:
        """Set the position from the axis words of a simple block and return their axes as bits."""
        unit, linear, position = MM_PER_INCH if self.inch else 1.0, self.linear, self.position
        axis_bits = 0
        for (_, axis), written in zip(self._simple.axes, match.groups()[2:], strict=False):
            if written is not None:
                value = number(written) if "," in written else float(written)
                position[axis] = value * unit if axis < linear else value
                axis_bits |= 1 << axis
        return axis_bits

    def _simple_move(self, match: re.Match[str], axis_bits: int) -> Move:
        """Return the move of a simple block after its axis words have been applied."""
        normal = tool = None
        if len(match[2]) > 1:
            values = match.groups()[self._simple.behind]
            parts = values[:3], values[3:]
            normal, tool = ([number(text or "0") for text in part] if any(part) else None for part in parts)
        self.check_plane(axis_bits >> self.linear != 0)
        kind = Kind.RAPID if _rapid(match) else Kind.LINEAR
        if self.unknown:
            return self.unknown_move(kind, axis_bits)
        unit_normal = self._directed(axis_bits, tool, normal)
        self.use_set_up(kind)
        position = tuple(self.position)
        return Move(self._line, kind, self.tcp, position, self.named(axis_bits), False, self.vector, unit_normal)

    def _directed(self, axis_bits: int, tool: list[float] | None, normal: list[float] | None) -> Vector | None:
        """Set the tool vector from a block that names some axes (bits) and return its surface normal at unit length."""
        if tool is not None:
            vector = self.unit_direction("tool vector", tool)
            if not self.tcp:
                what = "tool vector while tool centre point control is off"
                raise self.error(what, "M128 or FUNCTION TCPM before it")
            self.set_tool_vector(axis_bits, vector)
        elif axis_bits >> self.linear:
            self.vector = None
        return None if normal is None else self.unit_direction("surface normal", normal)

    def _body(self, block: PathBlock, body: str) -> None:
        match = vocabulary.KEYWORD.match(body)
        keyword = "" if match is None else match.group().upper()
        if vocabulary.BLOCK_OF_ISO.match(body):
            raise self.error("block of an ISO program", "blocks of plain language", body)
        if vocabulary.SKIPPED.match(body):
            expected = "the blocks to execute without /, the others left out"
            raise self.error(
                "block skip: whether the block is executed depends on a switch of the control", expected, body
            )
        if vocabulary.PARAXIAL.match(body) or (keyword[:1] == "M" and len(keyword) <= 2):
            self._path(block, "", block.head_end)
        elif match is None:
            raise self.error("unknown block", "a plain-language block such as L X+10 FMAX", body)
        elif keyword in ("L", "LN", "C", "CR"):
            self._path(block, keyword, block.head_end + match.end())
        elif keyword == "CC":
            self._pole(block, block.head_end + match.end())
        else:
            self.continued = body.endswith("~")
            self._block_text = body
            self._statement(block, keyword, body)
            self.end_preset(block)

    # ------------------------------------------------------------------ statements

    def _statement(self, block: PathBlock, keyword: str, body: str) -> None:
        upper = " ".join(body.split(";")[0].upper().split())
        if keyword in vocabulary.REFUSED_PATHS:
            raise self.error(f"path function {keyword}", vocabulary.LINEAR)
        if keyword in vocabulary.WITH_NUMBERS:
            exponent = vocabulary.EXPONENT.search(vocabulary.QUOTED.sub("", body.split(";")[0]))
            if exponent is not None:
                raise self.error("number with an exponent", "a number such as 0.001", exponent.group())
        if keyword in _STATEMENTS:
            _STATEMENTS[keyword](self, block, body, upper)
        elif vocabulary.PARAMETER.match(body):
            self._assignments(body)
        elif keyword in self.index or (keyword[:1] == "I" and keyword[1:] in self.index):
            raise self.error("word without a number", f"a number after {keyword}")
        elif keyword not in vocabulary.PASSED and not upper.startswith("TABDATA READ"):
            self.lose(block, body)

    def _begin(self, block: PathBlock, body: str, upper: str) -> None:
        unit = vocabulary.UNIT.match(body)
        if unit is None or unit.group(1).upper() not in {"MM"} | vocabulary.INCHES:
            raise self.error("unknown unit", "BEGIN PGM name MM or INCH")
        self.inch = unit.group(1).upper() in vocabulary.INCHES

    def _tool(self, block: PathBlock, body: str, upper: str) -> None:
        if "CALL" not in upper:
            if not upper.startswith("TOOL DEF"):
                self.lose(block, body)
            return
        axis = vocabulary.TOOL_AXIS.match(body)
        if axis is not None:
            self.plane = _PLANES[axis.group(1).upper()]
        self.select_tool(block, body)

    def _call(self, block: PathBlock, body: str, upper: str) -> None:
        if upper.startswith(("CALL", "IF")):
            raise self.error("subprogram call or repetition", vocabulary.NO_CALLS)

    def _transform(self, block: PathBlock, body: str, upper: str) -> None:
        words = upper.split()
        rest = upper.partition(" AXIS ")[2] if words[1:3] == ["DATUM", "AXIS"] else upper.partition(" ROTATION ")[2]
        if words[:3] == ["TRANS", "DATUM", "RESET"]:
            self._shift_to(block, (), self.frame.turn)
        elif words[:3] == ["TRANS", "ROTATION", "RESET"]:
            self._shift_to(block, self.frame.shift, None)
        elif words[:3] == ["TRANS", "DATUM", "AXIS"]:
            self.shift(block, rest, "TRANS DATUM")
        elif words[:2] == ["TRANS", "ROTATION"]:
            self.turn(block, rest, "TRANS ROTATION")
        elif "RESET" not in upper:
            name = "POLARKIN" if upper.startswith("POLARKIN") else "TRANS"
            raise self.error(f"coordinate transformation {name}", vocabulary.NO_TRANSFORMATION)

    def _tilt(self, block: PathBlock, body: str, upper: str) -> None:
        self.tilt(block, upper)

    def _cycle(self, block: PathBlock, body: str, upper: str) -> None:
        if upper.startswith("CYCL CALL"):
            raise self.error("cycle call", vocabulary.EXPANDED_CYCLE)
        match = vocabulary.CYCLE.match(body)
        if match is None:
            raise self.error("cycle without a number", "CYCL DEF and a number")
        cycle, part, rest = int(match.group(1)), match.group(2), match.group(3).split(";")[0].strip(" \t\r\n~")
        if cycle in vocabulary.RUN_AT_ONCE:
            raise self.error(f"cycle {cycle} is executed where it is defined", vocabulary.EXPANDED_CYCLE)
        if cycle in vocabulary.TRANSFORM_CYCLES and self.continued:
            raise self.error(
                f"CYCL DEF {cycle} over several lines", "its parts as blocks of their own, such as CYCL DEF 7.1 X+10"
            )
        if cycle == 247:
            self.begin_preset()
        elif cycle in (7, 10) and part is not None and part != "0":
            (self.shift if cycle == 7 else self.turn)(block, rest, f"CYCL DEF {cycle}")
        elif cycle not in vocabulary.HARMLESS_CYCLES and cycle not in vocabulary.TRANSFORM_CYCLES:
            self.lose(block, body)
        elif cycle in vocabulary.TRANSFORM_CYCLES and (
            part is None or (part != "0" and not vocabulary.cancels(cycle, rest))
        ):
            what = f"coordinate transformation CYCL DEF {cycle} ({vocabulary.TRANSFORM_CYCLES[cycle]})"
            raise self.error(what, vocabulary.NO_TRANSFORMATION)
        self._assignments(body)

    def _fn(self, block: PathBlock, body: str, upper: str) -> None:
        match = vocabulary.FN.match(body)
        if match is None:
            raise self.error("parameter function without a number", "FN 0: Q1 = +5")
        if 9 <= int(match.group(1)) <= 12:
            raise self.error("control flow", vocabulary.NO_CALLS)
        if int(match.group(1)) not in vocabulary.HARMLESS_FN:
            self.lose(block, body)
        self._assignments(match.group(2))

    def _assignments(self, body: str) -> None:
        for name, text in vocabulary.ASSIGNED.findall(body):
            self.assign(name, self.value_of(text.strip()))

    def _function(self, block: PathBlock, body: str, upper: str) -> None:
        if upper.startswith("FUNCTION RESET TCPM"):
            self.switch(block, False, "FUNCTION RESET TCPM")
        elif upper.startswith("FUNCTION TCPM"):
            self.switch(block, True, "FUNCTION TCPM")
        elif upper.startswith(("FUNCTION TURNDATA", "FUNCTION MODE TURN", "FUNCTION CORRDATA", "FUNCTION PARAXMODE")):
            raise self.error("function that changes the meaning of axis words", vocabulary.NO_TRANSFORMATION)
        elif not upper.startswith(vocabulary.HARMLESS_FUNCTIONS):
            self.lose(block, body)

    # ------------------------------------------------------------------ words of paths

    def _path(self, block: PathBlock, keyword: str, at: int) -> None:
        block.keyword, block.keyword_end = keyword, at
        for match in vocabulary.TOKEN.finditer(block.text, at):
            take = _TOKENS.get(match.lastgroup or "")
            if take is not None:
                take(self, block, match)
        if block.retracts:
            self.note("M140 retracts along the tool axis; the positions of the linear axes are unknown afterwards")
        if block.words or block.vector_words or (keyword in ("C", "CR") and block.clockwise is not None):
            self._move(block)
        elif keyword in ("C", "CR"):
            raise self.error("circular block without its sense", "DR+ or DR-")
        if block.retracts:
            self.mark_unknown(block, range(self.linear), moved=True)

    def _axis_word(self, match: re.Match[str]) -> AxisWord:
        prefix, name, written = match.group(2, 3, 4)
        axis = self.index.get(name.upper(), -1)
        if axis < 0:
            raise self.unknown_axis(match.group().strip())
        value = self.known(name, written)
        if axis < self.linear and self.inch:
            value *= MM_PER_INCH
        return AxisWord(axis, match.start(2), match.end(), match.start(4), match.end(), "", bool(prefix), value)

    def _axis(self, block: PathBlock, match: re.Match[str]) -> None:
        self.add(block, self._axis_word(match))

    def _feed(self, block: PathBlock, match: re.Match[str]) -> None:
        if match["feed"][-3:].upper() == "MAX":
            block.rapid_text = match["feed"]

    def _side(self, block: PathBlock, match: re.Match[str]) -> None:
        if match["side"].upper() != "R0":
            raise self.error(f"cutter radius compensation {match['side']}", "the tool centre path (R0)")

    def _misc(self, block: PathBlock, match: re.Match[str]) -> None:
        code = int(match.group(match.lastindex + 1) if match.lastindex else 0)
        word = f"M{code}"
        if code in vocabulary.REFUSED_M:
            what = "cycle call" if code in (89, 99) else "function that changes the meaning of axis words"
            raise self.error(
                f"{what} {word}", vocabulary.EXPANDED_CYCLE if code != 118 else vocabulary.NO_TRANSFORMATION
            )
        if code in vocabulary.LAST_M:
            block.end_m_words.append(Span(match.start("misc"), match.end()))
        self.switch_by(block, word)
        if code in (126, 127):
            self._shortest_way.append((self._line, code == 126))
        if not (code in vocabulary.HARMLESS_M or word in self.tcp_on | self.tcp_off):
            turned = [position for position in self.position[self.linear :] if not 0.0 <= position < 360.0]
            if code != 94 or turned:
                self.lose(block, match["misc"])
        block.machine |= code in (91, 92)
        block.elsewhere |= code == 92
        block.retracts |= code == 140

    def _sense(self, block: PathBlock, match: re.Match[str]) -> None:
        block.clockwise = match["sense"].endswith("-")
        block.arc_words.append(Span(match.start("sense"), match.end()))

    def _radius(self, block: PathBlock, match: re.Match[str]) -> None:
        if block.keyword != "CR":
            raise self._stray(block, match)
        written = match.group(match.lastindex + 1) if match.lastindex else ""
        block.radius = self.known("R", written) * (MM_PER_INCH if self.inch else 1.0)
        block.arc_words.append(Span(match.start("radius"), match.end()))

    def _vector(self, block: PathBlock, match: re.Match[str]) -> None:
        if block.keyword != "LN" or not match.lastindex:
            raise self._stray(block, match)
        name, written = match.group(match.lastindex + 1, match.lastindex + 2)
        value = self.known(name, written)
        index = "XYZ".index(name[1].upper())
        if name[0] in "tT":
            if index in block.vector_words:
                raise self.error(f"{name} twice in one block", "each word once")
            block.tool = block.tool or [0.0, 0.0, 0.0]
            block.tool[index] = value
            block.vector_words[index] = Span(match.end() - len(written), match.end(), name)
        else:
            block.normal = block.normal or [0.0, 0.0, 0.0]
            block.normal[index] = value
            block.normal_text.append(match["vector"])

    def _bad(self, block: PathBlock, match: re.Match[str]) -> None:
        raise self._stray(block, match)

    def _stray(self, block: PathBlock, match: re.Match[str]) -> InputError:
        shown = block.text[match.start(match.lastgroup or 0) :].split(";")[0].strip()
        letter = shown[:1].upper()
        if letter in self.index or letter in "FMRI":
            return self.error(f"{letter} has no number", f"a number after {letter}", shown)
        if letter in "XYZABCUVW":
            return self.unknown_axis(shown)
        return self.error("unknown word", "axis words, R0, F and M", shown)

    # ------------------------------------------------------------------ moves

    def _pole(self, block: PathBlock, at: int) -> None:
        found: dict[int, float] = {}
        for match in vocabulary.TOKEN.finditer(block.text, at):
            if match.lastgroup == "note":
                continue
            if match.lastgroup != "axis":
                raise self._stray(block, match)
            if self.index.get(match.group(3).upper(), self.linear) >= self.linear:
                raise self.unknown_axis(match.group().strip())
            word = self._axis_word(match)
            found[word.axis] = word.value + (self.position[word.axis] if word.incremental else 0.0)
        if found:
            self.centre = {**self.centre, **found}
        else:
            self.centre = dict(enumerate(self.position[: self.linear]))

    def _move(self, block: PathBlock) -> None:
        kind = Kind.RAPID if block.rapid_text else Kind.LINEAR
        names = self.named(block.axis_bits)
        self.check_plane(block.axis_bits >> self.linear != 0)
        if block.machine:
            if block.keyword in ("C", "CR", "LN"):
                raise self.error("machine coordinates in an arc", "an L block")
            position = self.machine_position(block, elsewhere=block.elsewhere)
            block.moves += (Move(self._line, kind, self.tcp, position, names, machine=True),)
            return
        if self.unknown:
            kind = Kind.ARC if block.keyword in ("C", "CR") else kind
            block.moves += (self.unknown_move(kind, block.axis_bits),)
            block.unknown_axes = tuple(range(len(self.names)))
            return
        if self.parks and kind is Kind.RAPID and block.keyword in ("L", "") and not (block.arc_words or self.vector):
            block.moves += (self.parking_move(block),)
            return
        start = self.position[: self.linear]
        self.apply_words(block)
        normal = self._directed(block.axis_bits, block.tool, block.normal)
        arc: Arc | None = None
        if block.keyword in ("C", "CR"):
            kind = Kind.ARC
            arc = self._arc(block, start)
        elif block.arc_words:
            raise self.error("DR outside a circular block", "C or CR")
        self.use_set_up(kind)
        position = tuple(self.position)
        block.moves += (Move(self._line, kind, self.tcp, position, names, False, self.vector, normal, arc),)

    def _arc(self, block: PathBlock, start: list[float]) -> Arc:
        if block.clockwise is None:
            raise self.error("circular block without its sense", "DR+ or DR-")
        a, b, _ = self.plane
        from_, to = (start[a], start[b]), (self.position[a], self.position[b])
        if block.keyword == "CR":
            if block.radius is None:
                raise self.error("CR without a radius", "R+10 or R-10")
            return self.valid_arc(arc_by_radius(self.plane, from_, to, block.radius, block.clockwise))
        if a in self.centre and b in self.centre:
            centre = (self.centre[a], self.centre[b])
            return self.valid_arc(arc_by_centre(self.plane, from_, to, centre, block.clockwise))
        return self.valid_arc(ArcMisfit("circular block without its centre", "CC before it"))


_TOKENS: Final[Mapping[str, Callable[[HeidenhainInterpreter, PathBlock, re.Match[str]], None]]] = {
    "axis": HeidenhainInterpreter._axis,
    "side": HeidenhainInterpreter._side,
    "feed": HeidenhainInterpreter._feed,
    "sense": HeidenhainInterpreter._sense,
    "radius": HeidenhainInterpreter._radius,
    "vector": HeidenhainInterpreter._vector,
    "misc": HeidenhainInterpreter._misc,
    "bad": HeidenhainInterpreter._bad,
}
"""Handler of each kind of `vocabulary.TOKEN`; other kinds are ignored."""

_STATEMENTS: Final[Mapping[str, Callable[[HeidenhainInterpreter, PathBlock, str, str], None]]] = {
    "BEGIN": HeidenhainInterpreter._begin,
    "CALL": HeidenhainInterpreter._call,
    "CYCL": HeidenhainInterpreter._cycle,
    "FN": HeidenhainInterpreter._fn,
    "FUNCTION": HeidenhainInterpreter._function,
    "IF": HeidenhainInterpreter._call,
    "PLANE": HeidenhainInterpreter._tilt,
    "POLARKIN": HeidenhainInterpreter._transform,
    "SEL": HeidenhainInterpreter._call,
    "TOOL": HeidenhainInterpreter._tool,
    "TRANS": HeidenhainInterpreter._transform,
}
"""Handler of each statement, by its first word."""


def _rapid(match: re.Match[str]) -> str:
    """Return ``FMAX`` of a simple block as written, or an empty text."""
    feed = match[match.re.groups]
    return feed if feed is not None and feed[-1] in "xX" else ""
