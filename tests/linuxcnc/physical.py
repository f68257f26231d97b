"""The machine behind the control: ``probed.comp`` with numbers of its own, driven by the motors and answering with its probe.

Nothing here is code of twin but the harness that starts the control.
"""

from __future__ import annotations

import csv
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import twin
from tests.linuxcnc.control import user_for
from tests.linuxcnc.machines import Kind, Part
from tests.truth.any_chain import rotations
from tests.truth.machine import RANGES
from tests.truth.reference import dmu50_pose
from twin.controls.linuxcnc import PERIOD_S, Configuration, Ran, run

MODULES = Path("/usr/lib/linuxcnc/modules")
HOME = {"X": 250.0, "Y": 225.0, "Z": 0.0, "B": 0.0, "C": 0.0}
LENGTH = 120.0
SPHERES = ((150.0, 0.0, 60.0), (-75.0, 130.0, 90.0), (-75.0, -130.0, 40.0))
"""Places of the spheres as the operator believes, mm."""
FASTER = 4
"""The control runs with a quarter of the usual period and four times the feeds: what happens in a cycle is the same, in less time."""
UM, URAD = 1e-3, 1e-6


@dataclass(frozen=True)
class Physical:
    """A machine, mm and radians.

    Attributes:
        scale: (3,) of X, Y, Z.
        square: (3,) E_C0Y, E_A0Z, E_B0Z.
        location: (2, 6) of B and C.
        places: (n, 3) true centres of the spheres on the table.
        curves: (5, 6, 8) coefficients of cosines, for C of cosines and sines in turn.
        probe: parameters of the component.
        home: where the axes stand at first, in the order of the motors.
        chains: C statements of the two sides of another machine than the DMU 50, by `TOOL_CHAIN` and `WORK_CHAIN`; without errors.
        reflectors: a tracker's targets by name: whether on the table (else on the spindle head), and the place there, mm.
    """

    scale: np.ndarray
    square: np.ndarray
    location: np.ndarray
    places: np.ndarray
    curves: np.ndarray = field(default_factory=lambda: np.zeros((5, 6, 8)))
    probe: Mapping[str, float] = field(default_factory=dict)
    home: Mapping[str, float] = field(default_factory=lambda: HOME)
    chains: Mapping[str, str] = field(default_factory=dict)
    reflectors: Mapping[str, tuple[bool, tuple[float, ...]]] = field(default_factory=dict)

    @classmethod
    def drawn(cls, seed: int, *, curves_um: float = 0.0) -> Physical:
        """Draw squareness of 40 µrad, locations of 30 µm and 40 µrad, spheres 1 mm from where they should be, and a probe."""
        rng = np.random.default_rng(seed)
        location = rng.normal(0.0, 1.0, (2, 6)) * [0.03, 0.03, 0.0, 4e-5, 4e-5, 0.0]
        # A location along the axis, and about it, is none.
        sizes = np.array([UM, UM, UM, 5.0 * URAD, 5.0 * URAD, 5.0 * URAD])[None, :, None] * curves_um
        orders = np.repeat(1.0 / np.arange(1, 5), 2)
        curves = rng.normal(0.0, 1.0, (5, 6, 8)) * sizes * orders
        square = rng.normal(0.0, 4e-5, 3)
        places = np.array(SPHERES) + rng.uniform(-1.0, 1.0, (3, 3)) * 0.8
        probe = {
            "length": LENGTH + rng.uniform(-0.3, 0.3),
            "offset-x": rng.normal(0.0, 0.01),
            "offset-y": rng.normal(0.0, 0.01),
            "pretravel": 0.008,
            "lobing": 0.001,
            "noise": 0.001,
            "seed": seed + 1,
        }
        return cls(np.zeros(3), square, location, places, curves, probe)

    @classmethod
    def of_kind(cls, kind: Kind, names: tuple[str, ...], place: tuple[float, ...]) -> Physical:
        """Return a machine of another kind, without errors, with a probe and one sphere up to 0.8 mm from its place."""
        rng, parts = np.random.default_rng(6), {part.name: part for part in (*kind.tool, *kind.work)}
        home = {name: 0.0 for name in names} | {name: 0.5 * (parts[name].low + parts[name].high) for name in "XY"}
        home["Z"] = parts["Z"].high
        probe = {"length": LENGTH, "pretravel": 0.008, "lobing": 0.001, "noise": 0.001, "seed": 7}
        chains = {"TOOL_CHAIN": _chain(kind.tool, names, kind.nose), "WORK_CHAIN": _chain(kind.work, names)}
        there = np.array([place]) + rng.uniform(-0.8, 0.8, (1, 3))
        return cls(np.zeros(3), np.zeros(3), np.zeros((2, 6)), there, probe=probe, home=home, chains=chains)

    def header(self) -> str:
        """Return the C header with the numbers."""
        held = list(self.reflectors.values())
        lines = [f"#define SPHERES {len(self.places)}", "#define RADIUS 12.5", f"#define REFLECTORS {len(held)}"]
        on_table = ", ".join([*(str(int(table)) for table, _ in held), "0"])
        lines.append(f"static const int ON_TABLE[{len(held) + 1}] = {{{on_table}}};")
        lines += [f"#define {name} {text}" for name, text in self.chains.items()]
        limits = np.array([RANGES[axis] for axis in "XYZBC"])
        named = {"SCALE": self.scale, "SQUARE": self.square, "LOCATION": self.location, "CURVES": self.curves}
        reflected = np.array([*(place for _, place in held), (0.0, 0.0, 0.0)])
        for name, values in (named | {"RANGES": limits, "PLACES": self.places, "REFLECTED": reflected}).items():
            sizes = "".join(f"[{n}]" for n in values.shape)
            numbers = ", ".join(f"{value:.17g}" for value in values.ravel())
            lines.append(f"static const double {name}{sizes} = {{{numbers}}};")
        return "\n".join(lines) + "\n"

    @contextmanager
    def installed(self, folder: Path) -> Iterator[None]:
        """Compile the machine into the control, and take it out at the end; one that was there before comes back."""
        folder.mkdir(exist_ok=True)
        target = MODULES / "probed.so"
        former = target.read_bytes() if target.exists() else None
        shutil.copy(Path(__file__).with_name("probed.comp"), folder)
        (folder / "numbers.h").write_text(self.header())
        subprocess.run(["halcompile", "--install", "probed.comp"], cwd=folder, check=True, capture_output=True)
        try:
            yield
        finally:
            target.unlink()
            if former is not None:
                target.write_bytes(former)

    def tip(self, q: np.ndarray) -> np.ndarray:
        """Return (3,) the true tip on the workpiece, mm, by other code than that of the component; without curves."""
        errors = {
            "X": np.zeros(6),
            "Y": np.zeros(6),
            "Z": np.zeros(6),
            "L_B": self.location[0],
            "L_C": self.location[1],
        }
        for i, axis in enumerate("XYZ"):
            errors[axis][i] = self.scale[i] * q[i]
        errors["Y"][0] = -self.square[0] * q[1]
        errors["Z"][:2] = self.square[2] * q[2], -self.square[1] * q[2]
        pose = dmu50_pose(np.array([*q[:3], *np.radians(q[3:])]), errors)
        ball = [
            self.probe.get("offset-x", 0.0),
            self.probe.get("offset-y", 0.0),
            -self.probe.get("length", LENGTH),
            1.0,
        ]
        return np.asarray((pose @ ball)[:3])

    def hal(self, faults: Mapping[str, float]) -> str:
        """Return the lines that connect it."""
        values = {f"home-{i}": value for i, value in enumerate(self.home.values())} | dict(self.probe) | dict(faults)
        lines = ["loadrt probed", *(f"setp probed.0.{name} {value:.12g}" for name, value in values.items())]
        lines += [f"net motor-{i} => probed.0.motor-{i}" for i in range(len(self.home))]
        lines += [f"net seen-{i} probed.0.seen-{i} => motion.analog-in-{i:02}" for i in range(3)]
        lines.append("net looked-at motion.analog-out-00 => probed.0.reflector")
        return "\n".join([*lines, "addf probed.0 servo-thread", "net touch probed.0.touched => motion.probe-input\n"])


def _chain(parts: Sequence[Part], names: tuple[str, ...], end: tuple[float, ...] = (0.0, 0.0, 0.0)) -> str:
    """Return C statements that carry a pose along the axes of a side."""
    lines = []
    for part in parts:
        unit = np.array(part.motion) / np.linalg.norm(part.motion)
        scale = "" if part.linear else " * PI / 180.0"
        by = ", ".join(f"{value:.17g} * q[{names.index(part.name)}]{scale}" for value in unit)
        lines += [f"shift(&p, {', '.join(map(repr, part.place))});", f"{'shift' if part.linear else 'turn'}(&p, {by});"]
    return " ".join([*lines, f"shift(&p, {', '.join(map(repr, end))});"])


@contextmanager
def module(folder: Path) -> Iterator[str]:
    """Compile the kinematics module of a folder of `twin control` into the control, and return its HAL lines."""
    subprocess.run(["halcompile", "--install", "twinkins.c"], cwd=folder, check=True, capture_output=True)
    try:
        yield (folder / "twinkins.hal").read_text()
    finally:
        (MODULES / "twinkins.so").unlink()


def faster(text: str) -> str:
    """Return a program with its feeds multiplied."""
    return re.sub(r"\bF([\d.]+)", lambda found: f"F{FASTER * float(found[1]):g}", text)


def poses(count: int = 40) -> np.ndarray:
    """Return positions (n, 5) at which a tool of `LENGTH` is above the table, over the volume: mm and degrees."""
    rng, found = np.random.default_rng(8), []
    low, high = np.array([RANGES[axis] for axis in "XYZBC"]).T
    while len(found) < count:
        q = np.round(rng.uniform(low, high), 3)
        if 20.0 < nominal(q)[2] < 250.0:
            found.append(q)
    return np.array(found)


def nominal(q: np.ndarray) -> np.ndarray:
    """Return (3,) where the tool would be on the workpiece of a machine without errors, mm."""
    return np.asarray(dmu50_pose(np.array([*q[:3], *np.radians(q[3:])]), {}, LENGTH)[:3, 3])


def visits(places: np.ndarray) -> list[list[Any]]:
    """Return the actions that go to positions and ask the machine where its tool is."""
    # A ball without size touches nothing on the way.
    actions: list[list[Any]] = [["hal", ["setp", "probed.0.ball-radius", "-1000"]], ["mdi", f"G21 G90 G43.1 Z{LENGTH}"]]
    for q in places:
        words = " ".join(f"{name}{value:.3f}" for name, value in zip("XYZBC", q, strict=True))
        actions += [["mdi", f"G53 G0 {words}"], ["sleep", 0.15]]
        actions += [["hal", ["getp", f"probed.0.tip-{i}"]] for i in range(3)]
    return actions


def tips(ran: Ran, count: int) -> np.ndarray:
    """Return (n, 3) the answers of `visits`, the last actions of a run."""
    return np.array([float(value) for value in ran.results("hal")[-3 * count :]]).reshape(-1, 3)


def stops(plan: Path) -> list[dict[str, str]]:
    """Return the rows of a tracker's plan."""
    lines = [line for line in plan.read_text().splitlines() if not line.startswith("#")]
    return list(csv.DictReader(lines))


def reflectors(rows: Sequence[Mapping[str, str]]) -> dict[str, tuple[bool, tuple[float, ...]]]:
    """Return the targets of a plan, up to 5 mm from where they should be."""
    rng = np.random.default_rng(2)
    planned = {row["target"]: row for row in rows}
    return {
        name: (
            row["carrier"] == "work",
            tuple(float(row[f"planned_place_{axis}_mm"]) + rng.uniform(-5.0, 5.0) for axis in "xyz"),
        )
        for name, row in planned.items()
    }


def tracker_program(rows: Sequence[Mapping[str, str]], physical: Physical, length: float) -> str:
    """Return a program that stops at the points of a plan and logs where the reflector is; it stands for a tracker's own recording."""
    numbers = {name: i for i, name in enumerate(physical.reflectors)}
    lines = [f"G21 G90 G43.1 Z{length}", "(LOGOPEN,points.csv)"]
    for row in rows:
        words = " ".join(f"{axis}{row[f'{axis}_mm' if axis in 'XYZ' else f'{axis}_deg']}" for axis in "XYZBC")
        # The control takes its time to read what has been chosen.
        lines += [f"G53 G0 {words}", "G4 P0.1", f"M68 E0 Q{numbers[row['target']]}", "G4 P0.05"]
        for i in range(3):
            lines += [f"M66 E{i} L0", f"#{101 + i}=#5399"]
        lines.append("(LOG,#101,#102,#103)")
    return "\n".join([*lines, "(LOGCLOSE)", "M2\n"])


def write_tracked(path: Path, rows: Sequence[Mapping[str, str]], seen: np.ndarray, seed: int) -> None:
    """Write a measurement table: places (n, 3) as a laser tracker reads them in its own frame, with noise of its data sheet."""
    rng, stations, lines = np.random.default_rng(seed), {}, []
    names = ["X_mm", "Y_mm", "Z_mm", "B_deg", "C_deg", "target", "carrier", "station", "round", "time_s"]
    for row, point in zip(rows, seen, strict=True):
        if row["station"] not in stations:
            place = np.array([float(row[f"planned_station_{axis}_mm"]) for axis in "xyz"]) + rng.uniform(-30, 30, 3)
            # Level to some milliradians, its zero anywhere.
            turn = rotations(np.array([[*rng.normal(0.0, 0.003, 2), rng.uniform(-3.0, 3.0)]]))[0]
            stations[row["station"]] = place, turn
        place, turn = stations[row["station"]]
        reading = turn.T @ (point - place)
        metres = np.linalg.norm(reading) / 1e3
        # Half of the largest permissible errors: 0.4 µm + 0.3 µm/m along the beam, 15 µm + 6 µm/m across.
        along, across = 0.5e-3 * (0.4 + 0.3 * metres), 0.5e-3 * (15.0 + 6.0 * metres)
        beam, noise = reading / np.linalg.norm(reading), rng.normal(0.0, 1.0, 3)
        reading = reading + across * noise + (along - across) * (noise @ beam) * beam
        lines.append(",".join([*(row[name] for name in names), *(f"{value:.5f}" for value in reading)]))
    path.write_text("\n".join([",".join([*names, "x_mm", "y_mm", "z_mm"]), *lines, ""]))


def remaining_um(places: np.ndarray, reached: np.ndarray) -> np.ndarray:
    """Return (n,) distances of true and nominal tips, µm, after the operator has set the workpiece and the tool.

    That is a motion of the workpiece and an offset of the tool.
    """
    rows, off = [], []
    for q, tip in zip(places, reached, strict=True):
        turn = dmu50_pose(np.array([*q[:3], *np.radians(q[3:])]), {})[:3, :3]
        here = nominal(q)
        turned = np.stack([np.cross(unit, here) for unit in np.eye(3)], axis=1) / 100.0
        rows.append(np.concatenate([np.eye(3), turned, turn], axis=1))
        off.append(tip - here)
    unseen, difference = np.concatenate(rows), np.concatenate(off)
    fitted = unseen @ np.linalg.lstsq(unseen, difference, rcond=1e-9)[0]
    return np.linalg.norm((difference - fitted).reshape(-1, 3), axis=1) * 1e3


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def execute(
    folder: Path,
    machine: twin.Machine,
    physical: Physical,
    actions: Sequence[Sequence[Any]],
    *,
    live: str = "",
    faults: Mapping[str, float] | None = None,
) -> Ran:
    """Run the control with the machine behind it; ``live``: HAL lines of the kinematics module with errors.

    On a busy computer the control stops now and then because it reads the state of its queue too early; the operator starts again.
    """
    options: dict[str, Any] = {"hal": live + physical.hal(faults or {}), "kinematics": "twinkins" if live else ""}
    options |= {"period_s": PERIOD_S / FASTER, "acceleration": 16000.0}
    # Elsewhere than the folders of pytest: each of its sessions takes the rights of other users from all of them when it starts.
    with tempfile.TemporaryDirectory(prefix="twin-linuxcnc-") as name, first_in_line():
        room = Path(name)
        shutil.copytree(folder, room, dirs_exist_ok=True)
        for _ in range(4):
            ran = run(
                room, Configuration(machine, physical.home, **options), actions, user=user_for(room), seconds=590.0
            )
            if "Queue is not empty after probing" not in ran.failed:
                break
        for path in room.glob("*.*"):
            if path.is_file():
                shutil.copy(path, folder)
    return ran


@contextmanager
def first_in_line() -> Iterator[None]:
    """Let the processes started within come before others, if this user may."""
    usual = os.getpriority(os.PRIO_PROCESS, 0)
    try:
        os.setpriority(os.PRIO_PROCESS, 0, -15)
    except PermissionError:
        yield
        return
    try:
        yield
    finally:
        os.setpriority(os.PRIO_PROCESS, 0, usual)
