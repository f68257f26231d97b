"""Laser: the sections and entries that the public programs read and write, with invented values."""

from __future__ import annotations

import numpy as np

from twin.measurement.formats import Given

FILE = "x.rtl"
MACHINE = "dmu50"
GIVEN = Given(at={"Y": 225.0, "Z": -200.0, "B": 0.0, "C": 0.0}, offset={"X": 50.0})
TARGETS = np.array([0.0, 100.0, 200.0, 300.0, 400.0, 450.0])
UP, DOWN = np.array([0.0, 1.5, 2.5, 2.9, 4.0, 5.1]), np.array([-1.0, 0.5, 1.0, 2.0, 3.0, 4.0])
GOOD = (
    "HEADER::\nFile type  : rtl\nOwner      : Linear\nVersion no : 20.02.02\n\nTARGET DATA::\nFiletype  : ISO\n"
    "Target-count: 6\nTargets :\n0.000000  100.000000  200.000000  300.000000  400.000000 \n450.000000 \nFlags: 0 0 2 0\n\n"
    "USER-TEXT::\nMachine: mill\nSerial No: 7\nDate:10:46 Dec 12 2016\nAxis:X\nTITLE:\n\nRUNS::\nRun-count:2\n\n"
    "DEVIATIONS::\nRun Target Data:\n"
    + "".join(f"1   {i + 1}      {UP[i]}\n" for i in range(6))
    + "".join(f"2   {i + 1}      {DOWN[i]}\n" for i in reversed(range(6)))
    + "\nEQUIPMENT::\nSerial: 1\n\nENVIRONMENT::\nAir temp   : 20.30 20.40 0\nAir press  : 99.0 99.0 1\nMat temp 1 : 21.0 21.2 0\n"
    'Mat temp 2 : -10.000000 -10.000000 0\nDate Time  : "10:46 Dec 12 2016" "11:01 Dec 12 2016"\n\nEOF::\n'
)


def _rows() -> dict[str, np.ndarray]:
    at = np.concatenate([TARGETS, TARGETS[::-1]])
    length = at + np.concatenate([UP, DOWN[::-1]]) / 1000
    other = np.tile([225.0, -200.0, 0.0, 0.0], (12, 1))
    return {
        "positions": np.column_stack([at + 50.0, other]),
        "point_mm": np.column_stack([length, np.full((12, 2), np.nan)]),
        "approach": np.column_stack([np.repeat([1.0, -1.0], 6), np.zeros((12, 4))]),
        "T_air_degC": np.full(12, 20.35),
        "T_material_1_degC": np.full(12, 21.1),
    }


ROWS = _rows()
SIDES = ("laser X", "base", "tool")
AGREES_MM = 1e-9
BAD = [
    (
        "".join(f"2   {i + 1}      {DOWN[i]}\n" for i in reversed(range(6))),
        "".join(f"2   {i + 1}      0\n" for i in reversed(range(6))),
        32,
        "run 2 reads zero at every target",
    ),
    ("RUNS::", "RUMS::", 21, "unknown section"),
    ("Target-count: 6", "Target-count: 7", 8, "6 targets"),
    ("Run-count:2", "Run-count:4", 22, "2 runs"),
    ("Run-count:2", "Laps:2", 22, "unknown entry of RUNS"),
    ("rtl\n", "rta\n", 2, "unknown File type"),
    ("1   3      2.5\n", "", 30, "run 1 has not every target once"),
    ("1   3      2.5", "1   3      2,5", 28, "a deviation is not a number"),
    ("1   3      2.5", "1   3", 28, "not a reading"),
    ("1   3      2.5", "1   9      2.5", 31, "run 1 has not every target once"),
    ("2   5      3.0\n2   4      2.0\n", "2   4      2.0\n2   5      3.0\n", 37, "back and forth"),
    ("Axis:X", "Axis:Q", 18, "measured axis is not known"),
    ("20.40 0", "68.40 3", 43, "unknown unit of Air temp"),
    ("20.30 20.40 0", "20.30", 43, "Air temp is not complete"),
]
