"""Declarations of a user: axes that the model does not have and stand still, and subprograms that are not given."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.nc.nc_support import AXES
from twin._common.errors import InputError
from twin.compensation import Compensator, Options
from twin.compensation.programs.words import Setup
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import dialect_for, read_program
from twin.nc.blocks import AxisWords, Interpretation

WITH_W = replace(AXES, auxiliary_axes=("W",), harmless=("O9021", "L900", "DRESS", "FIN", "O<PROBE>", "SETUP"))
START = "G0 X1 Y2 Z3 B0 C0 W5\n"
PLAIN_START = "BEGIN PGM A MM\nL X+1 Y+2 Z+3 B+0 C+0 W+5 FMAX\n"


def interpreted(text: str, axes: AxisWords = WITH_W, language: str = "iso") -> Interpretation:
    dialect = dialect_for(Path("a"), None, language)
    return dialect.moves(dialect.read(text.encode("latin-1"), "test"), axes, tcp=False)


STILL = {
    "the same word": "G1 X5 W5\nX6\n",
    "away and back in rapids": "G1 X5\nG0 W0\nX7\nW5.0\nG1 X9\n",
    "an increment of zero": "G1 X5\nG91 G1 Y1 W0\n",
    "increments that return": "G1 X5\nG91 G0 W-5\nW5\nG1 X1\n",
    "its reference before every feed": "G91 G28 W0\nG90 G1 X5\nG91 G28 W0\nG90 G1 X7\n",
    "one place of the machine": "G53 G0 W-3\nG1 X5\nG53 G0 W-3\nG1 X7\n",
    "in a cycle": "G99 G81 X5 Y5 Z-5 R3 W5 F100\nX7 W5\nG80\n",
}
MOVED = {
    "a feed of it alone": ("G1 W6\n", 2, "feed of W"),
    "a feed of it with others": ("G1 X5\nX6 W6\n", 3, "feed of W"),
    "feeds at two places": ("G1 X5\nG0 W0\nG1 X7\n", 4, "feed with W at 0, after feeds with it at 5"),
    "a hole at another place": (
        "G1 X5\nG0 W0\nG99 G81 X5 Y5 Z-5 R3\nG80\n",
        4,
        "feed with W at 0, after feeds with it at 5",
    ),
    "an arc at another place": ("G1 X5\nG0 W0\nG2 X7 I1\n", 4, "feed with W at 0"),
    "its reference": ("G1 X5\nG91 G28 W0\nG90 G1 X7\n", 4, "feed with W at its reference, after feeds with it at 5"),
    "the machine's coordinates": ("G1 X5\nG53 G0 W5\nG1 X7\n", 4, "feed with W at 5 of the machine"),
    "a run of simple blocks": ("G1 X5\nG0 W0\n" + "G1 X7\nX8\n" * 40, 4, "feed with W at 0"),
    "a run that the block with it begins": ("G1 X5\nG0 W0 X6\nG0 X7\n" + "G1 X7\nX8\n" * 40, 5, "feed with W at 0"),
    "an increment": ("G1 X5\nG91 G0 W1\nG1 X1\n", 4, "feed with W at 6"),
    "an unknown value": ("G1 X5\nG0 W#7\n", 3, "the value of W is unknown"),
}


@pytest.mark.parametrize("name", STILL)
def test_an_axis_that_stands_still_in_all_feeds_passes(name: str) -> None:
    reading = interpreted(START + STILL[name])
    assert [one.text for one in reading.notices if one.text.startswith("W is not in the model")]
    without = STILL[name].replace("G91 G28 W0\n", "G91\n").replace("G53 G0 W-3\n", "G0\n")
    for word in (" W5.0", "W5.0", " W-5", " W5", "W5", " W0", "W0"):
        without = without.replace(word, "")
    same = interpreted(START.replace(" W5", "") + without, AXES)
    ends = [(move.kind, move.position) for move in reading.moves]
    assert ends == [(move.kind, move.position) for move in same.moves]


@pytest.mark.parametrize("name", MOVED)
def test_an_axis_that_moves_in_feeds_is_refused(name: str) -> None:
    text, line, what = MOVED[name]
    with pytest.raises(InputError, match=what) as caught:
        interpreted(START + text)
    assert caught.value.line == line
    with pytest.raises(InputError, match=r"unknown axis.*or W named as an auxiliary axis"):
        interpreted(START + text, AXES)


def test_plain_language() -> None:
    reading = interpreted(PLAIN_START + "L X+5 W+5 F100\nL W+0 FMAX\nL W+5 FMAX\nL X+6 F100\n", language="heidenhain")
    assert [move.position[0] for move in reading.moves] == [1.0, 5.0, 6.0]
    for text, what in (("L W+6 F100\n", "feed of W"), ("L X+5 F100\nL W+0 FMAX\nL X+6 F100\n", "feed with W at 0")):
        with pytest.raises(InputError, match=what):
            interpreted(PLAIN_START + text, language="heidenhain")


@given(
    st.lists(st.tuples(st.sampled_from(["G0 W{}", "G1 X{}", "G1 X{} W5", "G0 X{}"]), st.integers(0, 6)), max_size=12)
)
def test_accepted_if_and_only_if_no_feed_sees_another_place(blocks: list[tuple[str, int]]) -> None:
    """The rule in another form: all places in force at feeds are the same."""
    at, fed, legal = 5, set[int](), True
    for form, value in blocks:
        if "W5" in form:
            legal &= at == 5
        if form == "G0 W{}":
            at = value
        if form.startswith("G1"):
            fed.add(at)
    legal &= len(fed) <= 1
    text = START + "".join(f"{form.format(value)}\n" for form, value in blocks)
    try:
        interpreted(text)
    except InputError as error:
        assert not legal and "feed" in error.what
    else:
        assert legal


CALLED = {
    "iso": ("G65 P9021 T5 X7", "G90 G65 P9021", "M98 P9021", "L900", 'CALL "DRESS"', "DRESS(1,2)", "o<probe> call [1]"),
    "heidenhain": ("CALL PGM TNC:\\A\\FIN", "CALL PGM TNC:\\A\\FIN.H", 'CALL PGM "FIN"'),
}


@pytest.mark.parametrize(("language", "call"), [(one, call) for one, calls in CALLED.items() for call in calls])
def test_a_subprogram_named_as_harmless_moves_nothing(language: str, call: str) -> None:
    begin, end = (START, "G1 X6\n") if language == "iso" else (PLAIN_START, "L X+6 F100\n")
    reading = interpreted(f"{begin}{call}\n{end}", language=language)
    assert [move.position for move in reading.moves] == [(1, 2, 3, 0, 0), (6, 2, 3, 0, 0)]
    assert not any(move.unknown for move in reading.moves)
    if "(" in call:
        return  # a name is not certainly a call: nothing is known after it
    assert [one for one in reading.notices if "named as harmless" in one.text]
    with pytest.raises(InputError, match=r"no subprogram .* or .* named as harmless") as caught:
        interpreted(f"{begin}{call}\n{end}", replace(AXES, auxiliary_axes=("W",)), language)
    assert caught.value.line == begin.count("\n") + 1


def test_statements_of_cutter_locations() -> None:
    text = "PARTNO/A\nUNITS/MM\nSETUP/START,1\nGOTO/1,2,3\n"
    assert interpreted(text, language="apt").moves[0].position[:3] == (1, 2, 3)
    assert interpreted(text, AXES, "apt").moves[0].unknown


def test_csys() -> None:
    """One shifted coordinate system of all locations is the work frame; a second one, or a turned one, is not followed."""
    shifted, goto = "CSYS/1,0,0,0,0,1,0,33,0,0,1,0\n", "GOTO/1,2,3\n"
    reading = interpreted(shifted + goto + shifted + goto, language="apt")
    assert [move.position[:3] for move in reading.moves] == [(1, 2, 3)] * 2
    assert "CSYS is shifted" in reading.notices[0].text
    for text in (shifted + goto + shifted.replace("33", "34"), goto + shifted, "CSYS/0,1,0,0,-1,0,0,0,0,0,1,0\n"):
        assert interpreted(text + goto, language="apt").moves[-1].unknown


def test_the_output_keeps_words_and_calls(tmp_path: Path, dmu50: Machine) -> None:
    path = tmp_path / "a.nc"
    path.write_text("O1\nG65 P9021 X3\nG54\nG0 X250 Y225 Z-300 B0 C0 W5\nG1 X260 W5. F100\nM98 P9021\nX270\nM30\n")
    setup = Setup(harmless=("o9021",), auxiliary_axes=("w",))
    result = Compensator(dmu50, Calibration.default(dmu50), Options(setup=setup)).compensate(*read_program(path))
    lines = result.text.split("\n")
    assert {"G65 P9021 X3", "M98 P9021"} <= {*lines} and result.report.complete
    assert [line.count("W5") for line in lines if line.startswith(("G0", "G1"))] == [1, 1]
    with pytest.raises(InputError, match=r"auxiliary axis.*'X'"):
        Compensator(dmu50, Calibration.default(dmu50), Options(setup=Setup(auxiliary_axes=("X",))))
