"""Programs that shift or turn their coordinates by constant values.

Truth: LinuxCNC's interpreter for what it knows, in the machine's coordinates, of the original and of the output; else positions that
are computed here from the manuals' descriptions.
"""

from __future__ import annotations

from pathlib import Path
from random import Random

import numpy as np
import pytest

from tests.model.errors import random_calibration
from tests.nc import rs274
from twin._common.errors import InputError
from twin.compensation import Compensation, Compensator, Options
from twin.compensation.programs.words import Setup
from twin.controls.offsets import OffsetTable
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import DIALECTS
from twin.tool.forward import Kinematics

ISO, HEIDENHAIN = DIALECTS[:2]
ROWS = {
    "G54": {"X": 250.0, "Y": 225.0, "Z": -250.0, "B": 2.5, "C": -10.0},
    "G55": {"X": 230.0, "Y": 215.0, "Z": -260.0, "B": 0.0, "C": 5.0},
    "G56": {"X": 260.0, "Y": 205.0, "Z": -240.0, "B": 1.0, "C": 0.0},
}
PARAMETERS = "".join(
    f"{5221 + 20 * place + axis} {value:.6f}\n"
    for place, row in enumerate(ROWS.values())
    for axis, value in zip((0, 1, 2, 4, 5), row.values(), strict=True)
)
TABLE = Setup(offsets=OffsetTable(Path("offsets.csv"), ROWS))
ONE = Setup(work_offset=ROWS["G54"])


@pytest.fixture(scope="module")
def errors(dmu50: Machine) -> Calibration:
    return random_calibration(dmu50, np.random.default_rng(11), size=30.0)


def compensated(text: str, machine: Machine, errors: Calibration, setup: Setup) -> Compensation:
    dialect = HEIDENHAIN if text.startswith("BEGIN") else ISO
    compensator = Compensator(machine, errors, Options(setup=setup, tool_length_mm=0.0))
    return compensator.compensate(dialect.read(text.encode(), "part"), dialect)


def random_program(rng: Random, *, several: bool) -> str:
    """Return a program of LinuxCNC that moves, and shifts its coordinates; ``several``: in several work offsets."""

    def words(axes: str, size: float) -> str:
        chosen = sorted(rng.sample(axes, rng.randint(1, len(axes))))
        return " ".join(f"{axis}{(40 if axis == 'B' else 0) + rng.uniform(-size, size):.3f}" for axis in chosen)

    def arc() -> list[str]:
        radius = rng.uniform(3.0, 12.0)
        return [f"G{rng.choice([2, 3])} X0 Y{radius:.3f} Z5 I0 J{radius / 2:.3f}"]

    def shift() -> list[str]:
        kinds = [
            f"G92 {words('XYZBC', 10.0)}",
            f"G92 {words('XYZ', 10.0)}",
            *("G92.1", "G92.2"),
            f"G10 L2 P{rng.choice([1, 1, 2]) if several else 1} X{rng.uniform(240, 260):.3f} Z{rng.uniform(-260, -240):.3f}",
            f"G10 L2 P{rng.choice([1, 2]) if several else 1} R{rng.uniform(-40, 40):.3f}",
            "G10 L2 P1 R0",
        ]
        return [rng.choice(kinds)]

    lines = ["G90 G21 G17 G94 G54 G91.1 #<a>=1 F500", "G0 X0 Y0 Z0 B40 C0"]
    for _ in range(14):
        kind = rng.choice(["move", "move", "more", "shift", "shift", "arc", "offset", "machine"])
        if kind == "arc":
            # The interpreter in Python takes it as an arc from where the axes stand.
            lines += ["G1 X0 Y0 Z0", *arc()]
        elif kind == "shift":
            lines += ["G90", *shift()]
        elif kind == "offset" and several:
            lines.append(rng.choice(["G54", "G55", "G56"]))
        elif kind == "machine":
            lines += [
                "G90",
                f"G53 G0 Z{rng.uniform(-200, -150):.2f}",
                f"G0 {words('XYZBC', 15.0)}",
                "G0 X1 Y1 Z1 B40 C0",
            ]
        elif kind == "more":
            lines.append(f"G91 G1 {words('XYZC', 5.0)}")
        else:
            lines.append(f"G90 G{rng.choice([0, 1])} {words('XYZBC', 15.0)}")
    return "\n".join([*lines, "M2", ""])


def positions(text: str, folder: Path) -> np.ndarray:
    """Return the positions of the axes that LinuxCNC's interpreter reads in a program, each once."""
    path = folder / "part.ngc"
    path.write_text(text)
    reading = rs274.read(path, folder, parameters=PARAMETERS)
    assert not reading.refusal, f"line {reading.line}: {reading.refusal}\n{text}"
    return distinct(np.array([motion.machine for motion in reading.motions]))


def distinct(rows: np.ndarray) -> np.ndarray:
    moved = np.append(True, (np.abs(np.diff(rows, axis=0)) > 1e-7).any(axis=1))
    return rows[moved]


@rs274.needed
@pytest.mark.sample(6)  # of 40
@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize("seed", range(20))
def test_linuxcnc_goes_where_the_program_and_the_output_are_read(
    dmu50: Machine, errors: Calibration, seed: int, several: bool, tmp_path: Path
) -> None:
    rng = Random(f"{seed} {several}")
    text = random_program(rng, several=several)
    setup = TABLE if several else ONE
    lines = text.split("\n")
    for _ in range(len(lines)):
        try:
            plain = compensated("\n".join(lines), dmu50, Calibration.zero(dmu50), setup)
            result = compensated("\n".join(lines), dmu50, errors, setup)
        except InputError as error:
            assert error.line is not None, error
            del lines[error.line - 1]  # a position that another offset or machine coordinates have left unknown
        else:
            break
    text = "\n".join(lines)
    assert len(lines) > 16
    meant = positions(text, tmp_path)
    for row in plain.nominal:
        assert np.abs(meant - row).max(axis=1).min() < 1e-6, text
    done = positions(result.text, tmp_path)
    at = 0
    for row in distinct(result.commands):
        near = np.flatnonzero(np.abs(done[at : at + 4] - row).max(axis=1) < 2e-6)
        assert near.size, f"{row}\n{done[at : at + 4]}\n{result.text}"
        at += int(near[0]) + 1
    assert result.report.after.max_um < 5.0 < result.report.before.max_um


ZERO = {"X": 250.0, "Y": 225.0, "Z": -250.0}
HEAD = "G90 G710\nG0 X0 Y0 Z0 B0 C0\n"
HEAD_H = "BEGIN PGM A MM\nL X+0 Y+0 Z+0 B+0 C+0 FMAX\n"
R2 = 2.0**0.5
FOLLOWED: dict[str, tuple[str, tuple[float, ...]]] = {
    # program, and where its last block ends from the zero of the work offset: x, y, z, c
    "TRANS": (f"{HEAD}TRANS X10 Y5 C30\nG1 X1 Y2 C4 F100\n", (11, 7, 0, 34)),
    "TRANS replaces": (f"{HEAD}TRANS X10 Y5\nTRANS Z3\nG1 X1 Y2 Z1 F100\n", (1, 2, 4, 0)),
    "ATRANS adds": (
        f"{HEAD}TRANS X10 Y5\nN70 ATRANS X=R1+1 Z3\nG1 X1 Y2 Z1 F100\n".replace("G710", "G710 R1=3"),
        (15, 7, 4, 0),
    ),
    "an axis that is not named": (f"{HEAD}G1 X7 Y7 F100\nTRANS X10 Y5\nG1 X1\n", (11, 7, 0, 0)),
    "ROT": (f"{HEAD}ROT RPL=90\nG1 X10 Y2 F100\n", (-2, 10, 0, 0)),
    "ROT about Z": (f"{HEAD}ROT Z45\nG1 X{10 * R2} Y0 F100\n", (10, 10, 0, 0)),
    "ROT in G18": (f"{HEAD}G18\nROT RPL=90\nG1 X10 Z2 F100\n", (2, 0, -10, 0)),
    "ROT replaces TRANS": (f"{HEAD}TRANS X50\nROT RPL=90\nG1 X10 Y2 F100\n", (-2, 10, 0, 0)),
    "AROT after TRANS": (f"{HEAD}TRANS X50\nAROT RPL=90\nG1 X10 Y2 F100\n", (48, 10, 0, 0)),
    "ATRANS after ROT": (f"{HEAD}ROT RPL=90\nATRANS X50\nG1 X10 Y2 F100\n", (-2, 60, 0, 0)),
    "AROT adds": (f"{HEAD}ROT RPL=90\nAROT Z90\nG1 X10 Y2 F100\n", (-10, -2, 0, 0)),
    "TRANS alone": (f"{HEAD}TRANS X10 Y5\nAROT RPL=90\nTRANS\nG1 X1 Y2 F100\n", (1, 2, 0, 0)),
    "MIRROR alone": (f"{HEAD}TRANS X10 Y5\nMIRROR\nG1 X1 Y2 F100\n", (1, 2, 0, 0)),
    "in inches": (f"{HEAD}G700\nTRANS X1\nG1 X1 Y0 F100\n", (50.8, 0, 0, 0)),
    "an arc in turned coordinates": (f"{HEAD}ROT RPL=90\nG1 X10 Y0 F100\nG3 X0 Y10 I-10 J0\n", (-10, 0, 0, 0)),
    "G52 of Fanuc": ("O1234\nG90 G21 G0 X0 Y0 Z0 B0 C0\nG52 X10 Y5\nG1 X1 F100\nG91 X1\n", (2 + 10, 0, 0, 0)),
    "G10 L20 of Fanuc": (
        "O1234\nG90 G10 L20 P7 X260 Y225 Z-250 B0 C0\nG54.1 P7\nG0 X1 Y2 Z3 B0 C0\n",
        (11, 2, 3, 0),
    ),
    "highest spindle speed": ("G90 G21 G0 X0 Y0 Z0 B0 C0\nG92 S3000\nG1 X1 F100\n", (1, 0, 0, 0)),
    "cycle 7": (
        f"{HEAD_H}CYCL DEF 7.0 DATUM SHIFT\nCYCL DEF 7.1 X+10\n5 CYCL DEF 7.2 IY-5,5\nL X+1 Y+2 F100\n",
        (11, -3.5, 0, 0),
    ),
    "cycle 7 changes an axis": (
        f"{HEAD_H}CYCL DEF 7.0\nCYCL DEF 7.1 X+10\nCYCL DEF 7.2 Y+5\nQ1=+3\nCYCL DEF 7.0\nCYCL DEF 7.1 IX+Q1\nL X+1 Y+2 F100\n",
        (14, 7, 0, 0),
    ),
    "cycle 7 ended": (
        f"{HEAD_H}CYCL DEF 7.0\nCYCL DEF 7.1 X+10\nCYCL DEF 7.0\nCYCL DEF 7.1 X+0\nL X+1 Y+2 F100\n",
        (1, 2, 0, 0),
    ),
    "TRANS DATUM": (f"{HEAD_H}TRANS DATUM AXIS X+10 Y-5 C+30\nL X+1 Y+2 C+4 F100\n", (11, -3, 0, 34)),
    "TRANS DATUM RESET": (f"{HEAD_H}TRANS DATUM AXIS X+10 Y-5\nTRANS DATUM RESET\nL X+1 Y+2 F100\n", (1, 2, 0, 0)),
    "cycle 10": (
        f"{HEAD_H}CYCL DEF 7.1 X+50\nCYCL DEF 10.0\nCYCL DEF 10.1 ROT+60\nCYCL DEF 10.1 IROT+30\nL X+10 Y+2 F100\n",
        (48, 10, 0, 0),
    ),
    "cycle 10 ended": (f"{HEAD_H}CYCL DEF 10.1 ROT+60\nCYCL DEF 10.1 ROT+0\nL X+10 Y+2 F100\n", (10, 2, 0, 0)),
    "TRANS ROTATION": (f"{HEAD_H}TRANS ROTATION ROT+90\nL X+10 Y+2 F100\n", (-2, 10, 0, 0)),
    "a preset ends the shift": (
        f"{HEAD_H}CYCL DEF 7.1 X+50\nCYCL DEF 10.1 ROT+60\nCYCL DEF 247 Q339=+1\nL X+10 Y+2 F100\n",
        (10, 2, 0, 0),
    ),
}


@pytest.mark.sample(9)
@pytest.mark.parametrize("name", FOLLOWED)
def test_positions_computed_by_hand(dmu50: Machine, errors: Calibration, name: str) -> None:
    """Check the original, and the output: read again, it lands on the commands of the compensation."""
    text, (x, y, z, c) = FOLLOWED[name]
    setup = Setup(work_offset=ZERO)
    plain = compensated(text, dmu50, Calibration.zero(dmu50), setup)
    meant = [250.0 + x, 225.0 + y, -250.0 + z, 0.0, c]
    assert plain.nominal[-1] == pytest.approx(meant, abs=1e-9)
    result = compensated(text, dmu50, errors, setup)
    assert result.report.after.max_um < 3.0 < result.report.before.max_um
    again = compensated(result.text, dmu50, Calibration.zero(dmu50), setup)
    assert again.nominal[-1] == pytest.approx(result.commands[-1], abs=1e-9 if "inch" not in name else 2e-4)
    assert 0.002 < np.abs(again.nominal[-1] - meant).max() < 0.3


PLANE = "PLANE SPATIAL SPA+0 SPB+30 SPC+0 TURN FMAX SEQ+\n"
IN_PLANES = {
    "a shift before the plane moves its zero": (
        f"{HEAD_H}CYCL DEF 7.1 X+10\nCYCL DEF 7.3 Z-5\n{PLANE}L X+1 Y+2 Z+3 F100\n",
        (10.0, 0.0, -5.0),
        (1.0, 2.0, 3.0),
    ),
    "a shift in the plane": (
        f"{HEAD_H}{PLANE}CYCL DEF 7.1 X+10\nCYCL DEF 7.3 Z-5\nL X+1 Y+2 Z+3 F100\n",
        (0.0,) * 3,
        (11.0, 2.0, -2.0),
    ),
    "a rotation in the plane": (
        f"{HEAD_H}{PLANE}CYCL DEF 10.1 ROT+90\nL X+1 Y+2 Z+3 F100\n",
        (0.0,) * 3,
        (-2.0, 1.0, 3.0),
    ),
    "TRANS in the plane": (
        f'{HEAD}CYCLE800(0,"TC1",0,57,0,0,0,0,30,0,0,0,0,1)\nTRANS X10 Z-5\nG1 X1 Y2 Z3 F100\n',
        (0.0,) * 3,
        (11.0, 2.0, -2.0),
    ),
}


@pytest.mark.parametrize("name", IN_PLANES)
def test_shifts_and_tilted_planes(dmu50: Machine, name: str) -> None:
    """The same point of a plane whose zero and words are computed by hand: turned by 30° about Y."""
    text, zero, (x, y, z) = IN_PLANES[name]
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    plain = compensated(text, dmu50, Calibration.zero(dmu50), Setup(work_offset=ZERO))
    head = f'{HEAD}CYCLE800(0,"TC1",0,57,{zero[0]},{zero[1]},{zero[2]},0,30,0,0,0,0,1)\n'
    there = compensated(f"{head}G1 X{x} Y{y} Z{z} F100\n", dmu50, Calibration.zero(dmu50), Setup(work_offset=ZERO))
    assert plain.nominal[-1] == pytest.approx(there.nominal[-1], abs=1e-6)
    point = np.add(zero, [c * x + s * z, y, -s * x + c * z])
    tip = Kinematics(dmu50, Calibration.zero(dmu50), tool_length_mm=0.0).forward(plain.nominal[-1:]).point_mm[0]
    assert tip == pytest.approx(np.add(point, [0.0, 0.0, 150.0]), abs=0.003)  # rotary axes at their least increments


NOT_FOLLOWED = [
    (f"{HEAD}G92 X7\nG52 X5\n", 4, "G52 after G92"),
    (f"{HEAD}G52 X5\nG92 X0\n", 4, "G92 after G52"),
    (f"{HEAD}G91 G52 X5\n", 3, "in G91"),
    (f"{HEAD}G52 X5 M8\n", 3, "with other words"),
    (f"{HEAD}G0 G92 X5\n", 3, "with other words"),
    (f"{HEAD}G92.1 X0\n", 3, "with axis words"),
    (f"{HEAD}G92.3\n", 3, "without a G92"),
    (f"{HEAD}G10 L2 P0 X5\n", 3, "number of a work offset"),
    (f"{HEAD}G10 L10 P1 R5\n", 3, "transformation G10"),
    (f"{HEAD}G10 L20 P1 X5\n", 3, "means the present position"),
    (f"{HEAD}G54\nG1 X1 F100\nG10 L2 P2 X5\nG55\nG1 X1\n", 6, "second work offset"),
    (f"{HEAD}G43.4 H1\nG92 X5\n", 4, "under tool centre point control"),
    (f"{HEAD}G10 L2 P1 X250\nG43.4 H1\n", 4, "sets a work offset"),
    (f"{HEAD}TRANS X5\nG68.2 I30. J25. K0.\n", 4, "while the coordinates are shifted"),
    (f"{HEAD}TRANS X5 M8\n", 3, "with other words"),
    (f"{HEAD}TRANS X5 Q3\n", 3, "with other words"),
    (f"{HEAD}TRANS X=_A\n", 3, "value of X is unknown"),
    (f"{HEAD}ROT X10 Y20\n", 3, "about several axes"),
    (f"{HEAD}ROT C10\n", 3, "angles X, Y, Z or RPL"),
    ("G90 G710\nG0 X0 Y0 Z0 B0 C0\nTRAORI\nROT RPL=30\nG0 X1 Y1 Z1 A3=0 B3=0 C3=1\n", 5, "tool vector in turned"),
    (f"{HEAD}MIRROR X0\n", 3, "transformation MIRROR"),
    (f"{HEAD}G52 X5\nTRANS X5\n", 4, "TRANS after G92"),
    (f"$A.MIN%\n{HEAD}G92 X5\n", 4, "G92 of Okuma"),
    (f"{HEAD_H}CYCL DEF 7.0 DATUM SHIFT ~\nX+10\n", 3, "over several lines"),
    (f"{HEAD_H}CYCL DEF 7.1 #3\n", 3, "by a row of a datum table"),
    (f"{HEAD_H}CYCL DEF 7.1 X+Q5\n", 3, "value of X is unknown"),
    (f"{HEAD_H}CYCL DEF 7 X+10\n", 3, "datum shift"),
    (f"{HEAD_H}CYCL DEF 10.1 ROT+10\nCYCL DEF 7.1 X+10\n", 4, "in turned coordinates"),
    (f"{HEAD_H}CYCL DEF 7.1 X+5\n{PLANE}CYCL DEF 7.1 X+10\n", 5, "in a tilted plane"),
    (f"{HEAD_H}{PLANE}CYCL DEF 7.1 X+10\nPLANE RESET STAY\n", 5, "shifted or turned"),
    (f"{HEAD_H}TRANS MIRROR AXIS X\n", 3, "transformation TRANS"),
    (f"{HEAD_H}TRANS DATUM TABLE TABLINE5\n", 3, "transformation TRANS"),
]


@pytest.mark.parametrize(("text", "line", "words"), NOT_FOLLOWED)
def test_what_cannot_be_followed_is_refused(dmu50: Machine, text: str, line: int, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        compensated(text, dmu50, Calibration.zero(dmu50), Setup(work_offset=ZERO))
    assert caught.value.line == line


def test_tool_tip_coordinates_are_shifted_in_the_work_frame(dmu50: Machine, errors: Calibration) -> None:
    text = "G90 G21\nTRAORI\nG0 X0 Y0 Z20 B20 C30\n{}G1 X{} Y2 Z20 F100\n"
    origin = Setup(work_origin_mm=(0.0, 0.0, -400.0))
    one, other = (compensated(text.format(*how), dmu50, errors, origin) for how in (("TRANS X10\n", 1), ("", 11)))
    assert one.nominal[-1] == pytest.approx(other.nominal[-1], abs=1e-9)


def test_the_report_says_what_is_shifted(dmu50: Machine, errors: Calibration) -> None:
    report = compensated(FOLLOWED["AROT after TRANS"][0], dmu50, errors, Setup(work_offset=ZERO)).report
    assert "shifted by the program: X 50; turned by the program" in report.to_text()


@pytest.mark.parametrize(
    ("head", "increment", "other", "again"),
    [
        (f"{HEAD}TRANS X5\n", "G91 G1 X5 F100\nG90", "Y3", "X1 Y4"),
        (f"{HEAD_H}CYCL DEF 7.1 X+10\n", "L IX+5 F100", "L Y+3", "L X+1 Y+4"),
    ],
)
def test_an_increment_where_controls_disagree_stays_as_written_until_its_axis_is_known(
    dmu50: Machine, head: str, increment: str, other: str, again: str
) -> None:
    """Some controls read it from where the axis stands, others from the shifted word."""
    errors = random_calibration(dmu50, np.random.default_rng(4), size=30.0)
    result = compensated(f"{head}{increment}\n{other}\n{again}\n", dmu50, errors, ONE)
    assert f"{increment}\n{other}\n" in result.text and f"\n{again}\n" not in result.text
    (lost,) = [one for one in result.report.not_corrected if one.kind == "unknown"]
    first, last = head.count("\n") + 1, head.count("\n") + increment.count("\n") + 2
    assert lost.missed == (first, last) and "position of X" in lost.reason
