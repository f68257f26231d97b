"""Contacts of a touch probe on a sphere: directions that keep the stylus away from the stem of the sphere."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, final

import coal
import numpy as np

from twin._common.errors import InputError
from twin._common.messages import Message
from twin._common.units import MM
from twin.machine.machine import Machine
from twin.measurement.columns import CARRIERS
from twin.measurement.observation import observation_of
from twin.planning.clearance import Body, Clearance, machine_shapes
from twin.planning.sequences.specification import SequencePoints, SequenceTask


def linear_positions(
    machine: Machine,
    positions: np.ndarray,
    tip_mm: tuple[float, float, float],
    places_mm: np.ndarray,
    offset_mm: np.ndarray,
) -> np.ndarray:
    """Return positions (n, axes) with the tool's part ``tip_mm`` at (n, 3) places in the work frame, offset in the base frame.

    The positions of the linear axes are replaced, from the nominal kinematics; `InputError` unless three move the tool in all
    directions.
    """
    linear = list(machine.linear)
    q = np.array(positions, dtype=float)
    middle = [np.mean(machine.axes[i].domain) for i in linear]
    q[:, linear] = middle
    tips = np.broadcast_to(np.array(tip_mm), (len(q), 3))

    def gap(at: np.ndarray) -> np.ndarray:
        tool, work = (
            carried_points_mm(machine, at, side, place) for side, place in zip(CARRIERS, (tips, places_mm), strict=True)
        )
        return np.asarray(tool - work - offset_mm)

    here = gap(q)
    # Linear axes translate: the gap is an affine function of their positions.
    step = np.stack([gap(q + np.eye(len(machine.axes))[i]) - here for i in linear], axis=2)
    if len(q) and np.abs(np.linalg.det(step)).min() < 1e-6:
        raise InputError("the linear axes do not move the tool in all directions", expected="three independent axes")
    q[:, linear] -= np.linalg.solve(step, here[:, :, None])[:, :, 0]
    return q


def carried_points_mm(machine: Machine, positions: np.ndarray, side: str, places_mm: np.ndarray) -> np.ndarray:
    """Return (n, 3) points of the nominal machine, base frame, mm, from places in the frame of ``side``: ``tool`` or ``work``."""
    n = len(positions)
    errors, carrier = np.zeros((n, 6 * len(machine.frames))), np.full(n, side, dtype=object)
    return observation_of(machine).points(positions * machine.scale, errors, carrier, places_mm * MM) / MM


# --- Contacts of a touch probe on a sphere: directions that keep the stylus away from the stem of the sphere

SIDEWAYS: Final = 0.1
"""Share of the stem's direction across the tool axis above which contacts are placed at 45° to it."""
ASIDE: Final = 0.17
"""Largest share of the stem's direction towards the spindle: the stem then stays below the equator."""


@final
@dataclass(frozen=True)
class ContactPose:
    """A pose at a sphere: position with the tip at its centre, and the directions of the contacts."""

    centre: np.ndarray  # (axes,) position with the tip at the nominal centre
    to_axes: np.ndarray  # (3, 3) motion of the linear axes for a motion of the tip in the base frame
    up: np.ndarray  # (3,) from the tip to the spindle, base frame
    stem: np.ndarray  # (3,) from the sphere along its stem, base frame
    sides: np.ndarray  # (4, 3) directions of the contacts at the equator, outwards, base frame

    def at(self, machine: Machine, away_mm: np.ndarray) -> np.ndarray:
        """Return the position (axes,) with the tip away from the centre by a vector of the base frame, mm."""
        position = np.array(self.centre)
        position[list(machine.linear)] += self.to_axes @ away_mm
        return position

    @property
    def stem_aside(self) -> bool:
        """Whether the stem does not point towards the spindle."""
        return bool(self.stem @ self.up < ASIDE)


def contact_poses(task: SequenceTask, positions: np.ndarray, places_mm: np.ndarray) -> list[ContactPose]:
    """Return the poses at spheres, (n, 3) in the work frame, with their directions; ``positions``: (n, axes), tip at the centres."""
    machine, tip = task.machine, np.tile(np.array(task.tip_mm), (len(positions), 1))
    along = np.array([0.0, 0.0, 1.0])

    def gap(q: np.ndarray) -> np.ndarray:
        return carried_points_mm(machine, q, "tool", tip) - carried_points_mm(machine, q, "work", places_mm)

    here = carried_points_mm(machine, positions, "tool", tip)
    ball = carried_points_mm(machine, positions, "work", places_mm)
    up = carried_points_mm(machine, positions, "tool", tip + along) - here
    stem = carried_points_mm(machine, positions, "work", places_mm - along) - ball
    moved = [gap(positions + np.eye(len(machine.axes))[i]) - (here - ball) for i in machine.linear]
    to_axes = np.linalg.inv(np.stack(moved, axis=2))
    return [ContactPose(*row, _sides(row[2], row[3])) for row in zip(positions, to_axes, up, stem, strict=True)]


def _sides(up: np.ndarray, stem: np.ndarray) -> np.ndarray:
    """Return (4, 3) directions at the equator: the stem's direction across the tool axis is halfway between two of them."""
    across = stem - (stem @ up) * up
    if np.linalg.norm(across) < SIDEWAYS:
        across = np.eye(3)[int(np.argmin(np.abs(up)))]
        first = across - (across @ up) * up
        first /= np.linalg.norm(first)
        second = np.cross(up, first)
    else:
        across /= np.linalg.norm(across)
        other = np.cross(up, across)
        first, second = (across + other) / np.sqrt(2.0), (other - across) / np.sqrt(2.0)
    # Neighbours in turn, so that the way over the sphere is short.
    return np.array([first, second, -first, -second])


# --- Positions of the linear axes of a sequence, and the points that the axes reach with clearance

STYLUS_MM: Final = 50.0
"""Length of a stylus that is assumed free of the probe's body."""
BODY_MM: Final = 50.0
"""Diameter of the probe's body that is assumed above the stylus, up to the spindle nose."""
STEM_SHARE: Final = 0.3
"""Diameter of the sphere's stem that is assumed, as a share of that of the sphere; the stem is perpendicular to the table."""
TABLE_SHARE: Final = 0.6
"""Distance of a default sphere from the middle of the table, as a share of the table's radius."""
HEIGHT_MM: Final = 60.0
"""Height of a default sphere above the table."""
CHECKED_SHARE: Final = 0.9
"""Share of the clearance that moves beside the sphere are checked with; they keep the whole of it by construction."""
ASSUMED_RADIUS_MM: Final = 200.0
"""Radius of a table without shapes."""


@final
@dataclass(frozen=True)
class Reached:
    """Points of a sequence that the axes reach."""

    points: SequencePoints  # those points, with the positions of all axes
    dropped: Mapping[Message, int]  # number of the other points by reason


def reach(task: SequenceTask, points: SequencePoints) -> Reached:
    """Return the points that the axes reach with clearance, and why others are not; `InputError` as of `linear_positions`."""
    machine = task.machine
    places = np.array([task.places_mm[str(name)] for name in points.place]).reshape(-1, 3)
    positions = linear_positions(machine, points.positions, task.tip_mm, places, points.offset_mm)
    increment = np.array([axis.increment for axis in machine.axes])
    positions = np.round(np.round(positions / increment) * increment, 9) + 0.0
    linear = np.array([axis.linear for axis in machine.axes])
    limited = np.array([axis.lower is not None for axis in machine.axes])
    margin = np.where(linear, task.margin_mm, 0.0)
    low, high = task.kit.ranges.T
    outside = ((positions < low + margin) | (positions > high - margin)) & limited
    dropped: dict[Message, int] = {}
    for i in np.flatnonzero(outside.any(axis=0)):
        first = outside[:, i] & ~outside[:, :i].any(axis=1)
        if first.any():
            dropped[Message("{name} beyond its range", name=machine.axes[i].name)] = int(first.sum())
    inside = np.flatnonzero(~outside.any(axis=1))
    clear = _clear(task, positions[inside], places[inside])
    kept = inside[clear].tolist()
    if len(kept) < len(inside):
        dropped[Message("too little clearance")] = len(inside) - len(kept)
    found = points.select(np.array(kept, dtype=int))
    reached = SequencePoints(positions[kept], found.place, found.offset_mm, found.run)
    return Reached(reached, MappingProxyType(dropped))


def _clear(task: SequenceTask, positions: np.ndarray, places_mm: np.ndarray) -> np.ndarray:
    """Return (n,) whether poses have clearance, those of a probe also beside the sphere."""
    touching = clearance_of(task.machine, task)
    clear = np.array([touching.is_clear(position) for position in positions], dtype=bool)
    if task.instrument.specification.reads != "null" or not len(positions):
        return clear
    apart = apart_clearance(touching)
    poses = contact_poses(task, positions, places_mm)
    for row, pose in enumerate(poses):
        if clear[row]:
            clear[row] = pose.stem_aside and all(
                apart.is_clear(pose.at(task.machine, task.sizes.around_mm * out))
                and touching.is_clear(pose.at(task.machine, task.sizes.contact_mm * out))
                for out in (pose.up, *pose.sides)
            )
    return clear


def apart_clearance(touching: Clearance) -> Clearance:
    """Return the clearance check for moves in which stylus and sphere do not touch."""
    bodies = tuple(replace(body, contact=False) for body in touching.bodies)
    return Clearance(touching.machine, touching.kit, bodies, CHECKED_SHARE * touching.margin_mm)


def clearance_of(machine: Machine, task: SequenceTask) -> Clearance:
    """Return the clearance check of a machine with a probe in the spindle and spheres on the table; other instruments alike."""
    sizes, length = task.sizes, -task.tip_mm[2]
    free = min(STYLUS_MM, length)
    bodies = [_rod("tool", (0.0, 0.0, -length), free, sizes.ball_mm / 2.0, contact=True)]
    if length > free:
        bodies.append(_rod("tool", (0.0, 0.0, free - length), length - free, BODY_MM / 2.0))
    for x, y, z in task.places_mm.values():
        ball = coal.Sphere(sizes.sphere_mm / 2.0 * MM)
        bodies.append(Body("work", ball, (x, y, z), contact=True))
        if z > 0.0:
            bodies.append(_rod("work", (x, y, 0.0), z, STEM_SHARE * sizes.sphere_mm / 2.0, contact=True))
    return Clearance(machine, task.kit.without_targets(), tuple(bodies), sizes.clearance_mm)


def _rod(side: str, start: tuple[float, float, float], length: float, radius: float, *, contact: bool = False) -> Body:
    """Return a cylinder from a point along the z of its carrier, mm."""
    x, y, z = start
    return Body(side, coal.Cylinder(radius * MM, length * MM), (x, y, z + length / 2.0), contact=contact)


def default_place(machine: Machine, tip_mm: tuple[float, float, float], *, central: bool) -> tuple[float, float, float]:
    """Return the place of a part in the work frame, mm: on a turning table (``central``: its middle), or below the tool."""
    if all(machine.axes[i].side == "tool" for i in machine.rotary):
        middle = np.array([[np.mean(axis.domain) if axis.linear else 0.0 for axis in machine.axes]])
        tip = carried_points_mm(machine, middle, "tool", np.array([tip_mm]))
        zero = carried_points_mm(machine, middle, "work", np.zeros((1, 3)))
        unit = [carried_points_mm(machine, middle, "work", np.eye(3)[i : i + 1]) - zero for i in range(3)]
        x, y, z = (float(np.round((tip - zero)[0] @ way[0], 0)) + 0.0 for way in unit)
        return x, y, z
    distance = 0.0 if central else round(TABLE_SHARE * _table_radius_mm(machine), -1)
    return distance, 0.0, HEIGHT_MM


def _table_radius_mm(machine: Machine) -> float:
    """Return the half size of the table across its normal, from the shapes of the URDF."""
    frame = machine.model.frames[machine.work_frame]
    sizes = [0.0]
    for shape in machine_shapes(machine):
        if shape.joint != frame.parentJoint:
            continue
        shape.geometry.computeLocalAABB()
        half = (np.array(shape.geometry.aabb_local.max_) - np.array(shape.geometry.aabb_local.min_)) / 2.0
        turn = np.abs((frame.placement.inverse() * shape.placement).rotation)
        sizes.append(float((turn @ half)[:2].min()) / MM)
    return max(sizes) or ASSUMED_RADIUS_MM
