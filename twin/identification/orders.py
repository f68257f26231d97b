"""Choice of the number of functions of each curve, by the prediction error on rounds and positions that were held out.

Near one estimate with as many functions as the positions allow, the problem is linear, and a truncated curve is the least-squares
estimate without the truncated coefficients. One Cholesky factor of the normal matrix, with the columns of a curve last, serves all its
truncations: each is a leading block. The set-up is eliminated before, by orthogonal transformations of the readings: it is determined
10⁸ times better than its prior, so that in normal equations, whose condition is the square of that, rounding errors would decide
between models that predict equally well. The search starts at the best number that is the same for all curves and then tries every
number for one curve after the other, until no curve changes.

A fold leaves out one round and some interior positions together: rounds alone repeat the same positions, and a curve that oscillates
between them would not be detected (thesis: degree 8 on 11 points).

Residuals at held-out poses, in micrometres: how far off the written calibration is where nothing was measured.

Every fold leaves out some of the poses with all their readings. Near the estimate the problem is linear, so that the estimate without
a fold follows from the normal equations (leave-group-out residuals; Cook and Weisberg 1982, section 2.2). Outliers, priors and weights
are those of the whole estimate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
import scipy

from twin._common.arrays import read_only
from twin._common.resources import map_chunks
from twin.identification.fitting import RobustStart
from twin.identification.network import Network, Unknowns
from twin.identification.solve import FitSolution
from twin.measurement.table import Measurements
from twin.numerics.curves import CurveSpace
from twin.numerics.observability import SINGULAR_VALUE_TOLERANCE

POSE_FOLDS: Final = 5
ROUND_FOLDS: Final = 8
SWEEPS: Final = 6
WAITING: Final = 2
"""Rows that are collected before they are reduced to a triangle, in triangles."""
DEPENDENT: Final = 1e-9
"""Relative singular value below which the datum's conditions on a truncated model depend on each other."""
ROUNDING: Final = 2e-15
"""Held-out chi² per reading that is rounding: of models that predict equally well the smallest is taken, so that noise-free data do not
give functions that do not exist.
"""


@final
@dataclass(frozen=True)
class Folds:
    """Groups of points that are held out together.

    ``round_of``: (n,) group of rounds; ``pose_of``: (n,) group of positions; −1 for those never held out (end points of an axis's
    travel).
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

    ``network``: data and the largest model, with the weights of the comparison.
    """
    folds = Folds.of(network.data)
    triangles, count = _cells(network, start.solution, start.weight, folds)
    search = _Search(network.unknowns, _folds(network, start.solution, triangles, folds), whole)
    readings = max(int(sum(count[mask].sum() for mask in folds.held_out())), 1)
    uniform = search.uniform()
    least = min((score for score, _ in uniform.values()), default=0.0)
    best = next((size for size, (score, _) in uniform.items() if score <= _equal(least, readings)), 0)
    sizes = dict(uniform[best][1]) if uniform else {}
    by_curve: dict[str, dict[int, float]] = {}
    for _ in range(SWEEPS):
        before = dict(sizes)
        for name in search.curves:
            if name in whole:
                continue
            scores = search.scores_of(name, sizes)
            limit = _equal(min(scores.values()), readings)
            sizes[name] = min(size for size, value in scores.items() if value <= limit)
            by_curve[name] = scores
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


def _equal(least: float, readings: int) -> float:
    """Return the largest held-out chi² that counts as equal to the least."""
    return least * (1.0 + 1e-6) + ROUNDING * readings


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
        self._count = len(folds[0].slope) if folds else 0

    def score(self, sizes: Mapping[str, int]) -> float:
        """Return the held-out chi² with a number of functions for each curve."""
        kept = self._kept_columns(sizes)
        return sum(fold.score(theta) for fold in self._folds for theta in fold.truncated(kept, [len(kept)]))

    def uniform(self) -> dict[int, tuple[float, dict[str, int]]]:
        """Return the held-out chi² by number of functions, the same for all curves that have it, and the number of each curve."""
        uniform = {}
        for size in range(1, max((c.count for c in self.curves.values()), default=0) + 1):
            fitted = {
                name: c.count if name in self._whole else max(n for n in _sizes(c) if n <= size)
                for name, c in self.curves.items()
            }
            uniform[size] = (self.score(fitted), fitted)
        return uniform

    def scores_of(self, name: str, sizes: Mapping[str, int]) -> dict[int, float]:
        """Return the held-out chi² by number of functions of one curve, the others as given."""
        curve, own = self.curves[name], self._columns[name]
        fewest, *more = sizes_of_curve = _sizes(curve)
        kept = self._kept_columns({**sizes, name: fewest})
        widths = [len(kept), *(len(kept) + size - curve.first for size in more)]
        scores = dict.fromkeys(sizes_of_curve, 0.0)
        for fold in self._folds:
            for size, theta in zip(sizes_of_curve, fold.truncated([*kept, *own], widths), strict=True):
                scores[size] += fold.score(theta)
        return scores

    def _kept_columns(self, sizes: Mapping[str, int]) -> list[int]:
        """Return the columns that are not zero."""
        removed = {
            i
            for name, curve in self.curves.items()
            if name in sizes
            for i in self._columns[name][max(sizes[name] - curve.first, 0) :]
        }
        return [i for i in range(self._count) if i not in removed]


def _sizes(curve: CurveSpace) -> list[int]:
    """Return the numbers of functions that a curve can have, 0 first."""
    return [0, *(group[-1] + 1 for group in curve.groups())]


@final
@dataclass(frozen=True)
class _Fold:
    """Normal equations without the held-out readings, the set-up eliminated, and the prediction of these; scaled by the priors.

    Attributes:
        normal: (m, m) normal matrix of the machine's unknowns, the prior included.
        slope: (m,) its right-hand side.
        datum: (k, m) conditions that these unknowns fulfil.
        setup: (s,) change of the set-up from the full estimate where the machine's unknowns do not change.
        by_machine: (s, m) its change with these.
        held: (m + s + 1, m + s + 1) triangular factor of the held-out readings, linearised at the full estimate.
        origin: (m,) the full estimate.
    """

    normal: np.ndarray
    slope: np.ndarray
    datum: np.ndarray
    setup: np.ndarray
    by_machine: np.ndarray
    held: np.ndarray
    origin: np.ndarray

    def score(self, theta: np.ndarray) -> float:
        """Return chi² of the held-out readings for given (m,) unknowns of the machine."""
        moved = theta - self.origin
        step = np.concatenate([moved, self.setup + self.by_machine @ moved, [-1.0]])
        return float(np.sum((self.held @ step) ** 2))

    def truncated(self, columns: list[int], widths: Sequence[int]) -> list[np.ndarray]:
        """Return the estimates (m,) with only the first few of some columns, all other unknowns being zero.

        ``columns``: columns, in the order in which they are added.
        """
        lower = scipy.linalg.cholesky(self.normal[np.ix_(columns, columns)], lower=True, check_finite=False)
        right = np.concatenate([self.slope[columns, None], self.datum[:, columns].T], axis=1)
        solved = scipy.linalg.solve_triangular(lower, right, lower=True, check_finite=False)
        truncated = []
        for width in widths:
            # The rows before a width belong to that width's own factor; the datum's conditions are projected out.
            free, conditions = solved[:width, 0], solved[:width, 1:]
            if conditions.size:
                free = free - conditions @ np.linalg.lstsq(conditions, free, rcond=DEPENDENT)[0]
            theta = np.zeros(len(self.slope))
            theta[columns[:width]] = scipy.linalg.solve_triangular(
                lower[:width, :width], free, lower=True, trans="T", check_finite=False
            )
            truncated.append(theta)
        return truncated


def _ends(poses: np.ndarray) -> np.ndarray:
    """Return (poses,) whether a position is the first or last of a line along an axis, beyond which a curve would be extrapolated."""
    ends = np.zeros(len(poses), dtype=bool)
    for axis in range(poses.shape[1]):
        _, line, size = np.unique(np.delete(poses, axis, axis=1), axis=0, return_inverse=True, return_counts=True)
        line = line.reshape(-1)
        for k in np.flatnonzero(size >= 3):
            on = np.flatnonzero(line == k)
            ends[on[[np.argmin(poses[on, axis]), np.argmax(poses[on, axis])]]] = True
    return ends


def _cells(network: Network, solution: FitSolution, weight: np.ndarray, folds: Folds) -> tuple[np.ndarray, np.ndarray]:
    """Return triangular factors of [J | r] by group of rounds and of positions, and the number of readings in each."""
    size = len(solution.spectrum.scale) + 1
    pose = np.where((folds.pose_of < 0) | (folds.poses == 0), folds.poses, folds.pose_of)
    cell_of = folds.round_of * (folds.poses + 1) + pose
    cells = folds.rounds * (folds.poses + 1)
    scale = np.append(solution.spectrum.scale, 1.0)

    def factors(chunks: Sequence[np.ndarray]) -> np.ndarray:
        found = np.zeros((cells, size, size))
        waiting: list[list[np.ndarray]] = [[] for _ in range(cells)]
        for rows_of_chunk in chunks:
            piece = network.chunk(solution.theta, solution.setup, rows_of_chunk)
            both = piece.columns
            both *= scale[:, None, None]
            both *= np.sqrt(weight[piece.rows])[:, None]
            of = cell_of[piece.rows]
            for cell in np.unique(of):
                waiting[cell].append(both[:, of == cell].reshape(size, -1).T)
                if sum(map(len, waiting[cell])) > WAITING * size:
                    found[cell] = _factor([found[cell], *waiting[cell]])
                    waiting[cell] = []
        for cell in range(cells):
            if waiting[cell]:
                found[cell] = _factor([found[cell], *waiting[cell]])
        return found

    parts = map_chunks(network.row_chunks, factors)
    found = parts[0] if len(parts) == 1 else np.stack([_factor([part[k] for part in parts]) for k in range(cells)])
    count = np.bincount(cell_of, np.sum(network.read * (weight > 0.0)[:, None], axis=1), minlength=cells)
    shape = (folds.rounds, folds.poses + 1)
    return found.reshape(*shape, size, size), count.reshape(shape)


def _factor(rows: Sequence[np.ndarray]) -> np.ndarray:
    """Return the (p, p) triangular factor of at least p rows (…, p), one array below the other."""
    return np.asarray(np.linalg.qr(np.concatenate(rows), mode="r"))


def _folds(network: Network, solution: FitSolution, triangles: np.ndarray, folds: Folds) -> list[_Fold]:
    machine, count = len(network.unknowns), len(solution.spectrum.scale)
    free = solution.free[:machine]
    # The conditions are the directions of the machine's unknowns that are not free.
    datum = scipy.linalg.null_space(free.T, rcond=DEPENDENT).T
    datum[np.abs(datum) < DEPENDENT] = 0.0  # rounding would be a condition on a model without its curves
    origin = solution.theta / network.unknowns.plausible
    setup_first = [*range(machine, count), *range(machine), count]
    # What certificates state is known, whichever readings are held out.
    certified = network.certified(solution.setup) * np.append(solution.spectrum.scale, 1.0)
    found = []
    for mask in folds.held_out():
        held, rest_of_data = _factor(list(triangles[mask])), triangles[~mask]
        # The prior affects only what the remaining data do not determine: that falls back to its prior mean, and keeps nothing that
        # the estimate took from the readings held out.
        known = [*rest_of_data, certified]
        _, strength, directions = np.linalg.svd(
            _factor(known)[:, :-1] if len(rest_of_data) or len(certified) else np.zeros((count, count))
        )
        unseen = directions[np.append(strength, np.zeros(count - len(strength))) <= SINGULAR_VALUE_TOLERANCE]
        prior = np.column_stack([np.eye(count), -unseen.T @ (unseen @ solution.deviation)])
        train = _factor([prior[:, setup_first], *(rows[:, setup_first] for rows in known)])
        rest = count - machine
        left, own = train[:rest], train[rest:count, rest:]
        inverse = scipy.linalg.solve_triangular(left[:, :rest], left[:, rest:], check_finite=False)
        normal = own[:, :-1].T @ own[:, :-1]
        slope = own[:, :-1].T @ own[:, -1] + normal @ origin
        found.append(_Fold(normal, slope, datum, inverse[:, -1], -inverse[:, :-1], held, origin))
    return found


# --- Residuals at held-out poses, in micrometres: how far off the written calibration is where nothing was measured

FOLDS: Final = 5
"""Number of folds: every fifth pose is left out together."""


@final
@dataclass(frozen=True)
class HeldOutResiduals:
    """Residuals at held-out poses.

    ``whitened_rms``: the same in standard deviations of the weights, about one if the model holds; ``readings``: number of coordinates
    that were held out.
    """

    rms_um: float
    whitened_rms: float
    folds: int
    poses: int
    readings: int

    @property
    def text(self) -> str:
        """One line."""
        return f"{self.rms_um:.3g} µm RMS per coordinate ({self.poses:,} poses in {self.folds} folds, each predicted from the others)"


def held_out_residuals(network: Network, solution: FitSolution, used: np.ndarray) -> HeldOutResiduals | None:
    """Return the residuals at held-out poses; None with fewer than two poses, or if the rest determines no station and target.

    ``network``: data and model, with the weights of the estimate; ``used``: (n,) the points that were used.
    """
    data = network.data
    poses, pose = np.unique(np.round(data.positions, 3), axis=0, return_inverse=True)
    folds = min(FOLDS, len(poses))
    if folds < 2:
        return None
    fold = pose.reshape(-1) % folds
    tested = used & _determined_by_others(data.station, fold, used) & _determined_by_others(data.target, fold, used)
    if not np.any(network.read[tested]):
        return None
    basis = solution.basis * solution.spectrum.scale[:, None]
    normal = np.zeros((folds, basis.shape[1], basis.shape[1]))
    right = np.zeros((folds, basis.shape[1]))
    for piece in network.chunks(solution.theta, solution.setup):
        along = piece.jacobian @ basis
        for k in np.unique(fold[piece.rows]).tolist():
            rows = (fold[piece.rows] == k) & used[piece.rows]
            flat = along[rows].reshape(-1, basis.shape[1])
            normal[k] += flat.T @ flat
            right[k] += flat.T @ piece.residual[rows].reshape(-1)
    # What the rest does not determine falls back to its prior; at the estimate the prior's pull is in balance only where it acts.
    free = (solution.stiffness <= solution.spectrum.values**2).astype(float)
    pull = free * (solution.basis.T @ solution.deviation)
    steps = np.stack(
        [
            basis @ np.linalg.solve(np.diag(solution.stiffness + free) - own, -of_fold - pull)
            for own, of_fold in zip(normal, right, strict=True)
        ]
    )
    square = whitened_square = 0.0
    for piece in network.chunks(solution.theta, solution.setup):
        safe = network.whitening[piece.rows] + np.eye(3) * ~network.read[piece.rows][:, None, :]
        off = piece.residual - np.einsum("nki,ni->nk", piece.jacobian, steps[fold[piece.rows]])
        whitened_square += float(np.sum(off[tested[piece.rows]] ** 2))
        off = np.linalg.solve(safe, off[:, :, None])[:, :, 0]
        square += float(np.sum(off[tested[piece.rows]] ** 2))
    readings = int(np.count_nonzero(network.read[tested]))
    rms_um, whitened_rms = float(np.sqrt(square / readings)) * 1e6, float(np.sqrt(whitened_square / readings))
    return HeldOutResiduals(rms_um, whitened_rms, folds, len(poses), readings)


def _determined_by_others(names: np.ndarray, fold: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Return (n,) whether a station or target is in another fold too."""
    determined_by_others = np.zeros(len(names), dtype=bool)
    for name in dict.fromkeys(names.tolist()):
        own = names == name
        folds = np.unique(fold[own & used])
        determined_by_others |= own & (np.isin(fold, folds[:1], invert=True) if len(folds) == 1 else len(folds) > 1)
    return determined_by_others
