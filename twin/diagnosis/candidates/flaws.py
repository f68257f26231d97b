"""Why a curve of the calibration is wrong, where one plain mistake in making it says it all.

A correction Δ of the curve f was found, with its covariance C, in orthonormal functions. A mistake foretells Δ up to few numbers; how
far the rest is from nothing is a chi² (Wald). The plainest mistake that is not contradicted is named:
- f is taken with a factor: not at all, with the wrong sign, twice, in another unit: Δ = (s − 1)·f;
- f was fitted without a constant (Ellingsdalen 2021, listing 3.1: every degree above one), so that it is nothing at q = 0 where the
  machine is not: Δ = c·(1 − what q, q² … qⁿ can do of it at the stops);
- f has terms the machine does not have: a polynomial of high degree on few stops swings between them: Δ undoes f above some degree.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from twin._common.distributions import chi2_sf
from twin.machine.motion_curve import Curve
from twin.numerics.curves import CurveSpace

CONTRADICTED: Final = 1e-3
"""Chance below which what a mistake leaves of the correction is not scatter."""
MOSTLY: Final = 0.97
"""Share of the correction above which a mistake is named all the same: beside it, other errors of the curve are small."""
STOPS: Final = (9, 11, 13, 16, 21, 51)
"""Numbers of even stops a curve may have been fitted at."""
ITSELF: Final = 0.0
"""In place of a number of stops: the curve itself, taken with another factor."""
SEEN: Final = 1e-9


def flaw(space: CurveSpace, curve: Curve, correction: np.ndarray, covariance: np.ndarray) -> str:
    """The mistake in words; empty where none is plain, or the curve has more coefficients than there are functions.

    Args:
        space: the functions of the correction.
        curve: of the calibration, of the same basis and domain.
        correction: (k,) coefficients of the first functions, µm or µrad.
        covariance: (k, k) of them; what the data do not see is zero.
    """
    if len(curve.coefficients) > space.count:
        return ""
    given = _given(space, curve)
    weight, rank = _inverse(covariance)
    k = len(correction)
    whole = float(correction @ weight @ correction)
    unit = curve.unit.replace("urad", "µrad").replace("um", "µm")

    def left(known: np.ndarray, free: np.ndarray) -> tuple[float, np.ndarray, bool]:
        """Chi² of what known + free·s leaves, the best s, and whether the mistake stands."""
        gram = free.T @ weight @ free
        s = np.linalg.pinv(gram, hermitian=True) @ (free.T @ weight @ (correction - known))
        off = correction - known - free @ s
        chi2 = float(off @ weight @ off)
        dof = rank - int(np.linalg.matrix_rank(gram, hermitian=True))
        stands = dof > 0 and (chi2_sf(chi2, dof) > CONTRADICTED or chi2 < (1.0 - MOSTLY) * whole)
        return chi2, s, stands

    # What the curve has beyond the correction's functions the data do not object to.
    if np.linalg.norm(given[k:]) < (1.0 - MOSTLY) * np.linalg.norm(given):
        _, factor, stands = left(np.zeros(k), given[:k, None])
        if stands:
            return times(1.0 + float(factor[0]))
    tried = []
    for stops in STOPS:
        pattern = without_constant(space, len(curve.coefficients) - 1, stops)
        if pattern is not None and np.linalg.norm(pattern[k:]) < (1.0 - MOSTLY) * np.linalg.norm(pattern):
            chi2, size, stands = left(np.zeros(k), pattern[:k, None])
            tried.append((chi2, float(size[0]), stands))
    if tried:
        _, constant, stands = min(tried)
        if stands:
            return constant_dropped(curve, constant)
    degree = len(curve.coefficients) - 1
    for lower in range(1, degree if k > degree else 1):
        known = np.where(np.arange(k) > lower, -given[:k], 0.0)
        free = np.eye(k)[:, : lower + 1]
        if left(np.zeros(k), free)[2]:
            break  # that they are right is not contradicted either
        if left(known, free)[2]:
            q, _ = space.grid()
            swing = space.functions(q)[:, lower + 1 :] @ given[lower + 1 :]
            return (
                f"its polynomial of degree {degree} swings by up to {float(np.abs(swing).max()):.2g} {unit} where the machine does "
                f"not: the terms above degree {lower} are not there"
            )
    return ""


def constant_dropped(curve: Curve, size: float) -> str:
    """In words: what a constant of some size, left out of a fit, did."""
    unit = curve.unit.replace("urad", "µrad").replace("um", "µm")
    return (
        f"its polynomial of degree {len(curve.coefficients) - 1} was fitted without a constant term, "
        f"so it is forced through zero at 0, where the machine errs by {size:.3g} {unit}"
    )


def without_constant(space: CurveSpace, degree: int, stops: int) -> np.ndarray | None:
    """(count,) coefficients of what a constant of one leaves of a polynomial q, q² … fitted to it at even stops; None if that is exact.

    Args:
        space: the functions; its domain is where the stops are.
        degree: of the polynomial.
        stops: how many.
    """
    lo, hi = space.domain
    if not lo <= 0.0 <= hi or degree < 2 or degree >= space.count or stops <= degree:
        return None
    q = np.linspace(lo, hi, stops)
    scale = max(abs(lo), abs(hi))
    # In u = q/scale; the same polynomial whatever the unit.
    powers = np.stack([(q / scale) ** n for n in range(1, degree + 1)], axis=1)
    fitted, *_ = np.linalg.lstsq(powers, np.ones(stops), rcond=None)
    at, weight = space.grid()
    values = 1.0 - np.stack([(at / scale) ** n for n in range(1, degree + 1)], axis=1) @ fitted
    functions = space.functions(at)
    return np.asarray(functions.T @ (weight * values))


def of_curve(space: CurveSpace, curve: Curve) -> np.ndarray | None:
    """(count,) the curve's own coefficients of the functions; None if it has more than they, or is nothing."""
    if len(curve.coefficients) > space.count or not np.any(curve.coefficients):
        return None
    return _given(space, curve)


def _given(space: CurveSpace, curve: Curve) -> np.ndarray:
    return np.asarray(np.linalg.solve(space.transform, _padded(curve.coefficients, space.count)))


def mistakes(space: CurveSpace, curve: Curve | None) -> dict[float, np.ndarray]:
    """What one mistake did to the calibration's polynomial, by `STOPS` or `ITSELF`: one number, not as many as the polynomial has."""
    if curve is None:
        return {}
    shapes = {float(n): without_constant(space, len(curve.coefficients) - 1, n) for n in STOPS}
    shapes[ITSELF] = of_curve(space, curve)
    return {stops: shape for stops, shape in shapes.items() if shape is not None}


def times(factor: float) -> str:
    """In words: what the machine does is the calibration's curve with a factor."""
    if abs(factor) < 0.1:
        return "the machine does not have the calibration's curve at all: it is corrected elsewhere, or it was another machine's"
    if abs(factor + 1.0) < 0.1:
        return "the calibration's curve has the wrong sign"
    return f"the machine does {factor:.2g} times what the calibration's curve says"


def _padded(values: Sequence[float], count: int) -> np.ndarray:
    return np.concatenate([np.asarray(values, dtype=float), np.zeros(count - len(values))])


def _inverse(covariance: np.ndarray) -> tuple[np.ndarray, int]:
    """Inverse over what the data see, and how many directions that is."""
    values, vectors = np.linalg.eigh(covariance)
    seen = values > SEEN * values[-1] if len(values) else np.zeros(0, dtype=bool)
    return np.asarray((vectors[:, seen] / values[seen]) @ vectors[:, seen].T), int(seen.sum())
