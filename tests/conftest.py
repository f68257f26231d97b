from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from twin.calibration import Calibration
from twin.machine import Machine

# Seeded and without a deadline: two shared cores make time no measure of right or wrong.
settings.register_profile("twin", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("twin")

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def dmu50() -> Machine:
    return Machine.load("dmu50")


@pytest.fixture(scope="session")
def calibration(dmu50: Machine) -> Calibration:
    return Calibration.default(dmu50)


@pytest.fixture(scope="session")
def programs() -> Path:
    folder = SHARED / "data" / "programs"
    if not folder.is_dir():
        pytest.skip("the real programs of others are not beside this checkout")
    return folder
