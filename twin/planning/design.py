"""Which readings to take: one after the other, always the one that tells most for its time, then the poorest exchanged.

With C the covariance of all unknowns so far and R the whitened derivatives of a reading, what is aimed at falls by tr(S⁻¹ R C M C Rᵀ),
S = 1 + R C Rᵀ, where M weighs the unknowns: the tool point's variance over the volume (L- or I-optimality), the determinant (D: M is
the inverse of the machine's own covariance), the worst direction (E: M is its projector), or a few errors by name.
(Fedorov 1972; Atkinson, Donev and Tobias 2007, chapters 10 to 12.)
"""

from __future__ import annotations

import heapq
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Final, final

import numpy as np

Say = Callable[[str, float], None]
SEED_SHARE: Final = 0.1
"""Share of a plan that is spread evenly before the choice begins: without it nothing places stations and targets."""
AFRESH: Final = 100
"""Choices after which the covariance is found anew from all of them: updates add up their rounding."""
AT_ONCE: Final = 8
EXCHANGED: Final = 0.15
PASSES: Final = 1


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
    """

    def __init__(self, derivatives: np.ndarray, name: str = "tool") -> None:
        self.name = name
        self.unit = "µm" if name == "tool" else "µm and µrad"
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
    most: int = 4,
    say: Say | None = None,
) -> np.ndarray:
    """Indices of the readings of a plan, in the order of choice, a few more than once.

    Args:
        prior: (f, f) precision of the coordinates before any reading.
        rows: (n, 3, f) derivatives of every candidate.
        cost: (n,) seconds of each.
        aim: what to make small.
        count: how many readings.
        first: candidates that a plan begins with, spread evenly (`SEED_SHARE` of it).
        most: times one candidate may be taken.
        say: told how far it is.
    """
    chosen = list(first[: max(1, round(SEED_SHARE * count))])
    rounds = 1 + PASSES
    for number in range(rounds):
        if number:
            chosen = _kept(prior, rows, aim, chosen, max(1, round(EXCHANGED * count)))
        _grow(prior, rows, cost, aim, chosen, count, most, say, number / rounds, 1.0 / rounds)
    return np.array(chosen)


def _grow(
    prior: np.ndarray,
    rows: np.ndarray,
    cost: np.ndarray,
    aim: Aim,
    chosen: list[int],
    count: int,
    most: int,
    say: Say | None,
    done: float,
    share: float,
) -> None:
    """Add readings, the best for its time each time; what was worth little is not looked at again until the others are worth less."""
    begun = len(chosen)
    taken = np.bincount(chosen, minlength=len(rows))
    while len(chosen) < count:
        covariance = covariance_of(prior, rows[chosen])
        weight = aim.weight(covariance)
        heap = [(-float(g), int(i)) for i, g in enumerate(gains(rows, covariance, weight) / cost) if taken[i] < most]
        if not heap:
            return
        heapq.heapify(heap)
        for _ in range(min(AFRESH, count - len(chosen))):
            best, gain = None, 0.0
            while heap:
                # Some at a time: what is looked at anew mostly is no longer the best.
                some = [heapq.heappop(heap)[1] for _ in range(min(AT_ONCE, len(heap)))]
                found = gains(rows[some], covariance, weight) / cost[some]
                top = int(np.argmax(found))
                for k, i in enumerate(some):
                    if k != top:
                        heapq.heappush(heap, (-float(found[k]), i))
                if not heap or found[top] >= -heap[0][0] * (1.0 - 1e-12):
                    best, gain = some[top], float(found[top])
                    break
                heapq.heappush(heap, (-float(found[top]), some[top]))
            if best is None:
                return
            chosen.append(best)
            taken[best] += 1
            if taken[best] < most:
                heapq.heappush(heap, (-gain, best))
            covariance = _after(covariance, rows[best])
        if say is not None:
            say("choosing", done + share * (len(chosen) - begun) / max(count - begun, 1))


def gains(rows: np.ndarray, covariance: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(n,) by how much what is aimed at falls with each of some readings (n, 3, f)."""
    spread = rows @ covariance
    own = np.einsum("nif,njf->nij", spread, rows) + np.eye(3)
    moved = np.einsum("nif,njf->nij", spread @ weight, spread)
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
