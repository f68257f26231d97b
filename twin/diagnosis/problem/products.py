"""What the data say of every column of the candidates, before anything is projected out: kept, and mended where only little changes."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import final

import numpy as np

from twin.diagnosis.candidates.signatures import Column
from twin.diagnosis.problem.problem import Problem
from twin.diagnosis.problem.signature_products import PointBlock, Signatures


@final
class Products:
    """Inner products of columns within groups of them, with a problem's basis and residual, and on demand with each other.

    Nothing is projected out.

    Args:
        problem: whose rows, basis and residual; nothing of it held out.
        columns: of signatures.
        groups: numbers of columns, those of equally wide groups together: (groups, w) each.
        points: the points that count; all if None.
        parts: (n,) which part of the data each point is in, from 0 on, where one or another is to be taken away.
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
        self._first = list(columns)
        self._from: tuple[Products, np.ndarray | int] | None = None
        self._within = self.signatures.within(groups, points)
        self._by_basis, self._by_residual = self._along_problem(points)
        # (parts, all) of each column that was asked for.
        self._cross: list[np.ndarray] = []
        self._row = np.full(len(columns), -1)
        self._changed = np.zeros(0, dtype=int)
        self.within = [own.sum(axis=0) for own in self._within]
        self.by_basis, self.by_residual = self._by_basis.sum(axis=0), self._by_residual.sum(axis=0)

    def less(self, points: np.ndarray) -> Products:
        """The same without some points, which are all that is worked out again; nothing is where they are one of the parts.

        Args:
            points: their numbers, in ascending order.
        """
        other = copy(self)
        part = None if self._parts is None else int(self._parts[points[0]])
        # What was refined since is not known by part.
        if part is not None and np.array_equal(points, np.flatnonzero(self._parts == part)) and self._as_it_was():
            other._from = self, part
            within, by_basis, by_residual = (
                [own[part] for own in self._within],
                self._by_basis[part],
                self._by_residual[part],
            )
        else:
            other._from = self, points
            within = [own[0] for own in self.signatures.within(self._groups, points)]
            by_basis, by_residual = (own[0] for own in self._along_problem(points))
        other._cross, other._changed = [], self._changed[:0]
        other._row = np.full_like(self._row, -1)
        other.within = [whole - gone for whole, gone in zip(self.within, within, strict=True)]
        other.by_basis, other.by_residual = self.by_basis - by_basis, self.by_residual - by_residual
        return other

    def _as_it_was(self) -> bool:
        return all(one is other for one, other in zip(self.columns, self._first, strict=True))

    @property
    def columns(self) -> Sequence[Column]:
        """Of signatures."""
        return self.signatures.columns

    def along(self, vectors: np.ndarray, points: np.ndarray) -> np.ndarray:
        """(all, r) inner products with (3·points, r) vectors at some points, in ascending order."""
        right = vectors.reshape(len(points), 3, -1)
        return self.signatures.along(lambda block: right[np.searchsorted(points, np.asarray(block.rows))], points)[0]

    def set_residual(self, residual: np.ndarray) -> None:
        """Another (3n,) residual."""
        if residual is not self._residual:
            self._residual = residual
            kept = np.array(residual).reshape(-1, 3, 1)
            if self._from is not None:
                gone = self._from[1]
                kept[self._parts == gone if isinstance(gone, int) else gone] = 0.0
            self._by_residual = self.signatures.along(lambda block: kept[block.rows])[:, :, 0]
            self.by_residual = self._by_residual.sum(axis=0)

    def cross(self, columns: np.ndarray) -> np.ndarray:
        """(columns, all) inner products, worked out once."""
        return np.asarray(self._by_part(columns).sum(axis=0))

    def _by_part(self, columns: np.ndarray) -> np.ndarray:
        """(parts, columns, all); of what is less than the whole one part only."""
        fresh = columns[self._row[columns] < 0]
        if len(fresh) or len(self._changed):
            fresh = np.union1d(fresh, self._changed)
            if self._from is None:
                found = self._of(fresh)
            else:
                whole, gone = self._from
                if isinstance(gone, int):
                    every = whole._by_part(fresh)
                    found = (every.sum(axis=0) - every[gone])[None]
                else:
                    found = whole.cross(fresh)[None] - whole._of(fresh, gone)
            known = np.flatnonzero(self._row >= 0)
            if len(self._changed):
                own = found[:, np.searchsorted(fresh, self._changed)][:, :, known]
                for k, row in enumerate(self._row[known].tolist()):
                    self._cross[row][:, self._changed] = own[:, :, k]
            self._changed = self._changed[:0]
            self._row[fresh] = len(self._cross) + np.arange(len(fresh))
            self._cross += [np.ascontiguousarray(found[:, k]) for k in range(len(fresh))]
        rows = [self._cross[row] for row in self._row[columns].tolist()]
        return np.stack(rows, axis=1) if rows else np.zeros((len(self._by_residual), 0, len(self._row)))

    @property
    def at_hand(self) -> np.ndarray:
        """(all,) columns whose inner products with all others cost no pass over all points."""
        return np.asarray((self._row if self._from is None else self._from[0]._row) >= 0)

    def replace(self, at: np.ndarray, columns: Sequence[Column]) -> None:
        """Other columns in the place of those of one group.

        Args:
            at: their numbers, in order.
            columns: as many.
        """
        self.signatures.replace(at.tolist(), columns)
        new = self._problem.products(columns)
        self.by_basis[:, at], self.by_residual[at] = new.basis, new.with_residual
        kind, k = next(
            (kind, k)
            for kind, of in enumerate(self._groups)
            if of.shape[1] == len(at)
            for k in np.flatnonzero(np.all(of == at, axis=1))
        )
        self.within[kind][k] = new.raw
        # What they are with others waits for the next pass.
        self._row[at] = -1
        self._changed = np.union1d(self._changed, at)

    def _of(self, columns: np.ndarray, points: np.ndarray | None = None) -> np.ndarray:
        """(parts, columns, all) inner products, over all points or some, these as one part."""
        which = columns.tolist()
        return self.signatures.along(lambda block: self.signatures.at(block, which), points).transpose(0, 2, 1)

    def _along_problem(self, points: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """(parts, directions, all) inner products with the basis, and (parts, all) with the residual."""

        def vectors(block: PointBlock) -> np.ndarray:
            residual = self._residual.reshape(-1, 3)[block.rows, :, None]
            return np.concatenate([self._problem.rows(block.rows), residual], axis=2)

        found = self.signatures.along(vectors, points)
        return np.ascontiguousarray(found[:, :, :-1].transpose(0, 2, 1)), found[:, :, -1].copy()
