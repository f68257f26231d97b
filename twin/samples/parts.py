"""Generate the test parts in this folder: run ``python -m twin.samples.parts``.

Programs in axis words of the DMU 50, and for each the file of its features: squares, a diamond and a circle (after NAS 979 and ISO
10791-7), a hemisphere, a plate of holes, and the features of ``cone_frustum.nc`` (ISO 10791-7). Sizes are our own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from twin._common.files import write_atomic
from twin._common.yaml_files import yaml_text
from twin.samples import PARTS

LENGTH: Final = 120.0
ZERO: Final = (250.0, 225.0, -400.0 + LENGTH)
"""Axis positions at which the tip of a tool of that length is in the centre of the table's surface."""
SAFE: Final = 90.0
"""Height above the table at which the tool passes over the part."""
MILL, BALL, DRILL = 20.0, 10.0, 8.0


def word(x: float, y: float, z: float | None = None) -> str:
    """Return the words of a point of the tip in the part's frame, mm."""
    at = zip("XYZ", (x, y) if z is None else (x, y, z), ZERO, strict=False)
    return " ".join(f"{axis}{value + zero:.3f}" for axis, value, zero in at)


def program(title: str, tool: int, blocks: Iterable[str]) -> str:
    """Return a program with one tool."""
    head = [
        f"({title}, MADE BY TWIN)",
        "(AXIS WORDS OF THE DMU 50: TOOL LENGTH 120 MM)",
        "G21 G17 G40 G90 G94",
        f"T{tool} M6",
    ]
    lines = [*head, "S8000 M3", "G0 B0. C0.", f"G0 {word(0.0, 0.0)}", *blocks, f"G0 Z{SAFE + ZERO[2]:.3f}", "M5", "M30"]
    return "%\n" + "".join(f"{line}\n" for line in lines) + "%\n"


def contour(corners: np.ndarray, z: float) -> list[str]:
    """Return blocks around a polygon (n, 2), entered and left beside its first side."""
    first, second = corners[0], corners[1]
    along = (second - first) / np.linalg.norm(second - first)
    before, after = first - 15.0 * along, first + 15.0 * (first - corners[-1]) / np.linalg.norm(first - corners[-1])
    path = [*corners[1:], corners[0], after]
    return [
        f"G0 {word(*before)}",
        f"G0 Z{z + ZERO[2]:.3f}",
        *(f"G1 {word(*at)} F600" for at in path),
        f"G0 Z{SAFE + ZERO[2]:.3f}",
    ]


def circle(radius: float, z: float, *, back: bool = False, feed: int = 600) -> list[str]:
    """Return blocks of a full circle about the part's centre, in two arcs."""
    code = "G2" if back else "G3"
    return [
        f"G1 {word(radius, 0.0, z)} F{feed}",
        f"{code} {word(-radius, 0.0)} I{-radius:.3f} J0.",
        f"{code} {word(radius, 0.0)} I{radius:.3f} J0.",
    ]


def circle_diamond_square() -> tuple[str, dict[str, Any]]:
    """Return the program and the features: a square of 160 mm, a diamond and a circle on it, a bore."""
    half, side, radius, bore = 80.0, 80.0 / np.sqrt(2.0), 54.0, 20.0
    square = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]])
    turn = np.array([[1.0, -1.0], [1.0, 1.0]]) / np.sqrt(2.0)
    out = radius + MILL / 2.0
    blocks = [
        *contour(square * (half + MILL / 2.0), 10.0),
        *contour(square * (side + MILL / 2.0) @ turn.T, 20.0),
        f"G0 {word(out + 20.0, 0.0)}", f"G0 Z{30.0 + ZERO[2]:.3f}", *circle(out, 30.0, back=True), *circle(out, 30.0),
        f"G1 {word(out + 20.0, 0.0)}", f"G0 Z{SAFE + ZERO[2]:.3f}",
        f"G0 {word(0.0, 0.0)}", f"G0 Z{25.0 + ZERO[2]:.3f}", *circle(bore - MILL / 2.0, 25.0), f"G1 {word(0.0, 0.0)}",
    ]  # fmt: skip
    features: dict[str, Any] = {}
    for name, size, low, rotation in (("S", half, 10.0, np.eye(2)), ("D", side, 20.0, turn)):
        for k, (normal, across) in enumerate(
            (((-1, 0), (0, 1)), ((0, 1), (1, 0)), ((1, 0), (0, 1)), ((0, -1), (1, 0)))
        ):
            n, t = rotation @ normal, rotation @ across
            ends = np.array([size * n - 0.97 * size * t, size * n + 0.97 * size * t])
            box = [[*ends.min(axis=0) - 0.1, low], [*ends.max(axis=0) + 0.1, low + 10.0]]
            features[f"{name}{k + 1}"] = {
                "kind": "plane",
                "point": [*size * n, low],
                "normal": [*n, 0.0],
                "within": box,
            }
    features["C"] = {"kind": "cylinder", "point": [0, 0, 40], "depth": 10, "diameter": 2 * radius, "internal": False}
    features["Bore"] = {"kind": "hole", "point": [0, 0, 40], "depth": 15, "diameter": 2 * bore}
    tolerances = [
        {"kind": "profile", "of": ["S1", "S2", "S3", "S4"], "zone": 0.05},
        {"kind": "roundness", "of": "C", "zone": 0.02},
        {"kind": "perpendicularity", "of": "S2", "zone": 0.02, "datums": ["S1"]},
    ]
    mill = {"number": 1, "diameter": MILL, "cutting_length": 40}
    return program("CIRCLE, DIAMOND, SQUARE", 1, blocks), drawing("circle, diamond, square", mill, features, tolerances)


def hemisphere() -> tuple[str, dict[str, Any]]:
    """Return the program and the features: a ball-nose tool on circles of a hemisphere of 80 mm, there and back."""
    radius, ball, blocks = 40.0, BALL / 2.0, []
    for k, angle in enumerate(np.radians(np.arange(10.0, 85.5, 1.0))):
        out, z = (radius + ball) * np.sin(angle), (radius + ball) * np.cos(angle) - ball + 20.0
        blocks += [f"G0 {word(out, 0.0)}"] if k == 0 else []
        blocks += circle(out, z, back=k % 2 == 1, feed=2000)
    features = {"Ball": {"kind": "sphere", "centre": [0, 0, 20], "diameter": 2 * radius}}
    tolerances = [{"kind": "profile", "of": "Ball", "zone": 0.05}]
    tool = {"number": 1, "diameter": BALL, "corner_radius": ball}
    return program("HEMISPHERE", 1, blocks), drawing("hemisphere", tool, features, tolerances)


def plate_of_holes() -> tuple[str, dict[str, Any]]:
    """Return the program and the features: 7 by 6 holes over 360 mm by 300 mm, every second in rows, the others in columns."""
    x, y = np.linspace(-180.0, 180.0, 7), np.linspace(-150.0, 150.0, 6)
    rows = [(i, j) for j in range(6) for i in (range(7) if j % 2 == 0 else range(6, -1, -1)) if (i + j) % 2 == 0]
    columns = [(i, j) for i in range(6, -1, -1) for j in (range(5, -1, -1) if i % 2 == 0 else range(6)) if (i + j) % 2]
    blocks, features = [], {}
    for i, j in [*rows, *columns]:
        blocks += [
            f"G0 {word(x[i], y[j])}",
            f"G0 Z{25.0 + ZERO[2]:.3f}",
            f"G1 Z{5.0 + ZERO[2]:.3f} F400",
            f"G0 Z{25.0 + ZERO[2]:.3f}",
        ]
        features[f"H{i + 1}{j + 1}"] = {
            "kind": "hole",
            "point": [float(x[i]), float(y[j]), 20.0],
            "depth": 15,
            "diameter": DRILL,
        }
    tolerances = [{"kind": "position", "of": "H76", "zone": 0.1, "datums": ["H11"]}]
    return program("PLATE OF HOLES", 1, blocks), drawing(
        "plate of holes", {"number": 1, "diameter": DRILL}, features, tolerances
    )


def cone_frustum() -> dict[str, Any]:
    """Return the features of ``cone_frustum.nc``: a cone of half apex angle 15°, inclined by 10°."""
    axis = [float(np.sin(np.radians(10.0))), 0.0, float(np.cos(np.radians(10.0)))]
    base = np.array([60.1107, 0.0, 60.6468]) - 2.5882 * np.array(axis)
    cone = {
        "kind": "cone", "point": [round(float(v), 4) for v in base], "direction": axis, "depth": 30.0, "diameter": 81.032,
        "half_angle_deg": -15.0, "internal": False,
    }  # fmt: skip
    tool = {"number": 1, "diameter": 20.0, "cutting_length": 40}
    tolerances = [{"kind": "roundness", "of": "Cone", "zone": 0.05}]
    return drawing("cone frustum", tool, {"Cone": cone}, tolerances) | {"touch_mm": 0.05}


def drawing(
    name: str, tool: Mapping[str, Any], features: Mapping[str, Any], tolerances: Iterable[Mapping[str, Any]]
) -> dict[str, Any]:
    """Return the file of a part whose zero is the centre of the table."""
    head = {"schema": "twin.part/1", "part": name, "units": "mm", "zero": "table", "tools": [dict(tool)]}
    return head | {"features": dict(features), "tolerances": list(tolerances)}


def plain(value: Any) -> Any:
    """Return data with plain, rounded numbers."""
    if isinstance(value, dict):
        return {key: plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    return round(float(value), 6) if isinstance(value, float) else value


def contents() -> dict[str, str]:
    """Return the files by their names."""
    made = dict(zip(PARTS, (circle_diamond_square(), hemisphere(), plate_of_holes()), strict=False))
    found = {f"{name}.nc": text for name, (text, _) in made.items()}
    drawings = {name: drawn for name, (_, drawn) in made.items()} | {"cone_frustum": cone_frustum()}
    for name, drawn in drawings.items():
        found[f"{name}.part.yaml"] = yaml_text(plain(drawn))
    return found


if __name__ == "__main__":
    for file, text in contents().items():
        write_atomic(Path(__file__).parent / file, text)
