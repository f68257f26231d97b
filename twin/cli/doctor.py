"""``twin doctor``: what is installed, what is missing, and whether this machine computes what it should."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, Final

import numpy as np
import pinocchio as pin

from twin._common.errors import InputError, OutputError
from twin._common.json_form import json_form
from twin.cli.shared.command import CommandResult, JsonOption, command, progress
from twin.cli.shared.installation import Finding, browser, extras, packages, python, shown, size
from twin.compensation import Compensator, Options
from twin.compute.native import compiler, in_use, store
from twin.compute.native.loading import SWITCH, enabled
from twin.kinematics.forward import Kinematics
from twin.kinematics.inverse import Inverse, Status
from twin.machine.calibration import Calibration
from twin.machine.machine import DEFAULT, Machine
from twin.nc import dialect_for

SCHEMA: Final = "twin.doctor/1"
SLOW_START_S: Final = 5.0
"""Of processor time before a command begins: two are usual."""
SAME_MM: Final = 1e-9
"""Two formulations of one chain of 1 m in double precision."""
SAME_RAD: Final = 1e-11
LEAST_INCREMENTS: Final = 2.0
"""What rounding words to the least increment of 1 µm leaves at the tool of a five-axis block, µm."""
POSES: Final = 50

PROGRAM: Final = "G21 G90\nG1 X100 Y100 Z-200 B30 C40 F1000\nX140 Y130 Z-210 B35 C50\nX150\nM30\n"


@command("twin doctor", "twin doctor --json doctor.json")
def doctor(json_file: JsonOption = None) -> CommandResult:
    """What is installed, what is missing, and a short check that this machine computes what it should.

    The exit status is 0 if all that is needed is there and right, and 3 if a check failed. What is optional may be missing.
    """
    began = process_time()
    looked: tuple[tuple[str, Callable[[], list[Finding]]], ...] = (
        ("Python", lambda: [python(), *packages(), *extras(), browser(), _cache(), *size(), _start(began)]),
        ("compiler", lambda: [_compiler()]),
        ("machine", _checks),
    )
    found: list[Finding] = []
    clock = perf_counter()
    with progress() as say:
        for i, (stage, look) in enumerate(looked):
            say(stage, i / len(looked))
            found += look()
    taken = perf_counter() - clock
    failed = [one.name for one in found if one.status == "FAILED"]
    told = {"schema": SCHEMA, "ok": not failed, "failed": failed, "seconds": taken, "findings": json_form(found)}
    return CommandResult(shown(found, taken), lambda: told, met=not failed, written="written: {}")


def _cache() -> Finding:
    """Where compiled libraries are kept."""
    place = store.folder()
    existing = next((one for one in (place, *place.parents) if one.exists()), Path("/"))
    try:
        with tempfile.TemporaryFile(dir=existing):
            return Finding("cache folder", "ok", f"{place}, writable")
    except OSError as error:
        remedy = "compiled code is built anew every time; set XDG_CACHE_HOME to a folder that can be written"
        return Finding("cache folder", "missing", f"{place}: {error.strerror}", remedy)


def _start(seconds: float) -> Finding:
    """Processor time that Python and all imports took before this command began."""
    if seconds > SLOW_START_S:
        remedy = "a slow disk or a virus scanner on the environment's folder: put it on a local disk"
        return Finding("start-up", "missing", f"{seconds:.1f} s of processor", remedy)
    return Finding("start-up", "ok", f"{seconds:.1f} s of processor before a command begins")


def _compiler() -> Finding:
    tool = compiler.find_compiler()
    if tool is None:
        remedy = "solving takes some twenty times as long from 50,000 poses on; apt install g++, or set CXX"
        return Finding("C++ compiler", "missing", "none of c++, g++, clang++, $CXX", remedy)
    if not enabled():
        return Finding("C++ compiler", "missing", f"switched off by {SWITCH}=0", f"unset {SWITCH} to compile")
    told = in_use()  # compiles and runs a few lines, unless they are kept from the last time
    if not told.startswith("compiled"):
        remedy = "the slower way without a compiler is taken; repair it, or set CXX to another"
        return Finding("C++ compiler", "missing", f"{tool.command[0]} fails: {told}", remedy)
    return Finding("C++ compiler", "ok", told)


def _checks() -> list[Finding]:
    """What the machine that comes with twin must compute to."""
    try:
        machine = Machine.load(DEFAULT)
        calibration = Calibration.default(machine)
    except InputError as error:
        return [Finding("files of the machine", "FAILED", str(error), "install twin again: pip install .")]
    real = Kinematics(machine, calibration, tool_length_mm=120.0)
    lower, upper = np.array([axis.domain for axis in machine.axes]).T
    # Away from the ends: the correction leads beyond them there, and B = 0 is where C turns nothing.
    q = np.random.default_rng(1).uniform(0.9 * lower + 0.1 * upper, 0.1 * lower + 0.9 * upper, (POSES, len(lower)))
    return [
        _guarded("kinematics", lambda: _forward(machine, real, q)),
        _guarded("inverse", lambda: _inverse(machine, real, q)),
        _guarded("a program compensated", lambda: _program(machine, calibration)),
        _guarded("least squares", _least_squares),
    ]


def _guarded(name: str, check: Callable[[], tuple[bool, str]]) -> Finding:
    """A check whose breaking off is a failure like any other."""
    remedy = "install twin and its packages again in a fresh environment; if that does not help, report this line"
    try:
        good, detail = check()
    except (InputError, OutputError, ArithmeticError, LookupError, RuntimeError, ValueError) as error:
        return Finding(name, "FAILED", f"{type(error).__name__}: {error}", remedy)
    return Finding(name, "ok", detail) if good else Finding(name, "FAILED", detail, remedy)


def _forward(machine: Machine, real: Kinematics, q: np.ndarray) -> tuple[bool, str]:
    """Against Pinocchio's own recursion on the model with a free-flyer an error frame."""
    poses, frames = real.forward(q), real.error_frames(q)
    data = machine.model.createData()
    worst = np.zeros(2)
    tip = pin.SE3(np.eye(3), np.array([0.0, 0.0, -1e-3 * real.tool_length_mm]))
    for i in range(len(q)):
        pin.framesForwardKinematics(machine.model, data, machine.configuration(q[i] * machine.scale, frames[i]))
        pose: Any = data.oMf[machine.work_frame].actInv(data.oMf[machine.tool_frame] * tip)
        off = np.linalg.norm(pose.translation * 1e3 - poses.point_mm[i])
        turned = np.linalg.norm(pose.rotation - poses.rotation[i])
        worst = np.maximum(worst, [off, turned])
    detail = f"{len(q)} poses within {worst[0]:.0e} mm, {worst[1]:.0e} rad of Pinocchio's"
    return bool(worst[0] <= SAME_MM and worst[1] <= SAME_RAD), detail


def _inverse(machine: Machine, real: Kinematics, q: np.ndarray) -> tuple[bool, str]:
    """Commands that reach the poses of the machine as drawn, executed on the machine with errors."""
    meant = Kinematics(machine, Calibration.zero(machine), tool_length_mm=real.tool_length_mm).forward(q)
    solved = Inverse(real).solve(meant, q)
    good = solved.where(Status.CONVERGED)
    if not np.any(good):
        return False, "no pose converged"
    off = np.linalg.norm(real.forward(solved.positions[good]).point_mm - meant.point_mm[good], axis=1).max()
    return bool(off <= SAME_MM and np.all(good)), f"{int(good.sum())} of {len(q)} poses reached within {off:.0e} mm"


def _program(machine: Machine, calibration: Calibration) -> tuple[bool, str]:
    """Five-axis blocks, written and read back."""
    dialect = dialect_for(Path("check.nc"))
    program = dialect.read(PROGRAM.encode(), "check.nc")
    report = Compensator(machine, calibration, Options(tool_length_mm=120.0)).compensate(program, dialect).report
    told = report.to_dict()
    before, after = told["before"]["max_um"], told["after"]["max_um"]
    detail = f"{before:.1f} µm at the tool before, {after:.2f} µm after"
    return bool(report.complete and after <= LEAST_INCREMENTS < before), detail


def _least_squares() -> tuple[bool, str]:
    """The linear algebra that identification stands on: a curve of degree 12 out of 400 points without noise."""
    x = np.linspace(-1.0, 1.0, 400)
    functions = np.polynomial.legendre.legvander(x, 12)
    truth = np.random.default_rng(2).standard_normal(13)
    q, triangle = np.linalg.qr(functions)
    off = float(np.abs(np.linalg.solve(triangle, q.T @ (functions @ truth)) - truth).max())
    return off <= 1e-12, f"13 coefficients of 400 points within {off:.0e}"
