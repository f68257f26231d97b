"""The closed loop on the control: it measures a machine with errors by twin's programs, is corrected by the result, and measures again.

The machine is ``probed.comp``, a realtime component behind the control; twin sees its answers only through the log of the control.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import twin
from tests.linuxcnc.control import needs_linuxcnc, needs_root, skip_without_control
from tests.linuxcnc.physical import (
    LENGTH,
    SPHERES,
    Physical,
    execute,
    faster,
    module,
    poses,
    remaining_um,
    rms,
    tips,
    visits,
)
from tests.truth.reference import dmu50_pose

pytestmark = [needs_linuxcnc, needs_root, pytest.mark.xdist_group("linuxcnc")]
SHORT = 4
"""Poses of a program that is cut short."""
ON = [["hal", ["setp", "twinkins.fade-rate", "10"]], ["hal", ["setp", "twinkins.enable", "1"]], ["sleep", 0.5]]


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> twin.Machine:
    machine = twin.Machine.load("dmu50")
    skip_without_control(tmp_path_factory.mktemp("plain"), machine)
    return machine


@pytest.fixture(scope="module")
def physical(machine: twin.Machine, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Physical]:
    found = Physical.drawn(1)
    with found.installed(tmp_path_factory.mktemp("component")):
        yield found


def command(folder: Path, *words: object, status: int = 0) -> str:
    """Run twin as a user does, in a folder, and return what it says."""
    whole = [sys.executable, "-m", "twin.cli", *map(str, words)]
    done = subprocess.run(whole, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == status, done.stderr + done.stdout
    return done.stdout + done.stderr


def planned(folder: Path, name: str, *words: object) -> Path:
    """Return a measuring program of twin; its sphere places are those that the operator believes."""
    spheres = [f"{x:g},{y:g},{z:g}" for x, y, z in SPHERES]
    plan = ["plan", "--instrument", "probe", "-o", f"{name}.csv", "--program", f"{name}.ngc", "--tool-length", LENGTH]
    command(folder, *plan, "--clearance", 3, "--spheres", *spheres, "--quiet", *words)
    return folder / f"{name}.ngc"


def room(folder: Path, program: Path, text: str | None = None) -> Path:
    """Return the folder of a run, with the program as the control of the tests executes it."""
    run = folder / f"run of {program.stem}"
    run.mkdir()
    (run / program.name).write_text(faster(program.read_text() if text is None else text))
    return run


def converted(folder: Path, log: Path, table: str, *words: object, status: int = 0) -> str:
    return command(folder, "convert", log, "--contacts", 5, "-o", table, *words, status=status)


def centres(machine: twin.Machine, path: Path) -> tuple[np.ndarray, list[str]]:
    data = twin.Measurements.load(path, machine)
    return np.array(data.positions), [str(name) for name in data.target]


def test_the_centres_in_the_log_are_those_of_the_machine(
    machine: twin.Machine, physical: Physical, tmp_path: Path
) -> None:
    """A program of a few poses; the true tip at the centres that `convert` makes of the log is at the true spheres."""
    program = planned(tmp_path, "short", "--minutes", 30)
    whole = program.read_text()
    text = whole[: whole.index(f"(pose {SHORT + 1})")] + "(LOGCLOSE)\nM2\n"
    folder = room(tmp_path, program, text)
    ran = execute(
        folder, machine, physical, [["home"], ["program", program.name]], faults={"noise": 0.0, "lobing": 0.0}
    )
    assert not ran.failed, f"{ran.failed}\n{ran.log}"
    converted(tmp_path, folder / "SHORT_LOG.csv", "measured.csv")
    found, names = centres(machine, tmp_path / "measured.csv")
    assert len(found) == SHORT
    for q, name in zip(found, names, strict=True):
        # A touch is seen once in a cycle, 3.3 µm, and counts alike on all sides but for that.
        assert np.linalg.norm(physical.tip(q) - physical.places[int(name.removeprefix("sphere ")) - 1]) < 0.004
        assert np.linalg.norm(physical.tip(q) - SPHERES[int(name.removeprefix("sphere ")) - 1]) > 0.1


def spread_um(found: np.ndarray, names: list[str]) -> float:
    """Return the RMS distance of sphere centres from their places on the nominal machine, with tip and places fitted, µm."""
    kinds = sorted(set(names))
    rows, off = [], []
    for q, name in zip(found, names, strict=True):
        pose = dmu50_pose(np.array([*q[:3], *np.radians(q[3:])]), {}, LENGTH)
        place = np.hstack([np.eye(3) * (name == kind) for kind in kinds])
        rows.append(np.hstack([pose[:3, :3], -place]))
        off.append(-pose[:3, 3])
    matrix, wanted = np.concatenate(rows), np.concatenate(off)
    left = wanted - matrix @ np.linalg.lstsq(matrix, wanted, rcond=None)[0]
    return 1e3 * float(np.sqrt(3.0 * np.mean(left**2)))


@pytest.mark.slow
def test_the_machine_is_right_after_one_loop(machine: twin.Machine, physical: Physical, tmp_path: Path) -> None:
    """Plan, measure, convert, identify, correct in the control, measure with another program: 1.5 µm RMS or less remain."""
    program = planned(tmp_path, "first", "--minutes", 45)
    folder = room(tmp_path, program)
    places = poses()
    ran = execute(folder, machine, physical, [["home"], ["program", program.name], *visits(places)])
    assert not ran.failed, f"{ran.failed}\n{ran.log}"
    before = remaining_um(places, tips(ran, len(places)))
    probe = physical.probe
    tip = f"{probe['offset-x']:.3f},{probe['offset-y']:.3f},{-probe['length']:.3f}"
    converted(tmp_path, folder / "FIRST_LOG.csv", "measured.csv", "--tip", tip)
    command(tmp_path, "identify", "measured.csv", "-o", "mine.yaml", "--only", "E_*0*")
    command(
        tmp_path, "control", "--to", "linuxcnc-kinematics", "-o", "live", "-c", "mine.yaml", "--tool-length", LENGTH
    )
    with module(tmp_path / "live") as live:
        second = planned(tmp_path, "second", "--sequence", "turns")
        again = room(tmp_path, second)
        ran = execute(again, machine, physical, [["home"], *ON, ["program", second.name], *visits(places)], live=live)
    assert not ran.failed, f"{ran.failed}\n{ran.log}"
    after = remaining_um(places, tips(ran, len(places)))
    converted(tmp_path, again / "SECOND_LOG.csv", "second.csv")
    assert rms(before) > 8.0 and rms(after) <= 1.5 and after.max() < 0.25 * before.max()
    first = spread_um(*centres(machine, tmp_path / "measured.csv"))
    assert first > 10.0 and spread_um(*centres(machine, tmp_path / "second.csv")) < 3.0
