"""Pairing of the errors of two calibrations, and the change of each with its covariance.

A curve is compared as a function over the common part of both domains, whatever its basis and degree: both curves are expressed in
functions that are orthonormal there (mean square one), so that the norm of a change is its RMS. A squareness or location is a number,
and so is every parameter of an effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import pi
from typing import Any, Final, Literal, final

import numpy as np

from twin._common.arrays import read_only
from twin.machine.calibration import Calibration
from twin.machine.effects import Effect, unit_of
from twin.machine.iso16907 import error_motion_of, iso_class
from twin.machine.machine import Axis
from twin.numerics.covariance import Covariance
from twin.uncertainty.budget import CURVE_POINTS

ROUNDING: Final = 1e-10
"""Relative singular value up to which a function is linearly dependent on the others."""
NOTHING: Final = 1e-7
"""Ratio of a standard uncertainty to the largest of the same error up to which it is a rounding error of zero."""

Status = Literal["same", "known", "unknown"]


@final
@dataclass(frozen=True)
class Side:
    """The parameters of one error in one of the calibrations.

    Attributes:
        numbers: names of the parameters.
        values: (k,) in the units of the file.
        transform: (m, k) transformation of the parameters to coordinates common to both calibrations.
        covariance: (k, k), or None if any parameter has no uncertainty.
    """

    numbers: tuple[str, ...]
    values: np.ndarray
    transform: np.ndarray
    covariance: np.ndarray | None

    @property
    def common_covariance(self) -> np.ndarray | None:
        """Return the (m, m) covariance of the common coordinates; None if unknown."""
        return None if self.covariance is None else np.asarray(self.transform @ self.covariance @ self.transform.T)


@final
@dataclass(frozen=True)
class Pair:
    """One error that both calibrations contain.

    Attributes:
        name: ISO 230-1 name, or the effect's own.
        kind: ``curve``; ``number`` (squareness, location); ``effect``.
        unit: ``um`` or ``urad``; empty for an effect of several numbers.
        axis: the axis it belongs to.
        iso_class: class of ISO/TR 16907.
        first, second: the two sides.
        change: (m,) second less first, in common coordinates.
        positions: (g,) positions of the axis, mm or degrees; empty unless a curve.
        shape: (g, m) value at these positions of a unit of each coordinate; the identity unless a curve.
        labels: name and unit of every coordinate of an effect.
        notes: assumptions made.
    """

    name: str
    kind: Literal["curve", "number", "effect"]
    unit: str
    axis: str
    iso_class: str
    first: Side
    second: Side
    change: np.ndarray
    positions: np.ndarray
    shape: np.ndarray
    labels: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def status(self) -> Status:
        """Return ``same`` for identical numbers (one estimate), ``unknown`` if a side has no uncertainty, else ``known``."""
        one, two = self.first, self.second
        if (
            not np.any(self.change)
            and np.array_equal(one.values, two.values)
            and _equal(one.covariance, two.covariance)
        ):
            return "same"
        for side in (one, two):
            if side.common_covariance is None or not np.any(np.diag(side.common_covariance) > 0.0):
                return "unknown"
        return "known"

    @property
    def covariance(self) -> np.ndarray:
        """Return the (m, m) covariance of the change, the sides independent; zero for identical numbers, NaN if unknown."""
        size = len(self.change)
        if self.status == "same":
            return np.zeros((size, size))
        parts = [side.common_covariance for side in (self.first, self.second)]
        if parts[0] is None or parts[1] is None or self.status == "unknown":
            return np.full((size, size), np.nan)
        return without_rounding(parts[0] + parts[1], alike=self.kind == "curve")

    @property
    def exact(self) -> np.ndarray:
        """Return (m, e) columns of the parameters without variance, on either side, in common coordinates."""
        found = []
        for side in (self.first, self.second):
            if side.covariance is not None:
                variance = np.diag(side.covariance)
                found.append(side.transform[:, variance <= NOTHING**2 * variance.max(initial=0.0)])
        return np.concatenate([np.zeros((len(self.change), 0)), *found], axis=1)

    @property
    def values(self) -> np.ndarray:
        """Return the (g,) change at ``positions``, or of every number."""
        return np.asarray(self.shape @ self.change)


@final
@dataclass(frozen=True)
class NotCompared:
    """One error that could not be compared.

    Attributes:
        name: its name.
        given_by: ``first`` or ``second`` if only one contains it, else ``both``.
        why: the reason, in words.
        peak: its largest absolute value; NaN if both contain it.
        unit: of the peak.
    """

    name: str
    given_by: Literal["first", "second", "both"]
    why: str
    peak: float
    unit: str


def pair_errors(first: Calibration, second: Calibration) -> tuple[tuple[Pair, ...], tuple[NotCompared, ...]]:
    """Return the errors that two calibrations of one machine have in common, and those that cannot be compared.

    Args:
        first: the older calibration.
        second: the newer calibration.
    """
    one, two = ({effect.name: effect for effect in side.effects} for side in (first, second))
    covariances = first.covariance, second.covariance
    pairs: list[Pair] = []
    not_compared: list[NotCompared] = []
    for name in dict.fromkeys((*one, *two)):
        if name not in one or name not in two:
            given: Literal["first", "second"] = "first" if name in one else "second"
            owner = first if name in one else second
            not_compared.append(_alone(name, given, owner))
            continue
        axis = first.machine.by_name[one[name].frame.axis]
        found = (
            _curve(name, axis, first, second, covariances)
            if name in first.curves
            else _numbers(one[name], two[name], axis.name, covariances)
        )
        if isinstance(found, Pair):
            pairs.append(replace(found, iso_class=iso_class(error_motion_of(one[name], first.machine), first.machine)))
        else:
            not_compared.append(found)
    return tuple(pairs), tuple(not_compared)


def not_identified(first: Calibration, second: Calibration) -> tuple[NotCompared, ...]:
    """Return the errors that neither calibration contains, because they could not be determined.

    An error that one of them contains is listed by `pair_errors`.
    """
    given = {effect.name for side in (first, second) for effect in side.effects}
    reasons = {one.name: one.why for side in (first, second) for one in side.not_identifiable if one.name not in given}
    return tuple(NotCompared(name, "both", why, float("nan"), unit_of(name)) for name, why in reasons.items())


def without_rounding(covariance: np.ndarray, *, alike: bool) -> np.ndarray:
    """Return a covariance with variances that are rounding errors set to zero.

    Args:
        covariance: (m, m).
        alike: whether all have the same unit, so that the largest variance gives the size of rounding errors.
    """
    variance = np.diag(covariance)
    least = NOTHING**2 * variance.max(initial=0.0) if alike else 0.0
    keep = variance > least
    return np.asarray(np.where(np.outer(keep, keep), covariance, 0.0))


def _equal(one: np.ndarray | None, two: np.ndarray | None) -> bool:
    return np.array_equal(one, two) if one is not None and two is not None else one is two


def _alone(name: str, given: Literal["first", "second"], owner: Calibration) -> NotCompared:
    other = "second" if given == "first" else "first"
    if name in owner.curves:
        curve = owner.curves[name]
        peak, unit = float(np.abs(curve(np.linspace(*curve.domain, CURVE_POINTS))).max()), curve.unit
    elif name.startswith("E_"):
        peak, unit = abs(float({**owner.squareness, **owner.location}[name])), unit_of(name)
    else:
        peak, unit = float("nan"), ""
    return NotCompared(
        name, given, f"the {other} calibration does not contain it, which does not mean zero", peak, unit
    )


def _curve(
    name: str, axis: Axis, first: Calibration, second: Calibration, covariances: tuple[Covariance, Covariance]
) -> Pair | NotCompared:
    curves = first.curves[name], second.curves[name]
    effects = [next(effect for effect in side.effects if effect.name == name) for side in (first, second)]
    notes: list[str] = []
    if axis.lower is None:
        lo, hi = curves[0].domain
    else:
        lo, hi = (max(c.domain[0] for c in curves), min(c.domain[1] for c in curves))
        if not lo < hi:
            spans = " and ".join(f"{c.domain[0]:g} to {c.domain[1]:g}" for c in curves)
            return NotCompared(name, "both", f"its domains do not overlap: {spans} {axis.unit}", np.nan, unit_of(name))
        if (lo, hi) != curves[0].domain or (lo, hi) != curves[1].domain:
            notes.append(f"compared from {lo:g} to {hi:g} {axis.unit}, the common domain")
    positions = np.linspace(lo, hi, CURVE_POINTS)
    functions = [_functions(effect, axis.name, positions) for effect in effects]
    counts = [f.shape[1] for f in functions]
    families = curves[0].family, curves[1].family
    if families[0] == families[1] and families[0].nested and counts[0] != counts[1]:
        fewer = "first" if counts[0] < counts[1] else "second"
        notes.append(
            f"the {fewer} has {min(counts)} coefficients, the other {max(counts)}: missing ones are taken as zero"
        )
    # Both in one orthonormal basis of the functions of both curves.
    left, size, _ = np.linalg.svd(np.concatenate(functions, axis=1) / np.sqrt(CURVE_POINTS), full_matrices=False)
    left = left[:, size > ROUNDING * size[0]]
    transform = [left.T @ f / np.sqrt(CURVE_POINTS) for f in functions]
    sides = [
        _side(effect, matrix, covariance)
        for effect, matrix, covariance in zip(effects, transform, covariances, strict=True)
    ]
    change = sides[1].transform @ sides[1].values - sides[0].transform @ sides[0].values
    if families[0] == families[1] and curves[0].coefficients == curves[1].coefficients:
        change = np.zeros_like(change) if curves[0].domain == curves[1].domain else change
    return Pair(
        name=name,
        kind="curve",
        unit=unit_of(name),
        axis=axis.name,
        iso_class="",
        first=sides[0],
        second=sides[1],
        change=read_only(change),
        positions=read_only(positions),
        shape=read_only(left * np.sqrt(CURVE_POINTS)),
        notes=tuple(notes),
    )


def _functions(effect: Effect, axis: str, positions: np.ndarray) -> np.ndarray:
    """Return the (g, k) derivatives of a curve by its coefficients."""
    rates = effect.derivatives({axis: positions})
    return np.stack([np.broadcast_to(next(iter(rate.values())), len(positions)) for rate in rates], axis=1)


def _numbers(one: Effect, two: Effect, axis: str, covariances: tuple[Covariance, Covariance]) -> Pair:
    """Pair the numbers of a squareness, a location or an effect."""
    named = one.name.startswith("E_")
    turns = [_positive_amplitude(effect) for effect in (one, two)]
    sides = [
        _side(effect, np.diag(sign), covariance)
        for effect, (sign, _), covariance in zip((one, two), turns, covariances, strict=True)
    ]
    change = (sides[1].transform @ sides[1].values + turns[1][1]) - (sides[0].transform @ sides[0].values + turns[0][1])
    labels = tuple((number.name.rpartition(".")[2], number.unit) for number in one.parameters)
    for i, (label, _) in enumerate(labels):
        if label == "phase":
            change[i] = (change[i] + pi) % (2.0 * pi) - pi
    return Pair(
        name=one.name,
        kind="number" if named else "effect",
        unit=unit_of(one.name) if named else labels[0][1] if len(labels) == 1 else "",
        axis=axis,
        iso_class="",
        first=sides[0],
        second=sides[1],
        change=read_only(change),
        positions=read_only(np.zeros(0)),
        shape=read_only(np.eye(len(change))),
        labels=labels,
    )


def _positive_amplitude(effect: Effect) -> tuple[np.ndarray, np.ndarray]:
    """Return signs and shifts of the parameters that make the amplitude of a wave positive: −A sin φ = A sin(φ + π)."""
    names = [number.name.rpartition(".")[2] for number in effect.parameters]
    sign, shift = np.ones(len(names)), np.zeros(len(names))
    if "phase" in names and "amplitude" in names and effect.parameters[names.index("amplitude")].value < 0.0:
        sign[names.index("amplitude")] = -1.0
        shift[names.index("phase")] = pi
    return sign, shift


def _side(effect: Effect, transform: np.ndarray, covariance: Covariance) -> Side:
    names = tuple(number.name for number in effect.parameters)
    known = set(names) <= set(covariance.names)
    return Side(
        names,
        read_only(np.array([float(number.value) for number in effect.parameters])),
        read_only(np.asarray(transform)),
        covariance.of(names).matrix if known else None,
    )


def joint_covariance(pairs: Sequence[Pair], covariances: tuple[Covariance, Covariance]) -> np.ndarray:
    """Return the (Σm, Σm) joint covariance of all changes, with the correlations between errors.

    Args:
        pairs: errors of status ``known``.
        covariances: of the first and of the second calibration, taken as independent of each other.
    """
    starts = np.concatenate([[0], np.cumsum([len(pair.change) for pair in pairs])])
    total = np.zeros((int(starts[-1]), int(starts[-1])))
    for covariance, which in zip(covariances, ("first", "second"), strict=True):
        index: Mapping[str, Any] = {name: i for i, name in enumerate(covariance.names)}
        transform = np.zeros((starts[-1], len(covariance.names)))
        for pair, start in zip(pairs, starts, strict=False):
            side: Side = getattr(pair, which)
            transform[start : start + len(pair.change), [index[name] for name in side.numbers]] = side.transform
        total += transform @ covariance.matrix @ transform.T
    for pair, start in zip(pairs, starts, strict=False):
        rows = slice(start, start + len(pair.change))
        gone = np.flatnonzero(np.diag(pair.covariance) == 0.0) + rows.start
        total[gone] = 0.0
        total[:, gone] = 0.0
    return (total + total.T) / 2.0
