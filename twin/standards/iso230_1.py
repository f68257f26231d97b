"""Straightness, squareness and angular errors of linear axes (ISO 230-1:2012).

The angular error is the largest minus the smallest angular deviation over the travel. The zero of the instrument has no influence, and
no slope is removed: an angle that changes steadily along the travel is an error motion. Deviations are the means of the readings at a
position in one direction of approach, so that the range contains the reversal.

Straightness deviations (clause 3.4, test 8.2) are taken along the direction in which they were measured, not perpendicular to the line:
for slopes below a milliradian they differ by less than a millionth. All three reference lines are linear in the deviations (the minimum
zone as long as the same three points define it), so the covariance of the deviations gives that of the line.

Squareness is that of the reference lines of two straightnesses in the same plane and relative to the same reference: an artefact with
two legs, or an instrument that was not moved in between. The sign is that of the direction of the second axis, rotated right-handed
about the third: E_XY −= y·E_C0Y, E_XZ += z·E_B0Z, E_YZ −= z·E_A0Z, so a positive ``E_C0Y`` opens the angle from +X to +Y beyond 90°. A
common rotation of the reference has no influence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal, final

import numpy as np
from numpy.typing import ArrayLike

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.messages import Message


def finite_array(name: str, values: ArrayLike, *dimensions: int) -> np.ndarray:
    """Return a read-only copy as floats, of one of the given numbers of dimensions.

    Raises:
        InputError: values that are not numbers, another shape, or a missing (NaN) or infinite value; the standards allow no gaps.
    """
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} are not numbers", expected="an array of numbers", value=values) from None
    if array.ndim not in dimensions or array.size == 0:
        raise InputError(
            f"{name} have the wrong shape",
            expected=f"{' or '.join(map(str, dimensions))} dimension(s), none empty",
            value=array.shape,
        )
    missing = np.argwhere(~np.isfinite(array))
    if len(missing):
        place = ", ".join(str(int(i)) for i in missing[0])
        raise InputError(
            f"{name} lack {len(missing)} of {array.size} values, the first at [{place}]",
            expected="every value: measure it again, or leave out its whole row",
            value=float(array[tuple(missing[0])]),
        )
    return read_only(array)


def check_same_length(name: str, values: np.ndarray, other_name: str, other: np.ndarray) -> None:
    """Raise `InputError` if the first dimensions of two arrays differ."""
    if len(values) != len(other):
        raise InputError(
            f"{name} do not fit {other_name}",
            expected=f"{len(other)} rows, one for each of {other_name}",
            value=len(values),
        )


# --- Angular error of a linear axis from readings of a level or an autocollimator, after ISO 230-1:2012, 3.4.16 and 8.4

FEWEST_POSITIONS: Final = 5
"""Number of positions along the travel below which the test is not a full one (tests of ISO 10791-1)."""


@final
@dataclass(frozen=True)
class AngularError:
    """Angular error of a linear axis about one direction; m positions, angles in µrad from the first deviation."""

    name: str  # ISO 230-1 name of the error motion: ``E_AX``
    position_mm: np.ndarray  # (m,) positions, ascending
    # forward_urad, backward_urad: (m,) mean angular deviation of each direction of approach; NaN where it was not read
    forward_urad: np.ndarray
    backward_urad: np.ndarray
    value_urad: float  # range of all deviations: the angular error
    # forward_value_urad, backward_value_urad: range in one direction; None if it was not read at two positions
    forward_value_urad: float | None
    backward_value_urad: float | None
    # largest difference of the two directions at a position, forward minus backward; None if there is none
    reversal_urad: float | None
    shortfalls: tuple[Message, ...]  # what a full test has and this one lacks


def angular_error(position_mm: ArrayLike, angle_urad: ArrayLike, approach: ArrayLike, *, name: str) -> AngularError:
    """Evaluate the angular error of a linear axis, with the ISO 230-1 ``name`` of its error motion.

    Commanded positions (n,), of which equal ones are repeats, readings (n,) and directions of approach (n,), +1 or −1.
    """
    position, angle = finite_array("positions", position_mm, 1), finite_array("angles", angle_urad, 1)
    side = finite_array("directions of approach", approach, 1)
    check_same_length("angles", angle, "positions", position)
    check_same_length("directions of approach", side, "positions", position)
    if not np.isin(side, (-1.0, 1.0)).all():
        raise InputError("unknown direction of approach", expected="+1 or -1", value=side[~np.isin(side, (-1, 1))][0])
    targets, which = np.unique(position, return_inverse=True)
    if len(targets) < 2:
        raise InputError("angles at one position", expected="two positions or more", value=float(targets[0]))
    means = []
    for direction in (1.0, -1.0):
        rows = side == direction
        count = np.bincount(which[rows], minlength=len(targets)).astype(float)
        total = np.bincount(which[rows], angle[rows], minlength=len(targets))
        means.append(np.divide(total, count, out=np.full(len(targets), np.nan), where=count > 0.0))
    both = np.array(means)
    both = both - both[np.isfinite(both[:, 0]), 0][0]
    ranges = [float(np.nanmax(one) - np.nanmin(one)) if np.isfinite(one).sum() > 1 else None for one in both]
    shortfalls = []
    if len(targets) < FEWEST_POSITIONS:
        shortfalls.append(
            Message("{count} positions, fewer than {fewest}", count=len(targets), fewest=FEWEST_POSITIONS)
        )
    if None in ranges:
        shortfalls.append(Message("one direction of motion only"))
    difference = (both[0] - both[1])[np.isfinite(both).all(axis=0)]
    return AngularError(
        name,
        read_only(targets),
        read_only(both[0]),
        read_only(both[1]),
        float(np.nanmax(both) - np.nanmin(both)),
        ranges[0],
        ranges[1],
        float(difference[np.argmax(np.abs(difference))]) if len(difference) else None,
        tuple(shortfalls),
    )


# --- Straightness of a motion about the three reference lines of ISO 230-1:2012 -------------------

SLOPE: Final = 1e-3
"""Factor from µrad × mm to µm."""


@final
@dataclass(frozen=True)
class ReferenceLine:
    """A reference straight line (ISO 230-1:2012, 3.4.12) and the deviations from it."""

    kind: str  # ``least squares``, ``end point`` or ``minimum zone``
    offset_um: float  # its height at position 0
    slope_urad: float  # its slope; positive if the deviation increases with the position
    residual_um: np.ndarray  # (n,) deviations from it
    value_um: float  # the straightness error: the largest positive plus the absolute largest negative deviation
    # indices of the points that define it: none, the two end points, or the points on the zone's two borders
    contacts: tuple[int, ...]
    covariance: np.ndarray | None  # (2, 2) of (offset_um, slope_urad), or None if the deviations have no uncertainties

    @property
    def u_slope_urad(self) -> float | None:
        """Standard uncertainty of the slope."""
        return None if self.covariance is None else float(np.sqrt(self.covariance[1, 1]))

    def at_um(self, position_mm: ArrayLike) -> np.ndarray:
        """Return its height at given positions."""
        return np.asarray(self.offset_um + self.slope_urad * SLOPE * np.asarray(position_mm, dtype=float))


@final
@dataclass(frozen=True)
class Straightness:
    """Straightness of one motion in one plane."""

    name: str  # ISO 230-1 name of the error motion, such as ``E_YX``: deviation along Y of the motion of X
    position_mm: np.ndarray  # (n,) positions of the axis, ascending
    # (n,) measured deviations; positive in the positive direction of the axis along which they are (ISO 841)
    deviation_um: np.ndarray
    least_squares: ReferenceLine  # least_squares, end_point, minimum_zone: the three lines
    end_point: ReferenceLine
    minimum_zone: ReferenceLine

    @property
    def lines(self) -> tuple[ReferenceLine, ReferenceLine, ReferenceLine]:
        """All three lines."""
        return self.least_squares, self.end_point, self.minimum_zone


def straightness(
    position_mm: ArrayLike,
    deviation_um: ArrayLike,
    *,
    name: str = "",
    u_um: float | None = None,
) -> Straightness:
    """Evaluate the straightness of a motion from deviations measured along it (ISO 230-1:2012, 3.4 and 8.2).

    Each of the positions (n,) stands once, in any order; use means for positions visited repeatedly. `squareness` needs the ISO 230-1
    ``name`` of the error motion. ``u_um`` is the standard uncertainty of each deviation, independent of each other; None if unknown.
    """
    position, deviation = finite_array("positions", position_mm, 1), finite_array("deviations", deviation_um, 1)
    check_same_length("deviations", deviation, "the positions", position)
    if len(position) < 3:
        raise InputError("too few points for a straightness", expected="at least 3 points", value=len(position))
    order = np.argsort(position)
    if u_um is not None and not (np.isfinite(u_um) and u_um >= 0.0):
        raise InputError("not a standard uncertainty", expected="a finite number of µm, not negative", value=u_um)
    position, deviation = read_only(position[order]), read_only(deviation[order])
    same = np.flatnonzero(np.diff(position) == 0.0)
    if len(same):
        raise InputError(
            "a position occurs twice",
            expected="each position once, with the mean of its deviations",
            value=float(position[same[0]]),
        )
    zone_weights, contacts = _minimum_zone(position, deviation)
    return Straightness(
        name=name,
        position_mm=position,
        deviation_um=deviation,
        least_squares=_line("least squares", position, deviation, _least_squares(position), (), u_um),
        end_point=_line("end point", position, deviation, _end_point(position), (0, len(position) - 1), u_um),
        minimum_zone=_line("minimum zone", position, deviation, zone_weights, contacts, u_um),
    )


def _line(
    kind: str,
    position: np.ndarray,
    deviation: np.ndarray,
    weights: np.ndarray,
    contacts: tuple[int, ...],
    u_um: float | None,
) -> ReferenceLine:
    """Return the line of (2, n) weights: height at the middle of the positions, and slope in µm/mm."""
    middle = position.mean()
    to_user = np.array([[1.0, -middle], [0.0, 1.0 / SLOPE]]) @ weights
    height, slope = weights @ deviation
    residual = deviation - (height + slope * (position - middle))  # not from position 0, which may be far away
    offset, slope_urad = to_user @ deviation
    return ReferenceLine(
        kind=kind,
        offset_um=float(offset),
        slope_urad=float(slope_urad),
        residual_um=read_only(residual),
        value_um=float(max(residual.max(), 0.0) - min(residual.min(), 0.0)),
        contacts=contacts,
        covariance=None if u_um is None else read_only(u_um**2 * to_user @ to_user.T),
    )


def _least_squares(position: np.ndarray) -> np.ndarray:
    centred = position - position.mean()
    return np.array([np.full(len(position), 1.0 / len(position)), centred / (centred @ centred)])


def _end_point(position: np.ndarray) -> np.ndarray:
    weights, travel = np.zeros((2, len(position))), position[-1] - position[0]
    share = (position.mean() - position[0]) / travel
    weights[0, [0, -1]] = 1.0 - share, share
    weights[1, [0, -1]] = -1.0 / travel, 1.0 / travel
    return weights


def _minimum_zone(position: np.ndarray, deviation: np.ndarray) -> tuple[np.ndarray, tuple[int, ...]]:
    """Return the weights of the exact minimum-zone line, and the points that define it.

    The width of the zone is convex and piecewise linear in the slope, with breaks where an edge of the convex hull lies on a border. So
    the least width is at an edge of the hull, with the opposite point between the edge's end points.
    """
    equal = 1e-12 * float(
        np.ptp(deviation)
    )  # readings in whole µm give parallel edges, whose widths differ by rounding only
    best: tuple[float, float, int, int, int] | None = None
    for side in (1.0, -1.0):  # the lower chain, then the upper one as the lower of the mirror image
        chain = _lower_hull(position, side * deviation)
        for a, b in pairwise(chain):
            slope = (deviation[b] - deviation[a]) / (position[b] - position[a])
            height = side * ((deviation - deviation[a]) - slope * (position - position[a]))
            width = float(height.max())
            beside = np.maximum(position[a] - position, position - position[b])  # negative between the edge's ends
            across = int(np.argmin(np.where(height >= width - equal, beside, np.inf)))
            if (
                best is None
                or width < best[0] - equal
                or (width <= best[0] + equal and float(beside[across]) < best[1])
            ):
                best = (width, float(beside[across]), a, b, across)
    if best is None:
        raise InputError("no convex hull", expected="at least 2 points", value=len(position))
    *_, a, b, across = best
    weights, run = np.zeros((2, len(position))), position[b] - position[a]
    weights[1, [a, b]] = -1.0 / run, 1.0 / run
    # The middle line: half way between the edge and its parallel, (d_a − k p_a + d_c − k p_c)/2 at position 0.
    np.add.at(weights[0], [a, across], [0.5, 0.5])
    weights[0] += (position.mean() - (position[a] + position[across]) / 2.0) * weights[1]
    return weights, tuple(sorted({a, b, across}))


def _lower_hull(position: np.ndarray, height: np.ndarray) -> Sequence[int]:
    """Return the indices of the lower convex hull, left to right (Andrew's monotone chain; positions ascend)."""
    chain: list[int] = []
    for i in range(len(position)):
        while len(chain) >= 2:
            a, b = chain[-2], chain[-1]
            turn = (position[b] - position[a]) * (height[i] - height[a])
            turn -= (height[b] - height[a]) * (position[i] - position[a])
            if turn > 0.0:
                break
            chain.pop()
        chain.append(i)
    return chain


# --- Squareness of two linear axes from the reference lines of two straightness measurements, with the sign of ISO 230-1:2012

LineKind = Literal["least squares", "end point", "minimum zone"]
PAIRS: Final = {
    "E_C0Y": ("E_YX", "E_XY", -1.0),
    "E_B0Z": ("E_ZX", "E_XZ", +1.0),
    "E_A0Z": ("E_ZY", "E_YZ", -1.0),
}
"""Squareness → straightness of the datum axis, of the other axis, and the sign of the sum of their slopes."""


@final
@dataclass(frozen=True)
class SquarenessError:
    """Squareness of an axis relative to another."""

    name: str  # ``E_C0Y``, ``E_B0Z`` or ``E_A0Z``
    value_urad: float  # the error; right-handed, see the module
    u_urad: float | None  # its standard uncertainty, or None if the lines have none
    line: LineKind
    datum_slope_urad: float  # datum_slope_urad, slope_urad: slopes of the lines of the datum axis and of the other axis
    slope_urad: float


def squareness(
    datum: Straightness,
    other: Straightness,
    *,
    line: LineKind = "least squares",
) -> SquarenessError:
    """Evaluate the squareness of an axis relative to its datum axis, from two straightnesses that are a pair of `PAIRS`.

    The two measurements are taken as independent.
    """
    name = next(
        (name for name, (first, second, _) in PAIRS.items() if (first, second) == (datum.name, other.name)), None
    )
    if name is None:
        pairs = "; ".join(f"{first} and {second}" for first, second, _ in PAIRS.values())
        raise InputError(
            "not two straightnesses in one plane, datum axis first",
            expected=pairs,
            value=f"{datum.name} and {other.name}",
        )
    first, second = _of_kind(datum, line), _of_kind(other, line)
    u_first, u_second = first.u_slope_urad, second.u_slope_urad
    u = None if u_first is None or u_second is None else float(np.hypot(u_first, u_second))
    return SquarenessError(
        name=name,
        value_urad=PAIRS[name][2] * (first.slope_urad + second.slope_urad),
        u_urad=u,
        line=line,
        datum_slope_urad=first.slope_urad,
        slope_urad=second.slope_urad,
    )


def _of_kind(measured: Straightness, kind: str) -> ReferenceLine:
    found = next((line for line in measured.lines if line.kind == kind), None)
    if found is None:
        raise InputError("unknown reference line", expected=", ".join(line.kind for line in measured.lines), value=kind)
    return found
