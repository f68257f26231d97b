"""A truth machine that cuts the bundled test parts and a machine that measures them, in plain numpy, sharing no code with `twin`.

Programs are read by an interpreter of a few lines (G0 to G3 in axis words). The point of the part at P is that of the tool which stands
there on a perfect machine, carried along by the real pose. Effects are written from their definitions in the documentation.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

Hidden = tuple[str, str, Mapping[str, float]]
"""Effect, where it is, and its numbers."""
SAMPLES = Path(__file__).resolve().parents[2] / "twin" / "samples"
D = 154.996
ZERO = np.array([250.0, 225.0, -280.0])
"""Axis positions at which the tip of a tool of 120 mm is in the centre of the table."""
STEP = 0.25
RAPID = 500.0
"""mm/s."""


@dataclass(frozen=True)
class Way:
    """Samples of a program: (n, 3) tips in the part's frame, (n, 3) directions of approach, (n,) s, (n,) whether it feeds."""

    tip: np.ndarray
    approach: np.ndarray
    time: np.ndarray
    feeds: np.ndarray


@lru_cache(maxsize=8)
def path_of(name: str, step: float = STEP) -> Way:
    """Return the way of the tip in a bundled program of three axes."""
    at, code, feed = np.array([np.nan, np.nan, np.nan]), 0, np.nan
    points, feeds, took = [], [], []
    for line in (SAMPLES / f"{name}.nc").read_text().splitlines():
        if line.startswith(("(", "%")):
            continue
        for number in re.findall(r"G([0-3])(?!\d)", line):
            code = int(number)
        words = {letter: float(value) for letter, value in re.findall(r"([XYZIJF])(-?[\d.]+)", line)}
        feed = words.get("F", feed)
        goal = np.array([words.get(letter, at[i]) for i, letter in enumerate("XYZ")])
        if not {*"XYZ"} & {*words}:
            continue
        if np.isnan(at).any():
            at = goal
            continue
        if code in (2, 3):
            centre = np.array([at[0] + words["I"], at[1] + words["J"]])
            first, last = (np.arctan2(*(p[:2] - centre)[::-1]) for p in (at, goal))
            sweep = (last - first) % (2 * np.pi) if code == 3 else -((first - last) % (2 * np.pi))
            radius = np.linalg.norm(at[:2] - centre)
            count = max(2, int(np.ceil(abs(sweep) * radius / step)))
            angle = first + sweep * np.arange(1, count + 1) / count
            way = np.column_stack(
                [centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle), np.full(count, at[2])]
            )
            length = abs(sweep) * radius
        else:
            length = float(np.linalg.norm(goal - at))
            count = max(1, int(np.ceil(length / step)))
            way = at + (goal - at) * (np.arange(1, count + 1) / count)[:, None]
        points.append(way)
        feeds.append(np.full(len(way), code > 0))
        took.append(np.full(len(way), length / len(way) / (feed / 60.0 if code else RAPID)))
        at = goal
    tip = np.concatenate(points) - ZERO
    sign = np.sign(np.round(np.diff(tip, axis=0, prepend=tip[:1]), 9))
    for i in range(1, len(sign)):
        sign[i] = np.where(sign[i] == 0.0, sign[i - 1], sign[i])
    return Way(tip, sign, np.cumsum(np.concatenate(took)), np.concatenate(feeds))


@dataclass(frozen=True)
class Probed:
    """Points of a part to measure: nominal points (n, 3), outward normals (n, 3), where the tool stood, and what it was doing."""

    name: str
    feature: np.ndarray
    place: np.ndarray
    normal: np.ndarray
    q: np.ndarray
    approach: np.ndarray
    time: np.ndarray
    lever: np.ndarray
    by_radius: np.ndarray
    centre: bool = False


TOOL = {"circle_diamond_square": (10.0, 0.0), "hemisphere": (5.0, 5.0), "plate_of_holes": (4.0, 0.0)}
"""Radius and corner radius."""


def surface(name: str, dense: int = 1) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Return features, points and outward normals of a part."""
    feature, place, normal = [], [], []
    if name == "circle_diamond_square":
        for letter, size, z, turn in (("S", 80.0, 15.0, 0.0), ("D", 80.0 / np.sqrt(2.0), 25.0, np.pi / 4)):
            for k, angle in enumerate(np.array([np.pi, np.pi / 2, 0.0, -np.pi / 2])):
                n = np.array([np.cos(angle + turn), np.sin(angle + turn), 0.0])
                t = np.array([-n[1], n[0], 0.0])
                for s in np.linspace(-0.9, 0.9, 10 * dense) * size:
                    feature.append(f"{letter}{k + 1}")
                    place.append(size * n + s * t + [0.0, 0.0, z])
                    normal.append(n)
        for key, radius, z, sign, count in (("C", 54.0, 35.0, 1.0, 48 * dense), ("Bore", 20.0, 33.0, -1.0, 24 * dense)):
            for angle in (np.arange(count) + 0.5) * 2 * np.pi / count:
                n = np.array([np.cos(angle), np.sin(angle), 0.0])
                feature.append(key)
                place.append(radius * n + [0.0, 0.0, z])
                normal.append(sign * n)
    elif name == "hemisphere":
        for polar in np.radians(np.arange(10.0, 81.0, 10.0)):
            for angle in (np.arange(16 * dense) + 0.5) * 2 * np.pi / (16 * dense):
                n = np.array([np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar)])
                feature.append("Ball")
                place.append(40.0 * n + [0.0, 0.0, 20.0])
                normal.append(n)
    else:
        for i, x in enumerate(np.linspace(-180.0, 180.0, 7)):
            for j, y in enumerate(np.linspace(-150.0, 150.0, 6)):
                for n in np.eye(3)[:2]:
                    feature.append(f"H{i + 1}{j + 1}")
                    place.append(np.array([x, y, 12.5]))
                    normal.append(n)
    return feature, np.array(place), np.array(normal)


@lru_cache(maxsize=8)
def probed(name: str, dense: int = 1) -> Probed:
    """Return the points of a part to measure, and where the tool stood when it cut them."""
    feature, place, normal = surface(name, dense)
    way, (radius, corner) = path_of(name), TOOL[name]
    flat = name == "circle_diamond_square"
    goal = place + (corner * normal - [0.0, 0.0, corner] if corner else radius * normal if flat else 0.0)
    q, approach, time = (np.zeros((len(place), 3)) for _ in range(3))
    fed = np.flatnonzero(way.feeds)
    for i, at in enumerate(goal):
        tip = way.tip[fed]
        off = tip - at
        if flat:
            off = np.where((tip[:, 2] > at[2])[:, None], 1e3, off)
            off[:, 2] = np.where(off[:, 2] < -12.0, 1e3, 0.0)
        distance = np.linalg.norm(off, axis=1)
        row = fed[np.flatnonzero(distance <= distance.min() + 1e-2)[-1]]
        q[i], approach[i], time[i] = way.tip[row] + ZERO, way.approach[row], way.time[row]
        q[i, :2] = at[:2] + ZERO[:2]  # the samples are some tenths of a millimetre apart
    lever = place - (q - ZERO) if name != "plate_of_holes" else np.zeros((len(place), 3))
    by_radius = normal[:, 2] - 1.0 if corner else -np.ones(len(place)) if flat else np.zeros(len(place))
    return Probed(
        name, np.array(feature), place, normal, q, approach, time[:, 0], lever, by_radius, name == "plate_of_holes"
    )


def displacement(
    at: Probed, effects: Sequence[tuple[str, str, Mapping[str, float]]], warm: float = 3000.0
) -> np.ndarray:
    """Return (n, 3) mm by which the part's points lie off, by a chain of three linear axes with small errors (B and C at zero)."""
    n = len(at.q)
    e = {axis: np.zeros((n, 6)) for axis in "XYZ"}  # mm and rad
    total = np.zeros((n, 3))
    for effect, where, v in effects:
        i = "XYZ".find(where[0])
        if effect == "reversal":
            e[where][:, i] += 0.5e-3 * v["size"] * at.approach[:, i]
        elif effect == "pitch_error":
            e[where][:, i] += 1e-3 * v["amplitude"] * np.sin(2 * np.pi * at.q[:, i] / v["period"] + v["phase"])
        elif effect == "squareness":
            axis, y = ("Y", at.q[:, 1]) if where == "E_C0Y" else ("Z", at.q[:, 2])
            a = 1e-6 * v["angle"]
            if where == "E_C0Y":
                e[axis][:, 0] -= y * a
            elif where == "E_B0Z":
                e[axis][:, 0] += y * a
            else:
                e[axis][:, 1] -= y * a
        elif effect in ("positioning", "straightness", "angular_error_motion"):
            axis = where[3]
            low, high = {"X": (0.0, 500.0), "Y": (0.0, 450.0), "Z": (-400.0, 0.0)}[axis]
            u = (2 * at.q[:, "XYZ".index(axis)] - low - high) / (high - low)
            k = "XYZABC".index(where[2])
            e[axis][:, k] += (1e-3 if k < 3 else 1e-6) * sum(v[c] * u ** int(c[1:]) for c in v)
        elif effect == "thermal_drift":
            total[:, i] += 1e-3 * v["amplitude"] * (1.0 - np.exp(-at.time / v["time_constant"]))
        else:
            raise ValueError(effect)
    # Tool side: base, X, Y, Z, then the tool down to its point.
    point = np.column_stack([np.zeros((n, 2)), np.full(n, -120.0)]) + at.lever
    real, nominal = point, point
    for axis, k in (("Z", 2), ("Y", 1), ("X", 0)):
        w, r = e[axis][:, 3:], real
        real = r + np.cross(w, r) + 0.5 * np.cross(w, np.cross(w, r)) + e[axis][:, :3]
        real[:, k] += at.q[:, k]
        nominal = nominal + np.eye(3)[k] * at.q[:, k : k + 1]
    return real - nominal + total


def set_up(at: Probed) -> np.ndarray:
    """Return the change of the readings by the part's place and the tool's sizes (n, k)."""
    arm = at.place / 100.0
    columns = np.hstack([at.normal, np.cross(arm, at.normal), at.by_radius[:, None], -at.normal[:, 2:]])
    return columns[:, np.abs(columns).max(axis=0) > 0.0]


def strength(at: Probed, deviation: np.ndarray, u: float) -> float:
    """Return λ: the sum of squares of a deviation (n,), over its noise, that the set-up does not take."""
    columns = set_up(at)
    left = deviation - columns @ np.linalg.lstsq(columns, deviation, rcond=None)[0]
    return float(left @ left) / u**2


def write(
    path: Path, at: Probed, deviation: np.ndarray, u: float, rng: np.random.Generator, *, moved: bool = True
) -> Path:
    """Write what the measuring machine says: mm with 5 decimals, in a frame a little off, cut by a tool a little off."""
    shift = set_up(at) @ rng.normal(size=set_up(at).shape[1]) * 0.01 if moved else 0.0
    off = deviation + shift + u * rng.normal(size=len(deviation))
    with path.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(
            ["Feature", *(f"{role} {axis} [mm]" for role in ("Nominal", "Actual") for axis in "XYZ"), "U [mm]"]
        )
        if at.centre:
            for k in range(0, len(off), 2):
                x, y = at.place[k, :2]
                out.writerow([at.feature[k], x, y, "", f"{x + off[k]:.5f}", f"{y + off[k + 1]:.5f}", "", u])
        else:
            for k in range(len(off)):
                measured = at.place[k] + off[k] * at.normal[k]
                out.writerow([at.feature[k], *(f"{v:.5f}" for v in at.place[k]), *(f"{v:.5f}" for v in measured), u])
    return path
