"""Sines and cosines of many frequencies along an axis, and the highest frequency that the measured positions resolve."""

from __future__ import annotations

from typing import Final

import numpy as np
import scipy

from twin.numerics.functions import Functions, Interpolation, Rows, pieces

SHORTEST_PERIOD: Final = 2.0
"""mm: pitch errors of shorter periods are not considered."""
ALIASED: Final = 0.5
"""Value of the spectral window (1 for even spacing) above which two frequencies are aliases."""
SAMPLED_POSITIONS: Final = 500
"""Positions sampled for the spectral window: its sampling error is one over their square root, a tenth of the threshold."""
BLOCK: Final = 64
"""Points processed at a time."""
SUPPORT: Final = 16
"""Nodes under the kernel of the interpolation: its error is about 1e-12."""
OVERSAMPLING: Final = 2.0
"""Nodes for each half period of the highest frequency."""


def highest_frequency(q: np.ndarray, span: float) -> float:
    """Return the largest frequency, in 1/mm, at which a wave is sought: one position a period, or where aliasing begins.

    Evenly spaced positions cannot distinguish f from f_s − f, where f_s is the sampling frequency; unevenly spaced ones can. The
    spectral window shows which is the case: at such an f_s all positions are nearly whole periods apart (Deeming 1975, Astrophys.
    Space Sci. 36, 137).
    """
    places = np.unique(np.round(q, 3))
    return _alias_free(places, span, min(1.0 / SHORTEST_PERIOD, max(len(places) - 1, 1) / span))


def sampling_frequency(q: np.ndarray) -> float | None:
    """Return the sampling frequency, in 1/mm, of evenly spaced positions; None if no alias is as long as `SHORTEST_PERIOD`."""
    places = np.unique(np.round(q, 3))
    span = float(np.ptp(places))
    if len(places) < 2:
        return None
    highest = 1.01 * min((len(places) - 1) / span, 1.0 / SHORTEST_PERIOD)
    limit = _alias_free(places, span, highest)
    if limit >= highest:
        return None
    # Search from the edge of the window's peak to its maximum.
    near_peak = 2.0 * limit + np.linspace(0.0, 1.5, 76) / span
    return float(near_peak[np.argmax(_window(near_peak, places))])


def _window(frequencies: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return the spectral window of positions at evenly spaced frequencies: 1 where all are whole periods apart.

    Each frequency is the sum of one of a coarse and one of a fine grid, which makes the mean over positions a matrix product.
    """
    fine = max(int(np.ceil(np.sqrt(len(frequencies)))), 1)
    offsets = frequencies[:fine] - frequencies[:1]
    coarse, shifts = (np.exp(2j * np.pi * np.outer(part, places)) for part in (frequencies[::fine], offsets))
    return np.abs(coarse @ shifts.T).ravel()[: len(frequencies)] / len(places)


def _alias_free(places: np.ndarray, span: float, highest: float) -> float:
    """Return the largest frequency up to ``highest`` that is not an alias of a lower one."""
    if len(places) > SAMPLED_POSITIONS:
        # A random sample of evenly spaced positions has the same spectral window.
        places = np.random.default_rng(0).choice(places, SAMPLED_POSITIONS, replace=False)
    frequencies = np.arange(1.0, 2.0 * highest * span + 1.0, 0.25) / span
    window = _window(frequencies, places)
    # Outside the window's main peak at zero, which is one over the span wide.
    aliased = frequencies[(window > ALIASED) & (frequencies > 1.5 / span)]
    return min(highest, 0.5 * float(aliased[0])) if aliased.size else highest


def highest_order(distinct: np.ndarray, most: int) -> int:
    """Return the largest harmonic of a revolution that positions in degrees distinguish from lower ones.

    Args:
        distinct: (n,) the positions, each once, 0 to 360.
        most: upper limit of the harmonic.
    """
    limit = _alias_free(distinct, float(np.ptp(distinct)), min(most, (len(distinct) - 1) // 2) / 360.0)
    return int(360.0 * limit + 1e-9)


def waves(q: np.ndarray, first: float, step: float, count: int) -> Functions:
    """Return sines of evenly spaced frequencies (radians per unit of q), followed by their cosines.

    Each is a sum of two frequencies, one of a coarse and one of a fine grid, by the addition theorems, which saves evaluations.
    """
    fine = max(int(np.ceil(np.sqrt(count))), 1)
    coarse = -(-count // fine)

    def values(rows: Rows) -> np.ndarray:
        at = q[rows, None]
        coarse_angles = (at * (first + step * fine * np.arange(coarse)))[:, :, None]
        fine_angles = (at * step * np.arange(fine))[:, None, :]
        sines, cosines = (np.sin(coarse_angles), np.sin(fine_angles)), (np.cos(coarse_angles), np.cos(fine_angles))
        found = np.empty((len(at), 2 * count))
        one, other = np.empty((2, BLOCK, coarse, fine))
        # Blocks of points that fit the processor's cache.
        for block in pieces(len(at), BLOCK):
            first_part, second_part = one[: len(at[block])], other[: len(at[block])]
            np.multiply(sines[0][block], cosines[1][block], out=first_part)
            first_part += np.multiply(cosines[0][block], sines[1][block], out=second_part)
            found[block, :count] = first_part.reshape(-1, coarse * fine)[:, :count]
            np.multiply(cosines[0][block], cosines[1][block], out=first_part)
            first_part -= np.multiply(sines[0][block], sines[1][block], out=second_part)
            found[block, count:] = first_part.reshape(-1, coarse * fine)[:, :count]
        return found

    def interpolate() -> Interpolation:
        return _interpolation(q, first + step * np.arange(count))

    return Functions(len(q), 2 * count, values, bound=1.0, interpolate=interpolate)


def _interpolation(q: np.ndarray, frequencies: np.ndarray) -> Interpolation:
    """Return the interpolation of sines, followed by cosines, of frequencies in radians per unit of q.

    A wave is the sum over evenly spaced nodes of its values there times a Kaiser-Bessel kernel, divided by the kernel's Fourier
    transform at its frequency; the error is the transform at the aliases (Fessler and Sutton 2003, IEEE Trans. Signal Process. 51,
    560).
    """
    spacing = np.pi / (OVERSAMPLING * float(np.abs(frequencies).max()))
    low = float(q.min()) - 0.5 * SUPPORT * spacing
    at = (q - low) / spacing
    nearest = np.ceil(at - 0.5 * SUPPORT).astype(np.int32)
    nodes = int(nearest.max()) + SUPPORT
    shape = np.pi * SUPPORT * (1.0 - 0.5 / OVERSAMPLING)
    places = nearest[:, None] + np.arange(SUPPORT, dtype=np.int32)
    share = np.maximum(1.0 - ((at[:, None] - places) / (0.5 * SUPPORT)) ** 2, 0.0)
    kernel = scipy.special.i0(shape * np.sqrt(share))
    rest = np.sqrt(shape**2 - (0.5 * SUPPORT * spacing * frequencies) ** 2)
    angles = np.outer(low + spacing * np.arange(nodes), frequencies)
    factor = rest / (SUPPORT * np.sinh(rest))
    table = np.concatenate([np.sin(angles) * factor, np.cos(angles) * factor], axis=1)
    starts = np.arange(0, places.size + 1, SUPPORT, dtype=np.int32)
    return Interpolation(scipy.sparse.csr_matrix((kernel.ravel(), places.ravel(), starts), (len(q), nodes)), table)
