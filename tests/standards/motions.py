"""Tables of readings of the DMU 50, computed here without `twin`: closed form of its chain, errors added by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

AXES = ("X_mm", "Y_mm", "Z_mm", "B_deg", "C_deg")
STATION = Rotation.from_euler("xyz", [3.0, -8.0, 40.0], degrees=True)
"""Orientation of the tracker's frame in the machine frame."""
ORIGIN = np.array([812.0, -640.0, 333.0])
D_MM = 154.996
HOME = np.array([250.0, 225.0, -400.0])
"""Axis positions X, Y, Z at which the spindle nose is at the centre of the table."""


def seen(points: np.ndarray) -> np.ndarray:
    """Return points of the machine frame in the tracker's frame."""
    return STATION.inv().apply(points - ORIGIN)


def to_machine(points: np.ndarray, b_deg: np.ndarray, c_deg: np.ndarray) -> np.ndarray:
    """Return points (n, 3) fixed to the table in the machine frame, by contract §1: Tz(d) Rx(45) Rz(B) Rx(−45) Tz(−d) Rz(−C)."""
    tilt = Rotation.from_euler("x", 45.0, degrees=True)
    offset = np.array([0.0, 0.0, D_MM])
    found = Rotation.from_euler("z", -c_deg[:, None], degrees=True).apply(points) - offset
    found = tilt.inv().apply(found)
    found = Rotation.from_euler("z", b_deg[:, None], degrees=True).apply(found)
    return tilt.apply(found) + offset


def write(
    path: Path,
    q: np.ndarray,
    points: np.ndarray,
    *,
    carrier: str = "tool",
    comment: str = "",
    **columns: Sequence[object],
) -> Path:
    """Write a table; NaN becomes an empty cell."""
    header = [*AXES, "target", "carrier", "x_mm", "y_mm", "z_mm", *columns]
    rows = [
        [*map(repr, map(float, a)), "K", carrier, *("" if np.isnan(v) else repr(float(v)) for v in p), *map(str, more)]
        for a, p, *more in zip(q, points, *columns.values(), strict=True)
    ]
    lines = [",".join(header), *(",".join(row) for row in rows)]
    path.write_text((f"# {comment}\n" if comment else "") + "\n".join(lines) + "\n", encoding="utf-8")
    return path


def positions(count: int, **moved: np.ndarray) -> np.ndarray:
    """Return (n, 5) commands: X 250, Y 225, Z −200, B 0, C 0 except for the axes given."""
    q = np.tile([250.0, 225.0, -200.0, 0.0, 0.0], (count, 1))
    for name, values in moved.items():
        q[:, "XYZBC".index(name)] = values
    return q


def there_and_back(targets: np.ndarray, cycles: int) -> np.ndarray:
    """Return the targets up and down again, with the end targets read twice, for a number of cycles."""
    return np.tile(np.concatenate([targets, targets[::-1]]), cycles)


def straight_run(
    axis: int, targets: np.ndarray, cycles: int, error: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return commands, points in the machine frame, and the direction of approach of a linear axis.

    Args:
        axis: index of the axis.
        targets: target positions, ascending.
        cycles: number of cycles.
        error: of commands, direction and number of the reading; returns (n, 3) mm.
    """
    along = there_and_back(targets, cycles)
    side = np.tile(np.repeat([1.0, -1.0], len(targets)), cycles)
    q = positions(len(along), **{"XYZ"[axis]: along})
    return q, q[:, :3] - HOME + error(along, side, np.arange(len(along))), side
