"""Dense check of the path between the end points of pieces: real tool points compared with nominal ones."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple, final

import numpy as np

from twin._common.arrays import rows_all_true
from twin.compensation.programs.comparison import Commands, split_lines
from twin.compensation.programs.motions import SAMPLES_A_PIECE
from twin.compensation.programs.pieces import PRINTED_ALIKE, Pieces, Rows, Ways, even_cuts, repeat_with_index, taken
from twin.compute.along import fractions

POSES: Final = 100_000
"""Points checked at once, to bound the memory, where every point needs its own commands; several times as many on straight lines."""
POSES_ON_LINES: Final = 400_000


@final
@dataclass(frozen=True)
class Samples:
    """Dense points inside the pieces of legs, at fractions (k + ½)/n of each piece."""

    leg: np.ndarray  # (pieces,) leg of each piece
    number: np.ndarray  # (pieces,) index of the piece within its leg
    points: np.ndarray  # (pieces,) number of points n of each piece

    @cached_property
    def piece(self) -> np.ndarray:
        """(n,) piece of each point."""
        return np.repeat(np.arange(len(self.leg)), self.points)

    @cached_property
    def within(self) -> np.ndarray:
        """(n,) fraction of its piece."""
        return fractions(self.points)


class EndState(NamedTuple):
    """End of a stretch of a program, at which the next one begins."""

    words: np.ndarray  # (axes,) nominal words
    tcp: bool  # whether these are tool-tip coordinates
    exact: np.ndarray  # exact, printed: (axes,) compensated words before and after rounding
    printed: np.ndarray
    uncorrected: bool  # whether the position is left uncorrected


@final
class PathErrors:
    """Errors of a stretch of a program between the end points of its pieces.

    ``before``: end of the stretch before, if any; ``first``: the first motion whose errors between end points are asked for.
    """

    def __init__(self, pieces: Pieces, before: EndState | None = None, first: int = 0) -> None:
        self._first = first
        self._pieces, self._space, self._before = pieces, pieces.space, before
        self._starts: tuple[tuple[bytes, bytes], Rows] | None = None
        self._cached_mm = np.full(len(pieces.legs.motion), np.nan)

    def forget(self, legs: np.ndarray | slice = slice(None)) -> None:
        """Discard cached errors of some legs."""
        self._cached_mm[legs] = np.nan

    def motion_errors_mm(self, rows: Rows) -> np.ndarray:
        """Return (motions,) the largest error (mm) inside each motion, as in `leg_errors_mm`; 0 where no path is defined."""
        motion = self._pieces.legs.motion
        legs = np.flatnonzero(self._pieces.interpolated[motion] & (motion >= self._first))
        unknown = legs[np.isnan(self._cached_mm[legs])]
        if unknown.size:
            self.leg_errors_mm(unknown, rows)
        return self._by_motion(legs, self._cached_mm[legs])

    def motion_errors_as_run_mm(self, motions: np.ndarray, rows: Rows) -> np.ndarray:
        """Return (motions,) the largest error (mm) inside some motions, each starting from the actual axis positions."""
        legs = np.flatnonzero(np.isin(self._pieces.legs.motion, motions))
        return self._by_motion(legs, self._distances(legs, rows, as_run=True))[motions]

    def _by_motion(self, legs: np.ndarray, of_legs: np.ndarray) -> np.ndarray:
        worst = np.zeros(len(self._pieces.start))
        np.maximum.at(worst, self._pieces.legs.motion[legs], of_legs)
        return worst

    def leg_errors_mm(self, legs: np.ndarray, rows: Rows) -> np.ndarray:
        """Return (legs,) the largest distance (mm) of the real from the nominal point between the end points of each leg's pieces.

        Linear words are taken before rounding, so that blocks are not split because of rounding.
        """
        self._cached_mm[legs] = self._distances(legs, rows, as_run=False)
        return self._cached_mm[legs]

    def _distances(self, legs: np.ndarray, rows: Rows, *, as_run: bool) -> np.ndarray:
        ways = self.ways(rows, printed=False, as_run=as_run)
        parts = [self._portion(part, rows, ways) for part in self.portions(legs)]
        return np.concatenate(parts) if parts else np.zeros(0)

    def _portion(self, legs: np.ndarray, rows: Rows, ways: Ways) -> np.ndarray:
        samples = self.samples(legs)
        nominal, written = self.commands(samples, ways)
        piece, state = samples.piece if nominal.points is None else np.arange(len(samples.leg)), None
        if self._pieces.aim.point.directed:
            piece, share, state = self._directed(samples, rows, ways, on_lines=nominal.points is not None)
            nominal, written = nominal.split(piece, share), written.split(piece, share)
        distance = self._pieces.aim.comparison.distance_mm(nominal, written, state)
        # A leg merged into another has no pieces and no points.
        of_leg = np.repeat(np.arange(len(legs)), self._pieces.legs.count[legs])
        lines = np.bincount(of_leg[piece], minlength=len(legs))
        worst = np.maximum.reduceat(np.append(distance, 0.0), np.cumsum(lines) - lines)
        return np.where(lines > 0, worst, 0.0)

    def _directed(
        self, samples: Samples, rows: Rows, ways: Ways, *, on_lines: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return lines with constant approach and conditions: (n,) piece and fraction, as `split_lines`, and (n, axes + channels).

        ``on_lines``: whether every piece is a line; otherwise every point is one.
        """
        pieces, row = self._pieces, rows_of(samples, ways)
        ended = rows.approach[row]
        begun = np.array(ended)
        for axis in set(pieces.aim.backlash.axes) & set(pieces.prepared.machine.rotary):
            # A rotary axis may be partly through its play at either end point. After an unobserved reversal it is fully through.
            last = np.maximum(row - 1, 0)
            unseen = rows.reverses[row, axis] & ~rows.backlash_move[last]
            begun[:, axis] = np.where(unseen, ended[:, axis], rows.approach[last, axis])
        varying = (begun != ended).any(axis=1) | bool(pieces.conditions.names) | (not on_lines)
        piece, share = split_lines(samples.points, varying)
        sides = begun[piece] + np.nan_to_num(share)[:, None] * (ended - begun)[piece]
        fraction = self.fractions(samples) if pieces.conditions.names else share
        return piece, share, pieces.conditions.at(sides, pieces.legs.motion[samples.leg][piece], fraction)

    # --- dense points ------------------------------------------------------------------------------------------------

    def portions(self, legs: np.ndarray) -> list[np.ndarray]:
        """Split legs into portions of about equal size with at most about `POSES` samples, or `POSES_ON_LINES`."""
        most = POSES_ON_LINES if self._on_lines(self._pieces.legs.motion[legs]) else POSES
        return (
            np.split(legs, even_cuts(self._points_per_piece(legs) * self._pieces.legs.count[legs], most))
            if legs.size
            else []
        )

    def samples(self, legs: np.ndarray) -> Samples:
        """Return dense points inside the pieces of legs of interpolated motions."""
        if self._pieces.legs.whole(legs):
            return Samples(legs, np.zeros(len(legs), dtype=int), self._points_per_piece(legs))
        pieces = self._pieces.legs.count[legs]
        return Samples(*repeat_with_index(legs, pieces), np.repeat(self._points_per_piece(legs), pieces))

    def _points_per_piece(self, legs: np.ndarray) -> np.ndarray:
        """Return (legs,) the number of dense points per piece of each leg."""
        all_legs = self._pieces.legs
        lengths = taken(self._pieces.path.columns.spacings, taken(all_legs.motion, legs))
        if not all_legs.whole(legs):
            lengths = lengths * (all_legs.end[legs] - all_legs.begin[legs]) / np.maximum(all_legs.count[legs], 1)
        points = np.ceil(lengths)
        return np.maximum(SAMPLES_A_PIECE, points).astype(int)

    def fractions(self, samples: Samples) -> np.ndarray:
        """Return (n,) the fraction of the motion at each point."""
        first, last = self._fractions(samples)
        return np.asarray(first[samples.piece] + samples.within * (last - first)[samples.piece])

    def _fractions(self, samples: Samples) -> tuple[np.ndarray, np.ndarray]:
        """Return (pieces,) and (pieces,) the fractions of the motion at which each piece begins and ends."""
        share = 1.0 / self._pieces.legs.count[samples.leg]
        begin, end = (self._pieces.legs.at(samples.leg, (samples.number + i) * share) for i in (0, 1))
        return begin, end

    def commands(self, samples: Samples, ways: Ways) -> tuple[Commands, Commands]:
        """Return nominal commands and those of pieces that follow ``ways``: as lines if all are straight, else as points."""
        row = rows_of(samples, ways)
        motion = taken(self._pieces.legs.motion, samples.leg)
        begin, way = taken(ways.begin, row), taken(ways.way, row)
        straight = bool(np.all(self._pieces.straight[motion]))
        if straight:
            meant, meant_way = (taken(words, motion) for words in self._pieces.ways)
            if not self._pieces.legs.whole(samples.leg):
                first, last = self._fractions(samples)
                meant, meant_way = meant + first[:, None] * meant_way, (last - first)[:, None] * meant_way
            if self._on_lines(motion):
                tips, tips_out = (bool(mode[motion[:1]].any()) for mode in (self._pieces.tcp, self._pieces.tcp_out))
                return (
                    self._line(meant, meant_way, samples.points, tips=tips),
                    self._line(begin, way, samples.points, tips=tips_out),
                )
        of = motion[samples.piece]
        if straight:
            words = meant[samples.piece] + samples.within[:, None] * meant_way[samples.piece]
        else:
            words = self._pieces.words_at(of, self.fractions(samples))
        new = begin[samples.piece] + samples.within[:, None] * way[samples.piece]
        return (
            Commands(self._space.commands(words, self._pieces.tcp[of])),
            Commands(self._space.commands(new, self._pieces.tcp_out[of])),
        )

    def _on_lines(self, motions: np.ndarray) -> bool:
        """Return whether motions can be simulated as lines of commands or words: straight, in one mode, outside tilted planes.

        Lines of tool-tip words are split into points if the machine's errors depend on approach directions or conditions.
        """
        pieces = self._pieces
        if not self._space.parallel or not np.all(pieces.straight[motions]):
            return False
        tips = np.count_nonzero(pieces.tcp[motions])
        return not tips or (tips == len(motions) and not pieces.prepared.real.directed)

    def _line(self, begin: np.ndarray, way: np.ndarray, points: np.ndarray, *, tips: bool) -> Commands:
        """Return points on straight lines of words: of the axes, or of the tool ``tips``."""
        mode = np.full(len(begin), tips)
        if tips:
            return Commands(begin, way, points, lambda words: self._space.commands(words, np.full(len(words), True)))
        return Commands(self._space.commands(begin, mode), self._space.displacements(way), points)

    # --- ways of pieces ----------------------------------------------------------------------------------------------

    def ways(self, rows: Rows, *, printed: bool, as_run: bool) -> Ways:
        """Return the way of each piece of interpolated motions, between words ``printed`` or before rounding.

        With ``as_run``, a motion after a line left as written starts at its actual position. For splitting it is assumed to start
        compensated, because splitting cannot correct its starting point.
        """
        end_words = rows.printed if printed else self._space.words(rows.exact, self._pieces.tcp_out[rows.motion])
        before = self._before
        at_start = end_words[0] if before is None else before.printed if printed else before.exact
        begin = np.concatenate([at_start[None], end_words[:-1]])
        separate = np.flatnonzero(~self._follows & self._pieces.interpolated)
        separate = separate[separate >= self._first]
        if separate.size:
            first = np.searchsorted(rows.motion, separate)
            begin[first] = self._start_words(separate, rows.approach[first], begin[first], as_run=as_run)
        legs = np.arange(len(self._pieces.legs.motion))
        if np.all(self._pieces.legs.count == 1) and not rows.backlash_move.any():
            return Ways(begin, end_words - begin, legs, legs)
        ends = np.flatnonzero(~rows.backlash_move)
        return Ways(begin, end_words - begin, ends, np.searchsorted(rows.leg[ends], legs))

    def starts_uncorrected(self, rows: Rows) -> np.ndarray:
        """Return (motions,) whether each begins at an uncorrected position, left by the motion before or by a line between them."""
        uncorrected, off = rows.untouched | rows.clamped, ~self._follows
        off[0] = self._before is not None and (self._before.uncorrected or off[0])
        if uncorrected.any():
            off[1:] |= uncorrected[np.searchsorted(rows.motion, np.arange(1, len(off))) - 1]
        return off & self._pieces.interpolated

    def _start_words(self, separate: np.ndarray, sides: np.ndarray, reached: np.ndarray, *, as_run: bool) -> np.ndarray:
        """Return (n, axes) words at the start of (n,) motions that do not begin at (n, axes) ``reached``, where the one before ends."""
        pieces = self._pieces
        rows = self._starts_of(separate, sides)
        commands = self._actual_start(separate, rows.nominal, reached) if as_run else rows.exact
        return self._space.words(commands, pieces.tcp_out[separate])

    def _starts_of(self, separate: np.ndarray, sides: np.ndarray) -> Rows:
        """Return the solution at the start of (n,) motions, with (n, axes) sides of approach; asked for again after splitting."""
        key = separate.tobytes(), sides.tobytes()
        if self._starts is None or self._starts[0] != key:
            leg = np.searchsorted(self._pieces.legs.motion, separate)
            self._starts = key, self._pieces.solve(leg, np.zeros(len(separate)), sides)
        return self._starts[1]

    def _actual_start(self, separate: np.ndarray, nominal: np.ndarray, reached: np.ndarray) -> np.ndarray:
        """Return (n, axes) actual commands at the start of motions; axes moved by a line before stand where that line put them."""
        ended, tcp = (values[separate] for values in self._ends_before)
        expected = self._space.commands(ended, tcp)
        # As in the output, where tool-tip input that is posted has axis words.
        standing = self._space.commands(reached, tcp & (not self._pieces.posted))
        known = (separate > 0) | (self._before is not None)
        return np.where(known[:, None] & (np.abs(expected - nominal) < PRINTED_ALIKE), standing, nominal)

    @cached_property
    def _follows(self) -> np.ndarray:
        """(motions,) whether each begins where the one before ends, in words of the same mode."""
        ended, tcp = self._ends_before
        follows = (tcp == self._pieces.tcp) & rows_all_true(self._pieces.start == ended)
        return follows if self._before is not None else follows & (np.arange(len(follows)) > 0)

    @cached_property
    def _ends_before(self) -> tuple[np.ndarray, np.ndarray]:
        """(motions, axes) words and (motions,) mode at the end of the motion before each; the first one's own if there is none."""
        pieces, before = self._pieces, self._before
        words, tcp = (pieces.start[:1], pieces.tcp[:1]) if before is None else (before.words[None], [before.tcp])
        return np.concatenate([words, pieces.end[:-1]]), np.concatenate([tcp, pieces.tcp[:-1]])


def rows_of(samples: Samples, ways: Ways) -> np.ndarray:
    """Return (pieces,) the row of each piece's end point."""
    return taken(ways.rows, taken(ways.first, samples.leg) + samples.number)
