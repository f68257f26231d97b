"""Correct a program, or a stretch of it: solve all end points, and split blocks where the path between them leaves the tolerance.

Every axis is commanded for its approach direction. Where one with backlash reverses, between blocks or inside one, which is cut there,
an inserted move takes up the backlash before the way back begins, because that starting point needs the command for the new direction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.resources import Progress
from twin.compensation.programs.path_errors import EndState, PathErrors
from twin.compensation.programs.pieces import Pieces, Rows
from twin.compensation.programs.words import check_domains
from twin.model.effects.empirical import check_ranges
from twin.nc.blocks import NewPositions
from twin.tool.inverse import SLACK, Status

OVERSHOOT: Final = 3.0
"""Least increments by which an axis is moved beyond a position and back so that it has reversed; rounding may remove one of them."""


def insert_backlash_moves(pieces: Pieces, rows: Rows) -> Rows:
    """Return the rows with every axis commanded for its approach direction, and with the moves inserted that take up backlash."""
    intended = _intended(pieces, rows)
    sides = pieces.aim.backlash.commanded_sides(pieces.path, rows.motion, intended)
    turned = np.append(np.zeros_like(sides[:1], dtype=bool), sides[1:] != sides[:-1], axis=0)
    at = _rows_to_insert_before(pieces, rows, intended, turned)
    begin = np.where(rows.motion[at] == rows.motion[at - 1], rows.fraction[at - 1], 0.0)
    # An axis that jumps ahead when it reverses is moved beyond that position and back, so that it has reversed.
    ahead = turned[at] & (pieces.aim.backlash.size >= pieces.prepared.machine_increment)
    beyond = np.where(ahead, -OVERSHOOT * pieces.prepared.machine_increment * sides[at], 0.0)
    over = np.flatnonzero(ahead.any(axis=1))
    of = np.concatenate([np.arange(len(rows.leg)), at, at[over]])
    order = np.lexsort((np.repeat([2, 1, 0], [len(rows.leg), len(at), len(over)]), of))
    fraction = np.concatenate([rows.fraction, begin, begin[over]])[order]
    inserted = pieces.solve(rows.leg[of][order], fraction, sides[of][order])
    inserted = replace(
        inserted,
        backlash_move=(np.arange(len(of)) >= len(rows.leg))[order],
        reverses=np.concatenate([turned, turned[at], np.zeros_like(turned[over])])[order],
        overshoot=np.concatenate([np.zeros_like(sides), np.zeros_like(beyond), beyond[over]])[order],
        untouched=inserted.untouched | pieces.left_as_written(rows)[inserted.motion],
    )
    inserted = pieces.printed(inserted).distinct()
    inserted = _without_steps_back(pieces, inserted, inserted.approach, pieces.prepared.machine.rotary)
    return _without_steps_back(
        pieces, _linear_axes_solved_again(pieces, inserted), inserted.approach, pieces.prepared.machine.linear
    ).distinct()


def _rows_to_insert_before(pieces: Pieces, rows: Rows, intended: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """Return the rows before which a move is inserted that takes up backlash.

    None is inserted on a rapid or after a passed-through line: there the axis reaches its new side on the way to the end point, unless
    it jumps ahead when it reverses and its way is too short for that.
    """
    size = pieces.aim.backlash.size
    at = np.flatnonzero(turned.any(axis=1))
    motion = rows.motion[at]
    passed = np.array([passage.before for passage in pieces.path.passages], dtype=int)
    short = (np.abs(intended[at] - intended[at - 1]) < size + OVERSHOOT * pieces.prepared.machine_increment) & turned[
        at
    ]
    start = pieces.start[motion]
    known = np.isfinite(start).all(axis=1) & ~pieces.prepared.outside(pieces.space.commands(start, pieces.tcp[motion]))
    free = pieces.interpolated[motion] | (known & (short & (size > 0.0)).any(axis=1))
    free &= ~rows.untouched[at] & ((motion == rows.motion[at - 1]) | ~np.isin(motion, passed))
    return at[free]


def _intended(pieces: Pieces, rows: Rows) -> np.ndarray:
    """Return (rows, axes) the intended axis positions: compensated for everything but backlash, not rounded."""
    start = np.clip(rows.nominal, *pieces.prepared.limits.T)
    state = pieces.state(replace(rows, approach=np.zeros_like(rows.approach)))
    commands, _ = pieces.oriented(rows.target, start, state)
    solved = pieces.aim.point_inverse.solve(rows.target, commands, rotary=False, approach=state).positions
    solved = np.where(rows.relaxed[:, None], rows.exact, solved)
    return np.where(rows.untouched[:, None], rows.nominal, solved)


def _linear_axes_solved_again(pieces: Pieces, rows: Rows) -> Rows:
    """Solve the linear axes again for rotary axes that, as printed, reach their new side only in part."""
    rotary = list(pieces.prepared.machine.rotary)
    if not set(rotary) & set(pieces.aim.backlash.axes):
        return rows
    sides, start = np.array(rows.approach), np.array(rows.exact)
    there = ~rows.overshoot.any(axis=1)
    real = pieces.aim.backlash.sides(pieces.path, rows.motion, rows.commands)
    for axis in rotary:
        sides[there, axis] = real[there, axis]
        start[:, axis] = (rows.commands - rows.overshoot)[:, axis]
    rows = replace(rows, approach=sides)
    solution = pieces.aim.point_inverse.solve(rows.target, start, rotary=False, approach=pieces.state(rows))
    rows = replace(rows, exact=solution.positions, as_programmed=np.zeros_like(rows.as_programmed))
    return pieces.printed(rows, solution.where(Status.OUT_OF_RANGE))


def _without_steps_back(pieces: Pieces, rows: Rows, sides: np.ndarray, axes: tuple[int, ...]) -> Rows:
    """Return the rows without small steps back caused by rounding, which backlash would absorb, or a control see as reversals."""
    commands = rows.commands.copy()
    fixed = rows.untouched | rows.clamped | (pieces.by_vector[rows.motion] & (axes == pieces.prepared.machine.rotary))
    for axis in set(pieces.aim.backlash.axes) & set(axes):
        passed = [passage.before for passage in pieces.path.passages if passage.moved[axis]]
        breaks = [*np.searchsorted(rows.motion, passed), *np.flatnonzero(fixed), *(np.flatnonzero(fixed) + 1)]
        starts = np.unique([0, *breaks, *np.flatnonzero(np.diff(sides[:, axis])) + 1, len(sides)])
        way = commands[:, axis] * sides[:, axis]
        back = np.flatnonzero(np.diff(way) < 0.0) + 1
        for place in np.unique(np.searchsorted(starts, back[~np.isin(back, starts)])).tolist():
            first, last = starts[place - 1], starts[place]
            if sides[first, axis] != 0.0:
                not_back = _not_back(way[first:last], abs(pieces.aim.backlash.size[axis]))
                commands[first:last, axis] = not_back * sides[first, axis]
    which = np.flatnonzero((commands != rows.commands).any(axis=1) & ~fixed)
    tcp_out = pieces.tcp_out[rows.motion[which]]
    printed, final_commands = rows.printed.copy(), rows.commands.copy()
    words = pieces.space.words(commands[which], tcp_out)
    rounded = pieces.prepared.on_grid(words, tcp_out, pieces.increment)
    free = ~pieces.by_vector[rows.motion[which]]
    printed[which, :3] = rounded[:, :3]
    printed[which[free], 3:] = rounded[free, 3:]
    final_commands[which] = pieces.space.commands(printed[which], tcp_out)
    return replace(rows, printed=printed, commands=final_commands)


def _not_back(way: np.ndarray, most: float) -> np.ndarray:
    """Return a rising sequence with steps back below ``most`` removed; larger ones are not caused by rounding."""
    rising = np.maximum.accumulate(way)
    if np.all(rising - way < most):
        return rising
    out = []
    top = way[0]
    for place in way.tolist():
        top = place if place >= top or top - place >= most else top
        out.append(top)
    return np.array(out)


# --- Correct a program, or a stretch of it: solve all end points, and split blocks where the path between them leaves the tol

LARGEST_SPLIT: Final = 4096
"""Most pieces per block; an error that needs more cannot be reduced by splitting."""
MOST_ROUNDS: Final = 16
"""Most rounds of splitting."""
ARC_POINTS: Final = 64
"""Points of an arc that are compared with the axis ranges, for the message."""


@final
@dataclass(frozen=True)
class Corrected:
    """A corrected program, or a stretch of it."""

    pieces: Pieces  # the program cut into pieces
    path_errors: PathErrors  # the errors between their end points
    rows: Rows  # the commands at the end points
    context: int  # number of its first motions that belong to the stretch before

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
    """Return the positions that replace the moves of a program, or of a part of it, corrected in consecutive stretches.

    They have shares of the moves' time where moves are inserted that take up backlash. ``axes``: number of words per position.
    """
    first, count = np.zeros((2, moves), dtype=int)
    begin = 0
    for stretch in stretches:
        own = stretch.pieces.path.columns.move[stretch.context :]
        first[own], count[own] = stretch.new.first + begin, stretch.new.count
        begin += len(stretch.new.positions)
    positions = np.concatenate([np.zeros((0, axes)), *(stretch.new.positions for stretch in stretches)])
    vectors = np.concatenate([np.zeros((0, 3)), *(stretch.new.vectors for stretch in stretches)])
    inserted = any(np.any(stretch.rows.backlash_move) for stretch in stretches)
    shares = np.concatenate([_shares(stretch) for stretch in stretches]) if inserted else None
    return NewPositions(first, count, positions, vectors, shares)


def _shares(found: Corrected) -> np.ndarray:
    """Return (rows,) the share of its motion's time for each row, NaN if all are equal. One degree counts as one millimetre."""
    rows, taken = found.rows, found.rows.backlash_move
    starts = np.append(True, rows.motion[1:] != rows.motion[:-1])[: len(taken)]
    shares = rows.fraction - np.where(starts, 0.0, np.roll(rows.fraction, 1))
    way = np.linalg.norm(np.diff(rows.printed, axis=0, prepend=rows.printed[:1]), axis=1)
    total = np.bincount(rows.motion, way)[rows.motion]
    shares[taken] = way[taken] / np.maximum(total[taken], found.pieces.increment[0])
    with_backlash = np.bincount(rows.motion, taken)[rows.motion] > 0
    return np.where(with_backlash, np.clip(shares, 1e-6, 1.0), np.nan)


def correct(pieces: Pieces, progress: Progress, *, context: int = 0, before: EndState | None = None) -> Corrected:
    """Solve all blocks, and split those whose error between end points exceeds the tolerance.

    ``context``: number of first motions that belong to the stretch before, whose end is ``before`` if none of its motions is among the
    pieces. `InputError` for a position that the calibration does not cover, or an arc that cannot be compensated as a whole.
    """
    prepared, lines = pieces.prepared, pieces.path.columns.line + 1
    commands = pieces.space.commands(pieces.end[context:], pieces.tcp[context:])
    check_domains(prepared.real, pieces.source, lines[context:], commands)
    # Backlash depends on how the motion before a stretch ends, and so on its pieces.
    first = 0 if pieces.aim.backlash.axes else context
    path_errors = PathErrors(pieces, before, first)
    rows = pieces.ends(np.arange(len(pieces.legs.motion)))
    if not pieces.idle:
        if prepared.thesis is None:
            rows = _whole(pieces, path_errors, _split(pieces, path_errors, rows, progress, first))
        _check_arcs(pieces, rows)
        if prepared.thesis is None:
            _check_ranges(pieces, rows)
            if pieces.aim.backlash.axes:
                path_errors.forget()
                rows = insert_backlash_moves(pieces, rows)
    return Corrected(pieces, path_errors, rows, context)


def _split(pieces: Pieces, path_errors: PathErrors, rows: Rows, progress: Progress, first: int) -> Rows:
    """Split blocks, from a ``first`` motion on, until the path between end points is within tolerance, or splitting no longer helps."""
    legs, tolerance = pieces.legs, pieces.prepared.options.tolerance_mm
    candidates = np.flatnonzero((pieces.interpolated & ~pieces.whole)[legs.motion] & (legs.motion >= first))
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
    """Raise `InputError` if a corrected block leaves the range of an effect between its end points."""
    calibration = pieces.prepared.calibration
    if calibration.bounded:
        rows = rows.where(~rows.untouched)
        lines = pieces.path.columns.line[rows.motion] + 1
        state = calibration.state(rows.nominal) | pieces.conditions.channels(rows.motion, rows.fraction)
        check_ranges(calibration.bounded, state, lines, pieces.source)
