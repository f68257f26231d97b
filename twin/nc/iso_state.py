"""The modal interpreter of ISO programs: blocks in, what each says in full out."""

from __future__ import annotations

import math

from twin._common.errors import InputError
from twin.nc import iso_words as vocabulary
from twin.nc.arcs import PLANES, Misfit, arc_by_centre, arc_by_radius
from twin.nc.blocks import Arc, AxisWords, Kind, Move
from twin.nc.iso_block import AxisWord, Block, Drilling, Span
from twin.nc.iso_values import Variables, canonical
from twin.nc.modal import Modal
from twin.nc.text import BOM, MM_PER_INCH, number

_AXIS_LETTERS = frozenset("XYZABCUVW")
_CENTRE = {"I": 0, "J": 1, "K": 2}
_SPINDLE_VECTOR = {"A3": 0, "B3": 1, "C3": 2}
_PLAIN = frozenset("STDHFPQM")
_TCP_ON = frozenset({"G43.4", "G43.5", "TRAORI"})
_TCP_OFF = frozenset({"G49", "TRAFOOF"})
Late = tuple[str, int, int, int, int, str]
"""A word whose meaning waits for the rest of its block: name, start, end, value start, value end, value."""


class Interpreter(Modal):
    """Reads blocks in order, keeping the modal state."""

    def __init__(self, source: str, axes: AxisWords, *, tcp: bool) -> None:
        super().__init__(source, axes, tcp=tcp)
        self.tcp_by = ""  # what switched it on: "" is the user
        self.tcp_on = _TCP_ON | frozenset(canonical(word) for word in axes.tcp_on)
        self.tcp_off = (_TCP_OFF | frozenset(canonical(word) for word in axes.tcp_off)) - self.tcp_on
        self.motion: int | None = None
        self.plane = 17
        self.inch = False
        self.incremental = False
        self.absolute_centre = False
        self.feed_mode = "94"
        self.length_vector = False
        self.variables = Variables()
        self.offset: str | None = None
        self.offset_line = 0
        self.used_offset: str | None = None
        self.cycle: Drilling | None = None
        self._codes: dict[str, str] = {}

    # ------------------------------------------------------------------ a block

    def step(self, line: int, text: str) -> Block | None:
        """Interpret one line; None for a line that says nothing (blank, comment, ``%``).

        Args:
            line: 0-based index of the line.
            text: its text.

        Raises:
            InputError: with file, line and value.
        """
        self._line = line
        begin = len(BOM) if line == 0 and text.startswith(BOM) else 0
        stripped = text[begin:].strip(" \t\r\n\f\x1a")
        if not stripped or stripped[0] in "%;":
            return None
        block = Block(text)
        codes: list[Span] = []
        axis_words: list[Late] = []
        others: list[Late] = []
        names: list[Late] = []
        block.head = begin
        started = False
        for match in vocabulary.TOKEN.finditer(text, begin):
            kind = match.lastgroup
            if kind == "word":
                letter, value = match.group(2, 3)
                letter = letter.upper()
                if letter in self.index:
                    at = match.start(2)
                    axis_words.append((letter, at, match.end(), match.start(3), match.end(), value))
                elif letter == "G":
                    codes.append(Span(match.start(2), match.end(), self._code(value)))
                elif letter == "N" and not started:
                    block.head = match.end()
                    continue
                elif letter == "F":
                    if not value.isdigit() and number(value) != number(value):
                        raise self.no_number("F", value)
                    block.feed = Span(match.start(3), match.end())
                elif letter == "M":
                    self._m_word(block, match.start(2), match.end(), value)
                else:
                    others.append((letter, match.start(2), match.end(), match.start(3), match.end(), value))
                started = True
            elif kind == "note":
                continue
            elif kind == "given":
                key, value = match.group(6, 8)
                item = (key.upper(), match.start(6), match.end(), match.start(8), match.end(8), value)
                if key.upper() in self.index:
                    axis_words.append(item)
                elif not self._assigned(item, match.group(7) or ""):
                    others.append(item)
                started = True
            elif kind == "name":
                name = match.group(10)
                start = match.start(10)
                names.append((name.upper(), start, match.end(), start, match.end(), match.group(12) or ""))
                if name.upper() in ("DEF", "EXTERN", "PROC"):
                    self.variables.declare(text[match.end() :])
                    break
                if name.upper() in vocabulary.CONTROL_FLOW:
                    raise self.refuse("control flow", stripped, vocabulary.FLAT)
                started = True
            elif kind == "late":
                letter, value = match.group(14, 15)
                item = (letter.upper(), match.start(14), match.end(), match.start(15), match.end(), value)
                (axis_words if letter.upper() in self.index else others).append(item)
                started = True
            elif kind == "hash":
                self.variables.set(match.group(17), match.group(18))
                started = True
            elif kind == "skip":
                if started:
                    raise self.refuse("a slash inside a block", stripped, "block skip at the start of a block")
                skips = match["skip"]
                block.skip = skips[skips.rindex("/") :]
                block.head = match.end()
            elif kind == "main":
                if names and len(names) == 1 and not axis_words and not others and not codes and match["main"] == ":":
                    return None  # a label
                if started:
                    raise self.refuse("a colon inside a block", stripped, "a block number or label at its start")
                block.head = match.end()
            else:
                raise self._stray(match["bad"], text, match.start("bad"))
        if not (started or codes or names):
            return None
        return self._apply(block, codes, axis_words, others, names)

    def _apply(
        self, block: Block, codes: list[Span], axis_words: list[Late], others: list[Late], names: list[Late]
    ) -> Block:
        machine = still = reference = False
        if codes:
            machine, still, reference = self._g_words(block, codes, bool(axis_words), others)
        if names:
            machine = self._names(block, names, bool(axis_words)) or machine
        centre: list[Late] = []
        for item in others:
            name = item[0]
            if name in _CENTRE or name in _SPINDLE_VECTOR or name in ("R", "CR", "TURN"):
                centre.append(item)
            elif name == "P" and self.motion in (2, 3) and axis_words:
                centre.append(item)
            elif name in _AXIS_LETTERS or (name[0] in _AXIS_LETTERS and name[1:].isdigit()):
                raise self.no_axis(f"{item[0]}{item[5]}")
            elif name == "L":
                raise self.refuse("subprogram call or repetition", block.text[item[1] : item[2]], vocabulary.FLAT)
            elif name == "O":
                if axis_words or names:
                    raise self.refuse("control flow", block.text.strip(), vocabulary.FLAT)
            elif name == "N":
                raise self.refuse("a block number inside a block", block.text[item[1] : item[2]], "N at its start")
            elif name not in _PLAIN:
                if axis_words:
                    raise self.refuse(
                        "a word that is not understood in a block that moves axes",
                        block.text[item[1] : item[2]],
                        "words whose effect on the motion is known",
                    )
                self.note(f"{block.text[item[1] : item[2]].strip()} is not understood and passes through")
        block.motion = self.motion
        block.inch = self.inch
        block.incremental = self.incremental
        block.inverse_time = self.feed_mode == "93"
        if still:
            return block
        if reference:
            which = [self._axis(item) for item in axis_words]
            self.note("reference return or probing passes through uncompensated; its axes are unknown afterwards")
            self.forget(block, which or range(len(self.names)), moved=True)
            return block
        if axis_words or centre:
            self._motion(block, axis_words, centre, machine)
        return block

    # ------------------------------------------------------------------ words

    def _code(self, value: str) -> str:
        code = self._codes.get(value)
        if code is None:
            word = canonical(f"G{value}")
            if len(word) < 2 or not word[1].isdigit():
                raise self.no_number("G", value)
            code = self._codes[value] = word[1:]
        return code

    def _m_word(self, block: Block, start: int, end: int, value: str) -> None:
        word = canonical(f"M{value}")
        if word in vocabulary.REFUSED_M:
            raise self.refuse("subprogram call", word, vocabulary.FLAT)
        if len(word) < 2:
            raise self.no_number("M", value)
        if word in vocabulary.LAST_M:
            block.last_m.append(Span(start, end, word))
        if word in self.tcp_on:
            self._switch(block, True, word)
        elif word in self.tcp_off:
            self._switch(block, False, word)

    def _g_words(
        self, block: Block, codes: list[Span], axis_words: bool, others: list[Late]
    ) -> tuple[bool, bool, bool]:
        machine = still = reference = False
        seen: set[str] = set()
        for span in codes:
            code = span.name
            group = vocabulary.GROUP_OF.get(code)
            if group is None:
                known = vocabulary.REFUSED_CODES.get(code)
                if known is not None:
                    raise self.refuse(known[0], block.text.strip(), known[1])
                if f"G{code}" in self.tcp_on or f"G{code}" in self.tcp_off:
                    group = ""
                elif axis_words:
                    raise self.refuse("a G word that is not understood", f"G{code}", "G words whose effect is known")
                else:
                    self.note(f"G{code} is not understood and passes through")
                    self.forget(block, range(len(self.names)))
                    continue
            if group:
                if group in seen:
                    raise self.refuse(
                        f"two G words of one modal group ({group})",
                        block.text.strip(),
                        "one G word of a group in a block",
                    )
                seen.add(group)
            if group == "motion":
                self.motion = int(code)
                block.motion_word = span
            elif group == "distance":
                self.incremental = code == "91"
            elif group == "feed":
                self.feed_mode = code
            elif group == "plane":
                self.plane = int(code)
            elif group == "units":
                self.inch = code in ("20", "70", "700")
            elif group == "arc centre":
                self.absolute_centre = code == "90.1"
            elif group == "machine":
                machine = True
            elif group == "still":
                still = True
            elif group == "reference":
                reference = True
            elif group == "offset":
                self._offset(code, axis_words, "motion" in seen or any(c.name in "0123" for c in codes), others)
            elif group == "length":
                self.length_vector = code == "43.5"
                if self.tcp_by in ("G43.4", "G43.5") and code in ("43", "44"):
                    self._switch(block, False, f"G{code}")
            elif code == "5" and (axis_words or not any(item[0] == "P" for item in others)):
                raise self.refuse("curve G5", block.text.strip(), vocabulary.LINEAR)
            word = f"G{code}"
            if word in self.tcp_on:
                self._switch(block, True, word)
            elif word in self.tcp_off:
                self._switch(block, False, word)
        return machine, still, reference

    def _offset(self, code: str, axis_words: bool, moves: bool, others: list[Late]) -> None:
        if code in ("58", "59") and axis_words and not moves:
            raise self.refuse(f"coordinate transformation G{code}", f"G{code}", vocabulary.BAKED)
        if code == "54.1":
            code += "".join(f" P{item[5]}" for item in others if item[0] == "P")
        self.offset = code
        self.offset_line = self._line

    def _names(self, block: Block, names: list[Late], axis_words: bool) -> bool:
        """Apply statements by name; whether one says machine coordinates."""
        machine = False
        for place, (name, start, end, _, _, arguments) in enumerate(names):
            shown = block.text[start:end]
            if name == "SUPA":
                machine = True
            elif name in self.tcp_on:
                self._switch(block, True, name)
            elif name in self.tcp_off:
                self._switch(block, False, name)
            elif name in vocabulary.TRANSFORMS:
                if name not in vocabulary.CANCELLING or axis_words or arguments.strip("() \t"):
                    raise self.refuse(
                        f"coordinate transformation {name}", block.text[start:].split(";")[0].strip(), vocabulary.BAKED
                    )
            elif name == "MCALL" or (place and names[place - 1][0] == "MCALL"):
                self._mcall(block, name, arguments, start, len(names) == place + 1)
            elif name in vocabulary.CURVES:
                raise self.refuse(f"curve or rounding {name}", block.text.strip(), vocabulary.LINEAR)
            elif name in vocabulary.PASSED:
                continue
            elif vocabulary.CYCLE.fullmatch(name):
                raise self.refuse(f"canned cycle {name}", shown, vocabulary.EXPAND)
            elif name[0] in self.index and not arguments and "_" not in name and not name.startswith("CYCLE"):
                raise self.refuse("a word without a number", shown, f"a number after {name[0]}")
            elif axis_words:
                raise self.refuse(
                    "a word that is not understood in a block that moves axes", shown, "words whose effect is known"
                )
            else:
                self.note(f"{shown.strip()} is not understood and passes through; every axis is unknown afterwards")
                self.forget(block, range(len(self.names)))
        return machine

    def _mcall(self, block: Block, name: str, arguments: str, start: int, last: bool) -> None:
        if name == "MCALL":
            block.cycle_word = Span(start, len(block.text.rstrip("\r\n")))
            if last:
                self.cycle = None
            return
        unit = MM_PER_INCH if self.inch else 1.0
        cycle = self.variables.drilling(name, arguments, unit) if last and self.plane == 17 and not self.tcp else None
        if cycle is None:
            raise self.refuse(f"canned cycle {name}", block.text[start:].strip(), vocabulary.EXPAND)
        self.cycle = cycle

    # ------------------------------------------------------------------ values

    def _assigned(self, item: Late, bracket: str) -> bool:
        """Take an assignment that is no word of the block; whether it was one."""
        name, value = item[0], item[5]
        if len(name) == 1:
            return False
        if name in _SPINDLE_VECTOR or name in ("CR", "TURN"):
            return False
        if name[0] in "ABCD" and name[1:] in ("2", "4", "5", "6", "7"):
            raise self.refuse(
                f"tool orientation by {name}", f"{name}={value}", "a tool vector A3= B3= C3=, or rotary axes"
            )
        if name in vocabulary.CURVES or name in ("I1", "J1", "K1"):
            raise self.refuse(f"curve or rounding {name}", f"{name}={value}", vocabulary.LINEAR)
        if name in vocabulary.TRANSFORMS or name.startswith("$P_"):
            raise self.refuse(f"coordinate transformation {name}", f"{name}={value}", vocabulary.BAKED)
        if name[1:].isdigit() and name[0] in _AXIS_LETTERS:
            return False
        if name.startswith("$"):
            self.note(f"{name} is set by the program; what that does is not known here")
            return True
        self.variables.set(name + bracket, value)
        return True

    def _axis(self, item: Late) -> int:
        return self.index[item[0]]

    def _axis_word(self, item: Late, machine: bool) -> AxisWord:
        name, start, end, value_start, value_end, text = item
        axis = self.index[name]
        form = ""
        value = number(text)
        if value != value:
            wrapped = vocabulary.WRAPPED.fullmatch(text)
            if wrapped is not None:
                form = wrapped.group(1).upper()
                value_start, value_end = value_start + wrapped.start(2), value_start + wrapped.end(2)
                text = wrapped.group(2)
            value = self.variables.value(text)
            if value != value and not machine:
                if vocabulary.LITERAL.fullmatch(text):
                    raise self.no_number(name, text)
                raise self.refuse(f"the value of {name} is not known here", text, "a number, or a variable set to one")
        if self.inch and axis < self.linear:
            value *= MM_PER_INCH
        incremental = form == "IC" or (form == "" and self.incremental)
        return AxisWord(axis, start, end, value_start, value_end, form, incremental, value)

    # ------------------------------------------------------------------ motion

    def _motion(self, block: Block, axis_words: list[Late], centre: list[Late], machine: bool) -> None:
        words = block.words
        seen = 0
        for item in axis_words:
            word = self._axis_word(item, machine)
            bit = 1 << word.axis
            if seen & bit:
                raise self.refuse(f"axis {item[0]} twice in one block", block.text.strip(), "each axis once")
            seen |= bit
            words.append(word)
        if machine:
            self._machine_move(block, centre, seen)
            return
        position = self.position
        start = position[: self.linear]
        for word in words:
            plain = not (word.incremental or word.form)
            position[word.axis] = word.value if plain else self._target(word)
        motion = self.motion
        vector = None
        arc: Arc | None = None
        if centre:
            vector = self._vector(block, centre)
        if motion is None:
            self.note("axes move before any of G0, G1, G2, G3: taken as a linear move", once=True)
            kind = Kind.LINEAR
        elif motion >= 2:
            kind = Kind.ARC
            if vector is not None or (self.length_vector and self.tcp):
                raise self.refuse("an arc with a tool vector", block.text.strip(), vocabulary.LINEAR)
            arc = self._arc(block, centre, start, seen)
        else:
            kind = Kind.LINEAR if motion else Kind.RAPID
            if centre and vector is None:
                item = centre[0]
                raise self.refuse(
                    f"{item[0]} outside a circular block", block.text[item[1] : item[2]], "arcs with G2 or G3"
                )
        if self.offset is not None and self.offset != self.used_offset:
            if self.used_offset is not None:
                raise self.refuse(
                    "a second work offset",
                    f"G{self.offset}",
                    f"one work offset in a program (moves so far are in G{self.used_offset})",
                    self.offset_line + 1,
                )
            self.used_offset = self.offset
        if vector is not None:
            self._turn_to(block, vector, seen)
        elif seen >> self.linear:
            self.vector = None
        if self.vector is not None:
            block.vector_names = ("I", "J", "K") if self.length_vector else ("A3=", "B3=", "C3=")
        if block.skip:
            self.note("block skip: taken as executed", once=True)
        block.moves.append(
            Move(
                line=self._line,
                kind=kind,
                tcp=self.tcp,
                position=tuple(position),
                named=self.named(seen),
                vector=self.vector,
                arc=arc,
            )
        )
        if self.cycle is not None:
            self._drill(block, self.cycle)

    def _turn_to(self, block: Block, vector: tuple[float, float, float] | None, seen: int) -> None:
        """Take a tool vector: where the rotary axes are is then the control's business."""
        if seen >> self.linear:
            raise self.refuse("a tool vector and rotary axes in one block", block.text.strip(), "one of them")
        self.vector = vector
        for i in range(self.linear, len(self.position)):
            self.position[i] = math.nan

    def _target(self, word: AxisWord) -> float:
        last = self.position[word.axis]
        value = word.value
        if word.incremental:
            if last != last:
                raise self.no_position(word.axis)
            return last + value
        if word.form in ("DC", "ACP", "ACN") and last == last:
            turn = (value - last) % 360.0
            if word.form == "ACN" and turn > 0.0:
                turn -= 360.0
            elif word.form == "DC" and turn > 180.0:
                turn -= 360.0
            return round(last + turn, 9)
        return value

    def _machine_move(self, block: Block, centre: list[Late], seen: int) -> None:
        if centre or self.cycle is not None:
            raise self.refuse("machine coordinates in an arc or a cycle", block.text.strip(), "a straight move")
        position = self.machine_position(block.words, block)
        block.moves.append(
            Move(
                line=self._line,
                kind=Kind.RAPID if self.motion == 0 else Kind.LINEAR,
                tcp=self.tcp,
                position=position,
                named=self.named(seen),
                machine=True,
            )
        )

    def _vector(self, block: Block, centre: list[Late]) -> tuple[float, float, float] | None:
        by_length = self.length_vector and self.tcp and self.motion in (None, 0, 1)
        components = [0.0, 0.0, 0.0]
        found = False
        for name, start, end, value_start, value_end, text in centre:
            index = _SPINDLE_VECTOR.get(name)
            if index is None and by_length:
                index = _CENTRE.get(name)
            if index is None:
                continue
            if not self.tcp:
                raise self.refuse(f"tool vector {name} while the control's kinematics are off", text, "TRAORI first")
            value = self.variables.value(text)
            if value != value:
                raise self.no_number(name, text)
            if index in block.vector_words:
                raise self.refuse(f"{name} twice in one block", block.text.strip(), "each word once")
            components[index] = value
            block.vector_words[index] = Span(value_start, value_end, block.text[start:end])
            found = True
        if not found:
            return None
        return self.direction("tool vector", components, block.text.strip())

    def _arc(self, block: Block, items: list[Late], start: list[float], seen: int) -> Arc:
        a, b, _ = plane = PLANES[self.plane]
        scale = MM_PER_INCH if self.inch else 1.0
        centre: dict[int, float] = {}
        radius: float | None = None
        turns = 0
        for name, begin, end, _, _, text in items:
            block.arc_words.append(Span(begin, end, name))
            wrapped = vocabulary.WRAPPED.fullmatch(text)
            value = self.variables.value(wrapped.group(2) if wrapped else text)
            if value != value:
                raise self.no_number(name, text)
            if name in _CENTRE:
                axis = _CENTRE[name]
                if axis in centre:
                    raise self.refuse(f"{name} twice in one block", block.text.strip(), "each word once")
                absolute = wrapped.group(1).upper() == "AC" if wrapped else self.absolute_centre
                centre[axis] = value * scale + (0.0 if absolute else start[axis])
                if axis not in (a, b):
                    raise self.refuse(
                        f"{name} outside the plane G{self.plane}", block.text.strip(), "a centre in the plane"
                    )
            elif name in ("R", "CR"):
                radius = value * scale
            else:
                if value != int(value) or not 0 <= value < 1e6:
                    raise self.refuse(f"{name} is not a number of turns", text, "a whole number")
                turns = int(value) if name == "TURN" else max(0, int(value) - 1)
        clockwise = self.motion == 2
        from_, to = (start[a], start[b]), (self.position[a], self.position[b])
        if radius is not None and not centre:
            found = arc_by_radius(plane, from_, to, radius, clockwise, turns)
        elif centre and radius is None:
            middle = (centre.get(a, start[a]), centre.get(b, start[b]))
            found = arc_by_centre(plane, from_, to, middle, clockwise, turns)
        else:
            found = Misfit("an arc needs either a centre or a radius", "I, J, K or R (CR=)")
        if isinstance(found, Misfit):
            raise self.refuse(found.what, block.text.strip(), found.expected)
        return found

    def _drill(self, block: Block, cycle: Drilling) -> None:
        if self.incremental or self.tcp or self.vector is not None or block.last_m:
            raise self.refuse("canned cycle", block.text.strip(), vocabulary.EXPAND)
        position = self.position
        named = frozenset(self.names[2:3])
        for height, kind in ((cycle.approach, Kind.RAPID), (cycle.depth, Kind.LINEAR), (cycle.retract, Kind.RAPID)):
            position[2] = height
            block.moves.append(Move(line=self._line, kind=kind, tcp=False, position=tuple(position), named=named))
        block.dwell = cycle.dwell

    # ------------------------------------------------------------------ state

    def _switch(self, block: Block, on: bool, word: str) -> None:
        if on == self.tcp:
            return
        if not on:
            if word == "G49" and self.tcp_by not in ("", "G43.4", "G43.5"):
                return  # it ends a length offset, not what another word switched on
            if not self.tcp_by:
                self.note(f"{word} switches the control's kinematics off", once=True)
            self.vector = None
        self.tcp = on
        self.tcp_by = word if on else "off"
        block.switched = True
        self.forget(block, range(self.linear), moved=None)

    def _stray(self, character: str, text: str, at: int) -> InputError:
        letter = character.upper()
        rest = text[at:].strip()
        if letter in self.index or letter in "FGMIJKRSTDHN":
            return self.refuse(f"{letter} has no number", rest.split(";")[0].strip(), f"a number after {letter}")
        if letter in _AXIS_LETTERS:
            return self.no_axis(rest)
        if character == "(":
            return self.refuse("a comment or argument list without its closing parenthesis", rest, "( ... )")
        if letter == "O":
            return self.refuse("control flow", rest, vocabulary.FLAT)
        return self.refuse("a character that is not understood", rest, "words: letter and number")
