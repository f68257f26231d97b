"""The bundled A-C trunnion with errors, measured by one tracker as a shop does it, in plain numpy: it shares no code with `twin`.

X and Z carry the tool, Y the trunnion. 486 readings in three rounds: stops of each axis there and back and poses of all five, with one
reflector of each side in turn, noise 2 µm a coordinate, temperatures that rise while it is measured. mm and radians.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

AXES = "XYZAC"
RANGES = {"X": (0.0, 600.0), "Y": (0.0, 500.0), "Z": (-450.0, 0.0), "A": (-90.0, 30.0), "C": (0.0, 360.0)}
HOME = {"X": 300.0, "Y": 250.0, "Z": -200.0, "A": 0.0, "C": 0.0}
TOOL = {"K1": (-90.0, 60.0, 150.0), "K2": (100.0, -70.0, 40.0), "K3": (30.0, 80.0, 210.0)}
WORK = {"T1": (-120.0, 110.0, 60.0), "T2": (90.0, 140.0, 180.0), "T3": (40.0, -160.0, 110.0)}
PIVOT_MM = 60.0
"""Height of A above the table's surface."""
STATION, TURN = np.array([1500.0, -1900.0, 650.0]), 2.1
SIGMA_MM = 2e-3
STOPS, POSES, ROUNDS = 5, 81, 3
SECONDS, PAUSE_S = 7.0, 300.0
Read = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Plan:
    """Rows of the measurement in order, n of them: positions, directions of approach, target, round, time and temperatures."""

    q: np.ndarray
    approach: np.ndarray
    target: np.ndarray
    round: np.ndarray
    time_s: np.ndarray
    warm: Mapping[str, np.ndarray]

    def at(self, axis: str) -> np.ndarray:
        return self.q[:, AXES.index(axis)]

    def share(self, axis: str) -> np.ndarray:
        """Positions of an axis, 0 to 1 over its range."""
        return (self.at(axis) - RANGES[axis][0]) / np.ptp(RANGES[axis])

    @property
    def tool(self) -> np.ndarray:
        return np.char.startswith(self.target, "K")

    @property
    def clock(self) -> np.ndarray:
        """Times, 0 to 1."""
        return self.time_s / self.time_s[-1]


@dataclass(frozen=True)
class Errors:
    """Errors of machine and instrument.

    Attributes:
        motion: error motions by axis, (n, 6) mm and rad in the order XYZABC.
        tool, base, place: (n, 3) mm shifts of the tool side, of all targets, and of each target on its carrier.
        instrument: (n, 3) true coordinates in its frame → those that it reads.
    """

    motion: Mapping[str, np.ndarray] = field(default_factory=dict)
    tool: np.ndarray | float = 0.0
    base: np.ndarray | float = 0.0
    place: np.ndarray | float = 0.0
    instrument: Read = lambda seen: seen


def plan(rng: np.random.Generator) -> Plan:
    poses = []
    for axis in AXES:
        low, high = RANGES[axis]
        stops = np.clip(np.linspace(low, high, STOPS) + rng.uniform(-0.008, 0.008, STOPS) * (high - low), low, high)
        poses += [HOME | {axis: round(float(stop), 3)} for stop in (*stops, *stops[::-1])]
    runs = len(poses)
    poses += [{axis: round(float(rng.uniform(*RANGES[axis])), 3) for axis in AXES} for _ in range(POSES - runs)]
    q, target, rounds, time_s = [], [], [], []
    now = 0.0
    for r in range(ROUNDS):
        for k in (*range(runs), *(runs + rng.permutation(POSES - runs))):
            for names in (list(TOOL), list(WORK)):
                q.append([poses[k][axis] for axis in AXES])
                target.append(names[(k + r) % 3])
                rounds.append(str(r + 1))
                time_s.append(now)
                now += SECONDS
        now += PAUSE_S
    positions, clock = np.array(q), np.array(time_s) / time_s[-1]
    moved = np.sign(np.diff(positions, axis=0, prepend=positions[:1]))
    moved[0] = 1.0
    for i in range(1, len(moved)):
        moved[i] = np.where(moved[i] == 0.0, moved[i - 1], moved[i])
    courses = {
        "X": 20.3 + 2.2 * (1.0 - np.exp(-clock / 0.4)),
        "Y": 20.1 + 1.5 * np.sin(2.6 * clock),
        "Z": 19.8 + 3.1 * clock**1.5,
    }
    warm = {name: course + rng.normal(0.0, 0.02, len(clock)) for name, course in courses.items()}
    return Plan(positions, moved, np.array(target), np.array(rounds), np.array(time_s), warm)


def readings(of: Plan, errors: Errors, rng: np.random.Generator) -> np.ndarray:
    """Return (n, 3) readings in the station's frame."""
    c, s = np.cos(TURN), np.sin(TURN)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    seen = errors.instrument((_points(of, errors) + errors.base - STATION) @ turn)
    return seen + rng.normal(0.0, SIGMA_MM, seen.shape)


def write(path: Path, of: Plan, read: np.ndarray, *, temperatures: bool = True) -> Path:
    warm = of.warm if temperatures else {}
    head = [f"{axis}_{'mm' if axis in 'XYZ' else 'deg'}" for axis in AXES] + [
        "target",
        "carrier",
        "x_mm",
        "y_mm",
        "z_mm",
    ]
    head += [f"u_{x}_mm" for x in "xyz"] + ["station", "round", "time_s", *(f"approach_{axis}" for axis in AXES)]
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow([*head, *(f"T_{name}_degC" for name in warm)])
        for i in range(len(read)):
            side = "tool" if of.tool[i] else "work"
            row = [*of.q[i], of.target[i], side, *np.round(read[i], 5), *(SIGMA_MM,) * 3, 1, of.round[i], of.time_s[i]]
            table.writerow(
                [*row, *of.approach[i].astype(int), *(round(float(values[i]), 3) for values in warm.values())]
            )
    return path


def _points(of: Plan, errors: Errors) -> np.ndarray:
    """Return (n, 3) the targets in the base, whose origin is the middle of the table's surface."""
    zero = np.zeros(len(of.q))
    x, y, z, a, c = of.q.T
    pivot = np.array([0.0, 0.0, PIVOT_MM])
    own = np.array([(TOOL | WORK)[name] for name in of.target]) + errors.place

    def wrong(axis: str, point: np.ndarray) -> np.ndarray:
        error = errors.motion.get(axis, np.zeros((len(zero), 6)))
        return point + np.cross(error[:, 3:], point) + error[:, :3]

    tool = wrong("Z", own) + np.stack([zero, zero, z + 450.0], axis=1)
    tool = wrong("X", tool) + np.stack([x - 300.0, zero, zero], axis=1) + errors.tool
    work = wrong("C", _turned(own, 2, -np.radians(c))) - pivot
    work = wrong("A", _turned(work, 0, -np.radians(a))) + pivot
    work = wrong("Y", work) - np.stack([zero, y - 250.0, zero], axis=1)
    return np.where(of.tool[:, None], tool, work)


def _turned(points: np.ndarray, about: int, angle: np.ndarray) -> np.ndarray:
    i, j = (about + 1) % 3, (about + 2) % 3
    out = points.copy()
    out[:, i] = np.cos(angle) * points[:, i] - np.sin(angle) * points[:, j]
    out[:, j] = np.sin(angle) * points[:, i] + np.cos(angle) * points[:, j]
    return out
