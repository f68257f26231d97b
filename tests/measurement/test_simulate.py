"""Simulated measurements compared with the truth machine, which shares no code with `twin`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.measurement.test_instruments import READING
from tests.truth.machine import TruthMachine, carried, seen
from twin import cli
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.measurement.instruments import Air, Instrument, LaserTracker, TrackingInterferometer
from twin.measurement.simulate import Environment, Placement, Station, simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.samples import thesis_plan

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
    return Measurements.load(path, dmu50, plan=True)


def test_without_noise_the_readings_are_the_truth(dmu50: Machine, calibration: Calibration, plan: Measurements) -> None:
    assert calibration.path is not None
    truth = TruthMachine(calibration.path)
    measured, setting = simulate(plan, dmu50, calibration, LaserTracker(), np.random.default_rng(3), noise=False)
    for i in range(len(measured)):
        station = setting.stations[measured.station[i]]
        place = np.array(setting.places_mm[measured.target[i]])
        base = carried(truth, measured.positions[i], measured.carrier[i], place)
        read = seen(np.array(station.origin_mm), np.array(station.rotation_rad), base)
        assert np.abs(read - measured.point_mm[i]).max() <= 1e-9


def test_the_same_seed_gives_the_same_data(dmu50: Machine, calibration: Calibration, plan: Measurements) -> None:
    first, _ = simulate(plan, dmu50, calibration, LaserTracker(), np.random.default_rng(3))
    again, _ = simulate(plan, dmu50, calibration, LaserTracker(), np.random.default_rng(3))
    other, _ = simulate(plan, dmu50, calibration, LaserTracker(), np.random.default_rng(4))
    assert np.array_equal(first.point_mm, again.point_mm)
    assert not np.array_equal(first.point_mm, other.point_mm)


def test_noise_is_the_instruments(dmu50: Machine, calibration: Calibration, plan: Measurements) -> None:
    """Whitened by the stated covariance, the readings' errors are standard normal: chi² of 15 repeats within 4 sigma."""
    setting = Placement.draw(plan, np.random.default_rng(5))
    for instrument in READING:
        exact, _ = simulate(
            plan, dmu50, calibration, instrument, np.random.default_rng(0), setting=setting, noise=False
        )
        rng = np.random.default_rng(6)
        total, count = 0.0, 0
        by_tracker, _ = simulate(plan, dmu50, calibration, LaserTracker(), rng, setting=setting, noise=False)
        seen = by_tracker.point_mm * 1e-3
        covariance = instrument.covariance(seen) * 1e6
        for _ in range(15):
            noisy, _ = simulate(plan, dmu50, calibration, instrument, rng, setting=setting)
            for i, error in enumerate(noisy.point_mm - exact.point_mm):
                read = np.isfinite(error)
                total += error[read] @ np.linalg.solve(covariance[i][np.ix_(read, read)], error[read])
                count += int(read.sum())
        assert abs(total - count) <= 4.0 * np.sqrt(2.0 * count)


def placed(plan: Measurements) -> Measurements:
    """Return the plan with target K and station 1 known."""
    places, poses = np.array(plan.place_mm), np.array(plan.station_pose)
    places[plan.target == "K"] = [12.0, -34.0, 56.0]
    poses[plan.station == "1"] = [0.0, -1900.0, 150.0, 0.0, 0.0, 90.0]
    return replace(plan, place_mm=places, station_pose=poses)


def test_given_places_are_used_and_not_written(dmu50: Machine, calibration: Calibration, plan: Measurements) -> None:
    measured, setting = simulate(placed(plan), dmu50, calibration, LaserTracker(), np.random.default_rng(3))
    assert setting.places_mm["K"] == (12.0, -34.0, 56.0)
    assert setting.stations["1"] == Station((0.0, -1900.0, 150.0), (0.0, 0.0, np.pi / 2))
    assert setting.stations["1"].pose.tolist() == [0.0, -1900.0, 150.0, 0.0, 0.0, 90.0]
    _, drawn = simulate(placed(plan), dmu50, calibration, LaserTracker(), np.random.default_rng(4))
    assert drawn.places_mm["K"] == setting.places_mm["K"] and drawn.places_mm["P"] != setting.places_mm["P"]
    assert drawn.stations["2"] != setting.stations["2"]
    assert np.isnan(measured.place_mm).all() and np.isnan(measured.station_pose).all()
    assert "place_x_mm" not in measured.to_csv(dmu50) and "target K: (12, -34, 56) mm" in setting.describe()


def shop(
    plan: Measurements, machine: Machine, calibration: Calibration, instrument: Instrument, around: Environment | None
) -> np.ndarray:
    return simulate(plan, machine, calibration, instrument, np.random.default_rng(3), surroundings=around)[0].point_mm


def test_no_ambient_influence_by_default(dmu50: Machine, calibration: Calibration, plan: Measurements) -> None:
    """Bit for bit, noise included; the air that the instrument assumes has no influence either."""
    for instrument in READING:
        without = shop(plan, dmu50, calibration, instrument, None)
        for around in (Environment(), Environment(air=Air())):
            assert np.array_equal(shop(plan, dmu50, calibration, instrument, around), without, equal_nan=True)
    assert Environment().describe() == ""


def test_warm_air_shortens_lengths(dmu50: Machine, calibration: Calibration, plan: Measurements) -> None:
    """One degree more: −0.95 µm/m by Birch and Downs, along the beam; for an interferometer, without the dead path."""
    warm = Environment(air=Air(temperature_degC=21.0))
    assert (warm.scale - 1.0) * 1e6 == pytest.approx(-0.95, abs=0.01)
    tracker = LaserTracker()
    exact = shop(plan, dmu50, calibration, tracker, None)
    change = shop(plan, dmu50, calibration, tracker, warm) - exact
    length = np.linalg.norm(exact, axis=1)
    beam = exact / length[:, None]
    # 1e-4 µm: the noise is the same draw, 14 µm across a beam that it turns by 1e-5, times 2 µm
    assert np.sum(change * beam, axis=1) * 1e3 == pytest.approx(-0.952 * length * 1e-3, abs=2e-3)
    assert np.abs(np.cross(change, beam)).max() * 1e3 < 1e-4
    for dead_path in (0.0, 1.5):
        lengths = TrackingInterferometer(dead_path_m=dead_path)
        read = shop(plan, dmu50, calibration, lengths, None)[:, 0]
        shorter = shop(plan, dmu50, calibration, lengths, warm)[:, 0] - read
        assert shorter * 1e3 == pytest.approx(-0.952 * read * 1e-3, abs=2e-3)


def test_a_station_drifts_with_time(dmu50: Machine, calibration: Calibration, plan: Measurements) -> None:
    """In the base frame, linear in the time since the plan's first point; the other station does not move."""
    timed = replace(plan, time_s=5000.0 + 60.0 * np.arange(len(plan)))
    rate = np.array([12.0, -7.0, 3.0])
    around = Environment(drift_um_per_h={"1": (12.0, -7.0, 3.0)})
    still, setting = simulate(timed, dmu50, calibration, LaserTracker(), np.random.default_rng(3), noise=False)
    creeping, _ = simulate(
        timed, dmu50, calibration, LaserTracker(), np.random.default_rng(3), noise=False, surroundings=around
    )
    of = plan.station == "1"
    turn = setting.stations["1"].to_station_mm(np.eye(3) + setting.stations["1"].origin_mm)
    hours = 60.0 * np.flatnonzero(of) / 3600.0
    moved = (creeping.point_mm - still.point_mm) * 1e3
    # the target seems to move the other way; 1e-6 µm is rounding of coordinates of 2000 mm
    assert moved[of] == pytest.approx(-np.outer(hours, rate) @ turn, abs=1e-6)
    assert not moved[~of].any()


def test_drifts_that_cannot_be(dmu50: Machine, calibration: Calibration, plan: Measurements) -> None:
    times = np.arange(len(plan), dtype=float)
    times[np.flatnonzero(plan.station == "2")[1]] = np.nan
    timed = replace(plan, time_s=times)
    with pytest.raises(InputError, match="drift of an unknown station: '3'; expected one of"):
        shop(timed, dmu50, calibration, LaserTracker(), Environment(drift_um_per_h={"3": (1.0, 0.0, 0.0)}))
    with pytest.raises(InputError, match="time_s in every row") as caught:
        shop(timed, dmu50, calibration, LaserTracker(), Environment(drift_um_per_h={"2": (1.0, 0.0, 0.0)}))
    assert caught.value.line == plan.lines[np.flatnonzero(plan.station == "2")[1]]
    shop(timed, dmu50, calibration, LaserTracker(), Environment(drift_um_per_h={"1": (1.0, 0.0, 0.0)}))


def test_command_with_air_and_drift(tmp_path: Path, dmu50: Machine, capsys: pytest.CaptureFixture[str]) -> None:
    """A plan by its bare name; the ambient influences are in the file; bad options are explained."""
    out = tmp_path / "measured.csv"
    with pytest.raises(SystemExit) as stopped:
        cli.main(["simulate", "thesis_plan.csv", "-o", str(out), "--air", "21,1013.25,50", "--drift", "1=5,0,-2.5"])
    assert stopped.value.code == 0 and "840 points" in capsys.readouterr().out
    comment = [line for line in out.read_text().splitlines() if line.startswith("#")]
    assert any("lengths read -0.952 um/m" in line for line in comment)
    assert any("station 1 drifts (5, 0, -2.5) um/h" in line for line in comment)
    assert any("target QT: (60, 90, 140) mm" in line for line in comment)
    assert len(Measurements.load(out, dmu50)) == 840 and "place_x_mm" not in out.read_text()
    for plan_name, arguments, words in (
        ("thesis_plan.csv", ["--air", "21,1013.25"], "T,p,RH"),
        ("thesis_plan.csv", ["--air", "21,101325,50"], "hPa"),
        ("thesis_plan.csv", ["--drift", "5,0,0"], "STATION=x,y,z"),
        ("thesis_plan.csv", ["--drift", "1=5,0"], "x,y,z in µm/h"),
        ("thesis_plan.csv", ["--drift", "east=5,0,0"], "expected one of 1"),
        (
            "thesis.csv",
            [],
            "no such plan (did you mean thesis_plan.csv?); expected a measurement table, or a bundled plan: thesis_plan.csv",
        ),
    ):
        with pytest.raises(SystemExit) as stopped:
            cli.main(["simulate", plan_name, "-o", str(tmp_path / "no.csv"), *arguments])
        assert stopped.value.code == 2 and words in capsys.readouterr().err
        assert not (tmp_path / "no.csv").exists()
    own = tmp_path / "plan.csv"
    own.write_text(thesis_plan.text())
    with pytest.raises(SystemExit) as stopped:
        cli.main(["simulate", str(own), "-o", str(own)])
    assert stopped.value.code == 2 and own.read_text() == thesis_plan.text()


def test_command(tmp_path: Path, dmu50: Machine, plan: Measurements, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "plan.csv", tmp_path / "measured.csv"
    with pytest.raises(SystemExit) as stopped:
        cli.main(["simulate", str(path), "-o", str(out), "--seed", "9"])
    assert stopped.value.code == 0
    assert "60 points" in capsys.readouterr().out
    text = out.read_text()
    assert text.startswith("# simulated by twin") and "seed 9" in text and "# target K:" in text
    measured = Measurements.load(out, dmu50)
    assert len(measured) == 60 and not measured.set_aside
    for arguments, word in ((["--instrument", "ruler"], "tracker"), (["--seed", "-1"], "0 or more")):
        with pytest.raises(SystemExit) as stopped:
            cli.main(["simulate", str(path), "-o", str(tmp_path / "no.csv"), *arguments])
        assert stopped.value.code == 2
        assert word in capsys.readouterr().err
        assert not (tmp_path / "no.csv").exists()
