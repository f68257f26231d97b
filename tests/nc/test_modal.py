"""Modal state of ISO programs over random sequences of statements: against the path they were written from, and LinuxCNC's interpreter."""

from __future__ import annotations

from pathlib import Path
from random import Random

import numpy as np
import pytest

from tests.machine.errors import random_calibration
from tests.nc import rs274
from tests.nc.modal_programs import Event, ModalProgram, difference
from tests.nc.nc_support import AXES
from twin.compensation import Compensation, Compensator
from twin.machine.calibration import Calibration
from twin.machine.machine import Machine
from twin.nc import DIALECTS
from twin.nc.blocks import Kind, Move
from twin.nc.iso import cycles

ISO = DIALECTS[0]
PRINTED_MM = 2e-3
"""LinuxCNC's interpreter prints four decimals: up to 1.3 µm of an inch program."""


def as_events(moves: list[Move]) -> list[Event]:
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
    return as_events(list(ISO.moves(ISO.read(text.encode(), "part"), AXES, tcp=False).moves))


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
    found = difference(judged, program.events, PRINTED_MM) or difference(judged, read(program.text), PRINTED_MM)
    assert not found, f"{found}\n{program.text}"
