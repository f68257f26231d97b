"""Choice of the number of functions of each curve, by the prediction error on rounds and positions that were held out.

Near one estimate with as many functions as the positions allow, the problem is linear, and a truncated curve is that estimate
conditional on zero values of the truncated coefficients. So one factorisation for each fold serves all candidates: truncation is
conditioning. The search starts at the best number that is the same for all curves and then tries every number for one curve after the
other, until no curve changes.

A fold leaves out one round and some interior positions together: rounds alone repeat the same positions, and a curve that oscillates
between them would not be detected (thesis: degree 8 on 11 points).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
import scipy

from twin._common.arrays import read_only
from twin._common.threads import map_chunks
from twin.identification.network import Network
from twin.identification.robust import RobustStart
from twin.identification.solve import FitSolution
from twin.identification.unknowns import Unknowns
from twin.measurement.table import Measurements
from twin.numerics.curves import CurveSpace

POSE_FOLDS: Final = 5
ROUND_FOLDS: Final = 8
SWEEPS: Final = 6
ROUNDING: Final = 2e-15
"""Held-out chi² per reading that is rounding: of models that predict equally well the smallest is taken, so that noise-free data do not
give functions that do not exist.
"""


@final
@dataclass(frozen=True)
class Folds:
    """Groups of points that are held out together.

    Attributes:
        round_of: (n,) group of rounds.
        pose_of: (n,) group of positions; −1 for those never held out (end points of an axis's travel).
        rounds, poses: number of groups.
    """

    round_of: np.ndarray
    pose_of: np.ndarray
    rounds: int
    poses: int

    @classmethod
    def of(cls, data: Measurements) -> Folds:
        """Return the folds of a table's rounds and positions."""
        names = list(dict.fromkeys(data.round))
        rounds = min(len(names), ROUND_FOLDS)
        round_of = np.array([names.index(name) % rounds for name in data.round])
        poses, pose = np.unique(np.round(data.positions, 3), axis=0, return_inverse=True)
        pose = pose.reshape(-1)
        interior = ~_ends(poses)
        group = np.full(len(poses), -1)
        inside = np.flatnonzero(interior)
        count = min(POSE_FOLDS, len(inside))
        group[inside] = np.arange(len(inside)) % max(count, 1)
        return cls(read_only(round_of), read_only(group[pose]), rounds, count if count > 1 else 0)

    def held_out(self) -> list[np.ndarray]:
        """Return (rounds, poses + 1) masks of cells, one for each fold; the last column contains positions that are never held out."""
        count = max(self.rounds if self.rounds > 1 else 0, self.poses)
        masks = []
        for fold in range(count):
            mask = np.zeros((self.rounds, self.poses + 1), dtype=bool)
            if self.rounds > 1:
                mask[fold % self.rounds] = True
            if self.poses:
                mask[:, fold % self.poses] = True
            masks.append(mask)
        return masks


@final
@dataclass(frozen=True)
class Choice:
    """Number of functions of each curve, and prediction errors of the alternatives.

    Attributes:
        counts: number of functions by curve, those excluded by the datum counted; 0 for a curve left out.
        held_out: RMS of the whitened residuals held out; whitened by noise and discrepancy.
        by_curve: for every curve, held-out RMS by number of functions, the others as chosen.
        uniform: held-out RMS with the same number for all curves, by that number.
        readings: number of readings held out, all folds together.
    """

    counts: Mapping[str, int]
    held_out: float
    by_curve: Mapping[str, Mapping[int, float]]
    uniform: Mapping[int, float]
    readings: int


def choose(network: Network, start: RobustStart, whole: Sequence[str] = ()) -> Choice:
    """Return the model that predicts held-out readings best.

    Args:
        network: data and the largest model, with the weights of the comparison.
        start: a robust estimate of it.
        whole: curves that keep all their functions.
    """
    folds = Folds.of(network.data)
    normal, count = _cells(network, start.solution, start.weight, folds)
    search = _Search(network.unknowns, _folds(network, start.solution, normal, folds), whole)
    readings = max(int(sum(count[mask].sum() for mask in folds.held_out())), 1)
    uniform = search.uniform()
    best = min(uniform, key=lambda size: uniform[size][0], default=0)
    sizes = dict(uniform[best][1]) if uniform else {}
    by_curve: dict[str, dict[int, float]] = {}
    for _ in range(SWEEPS):
        before = dict(sizes)
        for name in search.curves:
            if name in whole:
                continue
            found = search.scores_of(name, sizes)
            limit = min(found.values()) * (1.0 + 1e-6) + ROUNDING * readings
            sizes[name] = min(size for size, value in found.items() if value <= limit)
            by_curve[name] = found
        if sizes == before:
            break

    def rms(total: float) -> float:
        return float(np.sqrt(max(total, 0.0) / readings))

    return Choice(
        counts=sizes,
        held_out=rms(search.score(sizes)),
        by_curve={name: {n: rms(v) for n, v in sorted(found.items())} for name, found in by_curve.items()},
        uniform={size: rms(score) for size, (score, _) in uniform.items()},
        readings=readings,
    )


@final
class _Search:
    """Held-out chi² of truncated curves.

    Args:
        unknowns: unknowns of the largest model.
        folds: its estimates without the readings that each holds out.
        whole: curves that keep all their functions.
    """

    def __init__(self, unknowns: Unknowns, folds: Sequence[_Fold], whole: Sequence[str]) -> None:
        self.curves = {c.name: c for c in unknowns.curves}
        self._columns = {name: unknowns.of(name) for name in self.curves}
        self._folds, self._whole = folds, whole

    def score(self, sizes: Mapping[str, int]) -> float:
        """Return the held-out chi² with a number of functions for each curve."""
        return sum(fold.score(fold.conditional(self._removed_columns(sizes), [])[0]) for fold in self._folds)

    def uniform(self) -> dict[int, tuple[float, dict[str, int]]]:
        """Return the held-out chi² by number of functions, the same for all curves that have it, and the number of each curve."""
        found = {}
        for size in range(1, max((c.count for c in self.curves.values()), default=0) + 1):
            fitted = {
                name: c.count if name in self._whole else max(n for n in _sizes(c) if n <= size)
                for name, c in self.curves.items()
            }
            found[size] = (self.score(fitted), fitted)
        return found

    def scores_of(self, name: str, sizes: Mapping[str, int]) -> dict[int, float]:
        """Return the held-out chi² by number of functions of one curve, the others as given."""
        curve, own = self.curves[name], self._columns[name]
        found = dict.fromkeys(_sizes(curve), 0.0)
        others = self._removed_columns({one: size for one, size in sizes.items() if one != name})
        for fold in self._folds:
            theta, covariance = fold.conditional(others, own)
            found[curve.count] += fold.score(theta)
            for group in reversed(curve.groups()):
                for k in reversed(group):
                    theta, covariance = _with_zero(theta, covariance, own, k - curve.first)
                found[_below(curve, group)] += fold.score(theta)
        return found

    def _removed_columns(self, sizes: Mapping[str, int]) -> list[int]:
        """Return the columns that are zero, curve by curve."""
        return [
            i
            for name, curve in self.curves.items()
            if name in sizes
            for i in self._columns[name][max(sizes[name] - curve.first, 0) :]
        ]


def _sizes(curve: CurveSpace) -> list[int]:
    """Return the numbers of functions that a curve can have, 0 first."""
    return [0, *(group[-1] + 1 for group in curve.groups())]


def _below(curve: CurveSpace, group: tuple[int, ...]) -> int:
    """Return the number of functions that remain without a group and all above it."""
    sizes = _sizes(curve)
    return sizes[sizes.index(group[-1] + 1) - 1]


@final
@dataclass(frozen=True)
class _Fold:
    """An estimate without the held-out readings, and its prediction of them; scaled by the priors.

    Attributes:
        theta: (p,) unknowns, the set-up's as differences from the full estimate.
        covariance: (p, p) of it.
        held: (p + 1, p + 1) normal matrix of the held-out readings, linearised at ``origin``.
        origin: (p,) the full estimate.
    """

    theta: np.ndarray
    covariance: np.ndarray
    held: np.ndarray
    origin: np.ndarray

    def score(self, theta: np.ndarray) -> float:
        """Return chi² of the held-out readings."""
        step = np.append(theta - self.origin, -1.0)
        return float(step @ self.held @ step)

    def conditional(self, removed: list[int], kept: list[int]) -> tuple[np.ndarray, np.ndarray]:
        """Return the estimate conditional on zero values of some unknowns, and (p, kept) its covariance with others."""
        if not removed:
            return self.theta.copy(), self.covariance[:, kept].copy()
        # Pivoted, because unknowns that the datum or another condition fixes have no variance.
        lower, pivot, rank, _ = scipy.linalg.lapack.dpstrf(
            self.covariance[np.ix_(removed, removed)], tol=1e-15, lower=1
        )
        rows = [removed[i - 1] for i in pivot[:rank]]
        right = np.concatenate([self.theta[rows, None], self.covariance[np.ix_(rows, kept)]], axis=1)
        solved = scipy.linalg.cho_solve((lower[:rank, :rank], True), right)
        cross = self.covariance[:, rows]
        theta = self.theta - cross @ solved[:, 0]
        theta[removed] = 0.0
        return theta, self.covariance[:, kept] - cross @ solved[:, 1:]


def _with_zero(theta: np.ndarray, covariance: np.ndarray, own: list[int], k: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the estimate conditional on a zero value of one more of a curve's unknowns."""
    variance = covariance[own[k], k]
    if variance > 1e-20:
        gain = covariance[:, k] / variance
        theta = theta - gain * theta[own[k]]
        covariance = covariance - np.outer(gain, covariance[own[k]])
    theta[own[k]] = 0.0
    return theta, covariance


def _ends(poses: np.ndarray) -> np.ndarray:
    """Return (poses,) whether a position is the first or last of a line along an axis, beyond which a curve would be extrapolated."""
    found = np.zeros(len(poses), dtype=bool)
    for axis in range(poses.shape[1]):
        _, line, size = np.unique(np.delete(poses, axis, axis=1), axis=0, return_inverse=True, return_counts=True)
        line = line.reshape(-1)
        for k in np.flatnonzero(size >= 3):
            on = np.flatnonzero(line == k)
            found[on[[np.argmin(poses[on, axis]), np.argmax(poses[on, axis])]]] = True
    return found


def _cells(network: Network, solution: FitSolution, weight: np.ndarray, folds: Folds) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal matrices of [J | r] by group of rounds and of positions, and the number of readings in each."""
    size = len(solution.spectrum.scale) + 1
    pose = np.where((folds.pose_of < 0) | (folds.poses == 0), folds.poses, folds.pose_of)
    cell_of = folds.round_of * (folds.poses + 1) + pose
    cells = folds.rounds * (folds.poses + 1)
    scale = np.append(solution.spectrum.scale, 1.0)

    def summed(chunks: Sequence[np.ndarray]) -> np.ndarray:
        normal = np.zeros((cells, size, size))
        for rows_of_chunk in chunks:
            piece = network.chunk(solution.theta, solution.setup, rows_of_chunk)
            both = piece.columns
            both *= scale[:, None, None]
            both *= np.sqrt(weight[piece.rows])[:, None]
            of = cell_of[piece.rows]
            for cell in np.unique(of):
                rows = both[:, of == cell].reshape(size, -1)
                normal[cell] += rows @ rows.T
        return normal

    normal = np.sum(map_chunks(network.row_chunks, summed), axis=0)
    normal = normal.reshape(folds.rounds, folds.poses + 1, size, size)
    count = np.bincount(cell_of, np.sum(network.read * (weight > 0.0)[:, None], axis=1), minlength=cells)
    return normal, count.reshape(folds.rounds, folds.poses + 1)


def _folds(network: Network, solution: FitSolution, normal: np.ndarray, folds: Folds) -> list[_Fold]:
    free = solution.free
    origin = np.concatenate([solution.theta / network.unknowns.plausible, np.zeros(len(solution.setup))])
    total = normal.sum(axis=(0, 1))
    found = []
    for mask in folds.held_out():
        held = normal[mask].sum(axis=0)
        train = total - held
        inner = free.T @ train[:-1, :-1] @ free
        # The prior affects only what the remaining data do not determine.
        inverse = np.linalg.inv(inner + np.eye(len(inner)))
        covariance = free @ inverse @ free.T
        theta = origin + covariance @ train[:-1, -1]
        found.append(_Fold(theta, covariance, held, origin))
    return found
