"""End points and paths of SINUMERIK by other words than coordinates. Truth: end points, centres and sweeps computed by hand."""

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
from twin.compensation.programs import parts
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import DIALECTS
from twin.nc.blocks import Move

ISO = DIALECTS[0]
START = "G90 G71 G17 G40\nG0 X250 Y200 Z-100 B0 C0\nG1 F500 X260 Y200\n"
END = "G1 X300 Y230\nG0 Z-90\nM30\n"
ROOT = 5 * math.sqrt(2)
PATHS = {
    # name: (blocks, end points, centre and sweep in degrees of the last one or None)
    "about the zero": ("G111 X260 Y210\nG1 AP=0 RP=10\nAP=90\n", [(270, 210), (260, 220)], None),
    "a radius alone": ("G111 X260 Y210\nG1 AP=90 RP=10\nRP=15\n", [(260, 220), (260, 225)], None),
    "an angle further": ("G111 X260 Y210\nG1 AP=0 RP=10\nAP=IC(45)\n", [(270, 210), (260 + ROOT, 210 + ROOT)], None),
    "from the last position": ("G110 X10 Y0\nG0 AP=180 RP=5\n", [(265, 200)], None),
    "from the last pole": ("G111 X260 Y200\nG112 X5 Y5\nG1 AP=90 RP=5\n", [(265, 210)], None),
    "a pole by an angle": ("G111 AP=90 RP=200\nG1 AP=0 RP=270\n", [(270, 200)], None),
    "without a pole": ("G1 AP=0 RP=270 Z-110\n", [(270, 0)], None),
    "an arc about the pole": ("G111 X260 Y210\nG3 AP=0 RP=10\n", [(270, 210)], ((260, 210), 90)),
    "the long way": ("G111 X260 Y210\nG2 AP=0 RP=10\n", [(270, 210)], ((260, 210), -270)),
    "inches": ("G70\nG111 X10 Y8\nG1 AP=0 RP=0.5\n", [(266.7, 203.2)], None),
    "parameters": ("R1=10\nG111 X=R1*26 Y210\nG1 AP=R1*9 RP=R1\n", [(260, 220)], None),
    "an angle and an end": ("G2 X280 Y200 AR=90\n", [(280, 200)], ((270, 190), -90)),
    "more than half a circle": ("G3 X280 Y200 AR=270\n", [(280, 200)], ((270, 190), 270)),
    "an angle and a centre": ("G3 I10 J0 AR=90\n", [(270, 190)], ((270, 200), 90)),
    "a centre from zero": ("G2 I=AC(270) J=AC(200) AR=180\n", [(280, 200)], ((270, 200), -180)),
    "a direction": ("G1 ANG=45 X270\nANG=135 Y215\n", [(270, 210), (265, 215)], None),
    "through a point": ("CIP X280 Y200 I1=270 J1=210\n", [(280, 200)], ((270, 200), -180)),
    "through a point further": ("CIP X280 Y200 I1=IC(10) J1=IC(-10)\n", [(280, 200)], ((270, 200), 180)),
    "three quarters": ("CIP X270 Y210 I1=270 J1=190 K1=-100\n", [(270, 210)], ((270, 200), 270)),
}
CORNERS = {
    # name: (blocks, which moves behind the start stay whole)
    "RND": ("X270 RND=3\nY220\nX250\n", [True, True, False]),
    "CHR": ("X270 CHR=1 F300\nY220\nX250\n", [True, True, False]),
    "RNDM": ("X270 RNDM=1\nY220\nX250 RNDM=0\nY240\nX240\n", [True, True, True, False, False]),
    "an arc": ("G3 X270 Y210 I0 J10 RND=2\nG1 Y230\nX250\n", [True, True, False]),
    "CT": ("X270\nCT X290 Y220\nG1 Y240\n", [True, True, False]),
    "BSPLINE": ("X270\nBSPLINE X275 Y205 PW=0.7\nX280 Y215\nG1 Y240\nX250\n", [True, True, True, True, False]),
    "CSPLINE": ("X270\nBNAT ENAT CSPLINE X275 Y205\nX280 Y215\nG1 Y240\nX250\n", [True, True, True, True, False]),
}


@pytest.fixture(scope="module")
def errors(dmu50: Machine) -> Calibration:
    return random_calibration(dmu50, np.random.default_rng(5), size=120.0)


def compensated(text: str, machine: Machine, errors: Calibration) -> Compensation:
    return Compensator(machine, errors).compensate(ISO.read(text.encode(), "part.mpf"), ISO)


def moves_of(text: str) -> list[Move]:
    return list(ISO.moves(ISO.read(text.encode(), "part"), AXES, tcp=False).moves)


def ends_of(text: str) -> np.ndarray:
    """Return X, Y, Z at the ends of blocks of a program without poles, by a reader of words of its own."""
    at, ends = {"X": np.nan, "Y": np.nan, "Z": np.nan}, []
    for line in text.splitlines():
        bare = re.sub(r";.*|\(.*?\)|^G11\d.*", "", line)
        words = re.findall(r"(?<![A-Z=])([XYZ])=?([-+]?[\d.]+)", bare)
        at |= {name: float(value) for name, value in words}
        ends += [list(at.values())] if words else []
    return np.array(ends)


@pytest.mark.parametrize("name", PATHS)
def test_end_points_and_arcs(name: str) -> None:
    text, ends, arc = PATHS[name]
    moves = moves_of(START + text)[2:]
    assert np.array([move.position[:2] for move in moves]) == pytest.approx(np.array(ends, dtype=float))
    found = moves[-1].arc
    assert (found is None) == (arc is None)
    if found is not None and arc is not None:
        assert found.centre_mm == pytest.approx(arc[0])
        assert math.degrees(found.angle_rad) == pytest.approx(arc[1])


@pytest.mark.parametrize(
    "name", [name for name in PATHS if name not in ("inches", "without a pole", "a pole by an angle")]
)
def test_the_output_has_coordinates_at_the_corrected_points(dmu50: Machine, errors: Calibration, name: str) -> None:
    result = compensated(START + PATHS[name][0] + END, dmu50, errors)
    bare = re.sub(r"\(.*?\)|G11\d.*", "", result.text)
    assert not re.search(r"\b(?:AP|RP|AR|ANG|I1|CIP)\b", bare)
    ends = ends_of(result.text)
    for q in result.commands[1:]:
        assert np.abs(ends - q[:3]).max(axis=1).min() < 2e-3
    assert ends[-1] == pytest.approx(result.commands[-1][:3], abs=1e-6)


@pytest.mark.parametrize("name", PATHS)
def test_without_corrections_every_byte_stays(dmu50: Machine, name: str) -> None:
    if name not in ("without a pole", "a pole by an angle"):  # outside of the machine
        text = START + PATHS[name][0] + END
        assert compensated(text, dmu50, Calibration.zero(dmu50)).text == text


@pytest.mark.parametrize("name", CORNERS)
def test_blocks_beside_a_path_of_the_control_stay_whole(dmu50: Machine, errors: Calibration, name: str) -> None:
    text, whole = CORNERS[name]
    assert [move.whole for move in moves_of(START + text)[2:]] == whole
    result = compensated(START + text + END, dmu50, errors)
    kept = re.findall(r"RND=\d|CHR=\d|RNDM=\d|\bCT\b|[BC]SPLINE|PW=0.7|BNAT ENAT", text)
    assert re.findall(r"RND=\d|CHR=\d|RNDM=\d|\bCT\b|[BC]SPLINE|PW=0.7|BNAT ENAT", result.text) == kept
    ends = ends_of(result.text)
    for q, move in zip(result.commands, result.reading.moves, strict=False):
        if move.whole:
            assert np.abs(ends - q[:3]).max(axis=1).min() < 1e-6
    assert "left to the control" in result.report.to_text()


def test_a_path_of_the_control_at_the_end_of_a_stretch(
    dmu50: Machine, errors: Calibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, output = tmp_path / "part.mpf", tmp_path / "out.mpf"
    text = START + CORNERS["CT"][0] + "; a remark\n" + CORNERS["CSPLINE"][0] + END
    source.write_text(text)
    for size in (5, 33, 64, 90):
        monkeypatch.setattr(parts, "STRETCH_BYTES", size)
        Compensator(dmu50, errors).compensate_file(source, output)
        assert output.read_text() == compensated(text, dmu50, errors).text


REFUSED = {
    "a pole of another frame": ("G111 X260 Y210\nTRANS X5\nG1 AP=0 RP=5\n", "pole from before a change"),
    "a pole from one of another frame": ("G111 X260 Y210\nTRANS X5\nG112 X5 Y5\n", "pole from before a change"),
    "a work offset of Haas": ("G21\nG111 X260 Y210\n", "selects a work offset"),
    "its words later": ("G111 X260 Y210\nG1 AP=0 RP=5\nG28 Z0\n", "selects a work offset"),
    "a rounding beside a turn": ("X270 RND=2\nY210 B5\n", "the tool turns"),
    "a rounding before a hole": ("X270 RND=2\nMCALL CYCLE81(-80,-110,2,-120)\nY210\n", "drills"),
    "an angle with another word": ("G3 I10 K1 AR=90\n", "other words"),
    "a spline in a cycle": ("MCALL CYCLE81(-80,-110,2,-120)\nBSPLINE X270\n", "in a cycle"),
    "the weight of no spline": ("G1 X270 PW=2\n", "curve"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused(name: str) -> None:
    text, words = REFUSED[name]
    with pytest.raises(InputError, match=words):
        moves_of(START + text)


@pytest.mark.parametrize("name", [name for name, (_, _, arc) in PATHS.items() if arc is not None])
@pytest.mark.parametrize("beside", ["RND=1", "G41"])
def test_an_arc_that_stays_one_has_its_centre(dmu50: Machine, errors: Calibration, name: str, beside: str) -> None:
    """Check that it is written with G2 or G3, its ends and I and J, about a centre near that computed by hand."""
    text, _, arc = PATHS[name]
    *before, last = text.splitlines()
    contour = [f"{last} RND=1", "G1 X290 Y240"] if beside == "RND=1" else [last, "G1 X290 Y240", "G40 X300"]
    side = ["G41 D1 G1 X260 Y200"] if beside == "G41" else []
    begin = START.replace("G1 F500 X260 Y200\n", "G1 F500 X262 Y195\n" if side else "G1 F500 X260 Y200\n")
    result = compensated(begin + "\n".join([*side, *before, *contour, ""]) + END, dmu50, errors)
    written = [line for line in result.text.splitlines() if re.match(r"G[23] ", line)]
    assert len(written) == 1 and not re.search(r"A[PR]=|RP=|I1=|CIP", written[0]) and arc is not None
    words = {letter: float(value) for letter, value in re.findall(r"([GXYIJ])([-+]?[\d.]+)", written[0])}
    at = next(i for i, move in enumerate(result.reading.moves) if move.arc is not None)
    assert (words["X"], words["Y"]) == pytest.approx(result.commands[at][:2], abs=1e-6)
    start = result.commands[at - 1][:2]
    centre = start[0] + words.get("I", 0.0), start[1] + words.get("J", 0.0)
    assert math.dist(centre, start) == pytest.approx(math.dist(centre, result.commands[at][:2]), abs=0.002)
    off = 0.5 * (start + result.commands[at][:2] - np.array([260, 200]) - np.array(PATHS[name][1][-1]))
    assert np.array(centre) - arc[0] == pytest.approx(off, abs=0.02)
    assert words["G"] == (2 if arc[1] < 0 else 3)
