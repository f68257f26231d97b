"""Inverse kinematics of the DMU 50 without errors: the same target poses and the same starts for all.

The poses come from random commands over the whole range (B from 20 to 160°); every solver starts up to 1 mm and 1° from them. The
chain runs from the table to the tool tip. The peers solve for all six coordinates of a pose, which five axes reach because the poses
come from commands; `twin` and `scipy.optimize.root` for the point and the tool axis. The peers have no error frames; only
`scipy.optimize.root` is also measured on the machine with its 30 error motions, because its residual is a function of our own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.optimize import root

from tests.benchmarks.peers.chain import SerialChain, pinocchio_model, serial_chain
from tests.benchmarks.peers.record import Measured, Peer, Section, section
from tests.benchmarks.timing import timed
from tests.tool.test_kinematics import random_commands
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.tool.forward import Kinematics, Poses
from twin.tool.inverse import Inverse

LENGTH_MM = 100.0
TILT_DEG = (20.0, 160.0)
OURS = 100_000
POINTS = 200
"""Poses that are solved by a peer, one at a time."""
REPEATS = 5
OFF = 1.0
"""Largest distance of the start from the solution in each axis, mm and degrees."""
AIM_M = 1e-9
"""Residual at which an iteration with a tolerance of its own ends: metres and radians."""
MISSED_MM = 1e-3
"""Residual above which a pose counts as not reached."""
STEPS = 30
ROTARY_LIMIT_DEG = 5.0


@dataclass(frozen=True)
class Task:
    """Poses to reach.

    Attributes:
        real: the machine.
        target: n poses.
        start: (n, axes) commands near them, mm and degrees.
    """

    real: Kinematics
    target: Poses
    start: np.ndarray

    def result(self, found: np.ndarray) -> str:
        """Return the residual of (n, axes) commands, mm and degrees, in words."""
        n = len(found)
        reached = self.real.forward(found)
        miss = np.linalg.norm(reached.point_mm - self.target.point_mm[:n], axis=1)
        turned = np.linalg.norm(np.cross(reached.axis, self.target.axis[:n]), axis=1)
        lost = int(np.count_nonzero(miss > MISSED_MM))
        worst = f"residual at most {miss.max():.0e} mm, {turned.max():.0e} rad"
        if not lost:
            return worst
        rest = f"{lost} of {n} poses missed by more than {MISSED_MM * 1e3:g} µm"
        return f"{rest}; {worst} (median {np.median(miss):.0e} mm)"

    def each(self, solve: Callable[[int], np.ndarray], points: int = POINTS) -> Measured:
        """Measure a solver of single poses; ``solve``: from the number of a pose to commands in mm and degrees."""
        solve(0)
        found = np.array([solve(i) for i in range(points)])
        return Measured(
            timed(lambda: [solve(i) for i in range(points)], REPEATS).each(points), points, self.result(found)
        )

    def pose(self, i: int) -> pin.SE3:
        """Return a target as a transformation in metres."""
        return pin.SE3(np.array(self.target.rotation[i]), np.array(self.target.point_mm[i]) * 1e-3)


def poses(machine: Machine, n: int, tilt: tuple[float, float]) -> tuple[Poses, np.ndarray]:
    """Return commands over the whole range with B within ``tilt``, and the target poses of the nominal machine."""
    rng = np.random.default_rng(3)
    q = random_commands(machine, n, rng)
    q[:, :3] = np.clip(q[:, :3], [8.0, 8.0, -392.0], [492.0, 442.0, -8.0])
    q[:, 3] = rng.uniform(*tilt, n)
    return Kinematics(machine, Calibration.zero(machine), tool_length_mm=LENGTH_MM).forward(q), q


def task(machine: Machine, calibration: Calibration, n: int) -> Task:
    """Return poses of the nominal machine, and starts near them."""
    target, q = poses(machine, n, TILT_DEG)
    start = q + np.random.default_rng(4).uniform(-OFF, OFF, q.shape)
    return Task(Kinematics(machine, calibration, tool_length_mm=LENGTH_MM), target, start)


def by_twin(of: Task) -> Measured:
    """Measure `Inverse.solve` on all poses at once."""
    inverse = Inverse(of.real, rotary_limit_deg=ROTARY_LIMIT_DEG)
    found = inverse.solve(of.target, of.start).positions
    n = len(found)
    return Measured(timed(lambda: inverse.solve(of.target, of.start), REPEATS).each(n), n, of.result(found))


def by_twin_singly(of: Task) -> Measured:
    """Measure `Inverse.solve` on one pose a call."""
    inverse = Inverse(of.real, rotary_limit_deg=ROTARY_LIMIT_DEG)
    single = [
        Poses(rotation=of.target.rotation[i : i + 1], point_mm=of.target.point_mm[i : i + 1]) for i in range(POINTS)
    ]
    return of.each(lambda i: inverse.solve(single[i], of.start[i : i + 1]).positions[0])


def by_root(of: Task, points: int = POINTS) -> Measured:
    """Measure scipy's hybrid method on Pinocchio's model, with the errors of the task's machine."""
    real, machine = of.real, of.real.machine
    data = machine.model.createData()

    def residual(position: np.ndarray, i: int) -> np.ndarray:
        errors = np.array(real.errors(position * machine.scale)).reshape(-1, 6)
        pin.framesForwardKinematics(machine.model, data, machine.configuration(position * machine.scale, errors))
        pose = data.oMf[machine.work_frame].actInv(data.oMf[machine.tool_frame])
        axis = pose.rotation[:, 2]
        point = (pose.translation - LENGTH_MM * 1e-3 * axis) * 1e3
        return np.concatenate([point - of.target.point_mm[i], 1e3 * np.cross(axis, of.target.axis[i])[:2]])

    return of.each(lambda i: root(residual, of.start[i], args=(i,)).x, points)


def by_pink(of: Task, steps: int = STEPS) -> Measured:
    """Measure pink: steps until the target is reached, at most ``steps``."""
    import pink
    from pink.tasks import FrameTask

    machine = of.real.machine
    chain = serial_chain(machine, LENGTH_MM)
    model = pinocchio_model(chain)
    data = model.createData()
    columns = [joint.column for joint in chain.joints]
    task = FrameTask("tip", position_cost=1.0, orientation_cost=1.0)

    def solve(i: int) -> np.ndarray:
        configuration = pink.Configuration(model, data, (of.start[i] * machine.scale)[columns])
        task.set_target(of.pose(i))
        for _ in range(steps):
            velocity = pink.solve_ik(configuration, [task], 1.0, solver="quadprog", safety_break=False)
            configuration.integrate_inplace(velocity, 1.0)
            if np.abs(task.compute_error(configuration)).max() < AIM_M:
                break
        return _commands(machine, chain, configuration.q)

    return of.each(solve)


def by_ikpy(of: Task) -> Measured:
    """Measure ikpy, whose least squares have tolerances of 1e-15."""
    from ikpy.chain import Chain
    from ikpy.link import OriginLink, URDFLink

    machine = of.real.machine
    serial = serial_chain(machine, LENGTH_MM)
    links = [OriginLink()]
    for joint in serial.joints:
        placed = {"origin_translation": joint.placement.translation, "origin_orientation": _rpy(joint.placement)}
        moving = (
            {"translation": joint.axis, "joint_type": "prismatic"}
            if joint.linear
            else {"rotation": joint.axis, "joint_type": "revolute"}
        )
        links.append(URDFLink(name=f"joint {joint.column}", **placed, **moving))
    links.append(URDFLink("tip", serial.tip.translation, _rpy(serial.tip), joint_type="fixed"))
    chain = Chain(links, active_links_mask=[False, *[True] * len(serial.joints), False])
    columns = [joint.column for joint in serial.joints]

    def solve(i: int) -> np.ndarray:
        start = [0.0, *(of.start[i] * machine.scale)[columns], 0.0]
        found = chain.inverse_kinematics_frame(of.pose(i).homogeneous, start, orientation_mode="all", tol=1e-15)
        return _commands(machine, serial, np.asarray(found)[1:-1])

    return of.each(solve)


def by_roboticstoolbox(of: Task) -> Measured:
    """Measure the Levenberg-Marquardt solver of roboticstoolbox, which is compiled."""
    import roboticstoolbox as rtb

    machine = of.real.machine
    chain = serial_chain(machine, LENGTH_MM)
    parts = []
    for joint in chain.joints:
        turned = joint.along_z
        parts += [rtb.ET.SE3((joint.placement * turned).homogeneous), rtb.ET.tz() if joint.linear else rtb.ET.Rz()]
        parts.append(rtb.ET.SE3(turned.inverse().homogeneous))
    ets = rtb.ETS([*parts, rtb.ET.SE3(chain.tip.homogeneous)])
    columns = [joint.column for joint in chain.joints]

    def solve(i: int) -> np.ndarray:
        start = (of.start[i] * machine.scale)[columns]
        goal = of.pose(i).homogeneous
        found = ets.ik_LM(goal, q0=start, ilimit=STEPS, slimit=1, tol=0.5 * AIM_M**2, joint_limits=False)
        return _commands(machine, chain, np.asarray(found.q))

    return of.each(solve)


def _commands(machine: Machine, chain: SerialChain, q: np.ndarray) -> np.ndarray:
    """Return joint positions in the order of the chain as commands, mm and degrees."""
    found = np.empty(len(q))
    found[[joint.column for joint in chain.joints]] = q
    return found / machine.scale


def _rpy(placement: pin.SE3) -> np.ndarray:
    return np.asarray(pin.rpy.matrixToRpy(placement.rotation))


def sections(machine: Machine) -> Iterator[Section]:
    """Yield the comparisons without and with errors."""
    nominal = task(machine, Calibration.zero(machine), OURS)
    yield section(
        "Inverse kinematics, machine without errors",
        "`Inverse.solve`, all poses in one call",
        by_twin(nominal),
        [
            Peer(("twin",), "`Inverse.solve`, one pose a call", lambda: by_twin_singly(nominal)),
            Peer(
                ("scipy",), "`optimize.root` on Pinocchio's kinematics, numerical derivatives", lambda: by_root(nominal)
            ),
            Peer(
                ("pin-pink", "quadprog"),
                "steps of a quadratic program until the pose is reached",
                lambda: by_pink(nominal),
            ),
            Peer(("ikpy",), "least squares with numerical derivatives", lambda: by_ikpy(nominal)),
            Peer(
                ("roboticstoolbox-python",),
                "`ik_LM`, compiled Levenberg-Marquardt",
                lambda: by_roboticstoolbox(nominal),
            ),
        ],
    )
    real = task(machine, Calibration.default(machine), OURS)
    yield section(
        "Inverse kinematics, machine with 30 error motions (only peers to which a residual can be given)",
        "`Inverse.solve`, all poses in one call",
        by_twin(real),
        [Peer(("scipy",), "`optimize.root` on Pinocchio's kinematics, numerical derivatives", lambda: by_root(real))],
    )
