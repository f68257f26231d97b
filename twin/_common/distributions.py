"""Tail probabilities and quantiles of χ², F, t and normal distributions, from `scipy.special`.

Importing `scipy.stats` would take longer than most commands take to run.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import scipy


def chi2_sf(value: Any, dof: Any) -> Any:
    """Return the probability that χ² with ``dof`` degrees of freedom exceeds a value."""
    return scipy.special.chdtrc(dof, value)


def chi2_log_sf(value: Any, dof: Any) -> Any:
    """Return the logarithm of `chi2_sf`; −∞ where the probability underflows."""
    with np.errstate(divide="ignore"):
        return np.log(scipy.special.chdtrc(dof, value))


def chi2_isf(chance: Any, dof: Any) -> Any:
    """Return the value that χ² with ``dof`` degrees of freedom exceeds with a given probability."""
    return scipy.special.chdtri(dof, chance)


def f_sf(value: Any, dof: Any, other: Any) -> Any:
    """Return the probability that F with ``dof`` and ``other`` degrees of freedom exceeds a value."""
    return scipy.special.fdtrc(dof, other, value)


def f_log_sf(value: Any, dof: Any, other: Any) -> Any:
    """Return the logarithm of `f_sf`; −∞ where the probability underflows."""
    with np.errstate(divide="ignore"):
        return np.log(scipy.special.fdtrc(dof, other, value))


def f_isf(chance: Any, dof: Any, other: Any) -> Any:
    """Return the value that F with ``dof`` and ``other`` degrees of freedom exceeds with a given probability.

    Computed from the lower tail of the beta distribution of other/(other + dof·F), so that small probabilities keep their digits.
    """
    share = scipy.special.betaincinv(np.multiply(0.5, other), np.multiply(0.5, dof), chance)
    with np.errstate(divide="ignore"):
        return np.multiply(other, 1.0 - share) / np.multiply(dof, share)


def normal_sf(value: Any) -> Any:
    """Return the probability that a standard normal variable exceeds a value."""
    return scipy.special.ndtr(-np.asarray(value))


def normal_isf(chance: Any) -> Any:
    """Return the value that a standard normal variable exceeds with a given probability."""
    return -scipy.special.ndtri(chance)


def student_isf(chance: Any, dof: Any) -> Any:
    """Return the value that Student's t with ``dof`` degrees of freedom exceeds with a given probability."""
    return -scipy.special.stdtrit(dof, chance)


def student_sf(value: Any, dof: Any) -> Any:
    """Return the probability that Student's t with ``dof`` degrees of freedom exceeds a value."""
    return scipy.special.stdtr(dof, -np.asarray(value))


# --- Decision rule of ISO 14253-1:2017: a value with its expanded uncertainty U against a tolerance. Every command decides by

Verdict = Literal["pass", "fail", "undecided"]


def decide(value: float, half: float, tolerance: float) -> Verdict:
    """Return ``pass`` if value + U ≤ tolerance, ``fail`` if value − U > tolerance, else ``undecided``; ``half`` is U (95 %)."""
    return decide_interval(value - half, value + half, tolerance)


def decide_interval(low: float, high: float, tolerance: float) -> Verdict:
    """Return the verdict on an absolute value with the limits of its 95 % interval; ``undecided`` for NaN."""
    if high <= tolerance:
        return "pass"
    return "fail" if low > tolerance else "undecided"


def is_accepted(verdict: Verdict, value: float, tolerance: float) -> bool:
    """Return whether a command is done: no verdict ``fail``, and a known value within its tolerance.

    An undecided value above its tolerance is more probably out of it than within.
    """
    return verdict != "fail" and value <= tolerance
