"""Fewer blocks for a run: a curve from corner to corner, cut into blocks, within the path's share of the tolerance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Final, NamedTuple, final

import numpy as np

from twin._common.errors import InputError
from twin.compensation.fewer_blocks.emit import RunEndPoints
from twin.compensation.fewer_blocks.fit import CurvePiece, Fitter, Polyline, Tool, between, few_blocks, largest_distance
from twin.compensation.fewer_blocks.report import ToleranceShares
from twin.compensation.fewer_blocks.runs import SAME_MM, Run, corners
from twin.compensation.programs.motions import ToolPath
from twin.compensation.programs.prepared import PreparedMachine

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
POINTS_PER_BLOCK: Final = 16
"""Points per block at which a fitted curve is evaluated."""


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
    """Refits runs with fewer blocks.

    ``increment``: (axes,) least increments of the output words; ``compensated``: whether a share of the tolerance is reserved for the
    compensation between end points; ``posted``: whether axis words are written even for tool-tip input; ``printed``: whether every
    block is written anew, fitted or not. Raises `InputError`: rounding alone exceeds the tolerance.
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
        """Return the division of the tolerance; ``turning``: for runs that turn rotary axes.

        Raises `InputError`: rounding alone exceeds the tolerance.
        """
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
        turning = _turns(run)
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
        """Return the block end points, curve and use of the tolerance with the fewest blocks and control points.

        None if no blocks are saved.
        """
        best, least = None, np.inf
        for fraction in CURVE_SHARES:
            line, pieces = self._curve(words, tool, fraction * allowed)
            if all(piece.blocks == 1 for piece in pieces):
                continue
            curve, at = Fitter(line, tool, fraction * allowed).curve(pieces, POINTS_PER_BLOCK)
            # Blocks are straight in the output words.
            straight, out = (
                (partial(self.space.switched, tcp=False), self._tool(True, False)) if posted else (_same, tool)
            )
            found = few_blocks(replace(line, words=straight(line.words)), straight(curve), at, out, allowed)
            cost = np.inf if found is None else len(found[0]) + _cost(pieces)
            if found is None or cost >= least:
                continue
            least = cost
            dense, dense_at = between(np.concatenate([straight(words[:1]), found[0]]), found[1], POINTS_PER_BLOCK)
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


def _same(words: np.ndarray) -> np.ndarray:
    return words


def _cost(pieces: list[CurvePiece]) -> int:
    return sum(piece.degree for piece in pieces)


def _turns(run: Run) -> bool:
    return bool(np.ptp(run.words[:, 3:], axis=0).max(initial=0.0) > 0.0)
