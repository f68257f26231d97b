"""Backlash compensation: every axis is commanded for its approach direction, and inserted moves take up the backlash at reversals.

Where an axis reverses, between blocks or inside one, the inserted move takes up the backlash before the way back begins, because that
starting point needs the command for the new direction.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from twin.compensation.solving.pieces import Pieces
from twin.compensation.solving.rows import Rows
from twin.kinematics.inverse import Status

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
    found = pieces.solve(rows.leg[of][order], fraction, sides[of][order])
    found = replace(
        found,
        backlash_move=(np.arange(len(of)) >= len(rows.leg))[order],
        reverses=np.concatenate([turned, turned[at], np.zeros_like(turned[over])])[order],
        overshoot=np.concatenate([np.zeros_like(sides), np.zeros_like(beyond), beyond[over]])[order],
        untouched=found.untouched | pieces.left_as_written(rows)[found.motion],
    )
    found = pieces.printed(found).distinct()
    found = _without_steps_back(pieces, found, found.approach, pieces.prepared.machine.rotary)
    return _without_steps_back(
        pieces, _linear_axes_solved_again(pieces, found), found.approach, pieces.prepared.machine.linear
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
    """Return the rows without small steps back caused by rounding.

    Backlash would absorb such a step, or a control might see a reversal.
    """
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
                found = _not_back(way[first:last], abs(pieces.aim.backlash.size[axis]))
                commands[first:last, axis] = found * sides[first, axis]
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
