"""The multi-axis interferometer: compared with ray tracing, exact ranks modulo a prime, and the values printed in its paper.

Wen, Hu, Zhu, Hua, Appl. Sci. 13 (2023) 10887. Valid results are reproduced, others refuted: the sign of beams 4 to 6, the
uniqueness of x and y, the independence of the installation.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tests.measurement.wen import (
    joint_covariance,
    nine_beams,
    of_beams,
    plausible_of,
    question,
    self_calibrate,
    six_beams,
    standard_uncertainty,
    u_installation,
)
from tests.numerics.independence import independence_factors
from twin._common.errors import InputError
from twin.measurement.instruments.multi_axis import MultiAxis, measure
from twin.numerics.observability import determinability

TABLE_1 = (
    np.array(
        [
            [-0.96, 0.61, -1.40, 0.67, 1.10, -0.74],
            [-0.21, 0.23, -1.10, 2.60, -0.48, 0.38],
            [0.51, -1.20, 0.09, -1.70, -1.00, 0.91],
        ]
    )
    * 1e-6
)
"""x_d, y_d, metres, and α, radians, of the six beams: 1e-3 mm and 1e-3 mrad as printed."""
NOISE = 1e-10
NOT_UNIQUE = [1, 2, 4, 5, 7, 8, 10, 11, 13, 14, 16, 17]
"""Indices in fig. 7b, 1-based; in the order x_d1, y_d1, α_1, x_d2, …, not in that of their eq. 30."""

# Ray tracing, in extended precision: nothing here is taken from the package.


def rotation(w: np.ndarray) -> np.ndarray:
    """Return a rotation matrix by Rodrigues' formula."""
    w = np.asarray(w, dtype=np.longdouble)
    angle = np.sqrt(w @ w)
    if angle == 0.0:
        return np.eye(3, dtype=np.longdouble)
    k = w / angle
    cross = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]], dtype=np.longdouble)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)


def path(source: np.ndarray, beam: np.ndarray, pose: np.ndarray, normal: np.ndarray, distance: float) -> np.longdouble:
    """Return the path to the mirror, after reflection back to the plane through the source across the beam: leg by leg."""
    turned = rotation(pose[3:]) @ normal.astype(np.longdouble)
    on_mirror = pose[:3].astype(np.longdouble) + turned * np.longdouble(distance)
    s, d = source.astype(np.longdouble), beam.astype(np.longdouble)
    hit = s + d * (((on_mirror - s) @ turned) / (d @ turned))
    back = d - 2 * (d @ turned) * turned
    end = hit + back * (((s - hit) @ d) / (back @ d))
    assert abs((end - s) @ d) < 1e-17
    return np.sqrt((hit - s) @ (hit - s)) + np.sqrt((end - hit) @ (end - hit))


def traced(layout: MultiAxis, sources: np.ndarray, beams: np.ndarray, poses: np.ndarray) -> np.ndarray:
    found = np.zeros((len(poses), len(sources)))
    for i, (source, beam) in enumerate(zip(sources, beams, strict=True)):
        face = (layout.normal[layout.mirror[i]], float(layout.distance[layout.mirror[i]]))
        rest = path(source, beam, np.zeros(6), *face)
        found[:, i] = [float(path(source, beam, pose, *face) - rest) for pose in poses]
    return found


def in_plane(rng: np.random.Generator, count: int, length: float, angle: float) -> np.ndarray:
    poses = np.zeros((count, 6))
    poses[:, :2] = rng.uniform(-length, length, (count, 2))
    poses[:, 5] = rng.uniform(-angle, angle, count)
    return poses


def in_space(rng: np.random.Generator, count: int, length: float, angle: float) -> np.ndarray:
    return np.hstack([rng.uniform(-length, length, (count, 3)), rng.uniform(-angle, angle, (count, 3))])


def table_1(layout: MultiAxis, times: float = 1.0) -> np.ndarray:
    installation = np.zeros(len(layout.installation))
    installation[of_beams(layout)] = (TABLE_1 * times).T.reshape(-1)
    return installation


LIMIT = 1e-15
"""1e-12 mm: the path of some 0.4 m is known to 1e-16 of itself in double precision, and a reading is a difference of two."""


def test_six_beams_against_traced_rays() -> None:
    layout = six_beams()
    rng = np.random.default_rng(1)
    poses = in_plane(rng, 40, 0.05, 0.01)
    installation = np.zeros(len(layout.installation))
    by_beam = rng.normal(size=(6, 3)) * [1e-3, 1e-3, 5e-3]
    installation[:18] = by_beam.reshape(-1)
    sources = layout.source + np.pad(by_beam[:, :2], ((0, 0), (0, 1)))
    # α turns the beam from its nominal direction, x to y.
    nominal = np.repeat([0.0, np.pi / 2.0], 3)
    beams = np.stack([np.cos(nominal + by_beam[:, 2]), np.sin(nominal + by_beam[:, 2]), np.zeros(6)], axis=1)
    # Rounding of these cosines to double moves the path by 1e-17 m; that of the arc itself is what is checked.
    found = layout.readings(poses, installation)
    assert np.abs(found - traced(layout, sources, beams, poses)).max() < LIMIT


def test_nine_beams_against_traced_rays() -> None:
    layout = nine_beams()
    rng = np.random.default_rng(2)
    poses = in_space(rng, 40, 0.05, 0.01)
    places = rng.normal(size=(9, 3)) * 1e-3
    turns = rng.normal(size=(9, 2)) * 5e-3
    installation = np.zeros(len(layout.installation))
    installation[:45] = np.hstack([places, turns]).reshape(-1)
    # Turned about those of z, y, x in this order that the beam does not run along.
    beams = np.zeros((9, 3))
    for i in range(9):
        others = [axis for axis in (2, 1, 0) if axis != i // 3]
        w = np.zeros(3)
        w[others] = turns[i]
        beams[i] = (rotation(w) @ np.eye(3)[i // 3]).astype(float)
    found = layout.readings(poses, installation)
    assert np.abs(found - traced(layout, layout.source + places, beams, poses)).max() < LIMIT


def test_equations_3_and_4_as_printed_have_a_wrong_sign_in_beams_4_to_6() -> None:
    layout = six_beams()
    poses = in_plane(np.random.default_rng(3), 200, 0.05, 0.01)
    real = traced(layout, layout.source, layout.direction, poses)

    def printed(sign: float) -> np.ndarray:
        found = np.zeros_like(real)
        for i in range(6):
            (xd, yd), (x, y), t = layout.source[i, :2], poses[:, :2].T, poses[:, 5]
            along = (x - xd) * np.cos(t) + (y - yd) * np.sin(t)
            if i >= 3:
                along = (y - yd) * np.cos(t) + sign * (x - xd) * np.sin(t)
            start = xd if i < 3 else yd
            found[:, i] = 2 * np.cos(t) / np.cos(2 * t) * (along - 0.1) + 2 * (start + 0.1)
        return found

    assert np.abs(printed(1.0) - real)[:, :3].max() < LIMIT
    wrong = (printed(1.0) - real)[:, 3:]
    t = poses[:, 5:]
    lever = poses[:, :1] - layout.source[3:, 0]
    assert np.abs(wrong - 4.0 * np.cos(t) / np.cos(2.0 * t) * lever * np.sin(t)).max() < LIMIT
    assert np.abs(wrong).max() > 4e-3  # metres: 4 · (50 + 60 mm) · 10 mrad at the outer beams
    assert np.abs(printed(-1.0) - real).max() < LIMIT


@pytest.mark.parametrize("layout", [six_beams(), nine_beams(), six_beams(planar=False)], ids=["plane", "cube", "flat"])
def test_derivatives_against_differences(layout: MultiAxis) -> None:
    rng = np.random.default_rng(4)
    poses = (in_plane if layout.planar else in_space)(rng, 3, 0.05, 0.02)
    installation = rng.normal(size=len(layout.installation)) * 1e-3
    _, by_pose, by_installation = layout.derivatives(poses, installation)
    step = 1e-6  # central: its own error is 1e-12 · f''' ≈ 1e-11, that of rounding 1e-16 / 1e-6
    for column, k in enumerate(layout.motions):
        d = np.eye(6)[k] * step
        difference = layout.readings(poses + d, installation) - layout.readings(poses - d, installation)
        assert np.abs(difference / (2.0 * step) - by_pose[:, :, column]).max() < 1e-9
    for i in range(len(installation)):
        d = np.eye(len(installation))[i] * step
        difference = layout.readings(poses, installation + d) - layout.readings(poses, installation - d)
        assert np.abs(difference / (2.0 * step) - by_installation[:, :, i]).max() < 1e-9


# Rank without rounding: the derivatives are rational in cosines and sines, and so exist modulo a prime; a rank there is the exact one
# unless the prime divides a minor (one chance in a thousand million for a random one).

PRIME = 2**31 - 1


def inverse(value: np.ndarray) -> np.ndarray:
    found, power, exponent = np.ones_like(value), value % PRIME, PRIME - 2
    while exponent:
        if exponent & 1:
            found = found * power % PRIME
        power = power * power % PRIME
        exponent >>= 1
    return found


def rank_modulo(matrix: np.ndarray) -> int:
    rows = matrix % PRIME
    rank = 0
    for column in range(rows.shape[1]):
        at = np.flatnonzero(rows[rank:, column])
        if len(at) == 0:
            continue
        rows[[rank, rank + at[0]]] = rows[[rank + at[0], rank]]
        rows[rank] = rows[rank] * inverse(rows[rank, column : column + 1])[0] % PRIME
        below = rows[rank + 1 :, column]
        rows[rank + 1 :] = (rows[rank + 1 :] - below[:, None] * rows[rank] % PRIME) % PRIME
        rank += 1
        if rank == len(rows):
            break
    return rank


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.sum(a * b % PRIME, axis=-1) % PRIME


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    rolled = [np.roll(a, -1, -1) * np.roll(b, -2, -1) % PRIME, np.roll(a, -2, -1) * np.roll(b, -1, -1) % PRIME]
    return (rolled[0] - rolled[1]) % PRIME


def unit_quaternion_matrix(q: np.ndarray) -> np.ndarray:
    """Return a random rational rotation from a random integer quaternion."""
    w, x, y, z = (q[i] for i in range(4))
    s = inverse(np.array([(w * w + x * x + y * y + z * z) % PRIME]))[0]
    entries = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return np.array([[int(v) % PRIME * int(s) % PRIME for v in row] for row in entries])


def exact_jacobian(positions: int, faces: list[int], *, planar: bool, seed: int) -> np.ndarray:
    """Return derivatives of L = 2c/(2c² − 1)·((s − r)·n − h) minus its value at rest, by s, d, r and the rotation; modulo the prime."""
    rng = np.random.default_rng(seed)

    def draw(*shape: int) -> np.ndarray:
        return rng.integers(1, 2**15, shape).astype(np.int64)

    def turn() -> np.ndarray:
        q = draw(4)
        return unit_quaternion_matrix(q * [1, 0, 0, 1] if planar else q)

    def parts(n: np.ndarray, s: np.ndarray, r: np.ndarray, d: np.ndarray, h: int) -> tuple[np.ndarray, ...]:
        c = -dot(d, n) % PRIME
        gap = (dot((s - r) % PRIME, n) - h) % PRIME
        below = inverse(np.array([(2 * (c * c % PRIME) - 1) % PRIME]))[0]
        f = 2 * c * below % PRIME
        slope = -(4 * (c * c % PRIME) + 2) % PRIME * below % PRIME * below % PRIME
        by_n = (f * ((s - r) % PRIME) - slope * gap % PRIME * d) % PRIME
        return f * n % PRIME, -slope * gap % PRIME * n % PRIME, by_n  # by s (and −r), by d, by n

    free = [0, 1, 5] if planar else list(range(6))
    spins = [turn() for _ in range(positions)]
    places = [draw(3) * ([1, 1, 0] if planar else 1) for _ in range(positions)]
    axes = np.eye(3, dtype=np.int64)
    per = 3 if planar else 5
    rows = []
    for i, face in enumerate(faces):
        s, h = draw(3) * ([1, 1, 0] if planar else 1), int(draw(1)[0])
        d = turn()[:, face]
        tangents = [cross(w, d) for w in (axes[2:] if planar else [a for k, a in enumerate(axes) if k != face])]
        n0 = -axes[face] % PRIME
        at_rest = parts(n0, s, np.zeros(3, dtype=np.int64), d, h)
        for k in range(positions):
            n = spins[k] @ n0 % PRIME
            by_s, by_d, by_n = parts(n, s, places[k], d, h)
            row = np.zeros(len(faces) * per + positions * len(free), dtype=np.int64)
            installed = (by_s - at_rest[0]) % PRIME
            moved = [dot((by_d - at_rest[1]) % PRIME, t) for t in tangents]
            row[i * per : (i + 1) * per] = [*(installed[:2] if planar else installed), *moved]
            by_pose = np.concatenate([-by_s % PRIME, [dot(by_n, cross(a, n)) for a in axes]])
            at = len(faces) * per + k * len(free)
            row[at : at + len(free)] = by_pose[free]
            rows.append(row)
    return np.array(rows)


@pytest.mark.parametrize("positions", [6, 10, 15])
def test_the_rank_of_six_beams_is_two_short_whatever_the_number_of_positions(positions: int) -> None:
    exact = exact_jacobian(positions, [0] * 3 + [1] * 3, planar=True, seed=positions)
    assert exact.shape == (6 * positions, 18 + 3 * positions)
    assert rank_modulo(exact) == exact.shape[1] - 2


@pytest.mark.parametrize("positions", [15, 20, 30])
def test_the_rank_of_nine_beams_is_six_short_whatever_the_number_of_positions(positions: int) -> None:
    exact = exact_jacobian(positions, [0] * 3 + [1] * 3 + [2] * 3, planar=False, seed=positions)
    assert exact.shape == (9 * positions, 45 + 6 * positions)
    assert rank_modulo(exact) == exact.shape[1] - 6


def asked(layout: MultiAxis, poses: np.ndarray, length: float, angle: float, installation: np.ndarray) -> np.ndarray:
    """Return derivatives by beams and positions, in millimetres and the chosen units."""
    sizes = plausible_of(layout, length, angle, 1.0)
    matrix, unknowns = question(
        layout,
        poses,
        installation,
        unknown=of_beams(layout),
        pose_sizes=(length, angle),
        installation_sizes=sizes,
    )
    return matrix * np.array([one.plausible * one.factor for one in unknowns]) / 1e-3


@pytest.mark.parametrize(
    ("layout", "make", "rank", "count"), [(six_beams(), in_plane, 46, 48), (nine_beams(), in_space, 159, 165)]
)
def test_the_package_finds_that_rank_where_double_precision_can_show_it(
    layout: MultiAxis, make: Callable[..., np.ndarray], rank: int, count: int
) -> None:
    """Rotations of 0.3 rad, beam directions 0.1 rad from each other: at the paper's milliradians six values are below rounding."""
    rng = np.random.default_rng(6)
    poses = make(rng, 10 if layout.planar else 20, 0.05, 0.3)
    installation = rng.normal(size=len(layout.installation)) * np.where(of_beams(layout), 0.1, 0.0)
    installation[["turn" not in name for name in layout.installation]] *= 0.1
    sizes = plausible_of(layout, 0.1, 0.1, 1.0)
    matrix, unknowns = question(
        layout, poses, installation, unknown=of_beams(layout), pose_sizes=(0.1, 0.1), installation_sizes=sizes
    )
    found = determinability(matrix, unknowns, tolerance=1e-13)
    values = found.spectrum.values
    assert (len(values), found.spectrum.rank) == (count, rank)
    assert values[rank - 1] > 30.0 * values[rank]
    free = [i for i, name in enumerate(found.names) if "position" in name]
    turns = [i for i in free if "turn" in found.names[i]]
    assert found.spectrum.leverage[turns].max() < 1e-6
    assert found.spectrum.leverage[[i for i in free if i not in turns]].max() > 1e-3


def test_a_move_that_changes_no_reading_and_moves_x_and_y() -> None:
    layout = six_beams()
    poses = in_plane(np.random.default_rng(7), 10, 0.01, 0.005)
    installation = table_1(layout)
    for beams, (i, along) in (((0, 1, 2), (1, 0)), ((3, 4, 5), (0, 1))):
        c = 1e-3
        shifted, moved = installation.copy(), poses.copy()
        for beam in beams:
            shifted[3 * beam + i] += c
        sine, cosine = np.sin(poses[:, 5]), np.cos(poses[:, 5])
        moved[:, along] += (1.0 if along == 0 else -1.0) * c * sine * cosine
        moved[:, 1 - along] += c * sine**2
        assert np.abs(layout.readings(moved, shifted) - layout.readings(poses, installation)).max() < LIMIT
        assert np.abs(moved[:, along] - poses[:, along]).max() == pytest.approx(5e-6, rel=0.1)


def test_in_words_the_beams_of_one_mirror_move_along_it_together() -> None:
    layout = six_beams()
    poses = in_plane(np.random.default_rng(8), 10, 0.05, 0.3)
    installation = np.zeros(len(layout.installation))
    installation[2:18:3] = np.random.default_rng(9).normal(size=6) * 0.1
    sizes = plausible_of(layout, 1e-3, 1e-3, 1.0)
    matrix, unknowns = question(
        layout, poses, installation, unknown=of_beams(layout), pose_sizes=(1e-3, 1e-3), installation_sizes=sizes
    )
    found = determinability(matrix, unknowns, tolerance=1e-13)
    assert found.spectrum.rank == 46
    moving = found.null_direction_of("beam 2 y")
    assert moving is not None
    moves = {move.name: move.value for move in moving.moves}
    assert [move.unit for move in moving.moves] == ["um"] * len(moving.moves)
    assert {"beam 1 y", "beam 2 y", "beam 3 y"} <= set(moves)
    assert moves["beam 1 y"] == pytest.approx(moves["beam 3 y"], rel=1e-6)
    assert found.null_direction_of("position 3 turn z") is None


@pytest.mark.parametrize("seed", range(8))
def test_the_twelve_indices_come_out_in_one_choice_of_units_and_truncation_only(seed: int) -> None:
    """Algorithm 1: in mm and rad, cut at the gap after the 33rd eigenvalue, it names their twelve; in mm and mrad no cut does."""
    layout = six_beams()
    poses = in_plane(np.random.default_rng(seed), 10, 0.01, 0.005)
    jacobian = asked(layout, poses, 1e-3, 1.0, table_1(layout))
    values = independence_factors(jacobian, threshold=1e-30).eigenvalues
    gap = float(np.sqrt(values[32] * values[33]))
    assert values[32] > 300.0 * values[33]
    found = independence_factors(jacobian, threshold=gap)
    assert found.rank == 33
    assert (np.flatnonzero(found.factors < 0.3) + 1).tolist() == NOT_UNIQUE

    other = asked(layout, poses, 1e-3, 1e-3, table_1(layout))
    values = independence_factors(other, threshold=1e-30).eigenvalues
    for rank in range(1, 46):
        cut = independence_factors(other, threshold=float(np.sqrt(values[rank - 1] * values[rank])))
        assert (np.flatnonzero(cut.factors < 0.3) + 1).tolist() != NOT_UNIQUE


def simulated(times: float, seed: int) -> tuple[MultiAxis, np.ndarray, np.ndarray, np.ndarray]:
    """Return their section 4: layout, true poses, readings with 0.1 nm, initial values within 1 µm and 1 µrad."""
    layout = six_beams()
    rng = np.random.default_rng(seed)
    poses = in_plane(rng, 10, 0.01, 0.005)
    readings = layout.readings(poses, table_1(layout, times)) + rng.normal(size=(10, 6)) * NOISE
    return layout, poses, readings, poses + in_plane(rng, 10, 1e-6, 1e-6)


def errors_of_algorithm_2(times: float) -> tuple[float, float, int]:
    """Return standard deviations of x, nm, and θ, mrad, over 40 draws, and the largest number of steps."""
    x, theta, steps = [], [], 0
    for seed in range(40):
        layout, poses, readings, start = simulated(times, seed)
        found = self_calibrate(layout, readings, noise=NOISE, tolerance=1e-6, poses=start)
        assert found.converged
        steps = max(steps, found.steps)
        x.append((found.poses - poses)[:, 0] * 1e9)
        theta.append((found.poses - poses)[:, 5] * 1e3)
    return float(np.std(x)), float(np.std(theta)), steps


def test_algorithm_2_is_not_independent_of_the_installation() -> None:
    """Ten times the installation error gives ten times the error of x: 1.884 nm is not due to 0.1 nm of noise, θ is not independent."""
    one, ten = errors_of_algorithm_2(1.0), errors_of_algorithm_2(10.0)
    assert one[0] == pytest.approx(1.5, rel=0.2)
    assert ten[0] / one[0] == pytest.approx(10.0, rel=0.15)  # the noise's own part is 0.2 of 1.5 nm
    assert 5.0 < ten[1] / one[1] < 12.0
    assert one[1] > 20.0 * 5.871e-7
    assert max(one[2], ten[2]) <= 4


def test_the_angles_of_the_beams_are_not_solved() -> None:
    """Six of their 36 accurate unknowns are not: a third of each α is in the truncated part of Algorithm 2."""
    for seed in range(5):
        layout, _, readings, start = simulated(1.0, seed)
        found = self_calibrate(layout, readings, noise=NOISE, tolerance=1e-6, poses=start).determinability
        angles = [i for i, name in enumerate(found.names) if name.startswith("beam") and "turn" in name]
        assert len(angles) == 6
        assert found.spectrum.leverage[angles].min() > 0.3
        assert found.spectrum.rank < 46


def test_limit_with_a_known_installation() -> None:
    """Installation known: 0.029 nm and 4.17e-7 mrad, by the covariance and by 60 draws."""
    x, theta = [], []
    for seed in range(60):
        layout, poses, readings, start = simulated(0.0, seed)
        nothing = np.zeros(len(layout.installation))
        found = measure(layout, readings, noise=NOISE, installation_u=nothing, poses=start)
        assert found.converged and found.steps <= 4
        x.append((found.poses - poses)[:, 0])
        theta.append((found.poses - poses)[:, 5])
        assert np.allclose(standard_uncertainty(found)[:, 0], 0.029e-9, rtol=0.05)
        assert np.allclose(standard_uncertainty(found)[:, 2], 4.17e-10, rtol=0.05)
    # 600 values: their standard deviation is known to 3 %.
    assert np.std(x) == pytest.approx(0.029e-9, rel=0.1)
    assert np.std(theta) == pytest.approx(4.17e-10, rel=0.1)


@pytest.mark.parametrize("layout", [six_beams(), nine_beams()], ids=["plane", "cube"])
def test_the_stated_uncertainty_covers_the_truth(layout: MultiAxis) -> None:
    """Installation drawn with its stated uncertainty, mirrors and scale too: squared errors compared with the joint covariance."""
    u = plausible_of(layout, 20e-6, 20e-6, 5e-7)
    total, dof = 0.0, 0
    share = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        poses = (in_plane if layout.planar else in_space)(rng, 6, 0.01, 0.001)
        readings = layout.readings(poses, u * rng.standard_normal(len(u)))
        readings += rng.normal(size=readings.shape) * 1e-9
        start = np.zeros_like(poses)
        found = measure(layout, readings, noise=1e-9, installation_u=u, poses=start)
        error = (found.poses - poses)[:, list(layout.motions)].reshape(-1)
        total += float(error @ np.linalg.solve(joint_covariance(found), error))
        dof += len(error)
        share.append(float(np.mean(u_installation(found)[:, 0] / standard_uncertainty(found)[:, 0])))
    # chi² of a thousand degrees of freedom and more: two standard deviations are 9 % at most.
    assert total / dof == pytest.approx(1.0, abs=0.1)
    assert np.mean(share) > 0.9  # the installation, not the noise, is what x is uncertain by


def test_a_missing_beam_widens_the_uncertainty() -> None:
    layout, _, readings, start = simulated(0.0, 1)
    nothing = np.zeros(len(layout.installation))
    whole = measure(layout, readings, noise=NOISE, installation_u=nothing, poses=start)
    readings[4, 0] = np.nan
    part = measure(layout, readings, noise=NOISE, installation_u=nothing, poses=start)
    assert np.isnan(part.residual[4, 0])
    u_part, u_whole = standard_uncertainty(part), standard_uncertainty(whole)
    assert u_part[4, 0] > 1.05 * u_whole[4, 0]
    assert np.allclose(np.delete(u_part, 4, axis=0), np.delete(u_whole, 4, axis=0))
    readings[4, :3] = np.nan
    with pytest.raises(InputError, match="position 5 do not determine its 3 motions"):
        measure(layout, readings, noise=NOISE, installation_u=nothing, poses=start)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"direction": np.tile([0.0, 1.0, 0.0], (6, 1))}, "beam 1 meets mirror x at too large an angle"),
        ({"source": np.zeros((6, 3))}, "beam 1 starts behind mirror x"),
        ({"direction": np.eye(3)[[0, 0, 0, 1, 1, 1]] * 1.1}, "not a unit vector"),
        ({"mirror": np.zeros(5, dtype=int)}, "arrays of a layout do not match"),
        ({"beams": ("1", "1", "3", "4", "5", "6")}, "each name once"),
    ],
)
def test_layouts_that_cannot_be(change: dict[str, object], said: str) -> None:
    layout = six_beams()
    given = {name: getattr(layout, name) for name in MultiAxis.__dataclass_fields__}
    with pytest.raises(InputError, match=said):
        MultiAxis(**(given | change))


def test_arguments_that_cannot_be() -> None:
    layout, _, readings, start = simulated(1.0, 3)
    nothing = np.zeros(len(layout.installation))
    with pytest.raises(InputError, match="do not match"):
        measure(layout, readings[:, :5], noise=NOISE, installation_u=nothing, poses=start)
    with pytest.raises(InputError, match="must be positive"):
        measure(layout, readings, noise=0.0, installation_u=nothing, poses=start)
    for u in (np.zeros(3), np.full(len(nothing), np.inf)):
        with pytest.raises(InputError, match="uncertainties of the installation"):
            measure(layout, readings, noise=NOISE, installation_u=u, poses=start)
    with pytest.raises(InputError, match="poses or installation"):
        layout.readings(np.zeros((2, 5)))
