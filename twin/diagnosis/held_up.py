"""Causes that hold at positions and poses that their fit has not seen: to few readings many causes fit, and foretell nothing.

A small scatter, stated or presumed, lets every part of a misfit that nobody knows be significant. What was fitted to twenty poses
with forty numbers is then "explained", and wrong at the twenty-first. As many causes are kept as foretell best (cross-validation,
Stone 1974).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from twin.diagnosis.folds import parts
from twin.diagnosis.gain import ENOUGH, foretells, foretold, on_parts, plain
from twin.diagnosis.pool import Form, Pool, log_chance, together

PLENTY: Final = 20
"""Degrees of freedom a parameter from which on a fit cannot be much nearer to its readings than to others."""
OVERFITTED: Final = 1.25
"""RMS at what was left out, by that in the fit, from which on there may be more causes than the readings carry."""


def held_up(pool: Pool, forms: Sequence[Form]) -> list[Form]:
    """Causes without those that only fit: all of them unless what was left out is much farther off than what was fitted.

    In the order in which they explain most, each must be beyond what is left when it has entered, be that scatter or not (F to enter;
    Efroymson 1960). Of those, the fewest are kept that foretell as well as the best number does, within a standard error of the
    difference between groups (Breiman and others 1984, the one-standard-error rule). Where one axis moved, causes that are
    not promised (`twin.diagnosis.gain.foretells`) claim nothing between the positions, and stay.

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
    if table is None or table[:, -2].sum() / table[:, -1].sum() <= OVERFITTED**2 * _in_fit(pool, claimed):
        return list(forms)
    gone = {form.index for form in claimed[_fewest(table[:, : _beyond_rest(pool, claimed) + 1]) :]}
    return [form for form in forms if form.index not in gone]


def _beyond_rest(pool: Pool, forms: Sequence[Form]) -> int:
    """How many forms, entered in this order, are beyond what is left."""
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
    """Mean square of what is left in the fit, µm²."""
    problem = pool.problem
    left = problem.project(problem.residual - foretold(problem, pool, forms))
    return float(np.sum((plain(problem, left.reshape(-1, 3, 1)) * 1e6) ** 2) / np.count_nonzero(problem.network.read))
