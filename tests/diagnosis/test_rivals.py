"""The standard methods that `twin diagnose` is compared with: they must find clear effects."""

from __future__ import annotations

import numpy as np
import pytest
import statsmodels.api as sm

from tests.diagnosis import battery, rivals
from tests.diagnosis.battery import Truth
from twin.diagnosis.candidates.candidate import Candidate
from twin.diagnosis.problem import Problem
from twin.machine.machine import Machine

FEW = (
    ("reversal", "X"),
    ("squareness", "E_B0Z"),
    ("cross_axis", "E_ZY by X"),
    ("cross_axis", "E_ZX by Y"),
    ("harmonic", "E_XC"),
    ("straightness", "E_ZY"),
    ("thermal_growth", "Z by bed"),
    ("zero_offset", "X"),
)


@pytest.fixture(scope="module")
def data(dmu50: Machine) -> tuple[Problem, list[Candidate]]:
    """A data set without errors, and a few candidates: two identical ones, one that the set-up absorbs."""
    rng = np.random.default_rng(31)
    problem, searcher, root = battery.measured(rng, dmu50, "isotropic", 40, False)
    problem.set_residual(battery.noise_of(rng, problem, root))
    return problem, [one for one in searcher.task.catalogue.candidates if one.key in FEW]


@pytest.fixture(scope="module")
def design(data: tuple[Problem, list[Candidate]]) -> rivals.Design:
    return rivals.Design(*data)


def hide(data: tuple[Problem, list[Candidate]], key: rivals.Key, size: float, noise: np.ndarray) -> Truth:
    problem, candidates = data
    own = next(one for one in candidates if one.key == key)
    truth = battery.some_effect(np.random.default_rng(32), problem, {own.effect: [own]}, size)
    problem.set_residual(noise + truth[1])
    return truth


@pytest.mark.parametrize("key", [FEW[0], FEW[1], FEW[4], FEW[5], FEW[6]], ids=" ".join)
def test_a_strong_effect_is_named(
    data: tuple[Problem, list[Candidate]], design: rivals.Design, key: rivals.Key
) -> None:
    problem, candidates = data
    quiet = problem.residual
    try:
        hide(data, key, 400.0, quiet)
        assert rivals.stepwise_bic(problem, candidates, design=design) == (key,)
        assert rivals.stepwise_bic(problem, candidates, design=design, extended=True) == (key,)
        assert rivals.lasso(problem, candidates, design=design)[0] == key
    finally:
        problem.set_residual(quiet)


def test_the_shortlist_leaves_nothing_out(data: tuple[Problem, list[Candidate]], design: rivals.Design) -> None:
    """The same choice as fitting every form by statsmodels; with two effects, one of them weak."""
    problem, candidates = data
    quiet = problem.residual
    try:
        truth = hide(data, FEW[5], 400.0, quiet)
        hide(data, FEW[4], 25.0, quiet + truth[1])
        every = rivals.stepwise_bic(problem, candidates, design=design, shortlist=len(design.blocks))
        assert rivals.stepwise_bic(problem, candidates, design=design) == every
        assert set(every) == {FEW[4], FEW[5]}
    finally:
        problem.set_residual(quiet)


def test_gains_are_those_of_a_regression(data: tuple[Problem, list[Candidate]], design: rivals.Design) -> None:
    problem, _ = data
    first = next(block for block in design.blocks if block.key == FEW[0])
    explained, dof = design.gains(problem.projected, [first])
    alone = sm.OLS(problem.projected, first.directions, hasconst=False).fit().ssr
    for i, block in enumerate(design.blocks):
        if block.key == FEW[0]:
            assert dof[i] == 0
            continue
        both = sm.OLS(problem.projected, np.hstack([first.directions, block.directions]), hasconst=False).fit()
        # Sums of squares of some 3,000 readings of variance 1: rounding is far below 1e-6.
        assert explained[i] == pytest.approx(alone - both.ssr, abs=1e-6)
        assert dof[i] == both.df_model - 1


def test_likeness_is_the_cosine_of_an_angle(data: tuple[Problem, list[Candidate]], design: rivals.Design) -> None:
    """An error in Z that grows with X and Y matches two candidates; one absorbed by the set-up matches none."""
    problem, _ = data
    quiet = problem.residual
    try:
        signature = hide(data, ("cross_axis", "E_ZY by X"), 100.0, quiet)[1]
    finally:
        problem.set_residual(quiet)
    like = design.likeness(signature - battery.basis_of(problem) @ (battery.basis_of(problem).T @ signature))
    assert like["cross_axis", "E_ZY by X"] == pytest.approx(1.0, abs=1e-9)
    assert like["cross_axis", "E_ZX by Y"] > rivals.ALIKE
    assert like["reversal", "X"] < rivals.ALIKE
    assert ("zero_offset", "X") not in like


@pytest.mark.slow
def test_the_draws_are_those_of_the_battery() -> None:
    own = battery.answers("one60", 2, 33, poses=30)
    results = rivals.compared("one60", 2, 33, poses=30)
    assert [(one.truth, one.named) for one in results["twin"]] == [(one.truth, one.named) for one in own]
    assert set(results) == {"twin", "stepwise BIC", "stepwise EBIC", "LASSO"}
    assert all([one.truth for one in said] == [one.truth for one in own] for said in results.values())


def test_a_cause_stands_for_one_effect() -> None:
    a, b, c = ("reversal", "X"), ("reversal", "Y"), ("squareness", "E_B0Z")
    one_for_both = rivals.Said((a, b), (c,), ((a, b),), (), 0.0)
    assert not one_for_both.right and not one_for_both.in_group and not one_for_both.too_many
    each_for_one = rivals.Said((a, b), (c, a), ((a, b), ()), (), 0.0)
    assert each_for_one.in_group and not each_for_one.right
    assert not rivals.Said((a,), (), (), (), 0.0).in_group
    assert rivals.Said((), (a,), ((),), (), 0.0).too_many
