"""First-order lag of a channel behind its input: dL/dt = (s − L)/τ (Bryan 1990, CIRP Annals 39, 645, on thermal effects)."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

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
    passed = np.maximum(np.diff(t, prepend=0.0 if between == "held" else t[:1]), 0.0)
    begin = np.concatenate([end[:1], end[:-1]]) if between == "linear" else end
    slope = np.where(passed > 0.0, (end - begin) / np.where(passed > 0.0, passed, 1.0), 0.0)
    decay = np.exp(-passed / constant)
    faded = passed * decay / constant**2
    value, by_constant = (0.0 if between == "held" else float(end[0])), 0.0
    found = np.zeros((2, len(end)))
    # L − (s − kτ) decays; s − kτ follows an input of slope k for ever.
    for i, (d, f, b, e, k) in enumerate(
        zip(decay.tolist(), faded.tolist(), begin.tolist(), end.tolist(), slope.tolist(), strict=True)
    ):
        ahead = value - b + k * constant
        value, by_constant = e - k * constant + ahead * d, -k + (by_constant + k) * d + ahead * f
        found[:, i] = value, by_constant
    back = np.empty_like(found)
    back[:, order] = found
    return Lagged(back[0], back[1])
