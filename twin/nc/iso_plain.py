"""The interpreter of ISO programs with its short way for plain blocks."""

from __future__ import annotations

import re
from typing import final

from twin.nc.blocks import Arc, AxisWords, Kind, Move
from twin.nc.iso_block import Block
from twin.nc.iso_state import Interpreter, Late
from twin.nc.plain import ISO_WORDS, Place, iso_plain, other_places
from twin.nc.text import MM_PER_INCH

MOTION = {"0": 0, "00": 0, "1": 1, "01": 1, "2": 2, "02": 2, "3": 3, "03": 3}
_CENTRE = frozenset("IJK")
_SPINDLE = frozenset({"A3", "B3", "C3"})
_KINDS = (Kind.RAPID, Kind.LINEAR, Kind.ARC, Kind.ARC)


@final
class PlainInterpreter(Interpreter):
    """Reads plain blocks without looking at every token."""

    def __init__(self, source: str, axes: AxisWords, *, tcp: bool) -> None:
        super().__init__(source, axes, tcp=tcp)
        self._plain = iso_plain(self.names)

    def plain(self, line: int, match: re.Match[str]) -> Move | None:
        """The move of a plain block, as `step` reads it; None (and nothing done) where only `step` will do.

        Args:
            line: 0-based index of its line.
            match: of `iso_plain`.
        """
        groups = match.groups()
        code = groups[0]
        motion = self.motion if code is None else MOTION[code]
        if motion is None or self.cycle is not None or self.offset != self.used_offset:
            return None
        others = other_places(match, self._plain)
        named = {ISO_WORDS[which] for which, _, _ in others}
        if motion >= 2:
            if not named or named & _SPINDLE or self.length_vector:
                return None
        elif not (named <= _SPINDLE or (named <= _CENTRE and self.tcp and self.length_vector)):
            return None  # words that do not belong here
        start = self.position
        seen = self.plain_words(groups[1:], self._plain.axes, self.incremental, MM_PER_INCH if self.inch else 1.0)
        if not seen:
            return None
        self.motion = motion
        arc: Arc | None = None
        if seen >> self.linear:
            self.vector = None
        if others:
            self._line = line
            text = match.string
            block = Block(text)
            items = [_item(text, place) for place in others]
            if motion >= 2:
                arc = self._arc(block, items, start[: self.linear], seen)
            else:
                self._turn_to(block, self._vector(block, items), seen)
        return Move(
            line, _KINDS[motion], self.tcp, tuple(self.position), self.named(seen), False, self.vector, None, arc
        )

    def follow(self, move: Move, motion: int) -> bool:
        """Be where a plain block's move, read before, has led; whether that can be."""
        if self.cycle is not None or self.offset != self.used_offset:
            return False
        self.position = list(move.position)
        self.vector = move.vector
        self.motion = motion
        return True


def _item(text: str, place: Place) -> Late:
    """A word as the general way has it."""
    which, start, end = place
    name = ISO_WORDS[which]
    begin = start - len(name) - (len(name) > 1)
    return name, begin, end, start, end, text[start:end]
