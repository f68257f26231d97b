"""A control with a table of two rotary axes, in plain numpy: the commands for tool-tip coordinates. It shares no code with `twin`.

`trt_joints` states the kinematics xyzac-trt and xyzbc-trt of LinuxCNC as two rotations about two points, instead of the written-out
products of its source. `chain_commands` follows a chain of lines.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np


def turned(axis: np.ndarray, angle: float) -> np.ndarray:
    """Return the rotation about an axis by Rodrigues' formula."""
    x, y, z = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def pins_of(text: str) -> dict[str, float]:
    """Return the values of the pins in a HAL file, and the shift of the workpiece zero in its comments."""
    found = {name: float(value) for name, value in re.findall(r"^setp \S+-kins\.(\S+) (\S+)$", text, re.MULTILINE)}
    return found | {
        name: float(value) for name, value in re.findall(r"^# (work-zero-shift-\w) (\S+)$", text, re.MULTILINE)
    }


def trt_joints(pins: dict[str, float], tilting: str, tip: np.ndarray, tilt: float, c: float, tool: float) -> np.ndarray:
    """Return the joints X, Y, Z for a tip in machine coordinates with the table at zero; degrees, mm."""
    sign = -1.0 if pins.get("conventional-directions") else 1.0
    shift = np.array([pins.get(f"work-zero-shift-{axis}", 0.0) for axis in "xyz"])
    pivot = np.array([pins["x-rot-point"], pins["y-rot-point"], 0.0])
    cradle = pivot + np.array([pins["x-offset"], pins["y-offset"], pins["z-rot-point"] + pins["z-offset"]])
    on_plate = turned([0, 0, 1], sign * np.radians(c)) @ (tip + shift - pivot) + pivot
    on_bed = turned([1, 0, 0] if tilting == "A" else [0, 1, 0], sign * np.radians(tilt)) @ (on_plate - cradle) + cradle
    return on_bed + np.array([0.0, 0.0, tool])


def chain_of(text: str) -> dict[str, tuple[str, np.ndarray, float]]:
    """Return type, vector and angle (degrees) of the elements of a SINUMERIK chain."""
    fields: dict[str, dict[str, str]] = {}
    for name, element, value in re.findall(r"^\$NK_(\w+)\[([\d,]+)\]=(.*)$", text, re.MULTILINE):
        number, _, index = element.partition(",")
        fields.setdefault(number, {})[name + index] = value.strip('"')
    return {
        one["NAME"]: (one["TYPE"], np.array([float(one[f"OFF_DIR{i}"]) for i in range(3)]), float(one["A_OFF"]))
        for one in fields.values()
    }


def chain_commands(
    chain: dict[str, tuple[str, np.ndarray, float]], rotary: str, tip: np.ndarray, angles: np.ndarray, tool: float
) -> np.ndarray:
    """Return the commands X, Y, Z for a tip in the work frame (at the end of the chain); degrees, mm."""
    first, second = (chain[name][1] for name in rotary)
    p1 = chain["TO_FIRST"][1]
    p2 = p1 + chain["TO_SECOND"][1]
    _, about, angle = chain["TABLE"]
    rest = p2 + chain["TO_TABLE"][1] + turned(about, np.radians(angle)) @ tip
    on_first = p2 + turned(second, np.radians(angles[1])) @ (rest - p2)
    return p1 + turned(first, np.radians(angles[0])) @ (on_first - p1) + np.array([0.0, 0.0, tool])


def chain_file(folder: Path) -> dict[str, tuple[str, np.ndarray, float]]:
    """Return the chain in a folder that `twin control` wrote."""
    return chain_of((folder / "kinchain.mpf").read_text())
