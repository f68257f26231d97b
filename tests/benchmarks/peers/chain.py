"""The machine without errors as one serial chain from the table to the tool tip, the only form that most robotics packages accept."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from twin.machine.machine import Machine


@dataclass(frozen=True)
class SerialJoint:
    """A joint of the chain.

    Attributes:
        placement: its frame in that of the joint before it, both at zero.
        axis: (3,) its axis in its own frame; reversed for the joints between table and base.
        linear: whether it is prismatic.
        column: column of the commands that moves it.
    """

    placement: pin.SE3
    axis: np.ndarray
    linear: bool
    column: int

    @property
    def along_z(self) -> pin.SE3:
        """Rotation from a frame whose z axis is the joint's axis."""
        z = np.array([0.0, 0.0, 1.0])
        normal = np.cross(z, self.axis)
        if np.linalg.norm(normal) > 1e-9:
            rotation = pin.Quaternion.FromTwoVectors(z, self.axis).matrix()
        else:
            rotation = np.diag([1.0, self.axis[2], self.axis[2]])
        return pin.SE3(rotation, np.zeros(3))


@dataclass(frozen=True)
class SerialChain:
    """Joints from the table to the tool, and the tool tip in the frame of the last one."""

    joints: tuple[SerialJoint, ...]
    tip: pin.SE3

    def pose(self, q: np.ndarray) -> pin.SE3:
        """Return the tool tip in the table's frame; ``q``: commands in metres and radians, command order."""
        found = pin.SE3.Identity()
        for joint in self.joints:
            motion = joint.axis * q[joint.column]
            found = found * joint.placement
            found = found * (pin.SE3(np.eye(3), motion) if joint.linear else pin.SE3(pin.exp3(motion), np.zeros(3)))
        return found * self.tip


def serial_chain(machine: Machine, tool_length_mm: float) -> SerialChain:
    """Return the chain of a machine without errors."""
    model, data = machine.model, machine.model.createData()
    pin.framesForwardKinematics(model, data, machine.configuration(np.zeros(len(machine.axes))))
    work, tool = (
        [joint for joint in model.supports[model.frames[frame].parentJoint] if joint in machine.axis_joints]
        for frame in (machine.work_frame, machine.tool_frame)
    )
    before, joints = data.oMf[machine.work_frame], []
    for sign, number in [*((-1.0, joint) for joint in reversed(work)), *((1.0, joint) for joint in tool)]:
        subspace = _subspace(model.joints[number])
        linear = bool(np.any(subspace[:3]))
        axis = sign * (subspace[:3] if linear else subspace[3:])
        column = machine.axis_joints.index(number)
        joints.append(SerialJoint(before.actInv(data.oMi[number]), axis, linear, column))
        before = data.oMi[number]
    tip = pin.SE3(np.eye(3), np.array([0.0, 0.0, -tool_length_mm * 1e-3]))
    return SerialChain(tuple(joints), before.actInv(data.oMf[machine.tool_frame]) * tip)


def _subspace(joint: Any) -> np.ndarray:
    """Return the (6,) motion of a joint in its frame, translation first."""
    data = joint.createData()
    joint.calc(data, np.zeros(joint.nq))
    return np.asarray(data.S).reshape(6)


def pinocchio_model(chain: SerialChain) -> pin.Model:
    """Return the chain as a Pinocchio model; its frame ``tip`` is the tool tip, and its joints are in the order of the chain."""
    model, parent = pin.Model(), 0
    for joint in chain.joints:
        kind = pin.JointModelPrismaticUnaligned if joint.linear else pin.JointModelRevoluteUnaligned
        parent = model.addJoint(parent, kind(joint.axis), joint.placement, f"joint {joint.column}")
    model.addFrame(pin.Frame("tip", parent, 0, chain.tip, pin.FrameType.OP_FRAME))
    return model
