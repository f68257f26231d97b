"""A program of any length as read: stretches of whole lines, several to a part that is solved at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Final, NamedTuple, final

from twin._common.errors import InputError
from twin.compensation.bench import Bench, CorrectionAim
from twin.compensation.toolpath import Follower, MotionColumns
from twin.nc.blocks import Notice
from twin.nc.columns import MoveColumns
from twin.nc.iso.stream import IsoReader, Stretch
from twin.nc.text import Style, TextCheck, ending, lines_in, style_in

STRETCH_BYTES: Final = 1 << 18
"""Read, written and read back at once: little enough that what is made of it stays in cache."""
PART_LINES: Final = 60_000
"""Lines solved at once: the parts of a long program are alike, and none has fewer, so that solving is compiled
(`twin.compute.native`); nor many more, since they take memory."""


@final
class ProgramFile:
    """The file of a program.

    Args:
        path: where it is.

    Attributes:
        size: bytes.
        lines: about how many lines.

    Raises:
        InputError: it cannot be read, or is no program at all.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.size = self.lines = 0
        check = TextCheck(str(path))
        for data in self._blocks():
            check.add(data)
            self.size += len(data)
            self.lines += data.count(b"\n") or data.count(b"\r")
        check.finish()

    def begins(self) -> tuple[str, Style]:
        """Its line ending, and the style of its numbers."""
        lines = (line for data in self.stretches() for line in lines_in(data))
        first = next(lines)
        return ending(first) or "\n", style_in(chain((first,), lines), Style(point=True))

    def stretches(self) -> Iterator[bytes]:
        """Whole lines."""
        left = b""
        for block in self._blocks():
            data = left + block
            # A return at the very end may be half of a line's ending.
            cut = max(data.rfind(b"\n"), data.rfind(b"\r", 0, len(data) - 1)) + 1
            if cut:
                yield data[:cut]
            left = data[cut:]
        if left:
            yield left

    def _blocks(self) -> Iterator[bytes]:
        try:
            with self.path.open("rb") as stream:
                while data := stream.read(STRETCH_BYTES):
                    yield data
        except OSError as error:
            raise InputError(
                "cannot be read", expected="a readable file", file=self.path, value=error.strerror
            ) from error


class Read(NamedTuple):
    """A stretch as read: its lines and its moves."""

    stretch: Stretch
    moves: MoveColumns


@final
@dataclass(frozen=True)
class ProgramPart:
    """Stretches as read, to be solved together.

    Attributes:
        read: each of them.
        motions: their motions, behind the last one of the part before; of moves counted through all of the part.
        context: how many those of the part before are: 1, or 0 at the first.
        aim: what is corrected; None as long as nothing moved.
    """

    read: Sequence[Read]
    motions: MotionColumns
    context: int
    aim: CorrectionAim | None

    @property
    def moves(self) -> int:
        """How many moves."""
        return sum(len(one.moves) for one in self.read)


@final
class PartReader:
    """Reads a program, part by part.

    Args:
        bench: machine, calibration, options.
        source: the program.
        turns: whether it moves rotary axes; None: as its first motions say.

    Attributes:
        lines: how many were read so far.
        changed: whether it moves rotary axes only later on, so that all is to be done again.
        drills: whether it has a drilling cycle.
        failed: why it cannot be read to its end; None if it can.
    """

    def __init__(self, bench: Bench, source: ProgramFile, turns: bool | None) -> None:
        self._bench, self._source = bench, source
        self._aim = None if turns is None else bench.aim(turns=turns)
        self._reader = IsoReader(str(source.path), bench.space.axes, tcp=bench.options.tcp)
        self._follower = Follower(str(source.path), bench.space)
        self._notices: list[Notice] = []
        self._turns = False
        self.lines = 0
        self.changed = self.drills = False
        self.failed: InputError | None = None

    @property
    def notices(self) -> list[Notice]:
        """What a reader of the account must know of the lines read so far."""
        return [*self._notices, *self._follower.passed]

    def parts(self) -> Iterator[ProgramPart]:
        """The program as read; where it `failed`, all that was read before."""
        a_part = self._source.lines / max(self._source.lines // PART_LINES, 1)
        full, read = a_part, list[Read]()
        motions = [MotionColumns.of({}, len(self._bench.space.axes.names))]
        try:
            for data in self._source.stretches():
                read.append(self._read(data))
                motions.append(self._followed(read[-1], sum(len(one.moves) for one in read[:-1])))
                if self.lines >= full:
                    full += a_part
                    part = self._part(read, motions)
                    read, motions = [], [part.motions.part(max(len(part.motions) - 1, 0), len(part.motions))]
                    yield part
        except InputError as error:
            self.failed = error
        yield self._part(read, motions)

    def _part(self, read: list[Read], motions: list[MotionColumns]) -> ProgramPart:
        return ProgramPart(read, MotionColumns.joined(motions), len(motions[0]), self._aim)

    def _read(self, data: bytes) -> Read:
        stretch = Stretch(data, self.lines, self._bench.space.axes.names)
        self.lines += len(stretch)
        moves = self._reader.read(stretch)
        self._notices += self._reader.notices()
        self.drills = self._reader.drills
        return Read(stretch, moves)

    def _followed(self, read: Read, before: int) -> MotionColumns:
        """The motions of a stretch; ``before``: moves of its part that come first."""
        motions = self._follower.columns(read.moves, self._reader.lost_positions(), read.stretch.text_of)
        self._turns = self._turns or read.moves.turns(self._bench.space.axes.rotary)
        if self._aim is None and len(motions):
            self._aim = self._bench.aim(turns=self._turns)
        self.changed = self._turns and self._aim is not None and not self._aim.turns
        return replace(motions, move=motions.move + before)
