"""Functions of the machine's state: elementary ones, lags and waves, for NumPy arrays and CasADi expressions.

A search uses thousands of them; their values at all points would take many times the memory of the data.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, Final, Literal, NamedTuple, TypeVar, final

import casadi as ca
import numpy as np
import scipy

PIECE: Final = 1024
"""Points processed at a time."""

T = TypeVar("T")
Rows = np.ndarray | slice
"""A selection of points: their indices, or a slice."""


@final
@dataclass(frozen=True)
class Interpolation:
    """Functions as sums of a few functions of narrow support, for sums over very many points."""

    weights: scipy.sparse.csr_matrix  # (points, nodes) sparse matrix
    table: np.ndarray  # (nodes, count) coefficients; the values are ``weights @ table``


@final
class Functions:
    """Several functions of the state.

    Args:
        points: number of points.
        count: number of functions.
        values: function from a selection of points to values (rows, count).
        where: (points,) whether any function is not zero there; anywhere if None.
        bound: upper bound of their magnitude; if None, the largest magnitude at the points is computed.
        interpolate: function that makes an interpolation with the values' rounding error; None if there is none.
        tabulated: whether the values are looked up, not computed.
    """

    def __init__(
        self,
        points: int,
        count: int,
        values: Callable[[Rows], np.ndarray],
        where: np.ndarray | None = None,
        bound: float | None = None,
        interpolate: Callable[[], Interpolation] | None = None,
        *,
        tabulated: bool = False,
    ) -> None:
        self.points = points
        self.count = count
        self.values = values
        self.where = where
        self.tabulated = tabulated
        self._bound = bound
        self._interpolate = interpolate

    @cached_property
    def interpolation(self) -> Interpolation | None:
        """Return the interpolation; None if there is none."""
        return None if self._interpolate is None else self._interpolate()

    @cached_property
    def largest(self) -> np.ndarray:
        """(count,) largest magnitude over all points, or the bound."""
        if self._bound is not None:
            return np.full(self.count, self._bound)
        largest = np.zeros(self.count)
        for rows in pieces(self.points):
            np.maximum(largest, np.abs(self.values(rows)).max(axis=0, initial=0.0), out=largest)
        return largest


def pieces(points: int, size: int = PIECE) -> list[slice]:
    """Return slices of at most ``size`` points that cover all points."""
    return [slice(start, min(start + size, points)) for start in range(0, points, size)]


def count_of(rows: Rows, points: int) -> int:
    """Return the number of points in a selection."""
    return len(range(points)[rows]) if isinstance(rows, slice) else len(rows)


def tabulated(values: np.ndarray) -> Functions:
    """Return functions given by a table of values (n, count); one of booleans takes an eighth of the memory of numbers."""
    return Functions(len(values), values.shape[1], lambda rows: np.asarray(values[rows], dtype=float), tabulated=True)


@final
class CachingState(dict[str, Any]):
    """State of the readings with a cache for quantities that several effects derive from it (`cached_in_state`)."""

    def __init__(self, state: Mapping[str, Any]) -> None:
        super().__init__(state)
        self.known: dict[Hashable, Any] = {}


def cached_in_state(state: Mapping[str, Any], key: Hashable, make: Callable[[], T]) -> T:
    """Return a quantity derived from a state, made by ``make`` and cached under the key if the state is a `CachingState`."""
    if not isinstance(state, CachingState):
        return make()
    if key not in state.known:
        state.known[key] = make()
    cached_in_state: T = state.known[key]
    return cached_in_state


@final
class _StateSubset(Mapping[str, Any]):
    """The state at a selection of points; columns are selected on access."""

    def __init__(self, state: Mapping[str, Any], rows: Rows) -> None:
        self._state = state
        self._rows = rows

    def __getitem__(self, name: str) -> Any:
        return self._state[name][self._rows]

    def __iter__(self) -> Iterator[str]:
        return iter(self._state)

    def __len__(self) -> int:
        return len(self._state)


def functions_of_state(
    state: Mapping[str, Any], shapes: Callable[[Mapping[str, Any]], Sequence[Mapping[int, Any]]], *, whole: bool = False
) -> tuple[Functions, list[list[tuple[int, int]]]]:
    """Return the functions that an effect's formula gives, and for each shape its components, each with the index of its function.

    The formula takes the state at some points (at all if ``whole``) to the values of each shape by component, always the same ones.
    """
    points = len(next(iter(state.values())))
    first = shapes(state if whole else _StateSubset(state, slice(0, 1)))
    order = [(k, i) for k, shape in enumerate(first) for i in shape]
    own = [[(i, n) for n, (of, i) in enumerate(order) if of == k] for k in range(len(first))]
    if whole:
        return tabulated(np.stack([np.broadcast_to(first[k][i], points) for k, i in order], axis=1)), own

    def values(rows: Rows) -> np.ndarray:
        shape_values = shapes(_StateSubset(state, rows))
        found = np.empty((count_of(rows, points), len(order)))
        for column, (k, i) in enumerate(order):
            found[:, column] = shape_values[k][i]
        return found

    return Functions(points, len(order), values), own


# --- Elementary functions for both NumPy arrays and CasADi expressions, so that a formula is written once


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


# --- First-order lag of an input: dL/dt = (s − L)/τ (Bryan 1990, CIRP Annals 39, 645, on thermal effects)

LARGEST_DECAY: Final = 300.0
"""Natural logarithm of the largest decay within a block of the recursion."""
Between = Literal["held", "linear"]


class Lagged(NamedTuple):
    """The lag of an input and its derivative by the time constant, (n,) each, in the order of the readings."""

    value: np.ndarray
    by_constant: np.ndarray


def lagged(time_s: np.ndarray, source: np.ndarray, constant: float, between: Between) -> Lagged:
    """Return the first-order lag of an input (n,) with a time constant in s, at readings at times (n,) in any order.

    ``held``: a value applies from the reading before on, the first from time zero on, and L(0) = 0 (a speed that was set); ``linear``:
    the input changes linearly between readings, and L is equal to it at the first one (a temperature).
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
    """Return (n,) the lag at the end of consecutive intervals of ``passed`` s, in each of which the input changes linearly.

    ``begin`` and ``end`` (n,) are the input at either end of each, ``first`` is the lag before the first.
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
    recursion, last = np.empty(len(decay)), first
    for start, end in pairwise(starts):
        factor = np.cumprod(np.exp(-rate[start:end]))
        recursion[start:end] = factor * (last + np.cumsum(driven[start:end] / factor))
        last = float(recursion[end - 1]) if end > start else last
    return recursion


# --- Sines and cosines of many frequencies along an axis, and the highest frequency that the measured positions resolve

SHORTEST_PERIOD: Final = 2.0
"""mm: pitch errors of shorter periods are not considered."""
WAVES_PER_POSITION: Final = 4
"""Largest number of waves for each measured position: uneven positions resolve more than one, but many waves imitate any error."""
ALIASED: Final = 0.999
"""Value of the spectral window (1 for even spacing) above which two frequencies are aliases: below it the readings decide."""
ALIASED_ORDER: Final = 0.5
"""The same for orders of a turn, of which many are tried for many errors; more if the positions are few."""
SAMPLED_POSITIONS: Final = 500
"""Positions sampled for the spectral window: its sampling error is one over their square root, a tenth of the threshold."""
BLOCK: Final = 64
"""Points processed at a time."""
SUPPORT: Final = 16
"""Nodes under the kernel of the interpolation: its error is about 1e-12."""
OVERSAMPLING: Final = 2.0
"""Nodes for each half period of the highest frequency."""


def highest_frequency(q: np.ndarray, span: float) -> float:
    """Return the largest frequency, in 1/mm, at which a wave is sought: `WAVES_PER_POSITION`, or where aliasing begins.

    Evenly spaced positions cannot distinguish f from f_s − f, where f_s is the sampling frequency; unevenly spaced ones can. The
    spectral window shows which is the case: at such an f_s all positions are nearly whole periods apart (Deeming 1975, Astrophys.
    Space Sci. 36, 137).
    """
    places = np.unique(np.round(q, 3))
    return _alias_free(places, span, min(1.0 / SHORTEST_PERIOD, WAVES_PER_POSITION * max(len(places) - 1, 1) / span))


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


def _alias_free(places: np.ndarray, span: float, highest: float, alias: float = ALIASED) -> float:
    """Return the largest frequency up to ``highest`` that is not an alias of a lower one."""
    if len(places) > SAMPLED_POSITIONS:
        # A random sample of evenly spaced positions has the same spectral window.
        places = np.random.default_rng(0).choice(places, SAMPLED_POSITIONS, replace=False)
    # In steps of a fraction of the peak of an alias, which is one over the span wide.
    step = 1.0 / 32.0
    frequencies = np.arange(1.0, 2.0 * highest * span + 1.0, step) / span
    window = _window(frequencies, places)
    # Outside the window's main peak at zero, which is one over the span wide.
    aliased = frequencies[(window > alias) & (frequencies > 1.5 / span)]
    # At half of it, every other reading of a wave has the same value: below it.
    return min(highest, 0.5 * float(aliased[0] - step / span)) if aliased.size else highest


def highest_order(distinct: np.ndarray, most: int) -> int:
    """Return the largest harmonic of a revolution that distinct positions (n,), 0 to 360°, distinguish from lower ones.

    It is at most ``most``, and `WAVES_PER_POSITION` for each position.
    """
    span, highest = float(np.ptp(distinct)), min(most, WAVES_PER_POSITION * (len(distinct) - 1)) / 360.0
    # The largest of many values of a window of n random positions is about √(ln(frequencies)/n): that is no alias.
    random = np.sqrt(np.log(max(8.0 * highest * span, 2.0)) / len(distinct))
    limit = _alias_free(distinct, span, highest, max(ALIASED_ORDER, min(1.5 * random, 0.9)))
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
