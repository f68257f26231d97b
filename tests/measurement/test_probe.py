"""Touch probe and sphere: simulated on one machine model, read by another, and what they determine of the machine."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.measurement.probing import SPHERES, TIP, probing
from tests.real import probe_sphere
from tests.real.probe_sphere import MACHINE as HEAD_HEAD
from tests.truth.machine import carried, written
from twin._common.errors import InputError
from twin.identification import identify
from twin.identification.unidentified import ConstantErrors, constant_errors
from twin.machine.machine import Machine
from twin.measurement.instruments import StationInstruments, TouchProbe
from twin.measurement.set_up import StationsAndTargets
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

CONSTANTS = {
    "squareness": {"E_C0Y": 40.0, "E_A0Z": -60.0, "E_B0Z": 30.0},
    "location": {"E_A0B": 50.0, "E_B0B": -35.0, "E_X0C": 25.0, "E_A0C": -45.0, "E_B0C": 55.0},
}
"""Constant errors that a probe and spheres at unknown places determine, with X, Y and Z of the right scale."""


@pytest.fixture
def truth(tmp_path: Path, dmu50: Machine) -> Calibration:
    text = f"schema: twin.calibration/1\nmachine: {dmu50.name}\nsource: test\n"
    for entry, values in CONSTANTS.items():
        text += f"{entry}: {{{', '.join(f'{k}: {v}' for k, v in values.items())}}}\n"
    (tmp_path / "truth.yaml").write_text(text)
    return Calibration.load(tmp_path / "truth.yaml", dmu50)


def read(plan: Measurements, machine: Machine, errors: Calibration, seed: int | None = None) -> Measurements:
    rng = np.random.default_rng(seed or 0)
    return simulate(plan, machine, errors, TouchProbe(), rng, noise=seed is not None)[0]


def constants_of(plan: Measurements, machine: Machine, *, places: bool, tip: bool) -> ConstantErrors:
    """Return the constants that readings of the nominal machine determine if spheres or tips are known."""
    exact = read(plan, machine, Calibration.zero(machine))
    known = replace(
        exact,
        place_mm=plan.place_mm if places else exact.place_mm,
        station_pose=plan.station_pose if tip else exact.station_pose,
    )
    instruments = StationInstruments.same(TouchProbe(), plan.station)
    setup = StationsAndTargets.from_table(known, instruments)
    at = [int(np.flatnonzero(plan.target == name)[0]) for name in setup.targets]
    stations = [int(np.flatnonzero(plan.station == name)[0]) for name in setup.stations]
    setup = replace(setup, place=plan.place_mm[at] * 1e-3, origin=plan.station_pose[stations, :3] * 1e-3)
    found = constant_errors(machine, known, instruments, setup)
    assert found is not None
    return found


def test_the_tip_is_at_the_sphere_on_the_truth_machine(dmu50: Machine, tmp_path: Path) -> None:
    """By a machine model that shares no code with `twin`, 1e-6 mm."""
    path = tmp_path / "truth.yaml"
    model = written(path, {name: dict(of) for name, of in CONSTANTS.items()})
    found = read(probing(dmu50, SPHERES, 10, 1), dmu50, Calibration.load(path, dmu50))
    assert not np.any(found.point_mm)
    for q, target in zip(found.positions, found.target, strict=True):
        sphere = np.array(SPHERES[int(target[-1]) - 1])
        distance = np.linalg.norm(carried(model, q, "tool", np.array(TIP)) - carried(model, q, "work", sphere))
        assert distance < 1e-6


@pytest.mark.parametrize(
    ("spheres", "places", "tip", "count", "lost"),
    [
        (SPHERES, False, False, 10, ("the common scale of X, Y and Z", "E_X0B", "E_Y0B", "E_Y0C")),
        (SPHERES, True, False, 12, ("E_X0B", "E_Y0B")),
        (SPHERES, False, True, 13, ("1 combination of E_XX, E_YY, E_ZZ, E_Y0B, E_Y0C",)),
        (SPHERES, True, True, 14, ()),
        (SPHERES[:1], False, False, 10, ("the common scale of X, Y and Z", "E_X0B", "E_Y0B", "E_Y0C")),
    ],
)
def test_number_of_constants_determined(
    dmu50: Machine,
    spheres: tuple[tuple[float, float, float], ...],
    places: bool,
    tip: bool,
    count: int,
    lost: tuple[str, ...],
) -> None:
    found = constants_of(probing(dmu50, spheres, 60, 2), dmu50, places=places, tip=tip)
    assert (found.determined, len(found.u), found.lost) == (count, 14, lost)


def test_a_sphere_on_the_axis_of_c_tells_less(dmu50: Machine) -> None:
    found = constants_of(probing(dmu50, [(0.0, 0.0, 30.0)], 60, 2), dmu50, places=False, tip=False)
    assert found.determined == 5 and {"E_A0C", "E_B0C"} <= set(found.lost)


def test_constants_are_identified_within_their_uncertainty(dmu50: Machine, truth: Calibration) -> None:
    """χ² of the 8 constants over 12 draws: within its central 99.8 %."""
    plan, total = probing(dmu50, SPHERES, 20, 3), 0.0
    for seed in range(1, 13):
        found = identify(read(plan, dmu50, truth, seed), dmu50, wanted=lambda name: name[3] == "0").calibration
        for name, value in {**CONSTANTS["squareness"], **CONSTANTS["location"]}.items():
            estimate = {**found.squareness, **found.location}[name]
            total += (estimate - value) ** 2 / found.covariance.of([name]).matrix[0, 0] / 96.0
    assert 0.6 < total < 1.5


def test_the_report_names_what_is_lost(dmu50: Machine, truth: Calibration) -> None:
    found = identify(read(probing(dmu50, SPHERES, 12, 4), dmu50, truth, 1), dmu50)
    assert (
        "10 of 14 constant errors (scales, squareness, locations) determined; not: the common scale" in found.to_text()
    )
    assert found.to_dict()["constants"]["lost"][1:] == ["E_X0B", "E_Y0B", "E_Y0C"]
    assert found.shares == ()


def test_two_probes_do_not_change_what_spheres_tell(dmu50: Machine) -> None:
    """Tips at unknown places: another length adds readings, and what is lost stays lost."""
    plan = probing(dmu50, SPHERES, 30, 5, tips=(TIP, (0.0, 0.0, -50.0)))
    assert constants_of(plan, dmu50, places=False, tip=False).determined == 10


def test_positions_that_are_not_at_the_sphere_are_refused(dmu50: Machine, truth: Calibration) -> None:
    data = read(probing(dmu50, SPHERES, 10, 6), dmu50, truth)
    positions = np.array(data.positions)
    positions[:, :3] = np.random.default_rng(8).uniform([150, 150, -300], [350, 300, -100], (len(positions), 3))
    with pytest.raises(InputError, match=r"sphere \d moves by .* mm in the frame of probe"):
        identify(replace(data, positions=positions), dmu50)


def test_a_probe_on_the_side_of_its_sphere_is_refused(dmu50: Machine) -> None:
    plan = probing(dmu50, SPHERES, 10, 6)
    wrong = replace(plan, station_carrier=np.full(len(plan), "work", dtype=object))
    with pytest.raises(InputError, match="a probe rides on the side opposite to its sphere"):
        read(wrong, dmu50, Calibration.zero(dmu50))


def test_positions_of_the_tip_are_noticed() -> None:
    """With tool centre point control on, X, Y and Z follow the tip: the probe then fits best at the centre of the rotary axes."""
    machine = Machine.load(HEAD_HEAD)
    turns = np.random.default_rng(9).uniform(-60.0, 60.0, (30, 2))
    lever = np.array([[*probe_sphere.lever(*turn), 0.0, 0.0] for turn in turns])
    tip = np.concatenate([np.tile([300.0, 300.0, -800.0], (30, 1)), turns], axis=1)
    names = {
        field: np.full(30, name, dtype=object) for field, name in zip(("target", "carrier"), ("s", "work"), strict=True)
    }
    sides = {"station_carrier": np.full(30, "tool", dtype=object), "point_mm": np.zeros((30, 3))}

    def notices(positions: np.ndarray) -> str:
        data = Measurements(source="test", lines=np.arange(30) + 2, positions=positions, **names, **sides)
        return " ".join(identify(data, machine, wanted=lambda name: name == "E_A0B").notices)

    assert "the tip of probe 1 would be 180 mm above the spindle nose" in notices(tip)
    assert "above the spindle nose" not in notices(tip - lever)


def test_equal_rows_are_repeats(dmu50: Machine, tmp_path: Path) -> None:
    """Positions of 1 µm resolution: a repeat may find the same, and nothing else is in the row of a probe."""
    data = read(probing(dmu50, SPHERES, 5, 10), dmu50, Calibration.zero(dmu50))
    data.select(np.repeat(np.arange(len(data)), 2)).save(tmp_path / "m.csv", dmu50)
    again = Measurements.load(tmp_path / "m.csv", dmu50)
    assert len(again) == 2 * len(data) and again.set_aside == ()
