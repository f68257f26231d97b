"""Cycles, radius compensation and subprograms in shifted or turned coordinates and in loops.

Truth: LinuxCNC's interpreter for its words, of the original and of the output; else positions computed here by hand, and the output
read by a reader of words that shares no code with `twin.nc`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.compensation.test_shifts import ONE, PARAMETERS, TABLE, ZERO, compensated, distinct
from tests.model.errors import random_calibration
from tests.nc import rs274
from tests.nc.test_holes import path_of
from twin._common.errors import InputError
from twin.compensation import Compensation, Compensator, Options
from twin.compensation.programs.words import Setup
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import read_program

HEAD = "G90 G21 G17 G94 G54 G91.1 F500 S100 M3\nG0 X0 Y0 Z0 B40 C0\n"
CONTOUR = (
    "G41 D1\nG1 X10 Y10\nY50\nG2 X20 Y60 I10 J0\nG1 X50\nG2 X60 Y50 R10\nG3 X70 Y40 I10\nG1 X80\nY10\nX10\nG40 X0 Y0\n"
)
CYCLES = {
    "under G92": "G92 X5 Y7 Z-3\nG99 G81 X10 Y10 Z-20 R-8\nX20\nY20 L2\nG80\nG0 Z5\nG92.1\nG0 X1\n",
    "in turned coordinates": "G10 L2 P1 R30\nG0 X0 Y0 Z10\nG98 G81 X10 Y10 Z-20 R-8\nX20\nG80\nG10 L2 P1 R0\nG0 X1 Y0\n",
    "left to the control": "G10 L2 P1 R30\nG0 X0 Y0 Z10\nG99 G86 X10 Y10 Z-20 R-8 P0.1\nX20\nG80\nG0 Z5\n",
    "in G18": "G10 L2 P1 R30\nG18 G0 X0 Y10 Z0\nG99 G81 X10 Z10 Y-20 R-8\nX20\nG80\nG17 G0 Y5\n",
    "in a loop": (
        "G99 G81 X10 Y10 Z-20 R-8\n#1=0\no1 while [#1 LT 3]\nX[#1*3+20] Z[-20-#1]\n#1=[#1+1]\no1 endwhile\nG80\nG0 Z5\n"
    ),
    "and a shift in a loop": (
        "#1=0\no1 while [#1 LT 3]\nG92 X[#1*2] Y2\nG0 X0 Y0 Z10\nG99 G86 X10 Y#1 Z-20 R-8 P0.1\nG80\nG0 Z10\n#1=[#1+1]\no1 endwhile\n"
    ),
    "in a subprogram in a loop": (
        "#<i>=0\no1 repeat [3]\nG10 L2 P1 R[#<i>*30]\nG0 X0 Y0\no<hole> call [#<i>*10+20] [5]\n#<i>=[#<i>+1]\no1 endrepeat\n"
    ),
    "with many brackets": "G99 G81 X[1+[2*[3/[4-[5-2]]]]] Y[[[[[2]]]]] Z-20 R-8\nG80\nG0 Z5\n",
    "in two work offsets": "G98 G81 X10 Y10 Z-20 R-8\nX20\nG55 X0 Y0\nX10\nG80\nG0 Z5\n",
}
SUBPROGRAMS = {
    "hole.ngc": "o<hole> sub\nG99 G81 X#1 Y#2 Z-20 R-8\nG80\nG0 Z5\no<hole> endsub\n",
    "contour.ngc": f"o<contour> sub\nG1 Z-#1\n{CONTOUR}o<contour> endsub\n",
}


@pytest.fixture(scope="module")
def errors(dmu50: Machine) -> Calibration:
    return random_calibration(dmu50, np.random.default_rng(11), size=30.0)


def read_and_compensated(path: Path, machine: Machine, errors: Calibration, setup: Setup) -> Compensation:
    """Return the compensation of a file whose subprograms lie in the folder ``parts``."""
    program, dialect = read_program(path, subprograms=[path.parent / "parts"])
    return Compensator(machine, errors, Options(setup=setup, tool_length_mm=0.0)).compensate(program, dialect)


def machine_positions(text: str, folder: Path, tools: str = "") -> np.ndarray:
    """Return the positions of the axes that LinuxCNC's interpreter reads in a program."""
    for name, body in SUBPROGRAMS.items():
        (folder / name).write_text(body)
    (folder / "judged.ngc").write_text(text)
    reading = rs274.read(folder / "judged.ngc", folder, tools=tools, parameters=PARAMETERS)
    assert not reading.refusal, f"line {reading.line}: {reading.refusal}\n{text}"
    return np.array([motion.machine for motion in reading.motions])


def written(text: str, folder: Path, suffix: str = ".ngc") -> Path:
    """Return the path of a program beside a folder with the subprograms."""
    (folder / "parts").mkdir()
    for name, body in SUBPROGRAMS.items():
        (folder / "parts" / name).write_text(body)
    path = folder / f"part{suffix}"
    path.write_text(text)
    return path


@rs274.needed
@pytest.mark.parametrize("name", CYCLES)
def test_linuxcnc_drills_where_the_program_and_the_output_are_read(
    dmu50: Machine, errors: Calibration, name: str, tmp_path: Path
) -> None:
    text = f"{HEAD}{CYCLES[name]}M2\n"
    path, setup = written(text, tmp_path), TABLE if "offsets" in name else ONE
    plain = read_and_compensated(path, dmu50, Calibration.zero(dmu50), setup)
    result = read_and_compensated(path, dmu50, errors, setup)
    assert result.report.after.max_um < 2.0 < 10.0 < result.report.before.max_um
    for wanted, program in ((plain.nominal, text), (result.commands, result.text)):
        rows, at = distinct(machine_positions(program, tmp_path)), 0
        for row in distinct(wanted):
            # A cycle left to the control has strokes of its own between.
            near = np.flatnonzero(np.abs(rows[at : at + 3] - row).max(axis=1) < 2e-6)
            assert near.size, f"{row}\n{rows[at : at + 3]}\n{program}"
            at += int(near[0]) + 1
        assert "G86" in text or len(rows) == len(distinct(wanted))


@rs274.needed
@pytest.mark.parametrize(
    "text",
    [
        f"G92 X5 Y7\n{CONTOUR}G92.1\nG0 X1 Y1\n",
        "#2=2\no1 repeat [2]\nG10 L2 P1 R[#2*10]\nG0 X1 Y1 Z5\no<contour> call [#2]\n#2=[#2+2]\no1 endrepeat\n",
    ],
)
def test_linuxcnc_follows_the_contour_in_other_coordinates(
    dmu50: Machine, errors: Calibration, text: str, tmp_path: Path
) -> None:
    """Compare the tool paths that LinuxCNC computes, with its own offsets of the radius, from the original and the output."""
    text = f"{HEAD}{text}M2\n"
    result = read_and_compensated(written(text, tmp_path), dmu50, errors, ONE)
    before, after = (machine_positions(one, tmp_path, "T1 P1 D6\n") for one in (text, result.text))
    assert before.shape == after.shape and len(before) > 12
    wanted = result.commands - result.nominal
    for row, moved in zip(before, after - before, strict=True):
        nearest = np.argsort(np.linalg.norm(result.nominal[:, :3] - row[:3], axis=1))[:2]
        assert np.abs(wanted[nearest] - moved).min(axis=0).max() < 0.002
    assert np.abs(after - before).max() > 0.005


QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
STRAIGHT = np.eye(3)
BORE = "MCALL CYCLE86(30,0,2,-10,,0,3,1,0,1,0)\n"
FRAMES = {
    # name: (frame, program in it, turn, shift, places of the holes from the work offset's zero)
    "a row": (
        "TRANS X10 Y5",
        "MCALL CYCLE81(30,0,2,-10)\nHOLES1(0,0,90,5,10,2)\nMCALL\n",
        STRAIGHT,
        (10, 5, 0),
        [(10, 10), (10, 20)],
    ),
    "a circle": (
        "ROT RPL=90",
        "MCALL CYCLE81(30,0,2,-10)\nHOLES2(5,0,20,0,0,2)\nMCALL\n",
        QUARTER,
        (0, 0, 0),
        [(0, 25), (0, -15)],
    ),
    "a grid": (
        "ROT RPL=90",
        "MCALL CYCLE81(30,0,2,-10)\nCYCLE801(10,20,0,5,5,2,1)\nMCALL\n",
        QUARTER,
        (0, 0, 0),
        [(-20, 10), (-20, 15)],
    ),
    "boring": ("TRANS X10 Z-4", f"{BORE}X10 Y0\nX20\nMCALL\n", STRAIGHT, (10, 0, -4), [(20, 0), (30, 0)]),
    "boring, turned": ("ROT RPL=90", f"{BORE}X10 Y3\nX20\nMCALL\n", QUARTER, (0, 0, 0), [(-3, 10), (-3, 20)]),
}


@pytest.mark.parametrize("name", FRAMES)
def test_holes_in_a_frame_of_sinumerik(dmu50: Machine, errors: Calibration, name: str) -> None:
    frame, text, turn, shift, places = FRAMES[name]
    text = f"G90 G710 G17\n{frame}\nG0 X0 Y0 Z50 B0 C0\n{text}G0 Z50\n"
    zero = np.add([250.0, 225.0, -250.0], shift)
    plain = compensated(text, dmu50, Calibration.zero(dmu50), Setup(work_offset=ZERO))
    result = compensated(text, dmu50, errors, Setup(work_offset=ZERO))
    lowest = plain.nominal[:, 2] == plain.nominal[:, 2].min()
    assert plain.nominal[lowest][:, :2] - [250.0, 225.0] == pytest.approx(np.array(places, dtype=float), abs=1e-9)
    path, own = path_of(result.text.replace(frame, ""))
    words = np.array(path)
    assert zero + words[:, :3] @ turn.T == pytest.approx(result.commands[:, :3], abs=1e-6)
    assert result.report.after.max_um < 2.0 < result.report.before.max_um
    tops = words[lowest, 2] if "boring" in name else []
    assert [value for *_, top, bottom in own for value in (top, bottom)] == pytest.approx(
        [value for top in tops for value in (top, top - 12.0)], abs=1e-9
    )


DRILLING = "CYCL DEF 200 ~\n Q200=+5 ~\n Q201=-10 ~\n Q206=+45 ~\n Q202=+10 ~\n Q203=-20 ~\n Q204=+20\n"
HEAD_H = "BEGIN PGM A MM\nTOOL CALL 5 Z S500\nL X+0 Y+0 Z+50 B+0 C+0 R0 FMAX M3\n"
END_H = "L X+0 Y+0 Z+60 R0 FMAX\nM30\nEND PGM A MM\n"
BY_HAND = {
    # name: (suffix, text, places of the moves to the height)
    "a datum shift in a repeated part": (
        ".h",
        f"{HEAD_H}{DRILLING}LBL 1\nL X+10 Y+0 Z+50 FMAX M99\nCYCL DEF 7.0\nCYCL DEF 7.1 IX+10\nCYCL DEF 7.2 IZ+0\n"
        f"CALL LBL 1 REP 2\nCYCL DEF 7.1 X+0\n{END_H}",
        (-15.0, [(10, 0), (20, 0), (30, 0)]),
    ),
    "a hole in turned coordinates": (
        ".h",
        f"{HEAD_H}LBL 1\nCYCL DEF 10.0\nCYCL DEF 10.1 IROT+90\n{DRILLING}L X+10 Y+0 Z+50 FMAX M99\nCALL LBL 1 REP 1\n{END_H}",
        (-15.0, [(0, 10), (-10, 0)]),
    ),
    "a contour in turned coordinates": (
        ".h",
        f"{HEAD_H}CYCL DEF 10.0\nCYCL DEF 10.1 ROT+90\nL X+0 Y+0 Z+9 FMAX\nL X+10 Y+10 RL F100\nL Y+20\nCC X+20 Y+20\n"
        f"C X+20 Y+30 DR-\nCR X+30 Y+20 R+10 DR-\nL X+40\nL R0 X+0 Y+0\nCYCL DEF 10.1 ROT+0\n{END_H}",
        (9.0, [(0, 0), (-10, 10), (-20, 10), (-30, 20), (-20, 30), (-20, 40), (0, 0)]),
    ),
    "a macro with G52 and a loop with a cycle": (
        ".nc",
        "O1\nG90 G21 G17\nG0 X0 Y0 Z50 B0 C0\nG65 P100 A10 B5\nG65 P100 A20 B7\nG52 X0 Y0\nG0 X0 Y0 Z50\nM30\nO100\nG52 X#1\n"
        "G0 X0 Y0 Z50\n#3=0\nWHILE[#3LT2]DO1\nG98 G81 X#2 Y[#3*10] Z-10 R2 F100\n#3=#3+1\nEND1\nG80\nM99\n",
        (-10.0, [(15, 0), (15, 10), (27, 0), (27, 10)]),
    ),
    "a bored hole in a shifted loop": (
        ".mpf",
        "G90 G710 G17\nG0 X0 Y0 Z50 B0 C0\nFOR R1=0 TO 2\nTRANS X=R1*20\nG0 X0 Y0 Z50\n"
        "MCALL CYCLE86(30,0,2-R1/10,-10-R1,,0,3,1,0,1,0)\n"
        "X5 Y=R1\nMCALL\nENDFOR\nTRANS\nG0 X0 Y0 Z50\nM30\n",
        (None, [(5, 0, 2.0), (25, 1, 1.9), (45, 2, 1.8)]),
    ),
}


@pytest.mark.parametrize("name", BY_HAND)
def test_positions_computed_by_hand(dmu50: Machine, errors: Calibration, name: str, tmp_path: Path) -> None:
    suffix, text, (height, places) = BY_HAND[name]
    path = written(text, tmp_path, suffix)
    plain = read_and_compensated(path, dmu50, Calibration.zero(dmu50), Setup(work_offset=ZERO))
    result = read_and_compensated(path, dmu50, errors, Setup(work_offset=ZERO))
    at = plain.nominal[:, :3] - [250.0, 225.0, -250.0]
    there = at[np.abs(at[:, 2] - height) < 1e-9][:, :2] if height is not None else at[at[:, 2] < 3.0]
    assert there == pytest.approx(np.array(places, dtype=float), abs=1e-9)
    assert result.report.after.max_um < 2.0 < result.report.before.max_um
    again = tmp_path / f"again{suffix}"
    again.write_text(result.text)
    final = read_and_compensated(again, dmu50, Calibration.zero(dmu50), Setup(work_offset=ZERO))
    assert final.nominal == pytest.approx(result.commands, abs=1e-9)


OFFSET = "O1\nG90 G21\nG10 L20 P3 X260 Y225 Z-250 B0 C0\n{}\nG0 X1 Y2 Z3 B0 C0\nG1 X2 F100\n"


@pytest.mark.parametrize("word", ["G54.1 P3", "G54.1 P03", "G54 P3", "G154 P3"])
def test_words_for_one_further_work_offset(dmu50: Machine, word: str) -> None:
    plain = compensated(OFFSET.format(word), dmu50, Calibration.zero(dmu50), Setup(work_offset=ZERO))
    assert plain.nominal[-1] == pytest.approx([262.0, 227.0, -247.0, 0.0, 0.0])


SIDE = "G90 G710 G17\nG0 X0 Y0 Z50 B0 C0\nG41 D1\nG1 X10 Y10 F100\n"
REFUSED = {
    "G92": (f"{SIDE}G92 X5\n", 5, "coordinates under cutter radius compensation"),
    "ROT": (f"{SIDE}ROT RPL=90\n", 5, "coordinates under cutter radius compensation"),
    "a second offset": (f"{SIDE}G54 G1 X5\nG55\n", 6, "coordinates under cutter radius compensation"),
    "TRANS under MCALL": (
        "G90 G710 G17\nG0 X0 Y0 Z50 B0 C0\nMCALL CYCLE81(30,0,2,-10)\nTRANS X5\n",
        4,
        "or within a cycle",
    ),
    "G92 in a cycle": (f"{HEAD}G99 G81 X10 Y10 Z-20 R-8\nG92 X5\n", 4, "within a drilling cycle"),
    "a pattern from nowhere": (
        "G90 G710 G17\nG0 X0 Y0 Z50 B0 C0\nTRANS Z5\nMCALL CYCLE81(30,0,2,-10)\nHOLES1(0,0,90,5,10,3)\n",
        5,
        "several holes from an unknown position",
    ),
    "CYCL DEF 7 under RL": (f"{HEAD_H}L X+10 Y+10 RL F100\nCYCL DEF 7.1 X+10\n", 5, "coordinates under cutter radius"),
    "a pole of other coordinates": (
        f"{HEAD_H}CC X+0 Y+0\nCYCL DEF 7.1 X+10\nL X+10 Y+0 F100\nLP PR+10 PA+90\n",
        7,
        "LP without a pole",
    ),
    "a cycle at an unknown height": (
        f"{HEAD_H}{DRILLING}CYCL DEF 7.1 Z+10\nCYCL CALL\n",
        12,
        "position of Z is unknown",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused(dmu50: Machine, name: str) -> None:
    text, line, words = REFUSED[name]
    with pytest.raises(InputError, match=words) as caught:
        compensated(text, dmu50, Calibration.zero(dmu50), Setup(work_offset=ZERO))
    assert caught.value.line == line
