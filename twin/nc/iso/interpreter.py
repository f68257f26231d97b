"""Modal interpreter of ISO programs."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any, Final, final

from twin._common.errors import InputError
from twin.nc.arcs import ABSOLUTE, FROM_START
from twin.nc.blocks import AxisWords, Kind, Move, MoveColumns, Notice
from twin.nc.iso import vocabulary
from twin.nc.iso.cycles import PATTERNS, SINUMERIK
from twin.nc.iso.drilling import INCH_CODES, TAP
from twin.nc.iso.frame import PROGRAMMED, TOOL_CHANGE, IsoBlock, Item
from twin.nc.iso.motion import SPINDLE_VECTOR, IsoMotion
from twin.nc.iso.paths import CENTRE
from twin.nc.modal import SWITCHING_M, Block, Span
from twin.nc.text import BLANK, BOM, number

_AXIS_LETTERS: Final = frozenset("XYZABCUVW")
_LENGTH_WORDS: Final = frozenset({"", "G43.4", "G43.5", "G234", "G169"})
_ARC_WORDS: Final = frozenset({*CENTRE, *SPINDLE_VECTOR, "R", "CR", "TURN"}) | vocabulary.PATH_WORDS
_NORMAL: Final = frozenset(f"{letter}{place}" for letter in "ABC" for place in "45")
"""Surface normal of SINUMERIK at the start and the end of a block: of effect with LEAD, TILT and G41 or G42 only, which are refused."""
_NO_MOTION: Final = frozenset("STDHFPQM")
_new = tuple.__new__
_WITHOUT_CYCLE: Final = frozenset({"still", "reference"})
"""Groups of G words whose block does not execute the drilling cycle in force; its words are theirs."""
_RETURNS: Final = frozenset({"G28", "G30", "G30 P2", "G30 P3", "G30 P4", "G74"})
"""Words of reference returns whose positions a machine file may name."""
_SAVED: Final = (
    *("inch", "plane", "incremental", "feed_mode", "centres", "_to_initial", "_level_given"),
    *("side", "offset", "frame", "_held_length", "tcp"),
)
_SAVED_MODES: Final = 7
"""Attributes that hold the modal words which M70 saves; the first ones are restored by M72, the others must be the same."""
_SOME_WORDS: Final = "words whose effect is known"
_MODES: Final[Mapping[str, tuple[str, Callable[[str], Any]]]] = {
    "motion": ("motion", int),
    "distance": ("incremental", lambda code: code == "91"),
    "feed": ("feed_mode", str),
    "plane": ("plane", int),
    "radius": ("side", int),
    "units": ("inch", INCH_CODES.__contains__),
    "arc centre": ("centres", lambda code: ABSOLUTE if code == "90.1" else FROM_START),
    "length": ("length_vector", lambda code: code == "43.5"),
}
"""For each group of G codes: the attribute of the interpreter that holds its state, and the conversion of a code to that state."""


_OF_SINUMERIK: Final = vocabulary.PASSED | vocabulary.TRANSFORMS
NO_UNIT: Final = "the program does not state its unit (G20, G21, G70, G71): millimetres are assumed"
RIGID: Final = re.compile(r"M0*29(?!\d)", re.IGNORECASE)
"""Rigid tapping of Fanuc."""


@final
class IsoInterpreter(IsoMotion):
    """Interpreter of blocks in order, with their modal state."""

    def __init__(self, source: str, axes: AxisWords, *, tcp: bool) -> None:
        super().__init__(source, axes, tcp=tcp)
        self._codes: dict[str, str] = {}
        self._started = self._okuma = False
        self._assignments: list[tuple[str, float]] = []
        """Values of ``#`` variables that hold from the next block on: words of the same block have the values before (LinuxCNC)."""
        self._probes = self._siemens = self._begun = self._any = self._marked = False
        self._unit_line: int | None = None
        self._saved_modes: dict[str, Any] | None = None

    @property
    def variant(self) -> str:
        """The control whose words the program has used so far; empty if they are those of several."""
        return "Okuma" if self._okuma else self.control or ("SINUMERIK" if self._siemens else "")

    # ------------------------------------------------------------------ a block

    def step(self, line: int, text: str) -> IsoBlock | None:
        """Interpret one line (0-based index); return None for a line without words (blank, comment, ``%``)."""
        self._line, self._block_text = line, text
        begin = len(BOM) if line == 0 and text.startswith(BOM) else 0
        stripped = text[begin:].strip(" \t\r\n\f\x1a")
        if stripped[:1] == "%":
            self._tape_mark(stripped)
        if not stripped or stripped[0] in "%;" or self.is_listing(stripped):
            return None
        if self.end.word:
            self._behind_end(text, stripped)
            return None
        if stripped[0] == "$" and vocabulary.OKUMA_HEADER.fullmatch(stripped):
            self._okuma = True
            return None
        if stripped[0] in "<Oo" and self._is_name(stripped):
            return None
        self._block_text = stripped
        block = IsoBlock(text, begin)
        self._started = False
        for match in vocabulary.TOKEN.finditer(text, begin):
            kind = match.lastgroup or ""
            if kind == "main" and self._is_label(block, match):
                return None
            if kind != "note" and _TOKENS[kind](self, block, match):
                break
        applied = self._apply(block) if self._started or block.names else None
        self._any |= self._started or bool(block.names)
        self._end(block)
        for name, value in self._assignments:
            self.assign(name, value)
        self._assignments.clear()
        return applied

    def _is_name(self, text: str) -> bool:
        """Return whether a line is the name of the program: ``<NAME>``, or behind ``%`` a name after O in place of a number."""
        if vocabulary.PROGRAM_NAME.fullmatch(text):
            self.control = "Fanuc"
            return True
        found = self._marked and not self._any and vocabulary.NAME_BEHIND_O.fullmatch(text) is not None
        if found:
            self.note("the O word behind % has no number: taken as the name of the program")
            self._any = True
        return found

    def checked(self, moves: MoveColumns, text_of: Callable[[int], str]) -> MoveColumns:
        """See `Interpreter.checked`; note that a program does not state its unit before it moves."""
        if len(moves) and not self._begun:
            self._begun, first = True, int(moves.line[0])
            if self._unit_line is None or self._unit_line > first:
                self.late_notices.append(Notice(first, NO_UNIT))
        return super().checked(moves, text_of)

    def _end(self, block: IsoBlock) -> None:
        """Take note of a word that ends the program, or that returns from a subprogram, in a program that was not called."""
        words = [word for word in block.m_words if word in vocabulary.END_M]
        words += [item.name for item in block.names if item.name == "RET"]
        if not words:
            return
        if words[0] == "M99" and any(item.name == "P" for item in block.others):
            raise self.error("jump at the end of the program", "M99 without P")
        self.end.reached(words[0], self._line, skipped=bool(block.skip))

    def _tape_mark(self, text: str) -> None:
        """Take note of a line with %: the second one, or one behind a block, ends the program or begins another."""
        if self.end.word:
            if text.strip("%"):
                self.end.begins(text)
        elif self._any or not all(value != value for value in self.position) or (self._marked and text == "%"):
            self.end.reached("%", self._line)
            if text.strip("%"):
                self.end.begins(text)
        self._marked |= text == "%"

    def _behind_end(self, text: str, stripped: str) -> None:
        """Interpret a line behind the end of the program."""
        words = [match for match in vocabulary.TOKEN.finditer(text) if match.lastgroup != "note"]
        if vocabulary.PROGRAM_BEGIN.match(stripped):
            self.end.begins(stripped)
        elif any((match[2] or match[6] or "").upper() not in ("", "N") for match in words):
            self.behind_end(moves=any((match[2] or match[6] or "").upper() in self.index for match in words))

    def may_end(self, tail: str) -> bool:
        """See `Interpreter.may_end`: not while a cycle is in force or before a thread, which is written with the move before."""
        return self.cycle is None and RIGID.search(tail) is None and TAP not in tail

    def moves(self, line: int, text: str) -> tuple[Move, ...]:
        """See `Interpreter.moves`."""
        block = None if text in BLANK else self.step(line, text)
        return () if block is None else block.moves

    def _state_to(self, block: IsoBlock) -> None:
        block.motion, block.inch, block.incremental = self.motion, self.inch, self.incremental
        block.inverse_time = self.feed_mode == "93"

    def _apply(self, block: IsoBlock) -> IsoBlock:
        if block.skip and not _changes_nothing(block):
            self.note("block skip: assumed to be executed", once=True)
        self._machine_axes(block)
        groups = self._groups(block)
        if self._calls_outside(block) or (groups and self._frame_words(block, groups)):
            return block
        groups = self._with_probing(block, groups)
        drills = not groups & _WITHOUT_CYCLE and self.take_cycle_words(block)
        machine = self._names(block) if block.names else False
        own = "".join(vocabulary.OWN_WORDS.get(span.name, "") for span in block.codes)
        own += "".join(map(block.own_of, block.m_words))
        centre = [item for item in block.others if item.name not in own and self._is_of_motion(block, item)]
        self._state_to(block)
        self.choose_tool(block, frozenset(block.m_words))
        if self._does_not_go(block, groups):
            return block
        machine = machine or "machine" in groups
        for item in block.items:
            self.add(block, self.axis_word(item, machine=machine))
        if block.items or centre:
            self.move(block, centre, machine=machine)
            self.shape_paths(block)
        elif self.cycle is not None and (drills or block.calls or block.pattern):
            block.positions = False
            self.drill(block, self.cycle)
        if block.calls:
            self.cycle = None
        return block

    def _groups(self, block: IsoBlock) -> frozenset[str]:
        """Apply G words and M70 to M72, and take polar words; return the groups of the G words."""
        if not vocabulary.SAVING_M.isdisjoint(block.m_words):
            self._save_modes(block)
        groups = self._g_words(block) if block.codes else frozenset[str]()
        if block.polar:
            self.polar_words(block)
        return groups

    def _does_not_go(self, block: IsoBlock, groups: frozenset[str]) -> bool:
        """Apply a block that dwells, returns to a reference point or taps, and return whether it is one."""
        taps = any(span.name == TAP for span in block.codes)
        if taps:
            self.tap(block)
        elif "still" in groups:
            if block.items and ("motion" in groups or any(item.name == "P" for item in block.others)):
                raise self.error("a dwell in a block that moves axes", "G4 in a block of its own")
        elif "reference" in groups:
            self._reference(block)
        return taps or not groups.isdisjoint(_WITHOUT_CYCLE)

    def _save_modes(self, block: IsoBlock) -> None:
        """Save, forget or restore modal words (LinuxCNC: M70, M71, M72); M70 of other controls saves nothing that is read again."""
        word = next(word for word in block.m_words if word in vocabulary.SAVING_M)
        if word != "M70" and (self._saved_modes is None or len(block.m_words) > 1 or block.codes or block.items):
            raise self.error("modal words restored", "M70 before it, and M72 in a block of its own", word)
        modes = {name: getattr(self, name) for name in _SAVED}
        if word == "M72" and self._saved_modes is not None:
            if any(modes[name] != self._saved_modes[name] for name in _SAVED[_SAVED_MODES:]):
                what = "M72 that restores a work offset, a tool length or a radius compensation"
                raise self.error(what, "that selected by its own words before M72")
            for name in _SAVED[:_SAVED_MODES]:
                setattr(self, name, self._saved_modes[name])
            self.note("M72 restores feed and speed, too: times are stated with those of the words before it", once=True)
        self._saved_modes = {"M70": modes, "M71": None}.get(word, self._saved_modes)

    def _calls_outside(self, block: IsoBlock) -> bool:
        """Return whether a block calls a program by its number that is not given, and may; its other words are arguments."""
        calls = [word for word in block.m_words if word in vocabulary.CALLING_M]
        calls += [f"G{span.name}" for span in block.codes if span.name == "65"]
        if not calls:
            return False
        number = next((item.value for item in block.others if item.name == "P"), "")
        if not number.isdigit() or len(calls) > 1 or (calls != ["G65"] and (block.items or block.codes)):
            raise self.error("subprogram call", f"{calls[0]} with the number of a program, P, in a block of its own")
        self.call_outside(f"O{int(number)}")
        return True

    def _frame_words(self, block: IsoBlock, groups: frozenset[str]) -> bool:
        """Apply G words that tilt, shift or turn the coordinates; return whether the block does nothing else."""
        if "plane tilt" in groups:
            self.tilt_words(block)
        if "shift" in groups:
            self._state_to(block)
            return not self.shift_words(block, groups)
        if "pole" in groups:
            self.set_pole(block)
            return True
        return False

    def _reference(self, block: IsoBlock) -> None:
        """Apply a reference return, an approach of a fixed point, or probing, which passes through."""
        which = [self.index[item.name] for item in block.items]
        if not which and not any(item.name in self.auxiliary_axes.names for item in block.others):
            which = list(range(len(self.names)))
        self.leave_contour()
        self.check_plane(max(which, default=0) >= self.linear)
        words = [
            span.name for span in block.codes if vocabulary.GROUP_OF.get(span.name) == "reference" or block.approaches
        ]
        word = f"G{words[0]}" if words and not self._probes else ""
        point = [self.value_of(item.value) for item in block.others if item.name == "P"]
        word += f" P{point[0]:g}" if word == "G30" and point not in ([], [2.0]) else ""
        if word == "G30.1":
            self.references.pop("G30", None)
        known = {} if self.unknown else self.references.get(word, {})
        left = [axis for axis in which if self.names[axis] not in known]
        if left:
            self.note(
                "reference return or probing passed through uncompensated; its axis positions are unknown afterwards"
            )
            self.mark_unknown(block, left, moved=True, reference=word if word in _RETURNS else "")
            self.mark_unknown(block, self.words_of(left), moved=None)
        there = [axis for axis in which if axis not in left]
        if there:
            block.positions = False
            position = self.placed({axis: known[self.names[axis]] for axis in there}, block)
            bits = sum(1 << axis for axis in there)
            block.moves += (Move(self._line, Kind.RAPID, self.tcp, position, self.named(bits), machine=True),)

    def _with_probing(self, block: IsoBlock, groups: frozenset[str]) -> frozenset[str]:
        """Return the groups of a block's G words, with that of G38 where it is in force: until a word of the motion group or G80."""
        codes = [span.name for span in block.codes]
        if any(code.startswith("38") for code in codes):
            self._probes = True
        elif "motion" in groups or "80" in codes:
            self._probes = False
        elif self._probes and block.items and not groups & _WITHOUT_CYCLE:
            return groups | {"reference"}
        return groups

    def _machine_axes(self, block: IsoBlock) -> None:
        """Take machine axes of SINUMERIK (``G74 X1=0``, ``G75 FP=2 Z1=0``) as those of a reference or fixed point approach."""
        own = [item for item in block.others if item.name[1:] == "1" and item.name[0] in self.index]
        if own and [span.name for span in block.codes] in (["74"], ["75"]) and not block.items:
            if self.tcp:
                raise self.error("approach of a machine axis under tool centre point control", "TRAFOOF before it")
            block.approaches = True
            block.items = [item._replace(name=item.name[0]) for item in own]
            block.others = [item for item in block.others if item not in own]

    def _is_of_motion(self, block: IsoBlock, item: Item) -> bool:
        """Return whether a word other than an axis word belongs to the motion; unknown words raise an error or add a notice."""
        name, shown = item.name, block.text[item.start : item.end]
        if name in _ARC_WORDS or (name == "P" and self.motion in (2, 3) and (block.items or _has_centre(block))):
            return True
        if name in _NORMAL and self._has_vector(block, item):
            return False
        if name in _AXIS_LETTERS or (name[0] in _AXIS_LETTERS and name[1:].isdigit()):
            return self._auxiliary_axis(block, item)
        if name == "L":
            return self._called_by_number(block, item, shown)
        if name == "N":
            raise self.error("block number inside a block", "N at the start of the block", shown)
        if name == "O":
            if block.items or block.names:
                raise self.error("control flow", vocabulary.NO_CALLS)
            self.control = "Fanuc"
        elif name not in _NO_MOTION:
            if block.items or block.cycle_words:
                what = "unknown word in a block that moves axes"
                raise self.error(what, "words whose effect on the motion is known", shown)
            self.lose(block, shown)
        return False

    def _called_by_number(self, block: IsoBlock, item: Item, shown: str) -> bool:
        """Take ``L900`` of SINUMERIK, a call of a program that is not given; return False: it is no word of the motion."""
        if block.items:
            raise self.error("subprogram call or repetition", vocabulary.NO_CALLS, shown)
        self.call_outside(f"L{item.value}")
        return False

    def _auxiliary_axis(self, block: IsoBlock, item: Item) -> bool:
        """Take the word of an auxiliary axis, and return False: it is no word of the motion; raise `InputError` for another axis.

        Its place in coordinates of the machine, or at its reference, is another one than any place in those of the program.
        """
        if item.name not in self.auxiliary_axes.names:
            raise self.unknown_axis(f"{item.name}{item.value}")
        groups = {vocabulary.GROUP_OF.get(span.name) for span in block.codes}
        value: float | str = self.known_value(item.name, item.value, "a number")
        if "reference" in groups:
            value = "its reference"
        elif "machine" in groups:
            value = math.nan if self.incremental else f"{value:g} of the machine"
        feeds = self.motion in (1, 2, 3) and "reference" not in groups
        self.take_auxiliary_axis(item.name, value, incremental=self.incremental, feeds=feeds)
        return False

    def _has_vector(self, block: IsoBlock, normal: Item) -> bool:
        """Return True for a block with a tool vector; raise `InputError` otherwise: then the normal may direct the tool."""
        if SPINDLE_VECTOR.keys() <= {other.name for other in block.others}:
            return True
        what = f"surface normal {normal.name} without a tool vector"
        raise self.error(what, "A3= B3= C3= in the same block", block.text[normal.start : normal.end])

    # ------------------------------------------------------------------ tokens

    def _word(self, block: IsoBlock, match: re.Match[str]) -> None:
        written, value = match.group(2, 3)
        letter = written.upper()
        if letter in self.index:
            start, end = match.span(3)
            block.items.append(_new(Item, (letter, match.start(2), end, start, end, value)))
        elif letter == "N" and not self._started:
            block.head_end = match.end()
            return
        elif letter == "G":
            block.codes.append(Span(match.start(2), match.end(), self._code(value)))
        elif letter == "F":
            if not value.isdigit() and number(value) != number(value):
                raise self.missing_number("F", value)
            block.feed = Span(match.start(3), match.end())
        elif letter == "M":
            self._m_word(block, match.start(2), match.end(), value)
        else:
            if letter == "E":
                self._check_exponent(block, match.start(2), match.end())
            self._sort(block, Item(letter, match.start(2), match.end(), match.start(3), match.end(), value))
        self._started = True

    def _check_exponent(self, block: IsoBlock, start: int, end: int) -> None:
        """Raise `InputError` if a word that begins with E follows the digits of a number: few controls read it as an exponent."""
        if start > block.head_end and block.text[start - 1] in "0123456789.":
            shown = block.text[max(start - 12, block.head_end) : end].split()[-1]
            raise self.error("number with an exponent", "a number such as 0.001, and a space before a word", shown)

    def _sort(self, block: IsoBlock, item: Item) -> None:
        (block.items if item.name in self.index else block.others).append(item)

    def _given(self, block: IsoBlock, match: re.Match[str]) -> None:
        self._started = True
        key, value = match.group(6).upper(), match.group(8)
        key = "H" if key == "HA" and self._okuma else key
        bracket = match[7] or ""
        if key == "R" and bracket:
            key, bracket = f"R{self.value_of(bracket[1:-1]):.0f}", ""
        item = Item(key, match.start(6), match.end(), match.start(8), match.end(8), value)
        if key in self.index or not self._assigned(block, item, bracket):
            self._sort(block, item)

    def _name(self, block: IsoBlock, match: re.Match[str]) -> bool:
        """Interpret a name; return whether it takes the rest of the line."""
        self._started = True
        name, start = match.group(10).upper(), match.start(10)
        if name.startswith("EX"):
            self._check_exponent(block, start, match.end())
        if name in ("CALL", "EXTCALL") and (called := vocabulary.CALLED_BY_NAME.search(block.text, start)) is not None:
            self.call_outside(called[1])
            return True
        block.names.append(Item(name, start, match.end(), start, match.end(), match.group(12) or ""))
        if name in ("DEF", "EXTERN", "PROC"):
            for variable, value in vocabulary.ASSIGNED.findall(block.text[match.end() :].split(";")[0]):
                self.assign(variable, self.value_of(value))
            return True
        if name in vocabulary.CONTROL_FLOW:
            raise self.error("control flow", vocabulary.NO_CALLS)
        return False

    def _late(self, block: IsoBlock, match: re.Match[str]) -> None:
        self._started = True
        letter, value = match.group(14, 15)
        self._sort(block, Item(letter.upper(), match.start(14), match.end(), match.start(15), match.end(), value))

    def _polar_word(self, block: IsoBlock, match: re.Match[str]) -> None:
        self._started = True
        (start, end), text = match.span("polar"), match["polar"]
        block.polar.append(Item(text[0], start, end, start + 1, end, text[1:].strip()))

    def _hash(self, block: IsoBlock, match: re.Match[str]) -> None:
        self._started = True
        name = match.group(17)
        if name[1] == "<":
            self.control = "LinuxCNC"
        first, last = vocabulary.LINUXCNC_VARIABLES
        if self.control == "LinuxCNC" and name[1:].isdigit() and first <= int(name[1:]) <= last:
            self._assignments.append((name, self.value_of(match.group(18))))
            return
        if name[1:].isdigit() and any(first <= int(name[1:]) <= last for first, last in vocabulary.OFFSET_VARIABLES):
            raise self.error("the program sets a work offset or a tool length", vocabulary.NO_TRANSFORMATION, name)
        self._assignments.append((name, self.value_of(match.group(18))))
        if name[1:].isdigit() and not any(first <= int(name[1:]) <= last for first, last in vocabulary.USER_VARIABLES):
            self.lose(block, match.group().strip())

    def _skip(self, block: IsoBlock, match: re.Match[str]) -> None:
        if self._started:
            raise self.error("slash inside a block", "block skip at the start of the block")
        skips = match["skip"]
        block.skip = skips[skips.rindex("/") :]
        block.head_end = match.end()

    def _is_label(self, block: IsoBlock, match: re.Match[str]) -> bool:
        alone = len(block.names) == 1 and not (block.items or block.others or block.codes)
        return alone and match["main"] == ":"

    def _main(self, block: IsoBlock, match: re.Match[str]) -> None:
        if self._started:
            raise self.error("colon inside a block", "a block number or label at the start of the block")
        block.head_end = match.end()

    def _bad(self, block: IsoBlock, match: re.Match[str]) -> bool:
        called = vocabulary.O_CALL.match(block.text, match.start("bad"))
        if called is not None:
            self.call_outside(f"O{called[1]}", called[1].strip("<>"))
            return True
        character, rest = match["bad"], block.text[match.start("bad") :].strip()
        letter = character.upper()
        if letter in self.index or letter in "FGMIJKRSTDHN":
            raise self.error(f"{letter} has no number", f"a number after {letter}", rest.split(";")[0].strip())
        if letter in _AXIS_LETTERS:
            raise self.unknown_axis(rest)
        if character == "(":
            if 1 < rest.count("(") <= rest.count(")"):
                raise self.error("comment within a comment before words", "a comment without parentheses in it", rest)
            raise self.error("comment or argument list without closing parenthesis", "( ... )", rest)
        if letter == "O":
            only = vocabulary.O_SUB.match(rest) is not None
            raise self.error("control flow", vocabulary.MAIN_PROGRAM if only else vocabulary.NO_CALLS, rest)
        if character == "*":
            what = "block that ends in *: DIN/ISO of HEIDENHAIN, in which G words have other meanings"
            raise self.error(what, "the program in plain language, converted at the control", rest)
        raise self.error("unexpected character", "words of a letter and a number", rest)

    # ------------------------------------------------------------------ words

    def _code(self, value: str) -> str:
        code = self._codes.get(value)
        if code is None:
            word = vocabulary.canonical(f"G{value}")
            if len(word) < 2 or not word[1].isdigit():
                raise self.missing_number("G", value)
            code = self._codes[value] = word[1:]
        return vocabulary.OKUMA_CODES.get(code, code) if self._okuma else code

    def _m_word(self, block: IsoBlock, start: int, end: int, value: str) -> None:
        word = vocabulary.canonical(f"M{value}")
        if word in vocabulary.REFUSED_M:
            raise self.error("subprogram call", vocabulary.NO_CALLS, word)
        if word == "M73":
            raise self.error("modal words restored at a return", "M70 and M72, or modal words written out", word)
        if len(word) < 2:
            raise self.missing_number("M", value)
        block.m_words.append(word)
        if (
            word
            not in vocabulary.HARMLESS_M
            | vocabulary.CALLING_M
            | vocabulary.SAVING_M
            | self.harmless
            | self.tcp_on
            | self.tcp_off
        ):
            if not word[1:].isdigit() or int(word[1:]) in SWITCHING_M:
                self.lose(block, word)
            else:
                self.take_auxiliary(word)
        if word in vocabulary.LAST_M:
            block.end_m_words.append(Span(start, end, word))
        self.switch_by(block, word)

    def _g_words(self, block: IsoBlock) -> frozenset[str]:
        """Apply the G words of a block and return their groups."""
        seen: dict[str, str] = {}
        for span in block.codes:
            code = span.name
            group = self._group(block, code)
            if group is None:
                continue
            # The same word twice changes nothing: controls differ in whether they allow it.
            if group and seen.setdefault(group, code) != code:
                if group == "distance" and any(one.name in ("28", "30") for one in block.codes):
                    self.note(
                        "G90 and G91 in one block with a reference return: the last one is in force (Fanuc, Haas)"
                    )
                    self._modal(block, span, group)
                    continue
                raise self.error(f"two G words of one modal group ({group})", "one G word per group in a block")
            self._modal(block, span, group)
            self.tell_control(code)
            self.check_pole()
            self.switch_by(block, f"G{code}")
        self._unit_line = self._line if self._unit_line is None and "units" in seen else self._unit_line
        return frozenset(seen)

    def _modal(self, block: IsoBlock, span: Span, group: str) -> None:
        """Apply one G word of a known group to the modal state."""
        code = span.name
        if group != "reference" and self.cycle_code(block, span, group):
            return
        if group in _MODES:
            name, state = _MODES[group]
            setattr(self, name, state(code))
        if group == "motion":
            block.motion_word, self.curve = span, ""
        elif group == "offset":
            self.choose_offset(block, code)
        elif group == "length" and code in ("169", "170"):
            self._okuma = True
        elif group == "length" and self.tcp_word in _LENGTH_WORDS - {""} and code in ("43", "44"):
            self.switch(block, False, f"G{code}")
        elif code in vocabulary.FLAGS and (block.items or any(item.name in CENTRE for item in block.others)):
            raise self.error(f"G{code} with words of axes", f"G{code} without them, in a block of its own")
        elif code == "15" and any(item.name == "H" for item in block.others):
            self._okuma = True
            self.choose_offset(block, code)
        elif code == "5" and (block.items or not any(item.name == "P" for item in block.others)):
            raise self.error("curve G5", vocabulary.LINEAR)

    def _group(self, block: IsoBlock, code: str) -> str | None:
        """Return the modal group of a G code, empty if it has none; None for an unknown code that passes through."""
        if self._okuma and code in vocabulary.NOT_OF_OKUMA:
            what = f"G{code} of Okuma"
            raise self.error(what, "axis positions without tool length, work offset and cycles of Okuma", f"G{code}")
        group = "reference" if block.approaches else vocabulary.GROUP_OF.get(code)
        if group is not None:
            return group
        if code in vocabulary.ENDED_BY_P0 and [item.value for item in block.others if item.name == "P"] == ["0"]:
            return ""
        if code in vocabulary.SMOOTHING_BY_P and [item.name for item in block.others] == ["P"] and not block.items:
            return ""
        if code in vocabulary.REFUSED_CODES:
            raise self.error(*vocabulary.REFUSED_CODES[code])
        if f"G{code}" in self.tcp_on | self.tcp_off | self.harmless:
            return ""
        if block.items:
            raise self.error("unknown G word in a block that moves axes", "G words whose effect is known", f"G{code}")
        self.lose(block, f"G{code}")
        return None

    def switch(self, block: Block, on: bool, word: str) -> None:
        """As `Interpreter.switch`; G49 ends a length offset only, not the effect of other words."""
        if on or word != "G49" or self.tcp_word in _LENGTH_WORDS:
            super().switch(block, on, word)

    def _names(self, block: IsoBlock) -> bool:
        """Apply statements by name and return whether one of them selects machine coordinates."""
        names = block.names
        self._siemens = self._siemens or any(item.name in _OF_SINUMERIK for item in names)
        for place, (name, start, end, _, _, arguments) in enumerate(names):
            shown = block.text[start:end]
            if name == "SUPA" or name in self.tcp_on or name in self.tcp_off:
                self.switch_by(block, name)
            elif name == "CYCLE800":
                self.swivel(block, arguments)
            elif name in vocabulary.TRANSFORMS:
                alone = name in vocabulary.CANCELLING and not (block.items or block.others)
                if (name in PROGRAMMED or alone) and not arguments.strip("() \t"):
                    self.program_frame(block, name)
                else:
                    rest = block.text[start:].split(";")[0].strip()
                    raise self.error(f"coordinate transformation {name}", vocabulary.NO_TRANSFORMATION, rest)
            elif name == "MCALL" or (place and names[place - 1].name == "MCALL"):
                self.mcall(block, names[place], last=len(names) == place + 1)
            elif name in vocabulary.CURVES:
                self.select_curve(block, names[place])
            elif name in (SINUMERIK if self.cycle is None else PATTERNS) and len(names) == 1 and not block.items:
                self.call_once(block, names[place])
            elif not self._passes(name):
                self._unknown_name(block, names[place], shown)
        return any(item.name == "SUPA" for item in names)

    def _passes(self, name: str) -> bool:
        """Return whether a statement does not change the meaning of axis words; note whether tool vectors are the machine's."""
        if name in ("ORIMKS", "ORIWKS"):
            self.of_machine = name == "ORIMKS"
        of_tool = self._okuma and name in vocabulary.OKUMA_LENGTHS
        return name in vocabulary.PASSED or name in self.harmless or of_tool

    def _unknown_name(self, block: IsoBlock, item: Item, shown: str) -> None:
        """Pass a statement of unknown effect through; raise `InputError` in a block that moves axes."""
        name = item.name
        if vocabulary.CYCLE.fullmatch(name):
            raise self.error(f"canned cycle {name}", vocabulary.EXPANDED_CYCLE, shown)
        if name[0] in self.index and not item.value and "_" not in name and not name.startswith("CYCLE"):
            raise self.error("word without a number", f"a number after {name[0]}", shown)
        if block.items:
            raise self.error("unknown word in a block that moves axes", _SOME_WORDS, shown)
        self.lose(block, shown)

    def _assigned(self, block: IsoBlock, item: Item, bracket: str) -> bool:
        """Apply an assignment that is not a word of the block; return whether it was one."""
        name, value = item.name, item.value
        shown = f"{name}={value}"
        turns = name == "RPL" and any(one.name in PROGRAMMED for one in block.names)
        if len(name) == 1 or name in SPINDLE_VECTOR or name in ("CR", "TURN") or turns or name in vocabulary.PATH_WORDS:
            return False
        if self.shapes(block, name, value):
            return True
        self.check_assigned(name, shown)
        if name[1:].isdigit() and name[0] in _AXIS_LETTERS:
            return False
        if name[0] == "M" and name[1:].isdigit():
            self._m_word(block, item.start, item.end, value)
        elif name in vocabulary.CHANGING_KEYWORDS or (name[0] == "T" and name[1:].isdigit()):
            self.lose(block, shown)
        elif name.startswith("$"):
            if not name.startswith(vocabulary.HARMLESS_SYSTEM_VARIABLES):
                self.lose(block, shown)
        else:
            self.assign(name + bracket, self.value_of(value))
        return True


def _changes_nothing(block: IsoBlock) -> bool:
    """Return whether a block has M words only, of no effect on what follows."""
    other = block.items or block.codes or block.names or block.others
    return bool(block.m_words) and not other and vocabulary.HARMLESS_M - {TOOL_CHANGE} >= {*block.m_words}


def _has_centre(block: IsoBlock) -> bool:
    """Return whether a block has a centre: a full circle needs no axis words."""
    return any(item.name in CENTRE for item in block.others)


_TOKENS: Final[Mapping[str, Callable[[IsoInterpreter, IsoBlock, re.Match[str]], bool | InputError | None]]] = {
    "word": IsoInterpreter._word,
    "given": IsoInterpreter._given,
    "name": IsoInterpreter._name,
    "late": IsoInterpreter._late,
    "hash": IsoInterpreter._hash,
    "skip": IsoInterpreter._skip,
    "main": IsoInterpreter._main,
    "polar": IsoInterpreter._polar_word,
    "bad": IsoInterpreter._bad,
}
"""Handler of each kind of `vocabulary.TOKEN`; it returns True if the rest of the line is not words."""
