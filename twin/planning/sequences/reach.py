"""Positions of the linear axes of a sequence, and the points that the axes reach with clearance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, final

import coal
import numpy as np

from twin._common.units import MM
from twin.machine.machine import Machine
from twin.planning.clearance import Body, Clearance
from twin.planning.sequences.contacts import contact_poses
from twin.planning.sequences.positions import carried_points_mm, linear_positions
from twin.planning.sequences.specification import SequencePoints, SequenceTask
from twin.planning.sight import machine_shapes

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
    """Points of a sequence that the axes reach.

    Attributes:
        points: those points, with the positions of all axes.
        dropped: number of the other points by reason.
    """

    points: SequencePoints
    dropped: Mapping[str, int]


def reach(task: SequenceTask, points: SequencePoints) -> Reached:
    """Return the points that the axes reach with clearance, with the positions of the linear axes.

    Raises:
        InputError: the machine does not have three linear axes that move the tool in all directions.
    """
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
    dropped: dict[str, int] = {}
    for i in np.flatnonzero(outside.any(axis=0)):
        first = outside[:, i] & ~outside[:, :i].any(axis=1)
        if first.any():
            dropped[f"{machine.axes[i].name} beyond its range"] = int(first.sum())
    inside = np.flatnonzero(~outside.any(axis=1))
    clear = _clear(task, positions[inside], places[inside])
    kept = inside[clear].tolist()
    if len(kept) < len(inside):
        dropped["too little clearance"] = len(inside) - len(kept)
    found = points.select(np.array(kept, dtype=int))
    reached = SequencePoints(positions[kept], found.place, found.offset_mm, found.run)
    return Reached(reached, MappingProxyType(dropped))


def _clear(task: SequenceTask, positions: np.ndarray, places_mm: np.ndarray) -> np.ndarray:
    """Return (n,) whether poses have clearance, those of a probe also beside the sphere."""
    touching = clearance_of(task.machine, task)
    found = np.array([touching.is_clear(position) for position in positions], dtype=bool)
    if task.instrument.specification.reads != "null" or not len(positions):
        return found
    apart = apart_clearance(touching)
    poses = contact_poses(task, positions, places_mm)
    for row, pose in enumerate(poses):
        if found[row]:
            found[row] = pose.stem_aside and all(
                apart.is_clear(pose.at(task.machine, task.sizes.around_mm * out))
                and touching.is_clear(pose.at(task.machine, task.sizes.contact_mm * out))
                for out in (pose.up, *pose.sides)
            )
    return found


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
    """Return the place of one part on the table, in the work frame, mm.

    It is above a turning table, or where the tool is in the middle of the ranges of its linear axes.

    Args:
        machine: the machine.
        tip_mm: the part on the tool side.
        central: above the middle of the table, not near its rim.
    """
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
