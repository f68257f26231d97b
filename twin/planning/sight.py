"""Visibility of reflectors from stations: the beam must be free of the machine's shapes and within the acceptance angle.

The machine's shapes are those of its URDF (``collision``, or ``visual`` if it has none): boxes, cylinders, spheres, and for a mesh its
bounding box. The nominal machine is used, as errors are only micrometres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final, final

import coal
import numpy as np
import pinocchio as pin

from twin._common.errors import InputError
from twin._common.units import MM
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.planning.kit import Kit, Target

NEST: Final = 0.03
"""Length of the beam next to the reflector that is not checked because of its nest, m."""


@final
@dataclass(frozen=True)
class Shape:
    """Shape of the URDF.

    Attributes:
        joint: joint of the machine's model that moves it.
        geometry: geometry object of coal.
        placement: placement in the frame of the joint.
    """

    joint: int
    geometry: coal.CollisionGeometry
    placement: pin.SE3


def machine_shapes(machine: Machine) -> list[Shape]:
    """Return the ``collision`` shapes of the machine's URDF, or its ``visual`` shapes if it has none.

    Raises:
        InputError: a shape cannot be loaded.
    """
    found: list[Shape] = []
    for kind in (pin.GeometryType.COLLISION, pin.GeometryType.VISUAL):
        try:
            geometry = pin.buildGeomFromUrdf(machine.model, str(machine.urdf), kind)
        except (ValueError, RuntimeError) as error:
            raise InputError(
                "a shape cannot be loaded", expected="shapes whose files exist", file=machine.urdf, value=error
            ) from error
        found = [Shape(int(o.parentJoint), o.geometry, o.placement) for o in geometry.geometryObjects]
        if found:
            break
    return found


@final
@dataclass(frozen=True)
class _Solid:
    """Shape that blocks a beam; ``half`` are its half sizes along x, y, z."""

    kind: str
    half: np.ndarray
    joint: int
    placement: np.ndarray


@final
class Sight:
    """Visibility between the stations and reflectors of one machine.

    Args:
        machine: the machine.
        kit: stations and targets.

    Raises:
        InputError: a shape of the URDF cannot be loaded.
    """

    def __init__(self, machine: Machine, kit: Kit) -> None:
        self.machine = machine
        self.kit = kit

    def poses(self, positions: np.ndarray) -> dict[str, np.ndarray]:
        """Return the poses (n, 4, 4) of the two carriers in the base frame, metres, at commands (n, axes) in mm and degrees."""
        frames = {"tool": self.machine.tool_frame, "work": self.machine.work_frame}
        data = self.machine.model.createData()
        found = {side: np.empty((len(positions), 4, 4)) for side in frames}
        for i, q in enumerate(positions * self.machine.scale):
            pin.framesForwardKinematics(self.machine.model, data, self.machine.configuration(q))
            for side, frame in frames.items():
                found[side][i] = data.oMf[frame].homogeneous
        return found

    def reflectors(self, poses: dict[str, np.ndarray], target: Target) -> np.ndarray:
        """Return the positions (n, 3) of a reflector in the base frame, metres."""
        pose = poses[target.carrier]
        return np.asarray(pose[:, :3, :3] @ (np.array(target.place_mm) * MM) + pose[:, :3, 3])

    def towards(
        self, poses: dict[str, np.ndarray], target: Target, origin_mm: tuple[float, float, float]
    ) -> np.ndarray:
        """Return the unit vectors (n, 3) from a reflector to a station, in the frame of the reflector's carrier."""
        beam = np.array(origin_mm) * MM - self.reflectors(poses, target)
        beam /= np.linalg.norm(beam, axis=1, keepdims=True)
        return np.asarray(np.einsum("nji,nj->ni", poses[target.carrier][:, :3, :3], beam))

    def directions(self, plan: Measurements) -> np.ndarray:
        """Return the unit vectors (n, 3) from reflector to station per row, in carrier frames; zero if the kit lacks either."""
        poses = self.poses(plan.positions)
        found = np.zeros((len(plan), 3))
        for station in self.kit.stations:
            for target in self.kit.targets:
                rows = np.flatnonzero((plan.station == station) & (plan.target == target))
                if len(rows):
                    of = {side: pose[rows] for side, pose in poses.items()}
                    found[rows] = self.towards(of, self.kit.targets[target], self.kit.stations[station].origin_mm)
        return found

    def visible(self, positions: np.ndarray) -> dict[tuple[str, str], np.ndarray]:
        """Return whether each target is visible (n,) by (station, target), at commands (n, axes) in mm and degrees."""
        poses = self.poses(positions)
        blocked = self._blocked(positions, poses) if self.kit.opaque else {}
        found = {}
        for station, stand in self.kit.stations.items():
            for name, target in self.kit.targets.items():
                seen = ~blocked.get((station, name), np.zeros(len(positions), dtype=bool))
                if target.facing is not None:
                    along = self.towards(poses, target, stand.origin_mm) @ np.array(target.facing)
                    seen &= along >= np.cos(target.acceptance_rad)
                found[station, name] = seen
        return found

    def _blocked(self, positions: np.ndarray, poses: dict[str, np.ndarray]) -> dict[tuple[str, str], np.ndarray]:
        pairs = [(station, name) for station in self.kit.stations for name in self.kit.targets]
        starts, ends = [], []
        for station, name in pairs:
            eye = np.array(self.kit.stations[station].origin_mm) * MM
            reflector = self.reflectors(poses, self.kit.targets[name])
            away = eye - reflector
            starts.append(reflector + NEST * away / np.linalg.norm(away, axis=1, keepdims=True))
            ends.append(np.broadcast_to(eye, reflector.shape))
        start, end = np.stack(starts, axis=1), np.stack(ends, axis=1)
        hit = np.zeros(start.shape[:2], dtype=bool)
        placed = self._placed(positions, sorted({solid.joint for solid in self._solids}))
        for shape in self._solids:
            pose = placed[shape.joint] @ shape.placement
            turn, origin = pose[:, :3, :3], pose[:, None, :3, 3]
            hit |= _through(shape, (start - origin) @ turn, (end - origin) @ turn)
        return {pair: hit[:, i] for i, pair in enumerate(pairs)}

    def _placed(self, positions: np.ndarray, joints: list[int]) -> dict[int, np.ndarray]:
        data = self.machine.model.createData()
        found = {joint: np.empty((len(positions), 4, 4)) for joint in joints}
        for i, q in enumerate(positions * self.machine.scale):
            pin.forwardKinematics(self.machine.model, data, self.machine.configuration(q))
            for joint in joints:
                found[joint][i] = data.oMi[joint].homogeneous
        return found

    @cached_property
    def _solids(self) -> list[_Solid]:
        return [_solid(shape) for shape in machine_shapes(self.machine)]


def _solid(shape: Shape) -> _Solid:
    own, placement = shape.geometry, shape.placement.homogeneous
    if isinstance(own, coal.Box):
        return _Solid("box", np.array(own.halfSide), shape.joint, placement)
    if isinstance(own, coal.Cylinder):
        return _Solid("cylinder", np.array([own.radius, own.radius, own.halfLength]), shape.joint, placement)
    if isinstance(own, coal.Sphere):
        return _Solid("sphere", np.full(3, own.radius), shape.joint, placement)
    own.computeLocalAABB()
    low, high = np.array(own.aabb_local.min_), np.array(own.aabb_local.max_)
    middle = np.eye(4)
    middle[:3, 3] = (low + high) / 2.0
    return _Solid("box", (high - low) / 2.0, shape.joint, placement @ middle)


def _through(shape: _Solid, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return whether segments pass through a shape centred at the origin; start and end (…, 3) in its frame."""
    way = end - start
    if shape.kind == "box":
        enter, leave = _slab(start, way, shape.half)
    else:
        axes = 3 if shape.kind == "sphere" else 2
        enter, leave = _round(start[..., :axes], way[..., :axes], float(shape.half[0]))
        if shape.kind == "cylinder":
            below, above = _slab(start[..., 2:], way[..., 2:], shape.half[2:])
            enter, leave = np.maximum(enter, below), np.minimum(leave, above)
    return np.asarray(np.maximum(enter, 0.0) < np.minimum(leave, 1.0))


def _slab(start: np.ndarray, way: np.ndarray, half: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the parameters at which lines enter and leave a box (slab method; Kay and Kajiya 1986)."""
    safe = np.where(np.abs(way) < 1e-300, 1e-300, way)
    first, second = (-half - start) / safe, (half - start) / safe
    return np.minimum(first, second).max(axis=-1), np.maximum(first, second).min(axis=-1)


def _round(start: np.ndarray, way: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the parameters at which lines enter and leave a circle or sphere; +∞ and −∞ if they miss it."""
    a = np.maximum(np.sum(way**2, axis=-1), 1e-300)
    b = np.sum(start * way, axis=-1)
    root = b**2 - a * (np.sum(start**2, axis=-1) - radius**2)
    depth = np.sqrt(np.maximum(root, 0.0))
    missed = root <= 0.0
    return np.where(missed, np.inf, (-b - depth) / a), np.where(missed, -np.inf, (-b + depth) / a)
