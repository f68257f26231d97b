"""Runs, sequences of blocks that approximate one smooth path: found, cut at their corners, and refitted with fewer blocks.

A run consists of consecutive straight feed blocks that contain nothing but positions, in one mode and at one feed; comments between
them are allowed. Curves are fitted from corner to corner and cut into blocks, within the share of the tolerance for the path.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Final, NamedTuple, final

import numpy as np

from twin._common.errors import InputError
from twin.compensation.fewer_blocks.fit import (
    POINTS_PER_BLOCK,
    CurvePiece,
    Fitter,
    Polyline,
    Tool,
    between,
    few_blocks,
    largest_distance,
)
from twin.compensation.programs.motions import PathMotion, ToolPath
from twin.compensation.programs.prepared import PreparedMachine
from twin.compensation.programs.words import WordSpace
from twin.nc.blocks import Kind, Program
from twin.nc.dialect import Dialect, FeedUnit

FEWEST_BLOCKS: Final = 3
"""Least number of blocks of a run: two cannot be reduced."""
ISOLATED_BEND_RAD: Final = np.radians(15.0)
"""Least isolated bend that is a corner …"""
ISOLATED_FACTOR: Final = 3.0
"""… a bend is isolated if its neighbours are smaller by this factor; along a curve they are similar."""
LONG_FACTOR: Final = 10.0
"""A block longer than this many median blocks of the run is a line of its own, not part of a curve."""
SAME_MM: Final = 1e-9
"""Distance below which positions are equal."""


@final
@dataclass(frozen=True)
class Run:
    """Consecutive blocks of a run."""

    motions: range  # their indices in ``ToolPath.motions``, in order
    lines: tuple[int, ...]  # index of each block's line in the program
    words: np.ndarray  # (n+1, axes) start of the first block, and end points of all


@final
@dataclass(frozen=True)
class RunEndPoints:
    """A run with new end points for its blocks."""

    run: Run  # as found
    words: np.ndarray  # (m, axes) end points of the output blocks, not rounded
    assigned: np.ndarray  # (n,) index of the end point assigned to each block of the run, not decreasing
    changed: np.ndarray  # (n,) whether a block's text is rewritten

    @property
    def kept(self) -> np.ndarray:
        """(n,) whether each block remains: the first one of each end point."""
        return np.append(True, np.diff(self.assigned) > 0)


def find_runs(program: Program, dialect: Dialect, path: ToolPath, space: WordSpace) -> list[Run]:
    """Return the runs of a program, in order."""
    plain = _plain_lines(program, dialect, path, space.axes.names)
    passed = {passage.before for passage in path.passages}
    per_line: dict[int, int] = {}
    for motion in path.motions:
        per_line[motion.move.line] = per_line.get(motion.move.line, 0) + 1
    runs: list[Run] = []
    members: list[int] = []

    def close() -> None:
        if len(members) >= FEWEST_BLOCKS:
            motions = [path.motions[i] for i in members]
            words = np.array([motions[0].start, *(motion.end for motion in motions)])
            runs.append(Run(range(members[0], members[-1] + 1), tuple(m.move.line for m in motions), words))
        members.clear()

    for i, motion in enumerate(path.motions):
        feed = plain.get(motion.move.line)
        fits = feed is not None and per_line[motion.move.line] == 1 and _straight(motion)
        if members and not (fits and _follows(path.motions[members[-1]], motion) and i not in passed):
            close()
        if members:
            before = path.motions[members[-1]].move.line
            if feed != plain[before] or not all(map(dialect.is_comment, program.texts[before + 1 : motion.move.line])):
                close()
        if fits:
            members.append(i)
    close()
    return runs


def corners(line: Polyline, allowed_mm: float) -> list[int]:
    """Return the vertices of a run at which one curve ends and the next begins, including both end points.

    A vertex is a corner in three cases. First, the smooth path from the middle of one block to the middle of the next would miss it by
    more than the fit allows (twice that much, because a curve may lie on both sides of its polyline). Second, its bend is isolated.
    Third, a neighbouring block is so long that it is a line of its own. The smooth path, tangent to both blocks, misses the vertex by ¼
    of the shorter block times the sine of half the bend, measured between the end directions of blocks that are bent at the tool.
    """
    size = line.size
    way = np.diff(line.dense_tool, axis=0)
    unit = way / np.linalg.norm(way, axis=1)[:, None]
    half_sine = (
        np.linalg.norm(
            unit[POINTS_PER_BLOCK::POINTS_PER_BLOCK] - unit[POINTS_PER_BLOCK - 1 : -1 : POINTS_PER_BLOCK], axis=1
        )
        / 2.0
    )
    bend = 2.0 * np.arcsin(np.clip(half_sine, 0.0, 1.0))
    rounded = np.minimum(size[:-1], size[1:]) * half_sine / 4.0
    neighbour = np.maximum(np.append(0.0, bend[:-1]), np.append(bend[1:], 0.0))
    isolated = (bend >= ISOLATED_BEND_RAD) & (bend >= ISOLATED_FACTOR * neighbour)
    long = size > LONG_FACTOR * np.median(size)
    is_corner = (rounded > 2.0 * allowed_mm) | isolated | long[:-1] | long[1:]
    return [0, *(np.flatnonzero(is_corner) + 1).tolist(), len(size)]


def _straight(motion: PathMotion) -> bool:
    """Return whether a block is one straight move from a known position and nothing else."""
    move = motion.move
    free = not (move.machine or move.whole) and move.normal is None
    return move.kind is Kind.LINEAR and free and bool(np.isfinite(motion.start).all())


def _follows(before: PathMotion, motion: PathMotion) -> bool:
    """Return whether a block begins where the one before ended, in the same kind of words."""
    same = before.move.tcp == motion.move.tcp and (before.move.vector is None) == (motion.move.vector is None)
    return same and bool(np.array_equal(before.end, motion.start))


def _plain_lines(program: Program, dialect: Dialect, path: ToolPath, names: tuple[str, ...]) -> dict[int, str]:
    """Return the lines that contain only positions, with the feed in force; none in inverse-time feed mode."""
    moving = {motion.move.line for motion in path.motions}
    plain_lines: dict[int, str] = {}
    feed: float | None = None
    timed = False
    for index, text in enumerate(program.texts):
        words = dialect.line_words(text)
        feed = feed if words.feed is None else words.feed
        timed = timed if words.unit is None else words.unit is FeedUnit.INVERSE
        if index in moving and not timed and dialect.is_motion_only(text, names):
            plain_lines[index] = str(feed)
    return plain_lines


# --- Fewer blocks for a run -----------------------------------------------------------------------

LEVER_MM: Final = 100.0
"""Distance from the tip at which the tool axis must keep the tolerance if the tool has no length."""
COMPENSATION_SHARE: Final = (0.1, 1e-3)
"""Share of the compensation between end points: fraction of the tolerance after rounding, and largest value in mm. The error
between end points falls with the square of a block's length.
"""
CURVE_SHARES: Final = (0.25, 0.5, 0.75)
"""Fractions of the path's share that a curve may use, tried in this order …"""
CONTROL_POINT_SHARE: Final = 0.5
"""… until the control points are no more than this fraction of the output blocks, and both together no more than this fraction of the
input blocks. A curve deviates from a polyline by at least half the height of its chords, and from points by their rounding; where
these are large, the curve needs more of the tolerance.
"""
PARAMETER_EXPONENTS: Final = (0.0, 0.5, 1.0)
"""Exponents of the parameter that are tried: equal steps per point, root of the distance, distance. Points taken at equal steps of a
curve's own parameter need the first (a cycloid at its cusps); irregular points need the last.
"""
TRIAL_BLOCKS: Final = 600
"""Blocks of a stretch on which the parameter is chosen."""
SEARCHED_SHARE: Final = 0.05
"""Fraction of the path's share below which a smaller distance between blocks and curve is not searched for."""
CURVE_POINTS_PER_BLOCK: Final = 16
"""Points per block at which a fitted curve is evaluated."""


@final
@dataclass(frozen=True)
class ToleranceShares:
    """Division of the tolerance, µm."""

    tolerance: float  # the whole tolerance
    # share of rounding to the least increments, of the point and of the rotary words at the lever together
    rounding: float
    compensation: float  # share of the error between block end points
    path: float  # share of the path: deviation of the curve from the input and of the blocks from the curve, together


class ToleranceUse(NamedTuple):
    """Use of the tolerance by a run's curves and blocks, the largest over its stretches."""

    share_mm: float = 0.0  # tolerance of the curve
    fit_mm: float = 0.0  # distance between curve and input at the tool, in both directions
    chord_mm: float = 0.0  # distance between blocks and curve
    path_mm: float = 0.0  # distance between blocks and input


@final
@dataclass(frozen=True)
class RefittedRun:
    """One refitted run."""

    end_points: RunEndPoints  # new end points of its blocks
    shares: ToleranceShares  # division of the tolerance
    corners: int  # number of vertices kept as corners, without the end points of the run
    pieces: tuple[CurvePiece, ...]
    tolerance_use: ToleranceUse
    why: str  # why it was left unchanged; empty if it was refitted

    @property
    def control_points(self) -> int:
        """Control points of its curves, plus one for each unchanged block."""
        unchanged = len(self.end_points.assigned) - sum(piece.blocks for piece in self.pieces)
        return sum(piece.degree for piece in self.pieces) + unchanged + 1


@final
class RunRefitter:
    """Refits runs with fewer blocks; `InputError` if rounding alone exceeds the tolerance.

    ``increment``: (axes,) of the output words; ``compensated``: whether a share of the tolerance is reserved for the compensation;
    ``posted``: whether axis words are written even for tool-tip input; ``printed``: whether every block is written anew, fitted or not.
    """

    def __init__(
        self,
        prepared: PreparedMachine,
        increment: np.ndarray,
        *,
        compensated: bool,
        posted: bool = False,
        printed: bool = False,
    ) -> None:
        self.prepared = prepared
        self.space = prepared.space
        self.increment = increment
        self.compensated = compensated
        self.posted = posted
        self.printed = printed
        length = self.space.nominal.tool_length_mm
        self.lever = length if length > 0.0 else LEVER_MM
        self.shares(False)

    def shares(self, turning: bool) -> ToleranceShares:
        """Return the division of the tolerance for runs that turn rotary axes or not; `InputError` if rounding alone exceeds it."""
        half = self.increment / 2.0
        half[3:] = np.radians(half[3:]) * self.lever if turning else 0.0
        rounding = float(np.linalg.norm(half))
        tolerance = self.prepared.options.tolerance_mm
        available = tolerance - rounding
        if available <= 0.0:
            raise InputError(
                "the tolerance does not exceed the rounding error",
                expected=f"more than {rounding:.6f} mm, half a least increment of every axis"
                + (f" (rotary axes at {self.lever:g} mm from the tip)" if turning else ""),
                value=tolerance,
                setting="tolerance",
            )
        machine = min(COMPENSATION_SHARE[0] * available, COMPENSATION_SHARE[1]) if self.compensated else 0.0
        return ToleranceShares(tolerance * 1e3, rounding * 1e3, machine * 1e3, (available - machine) * 1e3)

    def refit(self, run: Run, path: ToolPath) -> RefittedRun:
        """Return one run with fewer blocks where possible."""
        first = path.motions[run.motions[0]].move
        turning = bool(np.ptp(run.words[:, 3:], axis=0).max(initial=0.0) > 0.0)
        posted = self.posted and first.tcp
        by_vector = first.vector is not None and not posted
        shares = self.shares(turning and not by_vector)
        allowed = shares.path * 1e-3
        tool = self._tool(turning, first.tcp)
        modes = np.full(len(run.words), first.tcp)
        if np.any(self.prepared.outside(self.space.commands(run.words, modes))):
            return self._unchanged(run, shares, "outside the range of an axis")
        places = tool(run.words)
        moving = np.append(True, np.linalg.norm(np.diff(places, axis=0), axis=1) > SAME_MM)
        moving[-1] |= not moving[1:].any()
        vertices = run.words[moving]
        if len(vertices) < 3:
            return self._unchanged(run, shares, "the tool does not move")
        ids = np.cumsum(moving)[1:] - 1
        line = Polyline.of(vertices, tool)
        allowed -= _curvature_error_mm(line, tool)
        if allowed <= 0.0:
            return self._unchanged(run, shares, "the blocks deviate too far from straight lines at the tool")
        cuts = corners(line, allowed)
        words: list[np.ndarray] = []
        assigned = np.zeros(len(run.lines), dtype=int)
        changed = np.full(len(run.lines), self.printed)
        pieces: list[CurvePiece] = []
        figures = ToleranceUse()
        for number, (begin, end) in enumerate(pairwise(cuts)):
            blocks = np.flatnonzero((ids <= end) & ((ids > begin) | (number == 0)))
            found = self._stretch(vertices[begin : end + 1], tool, allowed, posted=posted) if end - begin > 2 else None
            if found is not None and self._beyond(found[0], tcp=first.tcp):
                found = None
            base = sum(map(len, words))
            if found is None:
                words.append(run.words[1:][blocks])
                assigned[blocks] = base + np.arange(len(blocks))
                continue
            words.append(found[0])
            assigned[blocks] = base + np.arange(len(blocks)) * len(found[0]) // len(blocks)
            changed[blocks] = True
            pieces += found[1]
            figures = ToleranceUse(*map(max, figures, found[2]))
        why = "" if pieces else "fewer blocks would exceed the tolerance"
        return RefittedRun(
            RunEndPoints(run, np.concatenate(words), assigned, changed),
            shares,
            len(cuts) - 2,
            tuple(pieces),
            figures,
            why,
        )

    def _beyond(self, words: np.ndarray, *, tcp: bool) -> bool:
        """Return whether words leave an axis's range or the domain of its error motions."""
        commands = self.space.commands(words, np.full(len(words), tcp))
        lower, upper = self.prepared.limits.T
        return bool(np.any((commands < lower) | (commands > upper)))

    def _unchanged(self, run: Run, shares: ToleranceShares, why: str) -> RefittedRun:
        count = len(run.lines)
        places = RunEndPoints(run, run.words[1:], np.arange(count), np.full(count, self.printed))
        return RefittedRun(places, shares, 0, (), ToleranceUse(), why)

    def _stretch(
        self, words: np.ndarray, tool: Tool, allowed: float, *, posted: bool
    ) -> tuple[np.ndarray, list[CurvePiece], ToleranceUse] | None:
        """Return end points, curve and use of the tolerance with the fewest blocks and control points; None if no blocks are saved."""
        best, least = None, np.inf
        for fraction in CURVE_SHARES:
            line, pieces = self._curve(words, tool, fraction * allowed)
            if all(piece.blocks == 1 for piece in pieces):
                continue
            curve, at = Fitter(line, tool, fraction * allowed).curve(pieces, CURVE_POINTS_PER_BLOCK)
            # Blocks are straight in the output words.
            straight, out = (
                (partial(self.space.switched, tcp=False), self._tool(True, False)) if posted else (np.asarray, tool)
            )
            found = few_blocks(replace(line, words=straight(line.words)), straight(curve), at, out, allowed)
            cost = np.inf if found is None else len(found[0]) + _cost(pieces)
            if found is None or cost >= least:
                continue
            least = cost
            dense, dense_at = between(np.concatenate([straight(words[:1]), found[0]]), found[1], CURVE_POINTS_PER_BLOCK)
            chord = largest_distance(
                out(dense), dense_at, tool(curve), at, SEARCHED_SHARE * allowed, allowed, anywhere=True
            )
            figures = ToleranceUse(fraction * allowed, max(piece.fit_mm for piece in pieces), chord, found[2])
            best = (self.space.switched(found[0], tcp=True) if posted else found[0]), pieces, figures
            if cost <= CONTROL_POINT_SHARE * (len(words) - 1) and _cost(pieces) <= CONTROL_POINT_SHARE * len(found[0]):
                break
        return best

    def _curve(self, words: np.ndarray, tool: Tool, allowed: float) -> tuple[Polyline, list[CurvePiece]]:
        """Return the curve with the fewest control points over all parameters tried."""
        powers: tuple[float, ...] = PARAMETER_EXPONENTS
        if len(words) > 2 * TRIAL_BLOCKS:
            costs = [
                _cost(Fitter(Polyline.of(words[:TRIAL_BLOCKS], tool, power), tool, allowed).pieces())
                for power in PARAMETER_EXPONENTS
            ]
            powers = (PARAMETER_EXPONENTS[int(np.argmin(costs))],)
        lines = [Polyline.of(words, tool, power) for power in powers]
        curves = [(line, Fitter(line, tool, allowed).pieces()) for line in lines]
        return min(curves, key=lambda one: _cost(one[1]))

    def _tool(self, turning: bool, tcp: bool) -> Tool:
        """Return the function from words to coordinates at the tool, mm: the point in the work frame, and rotary words at the lever."""
        if not turning:
            return lambda words: words[:, :3]  # the work frame keeps its orientation to the axes

        def place(words: np.ndarray) -> np.ndarray:
            point = words[:, :3]
            if not tcp:
                commands = self.space.commands(words, np.zeros(len(words), dtype=bool))
                point = self.space.nominal.reached(commands * self.space.machine.scale)[1] * 1e3
            return np.concatenate([point, np.radians(words[:, 3:]) * self.lever], axis=1)

        return place


def _curvature_error_mm(line: Polyline, tool: Tool) -> float:
    """Return the largest deviation in mm of blocks, between their dense points, from straight lines at the tool."""
    middle = tool((line.dense[1:] + line.dense[:-1]) / 2.0)
    return float(np.linalg.norm(middle - (line.dense_tool[1:] + line.dense_tool[:-1]) / 2.0, axis=1).max())


def _cost(pieces: list[CurvePiece]) -> int:
    return sum(piece.degree for piece in pieces)
