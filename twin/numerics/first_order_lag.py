"""First-order lag of an input: dL/dt = (s − L)/τ (Bryan 1990, CIRP Annals 39, 645, on thermal effects)."""

from __future__ import annotations

from itertools import pairwise
from typing import Final, Literal, NamedTuple

import numpy as np

LARGEST_DECAY: Final = 300.0
"""Natural logarithm of the largest decay within a block of the recursion."""
Between = Literal["held", "linear"]


class Lagged(NamedTuple):
    """The lag of an input and its derivative by the time constant, (n,) each, in the order of the readings."""

    value: np.ndarray
    by_constant: np.ndarray


def lagged(time_s: np.ndarray, source: np.ndarray, constant: float, between: Between) -> Lagged:
    """Return the first-order lag of an input at readings in any order of time.

    Args:
        time_s: (n,) time of each reading, s.
        source: (n,) the input s at the readings.
        constant: time constant τ, s.
        between: ``held``: a value applies from the reading before on, the first from time zero on, and L(0) = 0 (a speed that was
            set); ``linear``: the input changes linearly between readings, and L is equal to it at the first one (a temperature).
    """
    order = np.argsort(time_s, kind="stable")
    end = np.asarray(source, dtype=float)[order]
    t = np.asarray(time_s, dtype=float)[order]
    held = between == "held"
    passed = np.maximum(np.diff(t, prepend=0.0 if held else t[:1]), 0.0)
    begin = end if held else np.concatenate([end[:1], end[:-1]])
    first = 0.0 if held else float(end[0])
    value = follow(passed, begin, end, constant, first)
    slope = np.where(passed > 0.0, (end - begin) / np.where(passed > 0.0, passed, 1.0), 0.0)
    decay = np.exp(-passed / constant)
    # L − (s − kτ) decays; s − kτ follows an input of slope k for ever.
    ahead = np.concatenate([[first], value[:-1]]) - begin + slope * constant
    driven = slope * (decay - 1.0) + ahead * passed * decay / constant**2
    back = np.empty((2, len(end)))
    back[:, order] = value, _recursion(decay, driven, 0.0)
    return Lagged(back[0], back[1])


def follow(passed: np.ndarray, begin: np.ndarray, end: np.ndarray, constant: float, first: float) -> np.ndarray:
    """Return (n,) the lag at the end of consecutive intervals, in each of which the input changes linearly.

    Args:
        passed: (n,) lengths of the intervals, s.
        begin: (n,) the input at the beginning of each.
        end: (n,) the input at the end of each.
        constant: time constant, s.
        first: the lag before the first interval.
    """
    decay = np.exp(-passed / constant)
    gain = np.where(passed > 0.0, (1.0 - decay) * constant / np.where(passed > 0.0, passed, 1.0), 1.0)
    driven = (gain - decay) * begin + (1.0 - gain) * end
    return _recursion(decay, driven, first)


def _recursion(decay: np.ndarray, driven: np.ndarray, first: float) -> np.ndarray:
    """Return (n,) x with x_i = decay_i x_{i−1} + driven_i.

    With the cumulative product P of the decays, x_i = P_i (x_0 + Σ driven_j/P_j), in blocks in which P does not underflow.
    """
    rate = np.minimum(-np.log(np.maximum(decay, 1e-300)), LARGEST_DECAY)
    block = (np.cumsum(rate) / LARGEST_DECAY).astype(int)
    starts = [0, *(np.flatnonzero(np.diff(block)) + 1).tolist(), len(decay)]
    found, last = np.empty(len(decay)), first
    for start, end in pairwise(starts):
        factor = np.cumprod(np.exp(-rate[start:end]))
        found[start:end] = factor * (last + np.cumsum(driven[start:end] / factor))
        last = float(found[end - 1]) if end > start else last
    return found
