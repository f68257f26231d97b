"""Orientation: conversions against other formulations, smooth through zero; what the paper on fused-like angles prints, and what holds.

Truths: scipy's Rotation (quaternions), the power series of the matrix exponential in 50 decimal digits, formulas derived here.
Paper: D. Chang, P. Hu, J. Tan, Front. Inform. Technol. Electron. Eng. 22 (2021) 1677-1685.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from decimal import Decimal, localcontext
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from twin._common.errors import InputError
from twin.numerics.spatial import (
    composed,
    composed_approximately,
    euler_angles,
    euler_matrix,
    fused_angles,
    fused_matrix,
    rotation_exp,
    rotation_log,
    tilt,
)

EXACT = 1e-14
"""Max norm of matrices, largest difference of angles: what is promised."""
SETS = [p + q + r for p, q, r in itertools.product("xyz", repeat=3) if p != q != r]
ORDERS = [*SETS, *(order.upper() for order in SETS)]
MRAD, NRAD, URAD = 1e-3, 1e-9, 1e-6

vectors = st.builds(
    lambda height, azimuth, size: (
        10.0**size * np.array([*(np.sqrt(1.0 - height**2) * np.array([np.cos(azimuth), np.sin(azimuth)])), height])
    ),
    st.floats(-1.0, 1.0),
    st.floats(-np.pi, np.pi),
    st.floats(-15.0, np.log10(3.1415926)),
)
turns = st.floats(-np.pi, np.pi)


def wrapped(angle: np.ndarray) -> np.ndarray:
    return np.abs((angle + np.pi) % (2 * np.pi) - np.pi)


def directions(n: int, seed: int) -> np.ndarray:
    """(n, 3) evenly over the sphere."""
    drawn = np.random.default_rng(seed).normal(size=(n, 3))
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


def precise(vector: Any) -> np.ndarray:
    """Exp in 50 digits: Σ K^n / n!, which knows no sine; (3, 3) of Decimals."""
    x, y, z = (Decimal(float(v)) for v in vector)
    none = Decimal(0)
    k = np.array([[none, -z, y], [z, none, -x], [-y, x, none]])
    with localcontext() as context:
        context.prec = 50
        term = total = np.array([[Decimal(int(i == j)) for j in range(3)] for i in range(3)])
        for n in range(1, 80):
            term = term @ k / n
            total = total + term
    return total


def rms(rows: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(rows**2, axis=-1))))


# Conversions


@given(vectors)
def test_exp_and_log_against_the_power_series(vector: np.ndarray) -> None:
    exact = precise(vector).astype(float)
    assert np.abs(rotation_exp(vector) - exact).max() <= 1e-15  # a few roundings of an entry
    # Relative to its length: a vector of 1e-12 rad comes back with its digits.
    back = rotation_log(exact)
    assert np.linalg.norm(back - vector) <= 4e-15 * np.linalg.norm(vector) + 1e-300


@given(vectors, vectors)
def test_composition_against_the_power_series(first: np.ndarray, second: np.ndarray) -> None:
    exact = (precise(first) @ precise(second)).astype(float)
    assert np.abs(rotation_exp(composed(first, second)) - exact).max() <= EXACT


def test_log_and_composition_against_scipy() -> None:
    """Rotations even over all there are: most are large, and none has a vector longer than π."""
    first, second = Rotation.random(2000, random_state=11), Rotation.random(2000, random_state=12)
    for found, expected in (
        (rotation_log(first.as_matrix()), first.as_rotvec()),
        (composed(first.as_rotvec(), second.as_rotvec()), (first * second).as_rotvec()),
    ):
        assert np.linalg.norm(found, axis=1).max() <= np.pi
        assert np.abs(found - expected).max() <= EXACT


def test_exp_of_small_vectors_keeps_its_second_order() -> None:
    """R_ij + R_ji = v_i v_j to fourth order: a difference 1 − cos t would have lost it."""
    for size in (1e-3, 1e-5, 1e-7):
        x, y, z = vector = size * np.array([0.6, -0.48, 0.64])
        matrix = rotation_exp(vector)
        found = [matrix[p, q] + matrix[q, p] for p, q in ((0, 1), (0, 2), (1, 2))]
        # Entries of the size of the vector are rounded, sums of the size of its square remain.
        assert np.abs(np.array(found) - [x * y, x * z, y * z]).max() <= 4e-16 * size + size**4


def test_small_rotations_compose_without_loss() -> None:
    """Against Baker, Campbell, Hausdorff to third order; left are roundings of the sum, up to twice as long as each."""
    for size in (1e-5, 1e-7, 1e-9, 1e-12):
        a, b = size * directions(500, 1), size * directions(500, 2)
        cross = np.cross(a, b)
        third = (np.cross(a, cross) - np.cross(b, cross)) / 12.0
        assert np.abs(composed(a, b) - (a + b + cross / 2.0 + third)).max() <= 2e-15 * size


@given(st.lists(turns, min_size=3, max_size=3), st.sampled_from(ORDERS))
def test_every_order_there_and_back_and_as_scipy_has_it(angles: list[float], order: str) -> None:
    matrix = euler_matrix(angles, order)
    assert np.abs(matrix - Rotation.from_euler(order, angles).as_matrix()).max() <= 2e-15
    assert np.abs(euler_matrix(euler_angles(matrix, order), order) - matrix).max() <= EXACT


@pytest.mark.parametrize("order", ORDERS)
def test_angles_are_scipys(order: str) -> None:
    matrices = Rotation.random(500, random_state=3).as_matrix()
    ours, theirs = euler_angles(matrices, order), Rotation.from_matrix(matrices).as_euler(order)
    # The first and third angle are worth their distance from gimbal lock.
    off = np.abs(np.sin(theirs[:, 1]) if order[0] == order[2] else np.cos(theirs[:, 1]))
    assert (wrapped(ours - theirs).max(axis=1) * off).max() <= EXACT


@pytest.mark.parametrize("order", ORDERS)
def test_gimbal_lock(order: str) -> None:
    """The last angle is zero, as documented, and the matrix comes back; close to lock as well."""
    middle = [0.0, np.pi] if order[0] == order[2] else [np.pi / 2, -np.pi / 2]
    for angle in middle:
        matrix = euler_matrix([0.7, angle, -0.4], order)
        found = euler_angles(matrix, order)
        assert found[2] == 0.0
        assert abs(found[1] - angle) <= EXACT
        assert np.abs(euler_matrix(found, order) - matrix).max() <= EXACT
        for near in 10.0 ** np.arange(-16.0, -3.0):
            matrix = euler_matrix([0.7, angle + near, -0.4], order)
            assert np.abs(euler_matrix(euler_angles(matrix, order), order) - matrix).max() <= EXACT


def test_extrinsic_is_intrinsic_backwards_and_urdf_is_xyz() -> None:
    angles = np.random.default_rng(4).uniform(-3.0, 3.0, (50, 3))
    for order in SETS:
        backwards = euler_matrix(angles[:, ::-1], order[::-1].upper())
        assert np.abs(euler_matrix(angles, order) - backwards).max() == 0.0
    roll, pitch, yaw = angles[0]
    x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])  # eq. 1 to 3
    y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    z = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    assert np.abs(euler_matrix(angles[0], "xyz") - z @ y @ x).max() <= 1e-15  # eq. 4


steep = st.floats(-np.radians(85.0), np.radians(85.0))


@given(steep, steep, turns)
def test_fused_like_angles_there_and_back(roll: float, pitch: float, yaw: float) -> None:
    """By the definition of section 2.2, on the columns: projections of Z on yz and xz, of Y on xy."""
    matrix = fused_matrix([roll, pitch, yaw])
    x, y, z = matrix.T
    assert abs(np.sin(roll) * z[2] + np.cos(roll) * z[1]) <= 4e-16
    assert abs(np.sin(pitch) * z[2] - np.cos(pitch) * z[0]) <= 4e-16
    assert abs(np.sin(yaw) * y[1] + np.cos(yaw) * y[0]) <= 4e-16
    assert z[2] > 0.0
    assert np.sin(yaw) * -y[0] + np.cos(yaw) * y[1] > 0.0
    assert np.abs(matrix.T @ matrix - np.eye(3)).max() <= 2e-15
    assert np.abs(np.cross(x, y) - z).max() <= 2e-15
    back = fused_angles(matrix)
    assert wrapped(back - [roll, pitch, yaw]).max() <= EXACT
    assert np.abs(fused_matrix(back) - matrix).max() <= EXACT


@given(steep, steep)
def test_a_tilt_does_not_see_a_turn_about_the_axis(roll: float, pitch: float) -> None:
    matrix = fused_matrix([roll, pitch, 0.3])
    for yaw in (-3.0, -1e-9, 2.0):
        spun = matrix @ rotation_exp([0.0, 0.0, yaw])
        assert np.abs(tilt(spun[:, 2]) - [roll, pitch]).max() <= EXACT
        assert np.abs(fused_angles(spun)[:2] - [roll, pitch]).max() <= EXACT


def test_half_turns() -> None:
    for axis in directions(200, 5):
        matrix = 2.0 * np.outer(axis, axis) - np.eye(3)
        found = rotation_log(matrix)
        assert abs(np.linalg.norm(found) - np.pi) <= EXACT
        assert found[np.argmax(np.abs(found))] > 0.0
        assert np.abs(rotation_exp(found) - matrix).max() <= EXACT


def test_one_angle_alone_is_the_same_in_every_representation() -> None:
    for axis in range(3):
        for angle in (-1.2, -1e-8, 0.0, 1e-3, 1.5):
            vector = angle * np.eye(3)[axis]
            matrix = rotation_exp(vector)
            for other in (fused_matrix(vector), euler_matrix(vector, "xyz"), euler_matrix(vector, "XYZ")):
                assert np.abs(other - matrix).max() <= 4e-16  # roundings of an entry
            assert np.abs(fused_angles(matrix) - vector).max() <= 4e-16


def test_leading_dimensions() -> None:
    given_angles = np.random.default_rng(6).uniform(-1.0, 1.0, (4, 5, 3))
    pairs: list[tuple[Callable[[Any], Any], Callable[[Any], Any]]] = [
        (rotation_exp, rotation_log),
        (fused_matrix, fused_angles),
        (lambda a: euler_matrix(a, "zyx"), lambda r: euler_angles(r, "zyx")),
    ]
    for there, back in pairs:
        matrices = there(given_angles)
        assert matrices.shape == (4, 5, 3, 3)
        assert not matrices.flags.writeable
        found = back(matrices)
        assert found.shape == (4, 5, 3)
        assert not found.flags.writeable
        for place in np.ndindex(4, 5):
            assert np.array_equal(there(given_angles[place]), matrices[place])
            assert np.abs(back(matrices[place]) - found[place]).max() <= 4e-16
    assert tilt(given_angles * [1, 1, 0] + [0, 0, 1]).shape == (4, 5, 2)
    assert composed(given_angles, given_angles[0, 0]).shape == (4, 5, 3)
    assert rotation_exp(np.zeros((0, 3))).shape == (0, 3, 3)
    assert rotation_log(np.zeros((0, 3, 3))).shape == (0, 3)


# Smooth through zero


def expressions() -> dict[str, tuple[Any, Any, Callable[[np.ndarray], np.ndarray]]]:
    """Every conversion as an SX expression of a rotation vector, and what NumPy makes of it."""
    v = ca.SX.sym("v", 3)
    turn = rotation_exp(v)
    fixed = np.array([1e-3, -2e-3, 5e-4])
    return {
        "exp": (v, ca.vec(turn), lambda x: rotation_exp(x).T.ravel()),
        "log": (v, rotation_log(turn), lambda x: rotation_log(rotation_exp(x))),
        "fused": (v, fused_angles(turn), lambda x: fused_angles(rotation_exp(x))),
        "from fused": (v, ca.vec(fused_matrix(v)), lambda x: fused_matrix(x).T.ravel()),
        "tilt": (v, tilt(turn[:, 2]), lambda x: tilt(rotation_exp(x)[:, 2])),
        "xyz": (v, euler_angles(turn, "xyz"), lambda x: euler_angles(rotation_exp(x), "xyz")),
        "from ZYX": (v, ca.vec(euler_matrix(v, "ZYX")), lambda x: euler_matrix(x, "ZYX").T.ravel()),
        "composed": (v, composed(v, ca.SX(fixed)), lambda x: composed(x, fixed)),
        "second order": (v, composed_approximately(v, ca.SX(fixed)), lambda x: composed_approximately(x, fixed)),
    }


@pytest.mark.parametrize("name", list(expressions()))
def test_casadi_is_numpy_and_smooth_through_zero(name: str) -> None:
    v, expression, numpy = expressions()[name]
    function = ca.Function("f", [v], [expression, ca.jacobian(expression, v)])
    for x in (np.zeros(3), *(size * d for size in (1e-300, 1e-12, 1e-6, 1e-3, 0.2, 0.9) for d in directions(5, 7))):
        value, slope = (np.asarray(one) for one in function(x))
        assert np.abs(value.ravel() - numpy(x)).max() <= 2e-15
        assert np.all(np.isfinite(slope))
        # Central differences of NumPy's across zero: of step h they are right to h² and to rounding over h.
        h = 1e-5
        differences = np.stack([(numpy(x + h * e) - numpy(x - h * e)) / (2.0 * h) for e in np.eye(3)], axis=-1)
        assert np.abs(slope - differences).max() <= 1e-9
    curvature = ca.Function("c", [v], [ca.jacobian(ca.jacobian(expression, v), v)])
    assert np.all(np.isfinite(np.asarray(curvature(0.0))))


@pytest.mark.parametrize("size", [1.0, 2.0, 2.9])
def test_casadi_is_numpy_far_from_zero(size: float) -> None:
    """What takes a matrix, and composition, up to where their descriptions say."""
    r, u, v = ca.SX.sym("r", 3, 3), ca.SX.sym("u", 3), ca.SX.sym("v", 3)
    log = ca.Function("log", [r], [rotation_log(r)])
    both = ca.Function("both", [u, v], [composed(u, v)])
    euler = {order: ca.Function("euler", [r], [euler_angles(r, order)]) for order in ORDERS}
    for axis in directions(20, 10):
        matrix = Rotation.from_rotvec(size * axis).as_matrix()
        assert np.abs(np.asarray(log(matrix)).ravel() - size * axis).max() <= EXACT
        assert np.abs(np.asarray(both(0.4 * size * axis, 0.6 * size * axis)).ravel() - size * axis).max() <= EXACT
        for order, function in euler.items():
            again = Rotation.from_euler(order, np.asarray(function(matrix)).ravel()).as_matrix()
            assert np.abs(again - matrix).max() <= EXACT


def test_derivatives_of_exp_at_zero() -> None:
    """∂R/∂v_i = E_i, ∂²R/∂v_i∂v_j = (E_i E_j + E_j E_i) / 2: the terms of the exponential series."""
    e = [np.cross(np.eye(3), axis) for axis in np.eye(3)]  # E_i v = e_i × v
    v = ca.SX.sym("v", 3)
    flat = ca.vec(rotation_exp(v))
    first = np.asarray(ca.Function("f", [v], [ca.jacobian(flat, v)])(0.0))
    second = ca.jacobian(ca.jacobian(flat, v), v)
    second = np.asarray(ca.Function("s", [v], [second])(0.0)).reshape(3, 9, 3)  # column-major: first index is v_i
    for i in range(3):
        assert np.array_equal(first[:, i].reshape(3, 3).T, e[i])
        for j in range(3):
            expected = (e[i] @ e[j] + e[j] @ e[i]) / 2.0
            assert np.abs(second[i, :, j].reshape(3, 3).T - expected).max() <= 1e-16


def test_no_step_at_zero() -> None:
    """Along a line through zero nothing jumps, down to the smallest numbers: every result has the digits of its argument."""
    along = np.array([0.6, -0.48, 0.64])
    for size in (*10.0 ** np.arange(-300.0, -2.0, 7.0), *-(10.0 ** np.arange(-300.0, -2.0, 7.0))):
        vector = size * along
        second_order = size * size  # fused-like and roll-pitch-yaw angles are the vector to first order
        assert np.abs(rotation_log(rotation_exp(vector)) - vector).max() <= 4e-16 * abs(size)
        for angles in (fused_angles(rotation_exp(vector)), euler_angles(rotation_exp(vector), "xyz")):
            assert np.abs(angles - vector).max() <= second_order + 4e-16 * abs(size)


# Refusals


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (lambda: rotation_log(np.eye(3) * 1.001), "no rotation"),
        (lambda: fused_angles(np.diag([1.0, 1.0, -1.0])), "mirror image"),
        (lambda: euler_angles(np.full((3, 3), np.nan), "xyz"), "no rotation"),
        (lambda: rotation_log(np.round(rotation_exp([0.1, 0.2, 0.3]), 5)), "no rotation"),
        (lambda: rotation_log(np.eye(4)), "wrong shape"),
        (lambda: rotation_exp([1.0, 2.0]), "wrong shape"),
        (lambda: rotation_exp([1.0, np.inf, 0.0]), "no number"),
        (lambda: rotation_exp(ca.SX.sym("x", 4)), "wrong shape"),
        (lambda: rotation_log(ca.SX.sym("x", 2, 2)), "wrong shape"),
        (lambda: euler_matrix([0.0, 0.0, 0.0], "xyZ"), "no order"),
        (lambda: euler_matrix([0.0, 0.0, 0.0], "xxy"), "no order"),
        (lambda: euler_angles(np.eye(3), "xyzx"), "no order"),
        (lambda: fused_angles(rotation_exp([2.0, 0.0, 0.0])), "point up"),
        (lambda: tilt([1.0, 0.0, 0.0]), "point up"),
        (lambda: fused_matrix([0.0, 1.6, 0.0]), "right angle"),
    ],
)
def test_refused(wrong: Callable[[], Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        wrong()


# What the paper prints


def test_eq_7_has_its_sign_wrong() -> None:
    """With Z as printed, Y of eq. 9 and 10 is not at right angles to it, nor does eq. 5 give θ back."""
    roll, pitch, yaw = 0.2, 0.3, 0.5
    y = [-np.sin(yaw), np.cos(yaw), np.sin(yaw) * np.tan(pitch) + np.cos(yaw) * np.tan(roll)]
    printed, mended = np.array([-np.tan(pitch), np.tan(roll), 1.0]), np.array([np.tan(pitch), -np.tan(roll), 1.0])
    assert abs(printed @ y) > 0.5
    assert abs(mended @ y) <= 2e-16
    assert np.arctan(-printed[1] / printed[2]) == pytest.approx(-roll)
    matrix = fused_matrix([roll, pitch, yaw])
    assert np.abs(np.cross(matrix[:, 2], mended)).max() <= 2e-16
    assert np.abs(np.cross(matrix[:, 1], y)).max() <= 4e-16


def test_eq_8_jumps_where_atan2_does_not() -> None:
    def printed(y1: float, y2: float) -> float:
        if y2 < 0.0:
            return np.pi - np.arctan(y1 / y2)
        return np.arctan(-y1 / y2) + (0.0 if y1 <= 0.0 else 2.0 * np.pi)

    assert printed(1e-9, 1.0) - printed(-1e-9, 1.0) == pytest.approx(2.0 * np.pi)
    below, above = (fused_angles(rotation_exp([0.0, 0.0, psi]))[2] for psi in (-1e-9, 1e-9))
    assert above - below == pytest.approx(2e-9, rel=1e-12)


def test_eq_11_loses_its_digits() -> None:
    """arccos(z'·Z) of 10 nrad of pitch; the same by `euler_angles`."""
    matrix = fused_matrix([1e-3, 1e-8, 0.0])
    turned = euler_matrix([1e-3, 0.0, 0.0], "XYZ")[:, 2]
    assert abs(np.arccos(min(turned @ matrix[:, 2], 1.0)) / 1e-8 - 1.0) > 0.1
    assert euler_angles(matrix, "XYZ")[1] == pytest.approx(1e-8 * np.cos(1e-3), rel=1e-14)


def pitch_difference(roll: float, pitch: float) -> float:
    return float(euler_angles(fused_matrix([roll, pitch, 0.0]), "XYZ")[1] - pitch)


def test_figure_8() -> None:
    """Roll-pitch-yaw less fused-like pitch; by tan φ' = tan φ cos θ (section 3.1) it is −φθ²/2 to third order."""
    assert pitch_difference(MRAD, MRAD) == pytest.approx(-0.5000 * NRAD, abs=5e-5 * NRAD)
    assert pitch_difference(10 * MRAD, MRAD) == pytest.approx(-50.0 * NRAD, abs=0.01 * NRAD)
    for roll in (0.1, 0.5, 1.2):
        for pitch in (-0.8, 0.3, 1.0):
            exact = np.arctan(np.tan(pitch) * np.cos(roll)) - pitch
            assert pitch_difference(roll, pitch) == pytest.approx(exact, abs=EXACT)
            assert euler_angles(fused_matrix([roll, pitch, 0.4]), "XYZ")[0] == pytest.approx(
                roll, abs=EXACT
            )  # the first is the same
    # "When the roll angles increase by one order of magnitude, the difference … will enlarge by two orders": holds.
    assert pitch_difference(10 * MRAD, MRAD) / pitch_difference(MRAD, MRAD) == pytest.approx(100.0, rel=1e-3)


def test_no_larger_than_a_nanoradian_holds_up_to_1_26_mrad_only() -> None:
    """Section 3.1: "about several mrad … no larger than 1 nrad"."""
    assert abs(pitch_difference(1.259 * MRAD, 1.259 * MRAD)) < NRAD
    assert abs(pitch_difference(1.261 * MRAD, 1.261 * MRAD)) > NRAD
    assert abs(pitch_difference(5 * MRAD, 5 * MRAD)) == pytest.approx(62.5 * NRAD, rel=1e-3)


def yaw_difference(roll: float, pitch: float, yaw: float) -> float:
    return float(euler_angles(fused_matrix([roll, pitch, yaw]), "XYZ")[2] - yaw)


def test_figure_9() -> None:
    """Roll-pitch-yaw less fused-like yaw; from Y: (φ² − θ²)ψ/2 − θφψ² to fourth order."""
    assert yaw_difference(MRAD, MRAD, 10 * MRAD) == pytest.approx(-0.100 * NRAD, abs=5e-5 * NRAD)
    # Roll and pitch are equal on every curve of the figure, where the larger term is zero: unequal, it is 150 times as much.
    assert yaw_difference(2 * MRAD, MRAD, 10 * MRAD) == pytest.approx(-15.2 * NRAD, abs=0.01 * NRAD)
    assert yaw_difference(MRAD, 2 * MRAD, 10 * MRAD) == pytest.approx(14.8 * NRAD, abs=0.01 * NRAD)


@pytest.mark.parametrize(
    ("steps", "printed", "digits"), [(10, (-54.83, 55.11, -54.83), 0.005), (100, (-4872.6, 5196.6, -4873.5), 0.05)]
)
def test_figure_10(steps: int, printed: tuple[float, ...], digits: float) -> None:
    """Steps of 1 mrad of roll, pitch and yaw (order of eq. 4), as fused-like angles, less their sum; µrad."""
    matrix = np.linalg.matrix_power(Rotation.from_euler("xyz", [MRAD] * 3).as_matrix(), steps)
    off = (fused_angles(matrix) - steps * MRAD) / URAD
    assert np.abs(off - printed).max() <= digits
    # Fused-like angles "overcome this disadvantage": their own steps do not add up either; rotation vectors' do.
    own = np.linalg.matrix_power(fused_matrix([MRAD] * 3), steps)
    assert np.abs(fused_angles(own) - steps * MRAD).max() / URAD > 0.5 * np.abs(printed).min()
    same = np.linalg.matrix_power(rotation_exp([MRAD] * 3), steps)
    assert np.abs(rotation_log(same) - steps * MRAD).max() <= EXACT


def test_composition_table() -> None:
    """Two rotations of 1 mrad in even directions, coordinates added: RMS error in µrad.

    The table (0.567, 0.567, 0.403, 9.6e-5) is of some drawn sample. Of all: √(1/3) for fused-like angles, whose errors are
    (−φ_b ψ_a, θ_b ψ_a, −φ_a θ_b) to second order, and for roll-pitch-yaw; √(1/6) for ½ |a × b|; √(4/3) / 12 for the third order of
    Baker, Campbell, Hausdorff.
    """
    n = 40_000
    a, b = MRAD * directions(n, 8), MRAD * directions(n, 9)
    both = composed(a, b)
    errors = {
        "fused": fused_angles(fused_matrix(a) @ fused_matrix(b)) - (a + b),
        "rpy": euler_angles(euler_matrix(a, "xyz") @ euler_matrix(b, "xyz"), "xyz") - (a + b),
        "vector": both - composed_approximately(a, b, terms=1),
        "second": both - composed_approximately(a, b),
    }
    table = {"fused": 0.567, "rpy": 0.567, "vector": 0.403, "second": 9.6e-5}
    limit = {"fused": 3**-0.5, "rpy": 3**-0.5, "vector": 6**-0.5, "second": 1e-3 * (4 / 3) ** 0.5 / 12}
    for name, rows in errors.items():
        # Squared errors scatter by less than their mean: 0.5 % of an RMS is 2 standard deviations and more of so many.
        assert rms(rows) / URAD == pytest.approx(limit[name], rel=5e-3)
        assert rms(rows) / URAD == pytest.approx(table[name], rel=0.025)
    second_order = np.stack([-b[:, 1] * a[:, 2], b[:, 0] * a[:, 2], -a[:, 1] * b[:, 0]], axis=1)
    assert np.abs(errors["fused"] - second_order).max() <= 10 * MRAD**3
    # "The addition and subtraction of the fused-like angles are commutative" (section 4): so rotations are not what is added.
    assert (
        rms(fused_angles(fused_matrix(a) @ fused_matrix(b)) - fused_angles(fused_matrix(b) @ fused_matrix(a)))
        > 0.5 * URAD
    )


def test_orders_differ_by_what_fused_like_angles_do_not_have() -> None:
    """The same three angles of 1 mrad in the six orders: spread of up to 1 µrad; the projections see one state, whatever the order."""
    matrices = [euler_matrix([MRAD] * 3, "".join(p)) for p in itertools.permutations("xyz")]
    states = np.array([fused_angles(matrix) for matrix in matrices])
    assert np.ptp(states, axis=0).max() / URAD == pytest.approx(1.0, rel=0.01)
    for matrix, state in zip(matrices, states, strict=True):
        for order in ("xyz", "ZYX", "zxz"):
            again = euler_matrix(euler_angles(matrix, order), order)
            assert np.abs(fused_angles(again) - state).max() <= EXACT
