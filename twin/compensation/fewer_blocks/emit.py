"""Write the program with fewer blocks: the remaining blocks of a run get the new end points, the others are removed.

A run of k blocks becomes m ≤ k blocks. Each of the k blocks first gets the end point reached by then, so that several consecutive ones
have the same end point. The text is rewritten with these by the program's language, and blocks without motion are then removed. The
remaining text is thus correct for absolute and incremental words, and comments in a run stay near their place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, NamedTuple, final

import numpy as np

from twin._common.csv_tables import split_cells
from twin._common.errors import InputError, OutputError
from twin._common.files import read_lines
from twin._common.units import count_with_noun
from twin.compensation.fewer_blocks.fit import largest_distance, lengths
from twin.compensation.fewer_blocks.runs import RunEndPoints
from twin.compensation.programs.backlash import Backlash
from twin.compensation.programs.follow import follow
from twin.compensation.programs.motions import MotionColumns, counted
from twin.compensation.programs.prepared import PreparedMachine
from twin.compensation.programs.words import WordSpace, turns_tool
from twin.nc.blocks import AxisWords, Interpretation, Move, NewPositions, Program
from twin.nc.dialect import Dialect
from twin.tool.forward import Kinematics
from twin.tool.inverse import SLACK


class Shortened(NamedTuple):
    """A program with fewer blocks."""

    program: Program  # the program with rewritten runs; removed blocks are empty lines, so that line numbers are kept
    reading: Interpretation  # its moves, with unrounded end points


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
    """Return a program with its runs replaced by fewer blocks; `OutputError` if the number of lines changed: a defect of `twin`.

    With ``posted``, the end points of runs are axis positions, with straight lines between them. ``others``: further moves to be
    rewritten, rounded to their increments: index, move and words.
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
    space, printed = prepared.space, prepared.on_grid(words, tcp, increment)
    turned = np.flatnonzero(~tcp & (printed[:, 3:] != words[:, 3:]).any(axis=1))
    if turned.size:
        commands = space.commands(words[turned], tcp[turned])
        target = space.nominal.forward(commands)
        start = np.array(commands)
        start[:, space.order[3:]] = printed[turned, 3:] + space.offset[3:]
        solved = space.inverse.solve(target, start, rotary=False).positions
        low, high = prepared.limits.T
        within = (commands >= low - SLACK) & (commands <= high + SLACK)
        kept = space.words(np.where(within, np.clip(solved, low, high), solved), tcp[turned])
        printed[turned, :3] = prepared.on_grid(kept, tcp[turned], increment)[:, :3]
    return np.asarray(printed)


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


# --- Independent check: the output text executed densely on the machine with errors and compared with the input path

POINTS_PER_BLOCK: Final = 7
"""Points per block at which the path is evaluated; deliberately no multiple of the numbers used by fit and chords."""
SEARCHED_SHARE: Final = 0.25
"""Share of the tolerance below which a closer point on the other path is not searched for."""
TURN_STEP_DEG: Final = 0.25
LINEAR_STEP_MM: Final = 5.0


@final
@dataclass(frozen=True)
class Executed:
    """A program executed on a machine, block by block."""

    block: np.ndarray  # (n,) index of each point's move among those of the program
    point_mm: np.ndarray  # (n, 3) tool points in the work frame

    def without(self, blocks: np.ndarray) -> Executed:
        """Return the points without those of some moves."""
        keep = ~np.isin(self.block, blocks)
        return Executed(self.block[keep], self.point_mm[keep])

    def between(self, first: int, last: int) -> np.ndarray:
        """Return the points of the moves from ``first`` to ``last``, both included."""
        return self.point_mm[slice(*np.searchsorted(self.block, [first, last + 1]))]


def execute_words(
    program: Program, reading: Interpretation, space: WordSpace, real: Kinematics, dense: np.ndarray
) -> Executed:
    """Execute a program as its control would, on straight lines in words; ``dense`` (moves,): which moves along their whole length."""
    path = follow(program, reading, space)
    moves = path.columns.move
    of, fractions = _fractions(path.columns, dense[moves])
    words = path.dense(of, fractions)
    commands = space.commands(words, path.columns.tcp[of])
    sides = Backlash(real.calibration).sides(path, of, commands)
    point = real.reached(commands * space.machine.scale, sides)[1] * 1e3
    return Executed(moves[of], point)


def _fractions(motions: MotionColumns, dense: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the motion of each sample and its fraction: only the end of rapids, of motions from unknown points, and of others."""
    size = np.abs(motions.end - motions.start)
    length, turn = size[:, :3].max(axis=1), size[:, 3:].max(axis=1, initial=0.0)
    steps = np.ceil(
        np.maximum.reduce([length / LINEAR_STEP_MM, turn / TURN_STEP_DEG, np.full(len(size), POINTS_PER_BLOCK)])
    )
    steps = np.where(dense & ~motions.rapid & motions.known, steps, 0.0).astype(int)
    of, k = counted(steps + 1)
    return of, np.where(steps[of] == 0, 1.0, k / np.maximum(steps[of], 1))


def path_distance_mm(one: np.ndarray, other: np.ndarray, tolerance_mm: float) -> float:
    """Return the largest distance between two executed paths of (n, 3) points in both directions, mm."""
    at = [_shares(points) for points in (one, other)]
    return largest_distance(one, at[0], other, at[1], SEARCHED_SHARE * tolerance_mm, tolerance_mm, anywhere=True)


def _shares(points: np.ndarray) -> np.ndarray:
    way = lengths(points)
    return np.asarray(way / way[-1]) if way[-1] > 0.0 else way


# --- Read points of a curve as a program with one straight block per point, to be refitted like any other

POINT: Final = ("x_mm", "y_mm", "z_mm")
VECTOR: Final = ("i", "j", "k")
SUFFIX: Final = ".csv"


def is_points(path: Path) -> bool:
    """Return whether a file is a table of points, by its name."""
    return path.suffix.lower() == SUFFIX


def points_program(
    path: Path, axes: AxisWords, dialects: Sequence[Dialect], written: Dialect, feed: float | None
) -> tuple[Program, Dialect]:
    """Return a program with a straight block per point of a table, and its language: ``written``, or cutter locations for vectors.

    The columns are ``x_mm,y_mm,z_mm``, then nothing, ``<axis>_deg`` per rotary axis, or the tool vector ``i,j,k``; ``#`` begins a
    comment. ``feed``: mm/min; None for no feed word. `InputError`, with line and value, for another table, or for rotary axes that
    ``written`` lacks.
    """
    header, lines, values = _table(path, axes)
    vectors = header[3:] == VECTOR
    if written.cutter_locations and len(header) > 3 and not vectors:
        raise InputError(
            "rotary axis columns cannot be written as cutter locations",
            expected="columns i,j,k, or an output file ending in .nc or .h",
            file=path,
            line=lines[0] - 1,
            value=",".join(header),
            setting="output",
        )
    dialect = next(dialect for dialect in dialects if dialect.cutter_locations) if vectors else written
    if vectors:
        size = np.linalg.norm(values[:, 3:], axis=1)
        wrong = np.flatnonzero(np.abs(size - 1.0) > 1e-3)
        if wrong.size:
            at = int(wrong[0])
            raise InputError(
                "not a tool vector",
                expected="i,j,k of unit length",
                file=path,
                line=lines[at],
                value=",".join(f"{v:g}" for v in values[at, 3:]),
            )
    names = axes.linear if len(header) == 3 or header[3:] == VECTOR else axes.names
    shown = "points of " + "".join(
        c if c.isascii() and c.isprintable() and c not in "()~;$" else "_" for c in path.name
    )
    text = dialect.from_points(names, values, feed, shown, path.stem)
    return dialect.read(text.encode("latin-1", "replace"), str(path)), dialect


def _table(path: Path, axes: AxisWords) -> tuple[tuple[str, ...], list[int], np.ndarray]:
    """Return header, line number of every row, and (n, columns) values."""
    rotary = tuple(f"{name}_deg" for name in axes.rotary)
    known = [POINT, *([POINT + rotary] if rotary else []), *([POINT + VECTOR] if rotary else [])]
    expected = "header " + " or ".join(",".join(columns) for columns in known)
    header: tuple[str, ...] | None = None
    lines: list[int] = []
    rows: list[list[float]] = []
    for number, text in enumerate(read_lines(path), start=1):
        if not text.strip() or text.lstrip().startswith("#"):
            continue
        cells = [cell.strip() for cell in split_cells(text, path, number)]
        if header is None:
            header = tuple(cells)
            if header not in known:
                raise InputError("not a table of points", expected=expected, file=path, line=number, value=text)
            continue
        if len(cells) != len(header):
            raise InputError(
                f"row with {count_with_noun(len(cells), 'value')}",
                expected=f"{len(header)} values: {','.join(header)}",
                file=path,
                line=number,
                value=text,
            )
        rows.append([_number(cell, name, path, number) for cell, name in zip(cells, header, strict=True)])
        lines.append(number)
    if header is None:
        raise InputError("no header row", expected=expected, file=path)
    if len(rows) < 2:
        raise InputError(f"only {count_with_noun(len(rows), 'point')}", expected="two or more", file=path)
    return header, lines, np.array(rows)


def _number(cell: str, column: str, path: Path, line: int) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = float("nan")
    if not abs(value) < 1e6:
        raise InputError(
            f"{column} is not a coordinate", expected="a number below 1e6", file=path, line=line, value=cell
        )
    return value
