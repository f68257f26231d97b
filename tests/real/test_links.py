"""The written file of two robots against plain unweighted least squares over the same parameters, in sample and at held-out poses.

The parameters are the links (`E_*0J*`), the station and the targets' places; the reference is a Gauss-Newton iteration in numpy with
differences of `Kinematics.forward`. The set-up of the written file is fitted here by SciPy; the outcome is the RMS distance.
"""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from tests.conftest import beside
from tests.identification.test_identify_command import status
from tests.real.__main__ import SetUpFit, Table
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.tool.forward import Kinematics

ALLOWED = 1.03
"""Ratio of RMS distances: the bar of the issue that introduced the discrepancy."""
PRIOR_MM_PER_UM = 1e-4
"""Weight of a weak prior about zero of each link: two of them turn with the place of a single target."""
STEP_UM, STEP_MM, STEPS = 50.0, 1e-4, 6


class Links:
    """Links and set-up of a robot: distances of readings, and their plain least squares."""

    def __init__(self, machine: Machine, names: list[str], table: Table) -> None:
        self.machine, self.names, self.table = machine, names, table

    def left(self, links: np.ndarray, setup: np.ndarray) -> np.ndarray:
        """Return (n, 3) measured minus predicted, mm."""
        errors = replace(Calibration.zero(self.machine), location=dict(zip(self.names, links.tolist(), strict=True)))
        poses = Kinematics(self.machine, errors, tool_length_mm=0.0).forward(self.table.positions)
        place = setup[6:].reshape(-1, 3)[self.table.target]
        points = np.array(poses.point_mm) + np.einsum("nij,nj->ni", poses.rotation, place)
        return np.asarray(self.table.point_mm - (Rotation.from_rotvec(setup[:3]).apply(points) + setup[3:6]))

    def fit(self, start: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return links and set-up of plain least squares on some rows, from a set-up of the nominal machine."""
        links, setup = np.zeros(len(self.names)), start
        for _ in range(STEPS):
            off = self.left(links, setup)
            columns = [
                (self.left(links + STEP_UM * one, setup) - off)[rows].ravel() / STEP_UM for one in np.eye(len(links))
            ]
            columns += [
                (self.left(links, setup + STEP_MM * one) - off)[rows].ravel() / STEP_MM for one in np.eye(len(setup))
            ]
            prior = PRIOR_MM_PER_UM * np.eye(len(links), len(links) + len(setup))
            matrix = np.concatenate([np.stack(columns, axis=1), prior])
            right = np.concatenate([off[rows].ravel(), PRIOR_MM_PER_UM * links])
            size = np.linalg.norm(matrix, axis=0)
            step = -np.linalg.lstsq(matrix / size, right, rcond=1e-9)[0] / size
            links, setup = links + step[: len(links)], setup + step[len(links) :]
        return links, setup


def rms_um(left: np.ndarray) -> float:
    return 1e3 * float(np.sqrt(np.mean(np.sum(left**2, axis=1))))


@pytest.mark.parametrize("held_out", [pytest.param(False, id="in sample"), pytest.param(True, id="held out")])
@pytest.mark.parametrize(
    ("folder", "file", "robot"), [("ur10-c", "poses.csv", "ur10.yaml"), ("abb-irb120", "tool2.csv", "irb120.yaml")]
)
@pytest.mark.slow
def test_the_file_is_as_good_as_plain_least_squares(
    tmp_path: Path, folder: str, file: str, robot: str, *, held_out: bool
) -> None:
    """Within 3 % over all rows; every fifth pose is held out. The weights of a tracker's noise gave 15 to 25 % more."""
    path, machine = beside("data", "real", folder, file), Machine.load(beside("data", "real", folder, robot))
    table = Table.read(path, machine)
    _, first, pose = np.unique(np.round(table.positions, 3), axis=0, return_index=True, return_inverse=True)
    order = np.argsort(np.argsort(first))[pose.reshape(-1)]
    kept = order % 5 != 4 if held_out else np.ones(len(order), dtype=bool)
    head, *lines = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
    with (tmp_path / "part.csv").open("w", newline="", encoding="utf-8") as part:
        csv.writer(part).writerows([head, *(line for line, keep in zip(lines, kept, strict=True) if keep)])
    words = ("-m", machine.path, "--only", "E_*0J*", "-o", tmp_path / "c.yaml")
    assert status("identify", tmp_path / "part.csv", *words) in (0, 3)
    written = Calibration.load(tmp_path / "c.yaml", machine)
    nominal = SetUpFit(table.part(np.flatnonzero(kept)), Calibration.zero(machine)).solution
    links = Links(machine, list(written.location), table)
    plain = links.left(*links.fit(nominal, kept))
    numbers = np.array([written.location[name] for name in links.names])
    setup = least_squares(lambda w: links.left(numbers, w)[kept].ravel(), nominal, x_scale="jac").x
    rows = ~kept if held_out else kept
    assert rms_um(links.left(numbers, setup)[rows]) < ALLOWED * rms_um(plain[rows])


@pytest.mark.slow
def test_a_diagnosis_with_the_noise_of_a_tracker_does_not_follow_the_beam(tmp_path: Path) -> None:
    """UR10, series C, of which no cause explains all: 91 µm at held-out poses; with the weights of the noise 278 µm."""
    folder = beside("data/real/ur10-c")
    found = tmp_path / "found.json"
    words = (folder / "poses.csv", "-m", folder / "ur10.yaml", "--instrument", "tracker", "--json", found)
    assert status("diagnose", *words) in (0, 3)
    assert json.loads(found.read_text())["gain"]["held_out"]["rms_after_um"] < 120.0
