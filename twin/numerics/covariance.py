"""Joint covariance of named parameters, with two text forms of its lower triangle: numbers in rows, and compressed."""

from __future__ import annotations

import base64
import hashlib
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from twin._common.arrays import read_only

ROUNDING = 1e-9
"""Tolerance for a negative eigenvalue due to the rounding of printed digits, relative to the largest."""


def inverse_root(covariance: np.ndarray) -> np.ndarray:
    """Return (n, n) W with W C Wᵀ = 1."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2.0)
    return np.asarray((vectors / np.sqrt(values)).T)


def symmetric_root(covariance: np.ndarray) -> np.ndarray:
    """Return the symmetric roots S of covariances Σ = S S, (..., p, p), without eigenvalues that are negative by rounding.

    Random draws use this root. It is unique and a continuous function of the covariance (N. J. Higham: Functions of Matrices, SIAM
    2008, chapter 6). The eigenvectors of a repeated eigenvalue are neither: a draw along them changes altogether where the last place
    of the covariance changes, and with it from one processor to another.
    """
    values, vectors = np.linalg.eigh(covariance)
    scaled = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return np.asarray(scaled @ vectors.swapaxes(-1, -2))


@final
@dataclass(frozen=True)
class Covariance:
    """Names of parameters and their covariance matrix."""

    names: tuple[str, ...]  # names of the parameters, each once
    matrix: np.ndarray  # (p, p), in the products of the parameters' units; read-only

    @classmethod
    def none(cls) -> Covariance:
        """Return an empty covariance."""
        return cls((), read_only(np.zeros((0, 0))))

    @classmethod
    def of_blocks(cls, blocks: Sequence[Covariance]) -> Covariance:
        """Return the joint covariance of independent groups."""
        names = tuple(name for block in blocks for name in block.names)
        matrix = np.zeros((len(names), len(names)))
        start = 0
        for block in blocks:
            end = start + len(block.names)
            matrix[start:end, start:end] = block.matrix
            start = end
        return cls(names, read_only(matrix))

    def of(self, names: Sequence[str]) -> Covariance:
        """Return the covariance of some names, in the order given. Raises `KeyError`: an unknown name."""
        index = {name: i for i, name in enumerate(self.names)}
        rows = [index[name] for name in names]
        return Covariance(tuple(names), read_only(self.matrix[np.ix_(rows, rows)]))

    def where(self, keep: Callable[[str], bool]) -> Covariance:
        """Return the covariance of the names for which ``keep`` is true."""
        return self.of([name for name in self.names if keep(name)])

    def plus(self, other: Covariance) -> Covariance:
        """Return the covariance of the sums of independent estimates; a name that only one has keeps its covariance."""
        names = tuple(dict.fromkeys((*self.names, *other.names)))
        index = {name: i for i, name in enumerate(names)}
        matrix = np.zeros((len(names), len(names)))
        for covariance in (self, other):
            rows = [index[name] for name in covariance.names]
            matrix[np.ix_(rows, rows)] += covariance.matrix
        return Covariance(names, read_only(matrix))

    def transformed(self, name: str, matrix: np.ndarray) -> Covariance:
        """Transform the parameters ``name[0]`` … ``name[k−1]`` into ``name[0]`` … ``name[m−1]`` by an (m, k) matrix.

        Parameters that are not among the names are taken as exact. Without any of them, or with an identity matrix, nothing changes.
        """
        new_count, count = matrix.shape
        index_of = {f"{name}[{k}]": k for k in range(count)}
        present = [n for n in self.names if n in index_of]
        if not present or np.array_equal(matrix, np.eye(new_count, count)):
            return self
        others = [column for column, n in enumerate(self.names) if n not in index_of]
        transform = np.zeros((len(others) + new_count, len(self.names)))
        transform[range(len(others)), others] = 1.0
        for column, n in enumerate(self.names):
            if n in index_of:
                transform[len(others) :, column] = matrix[:, index_of[n]]
        names = (*(self.names[column] for column in others), *(f"{name}[{k}]" for k in range(new_count)))
        found = transform @ self.matrix @ transform.T
        return Covariance(names, read_only((found + found.T) / 2.0))

    def to_text(self) -> str:
        """Return the lower triangle as text, one row on each line, in full precision."""
        return "".join(" ".join(repr(float(v)) for v in row[: i + 1]) + "\n" for i, row in enumerate(self.matrix))

    @classmethod
    def from_text(cls, names: Sequence[str], text: str) -> Covariance:
        """Parse the text of `to_text`.

        Raises:
            ValueError: rows of the wrong length, something that is not a finite number, or a matrix with a negative eigenvalue.
        """
        rows = [line.split() for line in text.splitlines() if line.strip()]
        if len(rows) != len(names):
            raise ValueError(f"{len(rows)} rows for {len(names)} parameters")
        matrix = np.zeros((len(names), len(names)))
        for i, row in enumerate(rows):
            if len(row) != i + 1:
                raise ValueError(f"row {i + 1} has {len(row)} numbers instead of {i + 1}")
            try:
                matrix[i, : i + 1] = [float(cell) for cell in row]
            except ValueError:
                raise ValueError(f"row {i + 1} has an entry that is not a number") from None
        return cls._of_triangle(names, matrix)

    def to_compressed(self) -> tuple[str, str]:
        """Return the lower triangle compressed, and its SHA-256.

        The text is the base64 of a zlib stream of the numbers, row by row, as little-endian float64. Their bytes are grouped by
        position (all first bytes, then all second bytes, …), which compresses better. The SHA-256 is that of the numbers' bytes.
        """
        raw = self.matrix[np.tril_indices(len(self.names))].astype("<f8").tobytes()
        grouped = np.frombuffer(raw, np.uint8).reshape(-1, 8).T.tobytes()
        return base64.b64encode(zlib.compress(grouped, 9)).decode("ascii"), hashlib.sha256(raw).hexdigest()

    @classmethod
    def from_compressed(cls, names: Sequence[str], text: str, sha256: str) -> Covariance:
        """Parse the text of `to_compressed`; white space in it is ignored.

        Raises:
            ValueError: a damaged text, the wrong number of entries, or entries that `from_text` would refuse.
        """
        size = 4 * len(names) * (len(names) + 1)
        try:
            grouped = zlib.decompressobj().decompress(base64.b64decode("".join(text.split()), validate=True), size + 8)
        except (ValueError, zlib.error):
            raise ValueError("the compressed text is damaged") from None
        if len(grouped) != size:
            raise ValueError(f"the compressed text does not hold the {size // 8} numbers of {len(names)} parameters")
        raw = np.frombuffer(grouped, np.uint8).reshape(8, -1).T.tobytes()
        if hashlib.sha256(raw).hexdigest() != sha256:
            raise ValueError("the numbers differ from those that the SHA-256 belongs to")
        matrix = np.zeros((len(names), len(names)))
        matrix[np.tril_indices(len(names))] = np.frombuffer(raw, "<f8")
        return cls._of_triangle(names, matrix)

    @classmethod
    def _of_triangle(cls, names: Sequence[str], lower: np.ndarray) -> Covariance:
        """Return the covariance of a lower triangle; raise ValueError if it is not one."""
        if not np.all(np.isfinite(lower)):
            raise ValueError("an entry is not finite")
        matrix = lower + np.tril(lower, -1).T
        defect = not_a_covariance(matrix)
        if defect is not None:
            raise ValueError(defect)
        return cls(tuple(names), read_only(matrix))


def not_a_covariance(matrix: np.ndarray) -> str | None:
    """Return the reason why a symmetric matrix is not a covariance; None if it is one.

    The test uses the correlations, so that it does not depend on the units.
    """
    variances = np.diag(matrix)
    if np.any(variances < 0.0):
        return f"a negative variance, {variances.min():.3g}"
    scale = np.where(variances > 0.0, np.sqrt(variances), 1.0)
    correlation = matrix / np.outer(scale, scale)
    if np.any(np.abs(correlation) > 1.0 + ROUNDING):
        return "a correlation above one, which implies a negative eigenvalue"
    smallest = np.linalg.eigvalsh(correlation)[0] if len(matrix) else 0.0
    return f"a negative eigenvalue of the correlations, {smallest:.3g}" if smallest < -ROUNDING * len(matrix) else None
