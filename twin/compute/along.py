"""A CasADi function at points along many straight lines, of which only the largest values or totals are kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Final, TypeVar, final

import casadi as ca
import numpy as np

from twin._common.arrays import distinct
from twin.compute.batch import BatchFunction
from twin.compute.native import ROUNDING, CompiledAlong, Totals, worth_compiling

AT_ONCE: Final = 100_000
"""Points evaluated at once without compiled code, to bound the memory."""
TRIED: Final = 64
"""Lines on which compiled code must agree with the evaluation point by point before it is used."""

Found = TypeVar("Found", np.ndarray, Totals)


@final
class AlongFunction:
    """A function at points spread evenly along lines: at fractions (k + ½)/n of each.

    Args:
        function: dense inputs, of which the last is the fraction; scalar outputs.
    """

    def __init__(self, function: ca.Function) -> None:
        self._rows = BatchFunction(function)
        self._compiled = CompiledAlong(function)
        self._confirmed = False

    def largest(self, inputs: tuple[np.ndarray, ...], points: np.ndarray) -> np.ndarray:
        """Return (lines,) the largest value, at least 0, of a function with one output on each line.

        Args:
            inputs: (lines, entries) each, or (entries,) for one value shared by all lines.
            points: (lines,) number of points on each line.
        """
        compiled = self._compiled.largest
        return self._chosen(inputs, points, compiled, self._largest, lambda found: found)

    def totals(self, inputs: tuple[np.ndarray, ...], points: np.ndarray, slack: float) -> Totals:
        """Return the totals of all outputs but the last, over the points at which the last is at most ``slack``.

        Points at which the first output is not finite do not count either. Arguments as for `largest`.
        """

        def compiled(inputs: tuple[np.ndarray, ...], points: np.ndarray) -> Totals | None:
            return self._compiled.totals(inputs, points, slack)

        def plain(inputs: tuple[np.ndarray, ...], points: np.ndarray) -> Totals:
            return self._totals(inputs, points, slack)

        return self._chosen(inputs, points, compiled, plain, _means)

    def _chosen(
        self,
        inputs: tuple[np.ndarray, ...],
        points: np.ndarray,
        compiled: Callable[[tuple[np.ndarray, ...], np.ndarray], Found | None],
        plain: Callable[[tuple[np.ndarray, ...], np.ndarray], Found],
        numbers: Callable[[Found], np.ndarray],
    ) -> Found:
        """Return the result of compiled code, if it is worth its time and agrees on the first lines; else that of all points."""
        rows = len(points)
        arrays = tuple(np.broadcast_to(np.asarray(array, dtype=float), (rows, np.shape(array)[-1])) for array in inputs)
        if worth_compiling(int(points.sum())) and self._compiled.usable:
            if not self._confirmed:
                some, few = tuple(array[:TRIED] for array in arrays), points[:TRIED]
                tried = compiled(some, few)
                self._confirmed = tried is not None and _alike(numbers(tried), numbers(plain(some, few)))
                if tried is not None and not self._confirmed:
                    self._compiled.refuse()
            found = compiled(arrays, points) if self._confirmed else None
            if found is not None:
                return found
        return plain(arrays, points)

    def _largest(self, inputs: tuple[np.ndarray, ...], points: np.ndarray) -> np.ndarray:
        found = np.zeros(len(points))
        for part, (values,) in self._expanded(inputs, points):
            there = np.flatnonzero(points[part] > 0)
            first = (np.cumsum(points[part]) - points[part])[there]
            if there.size:
                found[part.start + there] = np.maximum(np.maximum.reduceat(values[:, 0], first), 0.0)
        return found

    def _totals(self, inputs: tuple[np.ndarray, ...], points: np.ndarray, slack: float) -> Totals:
        total = Totals.none(len(self._rows.widths_out) - 1)
        for part, outputs in self._expanded(inputs, points):
            *columns, beyond = (output[:, 0] for output in outputs)
            known = np.isfinite(columns[0]) & (beyond <= slack)
            line = np.repeat(np.arange(len(points[part])), points[part])[known]
            values = np.stack(columns)[:, known]
            if line.size:
                at = np.argmax(values, axis=1)
                squares = np.einsum("ij,ij->i", values, values)
                total = total.joined(Totals(line.size, squares, values[:, at].T, line[at]), part.start)
        return total

    def _expanded(
        self, inputs: tuple[np.ndarray, ...], points: np.ndarray
    ) -> Iterator[tuple[slice, tuple[np.ndarray, ...]]]:
        """Yield portions of the lines with the outputs at all of their points."""
        total = np.cumsum(points)
        cuts = distinct(np.searchsorted(total, np.arange(AT_ONCE, total[-1], AT_ONCE))) if len(total) else []
        for first, last in pairwise([0, *cuts, len(points)]):
            count = points[first:last]
            number = np.repeat(np.arange(first, last), count)
            if number.size:
                yield (
                    slice(first, last),
                    self._rows(*(array.take(number, axis=0) for array in inputs), fractions(count)[:, None]),
                )


def fractions(points: np.ndarray) -> np.ndarray:
    """Return (n,) the fractions of all points of lines with these numbers of points: (k + ½)/n."""
    number = np.arange(points.sum()) - np.repeat(np.cumsum(points) - points, points)
    return (number + 0.5) / np.repeat(points, points)


def _means(found: Totals) -> np.ndarray:
    """Return number of points and root mean squares."""
    return np.append(np.sqrt(found.squares / max(found.count, 1)), found.count)


def _alike(found: np.ndarray, plain: np.ndarray) -> bool:
    """Return whether two results agree to rounding, relative to the value or to one."""
    return bool(np.allclose(found, plain, rtol=ROUNDING, atol=ROUNDING, equal_nan=True))
