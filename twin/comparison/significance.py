"""What of a change is more than the two measurements' uncertainty.

Four looks are taken at the same change, and an unchanged machine is to raise a false alarm in at most one comparison of twenty over all
of them together: each look has a quarter of that (Bonferroni).

- all numbers at once: χ² of the whole change;
- each error by itself, nothing assumed of the others (Holm 1979 over the errors);
- the fewest errors that account for everything, the others taken as unchanged. Errors that a measurement tells apart only badly have
  large uncertainties each and a small one together; where few errors changed this sees what the other two do not;
- the tool over the volume (`twin.comparison.tool`).

A covariance may have directions without variance: what a convention of `identify` rules out (no curve has a constant). They are
left out of every χ²; a change along one of them is told, and is neither significant nor zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.arrays import locked
from twin._common.distributions import chi2_log_sf, chi2_sf, normal_isf
from twin.comparison.pairs import Pair

FALSE_ALARMS: Final = 0.05
LOOKS: Final = 4
SHARE: Final = FALSE_ALARMS / LOOKS
"""Of false alarms for each look."""
WEAK: Final = 1e-8
"""Eigenvalues of a correlation matrix at or below this are zero. Of what `identify` writes in powers of degree 12, rounding leaves
1e-10 where a convention holds; the smallest others are 1e-4."""
FIXED: Final = 1e-3
"""A change along a direction without variance that is no more than this part of the standard uncertainties around it is rounding."""
DRAWS: Final = 4000
SEED: Final = 230
"""Of the draws for simultaneous bands."""
ODDS: Final = 2.0 * float(np.log(100.0))
"""χ² by which one explanation must beat another: odds of 100:1."""
DEPENDENT: Final = 1e-6
"""Relative size below which a direction is already explained by those chosen."""


@final
@dataclass(frozen=True)
class Whitened:
    """A change in uncorrelated coordinates of variance one.

    Attributes:
        into: (r, m) what makes them of the change.
        value: (r,) of this change.
        span: (m, r) orthonormal after dividing by ``scale``: the directions that have a variance.
        fixed: (m,) part of the change along directions without variance, rounding put to zero.
    """

    into: np.ndarray
    value: np.ndarray
    span: np.ndarray
    fixed: np.ndarray

    @property
    def rank(self) -> int:
        """Degrees of freedom."""
        return len(self.value)

    @property
    def chi2(self) -> float:
        """Of the change."""
        return float(self.value @ self.value)

    @property
    def p_value(self) -> float:
        """Of a χ² that large or larger if nothing changed; one if there is nothing to judge."""
        return float(chi2_sf(self.chi2, self.rank)) if self.rank else 1.0


def whiten(change: np.ndarray, covariance: np.ndarray, exact: np.ndarray | None = None) -> Whitened:
    """Rank-aware, by way of the correlations so that µm beside µrad loses nothing.

    Args:
        change: (m,).
        covariance: (m, m) of it, zero where nothing varies.
        exact: (m, e) what numbers without uncertainty add to it: where it goes along no variance, that is taken to be of these.
    """
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    typical = float(scale.max(initial=0.0)) or 1.0
    safe = np.where(scale > 0.0, scale, typical)
    values, vectors = np.linalg.eigh(covariance / np.outer(safe, safe))
    keep = values > WEAK * max(float(values[-1]), 1.0) if len(values) else np.zeros(0, dtype=bool)
    scaled = change / safe
    none = vectors[:, ~keep]
    still = none @ (none.T @ scaled)
    fixed = np.zeros_like(change)
    if np.linalg.norm(still) > FIXED:
        fixed = still * safe
        if exact is not None and exact.shape[1]:
            columns = exact / safe[:, None]
            found = columns @ np.linalg.lstsq(none.T @ columns, none.T @ scaled, rcond=None)[0]
            # What is left over is of no number alone: the shortest way back to what varies.
            fixed = (found + none @ (none.T @ (scaled - found))) * safe
    into = (vectors[:, keep] / np.sqrt(values[keep])).T / safe
    return Whitened(
        locked(into), locked(into @ (change - fixed)), locked(safe[:, None] * vectors[:, keep]), locked(fixed)
    )


def holm(p_values: Sequence[float]) -> list[float]:
    """Adjusted for their number (Holm 1979): significant at a level if no larger than it."""
    order = np.argsort(p_values, kind="stable")
    found = [1.0] * len(p_values)
    largest = 0.0
    for place, i in enumerate(order):
        largest = max(largest, min((len(p_values) - place) * p_values[i], 1.0))
        found[i] = largest
    return found


def simultaneous_factor(shape: np.ndarray, covariance: np.ndarray) -> float:
    """How many standard uncertainties to both sides hold a whole curve in 95 % of cases, by draws with a seed.

    Args:
        shape: (g, m) values of a unit of each coordinate.
        covariance: (m, m).
    """
    white = whiten(np.zeros(len(covariance)), covariance)
    if not white.rank:
        return 1.959964
    factor = shape @ np.linalg.pinv(white.into)
    size = np.linalg.norm(factor, axis=1)
    seen = size > 1e-9 * size.max()
    drawn = np.random.default_rng(SEED).standard_normal((white.rank, DRAWS))
    return float(np.quantile(np.abs(factor[seen] @ drawn / size[seen, None]).max(axis=0), 0.95))


@final
@dataclass(frozen=True)
class ChangeCandidate:
    """One way in which one error may have changed.

    Attributes:
        pair: its index.
        whole: whether any change of it, or only a straight line or bow over a linear axis.
        directions: (m, k) of the pair's own coordinates.
        columns: (r, k) orthonormal, of the whitened change of all.
    """

    pair: int
    whole: bool
    directions: np.ndarray
    columns: np.ndarray


@final
@dataclass(frozen=True)
class Culprit:
    """One error of the fewest that account for the change.

    Attributes:
        pair: its index among those given.
        change: (m,) estimate, all errors but the culprits taken as unchanged.
        covariance: (m, m) of it.
        p_value: of it beside the other culprits, not adjusted.
        alternatives: indices of the pairs that would do as well in its place, within odds of 100:1.
    """

    pair: int
    change: np.ndarray
    covariance: np.ndarray
    p_value: float
    alternatives: tuple[int, ...]


@final
@dataclass(frozen=True)
class Fewest:
    """The fewest errors that account for a change.

    Attributes:
        culprits: strongest first; none if nothing stands out.
        left_p_value: of what they leave.
        tried: how many ways were tried, which every p-value has to pay for.
        shows_from: of every pair that is one number, the change of it alone that would be seen in 19 of 20 comparisons; NaN of others.
    """

    culprits: tuple[Culprit, ...]
    left_p_value: float
    tried: int
    shows_from: tuple[float, ...]


def fewest(pairs: Sequence[Pair], white: Whitened, linear: Sequence[bool]) -> Fewest:
    """Forward, what is no longer needed taken out again, each exchanged where another does better.

    Args:
        pairs: all known.
        white: of their changes together.
        linear: of every pair, whether its axis is a linear one.
    """
    candidates = _candidates(pairs, white, linear)
    if not candidates:
        return Fewest((), white.p_value, 0, (float("nan"),) * len(pairs))
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
    return Fewest(tuple(map(search.culprit, order)), left_p, len(candidates), tuple(shows.tolist()))


def _candidates(pairs: Sequence[Pair], white: Whitened, linear: Sequence[bool]) -> list[ChangeCandidate]:
    found: list[ChangeCandidate] = []
    start = 0
    for i, (pair, straight) in enumerate(zip(pairs, linear, strict=True)):
        rows = slice(start, start + len(pair.change))
        start = rows.stop
        own = whiten(pair.change, pair.spread)
        ways = [(True, own.span)]
        if pair.kind == "curve" and straight and own.rank > 2:
            u = np.linspace(-1.0, 1.0, len(pair.positions))
            low = pair.shape.T @ np.stack([np.ones_like(u), u, u**2], axis=1) / len(u)
            # What a convention rules out is no part of it.
            allowed = own.span @ (np.linalg.pinv(own.span) @ low)
            left, size, _ = np.linalg.svd(allowed, full_matrices=False)
            ways.append((False, left[:, size > 1e-3 * size.max(initial=1e-300)]))
        for whole, directions in ways:
            columns = white.into[:, rows] @ directions
            left, size, right = np.linalg.svd(columns, full_matrices=False)
            keep = size > DEPENDENT * size.max(initial=0.0) if size.size else np.zeros(0, dtype=bool)
            if np.any(keep):
                found.append(
                    ChangeCandidate(i, whole, locked(directions @ right[keep].T / size[keep]), locked(left[:, keep]))
                )
    return found


@final
class _Search:
    """Stepwise selection among candidates.

    Attributes:
        candidates: the ways in which single errors may have changed.
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
        """(r, k) orthonormal, of what those chosen span together, but for one of them."""
        columns = [self.candidates[i].columns for i in self.chosen if i != without]
        if not columns:
            return np.zeros((len(self.value), 0))
        left, size, _ = np.linalg.svd(np.concatenate(columns, axis=1), full_matrices=False)
        return np.asarray(left[:, size > DEPENDENT])

    def beside_others(self, which: int) -> tuple[float, float, int]:
        """Gain of one of those chosen beside the others; see `_gain`."""
        return self._gain(self.candidates[which], self.basis(without=which))

    def culprit(self, which: int) -> Culprit:
        """One of those chosen, estimated beside the others, and what would do as well in its place."""
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
        return Culprit(own.pair, locked(estimate), locked(covariance), float(np.exp(gains[which][0])), tuple(rivals))

    def _exchange(self) -> None:
        """Exchange each of those chosen for a better one, if there is one."""
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
        """Logarithm of the p-value, gain of χ² and degrees of freedom of one candidate beside a basis."""
        columns = one.columns
        if basis.shape[1]:
            left, size, _ = np.linalg.svd(columns - basis @ (basis.T @ columns), full_matrices=False)
            columns = left[:, size > DEPENDENT]
        freedom = columns.shape[1]
        if not freedom:
            return 0.0, 0.0, 0
        gain = float(np.sum((columns.T @ self.value) ** 2))
        return float(chi2_log_sf(gain, freedom)), gain, freedom
