"""Readings left out of a fit: what causes fitted to the others foretell of them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Final

import numpy as np

from twin._common.distributions import student_isf
from twin.diagnosis.problem.pool import Form, Pool
from twin.diagnosis.problem.problem import Problem, plain
from twin.diagnosis.selection.folds import Parts, at_positions
from twin.diagnosis.selection.likelihood import Likelihood
from twin.machine.effects.names import axis_of

DENSE: Final = 20
"""Positions of an axis from which on what repeats at them holds between them as well."""
ENOUGH: Final = 6
"""Independent groups below which no interval is given."""


def foretold_patterns(likelihood: Likelihood, forms: Sequence[Form], written: Collection[int]) -> np.ndarray:
    """(3n,) what some patterns, fitted to a part of the readings beside causes, do to all of them.

    Args:
        likelihood: the patterns on that part.
        forms: the causes.
        written: numbers of the patterns.
    """
    which, values, _ = likelihood.most_likely(likelihood.fit(forms), likelihood.slope_beside(forms))
    own = np.isin(likelihood.group[which] // 3, list(written))
    return likelihood.made(which[own], values[own])


def foretold(problem: Problem, part: Pool, forms: Sequence[Form]) -> np.ndarray:
    """(3n,) what causes fitted to a part of the readings do to all of them.

    Nothing along what that part does not see: it would be noise times a lever on the rest.
    """
    columns, values, _ = part.fitted(forms)
    signature = problem.signature([part.products.columns[i] for i in columns])
    return np.asarray(signature @ values)


def interval(table: np.ndarray) -> tuple[float, float] | None:
    """95 % interval of the difference of two RMS values, by leaving out one group at a time; None for fewer than `ENOUGH`.

    The jackknife's pseudo-values with Student's t (Tukey 1958): groups, not readings, are independent.

    Args:
        table: (groups, 3) sums of squares before and after, and how many values.
    """
    count = len(table)
    if count < ENOUGH:
        return None
    total = table.sum(axis=0)
    rest = np.maximum(total - table, 0.0)
    used = np.maximum(rest[:, 2], 1.0)
    whole = float(np.sqrt(total[0] / total[2]) - np.sqrt(total[1] / total[2]))
    without = np.sqrt(rest[:, 0] / used) - np.sqrt(rest[:, 1] / used)
    pseudo = count * whole - (count - 1) * without
    half = float(student_isf(0.025, count - 1) * pseudo.std(ddof=1) / np.sqrt(count))
    return whole - half, whole + half


def foretells(pool: Pool, form: Form, forms: Sequence[Form]) -> bool:
    """Whether a function of an axis's position foretells positions of that axis that were left out of its fit.

    A variant of another effect has to foretell more than that does: a reversal that changes along the travel more than the plain one.

    Args:
        pool: the data.
        form: the cause.
        forms: all causes.
    """
    if not form.candidate.specification.curve:
        return True
    machine, data = pool.problem.network.machine, pool.problem.network.data
    where = form.candidate.where
    axis = machine.names.index(axis_of(where))
    if len(np.unique(np.round(data.positions[:, axis], 3))) > DENSE:
        return True
    split = at_positions(data, [axis])
    if split is None:
        return False
    others = [one for one in forms if one is not form]
    if form.candidate.specification.more_of:
        others += [one for one in pool.forms if one.key == (form.candidate.specification.more_of, where)]
    gained = positions_held_out(pool, form, others, split)
    return gained is not None and gained[0] > 0.0


def positions_held_out(pool: Pool, form: Form, others: Sequence[Form], split: Parts) -> tuple[float, float] | None:
    """95 % interval of what one cause gains at positions that it was not fitted to, all others kept; None where none is given.

    Args:
        pool: the data.
        form: the cause.
        others: the other causes.
        split: the positions.
    """

    def judged(small: Pool) -> tuple[np.ndarray, np.ndarray]:
        return foretold(pool.problem, small, others), foretold(pool.problem, small, [*others, form])

    table = on_parts(pool, split, judged)
    return None if table is None else interval(table)


def on_parts(pool: Pool, split: Parts, judged: Callable[[Pool], Sequence[np.ndarray]]) -> np.ndarray | None:
    """(groups, models + 1) sums of squares of what is held out, µm², with each model, and how many values.

    Args:
        pool: all data.
        split: what is held out together.
        judged: the rest of the data → (3n,) what each model, fitted to it, does to the whitened readings, all of them.
    """
    problem = pool.problem
    table: np.ndarray | None = None
    for k in range(int(split.part.max()) + 1):
        rows = split.part == k
        part = problem.without(rows)
        if part is None:
            return None
        small = pool.on(part)
        squares = []
        for made in judged(small):
            left = part.following(problem.residual - made).reshape(-1, 3, 1)[rows]
            squares.append(np.sum((plain(problem, left, rows)[:, :, 0] * 1e6) ** 2, axis=1))
        read = np.count_nonzero(problem.network.read[rows], axis=1).astype(float)
        counted = np.stack([*squares, read], axis=1)
        table = np.zeros((int(split.group.max()) + 1, counted.shape[1])) if table is None else table
        np.add.at(table, split.group[rows], counted)
    return table
