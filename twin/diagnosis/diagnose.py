"""Given measured data: is there anything beyond noise, what is it, what could it be mistaken for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
from scipy import stats
from threadpoolctl import threadpool_limits

from twin.arrays import locked
from twin.calibration import Calibration
from twin.diagnosis.account import account
from twin.diagnosis.catalogue import Candidate, Catalogue, catalogue
from twin.diagnosis.noise import ENOUGH, Scatter, from_repeats
from twin.diagnosis.problem import Problem
from twin.diagnosis.result import Diagnosis
from twin.diagnosis.search import Pool, Selection, every, prices, select
from twin.diagnosis.surrogates import EFFECT, surrogates
from twin.identification.network import Network, stated_covariance
from twin.identification.screen import explained, fitting, instrument_of, outliers
from twin.identification.setup import SetUp
from twin.identification.solve import solve
from twin.identification.spread import repeats
from twin.identification.unknowns import Unknowns
from twin.instruments import Instrument
from twin.machine import Machine
from twin.measurement import Measurements
from twin.units import MM

UNNAMED: Final = 3.0
"""Natural log of how much more an unnamed pattern must show than a named cause."""
ROBUST: Final = 4
Say = Callable[[str, float], None]


def diagnose(
    data: Measurements,
    machine: Machine,
    calibration: Calibration | None = None,
    *,
    instrument: Instrument | None = None,
    say: Say | None = None,
) -> Diagnosis:
    """Show what the model gets wrong about measured data, and name the cause.

    Args:
        data: the measurements.
        machine: the machine.
        calibration: the model to be judged; the machine file's own if None.
        instrument: what read the data; None where the table's uncertainties or the repeats say how it scatters.
        say: told what is being done and how far it is.

    Raises:
        InputError: data that cannot be a measurement of this machine.
    """
    tell = say or (lambda stage, part: None)
    errors = Calibration.default(machine) if calibration is None else calibration
    with threadpool_limits(limits=1, user_api="blas"):
        tell("placing the stations", 0.0)
        problem, known, scatter = problem_of(data, machine, errors, instrument)
        tell("searching", 0.2)
        searcher = Searcher(problem, machine, known)
        pool, best = searcher.run()
        tell("weighing", 0.7)
        return account(problem, known, pool, best, scatter, errors)


def problem_of(
    data: Measurements, machine: Machine, calibration: Calibration, instrument: Instrument | None
) -> tuple[Problem, Catalogue, Scatter]:
    """The data at their fitted set-up, whitened by what is known of their scatter, and the causes to try."""
    reader = instrument_of(machine, data, instrument)
    lengths = bool(np.isnan(reader.read(np.ones((1, 3)))[0, 1]))
    data, setup = fitting(machine, data, lengths_only=lengths)
    nothing = Unknowns(machine, (), ())
    covariance = stated_covariance(data, reader)
    stated = instrument is not None or bool(np.isfinite(data.u_mm).any())
    repeated = None if stated else _first_look(data, covariance)
    if repeated is not None:
        covariance = repeated
    source = "the table's uncertainties" if np.isfinite(data.u_mm).any() else f"the figures of the {reader.name}"
    scatter = Scatter(covariance, np.inf, source)
    known = catalogue(machine, data)
    network = Network(machine, data, reader, nothing, calibration, covariance)
    network, setup, data, scatter, known = _settled(network, setup, scatter, calibration, known)
    if not stated:
        view = network.view(np.zeros(0), setup, np.arange(len(data)))
        own = from_repeats(data, view, network.read, known.candidates)
        if own is not None:
            network = Network(machine, data, reader, nothing, calibration, own.covariance)
            network, setup, data, scatter, known = _settled(network, setup, own, calibration, known)
    return Problem(network, setup, calibration), known, scatter


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
    sigma = float(np.sqrt(np.median(np.sum(off**2, axis=1)) / stats.chi2.median(dimensions)))
    if sigma <= 0.0:
        return None
    return locked(np.where(stated != 0.0, 1.0, 0.0) * np.eye(3) * sigma**2)


def _settled(
    network: Network, setup: SetUp, scatter: Scatter, calibration: Calibration, known: Catalogue
) -> tuple[Network, SetUp, Measurements, Scatter, Catalogue]:
    """Set-up fitted without outliers; they are listed and left out."""
    data = network.data
    bad = np.zeros(len(data), dtype=bool)
    for _ in range(ROBUST):
        setup = solve(network, np.zeros(0), setup, (~bad).astype(float)).setup
        found, _ = outliers(network, network.residual(np.zeros(0), setup))
        if np.array_equal(found, bad):
            break
        bad = found
    if not np.any(bad):
        return network, setup, data, scatter, known
    rows = np.arange(len(data))
    difference = network.difference(np.zeros(0), setup, rows)
    notes = explained(network, difference, network.residual(np.zeros(0), setup), bad)
    left = replace(data.select(~bad), set_aside=(*data.set_aside, *notes))
    kept = replace(scatter, covariance=locked(np.array(scatter.covariance[~bad])))
    fresh = Network(network.machine, left, network.instrument, network.unknowns, calibration, kept.covariance)
    return fresh, setup, left, kept, catalogue(network.machine, left)


class Searcher:
    """The catalogue and its unnamed rivals on one data set.

    Args:
        problem: the data.
        machine: the machine.
        known: the causes to try.
    """

    def __init__(self, problem: Problem, machine: Machine, known: Catalogue) -> None:
        self.problem = problem
        self.known = known
        unnamed = surrogates(machine, problem.network.data)
        costs = prices(known.candidates)
        costs[EFFECT] = float(np.log(3 * max(len(unnamed), 1))) + UNNAMED
        everything: list[Candidate] = [*known.candidates, *unnamed]
        self.pool = Pool(problem, every(everything, costs))

    def run(self) -> tuple[Pool, Selection]:
        """The best set of causes, named and unnamed, and the pool it was chosen from."""
        return self.pool, select(self.pool)
