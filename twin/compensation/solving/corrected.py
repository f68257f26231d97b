"""Correct a program, or a stretch of it: solve all end points, and split blocks where the path between them leaves the tolerance.

If an axis has backlash, a block is also cut where that axis reverses inside it (`twin.compensation.solving.reversals`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.progress import Progress
from twin.compensation.solving.path_errors import EndState, PathErrors
from twin.compensation.solving.pieces import Pieces
from twin.compensation.solving.reversals import insert_backlash_moves
from twin.compensation.solving.rows import Rows
from twin.compensation.toolpath import check_domains
from twin.kinematics.inverse import SLACK
from twin.machine.effects.empirical import check_ranges
from twin.nc.columns import NewPositions

LARGEST_SPLIT: Final = 4096
"""Most pieces per block; an error that needs more cannot be reduced by splitting."""
MOST_ROUNDS: Final = 16
"""Most rounds of splitting."""
ARC_POINTS: Final = 64
"""Points of an arc that are compared with the axis ranges, for the message."""


@final
@dataclass(frozen=True)
class Corrected:
    """A corrected program, or a stretch of it.

    Attributes:
        pieces: the program cut into pieces.
        path_errors: the errors between their end points.
        rows: the commands at the end points.
        context: number of its first motions that belong to the stretch before.
    """

    pieces: Pieces
    path_errors: PathErrors
    rows: Rows
    context: int

    @cached_property
    def lines(self) -> np.ndarray:
        """(motions,) line numbers."""
        return self.pieces.lines

    @cached_property
    def own(self) -> Rows:
        """The rows after the context."""
        return self.rows.where(slice(int(np.searchsorted(self.rows.motion, self.context)), None))

    @cached_property
    def new(self) -> NewPositions:
        """Positions that replace the motions after the context; none for motions left as written."""
        pieces, rows = self.pieces, self.rows
        count = pieces.count(rows)
        first = np.cumsum(count) - count
        if pieces.idle:
            count[:] = 0
        elif not pieces.posted:
            count[rows.motion[rows.untouched]] = 0
        positions = np.array(rows.printed)
        # No rotary words: a vector gives the orientation, or the program has none.
        bare = pieces.by_vector[rows.motion] | (not pieces.aim.turns)
        positions[np.ix_(bare, range(3, positions.shape[1]))] = np.nan
        return NewPositions(first[self.context :], count[self.context :], positions, rows.vectors)

    @property
    def end(self) -> EndState:
        """State after its last motion."""
        pieces, rows = self.pieces, self.rows
        exact = pieces.space.words(rows.exact[-1:], pieces.tcp_out[-1:])[0]
        uncorrected = bool(rows.untouched[-1] or rows.clamped[-1])
        return EndState(pieces.end[-1], bool(pieces.tcp[-1]), exact, rows.printed[-1], uncorrected)

    @property
    def rewritten(self) -> int:
        """Number of motions with new words."""
        return int(np.count_nonzero(self.new.count))


def new_positions(stretches: Sequence[Corrected], moves: int, axes: int) -> NewPositions:
    """Return the positions that replace the moves of a program, or of a part of it, corrected in stretches.

    Args:
        stretches: consecutive stretches.
        moves: number of moves.
        axes: number of words per position.
    """
    first, count = np.zeros((2, moves), dtype=int)
    begin = 0
    for stretch in stretches:
        own = stretch.pieces.path.columns.move[stretch.context :]
        first[own], count[own] = stretch.new.first + begin, stretch.new.count
        begin += len(stretch.new.positions)
    positions = np.concatenate([np.zeros((0, axes)), *(stretch.new.positions for stretch in stretches)])
    vectors = np.concatenate([np.zeros((0, 3)), *(stretch.new.vectors for stretch in stretches)])
    return NewPositions(first, count, positions, vectors)


def correct(pieces: Pieces, progress: Progress, *, context: int = 0, before: EndState | None = None) -> Corrected:
    """Solve all blocks, and split those whose error between end points exceeds the tolerance.

    Args:
        pieces: the program, or a stretch of it.
        progress: called with a stage and the fraction done.
        context: number of its first motions that belong to the stretch before.
        before: end of that stretch, if none of its motions is among the pieces.

    Raises:
        InputError: a position that the calibration does not cover; an arc that cannot be compensated as a whole.
    """
    prepared, lines = pieces.prepared, pieces.path.columns.line + 1
    commands = pieces.space.commands(pieces.end[context:], pieces.tcp[context:])
    check_domains(prepared.real, pieces.source, lines[context:], commands)
    path_errors = PathErrors(pieces, before)
    rows = pieces.ends(np.arange(len(pieces.legs.motion)))
    if not pieces.idle:
        if prepared.thesis is None:
            rows = _whole(pieces, path_errors, _split(pieces, path_errors, rows, progress))
        _check_arcs(pieces, rows)
        if prepared.thesis is None:
            _check_ranges(pieces, rows)
            if pieces.aim.backlash.axes:
                path_errors.forget()
                rows = insert_backlash_moves(pieces, rows)
    return Corrected(pieces, path_errors, rows, context)


def _split(pieces: Pieces, path_errors: PathErrors, rows: Rows, progress: Progress) -> Rows:
    """Split blocks until the path between their end points is within tolerance, or splitting no longer helps."""
    legs, tolerance = pieces.legs, pieces.prepared.options.tolerance_mm
    candidates = np.flatnonzero(pieces.interpolated[legs.motion])
    for step in range(1, MOST_ROUNDS + 1):
        if not candidates.size:
            break
        progress("splitting", min(0.7, 0.2 + 0.05 * step))
        worst = path_errors.leg_errors_mm(candidates, rows)
        stuck = np.zeros(len(pieces.start), dtype=bool)
        stuck[rows.motion[rows.as_programmed | rows.untouched]] = True
        failing = (worst > tolerance) & ~stuck[legs.motion[candidates]] & (legs.count[candidates] < LARGEST_SPLIT)
        candidates = candidates[failing]
        if not candidates.size:
            break
        # The error between end points is quadratic in length.
        factor = np.clip(1.1 * np.sqrt(worst[failing] / tolerance), 1.3, 16.0)
        legs.count[candidates] = np.minimum(np.ceil(legs.count[candidates] * factor).astype(int), LARGEST_SPLIT)
        path_errors.forget(candidates)
        rows = rows.replaced(candidates, pieces.ends(candidates))
    return rows


def _whole(pieces: Pieces, path_errors: PathErrors, rows: Rows) -> Rows:
    """Restore blocks that leave an axis's range between their end points: left as written, in one piece."""
    legs = pieces.legs
    kept = pieces.left_as_written(rows)
    if not np.any(pieces.count(rows)[kept] > 1):
        return rows
    again = np.flatnonzero(kept[legs.motion])
    legs.merge(np.flatnonzero(kept))
    path_errors.forget(again)
    rows = rows.replaced(again, pieces.ends(again))
    return replace(rows, untouched=rows.untouched | kept[rows.motion])


def _check_arcs(pieces: Pieces, rows: Rows) -> None:
    """Raise `InputError` if an arc would be left as written: it would not begin where the compensated block before it ends."""
    arcs = rows.motion[rows.untouched & ~pieces.straight[rows.motion]]
    if not arcs.size:
        return
    of = np.full(ARC_POINTS, arcs[0])
    words = pieces.words_at(of, np.arange(1, ARC_POINTS + 1) / ARC_POINTS)
    commands = pieces.space.commands(words, pieces.tcp[of])
    machine = pieces.prepared.machine
    limits = machine.limits / machine.scale[:, None]
    beyond = np.maximum(limits[:, 0] - commands, commands - limits[:, 1])
    at_end = bool(np.any(beyond[-1] > SLACK))
    row = len(commands) - 1 if at_end else int(np.argmax(beyond.max(axis=1)))
    i = int(np.argmax(beyond[row]))
    place, side = commands[row, i], int(commands[row, i] >= limits[i, 0])
    raise InputError(
        f"the arc {'ends at' if at_end else 'passes'} {machine.axes[i].name} {place:.6g}, {('below', 'above')[side]} the axis's "
        f"{('minimum', 'maximum')[side]} {limits[i, side]:g}",
        expected="arcs within the range of every axis: is the work offset missing?",
        file=pieces.source,
        line=int(pieces.path.columns.line[arcs[0]] + 1),
        setting="work offset",
    )


def _check_ranges(pieces: Pieces, rows: Rows) -> None:
    """Raise `InputError` if a corrected block leaves the range of an empirical effect between its end points."""
    calibration = pieces.prepared.calibration
    if calibration.empirical:
        rows = rows.where(~rows.untouched)
        lines = pieces.path.columns.line[rows.motion] + 1
        state = calibration.state(rows.nominal) | pieces.conditions.channels(rows.motion, rows.fraction)
        check_ranges(calibration.empirical, state, lines, pieces.source)
