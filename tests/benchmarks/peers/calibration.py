"""Calibration: `scipy.optimize.least_squares` on the whitened residuals that `twin identify` minimises.

Same readings, unknowns, rows, priors and start: stations, targets and the errors that `identify` chose from a simulated measurement
with a laser tracker. The datum's conditions are fulfilled by the coordinates that `twin.identification.solve` uses, too. The peer gets
the residuals once with numerical derivatives, which is the usual way, and once with our analytic ones. Its coordinates are scaled by
the priors, and a direction that the readings do not determine is held by its prior. Results are compared as predicted readings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from tests.benchmarks.peers.record import Measured, Peer, Section, section
from tests.benchmarks.timing import timed
from tests.identification.plans import volumetric
from twin.identification import identify
from twin.identification.inputs import prepare
from twin.identification.network import Network
from twin.identification.solve import FitSolution, solve
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker
from twin.measurement.set_up import StationsAndTargets
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

POINTS = 1_000
REPEATS = 3
TOLERANCE = 1e-10
"""Relative tolerances of least_squares."""


@dataclass(frozen=True)
class Fit:
    """A least-squares problem as `twin.identification.solve.solve` gets it.

    Attributes:
        network: readings and model.
        setup: initial stations and targets.
        estimate: estimate of `twin`; its priors, free directions and scales define the problem of the peer.
        weight: (n,) weight of each point.
    """

    network: Network
    setup: StationsAndTargets
    estimate: FitSolution
    weight: np.ndarray

    @property
    def coordinates(self) -> np.ndarray:
        """(p, f) change of all unknowns for a change of each free coordinate."""
        return self.estimate.spectrum.scale[:, None] * self.estimate.basis

    def unknowns(self, x: np.ndarray) -> tuple[np.ndarray, StationsAndTargets]:
        """Return the machine's unknowns and the set-up of (f,) free coordinates."""
        step = self.coordinates @ x
        machine = len(self.network.unknowns)
        return step[:machine], self.setup.moved(step[machine:])

    @property
    def prior(self) -> np.ndarray:
        """(columns + weak directions, f) derivatives of the rows of the priors."""
        root = np.sqrt(self.estimate.priors.precision)
        weak = np.eye(self.estimate.basis.shape[1])[len(self.estimate.spectrum.directions.T) :]
        return np.concatenate([root[:, None] * self.coordinates[: len(root)], weak])

    def residual(self, x: np.ndarray) -> np.ndarray:
        """Return the whitened residuals, and those of the priors."""
        read = self.network.residual(*self.unknowns(x)) * np.sqrt(self.weight)[:, None]
        return np.concatenate([read.ravel(), self.prior @ x])

    def derivatives(self, x: np.ndarray) -> np.ndarray:
        """Return the derivatives of `residual`; the network's are those of the prediction."""
        rows = [chunk.jacobian for chunk in self.network.chunks(*self.unknowns(x))]
        read = np.concatenate(rows) * np.sqrt(self.weight)[:, None, None]
        return np.concatenate([-read.reshape(-1, read.shape[2]) @ self.coordinates, self.prior])


def by_scipy(fit: Fit, jacobian: Callable[[np.ndarray], np.ndarray] | str) -> Measured:
    """Measure `least_squares`; ``jacobian``: its argument ``jac``."""
    start = np.zeros(fit.coordinates.shape[1])

    found: list[np.ndarray] = []

    def once() -> None:
        found.append(least_squares(fit.residual, start, jacobian, ftol=TOLERANCE, xtol=TOLERANCE, gtol=TOLERANCE).x)

    n, timing = len(fit.network.data), timed(once, REPEATS)
    return Measured(timing.each(n), n, difference(fit, *fit.unknowns(found[-1])))


def difference(fit: Fit, theta: np.ndarray, setup: StationsAndTargets) -> str:
    """Return, in words, how an estimate differs from that of `twin`."""
    ours, other = (fit.network.residual(*at) for at in ((fit.estimate.theta, fit.estimate.setup), (theta, setup)))
    used = np.sqrt(fit.weight)[:, None]
    chi2 = float(np.sum((used * other) ** 2))
    sizes = f"chi² {chi2:.4f}, ours {float(np.sum((used * ours) ** 2)):.4f}"
    return (
        f"predicted readings differ by at most {np.abs(other - ours).max():.0e} of their standard uncertainty; {sizes}"
    )


def measured(machine: Machine, points: int) -> Measurements:
    """Return simulated readings of the illustrative machine."""
    plan = volumetric(machine, np.random.default_rng(5), points)
    return simulate(plan, machine, Calibration.default(machine), LaserTracker(), np.random.default_rng(1))[0]


def the_fit(machine: Machine, data: Measurements) -> Fit:
    """Return the last fit of `identify` as a problem of its own, from the nominal machine."""
    found = identify(data, machine)
    setup = prepare(machine, data, None).setup
    return Fit(found.network, setup, found.solution, found.used.astype(float))


def by_twin(fit: Fit) -> Measured:
    """Measure `solve` from the nominal machine."""

    def once() -> FitSolution:
        zero, last = np.zeros(len(fit.network.unknowns)), fit.estimate
        return solve(fit.network, zero, fit.setup, fit.weight, priors=last.priors)

    found, n = once(), len(fit.network.data)
    result = f"{difference(fit, found.theta, found.setup)}; {found.steps} steps"
    return Measured(timed(once, REPEATS).each(n), n, result)


def by_identify(fit: Fit, machine: Machine) -> Measured:
    """Measure `identify`: set-up, choice of the curves, priors, outliers, covariance."""
    data = fit.network.data
    n = len(data)
    return Measured(timed(lambda: identify(data, machine), REPEATS).each(n), n, "calibration with covariance")


def sections(machine: Machine) -> tuple[Section, ...]:
    """Return the comparison."""
    fit = the_fit(machine, measured(machine, POINTS))
    work = f"`identification.solve.solve`, {fit.coordinates.shape[1]} unknowns, from the nominal machine"
    peers = [
        Peer(
            ("scipy",),
            "`optimize.least_squares` on the same residuals, numerical derivatives",
            lambda: by_scipy(fit, "2-point"),
        ),
        Peer(
            ("scipy",),
            "`optimize.least_squares` on the same residuals, with the analytic derivatives of `twin`",
            lambda: by_scipy(fit, fit.derivatives),
        ),
        Peer(
            ("twin",),
            "`identify`: set-up, choice of the curves, priors, outliers and covariance, too",
            lambda: by_identify(fit, machine),
        ),
    ]
    return (section("Calibration (points are measured points, three coordinates each)", work, by_twin(fit), peers),)
