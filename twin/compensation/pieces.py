"""The heart of compensation: commands for the ends of every block's pieces, and how many pieces a block needs.

Nominal pose -> commands that reach it -> rotary words at their least increment -> linear axes solved again for what was rounded
-> linear words at theirs. A block is split where the machine, moving straight between two compensated ends, would leave the meant
path by more than the tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, final

import numpy as np

from twin.compensation.bench import Bench, Progress
from twin.inverse import Inverse, Status
from twin.iso16907 import Scope
from twin.kinematics import Kinematics, Poses
from twin.nc.blocks import Dialect, Reading
from twin.toolpath import Path, along, chords

SAMPLES_A_PIECE: Final = 5
"""Interior points at which every piece is re-simulated; more where it is long."""
SAMPLE_SPACING: Final = (10.0, 3.0)
"""No two samples further apart than this: mm of linear and degrees of rotary motion."""
LARGEST_SPLIT: Final = 4096
"""Pieces a block may be split into; an error that needs more is not one that splitting cures."""
VECTOR_DECIMALS: Final = {"apt": 9}
"""Decimals of a tool vector by dialect; 7 elsewhere (0.1 µrad)."""
CUTTER_LOCATION_INCREMENT: Final = 1e-5
"""mm: cutter locations are no axis words; a post rounds them to the machine's increment later."""


@final
@dataclass(frozen=True)
class Rows:
    """Ends of pieces: which motion each belongs to, at which fraction of it, and everything solved for it."""

    motion: np.ndarray
    fraction: np.ndarray
    words: np.ndarray
    nominal: np.ndarray
    target: Poses
    exact: np.ndarray
    commands: np.ndarray
    printed: np.ndarray
    vectors: np.ndarray
    orientation_left: np.ndarray
    singular: np.ndarray
    clamped: np.ndarray
    untouched: np.ndarray


@final
class Pieces:
    """One program cut into pieces, and the commands for their ends.

    Args:
        bench: machine, calibration, options.
        path: the program as motions.
        reading: the program as read.
        dialect: its language.
        posted: whether axis words come out whatever went in (cutter locations written for a control).

    Attributes:
        idle: whether no error motion is in scope.
        count: (motions,) how many pieces each motion is in.
        turns: whether the program moves rotary axes at all.
        scope: what is corrected.
        interpolated: (motions,) whether the control follows a line or arc from a known start.
        by_vector: (motions,) whether a tool vector comes out.
        tcp: (motions,) whether the words that went in are tool-tip coordinates.
        tcp_out: (motions,) whether those that come out are.
    """

    def __init__(self, bench: Bench, path: Path, reading: Reading, dialect: Dialect, *, posted: bool) -> None:
        self.bench = bench
        self.space = bench.space
        self.path = path
        self.reading = reading
        self.dialect = dialect
        self.turns = any(move.vector is not None or move.named & set(self.space.axes.rotary) for move in reading.moves)
        self.scope = bench.options.scope or Scope.everything(orientation=self.turns)
        self.tcp = np.array([motion.move.tcp for motion in path.motions])
        self.start = np.array([motion.start for motion in path.motions])
        self.end = np.array([motion.end for motion in path.motions])
        self.straight = np.array([motion.move.arc is None for motion in path.motions])
        self.by_vector = np.array([motion.move.vector is not None and not posted for motion in path.motions])
        self.posted = posted
        self.increment = bench.increment.copy()
        if dialect.name == "apt" and not posted:
            self.increment[:3] = CUTTER_LOCATION_INCREMENT
        self.tcp_out = self.tcp & (not posted)
        self.interpolated = np.array([motion.interpolated for motion in path.motions])
        # From outside the range there is no meant path to keep to; such a start is reported with its own block.
        self.interpolated &= ~self.bench.outside(self.space.commands(self.start, self.tcp))
        # Nothing to correct: arcs stay arcs, and the program is written as it came.
        nothing = self.point.calibration.empty and self._orientation_inverse is None
        self.idle = nothing and not posted and bench.thesis is None
        self.count = np.array(
            [1 if self.idle else chords(motion, bench.options.tolerance_mm) for motion in path.motions]
        )

    @cached_property
    def point(self) -> Kinematics:
        """The errors corrected at the functional point."""
        return self.bench.limited(lambda name: self.scope.at_point(name, self.bench.machine))

    @cached_property
    def _point_inverse(self) -> Inverse:
        return Inverse(self.point)

    @cached_property
    def orientation(self) -> Kinematics | None:
        """The errors corrected by the rotary axes; None where they do not move for it."""
        limited = self.bench.limited(lambda name: self.scope.in_orientation(name, self.bench.machine))
        return limited if self.turns and not limited.calibration.empty else None

    @cached_property
    def _orientation_inverse(self) -> Inverse | None:
        return (
            None
            if self.orientation is None
            else Inverse(self.orientation, rotary_limit_deg=self.bench.options.rotary_limit_deg)
        )

    # --- pieces ------------------------------------------------------------------------------------------------------

    def solve(self, say: Progress) -> Rows:
        """Solve all blocks, splitting where the error between two ends exceeds the tolerance."""
        everything = np.arange(len(self.path.motions))
        rows = self._solve(*self._ends(everything))
        if self.bench.options.method == "thesis" or self.idle:
            return rows
        candidates = everything[self.interpolated]
        step = 0
        while candidates.size and step < 16:
            step += 1
            say("splitting", min(0.7, 0.2 + 0.05 * step))
            worst = self.between(candidates, rows)
            stuck = np.zeros(len(everything), dtype=bool)
            stuck[rows.motion[rows.clamped | rows.untouched]] = True
            failing = (worst > self.bench.options.tolerance_mm) & ~stuck[candidates]
            failing &= self.count[candidates] < LARGEST_SPLIT
            candidates = candidates[failing]
            if not candidates.size:
                break
            # The error between ends is quadratic in length.
            factor = np.sqrt(worst[failing] / self.bench.options.tolerance_mm)
            grown = np.ceil(self.count[candidates] * np.clip(1.1 * factor, 1.3, 16.0)).astype(int)
            self.count[candidates] = np.minimum(grown, LARGEST_SPLIT)
            rows = _replaced(rows, candidates, self._solve(*self._ends(candidates)))
        kept = np.unique(rows.motion[rows.untouched])
        if np.any(self.count[kept] > 1):
            # A block that leaves the range on its way is left as written, whole.
            self.count[kept] = 1
            rows = _replaced(rows, kept, self._solve(*self._ends(kept)))
            rows = replace(rows, untouched=rows.untouched | np.isin(rows.motion, kept))
        return rows

    def _ends(self, motions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        of = np.repeat(motions, self.count[motions])
        counts = self.count[motions]
        within = np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts) + 1
        return of, within / np.repeat(counts, counts)

    def words_at(self, of: np.ndarray, fraction: np.ndarray) -> np.ndarray:
        """(n, axes) meant words at fractions of motions."""
        start = np.where(np.isfinite(self.start[of]), self.start[of], self.end[of])
        words = start + fraction[:, None] * (self.end[of] - start)
        words[fraction == 1.0] = self.end[of[fraction == 1.0]]
        for motion in np.unique(of[~self.straight[of]]):
            rows = of == motion
            words[rows] = along(self.path.motions[motion], fraction[rows])
        return words

    def _solve(self, of: np.ndarray, fraction: np.ndarray) -> Rows:
        words = self.words_at(of, fraction)
        tcp = self.tcp[of]
        nominal = self.space.commands(words, tcp)
        limits = self.bench.limits
        untouched = self.bench.outside(nominal)
        safe = np.where(untouched[:, None], np.clip(nominal, limits[:, 0], limits[:, 1]), nominal)
        target = self.space.nominal.forward(safe)
        vectors = np.full((len(of), 3), np.nan)
        orientation_left = np.zeros(len(of))
        singular = np.zeros(len(of), dtype=bool)
        commands = np.array(safe)
        rotary = list(self.bench.machine.rotary)
        if self.bench.thesis is not None:
            commands = self.bench.thesis.commands(safe)
            exact = np.array(commands)
        else:
            if self._orientation_inverse is not None:
                solution = self._orientation_inverse.solve(target, safe)
                good = solution.where(Status.CONVERGED) | solution.where(Status.SINGULAR)
                commands[np.ix_(good, rotary)] = solution.positions[np.ix_(good, rotary)]
                singular = solution.where(Status.SINGULAR)
                orientation_left = np.where(singular, solution.orientation_residual_rad, 0.0)
            commands, vectors = self._rotary_as_printed(commands, of)
            exact = self._point_inverse.solve(target, commands, rotary=False).positions
        clipped = np.clip(exact, limits[:, 0], limits[:, 1])
        clamped = (np.abs(clipped - exact)[:, self.space.order] > 0.5 * self.bench.increment).any(axis=1)
        tcp_out = self.tcp_out[of]
        out = self.space.words(clipped, tcp_out)
        printed = np.round(out / self.increment) * self.increment
        free = np.ix_(self.by_vector[of], range(3, printed.shape[1]))
        printed[free] = out[free]
        printed[untouched] = self.space.words(nominal, tcp_out)[untouched] if self.posted else words[untouched]
        final = self.space.commands(printed, tcp_out)
        return Rows(
            of,
            fraction,
            words,
            nominal,
            target,
            exact,
            final,
            printed,
            vectors,
            orientation_left,
            singular,
            clamped & ~untouched,
            untouched,
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
            decimals = VECTOR_DECIMALS.get(self.dialect.name, 7)
            vectors[rows] = np.round(self.space.nominal.forward(commands[rows]).axis, decimals)
            unit = vectors[rows] / np.linalg.norm(vectors[rows], axis=1, keepdims=True)
            for row, solutions in zip(rows, self.space.branches.all(unit), strict=True):
                found = self.space.branches.nearest(solutions, commands[row, rotary])
                if found is not None:
                    commands[row, rotary] = found
        return commands, vectors

    # --- re-simulation -----------------------------------------------------------------------------------------------

    def samples(self, motions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Dense points inside the pieces of interpolated motions.

        Returns:
            (n,) motion, (n,) fraction of it, and (n, 2) piece and fraction within the piece.
        """
        size = np.abs(self.end[motions] - self.start[motions])
        linear, turned = size[:, :3].max(axis=1), size[:, 3:].max(axis=1, initial=0.0)
        spacing = np.maximum(linear / SAMPLE_SPACING[0], turned / SAMPLE_SPACING[1])
        pieces = self.count[motions]
        each = np.maximum(SAMPLES_A_PIECE, np.ceil(spacing / pieces)).astype(int)
        count = pieces * each
        of = np.repeat(motions, count)
        index = np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count)
        within = (index % np.repeat(each, count) + 0.5) / np.repeat(each, count)
        piece = index // np.repeat(each, count)
        return of, (piece + within) / np.repeat(pieces, count), np.stack([piece, within], axis=1)

    def path_commands(
        self, of: np.ndarray, local: np.ndarray, rows: Rows, given: np.ndarray, *, as_run: bool = False
    ) -> np.ndarray:
        """Commands at (piece, fraction within it) of motions whose piece ends are ``given`` in words, row by row.

        A motion that starts from a place left as written really starts there (``as_run``); for splitting it is taken to
        start compensated, since no splitting cures its first end.
        """
        first = np.searchsorted(rows.motion, of)
        row = first + local[:, 0].astype(int)
        begin = np.where(
            (local[:, 0] == 0)[:, None], self._begin(rows, given, as_run=as_run)[of], given[np.maximum(row - 1, 0)]
        )
        words = begin + local[:, 1][:, None] * (given[row] - begin)
        return self.space.commands(words, self.tcp_out[of])

    def _begin(self, rows: Rows, given: np.ndarray, *, as_run: bool) -> np.ndarray:
        """(motions, axes) words each motion starts from: the last of the one before, where it follows on."""
        ends = np.searchsorted(rows.motion, np.arange(len(self.path.motions)), side="right") - 1
        begin = np.full_like(self.start, np.nan)
        begin[1:] = given[ends[:-1]]
        follows = np.zeros(len(begin), dtype=bool)
        follows[1:] = (self.tcp[1:] == self.tcp[:-1]) & (self.start[1:] == self.end[:-1]).all(axis=1)
        apart = np.flatnonzero(~follows & np.isfinite(self.start).all(axis=1))
        if apart.size:
            rows = self._solve(apart, np.zeros(len(apart)))
            begin[apart] = self.space.words(rows.nominal if as_run else rows.exact, self.tcp_out[apart])
        return begin

    def between(self, motions: np.ndarray, rows: Rows) -> np.ndarray:
        """(motions,) largest distance (mm) of the reached point from the meant one between the ends of each motion.

        Linear words are taken before rounding, so that splitting is not asked to cure rounding.
        """
        of, fraction, local = self.samples(motions)
        given = self.space.words(rows.exact, self.tcp_out[rows.motion])
        commands = self.path_commands(of, local, rows, given)
        meant = self.space.nominal.reached(
            self.space.commands(self.words_at(of, fraction), self.tcp[of]) * self.bench.machine.scale
        )[1]
        reached = self.point.reached(commands * self.bench.machine.scale)[1]
        distance = np.linalg.norm(reached - meant, axis=1) * 1e3
        worst = np.zeros(len(self.path.motions))
        np.maximum.at(worst, of, distance)
        return worst[motions]


def _replaced(rows: Rows, motions: np.ndarray, new: Rows) -> Rows:
    """Rows with those of some motions exchanged, still in order."""
    keep = ~np.isin(rows.motion, motions)
    order = np.argsort(np.concatenate([rows.motion[keep], new.motion]), kind="stable")

    def merged(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.asarray(np.concatenate([a[keep], b])[order])

    target = Poses(merged(rows.target.point_mm, new.target.point_mm), merged(rows.target.rotation, new.target.rotation))
    fields = {
        name: merged(getattr(rows, name), getattr(new, name)) for name in Rows.__dataclass_fields__ if name != "target"
    }
    return Rows(target=target, **fields)
