"""Evidence of subsets of candidate terms, and the average over the subsets that the data allow.

The residual of a displacement is a stationary process with exponential correlation (neighbouring rows are alike) plus white noise. The
coefficients have normal priors, so that the evidence of a subset has a closed form (Rasmussen and Williams, Gaussian Processes for
Machine Learning, 2006, eq. 2.43 to 2.45). Subsets are drawn by Markov chain Monte Carlo over models (Madigan and York, International
Statistical Review 63, 1995); means and covariances over the draws are those of Bayesian model averaging (Hoeting et al., Statistical
Science 14, 1999).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.thermal.candidates import TermCandidate

TERM_COST: Final = 3.0
"""Prior log odds against each candidate: some three terms are expected among sixty candidates."""
DRIFT_COST: Final = 6.0
"""The same for a drift, which has no measured cause and fits any slow change."""
STEPS: Final = 8000
BURN_IN: Final = 0.25
THINNING: Final = 20
CONSTANT_UM: Final = 2.0
"""Prior standard deviation of the constant: displacements count from the start of the record."""
RESIDUAL_SHARES: Final = np.geomspace(0.03, 0.7, 9)
RESIDUAL_TIMES: Final = (48.0, 24.0, 12.0, 6.0)
"""Correlation times of the residual tried: the record's duration divided by these."""


@final
@dataclass(frozen=True)
class Average:
    """Average over the drawn models, for one displacement; the last coefficient is the constant.

    Attributes:
        mean: (terms + 1,), µm/K or µm.
        covariance: (terms + 1, terms + 1), within and between models.
        residual_um: standard deviation of the correlated residual.
    """

    mean: np.ndarray
    covariance: np.ndarray
    residual_um: float


@final
@dataclass(frozen=True)
class DrawnModels:
    """Drawn models of a group of displacements.

    Attributes:
        models: indices of the candidates of every drawn model.
        averages: one for each displacement of the group.
    """

    models: tuple[tuple[int, ...], ...]
    averages: tuple[Average, ...]


class Evidence:
    """Evidence of every subset of candidates for the displacements of one group."""

    def __init__(
        self,
        x: np.ndarray,
        y: np.ndarray,
        time_s: np.ndarray,
        terms: Sequence[TermCandidate],
        noise_um: np.ndarray,
        duration_s: float,
    ) -> None:
        """Prepare the normal equations for every size and correlation time of the residual.

        Args:
            x: candidates (n, terms).
            y: displacements (n, m) in µm.
            time_s: (n,).
            terms: the candidates.
            noise_um: white noise of the displacements (m,).
            duration_s: duration of the record.
        """
        self.scale = np.r_[[term.prior for term in terms], CONSTANT_UM]
        self.count = x.shape[1]
        drift = np.array([term.effect == "thermal_drift" for term in terms])
        self._cost = np.where(drift, DRIFT_COST, TERM_COST)
        self.size = y.shape[1]
        design = np.c_[x, np.ones(len(x))] * self.scale
        distance = np.abs(time_s[:, None] - time_s[None, :])
        self.residual_um: list[list[float]] = []
        self._normal: list[list[tuple[np.ndarray, np.ndarray, float]]] = []
        for c in range(self.size):
            spread = max(float(y[:, c].std()), float(noise_um[c]), 1e-3)
            self.residual_um.append([spread * share for _ in RESIDUAL_TIMES for share in RESIDUAL_SHARES])
            kinds = []
            for part in RESIDUAL_TIMES:
                correlation = np.exp(-distance * part / duration_s)
                for share in RESIDUAL_SHARES:
                    covariance = (spread * share) ** 2 * correlation + (noise_um[c] ** 2 + 1e-8) * np.eye(len(x))
                    factor = np.linalg.cholesky(covariance)
                    white = np.linalg.solve(factor, np.c_[design, y[:, c]])
                    product = white.T @ white
                    rest = 0.5 * product[-1, -1] + float(np.log(np.diag(factor)).sum())
                    kinds.append((product[:-1, :-1], product[:-1, -1], rest))
            self._normal.append(kinds)

    def log_evidence(self, chosen: Sequence[int], displacement: int, kind: int) -> float:
        """Return the log evidence of a subset for one displacement and one kind of residual."""
        matrix, right, rest = self._normal[displacement][kind]
        index = np.array([*chosen, self.count])
        factor = np.linalg.cholesky(matrix[index[:, None], index] + np.eye(len(index)))
        half = np.linalg.solve(factor, right[index])
        return float(0.5 * half @ half - np.log(np.diag(factor)).sum() - rest)

    def coefficients(self, chosen: Sequence[int], displacement: int, kind: int) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and covariance of the coefficients of a subset, the constant last."""
        matrix, right, _ = self._normal[displacement][kind]
        index = np.array([*chosen, self.count])
        covariance = np.linalg.inv(matrix[index[:, None], index] + np.eye(len(index)))
        scale = self.scale[index]
        return covariance @ right[index] * scale, covariance * np.outer(scale, scale)

    def draw(self, generator: np.random.Generator, steps: int = STEPS) -> DrawnModels:
        """Draw models from their posterior distribution and return their average.

        The log evidence is the mean over the displacements of the group: they move together and are not independent observations.
        """
        kinds = len(self.residual_um[0])
        chosen: list[int] = []
        kind = [int(np.argmax([self.log_evidence(chosen, c, k) for k in range(kinds)])) for c in range(self.size)]
        now = self._posterior(chosen, kind)
        drawn = []
        for step in range(steps):
            new, new_kind = self._proposal(chosen, kind, generator)
            value = self._posterior(new, new_kind)
            if np.log(generator.random()) < value - now:
                chosen, kind, now = new, new_kind, value
            if step >= BURN_IN * steps and step % THINNING == 0:
                drawn.append((tuple(sorted(chosen)), tuple(kind)))
        averages = tuple(self._average([(model, k[c]) for model, k in drawn], c) for c in range(self.size))
        return DrawnModels(tuple(model for model, _ in drawn), averages)

    def _posterior(self, chosen: Sequence[int], kind: Sequence[int]) -> float:
        evidence = sum(self.log_evidence(chosen, c, kind[c]) for c in range(self.size)) / self.size
        return evidence - float(self._cost[list(chosen)].sum())

    def _proposal(
        self, chosen: list[int], kind: list[int], generator: np.random.Generator
    ) -> tuple[list[int], list[int]]:
        """Return a neighbour: another kind of residual, a term exchanged, added or removed; the proposal is symmetric."""
        way = generator.random()
        if way < 0.15:
            new_kind = list(kind)
            new_kind[int(generator.integers(self.size))] = int(generator.integers(len(self.residual_um[0])))
            return chosen, new_kind
        one = int(generator.integers(self.count))
        if way < 0.55:
            if one in chosen or not chosen:
                return chosen, kind
            place = int(generator.integers(len(chosen)))
            return [*chosen[:place], one, *chosen[place + 1 :]], kind
        return ([j for j in chosen if j != one] if one in chosen else [*chosen, one]), kind

    def _average(self, drawn: Sequence[tuple[tuple[int, ...], int]], displacement: int) -> Average:
        size = self.count + 1
        mean, second, variance = np.zeros(size), np.zeros((size, size)), 0.0
        for (model, kind), times in _counted(drawn):
            value, covariance = self.coefficients(model, displacement, kind)
            index = np.array([*model, self.count])
            mean[index] += times * value
            second[index[:, None], index] += times * (covariance + np.outer(value, value))
            variance += times * self.residual_um[displacement][kind] ** 2
        mean, second = mean / len(drawn), second / len(drawn)
        return Average(mean, second - np.outer(mean, mean), float(np.sqrt(variance / len(drawn))))


def _counted(drawn: Sequence[tuple[tuple[int, ...], int]]) -> list[tuple[tuple[tuple[int, ...], int], int]]:
    found: dict[tuple[tuple[int, ...], int], int] = {}
    for one in drawn:
        found[one] = found.get(one, 0) + 1
    return list(found.items())
