"""Table of residuals of `twin identify` for every real data set, each computed here from the calibration file that it wrote.

    python -m tests.real                (some minutes; needs the folder of real measurements next to the project)
    python -m tests.real ur10-c plates  (only these)

For each calibration, stations and the targets' places are fitted to the rows by a robust loss, with SciPy. "Before" is the nominal
machine. "Held out" is the residual of the other half of the positions, with calibration, stations and places from the first half.
"""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from tests.conftest import beside
from tests.real import plates, stage, ur10
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.tool.forward import Kinematics

SEED = 16
KEPT = 0.97
"""Share of the rows, those with the smallest residuals, whose RMS is shown next to that of all, which a few lost beams dominate."""
STARTS = 3
FEW = 20
LIMIT_S = 900.0


@dataclass(frozen=True)
class RealSet:
    """One table of one machine, and how it is identified."""

    name: str
    files: Callable[[Path], tuple[Path, Path]]
    options: tuple[str, ...] = ()


def given(folder: str, table: str, machine: str) -> Callable[[Path], tuple[Path, Path]]:
    """Return the table and machine file in the folder."""
    return lambda _: (beside("data", "real", folder, table), beside("data", "real", folder, machine))


def of_ur10(folder: Path) -> tuple[Path, Path]:
    """Return series A, 11,911 poses."""
    shared = beside("data", "real", "ur10")
    return ur10.write_table(shared, folder / "ur10.csv"), ur10.write_machine(shared, folder, as_given=False)


def of_plate(folder: Path) -> tuple[Path, Path]:
    """Return the plate of 2011."""
    holes = plates.holes_mm(beside("data", "real", "plates"))
    return plates.write_table(holes, folder / "plate.csv"), plates.write_machine(folder)


def of_stage(axis: str) -> Callable[[Path], tuple[Path, Path]]:
    """Return one axis of the ISO 230-2 stage."""
    return lambda folder: (
        stage.write_table(beside("data", "real", "stage-iso230-2"), axis, folder / "stage.csv"),
        stage.write_machine(folder),
    )


LINKS = ("--only", "E_*0J*", "--uncertainty", "between poses")
SETS = (
    RealSet("ur10-c links", given("ur10-c", "poses.csv", "ur10.yaml"), LINKS),
    RealSet("ur10-c all", given("ur10-c", "poses.csv", "ur10.yaml"), ("--uncertainty", "between poses")),
    RealSet("ur10 links", of_ur10, ("--only", "E_*0J*", "--uncertainty", "between rounds")),
    RealSet("abb links", given("abb-irb120", "tool2.csv", "irb120.yaml"), LINKS),
    RealSet("abb all", given("abb-irb120", "tool2.csv", "irb120.yaml"), ("--uncertainty", "between poses")),
    RealSet("plates", of_plate),
    RealSet("plate-2003", given("plate-2003", "plate.csv", "drill.yaml")),
    RealSet("plate-2003 free place", given("plate-2003", "plate_free_place.csv", "drill.yaml")),
    RealSet("stage-iso230-2 x", of_stage("x")),
    RealSet("stage-iso230-2 y", of_stage("y")),
    RealSet("stage-z", given("stage-z", "run.csv", "stage.yaml")),
    RealSet("voron run2", given("voron-frame", "run2.csv", "z.yaml")),
    RealSet("voron run3", given("voron-frame", "run3.csv", "z.yaml")),
    RealSet("voron dead sensor", given("voron-frame", "run3_dead_sensor.csv", "z.yaml")),
)


@dataclass(frozen=True)
class Table:
    """Numbers of a measurement table, read without `twin`."""

    positions: np.ndarray
    target: np.ndarray
    point_mm: np.ndarray
    place_mm: np.ndarray

    @classmethod
    def read(cls, path: Path, machine: Machine) -> Table:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = [row for row in csv.DictReader(line for line in file if not line.startswith("#"))]

        def numbers(*names: str) -> np.ndarray:
            return np.array([[float(row.get(name) or "nan") for name in names] for row in rows])

        axes = [f"{axis.name}_{axis.unit}" for axis in machine.axes]
        _, target = np.unique([row["target"] for row in rows], return_inverse=True)
        points, places = (numbers(*(f"{before}{one}_mm" for one in "xyz")) for before in ("", "place_"))
        return cls(numbers(*axes), target, points, places)

    def part(self, rows: np.ndarray) -> Table:
        """Return some rows."""
        return Table(self.positions[rows], self.target[rows], self.point_mm[rows], self.place_mm[rows])


class SetUpFit:
    """Station and places of targets on the tool side for one calibration, by a robust loss."""

    def __init__(self, table: Table, calibration: Calibration) -> None:
        self.calibration = calibration
        read = np.isfinite(table.point_mm)
        free = 0 if np.isfinite(table.place_mm).all() else 3 * (int(table.target.max()) + 1)
        # Readings of one coordinate along a line do not determine the rotation of the station.
        self.turns = bool(read.any(axis=0).sum() > 1)
        poses, best = self._poses(table), None
        for start in (
            self._nearest_turn(poses[0], table.point_mm),
            *Rotation.random(STARTS, random_state=SEED).as_rotvec(),
        ):
            first = np.zeros(6 + free)
            first[:3] = start if self.turns else 0.0
            for loss in ("linear", "soft_l1"):
                found = least_squares(
                    lambda w: self._left(w, table, poses)[read],
                    first,
                    loss=loss,
                    f_scale=0.3,
                    x_scale="jac",
                    max_nfev=100,
                )
                first = found.x
            best = found if best is None or found.cost < best.cost else best
            if not self.turns:
                break
        assert best is not None
        self.solution = best.x

    def residual(self, table: Table) -> np.ndarray:
        """Return (n, 3) measured minus predicted, mm; zero where nothing was read."""
        return self._left(self.solution, table, self._poses(table))

    @staticmethod
    def _nearest_turn(points: np.ndarray, read: np.ndarray) -> np.ndarray:
        """Return the rotation vector from points to readings, both about their means (Kabsch 1976)."""
        seen = np.where(np.isfinite(read), read, 0.0)
        u, _, v = np.linalg.svd((seen - seen.mean(axis=0)).T @ (points - points.mean(axis=0)))
        return np.asarray(Rotation.from_matrix(u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v).as_rotvec())

    def _poses(self, table: Table) -> tuple[np.ndarray, np.ndarray]:
        poses = Kinematics(self.calibration.machine, self.calibration, tool_length_mm=0.0).forward(table.positions)
        return np.asarray(poses.point_mm), np.asarray(poses.rotation)

    def _left(self, w: np.ndarray, table: Table, poses: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        place = w[6:].reshape(-1, 3)[table.target] if len(w) > 6 else np.nan_to_num(table.place_mm)
        points = poses[0] + (poses[1] @ place[:, :, None])[:, :, 0]
        left = table.point_mm - (Rotation.from_rotvec(w[:3] if self.turns else np.zeros(3)).apply(points) + w[3:6])
        return np.where(np.isfinite(table.point_mm), left, 0.0)


def rms_um(left: np.ndarray) -> tuple[float, float]:
    """Return the RMS distance of all rows, and of the share of them with the smallest residuals, µm."""
    far = np.sort(np.linalg.norm(left, axis=1))
    kept = far[: max(int(KEPT * len(far)), 1)]
    return 1e3 * float(np.sqrt(np.mean(far**2))), 1e3 * float(np.sqrt(np.mean(kept**2)))


def identified(table: Path, machine: Path, options: tuple[str, ...], folder: Path) -> tuple[str, dict, float]:
    """Run the command; return its message on stderr if it refused, otherwise its JSON, and the time in seconds."""
    out, said = folder / "calibration.yaml", folder / "identified.json"
    for path in (out, said):
        path.unlink(missing_ok=True)
    words = [sys.executable, "-m", "twin.cli", "identify", table, "-m", machine, "-o", out, "--json", said, *options]
    start = time.perf_counter()
    try:
        done = subprocess.run(
            [str(word) for word in words], capture_output=True, text=True, timeout=LIMIT_S, check=False
        )
    except subprocess.TimeoutExpired:
        return f"no answer in {LIMIT_S:g} s", {}, LIMIT_S
    seconds = time.perf_counter() - start
    if not said.exists():
        return f"exit {done.returncode}: {(done.stderr.strip().splitlines() or [''])[-1][:150]}", {}, seconds
    return "", json.loads(said.read_text(encoding="utf-8")), seconds


def half_of(path: Path, table: Table, machine: Machine, folder: Path) -> tuple[Path, np.ndarray]:
    """Return the rows of a random half of the positions as a table, and (n,) which they are."""
    _, pose = np.unique(np.round(table.positions, 3), axis=0, return_inverse=True)
    pose = pose.reshape(-1)
    chosen = np.random.default_rng(SEED).random(pose.max() + 1) < 0.5
    # The end points of a travel stay in, to avoid extrapolation; of few positions every second one.
    if len(chosen) < FEW:
        chosen = np.arange(len(chosen)) % 2 == 0
    ends = [pose[i] for q in table.positions.T if np.ptp(q) > 0.0 for i in (int(np.argmin(q)), int(np.argmax(q)))]
    chosen[ends] = True
    mask = chosen[pose]
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    head = next(i for i, line in enumerate(lines) if not line.startswith("#"))
    body = [line for line in lines[head + 1 :] if line.strip() and not line.startswith("#")]
    half = folder / "half.csv"
    half.write_text("\n".join([*lines[: head + 1], *(line for line, kept in zip(body, mask, strict=True) if kept), ""]))
    return half, mask


def row_of(one: RealSet) -> str:
    """Return the line of one set."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path, machine_file = one.files(folder)
        machine = Machine.load(machine_file)
        table = Table.read(path, machine)
        why, said, seconds = identified(path, machine_file, one.options, folder)
        if why:
            return f"{one.name:<22} {len(table.positions):>6}  {why}  ({seconds:.1f} s)"
        found = Calibration.load(folder / "calibration.yaml", machine)
        nominal = Calibration.zero(machine)
        before, after = (SetUpFit(table, c) for c in (nominal, found))
        left = [rms_um(fit.residual(table)) for fit in (before, after)]
        half, mask = half_of(path, table, machine, folder)
        held = "-"
        if 0 < mask.sum() < len(mask):
            why, _, _ = identified(half, machine_file, one.options, folder)
            held = why
            if not why:
                part = Calibration.load(folder / "calibration.yaml", machine)
                both = [rms_um(SetUpFit(table.part(mask), c).residual(table.part(~mask))) for c in (nominal, part)]
                held = f"{both[0][1]:8.2f} → {both[1][1]:8.2f}"
        return (
            f"{one.name:<22} {len(table.positions):>6} {said['points']['used']:>6}  {said['misfit']['rms_um']:8.2f}   "
            f"{left[0][0]:8.2f} → {left[1][0]:8.2f}   {left[0][1]:8.2f} → {left[1][1]:8.2f}   {held}   {seconds:6.1f} s"
        )


def main(names: list[str]) -> None:
    """Print the table."""
    print(
        "set                      rows   used  reported  all rows, before → after   nearest 97 %           held out, 97 %"
    )
    for one in SETS:
        if not names or any(one.name.startswith(name) for name in names):
            print(row_of(one), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
