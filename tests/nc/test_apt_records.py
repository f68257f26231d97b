"""Arcs and cycles of APT. Truth: centre, sense and places computed by hand; the pose by the machine in plain numpy."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.model.errors import random_calibration
from tests.nc.nc_support import AXES
from twin._common.errors import InputError
from twin.compensation import Compensation, Compensator
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import DIALECTS
from twin.nc.blocks import Kind, NewPositions

ISO, APT = DIALECTS[0], DIALECTS[2]
START = "UNITS/MM\nLOADTL/1\nRAPID\nGOTO/50,20,100,0,0,1\n"
HOLES = "CYCLE/DRILL,FEDTO,12.5,RAPTO,3.,MMPM,100.,RTRCTO,25.\nGOTO/50.,20.,40.\nGOTO/60.,30.,40.\nCYCLE/OFF\n"
ARCS = {
    # name: (text, centre in its plane, sweep in degrees): right-handed about the axis of the record
    "a quarter": ("GOTO/50,20,40\nCIRCLE/50,30,40,0,0,1\nGOTO/60,30,40\n", (50, 30), 90),
    "the other way": ("GOTO/50,20,40\nCIRCLE/50,30,40,0,0,-1,10\nGOTO/60,30,40\n", (50, 30), -270),
    "a circle": ("GOTO/50,20,40\nCIRCLE/50,30,40,0,0,-1,10,.01,.5,8,0\nGOTO/50,20,40\n", (50, 30), -360),
    "a helix": ("GOTO/50,20,40\nCIRCLE/50,30,40,0,0,1,10\nGOTO/50,40,38\n", (50, 30), 180),
    "about y": ("GOTO/50,20,40\nCIRCLE/60,20,40,0,1,0,10\nGOTO/60,20,50\n", (40, 60), 90),
    "in inches": ("UNITS/INCHES\nGOTO/2,1,1\nCIRCLE/2,2,1,0,0,1\nGOTO/3,2,1\nUNITS/MM\n", (50.8, 50.8), 90),
}


@pytest.fixture(scope="module")
def errors(dmu50: Machine) -> Calibration:
    return random_calibration(dmu50, np.random.default_rng(4), size=30.0)


def compensated(text: str, machine: Machine, errors: Calibration) -> Compensation:
    return Compensator(machine, errors).compensate(APT.read(text.encode(), "part.cls"), APT)


def locations(text: str) -> np.ndarray:
    """Return the three coordinates of every GOTO."""
    lines = [line for line in text.splitlines() if line.startswith("GOTO/")]
    return np.array([[float(part) for part in line[5:].split(",")[:3]] for line in lines])


@pytest.mark.parametrize("name", ARCS)
def test_an_arc_is_right_handed_about_its_axis(name: str) -> None:
    text, centre, sweep = ARCS[name]
    moves = APT.moves(APT.read((START + text).encode(), "part"), AXES, tcp=False).moves
    (arc,) = [move.arc for move in moves if move.kind is Kind.ARC]
    assert arc is not None and arc.centre_mm == pytest.approx(centre)
    assert math.degrees(arc.angle_rad) == pytest.approx(sweep)


def test_an_arc_becomes_locations_near_its_circle(dmu50: Machine, errors: Calibration) -> None:
    text, centre, _ = ARCS["the other way"]
    result = compensated(f"{START}{text}GOTO/70,30,40\n", dmu50, errors)
    found = locations(result.text)[2:-1]
    assert "$$ CIRCLE/50,30,40,0,0,-1,10\n" in result.text and len(found) > 20
    # Corrections are at most 0.1 mm, and a chord is at most 1 µm off the path.
    assert np.hypot(*(found[:, :2] - centre).T) == pytest.approx(10.0, abs=0.1)
    angles = np.degrees(np.unwrap(np.arctan2(*(found[:, 1::-1] - centre[::-1]).T)))
    assert (np.diff(angles) < 0).all() and angles[-1] - angles[0] == pytest.approx(-270, abs=12)
    assert result.report.after.max_um < 1.2


def test_a_cycle_stays_and_its_locations_are_corrected(dmu50: Machine, errors: Calibration) -> None:
    result = compensated(f"{START}{HOLES}RAPID\nGOTO/50,20,100\n", dmu50, errors)
    before, after = (text.splitlines() for text in (START + HOLES, result.text))
    assert [line for line in before if not line.startswith("GOTO")] == [
        line for line in after if not line.startswith(("GOTO", "$$"))
    ][:-1]
    moved = locations(result.text) - [(50, 20, 100), (50, 20, 40), (60, 30, 40), (50, 20, 100)]
    assert len(moved) == 4 and (np.abs(moved[:, 0]) > 0.001).all() and np.abs(moved).max() < 0.1
    assert "left to the postprocessor" in " ".join(notice.text for notice in result.reading.notices)


UNUSED = "GOTO/50,20,40\nCIRCLE/50,30,40,0,0,1\nFEDRAT/5\n$$ X\nGOTO/60,30,40\nCIRCLE/50,30,40,0,0,1\nFINI\n"


@pytest.mark.parametrize("name", ["both", "the last only"])
def test_statements_keep_their_order(name: str) -> None:
    program = APT.read((START + UNUSED).encode(), "part")
    reading = APT.moves(program, AXES, tcp=False)
    which = {"both": [1, 2], "the last only": [1]}[name]
    rows = {i: (np.array([reading.moves[i].position]), np.array([(0.0, 0.0, 1.0)])) for i in which}
    written = APT.rewrite(program, AXES, reading, NewPositions.of(len(reading.moves), 5, rows)).replace(
        "$$ CIRCLE", "CIRCLE"
    )
    words = [line.split("/")[0] for line in (START + UNUSED).splitlines()]
    assert [line.split("/")[0] for line in written.splitlines()] == words


BESIDE = (
    "RAPID\nGOTO/50,10,40\nCUTCOM/LEFT\nGOTO/50,20,40\nCIRCLE/50,30,40,0,0,1.\nFEDRAT/300,MMPM\nGOTO/60,30,40\nGOTO/60,50,40\n"
    "CIRCLE/50,50,40,0,0,-1.,10.,0.01,.5,8,0\nGOTO/60,50,40\nCUTCOM/OFF\nGOTO/60,40,40\n"
)


def test_a_contour_beside_the_tool_keeps_its_arcs(dmu50: Machine, errors: Calibration) -> None:
    """Compare with the original: the same statements, arcs of equal radius at both ends, centres shifted as their ends are."""
    result = compensated(START + BESIDE, dmu50, errors)
    words = [line.split("/")[0] for line in result.text.splitlines() if not line.startswith("$$")]
    assert words == [line.split("/")[0] for line in (START + BESIDE).splitlines()]
    points = locations(result.text)
    centres = [
        [float(part) for part in line[7:].split(",")[:2]] for line in result.text.splitlines() if "CIRCLE" in line
    ]
    for centre, (start, end) in zip(centres, [(points[2], points[3]), (points[4], points[5])], strict=True):
        assert np.hypot(*(start[:2] - centre)) == pytest.approx(np.hypot(*(end[:2] - centre)), abs=2e-5)
    shift = np.array(centres) - [(50, 30), (50, 50)]
    near = 0.5 * (points[[2, 4], :2] + points[[3, 5], :2]) - [(55, 25), (60, 50)]
    assert np.abs(shift - near).max() < 0.003 and np.abs(shift).max() > 0.005
    assert "arcs stay arcs" in " ".join(notice.text for notice in result.reading.notices)


@pytest.mark.parametrize("text", [HOLES, BESIDE, ARCS["a quarter"][0]])
def test_without_corrections_every_byte_stays(dmu50: Machine, text: str) -> None:
    assert compensated(START + text, dmu50, Calibration.zero(dmu50)).text == START + text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("CIRCLE/50,30,40,0,0,1,10,.01,.5,8,0,TIMES,2\n", "without TIMES"),
        ("CIRCLE/50,30,40,0,1,1\nGOTO/60,30,40\n", "oblique plane"),
        ("CIRCLE/50,31,100,0,0,1\nGOTO/60,30,100\n", "off its circle"),
        ("CIRCLE/50,30,100,0,0,1\nGOTO/60,30,100,0,1,0\n", "tool that turns"),
        ("CIRCLE/50,30,100,0,0,1\nCIRCLE/50,30,100,0,0,1\n", "without its end point"),
        ("CUTCOM/LEFT\nGOTO/60,30,100,0,0.5,0.8\n", "tool that turns"),
        ("CYCLE/ON\n", "CYCLE with its values"),
        ("CYCLE/DRILL,FEDTO,1\nCIRCLE/50,30,100,0,0,1\nGOTO/60,30,100\n", "arc within a cycle"),
    ],
)
def test_what_is_refused(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        APT.moves(APT.read((START + text).encode(), "part"), AXES, tcp=False)


@pytest.mark.parametrize("text", [HOLES, "CUTCOM/LEFT\n", ARCS["a quarter"][0]])
def test_none_is_written_as_axis_positions(dmu50: Machine, errors: Calibration, text: str) -> None:
    with pytest.raises(InputError, match="cannot be written as axis positions"):
        Compensator(dmu50, errors).compensate(APT.read((START + text).encode(), "part.cls"), APT, into=ISO)


def test_the_tool_loaded_selects_its_length_from_a_table() -> None:
    text = f"{START}LOAD/TOOL,2\nGOTO/50,20,40\n"
    with pytest.raises(InputError, match="second tool"):
        APT.moves(APT.read(text.encode(), "part"), AXES, tcp=False)
    reading = APT.moves(APT.read(text.encode(), "part"), replace(AXES, tools_known=True), tcp=False)
    assert [(change.line, change.frame.tool, change.frame.length) for change in reading.frames] == [
        (1, "1", "1"),
        (4, "2", "2"),
    ]


@pytest.mark.parametrize(
    ("statement", "known"),
    [
        ("CSYS/1.,0,0,0,0,1.,0,0,0,0,1.,0", True),
        ("CSYS/1.,0,0,5,0,1.,0,0,0,0,1.,0", False),
        ("TRNTYP/WORLD,0,0,0", True),
        ("TRNTYP/WORLD,0,0,1", False),
        ("INSERT/[HOLDER=C40] 8mm DRILL", True),
        ("INSERT/G92 X5", False),
        ("INSERT/N5 M90", False),
    ],
)
def test_statements_of_solidworks(statement: str, known: bool) -> None:
    moves = APT.moves(APT.read(f"{START}{statement}\nGOTO/50,20,40\n".encode(), "part"), AXES, tcp=False).moves
    assert bool(moves[-1].unknown) != known


TURNED = "CSYS/0,.999987,.005061,0,-1.,0,0,0,0,-.005061,.999987,0\n"
"""About z by a quarter, then tilted about the new x."""


def test_a_turned_csys_behind_world_turns_nothing_where_the_locations_show_it() -> None:
    """The tool axis is that of the CSYS in the world's coordinates; in those of the CSYS it would be 0, 0, 1."""
    world, goto = "TRNTYP/WORLD,0,0,0\n", "GOTO/10,20,30,.005061,0,.999987\nGOTO/12,20,29.99,.005061,0,.999987\n"
    program = APT.read(
        (START + world + TURNED + goto + "CSYS/1,0,0,0,0,1,0,0,0,0,1,0\nGOTO/1,2,3,0,0,1\n").encode(), "part"
    )
    reading = APT.moves(program, AXES, tcp=False)
    assert [move.position[:3] for move in reading.moves[1:]] == [(10, 20, 30), (12, 20, 29.99), (1, 2, 3)]
    assert "CSYS is turned" in " ".join(notice.text for notice in reading.notices)
    for other in ("GOTO/10,20,30,0,0,1\n", "GOTO/10,20,30\n"):
        with pytest.raises(InputError, match="without its z as tool axis"):
            APT.moves(APT.read((START + world + TURNED + other).encode(), "part"), AXES, tcp=False)
    about_z = "CSYS/0,1,0,0,-1,0,0,0,0,0,1,0\n"  # its z is that of the world: the locations show nothing
    for unclear in (TURNED + goto, world + about_z + goto, world + TURNED.replace("-1.", "1.") + goto):
        moves = APT.moves(APT.read((START + unclear).encode(), "part"), AXES, tcp=False).moves
        assert all(move.unknown for move in moves[1:])
