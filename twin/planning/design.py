"""Choose readings by exchange: start from an even spread, replace the least informative ones by those that gain most per second.

With C the covariance of all unknowns so far and R the whitened derivatives of a reading, the reading reduces the criterion by
tr(S⁻¹ R C M C Rᵀ), S = 1 + R C Rᵀ, where M is the weight matrix of the unknowns (`twin.planning.aims`).
(Fedorov 1972; Atkinson, Donev and Tobias 2007, chapters 10 to 12.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from twin._common.arrays import EQUAL, first_largest
from twin._common.progress import Progress, silent
from twin.measurement.instruments import Instrument
from twin.measurement.table import Measurements
from twin.planning.aims import Aim
from twin.planning.candidates import CandidateReadings

RECOMPUTED_AFTER: Final = 50
"""Number of choices after which the covariance is recomputed, as updates accumulate rounding errors."""
SAMPLED: Final = 128
"""Number of random candidates from which each reading is chosen."""
EXCHANGED_SHARES: Final = (0.9, 0.3, 0.3)
"""Shares of a plan exchanged in successive rounds."""


def covariance_of(prior: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the covariance (f, f) of the coordinates from the prior precision (f, f) and readings with derivatives (n, 3, f)."""
    flat = rows.reshape(-1, rows.shape[-1])
    return inverse(prior + flat.T @ flat)


def inverse(precision: np.ndarray) -> np.ndarray:
    """Return the inverse of a precision, scaled to a unit diagonal first: uncertainties range from metres to micrometres."""
    size = 1.0 / np.sqrt(np.diag(precision))
    found = np.linalg.inv(precision * size[:, None] * size)
    return np.asarray((found + found.T) / 2.0 * size[:, None] * size)


@final
@dataclass(frozen=True)
class DesignProblem:
    """Design problem of one instrument: candidate readings and criterion.

    Attributes:
        instrument: the instrument.
        candidates: the candidate readings.
        prior: (f, f) prior precision of the unknowns' coordinates.
        rows: (n, 3, f) derivatives of the whitened readings.
        aim: the criterion to minimise.
    """

    instrument: Instrument
    candidates: CandidateReadings
    prior: np.ndarray
    rows: np.ndarray
    aim: Aim

    @property
    def plan(self) -> Measurements:
        """Table of the candidate readings, one row each."""
        return self.candidates.plan

    def from_stations(self, stations: Sequence[str]) -> DesignProblem:
        """Return the problem restricted to some stations."""
        inside = np.flatnonzero(np.isin(self.plan.station, stations))
        return replace(self, candidates=self.candidates.select(inside), rows=self.rows[inside])

    def value(self, rows: np.ndarray) -> float:
        """Return the criterion after the readings with these indices."""
        return self.aim.value(covariance_of(self.prior, self.rows[rows]))


@final
@dataclass(frozen=True)
class Exchange:
    """Exchange algorithm that chooses readings among candidates.

    Attributes:
        prior: (f, f) prior precision of the coordinates.
        rows: (n, 3, f) derivatives of every candidate.
        cost: (n,) seconds for each.
        aim: the criterion to minimise.
        most: how often one candidate may be taken.
        exchanged: shares of the plan exchanged in successive rounds.
        among: number of random candidates from which each reading is chosen.
        progress: progress callback.
    """

    prior: np.ndarray
    rows: np.ndarray
    cost: np.ndarray
    aim: Aim
    most: int = 4
    exchanged: tuple[float, ...] = EXCHANGED_SHARES
    among: int = SAMPLED
    progress: Progress = silent

    def choose(self, count: int, first: np.ndarray, least: int) -> np.ndarray:
        """Return the indices of the chosen readings in order of choice; an index may repeat.

        Args:
            count: number of readings.
            first: indices of all candidates in random order, so that its first elements are an even spread: the initial plan.
            least: smallest number of readings to begin with.
        """
        spread = np.concatenate([first] * (1 + (count - 1) // max(len(first), 1)))[:count]
        best, value = list(spread), self._value(spread)
        for number, share in enumerate(self.exchanged):
            # A reading of a target whose position nothing determines carries no information, so the choice cannot begin with none.
            # It begins with part of an even spread; an exchange that does not reduce the criterion is dropped.
            fewer = max(1, round(share * count))
            chosen = (
                self._without_least_informative(best, fewer)
                if number
                else best[: max(count - fewer, min(least, count))]
            )
            self._add_readings(chosen, count, number / len(self.exchanged))
            reached = self._value(chosen)
            if reached < value * (1.0 - EQUAL):
                best, value = chosen, reached
        return np.array(best)

    def _value(self, chosen: np.ndarray | list[int]) -> float:
        """Return the criterion after some readings."""
        return self.aim.value(covariance_of(self.prior, self.rows[chosen]))

    def _add_readings(self, chosen: list[int], count: int, done: float) -> None:
        """Add readings: each time the one of a random sample with the largest gain per second.

        (Stochastic greedy; Mirzasoleiman et al. 2015.)
        """
        begun = len(chosen)
        taken = np.bincount(chosen, minlength=len(self.rows))
        rng = np.random.default_rng(begun)
        covariance, weight = np.zeros((0, 0)), np.zeros((0, 0))
        while len(chosen) < count:
            if (len(chosen) - begun) % RECOMPUTED_AFTER == 0:
                covariance = covariance_of(self.prior, self.rows[chosen])
                weight = self.aim.weight(covariance)
                part = (len(chosen) - begun) / max(count - begun, 1)
                self.progress("choosing", done + part / len(self.exchanged))
            available = np.flatnonzero(taken < self.most)
            if not len(available):
                return
            drawn = rng.choice(available, min(self.among, len(available)), replace=False)
            best = int(drawn[first_largest(gains(self.rows[drawn], covariance, weight) / self.cost[drawn])])
            chosen.append(best)
            taken[best] += 1
            covariance = _updated(covariance, self.rows[best])

    def _without_least_informative(self, chosen: list[int], fewer: int) -> list[int]:
        """Return the readings without the ``fewer`` least informative ones."""
        picked = self.rows[chosen]
        covariance = covariance_of(self.prior, picked)
        weight = self.aim.weight(covariance)
        spread = picked @ covariance
        own = np.eye(3) - np.einsum("nif,njf->nij", spread, picked)
        moved = np.einsum("nif,njf->nij", spread @ weight, spread)
        # Without an irreplaceable reading the loss would be infinite.
        safe = np.linalg.eigvalsh(own)[:, 0] > 1e-6
        loss = np.full(len(chosen), np.inf)
        loss[safe] = np.einsum("nii->n", np.linalg.solve(own[safe], moved[safe]))
        # In single precision, rounding does not decide between mirrored readings that are equally informative.
        gone = set(np.argsort(loss.astype(np.float32), kind="stable")[:fewer].tolist())
        return [index for k, index in enumerate(chosen) if k not in gone]


def gains(rows: np.ndarray, covariance: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return by how much each of some readings (n, 3, f) reduces the criterion: (n,)."""
    # One long product instead of many small ones.
    long = rows.reshape(-1, rows.shape[-1]) @ covariance
    spread = long.reshape(rows.shape)
    own = spread @ rows.transpose(0, 2, 1) + np.eye(3)
    moved = (long @ weight).reshape(rows.shape) @ spread.transpose(0, 2, 1)
    return np.asarray(np.einsum("nii->n", np.linalg.solve(own, moved)))


def _updated(covariance: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Return the covariance after one more reading."""
    spread = covariance @ row.T
    found = covariance - spread @ np.linalg.solve(row @ spread + np.eye(3), spread.T)
    return np.asarray((found + found.T) / 2.0)
