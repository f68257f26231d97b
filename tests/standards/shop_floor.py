"""A skewed machine, artefacts and gauges in plain numpy, which fill in the sheets of `twin plan --artefact`.

Nothing here is computed by `twin`: positions come from the sheet, the tool goes to M q, and every error is drawn from the distribution
that the sheet states: limits are rectangular, the noise of repeats is normal.
"""

from __future__ import annotations

import csv
import io
import re
from dataclasses import dataclass, field

import numpy as np

AXES = "XYZ"


@dataclass
class Truth:
    """Scale errors (mm per mm) and squareness errors (rad) of a machine whose axes all move the tool."""

    scale: dict[str, float] = field(default_factory=dict)
    square: dict[str, float] = field(default_factory=dict)

    @property
    def matrix(self) -> np.ndarray:
        """Tool displacement per command, by the convention: E_XY −= y·E_C0Y, E_XZ += z·E_B0Z, E_YZ −= z·E_A0Z."""
        m = np.diag([1.0 + self.scale.get(axis, 0.0) for axis in AXES])
        m[0, 1] -= self.square.get("E_C0Y", 0.0)
        m[0, 2] += self.square.get("E_B0Z", 0.0)
        m[1, 2] -= self.square.get("E_A0Z", 0.0)
        return m


class FilledSheet:
    """An empty sheet as text: its statements and its rows."""

    def __init__(self, text: str) -> None:
        lines = text.splitlines()
        self.head = [line for line in lines if line.startswith("#")]
        self.rows = list(csv.DictReader(io.StringIO("\n".join(line for line in lines if not line.startswith("#")))))
        self.stated: dict[str, tuple[float, float | None]] = {}
        for line in self.head:
            found = re.match(r"# ([a-z ]+): ([-\d.]+)(?: (?:±|\+/-) ([\d.]+))? ", line)
            if found:
                self.stated[found[1]] = (float(found[2]), None if found[3] is None else float(found[3]))
        self.plane = next(line.split()[-1] for line in self.head if line.startswith("# plane"))

    def state(self, **values: str) -> FilledSheet:
        """Replace statements, as a user who knows better; names with _ for blanks."""
        for key, text in values.items():
            name = key.replace("_", " ")
            place = next(i for i, line in enumerate(self.head) if line.startswith(f"# {name}:"))
            self.head[place] = f"# {name}: {text}"
        return FilledSheet(self.text())

    def text(self) -> str:
        out = io.StringIO()
        writer = csv.DictWriter(out, self.rows[0].keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.rows)
        return "\n".join(self.head) + "\n" + out.getvalue()

    def read(self, row: dict[str, str], value: float, rng: np.random.Generator, noise: float) -> None:
        """Enter the three readings of a value, rounded to the resolution."""
        step = self.stated["resolution"][0]
        for k in (1, 2, 3):
            row[f"reading_{k}_mm"] = f"{round((value + rng.normal(0.0, noise)) / step) * step:.6f}"

    def limit(self, key: str, rng: np.random.Generator) -> float:
        """Draw an error whose limit is stated."""
        value, spread = self.stated[key]
        return float(rng.uniform(-1.0, 1.0)) * (value if spread is None else spread)


def place(row: dict[str, str], prefix: str = "") -> np.ndarray:
    return np.array([float(row[f"{prefix}{axis}_mm"]) for axis in AXES])


def fill(sheet: FilledSheet, truth: Truth, rng: np.random.Generator, noise: float) -> str:
    """Return the sheet as a user fills it in."""
    kind = sheet.head[0].split()[-1]
    {"diagonals": lengths, "square": square, "block": block, "scale-bar": balls, "ball-plate": balls}[kind](
        sheet, truth, rng, noise
    )
    return sheet.text()


def lengths(sheet: FilledSheet, truth: Truth, rng: np.random.Generator, noise: float) -> None:
    wander: dict[tuple[float, ...], np.ndarray] = {}
    temperature = sheet.stated["temperature"][0] + rng.uniform(-1, 1) * sheet.stated["temperature"][1]
    expansion = sheet.stated["expansion"][0] + rng.uniform(-1, 1) * sheet.stated["expansion"][1]
    zero, scale = sheet.limit("instrument", rng), 1e-3 * sheet.limit("instrument per length", rng)
    for row in sheet.rows:
        ends = []
        for prefix in ("from_", "to_"):
            q = place(row, prefix)
            size = sheet.stated["marks"][0]
            ends.append(truth.matrix @ q + wander.setdefault(tuple(q), rng.uniform(-size, size, 3)))
        true = float(np.linalg.norm(ends[1] - ends[0]))
        # A ruler that is too long by its scale error or too warm shows too little.
        sheet.read(row, (true - zero) * (1.0 - scale) / (1.0 + 1e-6 * expansion * (temperature - 20.0)), rng, noise)


def surfaces(sheet: FilledSheet, rng: np.random.Generator) -> tuple[dict[str, float], float]:
    """Return how each set-up is turned (rad), and the error of the artefact's right angle (rad)."""
    turned = {setup: float(rng.uniform(-2e-3, 2e-3)) for setup in ("normal", "reversed")}
    return turned, 1e-3 * sheet.limit("angle", rng)


def square(sheet: FilledSheet, truth: Truth, rng: np.random.Generator, noise: float) -> None:
    a, b = (AXES.index(axis) for axis in sheet.plane)
    turned, angle = surfaces(sheet, rng)
    gain, zero = 1.0 + 1e-3 * sheet.limit("gauge per travel", rng), {}
    for row in sheet.rows:
        sign = 1.0 if row["plunger"][0] == "+" else -1.0
        tool = truth.matrix @ place(row)
        psi = turned[row["setup"]]
        if row["face"] == "datum":
            distance = tool[b] - np.tan(psi) * tool[a]
        else:
            own = angle if row["setup"] == "normal" else -angle
            distance = tool[a] + np.tan(psi + own) * tool[b]
        distance += rng.uniform(-1, 1) * sheet.stated["machine deviation"][0]
        first = zero.setdefault((row["setup"], row["face"]), distance)
        sheet.read(row, sign * (distance - first) * gain, rng, noise)


def block(sheet: FilledSheet, truth: Truth, rng: np.random.Generator, noise: float) -> None:
    a, b = (AXES.index(axis) for axis in sheet.plane)
    turned, angle = surfaces(sheet, rng)
    temperature = sheet.stated["temperature"][0] + rng.uniform(-1, 1) * sheet.stated["temperature"][1]
    expansion = sheet.stated["expansion"][0] + rng.uniform(-1, 1) * sheet.stated["expansion"][1]
    warm = 1.0 + 1e-6 * expansion * (temperature - 20.0)
    half = {
        a: 0.5 * warm * (sheet.stated["size"][0] + sheet.limit("size", rng)),
        b: 0.5 * warm * (sheet.stated["second size"][0] + sheet.limit("second size", rng)),
    }
    radius = sheet.stated["ball radius"][0] + sheet.limit("ball radius", rng)
    seat = {setup: rng.uniform(-2.0, 2.0, 3) for setup in turned}
    middle = {axis: np.mean([place(row)[axis] for row in sheet.rows]) for axis in (a, b)}
    for row in sheet.rows:
        axis = AXES.index(row["plunger"][1])
        sign = 1.0 if row["plunger"][0] == "+" else -1.0
        psi = turned[row["setup"]]
        own = angle if row["setup"] == "normal" else -angle
        slope = np.tan(psi) if axis == b else -np.tan(psi + own)
        running = a if axis == b else b
        q, m = place(row), truth.matrix
        # The tool's centre at contact, along the axis: M q = middle + seat + slope · running − sign · (half + radius)
        other = m[running] @ q - middle[running]
        goal = middle[axis] + seat[row["setup"]][axis] + slope * other - sign * (half[axis] + radius)
        rest = m[axis] @ q - m[axis, axis] * q[axis]
        found = (goal - rest) / m[axis, axis] + rng.uniform(-1, 1) * sheet.stated["machine deviation"][0]
        sheet.read(row, float(found), rng, noise)


def balls(sheet: FilledSheet, truth: Truth, rng: np.random.Generator, noise: float) -> None:
    a, b = (AXES.index(axis) for axis in sheet.plane)
    temperature = sheet.stated["temperature"][0] + rng.uniform(-1, 1) * sheet.stated["temperature"][1]
    expansion = sheet.stated["expansion"][0] + rng.uniform(-1, 1) * sheet.stated["expansion"][1]
    warm = (1.0 + 1e-6 * expansion * (temperature - 20.0)) * (1.0 + 1e-3 * sheet.limit("artefact scale", rng))
    off: dict[str, np.ndarray] = {}
    pose: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    centre: dict[tuple[str, str], np.ndarray] = {}
    for row in sheet.rows:
        ball, placement = row["ball"], row["placement"]
        size = sheet.stated["places"][0]
        own = off.setdefault(ball, rng.uniform(-size, size, 3))
        if placement not in pose:
            heading = {sheet.plane[1]: 90.0, "diagonal +": 45.0, "diagonal -": -45.0}.get(placement, 0.0)
            pose[placement] = turn(a, b, np.radians(heading + rng.uniform(-2, 2)), rng), rng.uniform(-30.0, 30.0, 3)
        if (placement, ball) not in centre:
            rotation, shift = pose[placement]
            nominal = np.array([float(row[f"ball_{axis}_mm"]) for axis in "xyz"])
            at = rotation @ (nominal * warm + own) + shift + np.array([300.0, 400.0, -50.0])
            centre[placement, ball] = np.linalg.solve(truth.matrix, at)
        k = AXES.index(row["axis"])
        sheet.read(
            row, centre[placement, ball][k] + rng.uniform(-1, 1) * sheet.stated["machine deviation"][0], rng, noise
        )


def turn(a: int, b: int, angle: float, rng: np.random.Generator) -> np.ndarray:
    """Return a rotation by an angle from a to b, a little out of the plane."""
    rotation = np.eye(3)
    rotation[[a, a, b, b], [a, b, a, b]] = np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)
    tilt = rng.uniform(-1e-3, 1e-3, 3)
    cross = np.array([[0, -tilt[2], tilt[1]], [tilt[2], 0, -tilt[0]], [-tilt[1], tilt[0], 0]])
    return np.linalg.qr(np.eye(3) + cross)[0] @ np.diag([-1, -1, -1]) @ rotation
