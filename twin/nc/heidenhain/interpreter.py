"""Modal interpreter of Heidenhain programs."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin.nc.blocks import Arc, AxisWords, Kind, Move, MoveColumns, Notice
from twin.nc.heidenhain import vocabulary
from twin.nc.heidenhain.modal import PLANES, HeidenhainFrame, PathBlock
from twin.nc.modal import SWITCHING_M, AxisWord, Span
from twin.nc.text import BLANK, MM_PER_INCH, number
from twin.nc.writer import Vector

LONGEST_TURN_DEG: Final = 180.5
"""Turn of a rotary axis up to which its shortest way is that of its words; a correction may turn half a turn a little further."""
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
        self._of_points, self._head = False, ""

    def step(self, line: int, text: str, known: Move | None = None) -> PathBlock:
        """Interpret one line; ``line``: its 0-based index, ``known``: its move, if it has been interpreted before."""
        found = self._found(line, text)
        return self._block(text) if found is None else self._simple_block(found, known)

    def checked(self, moves: MoveColumns, text_of: Callable[[int], str]) -> MoveColumns:
        """See `Interpreter.checked`: with ``M126`` a rotary axis may turn in the opposite direction. A rapid that does is noted.

        A feed that does is refused: the blocks that it is split into would turn the axis the long way.
        """
        moves = super().checked(moves, text_of)
        turned_to = self.turned_to
        if len(self._shortest_way) > 1:
            lines, on = (np.array(column) for column in zip(*self._shortest_way, strict=True))
            in_force = on[np.searchsorted(lines, moves.line, side="right") - 1]
            far = np.flatnonzero((np.abs(np.diff(turned_to, axis=0)) > LONGEST_TURN_DEG).any(axis=1) & in_force)
            for line in moves.line[far[~moves.rapid[far]]][:1].tolist():
                what = "a rotary axis turns by more than half a turn, or in the opposite direction (M126)"
                expected = "M127, or positions within half a turn of each other, such as C+370 after C+350"
                raise self.error(what, expected, text_of(line).strip(), line + 1)
            text = "M126: a rotary axis turns in the opposite direction on this rapid; its end point is the same"
            self.late_notices += [Notice(line, text) for line in moves.line[far].tolist()]
        return moves

    @property
    def runs_allowed(self) -> bool:
        """See `Interpreter.runs_allowed`: no tool vector, and no block that continues."""
        beside = self.beside or self.on_contour or self.pending or self._listing
        return self.set_up and self.vector is None and not (self.continued or self.modal or beside or self.end.word)

    def may_end(self, tail: str) -> bool:
        """See `Interpreter.may_end`: not while every positioning calls a cycle, or within a statement of several lines."""
        return not (self.modal or self.continued)

    def moves(self, line: int, text: str) -> tuple[Move, ...]:
        """See `Interpreter.moves`; as `step` does, without the words that only a writer needs."""
        if text in BLANK and not self.continued:
            return ()
        found = self._found(line, text)
        return self._block(text).moves if found is None else (self._simple_move(found, self._simple_words(found)),)

    def _found(self, line: int, text: str) -> re.Match[str] | None:
        """Begin a line and return its match if it is a simple block; only ``LN`` can have vectors."""
        self._line, self._block_text = line, text
        special = self.continued or self.modal or self.beside or self.on_contour
        special = special or self._listing or self.parks or self.pending is not None or bool(self.end.word)
        found = None if special else self._simple.pattern.fullmatch(text)
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
        if self.end.word:
            self._behind_end(block, body)
        elif self.continued:
            block.numbered = False
            self.continued = body.endswith("~")
            block.replaced, block.head = self.takes_pattern, self._head
            self._continue(block, body)
        elif body and body[0] not in ";*%" and not self.is_listing(body):
            self._body(block, body)
            if vocabulary.ENDING.match(body):
                self.end.reached("END PGM", self._line)
        return block

    def _continue(self, block: PathBlock, body: str) -> None:
        """Interpret a further line of a statement."""
        if self._of_points:
            self.take_points(body, begins=False)
            return
        self.take_parameters(body)
        self._assignments(body)
        self._complete(block)

    def _complete(self, block: PathBlock) -> None:
        """Execute what begins only with the last line of its definition: a preset, a pattern of holes."""
        self.end_preset(block)
        if not self.continued:
            self.end_pattern(block)

    def _behind_end(self, block: PathBlock, body: str) -> None:
        """Interpret a line behind the end of the program: a comment, the rest, ``END PGM``, or another program."""
        block.numbered = False
        if vocabulary.BEGINNING.match(body):
            self.end.begins(body)
        elif body and body[0] not in ";*%" and not vocabulary.ENDING.match(body):
            match = vocabulary.KEYWORD.match(body)
            keyword = "" if match is None else match.group().upper()
            paths = {"L", "LN"} | vocabulary.ARCS | vocabulary.POLAR
            self.behind_end(moves=keyword in paths or vocabulary.PARAXIAL.match(body) is not None)

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
        if not vocabulary.PARAMETER.match(body):
            self.close_definition()
        if vocabulary.BLOCK_OF_ISO.match(body):
            raise self.error("block of an ISO program", "blocks of plain language", body)
        if vocabulary.SKIPPED_END.fullmatch(body):
            self.note("block skip on the end of the program: assumed to be executed")
            return
        if vocabulary.SKIPPED.match(body):
            expected = "the blocks to execute without /, the others left out"
            what = "block skip: whether the block is executed depends on a switch of the control"
            raise self.error(what, expected, body)
        if vocabulary.PARAXIAL.match(body) or vocabulary.TECHNOLOGY.match(body):
            self._path(block, "", block.head_end)
        elif match is None:
            raise self.error("unknown block", "a plain-language block such as L X+10 FMAX", body)
        elif keyword in ("L", "LN") or keyword in vocabulary.ARCS | vocabulary.POLAR:
            self._path(block, keyword, block.head_end + match.end())
        elif keyword in ("APPR", "DEP") or keyword in vocabulary.ON_CONTOUR:
            self._left_to_control(block, keyword, body)
        elif keyword == "CC":
            self._pole(block, block.head_end + match.end())
        else:
            self.continued = body.endswith("~")
            self._block_text = body
            self._of_points = keyword == "PATTERN"
            self._statement(block, keyword, body)
            block.replaced |= self.takes_pattern
            self._head = block.indent
            self._complete(block)

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
            self.take_parameters(body)
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
            self.take_tool_axis(PLANES[axis.group(1).upper()])
        self.select_tool(block, body)

    def _call(self, block: PathBlock, body: str, upper: str) -> None:
        called = vocabulary.PROGRAM_CALL.match(body)
        if called is not None:
            name = called[1].strip()
            short = re.split(r"[\\/:]", name)[-1]
            self.call_outside(name, short, re.sub(r"\.h$", "", short, flags=re.IGNORECASE))
        elif upper.startswith(("CALL", "IF")):
            raise self.error("subprogram call or repetition", vocabulary.NO_CALLS)
        elif upper.startswith("SEL PATTERN"):
            self.take_points(upper, begins=True)

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

    def _cycle(self, block: PathBlock, body: str, upper: str) -> None:
        called = vocabulary.CYCLE_CALL.match(upper)
        if called is not None:
            self._call_here(block, upper[called.end() :])
            return
        match = vocabulary.CYCLE.match(body)
        if match is None:
            raise self.error("cycle without a number", "CYCL DEF and a number")
        cycle, part, rest = int(match.group(1)), match.group(2), match.group(3).split(";")[0].strip(" \t\r\n~")
        self.define(cycle, part, body)
        if cycle in vocabulary.RUN_AT_ONCE and not self.takes_pattern:
            raise self.error(f"cycle {cycle} is executed where it is defined", vocabulary.EXPANDED_CYCLE)
        if cycle in vocabulary.TRANSFORM_CYCLES and self.continued:
            what = f"CYCL DEF {cycle} over several lines"
            raise self.error(what, "its parts as blocks of their own, such as CYCL DEF 7.1 X+10")
        if cycle == 247:
            self.begin_preset()
        elif cycle in (7, 10) and part is not None and part != "0":
            (self.shift if cycle == 7 else self.turn)(block, rest, f"CYCL DEF {cycle}")
        elif cycle == 19 and part not in (None, "0"):
            self.working_plane(block, rest)
        elif cycle not in vocabulary.HARMLESS_CYCLES | vocabulary.TRANSFORM_CYCLES.keys() and not self.takes_pattern:
            self.lose(block, body)
        elif cycle in vocabulary.TRANSFORM_CYCLES and (
            part is None or (part != "0" and not vocabulary.cancels(cycle, rest))
        ):
            what = f"coordinate transformation CYCL DEF {cycle} ({vocabulary.TRANSFORM_CYCLES[cycle]})"
            raise self.error(what, vocabulary.NO_TRANSFORMATION)
        self._assignments(body)

    def _call_here(self, block: PathBlock, words: str) -> None:
        """Execute the cycle in force: ``CYCL CALL``, with M functions (``words``), ``CYCL CALL PAT``, or ``CYCL CALL POS``."""
        kind, *others = words.replace("F MAX", "FMAX").split() or [""]
        elsewhere = kind in ("PAT", "POS")
        axes = [match for match in map(vocabulary.PARAXIAL.fullmatch, others) if match] if kind == "POS" else []
        rest = [
            word for word in others if not (elsewhere and word in ("FMAX", "R0")) and word not in {m[0] for m in axes}
        ]
        if any(
            not vocabulary.HARMLESS_CALL.fullmatch(word) for word in (rest if elsewhere or not kind else [kind, *rest])
        ):
            raise self.error(
                "cycle call with other words",
                "CYCL CALL, PAT or POS X Y Z, FMAX and M functions of spindle and coolant",
            )
        if elsewhere and "FMAX" not in others:
            raise self.error(f"CYCL CALL {kind} at a feed", "FMAX")
        block.replaced = elsewhere
        block.positions = False
        if kind == "PAT":
            self.call_pattern(block)
        elif kind == "POS":
            self._call_at_position(block, {match[0][0]: match[0][1:] for match in axes})
        else:
            self.call_cycle(block)

    def _call_at_position(self, block: PathBlock, words: Mapping[str, str]) -> None:
        """Execute the cycle in force at a position; its word of the tool axis shifts the surface."""
        unit = MM_PER_INCH if self.inch else 1.0
        x, y, z = (self.names[axis].upper() for axis in self.plane)
        if words.keys() != {x, y, z}:
            raise self.error("CYCL CALL POS with other words", f"{x}, {y} and {z}")
        at = [self.known(name, words[name]) * unit for name in (x, y, z)]
        self.call_at(block, [(at[0], at[1], at[2])], "CYCL CALL POS", ())

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
            other = vocabulary.OTHER_TCPM.search(upper)
            if other is not None:
                raise self.error(f"FUNCTION TCPM with {other[0]}", "AXIS POS and REFPNT TIP-TIP, or neither")
            self.switch(block, True, "FUNCTION TCPM")
        elif upper.startswith(("FUNCTION TURNDATA", "FUNCTION MODE TURN", "FUNCTION CORRDATA", "FUNCTION PARAXMODE")):
            raise self.error("function that changes the meaning of axis words", vocabulary.NO_TRANSFORMATION)
        elif not upper.startswith(vocabulary.HARMLESS_FUNCTIONS):
            self.lose(block, body)

    # ------------------------------------------------------------------ words of paths

    def _left_to_control(self, block: PathBlock, keyword: str, body: str) -> None:
        """Apply a block whose path the control finds from the blocks beside it: ``APPR``, ``DEP``, ``RND``, ``CHF``, ``CT``."""
        if keyword in ("APPR", "DEP"):
            self._lead(block, body)
            return
        self.shape_corner(keyword, self._line, both=keyword != "CT")
        if keyword == "CT":
            block.leads = True
            self._path(block, "L", block.text.upper().index("CT", block.head_end) + 2)

    def _lead(self, block: PathBlock, body: str) -> None:
        """Apply ``APPR`` or ``DEP``, whose path the control finds: its end is corrected, if the block gives it."""
        match = vocabulary.LEAD.match(body)
        if match is None:
            raise self.error(
                f"path function {body.split()[0]}", "APPR or DEP with LT, LN, CT or LCT, or with PLT, PLN, PCT or PLCT"
            )
        at = block.head_end + match.end()
        words = vocabulary.LEAD_WORD.sub(lambda word: " " * len(word[0]), block.text[at:].split(";")[0])
        block.leads, arrives = True, match[1] is not None
        if not arrives:
            self.beside = False
        self.note("APPR and DEP are left to the control: their end is corrected where the block gives it", once=True)
        self._path(block, "LP" if match[2] or match[3] else "L", at, block.text[:at] + words)
        a, b, _ = self.plane
        given = bool(block.polar or block.axis_bits & (1 << a | 1 << b))
        if given is not (arrives or "LCT" in match[0].upper()):
            what = f"{match[0]} with or without its end"
            raise self.error(what, "the end with APPR and DEP LCT, none with DEP LT, LN and CT")
        if not given:
            self.on_contour = False
            self.mark_unknown(block, (a, b), moved=True)

    def _path(self, block: PathBlock, keyword: str, at: int, text: str = "") -> None:
        block.keyword, block.keyword_end = keyword, at
        for match in vocabulary.TOKEN.finditer(text or block.text, at):
            take = _TOKENS.get(match.lastgroup or "")
            if take is not None:
                take(self, block, match)
        for name, value, incremental in block.beside:
            self.take_auxiliary_axis(name, value, incremental=incremental, feeds=not block.rapid_text)
        if block.retracts:
            self.note("M140 retracts along the tool axis; the positions of the linear axes are unknown afterwards")
        arc = keyword in vocabulary.ARCS
        if block.words or block.vector_words or block.polar or (arc and block.clockwise is not None):
            self._move(block)
        elif arc:
            raise self.error("circular block without its sense", "DR+ or DR-")
        if block.calls or (self.modal and block.moves):
            block.positions = bool(block.moves)
            if block.machine or block.retracts or block.end_m_words or (self.modal and not block.moves):
                raise self.error("cycle call in this block", "M99, or M89 in a block with a position")
            self.call_cycle(block)
        if block.retracts:
            self.mark_unknown(block, range(self.linear), moved=True)

    def _axis(self, block: PathBlock, match: re.Match[str]) -> None:
        prefix, name, written = match.group(2, 3, 4)
        if name.upper() in self.auxiliary_axes.names:
            block.beside.append((name.upper(), self.known(name, written), bool(prefix)))
        else:
            self.add(block, self._axis_word(match))

    def _axis_word(self, match: re.Match[str]) -> AxisWord:
        prefix, name, written = match.group(2, 3, 4)
        axis = self.index.get(name.upper(), -1)
        if axis < 0:
            raise self.unknown_axis(match.group().strip())
        if self.pending is not None and axis >= self.linear and self._is_computed(name, written):
            return AxisWord(axis, match.start(2), match.end(), match.start(4), match.end(), "Q", bool(prefix), math.nan)
        value = self.known(name, written)
        if axis < self.linear and self.inch:
            value *= MM_PER_INCH
        return AxisWord(axis, match.start(2), match.end(), match.start(4), match.end(), "", bool(prefix), value)

    @staticmethod
    def _is_computed(name: str, written: str) -> bool:
        """Return whether the value of a rotary axis is the parameter that ``PLANE`` has set for it."""
        places = {"A": "120", "B": "121", "C": "122"}
        return written.replace(" ", "").lstrip("+").upper() == f"Q{places.get(name.upper(), '')}"

    def _feed(self, block: PathBlock, match: re.Match[str]) -> None:
        if match["feed"][-3:].upper() == "MAX":
            block.rapid_text = match["feed"]

    def _side(self, block: PathBlock, match: re.Match[str]) -> None:
        side = match["side"].upper()
        if side not in ("R0", "RL", "RR"):
            raise self.error(f"cutter radius compensation {side}", "RL or RR, or the tool centre path (R0)")
        self.beside = side != "R0"

    def _misc(self, block: PathBlock, match: re.Match[str]) -> None:
        code = int(match.group(match.lastindex + 1) if match.lastindex else 0)
        word = f"M{code}"
        if code in vocabulary.REFUSED_M:
            what = "function that changes the meaning of axis words"
            expected = vocabulary.EXPANDED_CYCLE if code != 118 else vocabulary.NO_TRANSFORMATION
            raise self.error(f"{what} {word}", expected)
        if code in vocabulary.CALLING_M:
            self.take_call_word(block, code, Span(match.start("misc"), match.end()))
            return
        if code in vocabulary.END_M:
            self.end.reached(word, self._line)
        if code in vocabulary.LAST_M:
            block.end_m_words.append(Span(match.start("misc"), match.end()))
        self.switch_by(block, word)
        if code in (126, 127):
            self._shortest_way.append((self._line, code == 126))
        if not (code in vocabulary.HARMLESS_M or word in self.tcp_on | self.tcp_off):
            known = [position for position in self.position[self.linear :] if position == position]
            turned = [position for position in known if not 0.0 <= position < 360.0]
            if code not in vocabulary.OF_HEIDENHAIN | SWITCHING_M:
                self.take_auxiliary(word)
            elif code != 94 or turned:
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

    def _polar(self, block: PathBlock, match: re.Match[str]) -> None:
        first = (match.lastindex or 0) + 1
        prefix, name, written = match.group(first, first + 1, first + 2)
        name = name.upper()
        if block.keyword not in vocabulary.POLAR or name in block.polar:
            raise self._stray(block, match)
        unit = MM_PER_INCH if self.inch and name == "R" else 1.0
        block.polar[name] = (self.known(f"P{name}", written) * unit, bool(prefix))
        block.polar_words.append(Span(match.start("polar"), match.end()))

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
        self.set_pole(found)

    def _apply_words_of_path(self, block: PathBlock) -> None:
        """Set the position from the axis words of a path; raise `InputError` for a sense outside an arc."""
        if block.arc_words and block.keyword not in vocabulary.ARCS:
            raise self.error("DR outside a circular block", "C, CP or CR")
        self.apply_words(block)

    def _check_helix(self, block: PathBlock, arc: Arc | None, start: list[float], *, whole: bool) -> None:
        """Raise `InputError` for an arc by ``CP`` that must stay whole but cannot be written as ``C``: a helix, or several turns."""
        if block.keyword != "CP" or arc is None:
            return
        axis = arc.plane[2]
        if abs(arc.angle_rad) > 2.0 * math.pi + 1e-9 or not abs(self.position[axis] - start[axis]) <= 1e-9:
            self.only_divided.add(self._line)
            if whole:
                raise self.error("cutter radius compensation on a helix by CP", "the tool centre path (R0)")

    def _only_places(self, block: PathBlock) -> bool:
        """Return whether a block is a rapid, or turns rotary axes alone without tool centre point control."""
        turns_only = not block.axis_bits & (1 << self.linear) - 1 and not self.tcp
        straight = block.keyword in ("L", "") and not (block.arc_words or self.vector)
        return straight and (turns_only or bool(block.rapid_text))

    def _move(self, block: PathBlock) -> None:
        kind = Kind.RAPID if block.rapid_text else Kind.LINEAR
        names = self.named(block.axis_bits)
        if not (block.machine or self.unknown) and self.stand_at_plane(block):
            return
        self.check_plane(block.axis_bits >> self.linear != 0 and self.pending is None, machine=block.machine)
        if block.machine:
            if block.keyword not in ("", "L"):
                raise self.error("machine coordinates in an arc", "an L block")
            self.leave_contour()
            position = self.machine_position(block, elsewhere=block.elsewhere)
            block.moves += (Move(self._line, kind, self.tcp, position, names, machine=True),)
            return
        if self.unknown:
            kind = Kind.ARC if block.keyword in vocabulary.ARCS else kind
            block.moves += (self.unknown_move(kind, block.axis_bits),)
            block.unknown_axes = tuple(range(len(self.names)))
            return
        if self.parks and self._only_places(block):
            block.moves += (self.parking_move(block),)
            return
        start, rotary = self.position[: self.linear], self.position[self.linear :]
        self._apply_words_of_path(block)
        sweep = self.polar_end(block, start) if block.keyword in vocabulary.POLAR else None
        normal = self._directed(block.axis_bits, block.tool, block.normal)
        arc: Arc | None = None
        if block.keyword in vocabulary.ARCS:
            kind = Kind.ARC
            plane = self.plane if block.keyword == "CR" else self.arc_plane
            if self.arc_from_unknown(block, start, plane[:2]):
                return
            arc = self.arc(block, start, sweep)
        self.use_set_up(kind)
        if block.polar:
            names |= {self.names[axis] for axis in self.arc_plane[:2]}
        whole = self.compensated(block, rotary)
        self._check_helix(block, arc, start, whole=whole)
        position = tuple(self.position)
        move = Move(self._line, kind, self.tcp, position, names, False, self.vector, normal, arc, "", whole)
        block.moves += (move,)


_TOKENS: Final[Mapping[str, Callable[[HeidenhainInterpreter, PathBlock, re.Match[str]], None]]] = {
    "axis": HeidenhainInterpreter._axis,
    "side": HeidenhainInterpreter._side,
    "feed": HeidenhainInterpreter._feed,
    "sense": HeidenhainInterpreter._sense,
    "radius": HeidenhainInterpreter._radius,
    "polar": HeidenhainInterpreter._polar,
    "vector": HeidenhainInterpreter._vector,
    "misc": HeidenhainInterpreter._misc,
    "bad": HeidenhainInterpreter._bad,
}
"""Handler of each kind of `vocabulary.TOKEN`; other kinds are ignored."""

_STATEMENTS: Final[Mapping[str, Callable[[HeidenhainInterpreter, PathBlock, str, str], None]]] = {
    "BEGIN": HeidenhainInterpreter._begin,
    "CALL": HeidenhainInterpreter._call,
    "CYCL": HeidenhainInterpreter._cycle,
    "CYCLE": HeidenhainInterpreter._cycle,
    "FN": HeidenhainInterpreter._fn,
    "FUNCTION": HeidenhainInterpreter._function,
    "IF": HeidenhainInterpreter._call,
    "PATTERN": lambda state, block, body, upper: state.take_points(upper, begins=True),
    "PLANE": lambda state, block, body, upper: state.tilt(block, upper),
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
