"""Unnamed patterns: functions, p-value of a score, likelihood together with causes; against plain numpy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from tests.diagnosis import battery
from tests.diagnosis.battery import Searcher
from tests.real import plates
from tests.truth import hidden
from tests.truth.hidden import Hidden
from twin.diagnosis.candidates.candidate import SignatureTerm, scaled_column
from twin.diagnosis.likelihood import Likelihood, _two_moments, log_tail, scan_patterns
from twin.diagnosis.patterns import Pattern, patterns
from twin.diagnosis.problem import Problem
from twin.diagnosis.readings import readings
from twin.diagnosis.structure import without_variants_in_time
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

SIGMA_MM = 3e-3


@pytest.fixture(scope="module")
def searched(dmu50: Machine, calibration: Calibration, tmp_path_factory: pytest.TempPathFactory) -> Searcher:
    """A small data set with a reversal of Y."""
    rng = np.random.default_rng(41)
    plan = hidden.rounded(hidden.plan(rng, rounds=2, stops=7, poses=60))
    exact = hidden.points(plan, [Hidden("reversal", "Y", {"size": 6.0})])
    path = tmp_path_factory.mktemp("unnamed") / "m.csv"
    data = Measurements.load(
        hidden.write(path, plan, hidden.noisy(exact, rng, "isotropic", SIGMA_MM), u_mm=SIGMA_MM), dmu50
    )
    placed = readings(data, dmu50, calibration)
    task = placed.without(placed.bad)
    return Searcher(without_variants_in_time(task))


def beside(problem: Problem, columns: np.ndarray) -> np.ndarray:
    """Return columns with the set-up projected out, by least squares."""
    setup = problem.nuisance
    return columns - setup @ np.linalg.lstsq(setup, columns, rcond=1e-12)[0]


@pytest.mark.parametrize("weights", [[1.0], [3.0, 1.0, 0.2], [0.9] * 40 + [0.1] * 60, [5.0, *[0.05] * 30]])
def test_the_tail_of_a_sum_of_chi2_by_simulation(weights: list[float]) -> None:
    """Down to a probability of one in a thousand, to 15 % of it (standard deviation of the simulation 3 %)."""
    w, rng = np.array(weights), np.random.default_rng(1)
    drawn = np.sort(sum(weight * rng.standard_normal(10**6) ** 2 for weight in w))
    for chance in (0.1, 0.01, 0.001):
        value = drawn[-int(chance * len(drawn))]
        assert np.exp(log_tail(w, float(value))) == pytest.approx(chance, rel=0.15)


def test_the_tail_of_one_weight_is_that_of_chi2_and_f() -> None:
    """Equal weights give χ², with estimated noise F; to a ninth of the probability, the known accuracy of the saddlepoint."""
    for count in (1, 4, 80):
        for chance in (1e-3, 1e-10):
            value = stats.chi2.isf(chance, count)
            assert log_tail(np.full(count, 2.0), 2.0 * value) == pytest.approx(np.log(chance), abs=0.12)
            value = stats.f.isf(chance, count, 60) * count
            assert log_tail(np.full(count, 2.0), 2.0 * value, 60.0) == pytest.approx(np.log(chance), abs=0.12)


def test_the_functions_of_a_pattern_are_products_of_half_waves_and_turns(searched: Searcher) -> None:
    data = searched.problem.network.data
    pattern = next(p for p in searched.patterns if p.names == ("X_mm", "C_deg") and p.side == "work")
    x, c = data.positions[:, 0], np.radians(data.positions[:, 4])
    own = data.carrier == "work"
    u = (x - x[own].min()) / np.ptp(x[own])
    expected = [np.cos(np.pi * k * u) for k in range(1, 9)]
    turns = [f(k * c) for k in range(1, 5) for f in (np.cos, np.sin)]
    expected += turns + [a * b for a in expected for b in turns]
    np.testing.assert_allclose(pattern.at(slice(None)), np.stack(expected, axis=1) * own[:, None], atol=1e-12)
    assert pattern.levels == (2, 4, 8)
    assert np.count_nonzero(pattern.order <= 2) == 2 + 2 + 4
    lost = next(p for p in searched.patterns if p.names == ("approach_Y", "X_mm") and p.side == "work")
    np.testing.assert_allclose(lost.at(slice(None))[:, 0], data.approach[:, 1] * own)
    np.testing.assert_allclose(lost.at(slice(None))[:, 3], data.approach[:, 1] * expected[2] * own)


def test_a_column_carries_a_pattern_only_where_it_changes(searched: Searcher, dmu50: Machine) -> None:
    """Z stands still in all readings of the tool side: no pattern of that side depends on it, those of the work side may."""
    data = searched.problem.network.data
    positions = np.array(data.positions)
    positions[data.carrier == "tool", 2] = -200.0
    still = patterns(dmu50, replace(data, positions=positions))
    depending = {side: {name for p in still if p.side == side for name in p.names} for side in ("tool", "work")}
    assert "Z_mm" not in depending["tool"] and "Z_mm" in depending["work"]
    assert depending["work"] - depending["tool"] == {"Z_mm"}


def test_the_score_of_a_pattern_is_the_one_of_plain_numpy(searched: Searcher) -> None:
    """Statistic and weights of every direction from dense matrices, set-up and a cause projected out by least squares."""
    problem, candidates = searched.problem, searched.candidates
    form = next(one for one in candidates.forms if one.key == ("reversal", "Y"))
    pattern = next(p for p in searched.patterns if p.names == ("Y_mm", "Z_mm") and p.side == "tool")
    (pattern_test,) = scan_patterns(problem, [pattern], [form], np.inf)
    columns = [problem.signature(pattern.columns(pattern_test.level, [i])) for i in pattern_test.directions]
    free = np.concatenate([problem.nuisance, problem.signature(form.variant.columns)], axis=1)
    phi = np.concatenate(columns, axis=1)
    phi = phi - free @ np.linalg.lstsq(free, phi, rcond=1e-12)[0]
    deviation = np.concatenate([np.full(c.shape[1], 1.0) for c in columns])
    at = 0
    for c in columns:
        own = slice(at, at + c.shape[1])
        deviation[own] = np.sqrt(100.0 / np.sum(phi[:, own] ** 2))
        at += c.shape[1]
    phi = phi * deviation
    gram = phi.T @ phi
    weights = np.linalg.eigvalsh(gram @ np.linalg.inv(gram + np.eye(len(gram))))
    slope = phi.T @ problem.residual
    score = slope @ np.linalg.solve(gram + np.eye(len(gram)), slope)
    assert pattern_test.log_p == pytest.approx(log_tail(np.sort(weights.real), float(score)), abs=1e-3)
    # With a noise of twenty degrees of freedom the same score is less significant.
    (estimated,) = scan_patterns(problem, [pattern], [form], 20.0)
    assert estimated.log_p > pattern_test.log_p + 1e-4
    # Bonferroni: every level in every direction, and all three together, counts for the correction.
    assert pattern_test.log_price == pytest.approx(np.log(4 * len(pattern.levels)))
    assert pattern_test.log_p_corrected == min(pattern_test.log_p + pattern_test.log_price, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(("draws", "allowed"), [(24, 1), pytest.param(200, 5, marks=pytest.mark.slow)])
def test_false_alarms_of_patterns_are_rare(searched: Searcher, draws: int, allowed: int) -> None:
    """At most one in a hundred data sets, by the union bound fewer; the limit is exceeded by chance in 1 of 42 and 1 of 62 runs."""
    problem, rng = searched.problem, np.random.default_rng(5)
    before, found = problem.residual, 0
    try:
        for _ in range(draws):
            problem.set_residual(rng.standard_normal(len(before)))
            found += scan_patterns(problem, searched.patterns, (), np.inf)[0].found
    finally:
        problem.set_residual(before)
    assert found <= allowed


def test_two_moments_give_a_scaled_chi2() -> None:
    """Mean and variance of a·χ²_k: k = 2 m²/v and a = v/(2 m); exact where all weights are equal."""
    score, mean, variance = np.array([9.0, 30.0]), np.array([3.0, 10.0]), np.array([6.0, 40.0])
    expected = [stats.chi2.logsf(9.0, 3), stats.chi2.logsf(15.0, 5)]
    np.testing.assert_allclose(_two_moments(score, mean, variance), expected, rtol=1e-9)


def found_pattern(searched: Searcher, pattern: Pattern, size: float) -> Likelihood:
    """Return readings with noise and a random function of a pattern, and their likelihood."""
    problem, rng = searched.problem, np.random.default_rng(6)
    columns = pattern.columns(2, [0])
    made = problem.signature(columns) @ rng.standard_normal(len(columns))
    problem.set_residual(made * size + rng.standard_normal(len(made)) * problem.network.read.reshape(-1))
    searched.candidates.set_problem(problem)
    (pattern_test,) = scan_patterns(problem, [pattern], (), np.inf)
    assert pattern_test.found
    return Likelihood(searched.candidates, [pattern_test])


def test_the_likelihood_beside_a_pattern_is_that_of_the_dense_covariance(searched: Searcher) -> None:
    """−log|V| − rᵀV⁻¹r with the set-up projected out, V = s²(1 + ΦDΦᵀ), at the estimated variances; no others are likelier."""
    problem, candidates = searched.problem, searched.candidates
    before = problem.residual
    try:
        pattern = next(p for p in searched.patterns if p.names == ("X_mm",) and p.side == "tool")
        likelihood = found_pattern(searched, pattern, 1.0)
        form = next(one for one in candidates.forms if one.key == ("reversal", "Y"))
        model = likelihood.fit([form])
        phi = beside(problem, problem.signature(likelihood.columns))
        x = beside(problem, problem.signature(form.variant.columns))
        r = beside(problem, problem.residual[:, None])[:, 0]

        def twice(variances: np.ndarray) -> float:
            d = variances[likelihood.group] + 1e-12
            inner = phi.T @ phi + np.diag(1.0 / d)

            def by_inverse(a: np.ndarray, b: np.ndarray) -> np.ndarray:
                return np.asarray(a.T @ b - (a.T @ phi) @ np.linalg.solve(inner, phi.T @ b))

            value = np.linalg.solve(by_inverse(x, x), by_inverse(x, r[:, None]))[:, 0]
            left = r - x @ value
            chi2 = float(by_inverse(left[:, None], left[:, None])[0, 0])
            more = max(chi2 / problem.dof, 1.0)
            log_det = np.linalg.slogdet(np.eye(len(d)) + np.sqrt(np.outer(d, d)) * (phi.T @ phi))[1]
            return float(r @ r - chi2 / more - problem.dof * np.log(more) - log_det)

        assert model.twice_log_ratio == pytest.approx(twice(model.variances), abs=0.05)
        for factor in (0.7, 1.4):
            assert twice(model.variances * factor) < model.twice_log_ratio + 0.02
    finally:
        problem.set_residual(before)
        candidates.set_problem(problem)


def test_the_most_likely_pattern_follows_from_the_dense_covariance(searched: Searcher) -> None:
    """s²(ΦᵀMΦ + D⁻¹)⁻¹ and its product with Φᵀr: Bayesian linear regression, also in directions that are not measured."""
    problem, candidates = searched.problem, searched.candidates
    before = problem.residual
    try:
        pattern = max((p for p in searched.patterns if p.side == "work"), key=lambda p: len(p.columns(p.highest, [0])))
        likelihood = found_pattern(searched, pattern, 1.0)
        model = likelihood.fit([])
        which, values, covariance = likelihood.most_likely(model, likelihood.slope_with(problem.residual))
        phi = beside(problem, problem.signature([likelihood.columns[i] for i in which]))
        inner = phi.T @ phi + np.diag(1.0 / model.variances[likelihood.group[which]])
        expected = np.linalg.inv(inner)
        np.testing.assert_allclose(covariance, model.variance_factor * expected, atol=1e-5 * model.variances.max())
        np.testing.assert_allclose(values, expected @ (phi.T @ problem.residual), atol=1e-3 * np.abs(values).max())
        alone = likelihood.slope_beside([])
        np.testing.assert_allclose(likelihood.slope_with(problem.residual), alone, atol=1e-6 * np.abs(alone).max())
    finally:
        problem.set_residual(before)
        candidates.set_problem(problem)


def test_columns_along_the_base_are_the_patterns_own(searched: Searcher) -> None:
    """µm per unit of a function, along an axis of the base frame."""
    pattern = next(p for p in searched.patterns if p.names == ("X_mm",) and p.side == "tool" and p.field == "base")
    (first, *_) = pattern.columns(2, [1])
    same = scaled_column([SignatureTerm(("base", 1), first.terms[0].functions, first.terms[0].index, 1e-6)])
    found, expected = (searched.problem.signature([column])[:, 0] / column.scale for column in (first, same))
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_patterns_follow_the_frame_that_turns(dmu50: Machine, tmp_path: Path) -> None:
    """On the table a pattern may be fixed to the table or to the base; the tool side of this machine does not turn."""
    rng = np.random.default_rng(3)
    plan = hidden.rounded(hidden.plan(rng, rounds=1, stops=5, poses=10))
    data = Measurements.load(hidden.write(tmp_path / "m.csv", plan, hidden.points(plan), u_mm=SIGMA_MM), dmu50)
    fields = {(p.side, p.field) for p in patterns(dmu50, data)}
    assert fields == {("tool", "base"), ("work", "base"), ("work", "place")}


def test_a_direction_that_was_not_read_is_not_tested(tmp_path: Path) -> None:
    """Along it a pattern's functions are rounding, which fits anything with a p-value of zero. Plates have no z."""
    machine, rng = Machine.load(plates.write_machine(tmp_path)), np.random.default_rng(4)
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-300.0, 300.0, 13), np.linspace(-240.0, 240.0, 9)))
    bent = 0.02 * np.sin(x / 100.0) + plates.U_MM * rng.standard_normal(len(x))
    path = plates.write_table(np.column_stack([x, y + bent, x, y]), tmp_path / "plate.csv")
    placed = readings(Measurements.load(path, machine), machine, Calibration.zero(machine))
    problem = placed.without(placed.bad).problem
    tried = patterns(machine, problem.network.data)
    found = scan_patterns(problem, tried, (), np.inf)
    assert found[0].found and found[0].directions == (1,)
    assert not [one for one in found if one.directions == (2,)]
    # Along x, along y, and all three together.
    assert found[0].log_price == pytest.approx(np.log(3 * sum(len(p.levels) for p in tried)))


def test_two_curves_of_one_axis_are_no_pattern_of_it() -> None:
    """A function of Z alone has more parameters than two of its curves, which explain all: they are named."""
    data = battery.DataSet(battery.Case("two60", 11, "isotropic", 100), 7)
    draw = [data.draw() for _ in range(8)][-1]
    data.problem.set_residual(draw.residual)
    data.searcher.candidates.set_problem(data.problem)
    structure = data.searcher.run().structure
    assert {form.key for form in structure.forms} == {one[0] for one in draw.truth}
    assert not structure.pattern_tests
