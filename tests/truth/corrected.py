"""A truth machine under a control with tables and kinematics, in plain numpy, sharing no code with `twin`.

LinuxCNC's compensation (``COMP_FILE_TYPE = 0``): a joint commanded to a position is sent to it plus nominal less actual position of the
table, linearly interpolated. Kinematics: in tool centre point mode, the linear axes go where the tool tip of a machine with these
locations, and no other error, is at the programmed point of the workpiece.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from tests.truth.machine import AXES, RANGES, TruthMachine, carried, seen
from tests.truth.reference import D, about, error_frame, translation

LOW, HIGH = np.array([RANGES[axis] for axis in AXES]).T
TARGETS = {
    "K": ("tool", (-100.0, 70.0, -20.0)),
    "P": ("tool", (30.0, -70.0, -110.0)),
    "Q": ("tool", (110.0, 60.0, -60.0)),
    "T": ("work", (-60.0, 130.0, 170.0)),
    "U": ("work", (-100.0, -200.0, 30.0)),
    "V": ("work", (60.0, 90.0, 140.0)),
}
STATION = ((0.0, -2000.0, 200.0), (0.0, 0.0, 1.6))
SIGMA_MM = 0.004


def comp_shift(file: Path, q: np.ndarray) -> np.ndarray:
    """Return the correction of a joint, mm or degrees, by a LinuxCNC table."""
    rows = np.array(
        [line.split() for line in file.read_text().splitlines() if line.strip()[:1] not in ("", "#", ";")], float
    )
    return np.asarray(np.interp(q, rows[:, 0], rows[:, 0] - rows[:, 1]))


def kinematic_shift(location: Mapping[str, float], q: np.ndarray, tool_length: float) -> np.ndarray:
    """Return the shifts of X, Y, Z, mm, of one pose (mm, degrees) by locations in µm and µrad."""
    b, c = np.radians(q[3:])

    def work(known: Mapping[str, float]) -> np.ndarray:
        at = {
            axis: error_frame(
                np.array(
                    [
                        known.get(f"E_{d}0{axis}", 0.0) * u
                        for d, u in zip("XYZABC", [1e-3] * 3 + [1e-6] * 3, strict=True)
                    ]
                )
            )
            for axis in "BC"
        }
        chain = translation(0, 0, D) @ about(0, np.pi / 4) @ at["B"] @ about(2, b) @ about(0, -np.pi / 4)
        return chain @ translation(0, 0, -D) @ at["C"] @ about(2, -c)

    tip = np.array([q[0] - 250, q[1] - 225, q[2] + 400 - tool_length, 1.0])
    return (work(location) @ np.linalg.solve(work({}), tip) - tip)[:3]


def poses(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return random poses, mm and degrees."""
    return np.round(rng.uniform(LOW, HIGH, (count, 5)), 0)


def measure(
    file: Path,
    truth: TruthMachine,
    q: np.ndarray,
    shift: np.ndarray,
    rng: np.random.Generator,
    sigma_mm: float = SIGMA_MM,
) -> Path:
    """Write a table of readings: commanded positions, and the targets where the shifted commands bring them; the set-up is new."""
    origin = np.array(STATION[0]) + rng.uniform(-100, 100, 3)
    turn = np.array(STATION[1]) + rng.uniform(-0.05, 0.05, 3)
    places = {name: np.array(place) + rng.uniform(-5, 5, 3) for name, (_, place) in TARGETS.items()}
    rows = ["X_mm,Y_mm,Z_mm,B_deg,C_deg,target,carrier,x_mm,y_mm,z_mm,u_x_mm,u_y_mm,u_z_mm"]
    for pose, moved in zip(q, q + shift, strict=True):
        for name, (carrier, _) in TARGETS.items():
            point = seen(origin, turn, carried(truth, moved, carrier, places[name])) + sigma_mm * rng.standard_normal(3)
            numbers = [f"{v:.6f}" for v in (*pose, *point)]
            rows.append(",".join([*numbers[:5], name, carrier, *numbers[5:], *[f"{sigma_mm}"] * 3]))
    file.write_text("\n".join(rows) + "\n")
    return file


def probe(
    file: Path,
    truth: TruthMachine,
    rotary: np.ndarray,
    control: Callable[[np.ndarray], np.ndarray],
    rng: np.random.Generator,
    place: tuple[float, float, float],
) -> Path:
    """Write what a touch probe finds at a sphere on the table: the commands (n, 5) at which its tip is at the centre, B and C given.

    ``control`` returns what the control adds to commands (1, 5).
    """
    sphere, tip = np.array(place) + rng.uniform(-2, 2, 3), truth.tool_length
    rows = ["X_mm,Y_mm,Z_mm,B_deg,C_deg,target,carrier,station,station_carrier,instrument,x_mm,y_mm,z_mm"]
    for b, c in rotary:
        q = np.array([250.0, 225.0, tip - 400.0, b, c])

        def gap(q: np.ndarray) -> np.ndarray:
            return np.asarray(truth.pose(q + control(q[None])[0])[:3, 3] - sphere)

        for _ in range(6):
            slope = np.stack([(gap(q + np.eye(5)[i]) - gap(q)) for i in range(3)], axis=1)
            q[:3] -= np.linalg.solve(slope, gap(q))
        q[:3] += 0.0015 * rng.standard_normal(3)
        rows.append(",".join([*(f"{v:.6f}" for v in q), "sphere,work,tip,tool,probe,0,0,0"]))
    file.write_text("\n".join(rows) + "\n")
    return file
