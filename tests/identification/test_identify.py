"""Identification is the inverse of simulation: noise-free readings of a machine in plain numpy give its errors.

The limit is 1e-6 µm or µrad for every curve over its range and every number. Rounding of readings of 2000 mm (2e-10 µm each) through
the worst lever arm of these plans gives 2e-8.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from tests.identification.plans import PLACES, STATIONS, four_stations, read_by_truth, table, volumetric, with_places
from tests.truth.machine import CONSTANTS, MOTIONS, RANGES, TruthMachine, in_datum, written
from twin.identification import Identification, identify
from twin.machine.machine import Machine
from twin.measurement.instruments import TrackingInterferometer
from twin.measurement.simulate import Placement, Station, simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.samples import thesis_plan
from twin.tool.forward import Kinematics
from twin.tool.inverse import Inverse, Status

EXACT = 1e-6
UNSEEN = {"E_X0B", "E_Y0B", "E_Y0C"}


def as_the_thesis(machine: Machine) -> Measurements:
    """Return the thesis's positions, targets and rounds, with the tracker at the first of `STATIONS`."""
    plan = thesis_plan.plan(machine)
    return table(machine, plan.positions, plan.target, plan.station, plan.round)


def differences(found: Calibration, truth: TruthMachine, errors: dict[str, Any]) -> dict[str, float]:
    """Return the largest difference over the range of every error motion, and of every identifiable number; unnamed errors are zero."""
    worst = {}
    for name in MOTIONS:
        q = np.linspace(*RANGES[name[3]], 101)
        true = np.array([truth.curve(name, float(v)) for v in q])
        own = found.curves[name](q) if name in found.curves else np.zeros_like(q)
        worst[name] = float(np.abs(own - true).max())
    numbers = {**found.squareness, **found.location}
    for name in CONSTANTS:
        given = {**errors["squareness"], **errors["location"]}.get(name, 0.0)
        worst[name] = abs(numbers.get(name, 0.0) - given)
    return worst


def check_exact(found: Identification, truth: TruthMachine, errors: dict[str, Any]) -> None:
    worst = differences(found.calibration, truth, errors)
    assert {name: value for name, value in worst.items() if not value <= EXACT} == {}
    assert found.complete and found.used.all()
    assert {one.name for one in found.unidentified} == UNSEEN
    assert UNSEEN.isdisjoint(found.calibration.location)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3, 4, 5))])
def test_the_thesis_plan_gives_the_machine_back(dmu50: Machine, tmp_path: Path, seed: int) -> None:
    """30 curves of degree 8 or four harmonics, three squareness, five locations; errors up to 0.1 mm and 1 mrad."""
    errors = in_datum(np.random.default_rng(seed), size=100.0)
    truth = written(tmp_path / "t.yaml", errors)
    found = identify(read_by_truth(as_the_thesis(dmu50), truth), dmu50)
    check_exact(found, truth, errors)
    assert found.rms_um < EXACT


@pytest.mark.slow
@pytest.mark.parametrize("seed", [6, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (7, 8, 9))])
def test_absent_errors_are_found_as_zero(dmu50: Machine, tmp_path: Path, seed: int) -> None:
    """Six curves and no constants: the other 24 curves and eight constants are found as zero, and degree 0."""
    rng = np.random.default_rng(seed)
    names = tuple(str(name) for name in rng.choice(MOTIONS, 6, replace=False))
    errors = in_datum(rng, names, constants=False)
    truth = written(tmp_path / "t.yaml", errors)
    found = identify(read_by_truth(as_the_thesis(dmu50), truth), dmu50)
    check_exact(found, truth, errors)
    assert {name for name, count in found.choice.counts.items() if count > 0} <= set(names)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (12, 13))])
def test_random_poses_and_two_stations(dmu50: Machine, tmp_path: Path, seed: int) -> None:
    """700 points, each at another pose, no single-axis runs."""
    rng = np.random.default_rng(seed)
    errors = in_datum(rng, size=100.0)
    truth = written(tmp_path / "t.yaml", errors)
    found = identify(read_by_truth(volumetric(dmu50, rng, 700), truth), dmu50)
    check_exact(found, truth, errors)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [21, pytest.param(22, marks=pytest.mark.slow)])
def test_lengths_from_four_stations(dmu50: Machine, tmp_path: Path, seed: int) -> None:
    """A tracking interferometer: lengths only, from an unknown zero; it is recognised by its empty columns."""
    rng = np.random.default_rng(seed)
    errors = in_datum(rng, size=100.0)
    truth = written(tmp_path / "t.yaml", errors)
    found = identify(read_by_truth(four_stations(dmu50, rng, 150), truth, dead_mm=500.0), dmu50)
    check_exact(found, truth, errors)
    assert all(one.reads == "length" for one in found.setup.reads)
    # The datum fixes the targets, and with them the stations: dead paths and places come back too, in mm.
    assert found.setup.dead * 1e3 == pytest.approx(500.0 + 10.0 * np.arange(4), abs=1e-6)
    for name, place in zip(found.setup.targets, found.setup.place, strict=True):
        assert place * 1e3 == pytest.approx(PLACES[name][1], abs=1e-6), name


@pytest.mark.slow
def test_multilateration_and_compensation(dmu50: Machine, tmp_path: Path) -> None:
    """Identified from 600 poses (4800 lengths) and four stations with noise, compensated: at most 0.5 µm RMS at the tool.

    The truth is in the datum, so nothing is removed: E_X0B, E_Y0B, E_Y0C and the constants of the curves, which depend on the clamping
    of workpiece and tool and on the zeroing of the machine, are zero in it.
    """
    rng = np.random.default_rng(31)
    errors = in_datum(rng, size=30.0)
    path = tmp_path / "t.yaml"
    truth = written(path, errors)
    plan = four_stations(dmu50, rng, 600)
    setting = Placement(
        {name: Station(pose[:3], pose[3:]) for name, pose in STATIONS.items()},
        {name: place for name, (_, place) in PLACES.items()},
    )
    data, _ = simulate(plan, dmu50, Calibration.load(path, dmu50), TrackingInterferometer(), rng, setting=setting)
    found = identify(data, dmu50)
    assert found.complete
    meant = rng.uniform([10.0, 10.0, -390.0, 5.0, 0.0], [490.0, 440.0, -10.0, 175.0, 360.0], (300, 5))
    nominal = Kinematics(dmu50, Calibration.zero(dmu50), tool_length_mm=0.0)
    real = Kinematics(dmu50, found.calibration, tool_length_mm=0.0)
    solution = Inverse(real).solve(nominal.forward(meant), meant)
    assert solution.where(Status.CONVERGED).all()
    before, _ = truth.deviations(meant, meant)
    after, _ = truth.deviations(solution.positions, meant)
    assert np.sqrt(np.mean(before**2)) > 30.0
    assert np.sqrt(np.mean(after**2)) <= 0.5


@settings(
    max_examples=6, phases=(Phase.explicit, Phase.reuse, Phase.generate)
)  # shrinking takes minutes and shows no more
@given(
    seed=st.integers(0, 2**32 - 1),
    axis=st.sampled_from("XYZ"),
    letters=st.sets(st.sampled_from("XYZABC"), min_size=1),
    size=st.floats(0.1, 100.0),
)
def test_one_axis_property(
    dmu50: Machine,
    tmp_path_factory: pytest.TempPathFactory,
    seed: int,
    axis: str,
    letters: set[str],
    size: float,
) -> None:
    """Any machine with errors of one linear axis, any size, from one run along it with three targets whose places are known.

    With unknown places, their common distance from the axis would be confounded with straightness (test_identify_datum.py).
    """
    errors = in_datum(
        np.random.default_rng(seed),
        tuple(f"E_{letter}{axis}" for letter in sorted(letters)),
        size=size,
        constants=False,
    )
    truth = written(tmp_path_factory.mktemp("one") / "t.yaml", errors)
    positions = np.tile(np.array([250.0, 225.0, -200.0, 0.0, 0.0]), (33, 1))
    positions[:, "XYZ".index(axis)] = np.tile(np.linspace(*RANGES[axis], 11), 3)
    plan = with_places(table(dmu50, positions, np.repeat(["K", "P", "Q"], 11), np.full(33, "1")))
    found = identify(read_by_truth(plan, truth), dmu50)
    assert max(differences(found.calibration, truth, errors).values()) <= EXACT
    assert found.rms_um < EXACT
