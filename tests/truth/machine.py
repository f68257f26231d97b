"""A truth machine: the DMU 50 executing programs and being measured, in plain numpy, sharing no code with `twin`.

It reads a calibration file with yaml alone, evaluates the curves itself, runs absolute axis-mode ISO programs through a modal
interpreter of a few lines, and returns the true position of the tool, and the readings of a tracker or an interferometer. It also
draws machines whose errors are written in the datum of `twin identify`, from that datum's definition alone.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import yaml
from numpy.polynomial import legendre

from tests.truth.reference import D, about, dmu50_pose, error_frame, translation

LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""The parser in C is seven times faster, where it is installed."""
AXES = "XYZBC"
RANGES = {"X": (0.0, 500.0), "Y": (0.0, 450.0), "Z": (-400.0, 0.0), "B": (0.0, 180.0), "C": (0.0, 360.0)}
MOTIONS = tuple(f"E_{letter}{axis}" for axis in AXES for letter in "XYZABC")
CONSTANTS = ("E_C0Y", "E_A0Z", "E_B0Z", "E_A0B", "E_B0B", "E_X0C", "E_A0C", "E_B0C")
"""Squareness and locations that points on targets of unknown place determine; E_X0B, E_Y0B and E_Y0C they do not."""


class TruthMachine:
    def __init__(self, calibration: Path, tool_length: float = 0.0) -> None:
        data = yaml.load(calibration.read_text(), Loader=LOADER)
        self.curves = data.get("curves", {})
        self.squareness = data.get("squareness", {})
        self.location = data.get("location", {})
        self.tool_length = tool_length

    def curve(self, name: str, q: float | np.ndarray) -> float | np.ndarray:
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
        return np.polyval(c[::-1], (2 * q - lo - hi) / (hi - lo))

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
        """Return 4×4 tool in the work frame; q in mm and degrees."""
        radians = np.asarray(q) * [1, 1, 1, np.pi / 180, np.pi / 180]
        return dmu50_pose(radians, self.errors(q) if real else {}, self.tool_length)

    def deviations(self, commands: np.ndarray, meant: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return µm at the tool tip and µrad of the tool axis: true pose at ``commands`` minus nominal pose at ``meant``."""
        um, urad = [], []
        for q, wanted in zip(commands, meant, strict=True):
            real, nominal = self.pose(q), self.pose(wanted, real=False)
            um.append(np.linalg.norm(real[:3, 3] - nominal[:3, 3]) * 1e3)
            urad.append(np.linalg.norm(real[:3, 2] - nominal[:3, 2]) * 1e6)
        return np.array(um), np.array(urad)


def run_iso(text: str, start: dict[str, float] | None = None) -> list[tuple[str, np.ndarray]]:
    """Return (G0 or G1, position) after each motion block of an absolute metric program; NaN where none was given."""
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


def carried(truth: TruthMachine, q: np.ndarray, carrier: str, place: np.ndarray) -> np.ndarray:
    """Return a reflector in the base frame, mm, from the two chains of the conventions; q in mm and degrees, place in mm."""
    e = {axis: error_frame(six) for axis, six in truth.errors(q).items()}
    b, c = np.radians(q[3:])
    if carrier == "tool":
        chain = translation(-250, -225, 400) @ translation(q[0], 0, 0) @ e["X"] @ translation(0, q[1], 0) @ e["Y"]
        chain = chain @ translation(0, 0, q[2]) @ e["Z"]
    else:
        chain = translation(0, 0, D) @ about(0, np.pi / 4) @ e["L_B"] @ e["B"] @ about(2, b) @ about(0, -np.pi / 4)
        chain = chain @ translation(0, 0, -D) @ e["L_C"] @ e["C"] @ about(2, -c)
    return (chain @ np.append(place, 1.0))[:3]


def seen(origin: np.ndarray, turn: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return a point of the base frame in the frame of a station, mm; ``turn`` its rotation vector."""
    return error_frame(np.concatenate([np.zeros(3), turn]))[:3, :3].T @ (point - origin)


def in_datum(
    rng: np.random.Generator, names: tuple[str, ...] = MOTIONS, *, size: float = 30.0, constants: bool = True
) -> dict[str, dict]:
    """Return curves, squareness and locations of a machine in the datum of `twin identify` (by its definition, not its code).

    Linear axes and B have Legendre polynomials up to degree 8, C four harmonics: no curve has a constant; no straightness a slope (the
    least-squares line over the range); a rotary axis has no part of (E_X, E_Y) or (E_A, E_B) that rotates with it.

    Args:
        rng: random generator.
        names: its error motions.
        size: µm; ten times as many µrad.
        constants: whether it has squareness and locations.
    """
    sums: dict[str, np.ndarray] = {}
    for name in names:
        letter, axis = name[2], name[3]
        amplitude = size if letter in "XYZ" else 10.0 * size
        if axis == "C":
            sums[name] = np.concatenate([[0.0], rng.normal(size=8)]) * amplitude / 8.0
        else:
            first = 2 if axis in "XYZ" and letter in "XYZ" and letter != axis else 1
            sums[name] = np.concatenate([np.zeros(first), rng.normal(size=9 - first)]) * amplitude / 8.0
    x, w = legendre.leggauss(64)
    for axis, sign in (("B", 1.0), ("C", -1.0)):
        for pair in ("XY", "AB"):
            both = [f"E_{letter}{axis}" for letter in pair]
            present = [name for name in both if name in sums]
            # Everything that the axis carries, shifted by a fixed vector (1, 0) or (0, 1), in the frame that does not rotate.
            angle = np.radians(np.mean(RANGES[axis]) + x * np.ptp(RANGES[axis]) / 2.0)
            patterns = [(np.cos(angle), sign * np.sin(angle)), (-sign * np.sin(angle), np.cos(angle))]
            functions = _harmonics(angle, 4) if axis == "C" else legendre.legvander(x, 8)
            parts = [
                np.concatenate([(w * pattern[both.index(name)]) @ functions[:, 1:] for name in present] or [[]])
                for pattern in patterns
            ]
            for row in np.linalg.svd(np.array(parts))[2][:2] if present else []:
                flat = np.concatenate([sums[name][1:] for name in present])
                flat = flat - row * (row @ flat)
                for name, own in zip(present, np.split(flat, len(present)), strict=True):
                    sums[name] = np.concatenate([[0.0], own])
    curves = {
        name: {
            "unit": "um" if name[2] in "XYZ" else "urad",
            "domain": list(RANGES[name[3]]),
            "basis": "fourier" if name[3] == "C" else "power",
            "coefficients": [float(v) for v in (found if name[3] == "C" else legendre.leg2poly(found))],
        }
        for name, found in sums.items()
    }
    numbers = {name: float(rng.uniform(-1.0, 1.0) * size) for name in CONSTANTS if constants}
    return {
        "curves": curves,
        "squareness": {name: value for name, value in numbers.items() if name[4] in "YZ"},
        "location": {name: value for name, value in numbers.items() if name[4] in "BC"},
    }


def written(path: Path, errors: dict[str, dict]) -> TruthMachine:
    """Return a machine with these errors, by way of its calibration file."""
    head = {"schema": "twin.calibration/1", "machine": "DMU 50 eVolution", "source": "drawn for a test"}
    path.write_text(yaml.safe_dump(head | errors, sort_keys=False))
    return TruthMachine(path)


def _harmonics(angle: np.ndarray, orders: int) -> np.ndarray:
    rows = [np.ones_like(angle)]
    for k in range(1, orders + 1):
        rows += [np.cos(k * angle), np.sin(k * angle)]
    return np.stack(rows, axis=1)
