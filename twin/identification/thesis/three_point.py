"""The thesis's six error motions from three reflectors, position by position (Zhang and Hu 2011).

A reflector at p on a carrier with errors (e, ω) moves by Δ = e + ω × p (thesis eq. 30). Three reflectors give nine equations for
six unknowns (eq. 31, 35; 3.5 for a rotary axis, p rotated with it); the thesis selects six of them (eq. 32, 36, 37, 3.6). Both are
implemented: the six as a baseline, and all nine by least squares. Neither considers noise, stations or repeats, as `identify` does.
"""

from __future__ import annotations

from typing import Final, Literal

import numpy as np

from twin._common.errors import InputError

SIX: Final = {
    "X": ("Px", "Py", "Qx", "Qz", "Ky", "Kz"),
    "Y": ("Py", "Pz", "Qy", "Kx", "Kz", "Px"),
    "Z": ("Pz", "Qx", "Qz", "Ky", "Px", "Py"),
    "rotary": ("Px", "Py", "Qx", "Qz", "Ky", "Kz"),
}
"""The six equations: reflector and direction. X eq. 32, Y eq. 36, Z eq. 37, rotary eq. 3.6."""
REFLECTORS: Final = "KPQ"


def three_point(
    deviations: np.ndarray,
    places: np.ndarray,
    axis: Literal["X", "Y", "Z", "rotary"],
    *,
    equations: Literal["six", "nine"] = "six",
) -> np.ndarray:
    """Return six error motions at every position.

    Args:
        deviations: (m, 3, 3) measured minus nominal of reflectors K, P, Q, metres, along the axis's error frame.
        places: (m, 3, 3) or (3, 3) the reflectors' nominal places in the error frame, metres; rotated with a rotary axis.
        axis: selects the six equations.
        equations: ``six`` as the thesis, ``nine`` by least squares.

    Returns:
        (m, 6) translations and rotations, metres and radians.

    Raises:
        InputError: reflectors on a line, or a place that makes the six equations singular (the thesis's N = 0).
    """
    deviations = np.asarray(deviations, dtype=float)
    where = np.broadcast_to(np.asarray(places, dtype=float), deviations.shape)
    m = len(deviations)
    matrix = np.zeros((m, 9, 6))
    for k in range(3):
        x, y, z = where[:, k].T
        block = matrix[:, 3 * k : 3 * k + 3]
        block[:, range(3), range(3)] = 1.0
        block[:, 0, 4], block[:, 0, 5] = z, -y
        block[:, 1, 3], block[:, 1, 5] = -z, x
        block[:, 2, 3], block[:, 2, 4] = y, -x
    right = deviations.reshape(m, 9)
    if equations == "six":
        rows = [3 * REFLECTORS.index(name[0]) + "xyz".index(name[1]) for name in SIX[axis]]
        matrix, right = matrix[:, rows], right[:, rows]
    scale = np.array([1.0, 1.0, 1.0, *(1.0 / _size(where),) * 3])
    singular = np.linalg.svd(matrix * scale, compute_uv=False)[:, -1]
    if np.any(singular < 1e-6):
        raise InputError(
            f"the {equations} equations of {axis} do not determine six errors",
            expected="three reflectors not on a line, and at different heights along the axes that the equations use",
            value=f"smallest singular value {singular.min():.1e}",
        )
    solved = np.linalg.pinv(matrix * scale) @ right[:, :, None]
    return np.asarray(solved[:, :, 0] * scale)


def _size(places: np.ndarray) -> float:
    """Return a typical distance of the reflectors, so that rotations are scaled like translations in the rank."""
    return float(max(np.linalg.norm(places - places.mean(axis=1, keepdims=True), axis=2).max(), 1e-9))
