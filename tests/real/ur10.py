"""The UR10 of `../shared/data/real/ur10`: its machine file, and its poses as a measurement table.

Landgraf et al. (2021), "A Hybrid Neural Network Approach for Increasing the Absolute Accuracy of Industrial Robots" (CASE), series A.
A laser tracker measured a 6-D probe on the flange; only its position is used, as one target whose place on the flange is unknown.

The URDF next to the data is a UR10e's (``<robot name="ur10e">``), a younger robot with other links. The robot measured is a UR10: with
the link lengths that Universal Robots publish for it, the commanded joints reach the goal poses of the table within 0.6 mm (median
0.09 mm), with those of the URDF only within 50 mm (median 10 mm). `write_machine` writes either robot.
"""

from __future__ import annotations

import csv
from datetime import datetime
from pathlib import Path
from typing import Final

import numpy as np

POSES: Final = "Series_A_measurements_grid.csv"
JOINTS: Final = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
U_MM: Final = 0.03
"""Standard uncertainty of a coordinate: the middle of the repeatability of 22 to 42 µm in the data's README, which includes robot and
tracker and is the same in all directions.
"""
LENGTHS: Final = (
    ('xyz="0 0 0.1807"', 'xyz="0 0 0.1273"'),
    ('xyz="-0.6127 0 0"', 'xyz="-0.612 0 0"'),
    ('xyz="-0.57155 0 0.17415"', 'xyz="-0.5723 0 0.163941"'),
    ('xyz="0 -0.11985 -2.458164590756244e-11"', 'xyz="0 -0.1157 0"'),
    ('xyz="0 0.11655 -2.390480459346185e-11"', 'xyz="0 0.0922 0"'),
)
"""Joint origins of the UR10e in the URDF next to the data, and of the UR10 (Universal Robots, "DH parameters for calculations of
kinematics and dynamics").
"""


def write_machine(shared: Path, folder: Path, *, as_given: bool) -> Path:
    """Write a machine file into ``folder``: for the URDF next to the data, or with the lengths of the robot that was measured."""
    urdf = shared / "ur10_robot.urdf"
    if not as_given:
        text = urdf.read_text(encoding="utf-8")
        for old, new in LENGTHS:
            if text.count(old) != 1:
                raise ValueError(f"{urdf}: {old} stands there {text.count(old)} times")
            text = text.replace(old, new)
        urdf = folder / "ur10.urdf"
        urdf.write_text(text, encoding="utf-8")
    axes = [
        f"  - {{name: J{i}, joint: {joint}_joint, kind: rotary, range: [{-reach}, {reach}], increment: 0.001}}"
        for i, (joint, reach) in enumerate(zip(JOINTS, (360, 360, 180, 360, 360, 360), strict=True), start=1)
    ]
    path = folder / "ur10.yaml"
    lines = ["schema: twin.machine/1", "name: UR10", f"urdf: {urdf}", "axes:", *axes]
    path.write_text("\n".join([*lines, "frames: {tool: tool0, work: base_link}", ""]), encoding="utf-8")
    return path


def write_table(shared: Path, path: Path) -> Path:
    """Write the poses as a measurement table: joints in degrees, the probe in the tracker's frame.

    A round is all poses at one place in space: some twenty orientations of the probe, measured one after the other with the arm nearly
    at rest. Their errors are correlated, so places are independent samples, not poses.
    """
    with (shared / POSES).open(encoding="utf-8-sig", newline="") as file:
        rows = list(csv.DictReader(file, delimiter=";"))
    start = datetime.strptime(rows[0]["Timestamp"], "%Y%m%d%H%M%S")
    places: dict[tuple[int, ...], int] = {}
    header = [f"J{i}_deg" for i in range(1, 7)] + ["target", "carrier", "round", "x_mm", "y_mm", "z_mm"]
    header += ["u_x_mm", "u_y_mm", "u_z_mm", "time_s", "T_air_degC"]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        for row in rows:
            joints = np.degrees([_number(row[f"{joint}_joint"]) for joint in JOINTS])
            point = [_number(row[f"measurement_{axis}"]) for axis in "xyz"]
            goal = tuple(round(1e3 * _number(row[f"Goal {axis}"])) for axis in "xyz")
            place = places.setdefault(goal, len(places) + 1)
            time = (datetime.strptime(row["Timestamp"], "%Y%m%d%H%M%S") - start).total_seconds()
            air = round(_number(row["measurement_temperature"]), 2)
            writer.writerow(
                [*(f"{q:.9f}" for q in joints), "T-Mac", "tool", place, *point, U_MM, U_MM, U_MM, time, air]
            )
    return path


def goals_mm(shared: Path) -> np.ndarray:
    """Return (n, 3) the intended position of the probe at each pose, in the robot's base frame, mm."""
    with (shared / POSES).open(encoding="utf-8-sig", newline="") as file:
        rows = csv.DictReader(file, delimiter=";")
        return 1e3 * np.array([[_number(row[f"Goal {axis}"]) for axis in "xyz"] for row in rows])


def _number(text: str) -> float:
    return float(text.replace(",", "."))
