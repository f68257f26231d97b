from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
import scipy.linalg  # noqa: F401  # its own library, to be limited with NumPy's
from hypothesis import HealthCheck, settings
from threadpoolctl import threadpool_limits

from twin.calibration import Calibration
from twin.machine import Machine
from twin.planning import Kit, Plan, duration, plan
from twin.samples import thesis_plan

# Two workers share two cores (pyproject.toml): threads of a linear algebra library would only stand in each other's way.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
threadpool_limits(limits=1, user_api="blas")

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


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What is compiled in a run stays in it: nothing of the user's is read or written."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="session")
def half(dmu50: Machine) -> Plan:
    """A plan that takes as long as half of the thesis's, by the same clock, with a tracker left and right."""
    own = Kit.default(dmu50)
    own = replace(own, stations=MappingProxyType({name: own.stations[name] for name in ("left", "right")}))
    whole = thesis_plan.plan(dmu50)
    first = whole.select(np.isin(whole.round, ["1", "2"]))
    return plan(dmu50, own, minutes=duration(dmu50, own, first) / 60.0)


@pytest.fixture(scope="session")
def programs() -> Path:
    folder = SHARED / "data" / "programs"
    if not folder.is_dir():
        pytest.skip("the real programs of others are not beside this checkout")
    return folder
