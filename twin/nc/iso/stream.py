"""ISO programs processed in chunks (`twin.nc.lines.chunks`)."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Final, final

import numpy as np

from twin.nc.blocks import AxisWords, Kind
from twin.nc.iso.interpreter import IsoInterpreter
from twin.nc.iso.writer import CODE, IsoWriter
from twin.nc.lines.chunks import ChunkReader, ChunkRewriter, SimpleRun, only_places
from twin.nc.lines.compiled import ARRAYS, LineCode
from twin.nc.text import Style
from twin.nc.word_texts import Formatting
from twin.nc.writer import Segments

_LINE: Final = re.compile(rb"[^\r\n]*+(?:\r\n|\n|\r)")


def iso_reader(source: str, axes: AxisWords, *, tcp: bool) -> ChunkReader:
    """Return a reader of ISO programs.

    Args:
        source: file name for messages.
        axes: axis words.
        tcp: whether tool centre point control is on from the start.
    """
    return ChunkReader(IsoInterpreter(source, axes, tcp=tcp))


@final
class IsoRewriter(ChunkRewriter):
    """Writer of a program, chunk by chunk.

    Args:
        source: file name for messages.
        axes: axis words.
        newline: line ending of the program.
        style: its number format (`twin.nc.text.style_in`).
        tcp: whether tool centre point control is on at the first move.
        expand_cycles: whether drilling cycles are expanded into blocks.
        rigid_lines: as for `IsoWriter`.
        code: how simple lines are written.
    """

    def __init__(
        self,
        source: str,
        axes: AxisWords,
        newline: str,
        style: Style,
        *,
        tcp: bool,
        expand_cycles: bool = False,
        rigid_lines: frozenset[int] = frozenset(),
        code: LineCode = ARRAYS,
    ) -> None:
        self._interpreter = IsoInterpreter(source, axes, tcp=tcp)
        self._writer = IsoWriter(source, axes, newline, style, expand_cycles=expand_cycles, rigid_lines=rigid_lines)
        super().__init__(axes, self._interpreter, self._writer, code)

    def line(self, line: int, text: str, segments: Mapping[int, Segments]) -> str:
        """See `ChunkRewriter.line`."""
        block = self._interpreter.step(line, text)
        return text if block is None else self._writer.block(line, block, segments)

    def formatting(self, run: SimpleRun) -> Formatting | None:
        """See `ChunkRewriter.formatting`."""
        writer, scan, lines = self._writer, run.scan, run.lines
        if self._interpreter.feed_mode == "93" or (scan.code[lines[0]] < 0 and writer.motion != run.motion[0]):
            return None
        if self._interpreter.cycle is not None and not self._drills_alike(run):
            return None
        writer.motion = int(run.motion[-1])
        return Formatting(writer.style, writer.spaced, writer.lower)

    def _drills_alike(self, run: SimpleRun) -> bool:
        """Return whether lines, one after the other, name places of holes, and every segment of a stroke moves."""
        writer, scan, lines, text = self._writer, run.scan, run.lines, run.scan.text
        if not writer.expand_cycles or not only_places(scan, lines, writer.linear - 1):
            return False
        first, second = scan.words.start[scan.first[lines]] - 1, scan.first[lines] + 1
        second = second[second < scan.first[lines + 1]]
        spaced = writer.spaced and np.all(text[scan.words.start[second] - 2] <= ord(" "))
        small = text[first] >= ord("a")
        alike = spaced and np.all(small == small[0])
        strokes = self._interpreter.strokes()
        moving = [stroke for stroke in strokes if stroke.height == stroke.height]
        if any(stroke.thread is not None for stroke in strokes):
            return False
        ends = bool(moving) and (moving[-1].kind is Kind.RAPID) == (run.motion[0] == 0)
        consecutive = (
            run.whole == slice(int(scan.start[lines[0]]), int(scan.end[lines[-1]]))
            and len(lines) == lines[-1] - lines[0] + 1
        )
        if not (alike and ends and consecutive and len(run.segments) == len(lines) * (1 + len(moving))):
            return False
        steps = np.rint(np.nan_to_num(run.targets) / self._grids.step)
        moved = (steps[1:] != steps[:-1]).any(axis=1)
        moved[np.cumsum(run.per_line)[:-1] - 1] = True
        return bool(moved.all())

    def written(self, run: SimpleRun, text: bytes, formatting: Formatting) -> bytes:
        """See `ChunkRewriter.written`."""
        self._writer.spaced = formatting.spaced
        coded = run.lines[run.scan.code[run.lines] >= 0]
        if coded.size:
            self._writer.wide = bool(run.scan.wide[coded[-1]])
        return text if self._interpreter.cycle is None else self._with_strokes(run, text)

    def _with_strokes(self, run: SimpleRun, text: bytes) -> bytes:
        """Return lines of holes whose strokes have been written as segments, with their motion words, feeds and blocks behind."""
        out = _LINE.findall(text)
        strokes = self._interpreter.strokes()
        moving = [stroke for stroke in strokes if stroke.height == stroke.height]
        codes = np.tile([int(run.motion[0]), *(CODE[stroke.kind] for stroke in moving)], len(run.lines))
        codes = np.repeat(codes, run.segments)
        for row in (np.flatnonzero(codes[1:] != codes[:-1]) + 1).tolist():
            out[row] = f"{self._writer.g(int(codes[row]))} ".encode("latin-1") + out[row]
        each, behind, place = 1 + len(moving), np.cumsum(run.segments), 0
        for stroke in strokes:
            place += stroke.height == stroke.height
            last = behind[place::each]
            for row in _ranges(last - run.segments[place::each], last) if stroke.feed else ():
                body = out[row].rstrip(b"\r\n")
                out[row] = body + f" {stroke.feed}".encode("latin-1") + out[row][len(body) :]
            for row in (last - 1).tolist() if stroke.after else ():
                end = out[row][len(out[row].rstrip(b"\r\n")) :]
                out[row] += stroke.after.encode("latin-1") + end
        return b"".join(out)


def _ranges(begin: np.ndarray, end: np.ndarray) -> Iterator[int]:
    """Yield the whole numbers of ranges."""
    for first, last in zip(begin.tolist(), end.tolist(), strict=True):
        yield from range(first, last)
