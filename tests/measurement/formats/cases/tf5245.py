"""Beckhoff TF5245: the numbers of both examples in its documentation, in one program written for this test."""

from __future__ import annotations

import numpy as np

from twin.measurement.formats import Given

FILE = "poses.nc"
MACHINE = "trunnion_ac"
GIVEN = Given(offset={"Z": -300.0})
CONTACTS = np.array(
    [
        [101.807, 273.174, 130.068],
        [116.795, 258.750, 130.068],
        [104.246, 244.524, 129.024],
        [89.606, 257.804, 132.980],
        [96.606, 269.804, 133.957],
        [102.780, 264.366, 139.522],
    ]
)
"""Contacts on the page "Direct input of measurement data"."""
CENTRE = (102.545449, 258.949268, 125.6186118)
"""Centre on the page "Sphere centre points already calculated"."""
GOOD = (
    "#VAR\nV.L.POSES = 2 ; poses\nV.L.N = 6   ( points )\nV.L.X[V.L.N]  ( X )\nV.L.A = 20\nV.L.B = 0\n#ENDVAR\n"
    'L CYCLE [NAME = "SysCalibFitInit.ecy" \\\n @P1 = 80 @P2 = 0 @P3 = V.L.POSES ]\n'
    + "".join(
        f"V.L.X[{i}] = {x:.3f}  V.L.Y[{i}] = {y:.3f}  V.L.Z[{i}] = {z:.3f}\n" for i, (x, y, z) in enumerate(CONTACTS)
    )
    + 'L CYCLE [NAME = "SysCalcSphere.ecy"]\n'
    'L CYCLE [NAME = "SysCalibFitAddRecord.ecy" \\\n'
    " @P1 = V.L.RESULT_V[0] @P2 = V.L.RESULT_V[1] \\ (centre)\n @P3 = V.L.RESULT_V[2] \\\n"
    " @P4 = V.L.A @P5 = V.L.B @P6 = 0 ]\n"
    'L CYCLE [NAME = "SysCalibFitAddRecord.ecy" \\\n'
    f" @P1 = {CENTRE[0]} @P2 = {CENTRE[1]} @P3 = {CENTRE[2]} @P4 = 20 @P5 = 0 @P6 = 0 ]\n"
)
ROWS = {
    "positions": np.array([[*CENTRE[:2], CENTRE[2] - 300.0, 20.0, 0.0]] * 2),
    "point_mm": np.zeros((2, 3)),
    "approach": np.zeros((2, 5)),
}
SIDES = ("probe", "tool", "work")
AGREES_MM = 2e-5
"""The documentation gives the algebraic fit; the geometric one differs by 10 nm in Z."""
BAD = [
    ("@P4 = V.L.A", "@P4 = V.L.Q", 17, "variable without a value"),
    ("@P5 = 0 @P6 = 0 ]", "@P5 = 7 @P6 = 0 ]", 21, "no rotary axis B"),
    ("@P4 = 20 ", "", 21, "@P4 missing"),
    ("V.L.POSES = 2", "V.L.POSES = 3", 21, "2 records"),
    ("V.L.N = 6", "V.L.N = 7", 16, "variable without a value"),
    ("V.L.N = 6", "V.L.N = 3", 17, "3 contacts on a sphere"),
    ('L CYCLE [NAME = "SysCalcSphere.ecy"]\n', "", 16, "RESULT_V has no value"),
    ("V.L.B = 0\n", "$FOR V.L.I = 0, 5, 1\n", 6, "control flow"),
    ("@P5 = 0 @P6 = 0 ]\n", "@P5 = 0 @P6 = 0\n", 21, "call without its end"),
]
