"""ISG: the DMU 50 with the component errors of the file and exact rotations."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tests.truth.reference import about, dmu50_pose

AGREES_UM = 0.15
"""Rotations are exact here and of first order in twin: 300 µrad · 100 µm, (300 µrad)² · 1 m / 2, and 1e-4 of 0.2 mm."""
GOOD = {"volcomp.csv": "P0X P0Y P0Z\n0 0 0\n#\nX EXX EYX\n0 0.001 0.002\n100 0.002 0.001\n"}
BAD = [
    ("volcomp.csv", "EYX", "EYY", 4, "unknown column in the block"),
    ("volcomp.csv", "100 0.002", "100", 6, "cells"),
    ("volcomp.csv", "100 0.002", "0 0.002", 6, "do not increase"),
    ("volcomp.csv", "0 0 0\n", "0 0 12\n", 2, "P0Z differs"),
    ("volcomp.csv", "P0X P0Y", "C0Y P0Y", 1, "unknown parameter"),
]
"""File, text replaced in it, replacement, line number and text of the error."""


def by_hand(folder: Path, axis: str, state: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return how far X, Y, Z must move to keep the point in place on the DMU 50 with the component errors of the file."""
    text = (folder / "volcomp.csv").read_text()
    length = float(re.search(r"tool length (\S+) mm", text)[1])
    blocks = [block.split() for block in re.sub(r"//.*", "", text).split("#")]
    tables = {}
    for words in blocks[1:]:
        head = [word for word in words if re.match(r"[A-Z]", word)]
        tables[words[0]] = (head[1:], np.array(words[len(head) :], dtype=float).reshape(-1, len(head)))
    found = []
    for i in range(len(state["X"])):
        q = np.array([state[name][i] for name in "XYZBC"])
        errors = {name: np.zeros(6) for name in ("X", "Y", "Z", "B", "C", "L_B", "L_C")}
        for name, (columns, rows) in tables.items():
            place = q["XYZBC".index(name)]
            place = np.mod(place, 360.0) if name == "C" else place
            for k, column in enumerate(columns, start=1):
                errors[name]["XYZABC".index(column[1])] = np.interp(place, rows[:, 0], rows[:, k])
        # The frame of B is rotated by 45° about x; the file uses the machine's directions.
        tilt = about(0, np.pi / 4)[:3, :3]
        errors["B"] = np.concatenate([tilt.T @ errors["B"][:3], tilt.T @ errors["B"][3:]])
        none = {name: np.zeros(6) for name in errors}
        b, c = np.radians(q[3:])
        real, meant = (dmu50_pose([*q[:3], b, c], one, length) for one in (errors, none))
        work = tilt @ about(2, b)[:3, :3] @ tilt.T @ about(2, -c)[:3, :3]
        found.append(-(work @ (real - meant)[:3, 3])["XYZ".index(axis)] * 1e3)
    return np.array(found)
