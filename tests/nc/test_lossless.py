"""Reading and writing an untouched program gives the same bytes."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.nc.nc_support import AXES, apt_program, iso_program, new_positions, plain_program, read_moves
from twin._common.errors import InputError
from twin.nc import dialect_for

ISO = dialect_for(Path("a.nc"))
PLAIN = dialect_for(Path("a.h"))
APT = dialect_for(Path("a.cls"))
ALL = pytest.mark.parametrize("dialect", [ISO, PLAIN, APT], ids=lambda d: d.name)


def check(dialect, text):
    data = text.encode("latin-1")
    program = dialect.read(data, "demo")
    assert program.text.encode("latin-1") == data
    reading = dialect.moves(program, AXES, tcp=False)
    assert dialect.rewrite(program, AXES, reading, new_positions(reading, {})) == text
    return reading


@given(iso_program())
def test_iso(text):
    assert check(ISO, text).moves


@given(plain_program())
def test_plain(text):
    assert check(PLAIN, text).moves


@given(apt_program())
def test_apt(text):
    reading = check(APT, text)
    assert len(reading.moves) == text.count("GOTO") - 1  # one stands in a comment


@ALL
@given(data=st.binary(min_size=1, max_size=300))
def test_any_bytes_survive_reading(dialect, data):
    try:
        program = dialect.read(data, "demo")
    except InputError as error:
        assert error.file == "demo"
    else:
        assert program.text.encode("latin-1") == data


@pytest.mark.parametrize(
    "text",
    [
        "g0 x 1.5 y - 2. z0\r\ng1x.5\ty-.5 f100",
        "G0 X1\rG1 X2\rM30",
        "\xef\xbb\xbfG0 X1\nG1 Y2 (\xe4\xf6\xfc \xc3\xa4)\n",
        "%\n/N10 G0 X1 Y2\nN20 G43.4 H1\nN30 G91 X1 Y1 Z1\n".replace("G91 X1 Y1 Z1", "G90 X1"),
    ],
)
def test_iso_bytes(text):
    assert check(ISO, text).moves


@ALL
@pytest.mark.parametrize("data", [b"", b" \r\n\t\n", b"\xef\xbb\xbf\n"])
def test_empty_program(dialect, data):
    with pytest.raises(InputError, match="empty program"):
        dialect.read(data, "demo")


@ALL
@pytest.mark.parametrize("data", [b"G0 X1\n\0\0\0", bytes(range(1, 32)) * 3])
def test_binary_file(dialect, data):
    with pytest.raises(InputError, match="binary file"):
        dialect.read(data, "demo")


def test_dialects_by_suffix():
    for name in ("a.nc", "a.NGC", "a.tap", "a.mpf", "a.spf", "a.iso", "a.eia", "a.ptp", "a.CNC", "a.gcode", "a.MIN"):
        assert dialect_for(Path(name)).name == "iso"
    assert dialect_for(Path("b.H")).name == "heidenhain"
    assert dialect_for(Path("b.cls")).name == dialect_for(Path("b.apt")).name == "apt"
    with pytest.raises(InputError, match=r"\.mpf.*\.h.*\.cls"):
        dialect_for(Path("a.step"))


def test_moves_of_a_lower_case_block():
    (first, second) = read_moves(ISO, "g0 x 1.5 y - 2. z0 b0 c0\ng1x.5\ty-.5 f100").moves
    assert first.position == (1.5, -2.0, 0.0, 0.0, 0.0)
    assert second.position == (0.5, -0.5, 0.0, 0.0, 0.0)
    assert second.named == {"X", "Y"}
