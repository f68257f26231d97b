"""A step in a scale or a rack: it is named, with its place and size, and is no periodic error and no curve."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.truth import hidden
from tests.truth.hidden import Hidden
from twin.diagnosis import Cause, Diagnosis, diagnose
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

SIGMA_MM = 3e-3
Look = Callable[..., Diagnosis]


@pytest.fixture
def look(dmu50: Machine, calibration: Calibration, tmp_path: Path) -> Look:
    """Simulate a measurement with hidden effects and diagnose it."""

    def looked(effects: Sequence[Hidden], seed: int, poses: int = 90) -> Diagnosis:
        rng = np.random.default_rng(seed)
        plan = hidden.rounded(hidden.plan(rng, poses=poses))
        read = hidden.noisy(hidden.points(plan, effects), rng, "isotropic", SIGMA_MM)
        path = hidden.write(tmp_path / "measured.csv", plan, read, u_mm=SIGMA_MM)
        return diagnose(Measurements.load(path, dmu50), dmu50, calibration)

    return looked


def step(axis: str, size: float, place: float) -> Hidden:
    return Hidden("scale_step", axis, {"size": size, "place": place})


def check(cause: Cause, truth: Hidden) -> None:
    """Check place and size against the truth."""
    found = {q.name: (q.value, q.u) for q in cause.parameters}
    assert abs(found["size"][0] - truth.numbers["size"]) < 3.0 * found["size"][1]
    assert abs(found["place"][0] - truth.numbers["place"]) <= found["width"][0] / 2.0
    assert found["width"][0] < 60.0


@pytest.mark.sample(2)
@pytest.mark.parametrize("truth", [step("X", 6.0, 312.3), step("Y", -5.0, 171.4), step("Z", 25.0, -260.7)])
def test_a_step_is_named(truth: Hidden, look: Look) -> None:
    result = look([truth], 31)
    (cause,) = result.causes
    # A small step is sometimes fitted as well by a curve of many terms of the same axis, and then that is stated.
    assert (cause.effect, cause.where) == truth.key and cause.promised
    assert set(cause.equivalent) <= {("positioning", f"E_{truth.where}{truth.where}")}
    assert result.verdict == ("ambiguous" if cause.equivalent else "explained")
    check(cause, truth)
    assert "jumps by" in cause.evidence
    held = result.gain.held_out if result.gain else None
    assert held is not None and held.ci95_um is not None and held.ci95_um[0] > 0.0


def test_a_step_between_few_stops_is_named(look: Look) -> None:
    """Eleven stops, no other positions: the step is named with the interval between two stops."""
    truth = step("X", 12.0, 322.0)
    result = look([truth], 33, 0)
    (cause,) = result.causes
    assert truth.key in {(cause.effect, cause.where), *cause.equivalent}
    assert all(cause.effect not in ("pitch_error", "positioning") for cause in result.causes)
    check(cause, truth)


@pytest.mark.sample(2)  # of 4
@pytest.mark.parametrize(
    "truth",
    [
        Hidden("positioning", "E_XX", {"c1": 8.0, "c3": 6.0}),
        Hidden("pitch_error", "X", {"amplitude": 4.0, "period": 157.0, "phase": 0.4}),
        Hidden("cross_axis", "E_XX by Y", {"coefficient": 120.0}),
        Hidden("reversal", "X", {"size": 5.0}),
    ],
    ids=lambda truth: truth.effect,
)
def test_its_neighbours_keep_their_names(truth: Hidden, look: Look) -> None:
    result = look([truth], 34)
    (cause,) = result.causes
    assert truth.key in {(cause.effect, cause.where), *cause.equivalent}
    assert cause.effect != "scale_step"


@pytest.mark.sample(1)  # of 2
@pytest.mark.parametrize("seed", [35, 37])
def test_nothing_is_named_without_it(seed: int, look: Look) -> None:
    assert look([], seed).verdict == "consistent"


def test_a_program_is_compensated_across_a_step(look: Look, dmu50: Machine, tmp_path: Path) -> None:
    """The file with the step is written, read again, and gives the size on either side."""
    truth = step("X", 40.0, 312.3)
    look([truth], 37).extended.save(tmp_path / "extended.yaml")
    (effect,) = Calibration.load(tmp_path / "extended.yaml", dmu50).extra
    (moved,) = effect.components({"X": np.array([100.0, 450.0])}).values()
    assert moved[0] == 0.0 and abs(moved[1] - 40.0) < 1.0
