"""Simulated measurements against the truth machine that shares no code with `twin`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.reference import D, about, error_frame, translation
from tests.truth import TruthMachine
from twin import cli
from twin.calibration import Calibration
from twin.instruments import INSTRUMENTS, LaserTracker
from twin.machine import Machine
from twin.measurement import Measurements, load
from twin.simulate import Setting, simulate

PLAN_HEADER = "X_mm,Y_mm,Z_mm,B_deg,C_deg,target,carrier,station,round"


@pytest.fixture
def plan(dmu50: Machine, tmp_path: Path) -> Measurements:
    """Both sides, two stations, two rounds, poses over the whole range."""
    rng = np.random.default_rng(21)
    rows = []
    for _ in range(60):
        q = rng.uniform([0, 0, -400, 0, 0], [500, 450, 0, 180, 360])
        target, carrier = [("K", "tool"), ("P", "tool"), ("T", "work")][int(rng.integers(3))]
        rows.append(
            ",".join([*(repr(float(v)) for v in q), target, carrier, str(rng.integers(1, 3)), str(rng.integers(1, 3))])
        )
    path = tmp_path / "plan.csv"
    path.write_text(PLAN_HEADER + "\n" + "\n".join(rows) + "\n")
    return load(path, dmu50, plan=True)


def carried(truth: TruthMachine, q: np.ndarray, carrier: str, place: np.ndarray) -> np.ndarray:
    """A reflector in the base frame, mm, from the contract's two chains."""
    e = {axis: error_frame(six) for axis, six in truth.errors(q).items()}
    b, c = np.radians(q[3:])
    if carrier == "tool":
        chain = translation(-250, -225, 400) @ translation(q[0], 0, 0) @ e["X"] @ translation(0, q[1], 0) @ e["Y"]
        chain = chain @ translation(0, 0, q[2]) @ e["Z"]
    else:
        chain = translation(0, 0, D) @ about(0, np.pi / 4) @ e["L_B"] @ e["B"] @ about(2, b) @ about(0, -np.pi / 4)
        chain = chain @ translation(0, 0, -D) @ e["L_C"] @ e["C"] @ about(2, -c)
    return (chain @ np.append(place, 1.0))[:3]


def test_without_noise_the_readings_are_the_truth(dmu50: Machine, calibration: Calibration, plan: Measurements) -> None:
    assert calibration.path is not None
    truth = TruthMachine(calibration.path)
    measured, setting = simulate(plan, dmu50, calibration, LaserTracker(), np.random.default_rng(3), noise=False)
    for i in range(len(measured)):
        station = setting.stations[measured.station[i]]
        place = np.array(setting.places_mm[measured.target[i]])
        base = carried(truth, measured.positions[i], measured.carrier[i], place)
        turn = error_frame(np.concatenate([np.zeros(3), station.turn_rad]))[:3, :3]
        assert np.abs(turn.T @ (base - station.origin_mm) - measured.point_mm[i]).max() <= 1e-9


def test_the_same_seed_gives_the_same_data(dmu50: Machine, calibration: Calibration, plan: Measurements) -> None:
    first, _ = simulate(plan, dmu50, calibration, LaserTracker(), np.random.default_rng(3))
    again, _ = simulate(plan, dmu50, calibration, LaserTracker(), np.random.default_rng(3))
    other, _ = simulate(plan, dmu50, calibration, LaserTracker(), np.random.default_rng(4))
    assert np.array_equal(first.point_mm, again.point_mm)
    assert not np.array_equal(first.point_mm, other.point_mm)


def test_noise_is_the_instruments(dmu50: Machine, calibration: Calibration, plan: Measurements) -> None:
    """Whitened by the stated covariance, the readings' errors are standard normal: chi² of 200 repeats within 4 sigma."""
    setting = Setting.drawn(plan, np.random.default_rng(5))
    for instrument in INSTRUMENTS:
        exact, _ = simulate(
            plan, dmu50, calibration, instrument, np.random.default_rng(0), setting=setting, noise=False
        )
        rng = np.random.default_rng(6)
        total, count = 0.0, 0
        by_tracker, _ = simulate(plan, dmu50, calibration, LaserTracker(), rng, setting=setting, noise=False)
        seen = by_tracker.point_mm * 1e-3
        covariance = instrument.covariance(seen) * 1e6
        for _ in range(200):
            noisy, _ = simulate(plan, dmu50, calibration, instrument, rng, setting=setting)
            for i, error in enumerate(noisy.point_mm - exact.point_mm):
                read = np.isfinite(error)
                total += error[read] @ np.linalg.solve(covariance[i][np.ix_(read, read)], error[read])
                count += int(read.sum())
        assert abs(total - count) <= 4.0 * np.sqrt(2.0 * count)


def test_command(tmp_path: Path, dmu50: Machine, plan: Measurements, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "plan.csv", tmp_path / "measured.csv"
    with pytest.raises(SystemExit) as stopped:
        cli.main(["simulate", str(path), "-o", str(out), "--seed", "9"])
    assert stopped.value.code == 0
    assert "60 points" in capsys.readouterr().out
    text = out.read_text()
    assert text.startswith("# simulated by twin") and "seed 9" in text and "# target K:" in text
    measured = load(out, dmu50)
    assert len(measured) == 60 and not measured.set_aside
    for arguments, word in ((["--instrument", "ruler"], "tracker"), (["--seed", "-1"], "0 or more")):
        with pytest.raises(SystemExit) as stopped:
            cli.main(["simulate", str(path), "-o", str(tmp_path / "no.csv"), *arguments])
        assert stopped.value.code == 2
        assert word in capsys.readouterr().err
        assert not (tmp_path / "no.csv").exists()
