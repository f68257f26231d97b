"""Coverage of the intervals of `identify` error by error, on a machine small enough for many seeds; its priors and its spreads.

The truth of the stage is three lines of numpy: a slide with six error motions, its targets at known places.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from tests.identification.plans import volumetric
from tests.identification.test_identify_inputs import rows_of
from tests.model.errors import random_calibration
from tests.planning import kits
from tests.truth import few_axes
from tests.truth.reference import error_frame
from twin._common.arrays import read_only
from twin.identification import fitting as priors_module
from twin.identification import identify
from twin.identification.discrepancy import covariance_of
from twin.identification.fitting import RobustStart, robust_start, shrunk_start
from twin.identification.inputs import prepare
from twin.identification.network import Network, Unknowns
from twin.identification.solve import Spread, solve
from twin.identification.unidentified import DeterminedModel, determined_models
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker, StationInstruments
from twin.measurement.observation import nominal_carriers
from twin.measurement.set_up import initial_setup
from twin.measurement.simulate import Placement, simulate, three_floats
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

RARE = 1e-4
SIGMA_MM = 0.003
PLACES = np.array([[100.0, 20.0, 0.0], [-30.0, 120.0, 0.0], [0.0, 0.0, 150.0]])
TURN = np.array([0.3, -0.2, 2.0])
ORIGIN = np.array([-900.0, -1500.0, 300.0])
MOTIONS = tuple(f"E_{letter}X" for letter in "XYZABC")


def errors(q: np.ndarray) -> np.ndarray:
    """Return (n, 6) µm and µrad: two long waves, a tilt, and three motions without any error, in the datum of `identify`."""
    u = q / 250.0 - 1.0
    cubic = 5.0 * (2.5 * u**3 - 1.5 * u)
    return np.stack([30.0 * u + cubic, 5.0 * (1.5 * u**2 - 0.5), 0 * u, 20.0 * u, 0 * u, 0 * u], axis=1)


@cache
def stage(folder: Path) -> tuple[Machine, Measurements]:
    """Return the slide, and its readings without noise: eleven positions, twice, with each of three targets."""
    machine = Machine.load(few_axes.write_stage(folder))
    q, of = np.tile(np.linspace(0.0, 500.0, 11), 6), np.repeat([0, 1, 2], 22)
    scaled = errors(q) * np.array([1e-3] * 3 + [1e-6] * 3)
    points = np.array(
        [
            np.array([x, 0.0, 0.0]) + (error_frame(six) @ [*PLACES[k], 1.0])[:3]
            for x, six, k in zip(q, scaled, of, strict=True)
        ]
    )
    turn = error_frame(np.concatenate([np.zeros(3), TURN]))[:3, :3]
    plan = rows_of(machine, q[:, None], "tool")
    return machine, replace(
        plan,
        target=read_only(np.array(["K", "P", "Q"], dtype=object)[of]),
        place_mm=read_only(PLACES[of]),
        round=read_only(np.tile(np.repeat(np.array(["1", "2"], dtype=object), 11), 3)),
        point_mm=read_only((points - ORIGIN) @ turn),
        u_mm=read_only(np.full((66, 3), SIGMA_MM)),
    )


def noisy(exact: Measurements, seed: int, u_mm: float = SIGMA_MM) -> Measurements:
    points = exact.point_mm + np.random.default_rng(seed).normal(0.0, SIGMA_MM, exact.point_mm.shape)
    return replace(exact, point_mm=read_only(points), u_mm=read_only(np.full(points.shape, u_mm)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("stage")


@pytest.mark.parametrize("seeds", [24, pytest.param(300, marks=pytest.mark.slow)])
def test_intervals_of_each_error_motion_cover(folder: Path, seeds: int) -> None:
    """95 % of each or more, with an error and without one; no alarm; and p-values of the misfit that are uniform.

    A curve that is shrunk is closer to zero than its interval is wide: where there is no error, nearly all intervals cover. They are no
    wider than those of priors that do not shrink a curve within the noise (1.6 µm and 15.5 µrad at the ends).
    """
    machine, exact = stage(folder)
    q = np.linspace(0.0, 500.0, 11)
    inside: dict[str, list[float]] = {name: [] for name in MOTIONS}
    widths: dict[str, list[float]] = {name: [] for name in MOTIONS}
    p_values, alarms = [], 0
    for seed in range(seeds):
        found = identify(noisy(exact, seed), machine)
        for i, name in enumerate(MOTIONS):
            value, u = found.interval(name, q)
            inside[name].append(float(np.mean(np.abs(value - errors(q)[:, i]) <= 1.959964 * u)))
            widths[name].append(float(u[-1]))
        p_values.append(found.misfit.p_value)
        alarms += len(found.set_aside)
    for name, shares in inside.items():
        # Positions of a seed are not independent: the spread is that between seeds, and at least that of 24 of them.
        error = max(float(np.std(shares, ddof=1)), 0.08) / np.sqrt(seeds)
        assert np.mean(shares) >= 0.94 - 3.7 * error, (name, np.mean(shares))
        assert np.mean(widths[name]) <= (1.6 if name[2] in "XYZ" else 15.5), (name, np.mean(widths[name]))
    assert alarms <= stats.binom.isf(RARE, seeds, 0.01)
    # The number of parameters that priors leave free is not known better than by a few of 198 degrees of freedom.
    assert stats.kstest(p_values, "uniform").pvalue > (RARE if seeds < 100 else RARE**2)


def start_of(machine: Machine, data: Measurements) -> tuple[DeterminedModel, RobustStart]:
    placed = prepare(machine, data, None)
    (model, *_) = determined_models(machine, placed, lambda name: True, None)
    return model, robust_start(model.network, placed.setup, model.triangle)


def test_a_noise_stated_too_large_does_not_shrink_more(folder: Path) -> None:
    """Twenty times the noise: weights fall by 400, and so does the precision of the priors, whose noise is that of the residuals."""
    machine, exact = stage(folder)
    starts = [start_of(machine, noisy(exact, 1, u)) for u in (SIGMA_MM, 20.0 * SIGMA_MM)]
    right, large = (shrunk_start(model.network, start).priors.precision for model, start in starts)
    used = right > 0.0
    assert np.count_nonzero(used) > 20
    ratio = large[used] / right[used]
    assert 1.0 / 600.0 < np.median(ratio) < 1.0 / 270.0


def test_prior_variances_have_converged(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """More iterations, or priors of the other unknowns that are wider by far, change next to nothing."""
    machine, exact = stage(folder)
    model, start = start_of(machine, noisy(exact, 2))
    usual = shrunk_start(model.network, start).priors.precision
    monkeypatch.setattr(priors_module, "FREE", 1e-4)
    np.testing.assert_allclose(shrunk_start(model.network, start).priors.precision, usual, rtol=0.02)
    monkeypatch.setattr(priors_module, "ITERATIONS", 40)
    np.testing.assert_allclose(shrunk_start(model.network, start).priors.precision, usual, rtol=0.3)


@pytest.mark.parametrize("spread", ["between poses", "between rounds"])
def test_the_covariance_between_groups_is_that_of_their_scores(dmu50: Machine, spread: Spread) -> None:
    """C (Σ g gᵀ) C · k/(k − 1) written out, with one score for each of k poses or rounds; poses 2 µm apart are two."""
    rng = np.random.default_rng(3)
    plan = volumetric(dmu50, rng, 24)
    positions = np.repeat(plan.positions[:6], 4, axis=0)
    positions[4:8] = positions[8:12]
    positions[4:8, 0], positions[8:12, 0] = 100.001, 100.003
    plan = replace(
        plan,
        positions=read_only(positions),
        round=read_only(np.arange(24).astype(str).astype(object)),
        target=read_only(np.array(list("KPQK") * 6, dtype=object)),
        carrier=read_only(np.full(24, "tool", dtype=object)),
        station=read_only(np.full(24, "1", dtype=object)),
    )
    data, _ = simulate(plan, dmu50, Calibration.zero(dmu50), LaserTracker(), rng)
    instruments = StationInstruments.same(LaserTracker(), data.station)
    network = Network(dmu50, data, instruments, Unknowns(dmu50, [], ["E_C0Y", "E_A0Z"]))
    setup, _ = initial_setup(data, instruments, nominal_carriers(dmu50, data))
    weight = np.ones(24)
    weight[5] = 0.0
    solution = solve(network, np.zeros(2), setup, weight)
    piece = network.chunk(solution.theta, solution.setup, np.arange(24))
    by_row = np.einsum("nki,nk,n->ni", piece.jacobian, piece.residual, weight)
    size = 4 if spread == "between poses" else 1
    groups = [range(start, start + size) for start in range(0, 24, size)]
    scores = np.array([by_row[list(rows)].sum(axis=0) for rows in groups])
    normal = np.einsum("nki,nkj,n->ij", piece.jacobian, piece.jacobian, weight)
    unit = np.sqrt(np.diag(normal))
    # A shift of the station is one of all targets: a null space, which does not touch the squareness.
    inverse = np.linalg.pinv(normal / np.outer(unit, unit), rcond=1e-10) / np.outer(unit, unit)
    count = len(groups)
    expected = (inverse @ (scores.T @ scores) @ inverse)[:2, :2] * count / (count - 1)
    found = covariance_of(network, solution, weight, spread)[:2, :2]
    np.testing.assert_allclose(found, expected, rtol=1e-3)


@pytest.mark.slow
def test_intervals_cover_wherever_the_reflectors_are_on_the_ram(tmp_path: Path) -> None:
    """Two slides; the reflectors are 0.2 m (1 σ) from where they are by default, which no reading shows.

    That turns the tilts of each slide into straightness of its reference point, and the uncertainty of the tilts, times the lever,
    counts: without these terms of second order the mean square below is 2.2. Contrasts of three positions do not depend on the datum.
    """
    machine, kit = kits.slides(tmp_path)
    square, count = [], 360
    for seed in range(12):
        rng = np.random.default_rng(seed)
        truth, lever = random_calibration(machine, rng, 30.0), rng.normal(0.0, 200.0, 3)
        places = {name: three_floats(np.array(place) + lever) for name, place in kit.setting.places_mm.items()}
        plan = Measurements(
            source="a test",
            lines=np.arange(count) + 2,
            positions=np.round(rng.uniform(*kit.ranges.T, (count, 2)), 3),
            target=np.resize(np.array(list(kit.targets), dtype=object), count),
            carrier=np.full(count, "tool", dtype=object),
            station=np.repeat(np.array(list(kit.stations), dtype=object), count // len(kit.stations)),
            point_mm=np.full((count, 3), np.nan),
            u_mm=np.full((count, 3), np.nan),
        )
        setting = Placement(kit.setting.stations, places)
        found = identify(simulate(plan, machine, truth, LaserTracker(), rng, setting=setting)[0], machine)
        for name in ("E_XX", "E_YX", "E_ZX", "E_XZ", "E_YZ", "E_ZZ"):
            curve, (low, high) = found.calibration.curves[name], truth.curves[name].domain
            q = np.array([low, (low + high) / 2.0, high])
            off = np.array([1.0, -2.0, 1.0]) @ (curve(q) - truth.curves[name](q))
            assert curve.basis == "power" and curve.covariance is not None
            contrast = np.array([2.0 * (k > 0 and k % 2 == 0) for k in range(len(curve.coefficients))])
            square.append(off**2 / (contrast @ curve.covariance @ contrast))
    # Some 40 independent contrasts: the mean square has a standard deviation of 0.22.
    assert 0.5 < np.mean(square) < 1.7, square
