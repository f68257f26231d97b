"""The readings of a diagnosis: with fitted set-up, measurement noise and outliers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.distributions import chi2_isf, chi2_sf
from twin._common.units import MM
from twin.diagnosis.candidates.candidate import Catalogue
from twin.diagnosis.candidates.catalogue import catalogue
from twin.diagnosis.problem.noise import LEAST_DOF, ReadingNoise, from_repeats, from_residuals
from twin.diagnosis.problem.problem import Problem
from twin.identification.discrepancy import Discrepancy, no_discrepancy
from twin.identification.inputs import prepare
from twin.identification.network import Network, stated_covariance
from twin.identification.outliers import outlier_notes, outliers
from twin.identification.setup import SetUp
from twin.identification.solve import solve
from twin.identification.spread import SIGNIFICANCE, repeats_of
from twin.identification.unknowns import Unknowns
from twin.machine.calibration import Calibration
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument, StationInstruments
from twin.measurement.state import repeat_groups
from twin.measurement.table import Measurements, RowNote

ITERATIONS: Final = 4
"""Repetitions of fit and outlier test, at most."""


@final
@dataclass(frozen=True, eq=False)
class DiagnosisTask:
    """One diagnosis: data, candidate causes and noise.

    Attributes:
        problem: the rows used, whitened by noise and discrepancy.
        catalogue: the candidate causes.
        noise: noise of these rows.
        by_noise: the same rows, whitened by their noise alone, for tests of consistency.
        discrepancy: what the causes selected before leave beyond the noise; none at first.
    """

    problem: Problem
    catalogue: Catalogue
    noise: ReadingNoise
    by_noise: Problem
    discrepancy: Discrepancy

    @classmethod
    def of(cls, problem: Problem, known: Catalogue, noise: ReadingNoise) -> DiagnosisTask:
        """Return the task with the weights of the noise."""
        return cls(problem, known, noise, problem, no_discrepancy(problem.network))

    def with_discrepancy(self, discrepancy: Discrepancy) -> DiagnosisTask:
        """Return the same task with another discrepancy in the weights."""
        own = self.by_noise
        weighted = Problem(own.network.with_discrepancy(discrepancy.root), own.setup, own.calibration)
        return replace(self, problem=weighted, discrepancy=discrepancy)


@final
@dataclass(frozen=True, eq=False)
class Readings:
    """All rows, with the set-up fitted to the good ones.

    Attributes:
        network: data and model, whitened by this noise.
        setup: stations and targets.
        noise: noise of all rows.
        calibration: the model under test.
        bad: (n,) whether a row is an outlier if the model is right and there is only noise.
    """

    network: Network
    setup: SetUp
    noise: ReadingNoise
    calibration: Calibration
    bad: np.ndarray

    def select_rows(self, rows: np.ndarray, notes: Sequence[RowNote] = ()) -> Readings:
        """Return some of the rows, with the set-up fitted to all.

        Args:
            rows: their numbers.
            notes: notes on the rows that are left out.
        """
        network = self.network
        covariance = read_only(np.array(self.noise.covariance[rows]))
        data = network.data.select(rows)
        fewer = Network(
            network.machine,
            replace(data, set_aside=(*data.set_aside, *notes)),
            network.instruments,
            network.unknowns,
            self.calibration,
            covariance,
        )
        return Readings(fewer, self.setup, replace(self.noise, covariance=covariance), self.calibration, self.bad[rows])

    def without(self, bad: np.ndarray) -> DiagnosisTask:
        """Return the diagnosis task without some rows, which are listed in its data with the reason.

        Args:
            bad: (n,) rows to leave out.
        """
        kept, network = self, self.network
        if np.any(bad):
            difference = network.residuals_m(np.zeros(0), self.setup, np.arange(len(network.data)))
            notes = outlier_notes(network, difference, network.residual(np.zeros(0), self.setup), bad)
            kept = self.select_rows(np.flatnonzero(~bad), notes)
        known = catalogue(network.machine, kept.network.data, self.calibration, network.instruments)
        return DiagnosisTask.of(Problem(kept.network, self.setup, self.calibration), known, kept.noise)


def readings(
    data: Measurements, machine: Machine, calibration: Calibration, instrument: Instrument | None = None
) -> Readings:
    """Fit stations and targets, and determine the measurement noise and the outliers.

    Args:
        data: the measurements.
        machine: the machine.
        calibration: the model under test.
        instrument: instrument whose noise model is used; None to take the table's uncertainties, or to estimate from repeats. If
            repeats contradict either, they decide.

    Raises:
        InputError: data that cannot be a measurement of this machine.
    """
    reader, data, setup = prepare(machine, data, instrument)
    no_unknowns = Unknowns(machine, (), ())
    covariance = stated_covariance(data, reader)
    has_u = bool(np.isfinite(data.u_mm).any())
    doubted = (instrument is not None or has_u) and _contradicted(machine, data, reader, covariance)
    stated = (instrument is not None or has_u) and not doubted
    preliminary = None if stated else _isotropic_from_repeats(data, covariance)
    by_model, covariance = covariance, covariance if preliminary is None else preliminary
    figures = "the table's uncertainties" if has_u else f"the noise model of the {reader.name}"
    if instrument is None and not has_u:
        figures += ", assumed: no uncertainties stated, too few repeats"
    noise = ReadingNoise(covariance, np.inf, figures)
    network = Network(machine, data, reader, no_unknowns, calibration, covariance)
    setup, bad = _setup_without_outliers(network, setup)
    if not stated:
        known = catalogue(machine, data, calibration, reader).candidates
        view = network.view(np.zeros(0), setup, np.flatnonzero(~bad))
        seen = network.view(np.zeros(0), setup, np.arange(len(data))).seen
        estimated = from_repeats(data.select(~bad), view, network.read[~bad], known, seen)
        if estimated is None:
            estimated = from_residuals(network, setup, view, known, seen)
        if doubted and estimated is not None and not _larger(estimated, by_model, network.read):
            # Only a known effect that changes between repeats made them vary.
            estimated = ReadingNoise(by_model, np.inf, figures)
        elif doubted and estimated is not None:
            estimated = replace(estimated, source=f"{estimated.source}; they contradict {figures}")
        if estimated is not None:
            noise = estimated
            network = Network(machine, data, reader, no_unknowns, calibration, estimated.covariance)
            setup, bad = _setup_without_outliers(network, setup)
    return Readings(network, setup, noise, calibration, bad)


def _contradicted(machine: Machine, data: Measurements, reader: StationInstruments, covariance: np.ndarray) -> bool:
    """Return whether repeats vary more than a stated covariance (n, 3, 3) allows."""
    return any(one.contradict for one in repeats_of(machine, data, reader, covariance))


def _larger(estimated: ReadingNoise, stated: np.ndarray, read: np.ndarray) -> bool:
    """Return whether an estimated noise is larger than the stated (n, 3, 3) covariance by more than its own uncertainty."""
    safe = stated + np.eye(3) * ~read[:, None, :]
    ratio = np.einsum("nii->n", np.linalg.solve(safe, np.where(read[:, None, :], estimated.covariance, 0.0)))
    mean = float(np.sum(ratio) / np.count_nonzero(read))
    return float(chi2_sf(mean * estimated.dof, estimated.dof)) < SIGNIFICANCE


def _isotropic_from_repeats(data: Measurements, stated: np.ndarray) -> np.ndarray | None:
    """Return an isotropic covariance (n, 3, 3) from the median distance of repeats, for a first outlier test; None without repeats.

    The instrument's noise model is not suitable for this test: it is many times smaller along the beam than across, and data with
    isotropic noise would appear full of outliers.
    """
    group = repeat_groups(data)
    size = np.bincount(group)
    if np.sum(np.maximum(size - 1, 0)) < LEAST_DOF // 2:
        return None
    points = np.where(np.isfinite(data.point_mm), data.point_mm, 0.0) * MM
    mean = np.stack([np.bincount(group, points[:, i]) / size for i in range(3)], axis=1)
    again = size[group] > 1
    deviation = (points - mean[group])[again] / np.sqrt(1.0 - 1.0 / size[group][again])[:, None]
    dimensions = int(np.isfinite(data.point_mm).any(axis=0).sum())
    sigma = float(np.sqrt(np.median(np.sum(deviation**2, axis=1)) / chi2_isf(0.5, dimensions)))
    if sigma <= 0.0:
        return None
    return read_only(np.where(stated != 0.0, 1.0, 0.0) * np.eye(3) * sigma**2)


def _setup_without_outliers(network: Network, setup: SetUp) -> tuple[SetUp, np.ndarray]:
    """Return the set-up fitted without outliers, and (n,) whether a row is one."""
    bad = np.zeros(len(network.data), dtype=bool)
    for _ in range(ITERATIONS):
        setup = solve(network, np.zeros(0), setup, (~bad).astype(float)).setup
        found = outliers(network, network.residual(np.zeros(0), setup))
        if np.array_equal(found, bad):
            break
        bad = found
    return setup, bad
