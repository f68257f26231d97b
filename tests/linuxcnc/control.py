"""The control in the tests: run as a user made for it, and skipped where it does not start."""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

import twin
from twin.controls.linuxcnc import PROGRAMS, Configuration, Ran, run

USER = "twincontrol"
"""LinuxCNC refuses root: tests that run as root use this user, made for it."""
INSTALLED = all(map(shutil.which, (*PROGRAMS, "halcompile", "make", "gcc")))
needs_linuxcnc = pytest.mark.skipif(
    not INSTALLED, reason="needs LinuxCNC and a compiler: apt-get install linuxcnc-uspace linuxcnc-uspace-dev make gcc"
)
needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="halcompile --install needs root")
LETTERS = "XYZABCUVW"


def user_for(folder: Path) -> str:
    """Return the user that runs the control, who may enter a folder; empty: the present one."""
    if os.geteuid() != 0:
        return ""
    try:
        pwd.getpwnam(USER)
    except KeyError:
        subprocess.run(["useradd", "--create-home", USER], check=True)
    for path in folder.parents:
        if path.stat().st_uid == 0 and path != Path("/") and not path.stat().st_mode & 1:
            path.chmod(path.stat().st_mode | 0o011)
    return USER


def control(
    folder: Path,
    machine: twin.Machine,
    actions: Sequence[Sequence[Any]],
    *,
    home: Mapping[str, float],
    seconds: float = 300.0,
    **others: Any,
) -> Ran:
    """Run the control in a folder; ``others``: see `Configuration`."""
    ran = run(folder, Configuration(machine, home, **others), actions, user=user_for(folder), seconds=seconds)
    assert not ran.failed, f"{ran.failed}\n{ran.said}\n{ran.log}"
    return ran


_REASONS: list[str] = []
"""Why the control does not start, empty if it does; one entry once it has been tried."""


def skip_without_control(folder: Path, machine: twin.Machine) -> None:
    """Skip the test if the control itself, with its own kinematics, does not start on this computer (no shared memory, for example)."""
    if not _REASONS:
        try:
            control(folder, machine, [["home"]], home=dict.fromkeys(machine.names, 1.0), seconds=60.0)
            _REASONS.append("")
        except (AssertionError, twin.InputError) as error:
            _REASONS.append(str(error)[-300:])
    if _REASONS[0]:
        pytest.skip(f"LinuxCNC does not start on this computer: {_REASONS[0]}")
