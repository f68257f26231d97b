"""Wrong data: outliers, broken beams, exchanged columns. Each is detected, named and excluded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin.identification import Identification, identify
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker, TrackingInterferometer
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.samples import thesis_plan


@pytest.fixture(scope="module")
def data(dmu50: Machine) -> Measurements:
    """The thesis's plan, measured with noise."""
    rng = np.random.default_rng(41)
    return simulate(thesis_plan.plan(dmu50), dmu50, Calibration.default(dmu50), LaserTracker(), rng)[0]


def displaced(data: Measurements, rows: np.ndarray, by_mm: np.ndarray) -> Measurements:
    points = np.array(data.point_mm)
    points[rows] += by_mm
    return replace(data, point_mm=read_only(points))


def check_as_without(found: Identification, without: Identification) -> None:
    """Check every curve where it was measured, and every number, within 0.2 of the stated standard uncertainty."""
    assert set(found.calibration.curves) == set(without.calibration.curves)
    for name in without.calibration.curves:
        q = thesis_plan.POSITIONS[name[3]]
        value, _ = found.interval(name, q)
        expected, u = without.interval(name, q)
        assert np.all(np.abs(value - expected) <= 0.2 * u), name
    for numbers, expected_numbers in (
        (found.calibration.squareness, without.calibration.squareness),
        (found.calibration.location, without.calibration.location),
    ):
        for name, number in expected_numbers.items():
            u = np.sqrt(without.calibration.covariance.of([name]).matrix[0, 0])
            assert abs(numbers[name] - number) <= 0.2 * u, name


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)])
def test_outliers_are_found(dmu50: Machine, data: Measurements, seed: int) -> None:
    """Twelve readings with errors of 0.1 to 5 mm in any direction: exactly these are found, and the estimate is the one without them.

    The tracker's standard deviation across the beam is 14 µm, and the limit 5.3 of them (one false alarm in a hundred data sets).
    """
    rng = np.random.default_rng(seed)
    rows = np.sort(rng.choice(len(data), 12, replace=False))
    direction = rng.normal(size=(12, 3))
    size = np.geomspace(0.1, 4.9, 12)  # beyond 5 mm it is the command that is doubted
    by = direction / np.linalg.norm(direction, axis=1)[:, None] * rng.permutation(size)[:, None]
    found = identify(displaced(data, rows, by), dmu50)
    notes = {note.line: note.text for note in found.set_aside}
    assert sorted(notes) == data.lines[rows].tolist()
    assert np.array_equal(np.flatnonzero(~found.used), rows)
    for row, off in zip(rows, np.linalg.norm(by, axis=1), strict=True):
        text = notes[int(data.lines[row])]
        assert text.startswith(f"outlier, not used: target {data.target[row]}, round {data.round[row]}, station 1: ")
        said = float(text.split(": residual ")[1].split(" µm")[0])
        assert said == pytest.approx(1e3 * off, abs=60.0)  # four standard deviations across the beam
        assert "along the beam" in text and "median residual of its 3 repeats" in text
    assert not found.complete
    keep = np.setdiff1d(np.arange(len(data)), rows)
    check_as_without(found, identify(data.select(keep), dmu50))


@pytest.mark.slow
def test_a_broken_beam(dmu50: Machine, data: Measurements) -> None:
    """Target P is lost in X's second round at the fourth position, and counted from a wrong length until the run ends."""
    of = (data.target == "P") & (data.round == "2") & (data.approach[:, 0] != 0)
    rows = np.flatnonzero(of)[3:]
    beam = data.point_mm[rows] / np.linalg.norm(data.point_mm[rows], axis=1)[:, None]
    found = identify(displaced(data, rows, 0.35 * beam), dmu50)
    assert [note.line for note in found.set_aside] == data.lines[rows].tolist()
    for note in found.set_aside:
        along = float(note.text.split(" µm of it along the beam")[0].rsplit(", ", 1)[1])
        assert along == pytest.approx(350.0, abs=5.0)  # of 0.5 µm along the beam, and the curves' own uncertainty
    keep = np.setdiff1d(np.arange(len(data)), rows)
    check_as_without(found, identify(data.select(keep), dmu50))


@pytest.mark.slow
def test_a_wrong_command(dmu50: Machine, data: Measurements) -> None:
    """One row has a command 12 mm off, and one a command off by a whole step: set aside before the estimate."""
    positions = np.array(data.positions)
    first = np.flatnonzero(data.approach[:, 1] != 0)[17]
    second = np.flatnonzero(data.approach[:, 4] != 0)[40]
    positions[first, 1] += 12.0 if positions[first, 1] < 400.0 else -12.0
    positions[second, 4] += 20.0
    found = identify(replace(data, positions=read_only(positions)), dmu50)
    assert sorted(note.line for note in found.set_aside) == sorted(data.lines[[first, second]].tolist())
    for note in found.set_aside:
        assert "the reading disagrees with the command by" in note.text
    text = next(note.text for note in found.set_aside if note.line == data.lines[first])
    said = float(text.split("command by ")[1].split(" mm")[0])
    assert said == pytest.approx(12.0, abs=0.3)  # the machine's own errors
    assert len(found.data) == len(data) - 2 and found.used.all()


@pytest.mark.sample(1)  # of 4
@pytest.mark.parametrize(
    ("first", "second", "words"),
    [
        (0, 1, "columns X_mm and Y_mm look swapped"),
        (1, 2, "columns Y_mm and Z_mm look swapped"),
        (3, 4, "columns B_deg and C_deg look swapped"),
        (0, 3, "columns X_mm and B_deg look swapped"),
    ],
)
def test_swapped_columns_are_named(dmu50: Machine, data: Measurements, first: int, second: int, words: str) -> None:
    positions = np.array(data.positions)
    positions[:, [first, second]] = positions[:, [second, first]]
    with pytest.raises(InputError) as caught:
        identify(replace(data, positions=read_only(positions)), dmu50)
    assert words in caught.value.what
    assert caught.value.file == data.source and caught.value.line in data.lines


@pytest.mark.parametrize(("axis", "column"), [(0, "X_mm"), (2, "Z_mm"), (3, "B_deg"), (4, "C_deg")])
def test_a_wrong_sign_is_named(dmu50: Machine, data: Measurements, axis: int, column: str) -> None:
    positions = np.array(data.positions)
    positions[:, axis] *= -1.0
    with pytest.raises(InputError) as caught:
        identify(replace(data, positions=read_only(positions)), dmu50)
    assert f"column {column} appears to have the wrong sign" in caught.value.what


@pytest.mark.parametrize("change", ["swap", "sign"])
def test_a_mirror_is_named(dmu50: Machine, data: Measurements, change: str) -> None:
    """Measured coordinates in a left-handed frame: two columns swapped, or one with the wrong sign."""
    points = data.point_mm[:, [1, 0, 2]] if change == "swap" else data.point_mm * [1.0, -1.0, 1.0]
    with pytest.raises(InputError, match="readings of station 1 are in a left-handed frame") as caught:
        identify(replace(data, point_mm=read_only(np.array(points))), dmu50)
    assert "right-handed" in caught.value.expected


def test_the_instrument_must_fit_the_columns(dmu50: Machine, data: Measurements) -> None:
    lengths = np.array(data.point_mm)
    lengths[:, 0] = np.linalg.norm(lengths, axis=1)
    lengths[:, 1:] = np.nan
    only = replace(data, point_mm=read_only(lengths))
    with pytest.raises(InputError, match="only x_mm is given, and as a coordinate"):
        identify(only, dmu50, instrument=LaserTracker())
    with pytest.raises(InputError, match="interferometer reads one number, but y_mm or z_mm is given") as caught:
        identify(data, dmu50, instrument=TrackingInterferometer())
    assert caught.value.line == data.lines[0]


def test_nothing_that_moved(dmu50: Machine, data: Measurements) -> None:
    still = data.select(np.all(data.positions == data.positions[0], axis=1))
    with pytest.raises(InputError):
        identify(still, dmu50)
