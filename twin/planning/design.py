"""Which readings to take: an even spread, its poorest exchanged for what tells most for its time.

With C the covariance of all unknowns so far and R the whitened derivatives of a reading, what is aimed at falls by tr(S⁻¹ R C M C Rᵀ),
S = 1 + R C Rᵀ, where M weighs the unknowns: the tool point's variance over the volume (L- or I-optimality), the determinant (D: M is
the inverse of the machine's own covariance), the worst direction (E: M is its projector), or a few errors by name.
(Fedorov 1972; Atkinson, Donev and Tobias 2007, chapters 10 to 12.)
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Final, final

import numpy as np

Say = Callable[[str, float], None]
AFRESH: Final = 50
"""Choices after which the covariance is found anew from all of them: updates add up their rounding."""
DRAWN: Final = 128
"""Candidates each choice is made among."""
EXCHANGED: Final = (0.9, 0.3, 0.3)
"""Shares of a plan exchanged one after the other."""


class Aim(ABC):
    """What a plan is to make small."""

    name: str
    unit: str

    @abstractmethod
    def weight(self, covariance: np.ndarray) -> np.ndarray:
        """(f, f) M: derivative of what is aimed at by the covariance (f, f)."""

    @abstractmethod
    def value(self, covariance: np.ndarray) -> float:
        """What is aimed at, in a unit that says something; smaller is better."""


@final
class AtTool(Aim):
    """RMS standard uncertainty of the tool point over the volume, µm; or of anything else that is linear in the unknowns.

    Args:
        derivatives: (n, k, f) by the coordinates.
        name: of the aim.
        unit: of its value.
    """

    def __init__(self, derivatives: np.ndarray, name: str = "tool", unit: str = "µm") -> None:
        self.name = name
        self.unit = unit
        flat = derivatives.reshape(-1, derivatives.shape[-1])
        self._matrix = flat.T @ flat / len(derivatives)

    def weight(self, covariance: np.ndarray) -> np.ndarray:
        """See `Aim.weight`."""
        return self._matrix

    def value(self, covariance: np.ndarray) -> float:
        """See `Aim.value`."""
        return float(np.sqrt(np.sum(self._matrix * covariance)))


@final
class Everything(Aim):
    """D-optimality: the mean logarithm of the machine's own standard uncertainties in all directions.

    Args:
        machine: (m, f) the machine's unknowns as directions among the coordinates, orthonormal rows.
    """

    name = "everything"
    unit = "in logarithm, a direction"

    def __init__(self, machine: np.ndarray) -> None:
        self._machine = machine

    def weight(self, covariance: np.ndarray) -> np.ndarray:
        """See `Aim.weight`."""
        own = self._machine @ covariance @ self._machine.T
        return np.asarray(self._machine.T @ np.linalg.solve(own, self._machine))

    def value(self, covariance: np.ndarray) -> float:
        """See `Aim.value`."""
        return float(np.linalg.slogdet(self._machine @ covariance @ self._machine.T)[1]) / (2.0 * len(self._machine))


@final
class Weakest(Aim):
    """E-optimality: the standard uncertainty of the direction known worst, as a share of what was plausible before.

    Args:
        machine: as of `Everything`.
        prior: (f, f) precision before any reading.
    """

    name = "weakest"
    unit = "of what is plausible"

    def __init__(self, machine: np.ndarray, prior: np.ndarray) -> None:
        root = np.linalg.cholesky(machine @ np.linalg.inv(prior) @ machine.T)
        self._machine = np.linalg.solve(root, machine)

    def weight(self, covariance: np.ndarray) -> np.ndarray:
        """See `Aim.weight`."""
        values, vectors = np.linalg.eigh(self._machine @ covariance @ self._machine.T)
        # The few worst together: the single worst one changes with every reading.
        power = (values / values[-1]) ** 8
        turned = vectors.T @ self._machine
        return np.asarray(turned.T @ (power[:, None] * turned))

    def value(self, covariance: np.ndarray) -> float:
        """See `Aim.value`."""
        return float(np.sqrt(np.linalg.eigvalsh(self._machine @ covariance @ self._machine.T)[-1]))


def covariance_of(prior: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(f, f) covariance of the coordinates, known before with precision (f, f), after readings with derivatives (n, 3, f)."""
    flat = rows.reshape(-1, rows.shape[-1])
    return inverse(prior + flat.T @ flat)


def inverse(precision: np.ndarray) -> np.ndarray:
    """Of a precision, brought to a unit diagonal first: stations are known to metres before and to micrometres after."""
    size = 1.0 / np.sqrt(np.diag(precision))
    found = np.linalg.inv(precision * size[:, None] * size)
    return np.asarray((found + found.T) / 2.0 * size[:, None] * size)


def choose(
    prior: np.ndarray,
    rows: np.ndarray,
    cost: np.ndarray,
    aim: Aim,
    count: int,
    first: np.ndarray,
    *,
    least: int,
    most: int = 4,
    exchanged: tuple[float, ...] = EXCHANGED,
    among: int = DRAWN,
    say: Say | None = None,
) -> np.ndarray:
    """Indices of the readings of a plan, in the order of choice, a few more than once.

    Args:
        prior: (f, f) precision of the coordinates before any reading.
        rows: (n, 3, f) derivatives of every candidate.
        cost: (n,) seconds of each.
        aim: what to make small.
        count: how many readings.
        first: every candidate, in an order that any beginning of is spread evenly: the plan that is bettered.
        least: readings that the choice begins with at least.
        most: times one candidate may be taken.
        exchanged: shares of the plan exchanged, one after the other.
        among: how many candidates each choice is made among.
        say: told how far it is.
    """
    spread = np.concatenate([first] * (1 + (count - 1) // max(len(first), 1)))[:count]
    best, value = list(spread), aim.value(covariance_of(prior, rows[spread]))
    for number, share in enumerate(exchanged):
        # Something has to place stations and targets: a reading of a target that nothing places tells nothing, so that a choice cannot
        # begin with none. It begins with part of an even spread, then exchanges; what does not pay is not done.
        fewer = max(1, round(share * count))
        chosen = _kept(prior, rows, aim, best, fewer) if number else best[: max(count - fewer, min(least, count))]
        _grow(prior, rows, cost, aim, chosen, count, most, among, say, number / len(exchanged), 1.0 / len(exchanged))
        reached = aim.value(covariance_of(prior, rows[chosen]))
        if reached < value:
            best, value = chosen, reached
    return np.array(best)


def _grow(
    prior: np.ndarray,
    rows: np.ndarray,
    cost: np.ndarray,
    aim: Aim,
    chosen: list[int],
    count: int,
    most: int,
    among: int,
    say: Say | None,
    done: float,
    share: float,
) -> None:
    """Add readings, each time the best for its time of some drawn at random (stochastic greedy; Mirzasoleiman et al. 2015)."""
    begun = len(chosen)
    taken = np.bincount(chosen, minlength=len(rows))
    rng = np.random.default_rng(begun)
    covariance, weight = np.zeros((0, 0)), np.zeros((0, 0))
    while len(chosen) < count:
        if (len(chosen) - begun) % AFRESH == 0:
            covariance = covariance_of(prior, rows[chosen])
            weight = aim.weight(covariance)
            if say is not None:
                say("choosing", done + share * (len(chosen) - begun) / max(count - begun, 1))
        left = np.flatnonzero(taken < most)
        if not len(left):
            return
        drawn = rng.choice(left, min(among, len(left)), replace=False)
        best = int(drawn[np.argmax(gains(rows[drawn], covariance, weight) / cost[drawn])])
        chosen.append(best)
        taken[best] += 1
        covariance = _after(covariance, rows[best])


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


def _kept(prior: np.ndarray, rows: np.ndarray, aim: Aim, chosen: list[int], fewer: int) -> list[int]:
    """Those left when the readings that tell least are taken out."""
    picked = rows[chosen]
    covariance = covariance_of(prior, picked)
    weight = aim.weight(covariance)
    spread = picked @ covariance
    own = np.eye(3) - np.einsum("nif,njf->nij", spread, picked)
    moved = np.einsum("nif,njf->nij", spread @ weight, spread)
    # Alone, a reading that nothing else replaces leaves no finite loss.
    safe = np.linalg.eigvalsh(own)[:, 0] > 1e-6
    loss = np.full(len(chosen), np.inf)
    loss[safe] = np.einsum("nii->n", np.linalg.solve(own[safe], moved[safe]))
    gone = set(np.argsort(loss, kind="stable")[:fewer].tolist())
    return [index for k, index in enumerate(chosen) if k not in gone]
