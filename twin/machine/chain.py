"""The machine's kinematic chain as a CasADi expression, built from the placements of the Pinocchio model.

The expression has no branches, so that it can be differentiated, mapped over batches and compiled.
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
        """Return the product ``self · other``."""
        return Pose(self.rotation @ other.rotation, self.rotation @ other.translation + self.translation)

    def inverse(self) -> Pose:
        """Return the inverse transformation."""
        return Pose(self.rotation.T, -(self.rotation.T @ self.translation))


@lru_cache(maxsize=16)  # shared by all calibrations; a machine is immutable
def chain_function(machine: Machine) -> ca.Function:
    """Return the function of the tool's pose in the work frame.

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


@lru_cache(maxsize=16)  # as `chain_function`
def tip_function(machine: Machine) -> ca.Function:
    """Return the function of the tool tip and the tool axis in the work frame, which takes fewer operations than `chain_function`.

    Inputs: as for `chain_function`. Outputs: ``p`` (3,) the tool tip, metres; ``z`` (3,) the tool axis, from tip to spindle.
    """
    q = ca.SX.sym("q", len(machine.axes))
    e = ca.SX.sym("e", 6 * len(machine.frames))
    length = ca.SX.sym("length")
    tool, work = branches(machine, q, e)
    tip, axis = work.into(*tool.carried(ca.vertcat(ca.SX(2, 1), -length), sparse(0.0, 0.0, 1.0)))
    return ca.Function("tip", [q, e, length], [tip, axis], ["q", "e", "length"], ["p", "z"])


def frame_pose(machine: Machine, frame: int, q: Any, e: Any) -> Pose:
    """Return the pose of a frame of the model in the base frame; ``e`` None: nominal."""
    model_frame = machine.model.frames[frame]
    return Branch(links(machine, model_frame.parentJoint, q, e), model_frame.placement).pose()


def joint_in_base(machine: Machine, joint: int, q: Any, e: Any) -> Pose:
    """Return the pose of a joint of the model in the base frame, after its own motion; ``e`` None: nominal."""
    return Branch(links(machine, joint, q, e), pin.SE3.Identity()).pose()


class Link(NamedTuple):
    """One joint of a branch at its current position."""

    joint: Any
    """Joint of the Pinocchio model."""
    placement: Pose
    """Constant placement on the joint before."""
    motion: Pose
    axis: int | None
    """Index of the axis that moves it."""
    error: int | None
    """Index of its first component in the vector of errors."""


Twist = tuple[Any, Any]
"""Angular velocity (3, 1), and velocity (3, 1) of the point at the origin."""


@final
class Branch:
    """A serial chain of joints, from the base outwards, with a frame placed on the last one."""

    def __init__(self, links: Sequence[Link], end: pin.SE3) -> None:
        self.links = tuple(links)
        self.end = constant_pose(end)

    def pose(self) -> Pose:
        """Return the pose of the frame, seen from the parent of the first joint."""
        pose = IDENTITY
        for link in reversed(self.links):
            pose = link.placement.then(link.motion).then(pose)
        return pose.then(self.end)

    def carried(self, point: Any, axis: Any) -> tuple[Any, Any]:
        """Return a point and a direction of the frame, seen from the parent of the first joint; cheaper than the whole pose."""
        for pose in reversed(self._poses):
            point, axis = pose.rotation @ point + pose.translation, pose.rotation @ axis
        return point, axis

    def into(self, point: Any, axis: Any) -> tuple[Any, Any]:
        """Return a point and a direction of the parent of the first joint in coordinates of the frame; inverse of `carried`."""
        for pose in self._poses:
            point, axis = pose.rotation.T @ (point - pose.translation), pose.rotation.T @ axis
        return point, axis

    @property
    def _poses(self) -> tuple[Pose, ...]:
        """Placements and motions from the base outwards, and the frame."""
        return *(pose for link in self.links for pose in (link.placement, link.motion)), self.end

    def twists(self, errors: Any, by_position: Any, terms: int) -> tuple[Pose, list[Twist]]:
        """Return the pose of the frame and its twist per unit of every axis, with errors (6·frames,) that depend on the axes.

        ``by_position`` (6·frames, axes) are the errors' derivatives, ``terms`` those of the Jacobian of Exp, I + [e]/2 + …: one or two.
        """
        none = ca.SX(3, 1)
        twists: list[Twist] = [(none, none) for _ in range(by_position.shape[1])]
        pose = IDENTITY
        for link in self.links:
            pose = pose.then(link.placement)
            after = pose.then(link.motion)
            if link.axis is not None:
                twists[link.axis] = _plus_twist(twists[link.axis], pose, pose.translation, *joint_twist(link.joint))
            elif link.error is not None:
                i = link.error
                for axis in range(len(twists)):
                    shift, turn = by_position[i : i + 3, axis], by_position[i + 3 : i + 6, axis]
                    if shift.nnz() + turn.nnz() == 0:
                        continue
                    if terms > 1:
                        turn = turn + 0.5 * ca.cross(errors[i + 3 : i + 6], turn)
                    twists[axis] = _plus_twist(twists[axis], pose, after.translation, turn, shift)
            pose = after
        return pose.then(self.end), twists


def _plus_twist(twist: Twist, pose: Pose, centre: Any, turn: Any, shift: Any) -> Twist:
    """Return the sum of a twist and another one that is given in the frame of ``pose`` about ``centre``."""
    about = pose.rotation @ turn
    return twist[0] + about, twist[1] + pose.rotation @ shift + ca.cross(centre, about)


def links(machine: Machine, joint: int, q: Any, e: Any) -> list[Link]:
    """Return the joints from the base to ``joint``, inclusive, at positions (axes,) with errors (6·frames,), or None: nominal."""
    model = machine.model
    axes = {joint: i for i, joint in enumerate(machine.axis_joints)}
    errors = {frame.joint: 6 * i for i, frame in enumerate(machine.frames)}
    links = []
    for index in list(model.supports[joint])[1:]:
        axis, error = axes.get(index), errors.get(index)
        motion = IDENTITY
        if axis is not None:
            motion = joint_pose(model.joints[index], q[axis])
        elif error is not None and e is not None:
            motion = Pose(rotation_exp(e[error + 3 : error + 6]), e[error : error + 3])
        links.append(Link(model.joints[index], constant_pose(model.jointPlacements[index]), motion, axis, error))
    return links


def branches(machine: Machine, q: Any, e: Any) -> tuple[Branch, Branch]:
    """Return the branches to the tool frame and to the work frame without the joints that they share, which move both."""
    frames = [machine.model.frames[frame] for frame in (machine.tool_frame, machine.work_frame)]
    paths = [list(machine.model.supports[frame.parentJoint])[1:] for frame in frames]
    shared = sum(a == b for a, b in zip(*paths, strict=False))
    tool, work = (Branch(links(machine, frame.parentJoint, q, e)[shared:], frame.placement) for frame in frames)
    return tool, work


@lru_cache(maxsize=16)  # used for every axis in every diagnosis; a machine is immutable
def gravity_load(machine: Machine) -> ca.Function:
    """Return the function of the gravity loads along each axis of the nominal machine: q (axes,) → (axes, 9) N or N·m.

    A load is the negative gradient of the potential energy. The nine loads are those of the masses in the URDF (zero if it has none),
    of 1 kg at the tool frame, of 1 kg·m along its x, y and z, and the same four at the work frame
    (`twin.model.effects.base.Payload`).
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
    """Return rotation (3, 1) and translation (3, 1) of a one-degree-of-freedom joint: Pinocchio's motion subspace."""
    data = joint.createData()
    joint.calc(data, np.zeros(joint.idx_q + joint.nq), np.zeros(joint.idx_v + joint.nv))
    motion = np.asarray(data.S).reshape(6)
    return ca.sparsify(ca.DM(motion[3:])), ca.sparsify(ca.DM(motion[:3]))


def joint_pose(joint: pin.JointModel, value: Any) -> Pose:
    """Return the transformation of a one-degree-of-freedom joint that is moved by ``value``."""
    axis, shift = (ca.densify(part) for part in joint_twist(joint))
    if np.any(np.asarray(shift)):
        return Pose(ca.SX.eye(3), shift * value)
    cross = ca.skew(axis)
    turn = ca.SX.eye(3) + ca.sin(value) * cross + (1.0 - ca.cos(value)) * (cross @ cross)
    return Pose(turn, ca.SX.zeros(3))


def constant_pose(placement: pin.SE3) -> Pose:
    """Return a placement of the model as a pose."""
    # Sparse, so that exact zeros of a placement cost no multiplications.
    return Pose(ca.SX(ca.sparsify(ca.DM(placement.rotation))), ca.SX(ca.sparsify(ca.DM(placement.translation))))


def sparse(*values: float) -> Any:
    """Return a column of numbers of which zeros cost no multiplications."""
    return ca.SX(ca.sparsify(ca.DM(values)))


IDENTITY: Final = constant_pose(pin.SE3.Identity())
"""The identity transformation."""
