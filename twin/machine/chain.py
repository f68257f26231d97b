"""The machine's chain as a CasADi expression, built from the Pinocchio model's own placements.

Branch-free on purpose: the same expression is differentiated, mapped over batches and, one day, compiled for SIMD.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

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
    pose = tool_in_work(machine, q, e, length)
    return ca.Function("chain", [q, e, length], [pose.rotation, pose.translation], ["q", "e", "length"], ["R", "p"])


def tool_in_work(machine: Machine, q: Any, e: Any, length: Any) -> Pose:
    """``work⁻¹ · tool``, the tip ``length`` below the tool frame (contract §1)."""
    tip = Pose(ca.SX.eye(3), ca.vertcat(0.0, 0.0, -length))
    tool = frame_pose(machine, machine.tool_frame, q, e).then(tip)
    work = frame_pose(machine, machine.work_frame, q, e)
    return work.inverse().then(tool)


def frame_pose(machine: Machine, frame: int, q: Any, e: Any) -> Pose:
    """A frame of the model in the base frame."""
    placed = machine.model.frames[frame]
    return _joint_in_base(machine, placed.parentJoint, q, e).then(constant_pose(placed.placement))


def _joint_in_base(machine: Machine, joint: int, q: Any, e: Any) -> Pose:
    model = machine.model
    moving = {joint: q[i] for i, joint in enumerate(machine.axis_joints)}
    erring = {frame.joint: e[6 * i : 6 * i + 6] for i, frame in enumerate(machine.frames)}
    pose = constant_pose(pin.SE3.Identity())
    while joint != 0:
        if joint in erring:
            error = erring[joint]
            motion = Pose(rotation_exp(error[3:6]), error[0:3])
        else:
            motion = joint_pose(model.joints[joint], moving.get(joint, 0.0))
        pose = constant_pose(model.jointPlacements[joint]).then(motion).then(pose)
        joint = model.parents[joint]
    return pose


@lru_cache(maxsize=16)  # every diagnosis asks for it, for each axis; a machine never changes
def gravity_load(machine: Machine) -> ca.Function:
    """What gravity does along each axis of the machine as drawn: q (axes,) → (axes, 9) N or N·m, minus the slope of its potential.

    Of the masses of the URDF, zero where it gives none; of 1 kg at the tool frame, of 1 kg·m along its x, y and z; likewise at the
    work frame (`twin.machine.effects.payload.Payload`).
    """
    model = machine.model
    q = ca.SX.sym("q", len(machine.axes))
    gravity = ca.DM(np.asarray(model.gravity.linear))
    none = ca.SX.zeros(6 * len(machine.frames))
    potential = [ca.SX(0.0)]
    for joint in range(1, model.njoints):
        inertia = model.inertias[joint]
        if inertia.mass > 0.0:
            pose = _joint_in_base(machine, joint, q, none)
            centre = pose.rotation @ ca.DM(np.asarray(inertia.lever)) + pose.translation
            potential[0] = potential[0] - inertia.mass * ca.dot(gravity, centre)
    for frame in (machine.tool_frame, machine.work_frame):
        pose = frame_pose(machine, frame, q, none)
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
