"""Sum of single effects: Bayes factors, posterior against exact enumeration, and comparison with the search."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy import stats

from tests.diagnosis.battery import Case, DataSet
from twin.diagnosis.search import select
from twin.diagnosis.second_opinion import (
    CREDIBLE_PROBABILITY,
    FOUND_ODDS,
    PRIOR_NONCENTRALITIES,
    SIZE_PRIOR,
    Alternatives,
    Fit,
    Key,
    SingleEffect,
    SingleEffects,
    _sum_of,
    compare_with_search,
    probability_of_any,
    second_opinion,
)

DRAWS = 2000


def alternatives(
    columns: np.ndarray, groups: Sequence[Sequence[int]], prior: Sequence[float] | None = None
) -> list[Alternatives]:
    """Forms of given columns of a dense (n, p) matrix, each with the same prior if none is given."""
    gram = columns.T @ columns
    weights = np.ones(len(groups)) if prior is None else np.array(prior)
    found = []
    for width in sorted({len(group) for group in groups}):
        forms = np.array([k for k, group in enumerate(groups) if len(group) == width])
        own = np.array([groups[k] for k in forms])
        inner = gram[own[:, :, None], own[:, None, :]]
        found.append(
            Alternatives(
                forms, own, inner, weights[forms], np.ones(own.shape), np.zeros(own.shape), np.zeros(len(forms))
            )
        )
    return found


def single_effects(
    columns: np.ndarray,
    groups: Sequence[Sequence[int]],
    residual: np.ndarray,
    dof: float = float("inf"),
    prior: Sequence[float] | None = None,
) -> SingleEffects:
    gram = columns.T @ columns
    return SingleEffects(alternatives(columns, groups, prior), columns.T @ residual, lambda k: gram[k], dof)


def fitted(columns: np.ndarray, groups: Sequence[Sequence[int]], residual: np.ndarray) -> tuple[Fit, ...]:
    return single_effects(columns, groups, residual).fitted(5)


def large(rng: np.random.Generator, points: int, count: int, alike: float = 0.0) -> np.ndarray:
    """(points, count) columns of norm 1000 with a part in common."""
    own = rng.standard_normal((points, count)) + alike * rng.standard_normal((points, 1))
    return np.asarray(own / np.linalg.norm(own, axis=0) * 1000.0)


def drawn(
    rng: np.random.Generator, columns: np.ndarray, groups: Sequence[Sequence[int]], dof: float, hidden: bool
) -> np.ndarray:
    """A residual in units of the estimated standard deviation: noise, and an effect drawn from the prior if there is one."""
    found = rng.standard_normal(len(columns))
    if hidden:
        own = columns[:, groups[rng.integers(len(groups))]]
        total = float(np.sum(own**2))
        weights = np.where(PRIOR_NONCENTRALITIES <= total, SIZE_PRIOR, 0.0)
        size = float(rng.choice(PRIOR_NONCENTRALITIES, p=weights / weights.sum()))
        found += own @ rng.standard_normal(own.shape[1]) * np.sqrt(size / total)
    return found if np.isinf(dof) else found / np.sqrt(rng.chisquare(dof) / dof)


@pytest.mark.slow
@pytest.mark.parametrize("dof", [float("inf"), 12.0])
def test_odds_are_a_ratio_of_densities(dof: float) -> None:
    """False alarms are rarer than one in 20, and the mean Bayes factor of data without an effect is one.

    The mean itself has too heavy a tail to be drawn. Equivalent, and bounded: below any limit, the mean of the odds on silent data is
    the share of data with an effect from the prior. Four standard errors.
    """
    rng = np.random.default_rng(17)
    columns = large(rng, 40, 12, 0.6)
    groups = [[0], [1], [2], [3, 4], [5, 6, 7], [8, 9, 10, 11]]

    def odds(hidden: bool) -> np.ndarray:
        residuals = [drawn(rng, columns, groups, dof, hidden) for _ in range(DRAWS)]
        effects = [single_effects(columns, groups, one, dof).fitted(1)[0] for one in residuals]
        return np.exp([min(effect.log_odds, 100.0) for effect in effects])

    silent, loud = odds(False), odds(True)
    assert np.mean(silent >= FOUND_ODDS) < 1.0 / FOUND_ODDS
    for limit in (0.3, 1.0, FOUND_ODDS):
        below, share = np.where(silent < limit, silent, 0.0), float(np.mean(loud < limit))
        error = np.sqrt((np.var(below) + share * (1.0 - share)) / DRAWS)
        assert 0.01 < share < 0.99
        assert abs(np.mean(below) - share) < 4.0 * error


def test_bayes_factors_for_known_noise_raise_alarms_where_it_is_estimated() -> None:
    """With noise estimated from four degrees of freedom, odds for known noise exceed 20 in more than one of 20 sets without effect."""
    rng = np.random.default_rng(18)
    columns = large(rng, 40, 6)
    groups = [[k] for k in range(6)]
    residuals = [drawn(rng, columns, groups, 4.0, False) for _ in range(1000)]
    alarms = {
        dof: np.mean([single_effects(columns, groups, one, dof).fitted(1)[0].found for one in residuals])
        for dof in (4.0, float("inf"))
    }
    assert alarms[4.0] < 1.0 / FOUND_ODDS < alarms[float("inf")]


def log_evidence(columns: np.ndarray, residual: np.ndarray) -> float:
    """Log likelihood with the coefficients integrated out, sizes on the grid each for itself; dense, no inner products."""
    sizes = [
        PRIOR_NONCENTRALITIES[PRIOR_NONCENTRALITIES <= max(float(np.sum(column**2)), PRIOR_NONCENTRALITIES[0])]
        for column in columns.T
    ]
    weights = [SIZE_PRIOR[: len(own)] / SIZE_PRIOR[: len(own)].sum() for own in sizes]
    terms = []
    for at in np.ndindex(*(len(own) for own in sizes)):
        covariance, log_weight = np.eye(len(residual)), 0.0
        for k, i in enumerate(at):
            unit = columns[:, k] / np.linalg.norm(columns[:, k])
            covariance += sizes[k][i] * np.outer(unit, unit)
            log_weight += float(np.log(weights[k][i]))
        terms.append(log_weight + float(stats.multivariate_normal.logpdf(residual, cov=covariance)))
    return float(np.logaddexp.reduce(terms))


def by_enumeration(columns: np.ndarray, residual: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """(count,) posterior probability that each column has a part in the residual; models with none, one or two.

    Prior odds of a first effect are one and so are those of a second one, as they are of single effects.
    """
    count = columns.shape[1]
    models: list[tuple[int, ...]] = [(), *((k,) for k in range(count)), *combinations(range(count), 2)]
    own = {(): 0.5} | {(k,): 0.25 * prior[k] for k in range(count)}
    pairs = {(i, j): prior[i] * prior[j] for i, j in combinations(range(count), 2)}
    own |= {pair: 0.25 * weight / sum(pairs.values()) for pair, weight in pairs.items()}
    log_posterior = np.array([np.log(own[model]) + log_evidence(columns[:, model], residual) for model in models])
    posterior = np.exp(log_posterior - np.logaddexp.reduce(log_posterior))
    return np.array([sum(posterior[m] for m, model in enumerate(models) if k in model) for k in range(count)])


@pytest.mark.parametrize(
    ("truth", "seed"), [((), 1), ((2,), 2), ((2,), 3), ((1, 6), 4), ((1, 6), 5), ((0, 3), 6)], ids=str
)
def test_inclusion_probabilities_agree_with_exact_enumeration(truth: tuple[int, ...], seed: int) -> None:
    """Within 0.1: the factorised posterior is an approximation, and so is stopping after the first effect that is not found."""
    rng = np.random.default_rng(seed)
    columns = large(rng, 30, 8, 0.5)
    prior = rng.dirichlet(np.full(8, 5.0))
    residual = rng.standard_normal(30) + sum((columns[:, k] / 1000.0 * 7.0 for k in truth), np.zeros(30))
    effects = single_effects(columns, [[k] for k in range(8)], residual, prior=prior).fitted(2)
    found = 1.0 - np.prod([1.0 - one.probability * one.posterior for one in effects], axis=0)
    exact = by_enumeration(columns, residual, prior)
    assert np.abs(found - exact).max() < 0.1
    assert all(exact[k] > 0.5 for k in truth)


def test_single_effect_has_the_exact_bayes_factor() -> None:
    """To rounding, against a dense multivariate normal density."""
    rng = np.random.default_rng(8)
    columns = large(rng, 30, 4, 1.0)
    residual = rng.standard_normal(30) + columns[:, 1] / 200.0
    found = single_effects(columns, [[k] for k in range(4)], residual).fitted(1)[0]
    null = float(stats.multivariate_normal.logpdf(residual, cov=np.eye(30)))
    exact = np.array([log_evidence(columns[:, [k]], residual) for k in range(4)]) - null - np.log(4.0)
    assert found.log_odds == pytest.approx(float(np.logaddexp.reduce(exact)), rel=1e-9)
    assert found.posterior == pytest.approx(np.exp(exact - np.logaddexp.reduce(exact)), rel=1e-7, abs=1e-12)


def test_block_is_one_effect() -> None:
    """Three columns that only together explain the residual are found as one form, and nothing else is."""
    rng = np.random.default_rng(9)
    columns = large(rng, 60, 6)
    residual = rng.standard_normal(60) + columns[:, :3] @ np.full(3, 5.5e-3)
    effects = fitted(columns, [[0, 1, 2], [0], [1], [2], [3], [4], [5]], residual)
    assert [effect.found for effect in effects] == [True, False]
    assert effects[0].posterior[0] > 0.9


def test_a_wider_form_is_not_preferred_for_noise() -> None:
    """Noise in eight further columns does not make the wider of two nested forms the likelier one."""
    rng = np.random.default_rng(10)
    columns = large(rng, 60, 9)
    residual = rng.standard_normal(60) + columns[:, 0] * 8e-3
    posterior = fitted(columns, [[0], list(range(9))], residual)[0].posterior
    assert posterior[0] > 0.95


def test_two_orthogonal_effects_are_two() -> None:
    rng = np.random.default_rng(11)
    columns = np.linalg.qr(rng.standard_normal((60, 8)))[0] * 1000.0
    residual = rng.standard_normal(60) + columns[:, 2] * 9e-3 + columns[:, 5] * 8e-3
    effects = fitted(columns, [[k] for k in range(8)], residual)
    assert [effect.found for effect in effects] == [True, True, False]
    assert {int(np.argmax(effect.posterior)) for effect in effects[:2]} == {2, 5}
    assert all(effect.posterior.max() > 0.99 for effect in effects[:2])


def test_the_better_start_is_kept() -> None:
    """A column that resembles the sum of two effects enters first and stays, unless the iteration starts from the two as well."""
    rng = np.random.default_rng(12)
    columns = np.linalg.qr(rng.standard_normal((80, 6)))[0] * 1000.0
    columns[:, 5] = (columns[:, 0] + columns[:, 1] + 0.2 * columns[:, 5]) / np.sqrt(2.04)
    residual = rng.standard_normal(80) + columns[:, 0] * 42e-3 + columns[:, 1] * 30e-3
    problem = single_effects(columns, [[k] for k in range(6)], residual)

    def likeliest(start: Sequence[int]) -> set[int]:
        return {int(np.argmax(effect.posterior)) for effect in problem.fitted(5, start) if effect.found}

    assert likeliest([]) == {0, 5}
    assert likeliest([1, 0]) == {0, 1}
    assert likeliest([2, 3]) == {0, 5}


def test_units_of_columns_do_not_matter() -> None:
    """To rounding, as long as no plausible size bounds an effect."""
    rng = np.random.default_rng(13)
    columns = large(rng, 60, 6) * 1e3
    residual = rng.standard_normal(60) + columns[:, 4] * 7e-6
    groups = [[0], [1], [2, 3], [4], [5]]
    for one, other in zip(fitted(columns, groups, residual), fitted(columns * 37.0, groups, residual), strict=True):
        assert one.log_odds == pytest.approx(other.log_odds, abs=1e-8)
        assert one.posterior == pytest.approx(other.posterior, abs=1e-8)


def test_size_beyond_plausible_counts_against_a_form() -> None:
    """Between two parallel columns, the one that would need fifty times its plausible size is not the cause."""
    rng = np.random.default_rng(14)
    columns = large(rng, 60, 3)
    columns[:, 2] = columns[:, 1] / 100.0
    residual = rng.standard_normal(60) + columns[:, 1] * 0.5
    assert fitted(columns, [[0], [1], [2]], residual)[0].posterior[1] > 0.999
    small, gram = 50.0, columns.T @ columns
    own = replace(alternatives(columns, [[0], [1], [2]])[0], largest=np.array([[1.0], [1.0 / small], [small]]))
    bounded = SingleEffects([own], columns.T @ residual, lambda k: gram[k]).fitted(1)[0]
    assert bounded.posterior[2] > 0.999


def test_known_size_is_used() -> None:
    """A form that is either present or absent is accepted at its size and not at half of it."""
    rng = np.random.default_rng(15)
    columns = large(rng, 60, 2)
    gram = columns.T @ columns
    plain, known = alternatives(columns, [[0], [1]])[0], []
    for size in (1.0, 0.5):
        residual = rng.standard_normal(60) + columns[:, 0] * 0.02 * size
        centre = np.array([[0.02], [0.0]])
        own = replace(plain, centre=centre, width=np.array([0.05, 0.0]))
        found = [SingleEffects([one], columns.T @ residual, lambda k: gram[k]).fitted(1)[0] for one in (own, plain)]
        known.append(found[0].log_odds - found[1].log_odds)
    assert known[0] > 1.0
    assert known[1] < -10.0


def opinion(*effects: tuple[float, Mapping[Key, float]]) -> tuple[SingleEffect, ...]:
    """Odds and posteriors, with all causes in the credible set."""
    return tuple(SingleEffect(float(np.log(odds)), posterior, tuple(posterior)) for odds, posterior in effects)


A, B, C, D = (("squareness", where) for where in "ABCD")


def test_probability_of_a_group_adds_its_causes() -> None:
    found = opinion((1e9, {A: 0.6, B: 0.4}), (1.0, {B: 0.5, C: 0.5}))
    assert probability_of_any(found, [A, B]) == pytest.approx(1.0, abs=1e-8)
    assert probability_of_any(found, [B]) == pytest.approx(1.0 - 0.6 * 0.75, abs=1e-8)
    assert probability_of_any(found, [D]) == 0.0


@pytest.mark.parametrize(
    ("effects", "groups", "instead", "further"),
    [
        # Overlap is agreement; so is silence of the weaker method.
        ([(1e6, {A: 0.7, B: 0.3})], [[B]], [()], 0),
        ([(5.0, {A: 1.0})], [[B]], [()], 0),
        ([(1e6, {A: 1.0}), (2.0, {C: 1.0})], [[A], [B]], [(), ()], 0),
        # Another cause in the place of a named one, or beside all of them.
        ([(1e6, {A: 1.0})], [[B]], [(A,)], 0),
        ([(1e6, {A: 1.0}), (1e4, {C: 1.0})], [[A], [B]], [(), (C,)], 0),
        ([(1e6, {A: 1.0}), (1e4, {C: 1.0})], [[A]], [()], 1),
        ([(1e6, {A: 1.0})], [], [], 1),
        # Two correlated causes are named, one effect could be either: the second is unseen, not contradicted.
        ([(1e6, {A: 0.5, B: 0.5})], [[A], [B]], [(), ()], 0),
        # Another is one of the two and a third cause: that stands in the place of the other.
        ([(1e6, {A: 0.6, B: 0.4}), (1e4, {C: 1.0})], [[A], [B]], [(), (C,)], 0),
        # One cause in two forms.
        ([(1e6, {A: 1.0}), (1e4, {A: 0.9, C: 0.1})], [[A], [B]], [(), ()], 0),
        # A second effect in the likeness of the first stands where the search has another cause.
        ([(1e6, {A: 1.0}), (1e4, {C: 0.9, A: 0.1})], [[A], [B]], [(), (C, A)], 0),
        ([(1e6, {A: 1.0}), (1e4, {C: 0.9, A: 0.1})], [[A]], [()], 0),
    ],
)
def test_comparison_with_the_search(
    effects: list[tuple[float, dict[Key, float]]],
    groups: list[list[Key]],
    instead: list[tuple[Key, ...]],
    further: int,
) -> None:
    found = compare_with_search(opinion(*effects), groups)
    assert list(found.instead) == instead
    assert len(found.further) == further
    assert found.disagree == (any(instead) or further > 0)


@pytest.fixture(scope="module")
def data_set() -> DataSet:
    """Some 3,000 readings of a five-axis machine with nothing hidden, and 2,500 named forms."""
    return DataSet(Case("one60", 5), 0)


def test_cause_is_named_on_the_truth_machine(data_set: DataSet) -> None:
    """Every credible set of an effect at noncentrality 60 has the truth in it, and nine draws in ten are found."""
    missed = 0
    for _ in range(10):
        draw = data_set.draw()
        data_set.problem.set_residual(draw.residual)
        data_set.searcher.candidates.set_problem(data_set.problem)
        found = second_opinion(data_set.searcher.candidates)
        key = draw.truth[0][0]
        assert key in found[0].credible
        if not found[0].found:
            missed += 1  # a pitch error, of which hundreds of periods are possible
            continue
        assert [effect.found for effect in found] == [True, False]
        assert sum(found[0].posterior.values()) == pytest.approx(1.0)
        comparison = compare_with_search(found, [[key]])
        assert not comparison.disagree
        assert comparison.probability[0] == pytest.approx(probability_of_any(found, [key]))
    assert missed <= 1


def test_credible_set_holds_causes_that_look_alike(data_set: DataSet) -> None:
    """Two cross-axis errors that move the tool alike share the posterior; the set is no larger than it must be."""
    candidates, problem = data_set.searcher.candidates, data_set.problem
    alike = {("cross_axis", "E_XX by Z"), ("cross_axis", "E_XZ by X")}
    form = next(one for one in candidates.forms if one.key in alike)
    signature = problem.signature(form.variant.columns)[:, 0]
    size = np.sqrt(60.0 / float(problem.inner(signature[:, None])[0, 0]))
    problem.set_residual(signature * size)
    candidates.set_problem(problem)
    effect = second_opinion(candidates)[0]
    assert alike <= set(effect.credible)
    share = np.array([effect.posterior[key] for key in effect.credible])
    assert share.sum() >= CREDIBLE_PROBABILITY
    assert share[:-1].sum() < CREDIBLE_PROBABILITY
    assert np.all(np.diff(share) <= 0.0)
    assert effect.posterior["cross_axis", "E_XX by Z"] == pytest.approx(
        effect.posterior["cross_axis", "E_XZ by X"], rel=0.05
    )


def test_two_causes_are_found_where_another_alone_explains_most(data_set: DataSet) -> None:
    """The search against the pair that made the readings: its set is worth no less, although the best single cause is a third."""
    candidates, problem, rng = data_set.searcher.candidates, data_set.problem, np.random.default_rng(8)
    single = [form for form in candidates.forms if len(form.columns) == 1 and not form.nonlinear]
    tested = 0
    while tested < 3:
        pair = [single[i] for i in rng.choice(len(single), 2, replace=False)]
        signature = problem.signature([form.variant.columns[0] for form in pair])
        gram = problem.inner(signature)
        if gram.diagonal().min() < 100.0 or abs(gram[0, 1]) > 0.3 * np.sqrt(gram.diagonal().prod()):
            continue
        problem.set_residual(signature @ np.sqrt(60.0 / gram.diagonal()))
        candidates.set_problem(problem)
        margins = candidates.margins([])
        worth = candidates.penalised_gain(pair)
        if max(margins.max(), 0.0) < worth and candidates.forms[int(margins.argmax())].key not in {f.key for f in pair}:
            assert select(candidates).worth > worth - 1e-6, [form.key for form in pair]
            tested += 1


@pytest.mark.parametrize(("left", "is_sum"), [(12.0, True), (20.0, False)])
def test_a_sum_is_recognised_beyond_the_noise_that_a_curve_follows(left: float, is_sum: bool) -> None:
    """Two causes and a curve of six functions that adds noise to them: χ² of 12 is one chance in 16 there, 20 one in 360."""
    slope = np.array([15.0, 12.0, np.sqrt(left), 0.0, 0.0, 0.0])
    forms = [SimpleNamespace(key=key, columns=np.array(own)) for key, own in ((A, [0]), (B, [1]), (C, range(6)))]
    candidates = SimpleNamespace(
        forms=forms,
        critical_table=np.zeros((3, 2)),
        fitted=lambda some: (
            own := np.concatenate([form.columns for form in some]),
            slope[own],
            np.eye(len(own)),
        ),
    )
    effect = Fit(99.0, np.array([0.0, 0.0, 1.0]), slope, slope)
    assert _sum_of(effect, cast(Any, candidates), cast(Any, forms[:2])) == ((A, B) if is_sum else ())
