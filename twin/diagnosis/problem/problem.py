"""The readings after everything the set-up and the fitted geometry can absorb has been projected out.

Whitened residual r and signatures S are judged by what remains of them beside the set-up's derivatives B (and the calibration's own
uncertainty, as directions with unit prior variance): xᵀMy = xᵀy − (Uᵀx)ᵀ(Uᵀy), U the part in the readings of an orthonormal basis of
[B, J·L; 0, 1]. With some points taken out, what is left of the basis is orthonormal again after a factor: UᵀU + PᵀP = 1 less what was
taken out, P the other part of the basis.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from scipy.linalg import block_diag

from twin._common.threads import side_by_side
from twin.diagnosis.candidates.signatures import Column, of_effect
from twin.diagnosis.problem.signature_products import PointBlock, Signatures
from twin.identification.network import Network, View
from twin.identification.setup import SetUp
from twin.machine.calibration import Calibration
from twin.measurement.table import state_of
from twin.numerics.functions import Rows, pieces

TOLD_APART: Final = 1e-9
"""Relative size of a set-up direction below which it is no direction of its own."""
LOST: Final = 1e-12
"""Share of a direction in the points that are left below which they do not hold it."""


@final
@dataclass(frozen=True)
class Inner:
    """Inner products of k columns.

    Attributes:
        gram: (k, k) beside the set-up and the calibration's doubt.
        slope: (k,) with the residual, likewise.
        basis: (directions, k) with the basis itself.
        raw: (k, k) nothing projected out.
        with_residual: (k,) with the residual, nothing projected out.
    """

    gram: np.ndarray
    slope: np.ndarray
    basis: np.ndarray
    raw: np.ndarray
    with_residual: np.ndarray


@final
class Problem:
    """Readings, set-up and calibration of one data set, linearised at the fitted set-up.

    Args:
        network: data and calibration (as ``base``), no unknowns.
        setup: the fitted set-up.
        calibration: whose covariance counts as uncertainty; none if None.
        random: columns of effects without a name that are free beside it, each with its standard deviation in units of the parameter.
    """

    def __init__(
        self,
        network: Network,
        setup: SetUp,
        calibration: Calibration | None,
        random: Sequence[tuple[Column, float]] = (),
    ) -> None:
        self.network = network
        self.setup = setup
        self.calibration = calibration
        self.random = tuple(random)
        self.view: View = network.view(np.zeros(0), setup, np.arange(len(network.data)))
        self.residual = self.view.residual.reshape(-1)
        doubt, root = self._uncertain(calibration)
        if random:
            doubt = [*doubt, *(column for column, _ in random)]
            root = block_diag(root, np.diag([deviation for _, deviation in random]))
        self.prior = np.concatenate([np.zeros((root.shape[1], len(setup))), np.eye(root.shape[1])], axis=1)
        self.basis, self.nuisance_coordinates = self._orthonormal(doubt, root)
        self.root = np.eye(self.basis.shape[1])
        self.held_out: np.ndarray = np.zeros(0, dtype=int)
        self.absorbed = self.basis.shape[1] - root.shape[1]
        self.set_residual(self.residual)
        self.readings = int(np.count_nonzero(network.read))

    def with_random_effects(self, random: Sequence[tuple[Column, float]], scatter: float = 1.0) -> Problem:
        """The same readings with effects without a name free beside the set-up, and with another scatter.

        Args:
            random: columns, each with its standard deviation in units of the parameter.
            scatter: times the stated variances.
        """
        network = self.network if scatter == 1.0 else self.network.scattered(scatter)
        found = Problem(network, self.setup, self.calibration, random)
        found.set_residual(self.residual / np.sqrt(scatter))
        if len(self.held_out):
            found = found.without(np.isin(np.arange(len(self.view.rows)), self.held_out)) or found
        return found

    def without(self, points: np.ndarray) -> Problem | None:
        """The same with some points taken out; None if a station or a target would be lost.

        Args:
            points: (n,) booleans, those to take out.
        """
        part = copy(self)
        part.held_out = np.flatnonzero(points)
        gone = self._gram(part.held_out)
        own = self.nuisance_coordinates[:, : len(self.setup)]
        size = np.einsum("ij,ij->j", own, own)
        left = size - np.einsum("ki,kl,li->i", own, gone, own)
        if np.any((left <= LOST * size) & (size > 0.0)):
            return None
        part.root = _root(np.eye(len(gone)) - gone)
        part.set_residual(self.residual)
        return part

    def orthonormal_on(self, points: np.ndarray) -> np.ndarray:
        """(directions, k) factor that makes the basis orthonormal again where only some points (their numbers) count."""
        own = self.prior @ np.linalg.pinv(self.nuisance_coordinates, rcond=TOLD_APART)
        return _root(own.T @ own + self._gram(points))

    def set_residual(self, residual: np.ndarray) -> None:
        """Another (3n,) whitened residual at the same set-up."""
        self.residual = residual
        self.along_basis = self.basis.T @ self.zero_held_out(residual)
        self.projected = self.project(residual)
        self.chi2 = float(self.residual @ self.projected)

    def project(self, residual: np.ndarray) -> np.ndarray:
        """A (3n,) residual beside the set-up and the calibration's doubt; rows that are held out are zero."""
        return self.zero_held_out(self.refit_setup(residual))

    def refit_setup(self, residual: np.ndarray) -> np.ndarray:
        """A (3n,) whitened residual once the set-up has been fitted to the rows that are not held out; all rows of it."""
        return np.asarray(
            residual - self.basis @ (self.root @ (self.root.T @ (self.basis.T @ self.zero_held_out(residual))))
        )

    def setup_step(self, residual: np.ndarray) -> np.ndarray:
        """(set-up,) its unknowns as a (3n,) residual moves them, metres and radians; the smallest where they can be chosen."""
        size = np.maximum(np.linalg.norm(self.nuisance_coordinates, axis=0), 1e-300)
        moved = np.linalg.lstsq(self.nuisance_coordinates / size, self.basis.T @ residual, rcond=1e-9)[0] / size
        return np.asarray(moved[: len(self.setup)] * self.setup.plausible)

    def zero_held_out(self, rows: np.ndarray) -> np.ndarray:
        """(3n, …) with the rows that are held out zero."""
        if len(self.held_out) == 0:
            return rows
        found = np.array(rows)
        found.reshape(len(self.view.rows), 3, -1)[self.held_out] = 0.0
        return found

    @property
    def nuisance(self) -> np.ndarray:
        """(3n, k) derivatives by the set-up (plausible sizes), and one standard deviation of each direction of the doubt."""
        return np.asarray(self.basis @ self.nuisance_coordinates)

    @property
    def calibration_directions(self) -> np.ndarray:
        """(directions, k) the latter of these, of the basis."""
        return np.asarray(self.nuisance_coordinates[:, len(self.setup) :])

    @property
    def dof(self) -> int:
        """Readings that the set-up does not settle."""
        return self.readings - self.absorbed

    def signature(self, columns: Sequence[Column]) -> np.ndarray:
        """(3n, columns) whitened, in plausible sizes; each column in one piece."""
        found = np.empty((len(columns), len(self.residual)))
        own = Signatures(self.view, columns)
        for rows in pieces(len(self.view.rows)):
            found[:, 3 * rows.start : 3 * rows.stop] = _flat(own.at(PointBlock(self.view, rows))).T
        return found.T

    def products(self, columns: Sequence[Column]) -> Inner:
        """What there is to know of some columns, without ever holding them at all points."""
        own = Signatures(self.view, columns)
        keep = np.ones(len(self.view.rows), dtype=bool)
        keep[self.held_out] = False
        residual = self.residual.reshape(-1, 3)

        def with_others(block: PointBlock) -> np.ndarray:
            return np.concatenate([own.at(block), self.rows(block.rows), residual[block.rows, :, None]], axis=2)

        whole = own.along(with_others, None if keep.all() else np.flatnonzero(keep))[0]
        k = len(columns)
        raw, basis, slope = whole[:, :k], whole[:, k:-1].T, whole[:, -1]
        within = self.root.T @ basis
        return Inner(raw - within.T @ within, slope - within.T @ (self.root.T @ self.along_basis), basis, raw, slope)

    def rows(self, points: Rows) -> np.ndarray:
        """(points, 3, directions) the basis at some points."""
        return np.asarray(self.basis.reshape(len(self.view.rows), 3, -1)[points])

    def inner(self, a: np.ndarray) -> np.ndarray:
        """aᵀMa of signatures."""
        a = self.zero_held_out(a)
        within = self.root.T @ (self.basis.T @ a)
        return np.asarray(a.T @ a - within.T @ within)

    def along(self, a: np.ndarray, residual: np.ndarray | None = None) -> np.ndarray:
        """aᵀMr; the data's residual, or another that is projected already."""
        return np.asarray(a.T @ (self.projected if residual is None else residual))

    def _gram(self, points: np.ndarray) -> np.ndarray:
        """(directions, directions) of the basis on some points."""
        found = np.zeros((self.basis.shape[1], self.basis.shape[1]))
        for run in pieces(len(points)):
            rows = self.rows(points[run]).reshape(-1, self.basis.shape[1])
            found += rows.T @ rows
        return found

    def _orthonormal(self, doubt: Sequence[Column], root: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The readings' part of an orthonormal basis of what set-up and doubt can do, and their derivatives in terms of it."""
        n, size = len(self.view.rows), self.prior.shape[1]
        whole = np.zeros((3 * n, size))
        own = Signatures(self.view, [Column(one.parts, 1.0) for one in doubt])
        triangle = self.prior
        for run in pieces(n):
            rows = slice(3 * run.start, 3 * run.stop)
            by_setup = np.zeros((run.stop - run.start, 3, len(self.setup)))
            self.network.by_setup(self.view.part(run), self.setup, by_setup)
            whole[rows, : len(self.setup)] = by_setup.reshape(-1, len(self.setup)) * self.setup.plausible
            if doubt:
                whole[rows, len(self.setup) :] = _flat(own.at(PointBlock(self.view, run))) @ root
            triangle = np.asarray(np.linalg.qr(np.concatenate([triangle, whole[rows]]), mode="r"))
        _, values, vectors = np.linalg.svd(triangle, full_matrices=False)
        kept = values > TOLD_APART * values[0] if len(values) else np.zeros(0, dtype=bool)
        factor, back = vectors[kept].T / values[kept], values[kept, None] * vectors[kept]
        # Twice: what rounding leaves of the angles between weak directions is straightened by a second factor.
        beside = self.prior @ factor

        def squares(own: Sequence[slice]) -> np.ndarray:
            found = np.zeros((factor.shape[1], factor.shape[1]))
            for rows in own:
                part = whole[rows] @ factor
                found += part.T @ part
            return found

        runs = [slice(3 * run.start, 3 * run.stop) for run in pieces(n)]
        lower = np.linalg.cholesky(beside.T @ beside + sum(side_by_side(runs, squares)))
        straight = np.linalg.solve(lower, factor.T).T

        def turned(own: Sequence[slice]) -> None:
            for rows in own:
                whole[rows, : straight.shape[1]] = whole[rows] @ straight

        side_by_side(runs, turned)
        return whole[:, : straight.shape[1]], np.asarray(lower.T @ back)

    def _uncertain(self, calibration: Calibration | None) -> tuple[list[Column], np.ndarray]:
        """Columns of the calibration's parameters, and what one standard deviation of each direction of its covariance is of them."""
        if calibration is None or not calibration.covariance.names:
            return [], np.zeros((0, 0))
        covariance = calibration.covariance
        known = set(covariance.names)
        machine = self.network.machine
        state = state_of(self.network.data, machine)
        found: dict[str, Column] = {}
        for effect in calibration.effects:
            names = [parameter.name for parameter in effect.parameters]
            if known.intersection(names):
                found |= dict(zip(names, of_effect(effect, machine, state), strict=True))
        values, vectors = np.linalg.eigh(covariance.matrix)
        strong = values > 1e-12 * max(float(values[-1]), 1e-300)
        return [found[name] for name in covariance.names], vectors[:, strong] * np.sqrt(values[strong])


def _flat(found: np.ndarray) -> np.ndarray:
    """(3·points, columns) of (points, 3, columns)."""
    return found.reshape(3 * len(found), found.shape[2])


def _root(gram: np.ndarray) -> np.ndarray:
    """R with R Rᵀ the inverse, over the directions that are there."""
    values, vectors = np.linalg.eigh(gram)
    there = values > LOST
    return np.asarray(vectors[:, there] / np.sqrt(values[there]))


def unwhitened_um(problem: Problem, residual: np.ndarray) -> np.ndarray:
    """(n, 3) µm of a (3n,) whitened residual; NaN where nothing was read."""
    found = unwhiten(problem, residual.reshape(-1, 3)[:, :, None])[:, :, 0]
    return np.where(problem.network.read, found * 1e6, np.nan)


def unwhiten(problem: Problem, whitened: np.ndarray, rows: Rows = slice(None)) -> np.ndarray:
    """(rows, 3, k) as it was before it was whitened; zero where nothing was read."""
    read = problem.network.read[rows]
    safe = np.where(read[:, :, None] & read[:, None, :], problem.network.whitening[rows], np.eye(3))
    return np.asarray(np.linalg.solve(safe, np.where(read[:, :, None], whitened, 0.0)))


def rms(values: np.ndarray, read: np.ndarray) -> float:
    """Of the coordinates that were read."""
    return float(np.sqrt(np.mean(values[read] ** 2)))
