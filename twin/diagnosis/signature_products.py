"""Signatures of many columns and their inner products, computed in blocks of points to limit the memory."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, reduce
from functools import partial as partial_of
from typing import Final, final

import numpy as np
import scipy

from twin._common.resources import SHARES, map_chunks
from twin.diagnosis.candidates.candidate import Column, Freedom, ReadingDerivatives, SignatureTerm
from twin.identification.network import LinearisedReadings
from twin.numerics.functions import Functions, Interpolation, Rows, pieces


@final
class PointBlock:
    """Derivatives and functions of the state at a block of points, each computed once.

    ``kept`` holds values of functions for further passes, and the functions to keep.
    """

    def __init__(
        self,
        view: LinearisedReadings,
        rows: Rows,
        kept: tuple[dict[Functions, np.ndarray | None], Collection[Functions]] | None = None,
    ) -> None:
        self.rows = rows
        self._points = view.rows[rows]
        self.derivatives = ReadingDerivatives(view, rows)
        self._values: dict[Functions, np.ndarray | None] = {}
        self._acts: dict[str, np.ndarray] = {}
        self._weights: dict[Functions, scipy.sparse.csr_matrix] = {}
        self._kept, self._keep = ({}, ()) if kept is None else kept

    def acts(self, freedom: Freedom) -> bool:
        """Return whether any of the readings depends on a degree of freedom."""
        name, direction = freedom
        if name not in self._acts:
            self._acts[name] = np.any(self.derivatives.of(name) != 0.0, axis=(0, 1))
        return bool(self._acts[name][direction])

    def values(self, functions: Functions) -> np.ndarray | None:
        """Return the functions' values (points, count), or None if all are zero."""
        # The values of a table are no faster to look up in a copy.
        values = self._kept if functions in self._keep and not functions.tabulated else self._values
        if functions not in values:
            values[functions] = None if self.is_zero(functions) else functions.values(self._points)
        return values[functions]

    def is_zero(self, functions: Functions) -> bool:
        """Return whether all functions are zero at these points."""
        return functions.where is not None and not functions.where[self._points].any()

    def weights(self, functions: Functions, interpolation: Interpolation) -> scipy.sparse.csr_matrix:
        """Return the weights (points, nodes) of the interpolation of some functions."""
        if functions not in self._weights:
            self._weights[functions] = interpolation.weights[self._points]
        return self._weights[functions]


Terms = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Positions among the columns, indices of functions, and weights; (e,) each."""


@final
@dataclass(frozen=True)
class ProductPlan:
    """Terms of the inner products that come from one pair of function sets."""

    first: np.ndarray  # (p,) index in the first set of each product of two functions
    second: np.ndarray  # (p,) index in the second set
    derivatives: tuple[tuple[Freedom, Freedom], ...]  # pairs that these products are multiplied by
    # indices of inner product, product of functions and pair of derivatives, and the weight; (e,) each
    entries: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@final
class SummedTerms:
    """Inner products of functions times derivatives with r vectors (numbers ``used``), summed over blocks of points.

    ``large``: (few, functions) by functions, derivative and first of a few vectors; ``small``: (r, terms) by terms evaluated together.
    """

    def __init__(self, used: np.ndarray) -> None:
        self.used = used
        self.large: dict[tuple[Functions, Freedom, int], np.ndarray] = {}
        self.small: dict[tuple[tuple[Functions, Freedom], ...], np.ndarray] = {}


def along_derivative(derivative: np.ndarray, vectors: np.ndarray, buffers: np.ndarray) -> np.ndarray:
    """Return products (r, points) of a derivative (points, 3) with vectors (3, r, points), in the first of two buffers.

    One coordinate at a time: as a batch of small matrix products it takes eight times as long.
    """
    along_derivative, product = buffers[:, : vectors.shape[1]]
    np.multiply(vectors[0], derivative[:, 0], out=along_derivative)
    for i in (1, 2):
        along_derivative += np.multiply(vectors[i], derivative[:, i], out=product)
    return np.asarray(along_derivative)


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
    """Return the pairs of columns within groups (groups, w), each once, as codes first · count + second, and whether first ≤ second.

    And for each array of groups the positions of its (groups, w, w) pairs among them, and for first > second of the transposed.
    """
    codes = [columns[:, :, None] * count + columns[:, None, :] for columns in groups]
    pairs, places = np.unique(np.concatenate([np.zeros(0, dtype=int), *map(np.ravel, codes)]), return_inverse=True)
    lower = pairs // count <= pairs % count
    transposed = np.searchsorted(pairs, pairs[~lower] % count * count + pairs[~lower] // count)
    ends = np.cumsum([code.size for code in codes])[:-1]
    own = [place.reshape(code.shape) for place, code in zip(np.split(places, ends), codes, strict=True)]
    return pairs, lower, own, transposed


BLOCK_WIDTH: Final = 64  # vectors, or products of two functions, at a time: they stay in the processor's cache
FEW_VECTORS: Final = 16  # number of vectors below which every derivative is multiplied by the vectors first
FEW_FUNCTIONS: Final = 20  # of a derivative, up to which it is multiplied by these, fewer than the vectors
LEAST_FUNCTIONS: Final = 16  # sets of fewer functions than this are merged into one set
MOST_SUMS: Final = 4  # number of sets of vectors that are not zero, besides that of all, for which sums are kept
LARGEST_CACHE: Final = 2**25  # number of function values (256 MB) up to which they are cached between passes


@final
class Signatures:
    """Signatures of many columns in plausible sizes, never held at all points at once.

    Each point belongs to one of ``parts`` (n,), from 0; all to a single part if None.
    """

    def __init__(self, view: LinearisedReadings, columns: Sequence[Column], parts: np.ndarray | None = None) -> None:
        self.view = view
        self._parts = np.zeros(len(view.rows), dtype=int) if parts is None else parts
        self.columns = list(columns)
        self._kept: dict[int, dict[Functions, np.ndarray | None]] = {}
        self._planned: (
            tuple[Sequence[np.ndarray], PairCodes, Mapping[tuple[Functions, Functions], ProductPlan]] | None
        ) = None
        self._prepare()

    def replace(self, at: Sequence[int], columns: Sequence[Column]) -> None:
        """Replace the columns with indices ``at``."""
        for i, column in zip(at, columns, strict=True):
            self.columns[i] = column
        self._prepare()

    def along(
        self, vectors: Callable[[PointBlock], np.ndarray], rows: np.ndarray | None = None, *, by_part: bool = True
    ) -> np.ndarray:
        """Return inner products (parts, columns, r) with r vectors (points, 3, r), given by a function of a block of points.

        Over ``rows``, as one part, or over all points: by part, or not.
        """
        runs, part_of, count = self._runs_of(rows)
        if not self.columns:
            runs = runs[:1]  # only for the number of vectors
        lists: list[list[int]] = [[] for _ in range(count)]
        for run in range(len(runs)):
            lists[part_of(run)].append(run)
        if count == 1 or not by_part:
            every = [run for own in lists for run in own]
            lists = [own for own in (every[i::SHARES] for i in range(SHARES)) if own]
        made: np.ndarray = np.zeros(0)
        for share, own in enumerate(lists):
            sums, width = self._sums_over(vectors, [(run, runs) for run in own])
            if not share:
                made = np.zeros((len(lists), len(self.columns), width))
            self._add_sums(sums, made[share])
        return made if count > 1 and by_part else reduce(np.ndarray.__iadd__, made)[None]

    def _sums_over(
        self, vectors: Callable[[PointBlock], np.ndarray], own: Sequence[tuple[int, Sequence[np.ndarray]]]
    ) -> tuple[Sequence[SummedTerms], int]:
        """Return inner products with r vectors, summed over some runs, and r.

        A reading of one side of the machine has zeros in all derivatives and nuisance vectors of the other side; they are skipped.
        """
        sums: dict[bytes, SummedTerms] = {}
        for run in own:
            block = self._block(*run)
            right = vectors(block)
            width, used = right.shape[2], np.flatnonzero(right.any(axis=(0, 1)))
            if len(sums) >= MOST_SUMS and used.tobytes() not in sums:
                used = np.arange(width)
            right = (right if len(used) == width else right[:, :, used]).transpose(1, 2, 0)
            self._add_block(block, right, sums.setdefault(used.tobytes(), SummedTerms(used)))
        return list(sums.values()), width

    def _add_sums(self, sums: Sequence[SummedTerms], found: np.ndarray) -> None:
        """Add sums over points to the inner products (columns, r)."""
        for one in sums:
            if len(one.used) == found.shape[1]:
                self._add_summed(one, found)
            else:
                part = np.zeros((len(found), len(one.used)))
                self._add_summed(one, part)
                found[:, one.used] += part

    def _add_block(self, block: PointBlock, right: np.ndarray, sums: SummedTerms) -> None:
        """Add the inner products of functions times derivatives with (3, r, points) vectors at a block of points."""
        by_freedom = self._by_freedom
        if right.shape[1] >= FEW_VECTORS:
            by_freedom = self._large
            terms, weighted = self._small_terms(block)
            products = sum(right[i] @ weighted[i] for i in range(3))
            if terms in sums.small:
                sums.small[terms] += products
            else:
                sums.small[terms] = products
        for freedom, projected, start in self._projected(block, right, by_freedom):
            for functions, (_, index, _) in by_freedom[freedom].items():
                found = self._with_functions(block, projected, functions, index)
                if found is None:
                    continue
                key = functions, freedom, start
                if key in sums.large:
                    sums.large[key] += found
                else:
                    sums.large[key] = found

    def _with_functions(
        self, block: PointBlock, projected: np.ndarray, functions: Functions, index: np.ndarray
    ) -> np.ndarray | None:
        """Return products (r, functions or nodes) of (r, points) vectors with functions; None if these are zero."""
        if functions in self._interpolated:
            weights = block.weights(functions, self._interpolated[functions])
            return np.asarray((weights.T @ projected.T).T)
        values = block.values(functions)
        if values is None:
            return None
        # A derivative may multiply only a few of the functions.
        return np.asarray(projected @ (values[:, index] if few_of(functions, index) else values))

    def _add_summed(self, sums: SummedTerms, found: np.ndarray) -> None:
        """Add to the inner products (columns, r) of the signatures with the vectors those of their terms."""
        while sums.large:
            (functions, freedom, start), values = sums.large.popitem()
            columns, index, weight = self._lookup[functions][freedom]
            if functions in self._interpolated:
                own_values = self._interpolated[functions].table[:, index].T @ values.T
            else:
                own_values = values.T if few_of(functions, index) else values.T[index]
            add_rows(found[:, start : start + len(values)], columns, weight[:, None] * own_values)
        for terms, products in sums.small.items():
            at = [np.zeros(0, dtype=int), *(self._lookup[functions][freedom][0] for functions, freedom in terms)]
            np.add.at(found, np.concatenate(at), products.T)

    def _projected(
        self, block: PointBlock, right: np.ndarray, by_freedom: Mapping[Freedom, Mapping[Functions, Terms]]
    ) -> Iterator[tuple[Freedom, np.ndarray, int]]:
        """Yield products (few, points) of each derivative with a few of the (3, r, points) vectors, and the number of the first."""
        buffers = np.empty((2, BLOCK_WIDTH, right.shape[2]))
        acting = [
            freedom
            for freedom, lookups in by_freedom.items()
            if block.acts(freedom) and not all(block.is_zero(of) for of in lookups)
        ]
        for few in pieces(right.shape[1], BLOCK_WIDTH):
            some = np.ascontiguousarray(right[:, few])
            for freedom in acting:
                yield freedom, along_derivative(block.derivatives[freedom], some, buffers), few.start

    def _small_terms(self, block: PointBlock) -> tuple[tuple[tuple[Functions, Freedom], ...], np.ndarray]:
        """Return the terms with few functions of a derivative that are not zero in a block, and their (3, points, terms) values."""
        acting = tuple(
            (functions, freedom)
            for functions, freedom in self._small
            if block.acts(freedom) and not block.is_zero(functions)
        )
        count = sum(len(self._lookup[functions][freedom][0]) for functions, freedom in acting)
        terms = np.empty((3, len(self.view.residual[block.rows]), count))
        start = 0
        for functions, freedom in acting:
            _, index, weight = self._lookup[functions][freedom]
            at = slice(start, start + len(index))
            start = at.stop
            values = block.values(functions)
            own, derivative = values[:, index] * weight, block.derivatives[freedom]  # type: ignore[index]
            for i in range(3):
                np.multiply(own, derivative[:, i, None], out=terms[i, :, at])
        return acting, terms

    def within(self, groups: Sequence[np.ndarray], rows: np.ndarray | None = None) -> list[np.ndarray]:  # noqa: C901
        """Return the inner products within groups of columns: (parts, groups, w, w) for each array of indices (groups, w).

        An inner product is a sum of products of two functions times products of two derivatives; each product of functions is
        computed once.
        """
        if self._planned is None or self._planned[0] is not groups:
            codes = pair_codes(groups, len(self.columns))
            self._planned = groups, codes, self._product_plan(codes[0][codes[1]])
        _, (pairs, lower, places, transposed), needed = self._planned

        def partial(own: Sequence[int]) -> np.ndarray:
            total: dict[tuple[int, Functions, Functions], np.ndarray] = {}
            for run in own:
                part = part_of(run)
                block = self._block(run, runs)
                turned: dict[Functions, np.ndarray] = {}
                dots = cache(partial_of(_dots, block))
                for (a, b), lookup in needed.items():
                    of_a, of_b = block.values(a), block.values(b)
                    if of_a is None or of_b is None:
                        continue
                    for functions, of in ((a, of_a), (b, of_b)):
                        if functions not in turned:
                            turned[functions] = np.ascontiguousarray(of.T)
                    weights = np.stack([dots(*both) for both in lookup.derivatives], axis=1)
                    if not weights.any():
                        continue
                    if (part, a, b) not in total:
                        total[part, a, b] = np.zeros((len(lookup.first), len(lookup.derivatives)))
                    for few in pieces(len(lookup.first), BLOCK_WIDTH):
                        products = turned[a][lookup.first[few]] * turned[b][lookup.second[few]]
                        total[part, a, b][few] += products @ weights
            found = np.zeros((count, len(pairs)))
            own_of = np.flatnonzero(lower)
            for (part, a, b), values in total.items():
                place, product, freedom, weight = needed[a, b].entries
                np.add.at(found[part], own_of[place], weight * values[product, freedom])
            return found

        runs, part_of, count = self._runs_of(rows)
        values = reduce(np.ndarray.__iadd__, map_chunks(range(len(runs)), partial))
        # The matrices are symmetric.
        values[:, ~lower] = values[:, transposed]
        return [values[:, own] for own in places]

    def _product_plan(self, pairs: np.ndarray) -> Mapping[tuple[Functions, Functions], ProductPlan]:
        """Return the terms of the inner products of pairs of columns (codes: first · columns + second)."""
        lists: dict[tuple[Functions, Functions], list[tuple[int, int, int, Freedom, Freedom, float]]] = {}
        for place, code in enumerate(pairs.tolist()):
            one, other = (self.columns[i] for i in divmod(code, len(self.columns)))
            scale = one.scale * other.scale
            for p in one.terms:
                for q in other.terms:
                    (a, k), (b, n) = self._location(p), self._location(q)
                    lists.setdefault((a, b), []).append(
                        (place, k, n, p.freedom, q.freedom, scale * p.weight * q.weight)
                    )
        product_plan = {}
        for both, own in lists.items():
            products: dict[tuple[int, int], int] = {}
            derivatives: dict[tuple[Freedom, Freedom], int] = {}
            entries = [
                (
                    place,
                    products.setdefault((k, n), len(products)),
                    derivatives.setdefault((f, g), len(derivatives)),
                    weight,
                )
                for place, k, n, f, g, weight in own
            ]
            columns = [np.array(values) for values in zip(*entries, strict=True)]
            first, second = (np.array(values) for values in zip(*products, strict=True))
            product_plan[both] = ProductPlan(
                first, second, tuple(derivatives), (columns[0], columns[1], columns[2], columns[3])
            )
        return product_plan

    def at(self, block: PointBlock, columns: Sequence[int] | None = None) -> np.ndarray:
        """Return signatures (points, 3, columns) at a block of points, of some columns (indices) or all."""
        lookup = self._lookup if columns is None else self._grouped(columns)
        count = len(self.view.residual[block.rows])
        products = np.zeros((3, len(self.columns) if columns is None else len(columns), count))
        for functions, of in lookup.items():
            for freedom, (at, index, weight) in of.items():
                if block.is_zero(functions) or not block.acts(freedom):
                    continue
                weighted = self._values_of(block, functions, index).T * weight[:, None]
                derivative = block.derivatives[freedom]
                for i in range(3):
                    add_rows(products[i], at, weighted * derivative[:, i])
        return products.transpose(2, 0, 1)

    def _values_of(self, block: PointBlock, functions: Functions, index: np.ndarray) -> np.ndarray:
        """Return values (points, index) of some functions that are not zero at a block of points."""
        if functions in self._interpolated and few_of(functions, index):
            interpolation = self._interpolated[functions]
            return np.asarray(block.weights(functions, interpolation) @ interpolation.table[:, index])
        return block.values(functions)[:, index]  # type: ignore[index]

    def combined(self, coefficients: np.ndarray, points: np.ndarray | None = None) -> np.ndarray:
        """Return linear combinations (n, 3, r) of the signatures, of coefficients (columns, r), at some points (ascending) or all."""
        width, runs = coefficients.shape[1], self._runs_of(points)[0]
        combined = np.empty((len(self.view.rows) if points is None else len(points), 3, width))

        for run, rows in enumerate(runs):
            block = self._block(run, runs)
            total = np.zeros((3, len(rows), width))
            for freedom, lookups in self._by_freedom.items():
                if not block.acts(freedom):
                    continue
                sums = np.zeros((len(rows), width))
                for functions, (columns, index, weight) in lookups.items():
                    values = block.values(functions)
                    if values is not None:
                        sums += values[:, index] @ (weight[:, None] * coefficients[columns])
                derivative = block.derivatives[freedom]
                for i in range(3):
                    total[i] += derivative[:, i, None] * sums
            combined[rows if points is None else np.searchsorted(points, rows)] = total.transpose(1, 0, 2)
        return combined

    def _block(self, run: int, runs: Sequence[np.ndarray]) -> PointBlock:
        """Return the block of a run; the values of all functions of the signatures are kept, and no others, if there is room."""
        if runs is not self._runs or not self._cache:
            return PointBlock(self.view, runs[run])
        return PointBlock(self.view, runs[run], (self._kept.setdefault(run, {}), self._lookup))

    def _location(self, part: SignatureTerm) -> tuple[Functions, int]:
        """Return the set and index under which a term's function is evaluated."""
        start = self._start.get(part.functions)
        return (part.functions, part.index) if start is None else (self._merged, start + part.index)

    def _prepare(self) -> None:
        self._planned = None
        few = dict.fromkeys(
            p.functions for column in self.columns for p in column.terms if p.functions.count < LEAST_FUNCTIONS
        )
        starts = np.cumsum([0, *(functions.count for functions in few)]).tolist()
        self._start = dict(zip(few, starts[:-1], strict=True))
        self._merged = Functions(
            len(self.view.rows),
            starts[-1],
            lambda rows: np.concatenate([functions.values(rows) for functions in few], axis=1),
        )
        self._lookup = self._grouped(range(len(self.columns)))
        self._by_freedom: dict[Freedom, dict[Functions, Terms]] = {}
        for functions, of in self._lookup.items():
            for freedom, own in of.items():
                self._by_freedom.setdefault(freedom, {})[functions] = own
        self._small = [
            (functions, freedom)
            for functions, of in self._lookup.items()
            for freedom, own in of.items()
            if len(own[0]) <= FEW_FUNCTIONS
        ]
        small = set(self._small)
        self._large = {
            freedom: large
            for freedom, lookups in self._by_freedom.items()
            if (large := {of: own for of, own in lookups.items() if (of, freedom) not in small})
        }
        size = sum(functions.count for functions in self._lookup) * len(self.view.rows)
        self._cache = size <= LARGEST_CACHE
        # Values that are cached are not interpolated.
        made = {of: None if self._cache or len(self.columns) < FEW_VECTORS else of.interpolation for of in self._lookup}
        self._interpolated = {of: interpolation for of, interpolation in made.items() if interpolation is not None}
        self._runs = self._ordered_runs(np.arange(len(self.view.rows)), self._parts)

    def _runs_of(self, rows: np.ndarray | None) -> tuple[list[np.ndarray], Callable[[int], int], int]:
        """Return runs of all points or of ``rows``, a function from run to part, and the number of parts."""
        if rows is not None:
            return self.ordered_runs(rows), lambda run: 0, 1
        return self._runs, lambda run: int(self._parts[self._runs[run][0]]), int(self._parts.max(initial=0)) + 1

    def ordered_runs(self, rows: np.ndarray) -> list[np.ndarray]:
        """Split some points into runs of one side."""
        return self._ordered_runs(rows, np.zeros(len(self._parts), dtype=int))

    def _ordered_runs(self, rows: np.ndarray, parts: np.ndarray) -> list[np.ndarray]:
        """Split points into runs of one part and one side, points where the same functions are zero together: zeros are skipped."""
        shown = np.sign(np.nan_to_num(self.view.shown[rows])).astype(int) + 1
        group = np.ravel_multi_index((parts[rows], *shown.T), (int(parts.max(initial=0)) + 1, *(3 for _ in shown.T)))
        pattern = group
        for functions in self._lookup:
            if functions.where is not None:
                pattern = 2 * pattern + functions.where[self.view.rows[rows]]
        order = np.argsort(pattern, kind="stable")
        ends = np.flatnonzero(np.diff(group[order])) + 1
        return [own[run] for own in np.split(rows[order], ends) for run in pieces(len(own))]

    def _grouped(self, columns: Sequence[int]) -> Mapping[Functions, Mapping[Freedom, Terms]]:
        """Return, by function set and derivative, the positions in ``columns``, the indices of functions and the weights."""
        lists: dict[Functions, dict[Freedom, list[tuple[int, int, float]]]] = {}
        for place, i in enumerate(columns):
            column = self.columns[i]
            for part in column.terms:
                functions, index = self._location(part)
                own = lists.setdefault(functions, {}).setdefault(part.freedom, [])
                own.append((place, index, part.weight * column.scale))
        return {functions: {freedom: as_arrays(own) for freedom, own in of.items()} for functions, of in lists.items()}


def _dots(block: PointBlock, one: Freedom, other: Freedom) -> np.ndarray:
    """Return the inner products (points,) of two derivatives at each point of a block."""
    return np.asarray(np.einsum("bi,bi->b", block.derivatives[one], block.derivatives[other]))


def signatures_of(view: LinearisedReadings, columns: Sequence[Column]) -> np.ndarray:
    """Return signatures (points, 3, columns) of a few columns at all points of a view."""
    return Signatures(view, columns).at(PointBlock(view, slice(None)))
