"""The weights of an estimate: residuals beyond the noise, and repeats that contradict the stated noise."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from tests.identification.plans import PLACES, STATIONS, four_stations, read_by_truth, volumetric
from tests.truth import hidden
from tests.truth.machine import TruthMachine
from twin._common.arrays import read_only
from twin.display.numbers import COVERAGE_FACTOR
from twin.identification import Identification, identify
from twin.identification.discrepancy import Discrepancy, _shared_score
from twin.identification.orders import FOLDS
from twin.identification.solve import solve
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker, instrument_named
from twin.measurement.simulate import Placement, Station, simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

WANTED = ("E_C0Y", "E_B0Z", "E_A0Z", "E_A0B", "E_B0B", "E_A0C", "E_B0C")
DRAWS = 40


@cache
def machine() -> Machine:
    return Machine.load("dmu50")


@cache
def exact(points: int, stations: int, repeats: int) -> Measurements:
    """Return noise-free readings of a machine without errors; every pose with one target, read several times."""
    plan = volumetric(machine(), np.random.default_rng(3), points, stations)
    plan = plan.select(np.tile(np.arange(points), repeats))
    nothing = Path(__file__).with_name("nothing.yaml")
    nothing.write_text("curves: {}")
    try:
        return read_by_truth(plan, TruthMachine(nothing))
    finally:
        nothing.unlink()


def beams(data: Measurements) -> np.ndarray:
    return data.point_mm / np.linalg.norm(data.point_mm, axis=1, keepdims=True)


def measured(
    seed: int, *, points: int = 150, stations: int = 1, repeats: int = 1, along: float = 0.0, across: float = 0.0
) -> Measurements:
    """Return readings with a tracker's noise and with a discrepancy, standard deviations in mm along and across the beam.

    Repeats of a pose share the discrepancy.
    """
    data, rng = exact(points, stations, repeats), np.random.default_rng(seed)
    beam, draw = beams(data), np.tile(rng.standard_normal((points, 3)), (repeats, 1))
    share = np.sum(draw * beam, axis=1, keepdims=True) * beam
    noisy = hidden.noisy(data.point_mm, rng, "tracker")
    return replace(data, point_mm=read_only(noisy + along * share + across * (draw - share)))


def identified(data: Measurements) -> Identification:
    return identify(data, machine(), wanted=lambda name: name in WANTED)


def errors(found: Identification) -> tuple[np.ndarray, np.ndarray]:
    """Return the deviation of each number from its truth, zero, and its stated standard uncertainty."""
    numbers = {**found.calibration.squareness, **found.calibration.location}
    return np.array([numbers[name] for name in WANTED]), np.sqrt(
        np.diag(found.calibration.covariance.of(list(WANTED)).matrix)
    )


@pytest.mark.slow
def test_a_model_that_fits_has_no_discrepancy() -> None:
    """At most as many of 40 data sets as the level of the test, 0.1 %, allows with probability 1e-3; repeats contradict none."""
    found = [identified(measured(seed, repeats=2)) for seed in range(DRAWS)]
    limit = stats.binom.isf(1e-3, DRAWS, 1e-3)
    assert sum(bool(one.discrepancy.parts) for one in found) <= limit
    assert sum(bool(one.noise.contradicted) for one in found) <= limit
    assert not np.any(found[0].discrepancy.root)


def test_the_discrepancy_of_each_direction_and_station() -> None:
    """50 µm along the beam, 300 µm across: some 70 readings a station and direction, a standard deviation of 8 %; four."""
    found = identified(measured(1, stations=2, along=0.05, across=0.3))
    assert {part.direction for part in found.discrepancy.parts} == {"along the beam", "across the beam"}
    for part in found.discrepancy.parts:
        true, count = (50.0, 1) if part.direction == "along the beam" else (300.0, 2)
        assert part.size_um == pytest.approx(true, rel=4.0 / np.sqrt(2.0 * count * 25.0))
        assert part.redundancy < count * 150
    assert "discrepancy of the model" in found.to_text()
    assert len(found.to_dict()["misfit"]["discrepancy"]) == len(found.discrepancy.parts)
    # The test of the model does not use it.
    assert found.misfit.p_value < 1e-6 and found.misfit.reduced > 100.0


@pytest.mark.parametrize("at_once", [2, 256])
def test_readings_of_a_pose_share_its_discrepancy(at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The covariance pose by pose, in the machine's frame, from four stations; one pose and one reading are not used."""
    monkeypatch.setattr("twin.identification.discrepancy.GROUPS_AT_ONCE", at_once)
    plan = four_stations(machine(), np.random.default_rng(4), 7)
    setting = Placement(
        {name: Station(pose[:3], pose[3:]) for name, pose in STATIONS.items()},
        {name: place for name, (_, place) in PLACES.items()},
    )
    rng = np.random.default_rng(5)
    data, _ = simulate(plan, machine(), Calibration.zero(machine()), LaserTracker(), rng, setting=setting)
    data = replace(data, point_mm=read_only(data.point_mm + rng.normal(0.0, 0.3, data.point_mm.shape)))
    found, weight = identified(data), np.ones(len(data))
    pose = np.unique(data.positions, axis=0, return_inverse=True)[1].reshape(-1)
    weight[3], weight[pose == 2] = 0.0, 0.0
    network = found.network.with_discrepancy(found.discrepancy.root)
    solution = solve(network, np.zeros(len(network.unknowns)), found.setup, weight)
    j = solution.triangle[:, :-1]
    expected, scale = j.T @ j, np.linalg.norm(j, axis=0)
    turn = solution.setup.rotation[[solution.setup.stations.index(name) for name in data.station]]
    jacobian = network.chunk(solution.theta, solution.setup, np.arange(len(data))).jacobian
    # Whitened derivatives by the discrepancy: one vector in the machine's frame, whose covariance is the unit matrix.
    by = jacobian.transpose(0, 2, 1) @ network.whitening @ found.discrepancy.root @ turn.transpose(0, 2, 1)
    for one in np.flatnonzero(weight):
        for other in np.flatnonzero(weight * (pose == pose[one])):
            expected += by[one] @ by[other].T if other != one else 0.0
    own = _shared_score(network, found.discrepancy, solution, weight)
    np.testing.assert_allclose((own - expected) / np.outer(scale, scale), 0.0, atol=1e-9)
    assert np.abs((expected - j.T @ j) / np.outer(scale, scale)).max() > 0.1


@pytest.fixture(scope="module")
def rough() -> list[Identification]:
    """Return estimates from readings with a discrepancy of 300 µm in all directions."""
    return [identified(measured(seed, along=0.3, across=0.3)) for seed in range(DRAWS)]


def test_a_wrong_model_is_weighted_as_plain_least_squares(rough: list[Identification]) -> None:
    """RMS errors within 3 % of equal weights, on the same draws; with the weights of the noise alone they are half as large again."""
    ours = np.array([errors(found)[0] for found in rough])
    plain = np.array([errors(equal_weights(seed))[0] for seed in range(DRAWS)])
    ratio = np.sqrt(np.mean((ours / plain.std(axis=0)) ** 2) / np.mean((plain / plain.std(axis=0)) ** 2))
    assert ratio < 1.03
    first = rough[0]
    network = first.network
    setup, zero = first.setup, np.zeros(len(network.unknowns))
    by_noise = solve(network, zero, setup, np.ones(len(network.data))).theta
    assert np.linalg.norm(by_noise / plain.std(axis=0)) > 1.5 * np.linalg.norm(ours[0] / plain.std(axis=0))


def equal_weights(seed: int) -> Identification:
    """Return the estimate with the same uncertainty stated for all coordinates."""
    data = measured(seed, along=0.3, across=0.3)
    return identified(replace(data, u_mm=read_only(np.full((len(data), 3), 0.3))))


def test_intervals_count_the_discrepancy(rough: list[Identification]) -> None:
    """95 % of the intervals hold; 3.3 standard errors of the share by data sets."""
    inside = np.array([np.abs(value) <= COVERAGE_FACTOR * u for value, u in map(errors, rough)])
    share, error = inside.mean(), inside.mean(axis=1).std(ddof=1) / np.sqrt(DRAWS)
    assert abs(share - 0.95) <= 3.3 * error
    for name, own in zip(WANTED, inside.mean(axis=0), strict=True):
        assert own >= stats.binom.isf(1.0 - 1e-3, DRAWS, 0.95) / DRAWS, name


def test_repeats_do_not_average_the_discrepancy() -> None:
    """Four readings a pose share it: the uncertainty is that of one reading, within the 10 % by which its size varies."""
    once, often = (errors(identified(measured(5, repeats=k, along=0.3, across=0.3)))[1] for k in (1, 4))
    np.testing.assert_allclose(often, once, rtol=0.1)


def test_held_out_residuals_are_those_of_refits() -> None:
    """Every fold fitted again without its poses, by `solve`; the problem is linear to 1e-3 of the residuals."""
    found = identified(measured(7, points=60, along=0.05, across=0.05))
    data, held = found.data, found.held_out
    assert held is not None and held.poses == 60 and held.folds == FOLDS
    pose = np.unique(np.round(data.positions, 3), axis=0, return_inverse=True)[1].reshape(-1)
    weighted = found.network.with_discrepancy(found.discrepancy.root)
    square = 0.0
    for fold in range(FOLDS):
        out = pose % FOLDS == fold
        part = solve(
            weighted,
            found.solution.theta,
            found.setup,
            (~out).astype(float),
            priors=found.solution.priors,
            incomplete=found.solution.incomplete,
        )
        square += float(np.sum(weighted.residuals_m(part.theta, part.setup, np.flatnonzero(out)) ** 2))
    assert held.rms_um == pytest.approx(1e6 * np.sqrt(square / (3 * len(data))), rel=1e-3)
    assert held.rms_um > found.rms_um
    assert f"{held.rms_um:.3g} µm RMS per coordinate" in found.to_text()
    assert found.to_dict()["misfit"]["held_out_rms_um"] == held.rms_um


SHOP_UM = 5.0
"""Noise of a tracker in a workshop, the same in all directions."""


def in_a_workshop(seed: int, repeats: int) -> Measurements:
    data = exact(100, 1, repeats)
    draw = np.random.default_rng(seed).standard_normal((len(data), 3))
    return replace(data, point_mm=read_only(data.point_mm + 1e-3 * SHOP_UM * draw))


def test_repeats_decide_where_they_contradict_the_stated_noise() -> None:
    """5 µm in all directions, of a tracker that states 0.5 µm along its beam; by name, by default, or from the table."""
    data = in_a_workshop(1, 3)
    for own in (data, replace(data, u_mm=read_only(np.full((len(data), 3), 1e-3)))):
        found = identified(own)
        assert found.spread == "repeats" and found.noise.contradicted == ("tracker",)
        size = 1e6 * np.sqrt(np.einsum("nii->n", found.network.covariance) / 3.0)
        # 200 degrees of freedom a coordinate: 3 % of one, and four standard deviations.
        assert size.max() == pytest.approx(SHOP_UM, rel=0.12)
        assert "the repeats contradict" in found.to_text() and "contradicted_by_repeats" in found.to_dict()["noise"]
        assert found.verdict == "consistent with the noise of the readings"
        value, u = errors(found)
        assert np.all(np.abs(value) < 4.0 * u)
    assert "tracker-absolute" in identified(data).to_text()


def test_lost_readings_do_not_make_the_noise() -> None:
    """Three readings of 300 are off by 1.7 mm: they are outliers, and the noise of the others is that of the tracker."""
    data = measured(3, points=100, repeats=3)
    points = np.array(data.point_mm)
    points[[7, 120, 290]] += 1.0
    found = identified(replace(data, point_mm=read_only(points)))
    assert not found.noise.contradicted and list(np.flatnonzero(~found.used)) == [7, 120, 290]


def test_the_assumed_instrument_is_stated() -> None:
    """Without repeats nothing tests it; with repeats that agree, with its name, or with stated uncertainties, nothing is assumed."""
    once, twice = measured(4, points=60), measured(4, points=60, repeats=2)
    found = identified(once)
    assert found.noise.assumed == ("tracker",)
    assert any(text.startswith("assumed: the readings are those of a laser tracker") for text in found.notices)
    named = identify(once, machine(), instrument=instrument_named("tracker"), wanted=lambda name: name in WANTED)
    in_table = identified(replace(once, instrument=read_only(np.full(len(once), "tracker", dtype=object))))
    for other in (identified(twice), named, in_table):
        assert not other.noise.assumed and not other.noise.notices


def test_more_stations_have_their_own(dmu50: Machine) -> None:
    """A station whose readings fit has none, beside one with 300 µm."""
    assert len(STATIONS) > 1
    data = measured(6, points=200, stations=2)
    rough = measured(6, points=200, stations=2, along=0.3, across=0.3)
    mixed = np.where((data.station == "1")[:, None], data.point_mm, rough.point_mm)
    found = identify(replace(data, point_mm=read_only(mixed)), dmu50, wanted=lambda name: name in WANTED)
    assert isinstance(found.discrepancy, Discrepancy)
    own = {station: part.size_um for part in found.discrepancy.parts for _, station in part.of}
    assert own.get("2", 0.0) > 100.0
    assert own.get("1", 0.0) < 30.0
