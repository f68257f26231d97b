"""An arm that deflects under its own weight and under a payload not in its URDF: found, estimated, written and loaded.

The truth is a chain of plain matrices; the torques are differences of its potential.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
import yaml

from twin._common.errors import InputError
from twin.diagnosis import Diagnosis, causes, diagnose
from twin.diagnosis.candidates import catalogue
from twin.diagnosis.result import Cause
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import GravityCompliance, Payload
from twin.tool.forward import Kinematics

G = 9.81
SIGMA_MM = 4e-3
POSES = 220
# Joints of a small arm, all about their own z: xyz m and rpy of each in the one before, mass kg and centre m of the link behind it.
JOINTS = (
    ((0.0, 0.0, 0.29), (0.0, 0.0, 0.0), 3.1, (0.0, 0.06, 0.0)),
    ((0.0, 0.0, 0.0), (-np.pi / 2, 0.0, 0.0), 3.9, (0.0, -0.1, 0.06)),
    ((0.0, -0.27, 0.0), (0.0, 0.0, 0.0), 2.9, (0.06, -0.06, 0.02)),
    ((0.0, -0.07, 0.0), (0.0, np.pi / 2, 0.0), 1.3, (0.0, 0.0, 0.15)),
    ((0.0, 0.0, 0.3), (0.0, -np.pi / 2, 0.0), 0.55, (0.02, 0.0, 0.0)),
    ((0.0, 0.0, 0.0), (0.0, np.pi / 2, 0.0), 0.02, (0.0, 0.0, 0.07)),
)
FLANGE_M = 0.072
HIGH = np.array([150.0, 80.0, 70.0, 150.0, 110.0, 170.0])
REFLECTORS_MM = {"S1": (60.0, 0.0, 20.0), "S2": (-30.0, 50.0, 20.0), "S3": (-30.0, -50.0, 40.0)}
FOUR = "parameters: {mass: 2, centre_x_mm: 0, centre_y_mm: 0, centre_z_mm: 5}}"
COMPLIANCE = {"J2": 26.0, "J3": 75.0, "J5": 140.0}


@dataclass(frozen=True)
class Carried:
    """A mass at the flange, one or one for each pose."""

    mass_kg: float | np.ndarray
    centre_mm: tuple[float, float, float]


def rotation(axis: int, angle: np.ndarray) -> np.ndarray:
    """(n, 3, 3) about x, y or z."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    found = np.zeros((*np.shape(angle), 3, 3))
    found[..., axis, axis] = 1.0
    found[..., i, i] = found[..., j, j] = np.cos(angle)
    found[..., j, i], found[..., i, j] = np.sin(angle), -np.sin(angle)
    return found


def links(q: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Orientation (n, 3, 3) and place (n, 3) m of every link at angles (n, 6) rad."""
    turn, place = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3))
    found = []
    for i, (xyz, (roll, pitch, yaw), _, _) in enumerate(JOINTS):
        place = place + turn @ np.array(xyz)
        turn = turn @ rotation(2, np.array(yaw)) @ rotation(1, np.array(pitch)) @ rotation(0, np.array(roll))
        turn = turn @ rotation(2, q[:, i])
        found.append((turn, place))
    return found


def potential(q: np.ndarray, carried: Carried | None) -> np.ndarray:
    """(n,) J."""
    every = links(q)
    total = sum(
        mass * G * (place + turn @ np.array(centre))[:, 2]
        for (turn, place), (_, _, mass, centre) in zip(every, JOINTS, strict=True)
    )
    if carried is not None:
        turn, place = every[-1]
        at = np.array([0.0, 0.0, FLANGE_M]) + 1e-3 * np.array(carried.centre_mm)
        total = total + carried.mass_kg * G * (place + turn @ at)[:, 2]
    return np.asarray(total)


def sagged(q: np.ndarray, compliance: dict[str, float], carried: Carried | None) -> np.ndarray:
    """(n, 6) angles that the joints really have, rad."""
    found = q.copy()
    for name, value in compliance.items():
        i, step = int(name[1]) - 1, np.zeros(6)
        step[i] = 1e-5
        torque = -(potential(q + step, carried) - potential(q - step, carried)) / 2e-5
        found[:, i] += 1e-6 * value * torque
    return found


def write_arm(folder: Path, masses: bool = True) -> Path:
    """Write the arm's URDF and machine file."""
    inertia = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    parts = ['<robot name="arm"><link name="base"/>']
    for i, (xyz, rpy, mass, centre) in enumerate(JOINTS):
        words = [" ".join(repr(float(v)) for v in three) for three in (xyz, rpy, centre)]
        own = f'<inertial><mass value="{mass}"/><origin xyz="{words[2]}"/>{inertia}</inertial>' if masses else ""
        parts.append(
            f'<link name="l{i + 1}">{own}</link>\n<joint name="j{i + 1}" type="revolute">'
            f'<parent link="{f"l{i}" if i else "base"}"/><child link="l{i + 1}"/><origin xyz="{words[0]}" rpy="{words[1]}"/>'
            '<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="0" velocity="1"/></joint>'
        )
    parts.append(
        '<link name="flange"/><joint name="f" type="fixed"><parent link="l6"/><child link="flange"/>'
        f'<origin xyz="0 0 {FLANGE_M}"/></joint></robot>'
    )
    (folder / "arm.urdf").write_text("\n".join(parts))
    axes = "\n".join(
        f"  - {{name: J{i + 1}, joint: j{i + 1}, kind: rotary, range: [{-high}, {high}], increment: 0.001}}"
        for i, high in enumerate(HIGH)
    )
    path = folder / "arm.yaml"
    path.write_text(
        f"schema: twin.machine/1\nname: arm\nurdf: arm.urdf\naxes:\n{axes}\nframes: {{tool: flange, work: base}}\n"
    )
    return path


def table(
    path: Path,
    q: np.ndarray,
    at_flange: tuple[np.ndarray, np.ndarray],
    rng: np.random.Generator,
    further: Mapping[str, np.ndarray] = MappingProxyType({}),
) -> Path:
    """Return the table of a tracker's readings of the reflectors, from commands (n, 6), pose of the last link, further columns (n,)."""
    turn, place = at_flange
    rows: list[dict[str, object]] = []
    for name, at in REFLECTORS_MM.items():
        points = 1e3 * (place + turn @ (np.array([0.0, 0.0, FLANGE_M]) + 1e-3 * np.array(at)))
        points = points @ rotation(2, np.array(0.7)).T + [1500.0, -400.0, 100.0]
        points += SIGMA_MM * rng.standard_normal(points.shape)
        rows += [
            {f"J{i + 1}_deg": q[k, i] for i in range(6)}
            | {"target": name, "carrier": "tool"}
            | {column: values[k] for column, values in further.items()}
            | {f"{c}_mm": points[k, i] for i, c in enumerate("xyz")}
            | {f"u_{c}_mm": SIGMA_MM for c in "xyz"}
            for k in range(len(q))
        ]
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return path


def measured(
    folder: Path, compliance: dict[str, float], carried: Carried | None, seed: int = 1
) -> tuple[Diagnosis, Machine]:
    """Return the diagnosis of an arm measured by a tracker."""
    rng = np.random.default_rng(seed)
    q = np.round(rng.uniform(-HIGH, HIGH, (POSES, 6)), 3)
    machine = Machine.load(str(write_arm(folder)))
    at_flange = links(sagged(np.radians(q), compliance, carried))[-1]
    data = Measurements.load(table(folder / "arm.csv", q, at_flange, rng), machine)
    return diagnose(data, machine, Calibration.default(machine)), machine


def by_name(found: Diagnosis) -> dict[tuple[str, str], Cause]:
    return {(cause.effect, cause.where): cause for cause in found.causes}


def check(cause: Cause, name: str, value: float, times: float = 3.0) -> None:
    (number,) = (q for q in cause.parameters if q.name == name)
    assert abs(number.value - value) < times * number.u, (cause.effect, cause.where, number, value)
    assert number.u < 0.2 * abs(value), number


@pytest.mark.slow
def test_an_unknown_payload_is_found_with_the_deflecting_joints(tmp_path: Path) -> None:
    carried = Carried(2.4, (35.0, -20.0, 60.0))
    found, machine = measured(tmp_path, COMPLIANCE, carried)
    causes = by_name(found)
    assert found.verdict == "explained"
    assert set(causes) == {("payload", "tool"), *(("gravity_compliance", name) for name in COMPLIANCE)}
    for name, value in COMPLIANCE.items():
        check(causes["gravity_compliance", name], "compliance", value)
    payload = causes["payload", "tool"]
    check(payload, "mass", carried.mass_kg)
    for letter, value in zip("xyz", carried.centre_mm, strict=True):
        check(payload, f"centre_{letter}_mm", value)
    assert found.gain is not None and found.gain.held_out is not None
    assert found.gain.rms_after_um == pytest.approx(1e3 * SIGMA_MM, rel=0.05)
    assert found.gain.held_out.after_um == pytest.approx(1e3 * SIGMA_MM, rel=0.1)
    # The file written predicts the arm at other poses.
    path = tmp_path / "arm-extended.yaml"
    found.extended.save(path)
    again = Calibration.load(path, machine)
    assert [e.payloads for e in again.extra if isinstance(e, GravityCompliance)] == [
        e.payloads for e in found.extended.extra if isinstance(e, GravityCompliance)
    ]
    q = np.random.default_rng(9).uniform(-HIGH, HIGH, (50, 6))
    turn, place = links(sagged(np.radians(q), COMPLIANCE, carried))[-1]
    truth = 1e3 * (place + turn @ [0.0, 0.0, FLANGE_M])
    ours, plain = (Kinematics(machine, one).forward(q).point_mm for one in (again, Calibration.zero(machine)))
    off, before = (np.sqrt(np.mean(np.sum((one - truth) ** 2, axis=1))) for one in (ours, plain))
    assert before > 0.3 and off < 0.01 * before


@pytest.fixture(scope="module")
def unloaded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Machine, Calibration]:
    """The calibration of the arm without a load, written and read."""
    folder = tmp_path_factory.mktemp("arm")
    found, machine = measured(folder, COMPLIANCE, None)
    found.extended.save(folder / "unloaded.yaml")
    return folder, machine, Calibration.load(folder / "unloaded.yaml", machine)


@pytest.mark.sample(2)  # of 3
@pytest.mark.parametrize(("mass", "seed", "poses"), [(2.5, 4, 30), (2.5, 6, 60), (0.0, 7, 30)])
def test_a_load_is_named_by_few_loaded_poses(
    unloaded: tuple[Path, Machine, Calibration], mass: float, seed: int, poses: int
) -> None:
    """A calibration without load and 30 loaded poses: the mass within its uncertainty, other loaded poses predicted."""
    folder, machine, known = unloaded
    rng = np.random.default_rng(seed)
    q = np.round(rng.uniform(-HIGH, HIGH, (poses, 6)), 3)
    carried = Carried(mass, (10.0, 0.0, 60.0))
    at_flange = links(sagged(np.radians(q), COMPLIANCE, carried))[-1]
    data = Measurements.load(table(folder / "loaded.csv", q, at_flange, rng), machine)
    found = diagnose(data, machine, known)
    if not mass:
        assert found.verdict == "consistent"
        return
    payload = by_name(found)["payload", "tool"]
    check(payload, "mass", mass)
    found.extended.save(folder / "loaded.yaml")
    again = Calibration.load(folder / "loaded.yaml", machine)
    q = np.random.default_rng(9).uniform(-HIGH, HIGH, (50, 6))
    turn, place = links(sagged(np.radians(q), COMPLIANCE, carried))[-1]
    truth = 1e3 * (place + turn @ [0.0, 0.0, FLANGE_M])
    off, before = (
        np.sqrt(np.mean(np.sum((Kinematics(machine, one).forward(q).point_mm - truth) ** 2, axis=1)))
        for one in (again, known)
    )
    assert off < 0.03 * before


@pytest.mark.slow
def test_a_size_that_becomes_impossible_after_the_search_is_not_written(
    unloaded: tuple[Path, Machine, Calibration], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the bounds of the search, a first moment without mass gives a centre metres away: it is named, but in no file."""
    folder, machine, known = unloaded
    monkeypatch.setattr("twin.diagnosis.payload._bounded_load", lambda candidates, form, forms: form)
    q = np.round(np.random.default_rng(3).uniform(-HIGH, HIGH, (40, 6)), 3)
    at_flange = links(sagged(np.radians(q), COMPLIANCE, Carried(0.01, (2e4, 0.0, 0.0))))[-1]
    data = Measurements.load(table(folder / "moved.csv", q, at_flange, np.random.default_rng(3)), machine)
    found = diagnose(data, machine, known)
    cause = by_name(found)["payload", "tool"]
    assert not cause.promised and cause.bounded and "physically impossible" in cause.evidence
    found.extended.save(folder / "moved.yaml")
    again = Calibration.load(folder / "moved.yaml", machine)
    assert not [one for effect in again.extra if isinstance(effect, GravityCompliance) for one in effect.payloads]
    assert again.misfit is not None and again.misfit.verdict == "systematic"
    assert found.gain is None or found.gain.tool_after_um < 1e5 or np.isnan(found.gain.tool_after_um)


def test_causes_of_an_impossible_size_are_left_out_with_the_reason(unloaded: tuple[Path, Machine, Calibration]) -> None:
    """An arm lighter than in its calibration needs joints that rise under load: text and JSON say why they are left out."""
    folder, machine, known = unloaded
    q = np.round(np.random.default_rng(3).uniform(-HIGH, HIGH, (40, 6)), 3)
    at_flange = links(sagged(np.radians(q), COMPLIANCE, Carried(-0.05, (10.0, 0.0, 60.0))))[-1]
    data = Measurements.load(table(folder / "lighter.csv", q, at_flange, np.random.default_rng(3)), machine)
    found = diagnose(data, machine, known)
    assert ("gravity_compliance", "J3") not in by_name(found)
    said = (
        "not named, because they fit only with a negative size, which is physically impossible: gravity_compliance J3"
    )
    assert said in found.to_dict()["notices"] and said in " ".join(found.to_text().split())


@pytest.mark.slow
@pytest.mark.parametrize("carried", [Carried(0.01, (2e4, 0.0, 0.0)), Carried(0.005, (0.0, 1e4, 3e4))])
def test_a_moment_without_mass_is_a_possible_load(
    unloaded: tuple[Path, Machine, Calibration], carried: Carried
) -> None:
    """A cable that pulls turns the joints like a first moment of a few grams, metres away: the file holds a load that is possible.

    Free mass and moments give a centre that every loader refuses, or any at all where the mass is noise.
    """
    folder, machine, known = unloaded
    rng = np.random.default_rng(3)
    q = np.round(rng.uniform(-HIGH, HIGH, (40, 6)), 3)
    data = Measurements.load(
        table(folder / "pulled.csv", q, links(sagged(np.radians(q), COMPLIANCE, carried))[-1], rng), machine
    )
    found = diagnose(data, machine, known)
    found.extended.save(folder / "pulled.yaml")
    again = Calibration.load(folder / "pulled.yaml", machine)
    payloads = {one for effect in again.extra if isinstance(effect, GravityCompliance) for one in effect.payloads}
    assert len(payloads) == 1 and all(one.plausible for one in payloads), payloads
    quantities = {q.name: q.value for q in by_name(found)["payload", "tool"].parameters}
    assert max(abs(quantities[f"centre_{letter}_mm"]) for letter in "xyz") <= 500.0
    assert found.gain is not None and found.gain.rms_after_um < found.gain.rms_before_um
    assert found.gain.tool_after_um < 1e5


@pytest.mark.slow
def test_own_weight_alone_needs_no_payload(tmp_path: Path) -> None:
    found, _ = measured(tmp_path, COMPLIANCE, None)
    causes = by_name(found)
    assert found.verdict == "explained"
    assert set(causes) == {("gravity_compliance", name) for name in COMPLIANCE}
    for name, value in COMPLIANCE.items():
        check(causes["gravity_compliance", name], "compliance", value)


def test_nothing_hidden_nothing_found(tmp_path: Path) -> None:
    found, _ = measured(tmp_path, {}, Carried(2.4, (35.0, -20.0, 60.0)))
    assert found.verdict == "consistent" and not found.causes


@pytest.mark.slow
def test_a_corrected_own_weight_bounds_the_payload(tmp_path: Path) -> None:
    """If the control corrects the arm's own sag, only products of mass and compliance are known, and the mass is not named."""
    corrected = {name: 1e-3 * value for name, value in COMPLIANCE.items()}
    found, _ = measured(tmp_path, corrected, Carried(2.4e3, (35.0, -20.0, 60.0)))
    causes = by_name(found)
    payload = causes["payload", "tool"]
    assert payload.bounded and "only the products of mass and compliance are known" in payload.evidence
    assert "mass" not in {q.name for q in payload.parameters} and "do not determine the mass" in payload.evidence
    mass = next(e.payloads[0].mass_kg for e in found.extended.extra if isinstance(e, GravityCompliance) and e.payloads)
    for name in ("J2", "J3"):
        cause = causes["gravity_compliance", name]
        assert cause.bounded and "a lower limit" in cause.evidence
        assert cause.parameters[0].value * mass == pytest.approx(COMPLIANCE[name] * 2.4, rel=0.1)
    # The file has a load that the arm could carry, and says that it is none: the real one follows by weighing.
    found.extended.save(tmp_path / "extended.yaml")
    (entry,) = (
        e for e in yaml.safe_load((tmp_path / "extended.yaml").read_text())["effects"] if e["effect"] == "payload"
    )
    parts = sum(mass for *_, mass, _ in JOINTS)
    assert entry["parameters"]["mass"] == pytest.approx(parts)
    assert entry["parameters"]["own_weight"] == pytest.approx(parts / mass)
    again = Calibration.load(tmp_path / "extended.yaml", found.extended.machine)
    q = np.random.default_rng(3).uniform(-60.0, 60.0, (20, 6))
    before, after = (Kinematics(one.machine, one).forward(q).point_mm for one in (found.extended, again))
    assert np.allclose(before, after, atol=1e-9)
    assert any("the load on the tool side is not a mass" in notice for notice in found.data.notices)


@pytest.mark.parametrize(
    ("mass", "u", "named"),
    [
        (2.0, 0.8, True),
        (2.0, 1.1, False),  # reaches below zero
        (38.0, 0.8, True),
        (38.0, 1.1, False),  # reaches beyond the moving parts, 40 kg
        (40.0, 0.0, False),
        (20.0, 11.0, False),
    ],
)
def test_a_mass_is_named_if_its_interval_lies_within_its_range(mass: float, u: float, named: bool) -> None:
    payload = Payload("tool", mass, (10.0, 20.0, 30.0))
    # The prior's standard deviation is 0.577 of the range: the readings do not determine y.
    found = causes._quantities(payload, np.array([u / 400.0, 0.1, 0.53, 0.5]), 400.0)
    assert [q.name for q in found] == [*(["mass"] if named else []), "centre_x_mm", "centre_z_mm"]
    assert [q.u for q in found[-2:]] == [50.0, 250.0]


def test_a_joint_that_its_own_weight_does_not_load_asks_for_no_payload(tmp_path: Path) -> None:
    """The compliance is confounded with the payload: J1 is vertical, J6 turns about its own centre of mass."""
    for masses, loaded in ((True, {"J2", "J3", "J4", "J5"}), (False, set[str]())):
        machine, rng = Machine.load(str(write_arm(tmp_path, masses))), np.random.default_rng(2)
        q = np.round(rng.uniform(-HIGH, HIGH, (40, 6)), 3)
        data = Measurements.load(table(tmp_path / "arm.csv", q, links(np.radians(q))[-1], rng), machine)
        known = catalogue(machine, data, Calibration.default(machine)).candidates
        free = {one.where for one in known if any("payload" in variant.fixed for variant in one.variants)}
        assert free == loaded


@pytest.mark.parametrize(
    ("entries", "line", "what"),
    [
        (
            "- {effect: payload, where: tool, " + FOUR,
            7,
            "loads no joint",
        ),
        (
            "- {effect: payload, where: flange, " + FOUR,
            7,
            "no such place for payload",
        ),
        (
            "- {effect: payload, where: tool, " + FOUR.replace("2", "-2"),
            7,
            "mass of payload tool",
        ),
        ("- {effect: payload, where: tool, parameters: {mass: 2}}", 7, "parameters of payload tool"),
        (f"- {{effect: payload, where: tool, {FOUR[:-2]}, own_weight: 0}}}}", 7, "own_weight of payload tool"),
    ],
)
def test_a_payload_that_does_not_fit_is_refused_with_its_line(
    tmp_path: Path, entries: str, line: int, what: str
) -> None:
    machine = Machine.load(str(write_arm(tmp_path)))
    path = tmp_path / "c.yaml"
    path.write_text(
        "schema: twin.calibration/1\nmachine: arm\nsource: a test\ncurves: {}\nsquareness: {}\neffects:\n"
        f"  {entries}\n"
    )
    with pytest.raises(InputError, match=what) as refused:
        Calibration.load(path, machine)
    assert refused.value.line == line
