"""The uncertainty stated by `identify`, compared with many measurements of one machine: an AT960 on the thesis's plan.

The machine and its tracker are those of `tests`, which share no code with the package. The truth is the bundled calibration in the
estimate's datum, which a measurement without noise gives to 1e-7 µm (test_identify.py).
By default eight seeds, with the allowance for so small a number; `pytest -m slow` tests the values themselves, on 60.
"""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from tests.identification.plans import read_by_truth
from tests.identification.test_identify import as_the_thesis
from tests.truth import hidden
from tests.truth.machine import TruthMachine
from twin._common.arrays import read_only
from twin.display.numbers import COVERAGE_FACTOR
from twin.identification import Identification, identify
from twin.identification.thesis import identify_as_thesis
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.samples import thesis_plan

FEW, MANY = 8, 60
AXES = ("X", "Y", "Z")
ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Run:
    """One seed: stated intervals that hold, by name; mean square errors of E_XX, E_YY, E_ZZ, ours and the thesis's, µm²."""

    inside: dict[str, np.ndarray]
    ours: np.ndarray
    thesis: np.ndarray
    alarms: int
    chi2: float
    dof: float


@cache
def machine() -> Machine:
    return Machine.load("dmu50")


@cache
def read() -> Measurements:
    """Return the readings without noise; neither places nor stations are given."""
    plan = replace(as_the_thesis(machine()), approach=thesis_plan.plan(machine()).approach)
    return read_by_truth(plan, TruthMachine(ROOT / "urdf" / "dmu50.calibration.yaml"))


def measured(seed: int) -> Measurements:
    points = hidden.noisy(read().point_mm, np.random.default_rng(seed), "tracker")
    return replace(read(), point_mm=read_only(points))


@cache
def truth() -> Calibration:
    found = identify(read(), machine())
    assert found.rms_um < 1e-6, "the bundled machine is no longer one that the estimate can write down"
    return found.calibration


def one(seed: int) -> Run:
    data, true = measured(seed), truth()
    found = identify(data, machine())
    inside = {}
    for name, curve in true.curves.items():
        q = thesis_plan.POSITIONS[name[3]]
        value, u = found.interval(name, q)
        inside[name] = np.abs(value - curve(q)) <= COVERAGE_FACTOR * u
    numbers = {**found.calibration.squareness, **found.calibration.location}
    for name, number in {**true.squareness, **true.location}.items():
        u = np.sqrt(found.calibration.covariance.of([name]).matrix[0, 0])
        inside[name] = np.array([abs(numbers[name] - number) <= COVERAGE_FACTOR * u])
    as_thesis = identify_as_thesis(data, machine()).calibration
    return Run(
        inside,
        np.array([_mean_square(found.calibration, true, f"E_{axis}{axis}") for axis in AXES]),
        np.array([_mean_square(as_thesis, true, f"E_{axis}{axis}") for axis in AXES]),
        len(found.set_aside),
        found.misfit.chi2,
        found.misfit.dof,
    )


def _mean_square(found: Calibration, true: Calibration, name: str) -> float:
    """Return the mean square over the range, without the constant, which depends on the datum."""
    q = np.linspace(*true.curves[name].domain, 201)
    error = found.curves[name](q) - true.curves[name](q)
    return float(np.var(error))


def runs(seeds: range) -> list[Run]:
    # Spawned: a forked process would inherit the threads' locks of the libraries underneath.
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(one, seeds, chunksize=max(1, min(10, len(seeds) // 2))))


@pytest.fixture(scope="module")
def few() -> list[Run]:
    return runs(range(1, 1 + FEW))


@pytest.fixture(scope="module")
def many() -> list[Run]:
    return runs(range(1, 1 + MANY))


def coverage(found: list[Run]) -> tuple[float, float]:
    """Return the share of all intervals that hold, and its standard error; seeds are independent, intervals of a seed are not."""
    by_seed = [np.concatenate(list(run.inside.values())).mean() for run in found]
    return float(np.mean(by_seed)), float(np.std(by_seed, ddof=1) / np.sqrt(len(by_seed)))


def of_one(found: list[Run], names: Iterable[str]) -> tuple[float, float]:
    """Return the same for some errors."""
    inside = [np.concatenate([run.inside[name] for name in names]).mean() for run in found]
    return float(np.mean(inside)), float(np.std(inside, ddof=1) / np.sqrt(len(inside)))


@pytest.mark.slow
def test_intervals_cover(few: list[Run]) -> None:
    """93 to 97 %, and three standard errors for the number of seeds; each of 30 curves 90 %, less three and a half of its own."""
    share, error = coverage(few)
    assert error < 0.02, "too few seeds to say anything"
    assert 0.93 - 3.0 * error <= share <= 0.97 + 3.0 * error
    for name in truth().curves:
        share, error = of_one(few, [name])
        assert share >= 0.90 - 3.5 * max(error, 0.02), name


@pytest.mark.slow
def test_intervals_cover_on_many_seeds(many: list[Run]) -> None:
    """93 to 97 % of all; of the curves, of the squareness and of the locations by themselves; and of each curve 90 %."""
    share, _ = coverage(many)
    assert 0.93 <= share <= 0.97
    for kind in ("curves", "squareness", "location"):
        share, error = of_one(many, list(getattr(truth(), kind)))
        assert 0.93 - 2.0 * error <= share <= 0.97 + 2.0 * error, kind
    by_curve = {name: of_one(many, [name])[0] for name in truth().curves}
    sys.stdout.write(", ".join(f"{name} {share:.3f}" for name, share in sorted(by_curve.items(), key=lambda x: x[1])))
    assert min(by_curve.values()) >= 0.90, by_curve


@pytest.mark.slow
def test_better_than_the_thesis(few: list[Run]) -> None:
    """RMS errors at least 30 % below, on the same data."""
    better_than_the_thesis(few)


@pytest.mark.slow
def test_better_than_the_thesis_on_many_seeds(many: list[Run]) -> None:
    better_than_the_thesis(many)


def better_than_the_thesis(found: list[Run]) -> None:
    ours = np.sqrt(np.mean([run.ours for run in found], axis=0))
    thesis = np.sqrt(np.mean([run.thesis for run in found], axis=0))
    assert np.all(ours <= 0.7 * thesis), (ours, thesis)


@pytest.mark.slow
def test_no_alarm_and_no_misfit(few: list[Run]) -> None:
    no_alarm_and_no_misfit(few)


@pytest.mark.slow
def test_no_alarm_and_no_misfit_on_many_seeds(many: list[Run]) -> None:
    no_alarm_and_no_misfit(many)


def no_alarm_and_no_misfit(found: list[Run]) -> None:
    """Check one false outlier in a hundred data sets (with a limit exceeded once in a thousand), and a reduced chi² near one.

    Two per cent, less than one data set's standard deviation (2.9 %): the number of parameters determined by a fit with chosen orders
    and priors is not known better. Measured on 200 seeds: 0.987, as if 252 parameters had been determined and not 223.
    """
    assert sum(run.alarms > 0 for run in found) <= stats.binom.isf(1e-3, len(found), 0.01)
    chi2, dof = sum(run.chi2 for run in found), sum(run.dof for run in found)
    assert abs(chi2 / dof - 1.0) <= 0.02 + 3.3 * np.sqrt(2.0 / dof), chi2 / dof


def test_covariance_is_that_of_the_readings_carried_through(tmp_path: Path) -> None:
    """(JᵀWJ)⁻¹ in numpy, J from the truth machine by differences of its readings, which shares no code; with stations and targets.

    Only constants are estimated, so that no order is chosen and nothing has a prior.
    """
    wanted = {"E_C0Y": 40.0, "E_B0Z": -25.0, "E_A0Z": 30.0, "E_A0C": 15.0}
    nothing = tmp_path / "nothing.yaml"
    nothing.write_text("curves: {}")
    sigma_mm, rng = 2e-3, np.random.default_rng(8)
    plan = hidden.plan(rng, rounds=1, poses=40)

    def read(errors: Mapping[str, float]) -> np.ndarray:
        effects = [
            hidden.Hidden("axis_location", name, {"offset": value})
            if name == "E_A0C"
            else hidden.Hidden("squareness", name, {"angle": value})
            for name, value in errors.items()
        ]
        return hidden.points(plan, effects, calibration=nothing)

    by_error = np.stack([(read({name: 1.0}) - read({name: -1.0})) / 2.0 for name in wanted], axis=2)
    jacobian = np.concatenate([by_error.reshape(-1, len(wanted)), hidden.set_up(plan)], axis=1) / sigma_mm
    size = np.linalg.norm(jacobian, axis=0)  # µrad beside mm: numbers of one size
    inverse = np.linalg.inv((jacobian / size).T @ (jacobian / size)) / np.outer(size, size)
    expected = inverse[: len(wanted), : len(wanted)]
    noisy = hidden.noisy(read(wanted), rng, "isotropic", sigma_mm)
    data = Measurements.load(hidden.write(tmp_path / "m.csv", plan, noisy, u_mm=sigma_mm), machine())
    found = identify(data, machine(), wanted=lambda name: name in wanted)
    assert found.complete and found.used.all()
    covariance = found.calibration.covariance.of(list(wanted)).matrix
    scale = np.sqrt(np.diag(expected))
    # Derivatives at other places of stations and targets, and at errors of some 40 µrad: parts in 10,000.
    np.testing.assert_allclose(covariance / np.outer(scale, scale), expected / np.outer(scale, scale), atol=2e-3)


@pytest.mark.slow
def test_the_estimate_is_reproducible() -> None:
    """No random numbers: the same data give the same result to the last digit."""
    first, again = (identify(measured(3), machine()) for _ in range(2))
    assert isinstance(first, Identification)
    assert first.calibration.to_yaml() == again.calibration.to_yaml()
