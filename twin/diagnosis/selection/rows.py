"""Which rows count: those too far off to be chance are left out, unless causes that the other rows show account for them."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin.diagnosis.estimate.estimate import estimate
from twin.diagnosis.problem.forms import Candidates
from twin.diagnosis.problem.problem import Problem
from twin.diagnosis.problem.readings import ITERATIONS, DiagnosisTask, Readings
from twin.diagnosis.selection.search import candidates_of, glimpse
from twin.identification.outliers import outliers

WITNESSES: Final = 3
"""Rows set aside below which no cause can be read off them."""
CLEAR: Final = 3
"""Causes, at most, that rows too far off are blamed on."""
TAKEN_BACK: Final = (1.0, 0.9, 0.5)
"""Shares of the rows set aside, the least far off first, that are looked at again: all, or without what lost its beam as well."""
LOOKED_AT: Final = 20_000
"""Rows that are enough to see whether one of the causes is why others are too far off."""
SEED: Final = 1964


def diagnosis_task(placed: Readings) -> DiagnosisTask:
    """What is to be solved: the rows that count, whitened, and the causes to try.

    Args:
        placed: all rows.
    """
    few = np.count_nonzero(placed.bad) < WITNESSES
    return placed.without(placed.bad if few else _still_bad(placed))


def _still_bad(placed: Readings) -> np.ndarray:
    """(n,) rows that are too far off whatever the cause: those of the start, unless causes account for more than half of them.

    What moves rows so far shows in some of the others as well: of very many, some are looked at.
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
    """(n,) rows too far off once the causes that the other rows show are taken out of all."""
    part = whole.without(bad) if np.any(bad) else whole
    if part is None:
        return placed.bad
    forms = glimpse(candidates.on_part(part), CLEAR)
    left = whole.residual - estimate(part, forms).signature.sum(axis=1)
    return outliers(placed.network, part.refit_setup(left).reshape(-1, 3))
