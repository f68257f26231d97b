"""Explain the correction of a calibration curve by a single mistake in making the curve, where one suffices.

A correction Δ of the curve f was estimated in orthonormal functions, with covariance C. A mistake predicts Δ up to a few parameters;
the rest is tested by a Wald chi². The simplest mistake that is not rejected is named:
- f was applied with a wrong factor (zero, wrong sign, twice, another unit): Δ = (s − 1)·f;
- f was fitted without a constant term (Ellingsdalen 2021, listing 3.1: every degree above one), so that it is zero at q = 0 where the
  machine's error is not: Δ = c·(1 − the least-squares fit of 1 by q, q² … qⁿ at the stops);
- f is a polynomial of too high a degree for its stops and oscillates between them: Δ cancels f above some degree.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from twin._common.distributions import chi2_sf
from twin.machine.motion_curve import Curve
from twin.numerics.curves import CurveSpace

REJECTED: Final = 1e-3
"""p-value below which a mistake is rejected: the rest of the correction is not noise."""
MAIN_SHARE: Final = 0.97
"""Share of the correction's chi² above which a mistake is named even if rejected: the curve's other errors are small."""
STOPS: Final = (9, 11, 13, 16, 21, 51)
"""Numbers of evenly spaced stops at which a curve may have been fitted."""
ITSELF: Final = 0.0
"""Key, in place of a number of stops, for the curve itself with another factor."""
RANK_TOLERANCE: Final = 1e-9


def flaw(space: CurveSpace, curve: Curve, correction: np.ndarray, covariance: np.ndarray) -> str:
    """Return the mistake in words; empty if none explains the correction, or the curve has more coefficients than functions.

    Args:
        space: functions of the correction.
        curve: the calibration's curve, of the same basis and domain.
        correction: (k,) coefficients of the first functions, µm or µrad.
        covariance: (k, k) of these; zero for directions that are not identifiable.
    """
    if len(curve.coefficients) > space.count:
        return ""
    calibrated = _coefficients(space, curve)
    weight, rank = _inverse(covariance)
    k = len(correction)
    whole = float(correction @ weight @ correction)
    unit = curve.unit.replace("urad", "µrad").replace("um", "µm")

    def tested(known: np.ndarray, free: np.ndarray) -> tuple[float, np.ndarray, bool]:
        """Return chi² of the correction less known + free·s, the best s, and whether the mistake is accepted."""
        gram = free.T @ weight @ free
        s = np.linalg.pinv(gram, hermitian=True) @ (free.T @ weight @ (correction - known))
        rest = correction - known - free @ s
        chi2 = float(rest @ weight @ rest)
        dof = rank - int(np.linalg.matrix_rank(gram, hermitian=True))
        accepted = dof > 0 and (chi2_sf(chi2, dof) > REJECTED or chi2 < (1.0 - MAIN_SHARE) * whole)
        return chi2, s, accepted

    # A factor is tested only if the correction's functions contain nearly all of the curve.
    if np.linalg.norm(calibrated[k:]) < (1.0 - MAIN_SHARE) * np.linalg.norm(calibrated):
        _, factor, accepted = tested(np.zeros(k), calibrated[:k, None])
        if accepted:
            return times(1.0 + float(factor[0]))
    fits = []
    for stops in STOPS:
        pattern = without_constant(space, len(curve.coefficients) - 1, stops)
        if pattern is not None and np.linalg.norm(pattern[k:]) < (1.0 - MAIN_SHARE) * np.linalg.norm(pattern):
            chi2, size, accepted = tested(np.zeros(k), pattern[:k, None])
            fits.append((chi2, float(size[0]), accepted))
    if fits:
        _, constant, accepted = min(fits)
        if accepted:
            return constant_dropped(curve, constant)
    degree = len(curve.coefficients) - 1
    for lower in range(1, degree if k > degree else 1):
        known = np.where(np.arange(k) > lower, -calibrated[:k], 0.0)
        free = np.eye(k)[:, : lower + 1]
        if tested(np.zeros(k), free)[2]:
            break  # the terms above this degree may just as well be right
        if tested(known, free)[2]:
            q, _ = space.grid()
            oscillation = space.functions(q)[:, lower + 1 :] @ calibrated[lower + 1 :]
            return (
                f"its polynomial of degree {degree} oscillates by up to {float(np.abs(oscillation).max()):.2g} {unit} where the "
                f"machine does not: the terms above degree {lower} are spurious"
            )
    return ""


def constant_dropped(curve: Curve, size: float) -> str:
    """Return a sentence on a constant term of a given size that was left out of a fit."""
    unit = curve.unit.replace("urad", "µrad").replace("um", "µm")
    return (
        f"its polynomial of degree {len(curve.coefficients) - 1} was fitted without a constant term, "
        f"so it is forced through zero at 0, where the machine's error is {size:.3g} {unit}"
    )


def without_constant(space: CurveSpace, degree: int, stops: int) -> np.ndarray | None:
    """Return coefficients (count,) of 1 less its fit by q, q² … qⁿ at evenly spaced stops; None if the fit is exact or impossible.

    Args:
        space: the functions; the stops span its domain.
        degree: degree n of the polynomial.
        stops: number of stops.
    """
    lo, hi = space.domain
    if not lo <= 0.0 <= hi or degree < 2 or degree >= space.count or stops <= degree:
        return None
    q = np.linspace(lo, hi, stops)
    scale = max(abs(lo), abs(hi))
    # Scaled to u = q/scale for the conditioning.
    powers = np.stack([(q / scale) ** n for n in range(1, degree + 1)], axis=1)
    fitted, *_ = np.linalg.lstsq(powers, np.ones(stops), rcond=None)
    at, weight = space.grid()
    values = 1.0 - np.stack([(at / scale) ** n for n in range(1, degree + 1)], axis=1) @ fitted
    functions = space.functions(at)
    return np.asarray(functions.T @ (weight * values))


def of_curve(space: CurveSpace, curve: Curve) -> np.ndarray | None:
    """Return the curve's coefficients (count,) in the functions; None if it has more coefficients than functions, or is zero."""
    if len(curve.coefficients) > space.count or not np.any(curve.coefficients):
        return None
    return _coefficients(space, curve)


def _coefficients(space: CurveSpace, curve: Curve) -> np.ndarray:
    return np.asarray(np.linalg.solve(space.transform, _padded(curve.coefficients, space.count)))


def mistakes(space: CurveSpace, curve: Curve | None) -> dict[float, np.ndarray]:
    """Return coefficients of the corrections by one mistake each, by number of stops or `ITSELF`; each has one unknown factor."""
    if curve is None:
        return {}
    shapes = {float(n): without_constant(space, len(curve.coefficients) - 1, n) for n in STOPS}
    shapes[ITSELF] = of_curve(space, curve)
    return {stops: shape for stops, shape in shapes.items() if shape is not None}


def times(factor: float) -> str:
    """Return a sentence on a machine whose error motion is the calibration's curve times a factor."""
    if abs(factor) < 0.1:
        return "the machine does not have this error motion at all: it is already corrected, or the curve is of another machine"
    if abs(factor + 1.0) < 0.1:
        return "the calibration's curve has the wrong sign"
    return f"the machine's error motion is {factor:.2g} times the calibration's curve"


def _padded(values: Sequence[float], count: int) -> np.ndarray:
    return np.concatenate([np.asarray(values, dtype=float), np.zeros(count - len(values))])


def _inverse(covariance: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the pseudo-inverse over the identifiable directions, and their number."""
    values, vectors = np.linalg.eigh(covariance)
    identifiable = values > RANK_TOLERANCE * values[-1] if len(values) else np.zeros(0, dtype=bool)
    return np.asarray((vectors[:, identifiable] / values[identifiable]) @ vectors[:, identifiable].T), int(
        identifiable.sum()
    )
