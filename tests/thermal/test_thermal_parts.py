"""Parts of the thermal fit by hand or in a second formulation: evidence, noise, held-out data, terms, uncertainty of a prediction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from twin._common.arrays import read_only
from twin.thermal import ThermalModel, ThermalRecord, fit
from twin.thermal.evidence import (
    CONSTANT_UM,
    DENSE_SIZES,
    RESIDUAL_SHARES,
    RESIDUAL_TIME,
    Average,
    DrawnModels,
    Evidence,
    Inputs,
    TermCandidate,
    averaged,
    candidates,
    clusters,
    drivers,
    features,
    sensor_groups,
)
from twin.thermal.fit import named_terms
from twin.thermal.model import DisplacementModel

LAG = TermCandidate("thermal_lag", ("bed",), 600.0, 0.0, 8.0)
DRIFT = TermCandidate("thermal_drift", (), 900.0, 0.0, 5.0)
SQUARE = TermCandidate("spindle_growth", (), 300.0, 2.0, 15.0)


def record(count: int = 200, *, rng: np.random.Generator | None = None, **changed: Any) -> ThermalRecord:
    """Return a record of one sensor, one displacement and the speed, a row a minute."""
    time = 60.0 * np.arange(count)
    noise = 0.0 if rng is None else rng.normal(0.0, 0.5, count)
    made = ThermalRecord(
        "r.csv",
        time,
        (20.0 + 2.0 * np.sin(time / 2000.0))[:, None],
        ("bed",),
        (10.0 * np.sin(time / 2000.0 - 0.3) + noise)[:, None],
        ("Z",),
        np.where(np.arange(count) < count // 2, 1000.0, 0.0),
    )
    return replace(made, **changed)


# ---- evidence


def test_the_evidence_is_that_of_a_gaussian_process() -> None:
    """The density of the readings with prior and noise in one covariance; differences, because 2π is left out."""
    rng = np.random.default_rng(1)
    time, x, y = np.sort(rng.uniform(0.0, 9000.0, 30)), rng.normal(size=(30, 3)), rng.normal(0.0, 4.0, (30, 2))
    terms, noise = (LAG, DRIFT, SQUARE), np.array([0.3, 1.7])
    evidence = Evidence(x, y, time, terms, noise, 9000.0)
    full, prior = np.c_[x, np.ones(30)], np.array([8.0, 5.0, 15.0, 2.0])
    constant = 15.0 * np.log(2.0 * np.pi)
    for c in range(2):
        for kind in (0, 4, len(RESIDUAL_SHARES) - 1):
            size = RESIDUAL_SHARES[kind] * y[:, c].std()
            assert evidence.residual_um[c][kind] == pytest.approx(size)
            apart = np.abs(time[:, None] - time)
            own = size**2 * np.exp(-apart / (RESIDUAL_TIME * 9000.0)) + noise[c] ** 2 * np.eye(30)
            for chosen in ((), (1,), (2, 0)):
                columns = [*chosen, 3]
                design, variance = full[:, columns], np.diag(prior[columns] ** 2)
                whole = own + design @ variance @ design.T
                expected = stats.multivariate_normal.logpdf(y[:, c], cov=whole) + constant
                assert evidence.log_evidence(chosen, c, kind) == pytest.approx(expected, rel=1e-5)
                mean, covariance = evidence.coefficients(chosen, c, kind)
                gain = variance @ design.T @ np.linalg.inv(whole)
                assert mean == pytest.approx(gain @ y[:, c], rel=1e-5, abs=1e-6)
                assert covariance == pytest.approx(variance - gain @ design @ variance, rel=1e-5, abs=1e-6)
    # A model's evidence is the mean over the displacements of its group, less the cost of its terms.
    both = np.mean([evidence.log_evidence((0, 1), c, kind) for c, kind in enumerate((3, 5))])
    assert evidence._posterior((0, 1), (3, 5)) == pytest.approx(both - 3.0 - 6.0)


@pytest.mark.parametrize("size", [0.0, 1.0])
def test_an_average_over_models_has_their_mean_and_spread(size: float) -> None:
    """A mixture of normal distributions, drawn: models of few terms by their draws, those of all terms by sizes, both by evidence.

    The evidence of the drawn models is computed from the density of the readings; with one model it is that of the model alone.
    """
    rng = np.random.default_rng(2)
    x, time = rng.normal(size=(40, 2)), 60.0 * np.arange(40)
    y = x @ [[3.0], [-2.0]] + size * rng.normal(size=(40, 1))
    evidence = Evidence(x, y, time, (LAG, SQUARE), np.array([0.5 + size]), 2400.0)
    drawn = [((0,), 2), ((0, 1), 7), ((0, 1), 7), ((), 10)]
    found = evidence._average(drawn, 0)
    alike = y[:, 0].std() / x.std(axis=0) / [8.0, 15.0]
    every = [((0, 1), kind, one * alike) for one in DENSE_SIZES for kind in range(len(RESIDUAL_SHARES))]
    odds = np.array([evidence.log_evidence(model, 0, kind, times) for model, kind, times in every])
    joint = [evidence.log_evidence(model, 0, kind) - 3.0 * len(model) for model, kind in drawn]
    entropy = np.log(4.0) - 0.5 * np.log(2.0)
    few = np.mean(joint) + entropy - np.log(len(RESIDUAL_SHARES)) - 2.0 * np.log(1.0 + np.exp(-3.0))
    share = 1.0 / (1.0 + np.exp(np.log(np.mean(np.exp(odds - odds.max()))) + odds.max() - few))
    models = [(model, kind, 1.0, share / 4.0) for model, kind in drawn]
    weights = np.exp(odds - odds.max())
    models += [(*one, (1.0 - share) * w) for one, w in zip(every, weights / weights.sum(), strict=True)]
    draws = []
    for model, kind, times, weight in models:
        mean, covariance = evidence.coefficients(model, 0, kind, times)
        some = np.zeros((round(200_000 * weight), 3))
        some[:, [*model, 2]] = rng.multivariate_normal(mean, covariance, len(some))
        draws.append(some)
    mixture = np.concatenate(draws)
    spread = mixture.std(axis=0)
    assert np.abs(found.mean - mixture.mean(axis=0)).max() < 0.02 * spread.max()
    assert np.abs((found.covariance - np.cov(mixture.T)) / np.outer(spread, spread)).max() < 0.03
    expected = np.sqrt(sum(weight * evidence.residual_um[0][kind] ** 2 for _, kind, _, weight in models))
    assert found.residual_um == pytest.approx(expected, rel=1e-2)


# ---- preparation of a record


def test_the_white_noise_is_that_of_the_rows() -> None:
    """Noise of 0.5 µm beside a slow motion; 5000 differences of differences know it to 1.5 %."""
    problem = fit._problem(record(5000, rng=np.random.default_rng(3)))
    length = 5000 // 139
    assert len(problem.x) == len(problem.y) == 5000 // length
    assert problem.noise_um * np.sqrt(length) == pytest.approx([0.5], rel=0.06)


def test_candidates_and_their_values_by_hand() -> None:
    terms = candidates([("bed",), ("a", "b")], True, 139.0 * 60.0)
    lags = (60.0, 120.0, 240.0, 480.0, 960.0, 1900.0)
    expected = [("thermal_lag", group, tau, 0.0, 8.0) for group in (("bed",), ("a", "b")) for tau in (0.0, *lags)]
    expected += [("spindle_shift", (), 0.0, power, 15.0) for power in (1.0, 2.0)]
    expected += [("spindle_growth", (), tau, power, 15.0) for power in (1.0, 2.0) for tau in lags]
    expected += [("thermal_drift", (), tau, 0.0, 5.0) for tau in (*lags[1:], 3800.0)]
    assert [(one.effect, one.sensors, one.time_constant_s, one.exponent, one.prior) for one in terms] == expected
    rows = record(
        3,
        time_s=np.array([100.0, 160.0, 220.0]),
        temperature_degC=np.array([[20.0, 21.0], [22.0, 22.0], [22.0, 27.0]]),
        sensors=("a", "b"),
        speed_rpm=np.array([0.0, 500.0, 1000.0]),
        displacement_um=np.zeros((3, 1)),
    )
    inputs = Inputs({"a": 20.0, "b": 21.0}, 1000.0, 40.0)
    pair, shift = TermCandidate("thermal_lag", ("a", "b"), 0.0, 0.0, 8.0), replace(SQUARE, time_constant_s=0.0)
    assert drivers(rows, (pair, shift, DRIFT), inputs).T.tolist() == [[0.0, 1.5, 4.0], [0.0, 0.25, 1.0], [0.0] * 3]
    # A drift counts from the first row of the fitted record.
    drift = features(rows, (pair, shift, DRIFT), inputs)[:, 2]
    assert drift == pytest.approx(1.0 - np.exp(-np.array([60.0, 120.0, 180.0]) / 900.0))


def test_groups_of_sensors_at_their_limits() -> None:
    """Correlations of 0.94 and 0.96, standard deviations of 0.09 and 0.11 K, after averages over two rows."""
    rng = np.random.default_rng(4)
    basis, _ = np.linalg.qr(np.c_[np.ones(100), rng.normal(size=(100, 4))])
    unit = 10.0 * basis[:, 1:]
    near, far = (r * unit[:, 0] + np.sqrt(1.0 - r**2) * unit[:, 1] for r in (0.96, 0.94))
    assert clusters(np.c_[unit[:, 0], near], "ab") == [("a", "b")]
    assert clusters(np.c_[unit[:, 0], far], "ab") == [("a",), ("b",)]
    values = np.repeat(np.c_[unit[:, 0], 0.11 * unit[:, 2], 0.09 * unit[:, 3]], 2, axis=0)
    values[::2] += 0.3
    values[1::2] -= 0.3
    rows = record(200, temperature_degC=values, sensors=("a", "b", "c"))
    assert sensor_groups(rows, 2) == ([("a",), ("b",)], ("c",))
    assert averaged(np.arange(7.0)[:, None], 3).tolist() == [[1.0], [4.0]]


# ---- held-out data


def test_held_out_parts_and_their_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Folds by hand: what follows 40, 55 and 70 %, five of six blocks, the highest speed; fold k errs by k times what is expected."""
    speed = np.repeat([0.0, 500.0, 0.0, 900.0, 0.0, 500.0], 20)
    problem = fit._problem(record(120, speed_rpm=speed))
    fitted: list[list[int]] = []
    left_out: list[list[int]] = []

    def remember(problem: Any, rows: np.ndarray, seed: int) -> list[Any]:
        fitted.append(rows.tolist())
        return []

    def errors(problem: Any, models: Any, rows: np.ndarray, between: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        assert between.shape == (1, 1, 1)
        left_out.append(np.flatnonzero(rows).tolist())
        ones = np.ones((int(rows.sum()), 1))
        return 2.0 * len(left_out) * ones * (-1.0) ** np.arange(len(ones))[:, None], 4.0 * ones

    monkeypatch.setattr(fit, "_fit", remember)
    monkeypatch.setattr(fit, "_errors", errors)
    monkeypatch.setattr(fit, "_between_parts", lambda problem, fitted: np.full((1, 1, 1), len(fitted)))
    found = fit._held_out(problem, 0, lambda *_: None)
    expected = [list(range(first, 120)) for first in (48, 66, 84)]
    expected += [list(range(first, first + 20)) for first in range(20, 120, 20)]
    expected.append(list(range(60, 100)))  # the highest speed and the cooling behind it
    assert left_out == expected
    assert fitted == [[i for i in range(120) if i not in rows] for rows in expected]
    assert found.factor == pytest.approx([3.0])  # the largest of those that follow
    assert found.forward_um[:, 0] == pytest.approx([2.0, 4.0, 6.0])
    assert found.between == [[[5.0]]]
    assert found.blocks_um == pytest.approx([2.0 * np.sqrt(np.mean(np.arange(4, 9) ** 2))])
    assert fit._highest_speed_left_out(replace(problem, record=record(120))) is None
    mostly = np.r_[np.repeat([0.0, 500.0], 25), np.repeat(900.0, 70)]
    assert fit._highest_speed_left_out(replace(problem, record=record(120, speed_rpm=mostly))) is None


def test_errors_on_averaged_rows_by_hand() -> None:
    problem = fit._problem(record(150))
    covariance = np.diag(np.arange(len(problem.terms) + 1.0))
    covariance[0, -1] = covariance[-1, 0] = 0.4
    average = Average(np.linspace(-1.0, 2.0, len(problem.terms) + 1), covariance, 0.7)
    rows = np.arange(150) % 3 == 1
    full = np.c_[problem.x, np.ones(150)][rows]
    for between in (0.0, 2.0):
        more = None if between == 0.0 else between * covariance[None]
        error, variance = fit._errors(problem, [((0,), DrawnModels((), (average,)))], rows, more)
        assert error[:, 0] == pytest.approx(problem.y[rows, 0] - full @ average.mean)
        own = np.array([row @ covariance @ row for row in full])
        assert variance[:, 0] == pytest.approx((1.0 + between) * own + 0.49)


def test_the_coefficients_vary_from_block_to_block_as_the_jackknife_says() -> None:
    """Blocks of a mean of independent values: the jackknife is the squared standard error of their mean."""
    rng = np.random.default_rng(2)
    problem = fit._problem(record(150))
    blocks = rng.normal(size=(5, len(problem.terms) + 1))
    none = np.zeros((blocks.shape[1],) * 2)
    fitted = []
    for left_out in range(5):
        mean = np.delete(blocks, left_out, axis=0).mean(axis=0)
        fitted.append([((0,), DrawnModels((), (Average(mean, none, 1.0),)))])
    found = fit._between_parts(problem, fitted)
    assert found[0] == pytest.approx(np.cov(blocks.T) / 5.0)


def test_all_terms_together_are_ridge_regression() -> None:
    """With a size and a residual, the coefficients are those of generalised ridge regression, written out; a drift is none of them."""
    problem = fit._problem(record(150))
    evidence = Evidence(problem.x, problem.y, problem.time_s, problem.terms, problem.noise_um, problem.duration_s)
    apart = np.abs(problem.time_s[:, None] - problem.time_s) / (RESIDUAL_TIME * problem.duration_s)
    design = np.c_[problem.x, np.ones(len(problem.x))]
    drift = np.array([term.effect == "thermal_drift" for term in problem.terms])
    models, _ = evidence._all_terms(0)
    assert sum(share for *_, share in models) == pytest.approx(1.0)
    for order, (model, kind, times, _) in list(enumerate(models))[::7]:
        size = DENSE_SIZES[order // len(RESIDUAL_SHARES)]
        noise = evidence.residual_um[0][kind] ** 2 * np.exp(-apart)
        noise += (problem.noise_um[0] ** 2 + 1e-8) * np.eye(len(apart))
        alike = np.where(drift, 1e-9, size * problem.y[:, 0].std() / problem.x.std(axis=0))
        gram = design.T @ np.linalg.solve(noise, design) + np.diag(1.0 / np.append(alike, CONSTANT_UM) ** 2)
        expected = np.linalg.solve(gram, design.T @ np.linalg.solve(noise, problem.y[:, 0]))
        found, _ = evidence.coefficients(model, 0, kind, times)
        assert np.all(found[:-1][drift] == 0.0)
        assert design @ found == pytest.approx(design @ expected, abs=1e-3)


def test_few_directions_keep_the_variance() -> None:
    """A covariance of rank one or two is kept whole; the factor is that of the variance a file leaves out."""
    rng = np.random.default_rng(5)
    scale = np.array([0.2, 3.0, 1.0, 10.0])
    one, other = rng.normal(size=(2, 4)) / scale
    found = fit._directions(np.outer(one, one), scale)
    assert found.shape == (1, 4)
    assert 0.99 * found.T @ found == pytest.approx(np.outer(one, one), abs=1e-9)
    assert found[0, np.argmax(np.abs(found[0] * scale))] > 0.0
    both = np.outer(one, one) + np.outer(other, other)
    two = fit._directions(both, scale)
    assert len(two) == 2 and 0.99 * two.T @ two == pytest.approx(both, abs=1e-9)


# ---- terms and predictions


def test_terms_by_hand() -> None:
    """Two lags of one sensor and one of the speed: sums, means weighted by the squares, alternatives."""
    slow = replace(LAG, time_constant_s=1800.0)
    terms = (LAG, slow, SQUARE)
    x = np.array([[1.0, 0.0, 0.0], [-1.0, 2.0, 1.0], [3.0, 1.0, 4.0]])
    mean = np.array([2.0, 1.0, -0.5, 7.0])
    covariance = np.diag([0.5, 1.0, 0.25, 9.0])
    covariance[0, 1] = covariance[1, 0] = -0.3
    models = ((0,), (0, 1), (2,), (1, 2), (0,), (2,), (2,), (2,), (2,), (2,))
    found = named_terms("Z", terms, x, DrawnModels(models, ()), Average(mean, covariance, 1.5), 2.0)
    bed, speed = found
    assert (bed.name, bed.input, bed.effect, bed.unit) == ("Z by bed", "bed", "thermal_lag", "µm/K")
    assert (speed.name, speed.input, speed.effect, speed.unit) == ("Z", "speed", "spindle_growth", "µm")
    assert bed.coefficient == 3.0 and speed.coefficient == -0.5
    assert bed.standard_uncertainty == pytest.approx(2.0 * np.sqrt(0.5 + 1.0 - 0.6))
    weights = np.array([2.0**2 + 0.5, 1.0 + 1.0]) / 6.5
    tau = weights @ [600.0, 1800.0]
    assert bed.time_constant_s == pytest.approx(tau)
    assert bed.u_time_constant_s == pytest.approx(np.sqrt(weights @ (np.array([600.0, 1800.0]) - tau) ** 2))
    assert bed.exponent is None and speed.exponent == 2.0
    assert bed.contribution_um == pytest.approx(np.std([2.0, 0.0, 7.0])) and bed.matters
    assert speed.contribution_um == pytest.approx(np.std([0.0, -0.5, -2.0])) and not speed.matters
    assert (bed.share, speed.share) == (0.4, 0.7)
    # All models without the bed follow the speed, of those with it one in four; the converse holds for the bed.
    assert bed.alternatives == ("speed",) and speed.alternatives == ("bed",)
    # Four inputs: those followed more often without the first come by how much more, and not those less than 0.15 more.
    models = ((0,),) * 10 + ((2, 1),) * 4 + ((2, 3), (2,)) * 2 + ((2, 1, 3),)
    others = [replace(LAG, sensors=(name,)) for name in "bcd"]
    some = named_terms(
        "Z", (LAG, *others), np.ones((2, 4)), DrawnModels(models, ()), Average(np.ones(5), np.eye(5), 1.0), 1.0
    )
    assert some[0].share == 10 / 19 and some[0].alternatives == ("c", "b", "d")


def by_hand() -> ThermalModel:
    """Return a model with a lag of one sensor and the square of the speed."""
    one = DisplacementModel(
        "Z", (), np.array([3.0, -2.0, 0.5]), 0.4, 0.0, (), 1.5, np.array([[0.3, 0.0, 0.1], [0.0, 0.2, 0.0]])
    )
    return ThermalModel(
        "r.csv",
        (LAG, SQUARE),
        Inputs({"bed": 20.0}, 1000.0, 0.0),
        (one,),
        np.array([[18.0, 22.0]]),
        ("bed",),
        (("bed",),),
        6000.0,
        60.0,
        np.array([1.0, 0.5]),
        np.array([2.0, 1.0]),
        np.array([0.8, 0.05]),
    )


def rows(start_s: float, temperature: Sequence[float], speed: Sequence[float]) -> ThermalRecord:
    count = len(temperature)
    return record(
        count,
        time_s=read_only(start_s + 60.0 * np.arange(count)),
        temperature_degC=np.array(temperature)[:, None],
        speed_rpm=np.array(speed, dtype=float),
        displacement_um=np.full((count, 1), 10.0),
    )


def expected(values: np.ndarray, doubt: np.ndarray, beyond: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    full = np.c_[values, np.ones(len(values))]
    covariance = np.array([[0.09, 0.0, 0.03], [0.0, 0.04, 0.0], [0.03, 0.0, 0.01]])
    own = np.einsum("ni,ij,nj->n", full, covariance, full)
    start = doubt**2 @ [3.0**2 + 0.09, 2.0**2 + 0.04]
    return full @ [3.0, -2.0, 0.5], 1.5 * np.sqrt(own + start + (0.4 * (1.0 + beyond)) ** 2)


def test_the_uncertainty_of_a_prediction_by_hand() -> None:
    """Steady start: the doubt of the lags decays; beyond the ranges the residual grows by widths of the range."""
    model = by_hand()
    found = model.predict(rows(0.0, [23.0] * 3, [500.0] * 3))
    time = np.array([0.0, 60.0, 120.0])
    doubt = np.array([0.8, 0.05]) * np.exp(-time[:, None] / [600.0, 300.0])
    started = 1.0 - np.exp(-time / 300.0)
    value, u = expected(np.c_[np.full(3, 3.0), 0.25 * started], doubt, np.full(3, 0.25))
    assert found.displacement_um[:, 0] == pytest.approx(value)
    assert found.standard_uncertainty_um[:, 0] == pytest.approx(u)
    assert found.residual_um[:, 0] == pytest.approx(10.0 - value)
    assert found.expected_rms_um == pytest.approx([np.sqrt(np.mean(u**2))])
    assert "by at most 1 K (bed)" in found.warnings[1] and len(found.warnings) == 2
    # The larger of the two distances counts: half of the highest speed beyond it.
    fast = model.predict(rows(0.0, [17.0] * 3, [1500.0] * 3))
    _, u = expected(np.c_[np.full(3, -3.0), 2.25 * started], doubt, np.full(3, 0.5))
    assert fast.standard_uncertainty_um[:, 0] == pytest.approx(u) and "speed up to 1500 rpm" in fast.warnings[2]
    # A record that begins with the fitted one has no doubt about its start.
    same = model.predict(rows(0.0, [20.0] * 3, [0.0] * 3))
    _, u = expected(np.zeros((3, 2)), np.zeros((3, 2)), np.zeros(3))
    assert same.standard_uncertainty_um[:, 0] == pytest.approx(u) and same.warnings == ()


@pytest.mark.parametrize(("gap", "follows"), [(60.0, True), (300.0, True), (301.0, False), (0.0, False)])
def test_a_record_that_follows_goes_on_from_the_last_state(gap: float, follows: bool) -> None:
    """Up to five intervals behind the last row; the state decays towards a temperature, linear in time, and a speed that is held."""
    found = by_hand().predict(rows(6000.0 + gap, [20.0] * 2, [0.0] * 2))
    assert bool(found.warnings) != follows
    if follows:
        state = []
        for first, tau, last in ((1.0, 600.0, 2.0), (0.5, 300.0, 1.0)):
            steps = np.linspace(0.0, gap, 20_001)
            middle = (steps[1:] + steps[:-1]) / 2.0
            step = np.diff(steps)[0]
            # A speed is that of the time up to its row: zero from the last fitted row on.
            driven = (tau == 600.0) * np.sum(np.exp(-(gap - middle) / tau) * last * (1.0 - middle / gap)) * step / tau
            state.append(first * np.exp(-gap / tau) + driven)
        values = np.array([state, np.array(state) * np.exp(-60.0 / np.array([600.0, 300.0]))])
        value, u = expected(values, np.zeros((2, 2)), np.zeros(2))
        assert found.displacement_um[:, 0] == pytest.approx(value, rel=1e-6)
        assert found.standard_uncertainty_um[:, 0] == pytest.approx(u, rel=1e-6)
