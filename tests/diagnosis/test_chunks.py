"""A diagnosis does not depend on the size of the chunks in which readings, functions and tests are evaluated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.identification.plans import volumetric
from tests.nested import alike
from twin._common.arrays import read_only
from twin.diagnosis import Diagnosis, diagnose
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.numerics import functions

CHUNKS = {
    "twin.numerics.functions.BLOCK": 17,
    "twin.diagnosis.signature_products.BLOCK_WIDTH": 13,
    "twin.diagnosis.estimate.BLOCK_COLUMNS": 5,
    "twin.diagnosis.patterns.READINGS_AT_ONCE": 29,
    "twin.diagnosis.likelihood.COLUMNS_AT_ONCE": 3,
    "twin.diagnosis.likelihood.AT_ONCE": 9,
    "twin.identification.network.CHUNK": 19,
    "twin.identification.network.VIEW_CHUNK": 19,
    "twin._common.resources.SHARES": 3,
}


@pytest.fixture(scope="module")
def data(dmu50: Machine) -> Measurements:
    """Return readings of a machine that is out of square, with a wave of the tool side along X."""
    rng = np.random.default_rng(3)
    truth = replace(Calibration.zero(dmu50), squareness={"E_C0Y": 80.0})
    read, _ = simulate(volumetric(dmu50, rng, 70), dmu50, truth, LaserTracker(), rng)
    wave = 0.08 * np.sin(read.positions[:, 0] / 60.0) * (read.carrier == "tool")
    return replace(read, point_mm=read_only(read.point_mm + wave[:, None] * [0.0, 0.0, 1.0]))


def test_the_size_of_chunks_changes_nothing(
    dmu50: Machine, data: Measurements, monkeypatch: pytest.MonkeyPatch
) -> None:
    def found() -> Diagnosis:
        return diagnose(data, dmu50, Calibration.zero(dmu50), instrument=LaserTracker())

    whole = found()
    assert whole.causes
    for name, size in CHUNKS.items():
        monkeypatch.setattr(name, size)
    monkeypatch.setattr(functions.pieces, "__defaults__", (23,))
    # Sums in another order; a p-value is an exponential of a sum.
    alike(found().to_dict(), whole.to_dict(), rel=1e-4, least=1e-9, texts=False)
