"""A load known for each reading (`load_kg`), hidden in the deflection of an arm's joints or of a table, and decoys.

The truth is that of `tests.diagnosis.test_hidden_payload` (an arm of plain matrices) and of `tests.truth.hidden` (the DMU 50), which
share no code with `twin`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.diagnosis.test_hidden_payload import (
    COMPLIANCE,
    FLANGE_M,
    HIGH,
    Carried,
    by_name,
    check,
    links,
    sagged,
    table,
    write_arm,
)
from tests.truth import hidden
from tests.truth.hidden import Hidden
from twin._common.errors import InputError
from twin.diagnosis import Diagnosis, diagnose
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions
from twin.tool.forward import Kinematics

CENTRE = (35.0, -20.0, 60.0)
LOADS = np.array([0.0, 1.25, 2.5])
SIGMA_MM = 3e-3
"""Noise of the readings of the DMU 50."""


def arm_with(
    folder: Path, mass: np.ndarray, seed: int, *, compliance: dict[str, float] = COMPLIANCE, column: bool = True
) -> tuple[Measurements, Machine]:
    """Return readings of an arm that carries another mass at each pose, with or without the column of the masses."""
    machine, rng = Machine.load(str(write_arm(folder))), np.random.default_rng(seed)
    q = np.round(rng.uniform(-HIGH, HIGH, (len(mass), 6)), 3)
    at_flange = links(sagged(np.radians(q), compliance, Carried(mass, CENTRE)))[-1]
    path = table(folder / "arm.csv", q, at_flange, rng, {"load_kg": mass} if column else {})
    return Measurements.load(path, machine), machine


def remaining(calibration: Calibration, mass: float) -> tuple[float, float]:
    """Return the RMS distance of the flange from the truth at other poses with a load, mm: with the calibration, without any."""
    q = np.random.default_rng(9).uniform(-HIGH, HIGH, (50, 6))
    turn, place = links(sagged(np.radians(q), COMPLIANCE, Carried(mass, CENTRE)))[-1]
    truth = 1e3 * (place + turn @ [0.0, 0.0, FLANGE_M])
    ours = Kinematics(calibration.machine, calibration, conditions=Conditions(load_kg=mass)).forward(q).point_mm
    plain = Kinematics(calibration.machine, Calibration.zero(calibration.machine)).forward(q).point_mm
    after, before = (float(np.sqrt(np.mean(np.sum((one - truth) ** 2, axis=1)))) for one in (ours, plain))
    return after, before


@pytest.mark.slow
def test_joints_are_found_under_known_loads_with_their_centre(tmp_path: Path) -> None:
    data, machine = arm_with(tmp_path, np.tile(LOADS, 40), 1)
    found = diagnose(data, machine, Calibration.default(machine))
    causes = by_name(found)
    assert found.verdict == "explained"
    assert set(causes) == {("carried_load", "tool"), *(("gravity_compliance", name) for name in COMPLIANCE)}
    for name, value in COMPLIANCE.items():
        check(causes["gravity_compliance", name], "compliance", value)
    for letter, value in zip("xyz", CENTRE, strict=True):
        check(causes["carried_load", "tool"], f"centre_{letter}_mm", value)
    found.extended.save(tmp_path / "loaded.yaml")
    again = Calibration.load(tmp_path / "loaded.yaml", machine)
    # A mass that was not in the readings.
    after, before = remaining(again, 4.0)
    assert before > 0.5 and after < 0.01 * before
    with pytest.raises(InputError, match=r"gravity_compliance:J2.* needs load_kg") as refused:
        Conditions().require(again)
    assert "the load" in str(refused.value.expected) and refused.value.setting == "load"


@pytest.mark.slow
@pytest.mark.parametrize("column", [True, False])
def test_a_calibration_without_load_and_few_loaded_poses(tmp_path: Path, column: bool) -> None:
    """With the column the load is known and its centre is found; without it, a payload with its mass."""
    data, machine = arm_with(tmp_path, np.zeros(120), 2, column=False)
    known = diagnose(data, machine, Calibration.default(machine)).extended
    data, _ = arm_with(tmp_path, np.full(30, 2.5), 3, column=column)
    found = diagnose(data, machine, known)
    effect, name, value = ("carried_load", "mass_ratio", 1.0) if column else ("payload", "mass", 2.5)
    cause = by_name(found)[effect, "tool"]
    check(cause, name, value)
    for letter, size in zip("xyz", CENTRE, strict=True):
        check(cause, f"centre_{letter}_mm", size)
    if column:
        after, before = remaining(found.extended, 2.5)
        assert before > 0.5 and after < 0.01 * before
    else:
        assert ("carried_load", "tool", "load_kg") in found.not_evaluated


def test_few_loaded_poses_alone_name_joints_and_payload(tmp_path: Path) -> None:
    """Without any compliance known, 30 poses with the same load that is not in the table: joints, mass and centre."""
    data, machine = arm_with(tmp_path, np.full(30, 2.5), 3, column=False)
    causes = by_name(diagnose(data, machine, Calibration.default(machine)))
    assert set(causes) == {("payload", "tool"), *(("gravity_compliance", name) for name in COMPLIANCE)}
    check(causes["payload", "tool"], "mass", 2.5)


def test_a_load_that_bends_nothing_is_not_named(tmp_path: Path) -> None:
    data, machine = arm_with(tmp_path, np.tile(LOADS, 20), 6, compliance={})
    assert diagnose(data, machine, Calibration.default(machine)).verdict == "consistent"


TABLE = {"load_x": 60.0, "load_y": 0.0, "load_z": 20.0}
BLOCKS = np.array([0.0, 100.0, 200.0])
LoadOf = Callable[[int], np.ndarray]


def in_blocks(n: int) -> np.ndarray:
    return BLOCKS[(12 * np.arange(n) // n) % 3]


def growing(n: int) -> np.ndarray:
    return np.round(np.linspace(0.0, 200.0, n))


def looked(folder: Path, machine: Machine, calibration: Calibration, effects: list[Hidden], load: LoadOf) -> Diagnosis:
    """Return the diagnosis of the DMU 50 with hidden effects and a column of loads."""
    rng = np.random.default_rng(8)
    of = hidden.rounded(hidden.plan(rng, poses=60))
    of = replace(of, load_kg=load(len(of.q)))
    read = hidden.noisy(hidden.points(of, effects), rng, "isotropic", SIGMA_MM)
    path = hidden.write(folder / "measured.csv", of, read, u_mm=SIGMA_MM)
    return diagnose(Measurements.load(path, machine), machine, calibration)


@pytest.mark.slow
@pytest.mark.parametrize("load", [in_blocks, growing], ids=["in blocks", "growing with time"])
def test_a_load_on_the_table_is_found_on_its_side(
    dmu50: Machine, calibration: Calibration, tmp_path: Path, load: LoadOf
) -> None:
    """Growing with time, it is not taken for a drift."""
    truth = Hidden("gravity_compliance", "B", {"compliance": 0.6, **TABLE})
    causes = by_name(looked(tmp_path, dmu50, calibration, [truth], load))
    assert set(causes) == {truth.key, ("carried_load", "work")}
    check(causes[truth.key], "compliance", 0.6)
    for quantity in causes["carried_load", "work"].parameters:
        assert abs(quantity.value - TABLE[f"load_{quantity.name[7]}"]) < 3.0 * quantity.u


def unchanged(n: int) -> np.ndarray:
    return np.full(n, 100.0)


DRIFT = Hidden("thermal_drift", "Z", {"amplitude": 15.0, "time_constant": 3000.0})
OWN_WEIGHT = Hidden("gravity_compliance", "B", {"compliance": 0.6})


@pytest.mark.sample(1)  # of 3
@pytest.mark.parametrize(
    ("truth", "load"),
    [(DRIFT, growing), (OWN_WEIGHT, growing), (OWN_WEIGHT, unchanged)],
    ids=["time", "own weight", "own weight, one load"],
)
def test_a_load_that_does_not_act_is_not_named(
    dmu50: Machine, calibration: Calibration, tmp_path: Path, truth: Hidden, load: LoadOf
) -> None:
    """The decoy: the load changes with time, and does not act on the joints that deflect."""
    found = looked(tmp_path, dmu50, calibration, [truth], load)
    (cause,) = found.causes
    assert (cause.effect, cause.where) == truth.key
    assert not {"carried_load", "payload"} & {effect for effect, _ in cause.equivalent}
    if load is unchanged:
        assert ("carried_load", "work", "readings at different load_kg") in found.not_evaluated


@pytest.mark.slow
def test_a_load_in_the_spindle_is_found_on_its_side(dmu50: Machine, calibration: Calibration, tmp_path: Path) -> None:
    truth = Hidden("gravity_compliance", "Z", {"compliance": 0.1, "load_z": 0.0})
    causes = by_name(looked(tmp_path, dmu50, calibration, [truth], lambda n: 0.1 * in_blocks(n)))
    assert set(causes) == {truth.key, ("carried_load", "tool")}
    check(causes[truth.key], "compliance", 0.1)
    # The spindle's axis is vertical and does not tilt: where its load is does not show.
    (only,) = causes["carried_load", "tool"].parameters
    assert (only.name, only.value, only.u) == ("mass_ratio", 1.0, 0.0)
