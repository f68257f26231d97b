"""Tilted working planes: G68.2 with G53.1, PLANE SPATIAL, CYCLE800.

Truth: rotations by SciPy in the convention that each manual prints, and the closed chain of the DMU 50 (contract, clause 1) without
errors, written here again.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.model.errors import random_calibration
from tests.truth.reference import D, about, translation
from twin._common.errors import InputError
from twin.compensation import Compensation, Compensator, Options
from twin.compensation.programs.compensator import compensate_file
from twin.compensation.programs.words import Setup
from twin.controls.offsets import OffsetTable
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import DIALECTS

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
}
REFUSED = [
    (f"{HEAD}G68.2 I30. J25. K0.\nG0 X1.\n", "between G68.2 and G53.1", 5),
    (f"{HEAD}G53.1\n", "without a tilted plane", 4),
    (f"{HEAD}G68.2 P1 I30. J25. K0.\n", "G68.2 with P", 4),
    (f"{HEAD}G68.2 I30. J25. K0.\nG53.1\nG0 B10.\n", "rotary axes or tool centre point", 6),
    (f"{HEAD}G68.2 I30. J25. K0.\nG53.1\nG43.4 H1\nG0 X0. Y0. Z50.\n", "rotary axes or tool centre point", 7),
    (f"{HEAD}G68.2 I30. J25. K0.\nG53.1\nG68.2 I30. J25. K0.\n", "within a tilted plane", 6),
    (f"{HEAD}G68.2 I0. J120. K0.\nG53.1\nG0 X0. Y0. Z50.\n", "cannot reach this tilted plane", 6),
    (f'{HEAD}CYCLE800(0,"T",0,192,0,0,0,20,-30,15,0,0,0,1)\n', "CYCLE800 of this kind", 4),
    (f'{HEAD}CYCLE800(0,"T",0,57,0,0,0,20,-30,15,0,0,0,0)\n', "does not position", 4),
    (f"{HEAD_H}PLANE SPATIAL SPA+20 SPB-30 SPC+15 STAY\n", "does not position", 3),
    (f"{HEAD_H}PLANE VECTOR BX1 BY0 BZ0 NX0 NY0 NZ1 TURN FMAX\n", "PLANE", 3),
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
    b, c = np.radians(q[3:])
    table = (
        translation(0, 0, D)
        @ about(0, np.pi / 4)
        @ about(2, b)
        @ about(0, -np.pi / 4)
        @ translation(0, 0, -D)
        @ about(2, -c)
    )
    pose = np.linalg.inv(table) @ tool
    return pose[:3, 3], pose[:3, 2]


def of_plane(rotation: Rotation, origin: tuple[float, ...], points: np.ndarray) -> np.ndarray:
    """Return points of a plane in the work frame."""
    before, after = np.array(origin[:3], dtype=float), np.array(origin[3:] or (0, 0, 0), dtype=float)
    return ZERO + before + rotation.apply(after + points)


@pytest.mark.parametrize("name", PLANES)
def test_the_tool_is_where_the_plane_says(dmu50: Machine, errors: Calibration, name: str) -> None:
    text, rotation, origin = PLANES[name]
    result = compensated(text, dmu50, errors)
    ends = [int(np.flatnonzero(result.moves == move)[-1]) for move in range(1, 5)]
    wanted, normal = of_plane(rotation, origin, POINTS), rotation.apply([0.0, 0.0, 1.0])
    for row, point in zip(ends, wanted, strict=True):
        tip, axis = in_work(result.nominal[row])
        # The rotary axes stop at their least increments; the linear axes reach the point for where they stopped.
        assert np.linalg.norm(tip - point) < 1e-6
        assert np.linalg.norm(axis - normal) < np.radians(0.001)
    assert result.report.after.max_um < 2.0
    assert result.report.before.max_um > 10.0


@pytest.mark.sample(2)  # of 7
@pytest.mark.parametrize("name", PLANES)
def test_the_words_of_the_output_lead_to_the_compensated_commands(
    dmu50: Machine, errors: Calibration, name: str
) -> None:
    """Read by hand: the words in the output's plane, at the rotary positions of the control."""
    import re

    text, rotation, origin = PLANES[name]
    result = compensated(text, dmu50, errors)
    begin = r"G53\.1|CYCLE800\(0|PLANE SPATIAL"
    lines = re.split(r"G69|CYCLE800\(\)|PLANE RESET", re.split(begin, result.text)[-1].partition("\n")[2])[
        0
    ].splitlines()
    position, words = {}, []
    for line in lines:
        found = re.findall(r"([XYZ])([-+]?[\d.]+)", line)
        position |= {axis: float(value) for axis, value in found}
        if found:
            words.append([position[axis] for axis in "XYZ"])
    rows = np.flatnonzero((result.moves >= 1) & (result.moves <= 4))
    assert len(words) == len(rows)
    for row, point in zip(rows, of_plane(rotation, origin, np.array(words)), strict=True):
        assert np.linalg.norm(in_work(result.commands[row])[0] - point) < 1e-6
        assert result.commands[row, 3:] == pytest.approx(result.nominal[row, 3:], abs=1e-9)


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
