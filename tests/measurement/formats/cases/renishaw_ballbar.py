"""Ball bar: elements of the public descriptions, with an invented element for the readings, which no description covers."""

from __future__ import annotations

import numpy as np

from twin.measurement.formats import Given

FILE = "circle.b5r"
MACHINE = "dmu50"
GIVEN = Given(at={"X": 250.0, "Y": 225.0, "Z": -200.0, "B": 0.0, "C": 0.0})
N = 9
DEVIATIONS = {
    "CCW": [0.0, 1.5, 2.5, 1.0, 0.5, -0.5, -1.5, -1.0, 0.1],
    "CW": [0.2, -1.0, -1.5, 0.5, 1.0, 2.0, 2.5, 1.0, 0.3],
}
GOOD = (
    '<?xml version="1.0" encoding="utf-8" standalone="yes"?>\n<TEST_DOCUMENT>\n'
    '<TEST_SPEC NAME="100mm XY 1000" version="2.0"><INSTRUMENT MANUFACTURER="Renishaw" MODEL="QC20">\n'
    '<DYNAMIC_BALLBAR CALIBRATION_REQUIRED="true">\n<NOMINAL_LENGTH>100</NOMINAL_LENGTH>\n'
    '<PROGRAMMED_FEEDRATE>1000</PROGRAMMED_FEEDRATE>\n<PLANE VIEW="+A+B" TEST_PLANE="XY">\n'
    "<A_AXIS_NAME>X</A_AXIS_NAME><B_AXIS_NAME>Y</B_AXIS_NAME></PLANE></DYNAMIC_BALLBAR></INSTRUMENT></TEST_SPEC>\n"
    '<MACHINE_TESTED NAME="M"/>\n<RUN_RESULTS>\n'
    + "".join(
        f"<BALLBAR_RUN>\n<RUN_DIRECTION>{name}</RUN_DIRECTION>\n"
        f'<FEATURE NAME="AF_CALCULATED_FEEDRATE" DT="UT_FEEDRATE">{feed}</FEATURE>\n'
        f'<READINGS DT="UT_LENGTH_UM">{" ".join(map(str, DEVIATIONS[name]))}</READINGS>\n</BALLBAR_RUN>\n'
        for name, feed in (("CCW", 998.5), ("CW", 1001.5))
    )
    + '</RUN_RESULTS>\n<ANALYSIS NAME="RENISHAW_DIAGNOSTICS" version="2.1">\n'
    '<FEATURE NAME="AF_CIRCULARITY" DT="UT_LENGTH_UM">5.1</FEATURE>\n</ANALYSIS>\n</TEST_DOCUMENT>\n'
)


def _rows() -> dict[str, np.ndarray]:
    """Return the rows from the complex plane: the point at e^(iφ), moving along ±i·e^(iφ)."""
    turns = {"CCW": np.exp(2j * np.pi * np.arange(N) / 8), "CW": np.exp(-2j * np.pi * np.arange(N) / 8)}
    points = np.concatenate([turns["CCW"], turns["CW"]])
    motion = np.concatenate([1j * turns["CCW"], -1j * turns["CW"]])
    motion = np.round(motion, 6)
    still = np.zeros(2 * N)
    lengths = 100.0 + np.array(DEVIATIONS["CCW"] + DEVIATIONS["CW"]) * 1e-3
    centre = np.array([250.0, 225.0, -200.0, 0.0, 0.0])
    return {
        "positions": centre + np.stack([100 * points.real, 100 * points.imag, still, still, still], axis=1),
        "point_mm": np.stack([lengths, still + np.nan, still + np.nan], axis=1),
        "approach": np.stack([np.sign(motion.real), np.sign(motion.imag), still, still, still], axis=1),
        "feed_mm_min": np.repeat([998.5, 1001.5], N),
    }


ROWS = _rows()
SIDES = ("pivot", "work", "tool")
AGREES_MM = 1e-9
BAD = [
    ("<TEST_DOCUMENT>", "<!DOCTYPE x [<!ENTITY a 'b'>]>\n<TEST_DOCUMENT>", 2, "document type declaration"),
    ("</TEST_DOCUMENT>", "", 26, "not XML"),
    ('VIEW="+A+B"', 'VIEW="-A+B"', 7, "unknown VIEW"),
    ('TEST_PLANE="XY"', 'TEST_PLANE="ZX"', 7, "TEST_PLANE does not fit"),
    ("<A_AXIS_NAME>X<", "<A_AXIS_NAME>B<", 8, "unknown axis in A_AXIS_NAME"),
    ("<NOMINAL_LENGTH>100</NOMINAL_LENGTH>", "", 4, "0 <NOMINAL_LENGTH>"),
    (">100</NOMINAL", ">-100</NOMINAL", 5, "not positive"),
    ("DIRECTION>CW<", "DIRECTION>ABOVE<", 17, "unknown direction"),
    ('READINGS DT="UT_LENGTH_UM"', 'READINGS DT="UT_LENGTH_INCH"', 11, "0 lists of lengths"),
    ('"UT_FEEDRATE"', '"UT_SPEED"', 13, "unknown unit of the feed"),
    ('READINGS DT="UT_LENGTH_UM"', 'READINGS DT="UT_LENGTH_M"', 14, "outside the travel"),
    ("0.0 1.5 2.5", "0.0 x 2.5", 11, "0 lists of lengths"),
]
