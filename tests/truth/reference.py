"""A second implementation of the DMU 50, in plain numpy from the conventions alone: it shares no code with `twin`.

Units: mm and radians; errors in mm and radians.
"""

from __future__ import annotations

import numpy as np

D = 154.996


def translation(x: float, y: float, z: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def about(axis: int, angle: float) -> np.ndarray:
    matrix = np.eye(4)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    matrix[i, i] = matrix[j, j] = np.cos(angle)
    matrix[j, i], matrix[i, j] = np.sin(angle), -np.sin(angle)
    return matrix


def error_frame(six: np.ndarray) -> np.ndarray:
    """Return Trans(e)·Exp(w), by Rodrigues' formula."""
    w = np.asarray(six[3:], dtype=float)
    angle = np.linalg.norm(w)
    matrix = translation(*six[:3])
    if angle > 0:
        n = w / angle
        cross = np.array([[0, -n[2], n[1]], [n[2], 0, -n[0]], [-n[1], n[0], 0]])
        matrix[:3, :3] = np.eye(3) + np.sin(angle) * cross + 2 * np.sin(angle / 2) ** 2 * cross @ cross
    return matrix


def dmu50_pose(q: np.ndarray, errors: dict[str, np.ndarray], tool_length: float = 0.0) -> np.ndarray:
    """Return work⁻¹ · tool.

    q: X, Y, Z in mm, B, C in radians. errors: six numbers for X, Y, Z, B, C and for L_B, L_C; absent = zero.
    """
    x, y, z, b, c = q

    def e(name: str) -> np.ndarray:
        return error_frame(errors.get(name, np.zeros(6)))

    tool = translation(-250, -225, 400) @ translation(x, 0, 0) @ e("X") @ translation(0, y, 0) @ e("Y")
    tool = tool @ translation(0, 0, z) @ e("Z") @ translation(0, 0, -tool_length)
    work = translation(0, 0, D) @ about(0, np.pi / 4) @ e("L_B") @ e("B") @ about(2, b)
    work = work @ about(0, -np.pi / 4) @ translation(0, 0, -D) @ e("L_C") @ e("C") @ about(2, -c)
    return np.linalg.solve(work, tool)


def sorby_forward(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return thesis eq. 3.19-3.24 (Sørby 2007): point (x, y, z) and tool axis (i, j, k); X, Y, Z counted from the table's centre.

    Derived from the chain again: the printed formulas hold.
    """
    X, Y, Z, B, C = q
    sb, cb, sc, cc = np.sin(B), np.cos(B), np.sin(C), np.cos(C)
    r = np.sqrt(2.0)
    axis = np.array([(r * cc * sb - sc * cb + sc) / 2, (r * sc * sb + cc * cb - cc) / 2, (1 + cb) / 2])
    s = Y + Z - D
    x = r / 2 * (X * sc + s * cc) * sb + 0.5 * (-Y + Z - D - s * cb) * sc + X * cc * cb
    y = r / 2 * (s * sc - X * cc) * sb + X * sc * cb + 0.5 * (s * cc * cb + (Y - Z + D) * cc)
    z = 0.5 * (-r * X * sb + s * cb - Y + Z + D)
    return np.array([x, y, z]), axis


def sorby_inverse(point: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return thesis eq. 3.25-3.29: X, Y, Z (from the table's centre), B, C."""
    x, y, z = point
    i, j, k = axis
    w = np.sqrt(max(2 * (k - k * k), 0.0))
    B = np.arccos(np.clip(2 * k - 1, -1, 1))
    C = np.arctan2((1 - k) * i + w * j, w * i + (k - 1) * j)
    c, s = np.cos(C), np.sin(C)
    X = (-y * w - x + 2 * x * k) * c + (x * w + 2 * y * k - y) * s + (D - z) * w
    Y = (x * w + y * k) * c + (y * w - x * k) * s - z + D - D * k + z * k
    Z = (x * w + y * k - y) * c + (y * w - x * k + x) * s + D - D * k + z * k
    return np.array([X, Y, Z, B, C])
