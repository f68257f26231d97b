"""Tilted working planes: the rotation of a program's coordinates, from the angles that each control uses.

Sources: Fanuc Series 30i operator's manual, "Tilted working plane indexing" (G68.2: Euler angles about Z, X', Z''); Heidenhain TNC 640
user's manual, "PLANE function: tilting the working plane" (SPA, SPB, SPC about the fixed X, Y, Z, in this order); SINUMERIK 840D sl
Programming Manual Cycles, CYCLE800 (rotations about the axes in the order that MODE names).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, radians, sin
from typing import Final, final

import numpy as np

Rows = tuple[tuple[float, ...], ...]
_AXES: Final = "XYZ"


@final
@dataclass(frozen=True)
class Plane:
    """A tilted working plane.

    Attributes:
        origin_mm: its zero in the program's coordinates before it.
        rotation: its axes in those coordinates, as the columns of a rotation matrix (rows of three numbers).
        choice: which of two positions of the rotary axes to take: +1 or −1: that where the axis nearer the tool is positive or
            negative; 0: the nearer one.
        stays: whether the linear axes stay where they are while the rotary axes turn.
    """

    origin_mm: tuple[float, float, float]
    rotation: Rows
    choice: int = 0
    stays: bool = True


def rotation_about(axes: str, angles_deg: Sequence[float]) -> Rows:
    """Return the rotation matrix of successive rotations, each about an axis that the ones before have turned.

    Args:
        axes: letters X, Y, Z, one for each rotation.
        angles_deg: their angles in degrees.
    """
    matrix = np.eye(3)
    for letter, angle in zip(axes, angles_deg, strict=True):
        c, s = _cos_sin(angle)
        i = _AXES.index(letter)
        j, k = (i + 1) % 3, (i + 2) % 3
        turn = np.eye(3)
        turn[j, j], turn[j, k], turn[k, j], turn[k, k] = c, -s, s, c
        matrix = matrix @ turn
    return tuple(tuple(row) for row in matrix.tolist())


def _cos_sin(angle_deg: float) -> tuple[float, float]:
    """Return cosine and sine, exact at multiples of 90°."""
    quarter, rest = divmod(angle_deg, 90.0)
    if rest == 0.0:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(quarter) % 4]
    return cos(radians(angle_deg)), sin(radians(angle_deg))
