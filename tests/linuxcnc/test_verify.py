"""`twin verify --control linuxcnc`: the control executes a program and its compensated form."""

from __future__ import annotations

import getpass
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import twin
from tests.linuxcnc.control import USER, needs_linuxcnc, needs_root, skip_without_control, user_for
from tests.truth.machine import TruthMachine
from twin.compensation import Compensator, Options
from twin.compensation.verification import Verification, on_exact_path, verify
from twin.controls import linuxcnc

pytestmark = [needs_linuxcnc, pytest.mark.xdist_group("linuxcnc")]
TOOL = 120.0
LINE = "G21 G90 {}\nG0 X100 Y225 Z-200 B0 C0\nG1 X400 F9000\nY325\nG0 Z-100\nM2\n"


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> twin.Machine:
    machine = twin.Machine.load("dmu50")
    skip_without_control(tmp_path_factory.mktemp("plain"), machine)
    return machine


def verified(text: str, machine: twin.Machine, folder: Path, **others: float) -> Verification:
    path = folder / "part.ngc"
    path.write_text(text)
    compensator = Compensator(machine, twin.Calibration.default(machine), Options(tool_length_mm=TOOL))
    return verify(path, compensator, user=user_for(folder), seconds=120.0, **others)


def test_the_error_over_the_motion_is_that_of_the_machine(machine: twin.Machine, tmp_path: Path) -> None:
    """On two lines of the axes, the distance from the path is the error across them: by the machine in plain numpy."""
    found = verified(LINE.format("G61"), machine, tmp_path)
    truth = TruthMachine(twin.Calibration.default(machine).path, TOOL)
    lines = (np.linspace(100.0, 400.0, 31), np.linspace(225.0, 325.0, 31))
    along_x = [np.array([x, 225.0, -200.0, 0.0, 0.0]) for x in lines[0]]
    along_y = [np.array([400.0, y, -200.0, 0.0, 0.0]) for y in lines[1]]
    across = []
    for poses, axis in ((along_x, 0), (along_y, 1)):
        errors = np.array([(truth.pose(q) - truth.pose(q, real=False)) @ [0, 0, 0, 1] for q in poses])[:, :3]
        across += np.linalg.norm(np.delete(errors, axis, axis=1), axis=1).tolist()
    assert found.before.largest_um == pytest.approx(1e3 * max(across), rel=0.1)
    assert 1e3 * min(across) < found.before.median_um < 1e3 * max(across)
    assert found.samples[0] > 1500
    assert found.control.largest_um < 0.3 and found.control.median_um < 0.01
    assert found.exact.largest_um == pytest.approx(found.control.largest_um, abs=0.1)
    assert found.after.largest_um < 1.5 < 0.1 * found.before.largest_um


def test_corners_and_corrections_that_the_control_joins_are_its_own_share(
    machine: twin.Machine, tmp_path: Path
) -> None:
    """With a path tolerance above the corrections, the control joins the blocks that hold them."""
    found = verified(LINE.format("G64 P0.2"), machine, tmp_path, acceleration=1000.0)
    assert 50.0 < found.control.largest_um < 200.0 and 5.0 < found.control.median_um
    assert found.exact.largest_um < 0.3 and found.exact.median_um < 0.01
    assert found.after.largest_um == pytest.approx(found.control.largest_um, rel=0.1)
    assert found.after.median_um == pytest.approx(found.control.median_um, abs=1.0)


def test_the_exact_path_replaces_every_path_tolerance() -> None:
    text = "G21 (G64 P1) G64 P[#1*2] Q0.1\r\nP0.2 g064 ; G64 P2\nG4 P1\nG64 P#<tolerance> G1 X1\n"
    assert on_exact_path(text) == "G21 (G64 P1) G61  \r\n G61 ; G64 P2\nG4 P1\nG61  G1 X1\n"
    assert on_exact_path("G64.1 G640 G61\n") == "G64.1 G640 G61\n"


def test_what_the_control_refuses_is_quoted(machine: twin.Machine, tmp_path: Path) -> None:
    # 0.01 mm too small: twin takes it.
    with pytest.raises(twin.InputError, match=r"LinuxCNC refuses the program.*Arc radius too small") as raised:
        verified("G21 G90 G0 X100 Y225 Z-200 B0 C0\nG1 X110 F900\nG2 X130 Y225 R9.99\nM2\n", machine, tmp_path)
    assert raised.value.file == str(tmp_path / "part.ngc")
    assert not linuxcnc.LOCK.exists()


def command(*words: str, path: str | None = None) -> subprocess.CompletedProcess[str]:
    environment = os.environ if path is None else {**os.environ, "PATH": path}
    whole = [sys.executable, "-m", "twin.cli", "verify", *words]
    return subprocess.run(whole, capture_output=True, text=True, check=False, env=environment)


def test_clear_errors(tmp_path: Path) -> None:
    """Missing, as root, another language."""
    linux = ("--control", "linuxcnc", "--tool-length", "120")
    missing = command("cone_frustum.nc", *linux, path=str(tmp_path))
    assert missing.returncode == 2 and "LinuxCNC is not installed" in missing.stderr
    if os.geteuid() == 0:
        root = command("cone_frustum.nc", *linux)
        assert root.returncode == 2 and "does not run as root" in root.stderr and "--user" in root.stderr
    unknown = command("cone_frustum.nc", *linux, "--user", "no-user-of-that-name")
    assert unknown.returncode == 2 and "no such user" in unknown.stderr
    user = ["--user", "daemon"] if os.geteuid() == 0 else []
    other = command("cone_frustum.h", *linux, *user)
    assert other.returncode == 2 and "not a program of LinuxCNC" in other.stderr


def test_interrupted_it_leaves_nothing_behind(machine: twin.Machine, tmp_path: Path) -> None:
    user = user_for(tmp_path / "folder of the control") or getpass.getuser()
    memory = linuxcnc._memory(user)
    words = [
        sys.executable,
        "-m",
        "twin.cli",
        "verify",
        "cone_frustum.nc",
        "--control",
        "linuxcnc",
        "--tool-length",
        "120",
    ]
    process = subprocess.Popen(
        [*words, "--user", user],
        stderr=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(tmp_path)},
        # Tests that run in the background of a shell have this signal ignored, and their processes with them.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    for _ in range(300):
        if linuxcnc.LOCK.exists() and linuxcnc._memory(user) - memory:
            break
        time.sleep(0.1)
    assert linuxcnc.LOCK.exists() and _running()
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    assert process.wait(30) == 130
    assert not linuxcnc.LOCK.exists() and linuxcnc._memory(user) == memory
    for _ in range(20):  # until their parent has taken note of their end
        if not _running():
            break
        time.sleep(0.1)
    assert not _running()
    assert not list(tmp_path.iterdir())


def _running() -> list[str]:
    """Return the processes of the control."""
    found = []
    for path in Path("/proc").glob("[0-9]*/comm"):
        try:
            name = path.read_text().strip()
        except OSError:
            continue
        if name in ("milltask", "rtapi_app", "rtapi_app:T#0", "halsampler", "linuxcncsvr"):
            found.append(name)
    return found


@needs_root
def test_json(machine: twin.Machine, tmp_path: Path) -> None:
    (tmp_path / "part.ngc").write_text(LINE.format("G61"))
    target = tmp_path / "found.json"
    words = ["--control", "linuxcnc", "--tool-length", "120", "--user", USER, "--json", str(target)]
    done = command(str(tmp_path / "part.ngc"), *words, "--tolerance", "0.00001")
    assert done.returncode == 3, done.stderr
    found = json.loads(target.read_text())
    assert found["schema"] == "twin.verification/1" and found["before"]["largest_um"] > 20.0
    assert found["control_exact_path"]["largest_um"] < 0.3 and "exact path, G61" in done.stdout
    assert "compensated program" in done.stdout and "ILLUSTRATIVE" in done.stdout
