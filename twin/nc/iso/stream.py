"""ISO programs processed in chunks (`twin.nc.lines.chunks`)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

import numpy as np

from twin.nc.blocks import AxisWords
from twin.nc.iso.interpreter import IsoInterpreter
from twin.nc.iso.writer import IsoWriter
from twin.nc.lines.bulk import Formatting
from twin.nc.lines.chunks import ChunkReader, ChunkRewriter
from twin.nc.lines.compiled import ARRAYS, LineCode
from twin.nc.lines.scan import Scan
from twin.nc.text import Style
from twin.nc.writer import Segments


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
        code: LineCode = ARRAYS,
    ) -> None:
        self._interpreter = IsoInterpreter(source, axes, tcp=tcp)
        self._writer = IsoWriter(source, axes, newline, style, expand_cycles=expand_cycles)
        super().__init__(axes, self._interpreter, self._writer, code)

    def line(self, line: int, text: str, segments: Mapping[int, Segments]) -> str:
        """See `ChunkRewriter.line`."""
        block = self._interpreter.step(line, text)
        return text if block is None else self._writer.block(line, block, segments)

    def formatting(self, scan: Scan, whole: slice, lines: np.ndarray, motion: np.ndarray) -> Formatting | None:
        """See `ChunkRewriter.formatting`."""
        writer = self._writer
        if self._interpreter.feed_mode == "93" or (scan.code[lines[0]] < 0 and writer.motion != motion[0]):
            return None
        writer.motion = int(motion[-1])
        return Formatting(writer.style, writer.spaced, writer.lower)

    def written(self, scan: Scan, lines: np.ndarray, count: np.ndarray, text: bytes, formatting: Formatting) -> bytes:
        """See `ChunkRewriter.written`."""
        self._writer.spaced = formatting.spaced
        coded = lines[scan.code[lines] >= 0]
        if coded.size:
            self._writer.wide = bool(scan.wide[coded[-1]])
        return text
