"""One suite for all instruments, the multi-axis interferometer included, and the influence of air on a length."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, replace
from pathlib import Path

import numpy as np
import pytest

from tests.identification.plans import PLACES, STATIONS, volumetric
from tests.measurement.wen import nine_beams
from tests.truth.machine import TruthMachine, carried, in_datum, seen, written
from twin._common.errors import InputError
from twin.identification import identify
from twin.machine.machine import Machine
from twin.measurement.instruments import (
    INSTRUMENTS,
    SIDES,
    Air,
    Instrument,
    LaserTracker,
    MultiAxis,
    TrackingInterferometer,
    default_instrument,
    refractive_index,
)
from twin.measurement.instruments.base import length_scale
from twin.measurement.instruments.lengths import TRACKING
from twin.measurement.instruments.points import AT960, AT960_ABSOLUTE
from twin.measurement.simulate import Placement, Station, simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

POINTS = np.array([[2.0, 0.0, 0.0], [1.0, -1.5, 0.5], [0.3, 0.2, -2.2]])
every = pytest.mark.parametrize("instrument", INSTRUMENTS, ids=lambda instrument: instrument.name)
READING = [one for one in INSTRUMENTS if one.specification.reads != "null"]
"""All but the probe, whose measurement is in the axis positions (`tests.measurement.test_probe`)."""


@pytest.mark.parametrize("instrument", [*INSTRUMENTS, nine_beams()], ids=lambda one: one.specification.name)
def test_a_specification_says_everything_and_cannot_change(instrument: Instrument | MultiAxis) -> None:
    of = instrument.specification
    assert of.name and of.title and of.columns
    assert len(set(of.columns)) == len(of.columns)
    assert set(of.rides_on) <= set(SIDES)
    assert of.source
    with pytest.raises(FrozenInstanceError):
        of.name = "another"  # type: ignore[misc]


def test_names_are_distinct_and_the_usual_ones_come_first() -> None:
    names = [one.name for one in INSTRUMENTS]
    assert len(set(names)) == len(names)
    assert default_instrument("point") is AT960
    assert default_instrument("length").specification.free_start
    assert default_instrument("point", "work", 3.0).name == "r-test"
    assert default_instrument("point", "work", 300.0) is AT960
    assert default_instrument("length", "work", 150.0).name == "ball-bar"
    assert default_instrument("null", "tool").name == "probe"


@every
def test_it_reads_the_columns_that_it_states(instrument: Instrument) -> None:
    by_column = zip(("x_mm", "y_mm", "z_mm"), instrument.read(POINTS).T, strict=True)
    read = [name for name, values in by_column if np.isfinite(values).all()]
    assert tuple(read) == instrument.specification.columns


@pytest.mark.sample(2)  # of 8
@every
def test_noise_has_the_stated_covariance(instrument: Instrument) -> None:
    """200,000 draws: sample covariance within 1.5 % of the largest entry (three times its own standard error)."""
    rng = np.random.default_rng(7)
    n = 200_000
    for point in POINTS:
        stated = instrument.covariance(point[None])[0]
        draws = instrument.noise(np.tile(point, (n, 1)), rng)
        assert np.abs(np.cov(draws.T) - stated).max() <= 0.015 * np.abs(stated).max()
        assert np.abs(draws.mean(axis=0)).max() <= 4.0 * np.sqrt(np.abs(stated).max() / n)


@every
def test_the_pooled_scatter_is_the_covariance(instrument: Instrument) -> None:
    """100,000 draws at one point: variances within 2 % (four standard errors, √(2/n) each)."""
    n = 100_000
    readings = np.tile(np.nan_to_num(instrument.read(POINTS[1:2])), (n, 1))
    draws = instrument.noise(np.tile(POINTS[1], (n, 1)), np.random.default_rng(8))
    stated = instrument.covariance(POINTS[1:2])[0]
    assert np.abs(instrument.pooled(readings, draws, n)[0] - stated).max() <= 0.02 * np.abs(stated).max()


@every
def test_jacobian_is_the_derivative(instrument: Instrument) -> None:
    h = 1e-6
    found = instrument.jacobian(POINTS)
    for k in range(3):
        step = np.zeros(3)
        step[k] = h
        slope = (instrument.read(POINTS + step) - instrument.read(POINTS - step)) / (2 * h)
        assert np.abs(found[:, :, k] - np.nan_to_num(slope)).max() < 1e-9


def riding(truth: TruthMachine, plan: Measurements, side: str) -> np.ndarray:
    """Return (n, 3) targets in the frames of stations that ride on a side, mm, by the two chains of the conventions."""
    found = np.empty((len(plan), 3))
    for i, q in enumerate(plan.positions):
        carrier, place = PLACES[plan.target[i]]
        point = carried(truth, q, carrier, np.array(place))
        if side != "base":
            origin = carried(truth, q, side, np.zeros(3))
            axes = [carried(truth, q, side, axis) - origin for axis in np.eye(3)]
            point = np.array(axes) @ (point - origin)
        pose = np.array(STATIONS[plan.station[i]])
        found[i] = seen(pose[:3], pose[3:], point)
    return found


@pytest.mark.sample(7)  # of 21
@pytest.mark.parametrize("instrument", READING, ids=lambda instrument: instrument.name)
@pytest.mark.parametrize("side", SIDES)
def test_a_station_rides_on_any_side(instrument: Instrument, side: str, dmu50: Machine, tmp_path: Path) -> None:
    """Simulated readings without noise compared with the truth machine: 1e-6 mm for coordinates of two metres."""
    errors = in_datum(np.random.default_rng(3), size=100.0)
    truth = written(tmp_path / "truth.yaml", errors)
    calibration = Calibration.load(tmp_path / "truth.yaml", dmu50)
    plan = volumetric(dmu50, np.random.default_rng(4), 60)
    plan = replace(plan, station_carrier=np.full(len(plan), side, dtype=object))
    stations = {name: Station(pose[:3], pose[3:]) for name, pose in STATIONS.items()}
    setting = Placement(stations, {name: place for name, (_, place) in PLACES.items()})
    rng = np.random.default_rng(5)
    found, _ = simulate(plan, dmu50, calibration, instrument, rng, setting=setting, noise=False)
    expected = instrument.read(riding(truth, plan, side) * 1e-3) * 1e3
    assert np.nanmax(np.abs(found.point_mm - expected)) < 1e-6
    assert np.array_equal(np.isnan(found.point_mm), np.isnan(expected))
    found.save(tmp_path / "m.csv", dmu50)
    assert set(Measurements.load(tmp_path / "m.csv", dmu50).station_carrier) == {side}


@pytest.mark.slow
def test_an_r_test_is_identified(dmu50: Machine, tmp_path: Path) -> None:
    """Sensor nests on the table read balls on the tool: of errors of 100 µm less than 1e-3 µm remain."""
    errors = in_datum(np.random.default_rng(6), size=100.0)
    plan = volumetric(dmu50, np.random.default_rng(7), 500, stations=1)
    plan = plan.select(plan.carrier == "tool")
    plan = replace(plan, station_carrier=np.full(len(plan), "work", dtype=object))
    data = replace(plan, point_mm=riding(written(tmp_path / "truth.yaml", errors), plan, "work"))
    found = identify(data, dmu50)
    assert found.converged
    assert found.rms_um < 1e-3
    drawn = identify(data, dmu50, wanted=lambda name: name == "E_XX")
    assert drawn.rms_um > 10.0


@pytest.mark.slow
def test_lengths_from_a_known_zero_have_no_dead_path(dmu50: Machine, tmp_path: Path) -> None:
    """An instrument that differs in its specification only: spheres on the table, absolute lengths."""
    bar = TrackingInterferometer(specification=replace(TRACKING, name="bar", free_start=False))
    errors = in_datum(np.random.default_rng(8), size=100.0)
    plan = volumetric(dmu50, np.random.default_rng(9), 1600, stations=4)
    plan = plan.select(plan.carrier == "tool")
    plan = replace(plan, station_carrier=np.full(len(plan), "work", dtype=object))
    points = riding(written(tmp_path / "truth.yaml", errors), plan, "work")
    found = identify(replace(plan, point_mm=bar.read(points * 1e-3) * 1e3), dmu50, instrument=bar)
    assert not any("dead path" in name for name in found.setup.names)
    assert np.all(found.setup.dead == 0.0)
    assert found.rms_um < 1e-3


def test_a_station_on_two_sides_is_refused(dmu50: Machine, tmp_path: Path) -> None:
    text = "X_mm,Y_mm,Z_mm,B_deg,C_deg,target,carrier,x_mm,y_mm,z_mm,station_carrier\n"
    text += "0,0,0,0,0,K,tool,1,2,3,base\n1,0,0,0,0,K,tool,1,2,3,{}\n"
    for side, said in (("work", "station on both sides"), ("bench", "unknown station carrier")):
        (tmp_path / "m.csv").write_text(text.format(side))
        with pytest.raises(InputError, match=said):
            Measurements.load(tmp_path / "m.csv", dmu50)


def test_the_at960_of_the_data_sheet() -> None:
    """At two metres: half of 0.4 + 0.6 µm along the beam, half of 15 + 12 µm across it; ±10 µm absolute."""
    covariance = LaserTracker().covariance(POINTS[:1])[0]
    assert np.sqrt(np.diag(covariance)) * 1e6 == pytest.approx([0.5, 13.5, 13.5])
    absolute = AT960_ABSOLUTE.covariance(POINTS[:1])[0]
    assert np.sqrt(absolute[0, 0]) * 1e6 == pytest.approx(5.0)


def test_the_interferometer_reads_lengths_from_its_zero() -> None:
    readings = TrackingInterferometer(dead_path_m=0.5).read(POINTS)
    assert readings[:, 0] == pytest.approx(np.linalg.norm(POINTS, axis=1) - 0.5)
    assert np.isnan(readings[:, 1:]).all()


def test_air() -> None:
    """Printed value of NIST's engineering metrology toolbox form of the equation, and the thesis's rules of thumb."""
    # 633 nm, 20 °C, 101.325 kPa, 50 % humidity: 1.00027137 (NIST, Stone and Zimmerman).
    standard = Air(20.0, 1013.25, 0.5)
    assert refractive_index(standard) == pytest.approx(1.00027137, abs=2e-8)
    per_degree = (length_scale(Air(21.0, 1013.25, 0.5), standard) - 1.0) * 1e6
    per_hpa = (length_scale(Air(20.0, 1014.25, 0.5), standard) - 1.0) * 1e6
    per_tenth = (length_scale(Air(20.0, 1013.25, 0.6), standard) - 1.0) * 1e6
    assert per_degree == pytest.approx(-1.0, abs=0.1)
    assert per_hpa == pytest.approx(0.3, abs=0.05)
    assert per_tenth == pytest.approx(-0.1, abs=0.05)
    with pytest.raises(InputError, match="hPa"):
        Air(20.0, 101325.0, 0.5)
