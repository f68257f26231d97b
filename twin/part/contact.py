"""Contact of a tool and a surface: the point of the part that a block makes, and how it moves when the tool does.

A tool is a flat disc with a rounded edge below a cylinder: end mill, bull-nose and ball-nose (radius R, corner radius r). It
touches a surface of outward normal n where its own surface has the normal −n: with the tip p and the axis a (tip to spindle),
c = p + r·a + (R − r)·e − r·n, where e points from the axis across to the surface. Along a flank (n across a) it touches in a line, and
a flat bottom (n along a) in a disc, of which the tip stands for all. A drill, a reamer or a tap makes its hole where its tip goes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.part.features import CylinderFeature, PointsFeature, Surface, ToolShape, across

ROUNDS: Final = 6
"""Steps from a point on the surface to the tool's contact and back; four are enough for a curved surface."""
FLANK: Final = 1e-3
"""Component of the normal along the tool's axis, up to which the flank touches in a line: a tool is not tilted back exactly."""
FLANK_POINTS: Final = 5
BOTTOM: Final = 1e-3
"""Sine of the angle between normal and axis, up to which a flat bottom touches: a compensated tool is not tilted back exactly."""
PARALLEL: Final = 1e-3
CORE: Final = 0.75
"""Smallest diameter of a drill, as a share of the hole's: the core hole of a thread."""


@final
@dataclass(frozen=True, eq=False)
class ToolContacts:
    """Points of a surface that samples of a program make.

    Attributes:
        sample: (n,) the sample of the program.
        place_mm: (n, 3) points on the nominal surface, or on the nominal axis of a drilled hole.
        normal: (n, 3) outward normals; of a drilled hole two directions across the axis, two rows for each sample.
        lever_mm: (n, 3) from the tool's tip to the point.
        off_mm: (n,) distance of the programmed point from the nominal surface along the normal.
        drilled: whether the tool's tip makes the hole.
    """

    sample: np.ndarray
    place_mm: np.ndarray
    normal: np.ndarray
    lever_mm: np.ndarray
    off_mm: np.ndarray
    drilled: bool = False

    def __len__(self) -> int:
        return len(self.sample)

    def part(self, rows: np.ndarray) -> ToolContacts:
        """Return some of the rows."""
        return ToolContacts(
            self.sample[rows],
            self.place_mm[rows],
            self.normal[rows],
            self.lever_mm[rows],
            self.off_mm[rows],
            self.drilled,
        )

    def deviation_mm(self, feature: Surface, tip_mm: np.ndarray, axis: np.ndarray, turned: np.ndarray) -> np.ndarray:
        """Return (n,) distances of the real points from the nominal surface along the normals.

        ``tip_mm``, ``axis``: (n, 3) real tips and axes at the rows; ``turned``: (n, 3) intended axes.
        """
        lever = self.lever_mm + np.cross(np.cross(turned, axis), self.lever_mm)
        real = tip_mm + lever
        if self.drilled:
            return np.asarray(((real - self.place_mm) * self.normal).sum(axis=1))
        return feature.signed_mm(real)[0]


def contacts(feature: Surface, tool: ToolShape, tip_mm: np.ndarray, axis: np.ndarray, touch_mm: float) -> ToolContacts:
    """Return the points of a surface that a tool makes at tips and axes (n, 3) in the part's frame."""
    n = _normals(feature, tool, tip_mm, axis)
    lever = _lever(tool, axis, n)
    flank = np.abs((n * axis).sum(axis=1)) < FLANK
    found = [_touching(feature, np.flatnonzero(~flank), tip_mm, n, lever, touch_mm)]
    if flank.any():
        rows = np.flatnonzero(flank)
        for height in np.linspace(0.0, max(tool.reach - tool.corner_radius, 0.0), FLANK_POINTS):
            found.append(_touching(feature, rows, tip_mm, n, lever + height * axis, touch_mm))
    walls = _joined(found)
    if isinstance(feature, PointsFeature):
        return _nearest_of_each(feature, walls)
    if not isinstance(feature, CylinderFeature) or not feature.internal:
        return walls
    # A tool on the axis has no side of the hole to touch; one that goes around it makes the hole, whatever drilled it before.
    walls = walls.part(np.flatnonzero(feature.radial(tip_mm[walls.sample])[0] > touch_mm))
    return walls if len(walls) else _drilled(feature, tool, tip_mm, axis, touch_mm)


def _nearest_of_each(feature: PointsFeature, found: ToolContacts) -> ToolContacts:
    """Return the contact nearest to each point of a free-form surface: between points it is not known."""
    which, beside = feature.nearest(found.place_mm)
    order = np.lexsort((beside, which))
    first = np.append(True, np.diff(which[order]) > 0) if len(order) else np.zeros(0, dtype=bool)
    return found.part(np.sort(order[first]))


def _drilled(
    feature: CylinderFeature, tool: ToolShape, tip_mm: np.ndarray, axis: np.ndarray, touch_mm: float
) -> ToolContacts:
    """Return the points of a hole's axis where the tip of a tool of its diameter moves on it."""
    off, _ = feature.radial(tip_mm)
    along = feature.along_mm(tip_mm)
    on_axis = (off < touch_mm) & (np.linalg.norm(np.cross(axis, feature.unit), axis=1) < PARALLEL)
    # A drill's nominal diameter may be that of the core hole of a thread: its place counts, not its size.
    on_axis &= feature.inside(tip_mm) & (tool.diameter <= feature.diameter + touch_mm)
    on_axis &= tool.diameter >= CORE * feature.diameter
    rows = np.flatnonzero(on_axis & (along >= 0.0))
    if len(rows) < 2 or np.ptp(along[rows]) < 1e-3:
        return _joined([])
    sides = np.array(across(feature.unit))
    twice = np.repeat(rows, 2)
    place = feature.axis_point(along[twice])
    normal = np.tile(sides, (len(rows), 1))
    return ToolContacts(
        twice, place, normal, np.zeros(place.shape), ((tip_mm[twice] - place) * normal).sum(axis=1), True
    )


def _normals(feature: Surface, tool: ToolShape, tip_mm: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return (n, 3) the normals of the surface where the tool comes nearest to it."""
    at = tip_mm + tool.corner_radius * axis
    n = feature.signed_mm(at)[1]
    for _ in range(ROUNDS):
        before, n = n, feature.signed_mm(tip_mm + _lever(tool, axis, n))[1]
        if np.array_equal(before, n):
            break
    return np.asarray(n)


def _lever(tool: ToolShape, axis: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Return (n, 3) from the tip to the point of the tool whose own normal is −n."""
    along = (n * axis).sum(axis=1, keepdims=True)
    side = n - along * axis
    length = np.linalg.norm(side, axis=1, keepdims=True)
    e = np.where(length > BOTTOM, -side / np.maximum(length, 1e-12), 0.0)
    r = tool.corner_radius
    return np.asarray(r * axis + (tool.radius - r) * e - r * np.where(length > BOTTOM, n, axis))


def _touching(
    feature: Surface, rows: np.ndarray, tip_mm: np.ndarray, n: np.ndarray, lever: np.ndarray, touch_mm: float
) -> ToolContacts:
    point = tip_mm[rows] + lever[rows]
    off, normal = feature.signed_mm(point)
    foot = point - off[:, None] * normal
    kept = (np.abs(off) <= touch_mm) & feature.inside(foot)
    return ToolContacts(rows[kept], foot[kept], normal[kept], lever[rows][kept], off[kept])


def _joined(parts: list[ToolContacts]) -> ToolContacts:
    none = np.zeros((0, 3))
    full = [one for one in parts if len(one)] or [ToolContacts(np.zeros(0, dtype=int), none, none, none, np.zeros(0))]
    return ToolContacts(
        np.concatenate([one.sample for one in full]),
        np.concatenate([one.place_mm for one in full]),
        np.concatenate([one.normal for one in full]),
        np.concatenate([one.lever_mm for one in full]),
        np.concatenate([one.off_mm for one in full]),
    )
