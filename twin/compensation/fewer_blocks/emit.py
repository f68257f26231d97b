"""The program with fewer blocks: the kept blocks of a run say the new places, the others go.

A run of k blocks becomes m ≤ k places. Every one of the k is given the place its turn has come to, so that several in a row say the
same; the text is written so, with whatever the language needs to say it, and then the blocks that move nothing are taken out. What is
left says of every axis what it means, whether its words are absolute or incremental, and a comment in a run stays about where it was.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from twin._common.errors import OutputError
from twin.compensation.fewer_blocks.runs import Run
from twin.compensation.toolpath import WordSpace
from twin.nc.blocks import AxisWords, Move, Program, Reading, Rewrite
from twin.nc.dialect import Dialect


@final
@dataclass(frozen=True)
class Places:
    """A run and the places its blocks are to end at.

    Attributes:
        run: as found.
        words: (m, axes) where the blocks of the output end, not rounded.
        given: (n,) which of them each block of the run is given, not decreasing.
        changed: (n,) whether a block's text is to be written anew.
    """

    run: Run
    words: np.ndarray
    given: np.ndarray
    changed: np.ndarray

    @property
    def kept(self) -> np.ndarray:
        """(n,) whether each block stays: the first that is given a place."""
        return np.append(True, np.diff(self.given) > 0)


@final
class Shortened(Dialect):
    """A program with fewer blocks, as a language of its own: it is read with its places as exact as they were found.

    Args:
        inner: the program's language.
        program: with the blocks of runs rewritten, those taken out left as empty lines (lines keep their numbers).
        reading: what it says, exact.
    """

    def __init__(self, inner: Dialect, program: Program, reading: Reading) -> None:
        self.inner = inner
        self.name, self.suffixes = inner.name, inner.suffixes
        self.vector_decimals, self.linear_increment_mm = inner.vector_decimals, inner.linear_increment_mm
        self.cutter_locations = inner.cutter_locations
        self.program = program
        self.reading = reading

    def moves(self, program: Program, axes: AxisWords, *, tcp: bool) -> Reading:
        """What the shortened program says, exact; any other as its language has it."""
        return self.reading if program is self.program else self.inner.moves(program, axes, tcp=tcp)

    def rewrite(self, program: Program, axes: AxisWords, reading: Reading, rewrites: Iterable[Rewrite]) -> str:
        """The text with moves replaced; see `Dialect.rewrite`."""
        return self.inner.rewrite(program, axes, reading, rewrites)

    def commented(self, text: str, comments: Sequence[str]) -> str:
        """The text with comments at its head; see `Dialect.commented`."""
        return self.inner.commented(text, comments)

    def posted(
        self, program: Program, reading: Reading, rewrites: Iterable[Rewrite], axes: AxisWords, into: Dialect
    ) -> str:
        """The program in axis words of another language; see `Dialect.posted`."""
        return self.inner.posted(program, reading, rewrites, axes, into)

    def from_points(self, names: Sequence[str], points: np.ndarray, feed: float | None, remark: str, title: str) -> str:
        """A new program through points; see `Dialect.from_points`."""
        return self.inner.from_points(names, points, feed, remark, title)

    def is_remark(self, text: str) -> bool:
        """Whether a line means nothing to the control."""
        return self.inner.is_remark(text)

    def only_moves(self, text: str, names: tuple[str, ...]) -> bool:
        """Whether a line says nothing but where to go; see `Dialect.only_moves`."""
        return self.inner.only_moves(text, names)


def shortened(
    program: Program,
    dialect: Dialect,
    reading: Reading,
    runs: Sequence[Places],
    space: WordSpace,
    increment: np.ndarray,
    *,
    tcp: bool,
    posted: bool = False,
    others: Sequence[tuple[Move, np.ndarray]] = (),
) -> Shortened:
    """A program with runs of blocks replaced by fewer.

    Args:
        program: as read.
        dialect: its language.
        reading: what it says.
        runs: what becomes of its runs.
        space: the machine's words.
        increment: (axes,) least increments of the words.
        tcp: as the program was read.
        posted: whether it is to be written in axis words, whatever it is in: places of runs are then axis positions, with straight
            ways of the axes between them.
        others: further moves to be written at their increments, with their words.

    Raises:
        OutputError: the text does not come out with a line for a line: a defect of `twin`.
    """
    by_line = {move.line: move for move in reading.moves}
    turns = any(move.vector is not None or move.named & set(space.axes.rotary) for move in reading.moves)
    vectors = dialect.vector_decimals
    rewrites = [
        _rewrite(move, rounded(words[None], np.array([move.tcp]), space, increment)[0], space, turns, vectors)
        for move, words in others
    ]
    exact: dict[int, np.ndarray] = {}
    gone: set[int] = set()
    for places in runs:
        lines = places.run.lines
        first = by_line[lines[0]]
        printed = rounded(places.words, np.full(len(places.words), first.tcp), space, increment)
        for block in np.flatnonzero(places.changed):
            rewrites.append(_rewrite(by_line[lines[block]], printed[places.given[block]], space, turns, vectors))
        for block in np.flatnonzero(places.kept & places.changed):
            exact[lines[block]] = places.words[places.given[block]]
        gone |= {lines[block] for block in np.flatnonzero(~places.kept)}
    text = dialect.rewrite(program, space.axes, reading, rewrites) if rewrites else program.text
    written = dialect.read(text.encode("latin-1"), program.source)
    if len(written.texts) != len(program.texts):
        raise OutputError(f"{program.source}: {len(written.texts)} lines written for {len(program.texts)}")
    left = Program(
        program.source,
        program.dialect,
        tuple("" if index in gone else line for index, line in enumerate(written.texts)),
    )
    found = dialect.moves(left, space.axes, tcp=tcp)
    moves = tuple(_exactly(move, exact, space, posted=posted) if move.line in exact else move for move in found.moves)
    return Shortened(dialect, left, Reading(moves, found.notices, found.left))


def rounded(words: np.ndarray, tcp: np.ndarray, space: WordSpace, increment: np.ndarray) -> np.ndarray:
    """(n, axes) words at their increments: rotary ones first, then linear ones that take the tool to the same point with those."""
    found = np.round(words / increment) * increment
    turned = np.flatnonzero(~tcp & (found[:, 3:] != words[:, 3:]).any(axis=1))
    if turned.size:
        commands = space.commands(words[turned], tcp[turned])
        target = space.nominal.forward(commands)
        start = np.array(commands)
        start[:, space.order[3:]] = found[turned, 3:] + space.offset[3:]
        solved = space.inverse.solve(target, start, rotary=False).positions
        linear = space.words(solved, tcp[turned])[:, :3]
        found[turned, :3] = np.round(linear / increment[:3]) * increment[:3]
    return np.asarray(found)


def axis_words(space: WordSpace, words: np.ndarray) -> np.ndarray:
    """(n, axes) axis words of (n, axes) tool-tip words."""
    tcp = np.ones(len(words), dtype=bool)
    return space.words(space.commands(words, tcp), ~tcp)


def tip_words(space: WordSpace, words: np.ndarray) -> np.ndarray:
    """(n, axes) tool-tip words of (n, axes) axis words."""
    tcp = np.ones(len(words), dtype=bool)
    return space.words(space.commands(words, ~tcp), tcp)


def _rewrite(move: Move, words: np.ndarray, space: WordSpace, turns: bool, decimals: int) -> Rewrite:
    """A move's new end; rotary words only where the program has them."""
    position = np.array(words)[None]
    vectors = None
    if move.vector is not None:
        vectors = np.round(_axis(words, move, space), decimals)[None]
    if move.vector is not None or not turns:
        position[:, 3:] = np.nan
    return Rewrite(move, position, vectors)


def _axis(words: np.ndarray, move: Move, space: WordSpace) -> np.ndarray:
    return space.nominal.forward(space.commands(words[None], np.array([move.tcp]))).axis[0]


def _exactly(move: Move, exact: Mapping[int, np.ndarray], space: WordSpace, *, posted: bool) -> Move:
    """A move with its end as it was found."""
    words = exact[move.line]
    if posted and move.tcp:
        return move._replace(tcp=False, vector=None, position=tuple(axis_words(space, words[None])[0].tolist()))
    position = tuple(old if old != old else float(new) for old, new in zip(move.position, words, strict=True))
    if move.vector is None:
        return move._replace(position=position)
    x, y, z = _axis(words, move, space)
    return move._replace(position=position, vector=(float(x), float(y), float(z)))
