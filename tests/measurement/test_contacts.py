"""Reduction of contacts: a machine with errors probed by the second implementation, statistics, degenerate groups, outliers."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats import t as student_t

from tests.machine.reordered import columns, reordered
from tests.measurement.formats.cases.spheres import DIRECTIONS
from tests.real.probe_sphere import MACHINE as HEAD_HEAD
from tests.truth.reference import about, dmu50_pose
from twin._common.errors import InputError
from twin.identification import identify
from twin.machine.machine import Machine
from twin.measurement.contacts import Contacts, Probing, ReducedContacts, fit_sphere, numbered_rounds, reduce_contacts

MACHINE = Machine.load("dmu50")
RADIUS, TOOL = 13.0, 150.0
NOISE = 0.001
SPHERE = np.array([60.0, -40.0, 90.0])
"""Place of the sphere in the work frame."""


def contacts(points: np.ndarray, poses: np.ndarray, direction: np.ndarray | None = None) -> Contacts:
    n = len(points)
    return Contacts(
        source="contacts.csv",
        lines=np.arange(2, n + 2),
        positions=np.column_stack([points, poses]),
        sphere=np.full(n, "S", dtype=object),
        round=np.full(n, "1", dtype=object),
        direction=np.full((n, 3), np.nan) if direction is None else direction,
    )


def probed(errors: dict[str, np.ndarray], rng: np.random.Generator) -> Contacts:
    """Return contacts with a sphere on the table of the second implementation, whose linear axes have no errors."""
    points, poses = [], []
    for b in (0.0, 30.0, 60.0, 90.0):
        for c in range(0, 360, 60):

            def tip(x: np.ndarray, b: float = b, c: float = c) -> np.ndarray:
                return dmu50_pose(np.array([*x, np.radians(b), np.radians(c)]), errors, TOOL)[:3, 3]

            zero = tip(np.zeros(3))
            motion = np.column_stack([tip(axis) - zero for axis in np.eye(3)])
            centre = np.linalg.solve(motion, SPHERE - zero)
            for normal in DIRECTIONS:
                points.append(centre + (RADIUS + rng.normal(0, NOISE)) * normal)
                poses.append([b, c])
    return contacts(np.array(points), np.array(poses))


def test_the_location_of_the_rotary_axes_is_identified_from_contacts() -> None:
    """Offsets of the average lines of B and C, in contacts made by a simulator that shares no code with twin."""
    truth, others = {"E_X0C": 40.0, "E_A0C": 30.0}, ("E_A0B", "E_B0C")
    errors = {"L_C": np.array([0.040, 0.0, 0.0, 30e-6, 0.0, 0.0])}
    found = reduce_contacts(probed(errors, np.random.default_rng(3)), MACHINE, Probing())
    assert found.u_contact_mm == pytest.approx(NOISE, rel=0.2)
    identified = identify(found.measurements, MACHINE, wanted=lambda name: name in (*truth, *others)).calibration
    u = dict(zip(identified.covariance.names, np.sqrt(np.diag(identified.covariance.matrix)), strict=True))
    for name, size in (truth | dict.fromkeys(others, 0.0)).items():
        assert abs(identified.location[name] - size) < 3.0 * u[name], name
    assert u["E_X0C"] < 1.0  # 40 µm are seen, not hidden in the uncertainty


def test_the_covariance_travels_into_the_table() -> None:
    """Stated uncertainties cover the true positions: z-scores of all coordinates have a variance of one."""
    rng = np.random.default_rng(5)
    points, poses = [], []
    for k in range(150):
        points += [np.array([250.0, 225.0, -200.0]) + (RADIUS + rng.normal(0, NOISE)) * normal for normal in DIRECTIONS]
        poses += [[0.0, float(k)]] * len(DIRECTIONS)
    found = reduce_contacts(contacts(np.array(points), np.array(poses)), MACHINE, Probing())
    scores = (found.measurements.positions[:, :3] - [250.0, 225.0, -200.0]) / found.measurements.u_mm
    assert found.measurements.u_mm.shape == (150, 3) and len(found.centres) == 150
    # 450 squares of normal variables: mean 1 ± 3.3 standard deviations of √(2/450).
    assert np.mean(scores**2) == pytest.approx(1.0, abs=3.3 * np.sqrt(2 / 450))


def one_sphere(offsets: np.ndarray | None = None, normals: np.ndarray = DIRECTIONS) -> Contacts:
    points = np.array([250.0, 225.0, -200.0]) + RADIUS * normals
    return contacts(points + (0.0 if offsets is None else offsets), np.zeros((len(normals), 2)))


def reduced(given: Contacts, probing: Probing | None = None) -> ReducedContacts:
    return reduce_contacts(given, MACHINE, Probing() if probing is None else probing)


def test_the_radius_of_the_tip_is_compensated_along_the_direction() -> None:
    exact = one_sphere()
    with_direction = contacts(exact.positions[:, :3], np.zeros((8, 2)), -DIRECTIONS)
    found = reduced(with_direction, Probing(tip_radius_mm=3.0, u_contact_mm=NOISE))
    assert found.centres[0].radius_mm == pytest.approx(RADIUS - 3.0)
    skew = -DIRECTIONS + [0.0, 0.0, 0.1]
    skew /= np.linalg.norm(skew, axis=1)[:, None]
    tilted = reduced(contacts(exact.positions[:, :3], np.zeros((8, 2)), skew), Probing(None, 3.0, 1.0))
    # A tilt of 0.1 turns the horizontal directions by atan 0.1 = 5.7°, and by more where the fitted centre moves.
    (note,) = (note for note in tilted.notes if note.startswith("largest angle between probing direction and normal"))
    assert 5.7 <= float(note.split("normal ")[1].split("°")[0]) < 9.0


def test_the_noise_of_all_spheres_serves_those_without_residuals() -> None:
    with pytest.raises(InputError, match="no residuals to estimate the noise from") as caught:
        reduced(one_sphere(normals=DIRECTIONS[[0, 1, 2, 4]]))
    assert caught.value.line == 2 and caught.value.setting == "contact uncertainty"
    rng = np.random.default_rng(2)
    first = one_sphere(rng.normal(0, NOISE, (8, 3)))
    points = np.vstack([first.positions[:, :3], one_sphere().positions[[0, 1, 2, 4], :3]])
    found = reduced(contacts(points, np.array([[0.0, 0.0]] * 8 + [[0.0, 90.0]] * 4)))
    assert np.isfinite(found.measurements.u_mm).all() and found.centres[1].contacts == 4


@pytest.mark.parametrize("stated", [None, NOISE])
def test_an_outlier_is_named(stated: float | None) -> None:
    rng = np.random.default_rng(1)
    offsets = rng.normal(0, NOISE, (24, 3))
    offsets[13] += 0.04 * DIRECTIONS[5]
    points = np.tile([250.0, 225.0, -200.0] + RADIUS * DIRECTIONS, (3, 1)) + offsets
    poses = np.repeat([[0.0, 0.0], [0.0, 90.0], [0.0, 180.0]], 8, axis=0)
    with pytest.raises(InputError, match="a contact is an outlier") as caught:
        reduced(contacts(points, poses), Probing(u_contact_mm=stated))
    assert caught.value.line == 15


@pytest.mark.parametrize(("sigmas", "refused"), [(4.0, False), (4.4, True)])
def test_an_outlier_is_significant_after_correction_for_the_number_of_contacts(sigmas: float, refused: bool) -> None:
    """With 24 contacts, p = 0.001 corrected is 4.2e-5 for one: 4.10 standard deviations of its residual (scipy.stats)."""
    assert 4.0 < norm.isf(0.5e-3 / 24) < 4.2
    leverage = fit_sphere(RADIUS * DIRECTIONS).leverage[5]
    points = np.tile([250.0, 225.0, -200.0] + RADIUS * DIRECTIONS, (3, 1))
    points[13] += sigmas * NOISE / np.sqrt(1.0 - leverage) * DIRECTIONS[5]
    given = contacts(points, np.repeat([[0.0, 0.0], [0.0, 90.0], [0.0, 180.0]], 8, axis=0))
    if refused:
        with pytest.raises(InputError, match="outlier"):
            reduced(given, Probing(u_contact_mm=NOISE))
    else:
        reduced(given, Probing(u_contact_mm=NOISE))


def test_a_stated_noise_that_is_too_small_is_no_outlier() -> None:
    offsets = DIRECTIONS * np.random.default_rng(4).normal(0, 20 * NOISE, (8, 1))
    found = reduced(one_sphere(offsets), Probing(u_contact_mm=NOISE))
    assert found.u_contact_mm == NOISE and any("significantly more than stated" in note for note in found.notes)


@pytest.mark.sample(1)  # of 2
@pytest.mark.parametrize("stated", [None, NOISE])
def test_false_alarms_of_the_outlier_test_are_rare(stated: float | None) -> None:
    rng, refused = np.random.default_rng(8), 0
    for _ in range(60):
        offsets = DIRECTIONS * rng.normal(0, NOISE, (8, 1))
        try:
            reduced(one_sphere(offsets), Probing(u_contact_mm=stated))
        except InputError:
            refused += 1
    assert refused <= 1  # 0.06 expected at p = 0.001; P(more than 1) = 2e-3


def test_degenerate_contacts_name_their_line() -> None:
    circle = np.array([[np.cos(p), np.sin(p), 0.0] for p in np.arange(6)])
    for probing in (Probing(u_contact_mm=NOISE), Probing(10.0, 3.0, NOISE)):
        with pytest.raises(InputError, match="do not determine the sphere's centre") as caught:
            reduced(one_sphere(normals=circle), probing)
        assert caught.value.line == 2
    with pytest.raises(InputError, match="needs the radius of the tip") as missing:
        reduced(one_sphere(), Probing(sphere_radius_mm=10.0))
    assert missing.value.setting == "tip radius"


def test_a_pose_probed_twice_gives_two_rounds() -> None:
    poses = np.array([[0.0], [0.0], [90.0], [0.0], [0.0], [0.0]])
    spheres = np.array(["S"] * 6, dtype=object)
    assert list(numbered_rounds(spheres, poses)) == ["1", "1", "1", "2", "2", "2"]
    assert list(numbered_rounds(spheres, poses, 2)) == ["1", "1", "1", "2", "2", "3"]


def test_machines_without_linear_axes_x_y_z_are_refused(tmp_path: Path) -> None:
    folder = Path(__file__).parents[2] / "urdf"
    text = re.sub(r"\bZ\b", "W", (folder / "dmu50.yaml").read_text())
    (tmp_path / "m.yaml").write_text(text.replace("dmu50.urdf", str(folder / "dmu50.urdf")))
    with pytest.raises(InputError, match="linear axes X, Y and Z"):
        reduce_contacts(one_sphere(), Machine.load(tmp_path / "m.yaml"), Probing(u_contact_mm=NOISE))


@pytest.mark.parametrize("directed", [False, True])
def test_the_order_of_the_axes_in_the_machine_file_does_not_matter(tmp_path: Path, directed: bool) -> None:
    """Contacts and directions are along X, Y, Z; positions are in command order, and so are the reduced ones."""
    rng = np.random.default_rng(12)
    points, poses = [], []
    for b, c in ((0.0, 0.0), (30.0, 90.0), (90.0, -45.0)):
        points += [np.array([250.0, 140.0, -300.0]) + (RADIUS + rng.normal(0, NOISE)) * normal for normal in DIRECTIONS]
        poses += [[b, c]] * len(DIRECTIONS)
    directions = -np.tile(DIRECTIONS, (3, 1)) if directed else None
    given = contacts(np.array(points), np.array(poses), directions)
    probing = Probing(tip_radius_mm=3.0) if directed else Probing()
    other, at = reordered(tmp_path), columns(MACHINE)
    one = reduce_contacts(given, MACHINE, probing)
    two = reduce_contacts(replace(given, positions=given.positions[:, at]), other, probing)
    np.testing.assert_allclose(two.measurements.positions, one.measurements.positions[:, at], atol=1e-9)
    np.testing.assert_allclose(two.measurements.u_mm, one.measurements.u_mm, rtol=1e-6)
    u = one.measurements.u_mm
    assert np.all(np.ptp(u, axis=1) > 0.05 * u.min(axis=1)), "the three coordinates differ, so that their order shows"
    for centre, same in zip(one.centres, two.centres, strict=True):
        assert same.radius_mm == pytest.approx(centre.radius_mm, abs=1e-9)
        np.testing.assert_allclose(same.covariance_mm2, centre.covariance_mm2, rtol=1e-6, atol=1e-15)


def test_uncertainties_are_along_the_axes_of_the_tool() -> None:
    """A head that turns the probe by C and B: u along x, y, z of the tool is that of Rᵀ Σ R, R = Rz(C) Ry(B)."""
    machine, rng = Machine.load(HEAD_HEAD), np.random.default_rng(13)
    points, poses, expected = [], [], []
    for c, b in ((0.0, 0.0), (0.0, 90.0), (90.0, 0.0), (35.0, -70.0)):
        points += [np.array([1500.0, 900.0, -700.0]) + (RADIUS + rng.normal(0, NOISE)) * n for n in DIRECTIONS]
        poses += [[c, b]] * len(DIRECTIONS)
        turn = about(2, np.radians(c))[:3, :3] @ about(1, np.radians(b))[:3, :3]
        design = np.column_stack([DIRECTIONS, np.ones(len(DIRECTIONS))])
        covariance = NOISE**2 * np.linalg.inv(design.T @ design)[:3, :3]
        expected.append(np.sqrt(np.diag(turn.T @ covariance @ turn)))
    found = reduce_contacts(contacts(np.array(points), np.array(poses)), machine, Probing(u_contact_mm=NOISE))
    # The directions of contact differ from the normals of the fit by the noise over the radius.
    np.testing.assert_allclose(found.measurements.u_mm, expected, rtol=1e-3)
    assert np.ptp(expected, axis=0).max() > 0.2 * NOISE, "the orientation of the head shows"


@pytest.mark.parametrize(("share", "refused"), [(0.97, False), (1.03, True)])
def test_an_outlier_among_few_contacts_is_studentised(share: float, refused: bool) -> None:
    """Without a stated noise the residual is compared with that of the others, by Student's t with their degrees of freedom."""
    rng = np.random.default_rng(21)
    points = [250.0, 225.0, -200.0] + (RADIUS + rng.normal(0, NOISE, (8, 1))) * DIRECTIONS
    leverage = fit_sphere(points).leverage[5]
    dof = 8 - 4
    limit = student_t.isf(0.5e-3 / 8, dof - 1)
    low, high = 0.0, 5.0
    for _ in range(60):  # t rises with the displacement of the contact, from some size on
        middle = (low + high) / 2.0
        moved = points.copy()
        moved[5] += middle * DIRECTIONS[5]
        sphere = fit_sphere(moved)
        scaled = sphere.residuals_mm[5] / np.sqrt(1.0 - sphere.leverage[5])
        others = sphere.residuals_mm @ sphere.residuals_mm - scaled**2
        t = abs(scaled) / np.sqrt(others / (dof - 1))
        low, high = (middle, high) if scaled < 0.0 or t < share * limit else (low, middle)
    assert 0.1 < leverage < 0.9 and high < 4.0
    given = contacts(moved, np.zeros((8, 2)))
    if refused:
        with pytest.raises(InputError, match="outlier"):
            reduced(given)
    else:
        reduced(given)


@pytest.mark.parametrize(("axis", "turned"), [("X", 0.0), ("Y", 0.0), ("", 0.0), ("X", 45.0)])
def test_backlash_of_an_axis_is_named_by_the_size_of_the_spheres(axis: str, turned: float) -> None:
    """10 µm of backlash shorten one diameter by 10 µm; contacts halfway between the axes cannot show whose it is."""
    rng = np.random.default_rng(6)
    around = [np.radians(turned + angle) for angle in (0.0, 90.0, 180.0, 270.0)]
    directions = np.array([[0.0, 0.0, 1.0], *([np.cos(angle), np.sin(angle), 0.0] for angle in around)])
    lost = np.array([0.010 * (name == axis) for name in "XYZ"])
    # At rest on the flank away from the motion: half of the backlash short of the sphere on both sides.
    short = 0.5 * np.where(np.abs(directions) > 1e-9, np.sign(directions), 0.0) * lost
    points = [
        np.array([250.0, 225.0, -200.0]) + (RADIUS + rng.normal(0.0, NOISE)) * normal - away
        for _ in range(25)
        for normal, away in zip(directions, short, strict=True)
    ]
    poses = np.repeat(np.column_stack([np.zeros(25), np.arange(25.0)]), 5, axis=0)
    found = reduce_contacts(contacts(np.array(points), poses), MACHINE, Probing())
    said = [note for note in found.notes if "smaller along" in note]
    if not axis or turned:
        assert not said
        return
    other = "Y" if axis == "X" else "X"
    (number, u) = map(float, re.findall(r"([\d.]+) ± ([\d.]+) µm", said[0])[0])
    assert len(said) == 1 and f"along {axis} than along {other}: backlash of {axis}," in said[0]
    assert abs(number - 10.0) < 2.0 * u and u < 2.0
    assert np.allclose(
        np.mean([one.positions[:3] for one in found.centres], axis=0), [250.0, 225.0, -200.0], atol=0.001
    )


def test_a_known_tip_is_in_the_table() -> None:
    """The tip of a calibrated probe determines the places of the rotary axes that a tip at an unknown place leaves open."""
    truth = {"E_X0B": 0.0, "E_Y0B": 25.0, "E_X0C": -30.0, "E_Y0C": 15.0}
    errors = {"L_B": np.array([0.0, 0.025, 0.0, 0.0, 0.0, 0.0]), "L_C": np.array([-0.030, 0.015, 0.0, 0.0, 0.0, 0.0])}
    made = probed(errors, np.random.default_rng(4))
    for tip, known in (((0.0, 0.0, -TOOL), True), (None, False)):
        found = reduce_contacts(made, MACHINE, Probing(tip_mm=tip))
        identified = identify(found.measurements, MACHINE, wanted=lambda name: name in truth)
        assert (identified.unidentified == {} or not identified.unidentified) is known
        for name, size in truth.items() if known else ():
            assert abs(identified.calibration.location[name] - size) < 2.0, name
