"""Paths about the pole and radius compensation in plain language. Truth: end points, sweeps and centres computed by hand."""

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

PLAIN = DIALECTS[1]
START = "0 BEGIN PGM A MM\n1 TOOL CALL 5 Z S5000\n2 L X+250 Y+200 Z-100 B+0 C+0 R0 FMAX M3\n"
POLE = "3 CC X+260 Y+200\n"
END = "90 L Z-90 R0 FMAX\n91 END PGM A MM\n"
POLAR = {
    # name: (blocks behind the pole, end points, sweep of the last one in degrees or None)
    "radius and angle": ("4 LP PR+20 PA+0 F500\n5 LP PA+90\n", [(280, 200), (260, 220)], None),
    "increments": ("4 LP PR+20 PA+0 F500\n5 LP IPR+10 IPA+90 FMAX\n", [(280, 200), (260, 230)], None),
    "from a position": ("4 L X+260 Y+210 F500\n5 LP IPA-90\n", [(260, 210), (270, 200)], None),
    "an arc": ("4 LP PR+20 PA+0 F500\n5 CP PA+270 DR-\n", [(280, 200), (260, 180)], -90),
    "an arc the long way": ("4 LP PR+20 PA+0 F500\n5 CP PA+270 DR+\n", [(280, 200), (260, 180)], 270),
    "an arc by increments": ("4 LP PR+20 PA+0 F500\n5 CP IPA-90 DR-\n", [(280, 200), (260, 180)], -90),
    "a helix of turns": ("4 LP PR+20 PA+0 F500\n5 CP IPA+810 IZ-5 DR+\n", [(280, 200), (260, 220)], 810),
    "a circle": ("4 LP PR+20 PA+0 F500\n5 CP IPA+360 DR+\n", [(280, 200), (280, 200)], 360),
    "parameters": ("4 Q1 = 20\n5 LP PR+Q1 PA+90 F500\n", [(260, 220)], None),
}
UPRIGHT = {
    # name: (blocks, end, plane, sweep in degrees): the pole names the plane; its first axis is the axis of angle 0
    "CP across Y": ("3 CC X+240 Z-100\n4 CP IPA+90 DR+ F500\n", (240, 200, -110), (2, 0, 1), 90),
    "CP across Y, another pole before": (
        "3 CC X+1 Y+2\n3 CC X+240 Z-100\n4 CP IPA-90 DR- F500\n",
        (240, 200, -90),
        (2, 0, 1),
        -90,
    ),
    "C across Y": ("3 CC X+240 Z-100\n4 C X+240 Z-110 DR+ F500\n", (240, 200, -110), (2, 0, 1), 90),
    "C across X": ("3 CC Y+190 Z-100\n4 C Y+190 Z-90 DR+ F500\n", (250, 190, -90), (1, 2, 0), 90),
    "CP across X, angle from Y": ("3 CC Y+190 Z-100\n4 CP PA+90 DR+ F500\n", (250, 190, -90), (1, 2, 0), 90),
    "LP across Y, angle from Z": ("3 CC X+240 Z-100\n4 LP PR+5 PA+90 F500\n", (245, 200, -100), None, 0),
}
CONTOUR = (
    "9 L X+270 Y+200 RL F200\n10 L Y+220\n11 CC X+280 Y+220\n12 C X+280 Y+230 DR-\n13 CR X+290 Y+220 R+10 DR-\n14 L Y+200\n"
    "15 L X+250 R0 FMAX\n"
)


@pytest.fixture(scope="module")
def errors(dmu50: Machine) -> Calibration:
    return random_calibration(dmu50, np.random.default_rng(5), size=120.0)


def compensated(text: str, machine: Machine, errors: Calibration) -> Compensation:
    return Compensator(machine, errors).compensate(PLAIN.read(text.encode(), "part.h"), PLAIN)


def moves_of(text: str) -> list[Move]:
    return list(PLAIN.moves(PLAIN.read(text.encode(), "part"), AXES, tcp=False).moves)


@pytest.mark.parametrize("name", POLAR)
def test_end_points_about_the_pole(name: str) -> None:
    text, ends, sweep = POLAR[name]
    moves = moves_of(START + POLE + text)[1:]
    assert np.array([move.position[:2] for move in moves]) == pytest.approx(np.array(ends, dtype=float))
    arc = moves[-1].arc
    assert (None if arc is None else math.degrees(arc.angle_rad)) == (None if sweep is None else pytest.approx(sweep))
    assert moves[-1].position[2] == (-105.0 if "IZ" in text else -100.0)


@pytest.mark.parametrize("name", POLAR)
def test_they_become_straight_blocks_at_the_corrected_points(dmu50: Machine, errors: Calibration, name: str) -> None:
    result = compensated(START + POLE + POLAR[name][0] + END, dmu50, errors)
    assert not re.search(r"\b(LP|CP|I?PA|I?PR)", re.sub(";.*", "", result.text))
    again = np.array([move.position for move in moves_of(result.text)])
    ends = [again[np.argmin(np.abs(again - q).sum(axis=1))] for q in result.commands]
    assert np.array(ends) == pytest.approx(result.commands, abs=2e-3)
    assert again[-1] == pytest.approx(result.commands[-1], abs=1e-6)


@pytest.mark.parametrize("name", UPRIGHT)
def test_the_pole_names_the_plane_of_the_arc(dmu50: Machine, errors: Calibration, name: str) -> None:
    text, end, plane, sweep = UPRIGHT[name]
    last = moves_of(START + text)[-1]
    assert last.position[:3] == pytest.approx(end)
    if plane is not None:
        assert last.arc is not None and last.arc.plane == plane
        assert math.degrees(last.arc.angle_rad) == pytest.approx(sweep)
    result = compensated(START + text + END, dmu50, errors)
    again = np.array([move.position for move in moves_of(result.text)])
    assert np.abs(again - result.commands[1]).max(axis=1).min() < 2e-3


@pytest.mark.parametrize("text", [*(POLE + text for text, _, _ in POLAR.values()), CONTOUR])
def test_without_corrections_every_byte_stays(dmu50: Machine, text: str) -> None:
    assert compensated(START + text + END, dmu50, Calibration.zero(dmu50)).text == START + text + END


def test_a_contour_with_radius_compensation_keeps_its_arcs(dmu50: Machine, errors: Calibration) -> None:
    """Compare with the original: one block each, RL and R0 where they stood, new poles equally far from both ends of the arc."""
    result = compensated(START + CONTOUR + END, dmu50, errors)
    lines = [re.sub(r"^\d+ ", "", line) for line in result.text.splitlines()]
    assert [line.split()[0] for line in lines if line[0] in "LC"] == [
        "L",
        "L",
        "L",
        "CC",
        "CC",
        "C",
        "CR",
        "L",
        "L",
        "L",
    ]
    assert sum("RL" in line for line in lines) == 1 and len(result.commands) == len(result.reading.moves)
    ends = np.array([move.position for move in moves_of(result.text)])
    assert ends == pytest.approx(result.commands, abs=1e-6)
    pole = [line for line in lines if line.startswith("CC")][-1]
    x, y = (float(value) for value in re.findall(r"[XY]([-+.\d]+)", pole))
    start, end = ends[2, :2], ends[3, :2]
    assert math.dist((x, y), start) == pytest.approx(math.dist((x, y), end), abs=0.002)
    assert (x - 280, y - 220) == pytest.approx(0.5 * (start + end - (270, 220) - (280, 230)), abs=0.003)
    radius = float(re.findall(r" R([-+.\d]+)", next(line for line in lines if line.startswith("CR")))[0])
    assert radius == pytest.approx(10.0, abs=0.01)
    numbers = [int(number) for number in re.findall(r"(?m)^(\d+) ", result.text)]
    assert numbers == list(range(len(numbers)))


def test_a_block_across_the_plane_neither_leads_in_nor_out() -> None:
    moves = moves_of(START + "4 L X+270 RL F200\n5 L Z-105\n6 L Y+210\n7 L R0\n8 L Z-100\n9 L X+250\n10 L Y+200\n")
    assert [move.whole for move in moves] == [False, True, True, True, True, True, False]


REFUSED = {
    "no pole": ("4 LP PR+20 PA+0\n", "without a pole"),
    "a helix of another sense": (POLE + "4 LP PR+20 PA+0 F500\n5 CP IPA+90 DR-\n", "sign of DR"),
    "no sense": (POLE + "4 LP PR+20 PA+0 F500\n5 CP IPA+90\n", "DR"),
    "an arc by its radius": (POLE + "4 CP PR+20 PA+0 DR+\n", "PA or IPA"),
    "from the pole itself": (POLE + "4 L X+260 F500\n5 LP IPA+26\n", "from the pole itself"),
    "an angle of a line": ("4 L PA+20\n", "unknown word"),
    "X in a polar block": (POLE + "4 LP PR+20 X+5\n", "without axis words"),
    "a helix beside a contour": (POLE + "4 LP PR+20 PA+0 RL F500\n5 CP IPA+90 IZ+1 DR+\n", "on a helix"),
    "a rounding beside a helix": (
        POLE + "4 LP PR+20 PA+0 F500\n5 CP IPA+90 IZ+1 DR+\n6 RND R1\n7 L X+300\n",
        "beside a helix",
    ),
    "a rounding beside a turn": ("4 L X+270 F500\n5 RND R1\n6 L Y+220 B+5\n", "the tool turns"),
    "a turn beside a contour": ("4 L X+270 RL F200\n5 L C+20\n", "tool that turns"),
    "machine coordinates": ("4 L X+270 RL F200\n5 L Z+0 M91\n", "R0 before"),
    "a lead-in without its end": ("4 APPR LT LEN10 RL F200\n", "with or without its end"),
    "a lead-out to somewhere": ("4 L X+270 RL F200\n5 DEP LT X+5 Y+5 LEN10\n", "with or without its end"),
    "a lead-in about no pole": ("4 APPR PLT PR+20 PA+0 LEN10 RL F200\n", "without a pole"),
    "a tangential arc about the pole": (POLE + "4 L X+270 F200\n5 CTP PR+20 PA+90\n", "CTP"),
    "one axis": ("4 X+270 R+ F200\n", "radius compensation"),
    "a pole in space": ("3 CC X+240 Y+200 Z-100\n4 C X+240 Y+190 DR+\n", "three coordinates"),
    "a radius with the tool axis": ("3 CR X+260 Z-90 R+20 DR+\n", "a word of the tool axis and one"),
    "an upright arc beside a contour": ("3 L X+260 RL F200\n4 CC X+250 Z-100\n5 CP IPA+90 DR+\n", "in another plane"),
    "an arc out of the plane of its pole": ("4 CC X+240 Z-100\n5 C X+240 Y+210 DR+\n", "with the axes of the words"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused(name: str) -> None:
    text, words = REFUSED[name]
    with pytest.raises(InputError, match=words):
        moves_of(START + text)


@pytest.mark.parametrize("text", ["L X+5 Y+6 R F MAX M", "L X+5 Y+6 R F M\n", "L X+5 Y+6 F100 M"])
def test_words_without_a_value_of_older_controls(text: str) -> None:
    (move,) = moves_of(f"{START}{text}\n")[1:]
    assert move.position[:2] == (5.0, 6.0)


ON_CONTOUR = "L Y+220\nL X+300 Y+225\nL Y+200\nL X+285 Y+190\n"
LEADS = {
    # name: (lead-in, behind each block of the contour, lead-out), each after the form of plain L blocks
    "tangents": ("APPR LT X+270 Y+200 LEN15 RL F200", ("", "", "", ""), "DEP LT LEN12,5 F500"),
    "normals": ("APPR LN X+270 Y+200 LEN+15 RR F200", ("", "", "", ""), "DEP LN LEN+20 F500"),
    "arcs": ("APPR CT X+270 Y+200 CCA180 R+10 RL F200", ("RND R2 F100", "CHF 1", "", ""), "DEP CT CCA90 R+8"),
    "lines and arcs": (
        "APPR LCT X+270 Y+200 Z-105 R10 RL F200",
        ("RND R2", "", "", ""),
        "DEP LCT X+250 Y+195 R+8 F500 M9",
    ),
    "without a side": ("APPR LCT X+270 Y+200 R10 R0 F200", ("", "", "", ""), "DEP LCT X+250 Y+195 Z-90 R8"),
}


@pytest.mark.parametrize("name", LEADS)
def test_leads_have_the_ends_of_straight_blocks(dmu50: Machine, errors: Calibration, name: str) -> None:
    """Compare with the program in which each is a straight block to its end; roundings and chamfers are left out there."""
    begin, behind, end = LEADS[name]
    straight = re.sub(r"APPR \w+|LEN\S+|CCA\d+|(?<= )R\+?\d+(?= )", "", begin).replace("  ", " ")
    out = re.sub(r"DEP LCT|R\+?8", "", end)
    blocks = [line for pair in zip(ON_CONTOUR.splitlines(), behind, strict=True) for line in pair if line]
    if "RL" not in begin and "RR" not in begin:
        blocks = ON_CONTOUR.splitlines()[:1]
    leads = [begin, *blocks, end, "L Z-80 FMAX", "L X+250 Y+200 FMAX"]
    plain = [f"L {straight}", *(line for line in blocks if line[0] == "L"), "" if "LCT" not in end else f"L {out} R0"]
    plain += ["L Z-80 FMAX", "L X+250 Y+200 FMAX"]
    found, wanted = (
        [
            re.sub(r"^\d+ ", "", line)
            for line in compensated(START + "\n".join(lines) + "\n" + END, dmu50, errors).text.splitlines()
        ]
        for lines in (leads, plain)
    )
    words = [re.findall(r"(?<![A-Z])[XYZBC][-+][\d.]+", re.sub(r"CCA\d+", "", line)) for line in found]
    meant = [re.findall(r"[XYZBC][-+][\d.]+", line) for line in wanted]
    at = next(i for i, line in enumerate(found) if line.startswith("APPR"))
    until = next(i for i, line in enumerate(found) if line.startswith("DEP"))
    moved = [line for i, line in enumerate(words[at : until + ("LCT" in end)]) if line]
    assert moved == [line for line in meant[at:] if line][: len(moved)] and len(moved) > 1
    kept = re.findall(
        r"APPR \w+|DEP \w+|LEN\S+|CCA\d+|R\+?\d+|R[LR]|RND.*|CHF.*|[FM]\d+", "\n".join([begin, *blocks, end])
    )
    assert kept == re.findall(
        r"APPR \w+|DEP \w+|LEN\S+|CCA\d+|R\+?\d+|R[LR]|RND.*|CHF.*|[FM]\d+", "\n".join(found[at : until + 1])
    )
    if "LCT" not in end:  # where the control goes is not known: the next rapid across the plane stays as it is
        assert found[until] == end and found[until + 1] == "L Z-80 FMAX" and words[until + 2] != ["X+250", "Y+200"]


def test_a_tangential_arc_beside_the_contour_is_left_to_the_control(dmu50: Machine, errors: Calibration) -> None:
    text = "3 L X+270 Y+200 RL F200\n4 L Y+220\n5 CT X+290 Y+240\n6 L X+300\n7 L Y+200 R0\n"
    result = compensated(START + text + END, dmu50, errors)
    arc = next(line for line in result.text.splitlines() if " CT " in line)
    straight = compensated(START + text.replace("CT", "L") + END, dmu50, errors).text.splitlines()
    assert arc.replace("CT", "L") in straight and "CT is left to the control" in result.report.to_text()


CORNERS = {
    # name: (blocks, which of the moves behind the start stay whole)
    "a rounding": ("3 L X+270 F500\n4 RND R5 F200\n5 L Y+230\n6 L X+250\n", [True, True, False]),
    "a chamfer after a comment": ("3 L X+270 F500\n4 ; x\n5 CHF 2\n6 L Y+230\n7 L X+250\n", [True, True, False]),
    "a tangential arc": ("3 L X+270 F500\n4 CT X+290 Y+220\n5 L Y+250\n", [True, True, False]),
    "arcs": ("3 CC X+250 Y+220\n4 C X+270 Y+220 DR+ F500\n5 RND R2\n6 L Y+240\n7 L X+250\n", [True, True, False]),
    "two": ("3 L X+270 F500\n4 RND R5\n5 L Y+230\n6 CHF 1\n7 L X+250\n8 L X+240\n", [True, True, True, False]),
    "about the pole": (
        POLE + "4 LP PR+20 PA+0 F500\n5 CP PA+90 DR+\n6 RND R2\n7 LP PA+180\n8 L X+300\n",
        [False, True, True, False],
    ),
}


@pytest.mark.parametrize("name", CORNERS)
def test_blocks_beside_a_corner_stay_whole(dmu50: Machine, errors: Calibration, name: str) -> None:
    """Check that their ends are corrected, and each is one block of the kind it was (``CP`` becomes ``C``)."""
    text, whole = CORNERS[name]
    assert [move.whole for move in moves_of(START + text)[1:]] == whole
    result = compensated(START + text + END, dmu50, errors)
    kept = [line for line in text.splitlines() if not line.endswith("DR-") or "C " not in line]
    statements = [re.sub(r"^\d+ ", "", line) for line in kept if re.match(r"\d+ (?:RND|CHF)", line)]
    found = [re.sub(r"^\d+ ", "", line) for line in result.text.splitlines()]
    assert [line for line in found if line.startswith(("RND", "CHF"))] == statements
    ends = np.array([move.position for move in moves_of(result.text)])
    wanted = [q for q, move in zip(result.commands, result.reading.moves, strict=False) if move.whole]
    assert len(wanted) == sum(whole)
    for q in wanted:
        assert np.abs(ends - q).max(axis=1).min() < 1e-6
    if name == "about the pole":
        pole = next(line for line in reversed(found) if line.startswith("CC"))
        x, y = (float(value) for value in re.findall(r"[XY]([-+.\d]+)", pole))
        arc = found[found.index(pole) + 1]
        assert arc.startswith("C X") and "DR+" in arc and (x, y) == pytest.approx((260, 200), abs=0.2)


def test_a_corner_at_the_end_of_a_stretch(
    dmu50: Machine, errors: Calibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Check that a block before ``RND`` stays whole, read in pieces of any size."""
    source, output = tmp_path / "part.h", tmp_path / "out.h"
    text = START + CORNERS["a chamfer after a comment"][0] + CORNERS["two"][0] + END
    source.write_text(text)
    for size in (7, 40, 61, 100):
        monkeypatch.setattr(parts, "STRETCH_BYTES", size)
        Compensator(dmu50, errors).compensate_file(source, output)
        assert output.read_text() == compensated(text, dmu50, errors).text


@pytest.mark.parametrize("lead", ["PLCT PR+20 PA+180 R5", "PLT PR+20 PA+180 LEN10", "PCT PR+20 PA+180 CCA90 R+4"])
def test_a_lead_in_about_the_pole(dmu50: Machine, errors: Calibration, lead: str) -> None:
    """Check that it ends at the corrected point that the pole, radius and angle mean: 240, 200."""
    text = f"4 L X+220 Y+200 F500\n5 APPR {lead} RL F200\n6 LP PA+120\n7 DEP PLCT PR+40 PA+120 R5\n8 L X+220 Y+200\n"
    result = compensated(START + POLE + text + END, dmu50, errors)
    moves = result.reading.moves
    assert moves[2].position[:2] == pytest.approx((240, 200)) and moves[3].position[:2] == pytest.approx(
        (250, 200 + 10 * math.sqrt(3))
    )
    found = [re.sub(r"^\d+ ", "", line) for line in result.text.splitlines()]
    begin = next(line for line in found if line.startswith("APPR"))
    end = next(line for line in found if line.startswith("DEP"))
    assert begin.split()[1] == lead.split()[0][1:] and end.startswith("DEP LCT X")
    assert not re.search(r"P[RA][+-]", re.sub(";.*", "", result.text))
    x, y = (float(value) for value in re.findall(r" [XY]([-+.\d]+)", begin))
    assert (x, y) == pytest.approx(result.commands[2][:2], abs=1e-6)
