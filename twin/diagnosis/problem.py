"""The least-squares problem of a diagnosis: whitened readings with the set-up and the calibration's uncertainty projected out.

The derivatives B by the set-up are projected out of the whitened residual r and of the signatures S, and so is the calibration's own
uncertainty, J·L, as directions with unit prior variance: xᵀMy = xᵀy − (Uᵀx)ᵀ(Uᵀy), where U is the readings' part of an orthonormal
basis of [B, J·L; 0, 1], held in coefficients (`twin.diagnosis.nuisance`). With some points held out the rest of the basis is
made orthonormal again by a factor: UᵀU + PᵀP is then the identity less the Gram matrix of the rows held out, where P is the prior's
part of the basis.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.diagnosis.candidates.candidate import Column, effect_columns
from twin.diagnosis.nuisance import Nuisance
from twin.diagnosis.signature_products import PointBlock, Signatures, side_by_side
from twin.identification.network import LinearisedReadings, Network
from twin.measurement.observation import machine_state
from twin.measurement.set_up import StationsAndTargets
from twin.model.calibration import Calibration
from twin.numerics.covariance import symmetric_root
from twin.numerics.functions import Rows, pieces

UNDETERMINED_SHARE: Final = 1e-12  # share of a direction in the remaining points below which they do not determine it

LOOSELY_PLACED: Final = 3.0
"""Standard uncertainty of a reading's place from the other readings, in that of a reading, above which they do not predict it."""


@final
@dataclass(frozen=True)
class InnerProducts:
    """Inner products of k columns."""

    gram: np.ndarray  # (k, k), set-up and calibration's uncertainty projected out
    slope: np.ndarray  # (k,) with the residual, likewise projected
    basis: np.ndarray  # (directions, k) with the nuisance basis
    by_nuisance: np.ndarray  # (raw, k) with the nuisance derivatives (`Nuisance.raw`)
    raw: np.ndarray  # (k, k) without projection
    with_residual: np.ndarray  # (k,) without projection


@final
class Problem:
    """Readings, set-up and calibration of one data set, linearised at the fitted set-up.

    The calibration's covariance is taken into account; none if None. The network has no unknowns.
    """

    def __init__(self, network: Network, setup: StationsAndTargets, calibration: Calibration | None) -> None:
        self.network = network
        self.setup = setup
        self.calibration = calibration
        self.view: LinearisedReadings = network.view(np.zeros(0), setup, np.arange(len(network.data)))
        self.residual = self.view.residual.reshape(-1)
        by_setup = np.zeros((len(setup), len(network.data), 3))
        network.fill_setup_columns(self.view, setup, by_setup.transpose(1, 2, 0))
        by_setup *= setup.plausible[:, None, None]
        flat = by_setup.reshape(len(setup), 3 * len(network.data)).T
        self.nuisances = Nuisance.of(self.view, flat, *self._calibration_columns(calibration))
        self._start()

    def _start(self) -> None:
        """Set everything that follows from the linearised readings and their nuisance parameters."""
        self.root = np.eye(len(self.nuisances.coordinates))
        self.held_out: np.ndarray = np.zeros(0, dtype=int)
        self.absorbed = len(self.nuisances.coordinates) - len(self.nuisances.prior)
        self.set_residual(self.residual)
        self.readings = int(np.count_nonzero(self.network.read))

    def with_random_effects(self, random: Sequence[tuple[Column, float]], variance_factor: float = 1.0) -> Problem:
        """Return the same readings with random effects (columns with standard deviations) added, and with scaled noise variances."""
        problem, scale = copy(self), 1.0 / float(np.sqrt(variance_factor))
        problem.network = self.network.with_variance_factor(variance_factor)
        problem.view = self.view.with_weights(scale)
        columns, deviations = [column for column, _ in random], np.array([deviation for _, deviation in random])
        problem.nuisances = self.nuisances.extended(problem.view, scale, columns, deviations)
        problem.residual = self.residual * scale
        problem._start()
        if len(self.held_out):
            problem = problem.without(np.isin(np.arange(len(self.view.rows)), self.held_out))
        return problem

    def without(self, points: np.ndarray) -> Problem:
        """Return the problem with some points (n,) held out."""
        part = copy(self)
        part.held_out = np.flatnonzero(points)
        gone = self.nuisances.gram(part.held_out)
        part.root = _root(np.eye(len(gone)) - gone)
        part.set_residual(self.residual)
        return part

    @property
    def placed_held_out(self) -> np.ndarray:
        """(held out,): whether the other readings place a held-out one to `LOOSELY_PLACED` times its own uncertainty in each direction.

        A station of which a few readings are left turns about them: an error of such a prediction says nothing about the machine.
        """
        setup = slice(self.nuisances.setup_count)
        left, turned = np.linalg.eigh(
            np.eye(self.nuisances.setup_count) - self.nuisances.gram(self.held_out)[setup, setup]
        )
        along = self.nuisances.rows(self.held_out)[:, :, setup] @ turned
        variance = np.sum(along**2 / np.maximum(left, UNDETERMINED_SHARE), axis=2)
        return np.asarray((variance <= LOOSELY_PLACED**2).all(axis=1))

    @property
    def nuisance(self) -> np.ndarray:
        """(3n, k) derivatives by the nuisance parameters: set-up (plausible sizes), calibration (root of its covariance)."""
        rows = self.nuisances.rows(slice(None))
        return np.asarray(rows.reshape(-1, rows.shape[2]) @ self.nuisances.coordinates)

    def orthonormal_on(self, points: np.ndarray) -> np.ndarray:
        """Return the factor (directions, k) that makes the basis orthonormal over a subset of the points (their numbers)."""
        return _root(self.nuisances.prior.T @ self.nuisances.prior + self.nuisances.gram(points))

    def set_residual(self, residual: np.ndarray) -> None:
        """Replace the whitened residual (3n,); the set-up stays."""
        self.residual = residual
        kept = self.zero_held_out(residual)
        self.residual_on_basis = self.nuisances.along(kept)
        within = self.root.T @ self.residual_on_basis
        self.chi2 = float(kept @ kept - within @ within)
        self._projected: np.ndarray | None = None

    @property
    def projected(self) -> np.ndarray:
        """(3n,) the residual with the set-up and the calibration's uncertainty projected out; held-out rows are zero."""
        if self._projected is None:
            self._projected = self.zero_held_out(self.residual - self.fitted(self.residual_on_basis))
        return self._projected

    def project(self, residual: np.ndarray) -> np.ndarray:
        """Return a (3n,) residual with the set-up and the calibration's uncertainty projected out; held-out rows are zero."""
        return self.zero_held_out(self.refit_setup(residual))

    def refit_setup(self, residual: np.ndarray) -> np.ndarray:
        """Return a (3n,) whitened residual, all rows, after fitting the set-up to the rows that are not held out."""
        return np.asarray(residual - self.fitted(self.nuisances.along(self.zero_held_out(residual))))

    def refitted_at_held_out(self, residual: np.ndarray) -> np.ndarray:
        """Return the held-out rows of `refit_setup` of (3n, k) residuals: (held out, 3, k)."""
        explained = self.fitted(self.nuisances.along(self.zero_held_out(residual)), self.held_out)
        at_points = residual.reshape(len(self.view.rows), 3, -1)[self.held_out]
        return np.asarray(at_points - explained.reshape(at_points.shape))

    def fitted(self, within: np.ndarray, points: np.ndarray | None = None) -> np.ndarray:
        """Return (3n, …) what the nuisance parameters explain of (directions, …) inner products with the basis, at points or all."""
        return self.nuisances.combined(self.root @ (self.root.T @ within), points)

    def setup_step(self, residual: np.ndarray) -> np.ndarray:
        """Return the change of the set-up's unknowns, in metres and radians, fitted to a (3n,) residual (minimum norm)."""
        size = np.maximum(np.linalg.norm(self.nuisances.coordinates, axis=0), 1e-300)
        moved = np.linalg.lstsq(self.nuisances.coordinates / size, self.nuisances.along(residual), rcond=1e-9)[0] / size
        return np.asarray(moved[: len(self.setup)] * self.setup.plausible)

    def zero_held_out(self, rows: np.ndarray) -> np.ndarray:
        """Return (3n, …) values with the held-out rows set to zero."""
        if len(self.held_out) == 0:
            return rows
        zero_held_out = np.array(rows)
        zero_held_out.reshape(len(self.view.rows), 3, -1)[self.held_out] = 0.0
        return zero_held_out

    @property
    def dof(self) -> int:
        """Degrees of freedom: readings less set-up parameters."""
        return self.readings - self.absorbed

    def signature(self, columns: Sequence[Column]) -> np.ndarray:
        """Return whitened signatures (3n, columns) in plausible sizes; each column is contiguous in memory."""
        signatures = np.empty((len(columns), len(self.residual)))
        own = Signatures(self.view, columns)
        for rows in pieces(len(self.view.rows)):
            signatures[:, 3 * rows.start : 3 * rows.stop] = _flat(own.at(PointBlock(self.view, rows))).T
        return signatures.T

    def products(self, columns: Sequence[Column]) -> InnerProducts:
        """Return the inner products of some columns, computed in blocks of points."""
        own = Signatures(self.view, columns)
        keep = np.ones(len(self.view.rows), dtype=bool)
        keep[self.held_out] = False
        residual = self.residual.reshape(-1, 3)

        def vectors(block: PointBlock) -> np.ndarray:
            return side_by_side(own.at(block), self.nuisances.raw(block), residual[block.rows, :, None])

        points = None if keep.all() else np.flatnonzero(keep)
        along = own.along(vectors, points)[0]
        raw, by_nuisance, slope = along[:, : len(columns)], along[:, len(columns) : -1].T, along[:, -1]
        basis = self.nuisances.from_raw(by_nuisance)
        within = self.root.T @ basis
        gram, left = raw - within.T @ within, slope - within.T @ (self.root.T @ self.residual_on_basis)
        return InnerProducts(gram, left, basis, by_nuisance, raw, slope)

    def inner(self, a: np.ndarray) -> np.ndarray:
        """Return the projected inner products aᵀMa of signatures."""
        a, within = self._kept_and_absorbed(a)
        return np.asarray(a.T @ a - within.T @ within)

    def normal_equations(self, a: np.ndarray, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the projected inner products aᵀMa of signatures (3n, k), and aᵀMr with a residual (3n,)."""
        (a, within), (residual, of_residual) = self._kept_and_absorbed(a), self._kept_and_absorbed(residual)
        return np.asarray(a.T @ a - within.T @ within), np.asarray(a.T @ residual - within.T @ of_residual)

    def _kept_and_absorbed(self, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (3n, …) vectors without the held-out rows, and the coordinates of the share that the nuisance parameters absorb."""
        a = self.zero_held_out(a)
        return a, self.root.T @ self.nuisances.along(a)

    def _calibration_columns(self, calibration: Calibration | None) -> tuple[list[Column], np.ndarray]:
        """Return the columns of the calibration's parameters, and the symmetric root of their covariance."""
        if calibration is None or not calibration.covariance.names:
            return [], np.zeros((0, 0))
        covariance = calibration.covariance
        known = set(covariance.names)
        machine = self.network.machine
        state = machine_state(self.network.data, machine)
        by_name: dict[str, Column] = {}
        for effect in calibration.effects:
            names = [parameter.name for parameter in effect.parameters]
            if known.intersection(names):
                by_name |= dict(zip(names, effect_columns(effect, machine, state), strict=True))
        return [by_name[name] for name in covariance.names], symmetric_root(covariance.matrix)


def _flat(found: np.ndarray) -> np.ndarray:
    """Reshape (points, 3, columns) to (3·points, columns)."""
    return found.reshape(3 * len(found), found.shape[2])


def _root(gram: np.ndarray) -> np.ndarray:
    """Return R with R Rᵀ the pseudo-inverse, over eigenvalues above `UNDETERMINED_SHARE`."""
    values, vectors = np.linalg.eigh(gram)
    positive = values > UNDETERMINED_SHARE
    return np.asarray(vectors[:, positive] / np.sqrt(values[positive]))


def in_um(network: Network, residual: np.ndarray) -> np.ndarray:
    """Return a (3n,) residual whitened by a network's weights in µm (n, 3); NaN where a coordinate was not measured."""
    residual_um = unwhiten(network, residual.reshape(-1, 3)[:, :, None])[:, :, 0]
    return np.where(network.read, residual_um * 1e6, np.nan)


def unwhiten(network: Network, whitened: np.ndarray, rows: Rows = slice(None)) -> np.ndarray:
    """Undo the whitening of (rows, 3, k) values; zero where a coordinate was not measured."""
    read = network.read[rows]
    safe = np.where(read[:, :, None] & read[:, None, :], network.whitening[rows], np.eye(3))
    return np.asarray(np.linalg.solve(safe, np.where(read[:, :, None], whitened, 0.0)))


def rewhitened(signature: np.ndarray, before: Network, after: Network) -> np.ndarray:
    """Return (3n, …) values whitened by a network's weights with those of another network of the same readings."""
    if before is after:
        return signature
    plain = unwhiten(before, signature.reshape(len(before.data), 3, -1))
    return np.asarray(np.einsum("nij,njk->nik", after.whitening, plain)).reshape(signature.shape)


def rms(values: np.ndarray, read: np.ndarray) -> float:
    """Return the root mean square of the coordinates that were measured."""
    return float(np.sqrt(np.mean(values[read] ** 2)))


@final
class Products:
    """Inner products of columns within groups, with a problem's basis and residual, and on demand with each other; without projection.

    Args:
        problem: the problem that gives rows, basis and residual; none of its rows held out.
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
        self._some_beside: dict[tuple[Column, ...], tuple[np.ndarray, np.ndarray]] = {}
        self._latest = np.zeros(0, dtype=int), np.zeros((len(self._residual), 0))
        self._residual_along: dict[tuple[Column, ...], np.ndarray] = {}
        self._within = self.signatures.within(groups, points)
        self._by_raw, self._by_residual = self._with_problem(points)
        # (parts, all) for each requested column.
        self._cross: list[np.ndarray] = []
        self._row = np.full(len(columns), -1)
        self._changed = np.zeros(0, dtype=int)
        self.within = [own.sum(axis=0) for own in self._within]
        self.by_raw, self.by_residual = self._by_raw.sum(axis=0), self._by_residual.sum(axis=0)

    def without(self, points: np.ndarray) -> Products:
        """Return the inner products without some points (ascending): only these are evaluated, none if they are one of the parts."""
        other = copy(self)
        part = None if self._parts is None else int(self._parts[points[0]])
        # Sums by part do not hold for columns that were refined since.
        unrefined = all(column is first for column, first in zip(self.columns, self._original_columns, strict=True))
        if part is not None and unrefined and np.array_equal(points, np.flatnonzero(self._parts == part)):
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
        """Return the inner products for the same readings with random effects and a factor on the weights; no pass over the points."""
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
        self._cross, self._changed, self._beside, self._some_beside = [], self._changed[:0], {}, {}
        self._latest, self._residual_along = (self._latest[0][:0], self._latest[1][:, :0]), {}
        self._row = np.full_like(self._row, -1)

    def on_basis(self, root: np.ndarray) -> np.ndarray:
        """Return the inner products (k, all) with vectors of coordinates (directions, k) in the nuisance basis."""
        return self._problem.nuisances.from_raw(self.by_raw, root)

    @property
    def columns(self) -> Sequence[Column]:
        """Columns of signatures, refined ones included."""
        return self.signatures.columns

    def with_vectors(self, vectors: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return inner products (all, r) with (3·points, r) vectors at some points, in ascending order."""
        right, every = vectors.reshape(len(points), 3, -1), len(points) == len(self._problem.view.rows)

        def at(block: PointBlock) -> np.ndarray:
            return right[block.rows if every else np.searchsorted(points, np.asarray(block.rows))]

        return np.asarray(self.signatures.along(at, None if every else points, by_part=False)[0])

    def set_residual(self, residual: np.ndarray) -> None:
        """Replace the residual (3n,)."""
        if residual is not self._residual and not np.array_equal(residual, self._residual):
            kept = self._kept(residual)
            self._by_residual = self.signatures.along(lambda block: kept[block.rows])[:, :, 0]
            self.by_residual = self._by_residual.sum(axis=0)
            self._residual_along = {}
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

    def with_groups(self, groups: Sequence[tuple[Column, ...]], which: np.ndarray | None) -> np.ndarray:
        """Return the inner products (k, which) of the k columns of groups of any columns with some (their numbers) or all; cached."""
        if which is None:
            return self.with_columns([column for group in groups for column in group])
        return np.concatenate([self._parts_with_some(group, which).sum(axis=0) for group in groups])

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
            along = self.signatures.along(Signatures(self._problem.view, fresh).at)
            self._beside |= {column: np.array(along[:, :, k]) for k, column in enumerate(fresh)}
        return [self._beside[column] for column in columns]

    def _parts_with_some(self, columns: tuple[Column, ...], which: np.ndarray) -> np.ndarray:
        """Return the inner products by part (parts, columns, which); a single part where points are held out."""
        if self._parent is not None and self._parent[1] is not None:
            whole, gone, _ = self._parent
            every = whole._parts_with_some(columns, which)
            lost = every[gone] if isinstance(gone, int) else self._evaluated_with_some(columns, which, gone)[0]
            return np.asarray(every.sum(axis=0) - lost)[None]
        if all(column in self._beside for column in columns):
            return np.stack([self._beside[column][:, which] for column in columns], axis=1)
        known, found = self._some_beside.get(columns, (which[:0], None))
        fresh = np.setdiff1d(which, known)
        if found is None or len(fresh):
            made = self._evaluated_with_some(columns, fresh, None)
            known, found = np.append(known, fresh), made if found is None else np.concatenate([found, made], axis=2)
            self._some_beside[columns] = known, found
        order = np.argsort(known)
        return np.asarray(found[:, :, order[np.searchsorted(known, which, sorter=order)]])

    def _evaluated_with_some(
        self, columns: Sequence[Column], which: np.ndarray, points: np.ndarray | None
    ) -> np.ndarray:
        """Return what `_parts_with_some` does, over all points by part or over some as one part.

        The signatures of the latest numbers are kept: several patterns are tested beside the same causes.
        """
        if not np.isin(which, self._latest[0]).all():
            self._latest = np.unique(which), self._problem.signature([self.columns[i] for i in np.unique(which)])
        vectors = self._latest[1][:, np.searchsorted(self._latest[0], which)]
        own = Signatures(self._problem.view, columns, self._parts)
        at_points = vectors.reshape(len(vectors) // 3, 3, len(which))
        return own.along(lambda block: at_points[block.rows], points)

    def among(self, groups: Sequence[tuple[Column, ...]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the inner products (k, k) of the k columns of groups, (raw, k) with the nuisance derivatives, (k,) with the residual.

        Those of a group with another and with the nuisance derivatives are kept with the problem.
        """
        view, residual = self._problem.view, self._kept(self._residual)
        ends = np.cumsum([0, *map(len, groups)])
        gram, by_nuisance = np.zeros((ends[-1], ends[-1])), np.zeros((self._problem.nuisances.raw_count, ends[-1]))
        by_residual = np.zeros(ends[-1])
        for i, own in enumerate(groups):
            at = slice(ends[i], ends[i + 1])
            *inner, raw = (parts.sum(axis=0) for parts in self._parts_among(own, [*groups[: i + 1], None]))
            for k, block in enumerate(inner):
                other = slice(ends[k], ends[k + 1])
                gram[at, other], gram[other, at] = block, block.T
            by_nuisance[:, at] = raw.T
            if own not in self._residual_along:
                self._residual_along[own] = Signatures(view, own).along(lambda block: residual[block.rows])[0, :, 0]
            by_residual[at] = self._residual_along[own]
        return gram, by_nuisance, by_residual

    def _parts_among(
        self, own: tuple[Column, ...], others: Sequence[tuple[Column, ...] | None]
    ) -> Sequence[np.ndarray]:
        """Return the inner products by part (parts, own, other) of a group with others, or with the nuisance derivatives (None).

        A single part where points are held out.
        """
        if self._parent is not None and self._parent[1] is not None:
            whole, gone, _ = self._parent
            every = whole._parts_among(own, others)
            if isinstance(gone, int):
                lost = [parts[gone] for parts in every]
            else:
                lost = [parts[0] for parts in whole._evaluated_among(own, others, gone)]
            return [(parts.sum(axis=0) - less)[None] for parts, less in zip(every, lost, strict=True)]
        known, parts = self._problem.nuisances.known, None if self._parts is None else self._parts.tobytes()
        fresh = [other for other in others if ("among", parts, own, other) not in known]
        if fresh:
            for other, found in zip(fresh, self._evaluated_among(own, fresh, None), strict=True):
                known["among", parts, own, other] = found
        return [known["among", parts, own, other] for other in others]

    def _evaluated_among(
        self, own: tuple[Column, ...], others: Sequence[tuple[Column, ...] | None], points: np.ndarray | None
    ) -> Sequence[np.ndarray]:
        """Return what `_parts_among` does, over all points by part or over some as one part."""
        nuisances, signatures = self._problem.nuisances, Signatures(self._problem.view, own, self._parts)
        vectors = [
            nuisances.raw
            if other is None
            else signatures.at
            if other is own
            else Signatures(self._problem.view, other).at
            for other in others
        ]
        along = signatures.along(lambda block: side_by_side(*(of(block) for of in vectors)), points)
        widths = [nuisances.raw_count if other is None else len(other) for other in others]
        return np.split(along, np.cumsum(widths)[:-1], axis=2)

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
        """Replace the columns of one group, whose indices ``at`` are in order, by as many."""
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
        self._beside, self._some_beside, self._latest = {}, {}, (self._latest[0][:0], self._latest[1][:, :0])
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

        along = self.signatures.along(vectors, points)
        return along[:, :, :-1].transpose(0, 2, 1), along[:, :, -1].copy()


def _stacked(rows: Sequence[np.ndarray], width: int) -> np.ndarray:
    """Return rows (width,) as an array (rows, width), also if there are none."""
    return np.stack(rows) if rows else np.zeros((0, width))
