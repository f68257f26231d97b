"""Write a program of any length stretch by stretch, and read it back."""

from __future__ import annotations

from dataclasses import replace
from typing import BinaryIO, Final, final

from twin._common.errors import InputError
from twin.compensation.checked import check, unreadable
from twin.compensation.prepared import PreparedMachine
from twin.compensation.stream.parts import ProgramFile, ProgramPart, ReadStretch
from twin.nc.columns import NewPositions
from twin.nc.header import HEAD_LINES
from twin.nc.iso.dialect import Iso
from twin.nc.iso.stream import IsoRewriter, iso_reader
from twin.nc.lines.chunks import Chunk
from twin.nc.lines.compiled import line_code

ISO: Final = Iso()


@final
class PartWriter:
    """Writes a program part by part.

    Args:
        prepared: machine, calibration and options.
        source: the original program.
        out: output stream.

    Attributes:
        moves: number of moves written.
        bytes: bytes of the original program that have been written.
    """

    def __init__(self, prepared: PreparedMachine, source: ProgramFile, out: BinaryIO) -> None:
        self._prepared, self._axes, self._name = prepared, prepared.space.axes, str(source.path)
        self._source_lines = source.lines
        self._code = line_code(source.lines)
        self._begins = source.begins()
        self._out = out
        self._checker = iso_reader(self._name, self._axes, tcp=prepared.options.tcp)
        self._rewriter: IsoRewriter | None = None
        self._pending: list[bytes] = []
        self._head: bytes | None = b""
        self._lines = self.moves = self.bytes = 0

    def write(self, part: ProgramPart, new: NewPositions) -> None:
        """Write a part, and read back what was written.

        Raises:
            OutputError: it differs from the intended positions.
        """
        first = 0
        for read in part.read:
            own = slice(first, first + len(read.moves))
            idle = part.aim is not None and part.aim.idle
            self._write(read, replace(new, first=new.first[own], count=new.count[own]), idle=idle)
            first = own.stop

    def _write(self, read: ReadStretch, new: NewPositions, *, idle: bool) -> None:
        stretch, moves = read
        if self._rewriter is None and not len(moves):
            self._pending.append(
                stretch.scan.data
            )  # the mode of the lines before the first move is that of the first move
            return
        if self._rewriter is None:
            newline, style = self._begins
            self._rewriter = IsoRewriter(
                self._name, self._axes, newline, style, tcp=bool(moves.tcp[0]), code=self._code
            )
            if self._pending:
                stretch = Chunk(b"".join(self._pending) + stretch.scan.data, 0, self._axes.names, self._code)
                self._pending = []
        data = stretch.scan.data if idle else self._rewriter.write(stretch, moves, new)
        # Arcs and splitting may make a short program long.
        written = Chunk(data, self._lines, self._axes.names, line_code(max(self._source_lines, self._lines)))
        try:
            read_back = self._checker.read(written)
        except InputError as error:
            raise unreadable(self._name, error) from error
        self._lines += len(written)
        check(self._name, moves.line + 1, new, read_back.position)
        self._put(data, last=False)
        self.moves += len(moves)
        self.bytes += len(stretch.scan.data)

    def _put(self, data: bytes, *, last: bool) -> None:
        """Write data; the first lines are held until the head is complete and then written with the warning comments."""
        if self._head is None:
            self._out.write(data)
            return
        self._head += data
        if last or self._lines >= HEAD_LINES:
            comments = self._prepared.comments
            self._out.write(ISO.with_comments(self._head.decode("latin-1"), comments).encode("latin-1"))
            self._head = None

    def finish(self) -> None:
        """Write the lines still held."""
        self._put(b"", last=True)
