"""Distributions over drawn machines, as sums and as counts over fine bins: their size does not grow with the number of machines."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Final, final

import numpy as np

BINS: Final = 512
"""Number of bins over some seven standard deviations: an interpolated quantile is within 1e-4 of a standard deviation."""
MEASURES: Final = ("as_it_is.rms", "as_it_is.max", "compensated.rms", "compensated.max")
"""Quantities per machine, over the poses: error relative to the nominal machine and relative to the estimated one."""


@final
@dataclass(frozen=True)
class Counts:
    """Distributions of several quantities, as counts over equal bins.

    Attributes:
        lower, upper: limits of the range of the bins, any shape.
        counts: (…, bins + 2), the first below all bins, the last above all bins.
    """

    lower: np.ndarray
    upper: np.ndarray
    counts: np.ndarray

    def quantile(self, share: float) -> np.ndarray:
        """Return the quantiles, interpolated linearly within a bin; NaN outside the bins."""
        bins = self.counts.shape[-1] - 2
        below = np.cumsum(self.counts, axis=-1)
        wanted = share * below[..., -1:]
        at = np.sum(below < wanted, axis=-1, keepdims=True)
        inside = (at >= 1) & (at <= bins)
        at = np.clip(at, 1, bins)
        own, before = (np.take_along_axis(*one, axis=-1) for one in ((self.counts, at), (below, at - 1)))
        place = (at - 1 + (wanted - before) / np.maximum(own, 1))[..., 0]
        found = self.lower + (self.upper - self.lower) * place / bins
        return np.asarray(np.where(inside[..., 0], found, np.nan))


@final
@dataclass(frozen=True)
class Tally:
    """Sums and counts over a number of machines.

    Attributes:
        machines: number of machines.
        point: (4, poses, bins + 2) counts of the deviation of the point along x, y, z, and of its length.
        sums: (poses, 3) sums of the point's deviation, µm.
        squares: (poses, 3, 3) sums of its products, µm².
        measures: (4, bins + 2) counts of `MEASURES`.
        totals: (4,) sums of `MEASURES`, µm.
        largest: (4,) maxima of `MEASURES`, µm.
    """

    machines: int
    point: np.ndarray
    sums: np.ndarray
    squares: np.ndarray
    measures: np.ndarray
    totals: np.ndarray
    largest: np.ndarray

    def plus(self, other: Tally) -> Tally:
        """Return the sum of both."""
        added = {one.name: getattr(self, one.name) + getattr(other, one.name) for one in fields(self)}
        return Tally(**added | {"largest": np.maximum(self.largest, other.largest)})


def binned(values: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Return the counts (…, bins + 2) of values (…, k) over equal bins from ``lower`` to ``upper`` (…)."""
    width, shape = BINS + 2, lower.shape
    scale = BINS / (upper - lower)
    # The first bin is 0, and places are positive: a conversion to integers rounds them down.
    place = values * scale[..., None]
    place += (1.0 - lower * scale)[..., None]
    np.clip(place, 0.0, BINS + 1.0, out=place)
    found = place.astype(np.intp)
    found += width * np.arange(lower.size).reshape(shape)[..., None]
    return np.bincount(found.reshape(-1), minlength=width * lower.size).reshape(*shape, width)
