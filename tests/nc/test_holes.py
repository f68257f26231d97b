"""Holes of one block or pattern, and cycles left to the control. Truth: their places written down by hand, and in the output by a
reader of words that shares no code with `twin.nc`.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from tests.model.errors import random_calibration
from tests.nc import rs274
from tests.nc.nc_support import AXES
from twin._common.errors import InputError
from twin.compensation import Compensation, Compensator, Options
from twin.compensation.programs.words import Setup
from twin.controls.offsets import ToolTable
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import DIALECTS, read_program

ISO = DIALECTS[0]
START = "G90 G21 G17\nG0 X300. Y200. Z-300. B0. C0.\n"
END = "\nG80\nG90\nG0 Z-290.\nX300.\n"
WORD = re.compile(r"([GXYZRBC])\s*([-+]?(?:\d+\.?\d*|\.\d+))")


@pytest.fixture(scope="module")
def errors(dmu50: Machine) -> Calibration:
    return random_calibration(dmu50, np.random.default_rng(5), size=30.0)


def compensated(text: str, machine: Machine, errors: Calibration) -> Compensation:
    return Compensator(machine, errors).compensate(ISO.read(text.encode(), "part.mpf"), ISO)


def path_of(text: str) -> tuple[list[np.ndarray], list[tuple[float, ...]]]:
    """Return the positions of a program of G0 and G1, and x, y, z, top and bottom of each of the control's own cycles."""
    at, relative, path, own = dict.fromkeys("XYZBC", 0.0), False, list[np.ndarray](), list[tuple[float, ...]]()
    for line in text.splitlines():
        line = re.sub(r"\(.*?\)|;.*", "", line) if not line.startswith("CYCLE") else line
        if line.startswith("CYCLE"):
            retract, reference, distance, depth = (float(part) for part in line[line.index("(") + 1 :].split(",")[:4])
            own.append((at["X"], at["Y"], at["Z"], reference + distance, depth))
            at["Z"] = retract
            continue
        words = WORD.findall(line)
        codes = [int(float(value)) for letter, value in words if letter == "G"]
        relative = 91 in codes or (relative and 90 not in codes)
        values = {letter: float(value) for letter, value in words if letter not in "GR"}
        if {74, 76, 84, 86, 88} & set(codes):
            top = float(dict(words)["R"]) + (at["Z"] if relative else 0.0)
            own.append((at["X"], at["Y"], at["Z"], top, values["Z"] + (top if relative else 0.0)))
        elif values:
            at |= {axis: value + (at[axis] if relative else 0.0) for axis, value in values.items()}
            path.append(np.array(list(at.values())))
    return path, own


PLACES = {
    # name: (text, places of the holes in order)
    "repeats in G91": ("G91 G99 G81 X10. Y5. Z-20. R-10. L3", [(310, 205), (320, 210), (330, 215)]),
    "repeats at a place": ("G99 G81 X310. Z-330. R-310. K2", [(310, 200), (310, 200)]),
    "defined before the first hole": (
        "G99 G81 Z-330. R-310. K0\nX310.\nY210.",
        [(310, 200), (310, 210)],
    ),
    "G91 after the cycle of Fanuc": (
        "O1234\nG99 G81 X310. Z-330. R-310.\nG91 X10. L2\nG90 Y210.",
        [(310, 200), (320, 200), (330, 200), (330, 210)],
    ),
    "a row": (
        "MCALL CYCLE81(-300,-312,2,-330)\nHOLES1(300,200,90,5,10,3)\nMCALL",
        [(300, 205), (300, 215), (300, 225)],
    ),
    "a circle": (
        "MCALL CYCLE81(-300,-312,2,-330)\nHOLES2(300,200,20,0,0,4)\nMCALL",
        [(320, 200), (300, 220), (280, 200), (300, 180)],
    ),
    "a part of a circle": (
        "MCALL CYCLE81(-300,-312,2,-330)\nHOLES2(300,200,20,90,90,2)\nMCALL",
        [(300, 220), (280, 200)],
    ),
    "a grid": (
        "MCALL CYCLE81(-300,-312,2,-330)\nCYCLE801(310,210,0,10,5,2,2)\nMCALL",
        [(310, 210), (320, 210), (320, 215), (310, 215)],
    ),
    "increments under MCALL": (
        "MCALL CYCLE81(-300,-312,2,-330)\nG91 X10.\nY10.\nG90\nMCALL",
        [(310, 200), (310, 210)],
    ),
}


@pytest.mark.parametrize("name", PLACES)
def test_places_of_holes(dmu50: Machine, errors: Calibration, name: str) -> None:
    text, places = PLACES[name]
    result = compensated(START + text + END, dmu50, errors)
    bottoms = [move.position[:2] for move in result.reading.moves if move.position[2] == -330.0]
    assert np.array(bottoms) == pytest.approx(np.array(places, dtype=float))
    path, own = path_of(result.text)
    assert not own and np.array(path) == pytest.approx(result.commands, abs=1e-6)
    assert result.report.after.max_um < 2.0


@pytest.mark.parametrize("name", PLACES)
def test_holes_stay_as_they_are_without_corrections(dmu50: Machine, name: str) -> None:
    text = START + PLACES[name][0] + END
    assert compensated(text, dmu50, Calibration.zero(dmu50)).text == text


BORED = {
    # name: (text, places, top and bottom of each)
    "G86": ("G98 G86 X310. Y210. Z-330. R-310. F50.\nX320.", [(310, 210), (320, 210)], (-310, -330)),
    "G86 in G91": ("G91 G99 G86 X10. Z-20. R-10. F50. L2", [(310, 200), (320, 200)], (-310, -330)),
    "G76": ("G99 G76 X310. Z-330. R-310. Q.1 P500 F50.", [(310, 200)], (-310, -330)),
    "G88": ("G99 G88 X310. Z-330. R-310. P500 F50.", [(310, 200)], (-310, -330)),
    "CYCLE86": ("MCALL CYCLE86(-300,-312,2,-330,,0,3,1,1,1,45)\nX310.\nMCALL", [(310, 200)], (-310, -330)),
    "a row of CYCLE84": (
        "MCALL CYCLE84(-300,-312,2,-330,,0,3,5,,1.5)\nHOLES1(300,200,0,0,10,2)\nMCALL",
        [(300, 200), (310, 200)],
        (-310, -330),
    ),
}


@pytest.mark.parametrize("name", BORED)
def test_a_cycle_left_to_the_control_begins_and_ends_corrected(dmu50: Machine, errors: Calibration, name: str) -> None:
    """Compare place, top and bottom of each cycle with the correction of the height at which it begins."""
    text, places, (top, bottom) = BORED[name]
    result = compensated(START + text + END, dmu50, errors)
    path, own = path_of(result.text)
    assert np.array(path) == pytest.approx(result.commands, abs=1e-6)
    wanted = [
        [*q[:3], q[2], q[2] + bottom - top]
        for move, q in zip(result.reading.moves, result.commands, strict=True)
        if move.position[2] == top and any(move.position[:2] == pytest.approx(place) for place in places)
    ]
    # From a level above, the tool comes to the top once at every place.
    assert len(own) == len(places) and np.array(own) == pytest.approx(np.array(wanted[: len(own)]), abs=1e-6)
    assert all(
        abs(one[0] - place[0]) > 1e-3 for one, place in zip(own, places, strict=True)
    )  # there is something to correct
    assert "is left to the control" in " ".join(notice.text for notice in result.reading.notices)


def test_the_other_words_of_a_bored_hole_are_kept(dmu50: Machine, errors: Calibration) -> None:
    lines = compensated(
        START + "G99 G76 X310. Z-330. R-310. Q.1 P500 F50.\nX320. F30." + END, dmu50, errors
    ).text.splitlines()
    own = [line for line in lines if line.startswith("G99 G76")]
    assert [line.split()[-3:] for line in own] == [["Q.1", "P500", "F50."], ["Q.1", "P500", "F30."]]
    lines = compensated(START + BORED["CYCLE86"][0] + END, dmu50, errors).text.splitlines()
    own = [line for line in lines if line.startswith("CYCLE86")]
    assert re.fullmatch(r"CYCLE86\([^,]+, [^,]+, 2, [^,]+, , 0, 3, 1, 1, 1, 45\)", own[0]) and len(own) == 1


def test_the_level_is_not_needed_where_the_tool_returns_to_r() -> None:
    text = START + "G28 Z0\nG99 G81 X310. Y200. Z-330. R-310. F50.\nX320.\nG80\nG0 Z-290.\n"
    moves = ISO.moves(ISO.read(text.encode(), "part"), AXES, tcp=False).moves
    assert [move.position[2] for move in moves[2:]] == [-310, -330, -310, -310, -330, -310, -290]


def test_holes_under_tool_centre_point_control(dmu50: Machine, errors: Calibration) -> None:
    """Drill along Z of the program with the tool along it: the words stay those of the tip."""
    text = "G90 G21 G17\nTRAORI\nG0 X50. Y20. Z100. B0. C30.\nMCALL CYCLE81(60,42,2,30)\nX60.\nMCALL\nG0 Z100.\nX61.\n"
    result = compensated(text, dmu50, errors)
    moves = result.reading.moves
    assert [move.position[2] for move in moves] == [100, 100, 44, 30, 60, 100, 100] and all(move.tcp for move in moves)
    path, own = path_of(result.text)
    written = np.array(path)[:, :3] - [move.position[:3] for move in moves]
    assert not own and 0.001 < np.abs(written).max() < 0.1 and result.report.after.max_um < 2.0


@rs274.needed
def test_boring_of_linuxcnc(dmu50: Machine, errors: Calibration, tmp_path: Path) -> None:
    """Compare where LinuxCNC bores by the original and by the output: the difference is the correction."""
    text = (
        START.replace("B0. C0.", "B0. C0. F50. S100 M3") + "G98 G86 X310. Y210. Z-330. R-310. P.5\nX320." + END + "M2\n"
    )
    result = compensated(text, dmu50, errors)
    before, after = (
        np.array([event.end for event in rs274.events(one, tmp_path) if event.end[2] == event.end[2]])
        for one in (text, result.text)
    )
    bottoms = [
        [rows[i] for i in range(1, len(rows) - 1) if rows[i][2] < min(rows[i - 1][2], rows[i + 1][2])]
        for rows in (before, after)
    ]
    assert len(bottoms[0]) == len(bottoms[1]) == 2
    shift = np.array(bottoms[1]) - np.array(bottoms[0])
    tops = [
        q - move.position
        for move, q in zip(result.reading.moves, result.commands, strict=True)
        if move.position[2] == -310.0
    ]
    assert shift[:, :3] == pytest.approx(np.array(tops)[:2, :3], abs=1e-6)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("G99 G81 X310. Z-330. R-310.\nG91 X10.", "program number"),
        ("MCALL CYCLE81(-300,-312,2,-330)\nHOLES1(300,200,90,5,10,_N)\n", "known values"),
        ("MCALL CYCLE81(-300,-312,2,-330)\nHOLES2(300,200,20,0,0,2.5)\n", "whole numbers of holes"),
        ("MCALL CYCLE81(-300,-312,2,-330)\nHOLES1(300,200,0,0,10,2,1)\n", "6 arguments"),
        ("M91\nG99 G81 X310. Z-330. R-310.", "the effect of M91 is not known"),
        ("G28 Z0\nG98 G81 X310. Z-330. R-310.", "position of Z unknown"),
        ("G99 G81 X310. Z-330. R-310.\nG18 X10.", "canned cycle"),
        ("G99 G81 X310. Z-330. R-310.\nMCALL CYCLE81(-300,-312,2,-330)", "cycles of one control"),
        ("MCALL CYCLE81(-300,-312,2,-330)\nG20", "before the unit changes"),
        ("G99 G81 X310. Z-330. R-310.\nG43 H1 X320.", "with and without a tool length"),
        ("G43.4 H1 X300. Y200. Z-300. B20.\nG99 G81 X310. Z-330. R-310.", "with B turned"),
    ],
)
def test_what_is_refused(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        ISO.moves(ISO.read((START + text).encode(), "part"), AXES, tcp=False)
    assert caught.value.line == 4


def test_a_stroke_that_rounding_leaves_no_way_is_written(dmu50: Machine, tmp_path: Path) -> None:
    """Check inches with five decimals of a postprocessor, a height that a length of zero makes unknown, and half a least increment."""
    options = Options(setup=Setup(tools=ToolTable(Path("t.csv"), {"1": 80.0})))
    compensator = Compensator(dmu50, Calibration.default(dmu50), options)
    iso = "G20 G90 G0 X10 Y9 Z{} B0 C0\n{}{} X10.5 Y9.5 Z-12.2 R-11.8 F9.8\nX10.9\nG80\nM30\n"
    texts = [iso.format("-11.79999", "", cycle) for cycle in ("G85 G98", "G81 G98", "G76 G98")]
    texts += [iso.format("-11.8", "G80 G49\n", cycle) for cycle in ("G86 G99", "G81 G99")]
    for text in texts:
        (tmp_path / "a.nc").write_text(f"O1\n{text}")
        result = compensator.compensate(*read_program(tmp_path / "a.nc"))
        assert len([line for line in result.text.split("\n") if "Z-12." in line and "(" not in line]) == 2, result.text
    cycle = "CYCL DEF 200 DRILLING ~\n Q200=+2 ~\n Q201=-9 ~\n Q206=+99 ~\n Q202=+9 ~\n Q210=+0 ~\n Q203=-302.0002 ~\n"
    cycle += " Q204=+2 ~\n Q211=+0\n"
    path = tmp_path / "a.h"
    path.write_text(f"BEGIN PGM A MM\nL X+250 Y+225 Z-300 B+0 C+0 FMAX\n{cycle}L X+260 FMAX M99\nEND PGM A MM\n")
    assert compensator.compensate(*read_program(path)).text.count("CYCL CALL") == 1
