"""The heart of compensation: commands for the ends of every block's pieces, and how many pieces a block needs.

Nominal pose -> commands that reach it -> rotary words at their least increment -> linear axes solved again for what was rounded
-> linear words at theirs. A block is split where the machine, moving straight between two compensated ends, would leave the meant
path by more than the tolerance.

With reversals a block is cut where such an axis turns round inside it, too. Wherever one turns round, between blocks or inside one, a
move of its own takes up the reversal before the way back begins: that start needs the new side's command, not the old one's.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from itertools import pairwise
from typing import Final, final

import numpy as np

from twin._common.arrays import every
from twin.compensation.bench import Aim, Bench, Progress
from twin.compensation.comparison import Commands
from twin.compensation.legs import Legs, turning_points
from twin.compensation.ranges import ARC_POINTS, refuse_arc
from twin.compensation.rows import SAME, Rows, Samples, Ways, counted, distinct, even_cuts, not_back, replaced, spacings
from twin.compensation.toolpath import Path, along, chords
from twin.kinematics.forward import Poses, angle_between_rad
from twin.kinematics.inverse import SLACK
from twin.machine.effects.empirical import check_ranges
from twin.nc.dialect import Dialect

SAMPLES_A_PIECE: Final = 5
"""Interior points at which every piece is re-simulated; more where it is long."""
POSES: Final = 100_000
"""Points checked at once, which bounds the memory it takes."""
LARGEST_SPLIT: Final = 4096
"""Pieces a block may be split into; an error that needs more is not one that splitting cures."""
RETURN: Final = 3.0
"""Least increments by which an axis is taken beyond a place and back so that it has turned: rounding may take one of them."""
ORIENTED_RAD: Final = 1e-9
"""Less is the solver's own noise."""


@final
class Pieces:
    """One program, or a stretch of it, cut into pieces, and the commands for their ends.

    Args:
        bench: machine, calibration, options.
        path: the program as motions.
        aim: what is corrected.
        dialect: its language.
        source: its name, for messages.
        posted: whether axis words come out whatever went in (cutter locations written for a control).

    Attributes:
        idle: whether no error motion is in scope.
        lost: the reversals in scope.
        legs: the motions, cut where an axis with one of them turns round inside, and how many pieces each is in.
        turns: whether the program moves rotary axes at all.
        scope: what is corrected.
        interpolated: (motions,) whether the control follows a line or arc from a known start.
        by_vector: (motions,) whether a tool vector comes out.
        tcp: (motions,) whether the words that went in are tool-tip coordinates.
        tcp_out: (motions,) whether those that come out are.
    """

    def __init__(self, bench: Bench, path: Path, aim: Aim, dialect: Dialect, *, source: str, posted: bool) -> None:
        self.bench = bench
        self.space = bench.space
        self.path = path
        self.aim = aim
        self.dialect = dialect
        self.source = source
        self.turns, self.scope, self.lost = aim.turns, aim.scope, aim.lost
        self.point, self.orientation = aim.point, aim.orientation
        columns = path.columns
        self.tcp, self.start, self.end = columns.tcp, columns.start, columns.end
        self.straight = np.ones(len(columns), dtype=bool)
        self.straight[[i for i, move in columns.special.items() if move.arc is not None]] = False
        self.by_vector = np.zeros(len(columns), dtype=bool)
        self.by_vector[[i for i, move in columns.special.items() if move.vector is not None and not posted]] = True
        self.posted = posted
        self.increment = bench.increment.copy()
        if dialect.linear_increment_mm is not None and not posted:
            self.increment[:3] = dialect.linear_increment_mm
        self.tcp_out = self.tcp & (not posted)
        self.interpolated = ~columns.rapid & every(np.isfinite(self.start))
        # From outside the range there is no meant path to keep to; such a start is reported with its own block.
        self.interpolated &= ~self.bench.outside(self.space.commands(self.start, self.tcp))
        # Nothing to correct: arcs stay arcs, and the program is written as it came.
        self.idle = aim.idle and not posted
        motions = path.motions
        turning = turning_points(bench, motions, np.flatnonzero(self.interpolated), self.lost.axes)
        self.legs = Legs.of(len(motions), turning)
        self._known_mm = np.full(len(self.legs.motion), np.nan)  # what `between` found, as long as it holds
        if not self.idle:
            whole = np.ones(len(motions), dtype=int)
            for i in np.flatnonzero(~self.straight).tolist():
                whole[i] = chords(motions[i], bench.options.tolerance_mm)
            share = self.legs.end - self.legs.begin
            self.legs.count = np.maximum(np.ceil(whole[self.legs.motion] * share), 1).astype(int)

    # --- pieces ------------------------------------------------------------------------------------------------------

    def solve(self, say: Progress) -> Rows:
        """Solve all blocks, splitting where the error between two ends exceeds the tolerance."""
        legs = self.legs
        everything = np.arange(len(legs.motion))
        rows = self._solve(*legs.ends(everything))
        if self.idle:
            return rows
        if self.bench.options.method == "thesis":
            self._check_arcs(rows)
            return rows
        candidates = everything[self.interpolated[legs.motion]]
        step = 0
        while candidates.size and step < 16:
            step += 1
            say("splitting", min(0.7, 0.2 + 0.05 * step))
            worst = self.between(candidates, rows)
            self._known_mm[candidates] = worst
            stuck = np.zeros(len(self.path.motions), dtype=bool)
            stuck[rows.motion[rows.clamped | rows.untouched]] = True
            failing = (worst > self.bench.options.tolerance_mm) & ~stuck[legs.motion[candidates]]
            failing &= legs.count[candidates] < LARGEST_SPLIT
            candidates = candidates[failing]
            if not candidates.size:
                break
            # The error between ends is quadratic in length.
            factor = np.sqrt(worst[failing] / self.bench.options.tolerance_mm)
            grown = np.ceil(legs.count[candidates] * np.clip(1.1 * factor, 1.3, 16.0)).astype(int)
            legs.count[candidates] = np.minimum(grown, LARGEST_SPLIT)
            self._known_mm[candidates] = np.nan
            rows = replaced(rows, candidates, self._solve(*legs.ends(candidates)))
        kept = np.unique(rows.motion[rows.untouched])
        if np.any(self.count(rows)[kept] > 1):
            # A block that leaves the range on its way is left as written, whole.
            legs.whole(kept)
            self._known_mm[np.isin(legs.motion, kept)] = np.nan
            again = np.flatnonzero(np.isin(legs.motion, kept))
            rows = replaced(rows, again, self._solve(*legs.ends(again)))
            rows = replace(rows, untouched=rows.untouched | np.isin(rows.motion, kept))
        self._check_arcs(rows)
        self._check_ranges(rows)
        if not self.lost.axes:
            return rows
        self._known_mm[:] = np.nan
        return self._taken_up(rows)

    def _check_arcs(self, rows: Rows) -> None:
        """Raise `InputError` if an arc is left as written: it would not begin where the compensated block before it ends."""
        arcs = rows.motion[rows.untouched & ~self.straight[rows.motion]]
        if arcs.size:
            of = np.full(ARC_POINTS, arcs[0])
            words = self.words_at(of, np.arange(1, ARC_POINTS + 1) / ARC_POINTS)
            refuse_arc(
                self.bench.machine,
                self.space.commands(words, self.tcp[of]),
                self.source,
                self.path.columns.line[arcs[0]] + 1,
            )

    def _check_ranges(self, rows: Rows) -> None:
        """Raise `InputError` if a corrected block leaves, between its ends, the range of an effect without a known cause."""
        calibration = self.bench.calibration
        if calibration.empirical:
            nominal = rows.nominal[~rows.untouched]
            lines = self.path.columns.line[rows.motion[~rows.untouched]] + 1
            check_ranges(calibration.empirical, calibration.state(nominal), lines, self.source)

    def left(self, rows: Rows) -> np.ndarray:
        """(motions,) largest distance (mm) as of `between` that is left inside each motion, 0 where there is no path to keep to."""
        legs = np.flatnonzero(self.interpolated[self.legs.motion])
        unknown = legs[np.isnan(self._known_mm[legs])]
        if unknown.size:
            self._known_mm[unknown] = self.between(unknown, rows)
        found = np.zeros(len(self.start))
        np.maximum.at(found, self.legs.motion[legs], self._known_mm[legs])
        return found

    def left_as_run(self, motions: np.ndarray, rows: Rows) -> np.ndarray:
        """(motions,) the same of some of them, from where the axes really stand when each begins."""
        legs = np.flatnonzero(np.isin(self.legs.motion, motions))
        found = np.zeros(len(self.start))
        np.maximum.at(found, self.legs.motion[legs], self.between(legs, rows, as_run=True))
        return found[motions]

    def count(self, rows: Rows) -> np.ndarray:
        """(motions,) how many blocks each motion becomes."""
        return np.bincount(rows.motion, minlength=len(self.path.motions))

    def _taken_up(self, rows: Rows) -> Rows:
        """The same pieces with every axis commanded for the side it comes from, and the moves that take up what a turn costs."""
        wanted = self._wanted(rows)
        sides = self.lost.turned(self.path, rows.motion, wanted)
        turned = np.append(np.zeros_like(sides[:1], dtype=bool), sides[1:] != sides[:-1], axis=0)
        at = np.flatnonzero(turned.any(axis=1))
        same = rows.motion[at] == rows.motion[at - 1]
        # On a rapid, and behind a line passed through, the axis is taken to its new side on its way to the end: unless it jumps ahead
        # when it turns, and its way is too short to show it.
        passed = np.array([passage.before for passage in self.path.passages], dtype=int)
        short = (np.abs(wanted[at] - wanted[at - 1]) < self.lost.size + RETURN * self.bench.machine_increment) & turned[
            at
        ]
        known = np.isfinite(self.start[rows.motion[at]]).all(axis=1) & ~self.bench.outside(
            self.space.commands(self.start[rows.motion[at]], self.tcp[rows.motion[at]])
        )
        free = self.interpolated[rows.motion[at]] | (known & (short & (self.lost.size > 0.0)).any(axis=1))
        free &= ~rows.untouched[at] & (same | ~np.isin(rows.motion[at], passed))
        at, same = at[free], same[free]
        begin = np.where(same, rows.fraction[at - 1], 0.0)
        # Where an axis jumps ahead when it turns, it goes beyond what takes that up and back, so that it has turned.
        ahead = turned[at] & (self.lost.size >= self.bench.machine_increment)
        beyond = np.where(ahead, -RETURN * self.bench.machine_increment * sides[at], 0.0)
        over = np.flatnonzero(ahead.any(axis=1))
        kept = np.unique(rows.motion[rows.untouched])
        of = np.concatenate([np.arange(len(rows.leg)), at, at[over]])
        order = np.lexsort((np.repeat([2, 1, 0], [len(rows.leg), len(at), len(over)]), of))
        found = self._solve(
            rows.leg[of][order], np.concatenate([rows.fraction, begin, begin[over]])[order], sides[of][order]
        )
        found = replace(
            found,
            taken=(np.arange(len(of)) >= len(rows.leg))[order],
            turned=np.concatenate([turned, turned[at], np.zeros_like(turned[over])])[order],
            beyond=np.concatenate([np.zeros_like(sides), np.zeros_like(beyond), beyond[over]])[order],
            untouched=found.untouched | np.isin(found.motion, kept),
        )
        found = self._ratcheted(distinct(self._printed(found)), found.approach, self.bench.machine.rotary)
        return distinct(self._ratcheted(self._followed(found), found.approach, self.bench.machine.linear))

    def _followed(self, rows: Rows) -> Rows:
        """What is printed may take a rotary axis to its new side in part only: the linear axes follow what it does."""
        rotary = np.array(self.bench.machine.rotary, dtype=int)
        if not set(rotary.tolist()) & set(self.lost.axes):
            return rows
        sides = np.array(rows.approach)
        there = ~rows.beyond.any(axis=1)
        real = self.lost.sides(self.path, rows.motion, rows.commands)
        start = np.array(rows.exact)
        for axis in rotary:
            sides[there, axis] = real[there, axis]
            start[:, axis] = (rows.commands - rows.beyond)[:, axis]
        exact = self.aim.point_inverse.solve(rows.target, start, rotary=False, approach=sides).positions
        return self._printed(replace(rows, exact=exact, approach=sides))

    def _ratcheted(self, rows: Rows, sides: np.ndarray, axes: tuple[int, ...]) -> Rows:
        """Axes that do not step back, by rounding, on the way to their side: play would swallow it, a control might turn."""
        commands = rows.commands.copy()
        fixed = rows.untouched | rows.clamped | (self.by_vector[rows.motion] & (axes == self.bench.machine.rotary))
        for axis in set(self.lost.axes) & set(axes):
            passed = [passage.before for passage in self.path.passages if passage.moved[axis]]
            breaks = [*np.searchsorted(rows.motion, passed), *np.flatnonzero(fixed), *(np.flatnonzero(fixed) + 1)]
            starts = np.unique([0, *breaks, *np.flatnonzero(np.diff(sides[:, axis])) + 1, len(sides)])
            for first, last in pairwise(starts.tolist()):
                if sides[first, axis] != 0.0:
                    way = commands[first:last, axis] * sides[first, axis]
                    commands[first:last, axis] = not_back(way, abs(self.lost.size[axis])) * sides[first, axis]
        which = np.flatnonzero((commands != rows.commands).any(axis=1) & ~fixed)
        tcp_out = self.tcp_out[rows.motion[which]]
        printed, final = rows.printed.copy(), rows.commands.copy()
        words = self.space.words(commands[which], tcp_out)
        free = ~self.by_vector[rows.motion[which]]
        printed[which, :3] = np.round(words[:, :3] / self.increment[:3]) * self.increment[:3]
        printed[which[free], 3:] = np.round(words[free, 3:] / self.increment[3:]) * self.increment[3:]
        final[which] = self.space.commands(printed[which], tcp_out)
        return replace(rows, printed=printed, commands=final)

    def _wanted(self, rows: Rows) -> np.ndarray:
        """(rows, axes) where the axes are really to be: compensated for everything but reversals, and not rounded."""
        commands, _ = self._oriented(rows.target, np.clip(rows.nominal, *self.bench.limits.T), None)
        solved = self.aim.point_inverse.solve(rows.target, commands, rotary=False).positions
        return np.where(rows.untouched[:, None], rows.nominal, solved)

    @cached_property
    def _ways(self) -> tuple[np.ndarray, np.ndarray]:
        """(motions, axes) words each motion starts from, its end where they are not known, and how far they go."""
        begin = np.where(np.isfinite(self.start), self.start, self.end)
        return begin, self.end - begin

    def words_at(self, of: np.ndarray, fraction: np.ndarray) -> np.ndarray:
        """(n, axes) meant words at fractions of motions."""
        begin, way = self._ways
        words = begin.take(of, axis=0) + fraction[:, None] * way.take(of, axis=0)
        whole = np.flatnonzero(fraction == 1.0)
        words[whole] = self.end.take(of[whole], axis=0)
        if self.straight.all():
            return words
        for motion in np.unique(of[~self.straight[of]]):
            rows = of == motion
            words[rows] = along(self.path.motions[motion], fraction[rows])
        return words

    def _solve(self, leg: np.ndarray, fraction: np.ndarray, approach: np.ndarray | None = None) -> Rows:
        of = self.legs.motion[leg]
        sides = np.zeros((len(of), len(self.bench.machine.axes))) if approach is None else approach
        words = self.words_at(of, fraction)
        nominal = self.space.commands(words, self.tcp[of])
        limits = self.bench.limits
        untouched = self.bench.outside(nominal)
        safe = np.where(untouched[:, None], np.clip(nominal, limits[:, 0], limits[:, 1]), nominal)
        target = self.space.nominal.forward(safe)
        vectors = np.full((len(of), 3), np.nan)
        orientation_left = np.zeros(len(of))
        singular = np.zeros(len(of), dtype=bool)
        if self.bench.thesis is not None:
            commands = self.bench.thesis.commands(safe)
            exact = np.array(commands)
        else:
            commands, orientation_left = self._oriented(target, safe, sides)
            singular = orientation_left > 0.0
            commands, vectors = self._rotary_as_printed(commands, of)
            exact = self.aim.point_inverse.solve(target, commands, rotary=False, approach=sides).positions
        none = np.zeros(len(of), dtype=bool)
        nowhere = np.zeros(sides.shape)
        rows = Rows(
            leg=leg,
            motion=of,
            taken=none,
            approach=sides,
            turned=nowhere.astype(bool),
            beyond=nowhere,
            fraction=fraction,
            words=words,
            nominal=nominal,
            target=target,
            exact=exact,
            commands=exact,
            printed=words,
            vectors=vectors,
            orientation_left=orientation_left,
            singular=singular,
            clamped=none,
            untouched=untouched,
        )
        return self._printed(rows)

    def _oriented(self, target: Poses, start: np.ndarray, sides: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """(n, axes) start with the rotary axes where they repair the orientation, and (n,) radians that are left of it.

        The rotary axes do so wherever they can, even if a linear axis has not the travel that the point would need.
        """
        commands = np.array(start)
        inverse, real = self.aim.orientation_inverse, self.aim.orientation
        if inverse is None or real is None:
            return commands, np.zeros(len(start))
        solution = inverse.solve(target, start, approach=sides)
        rotary = list(self.bench.machine.rotary)
        low, high = self.bench.limits[rotary].T
        turned = solution.positions[:, rotary]
        able = ((turned >= low - SLACK) & (turned <= high + SLACK)).all(axis=1)
        commands[np.ix_(able, rotary)] = turned[able]
        left = np.where(solution.orientation_residual_rad > ORIENTED_RAD, solution.orientation_residual_rad, 0.0)
        unable = np.flatnonzero(~able)
        if unable.size:
            reached = real.forward(commands[unable], None if sides is None else sides[unable])
            left[unable] = angle_between_rad(reached.axis, target.axis[unable])
        return commands, left

    def _printed(self, rows: Rows) -> Rows:
        """Rows with what ``exact`` comes to in words at their increments."""
        limits = self.bench.limits
        wanted = rows.exact + rows.beyond
        clipped = np.clip(wanted, limits[:, 0], limits[:, 1])
        clamped = ~every(np.abs(clipped - wanted)[:, self.space.order] <= 0.5 * self.bench.increment)
        tcp_out = self.tcp_out[rows.motion]
        out = self.space.words(clipped, tcp_out)
        printed = np.round(out / self.increment) * self.increment
        free = np.ix_(self.by_vector[rows.motion], range(3, printed.shape[1]))
        printed[free] = out[free]
        left = rows.untouched
        printed[left] = self.space.words(rows.nominal, tcp_out)[left] if self.posted else rows.words[left]
        return replace(
            rows, printed=printed, commands=self.space.commands(printed, tcp_out), clamped=clamped & ~rows.untouched
        )

    def _rotary_as_printed(self, commands: np.ndarray, of: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotary axes where the printed words will put them; tool vectors where the program gives those."""
        rotary = list(self.bench.machine.rotary)
        commands = np.array(commands)
        offset = self.space.offset[3:]
        increment = self.increment[3:]
        vectors = np.full((len(of), 3), np.nan)
        plain = ~self.by_vector[of]
        words = commands[:, rotary] - offset
        commands[np.ix_(plain, rotary)] = (np.round(words / increment) * increment + offset)[plain]
        rows = np.flatnonzero(~plain)
        if rows.size:
            axis = self.space.nominal.forward(commands[rows]).axis
            vectors[rows] = np.round(axis, self.dialect.vector_decimals)
            unit = vectors[rows] / np.linalg.norm(vectors[rows], axis=1, keepdims=True)
            for row, solutions in zip(rows, self.space.branches.all(unit), strict=True):
                found = self.space.branches.nearest(solutions, commands[row, rotary])
                if found is not None:
                    commands[row, rotary] = found
        return commands, vectors

    # --- re-simulation -----------------------------------------------------------------------------------------------

    def samples(self, legs: np.ndarray) -> Samples:
        """Dense points inside the pieces of legs of interpolated motions."""
        pieces = self.legs.count[legs]
        leg, number = counted(legs, pieces)
        points = np.repeat(self._each(legs), pieces)
        piece, point = counted(np.arange(len(leg)), points)
        return Samples(leg, number, piece, (point + 0.5) / points[piece])

    def _each(self, legs: np.ndarray) -> np.ndarray:
        """(legs,) how many dense points every piece of each leg has."""
        share = self.legs.end[legs] - self.legs.begin[legs]
        pieces = np.maximum(self.legs.count[legs], 1)
        points = np.ceil(self._spacings[self.legs.motion[legs]] * share / pieces)
        return np.maximum(SAMPLES_A_PIECE, points).astype(int)

    @cached_property
    def _spacings(self) -> np.ndarray:
        """(motions,) how many of the largest distances between samples each is long."""
        return spacings(self.start, self.end)

    def fractions(self, samples: Samples) -> np.ndarray:
        """(n,) of the motion that each point is at."""
        first, last = self._fractions(samples)
        return np.asarray(first[samples.piece] + samples.within * (last - first)[samples.piece])

    def _fractions(self, samples: Samples) -> tuple[np.ndarray, np.ndarray]:
        """(pieces,) and (pieces,) of the motion that each piece begins and ends at."""
        share = 1.0 / self.legs.count[samples.leg]
        begin, end = (self.legs.at(samples.leg, (samples.number + i) * share) for i in (0, 1))
        return begin, end

    def meant(self, samples: Samples) -> Commands:
        """Commands that the control makes of the program as it came."""
        motion = self.legs.motion[samples.leg]
        first, last = self._fractions(samples)
        if np.all(self.straight[motion]):
            begin, way = (words.take(motion, axis=0) for words in self._ways)
            if np.any(first != 0.0) or np.any(last != 1.0):
                begin, way = begin + first[:, None] * way, (last - first)[:, None] * way
            return self._on_lines(begin, way, samples, self.tcp[motion])
        of = motion[samples.piece]
        words = self.words_at(of, self.fractions(samples))
        return Commands(self.space.commands(words, self.tcp[of]))

    def given(self, samples: Samples, ways: Ways) -> Commands:
        """Commands where pieces go those ways."""
        row = self.rows_of(samples, ways)
        tcp = self.tcp_out[self.legs.motion[samples.leg]]
        return self._on_lines(ways.begin.take(row, axis=0), ways.way.take(row, axis=0), samples, tcp)

    def rows_of(self, samples: Samples, ways: Ways) -> np.ndarray:
        """(pieces,) the row each piece ends in."""
        return np.asarray(ways.rows[ways.first[samples.leg] + samples.number])

    def _on_lines(self, begin: np.ndarray, way: np.ndarray, samples: Samples, tcp: np.ndarray) -> Commands:
        """Points on straight lines in (pieces, axes) words; ``tcp``: (pieces,)."""
        if not np.any(tcp):
            way = way[:, np.argsort(self.space.order)]
            return Commands(self.space.commands(begin, tcp), way, samples.piece, samples.within)
        words = begin[samples.piece] + samples.within[:, None] * way[samples.piece]
        return Commands(self.space.commands(words, tcp[samples.piece]))

    def ways(self, rows: Rows, given: np.ndarray, *, as_run: bool = False) -> Ways:
        """The way of each piece, its end being ``given`` in words.

        A motion that starts from a place left as written really starts there (``as_run``); for splitting it is taken to
        start compensated, since no splitting cures its first end.
        """
        first = np.append(True, rows.motion[1:] != rows.motion[:-1])
        begin = np.concatenate([given[:1], given[:-1]])
        begin[first] = self._begin(rows, given, as_run=as_run)[rows.motion[first]]
        ends = np.flatnonzero(~rows.taken)
        first_of_leg = np.searchsorted(rows.leg[ends], np.arange(len(self.legs.motion)))
        return Ways(begin, given - begin, ends, first_of_leg)

    def _begin(self, rows: Rows, given: np.ndarray, *, as_run: bool) -> np.ndarray:
        """(motions, axes) words each motion starts from: the last of the one before, where it follows on."""
        ends = np.searchsorted(rows.motion, np.arange(len(self.path.motions)), side="right") - 1
        begin = np.full_like(self.start, np.nan)
        begin[1:] = given[ends[:-1]]
        apart = np.flatnonzero(~self._follows & every(np.isfinite(self.start)))
        if apart.size:
            sides = rows.approach[np.searchsorted(rows.motion, apart)]
            rows = self._solve(np.searchsorted(self.legs.motion, apart), np.zeros(len(apart)), sides)
            commands = self._standing(apart, rows.nominal, begin) if as_run else rows.exact
            begin[apart] = self.space.words(commands, self.tcp_out[apart])
        return begin

    def _standing(self, apart: np.ndarray, nominal: np.ndarray, begin: np.ndarray) -> np.ndarray:
        """(n, axes) commands where some motions begin: axes that a line between left as written moved stand where that says.

        Args:
            apart: (n,) the motions.
            nominal: (n, axes) where they were meant to begin.
            begin: (motions, axes) words that the motion before each ends in.
        """
        standing = np.array(nominal)
        after = apart > 0
        before = apart[after] - 1
        meant = self.space.commands(self.end[before], self.tcp[before])
        reached = self.space.commands(begin[apart[after]], self.tcp_out[before])
        standing[after] = np.where(np.abs(meant - nominal[after]) < SAME, reached, nominal[after])
        return standing

    def begins_off(self, rows: Rows) -> np.ndarray:
        """(motions,) whether each begins where the axes were left uncorrected: by the motion before, or by a line between them."""
        off = np.zeros(len(self.start), dtype=bool)
        ends = np.searchsorted(rows.motion, np.arange(len(off)), side="right") - 1
        off[1:] = (rows.untouched | rows.clamped)[ends[:-1]] | ~self._follows[1:]
        return off & self.interpolated

    @cached_property
    def _follows(self) -> np.ndarray:
        """(motions,) whether each begins where the one before ends, in words of the same mode."""
        follows = np.zeros(len(self.start), dtype=bool)
        follows[1:] = (self.tcp[1:] == self.tcp[:-1]) & every(self.start[1:] == self.end[:-1])
        return follows

    def between(self, legs: np.ndarray, rows: Rows, *, as_run: bool = False) -> np.ndarray:
        """(legs,) largest distance (mm) of the reached point from the meant one between the ends of each leg's pieces.

        Linear words are taken before rounding, so that splitting is not asked to cure rounding. ``as_run`` is that of `ways`.
        """
        ways = self.ways(rows, self.space.words(rows.exact, self.tcp_out[rows.motion]), as_run=as_run)
        parts = [self._between(part, rows, ways) for part in self.portions(legs)]
        return np.concatenate(parts) if parts else np.zeros(0)

    def portions(self, legs: np.ndarray) -> list[np.ndarray]:
        """Legs in portions of no more than some `POSES` samples, about as many in each."""
        return np.split(legs, even_cuts(self._each(legs) * self.legs.count[legs], POSES)) if legs.size else []

    def _between(self, legs: np.ndarray, rows: Rows, ways: Ways) -> np.ndarray:
        samples = self.samples(legs)
        sides = self._sides_between(samples, rows, ways) if self.point.directed else None
        distance = self.aim.compared.distance_mm(self.meant(samples), self.given(samples, ways), sides)
        # A leg that another stands for has no piece, and no point.
        points = self._each(legs) * self.legs.count[legs]
        worst = np.maximum.reduceat(np.append(distance, 0.0), np.cumsum(points) - points)
        return np.where(points > 0, worst, 0.0)

    def _sides_between(self, samples: Samples, rows: Rows, ways: Ways) -> np.ndarray:
        """(n, axes) sides that axes come from inside pieces."""
        row = self.rows_of(samples, ways)
        sides = rows.approach[row[samples.piece]]
        for axis in set(self.lost.axes) & set(self.bench.machine.rotary):
            # A rotary axis may be part of the way through its play at either end. One that turned unseen is through.
            last = np.maximum(row - 1, 0)
            unseen = rows.turned[row, axis] & ~rows.taken[last]
            before = np.where(unseen, rows.approach[row, axis], rows.approach[last, axis])[samples.piece]
            sides[:, axis] = before + samples.within * (sides[:, axis] - before)
        return np.asarray(sides)
