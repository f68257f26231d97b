"""Each statistical promise of the parts of `identify` by its own number: outliers, repeats, priors, uncertainty of curves.

Probabilities come from `scipy.stats`; limits of counts are those that a right probability exceeds once in ten thousand runs.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import scipy
from scipy import stats

from tests.identification.plans import read_by_truth, volumetric
from tests.model.errors import random_calibration
from tests.truth.machine import TruthMachine
from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin.identification import Identification, identify
from twin.identification.discrepancy import RowAssessment, assess_rows
from twin.identification.fitting import DECAYS, SIZES, TiedCurves, mixed_prior, robust_start
from twin.identification.inputs import prepare
from twin.identification.network import Network, Unknowns, stated_covariance
from twin.identification.orders import _Fold, choose
from twin.identification.solve import covariance_from_repeats, misfit, repeats_of
from twin.identification.unidentified import determined_models
from twin.machine.machine import Machine
from twin.measurement.instruments import (
    Instrument,
    LaserTracker,
    StationInstruments,
    TrackingInterferometer,
)
from twin.measurement.observation import nominal_carriers, repeat_groups
from twin.measurement.set_up import initial_setup
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.motion_curve import Curve
from twin.samples import thesis_plan

RARE = 1e-4


def assessed(
    whitened: np.ndarray, scale_m: float = 1e-6, kinds: np.ndarray | None = None, coordinates: int = 3
) -> RowAssessment:
    """Return the assessment of (n, 3) residuals in units of their standard deviations, one target from one station by default.

    Args:
        whitened: the residuals.
        scale_m: standard deviation of a reading.
        kinds: (n,) names of the targets.
        coordinates: number of coordinates that are read, the first ones.
    """
    n = len(whitened)
    read = np.zeros((n, 3), dtype=bool)
    read[:, :coordinates] = True
    names = np.full(n, "K", dtype=object) if kinds is None else kinds
    network = SimpleNamespace(
        read=read,
        whitening=read[:, :, None] * np.eye(3) / scale_m,
        data=SimpleNamespace(target=names, station=np.full(n, "1", dtype=object)),
    )
    return assess_rows(cast(Network, network), np.where(read, whitened, 0.0))


@pytest.mark.parametrize("sets", [100, pytest.param(1500, marks=pytest.mark.slow)])
@pytest.mark.parametrize("coordinates", [1, 2, 3])
def test_false_alarms_and_detections_of_single_outliers(coordinates: int, sets: int) -> None:
    """One data set in a hundred loses a point, and an outlier of d standard deviations is found as noncentral chi² says.

    The median of 400 rows is 5 % above or below that of chi², which is taken for a misfit: the limit is up to 15 % higher.
    """
    rng, n = np.random.default_rng(coordinates), 400
    limit = stats.chi2.isf(0.01 / n, coordinates)
    strange = np.sqrt(limit)
    alarms = detected = 0
    for _ in range(sets):
        whitened = rng.standard_normal((n, 3))
        alarms += int(assessed(whitened, coordinates=coordinates).bad.any())
        way = np.zeros(3)
        way[:coordinates] = rng.standard_normal(coordinates)
        whitened[7] += strange * way / np.linalg.norm(way)
        detected += int(assessed(whitened, coordinates=coordinates).bad[7])
    assert alarms <= stats.binom.isf(RARE, sets, 0.01)
    most, least = (stats.ncx2.sf(factor * limit, coordinates, strange**2) for factor in (1.0, 1.15))
    assert stats.binom.ppf(RARE, sets, least) <= detected <= stats.binom.isf(RARE, sets, most), (least, most)


def test_the_misfit_of_each_target_is_its_own() -> None:
    """Two targets, one with a misfit of three standard deviations; in µm per coordinate; the other has next to none."""
    rng, n = np.random.default_rng(4), 4000
    names = np.where(np.arange(n) % 2 == 0, "K", "P").astype(object)
    whitened = rng.standard_normal((n, 3)) * np.where(names == "P", np.sqrt(1.0 + 9.0), 1.0)[:, None]
    found = assessed(whitened, scale_m=2e-6, kinds=names)
    # Median of 2000: its standard error is 2.7 %, of a standard deviation half of that.
    assert found.misfit_um["P", "1"] == pytest.approx(3.0 * 2.0, rel=0.06)
    assert found.misfit_um.get(("K", "1"), 0.0) < 0.35 * 2.0
    # Mean of the two groups' squares, 1 and 10.
    assert found.noise == pytest.approx(np.sqrt((1.0 + 10.0) / 2.0), rel=0.04)
    # Huber's weight counts from two standard deviations of a coordinate, of the misfit and not of the noise.
    size = np.sqrt(np.sum(whitened**2, axis=1) / 3.0 / 10.0)
    far = (names == "P") & (size > 2.2)
    assert far.any() and found.weight[far] == pytest.approx(
        (2.0 / size[far]) * 0.9 + 0.1 * (1.0 + size[far] ** 2 / 9.0) ** -2, rel=0.06
    )


def test_few_rows_of_a_target_share_one_misfit() -> None:
    rng = np.random.default_rng(9)
    names = np.array([f"T{k // 29}" for k in range(290)], dtype=object)
    found = assessed(3.0 * rng.standard_normal((290, 3)), kinds=names)
    assert len(set(found.misfit_um.values())) == 1 and len(found.misfit_um) == 10
    own = assessed(
        3.0 * rng.standard_normal((300, 3)), kinds=np.array([f"T{k // 30}" for k in range(300)], dtype=object)
    )
    assert len(set(own.misfit_um.values())) == 10


@pytest.mark.parametrize(("ratio", "bad"), [(1.9, False), (2.1, True)])
def test_a_gap_separates_an_outlier_from_a_misfit(ratio: float, bad: bool) -> None:
    """All rows have a misfit of twenty standard deviations; the largest is beyond the wider limit, the next one just below it."""
    n = 200
    size = np.full(n, 20.0 * np.sqrt(stats.chi2.median(3)))
    # The limit is 1.5 times that of the noise, if all of the deviation is the misfit (400 of 401 parts of it).
    limit = 1.5 * np.sqrt(stats.chi2.isf(0.01 / n, 3)) * 20.0
    size[3], size[8] = 1.02 * limit, 1.02 * limit / ratio
    assert size[8] < limit < size[3]
    found = assessed(np.outer(size, [0.0, 0.6, 0.8]))
    assert np.flatnonzero(found.beyond).tolist() == [3]
    assert bool(found.bad[3]) is bad and np.count_nonzero(found.bad) == int(bad)


def test_of_two_gaps_the_rows_above_one_are_outliers() -> None:
    """The row below the gap is beyond the limit too, but nothing separates it from those below it."""
    n = 200
    size = np.full(n, 20.0 * np.sqrt(stats.chi2.median(3)))
    limit = 1.5 * np.sqrt(stats.chi2.isf(0.01 / n, 3)) * 20.0
    size[[3, 8, 11]] = 2.2 * limit, 1.05 * limit, 0.9 * limit
    found = assessed(np.outer(size, [0.0, 0.6, 0.8]))
    assert np.flatnonzero(found.beyond).tolist() == [3, 8] and np.flatnonzero(found.bad).tolist() == [3]


@pytest.mark.parametrize(("factor", "beyond"), [(0.97, False), (1.03, True)])
@pytest.mark.parametrize("coordinates", [1, 3])
def test_the_limit_of_a_misfit_is_wider_by_half(coordinates: int, factor: float, beyond: bool) -> None:
    n = 200
    size = np.full(n, 20.0 * np.sqrt(stats.chi2.median(coordinates)))
    size[3] = factor * 1.5 * np.sqrt(stats.chi2.isf(0.01 / n, coordinates)) * 20.0
    way = [1.0, 0.0, 0.0] if coordinates == 1 else [0.0, 0.6, 0.8]
    assert bool(assessed(np.outer(size, way), coordinates=coordinates).beyond[3]) is beyond


def test_weights_of_a_model_that_fits() -> None:
    """Without a misfit a row of k standard deviations of a coordinate has the weight (1 + k²/9)⁻² (Geman and McClure)."""
    whitened = np.full((400, 3), 0.85)
    whitened[[5, 6]] = [[3.0], [1.5]]
    found = assessed(whitened)
    assert found.misfit_um == {} and found.noise == 1.0
    assert found.weight[[5, 6]] == pytest.approx([0.25, 1.25**-2])


def table(rows: dict[str, Any], machine: Machine) -> Measurements:
    """Return a table of a target K on the tool from station 1, at X and with the approach of X as given."""
    n = len(rows["X"])
    positions = np.zeros((n, 5))
    positions[:, 0] = rows["X"]
    approach = np.zeros((n, 5))
    approach[:, 0] = rows.get("approach", np.zeros(n))
    names = {
        key: np.array(rows.get(key, [word] * n), dtype=object) for key, word in (("target", "K"), ("station", "1"))
    }
    return Measurements(
        source="a test",
        lines=np.arange(n) + 2,
        positions=positions,
        carrier=np.full(n, "tool", dtype=object),
        point_mm=np.asarray(rows.get("point_mm", np.ones((n, 3)))),
        approach=approach,
        **names,
    )


def test_repeats_are_of_one_point_from_one_side(dmu50: Machine) -> None:
    """Command, approach, target and station distinguish points; the round does not; a thousandth of a micrometre does not."""
    data = table(
        {
            "X": [1.0, 1.0, 1.0 + 1e-7, 1.0, 1.0, 1.0, 1.001],
            "approach": [1, 1, 1, -1, 1, 1, 1],
            "target": list("KKKKPKK"),
            "station": list("1111121"),
        },
        dmu50,
    )
    group = repeat_groups(replace(data, round=np.array(list("1234567"), dtype=object))).tolist()
    assert group[0] == group[1] == group[2]
    assert len(set(group)) == 5


def test_backlash_is_no_noise_of_repeats(dmu50: Machine) -> None:
    """Twenty standard deviations of backlash: the repeats of each side have a reduced chi² of one, their lack of fit shows it."""
    rng, n = np.random.default_rng(1), 400
    side = rng.choice([-1.0, 1.0], n)
    data = table({"X": np.arange(n) % 20, "approach": side}, dmu50)
    whitened = rng.standard_normal((n, 3))
    whitened[:, 0] += 10.0 * side
    found = misfit(whitened, np.ones((n, 3), dtype=bool), data, 0.0, np.ones(n, dtype=bool))
    assert found.pure_dof == 3 * (n - 40)
    assert abs(found.pure_reduced - 1.0) < 3.9 * np.sqrt(2.0 / found.pure_dof)
    assert found.lack_p_value < 1e-6 and found.p_value < 1e-6


def test_p_values_of_a_right_model_are_uniform(dmu50: Machine) -> None:
    """P-values of the residuals and of the lack of fit, each with the degrees of freedom of the readings that were used."""
    rng, n, draws = np.random.default_rng(2), 60, 400
    read = np.ones((n, 3), dtype=bool)
    read[::3, 1:] = False
    used = np.arange(n) % 10 != 0
    data = table({"X": np.arange(n) % 4}, dmu50)
    p = []
    for _ in range(draws):
        found = misfit(np.where(read, rng.standard_normal((n, 3)), 0.0), read, data, 0.0, used)
        p.append((found.p_value, found.lack_p_value))
    assert found.dof == np.count_nonzero(read[used])
    assert misfit(np.ones((n, 3)), read, data, 7.5, used).dof == found.dof - 7.5
    lack = found.dof - found.pure_dof
    ratio = (found.chi2 - found.pure_chi2) / lack / found.pure_reduced
    assert found.lack_p_value == pytest.approx(stats.f.sf(ratio, lack, found.pure_dof), rel=1e-9)
    for column in np.array(p).T:
        assert stats.kstest(column, "uniform").pvalue > RARE


def noise_of_repeats(machine: Machine, data: Measurements, instrument: Instrument) -> np.ndarray:
    """Return (n, 3, 3) the covariance of readings of one instrument from their repeats, m²."""
    readers = StationInstruments.same(instrument, data.station)
    return covariance_from_repeats(data, readers, repeats_of(machine, data, readers, stated_covariance(data, readers)))


@pytest.mark.parametrize("each", [2, 5])
@pytest.mark.parametrize("instrument", [LaserTracker(), TrackingInterferometer()], ids=lambda one: one.name)
def test_the_noise_of_repeats_has_its_own_size(dmu50: Machine, instrument: Instrument, each: int) -> None:
    """Three times the instrument's own: found without bias from pairs (n and n − 1 differ twofold), along and across the beam."""
    rng, places, draws = np.random.default_rng(each), 20, 60
    away = rng.uniform(0.5, 2.0, (places, 3))
    points = np.repeat(away, each, axis=0)
    truth = 9.0 * instrument.covariance(points)
    lower = np.zeros_like(truth)
    kept = [0, 1, 2] if isinstance(instrument, LaserTracker) else [0]
    inside = np.ix_(range(len(points)), kept, kept)
    lower[inside] = np.linalg.cholesky(truth[inside])
    exact = np.where(np.isin(range(3), kept), instrument.read(points), np.nan)
    ratio = np.zeros((draws, 2))
    beam = (
        points / np.linalg.norm(points, axis=1, keepdims=True)
        if len(kept) == 3
        else np.tile(np.eye(3)[0], (len(points), 1))
    )
    for k in range(draws):
        noise = np.einsum("nij,nj->ni", lower, rng.standard_normal(points.shape))
        data = table({"X": np.repeat(np.arange(places), each), "point_mm": (exact + noise) * 1e3}, dmu50)
        found = noise_of_repeats(dmu50, data, instrument)
        for i, of in enumerate((found, truth)):
            along = np.einsum("ni,nij,nj->n", beam, of, beam)
            whole = np.trace(of, axis1=1, axis2=2)
            ratio[k] = (
                ratio[k] / [along.mean(), max((whole - along).mean(), 1e-300)]
                if i
                else [along.mean(), (whole - along).mean()]
            )
    # Of each draw: √(2/dof) along, √(1/dof) across; three and a half standard errors of the mean.
    dof = places * (each - 1)
    assert abs(ratio[:, 0].mean() - 1.0) < 3.9 * np.sqrt(2.0 / dof / draws) + 0.02
    assert len(kept) == 1 or abs(ratio[:, 1].mean() - 1.0) < 3.9 * np.sqrt(1.0 / dof / draws) + 0.02


def test_ten_repeats_are_needed(dmu50: Machine) -> None:
    rng = np.random.default_rng(3)
    for rows, enough in ((11, True), (10, False)):
        data = table({"X": np.zeros(rows), "point_mm": 1000.0 + rng.normal(size=(rows, 3))}, dmu50)
        if enough:
            assert np.isfinite(noise_of_repeats(dmu50, data, LaserTracker())).all()
            continue
        with pytest.raises(InputError, match="too few repeats") as caught:
            noise_of_repeats(dmu50, data, LaserTracker())
        assert caught.value.value == 9


@pytest.mark.parametrize("seed", range(4))
def test_a_mixed_prior_shrinks_as_its_sizes_and_decays_do_on_average(seed: int) -> None:
    """Evidence of each pair from the normal density of the least-squares estimate, which is N(0, C + prior): a second formulation."""
    rng, count = np.random.default_rng(seed), 5
    noise = np.diag(10.0 ** rng.uniform(-9, -5, count))
    estimate = rng.normal(size=count) * 10.0 ** rng.uniform(-4, -1) * 0.5 ** np.arange(count)
    held, shares = 10.0 ** rng.uniform(2, 5, count), rng.dirichlet(np.ones(len(SIZES)))
    covariance = np.linalg.inv(np.linalg.inv(noise) + np.diag(held))
    mixture = mixed_prior(
        covariance @ np.linalg.solve(noise, estimate),
        covariance,
        held,
        shares,
        TiedCurves(np.arange(count), np.arange(count), np.eye(count)),
    )
    log = np.empty((len(SIZES), len(DECAYS)))
    priors, estimates = np.empty((*log.shape, count)), np.empty((*log.shape, count))
    for i, size in enumerate(SIZES):
        for j, decay in enumerate(DECAYS):
            priors[i, j] = size**2 * decay ** np.arange(count)
            log[i, j] = stats.multivariate_normal(np.zeros(count), noise + np.diag(priors[i, j])).logpdf(estimate)
            estimates[i, j] = estimate * priors[i, j] / (priors[i, j] + np.diag(noise))
    likelihood = np.exp(log - log.max())
    weight = likelihood * shares[:, None]
    weight /= weight.sum()
    np.testing.assert_allclose(mixture.share_of_size, weight.sum(axis=1), rtol=1e-6, atol=1e-12)
    # Readings of independent coefficients: the one prior leaves each the mean of all estimates.
    shrunk = estimate / (1.0 + np.diag(noise) * mixture.precision)
    np.testing.assert_allclose(shrunk, np.einsum("ij,ijk->k", weight, estimates), rtol=1e-6)
    # The grid's sizes are far apart where a coefficient is determined to many digits; both round alike.
    expected = np.einsum("ij,ijk->k", likelihood, priors) / likelihood.sum()
    np.testing.assert_allclose(mixture.variance, expected, rtol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_a_mixed_prior_of_tied_curves_is_that_of_their_allowed_part(seed: int) -> None:
    """Two curves of three coefficients with one condition on both: evidence of the allowed part from its own normal density.

    The prior of the allowed part is the conditional one, K = P − P a (aᵀ P a)⁻¹ aᵀ P of the diagonal prior P and the condition a.
    """
    rng = np.random.default_rng(seed)
    orders, condition = np.tile(np.arange(3), 2), rng.normal(size=(6, 1))
    condition /= np.linalg.norm(condition)
    inside = np.linalg.svd(condition)[0][:, 1:]
    noise = np.diag(10.0 ** rng.uniform(-9, -6, 5))
    estimate = rng.normal(size=5) * 10.0 ** rng.uniform(-4, -2)
    held, shares = 10.0 ** rng.uniform(2, 4, 6), rng.dirichlet(np.ones(len(SIZES)))
    covariance = np.linalg.inv(np.linalg.inv(noise) + inside.T @ np.diag(held) @ inside)
    mean = inside @ covariance @ np.linalg.solve(noise, estimate)
    tied = TiedCurves(np.arange(6), orders, inside)
    mixture = mixed_prior(mean, inside @ covariance @ inside.T, held, shares, tied)
    log, priors = np.empty((len(SIZES), len(DECAYS))), np.empty((len(SIZES), len(DECAYS), 6))
    for i, size in enumerate(SIZES):
        for j, decay in enumerate(DECAYS):
            priors[i, j] = size**2 * decay**orders
            prior = np.diag(priors[i, j])
            across = prior @ condition
            allowed = inside.T @ (prior - across @ across.T / (condition.T @ across)) @ inside
            log[i, j] = stats.multivariate_normal(np.zeros(5), noise + allowed).logpdf(estimate)
    likelihood = np.exp(log - log.max())
    weight = likelihood * shares[:, None]
    weight /= weight.sum()
    np.testing.assert_allclose(mixture.share_of_size, weight.sum(axis=1), rtol=1e-5, atol=1e-10)
    expected = np.einsum("ij,ijk->k", likelihood, priors) / likelihood.sum()
    np.testing.assert_allclose(mixture.variance, expected, rtol=1e-5)


def test_a_coefficient_that_the_conditions_fix_has_no_influence() -> None:
    """Two curves of three coefficients, the first one zero by the datum: the prior of the others is the one without it."""
    rng = np.random.default_rng(2)
    orders, inside = np.tile(np.arange(3), 2), np.eye(6)[:, 1:]
    root = rng.normal(size=(5, 5)) * 1e-3
    covariance, mean, held = root @ root.T, rng.normal(size=5) * 1e-3, np.full(6, 10.0)
    shares = np.full(len(SIZES), 1.0 / len(SIZES))
    whole = mixed_prior(
        inside @ mean, inside @ covariance @ inside.T, held, shares, TiedCurves(np.arange(6), orders, inside)
    )
    alone = mixed_prior(mean, covariance, held[1:], shares, TiedCurves(np.arange(5), orders[1:], np.eye(5)))
    assert np.all(np.isfinite(whole.precision))
    np.testing.assert_allclose(whole.precision[1:], alone.precision, rtol=1e-6)
    np.testing.assert_allclose(whole.variance[1:], alone.variance, rtol=1e-6)


def test_results_do_not_depend_on_the_size_of_chunks(dmu50: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows are computed in chunks of thousands; in chunks of 17 and 7 the same readings give the same estimate, all of its parts."""
    rng = np.random.default_rng(6)
    names = ("E_XX", "E_YX", "E_BY", "E_C0Y", "E_X0C")
    # In the datum of `identify`, and within the orders that it tries.
    curves = {"E_XX": (-4.0, 10.0, 12.0), "E_YX": (-2.5, 0.0, 7.5), "E_BY": (0.0, 40.0, 0.0)}
    errors = replace(
        Calibration.zero(dmu50),
        curves={
            name: Curve(name, "urad" if name == "E_BY" else "um", dmu50.by_name[name[3]].domain, "power", values)
            for name, values in curves.items()
        },
        squareness={"E_C0Y": 30.0},
        location={"E_X0C": -25.0},
    )
    data, _ = simulate(volumetric(dmu50, rng, 60), dmu50, errors, LaserTracker(), rng)

    def found() -> Identification:
        return identify(data, dmu50, wanted=lambda name: name in names, spread="between poses")

    whole = found()
    monkeypatch.setattr("twin.identification.network.CHUNK", 17)
    monkeypatch.setattr("twin.identification.network.VIEW_CHUNK", 7)
    parts = found()
    assert parts.choice.counts == whole.choice.counts
    # Far below the ratio at which two models count as equally good.
    assert parts.choice.held_out == pytest.approx(whole.choice.held_out, rel=1e-8)
    assert parts.misfit.chi2 == pytest.approx(whole.misfit.chi2, rel=1e-6)
    # Sums in another order, of a problem whose condition is 1e4.
    np.testing.assert_allclose(parts.residual_mm, whole.residual_mm, atol=1e-7)
    np.testing.assert_array_equal(parts.used, whole.used)
    one, two = (own.calibration.covariance for own in (whole, parts))
    assert one.names == two.names
    u = np.sqrt(np.diag(one.matrix))
    np.testing.assert_allclose(two.matrix / np.outer(u, u), one.matrix / np.outer(u, u), atol=1e-5)


def test_a_table_of_many_rows_is_read_row_by_row(dmu50: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every reading and derivative of a linearised table is that of its row alone, across the boundaries of its chunks."""
    rng = np.random.default_rng(7)
    data, _ = simulate(volumetric(dmu50, rng, 30), dmu50, random_calibration(dmu50, rng, 50.0), LaserTracker(), rng)
    instruments = StationInstruments.same(LaserTracker(), data.station)
    network = Network(dmu50, data, instruments, Unknowns(dmu50, [], ["E_C0Y", "E_X0C"]))
    setup, _ = initial_setup(data, instruments, nominal_carriers(dmu50, data))
    theta = np.array([12.0, -30.0])
    monkeypatch.setattr("twin.identification.network.VIEW_CHUNK", 8)
    view = network.view(theta, setup, np.arange(30))
    for row in range(30):
        alone = network.view(theta, setup, np.array([row]))
        for whole, own in zip(view.arrays(), alone.arrays(), strict=True):
            np.testing.assert_allclose(whole[row], own[0], rtol=1e-12, atol=1e-15)


def test_a_probe_finds_the_same_point_at_other_positions(dmu50: Machine) -> None:
    """Repeats of a probe, which reads zero by definition, differ by hundredths of a millimetre; those of a tracker do not."""
    data = table({"X": [100.01, 100.02, 99.99, 103.0], "point_mm": np.zeros((4, 3))}, dmu50)
    probe = replace(data, station_carrier=np.full(4, "work", dtype=object))
    assert len(set(repeat_groups(probe).tolist())) == 2
    assert len(set(repeat_groups(replace(probe, point_mm=np.ones((4, 3)))).tolist())) == 4


def test_stated_uncertainties_precede_the_instruments(dmu50: Machine) -> None:
    """A row counts as stated if every coordinate that it reads has an uncertainty, in millimetres (k = 1)."""
    points = np.array([[1000.0, 0.0, 0.0]] * 4)
    points[3, 1:] = np.nan
    u = np.array([[0.002, 0.003, 0.004], [0.002, 0.003, np.nan], [np.nan] * 3, [0.002, np.nan, np.nan]])
    data = replace(table({"X": np.arange(4), "point_mm": points}, dmu50), u_mm=u)
    tracker = LaserTracker()
    found = stated_covariance(data, StationInstruments.same(tracker, data.station))
    own = tracker.covariance(np.array([[1.0, 0.0, 0.0]]))[0]
    np.testing.assert_allclose(found[0], np.diag([4e-12, 9e-12, 16e-12]), rtol=1e-12)
    np.testing.assert_allclose(found[1], own, rtol=1e-12)
    np.testing.assert_allclose(found[2], own, rtol=1e-12)
    assert found[3, 0, 0] == pytest.approx(4e-12)


def test_a_factor_of_the_variances(dmu50: Machine) -> None:
    """Nine times the variance is a third of the weight."""
    rng = np.random.default_rng(8)
    data, _ = simulate(volumetric(dmu50, rng, 12), dmu50, Calibration.zero(dmu50), LaserTracker(), rng)
    network = Network(
        dmu50, data, StationInstruments.same(LaserTracker(), data.station), Unknowns(dmu50, [], ["E_C0Y"])
    )
    other = network.with_variance_factor(9.0)
    np.testing.assert_allclose(other.covariance, 9.0 * network.covariance)
    np.testing.assert_allclose(other.whitening, network.whitening / 3.0)
    unit = network.whitening @ network.covariance @ network.whitening.transpose(0, 2, 1)
    np.testing.assert_allclose(unit, np.tile(np.eye(3), (12, 1, 1)), atol=1e-9)


def folds(rng: np.random.Generator, count: int = 40) -> _Fold:
    """Return normal equations whose directions are determined by 0 to 10⁵ priors, with three conditions, and 200 held-out rows."""
    turn = np.linalg.qr(rng.standard_normal((count, count)))[0]
    rows = rng.standard_normal((1000, count)) @ (turn * np.logspace(-1.5, 4.0, count)) @ turn.T
    origin = 1e-3 * rng.standard_normal(count)
    read = rows @ origin + rng.standard_normal(1000)
    train, held = slice(0, 800), np.concatenate([rows[800:], (read - rows @ origin)[800:, None]], axis=1)
    normal, slope = rows[train].T @ rows[train] + np.eye(count), rows[train].T @ read[train] + origin
    datum = np.zeros((3, count))
    datum[:, :10] = rng.standard_normal((3, 10))
    return _Fold(normal, slope, datum, np.zeros(0), np.zeros((0, count)), held, origin)


def test_truncated_curves_are_least_squares_estimates() -> None:
    """The condition of a minimum: no gradient along any direction that fulfils the datum."""
    fold = folds(np.random.default_rng(1))
    columns, widths = [*range(5, 40), *range(5)], [20, 34, 35, 37, 40]
    for width, theta in zip(widths, fold.truncated(columns, widths), strict=True):
        kept = columns[:width]
        assert np.all(np.delete(theta, kept) == 0.0)
        assert np.abs(fold.datum @ theta).max() < 1e-12
        free = scipy.linalg.null_space(fold.datum[:, kept])
        gradient = fold.normal[np.ix_(kept, kept)] @ theta[kept] - fold.slope[kept]
        assert np.abs(free.T @ gradient).max() < 1e-9 * np.abs(fold.slope).max()


def test_scores_of_orders_do_not_depend_on_the_last_place() -> None:
    """The normal matrix of the same rows, added in another order; equally good models are decided at a ratio of 10⁻⁶."""
    rng = np.random.default_rng(2)
    fold, widths = folds(rng), list(range(20, 41))
    scores = [fold.score(theta) for theta in fold.truncated(list(range(40)), widths)]
    for _ in range(5):
        last = 1.0 + np.finfo(float).eps * rng.choice([-1.0, 0.0, 1.0], fold.normal.shape)
        other = replace(fold, normal=fold.normal * (last + last.T) / 2.0)
        found = [other.score(theta) for theta in other.truncated(list(range(40)), widths)]
        assert found == pytest.approx(scores, rel=1e-8)


def test_the_choice_of_orders_does_not_depend_on_the_order_of_rows(dmu50: Machine, calibration: Calibration) -> None:
    plan = thesis_plan.plan(dmu50)
    plan = plan.select(np.flatnonzero(plan.approach[:, :3].any(axis=1) & np.isin(plan.round, ["1", "2"])))
    data = simulate(plan, dmu50, calibration, LaserTracker(), np.random.default_rng(4))[0]
    rng, blocks = np.random.default_rng(5), dict.fromkeys(zip(data.round, data.target, strict=True))
    mixed = np.concatenate(
        [rng.permutation(np.flatnonzero((data.round == name) & (data.target == one))) for name, one in blocks]
    )
    choices = []
    for rows in (np.arange(len(data)), mixed):
        placed = prepare(dmu50, data.select(rows), None)
        of = determined_models(dmu50, placed, lambda name: True, None)[0]
        start = robust_start(of.network, placed.setup, of.triangle)
        choices.append(choose(of.network.with_discrepancy(start.discrepancy.root), start, of.confounded))
    first, second = choices
    assert first.counts == second.counts
    for name, scores in first.by_curve.items():
        assert list(second.by_curve[name].values()) == pytest.approx(list(scores.values()), rel=1e-8), name


@pytest.mark.parametrize(("count", "listed"), [(3, True), (5, False)])
def test_a_straightness_without_enough_positions_is_listed(
    count: int, listed: bool, dmu50: Machine, tmp_path: Path
) -> None:
    """A straightness error has no constant and no slope: X at three positions leaves no function for it."""
    plan = volumetric(dmu50, np.random.default_rng(3), 120, 2)
    positions = np.array(plan.positions)
    positions[:, 0] = np.linspace(50.0, 450.0, count)[np.arange(120) % count]
    (tmp_path / "nothing.yaml").write_text("curves: {}")
    data = read_by_truth(replace(plan, positions=read_only(positions)), TruthMachine(tmp_path / "nothing.yaml"))
    names = ("E_XX", "E_YX", "E_ZX", "E_C0Y")
    found = identify(data, dmu50, wanted=lambda name: name in names)
    reasons = {one.name: one.reason for one in found.unidentified}
    determined = {name.partition("[")[0] for name in found.calibration.covariance.names}
    assert set(names) <= determined | set(reasons)
    assert {name for name, why in reasons.items() if "too few different positions" in why} == (
        {"E_YX", "E_ZX"} if listed else set()
    )
