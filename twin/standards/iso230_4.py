"""Circular tests of two linear axes (ISO 230-4) and error motions of a rotary axis over a turn (ISO 230-7:2015, clause 3).

A circular test has the radii of the measured path at known angles, for one or both directions of travel. The angle counts from the
first axis to the second, so that a path with rising angles is the standard's counter-clockwise path. Of ISO 230-4:2005 and 2022 are
circular deviation G, bi-directional circular deviation G(b), radial deviation F and mean bi-directional radial deviation D; 2022 calls
them errors. H is a quantity of the edition of 1996. The definitions are taken from the public abstracts and from publications that use
them, not from the text of the standard.

An error motion is measured at the same angles in one or several turns: radially or axially in µm, as a tilt in µrad. The mean over the
turns is the *synchronous* error motion, the deviation from turn to turn the *asynchronous* one. The once-per-turn component of a radial
or tilt motion is due to the mounting of the artefact (its eccentricity or inclination), not to the axis; it is removed, with the
constant, as the least-squares circle centre of the polar plot. For an axial motion it is real: the *fundamental* error motion.

Deviations are small compared with the radius, so that the effect of a small offset of the centre is linear in it (limaçon).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np
import scipy
from numpy.typing import ArrayLike

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.messages import Message
from twin._common.units import DEG, MM, UM
from twin.standards.iso230_1 import check_same_length, finite_array

Kind = Literal["radial", "axial", "tilt"]
UNITS: Final[dict[Kind, Literal["um", "urad"]]] = {"radial": "um", "axial": "um", "tilt": "urad"}
WIDEST_GAP_DEG: Final = 60.0
"""Largest gap between neighbouring angles of a full turn."""
HARMONICS: Final = 12
"""Highest order that is fitted; k angles resolve (k − 1)/2."""


@final
@dataclass(frozen=True)
class MotionHarmonic:
    """One harmonic of the synchronous error motion: cos·cos(kθ) + sin·sin(kθ)."""

    order: int  # k, periods per turn
    cos: float  # cos, sin: coefficients in the motion's unit
    sin: float

    @property
    def amplitude(self) -> float:
        """Amplitude (half of the range) in the motion's unit."""
        return float(np.hypot(self.cos, self.sin))


@final
@dataclass(frozen=True)
class RotaryMotion:
    """An error motion over a turn and its values. Arrays are read-only, angles ascend.

    Values are in `unit`; each is the radial width of the ring about the polar plot's centre that just contains the curve.
    """

    name: str  # ISO 230-1 name, such as ``E_XC``; empty if none was given
    kind: Kind
    unit: Literal["um", "urad"]
    angle_deg: np.ndarray  # (k,) angles of the axis within a turn
    readings: np.ndarray  # (turns, k) as measured
    constant: float  # mean of the synchronous motion (the radius of the least-squares circle)
    # its first harmonic; for ``radial`` and ``tilt`` the centre of the least-squares circle
    once_per_turn: MotionHarmonic
    harmonics: tuple[MotionHarmonic, ...]  # orders 1 up to `HARMONICS`, fitted together
    total: np.ndarray  # (turns, k) total error motion: the readings about their centre
    synchronous: np.ndarray  # (k,) synchronous (average) error motion: mean over the turns
    residual: np.ndarray  # (k,) residual synchronous error motion: without the first harmonic, also for an axial motion
    total_value: float  # range of `total`
    synchronous_value: float  # range of `synchronous`
    # range of the first harmonic; an error for an axial motion, otherwise due to the mounting of the artefact
    fundamental_value: float
    residual_value: float  # range of `residual`
    asynchronous_value: float | None  # the largest range over the turns at any one angle; None for a single turn


def error_motion(angle_deg: ArrayLike, readings: ArrayLike, kind: Kind, *, name: str = "") -> RotaryMotion:
    """Evaluate an error motion of a rotary axis in a fixed sensitive direction from readings over whole turns.

    The angles (k,) of one turn are in any order and spread over all of it; 0° and 360° are the same angle. The readings are (k,) or
    (turns, k), radial and axial in µm, tilt in µrad.
    """
    if kind not in UNITS:
        raise InputError("unknown kind of error motion", expected=", ".join(UNITS), value=kind)
    angle = finite_array("angles", angle_deg, 1) % 360.0
    measured = finite_array("readings", readings, 1, 2)
    measured = measured.reshape(-1, measured.shape[-1])
    if measured.shape[1] != len(angle):
        raise InputError("readings do not match the angles", expected=f"{len(angle)} per turn", value=measured.shape[1])
    order = np.argsort(angle)
    angle, measured = angle[order], measured[:, order]
    gaps = np.diff(angle, append=angle[0] + 360.0)
    if len(angle) > 1 and gaps.min() < 1e-9:
        raise InputError(
            "an angle occurs twice in a turn",
            expected="each angle once: leave out 360°, which is 0°; enter further turns as further rows",
            value=float(angle[int(np.argmin(gaps))]),
        )
    if gaps.max() > WIDEST_GAP_DEG:
        expected = f"neighbouring angles within {WIDEST_GAP_DEG:g}°"
        raise InputError("angles do not cover a turn", expected=expected, value=float(gaps.max()))
    mean = measured.mean(axis=0)
    constant, (once,) = fit_harmonics(angle, mean, 1)
    wave = once.cos * np.cos(angle * DEG) + once.sin * np.sin(angle * DEG)
    centre = constant + (np.zeros_like(wave) if kind == "axial" else wave)
    total, synchronous, residual = measured - centre, mean - centre, mean - constant - wave
    return RotaryMotion(
        name=name,
        kind=kind,
        unit=UNITS[kind],
        angle_deg=read_only(angle),
        readings=read_only(measured),
        constant=constant,
        once_per_turn=once,
        harmonics=fit_harmonics(angle, mean, min(HARMONICS, (len(angle) - 1) // 2))[1],
        total=read_only(total),
        synchronous=read_only(synchronous),
        residual=read_only(residual),
        total_value=float(np.ptp(total)),
        synchronous_value=float(np.ptp(synchronous)),
        fundamental_value=2.0 * once.amplitude,
        residual_value=float(np.ptp(residual)),
        asynchronous_value=float(np.ptp(measured, axis=0).max()) if len(measured) > 1 else None,
    )


def fit_harmonics(angle: np.ndarray, values: np.ndarray, highest: int) -> tuple[float, tuple[MotionHarmonic, ...]]:
    """Fit a constant and harmonics to (n,) values at (n,) degrees by least squares; at even angles the discrete Fourier transform.

    Of a radius over the angle, the constant and the first harmonic are the radius and the centre of the least-squares circle.
    """
    phases = np.outer(angle * DEG, np.arange(1, highest + 1))
    columns = np.column_stack([np.ones(len(angle)), np.cos(phases), np.sin(phases)])
    constant, *rest = np.linalg.lstsq(columns, values, rcond=None)[0]
    found = zip(rest[:highest], rest[highest:], strict=True)
    return float(constant), tuple(MotionHarmonic(k, float(c), float(s)) for k, (c, s) in enumerate(found, start=1))


# --- Circular tests of two linear axes, with the terms of ISO 230-4:2005 and 2022, and the circular hysteresis of ISO 230-4:1

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
    """One direction of travel of a circular test. Arrays are read-only, angles ascend within 0 … 360°."""

    angle_deg: np.ndarray  # (n,) angles
    radius_um: np.ndarray  # (n,) measured radius minus nominal radius
    # circular deviation: least radial separation of two concentric circles that contain the path (minimum zone)
    G_um: float
    G_least_squares_um: float  # range of the radii about the centre of the least-squares circle
    centre_um: np.ndarray  # (2,) centre of the least-squares circle
    mean_um: float  # radius of the least-squares circle minus nominal radius
    # F_max_um, F_min_um: largest and smallest radial deviation from the nominal radius, about the centre of the least-squares circle
    F_max_um: float
    F_min_um: float


@final
@dataclass(frozen=True)
class CircularTest:
    """Result of a circular test."""

    name: str  # the two axes, such as ``XY``; empty if not given
    radius_mm: float
    # path with rising angle, from the first axis to the second (counter-clockwise); None if it was not measured
    forward: CircularPath | None
    backward: CircularPath | None  # path with falling angle (clockwise); None if it was not measured
    # bi-directional circular deviation G(b): minimum zone of both paths together; None with one direction
    G_b_um: float | None
    # mean bi-directional radial deviation: radius of the least-squares circle of both paths minus nominal radius; None with one
    # direction
    D_um: float | None
    # circular hysteresis (1996): largest difference of the radii of the two paths at one angle; None with one direction
    H_um: float | None
    H_angle_deg: float | None  # angle at which it occurs; None with one direction
    centre_um: np.ndarray  # (2,) centre of the least-squares circle of all points
    shortfalls: tuple[Message, ...]  # what the test lacks of a full one, in words; empty if nothing

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

    The paths with rising (forward) and falling angle are angles (n,) in degrees and measured radii (n,) in mm, in any order; None if
    not measured.

    Raises:
        InputError: no path, arrays that do not match, a missing value, fewer than eight points, less than half a turn, or a radius
            that is not positive.
    """
    if not (np.isfinite(radius_mm) and radius_mm > 0.0):
        raise InputError("the nominal radius must be positive", expected="mm, above 0", value=radius_mm)
    shortfalls: list[Message] = []
    found = [
        None if given is None else _path(words, radius_mm, given, shortfalls)
        for words, given in ((Message("counter-clockwise"), forward), (Message("clockwise"), backward))
    ]
    up, down = found
    present = [path for path in found if path is not None]
    if not present:
        raise InputError("no path of a circular test", expected="at least one direction of travel")
    if len(present) < 2:
        shortfalls.append(Message("one direction of travel only; the standard's test has both"))
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
    """Return the least radial separation of two concentric circles that contain all points (n,), by linear programming."""
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


def _path(words: Message, radius_mm: float, given: tuple[Angles, Radii], shortfalls: list[Message]) -> CircularPath:
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
        shortfalls.append(
            Message("{words} path of {degrees:.0f}° only, not a full turn", words=words, degrees=360.0 - gap)
        )
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
