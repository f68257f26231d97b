"""How fast the inverse with errors is, and against what: run ``python -m tests.benchmarks.solve`` (a minute).

A million five-axis poses of the DMU 50 with all 30 error motions, whole calls of `Inverse.solve`; then `Kinematics.forward`. Beside
them, pose by pose from Python: `scipy.optimize.root` on Pinocchio's kinematics; one iteration of pink (extra `bench`, left out where
that is not installed); the polynomials the thesis's listings refit for each block, nothing else of them and no file read; Pinocchio's
kinematics.

Times are of the processor, all threads together, so that they are a pose and core and what else runs counts little; each is the
smallest of its repeats, and ratios are told with the smallest and largest of theirs.
"""

from __future__ import annotations

import os

import numpy as np
import pinocchio as pin
from scipy.optimize import root

from tests.benchmarks.timing import Timing, machine_name, ratio, timed
from tests.kinematics.test_kinematics import random_commands
from twin.compute.native import in_use, loading
from twin.kinematics.forward import Kinematics, Poses
from twin.kinematics.inverse import Inverse, Status
from twin.machine.calibration import Calibration
from twin.machine.machine import Machine

POSES = 1_000_000
LENGTH_MM = 100.0
STOPS = 11
"""Measured points of a curve of the thesis."""
LINEAR_DEGREES = (4, 5, 8, 8, 6, 4, 8, 6, 8)
"""Polynomials of listing 3.4: position and straightness of X, Y, Z."""
SQUARENESS_DEGREES = (1,) * 6
ROTARY_DEGREES = (4, 4, 8, 7, 7, 7, 8, 8, 8, 7, 7, 7)
"""Those of listing 3.3."""


def told(name: str, timing: Timing, ours: Timing | None = None) -> None:
    """Of one pose."""
    line = f"  {name:44} {timing.best:10.3f}"
    if ours is None:
        print(f"{line}   ({timing.processor_s.max():.3f} at most; {timing.clock_s:.3f} by the clock)")
    else:
        print(f"{line}   {ratio(timing, ours)}")


def poses(machine: Machine, n: int, tilt: tuple[float, float]) -> tuple[Poses, np.ndarray]:
    """Commands all over the range, B within ``tilt``; the targets of the machine as drawn."""
    rng = np.random.default_rng(3)
    q = random_commands(machine, n, rng)
    q[:, :3] = np.clip(q[:, :3], [8.0, 8.0, -392.0], [492.0, 442.0, -8.0])
    q[:, 3] = rng.uniform(*tilt, n)
    return Kinematics(machine, Calibration.zero(machine), tool_length_mm=LENGTH_MM).forward(q), q


def ours(real: Kinematics) -> Timing:
    """Compiled, then plain; returns the first."""
    found = []
    print(f"{POSES:,} poses, µs of processor a pose; {in_use()}")
    for native in (True, False):
        os.environ[loading.SWITCH] = "1" if native else "0"
        for name, tilt, rotary in (
            ("five axes, B 20 to 160°", (20.0, 160.0), True),
            ("five axes, B 0 to 180°", (0.0, 180.0), True),
            ("linear axes", (0.0, 180.0), False),
        ):
            found.append(one_way(f"{name}, {'compiled' if native else 'NumPy'}", real, tilt, rotary, native))
    os.environ.pop(loading.SWITCH)
    return found[0]


def one_way(name: str, real: Kinematics, tilt: tuple[float, float], rotary: bool, native: bool) -> Timing:
    inverse, n = Inverse(real), POSES if native else POSES // 10
    target, q = poses(real.machine, n, tilt)
    solution = inverse.solve(target, q, rotary=rotary)
    timing = timed(lambda: inverse.solve(target, q, rotary=rotary), 9 if native else 3).each(n)
    told(name, timing)
    singular, most = 100.0 * float(np.mean(solution.where(Status.SINGULAR))), solution.point_residual_mm.max()
    print(f"    {singular:.1f} % singular; at most {most:.1e} mm left, {solution.iterations} steps")
    return timing


def by_root(machine: Machine, calibration: Calibration, target: Poses, q: np.ndarray) -> Timing:
    """scipy's hybrid method on Pinocchio's model with the same errors."""
    real = Kinematics(machine, calibration, tool_length_mm=LENGTH_MM)
    data = machine.model.createData()

    def residual(position: np.ndarray, i: int) -> np.ndarray:
        errors = np.array(real.errors(position * machine.scale)).reshape(-1, 6)
        pin.framesForwardKinematics(machine.model, data, machine.configuration(position * machine.scale, errors))
        pose = data.oMf[machine.work_frame].actInv(data.oMf[machine.tool_frame])
        axis = pose.rotation[:, 2]
        point = (pose.translation - LENGTH_MM * 1e-3 * axis) * 1e3
        return np.concatenate([point - target.point_mm[i], 1e3 * np.cross(axis, target.axis[i])[:2]])

    return timed(lambda: [root(residual, q[i], args=(i,)) for i in range(50)], 5).each(50)


def by_pink(machine: Machine, target: Poses, q: np.ndarray) -> Timing | None:
    """One iteration of the model without errors, from beside the target."""
    try:
        import pink
        from pink.tasks import RelativeFrameTask
    except ImportError:
        return None
    model = pin.buildModelFromUrdf(str(machine.urdf))
    task = RelativeFrameTask(
        machine.model.frames[machine.tool_frame].name,
        machine.model.frames[machine.work_frame].name,
        position_cost=1.0,
        orientation_cost=1.0,
    )
    data = model.createData()
    places = [model.joints[model.getJointId(axis.joint)].idx_q for axis in machine.axes]
    standing = np.zeros((50, model.nq))
    standing[:, places] = q[:50] * machine.scale
    standing = np.clip(standing, model.lowerPositionLimit, model.upperPositionLimit)

    def once(i: int) -> None:
        configuration = pink.Configuration(model, data, standing[i])
        task.set_target(pin.SE3(np.array(target.rotation[i]), np.array(target.point_mm[i]) * 1e-3))
        velocity = pink.solve_ik(configuration, [task], 1.0, solver="quadprog", safety_break=False)
        configuration.integrate_inplace(velocity, 1.0)

    return timed(lambda: [once(i) for i in range(50)], 5).each(50)


def by_refitting() -> Timing:
    """numpy.polyfit, as listing 3.1 calls it, for every curve of every block."""
    at = np.linspace(0.0, 500.0, STOPS)
    values = np.random.default_rng(4).normal(size=STOPS)

    def once() -> None:
        for degree in LINEAR_DEGREES + SQUARENESS_DEGREES + ROTARY_DEGREES:
            np.poly1d(np.polyfit(at / 500.0, values, degree, full=True)[0])(0.3)

    return timed(lambda: [once() for _ in range(50)], 5).each(50)


def forward(machine: Machine, calibration: Calibration) -> None:
    """Ours, and Pinocchio's called from Python with the errors given it, in its own vector."""
    some = poses(machine, POSES // 10, (0.0, 180.0))[1]
    own = []
    for native in ("1", "0"):
        os.environ[loading.SWITCH] = native
        real = Kinematics(machine, calibration, tool_length_mm=LENGTH_MM)
        real.forward(some)
        own.append(timed(lambda real=real: real.forward(some), 9).each(len(some)))  # type: ignore[misc]
    os.environ.pop(loading.SWITCH)
    data = machine.model.createData()
    vectors = [
        machine.configuration(position * machine.scale, errors)
        for position, errors in zip(some[:1000], real.error_frames(some[:1000]), strict=True)
    ]

    def once(vector: np.ndarray) -> None:
        pin.framesForwardKinematics(machine.model, data, vector)
        data.oMf[machine.work_frame].actInv(data.oMf[machine.tool_frame])

    other = timed(lambda: [once(vector) for vector in vectors], 9).each(len(vectors))
    print("forward kinematics:")
    told("ours, errors from the curves, compiled", own[0])
    told("ours, errors from the curves, NumPy", own[1])
    told("Pinocchio from Python, errors given", other, own[0])


def main() -> None:
    """Print all figures."""
    machine = Machine.load("dmu50")
    calibration = Calibration.default(machine)
    print(machine_name())
    best = ours(Kinematics(machine, calibration, tool_length_mm=LENGTH_MM))
    print("the same, one pose at a time:")
    target, q = poses(machine, 1000, (20.0, 160.0))
    told("scipy.optimize.root on Pinocchio", by_root(machine, calibration, target, q), best)
    pink = by_pink(machine, target, q)
    if pink is None:
        print("  pink is not installed (extra `bench`): left out")
    else:
        told("pink, one iteration, no errors", pink, best)
    told("the thesis's polynomials, refitted", by_refitting(), best)
    forward(machine, calibration)


if __name__ == "__main__":
    main()
