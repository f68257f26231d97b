"""Measure the speed of the inverse with errors and of alternatives: run ``python -m tests.benchmarks.solve`` (a minute).

One million five-axis poses of the DMU 50 with all 30 error motions by `Inverse.solve`; then `Kinematics.forward`. For comparison, one
pose at a time from Python: `scipy.optimize.root` on Pinocchio's kinematics; one iteration of pink (extra `peers`, omitted if not
installed); the polynomials that the thesis's listings refit for every block, without reading files; Pinocchio's kinematics.

Times are processor times of all threads, so that they are per pose and core and hardly depend on other load. Each is the smallest of
its repeats; ratios are given with their smallest and largest value.
"""

from __future__ import annotations

import os

import numpy as np
import pinocchio as pin

from tests.benchmarks.peers.inverse import LENGTH_MM, Task, by_pink, by_root, poses
from tests.benchmarks.peers.record import installed
from tests.benchmarks.timing import Timing, machine_name, ratio, timed
from twin.compute.native import compiler
from twin.compute.native.compiler import solver_description
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.tool.forward import Kinematics
from twin.tool.inverse import Inverse, Status

POSES = 1_000_000
STOPS = 11
"""Number of measured points of a curve of the thesis."""
LINEAR_DEGREES = (4, 5, 8, 8, 6, 4, 8, 6, 8)
"""Degrees of the polynomials of listing 3.4: positioning and straightness of X, Y, Z."""
SQUARENESS_DEGREES = (1,) * 6
ROTARY_DEGREES = (4, 4, 8, 7, 7, 7, 8, 8, 8, 7, 7, 7)
"""Degrees of the polynomials of listing 3.3."""


def print_line(name: str, timing: Timing, ours: Timing | None = None) -> None:
    """Print the time of one pose, or its ratio to ours."""
    line = f"  {name:44} {timing.best:10.3f}"
    if ours is None:
        print(f"{line}   ({timing.processor_s.max():.3f} at most; {timing.clock_s:.3f} by the clock)")
    else:
        print(f"{line}   {ratio(timing, ours)}")


def ours(real: Kinematics) -> Timing:
    """Measure compiled and NumPy code; return the first compiled result."""
    found = []
    print(f"{POSES:,} poses, µs of processor time per pose; {solver_description()}")
    for native in (True, False):
        os.environ[compiler.SWITCH_VARIABLE] = "1" if native else "0"
        for name, tilt, rotary in (
            ("five axes, B 20 to 160°", (20.0, 160.0), True),
            ("five axes, B 0 to 180°", (0.0, 180.0), True),
            ("linear axes", (0.0, 180.0), False),
        ):
            found.append(one_way(f"{name}, {'compiled' if native else 'NumPy'}", real, tilt, rotary, native))
    os.environ.pop(compiler.SWITCH_VARIABLE)
    return found[0]


def one_way(name: str, real: Kinematics, tilt: tuple[float, float], rotary: bool, native: bool) -> Timing:
    inverse, n = Inverse(real), POSES if native else POSES // 10
    target, q = poses(real.machine, n, tilt)
    solution = inverse.solve(target, q, rotary=rotary)
    timing = timed(lambda: inverse.solve(target, q, rotary=rotary), 9 if native else 3).each(n)
    print_line(name, timing)
    singular, most = 100.0 * float(np.mean(solution.where(Status.SINGULAR))), solution.point_residual_mm.max()
    print(f"    {singular:.1f} % singular; residual at most {most:.1e} mm, {solution.iterations} iterations")
    return timing


def by_refitting() -> Timing:
    """Time numpy.polyfit as called in listing 3.1, for every curve of every block."""
    at = np.linspace(0.0, 500.0, STOPS)
    values = np.random.default_rng(4).normal(size=STOPS)

    def once() -> None:
        for degree in LINEAR_DEGREES + SQUARENESS_DEGREES + ROTARY_DEGREES:
            np.poly1d(np.polyfit(at / 500.0, values, degree, full=True)[0])(0.3)

    return timed(lambda: [once() for _ in range(50)], 5).each(50)


def forward(machine: Machine, calibration: Calibration) -> None:
    """Time our forward kinematics, and Pinocchio's from Python with given errors."""
    some = poses(machine, POSES // 10, (0.0, 180.0))[1]
    own = []
    for native in ("1", "0"):
        os.environ[compiler.SWITCH_VARIABLE] = native
        real = Kinematics(machine, calibration, tool_length_mm=LENGTH_MM)
        real.forward(some)
        own.append(timed(lambda real=real: real.forward(some), 9).each(len(some)))  # type: ignore[misc]
    os.environ.pop(compiler.SWITCH_VARIABLE)
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
    print_line("ours, errors from the curves, compiled", own[0])
    print_line("ours, errors from the curves, NumPy", own[1])
    print_line("Pinocchio from Python, errors given", other, own[0])


def main() -> None:
    """Print all figures."""
    machine = Machine.load("dmu50")
    calibration = Calibration.default(machine)
    print(machine_name())
    best = ours(Kinematics(machine, calibration, tool_length_mm=LENGTH_MM))
    print("the same, one pose at a time:")
    target, q = poses(machine, 1000, (20.0, 160.0))
    with_errors, nominal = (
        Task(Kinematics(machine, errors, tool_length_mm=LENGTH_MM), target, q)
        for errors in (calibration, Calibration.zero(machine))
    )
    print_line("scipy.optimize.root on Pinocchio", by_root(with_errors, 50).each, best)
    if installed("pin-pink") is None:
        print("  pink is not installed (extra `peers`): omitted")
    else:
        print_line("pink, one iteration, no errors", by_pink(nominal, steps=1).each, best)
    print_line("the thesis's polynomials, refitted", by_refitting(), best)
    forward(machine, calibration)


if __name__ == "__main__":
    main()
