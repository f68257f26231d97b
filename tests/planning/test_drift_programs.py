"""Programs of drift tests: read back by twin's NC reader, and run by a small interpreter with a clock of its own."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from tests.nc.nc_support import read_moves
from tests.truth.machine import RANGES
from tests.truth.reference import dmu50_pose
from twin import cli
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.nc import read_program
from twin.planning.drift import DriftPlan, drift_plan
from twin.planning.programs.controls import write_program
from twin.planning.programs.steps import drift_steps
from twin.planning.sequences.specification import InstrumentSizes

LENGTH = 120.0
NAMES = "XYZBC"
SPEEDS = np.array([100.0, 100.0, 100.0, 15.0, 15.0])
"""Assumed fastest speeds of the default kit, mm/s and degrees/s."""


def planned(machine: Machine, name: str, instrument: str, **options: object) -> DriftPlan:
    minutes = {"spindle": 100.0}.get(name, 40.0)
    return drift_plan(machine, name, instrument, minutes=minutes, sizes=InstrumentSizes(LENGTH), options=options)


def positions_read(path: Path) -> np.ndarray:
    """Return the positions (n, 5) of the moves that twin's reader finds, with words that are not repeated filled in."""
    _, dialect = read_program(path)
    moves = read_moves(dialect, path.read_text(encoding="latin-1")).moves
    assert all(move.machine for move in moves)
    found = np.array([move.position for move in moves])
    for row in range(1, len(found)):
        found[row] = np.where(np.isnan(found[row]), found[row - 1], found[row])
    return found


@pytest.mark.sample(3)  # of 6
@pytest.mark.parametrize(
    ("name", "instrument", "options"),
    [
        ("environment", "r-test", {}),
        ("spindle", "displacement", {"highest_rpm": 12000.0}),
        ("axes", "r-test", {"axis": "X"}),
        ("axes", "displacement", {"axis": "Z"}),
        ("axes", "r-test", {"axis": "C"}),
        ("axes", "r-test", {"axis": "B"}),
    ],
)
def test_programs_read_back_as_the_same_motion(
    dmu50: Machine, tmp_path: Path, name: str, instrument: str, options: dict[str, object]
) -> None:
    plan = planned(dmu50, name, instrument, **options)
    steps = drift_steps(plan)
    wanted = np.array([step.position for step in steps.steps if step.moves])
    low, high = np.array([RANGES[axis] for axis in NAMES]).T
    for suffix in ("ngc", "mpf", "h"):
        write_program(steps, tmp_path / f"p.{suffix}")
        found = positions_read(tmp_path / f"p.{suffix}")
        changed = np.flatnonzero(np.any(np.diff(wanted, axis=0, prepend=np.nan) != 0.0, axis=1))
        np.testing.assert_allclose(found, wanted[changed], atol=6e-4)
        assert np.nanmax(np.maximum(found - high, low - found)) <= 0.0
        assert "NOT RUN ON A MACHINE" in (tmp_path / f"p.{suffix}").read_text()


def run(text: str) -> tuple[list[tuple[float, float, np.ndarray]], float]:
    """Return time, spindle speed and position of every reading of a LinuxCNC program, and the path of rotary and linear axes."""
    at, clock, speed, path, found = np.full(5, np.nan), 0.0, 0.0, 0.0, []
    for line in text.splitlines():
        if re.match(r"\(reading \d+ at", line):
            if not found:
                clock = 0.0
            found.append((clock, speed, at.copy()))
        code = re.sub(r"\(.*?\)", "", line).split()
        if code[:1] == ["G53"]:
            target = at.copy()
            for word in code[2:]:
                if word[0] in NAMES:
                    target[NAMES.index(word[0])] = float(word[1:])
            away = np.nan_to_num(np.abs(target - at))
            feed = next((float(word[1:]) / 60.0 for word in code if word[0] == "F"), np.inf)
            clock += max(float((away / SPEEDS).max()), float(np.linalg.norm(away)) / feed)
            path, at = path + float(away.sum()), target
        elif code[:1] == ["G4"]:
            clock += float(code[1][1:])
        elif code and code[0][0] == "S" and code[1:] == ["M3"]:
            speed = float(code[0][1:])
        elif code == ["M5"]:
            speed = 0.0
    return found, path


@pytest.mark.sample(2)  # of 4
@pytest.mark.parametrize(
    ("name", "options"),
    [("spindle", {"highest_rpm": 8000.0}), ("axes", {"axis": "Y"}), ("axes", {"axis": "Z"}), ("axes", {"axis": "C"})],
)
def test_readings_are_at_the_parts_at_their_times(
    dmu50: Machine, tmp_path: Path, name: str, options: dict[str, object]
) -> None:
    plan = planned(dmu50, name, "r-test", **options)
    write_program(drift_steps(plan), tmp_path / "p.ngc")
    found, path = run((tmp_path / "p.ngc").read_text())
    assert len(found) == len(plan.table)
    behind = [time - wanted for (time, _, _), wanted in zip(found, plan.schedule.time_s, strict=True)]
    assert min(behind) > -1.0 and max(behind) < 20.0
    assert [speed for _, speed, _ in found] == plan.schedule.speed_rpm.tolist()
    for (_, _, q), station in zip(found, plan.table.station, strict=True):
        place = np.array(plan.task.base.places_mm[str(station)])
        assert np.linalg.norm(dmu50_pose([*q[:3], *np.radians(q[3:])], {}, LENGTH)[:3, 3] - place) < 2e-3
    if name == "axes":
        exercised = int(np.count_nonzero(plan.schedule.exercised))
        readings = float(np.abs(np.diff([q for _, _, q in found], axis=0)).sum())
        assert exercised >= 4 and path > 3.0 * readings, "the axis moves between the readings"


def test_a_probe_stops_the_spindle_and_touches(dmu50: Machine, tmp_path: Path) -> None:
    plan = planned(dmu50, "spindle", "probe", highest_rpm=6000.0)
    write_program(drift_steps(plan), tmp_path / "p.ngc")
    text = (tmp_path / "p.ngc").read_text()
    assert text.count("G38.2") == 5 * len(plan.table)
    for block in text.split("M3\n")[1:]:
        assert block.index("M5") < block.index("(put the touch probe in)\nM0") < block.index("G38.2")


def test_a_motion_without_clearance_is_refused(dmu50: Machine) -> None:
    plan = drift_plan(
        dmu50, "axes", "r-test", minutes=40.0, sizes=InstrumentSizes(LENGTH), options={"axis": "Z"},
        places_mm={"nest 1": (150.0, 0.0, 60.0), "nest 2": (22.0, 0.0, 275.0)},
    )  # fmt: skip
    with pytest.raises(InputError, match=r"no path with clearance|to and fro"):
        drift_steps(plan)


def test_command(tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as ended:
        words = ["--drift", "axes", "--axis", "Y", "--instrument", "r-test", "--minutes", "40", "--tool-length", "120"]
        cli.main(["plan", *words, "-o", str(tmp_path / "p.csv"), "--program", str(tmp_path / "p.mpf")])
    assert not ended.value.code
    rows = [line for line in (tmp_path / "p.csv").read_text().splitlines() if line[0] != "#"]
    assert len(re.findall(r"; reading \d+ at", (tmp_path / "p.mpf").read_text())) == len(rows) - 1
