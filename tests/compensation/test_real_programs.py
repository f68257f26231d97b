"""Programs from real machining: read and written back unchanged, and compensated on a machine of the same kind."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from tests.model.errors import random_calibration
from tests.truth.machine import run_iso
from twin.compensation import Compensation, Compensator, Options
from twin.compensation.programs.execute import execute
from twin.compensation.programs.follow import follow
from twin.compensation.programs.words import Setup
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import read_program
from twin.tool.forward import Kinematics, Poses
from twin.tool.inverse import Inverse

LENGTH = 50.0
ROUNDING_UM = 0.9
OPTIONS = Options(tool_length_mm=LENGTH, setup=Setup(one_tool=False))  # all tools of one length


@pytest.fixture(scope="module")
def trunnion() -> Machine:
    return Machine.load("xyzbc_trunnion")


@pytest.fixture(scope="module")
def errors(trunnion: Machine) -> Calibration:
    return random_calibration(trunnion, np.random.default_rng(1), size=30.0)


def compensated(program: Path, machine: Machine, errors: Calibration) -> Compensation:
    read, dialect = read_program(program)
    return Compensator(machine, errors, OPTIONS).compensate(read, dialect)


@pytest.mark.parametrize(
    "name",
    [
        "linuxcnc_boat-xyzbc.ngc",
        "spinnerU5_Bottle_opener_Flaschenoeffner.txt",
        "spinnerU5_Keychain_Schluesselanhaenger.mpf",
    ],
)
def test_read_and_written_back_unchanged(programs: Path, trunnion: Machine, name: str) -> None:
    read, dialect = read_program(programs / name)
    assert read.text.encode("latin-1") == (programs / name).read_bytes()
    nothing = Compensator(trunnion, Calibration.zero(trunnion), OPTIONS)
    result = nothing.compensate(read, dialect)
    assert result.text.encode("latin-1") == (programs / name).read_bytes()
    assert result.report.rewritten == 0


@pytest.mark.parametrize("name", ["linuxcnc_boat-xyzbc.ngc", "spinnerU5_Keychain_Schluesselanhaenger.mpf"])
def test_compensated_on_a_machine_of_the_same_kind(
    programs: Path, trunnion: Machine, errors: Calibration, name: str
) -> None:
    result = compensated(programs / name, trunnion, errors)
    report = result.report
    assert report.before.rms_um > 8.0
    assert report.rounding_um <= ROUNDING_UM
    assert report.after.max_um <= ROUNDING_UM + 1.0
    assert not [one for one in report.not_corrected if one.kind == "tolerance"]
    # Every move is rewritten or listed in a note.
    noted = {note.line for note in report.notes} | {line for one in report.not_corrected for line in one.lines}
    read, dialect = read_program(programs / name)
    reading = dialect.moves(read, Compensator(trunnion, errors, OPTIONS).prepared.space.axes, tcp=False)
    for move, count in zip(reading.moves, result.new.count, strict=True):
        assert count or move.line + 1 in noted


def test_the_compensated_boat_is_on_the_nominal_path(programs: Path, trunnion: Machine, errors: Calibration) -> None:
    """The output executed by an independent interpreter: TCP words → nominal commands → Pinocchio's chain with errors."""
    name = "linuxcnc_boat-xyzbc.ngc"
    original = (programs / name).read_text()
    result = compensated(programs / name, trunnion, errors)
    body = slice(2, -10)  # between the first block with every axis known and the retract at the end
    meant = np.array([q for _, q in run_iso(original)])[body]
    done = np.array([q for _, q in run_iso(result.text)])
    assert result.report.added == 2
    nominal = Kinematics(trunnion, Calibration.zero(trunnion), tool_length_mm=LENGTH)
    real = Kinematics(trunnion, errors, tool_length_mm=LENGTH)

    def commands(words: np.ndarray) -> np.ndarray:
        start = np.concatenate([np.zeros((len(words), 3)), words[:, 3:]], axis=1)
        return (
            Inverse(nominal).solve(Poses(words[:, :3], nominal.forward(start).rotation), start, rotary=False).positions
        )

    reached = commands(done[2:])
    frames = real.error_frames(reached)
    data = trunnion.model.createData()
    tip = pin.SE3(np.eye(3), np.array([0.0, 0.0, -LENGTH * 1e-3]))
    points = []
    for q, e in zip(reached, frames, strict=True):
        pin.framesForwardKinematics(trunnion.model, data, trunnion.configuration(q * trunnion.scale, e))
        pose = data.oMf[trunnion.work_frame].actInv(data.oMf[trunnion.tool_frame]) * tip
        points.append(pose.translation * 1e3)
    # Every nominal point is reached in order; the two added blocks lie between.
    k = 0
    for wanted in meant[:, :3]:
        while np.linalg.norm(points[k] - wanted) * 1e3 > ROUNDING_UM:
            k += 1
            assert k < len(points), wanted
    assert k <= len(meant) + 12


def test_execution_follows_the_program(dmu50: Machine, calibration: Calibration) -> None:
    """The data of the scene: end points as programmed, dense points between, deviations equal to those of the kinematics."""
    read, dialect = read_program("cone_frustum.nc")
    prepared = Compensator(dmu50, calibration, Options(tool_length_mm=120.0)).prepared
    path = follow(read, dialect.moves(read, prepared.space.axes, tcp=False), prepared.space)
    run = execute(read, path, prepared.space, prepared.real)
    assert run.left_out == 0
    ends = run.positions[run.ends]
    assert ends == pytest.approx(np.array([q for _, q in run_iso(read.text)]), abs=1e-9)
    assert np.abs(np.diff(run.positions, axis=0))[:, :3].max() <= 10.0 + 1e-9
    assert run.meant_mm == pytest.approx(prepared.space.nominal.forward(run.positions).point_mm)
    deviation = np.linalg.norm(run.reached_mm - run.meant_mm, axis=1) * 1e3
    assert 20.0 < deviation.max() < 200.0
    assert np.count_nonzero(~run.cutting) < 40
