"""Cross-validation: prediction of held-out readings by causes fitted to the others, and removal of causes that overfit.

What is held out depends on the claim: positions or poses for a function of position; rounds or blocks of time for a change in time. If
the stated noise is small, every part of an unmodelled error is significant: forty parameters then fit twenty poses and fail at the
twenty-first. The number of causes is chosen by cross-validation (Stone 1974).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np

from twin._common.arrays import first_largest
from twin._common.distributions import student_isf
from twin.diagnosis.candidates.candidate import Candidate
from twin.diagnosis.forms import Candidates, Form, columns_of, log_p_value
from twin.diagnosis.likelihood import Likelihood
from twin.diagnosis.problem import Problem, in_um, rms, unwhiten
from twin.diagnosis.signature_products import Signatures
from twin.machine.machine import Machine
from twin.measurement.observation import order_in_time
from twin.measurement.table import Measurements
from twin.model.effects.base import axis_of

DENSE_POSITIONS: Final = 20  # number of positions of an axis above which a curve is taken to be valid between them
GROUPS_FOR_AN_INTERVAL: Final = 6  # smallest number of independent groups for a confidence interval


def predicted_pattern_shift(likelihood: Likelihood, forms: Sequence[Form], written: Collection[int]) -> np.ndarray:
    """Return the (3n,) prediction for all readings of the written patterns, fitted with the causes to a part of the readings."""
    which, values, _ = likelihood.most_likely(likelihood.fit(forms), likelihood.slope_beside(forms))
    in_file = np.isin(likelihood.group[which] // 3, list(written))
    return likelihood.effect_on_readings(which[in_file], values[in_file])


def predicted_shift(problem: Problem, part: Candidates, forms: Sequence[Form]) -> np.ndarray:
    """Return the (3n,) prediction for all readings of causes fitted to a part of them.

    Directions that the part does not determine are set to zero; they would only amplify noise.
    """
    columns, values, _ = part.fitted(forms)
    signatures = Signatures(problem.view, [part.products.columns[i] for i in columns])
    return signatures.combined(values[:, None]).reshape(-1)


def jackknife_interval(table: np.ndarray) -> tuple[float, float] | None:
    """Return the 95 % confidence interval of the difference of two RMS values; None for fewer than `GROUPS_FOR_AN_INTERVAL` groups.

    From (groups, 3) sums of squares before and after, and number of values, leaving one group out at a time; pseudo-values with
    Student's t (Tukey 1958). Groups, not readings, are independent.
    """
    count = len(table)
    if count < GROUPS_FOR_AN_INTERVAL:
        return None
    total = table.sum(axis=0)
    others = np.maximum(total - table, 0.0)
    values = np.maximum(others[:, 2], 1.0)
    gain = float(np.sqrt(total[0] / total[2]) - np.sqrt(total[1] / total[2]))
    gain_without = np.sqrt(others[:, 0] / values) - np.sqrt(others[:, 1] / values)
    pseudo = count * gain - (count - 1) * gain_without
    half = float(student_isf(0.025, count - 1) * pseudo.std(ddof=1) / np.sqrt(count))
    return gain - half, gain + half


def predicts_held_out(candidates: Candidates, form: Form, forms: Sequence[Form]) -> bool:
    """Return whether a function of an axis's position, one of some causes, predicts held-out positions of that axis.

    A variant of another effect must predict better than that effect, for example a reversal curve better than a constant reversal.
    """
    specification, where = form.candidate.specification, form.candidate.where
    if not specification.curve:
        return True
    data = candidates.problem.network.data
    axis = candidates.problem.network.machine.names.index(axis_of(where))
    if len(np.unique(np.round(data.positions[:, axis], 3))) > DENSE_POSITIONS:
        return True
    folds = folds_at_positions(data, [axis])
    if folds is None:
        return False
    others = [other for other in forms if other is not form]
    if specification.variant_of:
        others += [other for other in candidates.forms if other.key == (specification.variant_of, where)]
    return _predict_better(candidates, folds, others, [*others, form])


def _predict_better(candidates: Candidates, folds: HeldOutFolds, fewer: Sequence[Form], forms: Sequence[Form]) -> bool:
    """Return whether some causes predict held-out readings better than fewer causes do, with 95 % confidence."""

    def predict(part: Candidates) -> list[np.ndarray]:
        return [predicted_shift(candidates.problem, part, model) for model in (fewer, forms)]

    squares = held_out_squares(candidates, folds, predict)
    interval = None if squares is None else jackknife_interval(squares)
    return interval is not None and interval[0] > 0.0


def lines_that_predict(candidates: Candidates, kept: Sequence[Form], forms: Sequence[Form]) -> list[Form]:
    """Return the straight lines of error motions that predict cells of positions which were left out.

    A pattern takes up a straight line as well as any other smooth function, whatever the line's size. Over the whole range a line is
    one number of the machine: it comes first, and the pattern is what it leaves. The lines of ``forms`` that are not kept are tried.
    """
    axes, data = candidates.problem.network.machine.axes, candidates.problem.network.data
    moved = [i for i, axis in enumerate(axes) if axis.linear and np.ptp(data.positions[:, i]) > 0.0]
    cells = cells_of_positions(data, moved) if moved else None
    if cells is None:
        return []
    lines = {
        form.key: form for form in candidates.forms if form.variant.fixed == {"first": 1.0} and len(form.columns) == 1
    }
    taken, chosen = {form.key for form in kept}, list(kept)
    tried = [lines[key] for key in dict.fromkeys(form.key for form in forms) if key not in taken and key in lines]
    # Beside one that is taken another may predict that did not before.
    while tried and (better := [line for line in tried if _predict_better(candidates, cells, chosen, [*chosen, line])]):
        chosen.append(better[0])
        tried.remove(better[0])
    return chosen[len(kept) :]


def held_out_squares(
    candidates: Candidates, split: HeldOutFolds, predict: Callable[[Candidates], Sequence[np.ndarray]]
) -> np.ndarray | None:
    """Return (groups, models + 1): sums of squared held-out residuals of each model, µm², and the number of values; None for none.

    Readings that the others do not place (`Problem.placed_held_out`) do not count.
    ``predict``: data without a fold → (3n,) prediction of each model fitted to them, whitened, for all readings.
    """
    problem = candidates.problem
    table: np.ndarray | None = None
    for k in range(int(split.fold.max()) + 1):
        rows = split.fold == k
        part = problem.without(rows)
        predicted = np.stack(predict(candidates.on_part(part)), axis=1)
        whitened_residual = part.refitted_at_held_out(problem.residual[:, None] - predicted)
        placed = part.placed_held_out[:, None] & problem.network.read[rows]
        off = np.where(placed[:, :, None], unwhiten(problem.network, whitened_residual, rows) * 1e6, 0.0)
        squares, values = np.sum(off**2, axis=1), np.count_nonzero(placed, axis=1).astype(float)
        counted = np.column_stack([squares, values])
        table = np.zeros((int(split.group.max()) + 1, counted.shape[1])) if table is None else table
        np.add.at(table, split.group[rows], counted)
    return table if table is not None and table[:, -1].any() else None


FOLDS: Final = 8  # largest number of folds
CELLS: Final = 8  # number of contiguous cells of positions, at least, of which a part is left out at a time
SEED: Final = 2001
BLOCKS: Final = 8  # number of blocks of time of a single round
HeldOutOf = Literal["rounds", "positions", "poses", "blocks"]


@final
@dataclass(frozen=True)
class HeldOutFolds:
    """Folds of a cross-validation."""

    of: HeldOutOf  # ``positions`` of the one axis that moved, ``poses`` of several, ``blocks`` of time
    group: np.ndarray  # (n,) independent group of each reading
    fold: np.ndarray  # (n,) whole groups, drawn at random


def choose_folds(data: Measurements, machine: Machine, causes: Sequence[Candidate]) -> HeldOutFolds | None:
    """Return the folds suited to the causes; None if nothing can be held out."""
    changing = bool(causes) and all(cause.specification.varies == "with time" for cause in causes)
    moved = [] if changing else [i for i in range(len(machine.axes)) if np.ptp(data.positions[:, i]) > 0.0]
    folds = folds_at_positions(data, moved) if moved else None
    return folds_in_time(data) if folds is None else folds


def folds_in_time(data: Measurements) -> HeldOutFolds | None:
    """Return folds of rounds, or of blocks of time for a single round; None for too few readings."""
    _, group = np.unique(data.round.astype(str), return_inverse=True)
    return _drawn("rounds", group.reshape(-1)) if group.max() > 0 else blocks_of_time(data)


def blocks_of_time(data: Measurements) -> HeldOutFolds | None:
    """Return `BLOCKS` consecutive blocks of readings, one fold each; None for too few readings."""
    if len(data) < 2 * BLOCKS:
        return None
    group = np.empty(len(data), dtype=int)
    group[order_in_time(data)] = np.arange(len(data)) * BLOCKS // len(data)
    return HeldOutFolds("blocks", group, group)


def folds_at_positions(data: Measurements, axes: Sequence[int]) -> HeldOutFolds | None:
    """Return folds of positions of one axis, or of poses of several (numbers of those that moved); None if there is only one."""
    _, group = np.unique(np.round(data.positions[:, list(axes)], 3), axis=0, return_inverse=True)
    group = group.reshape(-1)
    return _drawn("positions" if len(axes) == 1 else "poses", group) if group.max() > 0 else None


def cells_of_positions(data: Measurements, axes: Sequence[int]) -> HeldOutFolds | None:
    """Return folds of cells, contiguous in the positions of all axes together, at least `CELLS` if there are enough; None for too few.

    Neighbours are left out together: only what holds over the whole range predicts a cell.
    """
    parts = int(np.ceil(CELLS ** (1.0 / len(axes))))
    cell = np.zeros(len(data), dtype=int)
    for axis in axes:
        q = data.positions[:, axis]
        limits = np.quantile(np.unique(np.round(q, 3)), np.arange(1, parts) / parts)
        cell = cell * parts + np.searchsorted(limits, q, side="right")
    _, group = np.unique(cell, return_inverse=True)
    group = group.reshape(-1)
    return _drawn("positions", group) if group.max() + 1 >= GROUPS_FOR_AN_INTERVAL else None


def _drawn(of: HeldOutOf, group: np.ndarray) -> HeldOutFolds:
    count = int(group.max()) + 1
    return HeldOutFolds(of, group, (np.random.default_rng(SEED).permutation(count) % min(count, FOLDS))[group])


AMPLE_FREEDOM: Final = 20  # degrees of freedom per parameter above which overfitting is negligible
OVERFITTED_RATIO: Final = 1.25  # ratio of held-out to fitted RMS residual above which the number of causes is reduced


def without_overfitting(candidates: Candidates, forms: Sequence[Form]) -> list[Form]:
    """Return the causes without those that overfit; all of them unless held-out readings fit much worse than the others.

    Causes enter in order of the chi² they explain, and each must be significant against the residual after it (F-to-enter, Efroymson
    1960). Of these the smallest number is kept whose held-out error is within one standard error of the minimum (Breiman and others
    1984). For poses, each fold chooses its causes anew. If only one axis moved, causes that are not promised (`predicts_held_out`) are
    kept: they make no claim between the measured positions.
    """
    problem = candidates.problem
    if AMPLE_FREEDOM * len(columns_of(forms)) < problem.dof:
        return list(forms)
    folds = choose_folds(problem.network.data, problem.network.machine, [form.candidate for form in forms])
    if folds is None or folds.of not in ("positions", "poses") or folds.group.max() + 1 < GROUPS_FOR_AN_INTERVAL:
        return list(forms)
    claimed = _by_entry(
        candidates, [form for form in forms if folds.of == "poses" or predicts_held_out(candidates, form, forms)]
    )

    def predict(part: Candidates) -> list[np.ndarray]:
        entered = claimed
        if folds.of == "poses":
            part.critical_table = candidates.critical_table  # what is excluded from the search is excluded here
            entered = _chosen_again(part, len(claimed))
        return [predicted_shift(problem, part, entered[:k]) for k in range(len(claimed) + 1)]

    table = held_out_squares(candidates, folds, predict)
    if table is None:
        return list(forms)
    if table[:, -2].sum() / table[:, -1].sum() <= (OVERFITTED_RATIO * fitted_rms_um(candidates, claimed)) ** 2:
        return list(forms)
    overfitted = claimed[_fewest(table[:, : _significant(candidates, claimed) + 1]) :]
    return [form for form in forms if form not in overfitted]


def fitted_rms_um(candidates: Candidates, forms: Sequence[Form]) -> float:
    """Return the RMS residual per coordinate, µm, that some causes leave in the readings that they are fitted to."""
    problem = candidates.problem
    left = problem.project(problem.residual - predicted_shift(problem, candidates, forms))
    return rms(in_um(problem.network, left), problem.network.read)


def _chosen_again(part: Candidates, count: int) -> list[Form]:
    """Return the causes that a part of the readings chooses one after the other, at most a number of them.

    Causes that all readings have chosen fit the readings left out, too: where there are many candidates and few poses, random errors
    seem to be predicted (Hastie, Tibshirani, Friedman: The elements of statistical learning, 2009, 7.10.2).
    """
    entered: list[Form] = []
    for _ in range(count):
        margins = part.margins(entered)
        margins[part.taken(entered)] = -np.inf
        best = first_largest(margins)
        if np.isneginf(margins[best]):
            break
        entered.append(part.forms[best])
    return entered


def _significant(candidates: Candidates, forms: Sequence[Form]) -> int:
    """Return the number of forms, entered in this order, that are significant against the residual (F-to-enter)."""
    problem, free = candidates.problem, float(candidates.problem.dof)
    for k, form in enumerate(forms):
        explained, dof, _ = candidates.scores(forms[:k], [form.index])[0]
        free -= dof
        variance_factor = (problem.chi2 - candidates.explained_by(forms[: k + 1])) / max(free, 1.0)
        log_p = log_p_value(np.array(explained / max(variance_factor, 1.0)), max(float(dof), 1.0), max(free, 1.0))
        if float(log_p) + form.log_tests > np.log(candidates.level):
            return k
    return len(forms)


def _fewest(squares: np.ndarray) -> int:
    """Return the number of causes from (groups, causes + 1) sums of squares with none, the first, the first two, and so on."""
    worse = squares - squares[:, [first_largest(-squares.sum(axis=0))]]
    error = np.sqrt(len(squares)) * worse.std(axis=0, ddof=1)
    return int(np.argmax(worse.sum(axis=0) <= error))


def _by_entry(candidates: Candidates, forms: Sequence[Form]) -> list[Form]:
    """Return the forms in the order in which each explains most given those before it."""
    waiting, entered = list(forms), list[Form]()
    while waiting:
        explained = candidates.scores(entered, [form.index for form in waiting])[:, 0]
        entered.append(waiting.pop(first_largest(explained)))
    return entered
