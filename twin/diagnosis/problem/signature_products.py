"""Signatures of many columns, a run of points at a time: never are all of them there at all points."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.threads import side_by_side
from twin.diagnosis.candidates.signatures import Column, Field, ReadingDerivatives, SignatureTerm
from twin.identification.network import View
from twin.numerics.functions import Functions, Rows, pieces

FEW: Final = 64
"""Vectors, or products of two functions, that are worked on at a time: what the processor has at hand is not fetched again."""
MANY: Final = 16
"""Sets of fewer functions are put together to one."""
KEPT: Final = 2**25
"""Function values (256 MB) up to which they are kept from one pass to the next."""


@final
@dataclass(frozen=True)
class _Paired:
    """Inner products that two sets of functions have a part in.

    Attributes:
        first: (p,) of the products of two functions, which of the first set.
        second: (p,) which of the second.
        fields: pairs of derivatives that they are multiplied by.
        entries: which inner product, which product of functions, which pair of derivatives, weight; (e,) each.
    """

    first: np.ndarray
    second: np.ndarray
    fields: tuple[tuple[Field, Field], ...]
    entries: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@final
class PointBlock:
    """Some points: their derivatives, and functions of their state, each worked out once.

    Args:
        view: of some or all points of the data.
        rows: which of the view.
    """

    def __init__(self, view: View, rows: Rows) -> None:
        self.rows = rows
        self._numbers = view.rows[rows]
        self.fields = ReadingDerivatives(view, rows)
        self._values: dict[Functions, np.ndarray | None] = {}

    def values(self, functions: Functions) -> np.ndarray | None:
        """(points, count), or None where they are all zero."""
        if functions not in self._values:
            nowhere = functions.where is not None and not functions.where[self._numbers].any()
            self._values[functions] = None if nowhere else functions.values(self._numbers)
        return self._values[functions]


@final
class Signatures:
    """Signatures of some columns in plausible sizes, (columns, points, 3) if they were ever all there.

    Args:
        view: the readings.
        columns: of them.
        parts: (n,) which part of the data a point is in, from 0 on; all in one if None.
    """

    def __init__(self, view: View, columns: Sequence[Column], parts: np.ndarray | None = None) -> None:
        self.view = view
        self._parts = np.zeros(len(view.rows), dtype=int) if parts is None else parts
        self.columns = list(columns)
        self._kept: dict[int, PointBlock] = {}
        self._asked: tuple[Sequence[np.ndarray], _Codes, Mapping[tuple[Functions, Functions], _Paired]] | None = None
        self._arrange()

    def replace(self, at: Sequence[int], columns: Sequence[Column]) -> None:
        """Other columns in the place of some."""
        for i, column in zip(at, columns, strict=True):
            self.columns[i] = column
        self._arrange()

    def along(self, vectors: Callable[[PointBlock], np.ndarray], rows: np.ndarray | None = None) -> np.ndarray:
        """(parts, columns, r) inner products with (points, 3, r) vectors.

        Args:
            vectors: some of the points → (points, 3, r).
            rows: the points that count, taken as one part; all of them, by part, if None.
        """

        def share(own: Sequence[int]) -> np.ndarray:
            total: dict[tuple[int, Functions, Field, int], np.ndarray] = {}
            for run in own:
                part = part_of(run)
                block = self._block(run, runs)
                right = vectors(block)
                for few in pieces(right.shape[2], FEW):
                    projected: dict[str, np.ndarray] = {}
                    for functions, wanted in self._wanted.items():
                        values = block.values(functions)
                        if values is None:
                            continue
                        for field, (_, index, _) in wanted.items():
                            name, direction = field
                            if name not in projected:
                                projected[name] = block.fields.of(name).transpose(0, 2, 1) @ right[:, :, few]
                            # Of a set of all kinds of functions each field has but a few.
                            some = values if functions is not self._various else values[:, index]
                            found = projected[name][:, direction].T @ some
                            key = part, functions, field, few.start
                            if key in total:
                                total[key] += found
                            else:
                                total[key] = found
            found = np.zeros((count, len(self.columns), right.shape[2]))
            while total:
                (part, functions, field, start), values = total.popitem()
                columns, index, weight = self._wanted[functions][field]
                own_values = values.T if functions is self._various else values.T[index]
                np.add.at(found[part, :, start : start + len(values)], columns, weight[:, None] * own_values)
            return found

        runs, part_of, count = self._runs_of(rows)
        return np.asarray(sum(side_by_side(range(len(runs)), share)))

    def within(self, groups: Sequence[np.ndarray], rows: np.ndarray | None = None) -> list[np.ndarray]:
        """Inner products within groups of columns: (parts, groups, w, w) of each (groups, w).

        Two products of a derivative and a function make the product of two functions times that of two derivatives; what has the same
        functions has these once.

        Args:
            groups: numbers of columns, those of equally wide groups together.
            rows: as of `along`.
        """
        if self._asked is None or self._asked[0] is not groups:
            codes = _codes(groups, len(self.columns))
            self._asked = groups, codes, self._paired(codes[0][codes[1]])
        _, (pairs, lower, places, twins), needed = self._asked

        def share(own: Sequence[int]) -> np.ndarray:
            total: dict[tuple[int, Functions, Functions], np.ndarray] = {}
            for run in own:
                part = part_of(run)
                block = self._block(run, runs)
                turned: dict[Functions, np.ndarray] = {}
                dots: dict[tuple[Field, Field], np.ndarray] = {}
                for (a, b), wanted in needed.items():
                    of_a, of_b = block.values(a), block.values(b)
                    if of_a is None or of_b is None:
                        continue
                    for functions, of in ((a, of_a), (b, of_b)):
                        if functions not in turned:
                            turned[functions] = np.ascontiguousarray(of.T)
                    for one, other in wanted.fields:
                        if (one, other) not in dots:
                            dots[one, other] = np.einsum("bi,bi->b", block.fields[one], block.fields[other])
                    weights = np.stack([dots[both] for both in wanted.fields], axis=1)
                    if (part, a, b) not in total:
                        total[part, a, b] = np.zeros((len(wanted.first), len(wanted.fields)))
                    for few in pieces(len(wanted.first), FEW):
                        products = turned[a][wanted.first[few]] * turned[b][wanted.second[few]]
                        total[part, a, b][few] += products @ weights
            found = np.zeros((count, len(pairs)))
            own_of = np.flatnonzero(lower)
            for (part, a, b), values in total.items():
                place, product, field, weight = needed[a, b].entries
                np.add.at(found[part], own_of[place], weight * values[product, field])
            return found

        runs, part_of, count = self._runs_of(rows)
        values = np.asarray(sum(side_by_side(range(len(runs)), share)))
        # The other way round they are the same.
        values[:, ~lower] = values[:, twins]
        return [values[:, own] for own in places]

    def _paired(self, pairs: np.ndarray) -> Mapping[tuple[Functions, Functions], _Paired]:
        """What the inner products of pairs of columns (codes: first · columns + second) are sums of."""
        lists: dict[tuple[Functions, Functions], list[tuple[int, int, int, Field, Field, float]]] = {}
        for place, code in enumerate(pairs.tolist()):
            one, other = (self.columns[i] for i in divmod(code, len(self.columns)))
            scale = one.scale * other.scale
            for p in one.parts:
                for q in other.parts:
                    (a, k), (b, n) = self._stand(p), self._stand(q)
                    lists.setdefault((a, b), []).append((place, k, n, p.field, q.field, scale * p.weight * q.weight))
        found = {}
        for both, own in lists.items():
            products: dict[tuple[int, int], int] = {}
            fields: dict[tuple[Field, Field], int] = {}
            entries = [
                (place, products.setdefault((k, n), len(products)), fields.setdefault((f, g), len(fields)), weight)
                for place, k, n, f, g, weight in own
            ]
            columns = [np.array(values) for values in zip(*entries, strict=True)]
            first, second = (np.array(values) for values in zip(*products, strict=True))
            found[both] = _Paired(first, second, tuple(fields), (columns[0], columns[1], columns[2], columns[3]))
        return found

    def at(self, block: PointBlock, columns: Sequence[int] | None = None) -> np.ndarray:
        """(points, 3, columns) signatures at some points, of some columns or all."""
        wanted = self._wanted if columns is None else self._arranged(columns)
        count = len(self.view.residual[block.rows])
        found = np.zeros((len(self.columns) if columns is None else len(columns), count, 3))
        for functions, of in wanted.items():
            values = block.values(functions)
            if values is None:
                continue
            for field, (at, index, weight) in of.items():
                part = (values[:, index] * weight).T[:, :, None] * block.fields[field]
                if len(set(at.tolist())) == len(at):
                    found[at] += part
                else:
                    # A column may be several functions of one set.
                    np.add.at(found, at, part)
        return found.transpose(1, 2, 0)

    def _block(self, run: int, runs: Sequence[np.ndarray]) -> PointBlock:
        """One of some runs; kept from one pass to the next if it is one of all points and they are few."""
        if runs is not self._runs or not self._keep:
            return PointBlock(self.view, runs[run])
        if run not in self._kept:
            self._kept[run] = PointBlock(self.view, runs[run])
        return self._kept[run]

    def _stand(self, part: SignatureTerm) -> tuple[Functions, int]:
        """Where a part's function is looked up."""
        start = self._start.get(part.functions)
        return (part.functions, part.index) if start is None else (self._various, start + part.index)

    def _arrange(self) -> None:
        self._asked = None
        few = dict.fromkeys(p.functions for column in self.columns for p in column.parts if p.functions.count < MANY)
        starts = np.cumsum([0, *(functions.count for functions in few)]).tolist()
        self._start = dict(zip(few, starts[:-1], strict=True))
        self._various = Functions(
            len(self.view.rows),
            starts[-1],
            lambda rows: np.concatenate([functions.values(rows) for functions in few], axis=1),
        )
        self._wanted = self._arranged(range(len(self.columns)))
        size = sum(functions.count for functions in self._wanted) * len(self.view.rows)
        self._keep = size <= KEPT
        self._runs = self._run_together(np.arange(len(self.view.rows)), self._parts)

    def _runs_of(self, rows: np.ndarray | None) -> tuple[list[np.ndarray], Callable[[int], int], int]:
        """Runs of all points or some, which part each is in, and how many parts there are."""
        if rows is not None:
            return self._run_together(rows, np.zeros(len(self._parts), dtype=int)), lambda run: 0, 1
        return self._runs, lambda run: int(self._parts[self._runs[run][0]]), int(self._parts.max(initial=0)) + 1

    def _run_together(self, rows: np.ndarray, parts: np.ndarray) -> list[np.ndarray]:
        """Points in runs of one part each; those at which the same functions are zero come together: these are passed over there."""
        alike = parts[rows]
        for functions in self._wanted:
            if functions.where is not None:
                alike = 2 * alike + functions.where[self.view.rows[rows]]
        order = np.argsort(alike, kind="stable")
        ends = np.flatnonzero(np.diff(parts[rows][order])) + 1
        return [own[run] for own in np.split(rows[order], ends) for run in pieces(len(own))]

    def _arranged(
        self, columns: Sequence[int]
    ) -> Mapping[Functions, Mapping[Field, tuple[np.ndarray, np.ndarray, np.ndarray]]]:
        """By functions and field: places of columns among those asked for, numbers of functions, and weights."""
        lists: dict[Functions, dict[Field, list[tuple[int, int, float]]]] = {}
        for place, i in enumerate(columns):
            column = self.columns[i]
            for part in column.parts:
                functions, index = self._stand(part)
                own = lists.setdefault(functions, {}).setdefault(part.field, [])
                own.append((place, index, part.weight * column.scale))
        return {functions: {field: _three(own) for field, own in of.items()} for functions, of in lists.items()}


def _three(entries: Sequence[tuple[int, int, float]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    first, second, third = zip(*entries, strict=True)
    return np.array(first), np.array(second), np.array(third)


_Codes = tuple[np.ndarray, np.ndarray, list[np.ndarray], np.ndarray]


def _codes(groups: Sequence[np.ndarray], count: int) -> _Codes:
    """Pairs of columns within groups, each once.

    Args:
        groups: (groups, w) numbers of columns each.
        count: columns.

    Returns:
        The pairs (first · count + second), whether the first is not after the second, of each array of groups the places of its
        (groups, w, w) pairs among them, and for those the other way round the place of the pair they are the same as.
    """
    codes = [columns[:, :, None] * count + columns[:, None, :] for columns in groups]
    pairs, places = np.unique(np.concatenate([np.zeros(0, dtype=int), *map(np.ravel, codes)]), return_inverse=True)
    lower = pairs // count <= pairs % count
    twins = np.searchsorted(pairs, pairs[~lower] % count * count + pairs[~lower] // count)
    ends = np.cumsum([code.size for code in codes])[:-1]
    own = [place.reshape(code.shape) for place, code in zip(np.split(places, ends), codes, strict=True)]
    return pairs, lower, own, twins


def signatures_of(view: View, columns: Sequence[Column]) -> np.ndarray:
    """(points, 3, columns) signatures at all points of a view, of few columns."""
    return Signatures(view, columns).at(PointBlock(view, slice(None)))
