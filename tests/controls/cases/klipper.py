"""Klipper: the motors' targets from the description of skew correction, by solving for them instead of by the firmware's expression."""

from __future__ import annotations

import configparser
from collections.abc import Mapping
from pathlib import Path

import numpy as np

AGREES_UM = 1e-6
GOOD = {
    "skew.cfg": "[skew_correction]\n\n[skew_correction twin]\nxy_skew = -0.001\nxz_skew = 0.002\nyz_skew = 0.0005\n"
}
BAD = [
    ("skew.cfg", "-0.001", "-0,001", 4, "not a number"),
    ("skew.cfg", "-0.001", "-1.1", 4, "implausibly large"),
    ("skew.cfg", "xy_skew = -0.001\n", "", None, "xy_skew is missing"),
    ("skew.cfg", "xz_skew", "xy_skew", 5, "twice"),
    ("skew.cfg", "yz_skew = ", "zy_skew = ", 6, "not one of these settings"),
]


def motors(xy: float, xz: float, yz: float, state: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the targets (3, n) p of the motors for which the skewed machine, x + xy·y + xz·z and y + yz·z, is where it should be."""
    moves = np.array([[1.0, xy, xz], [0.0, 1.0, yz], [0.0, 0.0, 1.0]])
    return np.linalg.solve(moves, np.array([np.broadcast_to(state[name], np.shape(state["X"])) for name in "XYZ"]))


def by_hand(folder: Path, axis: str, state: Mapping[str, np.ndarray]) -> np.ndarray:
    parser = configparser.ConfigParser()
    parser.read(folder / "skew.cfg")
    own = parser["skew_correction twin"]
    factors = [float(own[f"{plane}_skew"]) for plane in ("xy", "xz", "yz")]
    row = "XYZ".index(axis)
    return (motors(*factors, state)[row] - state[axis]) * 1e3
