"""The thermal test of a rotary axis: tables of the truth machine, whose axis moves over time; it shares no code with `twin`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.monitoring.folder import probed
from tests.standards.motions import write
from tests.truth.machine import TruthMachine, carried
from twin.machine.machine import Machine
from twin.standards import StandardTest, evaluate_drift

CALIBRATION = Path(__file__).resolve().parents[2] / "urdf" / "dmu50.calibration.yaml"
PLACE = np.array([110.0, 20.0, 60.0])
TIP = np.array([0.0, 0.0, -150.0])
END = {
    "C": {"X": 6.0, "Y": -4.0, "Z": 9.0, "A": 25.0, "B": -30.0, "C": 40.0},
    "B": {"X": 7.0, "Y": 5.0, "Z": -3.0, "A": 15.0, "B": 20.0, "C": -25.0},
}
"""Changes until the end of the test, in the frame of the axis, whose z is the axis: µm and µrad."""
RADIAL_UM = 8.0
ANGLES = {"C": (0.0, 90.0, 180.0, 270.0), "B": (0.0, 25.0, 50.0, 75.0, 100.0)}
CYCLES = 7


def heated(axis: str, share: float) -> TruthMachine:
    truth = TruthMachine(CALIBRATION)
    for letter, change in END[axis].items():
        name = f"E_{letter}0{axis}"
        truth.location[name] = truth.location.get(name, 0.0) + share * change
    return truth


def poses(axis: str) -> list[tuple[float, float]]:
    return [(0.0, angle) if axis == "C" else (angle, 0.0) for angle in ANGLES[axis]]


def expanded(axis: str, share: float) -> np.ndarray:
    """Return the place on the table; it moves away from C in the test of C."""
    radius = float(np.hypot(*PLACE[:2]))
    outward = np.array([*PLACE[:2], 0.0]) / radius
    return PLACE + share * RADIAL_UM * 1e-3 * outward * (axis == "C")


def probe_table(path: Path, axis: str, noise_mm: float = 0.0) -> Path:
    rng = np.random.default_rng(3)
    rows = []
    for cycle in range(CYCLES):
        share = cycle / (CYCLES - 1)
        for b, c in poses(axis):
            rows.append([*probed(heated(axis, share), expanded(axis, share), TIP, b, c), b, c])
    q = np.array(rows)
    q[:, :3] += rng.normal(0.0, noise_mm, (len(q), 3))
    columns: dict[str, list[object]] = {
        "station": ["p"] * len(q), "station_carrier": ["tool"] * len(q),
        "time_s": [600.0 * (k // len(ANGLES[axis])) + 20.0 * (k % len(ANGLES[axis])) for k in range(len(q))],
    }  # fmt: skip
    if noise_mm:
        columns |= {f"u_{name}_mm": [noise_mm] * len(q) for name in "xyz"}
    return write(path, q, np.zeros((len(q), 3)), carrier="work", **columns)


def nest_table(path: Path, axis: str) -> Path:
    """Return readings of a nest on the table at positions of the nominal machine, along the axes of the true table."""
    nominal = TruthMachine(CALIBRATION)
    nominal.curves, nominal.squareness, nominal.location = {}, {}, {}
    rows, points = [], []
    for cycle in range(CYCLES):
        share = cycle / (CYCLES - 1)
        truth = heated(axis, share)
        for b, c in poses(axis):
            q = np.array([*probed(nominal, PLACE, TIP, b, c), b, c])
            origin, place = carried(truth, q, "work", np.zeros(3)), expanded(axis, share)
            turn = np.stack([carried(truth, q, "work", np.eye(3)[k]) - origin for k in range(3)])
            rows.append(q)
            points.append(turn @ (carried(truth, q, "tool", TIP) - carried(truth, q, "work", place)))
    n = len(rows)
    return write(
        path, np.array(rows), np.array(points), station=["n"] * n, station_carrier=["work"] * n,
        time_s=[100.0 * k for k in range(n)],
    )  # fmt: skip


def wanted(axis: str) -> dict[str, float]:
    """Return the changes at the level of the sphere; the position of C turns against its z, that of B with it."""
    own = END[axis]
    level = PLACE[2] if axis == "C" else None
    found = {f"E_{letter}0{axis}": own[letter] for letter in "AB"}
    found |= {f"axial_{axis}": own["Z"], f"zero_{axis}": own["C"] * (-1.0 if axis == "C" else 1.0)}
    if level is not None:
        found |= {"E_X0C": own["X"] + own["B"] * level * 1e-3, "E_Y0C": own["Y"] - own["A"] * level * 1e-3}
    found[f"radial_{axis}"] = RADIAL_UM * (axis == "C")
    return found


def ends(test: StandardTest) -> dict[str, tuple[float, float]]:
    return {one.key[:-4]: (one.value, one.expanded) for one in test.values if one.key.endswith("_end")}


@pytest.mark.parametrize("axis", ["C", "B"])
@pytest.mark.parametrize("table", [probe_table, nest_table])
def test_changes_of_the_axis_are_found(dmu50: Machine, tmp_path: Path, axis: str, table: object) -> None:
    path = table(tmp_path / "t.csv", axis)  # type: ignore[operator]
    (test,) = evaluate_drift(path, dmu50).tests
    assert test.kind == "moving rotary axis" and test.name == axis
    found = ends(test)
    for name, value in wanted(axis).items():
        assert found[name][0] == pytest.approx(value, abs=0.05), name
    assert any("text was not read" in text for text in test.remarks)


def test_the_uncertainty_covers(dmu50: Machine, tmp_path: Path) -> None:
    (test,) = evaluate_drift(probe_table(tmp_path / "t.csv", "C", noise_mm=0.001), dmu50).tests
    off = {name: (ends(test)[name][0] - value) / ends(test)[name][1] for name, value in wanted("C").items()}
    assert all(abs(value) < 1.6 for value in off.values()) and max(map(abs, off.values())) > 0.1, off
    assert any("from the residuals" in text for text in test.remarks)
