"""Machine or instrument: both have the same functions, the targets decide which it is, and where they cannot, both are named.

The truth machine (`tests.hidden`) shares no code with `twin`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from tests import hidden
from tests.hidden import Hidden, Plan
from twin.calibration import Calibration
from twin.diagnosis import Diagnosis, diagnose
from twin.machine import Machine
from twin.measurement import load

SIGMA_MM = 3e-3
POSES = 60


def one(effect: str, where: str, **numbers: float) -> Hidden:
    return Hidden(effect, where, numbers)


def measured(
    folder: Path, machine: Machine, of: Plan, read: np.ndarray, rng: np.random.Generator, *, side: str | None = None
) -> Diagnosis:
    """Diagnose readings with isotropic noise; of the targets on one side only, if it is given."""
    noisy = hidden.noisy(read, rng, "isotropic", SIGMA_MM)
    data = load(hidden.write(folder / "measured.csv", of, noisy, u_mm=SIGMA_MM), machine)
    if side is not None:
        data = data.select(data.carrier == side)
    return diagnose(data, machine, Calibration.default(machine))


@pytest.fixture
def look(dmu50: Machine, tmp_path: Path) -> Callable[..., Diagnosis]:
    def found(effects: Sequence[Hidden], seed: int, *, side: str | None = None) -> Diagnosis:
        rng = np.random.default_rng(seed)
        of = hidden.rounded(hidden.plan(rng, poses=POSES))
        return measured(tmp_path, dmu50, of, hidden.points(of, effects), rng, side=side)

    return found


DRIFTS = {
    "machine, straight": one("thermal_drift", "Z", rate=6.0),
    "machine, exponential": one("thermal_drift", "Z", amplitude=12.0, time_constant=1500.0),
    "station, straight": one("station_drift", "1", rate_x=0.0, rate_y=0.0, rate_z=6.0),
    "station, exponential": one("station_drift", "1", rate_x=0.0, rate_y=0.0, rate_z=30.0, time_constant=1500.0),
}


@pytest.mark.parametrize("name", DRIFTS)
def test_targets_on_both_sides_decide_whose_drift_it_is(look: Callable[..., Diagnosis], name: str) -> None:
    truth = DRIFTS[name]
    result = look([truth], 41)
    (cause,) = result.causes
    assert (cause.effect, cause.where) == truth.key
    assert not {effect for effect, _ in cause.equivalent} & ({"thermal_drift", "station_drift"} - {truth.effect})
    found = {q.name: q for q in cause.parameters}
    # Three standard uncertainties, of at most four numbers.
    assert max(abs(found[key].value - value) / found[key].u for key, value in truth.numbers.items()) < 3.0
    assert cause.bounded == (name == "machine, straight")
    assert ("time_constant" in found) == ("exponential" in name)
    assert ("throughout" in cause.evidence) == ("straight" in name)


@pytest.mark.parametrize("name", DRIFTS)
def test_targets_on_the_tool_side_alone_leave_open_whose_drift_it_is(look: Callable[..., Diagnosis], name: str) -> None:
    result = look([DRIFTS[name]], 42, side="tool")
    assert result.verdict == "ambiguous"
    (cause,) = result.causes
    group = {(cause.effect, cause.where), *cause.equivalent}
    assert {("thermal_drift", "Z"), ("station_drift", "1")} <= group
    assert ("thermal_drift", "X") not in group and ("thermal_drift", "Y") not in group


def test_a_station_that_drifts_in_space_is_a_tool_side_that_drifts_along_each_direction(
    look: Callable[..., Diagnosis],
) -> None:
    truth = one("station_drift", "1", rate_x=6.0, rate_y=-5.0, rate_z=7.0)
    (cause,) = look([truth], 43, side="tool").causes
    group = {(cause.effect, cause.where), *cause.equivalent}
    assert {("station_drift", "1"), *(("thermal_drift", axis) for axis in "XYZ")} <= group
    (alone,) = look([truth], 43).causes
    assert (alone.effect, alone.where, alone.equivalent) == ("station_drift", "1", ())


def test_a_straight_drift_goes_into_the_calibration_as_a_rate(look: Callable[..., Diagnosis], tmp_path: Path) -> None:
    result = look([DRIFTS["machine, straight"]], 41)
    result.extended.save(tmp_path / "extended.yaml")
    again = Calibration.load(tmp_path / "extended.yaml", result.calibration.machine)
    (effect,) = [one for one in again.effects if one.name == "thermal_drift:Z"]
    (rate,) = effect.parameters
    assert (rate.name, rate.unit) == ("thermal_drift:Z.rate", "um/h")
    assert effect.components({"time_s": np.array([0.0, 1800.0])})[2] == pytest.approx([0.0, rate.value / 2.0])
