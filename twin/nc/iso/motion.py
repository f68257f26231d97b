"""Effects of ISO blocks on the axes: values of words, targets, arcs, tool vectors, machine coordinates."""

from __future__ import annotations

from typing import Final

from twin.nc.arcs import MOST_TURNS, PLANES, ArcMisfit, arc_by_centre, arc_by_radius
from twin.nc.block import AxisWord, Span
from twin.nc.blocks import Arc, AxisWords, Kind, Move
from twin.nc.iso import vocabulary
from twin.nc.iso.block import IsoBlock, Item
from twin.nc.iso.drilling import IsoDrilling
from twin.nc.text import MM_PER_INCH, number

CENTRE: Final = {"I": 0, "J": 1, "K": 2}
SPINDLE_VECTOR: Final = {"A3": 0, "B3": 1, "C3": 2}
_KINDS: Final = (Kind.RAPID, Kind.LINEAR, Kind.ARC, Kind.ARC)


class IsoMotion(IsoDrilling):
    """The modal state that determines the meaning of axis words, and its changes by blocks."""

    def __init__(self, source: str, axes: AxisWords, *, tcp: bool) -> None:
        on = vocabulary.TCP_ON | {vocabulary.canonical(word) for word in axes.tcp_on}
        off = vocabulary.TCP_OFF | {vocabulary.canonical(word) for word in axes.tcp_off}
        super().__init__(source, axes, tcp=tcp, tcp_on=on, tcp_off=off)
        self.absolute_centre = False
        self.feed_mode = "94"
        self.length_vector = False

    @property
    def runs_allowed(self) -> bool:
        """See `Interpreter.runs_allowed`: no pending work offset, incremental mode or tool vector, nor a cycle that changes."""
        return self.steady and self.set_up and not self.incremental and self.vector is None

    def move(self, block: IsoBlock, centre: list[Item], *, machine: bool) -> None:
        """Add the moves of a block whose axis words are known.

        Args:
            block: the block.
            centre: its words for a centre, a radius, full turns or a tool vector.
            machine: whether its axis words are machine coordinates.

        Raises:
            InputError: a word contradicts another word or the modal state.
        """
        motion = self.motion
        self.check_plane(block.axis_bits >> self.linear != 0)
        if machine:
            if centre or self.cycle is not None:
                raise self.error("machine coordinates in an arc or a cycle", "a straight move")
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
        start = self.position[: self.linear]
        self.apply_words(block)
        vector = self._vector(block, centre) if centre else None
        arc: Arc | None = None
        if motion is None:
            self.note("axes move before any of G0, G1, G2, G3: assumed to be a linear move", once=True)
        elif motion >= 2:
            if vector is not None or (self.length_vector and self.tcp):
                raise self.error("arc with a tool vector", vocabulary.LINEAR)
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
        if block.skip:
            self.note("block skip: assumed to be executed", once=True)
        named = self.named(block.axis_bits)
        block.moves += (Move(self._line, kind, self.tcp, tuple(self.position), named, False, self.vector, None, arc),)
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

    def axis_word(self, item: Item, *, machine: bool) -> AxisWord:
        """Return an axis word with its value.

        Raises:
            InputError: the value is unknown, and the block is not in machine coordinates.
        """
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
                raise self.error(
                    f"the value of {name} is unknown", "a number, or a variable set to a number before", text
                )
        if self.inch and axis < self.linear:
            value *= MM_PER_INCH
        incremental = form == "IC" or (form == "" and self.incremental)
        return tuple.__new__(AxisWord, (axis, start, end, value_start, value_end, form, incremental, value))

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
        centre: dict[int, float] = {}
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
                if value != int(value) or not 0 <= value <= MOST_TURNS:
                    raise self.error(f"{name} is not a number of turns", f"a whole number up to {MOST_TURNS}", text)
                turns = int(value) if name == "TURN" else max(0, int(value) - 1)
            elif CENTRE[name] in centre:
                raise self.error(f"{name} twice in one block", "each word once")
            else:
                axis = CENTRE[name]
                absolute = wrapped.group(1).upper() == "AC" if wrapped else self.absolute_centre
                centre[axis] = value * scale + (0.0 if absolute else start[axis])
                if axis not in (a, b):
                    raise self.error(f"{name} outside the plane G{self.plane}", "a centre in the plane")
        clockwise = self.motion == 2
        from_, to = (start[a], start[b]), (self.position[a], self.position[b])
        if radius is not None and not centre:
            return self.valid_arc(arc_by_radius(plane, from_, to, radius, clockwise, turns))
        if centre and radius is None:
            middle = (centre.get(a, start[a]), centre.get(b, start[b]))
            return self.valid_arc(arc_by_centre(plane, from_, to, middle, clockwise, turns))
        return self.valid_arc(ArcMisfit("arc without centre or radius, or with both", "either I, J, K or R (CR=)"))
