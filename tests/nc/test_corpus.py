"""Programs in the manner of postprocessors, compensated; the original and the output are executed by an interpreter of its own.

`corpus` holds the programs, written for these tests. Each states below how many block ends it has on known positions and where the last
feed ends, computed by hand for programs without tool centre point control and planes.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.nc.corpus_machine import LENGTHS, OFFSETS, run_iso, run_plain
from tests.truth.machine import TruthMachine
from twin.compensation import Compensation, Compensator, Options
from twin.compensation.programs.check import check_program
from twin.compensation.programs.words import Setup
from twin.controls.offsets import OffsetTable, ToolTable
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import read_program

CORPUS = Path(__file__).parent / "corpus"
PROGRAMS = sorted(CORPUS.iterdir())
SETUP = Setup(
    offsets=OffsetTable(Path("o.csv"), {name: dict(zip("XYZ", row, strict=True)) for name, row in OFFSETS.items()}),
    tools=ToolTable(Path("t.csv"), LENGTHS),
)
BETWEEN = 400
"""Most blocks of the output between two ends of the original that are compared."""
ROUNDING_UM = 1.2
LAST_FEED = {
    "haas_facing.nc": (250 + 40, 225 + 30, -390 + 131.5 + 12),
    "mill_begins_in_increments.nc": (250 - 20, 225 + 15, -390 + 80 + 50),
    "tnc_facing.h": (250 - 52.5, 225 - 10, -390 + 80 + 22),
    "tnc_contour.h": (250 - 60, 225 - 45, -390 + 80 + 15),
}
CONTROLS = {
    "mazak": "Fanuc",
    "haas": "Fanuc",
    "fanuc": "Fanuc",
    "linuxcnc": "",  # no word that other controls do not have
    "mill": "Fanuc",
    "okuma": "Okuma",
    "sinumerik": "SINUMERIK",
    "tnc": "HEIDENHAIN",
}


@pytest.fixture(scope="module")
def errors(dmu50: Machine) -> Calibration:
    return Calibration.default(dmu50)


def compensated(path: Path, machine: Machine, errors: Calibration) -> Compensation:
    read, dialect = read_program(path)
    return Compensator(machine, errors, Options(setup=SETUP)).compensate(read, dialect)


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.name)
def test_the_output_leads_the_real_machine_where_the_program_means(
    dmu50: Machine, errors: Calibration, path: Path
) -> None:
    run = run_plain if path.suffix == ".h" else run_iso
    text = path.read_text()
    result = compensated(path, dmu50, errors)
    meant, done = run(text).ends, run(result.text).ends
    assert len(meant) > 5
    at = 0
    for position, cutting, length in meant:
        assert errors.path is not None
        truth = TruthMachine(errors.path, length)
        near = np.array([place for place, _, _ in done[at : at + BETWEEN]])
        off_um, _ = truth.deviations(near, np.repeat(position[None], len(near), axis=0))
        reached = np.flatnonzero((off_um < ROUNDING_UM) & (np.abs(near[:, 3:] - position[3:]).max(axis=1) < 0.2))
        assert reached.size, f"{position} {cutting}: {off_um.min():.2f} µm"
        at += int(reached[0])
    assert at >= len(done) - 2
    before, _ = truth.deviations(np.array([row[0] for row in meant]), np.array([row[0] for row in meant]))
    assert before.max() > 20.0
    if path.name in LAST_FEED:
        feeds = [place for place, cutting, _ in meant if cutting]
        assert feeds[-1][:3] == pytest.approx(LAST_FEED[path.name], abs=1e-9)


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.name)
def test_without_errors_every_byte_stays(dmu50: Machine, path: Path) -> None:
    result = compensated(path, dmu50, Calibration.zero(dmu50))
    read, _ = read_program(path)
    assert result.text == read.text and (read.origins or result.text.encode() == path.read_bytes())


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.name)
def test_check_says_that_it_will_go(dmu50: Machine, path: Path) -> None:
    check = check_program(path, dmu50, options=Options(setup=SETUP))
    assert check.error is None and not check.lacks
    assert not any(one.beyond for one in check.travel.values())
    wanted = "in part" if path.name == "mill_begins_in_increments.nc" else "ready"  # a feed before the first position
    assert check.verdict == wanted and check.control == CONTROLS[path.name.split("_")[0]]
