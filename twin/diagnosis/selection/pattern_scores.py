"""Scores of unnamed patterns: inner products of their functions with the residual and each other, set-up and causes projected out.

The functions of a pattern are products of the functions of its columns. Their inner products with the residual, of all patterns of a
side at once, are those of the columns' functions with each other, weighted by the residual.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

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
"""Share of the largest eigenvalue below which a direction counts as zero, and share of the largest square of a pattern's functions that
the projection must leave of each: what is less is rounding. So is all of a direction that was not read."""
PLAUSIBLE: Final = 100.0
"""Noncentrality along a direction for which the test is most powerful: the score is taken at that variance, not at zero."""
TOGETHER: Final = 512
"""Readings at which the functions of all patterns of a side are evaluated at once."""


def _orthonormal_root(columns: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Return the coefficients (k, r) of an orthonormal basis in projected columns.

    Args:
        columns: (3n, k) columns.
        own: the same, projected; any rows held out are zero.
    """
    gram = columns.T @ own
    values, vectors = np.linalg.eigh((gram + gram.T) / 2.0)
    seen = values > SEEN * values.max(initial=0.0)
    return np.asarray(vectors[:, seen] / np.sqrt(values[seen]))


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
        self._columns = [column for form in forms for column in form.variant.columns]
        columns = problem.zero_held_out(problem.signature(self._columns))
        on_basis = problem.nuisances.along(columns)
        projected = problem.zero_held_out(columns - problem.fitted(on_basis))
        root = _orthonormal_root(columns, projected)
        self._causes = projected @ root
        # Coefficients of the orthonormal basis of nuisance and causes in the nuisance derivatives and the columns of the causes.
        change, absorbed = problem.nuisances.change @ problem.root, problem.root.T @ on_basis @ root
        self._change = np.block([[change, -change @ absorbed], [np.zeros((len(root), change.shape[1])), root]])
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
        lost, whole = side.lost[:, own], side.grams[pattern]
        gram = (whole - lost @ lost.transpose(0, 2, 1)) / side.share
        seen = _seen(gram, whole / side.share)
        return side.slope[:, own] * seen, gram * (seen[:, :, None] & seen[:, None, :])

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
        by_vectors, grams, whole, used = self._sampled(functions, alike, rows)
        scale = self._nuisance.scale
        in_setup = np.arange(len(self._change)) < self._nuisance.setup_count
        root = self._sample_root(whole, (np.where(in_setup, 1.0, scale)[:, None] * self._change)[used], len(own))
        lost = by_vectors.transpose(0, 2, 1) @ (scale * root)
        scaled = {pattern: gram * scale**2 for pattern, gram in grams.items()}
        return _Side(functions.own, slope, lost, scaled, len(rows) / max(len(own), 1))

    def _sampled(
        self, functions: ChannelFunctions, alike: Sequence[Pattern], rows: np.ndarray
    ) -> tuple[np.ndarray, dict[Pattern, np.ndarray], np.ndarray, np.ndarray]:
        """Return the inner products of functions over the sample, with the weights of the base.

        Those with nuisance derivatives and causes are the same in every test of these patterns on these readings and are kept.

        Returns:
            (3, used, m) with the nuisance derivatives and columns of causes that are not zero; Gram matrices (3, own, own), or one if
            they are equal; (rows, 3, used) these derivatives and columns; and their numbers.
        """
        base = self._nuisance.base
        view, block = base.signatures.view, PointBlock(base.signatures.view, rows)
        fields = ReadingDerivatives(view, rows).of(alike[0].derivative) * UM
        raw = base.raw(block)
        acting = np.flatnonzero(raw.any(axis=(0, 1)))
        key: Hashable = ("sample", tuple(alike), rows.tobytes())
        if key not in base.known:
            weight = np.einsum("nki,nki->ni", fields, fields)
            directions = 1 if np.ptp(weight) <= 1e-9 * weight.max() else 3
            grams = {pattern: np.zeros((directions, len(pattern.order), len(pattern.order))) for pattern in alike}
            for some in pieces(len(rows), TOGETHER):
                made = functions.at(rows[some])
                for pattern, own in functions.own.items():
                    for i in range(directions):
                        grams[pattern][i] += made[:, own].T @ (made[:, own] * weight[some, i, None])
            base.known[key] = _along_functions(functions, rows, fields, raw[:, :, acting]), grams, {}
        by_raw, grams, known = base.known[key]
        columns = [*self._nuisance.signatures.columns[len(base.signatures.columns) :], *self._columns]
        beside = Signatures(view, columns).at(block)
        fresh = [i for i, column in enumerate(columns) if column not in known]
        for i, own in zip(
            fresh, _along_functions(functions, rows, fields, beside[:, :, fresh]).transpose(1, 0, 2), strict=True
        ):
            known[columns[i]] = own.copy()
        by_beside = np.stack([known[column] for column in columns], axis=1) if columns else by_raw[:, :0]
        used = np.concatenate([acting, base.raw_count + np.arange(len(columns))])
        return np.concatenate([by_raw, by_beside], axis=1), grams, side_by_side(raw[:, :, acting], beside), used

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
            whole = self._gram(pattern, level, directions)
            gram = whole - lost[own] @ lost[own].T
            seen = _seen(gram, whole)
            gram *= seen[:, None] & seen
            size = np.diag(gram).reshape(len(directions), -1).sum(axis=1)
            deviation = np.repeat(np.sqrt(PLAUSIBLE / np.where(size > 0.0, size, np.inf)), len(own) // len(directions))
            values, vectors = np.linalg.eigh(gram * np.outer(deviation, deviation))
            values = np.maximum(values, 0.0)
            score = float(np.sum((vectors.T @ (slope[own] * seen * deviation)) ** 2 / (1.0 + values)))
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
        return np.concatenate(
            [by_raw @ self._change[: nuisance.raw_count, : problem.root.shape[1]], own], axis=1
        ), slope[:, 0]

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

    def _sample_root(self, whole: np.ndarray, change: np.ndarray, count: int) -> np.ndarray:
        """Return a root R (used, k) of the projection on nuisance and causes, VRRᵀVᵀ, such that a sample stands for all rows.

        Args:
            whole: (r, 3, used) vectors V at the sample.
            change: (used, directions) coefficients in these of an orthonormal basis over all rows.
            count: number of all rows.
        """
        root = np.asarray(np.linalg.qr(change.T, mode="r")).T
        if len(whole) == count:
            return root
        root = root * np.sqrt(count / len(whole))
        flat = whole.reshape(3 * len(whole), -1) @ root
        # Over all rows no direction is longer than one; over a sample it may seem to be.
        values, vectors = np.linalg.eigh(flat.T @ flat)
        return np.asarray(root @ (vectors / np.sqrt(np.maximum(values, 1.0))))

    def _fields(self, pattern: Pattern, rows: Rows) -> np.ndarray:
        return ReadingDerivatives(self._view, rows).of(pattern.derivative) * UM


def _seen(gram: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Return (…, m) which functions of a pattern the projection leaves, from Gram matrices (…, m, m) with and without it."""
    largest = float(np.diagonal(whole, axis1=-2, axis2=-1).max(initial=0.0))
    return np.asarray(np.diagonal(gram, axis1=-2, axis2=-1) > SEEN * largest)


def _along_functions(
    functions: ChannelFunctions, rows: np.ndarray, fields: np.ndarray, vectors: np.ndarray
) -> np.ndarray:
    """Return inner products (3, q, m) over some rows of functions along each direction of (n, 3, 3) fields with (n, 3, q) vectors."""
    found = np.zeros((3, vectors.shape[2], functions.count))
    for some in pieces(len(rows) if vectors.size else 0, TOGETHER):
        along = np.stack([sum(fields[some, k, i, None] * vectors[some, k] for k in range(3)) for i in range(3)])
        found += along.transpose(0, 2, 1) @ functions.at(rows[some])
    return found
