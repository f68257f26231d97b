"""No finding on honest data of a machine with errors; mirrored, exchanged and wrongly scaled coordinates are found.

The readings come from `tests.truth.machine`, which shares no code with `twin`.
"""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest

import twin
from tests.truth.machine import TruthMachine, carried, seen
from twin.machine.machine import Machine
from twin.measurement.agreement import wrong_columns
from twin.measurement.table import Measurements

LOW, HIGH = np.array([0.0, 0.0, -400.0, 0.0, 0.0]), np.array([500.0, 450.0, 0.0, 180.0, 360.0])
DRAWS = {"tracker": 55, "cmm": 55, "lines": 55} | dict.fromkeys(
    ("plane", "thin", "rtest", "interferometer", "probe"), 20
)  # a wrong row makes every change of the columns be tried: 2 s a draw
DRAWS |= {"outlier": 4}


@pytest.fixture(scope="module")
def machine() -> Machine:
    return twin.Machine.load("dmu50")


@pytest.fixture(scope="module")
def truth(machine: Machine) -> TruthMachine:
    return TruthMachine(machine.default_calibration)


def drawn(truth: TruthMachine, rng: np.random.Generator) -> TruthMachine:
    """Return a machine whose error motions are up to three times as large and of any sign."""
    own = copy.copy(truth)
    own.curves = {
        name: {
            **entry,
            "coefficients": (rng.uniform(-3.0, 3.0) * np.array(entry["coefficients"], dtype=float)).tolist(),
        }
        for name, entry in truth.curves.items()
    }
    return own


def measured(truth: TruthMachine, seed: int, kind: str) -> Measurements:
    """Return simulated rows of an instrument, with errors of the machine, noise, a shifted frame and one gross error."""
    rng = np.random.default_rng(seed)
    own = drawn(truth, rng)
    n = 25
    q = np.round(rng.uniform(LOW, HIGH, (n, 5)), 3)
    if kind in ("cmm", "outlier", "plane", "thin"):
        q[:, 3:] = 0.0
    if kind == "plane":
        q[:, 2] = -200.0
    if kind == "thin":
        q[:, 1] = np.round(rng.uniform(200.0, 206.0, n), 3)
    if kind == "lines":  # one axis after the other, as in a measurement of straight lines
        at = q[0].copy()
        for axis in range(5):
            rows = slice(5 * axis, 5 * axis + 5)
            q[rows] = at
            q[rows, axis] = np.linspace(LOW[axis], HIGH[axis], 5)
    place = rng.uniform(-150.0, 150.0, (3, 3))
    of = np.arange(n) % 3
    carrier = np.array(["tool", "tool", "tool" if kind in ("cmm", "outlier", "rtest") else "work"], dtype=object)[of]
    station_carrier = np.full(n, "work" if kind == "rtest" else "base", dtype=object)
    turn = np.zeros(3) if kind in ("cmm", "outlier") else rng.uniform(-3.0, 3.0, 3)
    origin = rng.uniform(-2000.0, 2000.0, 3)
    point = np.array([carried(own, one, side, place[k]) for one, side, k in zip(q, carrier, of, strict=True)])
    point = np.array([seen(origin, turn, one) for one in point])
    if kind == "rtest":  # the ball stays in the nest: small readings whatever the axes do
        point = rng.normal(0.0, 0.05, (n, 3))
        station_carrier[:] = "work"
    point += rng.normal(0.0, 0.01, (n, 3))
    point[n // 2 :] += rng.normal(0.0, 0.1, 3)  # the frame was aligned again
    if kind in ("outlier", "thin"):  # a single wrong row
        point[5] += rng.normal(0.0, 40.0, 3)
    if kind == "interferometer":
        point[:, 1:] = np.nan
    if kind == "probe":
        point[:] = 0.0
    target = np.array(list("KPQ"), dtype=object)[of]
    return Measurements(
        source="simulated",
        lines=np.arange(n),
        positions=q,
        target=target,
        carrier=carrier,
        point_mm=point,
        station_carrier=station_carrier,
    )


@pytest.mark.sample(2)  # of 9
@pytest.mark.parametrize("kind", DRAWS)
def test_honest_data_give_no_finding(machine: Machine, truth: TruthMachine, kind: str) -> None:
    found = {
        seed: texts for seed in range(DRAWS[kind]) if (texts := wrong_columns(machine, measured(truth, seed, kind)))
    }
    assert found == {}


def changed(rows: Measurements, *, coordinate: int | None = None, axes: tuple[int, ...] = ()) -> Measurements:
    point, positions = rows.point_mm.copy(), rows.positions.copy()
    if coordinate is not None:
        point[:, coordinate] *= -1.0
    positions[:, list(axes)] *= -1.0
    return replace(rows, point_mm=point, positions=positions)


@pytest.mark.parametrize("coordinate", [0, 1, 2])
def test_a_mirrored_reading_is_found(machine: Machine, truth: TruthMachine, coordinate: int) -> None:
    for seed in range(4):
        (tracker,) = wrong_columns(machine, changed(measured(truth, seed, "lines"), coordinate=coordinate))
        assert "seem to be mirrored" in tracker.text and "do not show which one" in tracker.text
        (cmm,) = wrong_columns(machine, changed(measured(truth, seed, "cmm"), coordinate=coordinate))
        name = "xyz"[coordinate]
        assert cmm.text.startswith(f"{name} seems to be mirrored: 25 of 25 rows agree with −{name}; RMS residual 0.")
        assert cmm.columns == (f"{name}_mm",)


def test_exchanged_coordinates_are_found(machine: Machine, truth: TruthMachine) -> None:
    rows = measured(truth, 3, "cmm")
    (found,) = wrong_columns(machine, replace(rows, point_mm=rows.point_mm[:, [1, 0, 2]]))
    assert found.text.startswith("x and y seem to be exchanged: 25 of 25 rows")


@pytest.mark.parametrize("axis", [3, 4])
def test_a_mirrored_rotary_axis_is_found(machine: Machine, truth: TruthMachine, axis: int) -> None:
    name = machine.names[axis]
    for seed in range(4):
        (found,) = wrong_columns(machine, changed(measured(truth, seed, "lines"), axes=(axis,)))
        text = {"B": "B seems to be mirrored", "C": "column C_deg appears to have the wrong sign"}[name]
        assert text in found.text and found.columns == (f"{name}_deg",), seed


def test_a_mirrored_command_outside_the_range_is_found(machine: Machine, truth: TruthMachine) -> None:
    (found,) = wrong_columns(machine, changed(measured(truth, 0, "cmm"), axes=(2,)))
    assert found.text == (
        "Z seems to be mirrored: 25 of 25 rows are outside the range of Z, -400 … 0 mm, and none with −Z"
    )


@pytest.mark.parametrize(
    ("unit", "word", "factor"),
    [("m", "metres", 1e-3), ("inch", "inches", 1 / 25.4), ("um", "micrometres", 1e3), ("cm", "centimetres", 0.1)],
)
def test_another_unit_is_found(machine: Machine, truth: TruthMachine, unit: str, word: str, factor: float) -> None:
    rows = measured(truth, 1, "tracker")
    lines = measured(truth, 1, "lines")
    assert wrong_columns(machine, rows) == []
    (found,) = wrong_columns(machine, replace(lines, point_mm=lines.point_mm * factor))
    assert found.text.startswith(f"columns x_mm, y_mm, z_mm look like {word}, not") and found.advice == f"unit: {unit}?"


@pytest.mark.parametrize(("unit", "factor"), [("inch", 1 / 25.4), ("um", 1e3)])
def test_a_mirrored_reading_in_another_unit_is_found(
    machine: Machine, truth: TruthMachine, unit: str, factor: float
) -> None:
    rows = changed(measured(truth, 1, "lines"), coordinate=2)
    scaled, mirrored = wrong_columns(machine, replace(rows, point_mm=rows.point_mm * factor))
    assert scaled.advice == f"unit: {unit}?" and "seem to be mirrored" in mirrored.text


def test_exchanged_commands_are_found(machine: Machine, truth: TruthMachine) -> None:
    rows = measured(truth, 1, "lines")
    (found,) = wrong_columns(machine, replace(rows, positions=rows.positions[:, [1, 0, 2, 3, 4]]))
    assert found.text.startswith("columns X_mm and Y_mm look swapped; RMS residual ")
    assert found.columns == ("X_mm", "Y_mm")
