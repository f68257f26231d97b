"""Findings of Ellingsdalen (2021), chapter 5, reproduced in simulation: tracker positions, influence of a new frame on straightness,
and gain of compensation by its method compared with ours.

The machine is the default calibration (illustrative), the plan the thesis's, the tracker the AT960; every draw is seeded.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from numpy.polynomial import polynomial

from tests.truth.machine import TruthMachine, run_iso
from twin.compensation import Compensator, Options
from twin.identification import Identification, identify
from twin.identification.thesis import identify_as_thesis
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker
from twin.measurement.observation import Observation
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.nc import dialect_for
from twin.samples import thesis_plan

LINEAR = "XYZ"
TRANSLATIONS = tuple(f"E_{direction}{axis}" for axis in LINEAR for direction in LINEAR)
LOW = ({"E_YX", "E_YY", "E_YZ"}, {"E_XX", "E_XY", "E_XZ"}, {"E_ZX", "E_ZY", "E_ZZ"})
"""By tracker position: errors along its beam. Table 5.1 is the first; table 5.2 takes each error from the position where it is low."""
LENGTH = 120.0


def rounds(machine: Machine, numbers: str, station: int = 0) -> Measurements:
    """Return some rounds of the thesis's plan from one of its three tracker positions."""
    plan = thesis_plan.plan(machine, thesis_plan.thesis_stations()[station])
    return plan.select(np.isin(plan.round, list(numbers)))


def at_targets_um(found: Identification) -> dict[str, float]:
    """Return the predicted standard deviation of each translation of X, Y, Z, RMS over the positions, at the targets' centre.

    The thesis does not state which uncertainty tables 5.1 and 5.2 mean. For the error frame's translation it would contain the angular
    errors times the distance from frame to targets, similar for every component. At the targets, it is the uncertainty of a coordinate
    due to tracker and machine. So: base coordinates of the targets' centre by all unknowns, places of the targets included, through the
    joint covariance; without the components that the datum and the unknown places absorb, a mean, and of a straightness a line.
    """
    network, setup, data = found.network, found.setup, found.data
    machine, unknowns = network.machine, network.unknowns
    covariance = found.solution.covariance()
    deviations = {}
    for column, axis in enumerate(LINEAR):
        run = (data.approach[:, column] != 0.0) & (data.round == data.round[0])
        by_unknown: np.ndarray | float = 0.0
        for target in dict.fromkeys(data.target[run]):
            rows = np.flatnonzero(run & (data.target == target))
            k, positions = setup.targets.index(target), data.positions[rows]
            errors, places = network.errors(found.solution.theta, rows), np.tile(setup.place[k], (len(rows), 1))
            carried = Observation(machine).carried(positions * machine.scale, errors, data.carrier[rows], places)
            own = np.zeros((len(rows), 3, len(covariance)))
            for i, shapes in enumerate(unknowns.shapes(positions)):
                for at, values in shapes:
                    own[:, :, i] += carried.by_error[:, :, at] * values[:, None]
            place = next(slot.at for slot in setup.slots if slot.kind == "place" and slot.number == k)
            own[:, :, len(unknowns) :][:, :, place] = carried.rotation
            by_unknown = by_unknown + own / 3.0
        q = positions[:, column]
        for i, direction in enumerate(LINEAR):
            taken = np.vander(q / np.ptp(q), 1 if direction == axis else 2)
            left = (np.eye(len(q)) - taken @ np.linalg.pinv(taken)) @ np.asarray(by_unknown)[:, i]
            variance = np.einsum("ni,ij,nj->n", left, covariance, left)
            deviations[f"E_{direction}{axis}"] = float(np.sqrt(np.mean(variance))) * 1e6
    return deviations


@pytest.mark.slow
def test_tables_5_1_and_5_2(dmu50: Machine, calibration: Calibration) -> None:
    """The rows "laser tracker performance".

    Measured with two rounds, µm: along the beam 0.37 … 0.65, across it 1.6 … 4.2.
    """
    found = []
    for k in range(3):
        data, _ = simulate(rounds(dmu50, "12", k), dmu50, calibration, LaserTracker(), np.random.default_rng(5))
        found.append(at_targets_um(identify(data, dmu50)))
    for low, deviation in zip(LOW, found, strict=True):
        high = {name: value for name, value in deviation.items() if name not in low}
        assert max(deviation[name] for name in low) < 0.5 * min(high.values())
    # Table 5.2: from its best position every one is low, by the measure of Pos. 1's own.
    best = {name: min(deviation[name] for deviation in found) for name in TRANSLATIONS}
    assert max(best.values()) < 0.5 * min(found[0][name] for name in TRANSLATIONS if name not in LOW[0])


@pytest.mark.slow
def test_a_new_frame_adds_the_rotation_of_x_and_z_to_y(dmu50: Machine, calibration: Calibration) -> None:
    """Chapter 5.1.2: X and Z are compensated by the measured errors, Y is not, each run in a frame aligned to its own X and Z.

    The frame follows the path of a target, which an angular error of an axis rotates by its lever arm; the compensation is for the
    spindle. So it rotates the lines of X and Z, the next frame rotates with them, and Y, which has not changed, is tilted in it.
    Whether its error increases or decreases depends on signs: for the illustrative machine without squareness, and angular errors a
    twentieth of its own (a few µm at the targets, as in the thesis), it increases. Without noise.
    """
    curves = {
        name: replace(curve, coefficients=tuple(0.05 * c for c in curve.coefficients))
        if curve.unit == "urad"
        else curve
        for name, curve in calibration.curves.items()
    }
    before = replace(calibration, curves=MappingProxyType(dict(curves)), squareness=MappingProxyType({}))
    plan = rounds(dmu50, "1")

    def measured(truth: Calibration) -> Measurements:
        return simulate(plan, dmu50, truth, LaserTracker(), np.random.default_rng(0), noise=False)[0]

    first = measured(before)
    points = identify_as_thesis(first, dmu50).motions
    for name in TRANSLATIONS:
        if name[3] != "Y":
            curve, motion = curves[name], points[name]
            low, high = curve.domain
            compensated = polynomial.polyfit((2.0 * motion.position - low - high) / (high - low), motion.mean, 8)
            left = polynomial.polysub(curve.coefficients, compensated)
            curves[name] = replace(curve, coefficients=tuple(float(c) for c in left))
    second = measured(replace(before, curves=MappingProxyType(curves)))
    again = identify_as_thesis(second, dmu50).motions

    def straightness_um(motions: Mapping[str, object], axis: str) -> float:
        names = [f"E_{direction}{axis}" for direction in LINEAR if direction != axis]
        return float(np.sqrt(np.mean([motions[name].mean ** 2 for name in names])))  # type: ignore[attr-defined]

    size = {axis: (straightness_um(points, axis), straightness_um(again, axis)) for axis in LINEAR}
    for axis in "XZ":
        assert size[axis][1] < 0.8 * size[axis][0]
    assert size["Y"][1] > 1.3 * size["Y"][0]  # and nothing about Y has changed

    # Jointly, in the machine's own datum: Y's straightness is what it was, X's and Z's is gone, and the turn is where it belongs, in
    # the squareness. 0.001 µm: products of 20 µrad with errors of 10 µm, and what degree 12 leaves of degree 8, are less.
    joint = [identify(data, dmu50) for data in (first, second)]
    for name in TRANSLATIONS:
        if name[2] != name[3]:
            q = np.linspace(*joint[0].calibration.curves[name].domain, 46)
            one, other = (found.calibration.curves[name](q) for found in joint)
            if name[3] == "Y":
                assert np.abs(one).max() > 3.0 and np.abs(other - one).max() < 1e-3, name
            else:
                assert np.abs(other).max() < 1e-2, name
    turned = {
        name: joint[1].calibration.squareness[name] - joint[0].calibration.squareness[name]
        for name in ("E_C0Y", "E_A0Z")
    }
    for name, apparent in (("E_C0Y", "E_XY"), ("E_A0Z", "E_ZY")):
        y = points[apparent].position
        askew = np.polyfit(y, again[apparent].mean - points[apparent].mean, 1)[0] * 1e3
        # A quarter: the thesis's lines follow one target, the datum's the axes themselves.
        assert turned[name] == pytest.approx(-askew, rel=0.25) and abs(askew) > 3.0, name


def programs() -> dict[str, str]:
    """Return two programs in axis positions: a grid over the volume at B = C = 0, and forty poses of all five axes."""
    grid = [f"X{x} Y{y} Z{z}" for x in (60, 250, 440) for y in (60, 225, 390) for z in (-340, -200, -60)]
    ranges = ((60, 440), (60, 390), (-340, -60), (20, 160), (0, 340))
    drawn = np.random.default_rng(3).uniform(*np.array(ranges).T, size=(40, 5))
    poses = [" ".join(f"{axis}{value:.3f}" for axis, value in zip("XYZBC", pose, strict=True)) for pose in drawn]
    head = "G21 G90 G94\nG0 "
    return {
        "three axes": head + "B0 C0 " + "\nG1 F1000 ".join(grid) + "\n",
        "five axes": head + "\nG1 F1000 ".join(poses) + "\n",
    }


def touched_off_um(truth: TruthMachine, commands: np.ndarray, meant: np.ndarray) -> np.ndarray:
    """Return (n,) the residual error at the tool tip after touching off tool and workpiece.

    Targets of unknown place do not determine where the tool and the workpiece are; on a real machine a probe does. So one constant
    vector on the tool's side and one on the workpiece's are subtracted, by least squares over the program, for every method.
    """
    off, shapes = [], []
    for q, wanted in zip(commands, meant, strict=True):
        nominal = truth.pose(wanted, real=False)
        off.append(truth.pose(q)[:3, 3] - nominal[:3, 3])
        shapes.append(np.concatenate([np.eye(3), nominal[:3, :3]], axis=1))
    matrix, vector = np.concatenate(shapes), np.concatenate(off)
    left = vector - matrix @ np.linalg.lstsq(matrix, vector, rcond=None)[0]
    return np.asarray(np.linalg.norm(left.reshape(-1, 3), axis=1)) * 1e3


def gains(machine: Machine, calibration: Calibration, folder: Path) -> dict[str, dict[str, tuple[float, float]]]:
    """Return RMS and maximum at the tool, µm, by program and method, on one machine measured once by one tracker (Pos. 1, seed 7)."""
    calibration.save(folder / "true.yaml")
    truth = TruthMachine(folder / "true.yaml", LENGTH)
    plan = thesis_plan.plan(machine)
    data, _ = simulate(plan, machine, calibration, LaserTracker(), np.random.default_rng(7))
    thesis, ours = identify_as_thesis(data, machine).calibration, identify(data, machine).calibration
    iso = dialect_for(Path("program.nc"))
    found: dict[str, dict[str, tuple[float, float]]] = {}
    for name, text in programs().items():
        meant = np.array([position for _, position in run_iso(text)])
        done = {"before": meant}
        for label, known, method in (
            ("thesis", thesis, "thesis"),
            ("ours", ours, "exact"),
            ("known", calibration, "exact"),
        ):
            options = Options(
                tool_length_mm=LENGTH, tolerance_mm=1.0, method="thesis" if method == "thesis" else "exact"
            )
            result = Compensator(machine, known, options).compensate(iso.read(text.encode(), f"{name}.nc"), iso)
            done[label] = np.array([position for _, position in run_iso(result.text)])
        left = {label: touched_off_um(truth, commands, meant) for label, commands in done.items()}
        found[name] = {label: (float(np.sqrt(np.mean(um**2))), float(um.max())) for label, um in left.items()}
    return found


@pytest.mark.slow
def test_gain_of_compensation(dmu50: Machine, calibration: Calibration, tmp_path: Path) -> None:
    """Measured, RMS µm at the tool tip (tool 120 mm): three axes 78 before, 94 thesis, 19 ours; five axes 66, 97, 15.

    The bound is half of the value before; another seed changes ours by some µm.
    """
    for name, left in gains(dmu50, calibration, tmp_path).items():
        rms = {label: values[0] for label, values in left.items()}
        assert rms["known"] < 1.0, name  # the judge agrees: with the true numbers only rounding is left
        assert rms["ours"] < 0.5 * rms["before"], name
        assert rms["ours"] < 0.5 * rms["thesis"], name
        assert rms["thesis"] > rms["before"], (
            name
        )  # no gain here: on this machine angular errors of the linear axes rule
