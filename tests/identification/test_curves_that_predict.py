"""Which curves an identification frees: those of a machine that has none are not made of the noise of its readings."""

from __future__ import annotations

import warnings
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
import pytest

from tests.truth.reference import dmu50_pose
from twin._common.errors import InputError
from twin.identification import identify
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.tool.forward import Kinematics

SPHERES = {"K1": (150.0, 0.0, 60.0), "K2": (-75.0, 130.0, 90.0), "K3": (-75.0, -130.0, 40.0)}
LENGTH = 110.0
"""Length of the probe, mm."""
NOISE_MM = 0.001
Errors = dict[str, np.ndarray]


def constants(rng: np.random.Generator) -> Errors:
    """Draw scales of 30 µm/m, squareness of 40 µrad, and axis locations of 30 µm and 40 µrad."""
    errors = {name: np.zeros(6) for name in ("Y", "Z", "L_B", "L_C")}
    errors["Y"][5], errors["Z"][3], errors["Z"][4] = rng.normal(0.0, 4e-5, 3)
    for name in ("L_B", "L_C"):
        errors[name][:3], errors[name][3:] = rng.normal(0.0, 0.03, 3), rng.normal(0.0, 4e-5, 3)
    return {**errors, "scale": rng.normal(0.0, 3e-5, 3)}


def small_motions(c: float) -> np.ndarray:
    """Return (6,) error motions of C at an angle, mm and rad: waves without a mean, a first harmonic (the datum's) or axial motion."""
    a = np.radians(c)
    return np.array([3e-4 * np.sin(2 * a), 2e-4 * np.cos(3 * a), 0.0, 2e-6 * np.cos(2 * a), 1e-6 * np.sin(2 * a), 0.0])


def tip(q: np.ndarray, errors: Errors, length: float) -> np.ndarray:
    """Return the tip in the work frame, mm; q in mm and degrees."""
    own = {name: np.array(value) for name, value in errors.items() if name not in ("scale", "waves")}
    if "waves" in errors:
        own["C"] = own.get("C", np.zeros(6)) + small_motions(q[4])
    for i, axis in enumerate("XYZ"):
        own[axis] = own.get(axis, np.zeros(6)) + np.eye(6)[i] * errors["scale"][i] * q[i]
    return np.asarray(dmu50_pose(np.array([*q[:3], *np.radians(q[3:])]), own, length)[:3, 3])


def at(point: np.ndarray, rotary: np.ndarray, errors: Errors, length: float) -> np.ndarray:
    """Return the positions of all axes at which the tip is at a point of the work frame."""
    q = np.array([250.0, 225.0, -300.0, *rotary])
    for _ in range(3):
        here = tip(q, errors, length)
        slope = np.stack([tip(q + step, errors, length) - here for step in np.eye(5)[:3]], axis=1)
        q[:3] += np.linalg.solve(slope, point - here)
    return q


def reachable(q: np.ndarray) -> bool:
    return bool(np.all(q >= [0.0, 0.0, -400.0, 0.0, 0.0]) and np.all(q <= [500.0, 450.0, 0.0, 180.0, 360.0]))


def probed(folder: Path, errors: Errors, rng: np.random.Generator, machine: Machine, count: int = 60) -> Measurements:
    """Return contacts of each sphere, with noise."""
    lines = ["X_mm,Y_mm,Z_mm,B_deg,C_deg,target,carrier,station,station_carrier,instrument,x_mm,y_mm,z_mm"]
    for name, place in SPHERES.items():
        left = count
        while left:
            rotary = np.round(rng.uniform([0.0, 0.0], [120.0, 360.0]) / 15.0) * 15.0
            q = at(np.array(place) + rng.normal(0.0, NOISE_MM, 3), rotary, errors, LENGTH)
            if reachable(q):
                left -= 1
                lines.append(",".join(f"{v:.6f}" for v in q) + f",{name},work,probe,tool,probe,0,0,0")
    (folder / "probed.csv").write_text("\n".join(lines) + "\n")
    return Measurements.load(folder / "probed.csv", machine)


def remaining_um(kinematics: Kinematics, errors: Errors) -> float:
    """Return the RMS distance of predicted and true tool tips, µm, but for what spheres and a probe at unknown places cannot show.

    That is a motion of the workpiece, an offset of the tool, and a common scale of the axes and of the spheres.
    """
    rng, rows, off = np.random.default_rng(5), [], []
    while len(off) < 100:
        place = rng.uniform([-120.0, -120.0, 40.0], [120.0, 120.0, 90.0])
        q = at(place, rng.uniform([0.0, 0.0], [120.0, 360.0]), {"scale": np.zeros(3)}, 0.0)
        if not reachable(q):
            continue
        turn = dmu50_pose(np.array([*q[:3], *np.radians(q[3:])]), {})[:3, :3]
        off.append(kinematics.forward(q[None]).point_mm[0] - tip(q, errors, 0.0))
        turned = np.stack([np.cross(unit, place) for unit in np.eye(3)], axis=1) / 100.0
        scales = np.stack([place, turn @ q[:3]], axis=1) / 100.0
        rows.append(np.concatenate([np.eye(3), turned, turn, scales], axis=1))
    unseen, difference = np.concatenate(rows), np.concatenate(off)
    fitted = unseen @ np.linalg.lstsq(unseen, difference, rcond=1e-9)[0]
    return float(np.sqrt(3.0 * np.mean((difference - fitted) ** 2)) * 1e3)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 6))])
def test_a_machine_without_curves_is_predicted_within_its_noise(dmu50: Machine, tmp_path: Path, seed: int) -> None:
    """Thirty curves are possible; 180 contacts with 1 µm of noise. The bar is 0.6 µm; curves with wide priors left 1.8 to 6.8."""
    rng = np.random.default_rng(seed)
    errors = constants(rng)
    found = identify(probed(tmp_path, errors, rng, dmu50), dmu50)
    assert {name[3] for name in found.calibration.curves} == set("XYZBC")
    assert remaining_um(Kinematics(dmu50, found.calibration), errors) <= 0.6


@pytest.mark.parametrize("seeds", [4, pytest.param(40, marks=pytest.mark.slow)])
def test_curves_that_the_datum_ties_do_not_shrink_to_nothing(dmu50: Machine, tmp_path: Path, seeds: int) -> None:
    """Motions of C of the size of the noise, tied in pairs by the datum: their 95 % intervals cover them, each curve on its own.

    With a prior for each curve, that of one was a reading of the other: both became zero, with a hundredth of their size as interval.
    """
    c = np.arange(0.0, 360.0, 10.0)
    truth = np.array([small_motions(angle) for angle in c]) * np.array([1e3] * 3 + [1e6] * 3)
    inside: dict[str, list[float]] = {f"E_{letter}C": [] for letter in "XYAB"}
    for seed in range(seeds):
        rng = np.random.default_rng(100 + seed)
        found = identify(probed(tmp_path, {**constants(rng), "waves": np.zeros(6)}, rng, dmu50), dmu50)
        for name, shares in inside.items():
            value, u = found.interval(name, c)
            shares.append(float(np.mean(np.abs(value - truth[:, "XYZABC".index(name[2])]) <= 1.959964 * u)))
    for name, shares in inside.items():
        error = max(float(np.std(shares, ddof=1)), 0.08) / np.sqrt(seeds)
        assert np.mean(shares) >= 0.94 - 3.7 * error, (name, shares)


def test_squareness_and_locations_of_few_contacts_are_identified(dmu50: Machine, tmp_path: Path) -> None:
    """Sixty contacts of three spheres, four hundred unknowns: curves are confounded, constants are not."""
    rng = np.random.default_rng(7)
    errors = constants(rng)
    found = identify(probed(tmp_path, errors, rng, dmu50, count=20), dmu50)
    unknown = {error.name for error in found.unidentified}
    assert {name for name in unknown if "0" in name} == {"E_X0B", "E_Y0B", "E_Y0C"}
    values = {**found.calibration.squareness, **found.calibration.location}
    truth = {"E_C0Y": errors["Y"][5], "E_A0B": errors["L_B"][3], "E_A0C": errors["L_C"][3], "E_B0C": errors["L_C"][4]}
    joint = found.calibration.covariance
    for name, value in truth.items():
        u = float(np.sqrt(joint.matrix[joint.names.index(name), joint.names.index(name)]))
        assert u < 60.0
        assert values[name] == pytest.approx(1e6 * value, abs=3.0 * u)
    # The largest model interpolates all readings: a part of them is not predicted by the others.
    assert found.choice.held_out > 1.0
    assert remaining_um(Kinematics(dmu50, found.calibration), errors) <= 1.0


@pytest.mark.parametrize("draws", [15, pytest.param(150, marks=pytest.mark.slow)])
def test_any_part_of_a_table_is_identified_or_refused(dmu50: Machine, tmp_path: Path, draws: int) -> None:
    """From four contacts on, with any errors wanted: numbers are finite, and nothing but an error of the input stops it."""
    rng = np.random.default_rng(11)
    data = probed(tmp_path, constants(rng), rng, dmu50, count=20)
    for _ in range(draws):
        rows = np.sort(rng.choice(len(data), int(rng.integers(4, len(data))), replace=False))
        pattern = str(rng.choice(["*", "E_*0*", "E_?[XYZ]", "E_*B", "E_*C", "E_[XY]*"]))
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            try:
                found = identify(data.select(rows), dmu50, wanted=lambda name, pattern=pattern: fnmatch(name, pattern))
            except InputError:
                continue
        assert np.all(np.isfinite(found.calibration.covariance.matrix)), (pattern, rows)
        assert found.to_text()
