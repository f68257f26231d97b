"""Drilling cycles, and arithmetic in words. Truth: the strokes written down by hand, as the manuals' figures show them."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.model.errors import random_calibration
from tests.truth.machine import run_iso
from twin._common.errors import InputError
from twin.compensation import Compensation, Compensator
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import DIALECTS
from twin.nc.arithmetic import evaluate
from twin.nc.blocks import AxisWords, Interpretation, Kind, NewPositions

ISO, HEIDENHAIN = DIALECTS[0], DIALECTS[1]
AXES = AxisWords(("X", "Y", "Z"), ("B", "C"), dict.fromkeys("XYZBC", 0.001))
START = "G90 G21 G17\nG0 X300. Y200. Z-300. B0. C0.\n"
HOLE = (310.0, 210.0)
CYCLES = {
    # name: (text, heights after the start, rapid or feed of each)
    "G81 to R": ("G99 G81 X310. Y210. Z-330. R-310. F120.\nG80\n", [-300, -310, -330, -310], "RRFR"),
    "G81 to the initial level": ("G98 G81 X310. Y210. Z-330. R-310. F120.\nG80\n", [-300, -310, -330, -300], "RRFR"),
    "G82": ("G99 G82 X310. Y210. Z-330. R-310. P500 F120.\nG80\n", [-300, -310, -330, -310], "RRFR"),
    "G83": (
        "G99 G83 X310. Y210. Z-330. R-310. Q8. F120.\nG80\n",
        [-300, -310, -318, -310, -317.5, -326, -310, -325.5, -330, -310],
        "RRFRRFRRFR",
    ),
    "G73": (
        "G99 G73 X310. Y210. Z-330. R-310. Q8. F120.\nG80\n",
        [-300, -310, -318, -317.5, -326, -325.5, -330, -310],
        "RRFRFRFR",
    ),
    "G85": ("G98 G85 X310. Y210. Z-330. R-310. F120.\nG80\n", [-300, -310, -330, -310, -300], "RRFFR"),
    "G89": ("G98 G89 X310. Y210. Z-330. R-310. P1 F120.\nG80\n", [-300, -310, -330, -310, -300], "RRFFR"),
    "G84": ("G98 G84 X310. Y210. Z-330. R-310. F1.\nG80\n", [-300, -310, -300], "RRR"),
    "CYCLE81": ("MCALL CYCLE81(-300,-312,2,-330)\nG0 X310. Y210.\nMCALL\n", [-300, -310, -330, -300], "RRFR"),
    "CYCLE82 relative": (
        "MCALL CYCLE82(-300,-312,2,,18,0.5)\nG0 X310. Y210.\nMCALL\n",
        [-300, -310, -330, -300],
        "RRFR",
    ),
    "CYCLE83 out": (
        "MCALL CYCLE83(-300,-312,2,-330,,-320,,0,0,0,1,1)\nG0 X310. Y210.\nMCALL\n",
        [-300, -310, -320, -310, -319.5, -328, -310, -327.5, -330, -300],
        "RRFRRFRRFR",
    ),
    "CYCLE83 chips": (
        "MCALL CYCLE83(-300,-312,2,-330,,-320,,0,0,0,1,0)\nG0 X310. Y210.\nMCALL\n",
        [-300, -310, -320, -319.5, -328, -327.5, -330, -300],
        "RRFRFRFR",
    ),
    "CYCLE85": (
        "MCALL CYCLE85(-300,-312,2,-330,,0,80,200)\nG0 X310. Y210.\nMCALL\n",
        [-300, -310, -330, -310, -300],
        "RRFFR",
    ),
    "CYCLE84": ("MCALL CYCLE84(-300,-312,2,-330,,0,3,5,,1.5)\nG0 X310. Y210.\nMCALL\n", [-300, -310], "RR"),
    "CYCLE86": ("MCALL CYCLE86(-300,-312,2,-330,,0,3,1,1,1,45)\nG0 X310. Y210.\nMCALL\n", [-300, -310], "RR"),
    "CYCLE83 with dwell": (
        "MCALL CYCLE83(-300,-312,2,-330,,-320,,1,.5,0,1,1,3,2,0,0,0)\nG0 X310. Y210.\nMCALL\n",
        [-300, -310],
        "RR",
    ),
    "G82 without dwell": ("G99 G82 X310. Y210. Z-330. R-310. F120.\nG80\n", [-300, -310, -330, -310], "RRFR"),
    "G86": ("G98 G86 X310. Y210. Z-330. R-310. F50.\nG80\n", [-300, -310, -300], "RRR"),
    "G76": ("G98 G76 X310. Y210. Z-330. R-310. Q.1 P500 F50.\nG80\n", [-300, -310, -300], "RRR"),
    "G84.2": ("G98 G84.2 X310. Y210. Z-330. R-310. F1.\nG80\n", [-300, -310, -300], "RRR"),
    "G73 with Q0": ("G98 G73 X310. Y210. Z-330. R-310. Q0 F50.\nG80\n", [-300, -310, -300], "RRR"),
    "G87": ("G99 G87 X310. Y210. Z-310. R-330. Q1. F50.\nG80\n", [-300], "R"),
    "from below R": ("G99 G81 X310. Y210. Z-330. R-290. F50.\nG80\n", [-300, -290, -330, -290], "RRFR"),
    "CYCLE81 once": ("G0 X310. Y210.\nCYCLE81(-300,-312,2,-330)\n", [-300, -310, -330, -300], "RRFR"),
}
KEPT = ("G99 G73", "G99 G74", "G99 G76", "G99 G84", "G99 G86", "G98 G87", "CYCLE83", "CYCLE84", "CYCLE86")
"""Beginnings of the lines with a cycle that is left to the control."""
REFUSED = {
    "no R": ("G81 X310. Y210. Z-330.\n", "R and Z"),
    "no Q": ("G83 X310. Y210. Z-330. R-310.\n", "Q, the depth of a step"),
    "upside down": ("G81 X310. Y210. Z-300. R-310.\n", "Z below R"),
    "from below": ("G81 X310. Y210. Z-330. R-290.\n", "Z is below R"),
    "relative in part": ("G91 G81 X10. Y10. R-10.\n", "R and the depth in the same block"),
    "half a repeat": ("G81 X310. Y210. Z-330. R-310. L1.5\n", "a whole number of holes"),
    "elsewhere without a hole": ("G81 X310. Y210. Z-330. R-310. L0\n", "another place with L0"),
    "back boring in increments": ("G91 G87 X1. Y2. Z-3. R-1. Q1.\n", "G90 and Z at the initial level"),
    "a thread of LinuxCNC": ("G76 P1 X310. Z-330. R-310. I-1. J1. K2.\n", "thread of LinuxCNC"),
    "boring in part": ("G86 X310. Y210. Z-330.\n", "Z and R in the block"),
    "another axis": ("MCALL CYCLE83(-300,-312,2,-330,,-320,,1,0,0,1,1,1)\n", "along the third axis"),
    "unknown": ("MCALL CYCLE83(-300,-312,2,_D,,-320,,0,0,0,1,1)\n", "known values"),
    "pattern without a cycle": ("HOLES1(0,0,0,10,10,5)\n", "canned cycle HOLES1"),
}


@pytest.fixture(scope="module")
def errors(dmu50: Machine) -> Calibration:
    return random_calibration(dmu50, np.random.default_rng(3), size=30.0)


def compensated(text: str, machine: Machine, errors: Calibration) -> Compensation:
    return Compensator(machine, errors).compensate(ISO.read(text.encode(), "part.mpf"), ISO)


@pytest.mark.sample(8)  # of 22
@pytest.mark.parametrize("name", CYCLES)
def test_a_cycle_is_expanded_into_its_strokes(dmu50: Machine, errors: Calibration, name: str) -> None:
    text, heights, kinds = CYCLES[name]
    result = compensated(START + text + "G0 Z-290.\nX300.\n", dmu50, errors)
    moves = result.reading.moves[1:-2]
    assert [move.position[2] for move in moves] == pytest.approx(heights)
    assert {move.position[:2] for move in moves} == {HOLE}
    assert "".join("R" if move.kind is Kind.RAPID else "F" for move in moves) == kinds
    # An interpreter that does not know cycles finds the same strokes in the output, and the compensated commands at their end points.
    plain = "\n".join(line for line in result.text.splitlines() if not line.startswith(KEPT))
    ran = run_iso(plain)
    assert [code for code, _ in ran[1:-2]] == [{"R": "G0", "F": "G1"}[kind] for kind in kinds]
    assert np.array([q for _, q in ran]) == pytest.approx(result.commands, abs=1e-6)
    assert not [line for line in plain.splitlines() if line.startswith(("G8", "MCALL")) and line != "G80"]
    assert result.report.after.max_um < 2.0


def test_the_return_level_may_change_between_holes(dmu50: Machine, errors: Calibration) -> None:
    """G98 in a block with nothing but a place: the tool clears what stands between the holes."""
    text = START + "G99 G81 X310. Y210. Z-330. R-310. F120.\nG98 X320.\nX330.\nG99\nX340.\nG80\nG0 Z-290.\nX300.\n"
    moves = compensated(text, dmu50, errors).reading.moves[1:-2]
    bottoms = [i for i, move in enumerate(moves) if move.position[2] == -330.0]
    assert [moves[i + 1].position[2] for i in bottoms] == [-310.0, -300.0, -300.0, -310.0]


def test_words_between_the_strokes(dmu50: Machine, errors: Calibration) -> None:
    """Dwell at depth, feeds down and up, a thread left to the control at every hole, and no cycle in force behind it."""
    lines = compensated(START + CYCLES["G82"][0], dmu50, errors).text.splitlines()
    assert lines[lines.index("G4 P500") - 1].startswith("G1 ")
    lines = compensated(START + CYCLES["CYCLE85"][0], dmu50, errors).text.splitlines()
    assert [line.split()[-1] for line in lines if "F" in line.split()[-1]] == ["F80", "F200"]
    text = START + "G99 G84 X310. Y210. Z-330. R-310. F1.\nX320.\nG80\nG0 Z-290.\n"
    lines = compensated(text, dmu50, errors).text.splitlines()
    threads = [i for i, line in enumerate(lines) if line.startswith("G99 G84 ")]
    assert len(threads) == 2
    assert all(lines[i + 1].startswith(("G0 ", "G80")) for i in threads)


@pytest.mark.slow
def test_a_dwell_or_a_return_under_a_cycle_is_not_part_of_it(dmu50: Machine, errors: Calibration) -> None:
    """P of G4 is not the dwell of the holes, Z of G28 not their depth, and neither block drills."""
    hole = "G99 G82 X310. Y210. Z-330. R-310. P1 F120.\n"
    for between in ("G4 P2\n", "G4 X3.\n", "G64 P0.01\n", "G5.1 Q1\n"):
        lines = compensated(f"{START}{hole}{between}X320.\nG80\n", dmu50, errors).text.splitlines()
        assert lines.count("G4 P1") == 2 and lines.count(between.strip()) == 1, between
    reading = read(f"{START}{hole}G28 Z-300.\nG80\nG0 Z-290.\n")
    assert [move.position[2] for move in reading.moves] == [-300.0, -300.0, -310.0, -330.0, -310.0, -290.0]
    assert [lost.axes for lost in reading.lost_positions] == [(2,)]


def test_the_depth_of_a_thread_is_corrected(dmu50: Machine, errors: Calibration) -> None:
    """As much as the height above it, which the control has reached when it begins; its other words are kept."""
    text = (
        START + "G98 G84 X310. Y210. Z-330. R-310. P500 F1.\n/X320.\nG99\nG0 X330.\nG74 Z-330. R-310. F2.\nX340. M8\n"
    )
    result = compensated(text, dmu50, errors)
    lines = result.text.splitlines()
    found = [
        re.fullmatch(r"(/?)G99 (G\d+) Z(\S+) R(\S+) (.*)", line) for line in lines if " Z" in line and " R" in line
    ]
    threads = [one.groups() for one in found if one is not None]
    heads, tails = ("", "/", "", ""), ("P500 F1.", "P500 F1.", "F2.", "F2.")
    assert [(skip, code, words) for skip, code, _, _, words in threads] == list(
        zip(heads, ("G84", "G84", "G74", "G74"), tails, strict=True)
    )
    above = [q[2] for move, q in zip(result.reading.moves, result.commands, strict=True) if move.position[2] == -310.0]
    assert [float(top) for _, _, _, top, _ in threads] == pytest.approx(above, abs=1e-6)
    assert all(float(top) - float(depth) == pytest.approx(20.0) for _, _, depth, top, _ in threads)
    assert abs(above[0] + 310.0) > 0.001  # there is something to correct


def test_rigid_tapping_is_stated_before_every_thread(dmu50: Machine, errors: Calibration) -> None:
    """Fanuc refuses a move between M29 and G84, and a motion word ends its effect."""
    one = "G84 X{}. Y210. Z-330. R-310. F1.\n"
    text = f"N9 M29 S500\nG99 {one.format(310)}X320.\nG80\n{one.format(330)}G0 Z-290.\n"
    text += f"M29 S600\n{one.format(310)}G0 X320.\n{one.format(330)}"
    lines = compensated(START + text, dmu50, errors).text.splitlines()
    assert lines[lines.index("(N9 M29 S500)") + 1].startswith("(G99 G84")
    before = [lines[i - 1] for i, line in enumerate(lines) if line.startswith("G99 G84")]
    assert [line if line.startswith("M29") else "" for line in before] == ["M29 S500", "M29 S500", "", "M29 S600", ""]
    assert sum(line.startswith("M29") for line in lines) == 3


@pytest.mark.parametrize("text", ["G84 X310. Z-330. R-310. F1. M29\n", "/M29\n{}", "M29 M8\n{}"])
def test_rigid_tapping_that_cannot_be_moved_is_refused(dmu50: Machine, errors: Calibration, text: str) -> None:
    with pytest.raises(InputError, match="rigid tapping M29") as caught:
        compensated(START + text.format("G84 X310. Z-330. R-310. F1.\n"), dmu50, errors)
    assert caught.value.line == 3


def test_rigid_tapping_stays_as_it_is_without_corrections(dmu50: Machine) -> None:
    text = START + "M29 S500\nG99 G84 X310. Y210. Z-330. R-310. F1.\nX320.\nG80\n"
    assert compensated(text, dmu50, Calibration.zero(dmu50)).text == text


def test_m29_without_a_thread_is_an_unknown_function(dmu50: Machine, errors: Calibration) -> None:
    """Coolant on a real machine, for example; the drilling cycle of the program is written out."""
    text = (
        START
        + "M29 M51 ; coolant\nG81 X310. Y210. Z-330. R-310. F120.\nG80\nM29\nG0 X300.\nG84 X310. Z-330. R-310. F1.\n"
    )
    lines = compensated(text, dmu50, errors).text.splitlines()
    assert "M29 M51 ; coolant" in lines and lines.count("M29") == 1


PLACE = st.tuples(st.integers(260, 340), st.integers(160, 240)).map(lambda at: f"X{at[0]}. Y{at[1]}.")
FANUC_LINES = st.one_of(
    PLACE,
    PLACE,
    st.sampled_from(
        ["G80", "M8", "(a note)", "", "G0 Z-250.", "G1 Z-300. F500.", "G98", "G99", "G4 P1", "G17 G0", "G90"]
    ),
    st.tuples(st.sampled_from(["G0 ", "G1 ", "G0", "G01 ", "N7 G00 "]), PLACE).map("".join),
    st.tuples(st.sampled_from(["G81 ", "G99 G85 ", "G98 G81 "]), PLACE).map(
        lambda one: "".join(one) + " Z-330. R-310. F100."
    ),
    st.lists(PLACE, min_size=14, max_size=18).map("\n".join),
)


def holes(text: str) -> list[tuple[float, float]]:
    """Return where a program of `FANUC_LINES` drills: at every place after a cycle until G80 or a motion word."""
    found, drills = [], False
    for line in text.splitlines():
        if re.search(r"G8[15]", line):
            drills = True
        elif re.search(r"G80|G0?[01]\b|G0?[01](?=X)", line):
            drills = False
        place = re.search(r"X(\S+) Y(\S+)", line)
        if drills and place:
            found.append((float(place[1]), float(place[2])))
    return found


@given(st.lists(FANUC_LINES, min_size=1, max_size=12).map("\n".join))
def test_holes_are_drilled_where_a_cycle_is_in_force(text: str) -> None:
    moves = read(f"{START}{text}\n").moves
    assert [move.position[:2] for move in moves if move.position[2] == -330.0] == holes(text)


THREADS = st.sampled_from(
    [
        "G84 X301. Y201. Z-330. R-310. F1.",
        "G99 G84 X320. Z-330. R-310. F1.",
        "MCALL CYCLE84(-240,-312,2,-330,,0,3,5,,1.5)",
        "MCALL CYCLE81(-240,-312,2,-330)",
        "MCALL",
        "CYCLE81(-240,-312,2,-330)",
        "G2 X300. Y200. R40.",
        "/X300.",
        "B30. C5.",
        "G0 Z-310.",
    ]
)


@example(
    text="G84 X301. Y201. Z-330. R-310. F1.\nG1 Y202.\n" + "".join(f"X{302 + i}.\n" for i in range(14)) + "B33. C168."
)
@settings(max_examples=25)
@given(text=st.lists(st.one_of(FANUC_LINES, THREADS), min_size=1, max_size=10).map("\n".join))
def test_any_program_with_cycles(dmu50: Machine, errors: Calibration, text: str) -> None:
    """Each is compensated, or refused for a reason; `Compensator` itself checks what it has written."""
    try:
        result = compensated(START + text, dmu50, errors)
    except InputError as error:
        assert error.expected
        return
    assert len(result.commands) == len(result.nominal)


def test_a_program_without_errors_keeps_its_cycles(dmu50: Machine) -> None:
    for text, _, _ in CYCLES.values():
        assert compensated(START + text, dmu50, Calibration.zero(dmu50)).text == START + text


IN_PLACE = {name: text for name, (text, _, _) in CYCLES.items()} | {
    "no place with the cycle": "G98 G81 Z-330. R-310. F120.\nX310. Y210.\nX320.\nG80\n",
    "a hole the operator may skip": "G98 G81 X310. Y210. Z-330. R-310. F120.\n/X320.\nX330.\nG80\n",
    "a thread the operator may skip": "G98 G84 X310. Y210. Z-330. R-310. F1.\n/X320.\nX330.\nG80\n",
    "many holes": "G98 G81 X310. Y210. Z-330. R-310. F120.\n" + "".join(f"X{310 + i}.\n" for i in range(20)) + "G80\n",
}


@pytest.mark.parametrize("name", IN_PLACE)
def test_a_cycle_stays_as_it_is_if_only_other_moves_are_replaced(name: str) -> None:
    """Every line but those replaced is the same, and an interpreter finds the same strokes in between."""
    text = f"{START}G1 X301. F500.\nX302.\n{IN_PLACE[name]}G1 Z-290.\nX300. Y200.\n"
    program = ISO.read(text.encode(), "part")
    reading = read(text)
    count, others = len(reading.moves), {1: 0.25, len(reading.moves) - 1: 0.5}
    shifts = {i: np.array([shift, 0.0, 0.0, math.nan, math.nan]) for i, shift in others.items()}
    rows = {i: (np.array([reading.moves[i].position]) + shift, None) for i, shift in shifts.items()}
    written = ISO.rewrite(program, AXES, reading, NewPositions.of(count, 5, rows))
    lines = text.splitlines()
    lines[2], lines[-1] = "G1 X301.25 F500.", "X300.5 Y200."
    assert written.splitlines() == lines
    found = [move.position for move in read(written).moves]
    wanted = [move.position for move in reading.moves]
    wanted[1], wanted[-1] = (301.25, *wanted[1][1:]), (300.5, *wanted[-1][1:])
    assert np.array(found) == pytest.approx(np.array(wanted))


@pytest.mark.sample(6)  # of 19
@pytest.mark.parametrize("name", IN_PLACE)
def test_cycles_are_the_same_from_file_to_file(dmu50: Machine, errors: Calibration, tmp_path: Path, name: str) -> None:
    """A program from file to file is processed in stretches, except for one with cycles, threads included."""
    source, output = tmp_path / "part.mpf", tmp_path / "out.mpf"
    source.write_text(START + IN_PLACE[name] + "G0 Z-290.\nX300.\n")
    Compensator(dmu50, errors).compensate_file(source, output)
    assert output.read_text() == compensated(source.read_text(), dmu50, errors).text


@pytest.mark.parametrize("cycle", ["G85 Z-330.", "G81 Z-330.", "G81 Z-299."])
def test_a_way_back_from_below_r_is_refused_of_a_control_that_may_be_a_fanuc(cycle: str) -> None:
    with pytest.raises(InputError, match="Z is below R"):
        read(f"O1\nG21 G90 G0 X1 Y2 Z-300.\n{cycle} X310. Y210. R-290. F50.\n")


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_expanded_is_refused(dmu50: Machine, name: str) -> None:
    text, words = REFUSED[name]
    with pytest.raises(InputError, match=words) as caught:
        compensated(START + text, dmu50, Calibration.zero(dmu50))
    assert caught.value.line == 3


@pytest.mark.parametrize("mode", ["G18", "G91"])
@pytest.mark.parametrize("places", [1, 20])
def test_a_mode_that_changes_under_a_cycle_is_refused(mode: str, places: int) -> None:
    with pytest.raises(InputError, match="canned cycle") as caught:
        read(f"{START}G99 G81 X310. Y210. Z-330. R-310.\nX311.\n{mode}\n" + "X320.\n" * places)
    assert caught.value.line == 6


VALUES = {"#1": 3.0, "#<X>": 5.0, "R1": 2.0, "_D": -4.0}
FORMULAS = [
    ("#1+2*R1", 7.0),
    ("[#1+2]*R1", 10.0),
    ("-[#1]", -3.0),
    ("(R1+1)*(_D-1)", -15.0),
    ("ATAN[1]/[-1]", 135.0),
    ("ATAN2(-1,1)", -45.0),
    ("2**3**1", 8.0),
    ("7 MOD 4", 3.0),
    ("7 DIV 2", 3.0),
    ("#<x>/2", 2.5),
    ("SQRT[16]+ABS[_D]", 8.0),
    ("ROUND[2.5]", 3.0),
    ("COS(60)*4", 2.0),
]
UNKNOWN = [
    "R9+1",
    "1/0",
    "FIX[-1.2]",
    "-7 MOD 4",
    "5+",
    "SQRT[-1]",
    "(1",
    "1 2",
    "#0",
    "ASIN(2)",
    "ATAN[-1]/[1]",
    "10**99",
]


@pytest.mark.parametrize(("text", "value"), FORMULAS)
def test_arithmetic(text: str, value: float) -> None:
    assert evaluate(text, VALUES) == pytest.approx(value)


@pytest.mark.parametrize("text", UNKNOWN)
def test_what_controls_disagree_about_is_unknown(text: str) -> None:
    assert math.isnan(evaluate(text, VALUES)) or abs(evaluate(text, VALUES)) > 1e9


@given(
    st.recursive(
        st.integers(1, 20).map(str),
        lambda inner: st.tuples(inner, st.sampled_from("+-*/"), inner).map(lambda t: f"({''.join(t)})"),
        max_leaves=12,
    )
)
def test_arithmetic_is_that_of_python(text: str) -> None:
    try:
        wanted = eval(text)  # only digits, signs and brackets
    except ZeroDivisionError:
        assert math.isnan(evaluate(text, {}))
        return
    assert evaluate(text, {}) == pytest.approx(wanted)


def read(text: str, dialect_of: int = 0) -> Interpretation:
    dialect = DIALECTS[dialect_of]
    return dialect.moves(dialect.read(text.encode(), "part"), AXES, tcp=False)


def test_words_with_arithmetic() -> None:
    text = (
        "R1=5 R2=R1*2+1\nG0 X=R1 Y=(R1+2)*3 Z=R2-1\nG1 X=IC(R1/2) F=R2\n#1=3\n#2=[#1+1]*2\nX#2 Y[#1*2] Z-[#1]\n"
        "DEF REAL A=5\nX=A+1\n"
    )
    assert [move.position[:3] for move in read(text).moves] == [(5, 21, 10), (7.5, 21, 10), (8, 6, -3), (6, 6, -3)]
    text = (
        "BEGIN PGM A MM\nQ1 = 5,5\nFN 1: Q2 = +Q1 + +4\nQ3 = (Q1 + 0,5) * SIN 30\nFN 4: Q4 = +7 DIV +2\n"
        "L X+Q1 Y+Q2 Z-Q3 F100\nL X+Q4\n"
    )
    found = [move.position[:3] for move in read(text, 1).moves]
    assert np.array(found) == pytest.approx(np.array([(5.5, 9.5, -3.0), (3.5, 9.5, -3.0)]))


def test_a_word_with_arithmetic_is_replaced_as_a_whole(dmu50: Machine, errors: Calibration) -> None:
    text = "G90 G21\nR1=300\nG0 X=R1+10 Y=(R1-100) Z=-R1 B0 C0\n#5=20\nG1 X[#5*16] F100\n"
    result = compensated(text, dmu50, errors)
    ran = np.array([q for _, q in run_iso(result.text.replace("=", ""))])
    assert ran == pytest.approx(result.commands, abs=1e-6)
    assert result.nominal[:, 0] == pytest.approx([310.0, 320.0])


def test_a_program_that_sets_a_work_offset_is_refused() -> None:
    with pytest.raises(InputError, match="sets a work offset") as caught:
        read("G0 X1 Y1 Z1\n#5221=10\n")
    assert caught.value.line == 2


@pytest.mark.parametrize("level", ["G98", "G99"])
def test_back_boring_has_its_heights_shifted_by_the_correction_of_the_initial_level(
    dmu50: Machine, errors: Calibration, level: str
) -> None:
    text = compensated(f"{START}{level} G87 X310. Y210. Z-310. R-330. Q1. F50.\nX320.\nG80\n", dmu50, errors).text
    lines = text.splitlines()
    kept = [i for i, line in enumerate(lines) if line.startswith("G98 G87")]
    assert len(kept) == 2
    for i in kept:
        before = " ".join(line for line in lines[:i] if not line.startswith(("(", "G98 G87"))).split()
        reached = [float(word[1:]) for word in before if word.startswith("Z")][-1]
        assert 1e-3 < abs(reached + 300.0) < 0.2
        z, r = (float(word[1:]) for word in lines[i].split() if word[0] in "ZR")
        assert (z, r) == pytest.approx((reached - 10.0, reached - 30.0), abs=1e-9)
