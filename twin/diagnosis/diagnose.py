"""Given measured data: is there anything beyond noise, what is it, what could it be mistaken for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from threadpoolctl import threadpool_limits

from twin.calibration import Calibration
from twin.diagnosis.catalogue import Candidate, Cell, catalogue
from twin.diagnosis.problem import Problem
from twin.diagnosis.search import Pool, Screen, Selection, few, prices, select
from twin.diagnosis.surrogates import EFFECT, surrogates
from twin.identification.network import Network, stated_covariance
from twin.identification.screen import fitting, outliers, robust_weights
from twin.identification.setup import SetUp
from twin.identification.solve import solve
from twin.identification.spread import covariance_from_repeats
from twin.identification.unknowns import Unknowns
from twin.instruments import Instrument, LaserTracker, TrackingInterferometer
from twin.machine import Machine
from twin.measurement import Measurements

UNNAMED: Final = 3.0
"""Log of how much more an unnamed pattern must show than a named cause."""
LOOPS: Final = 4
Say = Callable[[str, float], None]


def problem_of(
    data: Measurements, machine: Machine, calibration: Calibration, instrument: Instrument | None
) -> tuple[Problem, Measurements]:
    """The data at their fitted set-up."""
    lengths = bool(np.isnan(data.point_mm[:, 1:]).all())
    reader = instrument or (TrackingInterferometer() if lengths else LaserTracker())
    data, setup = fitting(machine, data, lengths_only=lengths)
    covariance = _scatter(data, reader, instrument is not None)
    network = Network(machine, data, reader, Unknowns(machine, (), ()), calibration, covariance)
    setup = _placed(network, setup)
    return Problem(network, setup, calibration), data


def _scatter(data: Measurements, reader: Instrument, given: bool) -> np.ndarray:
    if given or np.isfinite(data.u_mm).any():
        return stated_covariance(data, reader)
    try:
        return covariance_from_repeats(data, reader)[0]
    except Exception:
        return stated_covariance(data, reader)


def _placed(network: Network, setup: SetUp) -> SetUp:
    weight = np.ones(len(network.data))
    return solve(network, np.zeros(0), setup, weight).setup


def search(problem: Problem, data: Measurements, machine: Machine) -> tuple[Pool, Selection]:
    """The best set of causes, named and unnamed."""
    return Searcher(problem, data, machine).run()


class Searcher:
    """The catalogue on one data set's plan; the residual may change."""

    def __init__(self, problem: Problem, data: Measurements, machine: Machine) -> None:
        self.problem = problem
        self.known = catalogue(machine, data)
        unnamed = surrogates(machine, data)
        costs = prices(self.known.candidates)
        costs[EFFECT] = float(np.log(3 * len(unnamed))) + UNNAMED
        everything: list[Candidate] = [*self.known.candidates, *unnamed]
        self.screen = Screen(problem, everything, costs)
        self.pool = Pool(problem, few(everything, costs))

    def run(self) -> tuple[Pool, Selection]:
        self.pool.slope = self.problem.along(self.pool.signature)
        best = Selection((), 0.0)
        pool = self.pool
        for _ in range(LOOPS):
            here = {(c.key, tuple(cell.fixed.items())) for c, cell, _ in ()}
            fresh = self.screen.peaks(pool, best.forms)
            listed = {id(form.cell) for form in pool.forms}
            fresh = [one for one in fresh if id(one[1]) not in listed]
            pool = Pool(self.problem, fresh, pool)
            found = select(pool)
            again = select(pool, best.forms) if best.forms else found
            found = max(found, again, key=lambda one: one.worth)
            if found.worth <= best.worth + 1e-6:
                break
            best = found
        return pool, best
