"""Write the program with fewer blocks: the remaining blocks of a run get the new end points, the others are removed.

A run of k blocks becomes m ≤ k blocks. Each of the k blocks first gets the end point reached by then, so that several consecutive ones
have the same end point. The text is rewritten with these by the program's language, and blocks without motion are then removed. The
remaining text is thus correct for absolute and incremental words, and comments in a run stay near their place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, final

import numpy as np

from twin._common.errors import OutputError
from twin.compensation.fewer_blocks.runs import Run
from twin.compensation.prepared import PreparedMachine
from twin.compensation.toolpath import WordSpace, turns_tool
from twin.kinematics.inverse import SLACK
from twin.nc.blocks import Interpretation, Move, Program
from twin.nc.columns import NewPositions
from twin.nc.dialect import Dialect


@final
@dataclass(frozen=True)
class RunEndPoints:
    """A run with new end points for its blocks.

    Attributes:
        run: as found.
        words: (m, axes) end points of the output blocks, not rounded.
        assigned: (n,) index of the end point assigned to each block of the run, not decreasing.
        changed: (n,) whether a block's text is rewritten.
    """

    run: Run
    words: np.ndarray
    assigned: np.ndarray
    changed: np.ndarray

    @property
    def kept(self) -> np.ndarray:
        """(n,) whether each block remains: the first one of each end point."""
        return np.append(True, np.diff(self.assigned) > 0)


class Shortened(NamedTuple):
    """A program with fewer blocks.

    Attributes:
        program: the program with rewritten runs; removed blocks are empty lines, so that line numbers are kept.
        reading: its moves, with unrounded end points.
    """

    program: Program
    reading: Interpretation


def shortened(
    program: Program,
    dialect: Dialect,
    reading: Interpretation,
    runs: Sequence[RunEndPoints],
    prepared: PreparedMachine,
    *,
    posted: bool = False,
    others: Sequence[tuple[int, Move, np.ndarray]] = (),
) -> Shortened:
    """Return a program with its runs of blocks replaced by fewer blocks.

    Args:
        program: as read.
        dialect: its language.
        reading: its moves.
        runs: new end points of its runs.
        prepared: machine, calibration and options.
        posted: whether axis words are written even for tool-tip input; end points of runs are then axis positions, with straight
            lines between them.
        others: further moves to be rewritten rounded to their increments: index, move and words.

    Raises:
        OutputError: the number of lines changed: a defect of `twin`.
    """
    space, increment = prepared.space, prepared.printed_increment(dialect, posted=posted)
    by_line = {move.line: move for move in reading.moves}
    index_of = {move.line: index for index, move in enumerate(reading.moves)}
    turns, vectors = turns_tool(reading.moves, space.axes), dialect.vector_decimals
    new = {
        index: _replacement(
            move, rounded(words[None], np.array([move.tcp]), prepared, increment)[0], space, turns, vectors
        )
        for index, move, words in others
    }
    exact: dict[int, np.ndarray] = {}
    removed: set[int] = set()
    for places in runs:
        lines = places.run.lines
        first = by_line[lines[0]]
        printed = rounded(places.words, np.full(len(places.words), first.tcp), prepared, increment)
        for block in np.flatnonzero(places.changed):
            words, line = printed[places.assigned[block]], lines[block]
            new[index_of[line]] = _replacement(by_line[line], words, space, turns, vectors)
        for block in np.flatnonzero(places.kept & places.changed):
            exact[lines[block]] = places.words[places.assigned[block]]
        removed |= {lines[block] for block in np.flatnonzero(~places.kept)}
    positions = NewPositions.of(len(reading.moves), len(space.axes.names), dict(sorted(new.items())))
    text = dialect.rewrite(program, space.axes, reading, positions)
    written = dialect.read(text.encode("latin-1"), program.source)
    if len(written.texts) != len(program.texts):
        raise OutputError(f"{program.source}: {len(written.texts)} lines in the output, {len(program.texts)} expected")
    left = Program(
        program.source,
        program.dialect,
        tuple("" if index in removed else line for index, line in enumerate(written.texts)),
    )
    found = dialect.moves(left, space.axes, tcp=prepared.options.tcp)
    moves = tuple(_exactly(move, exact, space, posted=posted) if move.line in exact else move for move in found.moves)
    return Shortened(left, replace(found, moves=moves))


def rounded(words: np.ndarray, tcp: np.ndarray, prepared: PreparedMachine, increment: np.ndarray) -> np.ndarray:
    """Return (n, axes) words rounded to their increments: rotary words first, then linear words that keep the tool point."""
    space, found = prepared.space, prepared.on_grid(words, tcp, increment)
    turned = np.flatnonzero(~tcp & (found[:, 3:] != words[:, 3:]).any(axis=1))
    if turned.size:
        commands = space.commands(words[turned], tcp[turned])
        target = space.nominal.forward(commands)
        start = np.array(commands)
        start[:, space.order[3:]] = found[turned, 3:] + space.offset[3:]
        solved = space.inverse.solve(target, start, rotary=False).positions
        low, high = prepared.limits.T
        within = (commands >= low - SLACK) & (commands <= high + SLACK)
        kept = space.words(np.where(within, np.clip(solved, low, high), solved), tcp[turned])
        found[turned, :3] = prepared.on_grid(kept, tcp[turned], increment)[:, :3]
    return np.asarray(found)


def _replacement(
    move: Move, words: np.ndarray, space: WordSpace, turns: bool, decimals: int
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return a move's new end point, as `NewPositions.of` takes it; rotary words only if the program has them."""
    position = np.array(words)[None]
    vectors = None
    if move.vector is not None:
        vectors = np.round(_axis(words, move, space), decimals)[None]
    if move.vector is not None or not turns:
        position[:, 3:] = np.nan
    return position, vectors


def _axis(words: np.ndarray, move: Move, space: WordSpace) -> np.ndarray:
    return space.nominal.forward(space.commands(words[None], np.array([move.tcp]))).axis[0]


def _exactly(move: Move, exact: Mapping[int, np.ndarray], space: WordSpace, *, posted: bool) -> Move:
    """Return a move with its unrounded end point."""
    words = exact[move.line]
    if posted and move.tcp:
        return move._replace(tcp=False, vector=None, position=tuple(space.switched(words[None], tcp=False)[0].tolist()))
    position = tuple(old if old != old else float(new) for old, new in zip(move.position, words, strict=True))
    if move.vector is None:
        return move._replace(position=position)
    x, y, z = _axis(words, move, space)
    return move._replace(position=position, vector=(float(x), float(y), float(z)))
