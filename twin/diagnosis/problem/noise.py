"""Measurement noise of the readings, estimated from repeats or from residuals where neither table nor instrument states it.

Before repeats are compared, all effects that may change between them (a frame, a target, time, temperature) are removed by
regression; otherwise a drift would be counted as noise and hide itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin.diagnosis.candidates.candidate import Candidate
from twin.diagnosis.candidates.signatures import Column
from twin.diagnosis.problem.signature_products import signatures_of
from twin.identification.network import LinearisedReadings, Network
from twin.identification.setup import SetUp
from twin.measurement.instruments.base import along_and_across
from twin.measurement.state import repeat_groups
from twin.measurement.table import Measurements

LEAST_DOF: Final = 20
"""Degrees of freedom below which no noise is estimated."""
ITERATIONS: Final = 3
"""Iterations of the weights along and across the beam."""


@final
@dataclass(frozen=True)
class ReadingNoise:
    """Noise covariance of the readings.

    Attributes:
        covariance: (n, 3, 3) m².
        dof: degrees of freedom of the estimate; infinite where the covariance is given.
        source: where it comes from, in words.
    """

    covariance: np.ndarray
    dof: float
    source: str


def from_repeats(
    data: Measurements, view: LinearisedReadings, read: np.ndarray, known: tuple[Candidate, ...], seen: np.ndarray
) -> ReadingNoise | None:
    """Return the noise along and across the beam estimated from repeats; None if they are too few.

    Args:
        data: the measurements.
        view: their linearisation, with any isotropic whitening, which is undone here.
        read: (n, 3) whether a coordinate was measured.
        known: the candidate causes.
        seen: (m, 3) the points, in their stations' frames, whose covariance is returned.
    """
    group = repeat_groups(data)
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
    raw = np.linalg.inv(np.where(read[:, :, None] & read[:, None, :], view.whitening, np.eye(3)))
    nuisance = signatures_of(view, columns)
    values = np.einsum("nij,njk->nik", raw, np.concatenate([view.residual[:, :, None], nuisance], axis=2))
    values *= read[:, :, None]
    total = np.zeros((len(size), *values.shape[1:]))
    np.add.at(total, group, values)
    values = (values - total[group] / size[group][:, None, None]) * repeated[:, None, None]
    dof = float(np.sum(np.where(repeated, 1.0 - 1.0 / size[group], 0.0)))
    return _estimated(values, dof, view, read, seen, "repeats")


def from_residuals(
    network: Network, setup: SetUp, view: LinearisedReadings, known: tuple[Candidate, ...], seen: np.ndarray
) -> ReadingNoise | None:
    """Return the noise along and across the beam from the residuals of a regression on the main form of every cause.

    For readings without uncertainties, instrument or repeats. If an effect has none of these forms the noise is overestimated, so
    that causes are missed rather than invented. None if too few degrees of freedom remain.

    Args:
        network: data and model.
        setup: the fitted set-up; its unknowns are among the regressors.
        view: linearisation of the points used, with any isotropic whitening, which is undone here.
        known: the candidate causes.
        seen: (m, 3) the points, in their stations' frames, whose covariance is returned.
    """
    columns = [column for candidate in known for column in _main_columns(candidate)]
    by_setup = np.zeros((len(view.rows), 3, len(setup)))
    network.fill_setup_columns(view, setup, by_setup)
    read = network.read[view.rows]
    basis = signatures_of(view, columns)
    raw = np.linalg.inv(np.where(read[:, :, None] & read[:, None, :], view.whitening, np.eye(3)))
    values = np.einsum(
        "nij,njk->nik", raw, np.concatenate([view.residual[:, :, None], by_setup * setup.plausible, basis], axis=2)
    )
    values *= read[:, :, None]
    return _estimated(values, float(len(view.rows)), view, read, seen, "the residuals of a fit of every cause")


def _main_columns(candidate: Candidate) -> tuple[Column, ...]:
    """Return a candidate's main columns: the widest curve, the lowest harmonics, else the first forms; none if others have the same."""
    count = candidate.specification.plain_forms
    if count is not None:
        return tuple(column for variant in candidate.variants[:count] for column in variant.columns)
    return max(candidate.variants, key=lambda variant: len(variant.columns)).columns


def _estimated(
    values: np.ndarray, dof_each: float, view: LinearisedReadings, read: np.ndarray, seen: np.ndarray, source: str
) -> ReadingNoise | None:
    """Return the noise along and across the beam, after regression; None with fewer than `LEAST_DOF` degrees of freedom.

    Args:
        values: (n, 3, k) m: the deviations, then the regressors.
        dof_each: degrees of freedom in each direction before the regression.
        view: linearisation of the points.
        read: (n, 3) whether a coordinate was measured.
        seen: (m, 3) the points whose covariance is returned.
        source: where the deviations come from, in words.
    """
    if not read[:, 1:].any():
        residual, basis = _regressed(values)
        dof = dof_each - float(np.sum(basis[:, 0] ** 2))
        if dof < LEAST_DOF:
            return None
        found = np.zeros((len(seen), 3, 3))
        found[:, 0, 0] = np.sum(residual[:, 0] ** 2) / dof
        return ReadingNoise(
            read_only(found), dof, f"{source}: {np.sqrt(found[0, 0, 0]) * 1e6:.2g} µm ({dof:.0f} degrees of freedom)"
        )
    if not read.all():
        # An instrument that measures two coordinates is no tracker: the same noise in both.
        residual, basis = _regressed(values)
        dof = dof_each * np.count_nonzero(read) / len(read) - basis.shape[2]
        if dof < LEAST_DOF:
            return None
        sigma = float(np.sqrt(np.sum(residual**2) / dof))
        text = f"{source}: {sigma * 1e6:.2g} µm a coordinate ({dof:.0f} degrees of freedom)"
        return ReadingNoise(read_only(np.tile(sigma**2 * np.eye(3), (len(seen), 1, 1))), dof, text)
    beam = view.seen / np.linalg.norm(view.seen, axis=1, keepdims=True)
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
            return None
        along_u *= float(np.sqrt(np.sum(along**2) / dof_along))
        across_u *= float(np.sqrt((np.sum(residual**2) - np.sum(along**2)) / dof_across))
    if abs(np.log(along_u / across_u)) < 3.0 * np.sqrt(0.5 / dof_along + 0.5 / dof_across):
        # Isotropic within the uncertainty: one pooled value has more degrees of freedom.
        residual, basis = _regressed(values)
        along_u = across_u = float(np.sqrt(np.sum(residual**2) / (3.0 * dof_each - basis.shape[2])))
    n = len(seen)
    text = (
        f"{source}: {along_u * 1e6:.2g} µm along the beam, {across_u * 1e6:.2g} µm across "
        f"({dof_along + dof_across:.0f} degrees of freedom)"
    )
    return ReadingNoise(
        read_only(along_and_across(seen, np.full(n, along_u), np.full(n, across_u))), dof_along + dof_across, text
    )


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
