"""The program with fewer blocks: the kept blocks of a run say the new places, the others go.

A run of k blocks becomes m ≤ k places. Every one of the k is given the place its turn has come to, so that several in a row say the
same; the text is written so, with whatever the language needs to say it, and then the blocks that move nothing are taken out. What is
left says of every axis what it means, whether its words are absolute or incremental, and a comment in a run stays about where it was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from twin._common.errors import OutputError
from twin.compensation.bench import Bench
from twin.compensation.fewer_blocks.runs import Run
from twin.compensation.toolpath import WordSpace, turns_tool
from twin.nc.blocks import Move, Program, Reading, Rewrite
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


class Shortened(NamedTuple):
    """A program with fewer blocks.

    Attributes:
        program: with the blocks of runs rewritten, those taken out left as empty lines (lines keep their numbers).
        reading: what it says, its places as exact as they were found.
    """

    program: Program
    reading: Reading


def shortened(
    program: Program,
    dialect: Dialect,
    reading: Reading,
    runs: Sequence[Places],
    bench: Bench,
    *,
    posted: bool = False,
    others: Sequence[tuple[Move, np.ndarray]] = (),
) -> Shortened:
    """A program with runs of blocks replaced by fewer.

    Args:
        program: as read.
        dialect: its language.
        reading: what it says.
        runs: what becomes of its runs.
        bench: the machine, set up.
        posted: whether it is to be written in axis words, whatever it is in: places of runs are then axis positions, with straight
            ways of the axes between them.
        others: further moves to be written at their increments, with their words.

    Raises:
        OutputError: the text does not come out with a line for a line: a defect of `twin`.
    """
    space, increment = bench.space, bench.printed_increment(dialect, posted=posted)
    by_line = {move.line: move for move in reading.moves}
    turns, vectors = turns_tool(reading.moves, space.axes), dialect.vector_decimals
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
    found = dialect.moves(left, space.axes, tcp=bench.options.tcp)
    moves = tuple(_exactly(move, exact, space, posted=posted) if move.line in exact else move for move in found.moves)
    return Shortened(left, Reading(moves, found.notices, found.lost_positions))


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
        return move._replace(tcp=False, vector=None, position=tuple(space.switched(words[None], tcp=False)[0].tolist()))
    position = tuple(old if old != old else float(new) for old, new in zip(move.position, words, strict=True))
    if move.vector is None:
        return move._replace(position=position)
    x, y, z = _axis(words, move, space)
    return move._replace(position=position, vector=(float(x), float(y), float(z)))
