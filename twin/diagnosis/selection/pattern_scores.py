"""Scores of unnamed patterns: inner products of their functions with the residual and each other, set-up and causes projected out.

The functions of a pattern are products of the functions of its columns. Their inner products with the residual, of all patterns of a
side at once, are those of the columns' functions with each other, weighted by the residual.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
import scipy

from twin._common.units import UM
from twin.diagnosis.candidates.signatures import Column, ReadingDerivatives
from twin.diagnosis.problem.forms import Form
from twin.diagnosis.problem.point_block import PointBlock
from twin.diagnosis.problem.problem import Problem
from twin.diagnosis.problem.signature_products import Signatures
from twin.diagnosis.problem.signature_terms import side_by_side
from twin.diagnosis.selection.patterns import ChannelFunctions, Pattern
from twin.numerics.functions import Rows, pieces

SAMPLED: Final = 2048
"""Readings of a side from which the distribution of its scores for noise alone is estimated, where there are more: enough to find the
most significant tests. The scores themselves are those of all readings.
"""
SEED: Final = 4712
SEEN: Final = 1e-10
"""Share of the largest eigenvalue below which a direction counts as zero."""
PLAUSIBLE: Final = 100.0
"""Noncentrality along a direction for which the test is most powerful: the score is taken at that variance, not at zero."""
TOGETHER: Final = 512
"""Readings at which the functions of all patterns of a side are evaluated at once."""


def _orthonormal(columns: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of projected columns.

    Args:
        columns: (3n, k) columns.
        own: the same, projected; any rows held out are zero.
    """
    gram = columns.T @ own
    values, vectors = np.linalg.eigh((gram + gram.T) / 2.0)
    seen = values > SEEN * values.max(initial=0.0)
    return np.asarray(own @ (vectors[:, seen] / np.sqrt(values[seen])))


@final
@dataclass(frozen=True)
class _Side:
    """Inner products of all patterns of one side and frame with a total of m functions.

    Attributes:
        own: functions of each pattern among all.
        slope: (3, m) inner products with the residual along each direction.
        lost: (3, m, k) inner products with an orthonormal basis of nuisance and causes, over the sample.
        grams: of each pattern the Gram matrices (3, own, own) over the sample, or one (1, own, own) if they are equal.
        share: share of the side's readings in the sample.
    """

    own: dict[Pattern, slice]
    slope: np.ndarray
    lost: np.ndarray
    grams: dict[Pattern, np.ndarray]
    share: float


@final
class PatternScores:
    """Scores of patterns with set-up and causes projected out.

    Args:
        problem: the data.
        forms: causes that are projected out.
        tried: the patterns.
    """

    def __init__(self, problem: Problem, forms: Sequence[Form], tried: Sequence[Pattern]) -> None:
        n = len(problem.view.rows)
        self._problem, self._view = problem, problem.view
        self._kept = np.ones(n, dtype=bool)
        self._kept[problem.held_out] = False
        columns = problem.signature([column for form in forms for column in form.variant.columns])
        self._causes = _orthonormal(problem.zero_held_out(columns), problem.project(columns))
        # With the calibration's uncertainty the projection is not idempotent: the causes are fitted to the residual itself.
        left = problem.projected - self._causes @ (self._causes.T @ problem.residual)
        self._left = left.reshape(n, 3)
        self._nuisance = problem.nuisances
        self._by_side: dict[str, list[Pattern]] = {}
        for pattern in tried:
            self._by_side.setdefault(pattern.derivative, []).append(pattern)
        self._latest: tuple[str, _Side] | None = None

    def of(self, pattern: Pattern) -> tuple[np.ndarray, np.ndarray]:
        """Return (3, m) φᵀMr and (3, m, m) φᵀMφ along each direction; only the latest side is kept."""
        if self._latest is None or self._latest[0] != pattern.derivative:
            self._latest = None
            self._latest = pattern.derivative, self._side(self._by_side[pattern.derivative])
        side = self._latest[1]
        own = side.own[pattern]
        lost = side.lost[:, own]
        return side.slope[:, own], (side.grams[pattern] - lost @ lost.transpose(0, 2, 1)) / side.share

    def _side(self, alike: Sequence[Pattern]) -> _Side:
        """Return the inner products of all patterns of one side and frame."""
        functions = ChannelFunctions(alike)
        own = rows = np.flatnonzero(alike[0].own & self._kept)
        if len(own) > SAMPLED:
            rows = np.sort(np.random.default_rng(SEED).choice(own, SAMPLED, replace=False))
        slope = np.zeros((3, functions.count))
        for some in pieces(len(own)):
            along = np.einsum("nki,nk->in", self._fields(alike[0], own[some]), self._left[own[some]])
            slope += functions.with_vectors(own[some], along)
        fields = self._fields(alike[0], rows)
        raw = self._nuisance.raw(PointBlock(self._view, rows))
        causes = self._causes.reshape(len(self._kept), 3, -1)[rows]
        whole = np.concatenate([raw, causes], axis=2)
        acting, by_raw, grams = self._sampled(functions, alike, rows, fields)
        beside = _along_each(fields, whole[:, :, self._nuisance.base.raw_count :])
        by_beside = np.zeros((3, functions.count, beside.shape[2]))
        for some in pieces(len(rows) if beside.size else 0, TOGETHER):
            by_beside += functions.at(rows[some]).T @ beside[:, some]
        change, count = self._change(whole, len(own)), self._nuisance.base.raw_count
        lost = by_raw @ (self._raw_scale[acting, None] * change[acting]) + by_beside @ change[count:]
        factor = self._nuisance.scale**2
        scaled = {pattern: gram * factor for pattern, gram in grams.items()}
        return _Side(functions.own, slope, lost, scaled, len(rows) / max(len(own), 1))

    def _sampled(
        self, functions: ChannelFunctions, alike: Sequence[Pattern], rows: np.ndarray, fields: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, dict[Pattern, np.ndarray]]:
        """Return over the sample the inner products with the nuisance derivatives of the base, and the Gram matrices.

        The numbers of the derivatives that are not zero on this side, the (3, m, acting) inner products with these, and (3, own, own).

        They are the same in every test of these patterns on these readings and are kept.
        """
        base = self._nuisance.base
        key: Hashable = ("sample", tuple(alike), rows.tobytes())
        if key not in base.known:
            fields = fields / self._nuisance.scale
            weight = np.einsum("nki,nki->ni", fields, fields)
            equal = np.ptp(weight) <= 1e-9 * weight.max()
            along = _along_each(fields, base.raw(PointBlock(base.signatures.view, rows)))
            acting = np.flatnonzero(along.any(axis=(0, 1)))
            along = np.ascontiguousarray(along[:, :, acting])
            by_raw = np.zeros((3, functions.count, len(acting)))
            directions = 1 if equal else 3
            grams = {pattern: np.zeros((directions, len(pattern.order), len(pattern.order))) for pattern in alike}
            for some in pieces(len(rows), TOGETHER):
                made = functions.at(rows[some])
                by_raw += made.T @ along[:, some]
                for pattern, own in functions.own.items():
                    for i in range(directions):
                        grams[pattern][i] += made[:, own].T @ (made[:, own] * weight[some, i, None])
            base.known[key] = acting, by_raw, grams
        return base.known[key]

    def distributions(self, tests: Sequence[tuple[Pattern, int, tuple[int, ...]]]) -> list[tuple[np.ndarray, float]]:
        """Return of each test (pattern, level, directions) the weights of χ² whose sum its score is for noise alone, and the score."""
        every = list(dict.fromkeys(c for pattern, level, where in tests for c in pattern.columns(level, where)))
        if not every:
            return []
        at = {column: i for i, column in enumerate(every)}
        rows = np.flatnonzero(self._kept) if len(self._problem.held_out) else None
        lost, slope = self._along_every(every, rows)
        found = []
        for pattern, level, directions in tests:
            own = [at[column] for column in pattern.columns(level, directions)]
            gram = self._gram(pattern, level, directions) - lost[own] @ lost[own].T
            size = np.diag(gram).reshape(len(directions), -1).sum(axis=1)
            deviation = np.repeat(np.sqrt(PLAUSIBLE / np.where(size > 0.0, size, np.inf)), len(own) // len(directions))
            values, vectors = np.linalg.eigh(gram * np.outer(deviation, deviation))
            values = np.maximum(values, 0.0)
            score = float(np.sum((vectors.T @ (slope[own] * deviation)) ** 2 / (1.0 + values)))
            found.append((values / (1.0 + values), score))
        return found

    def _along_every(self, columns: Sequence[Column], rows: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Return inner products (columns, k) with the orthonormal basis of nuisance and causes, and (columns,) with the residual."""
        problem, base, nuisance = self._problem, self._nuisance.base, self._nuisance
        causes = self._causes.reshape(len(self._kept), 3, -1)

        def vectors(block: PointBlock) -> np.ndarray:
            return side_by_side(self._more_raw(block), causes[block.rows], self._left[block.rows, :, None])

        keys = [("exact", column, problem.held_out.tobytes()) for column in columns]
        fresh = [column for key, column in zip(keys, columns, strict=True) if key not in base.known]
        if fresh:
            signatures = Signatures(base.signatures.view, fresh)
            for column, own in zip(fresh, signatures.along(base.raw, rows)[0], strict=True):
                base.known["exact", column, problem.held_out.tobytes()] = own
        beside = Signatures(self._view, columns).along(vectors, rows)[0]
        more, own, slope = np.split(beside, [nuisance.raw_count - base.raw_count, beside.shape[1] - 1], axis=1)
        by_raw = np.concatenate([np.stack([base.known[key] for key in keys]) * self._raw_scale, more], axis=1)
        return np.concatenate([by_raw @ nuisance.change @ problem.root, own], axis=1), slope[:, 0]

    def _gram(self, pattern: Pattern, level: int, directions: tuple[int, ...]) -> np.ndarray:
        """Return φᵀφ of the functions up to an order along some directions, without projection; kept."""
        known = self._nuisance.base.known
        key = "gram", pattern, level, directions, self._problem.held_out.tobytes()
        if key not in known:
            rows, chosen = np.flatnonzero(pattern.own & self._kept), pattern.order <= level
            count = len(directions)
            found = np.zeros((count, int(chosen.sum()), count, int(chosen.sum())))
            for some in pieces(len(rows)):
                here = rows[some]
                fields = self._fields(pattern, here)[:, :, list(directions)] / self._nuisance.scale
                weights = np.einsum("nki,nkj->nij", fields, fields)
                made = pattern.at(here)[:, chosen]
                for i in range(count):
                    for j in range(i + 1):
                        found[i, :, j] += made.T @ (made * weights[:, i, j, None])
            for i in range(count):
                for j in range(i):
                    found[j, :, i] = found[i, :, j].T
            known[key] = found.reshape(count * found.shape[1], -1)
        return known[key] * self._nuisance.scale**2

    def _more_raw(self, block: PointBlock) -> np.ndarray:
        """Return the nuisance derivatives (points, 3, r) of random effects at a block of points."""
        own = self._nuisance.signatures
        return own.at(block, range(len(self._nuisance.base.signatures.columns), len(own.columns)))

    @property
    def _raw_scale(self) -> np.ndarray:
        """(raw,) factors on inner products with the base's nuisance derivatives, whose set-up part is orthonormal with any weights."""
        nuisance, base = self._nuisance, self._nuisance.base
        return np.where(np.arange(base.raw_count) < base.setup_count, nuisance.scale, nuisance.scale**2)

    def _change(self, whole: np.ndarray, count: int) -> np.ndarray:
        """Return the coefficients (raw, k) of an orthonormal basis of nuisance and causes, scaled so that a sample stands for all rows.

        Args:
            whole: (r, 3, raw) nuisance derivatives and causes at the sample.
            count: number of all rows.
        """
        change = scipy.linalg.block_diag(self._nuisance.change @ self._problem.root, np.eye(self._causes.shape[1]))
        if len(whole) == count:
            return change
        flat = whole.reshape(3 * len(whole), -1) @ change * np.sqrt(count / len(whole))
        # Over all rows no direction is longer than one; over a sample it may seem to be.
        values, vectors = np.linalg.eigh(flat.T @ flat)
        return change @ (vectors / np.sqrt(np.maximum(values, 1.0))) * np.sqrt(count / len(whole))

    def _fields(self, pattern: Pattern, rows: Rows) -> np.ndarray:
        return ReadingDerivatives(self._view, rows).of(pattern.derivative) * UM


def _along_each(fields: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return products (3, n, q) of (n, 3, q) vectors with each direction of (n, 3, 3) fields."""
    return np.stack([sum(fields[:, k, i, None] * vectors[:, k] for k in range(3)) for i in range(3)])
