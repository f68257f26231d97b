"""Orientation: conversions against other formulations, smoothness at zero, and the printed results of the paper on fused-like angles.

Truths: scipy's Rotation (quaternions), the power series of the matrix exponential in 50 decimal digits, formulas derived here.
Paper: D. Chang, P. Hu, J. Tan, Front. Inform. Technol. Electron. Eng. 22 (2021) 1677-1685.
"""

from __future__ import annotations

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
from twin.numerics.spatial import fused_angles, rotation_exp, rotation_log, tilt

EXACT = 1e-14
"""Max norm of matrices, largest difference of angles: what is promised."""
MRAD, URAD = 1e-3, 1e-6

vectors = st.builds(
    lambda height, azimuth, size: (
        10.0**size * np.array([*(np.sqrt(1.0 - height**2) * np.array([np.cos(azimuth), np.sin(azimuth)])), height])
    ),
    st.floats(-1.0, 1.0),
    st.floats(-np.pi, np.pi),
    st.floats(-15.0, np.log10(3.1415926)),
)
turns = st.floats(-np.pi, np.pi)
steep = st.floats(-np.radians(85.0), np.radians(85.0))


def wrapped(angle: np.ndarray) -> np.ndarray:
    return np.abs((angle + np.pi) % (2 * np.pi) - np.pi)


def fused_matrix(angles: Any) -> np.ndarray:
    """Return the matrix of fused-like angles (3,): eq. 7 with its sign corrected, 9 and 10."""
    roll, pitch, yaw = angles
    z = np.array([np.tan(pitch), -np.tan(roll), 1.0])
    y = np.array([-np.sin(yaw), np.cos(yaw), np.sin(yaw) * np.tan(pitch) + np.cos(yaw) * np.tan(roll)])
    y, z = y / np.linalg.norm(y), z / np.linalg.norm(z)
    return np.stack([np.cross(y, z), y, z], axis=1)


def directions(n: int, seed: int) -> np.ndarray:
    """Return directions (n, 3) evenly distributed over the sphere."""
    drawn = np.random.default_rng(seed).normal(size=(n, 3))
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


def precise(vector: Any) -> np.ndarray:
    """Return Exp as (3, 3) Decimals to 50 digits, by the series Σ K^n / n!."""
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


# Conversions


@given(vectors)
def test_exp_and_log_against_the_power_series(vector: np.ndarray) -> None:
    exact = precise(vector).astype(float)
    assert np.abs(rotation_exp(vector) - exact).max() <= 1e-15  # a few roundings of an entry
    # Relative to its length: a vector of 1e-12 rad comes back with its digits.
    back = rotation_log(exact)
    assert np.linalg.norm(back - vector) <= 4e-15 * np.linalg.norm(vector) + 1e-300


def test_exp_of_small_vectors_keeps_its_second_order() -> None:
    """R_ij + R_ji = v_i v_j to fourth order; a difference 1 − cos t would cancel."""
    for size in (1e-3, 1e-5, 1e-7):
        x, y, z = vector = size * np.array([0.6, -0.48, 0.64])
        matrix = rotation_exp(vector)
        found = [matrix[p, q] + matrix[q, p] for p, q in ((0, 1), (0, 2), (1, 2))]
        # Entries of the size of the vector are rounded, sums of the size of its square remain.
        assert np.abs(np.array(found) - [x * y, x * z, y * z]).max() <= 4e-16 * size + size**4


steep = st.floats(-np.radians(85.0), np.radians(85.0))


@given(steep, steep, turns)
def test_fused_like_angles_there_and_back(roll: float, pitch: float, yaw: float) -> None:
    """By the definition of section 2.2, on the columns: projections of Z on yz and xz, of Y on xy."""
    matrix = fused_matrix([roll, pitch, yaw])
    _, y, z = matrix.T
    assert abs(np.sin(roll) * z[2] + np.cos(roll) * z[1]) <= 4e-16
    assert abs(np.sin(pitch) * z[2] - np.cos(pitch) * z[0]) <= 4e-16
    assert abs(np.sin(yaw) * y[1] + np.cos(yaw) * y[0]) <= 4e-16
    assert wrapped(fused_angles(matrix) - [roll, pitch, yaw]).max() <= EXACT


@given(steep, steep)
def test_a_tilt_is_independent_of_a_rotation_about_the_axis(roll: float, pitch: float) -> None:
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
        assert np.abs(rotation_exp(found) - matrix).max() <= EXACT


def test_one_angle_alone_is_the_same_in_every_representation() -> None:
    for axis in range(3):
        for angle in (-1.2, -1e-8, 0.0, 1e-3, 1.5):
            vector = angle * np.eye(3)[axis]
            matrix = rotation_exp(vector)
            assert np.abs(Rotation.from_rotvec(vector).as_matrix() - matrix).max() <= 4e-16  # roundings of an entry
            assert np.abs(fused_angles(matrix) - vector).max() <= 4e-16


def test_leading_dimensions() -> None:
    given_angles = np.random.default_rng(6).uniform(-1.0, 1.0, (4, 5, 3))
    matrices = rotation_exp(given_angles)
    assert matrices.shape == (4, 5, 3, 3)
    assert not matrices.flags.writeable
    for back in (rotation_log, fused_angles):
        found = back(matrices)
        assert found.shape == (4, 5, 3)
        assert not found.flags.writeable
        for place in np.ndindex(4, 5):
            assert np.array_equal(rotation_exp(given_angles[place]), matrices[place])
            assert np.abs(back(matrices[place]) - found[place]).max() <= 4e-16
    assert tilt(given_angles * [1, 1, 0] + [0, 0, 1]).shape == (4, 5, 2)
    assert rotation_exp(np.zeros((0, 3))).shape == (0, 3, 3)
    assert rotation_log(np.zeros((0, 3, 3))).shape == (0, 3)


# Smooth through zero


@pytest.mark.parametrize("fused", [False, True])
def test_casadi_is_numpy_and_smooth_through_zero(fused: bool) -> None:
    v = ca.SX.sym("v", 3)
    expression = fused_angles(rotation_exp(v)) if fused else ca.vec(rotation_exp(v))
    slope = ca.jacobian(expression, v)
    function = ca.Function("f", [v], [expression, slope])

    def flat(x: np.ndarray) -> np.ndarray:
        return fused_angles(rotation_exp(x)) if fused else rotation_exp(x).T.ravel()

    for x in (np.zeros(3), *(size * d for size in (1e-300, 1e-12, 1e-6, 1e-3, 0.1, 0.3) for d in directions(5, 7))):
        value, rate = (np.asarray(one) for one in function(x))
        assert np.abs(value.ravel() - flat(x)).max() <= 2e-15
        # Central differences of NumPy's across zero: of step h they are right to h² and to rounding over h.
        h = 1e-5
        differences = np.stack([(flat(x + h * e) - flat(x - h * e)) / (2.0 * h) for e in np.eye(3)], axis=-1)
        assert np.abs(rate - differences).max() <= 1e-9
    assert np.all(np.isfinite(np.asarray(ca.Function("c", [v], [ca.jacobian(slope, v)])(0.0))))


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
    """Along a line through zero all results are continuous and accurate to rounding, down to the smallest numbers."""
    along = np.array([0.6, -0.48, 0.64])
    for size in (*10.0 ** np.arange(-300.0, -2.0, 7.0), *-(10.0 ** np.arange(-300.0, -2.0, 7.0))):
        vector = size * along
        second_order = size * size  # fused-like angles are the vector to first order
        assert np.abs(rotation_log(rotation_exp(vector)) - vector).max() <= 4e-16 * abs(size)
        assert np.abs(fused_angles(rotation_exp(vector)) - vector).max() <= second_order + 4e-16 * abs(size)


# Refusals


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (lambda: rotation_log(np.eye(3) * 1.001), "not a rotation"),
        (lambda: fused_angles(np.diag([1.0, 1.0, -1.0])), "mirror image"),
        (lambda: rotation_log(np.full((3, 3), np.nan)), "not a rotation"),
        (lambda: rotation_log(np.round(rotation_exp([0.1, 0.2, 0.3]), 5)), "not a rotation"),
        (lambda: rotation_log(np.eye(4)), "wrong shape"),
        (lambda: rotation_exp([1.0, 2.0]), "wrong shape"),
        (lambda: rotation_exp([1.0, np.inf, 0.0]), "not finite"),
        (lambda: rotation_exp(ca.SX.sym("x", 4)), "wrong shape"),
        (lambda: fused_angles(ca.SX.sym("x", 2, 2)), "wrong shape"),
        (lambda: fused_angles(rotation_exp([2.0, 0.0, 0.0])), "point up"),
        (lambda: tilt([1.0, 0.0, 0.0]), "point up"),
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
