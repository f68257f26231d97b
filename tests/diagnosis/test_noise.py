"""Measurement noise of a diagnosis: from repeats of a table that has nothing but commands and readings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.identification.plans import read_by_truth, table
from tests.identification.test_discrepancy import in_a_workshop, machine, measured
from tests.truth.machine import written
from twin._common.arrays import read_only
from twin.diagnosis import diagnose
from twin.diagnosis.readings import readings
from twin.machine.machine import Machine
from twin.measurement.instruments import instrument_named
from twin.model.calibration import Calibration

SIGMA_MM = 3e-3


@pytest.mark.parametrize(("count", "source"), [(18, "the noise model of the tracker"), (40, "repeats")])
def test_repeats_without_optional_columns_give_the_noise(
    dmu50: Machine, tmp_path: Path, count: int, source: str
) -> None:
    """Positions twice, x, y and z alone: no effect can change between the repeats, so nothing is regressed on.

    With 18, their 18 degrees of freedom along the beam are too few, and the residuals give the noise.
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
