"""Tails of χ², F and the normal distribution, from `scipy.special`: `scipy.stats` takes longer to import than most commands to run."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import special


def chi2_sf(value: Any, dof: Any) -> Any:
    """Chance that a χ² of ``dof`` degrees of freedom is larger."""
    return special.chdtrc(dof, value)


def chi2_log_sf(value: Any, dof: Any) -> Any:
    """Its logarithm; −∞ where the chance is too small for a number."""
    with np.errstate(divide="ignore"):
        return np.log(special.chdtrc(dof, value))


def chi2_isf(chance: Any, dof: Any) -> Any:
    """The value that is exceeded with a chance."""
    return special.chdtri(dof, chance)


def f_sf(value: Any, dof: Any, other: Any) -> Any:
    """Chance that an F of ``dof`` and ``other`` degrees of freedom is larger."""
    return special.fdtrc(dof, other, value)


def f_log_sf(value: Any, dof: Any, other: Any) -> Any:
    """Its logarithm; −∞ where the chance is too small for a number."""
    with np.errstate(divide="ignore"):
        return np.log(special.fdtrc(dof, other, value))


def f_isf(chance: Any, dof: Any, other: Any) -> Any:
    """The value that is exceeded with a chance.

    By the beta distribution of other/(other + dof·F), whose lower tail it is: a small chance keeps its digits.
    """
    share = special.betaincinv(np.multiply(0.5, other), np.multiply(0.5, dof), chance)
    with np.errstate(divide="ignore"):
        return np.multiply(other, 1.0 - share) / np.multiply(dof, share)


def normal_sf(value: Any) -> Any:
    """Chance that a standard normal number is larger."""
    return special.ndtr(-np.asarray(value))


def normal_isf(chance: Any) -> Any:
    """The value that is exceeded with a chance."""
    return -special.ndtri(chance)


def student_isf(chance: Any, dof: Any) -> Any:
    """The value that a Student t of ``dof`` degrees of freedom exceeds with a chance."""
    return -special.stdtrit(dof, chance)
