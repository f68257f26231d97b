"""Selection of rows: outliers are set aside, unless causes that the other rows show explain them."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin.diagnosis.estimate.estimate import estimate
from twin.diagnosis.problem.forms import Candidates
from twin.diagnosis.problem.problem import Problem
from twin.diagnosis.problem.readings import ITERATIONS, DiagnosisTask, Readings
from twin.diagnosis.selection.search import candidates_of, largest_causes
from twin.identification.outliers import outliers

WITNESSES: Final = 3
"""Number of outliers below which no cause is sought for them."""
CLEAR: Final = 3
"""Largest number of causes sought to explain outliers."""
TAKEN_BACK: Final = (1.0, 0.9, 0.5)
"""Shares of the outliers, smallest first, that are tested again: all, or without the largest (a lost beam, for example)."""
LOOKED_AT: Final = 20_000
"""Number of rows used to test whether causes explain the outliers."""
SEED: Final = 1964


def exclude_outliers(placed: Readings) -> DiagnosisTask:
    """Return the problem without outliers: whitened rows and the causes to test.

    Args:
        placed: all rows, with the stations placed.
    """
    few = np.count_nonzero(placed.bad) < WITNESSES
    return placed.without(placed.bad if few else _still_bad(placed))


def _still_bad(placed: Readings) -> np.ndarray:
    """Return (n,) which rows are outliers: the initial ones, unless causes explain more than half of them.

    A cause of such large residuals shows in other rows as well, so for very many rows a sample is used.
    """
    count, bad = len(placed.bad), np.flatnonzero(placed.bad)
    if count > LOOKED_AT and len(bad) < LOOKED_AT // 4:
        drawn = np.random.default_rng(SEED).choice(np.flatnonzero(~placed.bad), LOOKED_AT - len(bad), replace=False)
        rows = np.sort(np.concatenate([bad, drawn]))
        found = np.zeros(count, dtype=bool)
        found[rows] = _still_bad(placed.select_rows(rows))
        return found
    everything = placed.without(np.zeros(len(placed.bad), dtype=bool))
    whole, candidates = everything.problem, candidates_of(everything)
    size = np.linalg.norm(placed.network.residual(np.zeros(0), placed.setup), axis=1)
    for share in TAKEN_BACK:
        bad = placed.bad & (size > np.quantile(size[placed.bad], share))
        for _ in range(ITERATIONS):
            still = _beyond(placed, whole, candidates, bad)
            settled = np.count_nonzero(still & ~bad) == 0 and np.count_nonzero(still) > 0.9 * np.count_nonzero(bad)
            if settled or np.count_nonzero(still) > 0.5 * np.count_nonzero(placed.bad):
                break
            bad = still
        if np.count_nonzero(still) <= 0.5 * np.count_nonzero(placed.bad):
            return still
    return placed.bad


def _beyond(placed: Readings, whole: Problem, candidates: Candidates, bad: np.ndarray) -> np.ndarray:
    """Return (n,) which rows are outliers after removing the causes that the other rows show."""
    part = whole.without(bad) if np.any(bad) else whole
    if part is None:
        return placed.bad
    forms = largest_causes(candidates.on_part(part), CLEAR)
    left = whole.residual - estimate(part, forms).signature.sum(axis=1)
    return outliers(placed.network, part.refit_setup(left).reshape(-1, 3))
