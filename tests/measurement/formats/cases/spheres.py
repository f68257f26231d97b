"""Exact contacts with a sphere, for the formats of contacts."""

from __future__ import annotations

import numpy as np

DIRECTIONS = np.array(
    [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0.6, 0.0, 0.8], [0.0, -0.6, 0.8], [-0.48, 0.64, 0.6]]
)
"""Outward normals: exact in a few decimals."""
POSES = (((250.0, 225.0, -200.0), 0.0, 0.0), ((251.5, 225.25, -199.5), 0.0, 90.0), ((249.0, 190.5, -180.0), 30.0, 0.0))
"""Positions of the tip at the centre, B and C."""
APPROACH = np.array([[0.0] * 5, [0.0, 0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0, -1.0]])
"""Directions in which B and C came; a sphere is touched from both sides of X, Y and Z."""
RADIUS = 15.0
"""Radius of the tip's centre around the sphere's."""


def contacts(radius: float = RADIUS) -> list[tuple[np.ndarray, np.ndarray, float, float]]:
    """Return position of X, Y, Z at the contact, outward normal, B and C of every contact."""
    return [(np.array(centre) + radius * normal, normal, b, c) for centre, b, c in POSES for normal in DIRECTIONS]


def rows() -> dict[str, np.ndarray]:
    """Return the rows of the table."""
    at = np.array([[*centre, b, c] for centre, b, c in POSES])
    return {"positions": at, "point_mm": np.zeros((3, 3)), "approach": APPROACH}


SIDES = ("probe", "tool", "work")
"""Station, side it rides on, and side of the target."""
