"""Measure the figures quoted in the documents: run ``python -m tests.benchmarks.figures``.

Agreement of the kinematic formulations, residuals of the inverse, and the thesis's method compared with this one, for known and for
identified errors. For times see `tests.benchmarks.solve`.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np
import pinocchio as pin

from tests.compensation.test_thesis import PROGRAM
from tests.identification.plans import volumetric
from tests.identification.test_thesis_findings import gains
from tests.model.errors import random_calibration
from tests.tool.test_kinematics import random_commands, reference_pose
from tests.truth.reference import sorby_forward, sorby_inverse
from twin._common.bundled import find_program
from twin.compensation import Compensator, Options
from twin.compute.along import BatchFunction
from twin.identification import identify
from twin.machine.chain import chain_function
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker
from twin.measurement.simulate import simulate
from twin.model.calibration import Calibration
from twin.nc import dialect_for, read_program
from twin.nc.blocks import Program
from twin.nc.dialect import Dialect
from twin.samples.dmu50_calibration import as_drawn
from twin.tool.forward import Kinematics
from twin.tool.inverse import Inverse, Status


def agreement(machine: Machine) -> None:
    """Compare Pinocchio, CasADi and the reference over 10,000 poses with errors up to 1 mm and 1 mrad, and with the closed form."""
    n, length = 10_000, 0.123
    rng = np.random.default_rng(1)
    q, errors = random_commands(machine, n, rng), rng.uniform(-1e-3, 1e-3, (n, len(machine.frames), 6))
    rotation, point = BatchFunction(chain_function(machine))(
        q * machine.scale, errors.reshape(n, -1), np.array([length])
    )
    data = machine.model.createData()
    tip = pin.SE3(np.eye(3), np.array([0.0, 0.0, -length]))
    worst = np.zeros((2, 2))
    for i in range(n):
        pin.framesForwardKinematics(machine.model, data, machine.configuration(q[i] * machine.scale, errors[i]))
        pose = (data.oMf[machine.work_frame].actInv(data.oMf[machine.tool_frame]) * tip).homogeneous
        truth = reference_pose(machine, q[i], errors[i], length)
        for k, (turn, mm) in enumerate(
            ((pose[:3, :3], pose[:3, 3] * 1e3), (rotation[i].reshape(3, 3).T, point[i] * 1e3))
        ):
            worst[k] = np.maximum(worst[k], [np.abs(mm - truth[:3, 3]).max(), np.abs(turn - truth[:3, :3]).max()])
    print(f"agreement with the reference, {n} poses:")
    for name, (mm, rad) in zip(("Pinocchio", "CasADi"), worst, strict=True):
        print(f"  {name:10} {mm:.1e} mm  {rad:.1e} rad")
    nominal = Kinematics(machine, Calibration.zero(machine), tool_length_mm=0.0)
    poses = nominal.forward(q)
    joint = (q - [250, 225, -400, 0, 0]) * [1, 1, 1, np.pi / 180, np.pi / 180]
    forward = [np.concatenate(sorby_forward(row)) for row in joint]
    found = np.concatenate([poses.point_mm, poses.axis], axis=1)
    print(
        f"  closed form, forward: {np.abs(found - forward)[:, :3].max():.1e} mm, {np.abs(found - forward)[:, 3:].max():.1e} rad"
    )
    rows = np.flatnonzero((q[:, 3] > 1) & (q[:, 3] < 179))
    back = np.array([sorby_inverse(poses.point_mm[i], poses.axis[i])[:3] for i in rows])
    print(f"  closed form, inverse (1° < B < 179°): {np.abs(back - joint[rows, :3]).max():.1e} mm")


def inverse(machine: Machine) -> None:
    """Print residuals of the inverse with errors over 10,000 poses."""
    rng = np.random.default_rng(11)
    n = 10_000
    real = Kinematics(machine, random_calibration(machine, rng), tool_length_mm=100.0)
    nominal = Kinematics(machine, Calibration.zero(machine), tool_length_mm=100.0)
    q = random_commands(machine, n, rng)
    q[:, :3] = np.clip(q[:, :3], [8, 8, -392], [492, 442, -8])
    for rotary, name in ((True, "five axes"), (False, "linear axes only")):
        solution = Inverse(real).solve(nominal.forward(q), q, rotary=rotary)
        counts = {status.value: int(solution.where(status).sum()) for status in Status}
        good = solution.where(Status.CONVERGED)
        turned = f", {solution.orientation_residual_rad[good].max():.1e} rad" if rotary else ""
        print(f"inverse, {name}: {solution.point_residual_mm.max():.1e} mm{turned}; {counts}")


def methods(machine: Machine, calibration: Calibration) -> None:
    """Compare the thesis's method, given its own error curves, with this one on the same machine."""
    figure = dialect_for(find_program("cone_frustum.nc"))
    # X = 500 at mid-volume needs a command beyond the axis range and is omitted here.
    inner = PROGRAM.replace("X0 Y0 Z0", "X50 Y225 Z-200").replace("G1 X500 F1000\n", "")
    cases: list[tuple[str, Program, Dialect, float]] = [
        ("X = 50 … 500, Y = Z = 0", figure.read(PROGRAM.encode(), "figure.nc"), figure, 0.0),
        ("X = 50 … 450, Y 225, Z -200", figure.read(inner.encode(), "inner.nc"), figure, 120.0),
        ("cone frustum", *read_program("cone_frustum.nc"), 120.0),
    ]
    print(f"{'error at the tool, RMS / max µm':34}{'before':>18}{'thesis':>18}{'ours':>18}{'rounding':>12}")
    for name, program, dialect, length in cases:
        cells = []
        for method in ("thesis", "exact"):
            options = Options(tool_length_mm=length, method="thesis" if method == "thesis" else "exact")
            known = as_drawn(machine) if method == "thesis" else calibration
            report = Compensator(machine, known, options).compensate(program, dialect).report
            if not cells:
                cells.append(f"{report.before.rms_um:.2f} / {report.before.max_um:.2f}")
            cells.append(f"{report.after.rms_um:.2f} / {report.after.max_um:.2f}")
        print(f"{name:34}" + "".join(f"{cell:>18}" for cell in cells) + f"{report.rounding_um:>12.2f}")


def identified(machine: Machine, calibration: Calibration) -> None:
    """Identify from one tracker measurement and compensate, with the thesis's method and with this one."""
    with tempfile.TemporaryDirectory() as folder:
        found = gains(machine, calibration, Path(folder))
    print(
        f"{'identified, then compensated, RMS / max µm':44}"
        + "".join(f"{label:>18}" for label in ("before", "thesis", "ours"))
    )
    for name, left in found.items():
        cells = [f"{left[label][0]:.1f} / {left[label][1]:.1f}" for label in ("before", "thesis", "ours")]
        print(f"{name:44}" + "".join(f"{cell:>18}" for cell in cells))


def identification(machine: Machine, calibration: Calibration) -> None:
    """Print the time to identify from 10,000 points: random poses, six targets, two trackers, three rounds."""
    plan = volumetric(machine, np.random.default_rng(5), 10_000)
    data, _ = simulate(plan, machine, calibration, LaserTracker(), np.random.default_rng(1))
    start = time.perf_counter()
    found = identify(data, machine)
    seconds = time.perf_counter() - start
    print(
        f"identify, {len(data):,} points, {len(found.solution.spectrum.scale)} unknowns: {seconds:.1f} s "
        f"(reduced chi² {found.misfit.reduced:.3f})"
    )


def main() -> None:
    """Print all figures."""
    machine = Machine.load("dmu50")
    calibration = Calibration.default(machine)
    agreement(machine)
    inverse(machine)
    methods(machine, calibration)
    identified(machine, calibration)
    identification(machine, calibration)


if __name__ == "__main__":
    main()
