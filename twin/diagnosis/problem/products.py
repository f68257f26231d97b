"""Inner products of the candidates' columns before projection: cached, and updated where only a few columns or points change."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from typing import final

import numpy as np

from twin.diagnosis.candidates.signatures import Column
from twin.diagnosis.problem.point_block import PointBlock
from twin.diagnosis.problem.problem import Problem
from twin.diagnosis.problem.signature_products import Signatures
from twin.diagnosis.problem.signature_terms import side_by_side


@final
class Products:
    """Inner products of columns within groups, with a problem's basis and residual, and on demand with each other.

    Without projection.

    Args:
        problem: the problem that gives rows, basis and residual; none of its rows held out.
        columns: columns of signatures.
        groups: indices of the columns of each group, one array (groups, w) for each width w.
        points: the points to sum over; all if None.
        parts: (n,) number of the part each point belongs to, from 0, where parts are to be held out.
    """

    def __init__(
        self,
        problem: Problem,
        columns: Sequence[Column],
        groups: Sequence[np.ndarray],
        points: np.ndarray | None = None,
        parts: np.ndarray | None = None,
    ) -> None:
        self.signatures = Signatures(problem.view, columns, parts)
        self._problem = problem
        self._groups = groups
        self._residual = problem.residual
        self._parts = parts
        self._original_columns = list(columns)
        # The products these are derived from, the part or the points that these lack, and the factor on them.
        self._parent: tuple[Products, np.ndarray | int | None, float] | None = None
        self._beside: dict[Column, np.ndarray] = {}
        self._among: dict[tuple[Column, ...], tuple[np.ndarray, np.ndarray]] = {}
        self._within = self.signatures.within(groups, points)
        self._by_raw, self._by_residual = self._with_problem(points)
        # (parts, all) for each requested column.
        self._cross: list[np.ndarray] = []
        self._row = np.full(len(columns), -1)
        self._changed = np.zeros(0, dtype=int)
        self.within = [own.sum(axis=0) for own in self._within]
        self.by_raw, self.by_residual = self._by_raw.sum(axis=0), self._by_residual.sum(axis=0)

    def without(self, points: np.ndarray) -> Products:
        """Return the inner products without some points.

        Only these points are evaluated, and none where they are exactly one of the parts.

        Args:
            points: their numbers, in ascending order.
        """
        other = copy(self)
        part = None if self._parts is None else int(self._parts[points[0]])
        # Sums by part do not hold for columns that were refined since.
        if part is not None and np.array_equal(points, np.flatnonzero(self._parts == part)) and self._unrefined():
            other._parent = self, part, 1.0
            within, by_raw, by_residual = (
                [own[part] for own in self._within],
                self._by_raw[part],
                self._by_residual[part],
            )
        else:
            other._parent = self, points, 1.0
            within = [own[0] for own in self.signatures.within(self._groups, points)]
            by_raw, by_residual = (own[0] for own in self._with_problem(points))
        other._forget()
        other.within = [whole - gone for whole, gone in zip(self.within, within, strict=True)]
        other.by_raw, other.by_residual = self.by_raw - by_raw, self.by_residual - by_residual
        return other

    def for_problem(self, problem: Problem) -> Products:
        """Return the inner products for the same readings with random effects and a factor on the weights; no pass over the points.

        Args:
            problem: `Problem.with_random_effects` of the problem of these products.
        """
        other, nuisances = copy(self), problem.nuisances
        random = nuisances.signatures.columns[len(nuisances.base.signatures.columns) :]
        whitened = nuisances.scale**2
        other._problem, other._parts, other._parent = problem, None, (self, None, whitened)
        other._forget()
        other.signatures = Signatures(problem.view, self.columns)
        other.within = [own * whitened for own in self.within]
        by_setup, by_columns = np.split(self.by_raw, [nuisances.setup_count])
        other.by_raw = np.concatenate(
            [nuisances.scale * by_setup, whitened * by_columns, whitened * self.with_columns(random)]
        )
        other._residual = self._residual * nuisances.scale
        other.by_residual = self.by_residual * whitened
        return other

    def _forget(self) -> None:
        """Start without cached inner products."""
        self._cross, self._changed, self._beside, self._among = [], self._changed[:0], {}, {}
        self._row = np.full_like(self._row, -1)

    def _unrefined(self) -> bool:
        return all(one is other for one, other in zip(self.columns, self._original_columns, strict=True))

    def on_basis(self, root: np.ndarray) -> np.ndarray:
        """Return the inner products (k, all) with vectors of coordinates (directions, k) in the nuisance basis."""
        return self._problem.nuisances.from_raw(self.by_raw, root)

    @property
    def columns(self) -> Sequence[Column]:
        """Columns of signatures, refined ones included."""
        return self.signatures.columns

    def with_vectors(self, vectors: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return inner products (all, r) with (3·points, r) vectors at some points, in ascending order."""
        right = vectors.reshape(len(points), 3, -1)
        if len(points) == len(self._problem.view.rows):
            return self.along(lambda block: right[block.rows], None)
        return self.along(lambda block: right[np.searchsorted(points, np.asarray(block.rows))], points)

    def along(self, vectors: Callable[[PointBlock], np.ndarray], points: np.ndarray | None) -> np.ndarray:
        """Return inner products (all, r) with vectors made block by block, over some points or all."""
        return np.asarray(self.signatures.along(vectors, points, by_part=False)[0])

    def set_residual(self, residual: np.ndarray) -> None:
        """Replace the residual (3n,)."""
        if residual is not self._residual and not np.array_equal(residual, self._residual):
            kept = self._kept(residual)
            self._by_residual = self.signatures.along(lambda block: kept[block.rows])[:, :, 0]
            self.by_residual = self._by_residual.sum(axis=0)
        self._residual = residual

    def cross(self, columns: np.ndarray) -> np.ndarray:
        """Return the inner products (columns, all); cached."""
        return _stacked([own.sum(axis=0) for own in self._by_part(columns)], len(self._row))

    def _by_part(self, columns: np.ndarray) -> list[np.ndarray]:
        """Return inner products (parts, all) of each of some columns; a single part where points are held out."""
        fresh = columns[self._row[columns] < 0]
        if len(fresh) or len(self._changed):
            fresh = np.union1d(fresh, self._changed)
            if self._parent is None:
                found = self._over_points(fresh)
            else:
                whole, gone, factor = self._parent
                if isinstance(gone, int):
                    found = _stacked([own.sum(axis=0) - own[gone] for own in whole._by_part(fresh)], len(self._row))[
                        None
                    ]
                else:
                    found = factor * whole.cross(fresh)[None]
                    if gone is not None:
                        found -= whole._over_points(fresh, gone)
            known = np.flatnonzero(self._row >= 0)
            if len(self._changed):
                own = found[:, np.searchsorted(fresh, self._changed)][:, :, known]
                for k, row in enumerate(self._row[known].tolist()):
                    self._cross[row][:, self._changed] = own[:, :, k]
            self._changed = self._changed[:0]
            self._row[fresh] = len(self._cross) + np.arange(len(fresh))
            self._cross += [np.ascontiguousarray(found[:, k]) for k in range(len(fresh))]
        return [self._cross[row] for row in self._row[columns].tolist()]

    def with_columns(self, columns: Sequence[Column]) -> np.ndarray:
        """Return the inner products (columns, all) of any columns with all; cached."""
        return _stacked([own.sum(axis=0) for own in self._parts_with_columns(columns)], len(self._row))

    def _parts_with_columns(self, columns: Sequence[Column]) -> list[np.ndarray]:
        """Return the inner products (parts, all) of each of some columns; a single part where points are held out."""
        if self._parent is not None:
            whole, gone, factor = self._parent
            every = whole._parts_with_columns(columns)
            if isinstance(gone, int):
                return [(own.sum(axis=0) - own[gone])[None] for own in every]
            left = [factor * own.sum(axis=0)[None] for own in every]
            if gone is None or not columns:
                return left
            signatures = Signatures(self._problem.view, columns)
            without = self.signatures.along(signatures.at, gone)
            return [own - without[:, :, k] for k, own in enumerate(left)]
        fresh = [column for column in columns if column not in self._beside]
        if fresh:
            found = self.signatures.along(Signatures(self._problem.view, fresh).at)
            self._beside |= {column: np.array(found[:, :, k]) for k, column in enumerate(fresh)}
        return [self._beside[column] for column in columns]

    def among(self, columns: Sequence[Column]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the inner products (k, k) of any k columns, (raw, k) with the nuisance derivatives and (k,) with the residual.

        Those that depend on the columns alone are cached.
        """
        signatures, residual = Signatures(self._problem.view, columns), self._kept(self._residual)
        gram, by_nuisance = (own.sum(axis=0) for own in self._parts_among(tuple(columns)))
        return gram, by_nuisance, signatures.along(lambda block: residual[block.rows])[0, :, 0]

    def _parts_among(self, columns: tuple[Column, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Return the inner products by part (parts, k, k) and (parts, raw, k); a single part where points are held out."""
        if self._parent is not None and self._parent[1] is not None:
            whole, gone, _ = self._parent
            every = whole._parts_among(columns)
            if isinstance(gone, int):
                lost = [own[gone] for own in every]
            else:
                lost = [own[0] for own in whole._evaluated_among(columns, gone)]
            return every[0].sum(axis=0)[None] - lost[0], every[1].sum(axis=0)[None] - lost[1]
        if columns not in self._among:
            self._among[columns] = self._evaluated_among(columns, None)
        return self._among[columns]

    def _evaluated_among(self, columns: Sequence[Column], points: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Return what `_parts_among` does, over all points by part or over some as one part."""
        own = Signatures(self._problem.view, columns, self._parts)

        def vectors(block: PointBlock) -> np.ndarray:
            return side_by_side(own.at(block), self._problem.nuisances.raw(block))

        gram, by_nuisance = np.split(own.along(vectors, points), [len(columns)], axis=2)
        return gram, by_nuisance.transpose(0, 2, 1)

    def _kept(self, residual: np.ndarray) -> np.ndarray:
        """Return a residual as (n, 3, 1), zero at the points that are left out."""
        kept = np.array(residual).reshape(-1, 3, 1)
        if self._parent is not None and self._parent[1] is not None:
            gone = self._parent[1]
            kept[self._parts == gone if isinstance(gone, int) else gone] = 0.0
        return kept

    @property
    def cached(self) -> np.ndarray:
        """(all,) whether a column's inner products with all others need no further pass over all points."""
        return np.asarray((self._row if self._parent is None else self._parent[0]._row) >= 0)

    def replace(self, at: np.ndarray, columns: Sequence[Column]) -> None:
        """Replace the columns of one group.

        Args:
            at: indices of the group's columns, in order.
            columns: the new columns, as many.
        """
        self.signatures.replace(at.tolist(), columns)
        new = self._problem.products(columns)
        self.by_raw[:, at], self.by_residual[at] = new.by_nuisance, new.with_residual
        kind, k = next(
            (kind, k)
            for kind, of in enumerate(self._groups)
            if of.shape[1] == len(at)
            for k in np.flatnonzero(np.all(of == at, axis=1))
        )
        self.within[kind][k] = new.raw
        # Products with the other columns are updated in the next pass.
        self._beside = {}
        self._row[at] = -1
        self._changed = np.union1d(self._changed, at)

    def _over_points(self, columns: np.ndarray, points: np.ndarray | None = None) -> np.ndarray:
        """Return inner products (parts, columns, all) over all points by part, or over some points as one part."""
        which = columns.tolist()
        return self.signatures.along(lambda block: self.signatures.at(block, which), points).transpose(0, 2, 1)

    def _with_problem(self, points: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Return inner products (parts, raw, all) with the nuisance derivatives (`Nuisance.raw`) and (parts, all) with the residual."""

        def vectors(block: PointBlock) -> np.ndarray:
            residual = self._residual.reshape(-1, 3)[block.rows, :, None]
            return side_by_side(self._problem.nuisances.raw(block), residual)

        found = self.signatures.along(vectors, points)
        return found[:, :, :-1].transpose(0, 2, 1), found[:, :, -1].copy()


def _stacked(rows: Sequence[np.ndarray], width: int) -> np.ndarray:
    """Return rows (width,) as an array (rows, width), also if there are none."""
    return np.stack(rows) if rows else np.zeros((0, width))
