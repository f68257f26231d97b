"""The gain of modelling a cause, evaluated on the truth machine: commands of each model run on the machine with the hidden effect.

The truth machine (`tests.truth.hidden`) shares no code with `twin`. Its error at the tool is the way from a point of the work to the
tip that was meant to be there.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.truth import hidden
from tests.truth.hidden import Hidden, Plan
from tests.truth.machine import AXES
from twin.diagnosis import diagnose
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions
from twin.tool.forward import Kinematics
from twin.tool.inverse import Inverse

TOOL_MM = 100.0
SIGMA_MM = 3e-3
WARM = {"X": 21.5, "Y": 21.5, "Z": 21.5, "bed": 20.8}
POSES = 60

EVERY = [
    Hidden("reversal", "Y", {"size": 12.0}),
    Hidden("thermal_expansion", "X", {"coefficient": 15.0}),
    Hidden("thermal_growth", "Z by bed", {"coefficient": 6.0}),
    Hidden("harmonic", "E_XC", {"order": 3, "cos": 7.0, "sin": -5.0}),
    Hidden("angular_error_motion", "E_BX", {"c1": 40.0, "c2": 60.0}),
    Hidden("cross_axis", "E_BZ by Y", {"coefficient": 300.0}),
    Hidden("table_load", "B", {"tilt": 60.0}),
]

DEFAULT = ("reversal", "thermal_expansion", "cross_axis")


def errors_um(machine: Machine, calibration: Calibration, truth: Hidden, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """Return the (n,) error at the tool, on the truth machine, of commands compensated with a calibration."""
    rng = np.random.default_rng(12)
    margin = 0.05 * (hidden.HIGH - hidden.LOW)
    start = rng.uniform(hidden.LOW + margin, hidden.HIGH - margin, (POSES, 5))
    approach = rng.choice([-1.0, 1.0], (POSES, 5))
    meant = Kinematics(machine, Calibration.zero(machine), tool_length_mm=TOOL_MM).forward(start)
    real = Kinematics(machine, calibration, tool_length_mm=TOOL_MM, conditions=Conditions(WARM))
    solved = Inverse(real).solve(meant, start, approach=approach if real.directed else None)
    q = np.repeat(solved.positions, 2, axis=0)
    names = np.array([name for i in range(POSES) for name in ("tip", f"point {i}")])
    monkeypatch.setitem(hidden.TARGETS, "tip", ("tool", (0.0, 0.0, -TOOL_MM)))
    monkeypatch.setitem(hidden.STATIONS, "base", ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    for i, point in enumerate(meant.point_mm):
        monkeypatch.setitem(hidden.TARGETS, f"point {i}", ("work", tuple(point)))
    n = len(q)
    run = Plan(
        q,
        np.repeat(approach, 2, axis=0),
        names,
        np.full(n, "base"),
        np.full(n, "1"),
        np.zeros(n),
        {name: np.full(n, value) for name, value in WARM.items()},
    )
    points = hidden.points(run, [truth])
    return np.linalg.norm(points[::2] - points[1::2], axis=1) * 1e3


@pytest.mark.sample(1)  # of 3
@pytest.mark.parametrize(
    "truth",
    [h if h.effect in DEFAULT else pytest.param(h, marks=pytest.mark.slow) for h in EVERY],
    ids=lambda h: f"{h.effect} {h.where}",
)
def test_compensating_with_what_was_found_is_better_on_the_truth(
    dmu50: Machine, calibration: Calibration, tmp_path: Path, truth: Hidden, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(9)
    plan = hidden.rounded(hidden.plan(rng, poses=60))
    read = hidden.noisy(hidden.points(plan, [truth]), rng, "isotropic", SIGMA_MM)
    result = diagnose(
        Measurements.load(hidden.write(tmp_path / "m.csv", plan, read, u_mm=SIGMA_MM), dmu50), dmu50, calibration
    )
    assert result.gain is not None
    before = errors_um(dmu50, calibration, truth, monkeypatch)
    extended = result.extended
    # Loaded as `compensate` loads it.
    extended.save(tmp_path / "better.yaml")
    extended = Calibration.load(tmp_path / "better.yaml", dmu50)
    after = errors_um(dmu50, extended, truth, monkeypatch)
    rms_before, rms_after = (float(np.sqrt(np.mean(e**2))) for e in (before, after))
    assert rms_after < 0.35 * rms_before
    # As stated in the report: within three standard uncertainties (and a tenth of a µm for second order and rounding).
    assert rms_after < 3.0 * result.gain.tool_after_um + 0.1
    # The report uses another volume and other states than these poses: the size is similar, not equal.
    assert 0.4 * result.gain.tool_before_um < rms_before < 2.5 * result.gain.tool_before_um
    assert list(AXES) == list(dmu50.names)
