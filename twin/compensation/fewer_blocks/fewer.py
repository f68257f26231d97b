"""Fewer blocks for a run: a curve from corner to corner, and blocks along it, within what the tolerance leaves for the path."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Final, NamedTuple, final

import numpy as np

from twin._common.errors import InputError
from twin.compensation.bench import Bench
from twin.compensation.fewer_blocks.chords import between, few_blocks
from twin.compensation.fewer_blocks.distance import apart
from twin.compensation.fewer_blocks.emit import Places
from twin.compensation.fewer_blocks.fit import CurvePiece, Fitter, Polyline, Tool
from twin.compensation.fewer_blocks.report import Shares
from twin.compensation.fewer_blocks.runs import SAME_MM, Run, corners
from twin.compensation.toolpath import Path

LEVER_MM: Final = 100.0
"""Where a tool has no length: how far from the tip the tool axis is held to the tolerance."""
COMPENSATION: Final = (0.1, 1e-3)
"""The machine's share between ends: of what rounding leaves, and mm at most. It falls with the square of a block's length."""
FIT: Final = (0.25, 0.5, 0.75)
"""What a curve may have of the path's share, tried in this order …"""
ENOUGH: Final = 0.5
"""… until there are no more control points than this share of the blocks that come out, and of the two together than this share of the
blocks there were. A curve must leave a polyline by half the height of its chords, and points by what they were rounded to: where that
is much, a curve needs more of the tolerance."""
POWERS: Final = (0.0, 0.5, 1.0)
"""Parameters tried: as the points come, as the root of the way between them, as the way. Points cut at equal steps of a curve's own
parameter give it back (the cycloid at its cusps); points cut anyhow need the way."""
TRIAL: Final = 600
"""Blocks of a stretch on which the parameter is chosen."""
NEAR: Final = 0.05
"""Share of the path's share below which it does not matter where blocks and curve are still closer."""
STEPS: Final = 16
"""Places a block at which a fitted curve is looked at."""


class Figures(NamedTuple):
    """What a run's curves and blocks took of the tolerance, the largest of its stretches.

    Attributes:
        share_mm: what the curve was allowed.
        fit_mm: how far curve and input are apart, both ways, at the tool.
        chord_mm: how far blocks and curve are.
        path_mm: how far blocks and input are.
    """

    share_mm: float = 0.0
    fit_mm: float = 0.0
    chord_mm: float = 0.0
    path_mm: float = 0.0


@final
@dataclass(frozen=True)
class Fitted:
    """What became of one run.

    Attributes:
        places: where its blocks end now.
        shares: of the tolerance.
        corners: how many of its vertices stayed corners, its ends not counted.
        pieces: its curves.
        figures: what they took.
        why: why it was left as it is; empty where it was not.
    """

    places: Places
    shares: Shares
    corners: int
    pieces: tuple[CurvePiece, ...]
    figures: Figures
    why: str

    @property
    def control_points(self) -> int:
        """Of its curves, and one a block left as it is."""
        standing = len(self.places.given) - sum(piece.blocks for piece in self.pieces)
        return sum(piece.degree for piece in self.pieces) + standing + 1


@final
class Fewer:
    """Makes fewer blocks of runs.

    Args:
        bench: the machine, set up; its options have the whole tolerance.
        increment: (axes,) least increments of the words that come out.
        compensated: whether the machine's share of the tolerance is kept free.
        posted: whether axis words come out whatever went in.
        printed: whether every block is to be written anew, fitted or not.

    Raises:
        InputError: a tolerance that rounding alone uses up.
    """

    def __init__(
        self, bench: Bench, increment: np.ndarray, *, compensated: bool, posted: bool = False, printed: bool = False
    ) -> None:
        self.bench = bench
        self.space = bench.space
        self.increment = increment
        self.compensated = compensated
        self.posted = posted
        self.printed = printed
        length = self.space.nominal.tool_length_mm
        self.lever = length if length > 0.0 else LEVER_MM
        self.shares(False)

    def shares(self, turning: bool) -> Shares:
        """The tolerance shared out, for runs that turn rotary axes or do not.

        Raises:
            InputError: rounding alone uses it up.
        """
        half = self.increment / 2.0
        half[3:] = np.radians(half[3:]) * self.lever if turning else 0.0
        rounding = float(np.linalg.norm(half))
        tolerance = self.bench.options.tolerance_mm
        left = tolerance - rounding
        if left <= 0.0:
            raise InputError(
                "--tolerance is no more than rounding takes",
                expected=f"more than {rounding:.6f} mm: half a least increment of every axis"
                + (f", rotary ones {self.lever:g} mm from the tip" if turning else ""),
                value=tolerance,
            )
        machine = min(COMPENSATION[0] * left, COMPENSATION[1]) if self.compensated else 0.0
        return Shares(tolerance * 1e3, rounding * 1e3, machine * 1e3, (left - machine) * 1e3)

    def of(self, run: Run, path: Path) -> Fitted:
        """Fewer blocks for one run, where there are any."""
        first = path.motions[run.motions[0]].move
        turning = _turns(run)
        posted = self.posted and first.tcp
        by_vector = first.vector is not None and not posted
        shares = self.shares(turning and not by_vector)
        allowed = shares.path * 1e-3
        tool = self._tool(turning, first.tcp)
        modes = np.full(len(run.words), first.tcp)
        if np.any(self.bench.outside(self.space.commands(run.words, modes))):
            return self._as_it_is(run, shares, "it leaves the range of an axis")
        places = tool(run.words)
        moving = np.append(True, np.linalg.norm(np.diff(places, axis=0), axis=1) > SAME_MM)
        moving[-1] |= not moving[1:].any()
        vertices = run.words[moving]
        if len(vertices) < 3:
            return self._as_it_is(run, shares, "it does not move the tool")
        ids = np.cumsum(moving)[1:] - 1
        line = Polyline.of(vertices, tool)
        allowed -= _coarseness(line, tool)
        if allowed <= 0.0:
            return self._as_it_is(run, shares, "its blocks are too far from straight at the tool")
        cuts = corners(line, allowed)
        words: list[np.ndarray] = []
        given = np.zeros(len(run.lines), dtype=int)
        changed = np.full(len(run.lines), self.printed)
        pieces: list[CurvePiece] = []
        figures = Figures()
        for number, (begin, end) in enumerate(pairwise(cuts)):
            blocks = np.flatnonzero((ids <= end) & ((ids > begin) | (number == 0)))
            found = self._stretch(vertices[begin : end + 1], tool, allowed, posted=posted) if end - begin > 2 else None
            if found is not None and self._beyond(found[0], tcp=first.tcp):
                found = None
            base = sum(map(len, words))
            if found is None:
                words.append(run.words[1:][blocks])
                given[blocks] = base + np.arange(len(blocks))
                continue
            words.append(found[0])
            given[blocks] = base + np.arange(len(blocks)) * len(found[0]) // len(blocks)
            changed[blocks] = True
            pieces += found[1]
            figures = Figures(*map(max, figures, found[2]))
        why = "" if pieces else "no fewer blocks keep to the tolerance"
        return Fitted(
            Places(run, np.concatenate(words), given, changed),
            shares,
            len(cuts) - 2,
            tuple(pieces),
            figures,
            why,
        )

    def _beyond(self, words: np.ndarray, *, tcp: bool) -> bool:
        """Whether words lead beyond an axis's range or the domain of its error motions."""
        commands = self.space.commands(words, np.full(len(words), tcp))
        lower, upper = self.bench.limits.T
        return bool(np.any((commands < lower) | (commands > upper)))

    def _as_it_is(self, run: Run, shares: Shares, why: str) -> Fitted:
        count = len(run.lines)
        places = Places(run, run.words[1:], np.arange(count), np.full(count, self.printed))
        return Fitted(places, shares, 0, (), Figures(), why)

    def _stretch(
        self, words: np.ndarray, tool: Tool, allowed: float, *, posted: bool
    ) -> tuple[np.ndarray, list[CurvePiece], Figures] | None:
        """The fewest blocks and control points found for a stretch without corners: the blocks' ends, the curve, what they take."""
        best, least = None, np.inf
        for part in FIT:
            line, pieces = self._curve(words, tool, part * allowed)
            if all(piece.blocks == 1 for piece in pieces):
                continue
            curve, at = Fitter(line, tool, part * allowed).curve(pieces, STEPS)
            # Blocks are straight in the words that come out.
            straight, out = (
                (partial(self.space.switched, tcp=False), self._tool(True, False)) if posted else (_same, tool)
            )
            found = few_blocks(replace(line, words=straight(line.words)), straight(curve), at, out, allowed)
            cost = np.inf if found is None else len(found[0]) + _cost(pieces)
            if found is None or cost >= least:
                continue
            least = cost
            dense, dense_at = between(np.concatenate([straight(words[:1]), found[0]]), found[1], STEPS)
            chord = apart(out(dense), dense_at, tool(curve), at, NEAR * allowed, allowed, anywhere=True)
            figures = Figures(part * allowed, max(piece.fit_mm for piece in pieces), chord, found[2])
            best = (self.space.switched(found[0], tcp=True) if posted else found[0]), pieces, figures
            if cost <= ENOUGH * (len(words) - 1) and _cost(pieces) <= ENOUGH * len(found[0]):
                break
        return best

    def _curve(self, words: np.ndarray, tool: Tool, allowed: float) -> tuple[Polyline, list[CurvePiece]]:
        """The curve with the fewest control points, over the parameters."""
        powers: tuple[float, ...] = POWERS
        if len(words) > 2 * TRIAL:
            costs = [_cost(Fitter(Polyline.of(words[:TRIAL], tool, power), tool, allowed).pieces()) for power in POWERS]
            powers = (POWERS[int(np.argmin(costs))],)
        lines = [Polyline.of(words, tool, power) for power in powers]
        found = [(line, Fitter(line, tool, allowed).pieces()) for line in lines]
        return min(found, key=lambda one: _cost(one[1]))

    def _tool(self, turning: bool, tcp: bool) -> Tool:
        """Words to places at the tool, mm: the point in the work frame, and the rotary words at the lever."""
        if not turning:
            return lambda words: words[:, :3]  # the work frame stands to the axes as it is

        def place(words: np.ndarray) -> np.ndarray:
            point = words[:, :3]
            if not tcp:
                commands = self.space.commands(words, np.zeros(len(words), dtype=bool))
                point = self.space.nominal.reached(commands * self.space.machine.scale)[1] * 1e3
            return np.concatenate([point, np.radians(words[:, 3:]) * self.lever], axis=1)

        return place


def _coarseness(line: Polyline, tool: Tool) -> float:
    """How far a line is from the polyline of the places it is looked at, mm: nothing where its blocks are straight at the tool."""
    middle = tool((line.dense[1:] + line.dense[:-1]) / 2.0)
    return float(np.linalg.norm(middle - (line.dense_tool[1:] + line.dense_tool[:-1]) / 2.0, axis=1).max())


def _same(words: np.ndarray) -> np.ndarray:
    return words


def _cost(pieces: list[CurvePiece]) -> int:
    return sum(piece.degree for piece in pieces)


def _turns(run: Run) -> bool:
    return bool(np.ptp(run.words[:, 3:], axis=0).max(initial=0.0) > 0.0)
