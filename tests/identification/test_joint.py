"""Joint estimates: a probe and a tracker in one likelihood, and ball bar circles."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.measurement.probing import SPHERES, probing
from tests.measurement.test_probe import CONSTANTS
from tests.truth.machine import carried, written
from twin.identification import Identification, identify
from twin.machine.machine import Machine
from twin.measurement.instruments import BallBar, TouchProbe
from twin.measurement.instruments.points import AT960
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.samples import thesis_plan

NAMES = {**CONSTANTS["squareness"], **CONSTANTS["location"]}


@pytest.fixture(scope="module")
def truth(dmu50: Machine, tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    path = tmp_path_factory.mktemp("truth") / "truth.yaml"
    written(path, {name: dict(of) for name, of in CONSTANTS.items()})
    return Calibration.load(path, dmu50)


def u_of(found: Identification) -> dict[str, float]:
    return {name: float(np.sqrt(found.calibration.covariance.of([name]).matrix[0, 0])) for name in NAMES}


def test_probe_and_tracker_in_one_estimate(dmu50: Machine, truth: Calibration) -> None:
    """Both have a station 1; the joint u is that of the two informations added, and the constants are within it."""
    rng = np.random.default_rng(1)
    spheres = replace(probing(dmu50, SPHERES, 20, 2), station=np.full(60, "1", dtype=object), source="probe.csv")
    probe = replace(simulate(spheres, dmu50, truth, TouchProbe(), rng)[0], source="probe.csv")
    plan = thesis_plan.plan(dmu50)
    few = plan.select(np.arange(0, len(plan), 9))
    tracker = replace(simulate(few, dmu50, truth, AT960, rng)[0], source="tracker.csv")
    results = [
        identify(data, dmu50, wanted=lambda name: name in NAMES)
        for data in (probe, tracker, Measurements.join([tracker, probe]))
    ]
    own, other, both = (u_of(found) for found in results)
    for name, value in NAMES.items():
        assert both[name] <= 1.001 * min(own[name], other[name])
        estimate = {**results[2].calibration.squareness, **results[2].calibration.location}[name]
        assert abs(estimate - value) < 4.5 * both[name]
    shares = results[2].shares
    assert [(one.instrument, one.stations) for one in shares] == [("tracker", ("1",)), ("probe", ("1 (probe.csv)",))]
    assert all(0.6 < one.reduced_chi2 < 1.5 for one in shares)
    assert "probe (1 (probe.csv)): 180 readings" in results[2].to_text()
    assert shares[1].alone is not None and shares[1].alone.determined < 14


@pytest.mark.slow  # 30 s
def test_positions_of_a_probe_do_not_hide_the_curves_that_a_tracker_reads(dmu50: Machine) -> None:
    """Eleven stops of a run determine no curve of degree 12, whatever the probe's positions; with fewer functions all are found."""
    rng = np.random.default_rng(1)
    truth = Calibration.default(dmu50)
    spheres = replace(probing(dmu50, SPHERES, 25, 2), source="probe.csv")
    plan = thesis_plan.plan(dmu50)
    tables = [simulate(of, dmu50, truth, by, rng)[0] for of, by in ((plan, AT960), (spheres, TouchProbe()))]
    found = identify(Measurements.join([replace(tables[0], source="tracker.csv"), tables[1]]), dmu50)
    assert not {one.name for one in found.calibration.not_identifiable} & set(dmu50.motion_names)
    assert all(0.4 < one.reduced_chi2 < 1.5 for one in found.shares), found.shares


def circles(radius: float, noise_um: float, errors: Path, seed: int) -> tuple[Measurements, np.ndarray]:
    """Return lengths of a ball bar on circles in XY and ZX about a pivot on the table, by a machine model without `twin`."""
    model = written(errors, {"squareness": {"E_C0Y": 40.0, "E_B0Z": -30.0}})
    angle = np.radians(np.arange(0.0, 360.0, 5.0))
    centre, ball, pivot = np.array([250.0, 225.0, -250.0]), np.array([0.0, 0.0, -100.0]), np.array([0.0, 0.0, 50.0])
    planes = [
        np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1),
        np.stack([np.sin(angle), 0 * angle, np.cos(angle)], 1),
    ]
    q = np.concatenate([np.concatenate([centre + radius * p, np.zeros((72, 2))], 1) for p in planes])
    length = [np.linalg.norm(carried(model, x, "tool", ball) - carried(model, x, "work", pivot)) for x in q]
    rng = np.random.default_rng(seed)
    points = np.full((len(q), 3), np.nan)
    points[:, 0] = np.array(length) + 1e-3 * rng.normal(0.0, noise_um, len(q))
    names = {"target": "ball", "carrier": "tool", "station": "pivot", "station_carrier": "work"}
    columns = {field: np.full(len(q), name, dtype=object) for field, name in names.items()}
    return Measurements(source="bar.csv", lines=np.arange(len(q)) + 2, positions=q, point_mm=points, **columns), q


def test_a_ball_bar_shows_squareness(dmu50: Machine, tmp_path: Path) -> None:
    """Two circles of 150 mm radius: the squareness of both planes within 4 u, from absolute lengths."""
    data, _ = circles(150.0, 0.35, tmp_path / "truth.yaml", 3)
    found = identify(data, dmu50, instrument=BallBar(), wanted=lambda name: name in ("E_C0Y", "E_B0Z"))
    for name, value in (("E_C0Y", 40.0), ("E_B0Z", -30.0)):
        u = float(np.sqrt(found.calibration.covariance.of([name]).matrix[0, 0]))
        assert u < 2.0 and abs(found.calibration.squareness[name] - value) < 4.0 * u
    assert found.rms_um < 0.5 and not found.set_aside


def test_a_ball_bar_is_recognised(dmu50: Machine, tmp_path: Path) -> None:
    found = identify(circles(150.0, 0.35, tmp_path / "truth.yaml", 4)[0], dmu50, wanted=lambda name: name == "E_C0Y")
    assert any("read by a telescoping ball bar" in text for text in found.notices)
