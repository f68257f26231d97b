"""Modal state over random sequences of statements: against the path they were written from, and LinuxCNC's interpreter."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from random import Random

import numpy as np
import pytest

from tests.model.errors import random_calibration
from tests.nc import rs274
from tests.nc.modal_programs import Event, ModalProgram, difference
from tests.nc.nc_support import AXES
from tests.nc.other_programs import CutterLocations, PlainProgram
from twin._common.errors import InputError
from twin.compensation import Compensation, Compensator
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import DIALECTS
from twin.nc.blocks import Kind, Move
from twin.nc.iso import cycles

ISO, HEIDENHAIN, APT = DIALECTS
ANY_TOOL = replace(AXES, one_tool=False)
"""The programs select several tools and lengths: positions of words do not depend on them."""
EQUAL_MM = 1e-6
INCH_WORD_MM = 1.3e-4
"""Half of the last decimal of a length that is written in an inch program."""


def as_events(moves: Iterable[Move]) -> list[Event]:
    """Return the moves of a reading as events."""
    found = []
    for move in moves:
        if move.arc is None:
            found.append(Event(0 if move.kind is Kind.RAPID else 1, move.position))
        else:
            sweep = move.arc.angle_rad
            found.append(Event(3 if sweep > 0 else 2, move.position, move.arc.plane[:2], move.arc.centre_mm, sweep))
    return found


def read(text: str) -> list[Event]:
    return as_events(ISO.moves(ISO.read(text.encode(), "part"), ANY_TOOL, tcp=False).moves)


@pytest.mark.parametrize("seed", range(80))
def test_a_program_is_read_as_it_was_meant(seed: int) -> None:
    program = ModalProgram(Random(seed)).grow(30)
    found = difference(read(program.text), program.events, 1e-6)
    assert not found, f"{found}\n{program.text}"


@rs274.needed
@pytest.mark.parametrize("seed", range(40))
def test_a_program_is_read_as_linuxcnc_reads_it(seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cycles, "CLEARANCE_MM", rs274.PECK_MM)
    program = ModalProgram(Random(1000 + seed), "linuxcnc", rs274.PECK_MM).grow(30)
    judged = rs274.events(program.text, tmp_path)
    found = difference(judged, program.events, EQUAL_MM) or difference(judged, read(program.text), EQUAL_MM)
    assert not found, f"{found}\n{program.text}"


@pytest.mark.parametrize("seed", range(60))
def test_plain_language_is_read_as_it_was_meant(seed: int) -> None:
    program = PlainProgram(Random(seed)).grow(30)
    moves = HEIDENHAIN.moves(HEIDENHAIN.read(program.text.encode(), "part"), ANY_TOOL, tcp=False).moves
    found = difference(as_events(moves), program.events, 1e-6)
    assert not found, f"{found}\n{program.text}"


@pytest.mark.parametrize("seed", range(30))
def test_cutter_locations_are_read_as_they_were_meant(seed: int) -> None:
    program = CutterLocations(Random(seed)).grow(30)
    moves = APT.moves(APT.read(program.text.encode(), "part"), AXES, tcp=True).moves
    assert [move.kind is Kind.RAPID for move in moves] == program.rapid, program.text
    assert np.array([move.position[:3] for move in moves]) == pytest.approx(np.array(program.points), abs=1e-9)
    assert np.array([move.vector for move in moves]) == pytest.approx(np.array(program.vectors), abs=1e-8)


@pytest.fixture(scope="module")
def errors(dmu50: Machine) -> Calibration:
    return random_calibration(dmu50, np.random.default_rng(3), size=30.0)


def compensated(text: str, machine: Machine, errors: Calibration) -> Compensation:
    return Compensator(machine, errors).compensate(ISO.read(text.encode(), "part.ngc"), ISO)


@pytest.mark.sample(1)  # of 4
@rs274.needed
@pytest.mark.parametrize("seed", range(4))
def test_linuxcnc_goes_where_the_output_was_meant_to(
    dmu50: Machine, errors: Calibration, seed: int, tmp_path: Path
) -> None:
    """Every block end of the compensated program, cycles written out and arcs in chords."""
    program = ModalProgram(Random(2000 + seed), "linuxcnc").grow(20)
    result = compensated(program.text, dmu50, errors)
    assert len(result.commands) > len(program.events)
    meant = [Event(-1, tuple(row)) for row in result.commands.tolist()]
    judged = [event._replace(code=-1) for event in rs274.events(result.text, tmp_path)]
    assert not difference(judged, meant, INCH_WORD_MM), result.text


def test_the_same_word_twice_stays_one_meaning(dmu50: Machine, errors: Calibration) -> None:
    """Controls differ in whether they allow it; an arc becomes chords, so both its words change."""
    once = "G90 G21 G17\nG0 X200. Y200. Z-200. B5. C0.\nG3 X210. Y210. J10. F500\nG99 G81 X220. Z-220. R-205.\nG80\n"
    twice = once.replace("G90", "G90 G90").replace("G3", "G3 G03").replace("G81", "G81 G81")
    assert read(twice) == read(once)
    texts = [compensated(text, dmu50, errors).text for text in (once, twice)]
    assert read(texts[0]) == read(texts[1])


LENGTHS = ["T1 M6", "T2 M6", "G43 H1", "G43 H2", "G43", "G49", "G43.1 Z5", "G43.2 H1"]
OFFSETS = ["G54", "G55", "G92 X3 Z4", "G92.1", "G92.3", "G52 X2 Y1", "G10 L2 P1 Z7", "G10 L20 P1 X0", "G10 L1 P1 Z9"]


@rs274.needed
@pytest.mark.parametrize("seed", range(4))
def test_an_incremental_word_after_another_length_or_offset(tmp_path: Path, seed: int) -> None:
    """Every position read after such a change is that of LinuxCNC, with or without tables; others are refused."""
    tools = "T1 P1 Z1.5\nT2 P2 Z2.5\n"
    rng, read, refused = Random(4600 + seed), 0, 0
    for _ in range(15):
        lines = ["G90 G21 G54", f"{rng.choice(['', 'T1 M6', 'T1 M6 G43 H1'])} G0 X100 Y100 Z-100 B10 C20"]
        for _ in range(rng.choice([1, 1, 2, 4])):
            lines += rng.sample([*LENGTHS, *OFFSETS], rng.choice([0, 1, 1]))
            axes = sorted(rng.sample("XYZBC", rng.choice([1, 2, 3])))
            mode = rng.choice(["G90 ", "G91 ", "G91 "])
            lines.append(f"{mode}G1 {' '.join(f'{axis}{rng.uniform(5, 9):.2f}' for axis in axes)} F500")
        text = "\n".join([*lines, "M2", ""])
        judged = rs274.events(text, tmp_path, tools=tools)
        for known in (False, True):
            axes_of = replace(AXES, tools_known=known, offsets_known=known)
            try:
                moves = ISO.moves(ISO.read(text.encode(), "t"), axes_of, tcp=False).moves
            except InputError as error:
                assert error.line is not None
                refused += 1
                continue
            assert len(moves) == len(judged)
            for move, event in zip(moves, judged, strict=True):
                there = [i for i, value in enumerate(move.position) if value == value]
                assert [move.position[i] for i in there] == pytest.approx([event.end[i] for i in there], abs=1e-6), text
                read += len(there)
    assert read > 20 and refused


@rs274.needed
@pytest.mark.parametrize("seed", range(6))
def test_increments_of_zero_after_a_reference_move_nothing(tmp_path: Path, seed: int) -> None:
    """Other axes are where LinuxCNC has them; those at the reference are unknown until an absolute word, but not refused."""
    rng, unknown = Random(5000 + seed), 0
    lines = ["G90 G21 G17 G94", "G0 X10 Y20 Z30 B10 C20"]
    for _ in range(6):
        gone = rng.sample("XYZBC", rng.randint(1, 4))
        lines.append(f"G91 G28 {' '.join(f'{name}0' for name in gone)}")
        for _ in range(3):
            words = [f"{name}{0 if name in gone else rng.randint(-9, 9)}" for name in "XYZBC" if rng.random() < 0.8]
            lines.append(" ".join([rng.choice(["G0", "G1 F100"]), *words]))
        lines += ["G90", f"G0 {' '.join(f'{name}{rng.randint(1, 50)}' for name in gone)}"]
    text = "\n".join([*lines, "M2", ""])
    ends = {tuple(event.end) for event in rs274.events(text, tmp_path)}
    for move in read(text):
        unknown += any(value != value for value in move.end)
        assert any(all(a != a or abs(a - b) < 1e-6 for a, b in zip(move.end, end, strict=True)) for end in ends)
    assert unknown >= 6
