"""A joint covariance of named parameters, and its text: one row a line, lower triangle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from twin._common.arrays import locked

ROUNDING = 1e-9
"""What the printed digits may push a zero eigenvalue below zero, relative to the largest."""


@final
@dataclass(frozen=True)
class Covariance:
    """Names and their covariance matrix.

    Attributes:
        names: of the parameters, each once.
        matrix: (p, p), in the products of the parameters' units; read-only.
    """

    names: tuple[str, ...]
    matrix: np.ndarray

    @classmethod
    def none(cls) -> Covariance:
        """Of nothing."""
        return cls((), locked(np.zeros((0, 0))))

    @classmethod
    def of_blocks(cls, blocks: Sequence[Covariance]) -> Covariance:
        """Independent groups side by side."""
        names = tuple(name for block in blocks for name in block.names)
        matrix = np.zeros((len(names), len(names)))
        start = 0
        for block in blocks:
            end = start + len(block.names)
            matrix[start:end, start:end] = block.matrix
            start = end
        return cls(names, locked(matrix))

    def of(self, names: Sequence[str]) -> Covariance:
        """The part of some names, in their order.

        Raises:
            KeyError: a name that is not among these.
        """
        index = {name: i for i, name in enumerate(self.names)}
        rows = [index[name] for name in names]
        return Covariance(tuple(names), locked(self.matrix[np.ix_(rows, rows)]))

    def where(self, keep: Callable[[str], bool]) -> Covariance:
        """The part of the names that are kept."""
        return self.of([name for name in self.names if keep(name)])

    def plus(self, other: Covariance) -> Covariance:
        """Of the sums of independent estimates; a name that only one has keeps its own."""
        names = tuple(dict.fromkeys((*self.names, *other.names)))
        index = {name: i for i, name in enumerate(names)}
        matrix = np.zeros((len(names), len(names)))
        for one in (self, other):
            rows = [index[name] for name in one.names]
            matrix[np.ix_(rows, rows)] += one.matrix
        return Covariance(names, locked(matrix))

    def rewritten(self, name: str, matrix: np.ndarray) -> Covariance:
        """With the parameters ``name[0]`` … ``name[k−1]`` made into ``name[0]`` … ``name[m−1]``: (m, k) matrix times the former.

        Those of them that are not among these names are taken as exact; none of them, or a matrix that changes nothing, leaves all.
        """
        into, count = matrix.shape
        own = {f"{name}[{k}]": k for k in range(count)}
        have = [n for n in self.names if n in own]
        if not have or np.array_equal(matrix, np.eye(into, count)):
            return self
        rest = [column for column, n in enumerate(self.names) if n not in own]
        through = np.zeros((len(rest) + into, len(self.names)))
        through[range(len(rest)), rest] = 1.0
        for column, n in enumerate(self.names):
            if n in own:
                through[len(rest) :, column] = matrix[:, own[n]]
        names = (*(self.names[column] for column in rest), *(f"{name}[{k}]" for k in range(into)))
        found = through @ self.matrix @ through.T
        return Covariance(names, locked((found + found.T) / 2.0))

    def to_text(self) -> str:
        """Lower triangle, one row a line, every digit."""
        return "".join(" ".join(repr(float(v)) for v in row[: i + 1]) + "\n" for i, row in enumerate(self.matrix))

    @classmethod
    def from_text(cls, names: Sequence[str], text: str) -> Covariance:
        """Read `to_text`.

        Raises:
            ValueError: rows of the wrong length, something that is no finite number, a matrix with a negative eigenvalue; the
                message says which.
        """
        rows = [line.split() for line in text.splitlines() if line.strip()]
        if len(rows) != len(names):
            raise ValueError(f"{len(rows)} rows, {len(names)} parameters")
        matrix = np.zeros((len(names), len(names)))
        for i, row in enumerate(rows):
            if len(row) != i + 1:
                raise ValueError(f"row {i + 1} has {len(row)} numbers")
            try:
                matrix[i, : i + 1] = [float(cell) for cell in row]
            except ValueError:
                raise ValueError(f"row {i + 1} holds something that is no number") from None
        if not np.all(np.isfinite(matrix)):
            raise ValueError("it holds a number that is not finite")
        matrix = matrix + np.tril(matrix, -1).T
        problem = not_a_covariance(matrix)
        if problem is not None:
            raise ValueError(problem)
        return cls(tuple(names), locked(matrix))


def not_a_covariance(matrix: np.ndarray) -> str | None:
    """Why a symmetric matrix cannot be a covariance; None if it can.

    Judged on the correlations, so that µm beside µrad does not hide a sign.
    """
    variances = np.diag(matrix)
    if np.any(variances < 0.0):
        return f"a negative variance, {variances.min():.3g}"
    scale = np.where(variances > 0.0, np.sqrt(variances), 1.0)
    correlation = matrix / np.outer(scale, scale)
    if np.any(np.abs(correlation) > 1.0 + ROUNDING):
        return "a correlation beyond one: a negative eigenvalue"
    smallest = np.linalg.eigvalsh(correlation)[0] if len(matrix) else 0.0
    return f"a negative eigenvalue of the correlations, {smallest:.3g}" if smallest < -ROUNDING * len(matrix) else None
