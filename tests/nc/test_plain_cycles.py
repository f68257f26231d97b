"""Cycles of Heidenhain programs. Truth: places by hand, and in the output by a reader that shares no code with `twin.nc`."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from tests.model.errors import random_calibration
from tests.nc.nc_support import AXES
from twin._common.errors import InputError
from twin.compensation import Compensation, Compensator
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import DIALECTS

PLAIN = DIALECTS[1]
START = "0 BEGIN PGM A MM\n1 TOOL CALL 5 Z S5000\n2 L X+250 Y+200 Z-100 B+0 C+0 R0 FMAX M3\n"
END = "90 L Z-90 FMAX\n91 M30\n92 END PGM A MM\n"
DRILLING = """3 CYCL DEF 200 DRILLING ~
    Q200=+5    ;SET-UP CLEARANCE ~
    Q201=-10   ;DEPTH ~
    Q206=+45   ;FEED RATE FOR PLNGNG ~
    Q202=+10   ;PLUNGING DEPTH ~
    Q210=+0    ;DWELL TIME AT TOP ~
    Q203=-150  ;SURFACE COORDINATE ~
    Q204=+20   ;2ND SET-UP CLEARANCE ~
    Q211=+0    ;DWELL TIME AT DEPTH
"""
OF_NX = "3 CYCL DEF  203 UNIVERSAL DRILLING\nQ200=5 ;CLEARANCE\nQ201=-10\nQ203=-150.\nQ204=20.\n"
CIRCLE = """4 CYCL DEF 220 POLAR PATTERN ~
    Q216=+270  ;CENTER IN 1ST AXIS ~
    Q217=+210  ;CENTER IN 2ND AXIS ~
    Q244=20    ;PITCH CIRCLE DIAMETR ~
    Q245=+30   ;STARTING ANGLE ~
    Q246=+120  ;STOPPING ANGLE ~
    Q247=+0    ;STEPPING ANGLE ~
    Q241=4     ;NR OF REPETITIONS ~
    Q200=+5    ;SET-UP CLEARANCE ~
    Q203=-150  ;SURFACE COORDINATE ~
    Q204=+20   ;2ND SET-UP CLEARANCE ~
    Q301=+1    ;MOVE TO CLEARANCE ~
    Q365=+0    ;TYPE OF TRAVERSE
"""
GRID = """4 CYCL DEF 221 CARTESIAN PATTERN ~
    Q225=+260 ~
    Q226=+205 ~
    Q237=+10 ~
    Q238=+8 ~
    Q242=3 ~
    Q243=2 ~
    Q224=+90 ~
    Q200=+5 ~
    Q203=-150 ~
    Q204=+30 ~
    Q301=1
"""
CALLS = {
    "a part of a circle": (
        DRILLING + CIRCLE,
        [(270 + 10 * math.cos(math.radians(a)), 210 + 10 * math.sin(math.radians(a))) for a in (30, 60, 90, 120)],
        (-145, -150),
    ),
    "a circle by its step": (
        DRILLING + CIRCLE.replace("Q247=+0 ", "Q247=-90 ").replace("Q245=+30", "Q245=+0"),
        [(280, 210), (270, 200), (260, 210), (270, 220)],
        (-145, -150),
    ),
    "rows there and back, turned by a quarter": (
        DRILLING + GRID,
        [(260, 205), (260, 215), (260, 225), (252, 225), (252, 215), (252, 205)],
        (-145, -150),
    ),
    "a position": (DRILLING + "4 CYCL CALL POS X+270 Y+205 Z+0 FMAX M3\n", [(270, 205)], (-145, -150)),
    "a position on a step": (DRILLING + "4 CYCL CALL POS X+270 Y+205 Z-2.5 R0 FMAX\n", [(270, 205)], (-147.5, -152.5)),
    "points": (
        "3 PATTERN DEF ~\n POS1 (X+270 Y+205 Z+0) ~\n ROW1 (X+275 Y+210 D+5 NUM2 ROT+90 Z+0) ~\n"
        " PITCHCIRC1 (X+260 Y+210 D20 START+0 STEP+90 NUM2 Z+0)\n" + DRILLING + "4 CYCL CALL PAT F MAX\n",
        [(270, 205), (275, 210), (275, 215), (270, 210), (260, 220)],
        (-145, -150),
    ),
    "the edge of a field": (
        "3 Q5 = 10\n3 PATTERN DEF FRAME1 (X+260 Y+200 DX+Q5 DY+5 NUMX3 NUMY3 ROT+0 ROTX+0 ROTY+0 Z+0)\n"
        + DRILLING
        + "4 CYCL CALL PAT FMAX\n",
        [(260, 200), (270, 200), (280, 200), (280, 205), (260, 205), (260, 210), (270, 210), (280, 210)],
        (-145, -150),
    ),
    # name: (text, places, heights of start and surface of each)
    "M99": (DRILLING + "4 L X+270 FMAX M99\n5 L Y+210 R0 FMAX M99\n", [(270, 200), (270, 210)], (-145, -150)),
    "M99 where the tool is": (DRILLING + "4 L FMAX M99\n5 M99\n", [(250, 200), (250, 200)], (-145, -150)),
    "M89": (
        DRILLING + "4 L X+270 FMAX M89\n5 L Y+210 FMAX\n6 L IX+10 FMAX M99\n7 L X+300 FMAX\n",
        [(270, 200), (270, 210), (280, 210)],
        (-145, -150),
    ),
    "CYCL CALL": (DRILLING + "4 L X+270 FMAX\n5 CYCL CALL M8\n", [(270, 200)], (-145, -150)),
    "lines of NX": (OF_NX + "4 L X+270 FMAX M99\n5 L X+280 FMAX M99\n", [(270, 200), (280, 200)], (-145, -150)),
    "parameters": (
        "3 Q5 = -150\n" + DRILLING.replace("Q203=-150", "Q203=Q5") + "4 L X+270 FMAX M99\n",
        [(270, 200)],
        (-145, -150),
    ),
    "tapping of before": (
        "3 CYCL DEF 17.0 RIGID TAPPING\n4 CYCL DEF 17.1 SET UP 2\n5 CYCL DEF 17.2 DEPTH -10\n6 CYCL DEF 17.3 PITCH +1\n"
        "7 L Z-148 FMAX\n8 L X+270 FMAX M99\n",
        [(270, 200)],
        (-148, None),
    ),
    "decimal commas": (
        DRILLING.replace("-150", "-150,5").replace("+5 ", "+4,5 ") + "4 L X+270,5 FMAX M99\n",
        [(270.5, 200)],
        (-146, -150.5),
    ),
}


@pytest.fixture(scope="module")
def errors(dmu50: Machine) -> Calibration:
    return random_calibration(dmu50, np.random.default_rng(8), size=60.0)


def compensated(text: str, machine: Machine, errors: Calibration) -> Compensation:
    return Compensator(machine, errors).compensate(PLAIN.read(text.encode(), "part.h"), PLAIN)


def holes(text: str) -> list[tuple[float, float, float, float | None]]:
    """Return x, y, height and surface of every call in a program."""
    at, surface, found = dict.fromkeys("XYZ", 0.0), None, list[tuple[float, float, float, float | None]]()
    clearance = level = 0.0
    for line in text.replace(",", ".").splitlines():
        line = line.split(";")[0]
        for name, value in re.findall(r"(Q20[034])\s*=\s*([-+.\d]+)", line):
            surface = float(value) if name == "Q203" else surface
            clearance = float(value) if name == "Q200" else clearance
            level = float(value) if name == "Q204" else level
        body = re.sub(r"^\d+ ", "", line)
        if body.startswith("L "):
            at |= {axis: float(value) for axis, value in re.findall(r"(?<![A-Z])([XYZ])([-+.\d]+)", body)}
        elif body.startswith("CYCL CALL"):
            found.append((at["X"], at["Y"], at["Z"], surface))
            at["Z"] = at["Z"] if surface is None else surface + max(clearance, level)
    return found


@pytest.mark.parametrize("name", CALLS)
def test_a_call_begins_at_its_corrected_place(dmu50: Machine, errors: Calibration, name: str) -> None:
    text, places, (start, surface) = CALLS[name]
    result = compensated(START + text + END, dmu50, errors)
    found = holes(result.text)
    starts = [
        (move, q)
        for move, q in zip(result.reading.moves, result.commands, strict=True)
        if move.position[2] == start and any(move.position[:2] == pytest.approx(place) for place in places)
    ]
    assert [move.position[:2] for move, _ in starts][-1] == pytest.approx(places[-1])
    assert len(found) == len(places)
    for (x, y, z, top), (place_x, place_y) in zip(found, places, strict=True):
        q = next(q for move, q in starts if move.position[:2] == pytest.approx((place_x, place_y)))
        assert (x, y, z) == pytest.approx(q[:3], abs=1e-6)
        assert top is None or surface is None or top - surface == pytest.approx(z - start, abs=1e-6)
    assert max(abs(found[0][0] - places[0][0]), abs(found[0][1] - places[0][1])) > 2e-3  # there is something to correct
    assert "M99" not in re.sub(";.*", "", result.text) and "M89" not in re.sub(";.*", "", result.text)
    numbers = [int(number) for number in re.findall(r"(?m)^(\d+) ", result.text)]
    assert numbers == list(range(len(numbers)))


@pytest.mark.parametrize("name", CALLS)
def test_without_corrections_every_byte_stays(dmu50: Machine, name: str) -> None:
    text = START + CALLS[name][0] + END
    assert compensated(text, dmu50, Calibration.zero(dmu50)).text == text


def test_the_definition_is_repeated_only_for_another_surface(dmu50: Machine, errors: Calibration) -> None:
    text = START + DRILLING + "".join(f"4 L X+{250 + 0.001 * i:.3f} FMAX M99\n" for i in range(1, 9)) + END
    written = compensated(text, dmu50, errors).text
    assert written.count("CYCL CALL") == 8 and written.count("CYCL DEF 200") == 2


def test_the_same_from_file_to_file(dmu50: Machine, errors: Calibration, tmp_path: Path) -> None:
    text = START + CALLS["M89"][0] + END
    source, output = tmp_path / "part.h", tmp_path / "out.h"
    source.write_text(text)
    Compensator(dmu50, errors).compensate_file(source, output)
    assert output.read_text() == compensated(text, dmu50, errors).text


REFUSED = {
    "no cycle": ("4 L X+270 FMAX M99\n", "cycle call"),
    "another cycle after it": (DRILLING + "4 CYCL DEF 22.0 ROUGH-OUT\n5 L X+270 FMAX M99\n", "cycle call"),
    "a pocket": (DRILLING.replace("200 DRILLING", "251 RECTANGULAR POCKET") + "4 L X+270 FMAX M99\n", "cycle call"),
    "a parameter changed": (DRILLING + "4 L X+270 FMAX M99\n5 Q203=-160\n6 L X+280 FMAX M99\n", "a new CYCL DEF"),
    "an unknown surface": (DRILLING.replace("Q203=-150", "Q203=Q77") + "4 L X+270 FMAX M99\n", "unknown Q203"),
    "no surface": ("3 CYCL DEF 200 DRILLING ~\n Q200=2\n4 L X+270 FMAX M99\n", "Q203 in its definition"),
    "at a position of the plane": (DRILLING + "4 CYCL CALL POS X+10 Y+10 FMAX\n", "X, Y and Z"),
    "at a position by a feed": (DRILLING + "4 CYCL CALL POS X+10 Y+10 Z+0 F500\n", "at a feed|other words"),
    "at a position before a plane is reached": (
        DRILLING + "4 PLANE SPATIAL SPA+0 SPB+10 SPC+0 STAY\n5 CYCL CALL POS X+10 Y+10 Z+0 FMAX\n",
        "its positioning",
    ),
    "at a position under RL": (DRILLING + "4 L X+270 RL F200\n5 CYCL CALL POS X+10 Y+10 Z+0 FMAX\n", "under RL"),
    "at no pattern": (DRILLING + "4 CYCL CALL PAT FMAX\n", "PATTERN DEF with"),
    "at another pattern": (DRILLING + "4 PATTERN DEF ROW1 (X+10 Y+10 NUM2.5)\n5 CYCL CALL PAT FMAX\n", "whole numbers"),
    "at a table of points": (
        DRILLING + '4 PATTERN DEF POS1 (X+9 Y+9 Z+0)\n5 SEL PATTERN "a.pnt"\n6 CYCL CALL PAT FMAX\n',
        "PATTERN DEF with",
    ),
    "M99 after a pattern": (DRILLING + CIRCLE + "5 L X+270 FMAX M99\n", "a new CYCL DEF"),
    "a pattern along a circle": (DRILLING + CIRCLE.replace("Q365=+0", "Q365=+1"), "Q365=0"),
    "under tool centre point control": (DRILLING + "4 M128\n5 L X+270 Y+200 Z-100 FMAX M99\n", "M129"),
    "in machine coordinates": (DRILLING + "4 L X+270 FMAX M91 M99\n", "cycle call in this block"),
    "at the end": (DRILLING + "4 L X+270 FMAX M99 M5\n", "cycle call in this block"),
    "M89 alone": (DRILLING + "4 M89\n", "M89 in a block with a position"),
    "a circle of holes without its values": (DRILLING + "4 CYCL DEF 220 POLAR PATTERN\n", "Q216, Q217"),
    "a pattern without a cycle": (CIRCLE, "a cycle 200 to 209"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused(name: str) -> None:
    text, words = REFUSED[name]
    with pytest.raises(InputError, match=words):
        PLAIN.moves(PLAIN.read((START + text).encode(), "part"), AXES, tcp=False)
