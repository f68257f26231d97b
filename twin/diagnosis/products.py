"""What the data say of every column of a pool, before anything is projected out: kept, and mended where only little changes."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import final

import numpy as np

from twin.diagnosis.problem import Problem
from twin.diagnosis.signatures import Column
from twin.diagnosis.sweep import Block, Signatures


@final
class Products:
    """Inner products of columns within groups of them, with a problem's basis and residual, and on demand with each other.

    Nothing is projected out.

    Args:
        problem: whose rows, basis and residual; nothing of it held out.
        columns: of signatures.
        groups: numbers of columns, those of equally wide groups together: (groups, w) each.
        points: the points that count; all if None.
    """

    def __init__(
        self,
        problem: Problem,
        columns: Sequence[Column],
        groups: Sequence[np.ndarray],
        points: np.ndarray | None = None,
    ) -> None:
        self.signatures = Signatures(problem.view, columns)
        self._problem = problem
        self._groups = groups
        self._residual = problem.residual
        self._cross = np.zeros((0, len(columns)))
        self._row = np.full(len(columns), -1)
        self._changed = np.zeros(0, dtype=int)
        self._from: tuple[Products, np.ndarray] | None = None
        self.within = self.signatures.within(groups, points)
        self.by_basis, self.by_residual = self._along_problem(points)

    def less(self, points: np.ndarray) -> Products:
        """The same without some points, which are all that is worked out again.

        Args:
            points: their numbers.
        """
        other = copy(self)
        other._from = self, points
        other._cross, other._row, other._changed = self._cross[:0], np.full_like(self._row, -1), self._changed[:0]
        other.within = [
            whole - gone for whole, gone in zip(self.within, self.signatures.within(self._groups, points), strict=True)
        ]
        by_basis, by_residual = self._along_problem(points)
        other.by_basis, other.by_residual = self.by_basis - by_basis, self.by_residual - by_residual
        return other

    @property
    def columns(self) -> Sequence[Column]:
        """Of signatures."""
        return self.signatures.columns

    def along(self, vectors: np.ndarray, points: np.ndarray) -> np.ndarray:
        """(all, r) inner products with (3·points, r) vectors at some points, in ascending order."""
        right = vectors.reshape(len(points), 3, -1)
        return self.signatures.along(lambda block: right[np.searchsorted(points, np.asarray(block.rows))], points)

    def judge(self, residual: np.ndarray) -> None:
        """Another (3n,) residual."""
        if residual is not self._residual:
            self._residual = residual
            kept = np.array(residual).reshape(-1, 3, 1)
            if self._from is not None:
                kept[self._from[1]] = 0.0
            self.by_residual = self.signatures.along(lambda block: kept[block.rows])[:, 0]

    def cross(self, columns: np.ndarray) -> np.ndarray:
        """(columns, all) inner products, worked out once."""
        fresh = columns[self._row[columns] < 0]
        if len(fresh) or len(self._changed):
            fresh = np.union1d(fresh, self._changed)
            if self._from is None:
                found = self._of(fresh)
            else:
                whole, gone = self._from
                found = whole.cross(fresh) - whole._of(fresh, gone)
            known = self._row >= 0
            self._cross[np.ix_(self._row[known], self._changed)] = found[
                np.ix_(np.searchsorted(fresh, self._changed), known)
            ].T
            self._changed = self._changed[:0]
            self._row[fresh] = len(self._cross) + np.arange(len(fresh))
            self._cross = np.concatenate([self._cross, found])
        return np.asarray(self._cross[self._row[columns]])

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
        """(columns, all) inner products, over some points or all."""
        which = columns.tolist()
        return self.signatures.along(lambda block: self.signatures.at(block, which), points).T

    def _along_problem(self, points: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """(directions, all) inner products with the basis, and (all,) with the residual."""

        def vectors(block: Block) -> np.ndarray:
            residual = self._residual.reshape(-1, 3)[block.rows, :, None]
            return np.concatenate([self._problem.rows(block.rows), residual], axis=2)

        found = self.signatures.along(vectors, points)
        return np.ascontiguousarray(found[:, :-1].T), found[:, -1]
