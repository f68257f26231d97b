"""Measurement noise of a diagnosis: from repeats of a table that has nothing but commands and readings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from tests.identification.plans import read_by_truth, table
from tests.identification.test_discrepancy import in_a_workshop, machine, measured
from tests.truth.machine import written
from twin._common.arrays import read_only
from twin.diagnosis import diagnose
from twin.diagnosis.readings import readings
from twin.machine.machine import Machine
from twin.measurement.instruments import instrument_named
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

SIGMA_MM = 3e-3


@pytest.mark.parametrize(("count", "source"), [(18, "repeats"), (40, "repeats")])
def test_repeats_without_optional_columns_give_the_noise(
    dmu50: Machine, tmp_path: Path, count: int, source: str
) -> None:
    """Positions twice, x, y and z alone: no effect can change between the repeats, so nothing is regressed on.

    With 18, their 18 degrees of freedom along the beam are too few to tell it from the noise across: all 54 give one figure.
    """
    rng = np.random.default_rng(5)
    positions = np.zeros((count, 5))
    positions[:, :3] = np.round(rng.uniform([20.0, 20.0, -380.0], [480.0, 430.0, -20.0], (count, 3)), 3)
    twice = np.concatenate([positions, positions])
    plan = table(dmu50, twice, np.full(2 * count, "K"), np.full(2 * count, "1"))
    exact = read_by_truth(plan, written(tmp_path / "t.yaml", {}))
    points = exact.point_mm + SIGMA_MM * rng.standard_normal((2 * count, 3))
    found = diagnose(replace(exact, point_mm=read_only(points)), dmu50, Calibration.zero(dmu50))
    assert found.verdict == "consistent"
    assert found.noise_source.startswith(source)
    # At least 54 degrees of freedom: one standard deviation of the noise is a tenth of it; four.
    assert found.expected_rms_um == pytest.approx(1e3 * SIGMA_MM, rel=0.4)


def test_repeats_decide_where_they_contradict_the_named_instrument() -> None:
    """5 µm in all directions, of a tracker that states 0.5 µm along its beam; a tracker's own noise stays as stated."""
    tracker, zero = instrument_named("tracker"), Calibration.zero(machine())
    shop, fitting = (readings(data, machine(), zero, tracker) for data in (in_a_workshop(1, 3), measured(2, repeats=3)))
    # Some 500 degrees of freedom: 3 % of one, and four standard deviations.
    sigma_um = 1e6 * np.sqrt(np.einsum("nii->n", shop.noise.covariance) / 3.0)
    assert sigma_um.max() == pytest.approx(5.0, rel=0.12)
    assert "contradict the noise model of the tracker" in shop.noise.source
    assert fitting.noise.source == "the noise model of the tracker" and not np.isfinite(fitting.noise.dof)
    assert not np.any(shop.bad)


def repeated(machine: Machine, folder: Path, seed: int, count: int, *, wrong: bool) -> Measurements:
    """Return positions read twice, without stated uncertainties, on a right machine or on one with an error that no cause describes."""
    rng = np.random.default_rng(seed)
    positions = np.zeros((count, 5))
    positions[:, :3] = np.round(rng.uniform([20.0, 20.0, -380.0], [480.0, 430.0, -20.0], (count, 3)), 3)
    twice = np.concatenate([positions, positions])
    exact = read_by_truth(
        table(machine, twice, np.full(2 * count, "K"), np.full(2 * count, "1")), written(folder / "t.yaml", {})
    )
    error = 8e-3 * np.sin(twice[:, :3] / 45.0 + seed) * wrong
    points = exact.point_mm + error + SIGMA_MM * rng.standard_normal((2 * count, 3))
    return replace(exact, point_mm=read_only(points))


@pytest.mark.parametrize("wrong", [False, True])
def test_noise_of_few_repeats_is_that_of_the_readings_within_its_uncertainty(
    dmu50: Machine, tmp_path: Path, wrong: bool
) -> None:
    """Fifteen positions twice: each figure has 45 degrees of freedom, and says so; six tables by χ² to one in a thousand each way."""
    squares = freedom = 0.0
    for seed in range(6):
        noise = readings(repeated(dmu50, tmp_path, seed, 15, wrong=wrong), dmu50, Calibration.zero(dmu50)).noise
        assert noise.source.startswith("repeats") and noise.dof == 45.0
        variance = 1e6 * float(np.einsum("nii->n", noise.covariance).mean()) / 3.0
        squares += noise.dof * variance / SIGMA_MM**2
        freedom += noise.dof
    low, high = stats.chi2.ppf([0.001, 0.999], freedom)
    assert low < squares < high
