"""Orientation: rotation vectors, fused-like angles, matrices.

Inside `twin` an orientation error is a rotation vector (contract §1). It is reported in fused-like angles: the tilt of a surface or a
tool axis about x and about y, each seen along that axis, independent of any order of rotations.

Fused-like angles (θ, φ, ψ) follow D. Chang, P. Hu, J. Tan, "Fused-like angles: replacement for roll-pitch-yaw angles for a
six-degree-of-freedom grating interferometer", Front. Inform. Technol. Electron. Eng. 22 (2021) 1677-1685, with X, Y, Z the columns of
the matrix and these errors of the paper corrected:

- eq. 7 and 13 have both signs of Z reversed: by eq. 5 and 6, and for eq. 10 to make Y ⊥ Z, it is Z ∥ [tan φ, −tan θ, 1];
- eq. 8 jumps by 2π where ψ passes zero, and leaves the range (−π, π] the text gives: ψ = atan2(−Y₁, Y₂);
- eq. 13 and 14 add fused-like angles: that is no composition of rotations.

`rotation_exp` and `fused_angles` take NumPy arrays, vectorised over leading dimensions, and CasADi SX expressions; the others take
arrays. Angles are in radians.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, Final

import casadi as ca
import numpy as np
import scipy

from twin._common.arrays import read_only
from twin._common.errors import InputError

SERIES_TERMS: Final = 6
"""Terms of the sine and cosine series of a small rotation: exact to double precision up to 0.3 rad, three times the largest angle that
a calibration may have (`twin.model.calibration.LARGEST_ANGLE_URAD`). They are a tenth of the operations of a pose.
"""
ORTHONORMAL: Final = 1e-9
"""Tolerance of RᵀR against the identity: a nanoradian, a thousandth of the last digit reported; rounding along a chain is 1e-14."""


def rotation_exp(vector: Any) -> Any:
    """Return the rotation matrix (..., 3, 3) of a rotation vector (..., 3), axis times angle in rad (exponential map, Rodrigues).

    An SX expression may be up to 0.3 rad: there the coefficients are series in the squared length, smooth through zero to any
    derivative.

    Raises:
        InputError: another shape, or a number that is not finite.
    """
    if isinstance(vector, ca.SX) and vector.numel() == 3:
        return _expression()(vector)
    return _rodrigues(*_vector(vector))


@cache
def _expression() -> ca.Function:
    """Return the map as a CasADi function; calling it is faster than building its expressions anew."""
    v = ca.SX.sym("v", 3)
    return ca.Function("rotation_exp", [v], [_rodrigues(*ca.vertsplit(v))])


def _rodrigues(x: Any, y: Any, z: Any) -> Any:
    """Return the rotation matrix of the components of a rotation vector."""
    square = x * x + y * y + z * z
    sine, cosine = _sine(square), _cosine(square)
    xx, yy, zz = x * x, y * y, z * z
    xc, yc = cosine * x, cosine * y
    xy, xz, yz = xc * y, xc * z, yc * z
    xs, ys, zs = sine * x, sine * y, sine * z
    return _stacked(
        [
            [1.0 - cosine * (yy + zz), xy - zs, xz + ys],
            [xy + zs, 1.0 - cosine * (xx + zz), yz - xs],
            [xz - ys, yz + xs, 1.0 - cosine * (xx + yy)],
        ]
    )


def rotation_log(matrix: Any) -> np.ndarray:
    """Return the rotation vectors (..., 3), of length at most π, of matrices (..., 3, 3) (logarithmic map), accurate to rounding.

    Raises:
        InputError: a matrix that is not a rotation.
    """
    r = _matrix(matrix)
    flat = r.reshape(-1, 3, 3)
    vectors = scipy.spatial.transform.Rotation.from_matrix(flat).as_rotvec() if len(flat) else np.zeros((0, 3))
    return read_only(vectors.reshape(r.shape[:-1]))


def fused_angles(matrix: Any) -> Any:
    """Return the fused-like angles (..., 3) of a matrix: θ and φ of its z axis as in `tilt`, ψ of its y axis seen along z (eq. 5-8).

    θ, φ in (−π/2, π/2), ψ in (−π, π], rad. The rounding error grows with 1/cos θ and 1/cos φ; it is below 1e-14 up to 85°. An SX
    expression (3, 3) is not checked to be a rotation.

    Raises:
        InputError: a matrix that is not a rotation, or whose z axis does not point up.
    """
    if isinstance(matrix, ca.SX):
        if matrix.shape != (3, 3):
            raise InputError("wrong shape of a matrix", expected="(3, 3)", value=matrix.shape)
        x, y, z = (matrix[p, 2] for p in range(3))
        return ca.vertcat(ca.atan2(-y, z), ca.atan2(x, z), ca.atan2(-matrix[0, 1], matrix[1, 1]))
    r = _matrix(matrix)
    turn = np.arctan2(-r[..., 0, 1], r[..., 1, 1])
    return read_only(np.concatenate([tilt(r[..., 2]), turn[..., None]], axis=-1))


def tilt(axis: Any) -> np.ndarray:
    """Return the tilt (..., 2) of an axis (..., 3) of any length about x and about y, θ = atan2(−Z₂, Z₃), φ = atan2(Z₁, Z₃) (eq. 5, 6).

    The axis is near z. Two numbers suffice, since a rotation about the axis itself does not change it.

    Raises:
        InputError: an axis that does not point up, another shape, a number that is not finite.
    """
    x, y, z = _vector(axis)
    if np.any(z <= 0.0):
        raise InputError(
            "an axis that does not point up has no fused-like angles",
            expected="a positive z component",
            value=float(np.min(z)),
        )
    return read_only(np.stack([np.arctan2(-y, z), np.arctan2(x, z)], axis=-1))


def cross_matrix(vectors: np.ndarray) -> np.ndarray:
    """Return the matrices (n, 3, 3) of the cross product ``v ×`` of (n, 3) vectors."""
    cross_matrix = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    cross_matrix[:, 0, 1], cross_matrix[:, 0, 2], cross_matrix[:, 1, 2] = -z, y, -x
    cross_matrix[:, 1, 0], cross_matrix[:, 2, 0], cross_matrix[:, 2, 1] = z, -y, x
    return cross_matrix


def rigid_rates(points: np.ndarray) -> np.ndarray:
    """Return the derivatives (n, 3, 6) of (n, 3) points by a small shift and rotation of them all: e + ω × p."""
    return np.concatenate([np.broadcast_to(np.eye(3), (len(points), 3, 3)), -cross_matrix(points)], axis=2)


def rigid_fit(points: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (n, 3) points moved rigidly as near as possible to places, and the rotation (Kabsch 1976, Acta Cryst. A32, 922)."""
    centre, own = place.mean(axis=0), points - points.mean(axis=0)
    u, _, v = np.linalg.svd(own.T @ (place - centre))
    turn = v.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(v.T @ u.T))]) @ u.T
    return own @ turn.T + centre, turn


def shape_contrasts(place: np.ndarray) -> np.ndarray:
    """Return (3n, r) orthonormal changes of n places that no rigid motion makes."""
    own = place - place.mean(axis=0)
    motion = rigid_rates(own / (float(np.abs(own).max(initial=0.0)) or 1.0))
    left, values, _ = np.linalg.svd(motion.reshape(-1, 6), full_matrices=True)
    return np.asarray(left[:, int(np.count_nonzero(values > 1e-9 * values[0])) :])


def algebraic_sphere(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Return centre (k,) and radius of the circle (k = 2) or sphere (k = 3) through (n, k) points by algebraic least squares (Kåsa).

    The radius is infinite for points on a line or plane.
    """
    middle = points.mean(axis=0)
    local = points - middle
    design = np.column_stack([2.0 * local, np.ones(len(local))])
    solution, _, rank, _ = np.linalg.lstsq(design, (local**2).sum(axis=1), rcond=1e-9)
    if rank < design.shape[1]:
        return middle, float("inf")
    centre = solution[:-1]
    return middle + centre, float(np.sqrt(max(solution[-1] + centre @ centre, 0.0)))


def _sine(square: Any) -> Any:
    """Return sin t / t as a function of t²."""
    if isinstance(square, ca.SX):
        return _series(square, 1)
    t = np.sqrt(square)
    some = np.where(t == 0.0, 1.0, t)
    return np.where(t == 0.0, 1.0, np.sin(some) / some)


def _cosine(square: Any) -> Any:
    """Return (1 − cos t) / t² as a function of t², computed as ½ (sin(t/2) / (t/2))² to avoid cancellation."""
    return _series(square, 2) if isinstance(square, ca.SX) else 0.5 * _sine(0.25 * square) ** 2


def _series(square: Any, first: int) -> Any:
    """Return Σ (−s)^k / (2k + first)! by Horner's scheme: coefficients of Rodrigues' formula (cos t for first = 0)."""
    total: Any = 0.0
    for k in reversed(range(SERIES_TERMS)):
        total = (-1) ** k / math.factorial(2 * k + first) + square * total
    return total


def _vector(vector: Any) -> list[Any]:
    """Return the three components, checked."""
    if isinstance(vector, ca.SX):
        if vector.numel() != 3:
            raise InputError("wrong shape of a vector", expected="(3, 1)", value=vector.shape)
        return [vector[p] for p in range(3)]
    array = np.asarray(vector, dtype=float)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise InputError("wrong shape of a vector", expected="(..., 3)", value=array.shape)
    if not np.all(np.isfinite(array)):
        raise InputError("a component is not finite", expected="finite numbers", value=array[~np.isfinite(array)][0])
    return [array[..., p] for p in range(3)]


def _matrix(matrix: Any) -> np.ndarray:
    """Return the array (..., 3, 3), checked to contain rotations."""
    array = np.asarray(matrix, dtype=float)
    if array.ndim < 2 or array.shape[-2:] != (3, 3):
        raise InputError("wrong shape of a matrix", expected="(..., 3, 3)", value=array.shape)
    off = np.abs(np.swapaxes(array, -1, -2) @ array - np.eye(3)).max(initial=0.0)
    if not off <= ORTHONORMAL:  # NaN as well
        raise InputError(
            "a matrix is not a rotation", expected=f"orthonormal columns, to {ORTHONORMAL:g}", value=f"off by {off:.2g}"
        )
    if np.any(np.linalg.det(array) < 0.0):
        raise InputError("a matrix is not a rotation", expected="a right-handed one", value="a mirror image")
    return array


def _stacked(rows: list[list[Any]]) -> Any:
    if any(isinstance(one, ca.SX) for row in rows for one in row):
        return ca.vertcat(*[ca.horzcat(*row) for row in rows])
    flat = np.stack(np.broadcast_arrays(*[one for row in rows for one in row]), axis=-1)
    return read_only(flat.reshape(*flat.shape[:-1], 3, 3))
