"""Readings left out of a fit: what causes fitted to the others predict of them, and which causes only overfit.

What is held out is what the claim is about: a function of position is held out at positions, or poses; a change in time in rounds, or
blocks of time.

If the stated noise is small, every part of an unmodelled error is significant. Forty parameters then fit twenty poses and fail at the
twenty-first. The number of causes is chosen by cross-validation (Stone 1974).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np

from twin._common.distributions import student_isf
from twin.diagnosis.candidates.candidate import Candidate
from twin.diagnosis.problem.forms import Candidates, Form, columns_of, log_p_value
from twin.diagnosis.problem.problem import Problem, rms, unwhiten, unwhitened_um
from twin.diagnosis.selection.likelihood import Likelihood
from twin.machine.effects.names import axis_of
from twin.machine.machine import Machine
from twin.measurement.table import Measurements

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


def foretold(problem: Problem, part: Candidates, forms: Sequence[Form]) -> np.ndarray:
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


def foretells(candidates: Candidates, form: Form, forms: Sequence[Form]) -> bool:
    """Whether a function of an axis's position foretells positions of that axis that were left out of its fit.

    A variant of another effect has to foretell more than that does: a reversal that changes along the travel more than the plain one.

    Args:
        candidates: the data.
        form: the cause.
        forms: all causes.
    """
    if not form.candidate.specification.curve:
        return True
    machine, data = candidates.problem.network.machine, candidates.problem.network.data
    where = form.candidate.where
    axis = machine.names.index(axis_of(where))
    if len(np.unique(np.round(data.positions[:, axis], 3))) > DENSE:
        return True
    split = at_positions(data, [axis])
    if split is None:
        return False
    others = [one for one in forms if one is not form]
    if form.candidate.specification.variant_of:
        others += [one for one in candidates.forms if one.key == (form.candidate.specification.variant_of, where)]
    gained = positions_held_out(candidates, form, others, split)
    return gained is not None and gained[0] > 0.0


def positions_held_out(
    candidates: Candidates, form: Form, others: Sequence[Form], split: Parts
) -> tuple[float, float] | None:
    """95 % interval of what one cause gains at positions that it was not fitted to, all others kept; None where none is given.

    Args:
        candidates: the data.
        form: the cause.
        others: the other causes.
        split: the positions.
    """

    def judged(small: Candidates) -> tuple[np.ndarray, np.ndarray]:
        return foretold(candidates.problem, small, others), foretold(candidates.problem, small, [*others, form])

    table = on_parts(candidates, split, judged)
    return None if table is None else interval(table)


def on_parts(
    candidates: Candidates, split: Parts, judged: Callable[[Candidates], Sequence[np.ndarray]]
) -> np.ndarray | None:
    """(groups, models + 1) sums of squares of what is held out, µm², with each model, and how many values.

    Args:
        candidates: all data.
        split: what is held out together.
        judged: the rest of the data → (3n,) what each model, fitted to it, does to the whitened readings, all of them.
    """
    problem = candidates.problem
    table: np.ndarray | None = None
    for k in range(int(split.part.max()) + 1):
        rows = split.part == k
        part = problem.without(rows)
        if part is None:
            return None
        small = candidates.on_part(part)
        squares = []
        for made in judged(small):
            left = part.refit_setup(problem.residual - made).reshape(-1, 3, 1)[rows]
            squares.append(np.sum((unwhiten(problem, left, rows)[:, :, 0] * 1e6) ** 2, axis=1))
        read = np.count_nonzero(problem.network.read[rows], axis=1).astype(float)
        counted = np.stack([*squares, read], axis=1)
        table = np.zeros((int(split.group.max()) + 1, counted.shape[1])) if table is None else table
        np.add.at(table, split.group[rows], counted)
    return table


FOLDS: Final = 8
"""Parts at most."""
SEED: Final = 2001
BLOCKS: Final = 8
"""Parts of one long round, in time."""
HeldOutOf = Literal["rounds", "positions", "poses", "blocks"]


@final
@dataclass(frozen=True)
class Parts:
    """What is held out together.

    Attributes:
        of: ``rounds``, ``positions`` of the one axis that moved, ``poses``, or ``blocks`` of time.
        group: (n,) the independent group of each reading.
        part: (n,) the part it is held out with: whole groups, drawn at random.
    """

    of: HeldOutOf
    group: np.ndarray
    part: np.ndarray


def parts(data: Measurements, machine: Machine, causes: Sequence[Candidate]) -> Parts | None:
    """By what the causes claim; None where nothing can be held out.

    Args:
        data: the measurements.
        machine: the machine.
        causes: that were found.
    """
    changing = bool(causes) and all(cause.specification.varies == "with time" for cause in causes)
    if not changing:
        moved = [i for i in range(len(machine.axes)) if np.ptp(data.positions[:, i]) > 0.0]
        if moved:
            found = at_positions(data, moved)
            if found is not None:
                return found
    return in_time(data)


def in_time(data: Measurements) -> Parts | None:
    """Rounds, or blocks of time where there is but one round; None for too few readings.

    Args:
        data: the measurements.
    """
    _, group = np.unique(data.round.astype(str), return_inverse=True)
    if group.max() > 0:
        return _drawn("rounds", group.reshape(-1))
    if len(data) < 2 * BLOCKS:
        return None
    order = np.argsort(data.time_s, kind="stable") if np.all(np.isfinite(data.time_s)) else np.arange(len(data))
    group = np.empty(len(data), dtype=int)
    group[order] = np.arange(len(data)) * BLOCKS // len(data)
    return Parts("blocks", group, group)


def at_positions(data: Measurements, axes: Sequence[int]) -> Parts | None:
    """Positions of one axis, or poses of several; None where there is but one.

    Args:
        data: the measurements.
        axes: numbers of those that moved.
    """
    _, group = np.unique(np.round(data.positions[:, list(axes)], 3), axis=0, return_inverse=True)
    group = group.reshape(-1)
    return _drawn("positions" if len(axes) == 1 else "poses", group) if group.max() > 0 else None


def _drawn(of: HeldOutOf, group: np.ndarray) -> Parts:
    count = int(group.max()) + 1
    return Parts(of, group, (np.random.default_rng(SEED).permutation(count) % min(count, FOLDS))[group])


PLENTY: Final = 20
"""Degrees of freedom per parameter above which overfitting is negligible."""
OVERFITTED: Final = 1.25
"""Ratio of the RMS residual of held-out readings to that of the fit above which the fit is checked for too many causes."""


def held_up(candidates: Candidates, forms: Sequence[Form]) -> list[Form]:
    """The causes without those that only overfit; all of them unless held-out readings fit much worse than the others.

    Causes enter in order of the chi² they explain, and each must be significant against the residual after it (F-to-enter, Efroymson
    1960). Of these the smallest number is kept whose held-out error is within one standard error of the minimum (Breiman and others
    1984). If only one axis moved, causes that are not promised (`twin.diagnosis.selection.left_out.foretells`) are kept: they make no
    claim between the measured positions.

    Args:
        candidates: the data.
        forms: the causes.
    """
    if PLENTY * len(columns_of(forms)) < candidates.problem.dof:
        return list(forms)
    split = parts(
        candidates.problem.network.data, candidates.problem.network.machine, [form.candidate for form in forms]
    )
    if split is None or split.of not in ("positions", "poses") or split.group.max() + 1 < ENOUGH:
        return list(forms)
    claimed = _by_entry(
        candidates, [form for form in forms if split.of == "poses" or foretells(candidates, form, forms)]
    )

    def judged(small: Candidates) -> list[np.ndarray]:
        return [foretold(candidates.problem, small, claimed[:k]) for k in range(len(claimed) + 1)]

    table = on_parts(candidates, split, judged)
    if table is None or table[:, -2].sum() / table[:, -1].sum() <= (OVERFITTED * _in_fit(candidates, claimed)) ** 2:
        return list(forms)
    gone = {form.index for form in claimed[_fewest(table[:, : _beyond_rest(candidates, claimed) + 1]) :]}
    return [form for form in forms if form.index not in gone]


def _beyond_rest(candidates: Candidates, forms: Sequence[Form]) -> int:
    """Number of forms, entered in this order, that are significant against the residual (F-to-enter)."""
    problem, free = candidates.problem, float(candidates.problem.dof)
    for k, form in enumerate(forms):
        explained, dof, _ = candidates.scores(forms[:k], [form.index])[0]
        free -= dof
        left = (problem.chi2 - candidates.explained_by(forms[: k + 1])) / max(free, 1.0)
        chance = log_p_value(np.array(explained / max(left, 1.0)), max(float(dof), 1.0), max(free, 1.0))
        if float(chance) + form.log_tests > np.log(candidates.level):
            return k
    return len(forms)


def _fewest(squares: np.ndarray) -> int:
    """Number of causes: of (groups, causes + 1) sums of squares with none, the first, the first two and so on."""
    worse = squares - squares[:, [int(np.argmin(squares.sum(axis=0)))]]
    error = np.sqrt(len(squares)) * worse.std(axis=0, ddof=1)
    return int(np.argmax(worse.sum(axis=0) <= error))


def _by_entry(candidates: Candidates, forms: Sequence[Form]) -> list[Form]:
    """In the order in which each explains most beside those before it."""
    rest, entered = list(forms), list[Form]()
    while rest:
        explained = candidates.scores(entered, [form.index for form in rest])[:, 0]
        entered.append(rest.pop(int(np.argmax(explained))))
    return entered


def _in_fit(candidates: Candidates, forms: Sequence[Form]) -> float:
    """RMS residual of the fit, µm."""
    problem = candidates.problem
    residual = problem.project(problem.residual - foretold(problem, candidates, forms))
    return rms(unwhitened_um(problem, residual), problem.network.read)
