"""Significance of the changes between two calibrations.

The same change is tested in four ways. An unchanged machine raises a false alarm in at most one comparison of twenty over all of them,
so each test has a quarter of that (Bonferroni):

- all numbers at once: χ² of the whole change;
- each error by itself, with the others free (Holm 1979 over the errors);
- the smallest set of errors that explains the whole change, the others taken as unchanged. Strongly correlated errors have large
  uncertainties by themselves and a small one together; if few errors changed, this test is more sensitive than the first two;
- the tool point over the volume (`twin.comparison.tool`).

A covariance may have directions without variance, fixed by a convention of `identify` (no curve has a constant). They are left
out of every χ²; a change in such a direction is reported, and is neither significant nor zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.distributions import chi2_log_sf, chi2_sf, normal_isf
from twin.comparison.pairs import Pair
from twin.numerics.covariance import symmetric_root

FALSE_ALARMS: Final = 0.05
TESTS: Final = 4
SHARE: Final = FALSE_ALARMS / TESTS
"""Probability of a false alarm of each test."""
WEAK: Final = 1e-8
"""Eigenvalues of a correlation matrix up to this are zero. In files of `identify` with powers of degree 12, rounding leaves 1e-10 for
directions fixed by a convention; the smallest others are 1e-4."""
FIXED: Final = 1e-3
"""Changes in directions without variance up to this multiple of the standard uncertainties are rounding errors."""
DRAWS: Final = 4000
SEED: Final = 230
"""Random seed of the draws for simultaneous bands."""
ODDS: Final = 2.0 * float(np.log(100.0))
"""χ² by which one explanation must be better than another: odds of 100:1."""
DEPENDENT: Final = 1e-6
"""Relative singular value up to which a direction is linearly dependent on those selected."""


@final
@dataclass(frozen=True)
class Whitened:
    """A whitened change: uncorrelated coordinates of variance one.

    Attributes:
        transform: (r, m) whitening transformation.
        value: (r,) the whitened change.
        span: (m, r) the directions with a variance, orthonormal after division by the standard uncertainties.
        without_variance: (m,) part of the change in directions without variance; rounding errors are set to zero.
    """

    transform: np.ndarray
    value: np.ndarray
    span: np.ndarray
    without_variance: np.ndarray

    @property
    def rank(self) -> int:
        """Return the degrees of freedom."""
        return len(self.value)

    @property
    def chi2(self) -> float:
        """Return the χ² of the change."""
        return float(self.value @ self.value)

    @property
    def p_value(self) -> float:
        """Return the p-value of the χ²; one without degrees of freedom."""
        return float(chi2_sf(self.chi2, self.rank)) if self.rank else 1.0


def whiten(change: np.ndarray, covariance: np.ndarray, exact: np.ndarray | None = None) -> Whitened:
    """Whiten a change, for a singular covariance too; eigenvalues are those of the correlation matrix, so that units do not matter.

    Args:
        change: (m,).
        covariance: (m, m) of the change; zero for numbers without variance.
        exact: (m, e) columns of numbers without uncertainty; a change in directions without variance is attributed to these.
    """
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    typical = float(scale.max(initial=0.0)) or 1.0
    safe = np.where(scale > 0.0, scale, typical)
    values, vectors = np.linalg.eigh(covariance / np.outer(safe, safe))
    keep = values > WEAK * max(float(values[-1]), 1.0) if len(values) else np.zeros(0, dtype=bool)
    scaled = change / safe
    none = vectors[:, ~keep]
    still = none @ (none.T @ scaled)
    without_variance = np.zeros_like(change)
    if np.linalg.norm(still) > FIXED:
        without_variance = still * safe
        if exact is not None and exact.shape[1]:
            columns = exact / safe[:, None]
            found = columns @ np.linalg.lstsq(none.T @ columns, none.T @ scaled, rcond=None)[0]
            # The remainder belongs to no single number: orthogonal projection onto the directions without variance.
            without_variance = (found + none @ (none.T @ (scaled - found))) * safe
    transform = (vectors[:, keep] / np.sqrt(values[keep])).T / safe
    return Whitened(
        read_only(transform),
        read_only(transform @ (change - without_variance)),
        read_only(safe[:, None] * vectors[:, keep]),
        read_only(without_variance),
    )


def holm_adjusted(p_values: Sequence[float]) -> list[float]:
    """Return p-values corrected for multiple testing (Holm 1979)."""
    order = np.argsort(p_values, kind="stable")
    found = [1.0] * len(p_values)
    largest = 0.0
    for place, i in enumerate(order):
        largest = max(largest, min((len(p_values) - place) * p_values[i], 1.0))
        found[i] = largest
    return found


def simultaneous_factor(shape: np.ndarray, covariance: np.ndarray) -> float:
    """Return the coverage factor of a simultaneous 95 % band of a whole curve, by Monte Carlo with a fixed seed.

    Args:
        shape: (g, m) value of a unit of each coordinate.
        covariance: (m, m) of the coordinates.
    """
    # The coordinates are those of an arbitrary orthonormal basis: turned to be nearest to cosines, they do not depend on rounding.
    count, places = len(covariance), (np.arange(len(shape)) + 0.5) / max(len(shape), 1)
    left, _, right = np.linalg.svd(shape.T @ np.cos(np.pi * np.outer(places, np.arange(count))))
    turn = left @ right
    factor = shape @ turn @ symmetric_root(turn.T @ covariance @ turn)
    size = np.linalg.norm(factor, axis=1)
    if not np.any(size):
        return 1.959964
    seen = size > 1e-9 * size.max()
    drawn = np.random.default_rng(SEED).standard_normal((count, DRAWS))
    return float(np.quantile(np.abs(factor[seen] @ drawn / size[seen, None]).max(axis=0), 0.95))


@final
@dataclass(frozen=True)
class ChangeCandidate:
    """One form in which one error may have changed.

    Attributes:
        pair: index of the error.
        whole: whether any change of the error, or only a line or parabola over a linear axis.
        directions: (m, k) in the coordinates of the pair.
        columns: (r, k) orthonormal, in the whitened coordinates of all errors.
    """

    pair: int
    whole: bool
    directions: np.ndarray
    columns: np.ndarray


@final
@dataclass(frozen=True)
class Culprit:
    """One error of the smallest set that explains the change.

    Attributes:
        pair: index of the error.
        change: (m,) estimate, all errors outside the set taken as unchanged.
        covariance: (m, m) of the estimate.
        p_value: given the others of the set, not corrected for multiple testing.
        alternatives: indices of the errors that would explain the change in its place, within odds of 100:1.
    """

    pair: int
    change: np.ndarray
    covariance: np.ndarray
    p_value: float
    alternatives: tuple[int, ...]


@final
@dataclass(frozen=True)
class SmallestSet:
    """The smallest set of errors that explains a change.

    Attributes:
        culprits: strongest first; empty if no error is significant.
        left_p_value: p-value of the change they do not explain.
        tried: number of candidates, for which every p-value is corrected.
        shows_from: for each error that is one number, its detection limit (19 of 20 comparisons, all else unchanged); NaN for others.
    """

    culprits: tuple[Culprit, ...]
    left_p_value: float
    tried: int
    shows_from: tuple[float, ...]


def smallest_set(pairs: Sequence[Pair], white: Whitened, linear: Sequence[bool]) -> SmallestSet:
    """Select the smallest set of errors that explains a change: stepwise, forward with removal and exchange.

    Args:
        pairs: errors of status ``known``.
        white: their joint change, whitened.
        linear: for each error, whether its axis is linear.
    """
    candidates = _candidates(pairs, white, linear)
    if not candidates:
        return SmallestSet((), white.p_value, 0, (float("nan"),) * len(pairs))
    level = SHARE / len(candidates)
    search = _Search(candidates, white.value)
    search.run(float(np.log(level)))
    basis = search.basis()
    left = float(np.sum((white.value - basis @ (basis.T @ white.value)) ** 2))
    freedom = len(white.value) - basis.shape[1]
    order = sorted(search.chosen, key=lambda i: search.beside_others(i)[0])
    shows = np.full(len(pairs), np.nan)
    for one in candidates:
        if len(pairs[one.pair].change) == 1:
            u = float(np.abs(one.directions[0, 0]))
            shows[one.pair] = u * (normal_isf(level / 2.0) + normal_isf(0.05))
    left_p = float(chi2_sf(left, freedom)) if freedom else 1.0
    return SmallestSet(tuple(map(search.culprit, order)), left_p, len(candidates), tuple(shows.tolist()))


def _candidates(pairs: Sequence[Pair], white: Whitened, linear: Sequence[bool]) -> list[ChangeCandidate]:
    found: list[ChangeCandidate] = []
    start = 0
    for i, (pair, straight) in enumerate(zip(pairs, linear, strict=True)):
        rows = slice(start, start + len(pair.change))
        start = rows.stop
        own = whiten(pair.change, pair.covariance)
        ways = [(True, own.span)]
        if pair.kind == "curve" and straight and own.rank > 2:
            u = np.linspace(-1.0, 1.0, len(pair.positions))
            low = pair.shape.T @ np.stack([np.ones_like(u), u, u**2], axis=1) / len(u)
            # Without directions fixed by a convention.
            allowed = own.span @ (np.linalg.pinv(own.span) @ low)
            left, size, _ = np.linalg.svd(allowed, full_matrices=False)
            ways.append((False, left[:, size > 1e-3 * size.max(initial=1e-300)]))
        for whole, directions in ways:
            columns = white.transform[:, rows] @ directions
            left, size, right = np.linalg.svd(columns, full_matrices=False)
            keep = size > DEPENDENT * size.max(initial=0.0) if size.size else np.zeros(0, dtype=bool)
            if np.any(keep):
                found.append(
                    ChangeCandidate(
                        i, whole, read_only(directions @ right[keep].T / size[keep]), read_only(left[:, keep])
                    )
                )
    return found


@final
class _Search:
    """Stepwise selection among candidates.

    Attributes:
        candidates: the forms in which single errors may have changed.
        value: (r,) the whitened change.
        chosen: indices of the candidates selected.
    """

    def __init__(self, candidates: Sequence[ChangeCandidate], value: np.ndarray) -> None:
        self.candidates = candidates
        self.value = value
        self.chosen: list[int] = []

    def run(self, level: float) -> None:
        """Add the best candidate while the logarithm of its p-value is at most ``level``; exchange and remove in between."""
        seen: set[frozenset[int]] = set()
        while frozenset(self.chosen) not in seen:
            seen.add(frozenset(self.chosen))
            gains = self._gains(self.basis())
            best = min(range(len(gains)), key=lambda i: gains[i][0])
            if gains[best][0] > level:
                break
            pair = self.candidates[best].pair
            self.chosen = [i for i in self.chosen if self.candidates[i].pair != pair] + [best]
            self._exchange()
            while self.chosen:
                weakest = max(self.chosen, key=lambda i: self.beside_others(i)[0])
                if self.beside_others(weakest)[0] <= level:
                    break
                self.chosen.remove(weakest)

    def basis(self, without: int | None = None) -> np.ndarray:
        """Return an orthonormal (r, k) basis of the selected candidates, optionally without one of them."""
        columns = [self.candidates[i].columns for i in self.chosen if i != without]
        if not columns:
            return np.zeros((len(self.value), 0))
        left, size, _ = np.linalg.svd(np.concatenate(columns, axis=1), full_matrices=False)
        return np.asarray(left[:, size > DEPENDENT])

    def beside_others(self, which: int) -> tuple[float, float, int]:
        """Return the gain of one selected candidate given the others; see `_gain`."""
        return self._gain(self.candidates[which], self.basis(without=which))

    def culprit(self, which: int) -> Culprit:
        """Return one selected error, estimated jointly with the others, with its alternatives."""
        own = self.candidates[which]
        stacked = np.concatenate([self.candidates[i].columns for i in self.chosen], axis=1)
        inverse = np.linalg.pinv(stacked, rcond=DEPENDENT)
        before = self.chosen[: self.chosen.index(which)]
        at = sum(self.candidates[i].columns.shape[1] for i in before)
        rows = slice(at, at + own.columns.shape[1])
        estimate = own.directions @ (inverse @ self.value)[rows]
        covariance = own.directions @ (inverse @ inverse.T)[rows, rows] @ own.directions.T
        gains = self._gains(self.basis(without=which))
        taken = {self.candidates[i].pair for i in self.chosen}
        mine = gains[which][1] - 2.0 * gains[which][2]
        rivals = dict.fromkeys(
            self.candidates[i].pair
            for i in np.argsort([gain[0] for gain in gains], kind="stable")
            if self.candidates[i].pair not in taken and mine - (gains[i][1] - 2.0 * gains[i][2]) < ODDS
        )
        return Culprit(
            own.pair, read_only(estimate), read_only(covariance), float(np.exp(gains[which][0])), tuple(rivals)
        )

    def _exchange(self) -> None:
        """Exchange each selected candidate for a better one, if there is one."""
        for place, which in enumerate(list(self.chosen)):
            taken = {self.candidates[i].pair for i in self.chosen if i != which}
            gains = self._gains(self.basis(without=which))
            free = [i for i, one in enumerate(self.candidates) if one.pair not in taken]
            best = min(free, key=lambda i: gains[i][0])
            if gains[best][0] < gains[which][0]:
                self.chosen[place] = best

    def _gains(self, basis: np.ndarray) -> list[tuple[float, float, int]]:
        return [self._gain(one, basis) for one in self.candidates]

    def _gain(self, one: ChangeCandidate, basis: np.ndarray) -> tuple[float, float, int]:
        """Return log p-value, χ² gain and degrees of freedom of one candidate given a basis."""
        columns = one.columns
        if basis.shape[1]:
            left, size, _ = np.linalg.svd(columns - basis @ (basis.T @ columns), full_matrices=False)
            columns = left[:, size > DEPENDENT]
        freedom = columns.shape[1]
        if not freedom:
            return 0.0, 0.0, 0
        gain = float(np.sum((columns.T @ self.value) ** 2))
        return float(chi2_log_sf(gain, freedom)), gain, freedom
