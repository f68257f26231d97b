"""Orientation: rotation vectors, roll-pitch-yaw in any order, fused-like angles, matrices; conversions, composition.

Inside `twin` an error of orientation is a rotation vector (contract §1). Fused-like angles are how it is told: of a surface or a tool
axis they say how far it leans about x and about y, each seen along that axis, whatever the order in which it came to lean so.

Fused-like angles (θ, φ, ψ) follow D. Chang, P. Hu, J. Tan, "Fused-like angles: replacement for roll-pitch-yaw angles for a
six-degree-of-freedom grating interferometer", Front. Inform. Technol. Electron. Eng. 22 (2021) 1677-1685, with X, Y, Z the columns of
the matrix and these mistakes of the paper put right:

- eq. 7 and 13 have both signs of Z turned round: by eq. 5 and 6, and for eq. 10 to make Y ⊥ Z, it is Z ∥ [tan φ, −tan θ, 1];
- eq. 8 jumps by 2π where ψ passes zero, and leaves the range (−π, π] the text gives: ψ = atan2(−Y₁, Y₂);
- eq. 11 and 12 lose half of the digits of a small angle in an arccos: `euler_angles` has none;
- "no larger than 1 nrad" at "several mrad" (of the pitch, section 3.1): the difference −φθ²/2 passes 1 nrad at 1.26 mrad;
- eq. 13 and 14 add fused-like angles: that is no composition of rotations. Added, they miss it by as much as roll-pitch-yaw angles
  do, √2 times as far as rotation vectors (`composed_approximately`).

Every conversion is one formula on the entries and takes NumPy arrays, vectorised over leading dimensions, and CasADi SX expressions
(one rotation: (3, 1) and (3, 3); without branches) alike; where the two differ the function says so. Angles are in radians.
"""

from __future__ import annotations

import math
from typing import Any, Final, Literal

import casadi as ca
import numpy as np

from twin._common.arrays import locked
from twin._common.errors import InputError
from twin.numerics.elementary import arctan2, cos, sin, sqrt

SERIES_TERMS: Final = 9
"""Terms of the sine and cosine series of a small rotation: exact to double precision up to 1 rad; errors are < 0.2."""
ARCTAN_TERMS: Final = 8
"""Terms of the arctangent's series up to tan(π/32): the next is 5e-18 of the first."""
HALVINGS: Final = 3
"""That bring tan(θ/4), at most 1, below tan(π/32)."""
ORTHONORMAL: Final = 1e-9
"""How far RᵀR may be from the identity: a nanoradian, a thousandth of what is told; rounding along a chain is 1e-14."""
GIMBAL: Final = 4e-15
"""The sine of the distance from gimbal lock that counts as lock: 18 roundings of an entry."""


def rotation_exp(vector: Any) -> Any:
    """Exp: the matrix of a rotation vector (Rodrigues).

    Args:
        vector: (..., 3) axis times angle, rad, of any length; or an SX expression, of up to 1 rad: there the coefficients are series in
            the squared length, smooth through zero to any derivative.

    Raises:
        InputError: another shape, or a number that is not finite.
    """
    x, y, z = _vector(vector)
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


def rotation_log(matrix: Any) -> Any:
    """Log: the rotation vector of a matrix, of at most π; of a half turn the one whose largest component is positive.

    By way of the quaternion: no digits are lost, neither at zero nor at a half turn, and it is smooth below one. SX: below 3 rad.

    Args:
        matrix: (..., 3, 3) rotations, or SX.

    Returns:
        (..., 3) rad.

    Raises:
        InputError: a matrix that is no rotation.
    """
    return _row(_vector_of(_quaternion(_matrix(matrix))))


def euler_matrix(angles: Any, order: str) -> Any:
    """The matrix of three turns about the coordinate axes: roll-pitch-yaw in any order, and Euler's own.

    Args:
        angles: (..., 3) rad, in the order of the letters, or SX.
        order: three of the letters x, y, z, neighbours different. Small (``xyz``, extrinsic): about the axes that stand still, one
            after the other; capital (``XYZ``, intrinsic): about those that turn along. ``xyz`` is eq. 4 of the paper, and URDF's rpy.

    Raises:
        InputError: another order or shape, or a number that is not finite.
    """
    (i, j, k), intrinsic = _order(order)
    a, b, c = _vector(angles)
    turns = [_turn(i, a), _turn(j, b), _turn(k, c)]
    first, second, third = turns if intrinsic else turns[::-1]
    return _stacked(_product(_product(first, second), third))


def euler_angles(matrix: Any, order: str) -> Any:
    """The three angles of a matrix; the second within ±π/2 for three different letters, 0 to π where the first comes back.

    In gimbal lock (the second at ±π/2; at 0 or π) only the sum or difference of the others means anything: the last is zero, the first
    has all of it, and `euler_matrix` gives the matrix back as it does everywhere. SX: derivatives are not finite there.

    Args:
        matrix: (..., 3, 3) rotations, or SX.
        order: as of `euler_matrix`.

    Returns:
        (..., 3) rad, in the order of the letters.

    Raises:
        InputError: a matrix that is no rotation, another order.
    """
    (i, j, k), intrinsic = _order(order)
    r = _matrix(matrix)
    if not intrinsic:  # R = R_k(c) R_j(b) R_i(a), so Rᵀ = R_i(−a) R_j(−b) R_k(−c)
        r = [[r[q][p] for q in range(3)] for p in range(3)]
    proper = i == k
    other = 3 - i - j
    e = 1.0 if (j - i) % 3 == 1 else -1.0  # of (i, j, other): even or odd
    if proper:  # R_ii = cos b, R_ij = sin b sin c, R_i,other = e sin b cos c
        side = 1.0 if intrinsic else -1.0  # of sin b here, so that the second angle comes out positive
        across, along = side * r[i][j], side * e * r[i][other]
        off = sqrt(across * across + along * along)
        b = side * arctan2(off, r[i][i])
    else:  # R_ik = e sin b, R_ij = −e cos b sin c, R_ii = cos b cos c
        across, along = -e * r[i][j], r[i][i]
        off = sqrt(across * across + along * along)
        b = arctan2(e * r[i][k], off)
    c = arctan2(across, along)
    if not isinstance(c, ca.SX):
        c = np.where(off < GIMBAL, 0.0, c)
    # The first from what is left once the third is undone: so it stays well determined where both are not, one by one.
    beside, share = (other, -e * sin(c)) if proper else (i, e * sin(c))
    column = [cos(c) * r[p][j] + share * r[p][beside] for p in range(3)]
    a = arctan2(e * column[other], column[j])
    return _row([a, b, c] if intrinsic else [-a, -b, -c])


def fused_matrix(angles: Any) -> Any:
    """The matrix of fused-like angles.

    Eq. 7, 9 and 10 with the sign of eq. 7 put right, times cos θ cos φ so that nothing grows:
    Z ∥ [sin φ cos θ, −sin θ cos φ, cos θ cos φ].

    Args:
        angles: (..., 3) θ, φ within (−π/2, π/2) and ψ, rad, or SX.

    Raises:
        InputError: θ or φ at or beyond a right angle, another shape, a number that is not finite.
    """
    roll, pitch, yaw = _vector(angles)
    if not isinstance(roll, ca.SX):
        steep = (np.abs(roll) >= np.pi / 2) | (np.abs(pitch) >= np.pi / 2)
        if np.any(steep):
            where = np.unravel_index(np.argmax(steep), steep.shape)
            worst = max(abs(float(roll[where])), abs(float(pitch[where])))
            raise InputError("fused-like angles of a right angle or more", expected="θ and φ below π/2", value=worst)
    level = cos(roll) * cos(pitch)
    z = _unit([sin(pitch) * cos(roll), -sin(roll) * cos(pitch), level])
    rise = sin(yaw) * sin(pitch) * cos(roll) + cos(yaw) * sin(roll) * cos(pitch)
    y = _unit([-sin(yaw) * level, cos(yaw) * level, rise])
    x = [y[1] * z[2] - y[2] * z[1], y[2] * z[0] - y[0] * z[2], y[0] * z[1] - y[1] * z[0]]
    return _stacked([[x[p], y[p], z[p]] for p in range(3)])


def fused_angles(matrix: Any) -> Any:
    """Fused-like angles of a matrix: θ and φ of its z axis as `tilt`, ψ of its y axis seen along z (eq. 5, 6, 8).

    Their digits go with cos θ and cos φ: to 1e-14 up to 85°.

    Args:
        matrix: (..., 3, 3) rotations, or SX.

    Returns:
        (..., 3) θ, φ in (−π/2, π/2) and ψ in (−π, π], rad.

    Raises:
        InputError: a matrix that is no rotation, or whose z axis does not point up.
    """
    r = _matrix(matrix)
    return _row([*_leaning([r[p][2] for p in range(3)]), arctan2(-r[0][1], r[1][1])])


def tilt(axis: Any) -> Any:
    """Fused-like angles of an axis, or of the surface it is normal to: how it leans about x and about y (eq. 5, 6).

    Two numbers: what turns about the axis itself does not move it.

    Args:
        axis: (..., 3) of any length, near z: its z component positive; or SX.

    Returns:
        (..., 2) θ = atan2(−Z₂, Z₃) about x, φ = atan2(Z₁, Z₃) about y, rad.

    Raises:
        InputError: an axis that does not point up, another shape, a number that is not finite.
    """
    return _row(_leaning(_vector(axis)))


def composed(first: Any, second: Any) -> Any:
    """The rotation vector of Exp(first) · Exp(second), by quaternions: small ones lose no digits.

    Args:
        first: (..., 3) rad, or SX of up to 2 rad, both together below 3.
        second: as ``first``, and it broadcasts with it.

    Returns:
        (..., 3) rad, of at most π.

    Raises:
        InputError: another shape, or a number that is not finite.
    """
    a, u = _half(_vector(first))
    b, v = _half(_vector(second))
    w = a * b - (u[0] * v[0] + u[1] * v[1] + u[2] * v[2])
    cross = _cross(u, v)
    part = [a * v[p] + b * u[p] + cross[p] for p in range(3)]
    if not isinstance(w, ca.SX):
        sign = np.where(w < 0.0, -1.0, 1.0)
        w, part = w * sign, [sign * one for one in part]
    return _row(_vector_of((w, part)))


def composed_approximately(first: Any, second: Any, terms: Literal[1, 2] = 2) -> Any:
    """The same to first or second order (Baker, Campbell, Hausdorff): a + b, or a + b + a × b / 2.

    Off by ½ |a × b| and by some |a| |b| (|a| + |b|) / 12: of two errors of 1 mrad 0.4 µrad and 0.1 nrad.

    Args:
        first: (..., 3) rad, or SX.
        second: as ``first``, and it broadcasts with it.
        terms: 1 or 2.

    Raises:
        InputError: another shape, or a number that is not finite.
    """
    a, b = _vector(first), _vector(second)
    total = [a[p] + b[p] for p in range(3)]
    if terms == 2:
        cross = _cross(a, b)
        total = [total[p] + 0.5 * cross[p] for p in range(3)]
    return _row(total)


def cross_matrix(vectors: np.ndarray) -> np.ndarray:
    """(n, 3, 3) matrices of ``v ×`` of (n, 3) vectors."""
    found = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    found[:, 0, 1], found[:, 0, 2], found[:, 1, 2] = -z, y, -x
    found[:, 1, 0], found[:, 2, 0], found[:, 2, 1] = z, -y, x
    return found


def _sine(square: Any) -> Any:
    """Of t²: sin t / t."""
    if isinstance(square, ca.SX):
        return _series(square, 1)
    t = np.sqrt(square)
    some = np.where(t == 0.0, 1.0, t)
    return np.where(t == 0.0, 1.0, np.sin(some) / some)


def _cosine(square: Any) -> Any:
    """Of t²: (1 − cos t) / t²; without the difference, half the square of the other at half the angle."""
    return _series(square, 2) if isinstance(square, ca.SX) else 0.5 * _sine(0.25 * square) ** 2


def _series(square: Any, first: int) -> Any:
    """Σ (−s)^k / (2k + first)! by Horner: the coefficients of Rodrigues' formula, and cos t for 0."""
    total: Any = 1.0
    for k in range(SERIES_TERMS - 1, 0, -1):
        total = 1.0 - square * total / ((2 * k + first) * (2 * k + first - 1))
    return total / math.factorial(first)


def _half(vector: list[Any]) -> tuple[Any, list[Any]]:
    """The quaternion of a rotation vector: scalar and vector part."""
    quarter = 0.25 * (vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])  # the half angle, squared
    scalar = _series(quarter, 0) if isinstance(quarter, ca.SX) else np.cos(np.sqrt(quarter))
    half = 0.5 * _sine(quarter)
    return scalar, [half * one for one in vector]


def _vector_of(quaternion: tuple[Any, list[Any]]) -> list[Any]:
    """The rotation vector of a unit quaternion whose scalar is not negative.

    tan(θ/4) = |q| / (1 + w), so the vector is q · 4/(1 + w) · arctan(t)/t of that t: a function of t², smooth everywhere.
    """
    w, part = quaternion
    root = 1.0 + w
    square = (part[0] * part[0] + part[1] * part[1] + part[2] * part[2]) / (root * root)
    factor = 4.0 / root
    for _ in range(HALVINGS):  # arctan t = 2 arctan(t / (1 + √(1 + t²)))
        root = 1.0 + sqrt(1.0 + square)
        square, factor = square / (root * root), 2.0 * factor / root
    total: Any = 0.0
    for k in range(ARCTAN_TERMS - 1, -1, -1):
        total = 1.0 / (2 * k + 1) - square * total
    return [factor * total * one for one in part]


def _quaternion(r: list[list[Any]]) -> tuple[Any, list[Any]]:
    """The unit quaternion of a matrix, its scalar not negative (S. W. Shepperd, J. Guidance and Control 1 (1978) 223)."""
    axis = [r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]]
    trace = r[0][0] + r[1][1] + r[2][2]
    if isinstance(trace, ca.SX):
        twice = sqrt(1.0 + trace)
        return 0.5 * twice, [one / (2.0 * twice) for one in axis]
    # Products 4 q_i q_j; the row of the largest q_i, so that nothing small is divided by.
    products = np.empty((*trace.shape, 4, 4))
    products[..., 0, 0] = 1.0 + trace
    for p in range(3):
        products[..., 0, p + 1] = products[..., p + 1, 0] = axis[p]
        products[..., p + 1, p + 1] = 1.0 + 2.0 * r[p][p] - trace
        for q in range(p):
            products[..., p + 1, q + 1] = products[..., q + 1, p + 1] = r[p][q] + r[q][p]
    largest = np.argmax(np.diagonal(products, axis1=-2, axis2=-1), axis=-1)[..., None]
    row = np.take_along_axis(products, largest[..., None], axis=-2)[..., 0, :]
    row = row / (2.0 * np.sqrt(np.take_along_axis(row, largest, axis=-1)))
    row = np.where(row[..., :1] < 0.0, -row, row)
    return row[..., 0], [row[..., p] for p in (1, 2, 3)]


def _leaning(z: list[Any]) -> list[Any]:
    if not isinstance(z[2], ca.SX) and np.any(z[2] <= 0.0):
        raise InputError(
            "an axis that does not point up has no fused-like angles",
            expected="a positive z component",
            value=float(np.min(z[2])),
        )
    return [arctan2(-z[1], z[2]), arctan2(z[0], z[2])]


def _turn(axis: int, angle: Any) -> list[list[Any]]:
    """Entries of a turn about a coordinate axis (eq. 1 to 3)."""
    p, q = (axis + 1) % 3, (axis + 2) % 3
    entries: list[list[Any]] = [[float(i == j) for j in range(3)] for i in range(3)]
    entries[p][p] = entries[q][q] = cos(angle)
    entries[q][p] = sin(angle)
    entries[p][q] = -entries[q][p]
    return entries


def _product(a: list[list[Any]], b: list[list[Any]]) -> list[list[Any]]:
    return [[a[p][0] * b[0][q] + a[p][1] * b[1][q] + a[p][2] * b[2][q] for q in range(3)] for p in range(3)]


def _cross(a: list[Any], b: list[Any]) -> list[Any]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _unit(vector: list[Any]) -> list[Any]:
    length = sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])
    return [one / length for one in vector]


def _order(order: str) -> tuple[tuple[int, int, int], bool]:
    """Indices of the axes, and whether they turn along."""
    letters = order.lower()
    whole = len(order) == 3 and order in (letters, order.upper()) and set(letters) <= set("xyz")
    if not whole or letters[0] == letters[1] or letters[1] == letters[2]:
        raise InputError(
            "no order of three turns",
            expected="three of x, y, z, neighbours different: xyz about fixed axes, XYZ about turning ones",
            value=order,
        )
    i, j, k = ("xyz".index(letter) for letter in letters)
    return (i, j, k), order != letters


def _vector(vector: Any) -> list[Any]:
    """The three components."""
    if isinstance(vector, ca.SX):
        if vector.numel() != 3:
            raise InputError("a vector of the wrong shape", expected="(3, 1)", value=vector.shape)
        return [vector[p] for p in range(3)]
    array = np.asarray(vector, dtype=float)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise InputError("a vector of the wrong shape", expected="(..., 3)", value=array.shape)
    if not np.all(np.isfinite(array)):
        raise InputError("a component that is no number", expected="finite ones", value=array[~np.isfinite(array)][0])
    return [array[..., p] for p in range(3)]


def _matrix(matrix: Any) -> list[list[Any]]:
    """The entries, row by row, of what is a rotation."""
    if isinstance(matrix, ca.SX):
        if matrix.shape != (3, 3):
            raise InputError("a matrix of the wrong shape", expected="(3, 3)", value=matrix.shape)
        return [[matrix[p, q] for q in range(3)] for p in range(3)]
    array = np.asarray(matrix, dtype=float)
    if array.ndim < 2 or array.shape[-2:] != (3, 3):
        raise InputError("a matrix of the wrong shape", expected="(..., 3, 3)", value=array.shape)
    off = np.abs(np.swapaxes(array, -1, -2) @ array - np.eye(3)).max(initial=0.0)
    if not off <= ORTHONORMAL:  # NaN as well
        raise InputError(
            "a matrix that is no rotation",
            expected=f"columns of length one at right angles, to {ORTHONORMAL:g}",
            value=f"off by {off:.2g}",
        )
    if np.any(np.linalg.det(array) < 0.0):
        raise InputError("a matrix that is no rotation", expected="a right-handed one", value="a mirror image")
    return [[array[..., p, q] for q in range(3)] for p in range(3)]


def _row(components: list[Any]) -> Any:
    if any(isinstance(one, ca.SX) for one in components):
        return ca.vertcat(*components)
    return locked(np.stack(components, axis=-1))


def _stacked(rows: list[list[Any]]) -> Any:
    if any(isinstance(one, ca.SX) for row in rows for one in row):
        return ca.vertcat(*[ca.horzcat(*row) for row in rows])
    flat = np.stack(np.broadcast_arrays(*[one for row in rows for one in row]), axis=-1)
    return locked(flat.reshape(*flat.shape[:-1], 3, 3))
