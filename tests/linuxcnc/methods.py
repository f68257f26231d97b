"""The same programs executed by the control in four ways: as they are, with joint tables, compensated, with live kinematics.

Three machines, three programs each; the error is that of machines in plain numpy. ``python -m tests.linuxcnc.methods`` prints the
table of the manual (`twin doc control`); run it as root.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

import twin
from tests.linuxcnc.control import control
from tests.linuxcnc.machines import KINDS, Kind
from tests.linuxcnc.physical import module
from tests.model.errors import random_calibration
from tests.truth.machine import TruthMachine
from tests.truth.reference import dmu50_pose
from twin.compensation import Compensator, Options
from twin.compensation.live import make_module, write_module
from twin.compensation.tables import Request, make

TOOL = 120.0
ERRORS_UM = 100.0
METHODS = ("as it is", "joint tables", "compensated program", "live kinematics")
NAMES = ("DMU 50 (tables B C)", "head B, table C", "nutating head B, table C")
FEEDS = (2, 3)
"""Types of motion that cut: lines and arcs at feed."""


@dataclass(frozen=True)
class Subject:
    """A machine with errors and its programs.

    Attributes:
        tip: (positions (n, axes), whether with errors) → (n, 3) tool tip on the workpiece, mm.
        programs: their texts, by name.
    """

    machine: twin.Machine
    errors: twin.Calibration
    tip: Callable[[np.ndarray, bool], np.ndarray]
    programs: Mapping[str, str]


def subject(name: str, folder: Path, *, increment: float = 0.001) -> Subject:
    """Return one of `NAMES`, its files written into a folder; ``increment``: least increment of a machine that is not bundled."""
    rng = np.random.default_rng(5)
    if name == NAMES[0]:
        machine = twin.Machine.load("dmu50")
        errors = twin.Calibration.default(machine)
        truth = TruthMachine(errors.path, TOOL)

        def tip(q: np.ndarray, real: bool) -> np.ndarray:
            rows = q * machine_scale
            return np.array(
                [
                    dmu50_pose(row, truth.errors(words) if real else {}, TOOL)[:3, 3]
                    for row, words in zip(rows, q, strict=True)
                ]
            )

        machine_scale = np.array([1.0, 1.0, 1.0, np.pi / 180.0, np.pi / 180.0])
        frustum = Path(twin.__file__).with_name("samples").joinpath("cone_frustum.nc").read_text()
        first = frustum.replace("F800", "F3000")
        return Subject(machine, errors, tip, {"cone frustum": first} | _straight(machine, rng))
    kind = replace(KINDS["head-table" if name == NAMES[1] else "nutating head and table"](), increment=increment)
    machine = kind.machine(folder)
    errors = random_calibration(machine, np.random.default_rng(7), ERRORS_UM)
    errors.save(folder / "errors.yaml")
    truth = TruthMachine(folder / "errors.yaml")

    def kind_tip(q: np.ndarray, real: bool) -> np.ndarray:
        return kind.tip(machine.names, q, (0.0, 0.0, TOOL), truth if real else None)

    return Subject(machine, errors, kind_tip, {"cone": cone(kind, machine, rng)} | _straight(machine, rng))


def cone(kind: Kind, machine: twin.Machine, rng: np.random.Generator, points: int = 351) -> str:
    """Return a circle of 80 mm on the workpiece, the tool inclined by 15° to 25°, in axis words of the machine."""
    low, high = np.array([axis.domain for axis in machine.axes]).T
    angle = np.radians(np.linspace(5.0, 355.0, points))
    circle = 40.0 * np.stack([np.cos(angle), np.sin(angle), 0.1 * np.cos(2.0 * angle)], axis=1)
    rotary = np.stack([20.0 + 5.0 * np.cos(angle), np.degrees(angle)], axis=1)
    for _ in range(5000):
        words = np.tile(low + rng.uniform(0.1, 0.9, len(low)) * (high - low), (points, 1))
        words[:, list(machine.linear)] += circle
        words[:, list(machine.rotary)] = rotary
        q = kind.axes(machine.names, words, (0.0, 0.0, TOOL))
        if np.all((q > low + 5.0) & (q < high - 3.0)):
            return program(machine, q, "F3000")
    raise AssertionError("no place for the cone")


def _straight(machine: twin.Machine, rng: np.random.Generator) -> dict[str, str]:
    """Return a pocket with rotary axes at rest, and lines of all axes across the volume."""
    low, high = np.array([axis.domain for axis in machine.axes]).T
    middle = np.round(0.5 * (low + high))
    middle[list(machine.rotary)] = 30.0, 40.0
    x, y, z = (middle[machine.names.index(name)] for name in "XYZ")
    start = _words(machine, middle)
    pocket = [
        f"G0 {start}",
        f"G1 X{x + 40} F3000",
        f"Y{y + 30}",
        f"X{x - 40} Z{z - 5}",
        f"Y{y - 30} Z{z}",
        f"X{x + 40}",
        f"Y{y}",
        f"G2 X{x + 40} Y{y} I-40 J0",
        f"G3 X{x} Y{y} Z{z - 10} R20",
        f"G1 Z{z + 20}",
    ]
    ends = np.round(low + rng.uniform(0.1, 0.9, (6, len(low))) * (high - low), 2)
    return {
        "pocket, tilted": "G21 G17 G90 G94\n" + "\n".join(pocket) + "\nM2\n",
        "across the volume": program(machine, ends, "F15000"),
    }


def _words(machine: twin.Machine, q: np.ndarray) -> str:
    return " ".join(f"{name}{value:.4f}" for name, value in zip(machine.names, q, strict=True))


def program(machine: twin.Machine, q: np.ndarray, feed: str) -> str:
    lines = [f"G0 {_words(machine, q[0])}", f"G1 {_words(machine, q[1])} {feed}"]
    return "G21 G17 G90 G94\n" + "\n".join([*lines, *(_words(machine, row) for row in q[2:])]) + "\nM2\n"


def compensated(one: Subject, folder: Path, tolerance_mm: float = 1e-3) -> dict[str, str]:
    """Return the programs as twin rewrites them."""
    options = Options(tool_length_mm=TOOL, tolerance_mm=tolerance_mm)
    compensator, found = Compensator(one.machine, one.errors, options), {}
    for name, text in one.programs.items():
        path = folder / f"{name}.ngc"
        path.write_text(text)
        found[name] = compensator.compensate(*twin.read_program(path)).text
    return found


def executed(one: Subject, texts: Mapping[str, str], folder: Path, **others: Any) -> dict[str, np.ndarray]:
    """Return (n, axes) positions of the motors during feed motion, a program's under its name; on the exact path (G61)."""
    home = {axis.name: round(0.5 * sum(axis.domain)) for axis in one.machine.axes}
    # A joint has the correction of its table only once it has moved.
    apart = " ".join(f"{name}{value + 1.0}" for name, value in home.items())
    back = " ".join(f"{name}{value}" for name, value in home.items())
    actions: list[list[Any]] = [
        ["home"],
        *others.pop("first", []),
        ["mdi", f"G53 G0 {apart}"],
        ["mdi", f"G53 G0 {back}"],
    ]
    for i, text in enumerate(texts.values()):
        (folder / f"{i}.ngc").write_text(text)
        actions += [["mdi", "G61"], ["record", f"{i}.txt"], ["program", f"{i}.ngc"], ["stop"]]
    motors = [f"motor-{i}" for i in range(len(home))]
    pins = [*motors, "#motion.motion-type"]
    ran = control(folder, one.machine, actions, home=home, pins=pins, tools=f"T1 P1 Z{TOOL}\n", **others)
    found = {}
    for i, name in enumerate(texts):
        rows = ran.samples(f"{i}.txt")
        found[name] = rows[np.isin(rows[:, -1], FEEDS)][:, :-1] + np.array(list(home.values()))
    return found


def with_tables(one: Subject, folder: Path) -> dict[str, np.ndarray]:
    """Return the motors' positions with the tables of ``control --to linuxcnc``."""
    made = make(one.machine, one.errors, Request("linuxcnc", tool_length_mm=TOOL, tolerance_um=0.3))
    for name, text in made.files.items():
        (folder / name).write_text(text)
    joints = {int(number): lines for number, lines in re.findall(r"\[JOINT_(\d)\]\n([^\[]*)", made.files["joints.ini"])}
    return executed(one, one.programs, folder, joints=joints)


def with_kinematics(one: Subject, folder: Path) -> dict[str, np.ndarray]:
    """Return the motors' positions with the module of ``control --to linuxcnc-kinematics``; the programs have no G43."""
    write_module(make_module(one.errors, tool_length_mm=TOOL), folder / "live")
    on = [["hal", ["setp", "twinkins.fade-rate", "10"]], ["hal", ["setp", "twinkins.enable", "1"]], ["sleep", 0.5]]
    with module(folder / "live") as live:
        live += f"unlinkp twinkins.tool-z\nsetp twinkins.tool-z {TOOL}\n"
        return executed(one, one.programs, folder, kinematics="twinkins", hal=live, first=on)


def off_path_um(path: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return (n,) distances of points (n, 3) from a polyline (m, 3) of short parts, mm → µm."""
    # Where it stopped, its ends are close together, and the path may pass the same place more than once.
    _, nearest = cKDTree(path).query(points, k=min(256, len(path)))
    found = np.full(len(points), np.inf)
    for vertex in nearest.T:
        for begin in (np.maximum(vertex - 1, 0), np.minimum(vertex, len(path) - 2)):
            along, apart = path[begin + 1] - path[begin], points - path[begin]
            share = np.clip((apart * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-30), 0.0, 1.0)
            found = np.minimum(found, np.linalg.norm(apart - share[:, None] * along, axis=1))
    return 1e3 * found


def errors_um(one: Subject, root: Path) -> dict[str, list[np.ndarray]]:
    """Return distances of the true tip from the programmed path over the motion: by program, in the order of `METHODS`."""
    folders = [root / name for name in ("plain", "tables", "compensated", "live")]
    for folder in folders:
        folder.mkdir()
    runs = [
        executed(one, one.programs, folders[0]),
        with_tables(one, folders[1]),
        executed(one, compensated(one, root), folders[2]),
        with_kinematics(one, folders[3]),
    ]
    found = {}
    for name in one.programs:
        path = one.tip(runs[0][name], False)
        found[name] = [off_path_um(path, one.tip(run[name][::3], True)) for run in runs]
    return found


def main() -> None:
    """Print the table: median and largest error."""
    print(f"| machine | program | {' | '.join(METHODS)} |\n|{'---|' * (len(METHODS) + 2)}")
    for name in NAMES:
        with tempfile.TemporaryDirectory(prefix="twin-methods-") as folder:
            root = Path(folder)
            root.chmod(0o755)
            for title, found in errors_um(subject(name, root), root).items():
                cells = " | ".join(f"{np.median(off):.3g} / {off.max():.3g}" for off in found)
                print(f"| {name} | {title} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
