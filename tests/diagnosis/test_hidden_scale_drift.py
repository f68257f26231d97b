"""A ball screw warms up and no temperature was read: the growth of the axis's scale with time is named, with its place and size."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.truth import hidden
from tests.truth.hidden import Hidden, Plan
from twin.diagnosis import Diagnosis, diagnose
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

SIGMA_MM = 3e-3
NO_TEMPERATURES = tuple(f"T_{name}_degC" for name in ("X", "Y", "Z", "bed"))
Look = Callable[..., Diagnosis]


@pytest.fixture
def look(dmu50: Machine, calibration: Calibration, tmp_path: Path) -> Look:
    """Simulate a measurement with hidden effects and diagnose it."""

    def looked(
        effects: Sequence[Hidden], seed: int, without: Sequence[str] = (), change: Callable[[Plan], Plan] | None = None
    ) -> Diagnosis:
        rng = np.random.default_rng(seed)
        plan = hidden.rounded(hidden.plan(rng, poses=90))
        plan = plan if change is None else change(plan)
        read = hidden.noisy(hidden.points(plan, effects), rng, "isotropic", SIGMA_MM)
        path = hidden.write(tmp_path / "measured.csv", plan, read, u_mm=SIGMA_MM, without=without)
        return diagnose(Measurements.load(path, dmu50), dmu50, calibration)

    return looked


def warming(axis: str, amplitude: float, fixed_at: float, time_constant: float) -> Hidden:
    offset = -1e-3 * amplitude * fixed_at
    return Hidden("scale_drift", axis, {"amplitude": amplitude, "offset": offset, "time_constant": time_constant})


@pytest.mark.sample(2)  # of 3
@pytest.mark.parametrize(
    "truth",
    [
        warming("X", 40.0, 0.0, 1500.0),
        warming("Y", -35.0, 450.0, 2500.0),
        Hidden("scale_drift", "X", {"rate": 15.0, "offset_rate": -2.0}),
    ],
    ids=["X", "Y, fixed at 450 mm", "X, steady"],
)
def test_a_growing_scale_is_named(truth: Hidden, look: Look) -> None:
    result = look([truth], 21, NO_TEMPERATURES)
    (cause,) = result.causes
    assert (cause.effect, cause.where, cause.origin) == (*truth.key, "machine")
    assert result.verdict == ("ambiguous" if cause.equivalent else "explained") and result.unexplained is None
    found = {q.name: (q.value, q.u) for q in cause.parameters}
    for name, value in truth.numbers.items():
        assert abs(found[name][0] - value) < 3.0 * found[name][1], name
    assert found[next(iter(truth.numbers))][1] < 0.2 * abs(next(iter(truth.numbers.values())))
    held = result.gain.held_out if result.gain else None
    assert held is not None and held.after_um < held.before_um
    assert result.gain is not None and result.gain.tool_after_um < result.gain.tool_before_um


def test_a_drift_of_the_tool_side_is_no_growing_scale(look: Look) -> None:
    result = look([Hidden("thermal_drift", "X", {"amplitude": 12.0, "time_constant": 1500.0})], 22, NO_TEMPERATURES)
    (cause,) = result.causes
    assert ("thermal_drift", "X") in {(cause.effect, cause.where), *cause.equivalent}
    assert cause.effect != "scale_drift"


def test_a_wrong_scale_that_stays_is_no_growing_one(look: Look) -> None:
    result = look([Hidden("positioning", "E_XX", {"c1": 8.0})], 23, NO_TEMPERATURES)
    assert [(cause.effect, cause.where) for cause in result.causes] == [("positioning", "E_XX")]
    assert "scale_drift" not in {effect for effect, _ in result.causes[0].equivalent}


def test_a_temperature_that_explains_it_is_named(look: Look) -> None:
    result = look([Hidden("thermal_expansion", "Y", {"coefficient": 30.0})], 24)
    (cause,) = result.causes
    assert (cause.effect, cause.where, cause.equivalent) == ("thermal_expansion", "Y", ())


def test_a_temperature_with_the_course_of_a_warm_up_leaves_both(look: Look) -> None:
    """The scale's temperature follows 1 − exp(−t/τ) exactly: time and temperature are confounded."""

    def warm_up(plan: Plan) -> Plan:
        course = 20.0 + 3.0 * (1.0 - np.exp(-plan.time_s / 2500.0))
        return replace(plan, warm={name: course if name == "Y" else np.full(len(course), 20.0) for name in plan.warm})

    result = look([Hidden("thermal_expansion", "Y", {"coefficient": 11.0})], 25, change=warm_up)
    (cause,) = result.causes
    assert {("thermal_expansion", "Y"), ("scale_drift", "Y")} <= {(cause.effect, cause.where), *cause.equivalent}
    assert result.verdict == "ambiguous"


@pytest.mark.sample(1)  # of 2
@pytest.mark.parametrize("seed", [27, 29])
def test_nothing_is_named_without_it(seed: int, look: Look) -> None:
    assert look([], seed, NO_TEMPERATURES).verdict == "consistent"


def test_a_single_run_of_an_axis_is_not_tested(look: Look) -> None:
    """Along a single run, time and position are the same: growth is not tested, and what is missing is reported."""

    def one_run(plan: Plan) -> Plan:
        order = np.argsort(plan.at("X"), kind="stable")
        return replace(plan, time_s=plan.time_s[np.argsort(order)])

    result = look([], 28, NO_TEMPERATURES, one_run)
    assert ("scale_drift", "X", "X measured again later") in result.not_evaluated
