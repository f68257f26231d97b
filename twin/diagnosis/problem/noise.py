"""How far readings scatter when nothing changes: as the table says, as the instrument says, or as the repeats say.

Repeats are compared after everything that may honestly differ between them (a frame, a target, time, temperature) is taken out, or a
drift would pass for scatter and hide itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.arrays import locked
from twin.diagnosis.candidates.candidate import Candidate
from twin.diagnosis.candidates.signatures import Column
from twin.diagnosis.problem.signature_products import signatures_of
from twin.identification.network import Network, View
from twin.identification.setup import SetUp
from twin.identification.spread import repeats
from twin.measurement.instruments.base import along_and_across
from twin.measurement.table import Measurements

ENOUGH: Final = 20
"""Degrees of freedom of repeats below which the instrument's own figures are taken."""
WEIGHINGS: Final = 3


@final
@dataclass(frozen=True)
class ReadingNoise:
    """Covariance of the readings.

    Attributes:
        covariance: (n, 3, 3) m².
        dof: degrees of freedom it is known with; infinite where it is given.
        source: in words.
    """

    covariance: np.ndarray
    dof: float
    source: str


def from_repeats(
    data: Measurements, view: View, read: np.ndarray, known: tuple[Candidate, ...], seen: np.ndarray
) -> ReadingNoise | None:
    """ReadingNoise along and across the beam from repeats; None if they are too few.

    Args:
        data: the measurements.
        view: of these points, whitened by anything that is isotropic (its whitening is taken out again).
        read: (n, 3) coordinates that were read.
        known: the catalogue of all points.
        seen: (m, 3) all points in their stations' frames; the covariance is theirs.
    """
    group = repeats(data)
    size = np.bincount(group)
    again = size[group] > 1
    if np.sum(np.maximum(size - 1, 0)) < ENOUGH // 2:
        return None
    columns: list[Column] = [
        column
        for c in known
        if c.specification.varies != "never"
        for variant in c.variants[:: max(len(c.variants) // 4, 1)]
        for column in variant.columns
    ]
    raw = np.linalg.inv(np.where(read[:, :, None] & read[:, None, :], view.whitening, np.eye(3)))
    nuisance = signatures_of(view, columns)
    every = np.einsum("nij,njk->nik", raw, np.concatenate([view.residual[:, :, None], nuisance], axis=2))
    every *= read[:, :, None]
    total = np.zeros((len(size), *every.shape[1:]))
    np.add.at(total, group, every)
    every = (every - total[group] / size[group][:, None, None]) * again[:, None, None]
    free = float(np.sum(np.where(again, 1.0 - 1.0 / size[group], 0.0)))
    return _scatter(every, free, view, read, seen, "repeats")


def from_the_rest(
    network: Network, setup: SetUp, view: View, known: tuple[Candidate, ...], seen: np.ndarray
) -> ReadingNoise | None:
    """Noise along and across the beam from what the set-up and every plain form of every cause leave; None if that is too little.

    For readings that nothing else is said of: no uncertainties, no instrument, no repeats. What is taken for scatter here is too much
    if an effect has none of these forms, so causes are missed rather than invented.

    Args:
        network: data and model.
        setup: the fitted set-up.
        view: of the points that count, whitened by anything that is isotropic.
        known: the catalogue of all points.
        seen: (m, 3) all points in their stations' frames; the covariance is theirs.
    """
    columns = [column for c in known for column in _plain(c)]
    by_setup = np.zeros((len(view.rows), 3, len(setup)))
    network.by_setup(view, setup, by_setup)
    read = network.read[view.rows]
    taken = signatures_of(view, columns)
    raw = np.linalg.inv(np.where(read[:, :, None] & read[:, None, :], view.whitening, np.eye(3)))
    every = np.einsum(
        "nij,njk->nik", raw, np.concatenate([view.residual[:, :, None], by_setup * setup.plausible, taken], axis=2)
    )
    every *= read[:, :, None]
    return _scatter(every, float(len(view.rows)), view, read, seen, "what no plain form of any cause accounts for")


def _plain(candidate: Candidate) -> tuple[Column, ...]:
    """The widest curve, the lowest harmonics, the first of everything else; none of what has only forms that others have."""
    count = candidate.specification.plain_forms
    if count is not None:
        return tuple(column for variant in candidate.variants[:count] for column in variant.columns)
    return max(candidate.variants, key=lambda variant: len(variant.columns)).columns


def _scatter(
    every: np.ndarray, free: float, view: View, read: np.ndarray, seen: np.ndarray, source: str
) -> ReadingNoise | None:
    """Along and across the beam, from (n, 3, k): what scatters, and what is to be taken out of it.

    Args:
        every: metres.
        free: degrees of freedom a direction before anything is taken out.
        view: of the points.
        read: (n, 3) coordinates that were read.
        seen: (m, 3) points the covariance is wanted of.
        source: in words.
    """
    if not read[:, 1:].any():
        left, taken = _cleared(every)
        dof = free - float(np.sum(taken[:, 0] ** 2))
        if dof < ENOUGH:
            return None
        found = np.zeros((len(seen), 3, 3))
        found[:, 0, 0] = np.sum(left[:, 0] ** 2) / dof
        return ReadingNoise(
            locked(found), dof, f"{source}: {np.sqrt(found[0, 0, 0]) * 1e6:.2g} µm ({dof:.0f} degrees of freedom)"
        )
    if not read.all():
        # Something that reads a plane is no tracker: the same in every coordinate it reads.
        left, taken = _cleared(every)
        dof = free * np.count_nonzero(read) / len(read) - taken.shape[2]
        if dof < ENOUGH:
            return None
        sigma = float(np.sqrt(np.sum(left**2) / dof))
        text = f"{source}: {sigma * 1e6:.2g} µm a coordinate ({dof:.0f} degrees of freedom)"
        return ReadingNoise(locked(np.tile(sigma**2 * np.eye(3), (len(seen), 1, 1))), dof, text)
    beam = view.seen / np.linalg.norm(view.seen, axis=1, keepdims=True)
    a = c = 1.0
    for _ in range(WEIGHINGS):
        # Weighed as they scatter: taken out all alike, what across the beam leaves would swamp what is along it.
        lengths = np.einsum("ni,nik->nk", beam, every)[:, None, :] * beam[:, :, None]
        left, taken = _cleared(lengths / a + (every - lengths) / c)
        along = np.einsum("ni,ni->n", left, beam)
        used = float(np.sum(np.einsum("nik,ni->nk", taken, beam) ** 2))
        dof_along = free - used
        dof_across = 2.0 * free - (taken.shape[2] - used)
        if dof_along < ENOUGH:
            return None
        a *= float(np.sqrt(np.sum(along**2) / dof_along))
        c *= float(np.sqrt((np.sum(left**2) - np.sum(along**2)) / dof_across))
    if abs(np.log(a / c)) < 3.0 * np.sqrt(0.5 / dof_along + 0.5 / dof_across):
        # The same in all directions as far as they can tell: one number, known better.
        left, taken = _cleared(every)
        a = c = float(np.sqrt(np.sum(left**2) / (3.0 * free - taken.shape[2])))
    n = len(seen)
    text = f"{source}: {a * 1e6:.2g} µm along the beam, {c * 1e6:.2g} µm across ({dof_along + dof_across:.0f} degrees of freedom)"
    return ReadingNoise(locked(along_and_across(seen, np.full(n, a), np.full(n, c))), dof_along + dof_across, text)


def _cleared(every: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) the first of (n, 3, k) columns without the others, and (n, 3, m) an orthonormal basis of those."""
    flat = every.reshape(-1, every.shape[2])
    scale = np.maximum(np.linalg.norm(flat[:, 1:], axis=0), 1e-30)
    others = flat[:, 1:] / scale
    values, vectors = np.linalg.eigh(others.T @ others)
    seen = values > 1e-12 * max(float(values[-1]), 1e-300) if len(values) else np.zeros(0, dtype=bool)
    # Twice: the square loses half the digits.
    basis, _ = np.linalg.qr(others @ (vectors[:, seen] / np.sqrt(values[seen])))
    left = flat[:, 0] - basis @ (basis.T @ flat[:, 0])
    return left.reshape(-1, 3), basis.reshape(-1, 3, basis.shape[1])
