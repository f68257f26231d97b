"""Simulated points of a program on a machine with backlash: in order of travel, because approach directions depend on it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from twin.compensation.account.sample import SimulatedPoints
from twin.compensation.backlash import ApproachTracker
from twin.compensation.comparison import Commands, split_lines
from twin.compensation.prepared import PreparedMachine
from twin.compensation.solving import Corrected
from twin.compensation.solving.path_errors import Samples, rows_of
from twin.compensation.solving.rows import Rows, Ways

Both = tuple[Commands, Commands]
"""Nominal and written commands."""


def directed_points(
    corrected: Corrected, prepared: PreparedMachine, ends: Both, portions: Sequence[np.ndarray], ways: Ways
) -> Iterator[SimulatedPoints]:
    """Yield the end points of pieces and the dense points inside them, portion by portion.

    A straight piece is one line, unless the approach direction changes inside it: then each of its points is a line.

    Args:
        corrected: the stretch.
        prepared: the machine with all its reversal values.
        ends: nominal and written commands at the end points after the context.
        portions: legs with dense points, in order.
        ways: the ways of the pieces, as written.
    """
    rows, context = corrected.own, len(corrected.rows.leg) - len(corrected.own.leg)
    trackers = [ApproachTracker(prepared.backlash, corrected.pieces.path) for _ in ends]
    begins = [0, *(int(np.searchsorted(rows.leg, portion[0])) for portion in portions[1:]), len(rows.leg)]
    for place, (first, last) in enumerate(pairwise(begins)):
        samples = corrected.path_errors.samples(portions[place] if portions else np.zeros(0, dtype=int))
        row = rows_of(samples, ways) - context - first
        inside = corrected.path_errors.commands(samples, ways)
        inside = (inside[0], inside[0]) if corrected.pieces.idle else inside
        begun = (Commands(ends[0].begin[first:last]), Commands(ends[1].begin[first:last]))
        yield from _portion(corrected, rows.where(slice(first, last)), trackers, begun, samples, inside, row)


def _portion(
    corrected: Corrected,
    rows: Rows,
    trackers: Sequence[ApproachTracker],
    ends: Both,
    samples: Samples,
    inside: Both,
    row: np.ndarray,
) -> Iterator[SimulatedPoints]:
    """Yield the end points and the dense points of one portion.

    Args:
        corrected: the stretch.
        rows: its end points in this portion.
        trackers: approach directions with nominal and with written commands, up to this portion.
        ends: commands at the end points.
        samples: the dense points.
        inside: commands at these.
        row: (pieces,) end point of each piece.
    """
    pieces, points, motion = corrected.pieces, samples.points, corrected.pieces.legs.motion[samples.leg]
    line, share = samples.piece, samples.within
    if inside[0].points is not None:
        line, share = split_lines(points, _turning(corrected, rows, trackers, ends, inside, row))
    single = np.flatnonzero(np.isfinite(share))
    before = np.zeros(len(rows.leg), dtype=int)
    before[row] = np.bincount(line[single], minlength=len(row))
    at_end = np.arange(len(before)) + np.cumsum(before)
    within = np.ones(len(before) + before.sum(), dtype=bool)
    within[at_end] = False
    of, fraction = np.repeat(rows.motion, before + 1), np.zeros(len(line))
    if pieces.conditions.names:
        fraction = corrected.path_errors.fractions(samples)
    split = [commands.split(line, share) for commands in inside]
    at_ends, on_lines = [], []
    for tracker, end, commands in zip(trackers, ends, split, strict=True):
        places = np.empty((len(of), end.begin.shape[1]))
        places[at_end], places[within] = end.begin, commands.begin[single]
        found = tracker.after(of, places)
        sides = found[at_end[row[line]]]
        sides[single] = found[within]
        at_ends.append(pieces.conditions.at(found[at_end], rows.motion, rows.fraction))
        on_lines.append(pieces.conditions.at(sides, motion[line], fraction))
    # A move that only takes up backlash has no nominal position.
    yield SimulatedPoints(rows.motion, *ends, *at_ends).of(np.flatnonzero(~rows.backlash_move))
    yield SimulatedPoints(motion[line], split[0], split[1], *on_lines)


def _turning(
    corrected: Corrected,
    rows: Rows,
    trackers: Sequence[ApproachTracker],
    ends: Both,
    inside: Both,
    row: np.ndarray,
) -> np.ndarray:
    """Return (pieces,) whether the approach direction, or a condition, changes inside each straight piece; arguments as above."""
    changes = np.full(len(row), bool(corrected.pieces.conditions.names))
    for tracker, end, commands in zip(trackers, ends, inside, strict=True):
        if len(row):
            changes |= ~tracker.steady(rows.motion, end.begin, row, commands.first)
    return changes
