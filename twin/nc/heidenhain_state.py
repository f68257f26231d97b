"""The interpreter of Heidenhain plain language: blocks in, what each says in full out."""

from __future__ import annotations

import math
import re
from typing import final

from twin._common.errors import InputError
from twin.nc import heidenhain_words as vocabulary
from twin.nc.arcs import Misfit, arc_by_centre, arc_by_radius
from twin.nc.blocks import Arc, AxisWords, Kind, Move
from twin.nc.iso_block import AxisWord, Span
from twin.nc.modal import Modal
from twin.nc.plain import plain_language
from twin.nc.text import MM_PER_INCH, number

_PLANES = {"Z": (0, 1, 2), "Y": (2, 0, 1), "X": (1, 2, 0)}
_COMPONENT = {"TX": 0, "TY": 1, "TZ": 2}
_NORMAL = {"NX": 0, "NY": 1, "NZ": 2}


@final
class PathBlock:
    """One block of plain language, understood.

    Attributes:
        text: the line's text.
        head: where the block begins, after its number.
        numbered: whether it has a number.
        continued: whether it continues the line before (a cycle's parameters).
        keyword: ``L``, ``LN``, ``C``, ``CR``, or ``""`` for a paraxial block.
        keyword_end: where the keyword ends.
        words: axis words.
        vector_words: places of ``TX TY TZ`` by index (values).
        normal_text: the words ``NX NY NZ`` as written.
        arc_words: sense and radius of an arc.
        rapid_text: ``FMAX`` as written, or nothing.
        last_m: M words that act at the end of the block.
        inch: whether the program is in inches.
        move: the move it makes.
        forgets: axes nobody knows the position of afterwards.
        switched: whether the control's kinematics were switched.
    """

    __slots__ = (
        "arc_words",
        "continued",
        "forgets",
        "head",
        "inch",
        "keyword",
        "keyword_end",
        "last_m",
        "move",
        "normal_text",
        "numbered",
        "rapid_text",
        "switched",
        "text",
        "vector_words",
        "words",
    )

    def __init__(self, text: str, head: int, numbered: bool, inch: bool) -> None:
        self.text = text
        self.head = head
        self.numbered = numbered
        self.continued = False
        self.keyword = ""
        self.keyword_end = head
        self.words: list[AxisWord] = []
        self.vector_words: dict[int, Span] = {}
        self.normal_text: list[str] = []
        self.arc_words: list[Span] = []
        self.rapid_text = ""
        self.last_m: list[Span] = []
        self.inch = inch
        self.move: Move | None = None
        self.forgets: tuple[int, ...] = ()
        self.switched = False


@final
class Interpreter(Modal):
    """Reads blocks in order, keeping what is modal."""

    def __init__(self, source: str, axes: AxisWords, *, tcp: bool) -> None:
        super().__init__(source, axes, tcp=tcp)
        self.tcp_given = tcp
        self.tcp_on = {"M128", "TCPM", *(word.upper() for word in axes.tcp_on)}
        self.tcp_off = {"M129", "RESET TCPM", *(word.upper() for word in axes.tcp_off)}
        self.inch = False
        self.plane = _PLANES["Z"]
        self.centre: dict[int, float] = {}
        self.variables: dict[str, float] = {}
        self.continued = False
        self._plain = plain_language(self.names)

    def plain(self, line: int, match: re.Match[str]) -> Move | None:
        """The move of a plain block, as `step` reads it; None (and nothing done) where only `step` will do.

        Args:
            line: 0-based index of its line.
            match: of `plain_language`.
        """
        if self.continued:
            return None
        axes = self._plain.axes
        groups = match.groups()
        first = len(axes) + 2
        last = match.lastindex or 0
        others = groups[first - 1 : -1] if last >= first else ()
        if any(others) and groups[0][-1] not in "nN":
            return None
        seen = self.plain_words(groups[1:], axes, False, MM_PER_INCH if self.inch else 1.0)
        if seen >> self.linear:
            self.vector = None
        normal: tuple[float, float, float] | None = None
        if any(others):
            self._line = line
            shown = match.string.strip()
            if any(others[3:]):
                self._turn_to([number(text or "0") for text in others[3:]], seen, shown)
            if any(others[:3]):
                normal = self.direction("surface normal", [number(text or "0") for text in others[:3]], shown)
        feed = groups[-1]
        kind = Kind.RAPID if feed is not None and feed[-1] in "xX" else Kind.LINEAR
        return Move(line, kind, self.tcp, tuple(self.position), self.named(seen), False, self.vector, normal)

    def follow(self, move: Move) -> bool:
        """Be where a plain block's move, read before, has led; whether that can be."""
        if self.continued:
            return False
        self.position = list(move.position)
        self.vector = move.vector
        return True

    def step(self, line: int, text: str) -> PathBlock:
        """Interpret one line.

        Args:
            line: 0-based index of the line.
            text: its text.

        Raises:
            InputError: with file, line and value.
        """
        self._line = line
        head = vocabulary.HEAD.match(text)
        begin = head.end() if head else 0
        block = PathBlock(text, begin, head is not None and head.group(1) is not None, self.inch)
        body = text[begin:].strip(" \t\r\n\f\x1a")
        if self.continued:
            block.continued, block.numbered = True, False
            self.continued = body.endswith("~")
            self._assignments(body)
            return block
        if not body or body[0] in ";*%":
            return block
        if vocabulary.PARAXIAL.match(body):
            self._path(block, "", begin)
            return block
        found = vocabulary.KEYWORD.match(body)
        if found is None:
            raise self.refuse("a block that is not understood", body, "a plain-language block such as L X+10 FMAX")
        keyword = found.group().upper()
        if keyword in ("L", "LN", "C", "CR"):
            self._path(block, keyword, begin + found.end())
        elif keyword == "CC":
            self._pole(block, begin + found.end())
        elif keyword == "M" or (keyword[0] == "M" and len(keyword) <= 2):
            self._path(block, "", begin)
        else:
            self.continued = body.endswith("~")
            self._statement(block, keyword, body)
        return block

    # ------------------------------------------------------------------ statements

    def _statement(self, block: PathBlock, keyword: str, body: str) -> None:
        upper = " ".join(body.split(";")[0].upper().split())
        if keyword in vocabulary.REFUSED_PATHS:
            raise self.refuse(f"path function {keyword}", body, vocabulary.LINEAR)
        if keyword == "BEGIN":
            unit = vocabulary.UNIT.match(body)
            if unit is None or unit.group(1).upper() not in ("MM", "INCH"):
                raise self.refuse("a unit that is not one", body, "BEGIN PGM name MM or INCH")
            self.inch = unit.group(1).upper() == "INCH"
        elif keyword == "CYCL":
            self._cycle(block, body, upper)
        elif keyword == "FN":
            self._fn(body)
        elif keyword[0] == "Q":
            self._assignments(body)
        elif keyword == "FUNCTION":
            self._function(block, body, upper)
        elif keyword == "PLANE":
            if not upper.startswith("PLANE RESET"):
                raise self.refuse("coordinate transformation PLANE", body, vocabulary.BAKED)
            self._reset(block, "PLANE RESET")
        elif keyword in ("TRANS", "POLARKIN"):
            if "RESET" not in upper:
                raise self.refuse(f"coordinate transformation {keyword}", body, vocabulary.BAKED)
        elif keyword in ("CALL", "SEL", "IF"):
            if upper.startswith(("CALL LBL", "CALL PGM", "CALL SELECTED", "CALL", "IF")):
                raise self.refuse("subprogram call or repetition", body, vocabulary.FLAT)
        elif keyword in vocabulary.PASSED:
            if keyword == "TOOL" and "CALL" in upper:
                axis = vocabulary.TOOL_AXIS.match(body)
                if axis is not None:
                    self.plane = _PLANES[axis.group(1).upper()]
        elif keyword in self.index or (keyword[:1] == "I" and keyword[1:] in self.index):
            raise self.refuse("a word without a number", body, f"a number after {keyword}")
        else:
            what = "probing" if keyword == "TCH" else "a statement that is not understood"
            self.note(f"{what} passes through, every axis is unknown afterwards: {body[:60]}")
            self.forget(block, range(len(self.names)), moved=keyword == "TCH")

    def _cycle(self, block: PathBlock, body: str, upper: str) -> None:
        if upper.startswith("CYCL CALL"):
            raise self.refuse("cycle call", body, vocabulary.EXPAND)
        found = vocabulary.CYCLE.match(body)
        if found is None:
            raise self.refuse("a cycle without its number", body, "CYCL DEF and a number")
        cycle, part, rest = int(found.group(1)), found.group(2), found.group(3).split(";")[0].strip(" \t\r\n~")
        if cycle in vocabulary.RUN_AT_ONCE:
            raise self.refuse(f"cycle {cycle} runs where it is defined", body, vocabulary.EXPAND)
        if cycle in vocabulary.TRANSFORM_CYCLES:
            if part is None or (part != "0" and not _cancels(cycle, rest)):
                what = f"coordinate transformation CYCL DEF {cycle} ({vocabulary.TRANSFORM_CYCLES[cycle]})"
                raise self.refuse(what, body, vocabulary.BAKED)
            if cycle == 19:
                self._reset(block, "CYCL DEF 19")
        elif cycle == 247:
            self.note("CYCL DEF 247 chooses a preset: its offset is the one given with --work-offset")
        self._assignments(body)

    def _reset(self, block: PathBlock, name: str) -> None:
        """A cancelled tilt may turn the rotary axes: they are unknown afterwards if it does."""
        if name == "PLANE RESET" and not any(w in block.text.upper() for w in ("STAY",)):
            self.note("PLANE RESET may move the rotary axes; they are unknown afterwards")
            self.forget(block, range(self.linear, len(self.names)))

    def _fn(self, body: str) -> None:
        found = vocabulary.FN.match(body)
        if found is None:
            raise self.refuse("a parameter function without its number", body, "FN 0: Q1 = +5")
        if 9 <= int(found.group(1)) <= 12:
            raise self.refuse("control flow", body, vocabulary.FLAT)
        self._assignments(found.group(2))

    def _assignments(self, body: str) -> None:
        for name, text in vocabulary.ASSIGNED.findall(body):
            value = number(text.strip())
            if value == value:
                self.variables[name.upper()] = value
            else:
                self.variables.pop(name.upper(), None)

    def _function(self, block: PathBlock, body: str, upper: str) -> None:
        if upper.startswith("FUNCTION RESET TCPM"):
            self._switch(block, False, "FUNCTION RESET TCPM")
        elif upper.startswith("FUNCTION TCPM"):
            self._switch(block, True, "FUNCTION TCPM")
        elif upper.startswith(("FUNCTION TURNDATA", "FUNCTION MODE TURN", "FUNCTION CORRDATA", "FUNCTION PARAXMODE")):
            raise self.refuse("a function that changes what words mean", body, vocabulary.BAKED)

    # ------------------------------------------------------------------ paths

    def _value(self, text: str) -> float:
        value = number(text)
        if value == value:
            return value
        bare = text.lstrip("+- \t")
        known = self.variables.get(bare.upper(), math.nan)
        return -known if text.startswith("-") else known

    def _path(self, block: PathBlock, keyword: str, at: int) -> None:
        block.keyword, block.keyword_end = keyword, at
        machine = retracts = False
        clockwise: bool | None = None
        radius: float | None = None
        tool = [0.0, 0.0, 0.0]
        normal: list[float] | None = None
        text = block.text
        words = block.words
        seen = 0
        for match in vocabulary.TOKEN.finditer(text, at):
            kind = match.lastgroup
            if kind == "axis":
                prefix, name, written = match.group(2, 3, 4)
                axis = self.index.get(name.upper(), -1)
                if axis < 0:
                    raise self.no_axis(match.group().strip())
                value = self._value(written)
                if value != value:
                    raise self._valueless(name, written)
                if self.inch and axis < self.linear:
                    value *= MM_PER_INCH
                if seen >> axis & 1:
                    raise self.refuse(f"axis {name} twice in one block", text.strip(), "each axis once")
                seen |= 1 << axis
                start = match.start(2)
                words.append(AxisWord(axis, start, match.end(), match.start(4), match.end(), "", bool(prefix), value))
            elif kind == "note":
                continue
            elif kind == "feed":
                if match["feed"][-3:].upper() == "MAX":
                    block.rapid_text = match["feed"]
            elif kind == "side":
                if match["side"].upper() != "R0":
                    raise self.refuse(
                        f"cutter radius compensation {match['side']}", text.strip(), "the tool centre path (R0)"
                    )
            elif kind == "misc":
                code = int(match.group(match.lastindex + 1) if match.lastindex else 0)
                machine, retracts = self._misc(block, match.start("misc"), match.end(), code, machine, retracts)
            elif kind == "sense":
                clockwise = match["sense"].endswith("-")
                block.arc_words.append(Span(match.start("sense"), match.end()))
            elif kind == "radius" and keyword == "CR":
                radius = self._value(match.group(match.lastindex + 1) if match.lastindex else "")
                if radius != radius:
                    raise self._valueless("R", match["radius"])
                radius *= MM_PER_INCH if self.inch else 1.0
                block.arc_words.append(Span(match.start("radius"), match.end()))
            elif kind == "vector" and keyword == "LN" and match.lastindex:
                name, written = match.group(match.lastindex + 1, match.lastindex + 2)
                value = self._value(written)
                if value != value:
                    raise self._valueless(name, written)
                if name.upper() in _COMPONENT:
                    index = _COMPONENT[name.upper()]
                    tool[index] = value
                    if index in block.vector_words:
                        raise self.refuse(f"{name} twice in one block", text.strip(), "each word once")
                    block.vector_words[index] = Span(match.end() - len(written), match.end(), name)
                else:
                    normal = normal or [0.0, 0.0, 0.0]
                    normal[_NORMAL[name.upper()]] = value
                    block.normal_text.append(match["vector"])
            elif kind in ("retract", "ahead"):
                continue
            else:
                raise self._stray(text, match.start(kind or "bad"))
        if retracts:
            self.note("M140 retracts along the tool axis; the linear axes are unknown afterwards")
        if words or (keyword in ("C", "CR") and clockwise is not None) or block.vector_words:
            self._move(block, seen, machine, clockwise, radius, tool, normal)
        elif keyword in ("C", "CR"):
            raise self.refuse("a circular block without its sense", text.strip(), "DR+ or DR-")
        if retracts:
            self.forget(block, range(self.linear), moved=True)

    def _misc(
        self, block: PathBlock, start: int, end: int, code: int, machine: bool, retracts: bool
    ) -> tuple[bool, bool]:
        word = f"M{code}"
        if code in vocabulary.REFUSED_M:
            what = "cycle call" if code in (89, 99) else "a function that changes what words mean"
            raise self.refuse(
                f"{what} {word}", block.text.strip(), vocabulary.EXPAND if code != 118 else vocabulary.BAKED
            )
        if code in vocabulary.LAST_M:
            block.last_m.append(Span(start, end))
        if word in self.tcp_on:
            self._switch(block, True, word)
        elif word in self.tcp_off:
            self._switch(block, False, word)
        return machine or code in (91, 92), retracts or code == 140

    def _pole(self, block: PathBlock, at: int) -> None:
        found: dict[int, float] = {}
        for match in vocabulary.TOKEN.finditer(block.text, at):
            if match.lastgroup == "note":
                continue
            if match.lastgroup != "axis":
                raise self._stray(block.text, match.start(match.lastgroup or 0))
            prefix, name, written = match.group(2, 3, 4)
            axis = self.index.get(name.upper(), -1)
            if not 0 <= axis < self.linear:
                raise self.no_axis(match.group().strip())
            value = self._value(written)
            if value != value:
                raise self._valueless(name, written)
            value *= MM_PER_INCH if self.inch else 1.0
            found[axis] = value + (self.position[axis] if prefix else 0.0)
        if found:
            self.centre.update(found)
        else:
            self.centre = dict(enumerate(self.position[: self.linear]))

    def _move(
        self,
        block: PathBlock,
        seen: int,
        machine: bool,
        clockwise: bool | None,
        radius: float | None,
        tool: list[float],
        normal: list[float] | None,
    ) -> None:
        kind = Kind.RAPID if block.rapid_text else Kind.LINEAR
        names = self.named(seen)
        if machine:
            if block.keyword in ("C", "CR", "LN"):
                raise self.refuse("machine coordinates in an arc", block.text.strip(), "an L block")
            tcp = self.tcp
            position_named = self.machine_position(block.words, block)
            block.move = Move(self._line, kind, tcp, position_named, names, machine=True)
            return
        position = self.position
        start = position[: self.linear]
        for word in block.words:
            last = position[word.axis]
            if word.incremental and last != last:
                raise self.no_position(word.axis)
            position[word.axis] = last + word.value if word.incremental else word.value
        if block.vector_words:
            self._turn_to(tool, seen, block.text.strip())
        elif seen >> self.linear:
            self.vector = None
        arc: Arc | None = None
        if block.keyword in ("C", "CR"):
            kind = Kind.ARC
            arc = self._arc(block, start, clockwise, radius)
        elif block.arc_words:
            raise self.refuse("DR outside a circular block", block.text.strip(), "C or CR")
        block.move = Move(
            line=self._line,
            kind=kind,
            tcp=self.tcp,
            position=tuple(position),
            named=names,
            vector=self.vector,
            normal=None if normal is None else self.direction("surface normal", normal, block.text.strip()),
            arc=arc,
        )

    def _turn_to(self, tool: list[float], seen: int, shown: str) -> None:
        """Take a tool vector: where the rotary axes are is then the control's business."""
        vector = self.direction("tool vector", tool, shown)
        if not self.tcp:
            raise self.refuse(
                "a tool vector while the control's kinematics are off", shown, "M128 or FUNCTION TCPM first"
            )
        if seen >> self.linear:
            raise self.refuse("a tool vector and rotary axes in one block", shown, "one of them")
        self.vector = vector
        for i in range(self.linear, len(self.position)):
            self.position[i] = math.nan

    def _arc(self, block: PathBlock, start: list[float], clockwise: bool | None, radius: float | None) -> Arc:
        shown = block.text.strip()
        if clockwise is None:
            raise self.refuse("a circular block without its sense", shown, "DR+ or DR-")
        a, b, _ = self.plane
        from_, to = (start[a], start[b]), (self.position[a], self.position[b])
        found: Arc | Misfit
        if block.keyword == "CR":
            if radius is None:
                raise self.refuse("CR without a radius", shown, "R+10 or R-10")
            found = arc_by_radius(self.plane, from_, to, radius, clockwise)
        elif a in self.centre and b in self.centre:
            found = arc_by_centre(self.plane, from_, to, (self.centre[a], self.centre[b]), clockwise)
        else:
            found = Misfit("a circular block without its centre", "CC before it")
        if isinstance(found, Misfit):
            raise self.refuse(found.what, shown, found.expected)
        return found

    # ------------------------------------------------------------------ state

    def _switch(self, block: PathBlock, on: bool, word: str) -> None:
        if on == self.tcp:
            return
        if not on:
            self.vector = None
            if self.tcp_given:
                self.note(f"{word} switches the control's kinematics off")
                self.tcp_given = False
        self.tcp = on
        block.switched = True
        self.forget(block, range(self.linear), moved=None)

    def _valueless(self, name: str, written: str) -> InputError:
        if "Q" in written.upper():
            return self.refuse(
                f"the value of {name} is not known here", written, "a number, or a Q parameter set to one"
            )
        return self.no_number(name, written)

    def _stray(self, text: str, at: int) -> InputError:
        shown = text[at:].split(";")[0].strip()
        letter = shown[:1].upper()
        if letter in self.index or letter in "FMRI":
            return self.refuse(f"{letter} has no number", shown, f"a number after {letter}")
        if letter in "XYZABCUVW":
            return self.no_axis(shown)
        return self.refuse("a word that is not understood", shown, "axis words, R0, F and M")


def _cancels(cycle: int, rest: str) -> bool:
    """Whether the values of a transformation cycle are those that cancel it."""
    values = [number(text) for text in vocabulary.NUMBERS.findall(rest)]
    if cycle in (11, 26):
        return bool(values) and all(value == 1.0 for value in values)
    if cycle in (8, 19) and not rest:
        return True
    return cycle != 8 and bool(values) and "Q" not in rest.upper() and all(value == 0.0 for value in values)
