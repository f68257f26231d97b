"""Terms of signatures, a derivative times a function each, and how their inner products are put together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from twin.diagnosis.candidates.signatures import Freedom
from twin.numerics.functions import Functions

Terms = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Positions among the columns, indices of functions, and weights; (e,) each."""


@final
@dataclass(frozen=True)
class ProductPlan:
    """Terms of the inner products that come from one pair of function sets.

    Attributes:
        first: (p,) index in the first set of each product of two functions.
        second: (p,) index in the second set.
        derivatives: pairs of derivatives that these products are multiplied by.
        entries: indices of inner product, product of functions and pair of derivatives, and the weight; (e,) each.
    """

    first: np.ndarray
    second: np.ndarray
    derivatives: tuple[tuple[Freedom, Freedom], ...]
    entries: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@final
class SummedTerms:
    """Inner products of functions times derivatives with some vectors, summed over blocks of points.

    Args:
        used: (r,) numbers of the vectors.

    Attributes:
        large: by functions, derivative and number of the first of a few vectors: (few, functions).
        small: by functions and derivatives that are evaluated together: (r, terms).
    """

    def __init__(self, used: np.ndarray) -> None:
        self.used = used
        self.large: dict[tuple[Functions, Freedom, int], np.ndarray] = {}
        self.small: dict[tuple[tuple[Functions, Freedom], ...], np.ndarray] = {}


def along_derivative(derivative: np.ndarray, vectors: np.ndarray, buffers: np.ndarray) -> np.ndarray:
    """Return products (r, points) of a derivative (points, 3) with vectors (3, r, points), in the first of two buffers.

    One coordinate at a time: as a batch of small matrix products it takes eight times as long.
    """
    found, product = buffers[:, : vectors.shape[1]]
    np.multiply(vectors[0], derivative[:, 0], out=found)
    for i in (1, 2):
        found += np.multiply(vectors[i], derivative[:, i], out=product)
    return np.asarray(found)


def side_by_side(*vectors: np.ndarray) -> np.ndarray:
    """Return (points, 3, r) vectors as one array; in memory the points of one vector are contiguous, as in `Signatures.at`."""
    return np.concatenate([own.transpose(1, 2, 0) for own in vectors], axis=1).transpose(2, 0, 1)


def few_of(functions: Functions, index: np.ndarray) -> bool:
    """Return whether an index selects so few of the functions that the others are not evaluated with them."""
    return 2 * len(index) < functions.count


def add_rows(into: np.ndarray, at: np.ndarray, values: np.ndarray) -> None:
    """Add rows of values to the rows ``at``, of which some may be the same."""
    if len(set(at.tolist())) == len(at):
        into[at] += values
    else:
        np.add.at(into, at, values)


def as_arrays(entries: Sequence[tuple[int, int, float]]) -> Terms:
    """Return terms given one by one."""
    first, second, third = zip(*entries, strict=True)
    return np.array(first), np.array(second), np.array(third)


PairCodes = tuple[np.ndarray, np.ndarray, list[np.ndarray], np.ndarray]


def pair_codes(groups: Sequence[np.ndarray], count: int) -> PairCodes:
    """Return the pairs of columns within groups, each once.

    Args:
        groups: indices of columns, (groups, w) each.
        count: number of columns.

    Returns:
        The codes of the pairs (first · count + second); whether first ≤ second; for each array of groups, the positions of its
        (groups, w, w) pairs among the codes; and for each pair with first > second, the position of the transposed pair.
    """
    codes = [columns[:, :, None] * count + columns[:, None, :] for columns in groups]
    pairs, places = np.unique(np.concatenate([np.zeros(0, dtype=int), *map(np.ravel, codes)]), return_inverse=True)
    lower = pairs // count <= pairs % count
    transposed = np.searchsorted(pairs, pairs[~lower] % count * count + pairs[~lower] // count)
    ends = np.cumsum([code.size for code in codes])[:-1]
    own = [place.reshape(code.shape) for place, code in zip(np.split(places, ends), codes, strict=True)]
    return pairs, lower, own, transposed
