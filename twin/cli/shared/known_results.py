"""Computations with known results on the bundled machine, for `twin doctor`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pinocchio as pin

from twin._common.bundled import DEFAULT
from twin._common.errors import InputError, OutputError
from twin.cli.shared.installation import Finding

if TYPE_CHECKING:
    from twin.machine.machine import Machine
    from twin.model.calibration import Calibration
    from twin.tool.forward import Kinematics

SAME_MM: Final = 1e-9
"""Agreement of two formulations of a 1 m chain in double precision."""
SAME_RAD: Final = 1e-11
LEAST_INCREMENTS: Final = 2.0
"""Largest error at the tool of a five-axis block from rounding its words to the least increment of 1 µm, µm."""
POSES: Final = 50

PROGRAM: Final = "G21 G90\nG1 X100 Y100 Z-200 B30 C40 F1000\nX140 Y130 Z-210 B35 C50\nX150\nM30\n"


def known_results() -> list[Finding]:
    """Check computations on the bundled machine."""
    from twin.machine.machine import Machine
    from twin.model.calibration import Calibration
    from twin.tool.forward import Kinematics

    try:
        machine = Machine.load(DEFAULT)
        calibration = Calibration.default(machine)
    except InputError as error:
        return [Finding("files of the machine", "FAILED", str(error), "install twin again: pip install .")]
    real = Kinematics(machine, calibration, tool_length_mm=120.0)
    lower, upper = np.array([axis.domain for axis in machine.axes]).T
    # Away from the ends of travel, beyond which corrections would lead, and from the singularity at B = 0.
    q = np.random.default_rng(1).uniform(0.9 * lower + 0.1 * upper, 0.1 * lower + 0.9 * upper, (POSES, len(lower)))
    return [
        _guarded("kinematics", lambda: _forward(machine, real, q)),
        _guarded("inverse", lambda: _inverse(machine, real, q)),
        _guarded("compensation", lambda: _program(machine, calibration)),
        _guarded("least squares", _least_squares),
    ]


def _guarded(name: str, check: Callable[[], tuple[bool, str]]) -> Finding:
    """Run a check and report an exception as a failure."""
    remedy = "install twin and its packages again in a fresh environment; if that does not help, report this line"
    try:
        good, detail = check()
    except (InputError, OutputError, ArithmeticError, LookupError, RuntimeError, ValueError) as error:
        return Finding(name, "FAILED", f"{type(error).__name__}: {error}", remedy)
    return Finding(name, "ok", detail) if good else Finding(name, "FAILED", detail, remedy)


def _forward(machine: Machine, real: Kinematics, q: np.ndarray) -> tuple[bool, str]:
    """Compare with Pinocchio's own recursion on the model with one free-flyer joint per error frame."""
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
    detail = f"{len(q)} poses within {worst[0]:.0e} mm, {worst[1]:.0e} rad of Pinocchio"
    return bool(worst[0] <= SAME_MM and worst[1] <= SAME_RAD), detail


def _inverse(machine: Machine, real: Kinematics, q: np.ndarray) -> tuple[bool, str]:
    """Solve for commands that reach nominal poses on the machine with errors, and check the poses reached."""
    from twin.model.calibration import Calibration
    from twin.tool.forward import Kinematics
    from twin.tool.inverse import Inverse, Status

    meant = Kinematics(machine, Calibration.zero(machine), tool_length_mm=real.tool_length_mm).forward(q)
    solved = Inverse(real).solve(meant, q)
    good = solved.where(Status.CONVERGED)
    if not np.any(good):
        return False, "no pose converged"
    off = np.linalg.norm(real.forward(solved.positions[good]).point_mm - meant.point_mm[good], axis=1).max()
    return bool(off <= SAME_MM and np.all(good)), f"{int(good.sum())} of {len(q)} poses reached within {off:.0e} mm"


def _program(machine: Machine, calibration: Calibration) -> tuple[bool, str]:
    """Compensate five-axis blocks, which are written and read back."""
    from twin.compensation import Compensator, Options
    from twin.nc import dialect_for

    dialect = dialect_for(Path("check.nc"))
    program = dialect.read(PROGRAM.encode(), "check.nc")
    report = Compensator(machine, calibration, Options(tool_length_mm=120.0)).compensate(program, dialect).report
    values = report.to_dict()
    before, after = values["before"]["max_um"], values["after"]["max_um"]
    detail = f"{before:.1f} µm at the tool before, {after:.2f} µm after"
    return bool(report.complete and after <= LEAST_INCREMENTS < before), detail


def _least_squares() -> tuple[bool, str]:
    """Check least squares as used in identification: a curve of degree 12 from 400 noise-free points."""
    x = np.linspace(-1.0, 1.0, 400)
    functions = np.polynomial.legendre.legvander(x, 12)
    truth = np.random.default_rng(2).standard_normal(13)
    q, triangle = np.linalg.qr(functions)
    off = float(np.abs(np.linalg.solve(triangle, q.T @ (functions @ truth)) - truth).max())
    return off <= 1e-12, f"13 coefficients from 400 points within {off:.0e}"
