"""Waves along an axis: sines and cosines of many frequencies, and how high a frequency the measured positions can tell."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin.numerics.functions import Functions, Rows, pieces

SHORTEST_PERIOD: Final = 2.0
"""mm: pitch errors below it are not sought."""
ALIKE: Final = 0.5
"""Size of the spectral window (1: even positions) from which on two frequencies are too alike to be told apart."""
LOOKED_AT: Final = 500
"""Positions the window is worked out of: its scatter is one over their root, a tenth of `ALIKE`."""
AT_HAND: Final = 64


def highest_frequency(q: np.ndarray, span: float) -> float:
    """Largest frequency, a mm, at which a wave is looked for: one position a period, or where it looks like a slower one.

    Even positions cannot tell f from f_s − f, f_s being one a step; uneven ones can. Which they are their spectral window says: at such
    an f_s all positions are nearly whole periods apart (Deeming 1975, Astrophys. Space Sci. 36, 137).
    """
    places = np.unique(np.round(q, 3))
    return _unlike(places, span, min(1.0 / SHORTEST_PERIOD, max(len(places) - 1, 1) / span))


def sampling(q: np.ndarray) -> float | None:
    """Positions a mm where they are even, so that they cannot tell a wave of f from one of this less f; None where they are not."""
    places = np.unique(np.round(q, 3))
    span = float(np.ptp(places))
    if len(places) < 2:
        return None
    highest = 1.01 * (len(places) - 1) / span
    limit = _unlike(places, span, highest)
    if limit >= highest:
        return None
    # From the edge of the window's peak to the peak itself.
    near = 2.0 * limit + np.linspace(0.0, 1.5, 76) / span
    return float(near[np.argmax(_window(near, places))])


def _window(frequencies: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The spectral window of positions: 1 where all are whole periods apart."""
    return np.asarray(np.abs(np.mean(np.exp(2j * np.pi * np.outer(frequencies, places)), axis=1)))


def _unlike(places: np.ndarray, span: float, highest: float) -> float:
    """Largest frequency up to ``highest`` that does not look like a slower one."""
    if len(places) > LOOKED_AT:  # any of them: what is left of an even row at random has the window of the row
        places = np.random.default_rng(0).choice(places, LOOKED_AT, replace=False)
    looks = np.arange(1.0, 2.0 * highest * span + 1.0, 0.25) / span
    window = _window(looks, places)
    # Down from the window's own peak at zero, which is one over the span wide.
    alike = looks[(window > ALIKE) & (looks > 1.5 / span)]
    return min(highest, 0.5 * float(alike[0])) if alike.size else highest


def highest_order(distinct: np.ndarray, most: int) -> int:
    """Largest harmonic of a turn that positions in degrees can tell from lower ones.

    Args:
        distinct: (n,) the positions, each once, 0 to 360.
        most: harmonics at most.
    """
    limit = _unlike(distinct, float(np.ptp(distinct)), min(most, (len(distinct) - 1) // 2) / 360.0)
    return int(360.0 * limit + 1e-9)


def waves(q: np.ndarray, first: float, step: float, count: int) -> Functions:
    """Sines of evenly spaced frequencies (radians a unit of q), and after them their cosines.

    Each is a coarse wave turned on by a fine one: a product in place of two functions to be worked out.
    """
    fine = max(int(np.ceil(np.sqrt(count))), 1)
    coarse = -(-count // fine)

    def values(rows: Rows) -> np.ndarray:
        at = q[rows, None]
        few = np.exp(1j * at * (first + step * fine * np.arange(coarse)))[:, :, None]
        many = np.exp(1j * at * step * np.arange(fine))[:, None, :]
        found = np.empty((len(at), 2 * count))
        # As many points at a time as the processor has at hand.
        for some in pieces(len(at), AT_HAND):
            every = (few[some] * many[some]).reshape(-1, coarse * fine)[:, :count]
            found[some, :count], found[some, count:] = every.imag, every.real
        return found

    return Functions(len(q), 2 * count, values, most=1.0)
