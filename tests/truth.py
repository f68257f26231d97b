"""A truth machine: the DMU 50 executing programs, in plain numpy, sharing no code with `twin`.

It reads a calibration file with yaml alone, evaluates the curves itself, runs absolute axis-mode ISO programs through a modal
interpreter of a few lines, and says where the tool really is.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import yaml

from tests.reference import dmu50_pose

AXES = "XYZBC"


class TruthMachine:
    def __init__(self, calibration: Path, tool_length: float = 0.0) -> None:
        data = yaml.safe_load(calibration.read_text())
        self.curves = data.get("curves", {})
        self.squareness = data.get("squareness", {})
        self.location = data.get("location", {})
        self.tool_length = tool_length

    def curve(self, name: str, q: float) -> float:
        entry = self.curves.get(name)
        if entry is None:
            return 0.0
        c = [float(value) for value in entry["coefficients"]]
        if entry["basis"] == "fourier":
            total = c[0]
            for k in range(1, (len(c) + 1) // 2):
                total += c[2 * k - 1] * np.cos(k * np.radians(q)) + c[2 * k] * np.sin(k * np.radians(q))
            return total
        lo, hi = entry["domain"]
        return float(np.polyval(c[::-1], (2 * q - lo - hi) / (hi - lo)))

    def errors(self, q: np.ndarray) -> dict[str, np.ndarray]:
        found = {}
        for axis, position in zip(AXES, q, strict=True):
            six = [self.curve(f"E_{letter}{axis}", position) for letter in "XYZABC"]
            found[axis] = np.array(six) * [1e-3, 1e-3, 1e-3, 1e-6, 1e-6, 1e-6]
        s = self.squareness
        found["Y"][0] -= q[1] * s.get("E_C0Y", 0.0) * 1e-6
        found["Z"][0] += q[2] * s.get("E_B0Z", 0.0) * 1e-6
        found["Z"][1] -= q[2] * s.get("E_A0Z", 0.0) * 1e-6
        for axis in "BC":
            six = [self.location.get(f"E_{letter}0{axis}", 0.0) for letter in "XYZABC"]
            found[f"L_{axis}"] = np.array(six) * [1e-3, 1e-3, 1e-3, 1e-6, 1e-6, 1e-6]
        return found

    def pose(self, q: np.ndarray, *, real: bool = True) -> np.ndarray:
        """4×4 tool in the work frame; q in mm and degrees."""
        radians = np.asarray(q) * [1, 1, 1, np.pi / 180, np.pi / 180]
        return dmu50_pose(radians, self.errors(q) if real else {}, self.tool_length)

    def deviations(self, commands: np.ndarray, meant: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """µm at the tool tip and µrad of the tool axis: real pose at ``commands`` against nominal pose at ``meant``."""
        um, urad = [], []
        for q, wanted in zip(commands, meant, strict=True):
            real, nominal = self.pose(q), self.pose(wanted, real=False)
            um.append(np.linalg.norm(real[:3, 3] - nominal[:3, 3]) * 1e3)
            urad.append(np.linalg.norm(real[:3, 2] - nominal[:3, 2]) * 1e6)
        return np.array(um), np.array(urad)


def run_iso(text: str, start: dict[str, float] | None = None) -> list[tuple[str, np.ndarray]]:
    """(G0 or G1, position) after each motion block of an absolute metric program; NaN where nothing was said."""
    position = {axis: np.nan for axis in AXES} | (start or {})
    code, out = "G0", []
    for line in text.splitlines():
        line = re.sub(r"\(.*?\)|;.*", "", line).upper()
        for number in re.findall(r"G\s*0*([01])(?![\d.])", line):
            code = f"G{number}"
        words = re.findall(r"([XYZBC])\s*([-+]?(?:\d+\.?\d*|\.\d+))", line)
        if words:
            position |= {axis: float(value) for axis, value in words}
            out.append((code, np.array([position[axis] for axis in AXES])))
    return out
