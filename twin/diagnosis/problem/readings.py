"""The readings as a diagnosis takes them up: placed, with their scatter, and with the rows that are too far off to be chance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from twin._common.arrays import locked
from twin._common.distributions import chi2_isf
from twin._common.units import MM
from twin.diagnosis.candidates.candidate import Catalogue
from twin.diagnosis.candidates.catalogue import catalogue
from twin.diagnosis.problem.noise import ENOUGH, ReadingNoise, from_repeats, from_the_rest
from twin.diagnosis.problem.problem import Problem
from twin.identification.inputs import prepared
from twin.identification.network import Network, stated_covariance
from twin.identification.outliers import explained, outliers
from twin.identification.setup import SetUp
from twin.identification.solve import solve
from twin.identification.spread import repeats
from twin.identification.unknowns import Unknowns
from twin.machine.calibration import Calibration
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument
from twin.measurement.table import Measurements, RowNote

ROBUST: Final = 4


@final
@dataclass(frozen=True, eq=False)
class DiagnosisTask:
    """What is to be solved.

    Attributes:
        problem: the rows that count, whitened.
        catalogue: the causes to try.
        scatter: of the readings.
    """

    problem: Problem
    catalogue: Catalogue
    noise: ReadingNoise


@final
@dataclass(frozen=True, eq=False)
class Readings:
    """All rows, with the set-up fitted to the good ones.

    Attributes:
        network: data and model, scatter as known now.
        setup: stations and targets.
        scatter: of all rows.
        calibration: the model that is judged.
        bad: (n,) rows too far off to be chance, if nothing but scatter is there.
    """

    network: Network
    setup: SetUp
    noise: ReadingNoise
    calibration: Calibration
    bad: np.ndarray

    def select_rows(self, rows: np.ndarray, notes: Sequence[RowNote] = ()) -> Readings:
        """Some of the rows, the set-up as it was fitted to all.

        Args:
            rows: their numbers.
            notes: of those that are left out.
        """
        network = self.network
        covariance = locked(np.array(self.noise.covariance[rows]))
        data = network.data.select(rows)
        fewer = Network(
            network.machine,
            replace(data, set_aside=(*data.set_aside, *notes)),
            network.instrument,
            network.unknowns,
            self.calibration,
            covariance,
        )
        return Readings(fewer, self.setup, replace(self.noise, covariance=covariance), self.calibration, self.bad[rows])

    def without(self, bad: np.ndarray) -> DiagnosisTask:
        """What is to be solved with some rows listed and left out, the causes to try, and how the rows scatter.

        Args:
            bad: (n,) rows to leave out.
        """
        left, network = self, self.network
        if np.any(bad):
            difference = network.difference(np.zeros(0), self.setup, np.arange(len(network.data)))
            notes = explained(network, difference, network.residual(np.zeros(0), self.setup), bad)
            left = self.select_rows(np.flatnonzero(~bad), notes)
        known = catalogue(network.machine, left.network.data, self.calibration)
        return DiagnosisTask(Problem(left.network, self.setup, self.calibration), known, left.noise)


def readings(
    data: Measurements, machine: Machine, calibration: Calibration, instrument: Instrument | None = None
) -> Readings:
    """Place stations and targets, and find how the readings scatter.

    Args:
        data: the measurements.
        machine: the machine.
        calibration: the model to be judged.
        instrument: what read the data; None where the table's uncertainties or the repeats say how it scatters.

    Raises:
        InputError: data that cannot be a measurement of this machine.
    """
    reader, data, setup = prepared(machine, data, instrument)
    nothing = Unknowns(machine, (), ())
    covariance = stated_covariance(data, reader)
    given = bool(np.isfinite(data.u_mm).any())
    stated = given or instrument is not None
    repeated = None if stated else _first_look(data, covariance)
    if repeated is not None:
        covariance = repeated
    figures = f"the figures of the {reader.name}" + (
        "" if instrument is not None else ", presumed: nothing else is said"
    )
    scatter = ReadingNoise(covariance, np.inf, "the table's uncertainties" if given else figures)
    network = Network(machine, data, reader, nothing, calibration, covariance)
    setup, bad = _settled(network, setup)
    if not stated:
        known = catalogue(machine, data, calibration).candidates
        view = network.view(np.zeros(0), setup, np.flatnonzero(~bad))
        seen = network.view(np.zeros(0), setup, np.arange(len(data))).seen
        own = from_repeats(data.select(~bad), view, network.read[~bad], known, seen)
        if own is None:
            own = from_the_rest(network, setup, view, known, seen)
        if own is not None:
            scatter = own
            network = Network(machine, data, reader, nothing, calibration, own.covariance)
            setup, bad = _settled(network, setup)
    return Readings(network, setup, scatter, calibration, bad)


def _first_look(data: Measurements, stated: np.ndarray) -> np.ndarray | None:
    """The same scatter in every direction, from the median distance of repeats: enough to see outliers by; None without repeats.

    The instrument's figures will not do: along the beam they are many times smaller than across, and data that do not scatter
    like that would be full of outliers.
    """
    group = repeats(data)
    size = np.bincount(group)
    if np.sum(np.maximum(size - 1, 0)) < ENOUGH // 2:
        return None
    points = np.where(np.isfinite(data.point_mm), data.point_mm, 0.0) * MM
    mean = np.stack([np.bincount(group, points[:, i]) / size for i in range(3)], axis=1)
    again = size[group] > 1
    off = (points - mean[group])[again] / np.sqrt(1.0 - 1.0 / size[group][again])[:, None]
    dimensions = int(np.isfinite(data.point_mm).any(axis=0).sum())
    sigma = float(np.sqrt(np.median(np.sum(off**2, axis=1)) / chi2_isf(0.5, dimensions)))
    if sigma <= 0.0:
        return None
    return locked(np.where(stated != 0.0, 1.0, 0.0) * np.eye(3) * sigma**2)


def _settled(network: Network, setup: SetUp) -> tuple[SetUp, np.ndarray]:
    """The set-up fitted without outliers, and which rows those are."""
    bad = np.zeros(len(network.data), dtype=bool)
    for _ in range(ROBUST):
        setup = solve(network, np.zeros(0), setup, (~bad).astype(float)).setup
        found = outliers(network, network.residual(np.zeros(0), setup))
        if np.array_equal(found, bad):
            break
        bad = found
    return setup, bad
