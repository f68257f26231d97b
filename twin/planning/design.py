"""Which readings to take: an even spread, its poorest exchanged for what tells most for its time.

With C the covariance of all unknowns so far and R the whitened derivatives of a reading, what is aimed at falls by tr(S⁻¹ R C M C Rᵀ),
S = 1 + R C Rᵀ, where M (`twin.planning.aims`) weighs the unknowns.
(Fedorov 1972; Atkinson, Donev and Tobias 2007, chapters 10 to 12.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from twin.measurement.instruments import Instrument
from twin.measurement.table import Measurements
from twin.planning.aims import Aim
from twin.planning.candidates import Candidates
from twin.planning.task import Say

AFRESH: Final = 50
"""Choices after which the covariance is found anew from all of them: updates add up their rounding."""
DRAWN: Final = 128
"""Candidates each choice is made among."""
EXCHANGED: Final = (0.9, 0.3, 0.3)
"""Shares of a plan exchanged one after the other."""


def covariance_of(prior: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(f, f) covariance of the coordinates, known before with precision (f, f), after readings with derivatives (n, 3, f)."""
    flat = rows.reshape(-1, rows.shape[-1])
    return inverse(prior + flat.T @ flat)


def inverse(precision: np.ndarray) -> np.ndarray:
    """Of a precision, brought to a unit diagonal first: stations are known to metres before and to micrometres after."""
    size = 1.0 / np.sqrt(np.diag(precision))
    found = np.linalg.inv(precision * size[:, None] * size)
    return np.asarray((found + found.T) / 2.0 * size[:, None] * size)


@final
@dataclass(frozen=True)
class DesignProblem:
    """Everything that could be read with one instrument, and what is aimed at.

    Attributes:
        instrument: what reads.
        every: the readings.
        prior: (f, f) precision of the unknowns' coordinates before any reading.
        rows: (n, 3, f) derivatives of the whitened readings.
        aim: what is to become small.
    """

    instrument: Instrument
    every: Candidates
    prior: np.ndarray
    rows: np.ndarray
    aim: Aim

    @property
    def plan(self) -> Measurements:
        """The readings, a row each."""
        return self.every.plan

    def at(self, stations: Sequence[str]) -> DesignProblem:
        """Those from some stations."""
        inside = np.flatnonzero(np.isin(self.plan.station, stations))
        return replace(self, every=self.every.select(inside), rows=self.rows[inside])

    def value(self, rows: np.ndarray) -> float:
        """What is aimed at, after some of them."""
        return self.aim.value(covariance_of(self.prior, self.rows[rows]))


@final
@dataclass(frozen=True)
class Exchange:
    """Readings to choose from, and how.

    Attributes:
        prior: (f, f) precision of the coordinates before any reading.
        rows: (n, 3, f) derivatives of every candidate.
        cost: (n,) seconds of each.
        aim: what to make small.
        most: times one candidate may be taken.
        exchanged: shares of the plan exchanged, one after the other.
        among: how many candidates each choice is made among.
        say: told how far it is.
    """

    prior: np.ndarray
    rows: np.ndarray
    cost: np.ndarray
    aim: Aim
    most: int = 4
    exchanged: tuple[float, ...] = EXCHANGED
    among: int = DRAWN
    say: Say | None = None

    def of(self, count: int, first: np.ndarray, least: int) -> np.ndarray:
        """Indices of the readings of a plan, in the order of choice, a few more than once.

        Args:
            count: how many readings.
            first: every candidate, in an order that any beginning of is spread evenly: the plan that is bettered.
            least: readings that the choice begins with at least.
        """
        spread = np.concatenate([first] * (1 + (count - 1) // max(len(first), 1)))[:count]
        best, value = list(spread), self._value(spread)
        for number, share in enumerate(self.exchanged):
            # Something has to place stations and targets: a reading of a target that nothing places tells nothing, so that a choice
            # cannot begin with none. It begins with part of an even spread, then exchanges; what does not pay is not done.
            fewer = max(1, round(share * count))
            chosen = self._kept(best, fewer) if number else best[: max(count - fewer, min(least, count))]
            self._grow(chosen, count, number / len(self.exchanged))
            reached = self._value(chosen)
            if reached < value:
                best, value = chosen, reached
        return np.array(best)

    def _value(self, chosen: np.ndarray | list[int]) -> float:
        """What is aimed at, after some readings."""
        return self.aim.value(covariance_of(self.prior, self.rows[chosen]))

    def _grow(self, chosen: list[int], count: int, done: float) -> None:
        """Add readings, each time the best for its time of some drawn at random (stochastic greedy; Mirzasoleiman et al. 2015)."""
        begun = len(chosen)
        taken = np.bincount(chosen, minlength=len(self.rows))
        rng = np.random.default_rng(begun)
        covariance, weight = np.zeros((0, 0)), np.zeros((0, 0))
        while len(chosen) < count:
            if (len(chosen) - begun) % AFRESH == 0:
                covariance = covariance_of(self.prior, self.rows[chosen])
                weight = self.aim.weight(covariance)
                if self.say is not None:
                    part = (len(chosen) - begun) / max(count - begun, 1)
                    self.say("choosing", done + part / len(self.exchanged))
            left = np.flatnonzero(taken < self.most)
            if not len(left):
                return
            drawn = rng.choice(left, min(self.among, len(left)), replace=False)
            best = int(drawn[np.argmax(gains(self.rows[drawn], covariance, weight) / self.cost[drawn])])
            chosen.append(best)
            taken[best] += 1
            covariance = _after(covariance, self.rows[best])

    def _kept(self, chosen: list[int], fewer: int) -> list[int]:
        """Those left when the readings that tell least are taken out."""
        picked = self.rows[chosen]
        covariance = covariance_of(self.prior, picked)
        weight = self.aim.weight(covariance)
        spread = picked @ covariance
        own = np.eye(3) - np.einsum("nif,njf->nij", spread, picked)
        moved = np.einsum("nif,njf->nij", spread @ weight, spread)
        # Alone, a reading that nothing else replaces leaves no finite loss.
        safe = np.linalg.eigvalsh(own)[:, 0] > 1e-6
        loss = np.full(len(chosen), np.inf)
        loss[safe] = np.einsum("nii->n", np.linalg.solve(own[safe], moved[safe]))
        gone = set(np.argsort(loss, kind="stable")[:fewer].tolist())
        return [index for k, index in enumerate(chosen) if k not in gone]


def gains(rows: np.ndarray, covariance: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(n,) by how much what is aimed at falls with each of some readings (n, 3, f)."""
    # One long product instead of many small ones.
    long = rows.reshape(-1, rows.shape[-1]) @ covariance
    spread = long.reshape(rows.shape)
    own = spread @ rows.transpose(0, 2, 1) + np.eye(3)
    moved = (long @ weight).reshape(rows.shape) @ spread.transpose(0, 2, 1)
    return np.asarray(np.einsum("nii->n", np.linalg.solve(own, moved)))


def _after(covariance: np.ndarray, row: np.ndarray) -> np.ndarray:
    spread = covariance @ row.T
    found = covariance - spread @ np.linalg.solve(row @ spread + np.eye(3), spread.T)
    return np.asarray((found + found.T) / 2.0)
