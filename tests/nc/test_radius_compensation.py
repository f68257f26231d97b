"""Cutter radius compensation stays with the control. Truth: centres by hand, and the path that LinuxCNC computes from the output."""

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
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import DIALECTS
from twin.nc.arcs import PLANES, arc_by_centre, moved_centre
from twin.nc.blocks import Arc

ISO = DIALECTS[0]
START = "G90 G21 G17 G40\nG0 X250. Y150. Z-300. B0. C0.\nF500\n"
CONTOUR = (
    "G41 D1\nG1 X260. Y160.\nY200.\nG2 X270. Y210. I10. J0.\nG1 X300.\nG2 X310. Y200. R10.\nG3 X320. Y190. I10.\nG1 X330.\n"
    "Y160.\nX260.\nG40 X250. Y150.\nG0 Z-290.\nX251.\n"
)
INCREMENTS = (
    "G42 D1 G1 X260. Y140.\nG91 X40.\nG3 X10. Y10. J10.\nG3 X-10. Y10. I=AC(300.) J0.\nG90 G1 X260. Y160.\n"
    "G40 G1 X250. Y150.\n"
)
CIRCLE = "G41 D1\nG1 X260. Y150.\nG3 I-10.\nG40 G1 X250. Y150.\n"


@pytest.fixture(scope="module")
def errors(dmu50: Machine) -> Calibration:
    return random_calibration(dmu50, np.random.default_rng(5), size=120.0)


def compensated(text: str, machine: Machine, errors: Calibration, tolerance_mm: float = 1e-3) -> Compensation:
    options = Options(tolerance_mm=tolerance_mm)
    return Compensator(machine, errors, options).compensate(ISO.read(text.encode(), "part.mpf"), ISO)


def arcs_of(text: str) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return start, end and centre of every arc about a centre in G17, by a reader of words of its own."""
    at, code, relative, found = {"X": 0.0, "Y": 0.0}, 0, False, list[tuple[np.ndarray, np.ndarray, np.ndarray]]()
    for line in text.splitlines():
        line = re.sub(r"=AC\(([-+.\d]+)\)", r"@\1", line)
        line = re.sub(r"\(.*?\)", "", line)
        words = re.findall(r"([GXYIJR])(@?[-+]?[\d.]+)", line)
        for letter, value in words:
            if letter == "G":
                relative = {"90": False, "91": True}.get(value, relative)
                code = int(value) if value in "0123" else code
        values = {letter: value for letter, value in words if letter != "G"}
        start = np.array([at["X"], at["Y"]])
        for axis in set(values) & {"X", "Y"}:
            at[axis] = float(values[axis]) + (at[axis] if relative else 0.0)
        end = np.array([at["X"], at["Y"]])
        if code >= 2 and set(values) & {"I", "J"}:
            texts = [values.get(letter, "0") for letter in "IJ"]
            centre = [float(text.strip("@")) + (0.0 if "@" in text else start[i]) for i, text in enumerate(texts)]
            found.append((start, end, np.array(centre)))
    return found


@pytest.mark.parametrize("text", [CONTOUR, INCREMENTS, CIRCLE])
def test_ends_and_centres_are_corrected_alike(dmu50: Machine, errors: Calibration, text: str) -> None:
    """Compare every arc before and after: an arc about a centre has the same radius at both ends, and is shifted as its ends are."""
    result = compensated(START + text, dmu50, errors)
    before, after = arcs_of(START + text), arcs_of(result.text)
    assert len(before) == len(after) > 0
    for old, new in zip(before, after, strict=True):
        shift = [b - a for a, b in zip(old, new, strict=True)]
        assert np.abs(shift[2] - 0.5 * (shift[0] + shift[1])).max() < 0.003
        assert np.linalg.norm(new[0] - new[2]) == pytest.approx(np.linalg.norm(new[1] - new[2]), abs=0.002)
        assert np.abs(shift[0]).max() > 0.01
    ends = [move.position for move in ISO.moves(ISO.read(result.text.encode(), "p"), AXES, tcp=False).moves]
    assert np.array(ends) == pytest.approx(result.commands, abs=1e-6)


def test_no_block_is_split_and_what_remains_is_reported(dmu50: Machine, errors: Calibration) -> None:
    result = compensated(START + CONTOUR, dmu50, errors, tolerance_mm=1e-5)
    assert len(result.commands) == len(result.reading.moves)
    assert "between end points above the tolerance, with 1 pieces per block" in result.report.to_text()
    assert "along a block, is not corrected" in result.reading.notices[-1].text
    plain = compensated(START + CONTOUR.replace("G41 D1\n", ""), dmu50, errors, tolerance_mm=1e-5)
    assert len(plain.commands) > 2 * len(plain.reading.moves)


@pytest.mark.parametrize("text", [CONTOUR, INCREMENTS, CIRCLE])
def test_without_corrections_every_byte_stays(dmu50: Machine, text: str) -> None:
    assert compensated(START + text, dmu50, Calibration.zero(dmu50)).text == START + text


@rs274.needed
@pytest.mark.parametrize("text", [CONTOUR, CIRCLE])
def test_linuxcnc_follows_the_corrected_contour(dmu50: Machine, errors: Calibration, tmp_path: Path, text: str) -> None:
    """Compare the tool paths that LinuxCNC computes, with its own offsets of the radius, from the original and the output."""
    tools = "T1 P1 D6\n"
    original = START + text + "M2\n"
    result = compensated(original, dmu50, errors)
    before, after = (rs274.events(one, tmp_path, tools) for one in (original, result.text))
    assert [event.code for event in before] == [event.code for event in after] and len(before) >= 4
    shift = np.array(
        [[b - a for a, b in zip(x.end[:3], y.end[:3], strict=True)] for x, y in zip(before, after, strict=True)]
    )
    # The correction of the programmed points nearby, within what it changes over the radius and the printed digits.
    nominal, wanted = result.nominal[:, :3], (result.commands - result.nominal)[:, :3]
    for event, moved in zip(before, shift, strict=True):
        nearest = np.argsort(np.linalg.norm(nominal - event.end[:3], axis=1))[:2]
        assert np.abs(wanted[nearest] - moved).min(axis=0).max() < 0.003


def test_the_centre_of_a_moved_arc() -> None:
    arc = arc_by_centre(PLANES[17], (0.0, 0.0), (10.0, 10.0), (10.0, 0.0), clockwise=True)
    assert isinstance(arc, Arc)
    assert moved_centre(arc, (10.0, 10.0), (0.5, 0.25), (10.5, 10.25)) == pytest.approx((10.5, 0.25))
    x, y = moved_centre(arc, (10.0, 10.0), (0.0, 0.0), (10.02, 10.0))
    assert np.hypot(x, y) == pytest.approx(np.hypot(x - 10.02, y - 10.0))
    assert (x, y) == pytest.approx((10.01, 0.0), abs=0.02)


REFUSED = {
    "under tool centre point control": ("G43.4 H1\nG0 X0. Y0. Z0.\nG41 D1\nG1 X5.\n", "tool that turns"),
    "turning": ("G41 D1\nG1 X260. C5.\n", "tool that turns"),
    "in a cycle": ("G41 D1\nG81 X260. Z-310. R-305.\n", "in a cycle"),
    "at a reference return": ("G41 D1\nG1 X260.\nG28 Z0\n", "G40 before it"),
    "in machine coordinates": ("G41 D1\nG1 X260.\nG53 G0 Z0\n", "G40 before it"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused(name: str) -> None:
    text, words = REFUSED[name]
    with pytest.raises(InputError, match=words):
        ISO.moves(ISO.read((START + text).encode(), "part"), AXES, tcp=False)


def test_roundings_and_chamfers_stay_with_the_contour(dmu50: Machine, errors: Calibration) -> None:
    """The output is that of the program without them, with the words behind their blocks."""
    text = (
        CONTOUR.replace("\nY200.\n", "\nY200. RND=2.\n")
        .replace("G1 X330.\n", "G1 X330. CHF=1.5\n")
        .replace("Y160.\nX260", "Y160. CHR=1\nX260")
    )
    words = re.compile(r" (?:RND=2\.|CHF=1\.5|CHR=1)")
    result = compensated(START + text, dmu50, errors)
    assert len(words.findall(result.text)) == 3
    assert words.sub("", result.text) == compensated(START + CONTOUR, dmu50, errors).text
    assert "RND is left to the control" in result.report.to_text()


def test_centres_are_written_as_the_program_writes_them(dmu50: Machine, errors: Calibration) -> None:
    """I, J from the centre to the start: the output is the usual program's, with these words turned."""
    turned = re.compile(r"([IJ])(-?)(?=\d)")
    usual = (
        "G41 D1\nG1 X260. Y160.\nY200.\nG2 X270. Y210. I10. J0.\nG1 X300.\nG2 X310. Y200. J-10.\nG40 G1 X250. Y150.\n"
    )

    def turn(text: str) -> str:
        return turned.sub(lambda match: match[1] + ("" if match[2] else "-"), text)

    before = compensated(START + usual, dmu50, errors).text
    after = compensated(START + turn(usual), dmu50, errors).text
    assert "I" in before and after.splitlines()[-8:] == turn(before).splitlines()[-8:]
    assert arcs_of(before)[0][2] != pytest.approx(arcs_of(START + usual)[0][2], abs=0.005)
