"""Effects of ISO blocks on the axes: values of words, targets, arcs, tool vectors, machine coordinates."""

from __future__ import annotations

from typing import Final

from twin.nc.arcs import (
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
from twin.nc.iso import vocabulary
from twin.nc.iso.drilling import TAP, IsoDrilling
from twin.nc.iso.frame import IsoBlock, Item
from twin.nc.iso.paths import CENTRE, FORMS, IsoPaths
from twin.nc.modal import BESIDE, CORRECTION_DEG, Span
from twin.nc.text import MM_PER_INCH

_OF_LINUXCNC: Final = frozenset({"53.3", "59.1", "59.2", "59.3", "92.2", "92.3", "38.2", "38.3", "38.4", "38.5"})
_OF_FANUC: Final = frozenset({"54.1", "154", "68.2", "65", "268"})
_NOT_OF_SINUMERIK: Final = frozenset({*_OF_LINUXCNC, *_OF_FANUC, "20", "21", "28", "43", "49", "80", "98", "99"})
SPINDLE_VECTOR: Final = {"A3": 0, "B3": 1, "C3": 2}
_KINDS: Final = (Kind.RAPID, Kind.LINEAR, Kind.ARC, Kind.ARC)
MACHINE_INCREMENTS: Final = (
    "G53 in G91: Mitsubishi moves by the increments, Fanuc leaves the move out, LinuxCNC refuses it; the block stays as written, and "
    "the positions of its axes are unknown afterwards"
)


class IsoMotion(IsoDrilling, IsoPaths):
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
            or self.curve
            or self.rounded
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
        path, centre = self.path_words(centre)
        about = self.go_to_end(block, path, start)
        vector = self._vector(block, centre) if centre else None
        arc: Arc | None = None
        if motion is None:
            self._assume_linear()
        elif motion >= 2:
            if vector is not None or (self.length_vector and self.tcp):
                raise self.error("arc with a tool vector", vocabulary.LINEAR)
            if self.arc_from_unknown(block, start, PLANES[self.plane][:2]):
                return
            arc = self.arc_of_path(block, path, about, start, centre) or self._arc(block, centre, start)
        elif centre and vector is None:
            first = centre[0]
            shown = block.text[first.start : first.end]
            raise self.error(f"{first.name} outside a circular block", "arcs with G2 or G3", shown)
        self.use_set_up(kind)
        self._take_vector(block, vector)
        named, whole = self.named(block.axis_bits), self._compensated(block, rotary)
        named |= self.named_by_path(path)
        move = Move(self._line, kind, self.tcp, tuple(self.position), named, False, self.vector, None, arc, "", whole)
        block.moves += (move,)
        if self.cycle is not None:
            self.drill(block, self.cycle)

    def _take_vector(self, block: IsoBlock, vector: tuple[float, float, float] | None) -> None:
        if vector is not None:
            self.set_tool_vector(block.axis_bits, vector)
        elif block.axis_bits >> self.linear:
            self.vector = None
        if self.vector is not None:
            block.vector_names = ("I", "J", "K") if self.length_vector else ("A3=", "B3=", "C3=")

    def _assume_linear(self) -> None:
        """Note that a move is taken as a straight one; raise `InputError` where G33.1 is in force."""
        if self._tapped:
            raise self.error(f"axis words where G{TAP} is in force", "G0 or G1 before them")
        self.note("axes move before any of G0, G1, G2, G3: assumed to be a linear move", once=True)

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
            elif self._is_in_plane(name, value):
                words[CENTRE[name]] = (
                    value * scale,
                    FORMS.get(wrapped.group(1).upper(), FROM_START) if wrapped else None,
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

    def _is_in_plane(self, name: str, value: float) -> bool:
        """Return whether a centre word counts in the plane in force; raise `InputError` for another one that is not zero."""
        if CENTRE[name] in PLANES[self.plane][:2]:
            return True
        if value != 0.0:
            raise self.error(f"{name} outside the plane G{self.plane}", "a centre in the plane")
        self.note(f"{name}0 outside the plane G{self.plane} says nothing; LinuxCNC refuses such a block", once=True)
        return False

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

    def tell_control(self, code: str) -> None:
        """Take a G code as a word of one control."""
        self.without_frames = self.without_frames or code in _NOT_OF_SINUMERIK
        if code in _OF_LINUXCNC:
            self.control = "LinuxCNC"
        elif code in _OF_FANUC:
            self.control = "Fanuc"
