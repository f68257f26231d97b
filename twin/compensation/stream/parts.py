"""Read a program of any length: stretches of whole lines, several of which form a part that is solved together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from pathlib import Path
from typing import Final, NamedTuple, final

from twin._common.errors import InputError
from twin._common.files import open_input
from twin.compensation.prepared import CorrectionAim, PreparedMachine
from twin.compensation.toolpath import Follower, LostBlock, MotionColumns
from twin.nc.blocks import Notice
from twin.nc.columns import MoveColumns
from twin.nc.encoded import lines_in
from twin.nc.iso.stream import iso_reader
from twin.nc.lines.chunks import Chunk
from twin.nc.lines.compiled import line_code
from twin.nc.text import Style, TextCheck, ending, style_in

STRETCH_BYTES: Final = 3 << 17
"""Bytes read, written and read back at once."""
PART_LINES: Final = 24_576
"""Lines solved together: more need fewer calls and more memory. All parts of a long program are about equally long."""


@final
class ProgramFile:
    """File of a program.

    Args:
        path: its path.

    Attributes:
        size: bytes.
        lines: approximate number of lines.
        parts: number of parts in which it is solved.

    Raises:
        InputError: it cannot be read, or is not a program.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        check = TextCheck(str(path))
        for data in self._blocks():
            check.add(data)
        check.finish()
        self.size, self.lines = check.size, check.newlines or check.returns
        self.parts = max(self.lines // PART_LINES, 1)

    def begins(self) -> tuple[str, Style]:
        """Return its line ending and the style of its numbers."""
        lines = (line for data in self.stretches() for line in lines_in(data))
        first = next(lines)
        return ending(first) or "\n", style_in(chain((first,), lines), Style(point=True))

    def line(self, number: int) -> str:
        """Return the text of a line by its number."""
        lines = (line for data in self.stretches() for line in lines_in(data))
        return next(islice(lines, number - 1, None))

    def stretches(self) -> Iterator[bytes]:
        """Yield the file in stretches of whole lines."""
        left = b""
        for block in self._blocks():
            data = left + block
            # A carriage return as the last byte may be half of a line ending.
            cut = max(data.rfind(b"\n"), data.rfind(b"\r", 0, len(data) - 1)) + 1
            if cut:
                yield data[:cut]
            left = data[cut:]
        if left:
            yield left

    def _blocks(self) -> Iterator[bytes]:
        try:
            with open_input(self.path) as stream:
                while data := stream.read(STRETCH_BYTES):
                    yield data
        except OSError as error:
            raise InputError(
                "cannot be read", expected="a readable file", file=self.path, value=error.strerror
            ) from error


class ReadStretch(NamedTuple):
    """A stretch as read: its lines and its moves."""

    stretch: Chunk
    moves: MoveColumns


@final
@dataclass(frozen=True)
class ProgramPart:
    """Stretches as read, to be solved together.

    Attributes:
        read: the stretches.
        motions: their motions; moves are counted through the whole part.
        aim: errors to correct; None until a motion has been read.
    """

    read: Sequence[ReadStretch]
    motions: MotionColumns
    aim: CorrectionAim | None

    @property
    def moves(self) -> int:
        """Number of moves."""
        return sum(len(stretch.moves) for stretch in self.read)


@final
class PartReader:
    """Reads a program part by part.

    Args:
        prepared: machine, calibration and options.
        source: the program.
        turns: whether it moves rotary axes; None to decide from its first motions.

    Attributes:
        lines: number of lines read so far.
        turns_later: whether rotary motion appears only later, so that the program must be compensated again from its start.
        drills: whether it has a drilling cycle, or a tilted plane.
        failed: the error that ended reading; None if there is none.
    """

    def __init__(self, prepared: PreparedMachine, source: ProgramFile, turns: bool | None) -> None:
        self._prepared, self._source = prepared, source
        self._aim = None if turns is None else prepared.aim(turns=turns)
        self._reader = iso_reader(str(source.path), prepared.space.axes, tcp=prepared.options.tcp)
        self._code = line_code(source.lines)
        self._follower = Follower(str(source.path), prepared.space)
        self._notices: list[Notice] = []
        self._turns = False
        self.lines = 0
        self.turns_later = self.drills = False
        self.failed: InputError | None = None

    @property
    def notices(self) -> list[Notice]:
        """Notices on the lines read so far."""
        return [*self._notices, *self._follower.notices]

    @property
    def unknown(self) -> list[LostBlock]:
        """Blocks read so far that go to unknown places."""
        return self._follower.unknown

    def parts(self) -> Iterator[ProgramPart]:
        """Yield the program as read; if reading `failed`, everything before."""
        a_part = self._source.lines / self._source.parts
        full, read, motions = a_part, list[ReadStretch](), list[MotionColumns]()
        try:
            for data in self._source.stretches():
                read.append(self._read(data))
                motions.append(self._followed(read[-1], sum(len(stretch.moves) for stretch in read[:-1])))
                if self.drills:
                    break  # such a program is compensated as a whole
                if self.lines >= full:
                    full += a_part
                    yield self._part(read, motions)
                    read, motions = [], []
        except InputError as error:
            self.failed = error
        yield self._part(read, motions)

    def _part(self, read: list[ReadStretch], motions: list[MotionColumns]) -> ProgramPart:
        none = MotionColumns.of({}, len(self._prepared.space.axes.names))
        return ProgramPart(read, MotionColumns.joined(motions or [none]), self._aim)

    def _read(self, data: bytes) -> ReadStretch:
        stretch = Chunk(data, self.lines, self._prepared.space.axes.names, self._code)
        self.lines += len(stretch)
        moves = self._reader.read(stretch)
        self._notices += self._reader.notices()
        self.drills = self._reader.drills or bool(self._reader.frames)
        return ReadStretch(stretch, moves)

    def _followed(self, read: ReadStretch, before: int) -> MotionColumns:
        """Return the motions of a stretch; ``before``: number of earlier moves in its part."""
        motions = self._follower.columns(read.moves, self._reader.lost_positions(), read.stretch.text_of)
        self._turns = self._turns or read.moves.turns(self._prepared.space.axes.rotary)
        if self._aim is None and len(motions):
            self._aim = self._prepared.aim(turns=self._turns)
        self.turns_later = self._turns and self._aim is not None and not self._aim.turns
        return replace(motions, move=motions.move + before)
