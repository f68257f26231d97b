"""Clearance between the tool side and the work side, and between every reflector and everything that does not move with it.

Only the shapes in the URDF are known; holders, posts, clamps, cables and workpieces are not. Shapes that touch in the middle of the
ranges touch by design (a slide on its guideway) and are ignored.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final, final

import coal
import numpy as np
import pinocchio as pin

from twin._common.units import MM
from twin.machine.machine import Machine
from twin.planning.kit import Kit
from twin.planning.sight import machine_shapes

MARGIN_MM: Final = 25.0
"""Minimum distance between the tool side and the work side, mm."""
REFLECTOR_MM: Final = 40.0
"""Radius of the sphere that represents a 1.5 inch reflector with its nest, mm."""
STEP_MM: Final = 20.0
STEP_DEG: Final = 4.0
"""Step of a rotary axis at which a move is checked: less than the margin for shapes within 0.35 m of the axis."""


@final
@dataclass(frozen=True)
class Body:
    """A further body on one of the sides: a reflector, a probe, a sphere.

    Attributes:
        carrier: ``tool`` or ``work``.
        shape: its shape, metres.
        place_mm: centre of the shape on its carrier, mm.
        contact: whether it may touch others that may.
    """

    carrier: str
    shape: coal.CollisionGeometry
    place_mm: tuple[float, float, float]
    contact: bool = False


@final
class Clearance:
    """Clearance check for one machine.

    Args:
        machine: the machine.
        kit: its reflectors belong to the sides that carry them.
        bodies: further bodies.
        margin_mm: minimum distance.
    """

    def __init__(self, machine: Machine, kit: Kit, bodies: tuple[Body, ...] = (), margin_mm: float = MARGIN_MM) -> None:
        self.machine = machine
        self.kit = kit
        self.bodies = bodies
        self.margin_mm = margin_mm

    @cached_property
    def has_shapes(self) -> bool:
        """Whether the URDF has shapes on either side; if not, only the reflectors are kept clear of each other."""
        return any(self._side(shape.joint) is not None for shape in machine_shapes(self.machine))

    def is_clear(self, position: np.ndarray) -> bool:
        """Return whether a pose (axes,), mm and degrees, has clearance."""
        model, data, own = self._pairs
        q = self.machine.configuration(position * self.machine.scale)
        return not pin.computeCollisions(self.machine.model, data, model, own, q, True)

    def is_move_clear(self, start: np.ndarray, end: np.ndarray) -> bool:
        """Return whether the straight move between two poses has clearance, end points included; all axes move together."""
        way = np.abs(end - start)
        size = np.array([STEP_MM if axis.linear else STEP_DEG for axis in self.machine.axes])
        share = min(1.0, self.margin_mm / MARGIN_MM)
        count = int(np.ceil((way / (share * size)).max(initial=0.0))) + 1
        # Check from the middle outwards: collisions are most likely there.
        parts = sorted(np.linspace(0.0, 1.0, count + 1), key=lambda part: abs(part - 0.5))
        return all(self.is_clear(start + part * (end - start)) for part in parts)

    @cached_property
    def _pairs(self) -> tuple[pin.GeometryModel, pin.Data, pin.GeometryData]:
        model = pin.GeometryModel()
        sides: dict[str, list[int]] = {"tool": [], "work": []}
        drawn: list[tuple[int, int]] = []
        for number, shape in enumerate(machine_shapes(self.machine)):
            entry = pin.GeometryObject(f"shape {number}", shape.joint, shape.placement, shape.geometry)
            index = model.addGeometryObject(entry)
            drawn.append((index, shape.joint))
            side = self._side(shape.joint)
            if side is not None:
                sides[side].append(index)
        reflectors: dict[int, Body] = {}
        pairs = {(a, b) for a in sides["tool"] for b in sides["work"]}
        ball = coal.Sphere(REFLECTOR_MM * MM)
        targets = [Body(target.carrier, ball, target.place_mm) for target in self.kit.targets.values()]
        for number, body in enumerate((*targets, *self.bodies)):
            frame = self.machine.model.frames[
                self.machine.tool_frame if body.carrier == "tool" else self.machine.work_frame
            ]
            place = frame.placement * pin.SE3(np.eye(3), np.array(body.place_mm) * MM)
            entry = pin.GeometryObject(f"body {number}", frame.parentJoint, place, body.shape)
            index = model.addGeometryObject(entry)
            # Axis ranges prevent collisions of the machine itself, not of reflectors: check against all that moves relative to them.
            pairs |= {(index, other) for other, joint in drawn if joint != frame.parentJoint}
            pairs |= {
                (index, other)
                for other, own in reflectors.items()
                if model.geometryObjects[other].parentJoint != frame.parentJoint and not (own.contact and body.contact)
            }
            reflectors[index] = body
        data = self.machine.model.createData()
        middle = self.machine.configuration(
            np.mean([axis.domain for axis in self.machine.axes], axis=1) * self.machine.scale
        )
        pin.forwardKinematics(self.machine.model, data, middle)
        ordered = sorted(pairs)
        for a, b in ordered:
            model.addCollisionPair(pin.CollisionPair(a, b))
        own = pin.GeometryData(model)
        pin.computeCollisions(self.machine.model, data, model, own, middle, False)
        touching = [
            ordered[k]
            for k, result in enumerate(own.collisionResults)
            if result.isCollision() and not {*ordered[k]} & {*reflectors}
        ]
        for a, b in touching:
            model.removeCollisionPair(pin.CollisionPair(a, b))
        own = pin.GeometryData(model)
        for request in own.collisionRequests:
            request.security_margin = self.margin_mm * MM
        return model, data, own

    def _side(self, joint: int) -> str | None:
        """Return the carrier that a joint moves; None if it moves neither or both."""
        model = self.machine.model
        moving = {int(j) for j in self.machine.axis_joints}
        if not moving & {int(j) for j in model.supports[joint]}:
            return None
        tool = joint in model.supports[model.frames[self.machine.tool_frame].parentJoint].tolist()
        work = joint in model.supports[model.frames[self.machine.work_frame].parentJoint].tolist()
        return None if tool == work else "tool" if tool else "work"
