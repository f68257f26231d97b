"""Tilted working planes: G68.2 with G53.1, PLANE SPATIAL, CYCLE800.

Truth: rotations by SciPy in the convention that each manual prints, and the closed chain of the DMU 50 (contract, clause 1) without
errors, written here again.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.model.errors import random_calibration
from tests.nc.nc_support import AXES
from tests.truth.reference import D, about, translation
from twin._common.errors import InputError
from twin.compensation import Compensation, Compensator, Options
from twin.compensation.programs.compensator import compensate_file
from twin.compensation.programs.words import Setup
from twin.controls.offsets import OffsetTable
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import DIALECTS
from twin.nc.blocks import Kind
from twin.nc.chunks import ChunkRewriter

LENGTH = 30.0
ZERO = np.array([0.0, 0.0, 30.0])
"""Place of G54 in the work frame: the nose stands over the table's centre at X 250, Y 225, and on it at Z −400."""
OFFSETS = OffsetTable(Path("o.csv"), {"G54": {"X": 250.0, "Y": 225.0, "Z": -370.0}})
ISO, HEIDENHAIN = DIALECTS[0], DIALECTS[1]
POINTS = np.array([[0.0, 0.0, 20.0], [0.0, 0.0, 0.0], [20.0, 0.0, 0.0], [20.0, 15.0, 3.0]])
INSIDE = "G0 X0. Y0. Z20.\nG1 Z0. F200.\nX20.\nY15. Z3.\n"
INSIDE_H = "L X+0 Y+0 Z+20 FMAX\nL Z+0 F200\nL X+20\nL Y+15 Z+3\n"
HEAD = "G90 G21\nG54\nG0 X0. Y0. Z60. B0. C0.\n"
HEAD_H = "BEGIN PGM A MM\nL X+0 Y+0 Z+60 B+0 C+0 FMAX\n"
TURNED = Rotation.from_euler("xyz", [20, -30, 15], degrees=True)
SPATIAL = "PLANE SPATIAL SPA+20 SPB-30 SPC+15"
RESET_H = "PLANE RESET STAY\nEND PGM A MM\n"
X_AXIS, Y_AXIS, NORMAL = TURNED.as_matrix().T.round(9).tolist()


def table_of(b_deg: float, c_deg: float) -> np.ndarray:
    """Return the (4, 4) pose of the workpiece in the machine, without errors."""
    b, c = np.radians([b_deg, c_deg])
    swivel = about(0, np.pi / 4) @ about(2, b) @ about(0, -np.pi / 4)
    return translation(0, 0, D) @ swivel @ translation(0, 0, -D) @ about(2, -c)


def standing(rotation: Rotation) -> tuple[float, float]:
    """Return B and C at which the tool is along the normal of a plane, by bisection of B and an angle for C."""
    normal = rotation.apply([0.0, 0.0, 1.0])
    low, high = 0.0, 180.0  # the tool's z component in the workpiece falls with B
    for _ in range(60):
        b = 0.5 * (low + high)
        low, high = (b, high) if table_of(b, 0.0)[2, 2] > normal[2] else (low, b)
    axis = np.linalg.inv(table_of(b, 0.0)[:3, :3])[:, 2]
    c = np.degrees(np.arctan2(axis[1], axis[0]) - np.arctan2(normal[1], normal[0]))
    turned = [np.linalg.inv(table_of(b, sign * c)[:3, :3])[:, 2] for sign in (1.0, -1.0)]
    return b, float(c if np.linalg.norm(turned[0] - normal) < 1e-9 else -c)


B, C = standing(TURNED)
ANGLES = " ".join(f"{name}{deg:+.7f}" for name, deg in zip("ABC", TURNED.as_euler("xyz", degrees=True), strict=True))
MACHINE_AXES = Rotation.from_matrix(np.linalg.inv(table_of(40.0, -25.0)[:3, :3]))
PLANES = {
    # name: (program, rotation, origin in the program's coordinates)
    "G68.2": (
        f"{HEAD}G68.2 X10. Y5. Z2. I30. J25. K-40.\nG53.1\n{INSIDE}G69\n",
        Rotation.from_euler("ZXZ", [30, 25, -40], degrees=True),
        (10, 5, 2),
    ),
    "G68.2 without tilt": (
        f"{HEAD}G68.2 X10. Y5. Z2. I30. J0. K0.\nG53.1\n{INSIDE}G69\n",
        Rotation.from_euler("Z", 30, degrees=True),
        (10, 5, 2),
    ),
    "CYCLE800 57": (
        f'{HEAD}CYCLE800(0,"TC1",0,57,10,5,2,20,-30,15,1,2,3,1)\n{INSIDE}CYCLE800()\n',
        Rotation.from_euler("XYZ", [20, -30, 15], degrees=True),
        (10, 5, 2, 1, 2, 3),
    ),
    "CYCLE800 39": (
        f'{HEAD}CYCLE800(0,"TC1",0,39,10,5,2,20,-30,15,0,0,0,1)\n{INSIDE}CYCLE800()\n',
        Rotation.from_euler("ZXY", [20, -30, 15], degrees=True),
        (10, 5, 2),
    ),
    "CYCLE800 27": (
        f'{HEAD}R1=15\nCYCLE800(0,"TC1",0,27,10,5,2,20,-30,R1,0,0,0,1)\n{INSIDE}CYCLE800()\n',
        Rotation.from_euler("ZYX", [20, -30, 15], degrees=True),
        (10, 5, 2),
    ),
    "PLANE SPATIAL": (
        f"{HEAD_H}PLANE SPATIAL SPA+20 SPB-30 SPC+15 TURN FMAX\n{INSIDE_H}PLANE RESET STAY\nEND PGM A MM\n",
        Rotation.from_euler("xyz", [20, -30, 15], degrees=True),
        (0, 0, 0),
    ),
    "PLANE SPATIAL, MOVE": (
        f"{HEAD_H}PLANE SPATIAL SPA+0 SPB+35 SPC+0 MOVE DIST20 F5000 SEQ+\n{INSIDE_H}PLANE RESET STAY\nEND PGM A MM\n",
        Rotation.from_euler("y", 35, degrees=True),
        (0, 0, 0),
    ),
    "PLANE SPATIAL, STAY": (
        f"{HEAD_H}{SPATIAL} STAY TABLE ROT\nL B+Q121 C+Q122 R0 FMAX M126\n{INSIDE_H}{RESET_H}",
        TURNED,
        (0, 0, 0),
    ),
    "PLANE SPATIAL, STAY, in numbers": (
        f"{HEAD_H}{SPATIAL} STAY\nL B{B:+.4f} C{C:+.4f} FMAX\n{INSIDE_H}{RESET_H}",
        TURNED,
        (0, 0, 0),
    ),
    "PLANE SPATIAL, STAY, where the axes stand": (
        f"{HEAD_H}L B{B:+.4f} C{C:+.4f} FMAX\n{SPATIAL} STAY\n{INSIDE_H}{RESET_H}",
        TURNED,
        (0, 0, 0),
    ),
    "PLANE EULER": (
        f"{HEAD_H}PLANE EULER EULPR30 EULNU25 EULROT-40 TURN FMAX\n{INSIDE_H}{RESET_H}",
        Rotation.from_euler("ZXZ", [30, 25, -40], degrees=True),
        (0, 0, 0),
    ),
    "PLANE VECTOR": (
        f"{HEAD_H}PLANE VECTOR BX{X_AXIS[0]} BY{X_AXIS[1]} BZ{X_AXIS[2]} NX{NORMAL[0]} NY{NORMAL[1]} NZ{NORMAL[2]} TURN FMAX\n"
        f"{INSIDE_H}{RESET_H}",
        TURNED,
        (0, 0, 0),
    ),
    "PLANE POINTS": (
        f"{HEAD_H}PLANE POINTS P1X+1 P1Y+2 P1Z+3 P2X{1 + X_AXIS[0]:+.9f} P2Y{2 + X_AXIS[1]:+.9f} P2Z{3 + X_AXIS[2]:+.9f} "
        f"P3X{1 + X_AXIS[0] + 2 * Y_AXIS[0]:+.9f} P3Y{2 + X_AXIS[1] + 2 * Y_AXIS[1]:+.9f} P3Z{3 + X_AXIS[2] + 2 * Y_AXIS[2]:+.9f} "
        f"TURN FMAX\n{INSIDE_H}{RESET_H}",
        TURNED,
        (0, 0, 0),
    ),
    "PLANE RELATIV after another": (
        f"{HEAD_H}{SPATIAL} TURN FMAX\nPLANE RELATIV SPB-12 TURN FMAX\n{INSIDE_H}{RESET_H}",
        TURNED * Rotation.from_euler("Y", -12, degrees=True),
        (0, 0, 0),
    ),
    "PLANE SPATIAL after another, in a shift": (
        f"{HEAD_H}CYCL DEF 7.1 X+10\nCYCL DEF 7.2 Y+5\nPLANE SPATIAL SPA+5 SPB+5 SPC+0 TURN\n{SPATIAL} TURN\n{INSIDE_H}END PGM A MM\n",
        TURNED,
        (10, 5, 0),
    ),
    "G53.6": (
        f"{HEAD}G68.2 X10. Y5. Z2. I30. J25. K-40.\nG53.6\n{INSIDE}G69\n",
        Rotation.from_euler("ZXZ", [30, 25, -40], degrees=True),
        (10, 5, 2),
    ),
    "G68.2 P1 with one angle": (
        f"{HEAD}G68.2 P1 Q321 X10. J25.\nG53.1\n{INSIDE}G69\n",
        Rotation.from_euler("Y", 25, degrees=True),
        (10, 0, 0),
    ),
    "CYCL DEF 19": (
        f"{HEAD_H}CYCL DEF 19.0 WORKING PLANE\nCYCL DEF 19.1 {ANGLES}\nL B+Q121 C+Q122 R0 FMAX\n{INSIDE_H}{RESET_H}",
        TURNED,
        (0, 0, 0),
    ),
    "G68.2 where the axes stand": (
        f"{HEAD}G0 B{B:.4f} C{C:.4f}\nG68.2 X10. I{{0}} J{{1}} K{{2}}\n{INSIDE}G69\n".format(
            *TURNED.as_euler("ZXZ", degrees=True).round(7)
        ),
        TURNED,
        (10, 0, 0),
    ),
    "CYCLE800 that positions nothing": (
        f'{HEAD}CYCLE800(0,"TC1",0,27,10,5,2,15,-30,20,0,0,0,0)\nG0 B={B:.4f} C={C:.4f}\n{INSIDE}CYCLE800()\n',
        TURNED,
        (10, 5, 2),
    ),
    "G68.2 P2": (
        f"{HEAD}G68.2 P2 Q0 X0 Y0 Z0 R0\n"
        + "".join(
            "G68.2 P2 Q{} X{:.6f} Y{:.6f} Z{:.6f}\n".format(i, *(np.array([10, 5, 2]) + TURNED.apply(point)))
            for i, point in enumerate([(0, 0, 0), (40, 0, 0), (-25, 30, 0)], 1)
        )
        + f"G53.1\n{INSIDE}G69\n",
        TURNED,
        (10, 5, 2),
    ),
    "G68.2 P3": (
        f"{HEAD}G68.2 P3 Q1 X10 Y5 Z2 I{X_AXIS[0]} J{X_AXIS[1]} K{X_AXIS[2]}\n"
        f"G68.2 P3 Q2 I{NORMAL[0]} J{NORMAL[1]} K{NORMAL[2]}\nG53.1\n{INSIDE}G69\n",
        TURNED,
        (10, 5, 2),
    ),
    "G68.2 P3 where the axes stand": (
        f"{HEAD}G0 B{B:.4f} C{C:.4f}\nG68.2 P3 Q1 X10 Y5 Z2 I{X_AXIS[0]} J{X_AXIS[1]} K{X_AXIS[2]}\n"
        f"G68.2 P3 Q2 I{NORMAL[0]} J{NORMAL[1]} K{NORMAL[2]}\n{INSIDE}G69\n",
        TURNED,
        (10, 5, 2),
    ),
    "G53.3": (
        f"{HEAD}G68.2 X10. Y5. Z2. I30. J25. K-40.\nG53.3 X0. Y0. Z20.\n{INSIDE.removeprefix('G0 X0. Y0. Z20.')[1:]}G69\n",
        Rotation.from_euler("ZXZ", [30, 25, -40], degrees=True),
        (10, 5, 2),
    ),
    "G268": (f"{HEAD}G268 X10. Y5. Z2. I20. J-30. K15. Q123\nG253\n{INSIDE}G269\n", TURNED, (10, 5, 2)),
    "G268 where the axes stand": (
        f"{HEAD}G0 B{B:.4f} C{C:.4f}\nG268 X10. Y5. Z2. I20. J-30. K15. Q123\n{INSIDE}G269\n",
        TURNED,
        (10, 5, 2),
    ),
    "CYCLE800 by solid angles": (
        f'{HEAD}CYCLE800(0,"TC1",100000,64,10,5,2,35,28,0,1,2,3,1)\n{INSIDE}CYCLE800()\n',
        Rotation.from_euler("ZY", [35, 28], degrees=True),
        (10, 5, 2, 1, 2, 3),
    ),
    "CYCLE800 after another": (
        f'{HEAD}CYCLE800(0,"TC1",0,57,1,1,1,9,8,7,0,0,0,1)\nG0 X5 Y5 Z40\n'
        f'CYCLE800(0,"TC1",10,57,10,5,2,20,-30,15,0,0,0,1)\n{INSIDE}CYCLE800(0,"0",0,57,0,0,0,0,0,0,0,0,0,1)\n',
        Rotation.from_euler("XYZ", [20, -30, 15], degrees=True),
        (10, 5, 2),
    ),
    "CYCLE800 added to another": (
        f'{HEAD}CYCLE800(0,"TC1",0,57,10,5,2,20,0,0,0,0,0,1)\nG0 X5 Y5 Z40\n'
        f'CYCLE800(0,"TC1",1,57,0,0,0,0,-30,15,0,0,0,1)\n{INSIDE}CYCLE800()\n',
        Rotation.from_euler("XYZ", [20, -30, 15], degrees=True),
        (10, 5, 2),
    ),
    "G254": (f"{HEAD}G0 B40. C-25.\nG254\n{INSIDE}G255\n", MACHINE_AXES, (0, 0, 0)),
}
REFUSED = [
    (f"{HEAD}G68.2 I30. J25. K0.\nG0 X1.\n", "24.8° off the tilted plane", 5),
    (f"{HEAD}G68.2 I30. J25. K0.\n" + "X1.\nX2.\n" * 60, "24.8° off the tilted plane", 5),
    (f"{HEAD}G68.2 I30. J25. K0.\nG0 X1. B5.\n", "between G68.2 and G53.1", 5),
    (f"{HEAD}G268 I30. J25. K0.\n", "G268 without Q123", 4),
    (f"{HEAD}G268 I30. J25. K0. Q321\n", "G268 without Q123", 4),
    (f"{HEAD}G268 I30. J25. K0. Q123 R5.\n", "G268 with R", 4),
    (f"{HEAD}G253\n", "G253 without a tilted plane", 4),
    (f"{HEAD}G68.2 P4 I30. J25. K0.\n", "G68.2 with P4", 4),
    (f"{HEAD}G68.2 P2 Q0 X0. Y0. Z5.\n", "Q0 with a shift", 4),
    (f"{HEAD}G68.2 P2 Q1 X0. Y0. Z5.\nG0 X5.\n", "P2 that is not complete", 5),
    (f"{HEAD}G68.2 P2 Q1 X0. Y0. Z5.\n" + "X5.\nY5.\n" * 60, "P2 that is not complete", 5),
    (f"{HEAD}G68.2 P2 Q1 X0. Y0. Z5.\nG53.1\n", "P2 that is not complete", 5),
    (f"{HEAD}G68.2 P2 Q1 X0. Y0. Z5.\nG68.2 I5. J5.\n", "P2 that is not complete", 5),
    (f"{HEAD}G68.2 P2 Q1 X0. Y0. Z5.\nG68.2 P2 Q3 X9. Y0. Z5.\n", "out of order", 5),
    (f"{HEAD}G68.2 P2 Q1 X0. Y0. Z5.\nG68.2 P2 Q2 X9. Y0.\n", "out of order, or with other words", 5),
    (f"{HEAD}G68.2 P2 Q1 X0 Y0 Z5\nG68.2 P2 Q2 X9 Y0 Z5\nG68.2 P2 Q3 X8 Y0 Z5\n", "vector of length zero", 6),
    (f"{HEAD}G68.2 P3 Q1 X0 Y0 Z5 I1 J0 K0\nG68.2 P2 Q2 X9 Y0 Z5\n", "out of order", 5),
    (f"{HEAD}G68.2 P3 Q1 X0 Y0 Z5 I1 J0 K0.02\nG68.2 P3 Q2 I0 J0 K1\n", "not perpendicular", 5),
    (f"{HEAD}G68.2 I30. J25. K0.\nG53.3 X5. F100\nG69\nG53.3 X5 I2\n", "unknown word", 7),
    (f'{HEAD}CYCLE800(0,"T",0,64,0,0,0,20,-30,15,0,0,0,1)\n', "CYCLE800 of this kind", 4),
    (f'{HEAD}CYCLE800(0,"T",100,57,0,0,0,20,-30,15,0,0,0,1)\n', "CYCLE800 of this kind", 4),
    (f'{HEAD}CYCLE800(0,"0",0,57,0,0,0,20,-30,15,0,0,0,1)\n', "CYCLE800 of this kind", 4),
    ("G90 G21\nG54\nG0 X0 Y0 Z60\nG254\n", "G254 at unknown positions", 4),
    (f"{HEAD}G254 X5.\n", "unknown word in a block with a tilted plane", 4),
    (f"{HEAD}G254\nG0 B5.\n", "rotary axes or tool centre point", 5),
    (f"{HEAD}G53.1\n", "without a tilted plane", 4),
    (f"{HEAD}G68.2 P1 I30. J25. K0.\n", "G68.2 with P", 4),
    (f"{HEAD}G68.2 I30. J25. K0.\nG53.1\nG0 B10.\n", "rotary axes or tool centre point", 6),
    (f"{HEAD}G68.2 I30. J25. K0.\nG53.1\nG43.4 H1\nG0 X0. Y0. Z50.\n", "rotary axes or tool centre point", 7),
    (f"{HEAD}G68.2 I30. J25. K0.\nG53.1\nG68.2 I30. J25. K0.\n", "within a tilted plane", 6),
    (f"{HEAD}G68.2 I0. J120. K0.\nG53.1\nG0 X0. Y0. Z50.\n", "cannot reach this tilted plane", 6),
    (f'{HEAD}CYCLE800(0,"T",0,192,0,0,0,20,-30,15,0,0,0,1)\n', "CYCLE800 of this kind", 4),
    (f'{HEAD}CYCLE800(0,"T",0,57,0,0,0,20,-30,15,0,0,0,2)\n', "unknown DIR", 4),
    (f'{HEAD}CYCLE800(0,"T",0,57,0,0,0,20,-30,15,0,0,0,0)\nX1.\n', "off the tilted plane", 5),
    (f"{HEAD_H}{SPATIAL} STAY\nL X+5\n", "off the tilted plane", 4),
    (f"{HEAD_H}{SPATIAL} STAY\nL X+5 B+Q121 C+Q122\n", "STAY and its positioning", 4),
    (f"{HEAD_H}{SPATIAL} STAY\nL B+Q121\n", "every rotary axis", 4),
    (f"{HEAD_H}{SPATIAL} STAY\nL B+Q122 C+Q121\n", "value of B is unknown", 4),
    (f"{HEAD_H}{SPATIAL} STAY\nCYCL DEF 7.1 X+5\n", "between PLANE with STAY", 4),
    (f"{HEAD_H}{SPATIAL}\n", "says nothing of the rotary axes", 3),
    (f"{HEAD_H}PLANE SPATIAL SPA+0 SPB+0 SPC+30 TURN TABLE ROT\n", "only turns about the tool axis", 3),
    (f"{HEAD_H}PLANE VECTOR BX1 BY0 BZ0 NX1 NY0 NZ0 TURN FMAX\n", "two parallel vectors", 3),
    (f"{HEAD_H}PLANE VECTOR BX1 BY0 BZ0 TURN FMAX\n", "with other words", 3),
    (f"{HEAD_H}PLANE RELATIVE SPA+5 SPB+5 TURN\n", "about several axes", 3),
    (f"{HEAD_H}PLANE PROJECTED PROPR+24 PROMIN+24 ROT+30 TURN\n", "transformation PLANE PROJECTED", 3),
    (
        f"{HEAD_H}CYCL DEF 19.1 B+30 C+10\nL B+Q121 C+Q122 R0 FMAX\nL X+5\n",
        "another plane as positions of the rotary axes",
        5,
    ),
    (f"{HEAD_H}CYCL DEF 19.1 A+20 B+30\nL X+5 B+Q121 C+Q122 R0 FMAX\n", "STAY and its positioning", 4),
    (f"{HEAD_H}PLANE AXIAL B+45 TURN\n", "transformation PLANE AXIAL", 3),
]


@pytest.fixture(scope="module")
def errors(dmu50: Machine) -> Calibration:
    return random_calibration(dmu50, np.random.default_rng(8), size=30.0)


def compensated(text: str, machine: Machine, errors: Calibration) -> Compensation:
    dialect = HEIDENHAIN if text.startswith("BEGIN") else ISO
    setup = (
        Setup(offsets=OFFSETS) if dialect is ISO else Setup(work_offset=OFFSETS.rows["G54"] | {"Z": -370.0 + LENGTH})
    )
    compensator = Compensator(machine, errors, Options(setup=setup, tool_length_mm=LENGTH))
    return compensator.compensate(dialect.read(text.encode(), "part"), dialect)


def in_work(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return tool tip and tool axis in the work frame for axis positions of the machine without errors."""
    tool = translation(-250 + q[0], -225 + q[1], 400 + q[2] - LENGTH)
    pose = np.linalg.inv(table_of(*q[3:])) @ tool
    return pose[:3, 3], pose[:3, 2]


def of_plane(rotation: Rotation, origin: tuple[float, ...], points: np.ndarray) -> np.ndarray:
    """Return points of a plane in the work frame."""
    before, after = np.array(origin[:3], dtype=float), np.array(origin[3:] or (0, 0, 0), dtype=float)
    return ZERO + before + rotation.apply(after + points)


@pytest.mark.parametrize("name", PLANES)
def test_the_tool_is_where_the_plane_says(dmu50: Machine, errors: Calibration, name: str) -> None:
    text, rotation, origin = PLANES[name]
    result = compensated(text, dmu50, errors)
    ends = [int(np.flatnonzero(result.moves == move)[-1]) for move in np.unique(result.moves)[-4:]]
    wanted, normal = of_plane(rotation, origin, POINTS), rotation.apply([0.0, 0.0, 1.0])
    for row, point in zip(ends, wanted, strict=True):
        tip, axis = in_work(result.nominal[row])
        # The rotary axes stop at their least increments; the linear axes reach the point for where they stopped.
        assert np.linalg.norm(tip - point) < 1e-6
        assert np.linalg.norm(axis - normal) < np.radians(0.001)
    assert result.report.after.max_um < 2.0
    assert result.report.before.max_um > 10.0


@pytest.mark.sample(4)  # of 20
@pytest.mark.parametrize("name", PLANES)
def test_the_words_of_the_output_lead_to_the_compensated_commands(
    dmu50: Machine, errors: Calibration, name: str
) -> None:
    """Read by hand: the words in the output's plane, at the rotary positions of the control."""
    import re

    text, rotation, origin = PLANES[name]
    result = compensated(text, dmu50, errors)
    begin = r"G53\.1|G53\.6|(?=G53\.3)|G254|G253|G68\.2|G268|CYCLE800\(0,\"TC1|PLANE (?:SPATIAL|EULER|VECTOR|POINTS|RELATIV)|L B\+Q121"
    body = re.split(begin, result.text)[-1]
    body = body if body.startswith("G53.3") else body.partition("\n")[2]
    lines = re.split(r"G69|G269|G255|CYCLE800\((?:0,\"0.*)?\)|PLANE RESET", body)[0].splitlines()
    position, words = {}, []
    for line in lines:
        found = re.findall(r"([XYZ])([-+]?[\d.]+)", line)
        position |= {axis: float(value) for axis, value in found}
        if found:
            words.append([position[axis] for axis in "XYZ"])
    rows = np.flatnonzero(np.isin(result.moves, np.unique(result.moves)[-4:]))
    assert len(words) == len(rows)
    for row, point in zip(rows, of_plane(rotation, origin, np.array(words)), strict=True):
        assert np.linalg.norm(in_work(result.commands[row])[0] - point) < 1e-6
        assert result.commands[row, 3:] == pytest.approx(result.nominal[row, 3:], abs=1e-9)


@pytest.mark.parametrize("mode", [(57, 27), (39, 54), (45, 30)])
def test_rotations_that_are_added_undo_themselves(dmu50: Machine, errors: Calibration, mode: tuple[int, int]) -> None:
    """The opposite angles in the opposite order lead back to the plane before."""
    rng = np.random.default_rng(mode[0])
    for _ in range(3):
        a, b, c = rng.uniform(-25, 25, 3).round(3)
        plane = 'CYCLE800(0,"TC1",0,57,10,5,2,20,-30,15,0,0,0,1)\n'
        added = f'CYCLE800(0,"TC1",1,{mode[0]},0,0,0,{a},{b},{c},3,-4,5,1)\n'
        undone = f'CYCLE800(0,"TC1",1,{mode[1]},-3,4,-5,{-c},{-b},{-a},0,0,0,1)\n'
        end = f"{INSIDE}CYCLE800()\n"
        once, there_and_back = (
            compensated(f"{HEAD}{text}{end}", dmu50, errors) for text in (plane, plane + added + undone)
        )
        assert there_and_back.nominal[-4:] == pytest.approx(once.nominal[-4:], abs=2e-6)


def test_the_same_solid_on_every_control(dmu50: Machine, errors: Calibration) -> None:
    """One plane written for three controls gives the same axis commands."""
    fanuc = f"{HEAD}G68.2 I0. J25. K0.\nG53.1\n{INSIDE}G69\n"
    siemens = f'{HEAD}CYCLE800(0,"TC1",0,57,0,0,0,25,0,0,0,0,0,1)\n{INSIDE}CYCLE800()\n'
    klartext = f"{HEAD_H}PLANE SPATIAL SPA+25 SPB+0 SPC+0 TURN FMAX\n{INSIDE_H}PLANE RESET STAY\nEND PGM A MM\n"
    found = [compensated(text, dmu50, errors).commands for text in (fanuc, siemens, klartext)]
    assert found[1] == pytest.approx(found[0], abs=1e-9)
    assert found[2] == pytest.approx(found[0], abs=1e-9)


def test_drilling_in_a_plane_goes_along_the_tool(dmu50: Machine, errors: Calibration) -> None:
    text = f"{HEAD}G68.2 I30. J25. K0.\nG53.1\nG0 X0. Y0. Z20.\nG99 G81 X5. Y5. Z-3. R2. F100.\nG80\nG69\n"
    result = compensated(text, dmu50, errors)
    down = [i for i, move in enumerate(result.reading.moves) if move.position[2] in (2.0, -3.0)][:2]
    top, bottom = (in_work(result.nominal[np.flatnonzero(result.moves == i)[-1]])[0] for i in down)
    along = Rotation.from_euler("ZX", [30, 25], degrees=True).apply([0.0, 0.0, -5.0])
    assert bottom - top == pytest.approx(along, abs=1e-6)


def test_a_long_program_with_a_plane_is_read_whole(dmu50: Machine, errors: Calibration, tmp_path: Path) -> None:
    """From file to file, where plain programs are processed in parts."""
    text, _, _ = PLANES["G68.2"]
    (tmp_path / "part.nc").write_text(text)
    options = Options(setup=Setup(work_offset=OFFSETS.rows["G54"] | {"Z": -370.0 + LENGTH}), tool_length_mm=LENGTH)
    report = compensate_file(tmp_path / "part.nc", tmp_path / "out.nc", dmu50, errors, options=options)
    assert (tmp_path / "out.nc").read_text() == compensated(text, dmu50, errors).text.replace("part.nc", "part.nc")
    assert [bool(use.tilted_deg) for use in report.frames] == [False, True]
    assert "tilted plane" in report.to_text()


@pytest.mark.parametrize(("text", "words", "line"), REFUSED)
def test_other_planes_are_refused(dmu50: Machine, text: str, words: str, line: int) -> None:
    with pytest.raises(InputError, match=words) as caught:
        compensated(text, dmu50, Calibration.zero(dmu50))
    assert caught.value.line == line


def test_a_program_with_planes_cannot_lose_blocks(dmu50: Machine, tmp_path: Path) -> None:
    from twin.compensation.fewer_blocks.refit import Refitter

    program = ISO.read(PLANES["G68.2"][0].encode(), "part.nc")
    with pytest.raises(InputError, match="cannot be refitted"):
        Refitter(dmu50, Calibration.zero(dmu50)).refit(program, ISO)


@pytest.mark.sample(5)  # of 16
@pytest.mark.parametrize(
    ("text", "sign"),
    [
        ("G68.2 I20. J25. K0.\nG53.1 P1\n", 1),
        ("G68.2 I20. J25. K0.\nG53.1 P2\n", -1),
        ('CYCLE800(0,"T",0,57,0,0,0,25,0,0,0,0,0,1)\n', 1),
        ('CYCLE800(0,"T",0,57,0,0,0,25,0,0,0,0,0,-1)\n', -1),
        ("PLANE SPATIAL SPA+25 SPB+0 SPC+0 TURN FMAX SEQ+\n", 1),
        ("PLANE SPATIAL SPA+25 SPB+0 SPC+0 TURN FMAX SEQ-\n", -1),
        ("G68.2 I20. J25. K0.\nG53.1\n", 1),
        ("G68.2 I200. J25. K0.\nG53.1 P0\n", -1),
    ],
)
@pytest.mark.parametrize("standing", [10.0, -10.0])
def test_the_program_chooses_between_two_positions(text: str, sign: int, standing: float) -> None:
    """On a trunnion that tilts both ways: the axis nearer the tool becomes positive or negative, or C takes the shorter way."""
    machine = Machine.load("xyzbc_trunnion")
    if text.startswith("PLANE"):
        dialect, inside = HEIDENHAIN, "L X+0 Y+0 Z+5 FMAX\n"
        head = f"BEGIN PGM A MM\nL X+0 Y+0 Z+200 B{standing:+} C+0 FMAX\n"
    else:
        dialect, inside, head = ISO, "G0 X0. Y0. Z5.\n", f"G90 G21\nG0 X0. Y0. Z200. B{standing} C0.\n"
    result = Compensator(machine, Calibration.zero(machine)).compensate(
        dialect.read(f"{head}{text}{inside}".encode(), "part"), dialect
    )
    b = result.nominal[-1, machine.names.index("B")]
    assert abs(b) == pytest.approx(25.0)
    assert np.sign(b) == sign


CANCELLED = "CYCL DEF 7.1 X+0\nCYCL DEF 7.2 Y+0\nPLANE RESET STAY\n"
SHIFTED = f"{HEAD_H}CYCL DEF 7.1 X+10\nCYCL DEF 7.2 Y+5\n{SPATIAL} TURN\n{INSIDE_H}{CANCELLED}"


def test_a_shift_cancelled_within_its_plane_is_doubtful_until_all_axes_are_shifted_again(
    dmu50: Machine, errors: Calibration
) -> None:
    """Whether the shift from before the plane is in force behind it differs; as posts write it, nothing depends on that."""
    again = f"CYCL DEF 7.1 X+1\nCYCL DEF 7.2 Y+2\nCYCL DEF 7.3 Z+3\n{SPATIAL} STAY SEQ+\nL B+Q121 C+Q122 FMAX\n{INSIDE_H}{RESET_H}"
    result = compensated(f"{SHIFTED}L B+0 C+0 FMAX\nL X+3 FMAX\n{again}", dmu50, errors)
    assert "\nL B+0 C+0 FMAX\nL X+3 FMAX\n" in result.text
    ends = [int(np.flatnonzero(result.moves == move)[-1]) for move in np.unique(result.moves)[-4:]]
    for row, point in zip(ends, of_plane(TURNED, (1, 2, 3), POINTS), strict=True):
        assert np.linalg.norm(in_work(result.nominal[row])[0] - point) < 1e-6
    assert result.report.complete
    for text, words in (
        ("L X+3 F500\n", "cancelled within it"),
        ("L X+3 F500\n" * 60, "cancelled within it"),
        ("CYCL DEF 7.1 IX+1\n", "by an increment"),
        ("CYCL DEF 7.1 X+1\nCYCL DEF 7.2 Y+1\nL X+1 Y+1 Z+1 F500\n", "cancelled within it"),
    ):
        with pytest.raises(InputError, match=words):
            compensated(SHIFTED + text, dmu50, errors)


def test_lines_within_a_plane_written_together_are_those_written_one_by_one(
    dmu50: Machine, errors: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rotary axes have no values in a plane, but in the blocks between planes, of the same chunk."""
    inside = "".join(f"X{i % 17}.5 Y{i % 11}. Z{i % 5}.25\n" for i in range(60))
    text = HEAD + "".join(
        f"G0 B{b}. C-20.\nG68.2 X10. Y5. Z2. I{b}. J25. K-40.\nG53.1\n{INSIDE}{inside}G69\nG0 X0. Y0. Z60. B0. C0.\n"
        for b in (10, 20, 30)
    )
    sizes: list[int] = []
    run = ChunkRewriter._run

    def counted(*given: Any) -> bytes | None:
        written = run(*given)
        sizes.append(0 if written is None else written.count(b"\n"))
        return written

    monkeypatch.setattr(ChunkRewriter, "_run", counted)
    together = compensated(text, dmu50, errors).text
    assert sum(sizes) > 170  # most lines of the three planes
    monkeypatch.setattr(ChunkRewriter, "_run", lambda *_: None)
    assert together == compensated(text, dmu50, errors).text


def test_g53_3_moves_at_rapid() -> None:
    read = ISO.read(PLANES["G53.3"][0].encode(), "part")
    kinds = [move.kind for move in ISO.moves(read, AXES, tcp=False).moves]
    assert kinds[-4:] == [Kind.RAPID] + [Kind.LINEAR] * 3
