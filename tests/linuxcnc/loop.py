"""The closed loop on the control, as an operator goes round it.

``python -m tests.linuxcnc.loop``, as root, records one for the course's notebook: what the control wrote, and where the true tool was
(`one_loop`); some ten minutes.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import twin
from tests.linuxcnc.physical import (
    LENGTH,
    SPHERES,
    Physical,
    execute,
    faster,
    module,
    poses,
    remaining_um,
    tips,
    visits,
)
from tests.truth.reference import dmu50_pose

RECORD = Path(twin.__file__).with_name("samples") / "closed_loop.json"
MINUTES = 45
SEED = 1
ON = [["hal", ["setp", "twinkins.fade-rate", "10"]], ["hal", ["setp", "twinkins.enable", "1"]], ["sleep", 0.5]]


def command(folder: Path, *words: object, status: int = 0) -> str:
    """Run twin as a user does, in a folder, and return what it says."""
    whole = [sys.executable, "-m", "twin.cli", *map(str, words)]
    done = subprocess.run(whole, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == status, done.stderr + done.stdout
    return " ".join((done.stdout + done.stderr).split())


def planned(folder: Path, name: str, *words: object, spheres: int = 3) -> Path:
    """Return a measuring program of twin; the first spheres are where the operator believes."""
    places = [f"{x:g},{y:g},{z:g}" for x, y, z in SPHERES[:spheres]]
    plan = ["plan", "--instrument", "probe", "-o", f"{name}.csv", "--program", f"{name}.ngc", "--tool-length", LENGTH]
    command(folder, *plan, "--clearance", 3, "--spheres", *places, "--quiet", *words)
    return folder / f"{name}.ngc"


def joined(place: Sequence[float]) -> str:
    return ",".join(f"{value:g}" for value in place)


def room(folder: Path, program: Path) -> Path:
    """Return the folder of a run, with the program as the control of the tests executes it."""
    run = folder / f"run_{program.stem}"
    run.mkdir()
    (run / program.name).write_text(faster(program.read_text()))
    return run


def converted(folder: Path, log: Path, table: str, *words: object, status: int = 0) -> str:
    return command(folder, "convert", log, "--contacts", 5, "-o", table, *words, status=status)


def centres(machine: twin.Machine, path: Path) -> tuple[np.ndarray, list[str]]:
    data = twin.Measurements.load(path, machine)
    return np.array(data.positions), [str(name) for name in data.target]


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


def measured(
    folder: Path,
    machine: twin.Machine,
    physical: Physical,
    program: Path,
    table: str,
    *tip: object,
    live: str = "",
    seed: int = SEED,
) -> np.ndarray:
    """Execute a measuring program and convert its log.

    Args:
        tip: words of `twin convert` on the probe's tip.
        live: HAL lines of the kinematics module, which is switched on; empty: without one.
        seed: of the noise.

    Returns:
        (n,) distance of the true tip from the nominal one at `poses`, µm (`remaining_um`).
    """
    run, places = room(folder, program), poses()
    actions = [["home"], *(ON if live else []), ["program", program.name], *visits(places)]
    ran = execute(run, machine, physical, actions, live=live, faults={"seed": seed})
    assert not ran.failed, f"{ran.failed}\n{ran.log}"
    converted(folder, log_of(folder, program), table, *tip)
    return remaining_um(places, tips(ran, len(places)))


def log_of(folder: Path, program: Path) -> Path:
    return folder / f"run_{program.stem}" / f"{program.stem.upper()}_LOG.csv"


def tip_of(physical: Physical) -> str:
    """Return the calibrated place of the stylus ball from the spindle nose, mm."""
    probe = physical.probe
    return f"{probe['offset-x']:.3f},{probe['offset-y']:.3f},{-probe['length']:.3f}"


def corrected(folder: Path, calibration: str, live: str, *words: object, status: int = 0) -> str:
    """Make the kinematics module of a calibration, and return what twin says."""
    to = ["control", "--to", "linuxcnc-kinematics", "-o", live, "-c", calibration, "--tool-length", LENGTH]
    return command(folder, *to, *words, status=status)


def one_loop(folder: Path, machine: twin.Machine, physical: Physical) -> dict[str, Any]:
    """Plan, measure, convert, identify, correct in the control, measure with another program.

    Returns:
        The logs of the two measurements; the known place of the probe's tip from the spindle nose, mm; the positions of the axes at
        which the machine was asked for its true tip, and the distance of that tip from the nominal one before and after, µm
        (`remaining_um`).
    """
    first, tip = planned(folder, "first", "--minutes", MINUTES), tip_of(physical)
    before = measured(folder, machine, physical, first, "measured.csv", "--tip", tip, seed=SEED + 1)
    command(folder, "identify", "measured.csv", "-o", "mine.yaml", "--only", "E_*0*")
    corrected(folder, "mine.yaml", "live")
    with module(folder / "live") as live:
        second = planned(folder, "second", "--sequence", "turns", spheres=1)
        after = measured(folder, machine, physical, second, "second.csv", live=live, seed=SEED + 1)
    return {
        "first_log": log_of(folder, first).read_text(),
        "second_log": log_of(folder, second).read_text(),
        "tip_mm": tip,
        "positions": poses().tolist(),
        "before_um": np.round(before, 3).tolist(),
        "after_um": np.round(after, 3).tolist(),
    }


def main() -> None:
    """Record a loop."""
    with tempfile.TemporaryDirectory(prefix="twin-loop-") as name:
        folder, physical = Path(name), Physical.drawn(SEED)
        with physical.installed(folder / "component"):
            found = one_loop(folder, twin.Machine.load("dmu50"), physical)
    said = subprocess.run(["dpkg-query", "-W", "linuxcnc-uspace"], capture_output=True, text=True, check=True).stdout
    head = {"recorded_by": "python -m tests.linuxcnc.loop", "control": " ".join(said.split())}
    RECORD.write_text(json.dumps(head | found, indent=1) + "\n")


if __name__ == "__main__":
    main()
