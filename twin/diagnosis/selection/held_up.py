"""Causes that predict positions and poses that were not in their fit: with few readings, many causes fit and predict nothing.

If the stated noise is small, every part of an unmodelled error is significant. Forty parameters then fit twenty poses and fail at the
twenty-first. The number of causes is chosen by cross-validation (Stone 1974).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from twin.diagnosis.problem.pool import Form, Pool, log_chance, together
from twin.diagnosis.problem.problem import rms, unwhitened
from twin.diagnosis.selection.folds import parts
from twin.diagnosis.selection.left_out import ENOUGH, foretells, foretold, on_parts

PLENTY: Final = 20
"""Degrees of freedom per parameter above which overfitting is negligible."""
OVERFITTED: Final = 1.25
"""Ratio of the RMS residual of held-out readings to that of the fit above which the fit is checked for too many causes."""


def held_up(pool: Pool, forms: Sequence[Form]) -> list[Form]:
    """The causes without those that only overfit; all of them unless held-out readings fit much worse than the others.

    Causes enter in order of the chi² they explain, and each must be significant against the residual after it (F-to-enter, Efroymson
    1960). Of these the smallest number is kept whose held-out error is within one standard error of the minimum (Breiman and others
    1984). If only one axis moved, causes that are not promised (`twin.diagnosis.selection.left_out.foretells`) are kept: they make no
    claim between the measured positions.

    Args:
        pool: the data.
        forms: the causes.
    """
    if PLENTY * len(together(forms)) < pool.problem.dof:
        return list(forms)
    split = parts(pool.problem.network.data, pool.problem.network.machine, [form.candidate for form in forms])
    if split is None or split.of not in ("positions", "poses") or split.group.max() + 1 < ENOUGH:
        return list(forms)
    claimed = _by_entry(pool, [form for form in forms if split.of == "poses" or foretells(pool, form, forms)])

    def judged(small: Pool) -> list[np.ndarray]:
        return [foretold(pool.problem, small, claimed[:k]) for k in range(len(claimed) + 1)]

    table = on_parts(pool, split, judged)
    if table is None or table[:, -2].sum() / table[:, -1].sum() <= (OVERFITTED * _in_fit(pool, claimed)) ** 2:
        return list(forms)
    gone = {form.index for form in claimed[_fewest(table[:, : _beyond_rest(pool, claimed) + 1]) :]}
    return [form for form in forms if form.index not in gone]


def _beyond_rest(pool: Pool, forms: Sequence[Form]) -> int:
    """Number of forms, entered in this order, that are significant against the residual (F-to-enter)."""
    problem, free = pool.problem, float(pool.problem.dof)
    for k, form in enumerate(forms):
        explained, dof, _ = pool.scores(forms[:k], [form.index])[0]
        free -= dof
        left = (problem.chi2 - pool.explained_by(forms[: k + 1])) / max(free, 1.0)
        chance = log_chance(np.array(explained / max(left, 1.0)), max(float(dof), 1.0), max(free, 1.0))
        if float(chance) + form.price > np.log(pool.level):
            return k
    return len(forms)


def _fewest(squares: np.ndarray) -> int:
    """Number of causes: of (groups, causes + 1) sums of squares with none, the first, the first two and so on."""
    worse = squares - squares[:, [int(np.argmin(squares.sum(axis=0)))]]
    error = np.sqrt(len(squares)) * worse.std(axis=0, ddof=1)
    return int(np.argmax(worse.sum(axis=0) <= error))


def _by_entry(pool: Pool, forms: Sequence[Form]) -> list[Form]:
    """In the order in which each explains most beside those before it."""
    rest, entered = list(forms), list[Form]()
    while rest:
        explained = pool.scores(entered, [form.index for form in rest])[:, 0]
        entered.append(rest.pop(int(np.argmax(explained))))
    return entered


def _in_fit(pool: Pool, forms: Sequence[Form]) -> float:
    """RMS residual of the fit, µm."""
    problem = pool.problem
    residual = problem.project(problem.residual - foretold(problem, pool, forms))
    return rms(unwhitened(problem, residual), problem.network.read)
