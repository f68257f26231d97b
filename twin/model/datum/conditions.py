"""Linear conditions of a datum on the curves, in the order in which they are fulfilled.

Earlier groups have priority over later ones; within a group that cannot be fulfilled completely, the sum of squares is minimised.

1. No mean angle and no slope that a neighbour or a squareness can always absorb: angular error motions of a linear axis that is not
   next to the tool or the workpiece, the tilt of a rotary axis, fixed tilts, and slopes that are not a common rotation of all lines.
2. A common rotation of all lines: the direction of the machine frame.
3. The same for shifts: the mean of a straightness, of a rotary axis perpendicular to its line, and fixed shifts.
4. The mean of a straightness of an axis next to the tool or the workpiece.
5. The mean of a positioning error: the zero of the scale.
6. Amounts that only the workpiece or the tool could absorb: the mean tilt of the spindle, the pattern of the last rotary axis.
7. The smallest values of two locations that describe the same shift.

The chain of a machine as links, one per axis, and the change of their errors by a fixed motion inserted between two of them.

Between neighbouring axes is a gap: a frame fixed to the body between them. Inserting G · G⁻¹ there leaves every pose unchanged:
the axis before the gap ends with G, the axis after it begins with G⁻¹. At the ends of the chain, the tool and the workpiece, nothing
can be inserted; nor at the base if one of the two sides has no axis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np
import pinocchio as pin

from twin._common.arrays import read_only
from twin._common.messages import Message
from twin._common.units import UM, URAD
from twin.machine.error_names import DIRECTIONS
from twin.machine.machine import Axis, Machine
from twin.model.effects import AxisLocation, Squareness, split_name
from twin.model.effects.base import Effect
from twin.model.motion_curve import Curve
from twin.numerics.curves.basis import gauss_legendre
from twin.numerics.spatial import cross_matrix, rotation_exp, rotation_log

NODES: Final = 80
"""Points of the Gauss-Legendre rule over an axis's range: exact beyond any order of a curve."""
SI: Final = np.array([UM, UM, UM, URAD, URAD, URAD])


@final
@dataclass(frozen=True)
class Numbers:
    """The numbers of a calibration that depend on the datum."""

    machine: Machine
    curves: Mapping[str, Curve]  # error motions by name
    squareness: Mapping[str, float]  # µrad by name
    location: Mapping[str, float]  # µm and µrad by name

    def domain(self, axis: Axis) -> tuple[float, float]:
        """Return the range of an axis that all its curves cover, mm or degrees; one turn for an unlimited axis."""
        domains = [curve.domain for name, curve in self.curves.items() if split_name(name)[2] == axis.name]
        if not domains:
            return axis.domain
        return domains[0] if axis.lower is None else (max(d[0] for d in domains), min(d[1] for d in domains))


@final
@dataclass(frozen=True)
class DatumLink:
    """One axis between its two gaps."""

    axis: Axis
    before: int | None  # before, after: indices of the gaps; None if nothing can be inserted
    after: int | None
    # rotation, translation_m: nominal pose of the axis's error frame at position zero in the frame of the gap before
    rotation: np.ndarray
    translation_m: np.ndarray
    last: bool  # whether the axis is next to the tool or to the workpiece
    domain: tuple[float, float]  # range that its curves cover, mm or degrees
    nodes: np.ndarray  # (n,) positions: the lower end, the points of a Gauss-Legendre rule, the upper end
    weights: np.ndarray  # (n,) weights of the mean over the range; zero for the ends

    @property
    def u(self) -> np.ndarray:
        """Nodes (n,), scaled from −1 to 1 over the range."""
        lo, hi = self.domain
        return np.asarray((2.0 * self.nodes - lo - hi) / (hi - lo))

    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Return rotations (n, 3, 3) and translations (n, 3), metres, of the axis's nominal motion at the nodes, in its error frame."""
        direction = np.array(self.axis.direction)
        travel = (self.nodes * self.axis.scale)[:, None] * direction
        if self.axis.linear:
            return np.broadcast_to(np.eye(3), (len(travel), 3, 3)), travel
        return rotation_exp(travel), np.zeros_like(travel)

    def values(self, numbers: Numbers) -> np.ndarray:
        """Return the values (6, n) of the axis's curves at the nodes, µm and µrad."""
        values = np.zeros((6, len(self.nodes)))
        for i, letter in enumerate(DIRECTIONS):
            curve = numbers.curves.get(f"E_{letter}{self.axis.name}")
            if curve is not None:
                motion = curve.motion(wrapped=self.axis.lower is None)
                values[i] = motion.components({self.axis.name: self.nodes})[i]
        return values

    def shape(self, name: str) -> np.ndarray:
        """Return the contribution (6, n) of one unit of a squareness or location of this axis to its error frame."""
        effect: Effect = Squareness(name, 1.0, self.axis) if self.axis.linear else AxisLocation(name, 1.0)
        shape = np.zeros((6, len(self.nodes)))
        for i, values in effect.components({self.axis.name: self.nodes}).items():
            shape[i] = values
        return shape

    def rates(self, gaps: int) -> np.ndarray:
        """Return the first derivatives (6, n, 6·gaps) of the error frame at the nodes by the motions at the gaps; µm and µrad."""
        rates = np.zeros((6, len(self.nodes), 6 * gaps))
        turns, travel = self.motion()
        if self.before is not None:
            at = travel if self.axis.linear else np.zeros_like(travel)
            inverse = self.rotation.T
            # The motion at the gap before, in the frame of the axis at its position.
            rates[:, :, 6 * self.before : 6 * self.before + 6] -= _adjoint(
                np.broadcast_to(inverse, (len(at), 3, 3)), -(self.translation_m @ self.rotation) - at
            )
        if self.after is not None:
            rates[:, :, 6 * self.after : 6 * self.after + 6] += _adjoint(turns, np.zeros_like(travel))
        return rates

    def moved(self, values: np.ndarray, before: np.ndarray, after: np.ndarray, inserted: np.ndarray) -> np.ndarray:
        """Return the errors (6, n) in the motion frame at the nodes with motions inserted at the gaps, without approximation.

        All in µm and µrad: ``before`` and ``after`` (6,) are the old and the new location, zero for a linear axis; ``inserted``
        (6·gaps,) are the motions, each a translation and a rotation vector.
        """
        turns, travel = self.motion()
        frames = _frames(values.T)
        if self.before is not None:
            back = _inverse(_frames(inserted[6 * self.before : 6 * self.before + 6][None]))
            place = _matrices(self.rotation[None], self.translation_m[None])
            if self.axis.linear:
                place = place @ _matrices(np.eye(3)[None], travel)
            frames = _inverse(place @ _frames(after[None])) @ back @ place @ _frames(before[None]) @ frames
        else:
            frames = _inverse(_frames(after[None])) @ _frames(before[None]) @ frames
        if self.after is not None:
            turn = _matrices(turns, np.zeros_like(travel))
            frames = frames @ turn @ _frames(inserted[6 * self.after : 6 * self.after + 6][None]) @ _inverse(turn)
        displacement = np.concatenate([frames[:, :3, 3], rotation_log(frames[:, :3, :3])], axis=1)
        return np.asarray(displacement.T / SI[:, None])


def links_of(numbers: Numbers) -> tuple[tuple[DatumLink, ...], int]:
    """Return the links of both sides, the tool side first, each from the base outwards, and the number of gaps."""
    machine, model = numbers.machine, numbers.machine.model
    sides = [model.supports[model.frames[f].parentJoint].tolist() for f in (machine.tool_frame, machine.work_frame)]
    root = max(set(sides[0]) & set(sides[1]), key=sides[0].index)
    on_side = [
        [axis for _, axis in sorted(zip(machine.axis_joints, machine.axes, strict=True), key=lambda pair: pair[0])
         if axis.side == side]
        for side in ("tool", "work")
    ]  # fmt: skip
    gaps = int(all(on_side))
    links = []
    for axes, joints in zip(on_side, sides, strict=True):
        gap: int | None = 0 if all(on_side) else None
        previous, orientation = root, np.eye(3)
        for axis in axes:
            mark = "location" if not axis.linear else "motion"
            start = next(f.joint for f in machine.frames if f.axis == axis.name and f.role == mark)
            place = _path(model, joints, previous, start)
            last = axis is axes[-1]
            after = None if last else gaps
            gaps += 0 if last else 1
            links.append(
                _link(numbers, axis, (gap, after), orientation.T @ place.rotation, orientation.T @ place.translation)
            )
            gap = after
            previous = machine.axis_joints[machine.names.index(axis.name)]
            if axis.linear:
                previous, orientation = start, np.eye(3)
            else:
                # The frame of the gap turns with the axis and has the directions of the axis's error frame.
                orientation = np.asarray(model.jointPlacements[previous].rotation).T
    return tuple(links), gaps


def _link(
    numbers: Numbers, axis: Axis, gaps: tuple[int | None, int | None], rotation: np.ndarray, translation: np.ndarray
) -> DatumLink:
    lo, hi = numbers.domain(axis)
    x, w = gauss_legendre(NODES)
    nodes = np.concatenate([[lo], (lo + hi) / 2.0 + x * (hi - lo) / 2.0, [hi]])
    weights = np.concatenate([[0.0], w / 2.0, [0.0]])
    return DatumLink(axis, *gaps, rotation, translation, gaps[1] is None, (lo, hi), nodes, weights)


def _path(model: pin.Model, joints: list[int], start: int, end: int) -> pin.SE3:
    """Return the placement of a joint's frame in the frame of an earlier joint, all axes at zero."""
    place = pin.SE3.Identity()
    for joint in joints[joints.index(start) + 1 : joints.index(end) + 1]:
        place = place * model.jointPlacements[joint]
    return place


def _adjoint(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """Return the adjoint matrices (6, n, 6) of transformations (n, 3, 3) and (n, 3) in metres, for motions in µm and µrad."""
    found = np.zeros((len(translation), 6, 6))
    found[:, :3, :3] = found[:, 3:, 3:] = rotation
    found[:, :3, 3:] = cross_matrix(translation) @ rotation
    return np.asarray(found.transpose(1, 0, 2))


def _frames(values: np.ndarray) -> np.ndarray:
    """Return frames (n, 4, 4) from (n, 6) µm and µrad: translation, then rotation vector."""
    metres = values * SI
    return _matrices(rotation_exp(metres[:, 3:]), metres[:, :3])


def _matrices(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    matrices = np.zeros((max(len(rotation), len(translation)), 4, 4))
    matrices[:, :3, :3], matrices[:, :3, 3], matrices[:, 3, 3] = rotation, translation, 1.0
    return matrices


def _inverse(frames: np.ndarray) -> np.ndarray:
    turned = frames[:, :3, :3].transpose(0, 2, 1)
    return _matrices(turned, -np.einsum("nij,nj->ni", turned, frames[:, :3, 3]))


# --- Linear conditions of a datum on the curves, in the order in which they are fulfilled ---------

Datum = Literal["mean lines", "end points", "as given"]
MEAN_LINES: Final = "mean lines"
END_POINTS: Final = "end points"
AS_GIVEN: Final = "as given"
DATUMS: Final[tuple[Datum, ...]] = (MEAN_LINES, END_POINTS, AS_GIVEN)
EXPLANATION: Final[Mapping[Datum, str]] = {
    "mean lines": Message(
        "datum mean lines: no mean in a curve, no slope in a straightness, if squareness or a location can absorb it (twin doc datum)"
    ),
    "end points": Message(
        "datum end points: as mean lines, but every straightness is zero at both ends of its range (twin doc datum)"
    ),
    "as given": Message(
        "datum as given: means and slopes of the curves act like squareness and locations; convert to mean lines before comparing "
        "numbers (twin doc datum)"
    ),
}
"""Explanation of each datum, for the note below a table of errors."""
LAST_AXES: Final = 6
"""Group of the amounts that stay in the last axes."""
Weights = tuple[tuple[int, int, np.ndarray], ...]
"""Link, component and (n,) weights at its nodes: a sum of curve values, µm or µrad."""


@final
@dataclass(frozen=True)
class Condition:
    """A combination of curve values that the datum requires to be zero."""

    curve: str  # name of its curve; for a pair of curves, of the first
    what: str  # ``mean``, ``slope`` (over half the range), ``fixed shift``, ``fixed tilt``
    group: int  # number in the list of this module, 1 to 6
    weights: Weights  # weights of the curve values in the sum


def conditions_of(links: Sequence[DatumLink], datum: Datum) -> tuple[Condition, ...]:
    """Return all conditions of a datum on the axes of a machine."""
    conditions: list[Condition] = []
    slopes: list[Condition] = []
    tilts: list[np.ndarray] = []
    for i, link in enumerate(links):
        name = link.axis.name
        if not link.axis.linear:
            conditions += _of_rotary(i, link)
            continue
        for c, letter in enumerate(DIRECTIONS):
            curve, mean = f"E_{letter}{name}", link.weights
            if c >= 3:
                conditions.append(Condition(curve, "mean", LAST_AXES if link.last else 1, ((i, c, mean),)))
            elif along(link.axis, letter):
                conditions.append(Condition(curve, "mean", 5, ((i, c, mean),)))
            else:
                mean, slope = _line(link, datum)
                conditions.append(Condition(curve, "mean", 4 if link.last else 3, ((i, c, mean),)))
                slopes.append(Condition(curve, "slope", 2, ((i, c, slope),)))
                tilts.append(_tilt_of_turn(link, c))
    return (*conditions, *_intrinsic(slopes, np.array(tilts).reshape(-1, 3)), *slopes)


def turning_patterns(axis: Axis) -> list[tuple[Callable[[np.ndarray], np.ndarray], ...]]:
    """Return the components, in the fixed frame, of a unit vector fixed to the rotating side: two patterns, functions of θ in degrees.

    For u perpendicular to the axis d: Rot(d, θ)·u = u cos θ + (d × u) sin θ.
    """
    d = np.array(axis.direction)
    turning_patterns = []
    for i, letter in enumerate(DIRECTIONS[:3]):
        if along(axis, letter):
            continue
        u = np.eye(3)[i] - d[i] * d
        v = np.cross(d, u)
        turning_patterns.append(tuple(_wave(float(a), float(b)) for a, b in zip(u, v, strict=True)))
    return turning_patterns


def along(axis: Axis, letter: str) -> bool:
    """Return whether a component is the one along or about the axis."""
    return "XYZ".index(letter) == int(np.argmax(np.abs(axis.direction)))


def _of_rotary(i: int, link: DatumLink) -> list[Condition]:
    name = link.axis.name
    shift, tilt = (LAST_AXES, LAST_AXES) if link.last else (3, 1)
    conditions = []
    for c, letter in enumerate(DIRECTIONS):
        own = along(link.axis, DIRECTIONS[c % 3])
        group = (shift if own else 3) if c < 3 else (tilt if own else 1)
        conditions.append(Condition(f"E_{letter}{name}", "mean", group, ((i, c, link.weights),)))
    for first, what, group in ((0, "fixed shift", shift), (3, "fixed tilt", tilt)):
        for k, pattern in enumerate(turning_patterns(link.axis)):
            weights = [(i, first + c, read_only(link.weights * part(link.nodes))) for c, part in enumerate(pattern)]
            across = [c for c in range(3) if not along(link.axis, DIRECTIONS[c])]
            conditions.append(Condition(f"E_{DIRECTIONS[first + across[k]]}{name}", what, group, tuple(weights)))
    return conditions


def _line(link: DatumLink, datum: Datum) -> tuple[np.ndarray, np.ndarray]:
    """Return the weights (n,) of the height and of the slope, over half the range, of a curve's reference line."""
    if datum != END_POINTS:
        return link.weights, read_only(3.0 * link.weights * link.u)
    ends = np.zeros((2, len(link.nodes)))
    ends[:, 0], ends[:, -1] = (0.5, -0.5), (0.5, 0.5)
    return read_only(ends[0]), read_only(ends[1])


def _tilt_of_turn(link: DatumLink, component: int) -> np.ndarray:
    """Return the slopes (3,), over half the range, of a straightness if all lines turn about the machine's x, y or z; µm/µrad."""
    turns = np.array(link.axis.machine_axes)
    half = (link.domain[1] - link.domain[0]) / 2.0 * link.axis.scale
    return np.asarray(np.cross(turns, np.array(link.axis.direction))[:, component] * half)


def _intrinsic(slopes: Sequence[Condition], tilts: np.ndarray) -> list[Condition]:
    """Return the slopes of group 1, without the best common rotation of all lines; squareness can absorb them."""
    if not slopes:
        return []
    # In angles, so that long and short axes have equal weight.
    size = np.linalg.norm(tilts, axis=1)
    directions = tilts / size[:, None]
    rest = np.eye(len(slopes)) - directions @ np.linalg.pinv(directions)
    intrinsic = []
    for row, own in zip(rest, slopes, strict=True):
        weights = tuple(
            (i, c, share / scale * values)
            for share, scale, one in zip(row, size, slopes, strict=True)
            for i, c, values in one.weights
        )
        intrinsic.append(Condition(own.curve, "slope", 1, weights))
    return intrinsic


def _wave(a: float, b: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda theta: a * np.cos(np.radians(theta)) + b * np.sin(np.radians(theta))
