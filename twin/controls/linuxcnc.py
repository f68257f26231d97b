"""Run LinuxCNC without a display: a configuration for the axes of a machine, a list of actions, the recorded pins."""

from __future__ import annotations

import getpass
import json
import os
import pwd
import shutil
import signal
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from time import sleep
from typing import Any, Final, final
from uuid import uuid4

import numpy as np

from twin._common.bundled import DEFAULT_ACCELERATION
from twin._common.errors import InputError
from twin.machine.machine import Machine

PROGRAMS: Final = ("linuxcnc", "halcmd", "halsampler", "setpriv")
LOCK: Final = Path("/tmp/linuxcnc.lock")
MARK: Final = "TWIN_CONTROL"
"""Variable in the environment of every process of a run."""
LOST: Final = "USRMOT: ERROR: command timeout"
"""In its output where a command did not reach the motion controller; a refused one is an "invalid command" and has a message."""
PERIOD_S: Final = 0.001
_LIMITS: Final = "MIN_LIMIT = {low}\nMAX_LIMIT = {high}\nMAX_VELOCITY = 500\nMAX_ACCELERATION = {acceleration}"


@final
@dataclass(frozen=True)
class Ran:
    """Results of a run of the control: those of all actions by name, messages, why they ended early (or empty), pins, output."""

    done: list[tuple[str, Any]]
    said: list[str]
    failed: str
    folder: Path
    pins: int
    log: str

    def samples(self, name: str) -> np.ndarray:
        """Return the pins recorded into a file: (n, pins); raise `InputError` if the computer was too slow for all samples."""
        rows = [line.split() for line in (self.folder / name).read_text().splitlines()]
        # Samples lost before the first one do not matter.
        rows = rows[sum(row == ["overrun"] for row in rows[:1]) :]
        if not all(len(row) >= self.pins for row in rows[:-1]):
            raise InputError("samples of the control were lost", expected="a computer that is less busy")
        return np.array([row[-self.pins :] for row in rows if len(row) >= self.pins], dtype=float)

    def results(self, name: str) -> list[Any]:
        """Return the results of all actions of a name."""
        return [result for action, result in self.done if action == name]


@final
@dataclass(frozen=True)
class Configuration:
    """Configuration of the control.

    Attributes:
        home: position of every axis at which it stands at first.
        kinematics: the module; by default that of axes without a transformation.
        hal: further lines of HAL, after motmod is loaded.
        pins: pins or signals that are recorded by the action ``record``, every millisecond; whole numbers begin with ``#``.
        ini: further sections of the INI file.
        joints: further lines of the section of a joint, by its number.
        acceleration: largest acceleration, mm/s² and °/s².
    """

    machine: Machine
    home: Mapping[str, float]
    kinematics: str = ""
    hal: str = ""
    pins: Sequence[str] = ()
    ini: str = ""
    joints: Mapping[int, str] = field(default_factory=dict)
    tools: str = ""
    parameters: str = ""
    acceleration: float = DEFAULT_ACCELERATION
    period_s: float = PERIOD_S

    def write(self, folder: Path) -> None:
        """Write the files of the configuration into a folder."""
        (folder / "machine.ini").write_text(self._ini() + self.ini)
        (folder / "machine.hal").write_text(self._hal() + self.hal + _sampler(self.pins))
        (folder / "tool.tbl").write_text(self.tools)
        (folder / "machine.var").write_text(self.parameters)

    def _ini(self) -> str:
        names = self.machine.names
        kinematics = self.kinematics or f"trivkins coordinates={''.join(names)}"
        lines = [
            "[EMC]\nMACHINE = twin\nDEBUG = 0\nVERSION = 1.1",
            "[DISPLAY]\nDISPLAY = ./display\nCYCLE_TIME = 0.1\nPROGRAM_PREFIX = .\nINTRO_TIME = 0",
            "[TASK]\nTASK = milltask\nCYCLE_TIME = 0.001",
            "[RS274NGC]\nPARAMETER_FILE = ./machine.var",
            f"[EMCMOT]\nEMCMOT = motmod\nCOMM_TIMEOUT = 20.0\nSERVO_PERIOD = {round(self.period_s * 1e9)}",
            "[EMCIO]\nEMCIO = io\nCYCLE_TIME = 0.1\nTOOL_TABLE = ./tool.tbl",
            "[HAL]\nHALFILE = ./machine.hal",
            f"[TRAJ]\nCOORDINATES = {' '.join(names)}\nLINEAR_UNITS = mm\nANGULAR_UNITS = degree\nDEFAULT_LINEAR_VELOCITY = 200\n"
            f"MAX_LINEAR_VELOCITY = 500\nMAX_LINEAR_ACCELERATION = {self.acceleration}\nNO_FORCE_HOMING = 1",
            f"[KINS]\nKINEMATICS = {kinematics}\nJOINTS = {len(names)}",
        ]
        for i, axis in enumerate(self.machine.axes):
            # Room for the corrections beyond the ranges; an axis without limits is given some turns.
            low, high = (-7200.0, 7200.0) if axis.lower is None else (axis.domain[0] - 100.0, axis.domain[1] + 100.0)
            bounds = _LIMITS.format(low=low, high=high, acceleration=self.acceleration)
            kind = "LINEAR" if axis.linear else "ANGULAR"
            home = self.home[axis.name]
            lines.append(f"[AXIS_{axis.name}]\n{bounds}")
            lines.append(
                f"[JOINT_{i}]\nTYPE = {kind}\n{bounds}\nFERROR = 50\nMIN_FERROR = 10\nHOME_SEQUENCE = 0\n"
                f"HOME = {home}\nHOME_OFFSET = {home}\n{self.joints.get(i, '')}"
            )
        return "\n".join(lines) + "\n"

    def _hal(self) -> str:
        lines = [
            "loadrt [KINS]KINEMATICS",
            "loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS",
            "addf motion-command-handler servo-thread",
            "addf motion-controller servo-thread",
            *(
                f"net motor-{i} joint.{i}.motor-pos-cmd => joint.{i}.motor-pos-fb"
                for i in range(len(self.machine.names))
            ),
            "net estop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in",
            "net tool-prepare iocontrol.0.tool-prepare => iocontrol.0.tool-prepared",
            "net tool-change iocontrol.0.tool-change => iocontrol.0.tool-changed",
        ]
        return "\n".join(lines) + "\n"


def _sampler(pins: Sequence[str]) -> str:
    """Return the lines that record pins, or signals (names without a dot)."""
    if not pins:
        return ""
    lines = [
        f"loadrt sampler depth=200000 cfg={''.join('s' if pin.startswith('#') else 'f' for pin in pins)}",
        "addf sampler.0 servo-thread",
        "setp sampler.0.enable 0",
    ]
    for i, pin in enumerate(name.lstrip("#") for name in pins):
        lines.append(f"net {f'sampled-{i} {pin}' if '.' in pin else pin} => sampler.0.pin.{i}")
    return "\n".join(lines) + "\n"


def run(
    folder: Path, configuration: Configuration, actions: Sequence[Sequence[Any]], *, user: str = "", seconds: float
) -> Ran:
    """Run the control in a folder, and leave no process, lock or shared memory of it behind.

    Args:
        folder: an empty folder; files that programs need may be in it already.
        configuration: the control's configuration.
        actions: name and arguments of each, as in `linuxcnc_display.txt`.
        user: who runs it; the control refuses root.
        seconds: longest time.

    Raises:
        InputError: the control is not installed, does not start or end, or is to run as root.
    """
    check(user)
    (folder / "actions.json").write_text(json.dumps([*map(list, actions)]))
    configuration.write(folder)
    display = folder / "display"
    display.write_text(resources.files("twin.controls").joinpath("linuxcnc_display.txt").read_text(encoding="utf-8"))
    display.chmod(0o755)
    log = _run(folder, user or getpass.getuser(), seconds)
    if LOST in log:
        # It goes on with the next action, as if the program had ended.
        raise InputError("commands to the control were lost", expected="a computer that is less busy", value=LOST)
    results = folder / "results.json"
    if not results.exists():
        raise InputError("LinuxCNC does not start", expected="a control that runs here", value=log[-600:].strip())
    found = json.loads(results.read_text())
    done = [(name, result) for name, result in found["done"]]
    failed = (found["failed"] or "").strip().rpartition("\n")[2]
    return Ran(done, found["said"], failed, folder, len(configuration.pins), log)


def check(user: str = "") -> None:
    """Raise `InputError` if the control cannot run: it is missing, it is running already, or it would run as root."""
    missing = [name for name in PROGRAMS if shutil.which(name) is None]
    if missing:
        expected = "LinuxCNC 2.9 (Debian: apt-get install linuxcnc-uspace)"
        raise InputError("LinuxCNC is not installed", expected=expected, value=missing[0])
    if os.geteuid() == 0 and user in ("", "root"):
        expected = "an ordinary user, or the name of one for the control"
        raise InputError("LinuxCNC does not run as root", expected=expected, value="root", setting="user")
    if user:
        try:
            number = pwd.getpwnam(user).pw_uid
        except KeyError:
            raise InputError("no such user", expected="a user of this computer", value=user, setting="user") from None
        if os.geteuid() not in (0, number):
            expected = "no other user, or root to choose one"
            what = "only root runs the control as another user"
            raise InputError(what, expected=expected, value=user, setting="user")
    if LOCK.exists():
        raise InputError("LinuxCNC is running already", expected="none, or no lock that one left behind", file=LOCK)


def _run(folder: Path, user: str, seconds: float) -> str:
    words = ["linuxcnc", "-r", "machine.ini"]
    if os.geteuid() == 0:
        for path in (folder, *folder.rglob("*")):
            shutil.chown(path, user)
        words = ["setpriv", f"--reuid={user}", f"--regid={user}", "--init-groups", *words]
    mark = uuid4().hex
    environment = {"PATH": "/usr/bin:/bin:/usr/sbin:/sbin", "HOME": str(folder), "USER": user, "LANG": "C.UTF-8"}
    # The control makes this socket in HOME, and does not start if the path is longer than a hundred characters.
    environment["RTAPI_FIFO_PATH"] = str(_socket(mark))
    with _cleaned(mark, user), (folder / "log.txt").open("w+") as log:
        process = subprocess.Popen(
            words,
            cwd=folder,
            env={**environment, MARK: mark},
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
        )
        try:
            process.wait(seconds)
        except subprocess.TimeoutExpired:
            what = f"the control did not end within {seconds:.0f} s"
            raise InputError(what, expected="a shorter program, or more time") from None
        finally:
            _end(process, mark)
    return (folder / "log.txt").read_text(errors="replace")


def _end(process: subprocess.Popen[bytes], mark: str) -> None:
    """Let the control end by itself, as it does after its display."""
    if process.poll() is None:
        for display in _marked(mark):
            with suppress(OSError):
                if Path(f"/proc/{display}/comm").read_text().strip() == "display":
                    os.kill(display, signal.SIGTERM)
        with suppress(subprocess.TimeoutExpired):
            process.wait(15.0)


@contextmanager
def _cleaned(mark: str, user: str) -> Iterator[None]:
    """End at exit what was started within, and remove its shared memory and its lock; nothing that was there before."""
    before = _memory(user)
    try:
        yield
    finally:
        while found := _marked(mark):
            for process in found:
                with suppress(ProcessLookupError):
                    os.kill(process, signal.SIGKILL)
            sleep(0.05)
        for memory in _memory(user) - before:
            subprocess.run(["ipcrm", "-m", memory], check=False, capture_output=True)
        LOCK.unlink(missing_ok=True)
        _socket(mark).unlink(missing_ok=True)


def _socket(mark: str) -> Path:
    return LOCK.with_name(f"twin-{mark}.fifo")


def _marked(mark: str) -> list[int]:
    """Return the processes with a mark in their environment."""
    wanted, found = f"{MARK}={mark}".encode(), []
    for path in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):
            if wanted in path.read_bytes().split(b"\0"):
                found.append(int(path.parent.name))
    return found


def _memory(user: str) -> set[str]:
    """Return the numbers of a user's pieces of shared memory."""
    rows = [line.split() for line in Path("/proc/sysvipc/shm").read_text().splitlines()[1:]]
    return {row[1] for row in rows if row[7] == str(pwd.getpwnam(user).pw_uid)}
