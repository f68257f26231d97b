"""Feed, spindle speed and dwell of every line, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tests.nc.nc_support import AXES
from twin._common.bundled import find_program
from twin._common.errors import InputError
from twin.nc import DIALECTS, read_program
from twin.nc.dialect import FeedUnit, LineWords, Technology

NAN = float("nan")
OF = {dialect.name: dialect for dialect in DIALECTS}


def carried(name: str, text: str) -> Technology:
    dialect = OF[name]
    return dialect.technology(dialect.read(text.encode(), "part"))


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("iso", "G01X10Y3F300S5000M03", LineWords(feed=300.0, speed_rpm=5000.0, turning=True)),
        ("iso", "N10 G1 X10 F=1500 S1=8000 M1=3", LineWords(feed=1500.0, speed_rpm=8000.0, turning=True)),
        ("iso", "(S500) G1 X1 F.5 ; F3", LineWords(feed=0.5)),
        ("iso", 'MSG("S100") G95 F0.2 M30', LineWords(feed=0.2, unit=FeedUnit.TURN, off_after=True)),
        ("iso", "G20 G93 F4", LineWords(feed=4.0, unit=FeedUnit.INVERSE, inch=True)),
        ("iso", "N180 SUPA G0 Z=_Z_HOME D0", LineWords()),
        ("iso", "SPOS=90 M5", LineWords(off_after=True)),
        ("iso", "G4 F2.5", LineWords(dwell_s=2.5)),
        ("iso", "G04 P1500", LineWords(dwell_s=1.5)),
        ("iso", "G4 P1.5", LineWords(dwell_s=1.5)),
        ("iso", "G4 X12", LineWords(dwell_s=12.0)),
        ("heidenhain", "5 TOOL CALL 5 Z S8000 DL+0,1", LineWords(speed_rpm=8000.0)),
        ("heidenhain", '5 TOOL CALL "S20" Z S900', LineWords(speed_rpm=900.0)),
        ("heidenhain", "6 L X+1,5 R0 FMAX M13", LineWords(turning=True)),
        ("heidenhain", "6 L X+1,5 R0 F1250 M5", LineWords(feed=1250.0, off_after=True)),
        ("heidenhain", "7 L X1 FU0,1", LineWords(feed=0.1, unit=FeedUnit.TURN)),
        ("heidenhain", "8 CYCL DEF 9.1 V.ZEIT 2,5", LineWords(dwell_s=2.5)),
        ("heidenhain", "0 BEGIN PGM PART INCH", LineWords(inch=True)),
        ("heidenhain", "0 BEGIN PGM PART IN", LineWords(inch=True)),
        ("heidenhain", "N10 L Z-45. F1000. S6000", LineWords(feed=1000.0, speed_rpm=6000.0)),
        ("heidenhain", "M128. F10000.", LineWords(feed=10000.0)),
        ("heidenhain", "X+5 S500. M3.", LineWords(speed_rpm=500.0, turning=True)),
        ("heidenhain", "LBL 5 ; L S500", LineWords()),
        ("apt", "SPINDL/RPM,6000,CLW", LineWords(speed_rpm=6000.0, turning=True)),
        ("apt", "SPINDL/OFF", LineWords(turning=False)),
        ("apt", "FEDRAT/ 800.0,MMPM", LineWords(feed=800.0, unit=FeedUnit.MINUTE, metric=True)),
        ("apt", "FEDRAT/10,IPM", LineWords(feed=254.0, unit=FeedUnit.MINUTE, metric=True)),
        ("apt", "DELAY/2.5", LineWords(dwell_s=2.5)),
        ("apt", "GOTO/1,2,3", LineWords()),
    ],
)
def test_a_line(name: str, text: str, expected: LineWords) -> None:
    assert OF[name].line_words(text + "\n") == expected


@pytest.mark.parametrize(
    ("name", "text"),
    [("iso", "G1 X1 F#100"), ("iso", "F=R1*2"), ("heidenhain", "L X1 F AUTO"), ("heidenhain", "L X1 F Q5")],
)
def test_a_feed_that_is_not_a_number_is_unknown(name: str, text: str) -> None:
    assert np.isnan(OF[name].line_words(text).feed or 0.0)


def test_words_hold_for_the_following_lines() -> None:
    found = carried("iso", "G21 S3000\nM3\nG1 X1 F100\nX2\nM5 X3\nX4\nG20 F10\nG95\nF.1\nG4 P2000\nM4 S10\n")
    np.testing.assert_array_equal(found.speed_rpm, [0, 3000, 3000, 3000, 3000, 0, 0, 0, 0, 0, 10])
    np.testing.assert_allclose(found.feed, [NAN, NAN, 100, 100, 100, 100, 254, NAN, 2.54, 2.54, 2.54])
    assert list(found.unit) == [FeedUnit.MINUTE] * 7 + [FeedUnit.TURN] * 4
    assert found.dwell_s.sum() == 2.0


def test_a_program_that_never_switches_the_spindle_was_called_with_it_on() -> None:
    np.testing.assert_array_equal(carried("iso", "G1 X1\nS500\nX2\n").speed_rpm, [0, 500, 500])


@pytest.mark.parametrize("text", ["G1 X1\nG96 S200 M3\n", "X1\nS#5 M3\n", "X1\nG4 F=R1\n"])
def test_what_has_no_number_is_refused_with_its_line(text: str) -> None:
    with pytest.raises(InputError, match="part:2: the "):
        carried("iso", text)


def test_the_three_sample_programs_agree() -> None:
    """The same part in three languages: 6,000 1/min and 800 mm/min on every feed move."""
    for name in ("cone_frustum.nc", "cone_frustum.h", "cone_frustum.cls"):
        program, dialect = read_program(find_program(name))
        found = dialect.technology(program)
        cutting = [move.line for move in dialect.moves(program, AXES, tcp=False).moves if move.kind.value == "linear"]
        assert set(found.speed_rpm[cutting]) == {6000.0} and set(found.feed[cutting]) == {800.0}
