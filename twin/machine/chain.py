"""The machine's chain as a CasADi expression, built from the Pinocchio model's own placements.

Branch-free on purpose: the same expression is differentiated, mapped over batches and, one day, compiled for SIMD.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Final, NamedTuple, final

import casadi as ca
import numpy as np
import pinocchio as pin

from twin.machine.machine import Machine
from twin.numerics.spatial import rotation_exp


class Pose(NamedTuple):
    """A rigid transformation as expressions: rotation (3, 3) and translation (3, 1)."""

    rotation: Any
    translation: Any

    def then(self, other: Pose) -> Pose:
        """``self · other``."""
        return Pose(self.rotation @ other.rotation, self.rotation @ other.translation + self.translation)

    def inverse(self) -> Pose:
        """The transformation back."""
        return Pose(self.rotation.T, -(self.rotation.T @ self.translation))


@lru_cache(maxsize=16)  # every calibration asks for it; a machine never changes
def chain_function(machine: Machine) -> ca.Function:
    """The pose of the tool in the work frame.

    Inputs: ``q`` (axes,) in command order, ``e`` (6·frames,) frame after frame, ``length`` of the tool; metres, radians.
    Outputs: ``R`` (3, 3), ``p`` (3,): tool frame at the tool tip, in the work frame.
    """
    q = ca.SX.sym("q", len(machine.axes))
    e = ca.SX.sym("e", 6 * len(machine.frames))
    length = ca.SX.sym("length")
    tip = Pose(ca.SX.eye(3), ca.vertcat(0.0, 0.0, -length))  # below the tool frame (contract §1)
    tool = frame_pose(machine, machine.tool_frame, q, e).then(tip)
    pose = frame_pose(machine, machine.work_frame, q, e).inverse().then(tool)
    return ca.Function("chain", [q, e, length], [pose.rotation, pose.translation], ["q", "e", "length"], ["R", "p"])


def frame_pose(machine: Machine, frame: int, q: Any, e: Any) -> Pose:
    """A frame of the model in the base frame; ``e`` None: of the machine as drawn."""
    placed = machine.model.frames[frame]
    return Branch(links(machine, placed.parentJoint, q, e), placed.placement).pose()


def joint_in_base(machine: Machine, joint: int, q: Any, e: Any) -> Pose:
    """A joint of the model in the base frame, behind its own motion; ``e`` None: of the machine as drawn."""
    return Branch(links(machine, joint, q, e), pin.SE3.Identity()).pose()


class Link(NamedTuple):
    """One joint on the way out from the base, as it stands."""

    joint: Any
    """Of the Pinocchio model."""
    placement: Pose
    """Where it sits on the joint before: constant."""
    motion: Pose
    axis: int | None
    """Index of the axis that moves it."""
    error: int | None
    """Where its six components begin among the errors."""


Twist = tuple[Any, Any]
"""Turn (3, 1), and velocity (3, 1) of the point at the origin."""


@final
class Branch:
    """The way along some joints out to a frame behind the last of them.

    Args:
        links: the joints, outwards.
        end: the frame on the last.
    """

    def __init__(self, links: Sequence[Link], end: pin.SE3) -> None:
        self.links = tuple(links)
        self.end = constant_pose(end)

    def pose(self) -> Pose:
        """The frame, seen from where the first joint sits."""
        pose = IDENTITY
        for link in reversed(self.links):
            pose = link.placement.then(link.motion).then(pose)
        return pose.then(self.end)

    def carried(self, point: Any, axis: Any) -> tuple[Any, Any]:
        """A point and a direction of the frame, seen from where the first joint sits: less work than its pose."""
        outwards = [pose for link in self.links for pose in (link.placement, link.motion)]
        for pose in (self.end, *reversed(outwards)):
            point, axis = pose.rotation @ point + pose.translation, pose.rotation @ axis
        return point, axis

    def twists(self, errors: Any, by_position: Any, terms: int) -> tuple[Pose, list[Twist]]:
        """The pose of the frame, and its twist by every axis, errors following the axes.

        Args:
            errors: (6·frames,) those its links stand with.
            by_position: (6·frames, axes) their derivatives.
            terms: of the Jacobian of Exp, I + [e]/2 + …: one or two.
        """
        none = ca.SX(3, 1)
        twists: list[Twist] = [(none, none) for _ in range(by_position.shape[1])]
        pose = IDENTITY
        for link in self.links:
            pose = pose.then(link.placement)
            after = pose.then(link.motion)
            if link.axis is not None:
                twists[link.axis] = _added(twists[link.axis], pose, pose.translation, *joint_twist(link.joint))
            elif link.error is not None:
                i = link.error
                for axis in range(len(twists)):
                    shift, turn = by_position[i : i + 3, axis], by_position[i + 3 : i + 6, axis]
                    if shift.nnz() + turn.nnz() == 0:
                        continue
                    if terms > 1:
                        turn = turn + 0.5 * ca.cross(errors[i + 3 : i + 6], turn)
                    twists[axis] = _added(twists[axis], pose, after.translation, turn, shift)
            pose = after
        return pose.then(self.end), twists


def _added(twist: Twist, pose: Pose, centre: Any, turn: Any, shift: Any) -> Twist:
    """A twist, and another one given in the frame of ``pose`` about ``centre``."""
    about = pose.rotation @ turn
    return twist[0] + about, twist[1] + pose.rotation @ shift + ca.cross(centre, about)


def links(machine: Machine, joint: int, q: Any, e: Any) -> list[Link]:
    """The joints from the base out to one, itself included; positions (axes,), errors (6·frames,) or None: as drawn."""
    model = machine.model
    axes = {joint: i for i, joint in enumerate(machine.axis_joints)}
    errors = {frame.joint: 6 * i for i, frame in enumerate(machine.frames)}
    found = []
    for index in list(model.supports[joint])[1:]:
        axis, error = axes.get(index), errors.get(index)
        motion = IDENTITY
        if axis is not None:
            motion = joint_pose(model.joints[index], q[axis])
        elif error is not None and e is not None:
            motion = Pose(rotation_exp(e[error + 3 : error + 6]), e[error : error + 3])
        found.append(Link(model.joints[index], constant_pose(model.jointPlacements[index]), motion, axis, error))
    return found


def branches(machine: Machine, q: Any, e: Any) -> tuple[Branch, Branch]:
    """The ways to the tool frame and to the work frame from where the two part; the joints before move both."""
    frames = [machine.model.frames[frame] for frame in (machine.tool_frame, machine.work_frame)]
    ways = [list(machine.model.supports[frame.parentJoint])[1:] for frame in frames]
    shared = sum(a == b for a, b in zip(*ways, strict=False))
    tool, work = (Branch(links(machine, frame.parentJoint, q, e)[shared:], frame.placement) for frame in frames)
    return tool, work


@lru_cache(maxsize=16)  # every diagnosis asks for it, for each axis; a machine never changes
def gravity_load(machine: Machine) -> ca.Function:
    """What gravity does along each axis of the machine as drawn: q (axes,) → (axes, 9) N or N·m, minus the slope of its potential.

    Of the masses of the URDF, zero where it gives none; of 1 kg at the tool frame, of 1 kg·m along its x, y and z; likewise at the
    work frame (`twin.machine.effects.payload.Payload`).
    """
    model = machine.model
    q = ca.SX.sym("q", len(machine.axes))
    gravity = ca.DM(np.asarray(model.gravity.linear))
    potential = [ca.SX(0.0)]
    for joint in range(1, model.njoints):
        inertia = model.inertias[joint]
        if inertia.mass > 0.0:
            pose = joint_in_base(machine, joint, q, None)
            centre = pose.rotation @ ca.DM(np.asarray(inertia.lever)) + pose.translation
            potential[0] = potential[0] - inertia.mass * ca.dot(gravity, centre)
    for frame in (machine.tool_frame, machine.work_frame):
        pose = frame_pose(machine, frame, q, None)
        potential += [-ca.dot(gravity, pose.translation), *ca.vertsplit(-(pose.rotation.T @ gravity))]
    return ca.Function("load", [q], [ca.densify(-ca.jacobian(ca.vertcat(*potential), q)).T], ["q"], ["load"])


def joint_twist(joint: pin.JointModel) -> tuple[Any, Any]:
    """Turn (3, 1) and shift (3, 1) of a one-degree-of-freedom joint: what Pinocchio says of its motion subspace."""
    data = joint.createData()
    joint.calc(data, np.zeros(joint.idx_q + joint.nq), np.zeros(joint.idx_v + joint.nv))
    motion = np.asarray(data.S).reshape(6)
    return ca.sparsify(ca.DM(motion[3:])), ca.sparsify(ca.DM(motion[:3]))


def joint_pose(joint: pin.JointModel, value: Any) -> Pose:
    """A one-degree-of-freedom joint moved by ``value``."""
    axis, shift = (ca.densify(part) for part in joint_twist(joint))
    if np.any(np.asarray(shift)):
        return Pose(ca.SX.eye(3), shift * value)
    cross = ca.skew(axis)
    turn = ca.SX.eye(3) + ca.sin(value) * cross + (1.0 - ca.cos(value)) * (cross @ cross)
    return Pose(turn, ca.SX.zeros(3))


def constant_pose(placement: pin.SE3) -> Pose:
    """A placement of the model."""
    # Sparse where a placement is exactly zero, so that nothing is multiplied by it.
    return Pose(ca.SX(ca.sparsify(ca.DM(placement.rotation))), ca.SX(ca.sparsify(ca.DM(placement.translation))))


IDENTITY: Final = constant_pose(pin.SE3.Identity())
"""No motion at all."""
