"""Clearance between the tool side and the work side, and between every reflector and everything that does not move with it.

Only the shapes in the URDF are known; holders, posts, clamps, cables and workpieces are not. Shapes that touch in the middle of the
ranges touch by design (a slide on its guideway) and are ignored.

A beam from station to reflector must be free of the machine's shapes and within the acceptance angle. The machine's shapes are those of
its URDF (``collision``, or ``visual`` if it has none): boxes, cylinders, spheres, and for a mesh its bounding box. The nominal machine
is used, as errors are only micrometres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Final, final

import coal
import numpy as np
import pinocchio as pin

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.units import MM
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.planning.kit import Kit, Target
from twin.tool.uncertainty import latin_hypercube

NEST: Final = 0.03
"""Length of the beam next to the reflector that is not checked because of its nest, m."""


@final
@dataclass(frozen=True)
class Shape:
    """Shape of the URDF."""

    joint: int  # joint of the machine's model that moves it
    geometry: coal.CollisionGeometry  # geometry object of coal
    placement: pin.SE3  # placement in the frame of the joint


def machine_shapes(machine: Machine) -> list[Shape]:
    """Return the ``collision`` shapes of the machine's URDF, or its ``visual`` ones; `InputError` if one cannot be loaded."""
    machine_shapes: list[Shape] = []
    for kind in (pin.GeometryType.COLLISION, pin.GeometryType.VISUAL):
        try:
            geometry = pin.buildGeomFromUrdf(machine.model, str(machine.urdf), kind)
        except (ValueError, RuntimeError) as error:
            raise InputError(
                "a shape cannot be loaded", expected="shapes whose files exist", file=machine.urdf, value=error
            ) from error
        machine_shapes = [Shape(int(o.parentJoint), o.geometry, o.placement) for o in geometry.geometryObjects]
        if machine_shapes:
            break
    return machine_shapes


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
    """Visibility between the stations and reflectors of one machine. Raises `InputError`: a shape of the URDF cannot be loaded."""

    def __init__(self, machine: Machine, kit: Kit) -> None:
        self.machine = machine
        self.kit = kit

    def poses(self, positions: np.ndarray) -> dict[str, np.ndarray]:
        """Return the poses (n, 4, 4) of the two carriers in the base frame, metres, at commands (n, axes) in mm and degrees."""
        frames = {"tool": self.machine.tool_frame, "work": self.machine.work_frame}
        data = self.machine.model.createData()
        poses = {side: np.empty((len(positions), 4, 4)) for side in frames}
        for i, q in enumerate(positions * self.machine.scale):
            pin.framesForwardKinematics(self.machine.model, data, self.machine.configuration(q))
            for side, frame in frames.items():
                poses[side][i] = data.oMf[frame].homogeneous
        return poses

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
        directions = np.zeros((len(plan), 3))
        for station in self.kit.stations:
            for target in self.kit.targets:
                rows = np.flatnonzero((plan.station == station) & (plan.target == target))
                if len(rows):
                    of = {side: pose[rows] for side, pose in poses.items()}
                    directions[rows] = self.towards(of, self.kit.targets[target], self.kit.stations[station].origin_mm)
        return directions

    def visible(self, positions: np.ndarray) -> dict[tuple[str, str], np.ndarray]:
        """Return whether each target is visible (n,) by (station, target), at commands (n, axes) in mm and degrees."""
        poses = self.poses(positions)
        blocked = self._blocked(positions, poses) if self.kit.opaque else {}
        visible = {}
        for station, stand in self.kit.stations.items():
            for name, target in self.kit.targets.items():
                seen = ~blocked.get((station, name), np.zeros(len(positions), dtype=bool))
                if target.facing is not None:
                    along = self.towards(poses, target, stand.origin_mm) @ np.array(target.facing)
                    seen &= along >= np.cos(target.acceptance_rad)
                visible[station, name] = seen
        return visible

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
        placed = {joint: np.empty((len(positions), 4, 4)) for joint in joints}
        for i, q in enumerate(positions * self.machine.scale):
            pin.forwardKinematics(self.machine.model, data, self.machine.configuration(q))
            for joint in joints:
                placed[joint][i] = data.oMi[joint].homogeneous
        return placed

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


# --- Clearance between the tool side and the work side, and between every reflector and everything that does not move with it

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
    """A further body on one of the sides: a reflector, a probe, a sphere."""

    carrier: str  # ``tool`` or ``work``
    shape: coal.CollisionGeometry  # its shape, metres
    place_mm: tuple[float, float, float]  # centre of the shape on its carrier, mm
    contact: bool = False  # whether it may touch others that may


@final
class Clearance:
    """Clearance check for one machine."""

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


# --- Candidate readings: poses with clearance, and the reflectors visible there from each possible station

POSES: Final = 240
BATCHES: Final = 8
"""Batches of poses drawn before planning gives up for lack of clearance."""
FEWEST: Final = 20
ROUNDED_TO: Final = 1.0
"""Commands are rounded to this, mm or degrees, for readability."""
SHARE_AT_LIMIT: Final = 0.4
"""Share of poses with one axis at a limit of its range, where curves are least certain."""


@final
@dataclass(frozen=True)
class Session:
    """A state of the machine in which readings are taken."""

    instruction: str  # instruction for bringing the machine into this state
    start_s: float = 0.0  # earliest start on the clock of ``time_s``
    # °C of axes and sensors, by name
    temperatures: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))


ANY_STATE: Final = (Session("as it is"),)
"""Single session for plans in which the machine's state does not matter."""


@final
@dataclass(frozen=True)
class CandidateReadings:
    """Candidate readings in all sessions."""

    plan: Measurements  # the readings, one row each
    session: np.ndarray  # (n,) index of each reading's session
    sessions: tuple[Session, ...] = ANY_STATE  # states of the machine, in order

    def select(self, rows: np.ndarray) -> CandidateReadings:
        """Return the candidates with these indices; an index may repeat."""
        return replace(self, plan=self.plan.select(rows), session=self.session[rows])


def candidates(machine: Machine, kit: Kit, rng: np.random.Generator, levels: int | None = None) -> CandidateReadings:
    """Return every possible reading, one row each; the direction of approach of each axis is drawn per pose.

    ``levels``: number of positions of each axis over its range (`Task.levels`); None: any multiple of `ROUNDED_TO`. `InputError` if too
    few poses have clearance, or a reflector is visible from no station.
    """
    positions = _safe_poses(machine, kit, rng, levels)
    seen = Sight(machine, kit).visible(positions)
    sides = rng.choice([-1.0, 1.0], positions.shape)
    rows: list[tuple[int, str, str]] = []
    for name in kit.targets:
        mine = [(int(i), station, name) for station in kit.stations for i in np.flatnonzero(seen[station, name])]
        if not mine:
            raise InputError(
                f"target {name} is hidden from every station at every pose",
                expected="another place for the target, another station, or `stops_the_beam: nothing` in the kit",
                value=f"{kit.targets[name].place_mm} mm on the {kit.targets[name].carrier} side",
            )
        rows += mine
    pose = np.array([row[0] for row in rows])
    table = plan_table(machine, kit, positions[pose], [r[2] for r in rows], [r[1] for r in rows], sides[pose])
    return CandidateReadings(table, np.zeros(len(table), dtype=int))


def _safe_poses(machine: Machine, kit: Kit, rng: np.random.Generator, levels: int | None) -> np.ndarray:
    """Return clear commands (n, axes) in mm and degrees over the kit's ranges; `InputError` if they are too few."""
    clearance = Clearance(machine, kit)
    poses: list[np.ndarray] = []
    low, high = kit.ranges.T
    unlimited = np.array([axis.lower is None for axis in machine.axes])
    for _ in range(BATCHES):
        drawn = latin_hypercube(kit.ranges, POSES, rng)
        ended = np.flatnonzero(rng.random(POSES) < SHARE_AT_LIMIT)
        axis = rng.choice(np.flatnonzero(~unlimited), len(ended)) if not unlimited.all() else ended[:0]
        for row, i in zip(ended, axis, strict=False):
            drawn[row, i] = low[i] if rng.random() < 0.5 else high[i]
        if levels is not None:
            # On an unlimited axis the last level coincides with the first.
            step = (high - low) / np.where(unlimited, levels, levels - 1)
            drawn = low + np.round((drawn - low) / step) * step
            drawn = np.where(unlimited, low + np.mod(drawn - low, high - low), drawn)
        whole = np.clip(np.round(drawn / ROUNDED_TO) * ROUNDED_TO, low, high)
        poses += [pose for pose in whole if clearance.is_clear(pose)]
        if len(poses) >= POSES:
            break
    if len(poses) < FEWEST:
        raise InputError(
            "too few poses keep the tool side clear of the work side",
            expected=f"at least {FEWEST} of {BATCHES * POSES} poses: shorter holders, or narrower `ranges` in the kit",
            value=len(poses),
        )
    return np.unique(np.array(poses[:POSES]), axis=0)


def plan_table(
    machine: Machine,
    kit: Kit,
    positions: np.ndarray,
    target: list[str],
    station: list[str],
    approach: np.ndarray,
    *,
    source: str = "plan",
) -> Measurements:
    """Return a plan, n readings, as a measurement table without coordinates; ``approach`` (n, axes): +1, −1, 0 any."""
    n = len(target)
    return Measurements(
        source=source,
        lines=read_only(np.arange(1, n + 1)),
        positions=read_only(np.array(positions, dtype=float).reshape(n, len(machine.axes))),
        target=read_only(np.array(target, dtype=object)),
        carrier=read_only(np.array([kit.targets[name].carrier for name in target], dtype=object)),
        station=read_only(np.array(station, dtype=object)),
        approach=read_only(np.array(approach, dtype=float).reshape(n, len(machine.axes))),
        place_mm=read_only(np.array([kit.targets[name].place_mm for name in target]).reshape(n, 3)),
        station_pose=read_only(np.array([kit.stations[name].pose for name in station]).reshape(n, 6)),
    )
