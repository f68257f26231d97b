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
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np

from twin._common.arrays import read_only
from twin.machine.datum.links import DatumLink
from twin.machine.error_names import DIRECTIONS
from twin.machine.machine import Axis

Datum = Literal["mean lines", "end points", "as given"]
MEAN_LINES: Final = "mean lines"
END_POINTS: Final = "end points"
AS_GIVEN: Final = "as given"
DATUMS: Final[tuple[Datum, ...]] = (MEAN_LINES, END_POINTS, AS_GIVEN)
EXPLANATION: Final[Mapping[Datum, str]] = {
    "mean lines": "datum mean lines: no mean in a curve, no slope in a straightness, if squareness or a location can absorb it "
    "(twin doc datum)",
    "end points": "datum end points: as mean lines, but every straightness is zero at both ends of its range (twin doc datum)",
    "as given": "datum as given: means and slopes of the curves act like squareness and locations; convert to mean lines before "
    "comparing numbers (twin doc datum)",
}
"""Explanation of each datum, for the note below a table of errors."""
LAST_AXES: Final = 6
"""Group of the amounts that stay in the last axes."""
Weights = tuple[tuple[int, int, np.ndarray], ...]
"""Link, component and (n,) weights at its nodes: a sum of curve values, µm or µrad."""


@final
@dataclass(frozen=True)
class Condition:
    """A combination of curve values that the datum requires to be zero.

    Attributes:
        curve: name of its curve; for a pair of curves, of the first.
        what: ``mean``, ``slope`` (over half the range), ``fixed shift``, ``fixed tilt``.
        group: number in the list of this module, 1 to 6.
        weights: weights of the curve values in the sum.
    """

    curve: str
    what: str
    group: int
    weights: Weights


def conditions_of(links: Sequence[DatumLink], datum: Datum) -> tuple[Condition, ...]:
    """Return all conditions of a datum on the axes of a machine."""
    found: list[Condition] = []
    slopes: list[Condition] = []
    tilts: list[np.ndarray] = []
    for i, link in enumerate(links):
        name = link.axis.name
        if not link.axis.linear:
            found += _of_rotary(i, link)
            continue
        for c, letter in enumerate(DIRECTIONS):
            curve, mean = f"E_{letter}{name}", link.weights
            if c >= 3:
                found.append(Condition(curve, "mean", LAST_AXES if link.last else 1, ((i, c, mean),)))
            elif along(link.axis, letter):
                found.append(Condition(curve, "mean", 5, ((i, c, mean),)))
            else:
                mean, slope = _line(link, datum)
                found.append(Condition(curve, "mean", 4 if link.last else 3, ((i, c, mean),)))
                slopes.append(Condition(curve, "slope", 2, ((i, c, slope),)))
                tilts.append(_tilt_of_turn(link, c))
    return (*found, *_intrinsic(slopes, np.array(tilts).reshape(-1, 3)), *slopes)


def turning_patterns(axis: Axis) -> list[tuple[Callable[[np.ndarray], np.ndarray], ...]]:
    """Return the components, in the fixed frame, of a unit vector fixed to the rotating side: two patterns, functions of θ in degrees.

    For u perpendicular to the axis d: Rot(d, θ)·u = u cos θ + (d × u) sin θ.
    """
    d = np.array(axis.direction)
    found = []
    for i, letter in enumerate(DIRECTIONS[:3]):
        if along(axis, letter):
            continue
        u = np.eye(3)[i] - d[i] * d
        v = np.cross(d, u)
        found.append(tuple(_wave(float(a), float(b)) for a, b in zip(u, v, strict=True)))
    return found


def along(axis: Axis, letter: str) -> bool:
    """Return whether a component is the one along or about the axis."""
    return "XYZ".index(letter) == int(np.argmax(np.abs(axis.direction)))


def _of_rotary(i: int, link: DatumLink) -> list[Condition]:
    name = link.axis.name
    shift, tilt = (LAST_AXES, LAST_AXES) if link.last else (3, 1)
    found = []
    for c, letter in enumerate(DIRECTIONS):
        own = along(link.axis, DIRECTIONS[c % 3])
        group = (shift if own else 3) if c < 3 else (tilt if own else 1)
        found.append(Condition(f"E_{letter}{name}", "mean", group, ((i, c, link.weights),)))
    for first, what, group in ((0, "fixed shift", shift), (3, "fixed tilt", tilt)):
        for k, pattern in enumerate(turning_patterns(link.axis)):
            weights = [(i, first + c, read_only(link.weights * part(link.nodes))) for c, part in enumerate(pattern)]
            across = [c for c in range(3) if not along(link.axis, DIRECTIONS[c])]
            found.append(Condition(f"E_{DIRECTIONS[first + across[k]]}{name}", what, group, tuple(weights)))
    return found


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
    found = []
    for row, own in zip(rest, slopes, strict=True):
        weights = tuple(
            (i, c, share / scale * values)
            for share, scale, one in zip(row, size, slopes, strict=True)
            for i, c, values in one.weights
        )
        found.append(Condition(own.curve, "slope", 1, weights))
    return found


def _wave(a: float, b: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda theta: a * np.cos(np.radians(theta)) + b * np.sin(np.radians(theta))
