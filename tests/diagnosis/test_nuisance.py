"""Nuisance parameters in coefficients, against dense matrices: basis, projection, random effects, parts of the data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from tests.benchmarks.diagnosis import measured
from tests.diagnosis.battery import Searcher, basis_of
from twin._common.arrays import read_only
from twin.diagnosis.candidates.candidate import Column
from twin.diagnosis.forms import Form
from twin.diagnosis.problem import Problem, Products
from twin.diagnosis.readings import readings
from twin.diagnosis.search import prices
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.numerics.covariance import Covariance

FACTOR = 1.7
"""Factor on the noise variances."""


def correlated(calibration: Calibration) -> Calibration:
    """Return the calibration with curves known to about 1 µm at ten positions: coefficients of powers strongly correlated."""
    names, blocks = [], []
    for effect in calibration.effects:
        own = [parameter.name for parameter in effect.parameters]
        rows = np.vander(np.linspace(-1.0, 1.0, 10), len(own), increasing=True)
        names += own
        blocks.append(np.linalg.inv(rows.T @ rows + 1e-6 * np.eye(len(own))))
    ends = np.cumsum([0, *map(len, blocks)])
    matrix = np.zeros((ends[-1], ends[-1]))
    for at, block in zip(ends, blocks, strict=False):
        matrix[at : at + len(block), at : at + len(block)] = block
    return replace(calibration, joint=Covariance(tuple(names), read_only(matrix)))


@pytest.fixture(scope="module")
def searched(dmu50: Machine) -> Searcher:
    """Return the search in some 900 readings with an uncertain calibration."""
    placed = readings(measured(dmu50, 900), dmu50, correlated(Calibration.default(dmu50)))
    return Searcher(placed.without(placed.bad))


def random_effects(searched: Searcher) -> list[tuple[Column, float]]:
    """Return the random effects of a pattern with their standard deviations, µm."""
    pattern = next(one for one in searched.patterns if len(one.channels) == 2)
    return [(column, 1.0 + 0.2 * k) for k, column in enumerate(pattern.columns(2, [0, 2]))]


def dense_nuisance(problem: Problem, calibration: Calibration) -> tuple[np.ndarray, np.ndarray]:
    """Return (3n, set-up) derivatives by the set-up in plausible sizes, and (3n, k) one standard deviation of the calibration."""
    by_setup = np.zeros((len(problem.view.rows), 3, len(problem.setup)))
    problem.network.fill_setup_columns(problem.view, problem.setup, by_setup)
    columns, root = problem._calibration_columns(calibration)
    scale = np.array([column.scale for column in columns])
    return by_setup.reshape(-1, len(problem.setup)) * problem.setup.plausible, problem.signature(columns) / scale @ root


def dense_basis(nuisance: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Return the readings' part of an orthonormal basis by singular values."""
    left, values, _ = np.linalg.svd(np.concatenate([nuisance, prior]), full_matrices=False)
    return left[: len(nuisance), values > 1e-9 * values[0]]


@pytest.mark.parametrize("extended", [False, True])
def test_the_basis_is_that_of_the_dense_derivatives(dmu50: Machine, searched: Searcher, extended: bool) -> None:
    problem = searched.problem
    by_setup, uncertain = dense_nuisance(problem, correlated(Calibration.default(dmu50)))
    if extended:
        random = random_effects(searched)
        more = problem.signature([column for column, _ in random]) * [deviation for _, deviation in random]
        by_setup, uncertain = by_setup / np.sqrt(FACTOR), np.concatenate([uncertain, more], axis=1) / np.sqrt(FACTOR)
        problem = problem.with_random_effects(random, FACTOR)
    size = uncertain.shape[1]
    prior = np.concatenate([np.zeros((size, by_setup.shape[1])), np.eye(size)], axis=1)
    whole = np.concatenate([by_setup, uncertain], axis=1)
    basis, found = dense_basis(whole, prior), basis_of(problem)
    assert basis.shape == found.shape
    identity = found.T @ found + problem.nuisances.prior.T @ problem.nuisances.prior
    assert np.abs(identity - np.eye(len(identity))).max() < 1e-11
    # The same directions, and the derivatives and their prior from their coordinates.
    assert np.abs(found @ found.T - basis @ basis.T).max() < 1e-9
    assert np.abs(problem.nuisance - whole).max() < 1e-9 * np.abs(whole).max()
    assert np.abs((problem.nuisances.prior @ problem.nuisances.coordinates) - prior).max() < 1e-9
    vectors = np.random.default_rng(3).standard_normal((len(found), 20))
    left = vectors - basis @ (basis.T @ vectors)
    assert np.abs(problem.project(vectors) - left).max() < 1e-9
    assert np.abs(problem.project(vectors[:, 0]) - left[:, 0]).max() < 1e-9


def test_the_set_up_step_does_not_depend_on_the_weights(searched: Searcher) -> None:
    problem = Problem(searched.problem.network, searched.problem.setup, None)
    weighted = problem.with_random_effects([], FACTOR)
    moved = np.random.default_rng(5).standard_normal(len(problem.residual))
    step, other = problem.setup_step(moved), weighted.setup_step(moved / np.sqrt(FACTOR))
    assert np.allclose(other, step, rtol=1e-9, atol=1e-9 * np.abs(step).max())


def close(found: np.ndarray, truth: np.ndarray) -> None:
    assert found.shape == truth.shape
    assert np.abs(found - truth).max() <= 1e-10 * np.abs(truth).max()


def test_inner_products_with_random_effects_need_no_pass(searched: Searcher) -> None:
    """Derived from the products at hand, they equal those evaluated anew."""
    candidates = searched.candidates
    problem = searched.problem.with_random_effects(random_effects(searched), FACTOR)
    found = candidates.products.for_problem(problem)
    anew = Products(problem, candidates.products.columns, candidates._columns)
    root = np.linalg.qr(np.random.default_rng(8).standard_normal((len(problem.root), 9)))[0]
    close(found.on_basis(root), anew.on_basis(root))
    close(found.on_basis(root), root.T @ problem.nuisances.from_raw(found.by_raw))
    close(found.by_residual, anew.by_residual)
    some = np.arange(0, len(candidates.products.columns), 511)
    close(found.cross(some), anew.cross(some))
    for own, other in zip(found.within, anew.within, strict=True):
        close(own, other)


@pytest.mark.parametrize("which", ["a part", "any points"])
def test_inner_products_with_other_columns_on_a_part(searched: Searcher, which: str) -> None:
    problem, products = searched.problem, searched.candidates.products
    parts = products._parts
    assert parts is not None
    gone = np.flatnonzero(parts == 1)
    if which == "any points":
        gone = np.sort(np.random.default_rng(4).choice(len(parts), 50, replace=False))
    part = products.without(gone)
    columns = [column for column, _ in random_effects(searched)]
    rows = np.repeat(~np.isin(np.arange(len(parts)), gone), 3)
    other = problem.signature(columns)[rows]
    chosen = np.arange(0, len(products.columns), 401)
    whole = problem.signature([products.columns[i] for i in chosen])[rows]
    groups = [tuple(columns[:2]), tuple(columns[2:])]
    for some in (chosen[:2], chosen):
        close(part.with_groups(groups, some), other.T @ whole[:, : len(some)])
    close(part.with_groups(groups, None)[:, chosen], other.T @ whole)
    close(part.with_groups(groups, chosen), other.T @ whole)
    gram, by_nuisance, slope = part.among(groups)
    close(gram, other.T @ other)
    close(problem.nuisances.from_raw(by_nuisance), basis_of(problem)[rows].T @ other)
    close(slope, other.T @ problem.residual[rows])


def whole_forms(searched: Searcher) -> list[Form]:
    """Return some forms of one, two and more columns, all of whose directions the readings show."""
    _, dof = searched.candidates.scan([])
    shown = [form for form in searched.candidates.forms if dof[form.index] == len(form.columns)]
    return [form for width in (1, 2, 4) for form in [one for one in shown if len(one.columns) == width][:6]]


def test_what_a_form_explains_is_the_drop_of_dense_chi2(searched: Searcher) -> None:
    """χ² of the augmented least-squares problem, the prior's rows included, without the form less that with it."""
    problem, candidates = searched.problem, searched.candidates
    prior = problem.nuisances.prior @ problem.nuisances.coordinates
    nuisance = np.concatenate([problem.nuisance, prior])
    right = np.concatenate([problem.residual, np.zeros(len(prior))])

    def chi2(columns: np.ndarray) -> float:
        size = np.linalg.norm(columns, axis=0)
        left, values, _ = np.linalg.svd(columns / np.where(size > 0.0, size, 1.0), full_matrices=False)
        return float(right @ right - np.sum((left[:, values > 1e-9 * values[0]].T @ right) ** 2))

    forms = whole_forms(searched)
    assert {len(form.columns) for form in forms} == {1, 2, 4}
    explained, _ = candidates.scan([])
    for form in forms[::3]:
        signature = problem.signature(form.variant.columns)
        both = np.hstack([nuisance, np.concatenate([signature, np.zeros((len(prior), signature.shape[1]))])])
        assert explained[form.index] == pytest.approx(chi2(nuisance) - chi2(both), rel=1e-5, abs=1e-5)


def test_what_a_form_explains_of_noise_and_a_wrong_calibration_is_chi2(searched: Searcher) -> None:
    """Any set-up, a calibration drawn from its covariance, and noise: the null distribution of the test."""
    problem, rng, draws = searched.problem, np.random.default_rng(20), 400
    moved = rng.standard_normal((problem.nuisance.shape[1], draws))
    moved[: len(problem.setup)] *= 3.0  # the set-up is free: its size does not matter
    residual = problem.nuisance @ moved + rng.standard_normal((len(problem.residual), draws))
    residual *= problem.network.read.reshape(-1, 1)
    for form in whole_forms(searched)[::4]:
        gram, slope = problem.normal_equations(problem.signature(form.variant.columns), residual)
        explained = np.sum(slope * np.linalg.solve(gram, slope), axis=0)
        assert stats.kstest(explained, stats.chi2(len(form.columns)).cdf).pvalue > 1e-3, form.key


def test_the_shares_of_all_forms_in_the_false_alarms_add_up_to_one(searched: Searcher) -> None:
    """Weighted Bonferroni: corrected by these numbers of tests, all forms together are below a level at most at that rate."""
    tested = searched.task.catalogue.candidates
    log_tests = prices(tested)
    assert sum(one.tests * np.exp(-log_tests[one.effect]) for one in tested) == pytest.approx(1.0)
