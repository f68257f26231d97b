"""Circular tests of two linear axes, with the terms of ISO 230-4:2005 and 2022, and the circular hysteresis of ISO 230-4:1996.

Input are the radii of the measured path at known angles, for one or both directions of travel. The angle counts from the first axis to
the second, so that a path with rising angles is the standard's counter-clockwise path. Deviations are small compared with the radius,
so that the effect of a small offset of the centre is linear in it (limaçon).

The editions of 2005 and 2022 define four quantities: circular deviation G, bi-directional circular deviation G(b), radial deviation F
and mean bi-directional radial deviation D; 2022 calls them errors. H is a quantity of the edition of 1996. The definitions are taken
from the public abstracts and from publications that use them, not from the text of the standard.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np
import scipy
from numpy.typing import ArrayLike

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.units import DEG, MM, UM
from twin.measurement.evaluation.circular import fit_harmonics
from twin.measurement.evaluation.inputs import check_same_length, finite_array

FEWEST_POINTS: Final = 8
FULL_TURN_GAP_DEG: Final = 30.0
"""Largest gap between neighbouring angles of a path that counts as a full turn."""
LARGEST_GAP_DEG: Final = 180.0
"""Gap from which on the centre of a path is not determined well enough to be removed."""
MOST_ZONE_POINTS: Final = 720
"""Number of points above which the minimum zone is computed from the highest and lowest points of equal sectors."""


@final
@dataclass(frozen=True)
class CircularPath:
    """One direction of travel of a circular test. Arrays are read-only, angles ascend within 0 … 360°.

    Attributes:
        angle_deg: (n,) angles.
        radius_um: (n,) measured radius minus nominal radius.
        G_um: circular deviation: least radial separation of two concentric circles that contain the path (minimum zone).
        G_least_squares_um: range of the radii about the centre of the least-squares circle.
        centre_um: (2,) centre of the least-squares circle.
        mean_um: radius of the least-squares circle minus nominal radius.
        F_max_um, F_min_um: largest and smallest radial deviation from the nominal radius, about the centre of the least-squares circle.
    """

    angle_deg: np.ndarray
    radius_um: np.ndarray
    G_um: float
    G_least_squares_um: float
    centre_um: np.ndarray
    mean_um: float
    F_max_um: float
    F_min_um: float

    @property
    def centred_um(self) -> np.ndarray:
        """(n,) radial deviations about the centre of the least-squares circle."""
        return self.radius_um - _limacon(self.angle_deg, self.centre_um)


@final
@dataclass(frozen=True)
class CircularTest:
    """Result of a circular test.

    Attributes:
        name: the two axes, such as ``XY``; empty if not given.
        radius_mm: nominal radius.
        forward: path with rising angle, from the first axis to the second (counter-clockwise); None if it was not measured.
        backward: path with falling angle (clockwise); None if it was not measured.
        G_b_um: bi-directional circular deviation G(b): minimum zone of both paths together; None with one direction.
        D_um: mean bi-directional radial deviation: radius of the least-squares circle of both paths minus nominal radius; None with
            one direction.
        H_um: circular hysteresis (1996): largest difference of the radii of the two paths at one angle; None with one direction.
        H_angle_deg: angle at which it occurs; None with one direction.
        centre_um: (2,) centre of the least-squares circle of all points.
        shortfalls: what the test lacks of a full one, in words; empty if nothing.
    """

    name: str
    radius_mm: float
    forward: CircularPath | None
    backward: CircularPath | None
    G_b_um: float | None
    D_um: float | None
    H_um: float | None
    H_angle_deg: float | None
    centre_um: np.ndarray
    shortfalls: tuple[str, ...]

    @property
    def paths(self) -> tuple[tuple[str, CircularPath], ...]:
        """The paths that were measured, each with its arrow."""
        both = (("↺", self.forward), ("↻", self.backward))
        return tuple((arrow, path) for arrow, path in both if path is not None)


Angles = ArrayLike
Radii = ArrayLike


def circular_test(
    radius_mm: float, forward: tuple[Angles, Radii] | None, backward: tuple[Angles, Radii] | None, *, name: str = ""
) -> CircularTest:
    """Evaluate a circular test of two linear axes.

    Args:
        radius_mm: nominal radius of the path of the measured point.
        forward: angles (n,) in degrees and measured radii (n,) in mm of the path with rising angle, in any order; None if not measured.
        backward: the same of the path with falling angle.
        name: the two axes, for tables and plots.

    Raises:
        InputError: no path, arrays that do not match, a missing value, fewer than eight points, less than half a turn, or a radius
            that is not positive.
    """
    if not (np.isfinite(radius_mm) and radius_mm > 0.0):
        raise InputError("the nominal radius must be positive", expected="mm, above 0", value=radius_mm)
    shortfalls: list[str] = []
    found = [
        None if given is None else _path(words, radius_mm, given, shortfalls)
        for words, given in (("counter-clockwise", forward), ("clockwise", backward))
    ]
    up, down = found
    present = [path for path in found if path is not None]
    if not present:
        raise InputError("no path of a circular test", expected="at least one direction of travel")
    if len(present) < 2:
        shortfalls.append("one direction of travel only; the standard's test has both")
    angle = np.concatenate([path.angle_deg for path in present])
    radius = np.concatenate([path.radius_um for path in present])
    mean, (once,) = fit_harmonics(angle, radius, 1)
    hysteresis = at = None
    if up is not None and down is not None:
        difference = up.radius_um - _at_angles(up.angle_deg, down)
        i = int(np.argmax(np.abs(difference)))
        hysteresis, at = float(np.abs(difference[i])), float(up.angle_deg[i])
    return CircularTest(
        name=name,
        radius_mm=float(radius_mm),
        forward=up,
        backward=down,
        G_b_um=None if hysteresis is None else minimum_zone_um(angle, radius),
        D_um=None if hysteresis is None else mean,
        H_um=hysteresis,
        H_angle_deg=at,
        centre_um=read_only(np.array([once.cos, once.sin])),
        shortfalls=tuple(shortfalls),
    )


def minimum_zone_um(angle_deg: np.ndarray, radius_um: np.ndarray) -> float:
    """Return the least radial separation of two concentric circles that contain all points, by linear programming.

    Args:
        angle_deg: (n,) degrees.
        radius_um: (n,) radii minus any constant.
    """
    keep = _extremes(angle_deg, radius_um) if len(angle_deg) > MOST_ZONE_POINTS else slice(None)
    angle, radius = angle_deg[keep] * DEG, radius_um[keep] - radius_um.mean()
    rows = np.column_stack([np.cos(angle), np.sin(angle)])
    one, none = np.ones((len(angle), 1)), np.zeros((len(angle), 1))
    # Unknowns: centre (2), outer and inner radius; every point lies between the circles.
    bounds = np.vstack([np.hstack([-rows, -one, none]), np.hstack([rows, none, one])])
    solved = scipy.optimize.linprog(
        [0.0, 0.0, 1.0, -1.0], bounds, np.concatenate([-radius, radius]), bounds=(None, None)
    )
    return float(max(solved.fun, 0.0))


def _extremes(angle_deg: np.ndarray, radius_um: np.ndarray) -> np.ndarray:
    """Return the indices of the highest and the lowest point of each sector of one degree, about the least-squares centre."""
    _, (once,) = fit_harmonics(angle_deg, radius_um, 1)
    centred = radius_um - _limacon(angle_deg, np.array([once.cos, once.sin]))
    sector = np.floor(angle_deg).astype(int)
    order = np.lexsort((centred, sector))
    first = np.flatnonzero(np.diff(sector[order], prepend=-1))
    last = np.append(first[1:], len(order)) - 1
    return np.unique(order[np.concatenate([first, last])])


def _path(words: str, radius_mm: float, given: tuple[Angles, Radii], shortfalls: list[str]) -> CircularPath:
    angle, measured = finite_array("angles", given[0], 1) % 360.0, finite_array("radii", given[1], 1)
    check_same_length("radii", measured, "the angles", angle)
    if len(angle) < FEWEST_POINTS:
        raise InputError("too few points on a circle", expected=f"at least {FEWEST_POINTS}", value=len(angle))
    order = np.argsort(angle, kind="stable")
    angle, radius = angle[order], (measured[order] - radius_mm) * (MM / UM)
    gap = float(np.diff(angle, append=angle[0] + 360.0).max())
    if gap > LARGEST_GAP_DEG:
        raise InputError("less than half of a circle", expected="points over more than 180°", value=360.0 - gap)
    if gap > FULL_TURN_GAP_DEG:
        shortfalls.append(f"{words} path of {360.0 - gap:.0f}° only, not a full turn")
    mean, (once,) = fit_harmonics(angle, radius, 1)
    centre = np.array([once.cos, once.sin])
    centred = radius - _limacon(angle, centre)
    return CircularPath(
        angle_deg=read_only(angle),
        radius_um=read_only(radius),
        G_um=minimum_zone_um(angle, radius),
        G_least_squares_um=float(np.ptp(centred)),
        centre_um=read_only(centre),
        mean_um=mean,
        F_max_um=float(centred.max()),
        F_min_um=float(centred.min()),
    )


def _at_angles(angle_deg: np.ndarray, path: CircularPath) -> np.ndarray:
    """Return the radii of a path at given angles, interpolated linearly between the means of equal angles."""
    known, which = np.unique(np.round(path.angle_deg, 6), return_inverse=True)
    radius = np.bincount(which, path.radius_um) / np.bincount(which)
    return np.interp(angle_deg, known, radius, period=360.0)


def _limacon(angle_deg: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return what an offset of the centre adds to the radii."""
    return np.asarray(centre[0] * np.cos(angle_deg * DEG) + centre[1] * np.sin(angle_deg * DEG))
