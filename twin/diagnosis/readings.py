"""The readings of a diagnosis: with fitted set-up, measurement noise and outliers.

Where neither table nor instrument states the noise, it is estimated from repeats or residuals. Before repeats are compared, all effects
that may change between them are removed by regression; otherwise a drift would be counted as noise and hide itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.distributions import chi2_isf, chi2_sf
from twin._common.messages import Message
from twin._common.units import MM
from twin.diagnosis.candidates import catalogue
from twin.diagnosis.candidates.candidate import Candidate, Catalogue, Column
from twin.diagnosis.problem import Problem
from twin.diagnosis.signature_products import signatures_of
from twin.identification.discrepancy import Discrepancy, no_discrepancy, outlier_notes, outliers
from twin.identification.inputs import prepare
from twin.identification.network import LinearisedReadings, Network, Unknowns, stated_covariance
from twin.identification.solve import SIGNIFICANCE, repeats_of, solve
from twin.machine.machine import Machine
from twin.measurement.columns import RowNote
from twin.measurement.instruments import Instrument
from twin.measurement.instruments.base import along_and_across
from twin.measurement.observation import repeat_groups
from twin.measurement.set_up import StationsAndTargets, turned_about_the_axis
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

LEAST_DOF: Final = 20  # degrees of freedom below which no noise is estimated
ITERATIONS: Final = 3  # iterations of the weights along and across the beam
ROUNDING: Final = 1e-9  # share of a regressor's norm below which its variation between repeats is rounding


@final
@dataclass(frozen=True)
class ReadingNoise:
    """Noise covariance of the readings."""

    covariance: np.ndarray  # (n, 3, 3) m²
    dof: float  # of the estimate; infinite where the covariance is given
    source: str  # in words


def _noise_of_repeats(
    network: Network, view: LinearisedReadings, known: Sequence[Candidate], seen: np.ndarray
) -> ReadingNoise | None:
    """Return the noise at points ``seen`` (m, 3), along and across the beam, estimated from repeats; None if they are too few.

    The linearisation of the points used may have any isotropic whitening, which is undone here.
    """
    group = repeat_groups(network.data.select(view.rows))
    size = np.bincount(group)
    repeated = size[group] > 1
    if np.sum(np.maximum(size - 1, 0)) < LEAST_DOF // 2:
        return None
    columns: list[Column] = [
        column
        for candidate in known
        if candidate.specification.varies != "never"
        for variant in candidate.variants[:: max(len(candidate.variants) // 4, 1)]
        for column in variant.columns
    ]
    values = _deviations_and_regressors(network, view, signatures_of(view, columns))
    total = np.zeros((len(size), *values.shape[1:]))
    np.add.at(total, group, values)
    norm = np.linalg.norm(values, axis=(0, 1))
    values = (values - total[group] / size[group][:, None, None]) * repeated[:, None, None]
    # A regressor that is the same in all repeats keeps rounding only.
    values[:, :, 1:] *= np.linalg.norm(values, axis=(0, 1))[1:] > ROUNDING * norm[1:]
    dof = float(np.sum(np.where(repeated, 1.0 - 1.0 / size[group], 0.0)))
    return _noise_of(values, dof, network.read[view.rows], view.seen, seen, Message("repeats"))


def _noise_of_residuals(
    network: Network, setup: StationsAndTargets, view: LinearisedReadings, known: Sequence[Candidate], seen: np.ndarray
) -> ReadingNoise | None:
    """Return the noise along and across the beam from the residuals of a regression on set-up and main form of every cause.

    For readings without uncertainties, instrument or repeats. If an effect has none of these forms the noise is overestimated, so
    that causes are missed rather than invented. None if too few degrees of freedom remain. Arguments as for `_noise_of_repeats`.
    """
    columns = [column for candidate in known for column in _main_columns(candidate)]
    by_setup = np.zeros((len(view.rows), 3, len(setup)))
    network.fill_setup_columns(view, setup, by_setup)
    values = _deviations_and_regressors(network, view, by_setup * setup.plausible, signatures_of(view, columns))
    source = Message("the residuals of a fit of every cause")
    return _noise_of(values, float(len(view.rows)), network.read[view.rows], view.seen, seen, source)


def _deviations_and_regressors(network: Network, view: LinearisedReadings, *regressors: np.ndarray) -> np.ndarray:
    """Return (n, 3, k) m: the residuals, then (n, 3, …) regressors, without whitening; zero where a coordinate was not measured."""
    read = network.read[view.rows]
    raw = np.linalg.inv(np.where(read[:, :, None] & read[:, None, :], view.whitening, np.eye(3)))
    values = np.einsum("nij,njk->nik", raw, np.concatenate([view.residual[:, :, None], *regressors], axis=2))
    return np.asarray(values * read[:, :, None])


def _main_columns(candidate: Candidate) -> tuple[Column, ...]:
    """Return a candidate's main columns: the widest curve, the lowest harmonics, else the first forms; none if others have the same."""
    count = candidate.specification.plain_forms
    if count is not None:
        return tuple(column for variant in candidate.variants[:count] for column in variant.columns)
    return max(candidate.variants, key=lambda variant: len(variant.columns)).columns


def _noise_of(
    values: np.ndarray, dof_each: float, read: np.ndarray, points: np.ndarray, seen: np.ndarray, source: str
) -> ReadingNoise | None:
    """Return the noise along and across the beam, after regression; None with fewer than `LEAST_DOF` degrees of freedom.

    ``values`` (n, 3, k), m: deviations, then regressors, with ``dof_each`` degrees of freedom in each direction before it.
    """
    if not read[:, 1:].any():
        residual, basis = _regressed(values)
        dof = dof_each - float(np.sum(basis[:, 0] ** 2))
        if dof < LEAST_DOF:
            return None
        covariance = np.zeros((len(seen), 3, 3))
        covariance[:, 0, 0] = np.sum(residual[:, 0] ** 2) / dof
        size = np.sqrt(covariance[0, 0, 0]) * 1e6
        text = Message("{source}: {size:.2g} µm ({dof:.0f} degrees of freedom)", source=source, size=size, dof=dof)
        return ReadingNoise(read_only(covariance), dof, text)
    if not read.all():
        # An instrument that measures two coordinates is no tracker: the same noise in both.
        return _isotropic(values, dof_each * np.count_nonzero(read) / len(read), len(seen), source)
    beam = points / np.linalg.norm(points, axis=1, keepdims=True)
    along_u = across_u = 1.0
    for _ in range(ITERATIONS):
        # Weighted by the noise: unweighted, the residuals across the beam would dominate those along it.
        lengths = np.einsum("ni,nik->nk", beam, values)[:, None, :] * beam[:, :, None]
        residual, basis = _regressed(lengths / along_u + (values - lengths) / across_u)
        along = np.einsum("ni,ni->n", residual, beam)
        dof_used = float(np.sum(np.einsum("nik,ni->nk", basis, beam) ** 2))
        dof_along = dof_each - dof_used
        dof_across = 2.0 * dof_each - (basis.shape[2] - dof_used)
        if dof_along < LEAST_DOF:
            return _isotropic(values, 3.0 * dof_each, len(seen), source)
        along_u *= float(np.sqrt(np.sum(along**2) / dof_along))
        across_u *= float(np.sqrt((np.sum(residual**2) - np.sum(along**2)) / dof_across))
    if abs(np.log(along_u / across_u)) < 3.0 * np.sqrt(0.5 / dof_along + 0.5 / dof_across):
        # Isotropic within the uncertainty: one pooled value has more degrees of freedom.
        residual, basis = _regressed(values)
        along_u = across_u = float(np.sqrt(np.sum(residual**2) / (3.0 * dof_each - basis.shape[2])))
    dof = dof_along + dof_across
    text = Message(
        "{source}: {along:.2g} µm along the beam, {across:.2g} µm across ({dof:.0f} degrees of freedom)",
        source=source,
        along=along_u * 1e6,
        across=across_u * 1e6,
        dof=dof,
    )
    covariance = along_and_across(seen, np.full(len(seen), along_u), np.full(len(seen), across_u))
    return ReadingNoise(read_only(covariance), dof, text)


def _isotropic(values: np.ndarray, dof: float, points: int, source: str) -> ReadingNoise | None:
    """Return the noise that is the same in all coordinates, from ``dof`` degrees of freedom before regression (`_noise_of`)."""
    residual, basis = _regressed(values)
    dof -= basis.shape[2]
    if dof < LEAST_DOF:
        return None
    sigma = float(np.sqrt(np.sum(residual**2) / dof))
    text = Message(
        "{source}: {size:.2g} µm a coordinate ({dof:.0f} degrees of freedom)", source=source, size=sigma * 1e6, dof=dof
    )
    return ReadingNoise(read_only(np.tile(sigma**2 * np.eye(3), (points, 1, 1))), dof, text)


def _regressed(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Regress the first of (n, 3, k) columns on the others, if any: return residuals (n, 3) and an orthonormal basis (n, 3, m)."""
    flat = values.reshape(-1, values.shape[2])
    scale = np.maximum(np.linalg.norm(flat[:, 1:], axis=0), 1e-30)
    others = flat[:, 1:] / scale
    eigenvalues, vectors = np.linalg.eigh(others.T @ others)
    seen = eigenvalues > 1e-12 * max(float(eigenvalues[-1]), 1e-300) if len(eigenvalues) else np.zeros(0, dtype=bool)
    # Orthonormalised again by QR: the normal matrix loses half the digits.
    basis, _ = np.linalg.qr(others @ (vectors[:, seen] / np.sqrt(eigenvalues[seen])))
    residual = flat[:, 0] - basis @ (basis.T @ flat[:, 0])
    return residual.reshape(len(values), 3), basis.reshape(len(values), 3, basis.shape[1])


PLACING_ITERATIONS: Final = 4
TURN_STEPS: Final = 15  # steps of the fit from each turn of the set-up: which is the best shows soon
TURNS: Final = (
    tuple(np.arange(1, 8) * np.pi / 4.0),
    *((-width, width) for width in np.pi / 2.0 ** np.arange(3, 10)),
)
"""Turns of the set-up about the only axis that moved that are tried one after the other, rad: all round, then closer to the best."""
"""Repetitions of fit and outlier test, at most."""


@final
@dataclass(frozen=True, eq=False)
class DiagnosisTask:
    """One diagnosis: data, candidate causes and noise."""

    problem: Problem  # the rows used, whitened by noise and discrepancy
    catalogue: Catalogue
    noise: ReadingNoise  # of these rows
    by_noise: Problem  # the same rows, whitened by their noise alone, for tests of consistency
    discrepancy: Discrepancy  # what the causes selected before leave beyond the noise; none at first

    def with_discrepancy(self, discrepancy: Discrepancy) -> DiagnosisTask:
        """Return the same task with another discrepancy in the weights."""
        network = self.by_noise.network.with_discrepancy(discrepancy.root)
        weighted = Problem(network, self.by_noise.setup, self.by_noise.calibration)
        return replace(self, problem=weighted, discrepancy=discrepancy)


@final
@dataclass(frozen=True, eq=False)
class Readings:
    """All rows, with the set-up fitted to the good ones."""

    network: Network  # whitened by this noise
    setup: StationsAndTargets
    bad: np.ndarray  # (n,) whether a row is an outlier if the model is right and there is only noise
    noise: ReadingNoise  # of all rows
    calibration: Calibration  # the model under test

    def select_rows(self, rows: np.ndarray, notes: Sequence[RowNote] = ()) -> Readings:
        """Return some of the rows, with the set-up fitted to all, and notes on those left out."""
        network, covariance = self.network, read_only(np.array(self.noise.covariance[rows]))
        data = network.data.select(rows)
        data = replace(data, set_aside=(*data.set_aside, *notes))
        fewer = Network(network.machine, data, network.instruments, network.unknowns, self.calibration, covariance)
        return replace(self, network=fewer, bad=self.bad[rows], noise=replace(self.noise, covariance=covariance))

    def without(self, bad: np.ndarray) -> DiagnosisTask:
        """Return the diagnosis task without some rows (n,), which are listed in its data with the reason."""
        kept, network = self, self.network
        if np.any(bad):
            difference = network.residuals_m(np.zeros(0), self.setup, np.arange(len(network.data)))
            notes = outlier_notes(network, difference, network.residual(np.zeros(0), self.setup), bad)
            kept = self.select_rows(np.flatnonzero(~bad), notes)
        known = catalogue(network.machine, kept.network.data, self.calibration, network.instruments)
        problem = Problem(kept.network, self.setup, self.calibration)
        return DiagnosisTask(problem, known, kept.noise, problem, no_discrepancy(kept.network))


def readings(
    data: Measurements, machine: Machine, calibration: Calibration, instrument: Instrument | None = None
) -> Readings:
    """Fit stations and targets, and determine the measurement noise and the outliers.

    Without an instrument the table's uncertainties are taken, or estimated from repeats. If repeats contradict either, they decide.

    Raises:
        InputError: data that cannot be a measurement of this machine.
    """
    instruments, data, setup = prepare(machine, data, instrument)
    if instrument is not None:
        data = replace(data, instrument=read_only(np.where(data.instrument == "", instrument.name, data.instrument)))
    has_u = bool(np.isfinite(data.u_mm).any())
    if has_u:
        source = Message("the table's uncertainties")
    elif instrument is not None:
        source = Message("the noise model of the {name}", name=instruments.name)
    else:
        source = Message(
            "the noise model of the {name}, assumed: no uncertainties stated, too few repeats", name=instruments.name
        )
    noise = stated = ReadingNoise(stated_covariance(data, instruments), np.inf, source)
    is_stated = instrument is not None or has_u
    contradicted = is_stated and any(
        repeats.contradict for repeats in repeats_of(machine, data, instruments, stated.covariance)
    )
    if not is_stated or contradicted:
        noise = replace(stated, covariance=_isotropic_from_repeats(data, stated.covariance))

    def placed(noise: ReadingNoise, setup: StationsAndTargets) -> Readings:
        network = Network(machine, data, instruments, Unknowns(machine, (), ()), calibration, noise.covariance)
        return Readings(network, *_setup_without_outliers(network, setup), noise, calibration)

    first = placed(noise, setup)
    if is_stated and not contradicted:
        return first
    network, setup = first.network, first.setup
    known = catalogue(machine, data, calibration, instruments).candidates
    view = network.view(np.zeros(0), setup, np.flatnonzero(~first.bad))
    seen = network.view(np.zeros(0), setup, np.arange(len(data))).seen
    estimated = _noise_of_repeats(network, view, known, seen)
    if estimated is None:
        estimated = _noise_of_residuals(network, setup, view, known, seen)
    if estimated is None:
        return first
    if contradicted:
        # If it is not larger, only a known effect that changes between repeats made them vary.
        larger = _larger(estimated, stated.covariance, network.read)
        both = Message("{source}; they contradict {figures}", source=estimated.source, figures=source)
        estimated = replace(estimated, source=both) if larger else stated
    return placed(estimated, setup)


def _larger(estimated: ReadingNoise, stated: np.ndarray, read: np.ndarray) -> bool:
    """Return whether an estimated noise is larger than the stated (n, 3, 3) covariance by more than its own uncertainty."""
    safe = stated + np.eye(3) * ~read[:, None, :]
    ratio = np.einsum("nii->n", np.linalg.solve(safe, np.where(read[:, None, :], estimated.covariance, 0.0)))
    mean = float(np.sum(ratio) / np.count_nonzero(read))
    return float(chi2_sf(mean * estimated.dof, estimated.dof)) < SIGNIFICANCE


def _isotropic_from_repeats(data: Measurements, stated: np.ndarray) -> np.ndarray:
    """Return an isotropic covariance (n, 3, 3) from the median distance of repeats, for a first outlier test; ``stated`` without them.

    The instrument's noise model is not suitable for this test: it is many times smaller along the beam than across, and data with
    isotropic noise would appear full of outliers.
    """
    group = repeat_groups(data)
    size = np.bincount(group)
    if np.sum(np.maximum(size - 1, 0)) < LEAST_DOF // 2:
        return stated
    points = np.where(np.isfinite(data.point_mm), data.point_mm, 0.0) * MM
    mean = np.stack([np.bincount(group, points[:, i]) / size for i in range(3)], axis=1)
    repeated = size[group] > 1
    deviation = (points - mean[group])[repeated] / np.sqrt(1.0 - 1.0 / size[group][repeated])[:, None]
    dimensions = int(np.isfinite(data.point_mm).any(axis=0).sum())
    sigma = float(np.sqrt(np.median(np.sum(deviation**2, axis=1)) / chi2_isf(0.5, dimensions)))
    if sigma <= 0.0:
        return stated
    return read_only(np.where(stated != 0.0, 1.0, 0.0) * np.eye(3) * sigma**2)


def _likeliest(network: Network, setup: StationsAndTargets) -> StationsAndTargets:
    """Return the set-up that fits best of those that the nominal machine does not distinguish."""
    zero, weight = np.zeros(0), np.ones(len(network.data))
    best = solve(network, zero, setup, weight)
    if best.converged and best.chi2 < chi2_isf(SIGNIFICANCE, network.read.sum()):
        return best.setup
    for angles in TURNS:
        starts = turned_about_the_axis(network.machine, network.data, best.setup, angles)
        fits = [solve(network, zero, start, weight, steps=TURN_STEPS) for start in starts]
        best = min((best, *fits), key=lambda fit: fit.chi2)
    return best.setup


def _setup_without_outliers(network: Network, setup: StationsAndTargets) -> tuple[StationsAndTargets, np.ndarray]:
    """Return the set-up fitted without outliers, and (n,) whether a row is one."""
    bad = np.zeros(len(network.data), dtype=bool)
    setup = _likeliest(network, setup)
    for _ in range(PLACING_ITERATIONS):
        setup = solve(network, np.zeros(0), setup, (~bad).astype(float)).setup
        outlying = outliers(network, network.residual(np.zeros(0), setup))
        if np.array_equal(outlying, bad):
            break
        bad = outlying
    return setup, bad
