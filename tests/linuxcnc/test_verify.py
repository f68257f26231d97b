"""`twin verify --control linuxcnc`: the control executes a program and its compensated form."""

from __future__ import annotations

import getpass
import json
import os
import pwd
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import twin
from tests.linuxcnc.control import USER, needs_linuxcnc, needs_root, skip_without_control, user_for
from tests.truth.machine import TruthMachine
from twin._common.bundled import DEFAULT_ACCELERATION
from twin.compensation import Compensator, Options
from twin.compensation.verification import Verification, on_exact_path, verify
from twin.controls import linuxcnc

pytestmark = [needs_linuxcnc]
TOOL = 120.0
CORNER_UM = 1e3 * DEFAULT_ACCELERATION * linuxcnc.PERIOD_S**2 / 6.0 + 0.05
"""At a corner on the exact path: the control's interpolation, (x₋₁ + 4x₀ + x₁)/6, joins the last and the first step, a·T² at most."""
LINE = "G21 G90 {}\nG0 X100 Y225 Z-200 B0 C0\nG1 X400 F9000\nY325\nG0 Z-100\nM2\n"


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> twin.Machine:
    machine = twin.Machine.load("dmu50")
    skip_without_control(tmp_path_factory.mktemp("plain"), machine)
    return machine


def verified(
    text: str, machine: twin.Machine, folder: Path, setup: twin.Setup | None = None, **others: float
) -> Verification:
    path = folder / "part.ngc"
    path.write_text(text)
    options = Options(tool_length_mm=TOOL, setup=twin.Setup() if setup is None else setup)
    compensator = Compensator(machine, twin.Calibration.default(machine), options)
    return verify(path, compensator, user=user_for(folder), seconds=120.0, **others)


@needs_root
def test_the_error_over_the_motion_is_that_of_the_machine(machine: twin.Machine, tmp_path: Path) -> None:
    """On two lines of the axes, the distance from the path is the error across them: by the machine in plain numpy."""
    user_for(tmp_path / "folder of the control")
    (tmp_path / "part.ngc").write_text(LINE.format("G61"))
    target = tmp_path / "found.json"
    words = ["--control", "linuxcnc", "--tool-length", "120", "--user", USER, "--json", str(target)]
    done = command(str(tmp_path / "part.ngc"), *words, "--tolerance", "0.00001")
    assert done.returncode == 3, done.stderr
    assert "compensated program" in done.stdout and "exact path, G61" in done.stdout and "ILLUSTRATIVE" in done.stdout
    found = json.loads(target.read_text())
    assert found["schema"] == "twin.verification/1"
    truth = TruthMachine(twin.Calibration.default(machine).path, TOOL)
    lines = (np.linspace(100.0, 400.0, 31), np.linspace(225.0, 325.0, 31))
    along_x = [np.array([x, 225.0, -200.0, 0.0, 0.0]) for x in lines[0]]
    along_y = [np.array([400.0, y, -200.0, 0.0, 0.0]) for y in lines[1]]
    across = []
    for poses, axis in ((along_x, 0), (along_y, 1)):
        errors = np.array([(truth.pose(q) - truth.pose(q, real=False)) @ [0, 0, 0, 1] for q in poses])[:, :3]
        across += np.linalg.norm(np.delete(errors, axis, axis=1), axis=1).tolist()
    before = found["before"]
    assert before["largest_um"] == pytest.approx(1e3 * max(across), rel=0.1)
    assert 1e3 * min(across) < before["median_um"] < 1e3 * max(across)
    assert found["samples"]["before"] > 1500
    for own in (found["control_itself"], found["control_exact_path"]):
        assert own["largest_um"] < CORNER_UM and own["median_um"] < 0.01
    assert found["after"]["largest_um"] < 1.5 < 0.1 * before["largest_um"]


TABLES = """G21 G90 G61 G17 G94
T1 M6
G54 G43 H1
G0 X-100 Y0 Z59.5 B0 C0
G1 X100 F9000
G0 Z100
T2 M6
G59.3 G43 H2
G0 X50 Y0
Z69.75
G1 Y100
G10 L20 P9 X0 Y0 Z0
G1 X50
G10 L2 P3 X300 Y300 Z-280.25 B0 C0
G56 G1 X0 Y-50 Z0
M2
"""
WAYS = (
    (120.5, (150.0, 225.0), (350.0, 225.0)),
    (80.25, (250.0, 200.0), (250.0, 300.0)),
    (80.25, (250.0, 300.0), (300.0, 300.0)),
    (80.25, (300.0, 300.0), (300.0, 250.0)),
)
"""Length of the tool, and X and Y at both ends of each feed of `TABLES` at Z -200, by hand."""


def test_tables_of_offsets_and_tools(machine: twin.Machine, tmp_path: Path) -> None:
    """The control executes G43 H, G54, G55, G56, G59.3 and G10 with its own tables; the error is that of each tool's length."""
    (tmp_path / "machine.var").write_text("5220 1\n5221 250\n5222 225\n5223 -380\n5381 200\n5382 200\n5383 -350\n")
    (tmp_path / "tool.tbl").write_text("T1 P1 Z+120.5 D6 ; ball\nT2 P2 Z80.25\n")
    setup = twin.Setup(
        offsets=twin.load_offsets(tmp_path / "machine.var"), tools=twin.load_tools(tmp_path / "tool.tbl")
    )
    found = verified(TABLES, machine, tmp_path, setup)
    across = []
    for length, begin, end in WAYS:
        truth = TruthMachine(twin.Calibration.default(machine).path, length)
        along = int(begin[0] == end[0])
        for share in np.linspace(0.0, 1.0, 31):
            q = np.array([*(np.array(begin) + share * np.subtract(end, begin)), -200.0, 0.0, 0.0])
            error = ((truth.pose(q) - truth.pose(q, real=False)) @ [0, 0, 0, 1])[:3]
            across.append(np.linalg.norm(np.delete(error, along)))
    # The path is met nearest by, at its corners.
    assert found.before.largest_um == pytest.approx(1e3 * max(across), rel=0.02)
    assert 1e3 * min(across) < found.before.median_um < 1e3 * max(across)
    assert found.control.largest_um < CORNER_UM and found.after.largest_um < 2.0


@pytest.mark.slow
def test_words_that_the_control_reads_otherwise_are_refused(machine: twin.Machine, tmp_path: Path) -> None:
    """With a table of offsets alone, twin adds the length of the tool; without G43 the control does not."""
    (tmp_path / "machine.var").write_text("5220 1\n5221 250\n5222 225\n5223 -380\n")
    setup = twin.Setup(offsets=twin.load_offsets(tmp_path / "machine.var"))
    with pytest.raises(twin.InputError, match="moves to other positions") as raised:
        verified("G21 G90 G61\nG54 G0 X-50 Y0 Z100 B0 C0\nG1 X50 F9000\nM2\n", machine, tmp_path, setup)
    assert raised.value.line == 3 and "G1 X50 F9000: 120.0" in str(raised.value)
    found = verified("G21 G90 G61\nT7 M6 G43\nG54 G0 X-50 Y0 Z60 B0 C0\nG1 X50 F9000\nM2\n", machine, tmp_path, setup)
    assert found.after.largest_um < 1.5


@needs_root
def test_an_ordinary_user_needs_no_name_of_one(machine: twin.Machine, tmp_path: Path) -> None:
    """The control runs as the present user, and leaves nothing behind; only root chooses another one."""
    user = pwd.getpwnam(user_for(tmp_path / "folder of the control"))
    (tmp_path / "part.ngc").write_text("G21 G90 G61\nG0 X100 Y225 Z-200 B0 C0\nG1 X150 F9000\nM2\n")
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        status = 1
        try:
            os.setgid(user.pw_gid)
            os.setuid(user.pw_uid)
            os.environ["USER"] = user.pw_name
            compensator = Compensator(machine, twin.Calibration.default(machine), Options(tool_length_mm=TOOL))
            with pytest.raises(twin.InputError, match="only root runs the control as another user"):
                verify(tmp_path / "part.ngc", compensator, user="daemon")
            found = verify(tmp_path / "part.ngc", compensator, seconds=60.0)
            os.write(writer, found.brief.encode())
            status = 0
        except BaseException as error:
            os.write(writer, repr(error).encode())
        finally:
            os._exit(status)
    os.close(writer)
    said = os.read(reader, 100_000).decode()
    _, status = os.waitpid(child, 0)
    assert status == 0, said
    assert "µm largest before" in said and not linuxcnc.LOCK.exists()


@pytest.mark.slow  # 17 s, in which the control moves
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


def _interrupted(words: list[str], folder: Path, started: Callable[[], bool]) -> tuple[int, str]:
    """Return exit status and messages of a command that is interrupted a second after the control has started."""
    process = subprocess.Popen(
        words,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "TMPDIR": str(folder)},
        # Tests that run in the background of a shell have this signal ignored, and their processes with them.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    for _ in range(300):
        if process.poll() is not None or (linuxcnc.LOCK.exists() and started()):
            break
        time.sleep(0.1)
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=30)
    return process.returncode, said


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
    long = tmp_path / ("a long path " * 6)
    long.mkdir()
    user_for(long / "folder of the control")
    code, said = _interrupted([*words, "--user", user], long, lambda: bool(linuxcnc._memory(user) - memory))
    assert code == 130, said
    assert not linuxcnc.LOCK.exists() and linuxcnc._memory(user) == memory
    for _ in range(20):  # until their parent has taken note of their end
        if not _running():
            break
        time.sleep(0.1)
    assert not _running()
    assert not list(long.iterdir()) and not list(linuxcnc.LOCK.parent.glob("twin-*.fifo"))


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
