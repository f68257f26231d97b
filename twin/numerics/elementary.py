"""Elementary functions for both NumPy arrays and CasADi expressions, so that a formula is written once."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np


def cos(x: Any) -> Any:
    """Cosine."""
    return ca.cos(x) if isinstance(x, ca.SX) else np.cos(x)


def sin(x: Any) -> Any:
    """Sine."""
    return ca.sin(x) if isinstance(x, ca.SX) else np.sin(x)


def exp(x: Any) -> Any:
    """Exponential."""
    return ca.exp(x) if isinstance(x, ca.SX) else np.exp(x)


def floor(x: Any) -> Any:
    """Largest whole number not above x."""
    return ca.floor(x) if isinstance(x, ca.SX) else np.floor(x)


def fmax(x: Any, y: Any) -> Any:
    """The larger of two."""
    return ca.fmax(x, y) if isinstance(x, ca.SX) or isinstance(y, ca.SX) else np.fmax(x, y)
