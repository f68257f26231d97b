"""Heidenhain programs written in chunks (`twin.nc.lines.chunks`), with blocks renumbered where lines were inserted."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final, final

from twin.nc.blocks import AxisWords, Move
from twin.nc.columns import MoveColumns, NewPositions
from twin.nc.heidenhain.interpreter import HeidenhainInterpreter
from twin.nc.heidenhain.vocabulary import UNNUMBERED, renumbered
from twin.nc.heidenhain.writer import HeidenhainWriter
from twin.nc.lines.chunks import Chunk, ChunkRewriter, SimpleRun
from twin.nc.lines.compiled import LineCode
from twin.nc.text import Style
from twin.nc.word_texts import Formatting
from twin.nc.writer import Segments

_SPLIT: Final = re.compile(
    rb"(?:\A|(?<=[\r\n]))([ \t]*+(?:\d++[ \t]*+)?+L)([ \t][^\r\n]*+)(\r\n|\n|\r)((?:[A-CU-Za-cu-z][^\r\n]*+(?:\r\n|\n|\r))++)"
)
"""An L block followed by the words of further segments, each in a line that begins with an axis."""
_RAPID: Final = re.compile(rb"[ \t]FMAX(?=[ \t]|\Z)")
_SEGMENT: Final = re.compile(rb"([^\r\n]++)([\r\n]++)")


@final
class HeidenhainRewriter(ChunkRewriter):
    """Writer of a program, chunk by chunk.

    Args:
        source: file name for messages.
        axes: axis words.
        newline: line ending of the program.
        style: its number format (`twin.nc.text.style_in`).
        tcp: whether tool centre point control is on at the first move.
        code: how simple lines are written.
    """

    def __init__(self, source: str, axes: AxisWords, newline: str, style: Style, *, tcp: bool, code: LineCode) -> None:
        self._interpreter = HeidenhainInterpreter(source, axes, tcp=tcp)
        self._writer = HeidenhainWriter(source, axes, newline, style)
        self._comma = False
        super().__init__(axes, self._interpreter, self._writer, code)

    def whole(self, parts: Iterator[Chunk], moves: MoveColumns, new: NewPositions) -> str:
        """See `ChunkRewriter.whole`."""
        text = super().whole(parts, moves, new)
        return renumbered(text, _consecutive) if self._writer.inserted else text.replace(UNNUMBERED, "")

    def line(self, line: int, text: str, segments: Mapping[int, Segments]) -> str:
        """See `ChunkRewriter.line`."""
        continued = self._interpreter.continued
        move: Move | None = segments[0][0].move if segments else None
        written = self._writer.block(self._interpreter.step(line, text, move), segments.get(0))
        return f"{UNNUMBERED}{written}" if continued else written

    def formatting(self, run: SimpleRun) -> Formatting | None:
        """See `ChunkRewriter.formatting`. Lines with decimal commas are written as if with points: None if both occur."""
        data, style = run.scan.data[run.whole], self._writer.style
        if (b"." if style.comma else b",") in data:
            return None
        self._comma = style.comma
        return Formatting(style, True, False)

    def written(self, run: SimpleRun, text: bytes, formatting: Formatting) -> bytes:
        """See `ChunkRewriter.written`."""
        if run.per_line.max() > 1:
            text = _SPLIT.sub(self._segments, text)
        if self._comma:
            text = text.replace(b".", b",")
            self._writer.style = formatting.style._replace(comma=True)
        return text

    def _segments(self, match: re.Match[bytes]) -> bytes:
        """Return the blocks of a move with the beginning of the first one repeated in the others, and so ``FMAX``."""
        head, words, end, others = match.groups()
        self._writer.inserted |= head.strip() != b"L"
        tail = rb" FMAX\2" if _RAPID.search(words) else rb"\2"
        return head + words + end + _SEGMENT.sub(head + rb" \1" + tail, others)


def _consecutive(numbers: Sequence[str]) -> Iterable[int]:
    """Return consecutive block numbers that begin with the first of the old ones."""
    return itertools.count(int(numbers[0][:15])) if numbers else ()
