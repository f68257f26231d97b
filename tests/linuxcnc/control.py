"""Run LinuxCNC without a display: a configuration for the axes of a machine, a list of actions, the recorded pins."""

from __future__ import annotations

import getpass
import json
import os
import pwd
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin

USER = "twincontrol"
"""LinuxCNC refuses root: tests that run as root use this user, made for it."""
INSTALLED = all(map(shutil.which, ("linuxcnc", "halcompile", "halcmd", "make", "gcc", "setpriv")))
needs_linuxcnc = pytest.mark.skipif(
    not INSTALLED, reason="needs LinuxCNC and a compiler: apt-get install linuxcnc-uspace linuxcnc-uspace-dev make gcc"
)
needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="halcompile --install needs root")
DRIVER = Path(__file__).with_name("driver.py")
LETTERS = "XYZABCUVW"


@dataclass(frozen=True)
class Ran:
    """Results of a run of the control.

    Attributes:
        done: name and result of every action.
        said: messages of the control.
        folder: where it ran.
        pins: number of recorded pins.
        log: output of the control.
    """

    done: list[tuple[str, Any]]
    said: list[str]
    folder: Path
    pins: int
    log: str

    def samples(self, name: str) -> np.ndarray:
        """Return what was recorded into a file: (n, pins)."""
        rows = [line.split() for line in (self.folder / name).read_text().splitlines()]
        # Samples lost before the first one do not matter.
        rows = rows[sum(row == ["overrun"] for row in rows[:1]) :]
        assert all(len(row) >= self.pins for row in rows[:-1]), "no sample was lost"
        return np.array([row[-self.pins :] for row in rows if len(row) >= self.pins], dtype=float)

    def results(self, name: str) -> list[Any]:
        """Return the results of all actions of a name."""
        return [result for action, result in self.done if action == name]


def control(
    folder: Path,
    machine: twin.Machine,
    actions: Sequence[Sequence[Any]],
    *,
    home: Mapping[str, float],
    kinematics: str = "",
    hal: str = "",
    pins: Sequence[str] = (),
    ini: str = "",
    tools: str = "",
    seconds: float = 300.0,
) -> Ran:
    """Run the control in a folder.

    Args:
        folder: an empty folder; files that programs need may be in it already.
        machine: the machine whose axes it has.
        actions: name and arguments of each, as in `driver.py`.
        home: position of every axis at which it stands at first.
        kinematics: the module; by default that of axes without a transformation.
        hal: further lines of HAL, after motmod is loaded.
        pins: pins or signals that are recorded by the action ``record``, every millisecond.
        ini: further sections of the INI file.
        tools: the tool table.
        seconds: longest time.
    """
    (folder / "actions.json").write_text(json.dumps([*map(list, actions)]))
    (folder / "machine.ini").write_text(
        _ini(machine, home, kinematics or f"trivkins coordinates={''.join(machine.names)}") + ini
    )
    (folder / "machine.hal").write_text(_hal(machine) + hal + _sampler(pins))
    (folder / "tool.tbl").write_text(tools)
    shutil.copy(DRIVER, folder / "driver.py")
    (folder / "driver.py").chmod(0o755)
    done = _run(folder, ["linuxcnc", "-r", "machine.ini"], seconds)
    log = done.stdout + done.stderr
    assert (folder / "results.json").exists(), log
    results = json.loads((folder / "results.json").read_text())
    assert results["failed"] is None, f"{results['failed']}\n{results['said']}\n{log}"
    return Ran([(name, result) for name, result in results["done"]], results["said"], folder, len(pins), log)


def skip_without_control(folder: Path, machine: twin.Machine) -> None:
    """Skip the test if the control itself, with its own kinematics, does not start on this computer (no shared memory, for example)."""
    try:
        control(folder, machine, [["home"]], home=dict.fromkeys(machine.names, 1.0), seconds=60.0)
    except AssertionError as error:
        pytest.skip(f"LinuxCNC does not start on this computer: {str(error)[-300:]}")


def _run(folder: Path, words: list[str], seconds: float) -> subprocess.CompletedProcess[str]:
    user = getpass.getuser()
    if os.geteuid() == 0:
        user = USER
        try:
            pwd.getpwnam(USER)
        except KeyError:
            subprocess.run(["useradd", "--create-home", USER], check=True)
        for path in (folder, *folder.rglob("*")):
            shutil.chown(path, USER)
        for path in folder.parents:
            if path.stat().st_uid == 0 and path != Path("/") and not path.stat().st_mode & 1:
                path.chmod(path.stat().st_mode | 0o011)
        words = ["setpriv", f"--reuid={USER}", f"--regid={USER}", "--init-groups", *words]
    home = pwd.getpwnam(user).pw_dir
    environment = {"PATH": "/usr/bin:/bin:/usr/sbin:/sbin", "HOME": home, "USER": user, "LANG": "C.UTF-8"}
    try:
        return subprocess.run(
            words,
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            timeout=seconds,
            check=False,
            stdin=subprocess.DEVNULL,
        )
    except subprocess.TimeoutExpired as error:
        raise AssertionError(f"the control did not end: {error.stdout}\n{error.stderr}") from None
    finally:
        _clean(user)


def _clean(user: str) -> None:
    """End what the control left, and remove its lock and its shared memory."""
    for name in ("linuxcnc", "milltask", "rtapi_app", "linuxcncsvr", "halsampler", "io"):
        subprocess.run(["pkill", "-9", "-u", user, "-x", name], check=False)
    Path("/tmp/linuxcnc.lock").unlink(missing_ok=True)
    listed = subprocess.run(["ipcs", "-m"], capture_output=True, text=True, check=False).stdout
    for line in listed.splitlines():
        words = line.split()
        if len(words) > 3 and words[2] == user:
            subprocess.run(["ipcrm", "-m", words[1]], check=False)


def _ini(machine: twin.Machine, home: Mapping[str, float], kinematics: str) -> str:
    lines = [
        "[EMC]\nMACHINE = twin\nDEBUG = 0\nVERSION = 1.1",
        "[DISPLAY]\nDISPLAY = ./driver.py\nCYCLE_TIME = 0.1\nPROGRAM_PREFIX = .\nINTRO_TIME = 0",
        "[TASK]\nTASK = milltask\nCYCLE_TIME = 0.001",
        "[RS274NGC]\nPARAMETER_FILE = ./machine.var",
        "[EMCMOT]\nEMCMOT = motmod\nCOMM_TIMEOUT = 1.0\nSERVO_PERIOD = 1000000",
        "[EMCIO]\nEMCIO = io\nCYCLE_TIME = 0.1\nTOOL_TABLE = ./tool.tbl",
        "[HAL]\nHALFILE = ./machine.hal",
        f"[TRAJ]\nCOORDINATES = {' '.join(machine.names)}\nLINEAR_UNITS = mm\nANGULAR_UNITS = degree\nDEFAULT_LINEAR_VELOCITY = 200\n"
        "MAX_LINEAR_VELOCITY = 500\nMAX_LINEAR_ACCELERATION = 5000\nNO_FORCE_HOMING = 1",
        f"[KINS]\nKINEMATICS = {kinematics}\nJOINTS = {len(machine.names)}",
    ]
    limits = "MIN_LIMIT = {low}\nMAX_LIMIT = {high}\nMAX_VELOCITY = 500\nMAX_ACCELERATION = 5000"
    for i, axis in enumerate(machine.axes):
        # Room for the corrections beyond the ranges; an axis without limits is given some turns.
        low, high = (-7200.0, 7200.0) if axis.lower is None else (axis.domain[0] - 100.0, axis.domain[1] + 100.0)
        bounds = limits.format(low=low, high=high)
        lines.append(f"[AXIS_{axis.name}]\n{bounds}")
        lines.append(
            f"[JOINT_{i}]\nTYPE = {'LINEAR' if axis.linear else 'ANGULAR'}\n{bounds}\nFERROR = 50\nMIN_FERROR = 10\nHOME_SEQUENCE = 0\n"
            f"HOME = {home[axis.name]}\nHOME_OFFSET = {home[axis.name]}"
        )
    return "\n".join(lines) + "\n"


def _hal(machine: twin.Machine) -> str:
    lines = [
        "loadrt [KINS]KINEMATICS",
        "loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS",
        "addf motion-command-handler servo-thread",
        "addf motion-controller servo-thread",
        *(f"net motor-{i} joint.{i}.motor-pos-cmd => joint.{i}.motor-pos-fb" for i in range(len(machine.names))),
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
        f"loadrt sampler depth=200000 cfg={'f' * len(pins)}",
        "addf sampler.0 servo-thread",
        "setp sampler.0.enable 0",
    ]
    lines += [f"net {f'sampled-{i} {pin}' if '.' in pin else pin} => sampler.0.pin.{i}" for i, pin in enumerate(pins)]
    return "\n".join(lines) + "\n"
