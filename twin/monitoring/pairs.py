"""Pairing of the errors of two calibrations, and the change of each with its covariance.

A curve is compared as a function over the common part of both domains, whatever its basis and degree: both curves are expressed in
functions that are orthonormal there (mean square one), so that the norm of a change is its RMS. A squareness or location is a number,
and so is every parameter of an effect.

Significance of the changes between two calibrations.

The same change is tested in four ways. An unchanged machine raises a false alarm in at most one comparison of twenty over all of them,
so each test has a quarter of that (Bonferroni):

- all numbers at once: χ² of the whole change;
- each error by itself, with the others free (Holm 1979 over the errors);
- the smallest set of errors that explains the whole change, the others taken as unchanged. Strongly correlated errors have large
  uncertainties by themselves and a small one together; if few errors changed, this test is more sensitive than the first two;
- the tool point over the volume (`twin.monitoring.tool`).

A covariance may have directions without variance, fixed by a convention of `identify` (no curve has a constant). They are left
out of every χ²; a change in such a direction is reported, and is neither significant nor zero.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import pi
from typing import Any, Final, Literal, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.distributions import chi2_log_sf, chi2_sf, normal_isf
from twin._common.messages import Message
from twin._common.records import json_form
from twin.display.numbers import COVERAGE_FACTOR, readable
from twin.machine.machine import Axis
from twin.model.calibration import Calibration
from twin.model.effects import Effect, unit_of
from twin.model.iso16907 import error_motion_of, iso_class
from twin.numerics.covariance import Covariance, symmetric_root
from twin.tool.uncertainty import CURVE_POINTS

ROUNDING: Final = 1e-10
"""Relative singular value up to which a function is linearly dependent on the others."""
ZERO_UNCERTAINTY: Final = 1e-7
"""Ratio of a standard uncertainty to the largest of the same error up to which it is a rounding error of zero."""

Status = Literal["same", "known", "unknown"]


@final
@dataclass(frozen=True)
class Side:
    """The parameters of one error in one of the calibrations."""

    numbers: tuple[str, ...]  # names of the parameters
    values: np.ndarray  # (k,) in the units of the file
    transform: np.ndarray  # (m, k) transformation of the parameters to coordinates common to both calibrations
    covariance: np.ndarray | None  # (k, k), or None if any parameter has no uncertainty

    @property
    def common_covariance(self) -> np.ndarray | None:
        """Return the (m, m) covariance of the common coordinates; None if unknown."""
        return None if self.covariance is None else np.asarray(self.transform @ self.covariance @ self.transform.T)


@final
@dataclass(frozen=True)
class Pair:
    """One error that both calibrations contain."""

    name: str  # ISO 230-1 name, or the effect's own
    kind: Literal["curve", "number", "effect"]  # ``curve``; ``number`` (squareness, location); ``effect``
    unit: str  # ``um`` or ``urad``; empty for an effect of several numbers
    axis: str
    iso_class: str  # class of ISO/TR 16907
    first: Side
    second: Side
    change: np.ndarray  # (m,) second less first, in common coordinates
    positions: np.ndarray  # (g,) positions of the axis, mm or degrees; empty unless a curve
    shape: np.ndarray  # (g, m) value at these positions of a unit of each coordinate; the identity unless a curve
    labels: tuple[tuple[str, str], ...] = ()  # name and unit of every coordinate of an effect
    notes: tuple[str, ...] = ()  # assumptions made

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
                found.append(side.transform[:, variance <= ZERO_UNCERTAINTY**2 * variance.max(initial=0.0)])
        return np.concatenate([np.zeros((len(self.change), 0)), *found], axis=1)

    @property
    def values(self) -> np.ndarray:
        """Return the (g,) change at ``positions``, or of every number."""
        return np.asarray(self.shape @ self.change)


@final
@dataclass(frozen=True)
class NotCompared:
    """One error that could not be compared."""

    name: str
    given_by: Literal["first", "second", "both"]  # ``first`` or ``second`` if only one contains it, else ``both``
    why: str  # in words
    peak: float  # its largest absolute value; NaN if both contain it
    unit: str  # of the peak


def pair_errors(first: Calibration, second: Calibration) -> tuple[tuple[Pair, ...], tuple[NotCompared, ...]]:
    """Return the errors that two calibrations of one machine have in common, and those that cannot be compared."""
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
    """Return the errors that neither calibration contains, because they could not be determined."""
    given = {effect.name for side in (first, second) for effect in side.effects}
    reasons = {
        error.name: error.text for side in (first, second) for error in side.not_identifiable if error.name not in given
    }
    return tuple(NotCompared(name, "both", why, float("nan"), unit_of(name)) for name, why in reasons.items())


def without_rounding(covariance: np.ndarray, *, alike: bool) -> np.ndarray:
    """Return an (m, m) covariance with variances that are rounding errors of others, if ``alike`` in unit, set to zero."""
    variance = np.diag(covariance)
    least = ZERO_UNCERTAINTY**2 * variance.max(initial=0.0) if alike else 0.0
    keep = variance > least
    return np.asarray(np.where(np.outer(keep, keep), covariance, 0.0))


def _equal(one: np.ndarray | None, two: np.ndarray | None) -> bool:
    return np.array_equal(one, two) if one is not None and two is not None else one is two


def _alone(name: str, given: Literal["first", "second"], owner: Calibration) -> NotCompared:
    if name in owner.curves:
        curve = owner.curves[name]
        peak, unit = float(np.abs(curve(np.linspace(*curve.domain, CURVE_POINTS))).max()), curve.unit
    elif name.startswith("E_"):
        peak, unit = abs(float({**owner.squareness, **owner.location}[name])), unit_of(name)
    else:
        peak, unit = float("nan"), ""
    return NotCompared(
        name,
        given,
        Message("the second calibration does not contain it, which does not mean zero")
        if given == "first"
        else Message("the first calibration does not contain it, which does not mean zero"),
        peak,
        unit,
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
            spans = ", ".join(f"{c.domain[0]:g} … {c.domain[1]:g}" for c in curves)
            return NotCompared(
                name,
                "both",
                Message("its domains do not overlap: {spans} {unit}", spans=spans, unit=readable(axis.unit)),
                np.nan,
                unit_of(name),
            )
        if (lo, hi) != curves[0].domain or (lo, hi) != curves[1].domain:
            notes.append(
                Message(
                    "compared from {lo:g} to {hi:g} {unit}, the common domain", lo=lo, hi=hi, unit=readable(axis.unit)
                )
            )
    positions = np.linspace(lo, hi, CURVE_POINTS)
    functions = [_functions(effect, axis.name, positions) for effect in effects]
    counts = [f.shape[1] for f in functions]
    families = curves[0].family, curves[1].family
    if families[0] == families[1] and families[0].nested and counts[0] != counts[1]:
        one, two = counts
        notes.append(
            Message(
                "the first has {one} coefficients, the second {two}: missing ones are taken as zero", one=one, two=two
            )
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
    named = one.name.startswith("E_")
    forms = [effect.normal_form for effect in (one, two)]
    sides = [
        _side(effect, np.diag(signs), covariance)
        for effect, (signs, _), covariance in zip((one, two), forms, covariances, strict=True)
    ]
    values = [side.transform @ side.values + shifts for side, (_, shifts) in zip(sides, forms, strict=True)]
    change = values[1] - values[0]
    labels = tuple((number.name.rpartition(".")[2], number.unit) for number in one.parameters)
    for i, (_, unit) in enumerate(labels):
        if unit == "rad":  # a phase: small angles of the machine are in µrad
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
    """Return the (Σm, Σm) covariance of all changes of status ``known``, the two calibrations taken as independent."""
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


FALSE_ALARMS: Final = 0.05
TESTS: Final = 4
FALSE_ALARMS_OF_A_TEST: Final = FALSE_ALARMS / TESTS
"""Probability of a false alarm of each test."""
ZERO_EIGENVALUE: Final = 1e-8
"""Eigenvalues of a correlation matrix up to this are zero. In files of `identify` with powers of degree 12, rounding leaves 1e-10 for
directions fixed by a convention; the smallest others are 1e-4."""
ROUNDING_SIGMA: Final = 1e-3
"""Changes in directions without variance up to this multiple of the standard uncertainties are rounding errors."""
DRAWS: Final = 4000
SEED: Final = 230
"""Random seed of the draws for simultaneous bands."""
BETTER_CHI2: Final = 2.0 * float(np.log(100.0))
"""χ² by which one explanation must be better than another: odds of 100:1."""
DEPENDENT_SHARE: Final = 1e-6
"""Relative singular value up to which a direction is linearly dependent on those selected."""


@final
@dataclass(frozen=True)
class Whitened:
    """A whitened change: uncorrelated coordinates of variance one."""

    transform: np.ndarray  # (r, m) whitening transformation
    value: np.ndarray  # (r,) the whitened change
    span: np.ndarray  # (m, r) the directions with a variance, orthonormal after division by the standard uncertainties
    without_variance: np.ndarray  # (m,) part of the change in directions without variance, without rounding errors

    @property
    def rank(self) -> int:
        """Return the degrees of freedom."""
        return len(self.value)

    @property
    def chi2(self) -> float:
        """Return the χ² of the change."""
        return float(self.value @ self.value)

    @property
    def p_value(self) -> float:
        """Return the p-value of the χ²; one without degrees of freedom."""
        return float(chi2_sf(self.chi2, self.rank)) if self.rank else 1.0


def whiten(change: np.ndarray, covariance: np.ndarray, exact: np.ndarray | None = None) -> Whitened:
    """Whiten a change (m,), for a singular covariance too; by the correlation matrix, so that units do not matter.

    ``exact``: (m, e) columns of numbers without uncertainty; a change in directions without variance is attributed to these.
    """
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    typical = float(scale.max(initial=0.0)) or 1.0
    safe = np.where(scale > 0.0, scale, typical)
    values, vectors = np.linalg.eigh(covariance / np.outer(safe, safe))
    keep = values > ZERO_EIGENVALUE * max(float(values[-1]), 1.0) if len(values) else np.zeros(0, dtype=bool)
    scaled = change / safe
    none = vectors[:, ~keep]
    still = none @ (none.T @ scaled)
    without_variance = np.zeros_like(change)
    if np.linalg.norm(still) > ROUNDING_SIGMA:
        without_variance = still * safe
        if exact is not None and exact.shape[1]:
            columns = exact / safe[:, None]
            found = columns @ np.linalg.lstsq(none.T @ columns, none.T @ scaled, rcond=None)[0]
            # The remainder belongs to no single number: orthogonal projection onto the directions without variance.
            without_variance = (found + none @ (none.T @ (scaled - found))) * safe
    transform = (vectors[:, keep] / np.sqrt(values[keep])).T / safe
    return Whitened(
        read_only(transform),
        read_only(transform @ (change - without_variance)),
        read_only(safe[:, None] * vectors[:, keep]),
        read_only(without_variance),
    )


@final
@dataclass(frozen=True)
class ErrorChange:
    """The change of one error, second calibration less first."""

    name: str  # ISO 230-1 name, or the effect's own
    kind: Literal["curve", "number", "effect"]  # ``curve``, ``number`` (squareness, location) or ``effect``
    iso_class: str  # class of ISO/TR 16907
    axis: str
    unit: str  # for an effect, that of the number ``label``
    status: Status  # ``known``; ``same``: identical numbers; ``unknown``: a calibration does not state its uncertainty
    label: str  # for an effect, the number that ``largest`` belongs to: the one with the largest change in standard uncertainties
    rms: float  # of a curve, over the common part of both domains; else the absolute value of ``largest``
    largest: float  # the largest change of a curve with its sign, or the change of the number
    at: float  # position of the axis of the largest change, mm or degrees; NaN unless a curve
    u: float  # standard uncertainty (k = 1) of ``largest``; NaN if unknown
    band: float  # half width at ``at`` of the simultaneous 95 % band of the whole curve; for a number 1.96 u; NaN if unknown.
    p_value: float  # of the χ² of the change; NaN if unknown
    p_adjusted: float  # p-value corrected for the number of errors tested (Holm)
    without_variance: float  # largest change in directions without an uncertainty, in ``unit``; zero if none
    notes: tuple[str, ...]  # assumptions made

    @property
    def significant(self) -> bool | None:
        """Return whether the change is significant by itself, corrected for the number of errors; None if unknown."""
        if self.status == "same":
            return False
        return None if self.status == "unknown" else self.p_adjusted <= FALSE_ALARMS_OF_A_TEST

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON; null for unknown values."""
        renamed = {"name": "error", "iso_class": "class", "label": "number", "band": "band95"}
        entry = json_form(self, rename=renamed, leave_out=("without_variance", "notes"))
        return entry | {
            "number": self.label or None,
            "significant": self.significant,
            "without_uncertainty": self.without_variance,
            "notes": list(self.notes),
        }


def holm_adjusted(p_values: Sequence[float]) -> list[float]:
    """Return p-values corrected for multiple testing (Holm 1979)."""
    order = np.argsort(p_values, kind="stable")
    holm_adjusted = [1.0] * len(p_values)
    largest = 0.0
    for place, i in enumerate(order):
        largest = max(largest, min((len(p_values) - place) * p_values[i], 1.0))
        holm_adjusted[i] = largest
    return holm_adjusted


def simultaneous_factor(shape: np.ndarray, covariance: np.ndarray) -> float:
    """Return the coverage factor of a simultaneous 95 % band of a curve, by Monte Carlo; ``shape``: (g, m) of unit coordinates."""
    # The coordinates are those of an arbitrary orthonormal basis: turned to be nearest to cosines, they do not depend on rounding.
    count, places = len(covariance), (np.arange(len(shape)) + 0.5) / max(len(shape), 1)
    left, _, right = np.linalg.svd(shape.T @ np.cos(np.pi * np.outer(places, np.arange(count))))
    turn = left @ right
    factor = shape @ turn @ symmetric_root(turn.T @ covariance @ turn)
    size = np.linalg.norm(factor, axis=1)
    if not np.any(size):
        return COVERAGE_FACTOR
    seen = size > 1e-9 * size.max()
    drawn = np.random.default_rng(SEED).standard_normal((count, DRAWS))
    return float(np.quantile(np.abs(factor[seen] @ drawn / size[seen, None]).max(axis=0), 0.95))


@final
@dataclass(frozen=True)
class ChangeCandidate:
    """One form in which one error may have changed."""

    pair: int  # index of the error
    whole: bool  # whether any change of the error, or only a line or parabola over a linear axis
    directions: np.ndarray  # (m, k) in the coordinates of the pair
    columns: np.ndarray  # (r, k) orthonormal, in the whitened coordinates of all errors


@final
@dataclass(frozen=True)
class Culprit:
    """One error of the smallest set that explains the change."""

    pair: int  # index of the error
    change: np.ndarray  # (m,) estimate, all errors outside the set taken as unchanged
    covariance: np.ndarray  # (m, m) of the estimate
    p_value: float  # given the others of the set, not corrected for multiple testing
    alternatives: tuple[int, ...]  # errors that would explain the change in its place, within odds of 100:1


@final
@dataclass(frozen=True)
class SmallestSet:
    """The smallest set of errors that explains a change."""

    culprits: tuple[Culprit, ...]  # strongest first; empty if no error is significant
    left_p_value: float  # p-value of the change they do not explain
    tried: int  # number of candidates, for which every p-value is corrected
    shows_from: tuple[float, ...]  # detection limits of single numbers (19 of 20 comparisons); NaN for others


def smallest_set(pairs: Sequence[Pair], white: Whitened, linear: Sequence[bool]) -> SmallestSet:
    """Select the smallest set of errors (``known``) that explains a whitened change: stepwise, with removal and exchange."""
    candidates = _candidates(pairs, white, linear)
    if not candidates:
        return SmallestSet((), white.p_value, 0, (float("nan"),) * len(pairs))
    level = FALSE_ALARMS_OF_A_TEST / len(candidates)
    search = _Search(candidates, white.value)
    search.run(float(np.log(level)))
    basis = search.basis()
    left = float(np.sum((white.value - basis @ (basis.T @ white.value)) ** 2))
    freedom = len(white.value) - basis.shape[1]
    order = sorted(search.chosen, key=lambda i: search.beside_others(i)[0])
    shows = np.full(len(pairs), np.nan)
    for candidate in candidates:
        if len(pairs[candidate.pair].change) == 1:
            u = float(np.abs(candidate.directions[0, 0]))
            shows[candidate.pair] = u * (normal_isf(level / 2.0) + normal_isf(0.05))
    left_p = float(chi2_sf(left, freedom)) if freedom else 1.0
    return SmallestSet(tuple(map(search.culprit, order)), left_p, len(candidates), tuple(shows.tolist()))


def _candidates(pairs: Sequence[Pair], white: Whitened, linear: Sequence[bool]) -> list[ChangeCandidate]:
    candidates: list[ChangeCandidate] = []
    start = 0
    for i, (pair, straight) in enumerate(zip(pairs, linear, strict=True)):
        rows = slice(start, start + len(pair.change))
        start = rows.stop
        own = whiten(pair.change, pair.covariance)
        ways = [(True, own.span)]
        if pair.kind == "curve" and straight and own.rank > 2:
            u = np.linspace(-1.0, 1.0, len(pair.positions))
            low = pair.shape.T @ np.stack([np.ones_like(u), u, u**2], axis=1) / len(u)
            # Without directions fixed by a convention.
            allowed = own.span @ (np.linalg.pinv(own.span) @ low)
            left, size, _ = np.linalg.svd(allowed, full_matrices=False)
            ways.append((False, left[:, size > 1e-3 * size.max(initial=1e-300)]))
        for whole, directions in ways:
            columns = white.transform[:, rows] @ directions
            left, size, right = np.linalg.svd(columns, full_matrices=False)
            keep = size > DEPENDENT_SHARE * size.max(initial=0.0) if size.size else np.zeros(0, dtype=bool)
            if np.any(keep):
                candidates.append(
                    ChangeCandidate(
                        i, whole, read_only(directions @ right[keep].T / size[keep]), read_only(left[:, keep])
                    )
                )
    return candidates


@final
class _Search:
    """Stepwise selection among candidates; ``value``: (r,) whitened change, ``chosen``: indices of those selected."""

    def __init__(self, candidates: Sequence[ChangeCandidate], value: np.ndarray) -> None:
        self.candidates = candidates
        self.value = value
        self.chosen: list[int] = []

    def run(self, level: float) -> None:
        """Add the best candidate while the logarithm of its p-value is at most ``level``; exchange and remove in between."""
        seen: set[frozenset[int]] = set()
        while frozenset(self.chosen) not in seen:
            seen.add(frozenset(self.chosen))
            gains = self._gains(self.basis())
            best = min(range(len(gains)), key=lambda i: gains[i][0])
            if gains[best][0] > level:
                break
            pair = self.candidates[best].pair
            self.chosen = [i for i in self.chosen if self.candidates[i].pair != pair] + [best]
            self._exchange()
            while self.chosen:
                weakest = max(self.chosen, key=lambda i: self.beside_others(i)[0])
                if self.beside_others(weakest)[0] <= level:
                    break
                self.chosen.remove(weakest)

    def basis(self, without: int | None = None) -> np.ndarray:
        """Return an orthonormal (r, k) basis of the selected candidates, optionally without one of them."""
        columns = [self.candidates[i].columns for i in self.chosen if i != without]
        if not columns:
            return np.zeros((len(self.value), 0))
        left, size, _ = np.linalg.svd(np.concatenate(columns, axis=1), full_matrices=False)
        return np.asarray(left[:, size > DEPENDENT_SHARE])

    def beside_others(self, which: int) -> tuple[float, float, int]:
        """Return the gain of one selected candidate given the others; see `_gain`."""
        return self._gain(self.candidates[which], self.basis(without=which))

    def culprit(self, which: int) -> Culprit:
        """Return one selected error, estimated jointly with the others, with its alternatives."""
        own = self.candidates[which]
        stacked = np.concatenate([self.candidates[i].columns for i in self.chosen], axis=1)
        inverse = np.linalg.pinv(stacked, rcond=DEPENDENT_SHARE)
        before = self.chosen[: self.chosen.index(which)]
        at = sum(self.candidates[i].columns.shape[1] for i in before)
        rows = slice(at, at + own.columns.shape[1])
        estimate = own.directions @ (inverse @ self.value)[rows]
        covariance = own.directions @ (inverse @ inverse.T)[rows, rows] @ own.directions.T
        gains = self._gains(self.basis(without=which))
        taken = {self.candidates[i].pair for i in self.chosen}
        mine = gains[which][1] - 2.0 * gains[which][2]
        rivals = dict.fromkeys(
            self.candidates[i].pair
            for i in np.argsort([gain[0] for gain in gains], kind="stable")
            if self.candidates[i].pair not in taken and mine - (gains[i][1] - 2.0 * gains[i][2]) < BETTER_CHI2
        )
        return Culprit(
            own.pair, read_only(estimate), read_only(covariance), float(np.exp(gains[which][0])), tuple(rivals)
        )

    def _exchange(self) -> None:
        for place, which in enumerate(list(self.chosen)):
            taken = {self.candidates[i].pair for i in self.chosen if i != which}
            gains = self._gains(self.basis(without=which))
            free = [i for i, one in enumerate(self.candidates) if one.pair not in taken]
            best = min(free, key=lambda i: gains[i][0])
            if gains[best][0] < gains[which][0]:
                self.chosen[place] = best

    def _gains(self, basis: np.ndarray) -> list[tuple[float, float, int]]:
        return [self._gain(candidate, basis) for candidate in self.candidates]

    def _gain(self, one: ChangeCandidate, basis: np.ndarray) -> tuple[float, float, int]:
        """Return log p-value, χ² gain and degrees of freedom of one candidate given a basis."""
        columns = one.columns
        if basis.shape[1]:
            left, size, _ = np.linalg.svd(columns - basis @ (basis.T @ columns), full_matrices=False)
            columns = left[:, size > DEPENDENT_SHARE]
        freedom = columns.shape[1]
        if not freedom:
            return 0.0, 0.0, 0
        gain = float(np.sum((columns.T @ self.value) ** 2))
        return float(chi2_log_sf(gain, freedom)), gain, freedom
