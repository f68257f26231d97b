"""Nuisance parameters of the readings: set-up, uncertain calibration, random effects; their orthonormal basis in coefficients.

The derivatives by the set-up are few and held at all points, as an orthonormal basis Q. Those by the uncertain parameters, J, may be
hundreds; they are sums of a derivative of the reading times a function of the state, and only the coefficients of the basis are held.
With J̃ = J − QQᵀJ and a square root L of the covariance of the parameters, LᵀJ̃ᵀJ̃L + 1 = CCᵀ (Cholesky) gives the basis of
[B, JL; 0, 1]: its readings' part is U = [Q, J̃A] with A = LC⁻ᵀ, and its prior's part is [0, C⁻ᵀ]. UᵀU and the Gram matrix of the prior's
part add up to the identity, to a rounding error of 10⁻¹⁶ times the largest variance of J̃L in units of the noise variance.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import replace
from functools import reduce
from hashlib import blake2b
from math import prod
from typing import Any, Final, final

import numpy as np
import scipy

from twin._common.resources import map_chunks
from twin.diagnosis.candidates.candidate import Column
from twin.diagnosis.signature_products import PointBlock, Signatures, side_by_side
from twin.identification.network import LinearisedReadings
from twin.numerics.functions import Functions, Rows, tabulated

RANK_TOLERANCE: Final = 1e-9  # relative: smaller singular values of the set-up's derivatives count as zero


@final
class Nuisance:
    """Orthonormal basis of the nuisance derivatives of p parameters besides the set-up.

    Args:
        signatures: signatures of the p parameters, each in units of the parameter.
        root: (p, k) square root of their covariance.
        setup: (3n, s) orthonormal basis of the derivatives by the set-up.
        triangle: (s, set-up) coordinates in it of the derivatives by the set-up.
        on_setup: (s, p) inner products QᵀJ.
        remaining: (p, p) inner products J̃ᵀJ̃.
        extended: the parameters without random effects, and the square root of the factor on the weights; itself and one if None.

    Attributes:
        coordinates: (directions, set-up + k) coordinates in the basis of the derivatives by the set-up and of one standard deviation of
            each direction of the covariance.
        prior: (k, directions) the prior's part of the basis.
        known: inner products with `raw` of the base, kept by those who need them again.
    """

    def __init__(
        self,
        signatures: Signatures,
        root: np.ndarray,
        setup: np.ndarray,
        triangle: np.ndarray,
        on_setup: np.ndarray,
        remaining: np.ndarray,
        extended: tuple[Nuisance, float] | None = None,
    ) -> None:
        self.signatures = signatures
        self.base, self.scale = (self, 1.0) if extended is None else extended
        self.known: dict[Hashable, Any] = {}
        self._setup, self._triangle, self._on_setup = setup, triangle, on_setup
        self._root, self._remaining = root, remaining
        self._grams: dict[bytes, np.ndarray] = {}
        lower = np.linalg.cholesky(root.T @ remaining @ root + np.eye(root.shape[1]))
        inverse = scipy.linalg.solve_triangular(lower, np.eye(len(lower)), lower=True)
        self._change = root @ inverse.T
        self.prior = np.concatenate([np.zeros((len(inverse), setup.shape[1])), inverse.T], axis=1)
        below = np.zeros((len(lower), triangle.shape[1]))
        self.coordinates = np.block([[triangle, on_setup @ root], [below, lower.T]])

    @classmethod
    def of(
        cls, view: LinearisedReadings, by_setup: np.ndarray, columns: Sequence[Column], root: np.ndarray
    ) -> Nuisance:
        """Return the basis of set-up, by derivatives (3n, set-up) in plausible sizes (overwritten), and p uncertain parameters.

        ``root`` (p, k) is the square root of their covariance.
        """
        columns, root = _with_orthonormal_functions([_in_units(column) for column in columns], root)
        signatures = Signatures(view, _with_shared_functions(columns))
        setup, triangle = setup_basis(by_setup)
        on_setup = signatures.along(lambda block: _at(setup, block.rows))[0].T
        whole = _projected_gram(signatures, setup, on_setup, np.arange(len(view.rows)))
        count = len(triangle)
        nuisance = cls(signatures, root, setup, triangle, on_setup + whole[:count, count:], whole[count:, count:])
        if columns:
            nuisance._make_orthonormal()
        return nuisance

    def _make_orthonormal(self) -> None:
        """Remove the rounding errors of strongly correlated parameters by a second Cholesky factor, that of the basis itself."""
        count = self.setup_count
        lower = np.linalg.cholesky((self.prior.T @ self.prior + self._gram_of_rows())[count:, count:])
        inverse = scipy.linalg.solve_triangular(lower, np.eye(len(lower)), lower=True)
        self._change = self._change @ inverse.T
        self.prior[:, count:] = self.prior[:, count:] @ inverse.T
        self.coordinates[count:] = lower.T @ self.coordinates[count:]

    def _gram_of_rows(self) -> np.ndarray:
        """Return the Gram matrix (directions, directions) of the basis over all points, evaluated row by row.

        The basis at the points of one side is a combination of the derivatives that are not zero there, in as many dimensions.
        """
        runs, change = self.signatures.ordered_runs(np.arange(len(self.signatures.view.rows))), self.change

        def partial(own: Sequence[np.ndarray]) -> np.ndarray:
            sides: dict[bytes, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
            for run in own:
                here = self.raw(PointBlock(self.signatures.view, run))
                used = np.flatnonzero(here.any(axis=(0, 1)))
                if used.tobytes() not in sides:
                    orthonormal, triangle = np.linalg.qr(change[used].T)
                    sides[used.tobytes()] = orthonormal, triangle.T.copy(), np.zeros((len(triangle), len(triangle)))
                _, root, gram = sides[used.tobytes()]
                for i in range(3):
                    rows = here[:, i, used] @ root
                    gram += rows.T @ rows
            found = np.zeros((change.shape[1], change.shape[1]))
            for orthonormal, _, gram in sides.values():
                found += orthonormal @ gram @ orthonormal.T
            return found

        return reduce(np.ndarray.__iadd__, map_chunks(runs, partial))

    def extended(
        self, view: LinearisedReadings, scale: float, columns: Sequence[Column], deviations: np.ndarray
    ) -> Nuisance:
        """Return the basis with independent random effects (r,) of given standard deviations, for weights times ``scale``."""
        own = Signatures(view, [*self.signatures.columns, *(_in_units(column) for column in columns)])
        more = Signatures(self.signatures.view, own.columns[len(self.signatures.columns) :])
        by_setup, by_columns = np.split(self.along_signatures(more, None), [self._setup.shape[1]])
        on_setup = np.concatenate([self._on_setup, by_setup], axis=1)
        cross = by_columns - self._on_setup.T @ by_setup
        among = more.along(more.at)[0] - by_setup.T @ by_setup
        remaining = np.block([[self._remaining, cross], [cross.T, among]])
        root = scipy.linalg.block_diag(self._root, np.diag(deviations))
        return Nuisance(
            own, root, self._setup, scale * self._triangle, scale * on_setup, scale**2 * remaining, (self, scale)
        )

    @property
    def setup_count(self) -> int:
        """Number of vectors of the set-up in `raw`."""
        return int(self._setup.shape[1])

    @property
    def raw_count(self) -> int:
        """Number of vectors in `raw`."""
        return self._setup.shape[1] + len(self.signatures.columns)

    def raw(self, block: PointBlock) -> np.ndarray:
        """Return (points, 3, raw) basis of the set-up and columns of the parameters at a block of points."""
        return side_by_side(_at(self._setup, block.rows), self.signatures.at(block))

    def from_raw(self, products: np.ndarray, root: np.ndarray | None = None) -> np.ndarray:
        """Return inner products (k, …) with the basis, or with coordinates ``root`` in it (directions, k), from those with `raw`."""
        by_setup, by_columns = np.split(products, [self._setup.shape[1]])
        left = by_columns - self._on_setup.T @ by_setup
        if root is None:
            return np.concatenate([by_setup, self._change.T @ left])
        of_setup, rest = np.split(root, [self._setup.shape[1]])
        return np.asarray((self._change @ rest).T @ left + of_setup.T @ by_setup)

    def along(self, vectors: np.ndarray) -> np.ndarray:
        """Return inner products (directions, …) of the basis with (3n, …) vectors at all points."""
        flat = vectors.reshape(len(vectors), prod(vectors.shape[1:]))
        at_points = flat.reshape(len(flat) // 3, 3, flat.shape[1])
        by_columns = self.signatures.along(lambda block: at_points[block.rows])[0]
        along_columns = self.from_raw(np.concatenate([self._setup.T @ flat, by_columns]))
        return along_columns.reshape(len(along_columns), *vectors.shape[1:])

    def along_signatures(self, signatures: Signatures, points: np.ndarray | None) -> np.ndarray:
        """Return inner products (raw, columns) of `raw` with signatures, over some points or all."""
        by_setup = signatures.along(lambda block: _at(self._setup, block.rows), points)[0].T
        return np.concatenate([by_setup, self.signatures.along(signatures.at, points)[0]])

    def combined(self, coordinates: np.ndarray, points: np.ndarray | None = None) -> np.ndarray:
        """Return (3n, …) vectors at some points, in ascending order, or all, from (directions, …) coordinates in the basis."""
        by_setup, rest = np.split(
            coordinates.reshape(len(coordinates), prod(coordinates.shape[1:])), [self._setup.shape[1]]
        )
        by_columns = self._change @ rest
        setup = self._setup if points is None else _at(self._setup, points).reshape(3 * len(points), self.setup_count)
        combined_columns = setup @ (by_setup - self._on_setup @ by_columns)
        if len(by_columns):
            combined_columns += self.signatures.combined(by_columns, points).reshape(combined_columns.shape)
        return combined_columns.reshape(len(combined_columns), *coordinates.shape[1:])

    def rows(self, points: Rows) -> np.ndarray:
        """Return the basis (points, 3, directions) at some points."""
        here, columns = _at(self._setup, points), self.signatures.at(PointBlock(self.signatures.view, points))
        rows = np.empty((*here.shape[:2], len(self.coordinates)))
        rows[:, :, : self.setup_count] = here
        for i in range(3):
            rows[:, i, self.setup_count :] = (columns[:, i] - here[:, i] @ self._on_setup) @ self._change
        return rows

    @property
    def change(self) -> np.ndarray:
        """(raw, directions) coefficients of the basis in `raw`."""
        return np.block(
            [
                [np.eye(self._setup.shape[1]), -self._on_setup @ self._change],
                [np.zeros((len(self._change), self._setup.shape[1])), self._change],
            ]
        )

    def gram(self, points: np.ndarray) -> np.ndarray:
        """Return the Gram matrix (directions, directions) of the basis over some points; cached."""
        key = points.tobytes()
        if key not in self._grams:
            change = scipy.linalg.block_diag(np.eye(self.setup_count), self._change)
            inner = _projected_gram(self.signatures, self._setup, self._on_setup, points)
            self._grams[key] = change.T @ inner @ change
        return self._grams[key]


def setup_basis(by_setup: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return an orthonormal basis (3n, s) of the derivatives by the set-up, and their coordinates (s, set-up) in it.

    Derivatives whose columns are contiguous in memory are overwritten.
    """
    orthonormal, triangle = scipy.linalg.qr(by_setup, mode="economic", overwrite_a=True, check_finite=False)
    left, values, right = np.linalg.svd(triangle, full_matrices=False)
    kept = values > RANK_TOLERANCE * values.max(initial=0.0)
    return orthonormal @ left[:, kept], values[kept, None] * right[kept]


def _in_units(column: Column) -> Column:
    """Return a column in units of its parameter; the same object if it is already, so that its inner products are found again."""
    return column if column.scale == 1.0 else Column(column.terms, 1.0)


def _at(columns: np.ndarray, points: Rows) -> np.ndarray:
    """Return the rows (points, 3, k) of (3n, k) columns at some points."""
    return np.asarray(columns.reshape(len(columns) // 3, 3, columns.shape[1])[points])


def _projected_gram(signatures: Signatures, setup: np.ndarray, on_setup: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the Gram matrix of the basis of the set-up and of signatures with the set-up projected out, over some points.

    It follows from that of the signatures before projection, of which those of one side are zero at points of the other.
    """

    def partial(own: Sequence[np.ndarray]) -> np.ndarray:
        found = np.zeros((sum(on_setup.shape), sum(on_setup.shape)))
        for run in own:
            here = side_by_side(_at(setup, run), signatures.at(PointBlock(signatures.view, run)))
            used = np.flatnonzero(here.any(axis=(0, 1)))
            found[np.ix_(used, used)] += sum(own.T @ own for own in (here[:, i, used] for i in range(3)))
        return found

    raw = reduce(np.ndarray.__iadd__, map_chunks(signatures.ordered_runs(points), partial))
    change = np.eye(len(raw))
    change[: len(on_setup), len(on_setup) :] = -on_setup
    return np.asarray(change.T @ raw @ change)


def _with_orthonormal_functions(columns: Sequence[Column], root: np.ndarray) -> tuple[Sequence[Column], np.ndarray]:
    """Return columns that span the same, and the root in their units, with the functions of each curve orthonormal at the points.

    The coefficients of powers are strongly correlated: their effects are hundreds of times larger than the uncertainty of the curve,
    and cancel. Those of orthonormal functions are not. Sets of functions that are used in any other way stay as they are.
    """
    sets: dict[Functions, list[int]] = {}
    factors: dict[bytes, tuple[Functions, np.ndarray]] = {}
    for i, column in enumerate(columns):
        for term in column.terms:
            sets.setdefault(term.functions, []).append(i)
    columns_after, root = list(columns), np.array(root)
    for functions, own in sets.items():
        terms = [term for i in own for term in columns[i].terms]
        alike = len({(term.freedom, term.weight) for term in terms}) == 1
        if len(terms) != len(own) or not alike or len(own) > functions.points:
            continue
        values = functions.values(slice(None))[:, [term.index for term in terms]]
        key = blake2b(values.tobytes()).digest()
        if key not in factors:
            basis, triangle = np.linalg.qr(values)
            factors[key] = tabulated(basis), triangle
        made, triangle = factors[key]
        for k, i in enumerate(own):
            columns_after[i] = Column((replace(terms[k], functions=made, index=k),), columns[i].scale)
        root[own] = triangle @ root[own]
    return columns_after, root


def _with_shared_functions(columns: Sequence[Column]) -> list[Column]:
    """Return the same columns with their functions of the state in one table, functions with the same values once.

    The curves of an axis have the same functions, of which a calibration has hundreds.
    """
    number: dict[bytes, int] = {}
    table: list[np.ndarray] = []
    at: dict[Functions, list[int]] = {}
    for functions in dict.fromkeys(term.functions for column in columns for term in column.terms):
        values = functions.values(slice(None)).T
        at[functions] = []
        for own in np.ascontiguousarray(values):
            key = blake2b(own.tobytes()).digest()
            if (place := number.setdefault(key, len(table))) == len(table):
                table.append(own)
            at[functions].append(place)
    if not table:
        return list(columns)
    shared = tabulated(np.stack(table, axis=1))
    return [
        Column(
            tuple(replace(term, functions=shared, index=at[term.functions][term.index]) for term in column.terms),
            column.scale,
        )
        for column in columns
    ]
