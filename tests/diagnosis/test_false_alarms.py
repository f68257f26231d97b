"""Rate of findings on a machine with nothing hidden, for every instrument: at most the rates that causes, patterns and fit have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from tests.diagnosis.test_hidden_ball_bar import circles
from tests.identification.plans import four_stations, table, volumetric
from twin.diagnosis import diagnose
from twin.diagnosis.estimate import LACK_OF_FIT
from twin.diagnosis.forms import FALSE_ALARM_RATE
from twin.diagnosis.likelihood import PATTERN_ALARM_RATE
from twin.machine.machine import Machine
from twin.measurement.instruments import INSTRUMENTS, instrument_named
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.tool.forward import Kinematics, Poses
from twin.tool.inverse import Inverse

RATE = FALSE_ALARM_RATE + PATTERN_ALARM_RATE + LACK_OF_FIT
RARE = 1e-3
CENTRE = (250.0, 225.0, -200.0)
POINT_MM = (60.0, 40.0, 150.0)


def along_axes(machine: Machine) -> np.ndarray:
    """Return 25 positions along each linear axis."""
    q = np.tile([*CENTRE, 0.0, 0.0], (75, 1))
    for axis, (low, high) in enumerate(((0.0, 500.0), (0.0, 450.0), (-400.0, 0.0))):
        q[25 * axis : 25 * axis + 25, axis] = np.linspace(low, high, 25)
    return q


def about_a_point(machine: Machine, rng: np.random.Generator, count: int) -> np.ndarray:
    """Return positions at which the spindle nose is at one point of the table, with random positions of the rotary axes."""
    nominal = Kinematics(machine, Calibration.zero(machine))
    q = np.tile([*CENTRE, 0.0, 0.0], (count, 1))
    q[:, 3:] = rng.uniform(0.0, [90.0, 360.0], (count, 2))
    goal = Poses(np.tile(POINT_MM, (count, 1)), nominal.forward(q).rotation)
    return np.round(Inverse(nominal).solve(goal, q, rotary=False).positions, 3)


def planned(machine: Machine, name: str, rng: np.random.Generator) -> Measurements:
    """Return a plan of some 80 readings that an instrument can take."""
    if name == "interferometer":
        return four_stations(machine, rng, 20)
    if name in ("linear-interferometer", "level"):
        station = np.repeat(list("XYZ"), 25) if name == "linear-interferometer" else np.full(75, "table")
        plan = table(machine, along_axes(machine), np.full(75, "K"), station)
        if name == "level":
            return replace(plan, station_carrier=np.full(75, "work", object), instrument=np.full(75, name, object))
        turned = {"X": (0.0, 0.0, 0.0), "Y": (0.0, 0.0, 90.0), "Z": (0.0, -90.0, 0.0)}
        return replace(plan, station_pose=np.array([(0.0, 0.0, 0.0, *turned[axis]) for axis in station]))
    if name in ("probe", "r-test"):
        q = about_a_point(machine, rng, 80)
        target, side, place, station = (
            ("KT", "tool", (60.0, 40.0, 50.0), (0.0, 0.0, -100.0))
            if name == "probe"
            else ("K", "work", (0.0, 0.0, 0.0), POINT_MM)
        )
        plan = table(machine, q, np.full(80, target), np.full(80, "1"))
        return replace(
            plan,
            station_carrier=np.full(80, side, object),
            place_mm=np.tile(place, (80, 1)),
            station_pose=np.tile([*station, 0.0, 0.0, 0.0], (80, 1)),
        )
    return volumetric(machine, rng, 80)


@pytest.mark.parametrize("draws", [2, pytest.param(40, marks=pytest.mark.slow)])
# Measured parts have directions of their own, and a test of their own (`tests.part.test_measured`).
@pytest.mark.parametrize("name", [one.name for one in INSTRUMENTS if not one.specification.aligned])
def test_nothing_hidden_is_found_at_the_stated_rate(dmu50: Machine, name: str, draws: int) -> None:
    """The number of findings, and the p-values of the fit together (Stouffer): each wrong in one of a thousand runs."""
    nothing, instrument = Calibration.zero(dmu50), instrument_named(name)
    found = []
    for seed in range(5, 5 + draws):
        rng = np.random.default_rng(seed)
        if name == "ball-bar":
            data = circles((1000.0,), seed)
        else:
            data, _ = simulate(planned(dmu50, name, rng), dmu50, nothing, instrument, rng)
        found.append(diagnose(data, dmu50, nothing, instrument=None if name == "ball-bar" else instrument))
    alarms = sum(one.verdict != "consistent" for one in found)
    assert alarms <= stats.binom.isf(RARE, draws, RATE), [one.verdict for one in found]
    together = np.sum([stats.norm.isf(one.p_value) for one in found]) / np.sqrt(draws)
    assert abs(together) < stats.norm.isf(RARE / 2.0)
