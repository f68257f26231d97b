"""Straightness of a motion about the three reference lines of ISO 230-1:2012.

Deviations (clause 3.4, test 8.2) are taken along the direction in which they were measured, not perpendicular to the line: for slopes
below a milliradian they differ by less than a millionth. One plane; a motion has two, each evaluated by itself.

All three lines are linear in the deviations (the minimum zone as long as the same three points define it), so the covariance of the
deviations gives that of the line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, final

import numpy as np
from numpy.typing import ArrayLike

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin.measurement.evaluation.inputs import check_same_length, finite_array

SLOPE: Final = 1e-3
"""Factor from µrad × mm to µm."""


@final
@dataclass(frozen=True)
class ReferenceLine:
    """A reference straight line (ISO 230-1:2012, 3.4.12) and the deviations from it.

    Attributes:
        kind: ``least squares``, ``end point`` or ``minimum zone``.
        offset_um: its height at position 0.
        slope_urad: its slope; positive if the deviation increases with the position.
        residual_um: (n,) deviations from it.
        value_um: the straightness error: the largest positive plus the absolute largest negative deviation.
        contacts: indices of the points that define it: none, the two end points, or the points on the zone's two borders.
        covariance: (2, 2) of (offset_um, slope_urad), or None if the deviations have no uncertainties.
    """

    kind: str
    offset_um: float
    slope_urad: float
    residual_um: np.ndarray
    value_um: float
    contacts: tuple[int, ...]
    covariance: np.ndarray | None

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
    """Straightness of one motion in one plane.

    Attributes:
        name: ISO 230-1 name of the error motion, such as ``E_YX``: deviation along Y of the motion of X.
        position_mm: (n,) positions of the axis, ascending.
        deviation_um: (n,) measured deviations; positive in the positive direction of the axis along which they are (ISO 841).
        least_squares, end_point, minimum_zone: the three lines.
    """

    name: str
    position_mm: np.ndarray
    deviation_um: np.ndarray
    least_squares: ReferenceLine
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
    covariance_um2: ArrayLike | None = None,
) -> Straightness:
    """Evaluate the straightness of a motion from deviations measured along it (ISO 230-1:2012, 3.4 and 8.2).

    Args:
        position_mm: (n,) positions of the axis, each once, in any order; use means for positions visited repeatedly.
        deviation_um: (n,) deviations.
        name: ISO 230-1 name of the error motion; `squareness` needs it.
        u_um: standard uncertainty of each deviation, independent of each other; None if unknown.
        covariance_um2: (n, n) their covariance instead, in the order given.

    Raises:
        InputError: arrays that do not match, a missing value, a position given twice, fewer than three points, both kinds of
            uncertainty, or an invalid uncertainty.
    """
    position, deviation = finite_array("positions", position_mm, 1), finite_array("deviations", deviation_um, 1)
    check_same_length("deviations", deviation, "the positions", position)
    if len(position) < 3:
        raise InputError("too few points for a straightness", expected="at least 3 points", value=len(position))
    order = np.argsort(position)
    spread = _covariance(len(position), u_um, covariance_um2)
    position, deviation = read_only(position[order]), read_only(deviation[order])
    same = np.flatnonzero(np.diff(position) == 0.0)
    if len(same):
        raise InputError(
            "a position occurs twice",
            expected="each position once, with the mean of its deviations",
            value=float(position[same[0]]),
        )
    spread = None if spread is None else spread[np.ix_(order, order)]
    zone_weights, contacts = _minimum_zone(position, deviation)
    return Straightness(
        name=name,
        position_mm=position,
        deviation_um=deviation,
        least_squares=_line("least squares", position, deviation, _least_squares(position), (), spread),
        end_point=_line("end point", position, deviation, _end_point(position), (0, len(position) - 1), spread),
        minimum_zone=_line("minimum zone", position, deviation, zone_weights, contacts, spread),
    )


def _covariance(count: int, u_um: float | None, covariance_um2: ArrayLike | None) -> np.ndarray | None:
    if covariance_um2 is not None:
        if u_um is not None:
            raise InputError("two uncertainties given", expected="u_um or covariance_um2, not both", value=u_um)
        matrix = finite_array("covariances", covariance_um2, 2)
        if matrix.shape != (count, count):
            raise InputError("covariance has the wrong size", expected=f"({count}, {count})", value=matrix.shape)
        lowest, *_, highest = np.linalg.eigvalsh((matrix + matrix.T) / 2.0)
        if not np.allclose(matrix, matrix.T, rtol=1e-9, atol=1e-12 * highest) or lowest < -1e-9 * max(highest, 0.0):
            raise InputError("not a covariance", expected="a symmetric matrix, no negative eigenvalue", value=lowest)
        return matrix
    if u_um is None:
        return None
    if not (np.isfinite(u_um) and u_um >= 0.0):
        raise InputError("not a standard uncertainty", expected="a finite number of µm, not negative", value=u_um)
    return np.eye(count) * u_um**2


def _line(
    kind: str,
    position: np.ndarray,
    deviation: np.ndarray,
    weights: np.ndarray,
    contacts: tuple[int, ...],
    spread: np.ndarray | None,
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
        covariance=None if spread is None else read_only(to_user @ spread @ to_user.T),
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
