"""Whitened nonlinear least squares with a weak prior, which acts only where the readings determine little.

Every unknown is scaled by its prior standard deviation: errors by `Machine.plausible`, stations and targets by `setup`. In these units
each singular direction of the derivatives has a strength σ, the signal-to-noise ratio. The residuals are whitened by the noise of the
readings and, if the model is incomplete, by the discrepancy (`twin.identification.discrepancy`) as well: a direction weaker than the
misfit would be fitted to the misfit.

Every error has a Gaussian prior about zero, stations and targets about their initial values. If the model fits, the prior acts only on
directions with σ ≤ 1, which keep their initial values: nothing that the readings determine is biased, and noise-free readings give the
errors to the last digits. If it is incomplete, the prior acts on all. The covariance is that of this estimator, from the readings and
from the prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Final, Literal, NamedTuple, final

import numpy as np
import scipy

from twin._common.arrays import read_only
from twin._common.distributions import chi2_isf, chi2_sf, f_sf
from twin._common.messages import Message, Number
from twin._common.resources import map_chunks
from twin._common.units import MM, URAD
from twin.identification.network import Network, Unknowns
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument, StationInstruments
from twin.measurement.observation import FEWEST_REPEATS, at_origin, nominal_carriers, repeat_groups
from twin.measurement.set_up import StationsAndTargets
from twin.measurement.table import Measurements
from twin.model.effects import unit_of
from twin.numerics.observability import SINGULAR_VALUE_TOLERANCE, Determinability, Spectrum, Unknown, decompose

DATUM_WEIGHT: Final = 1e9
"""Weight of a condition of the datum when it is added as an observation."""
STEPS: Final = 50
PLAIN_STEPS: Final = 6
"""Number of plain Gauss-Newton steps, enough for a five-axis machine with a well-determined set-up. If a station or target remains
nearly undetermined, the derivatives change over its uncertainty, and plain steps converge by a tenth each or oscillate; then the
steps are accelerated with the last few.
"""
MEMORY: Final = 4
COST_TOLERANCE: Final = 1e-6
"""Relative increase of the sum of squares accepted in a step: rounding."""
DAMPING_FACTOR: Final = 10.0
"""Factor of the damping from one rejected step to the next, and back after an accepted one."""
LEAST_STRENGTH: Final = 30.0
"""Strength up to which directions keep their values when the machine's unknowns have priors: such priors would move a station or target
far for little, as it has no prior of its own here, and the covariance includes this strength anyway.
"""
PANEL: Final = 32
"""Block size of the factorisation; it affects computing time only."""
SETUP_SHARE: Final = 5e-3
"""Share of its prior standard deviation that limits a station or target if the model is incomplete. Otherwise points in a plane
or a place that no rotation determines would move by decimetres to reduce an error.
"""
CONVERGED_CHANGE: Final = 1e-4
"""Change of the whitened residuals (root of the sum of squares) that ends the iteration: the errors of a machine are small, so the next
step would be a thousandth of it or less, and the remainder 1e-7 of a standard uncertainty.
"""


class Priors(NamedTuple):
    """Gaussian priors of the machine's unknowns about zero.

    ``precision``: (columns,) in the estimate, one over µm² or µrad²; zero without a prior; ``variance``: (columns,) µm² or µrad², for
    the covariance: how far the unknowns that the estimate holds back may be from zero.
    """

    precision: np.ndarray
    variance: np.ndarray


@final
@dataclass(frozen=True)
class FitSolution:
    """An estimate.

    Attributes:
        theta: (columns,) µm and µrad.
        triangle: (p + 1, p + 1) factor of [J | r] at the estimate.
        spectrum: directions (machine and set-up, scaled by their priors) that the data determine, their singular values, and null
            directions; all of them fulfil the datum's conditions.
        determined: number of parameters determined by the readings: the trace of their share in the estimate.
        converged: whether the iteration converged.
        incomplete: whether the model does not fit, so that the prior acts on every direction.
        priors: further priors of the machine's unknowns about zero.
        free: (p, f) orthonormal directions that fulfil the datum's conditions.
    """

    theta: np.ndarray
    setup: StationsAndTargets
    triangle: np.ndarray
    spectrum: Spectrum
    determined: float
    converged: bool
    steps: int
    incomplete: bool
    priors: Priors
    free: np.ndarray

    @cached_property
    def basis(self) -> np.ndarray:
        """All directions that the datum allows, (p, f), scaled by the priors, strongest first."""
        return read_only(np.concatenate([self.spectrum.directions, self.spectrum.null_space], axis=1))

    @cached_property
    def stiffness(self) -> np.ndarray:
        """Precision of the estimate along each direction, (f,), prior included."""
        return read_only(self.spectrum.values**2 + _with_prior(self.spectrum.values, incomplete=self.incomplete))

    @property
    def deviation(self) -> np.ndarray:
        """Deviation of each unknown from its prior mean, (p,), in prior standard deviations."""
        return np.asarray(_Iterate(self.theta, self.setup).deviation / self.spectrum.scale)

    @property
    def unseen(self) -> np.ndarray:
        """Share of each unknown's prior variance that remains after readings with this noise, (p,)."""
        return np.asarray(self.basis**2 @ (1.0 / (self.spectrum.values**2 + 1.0)))

    def covariance(self, score_covariance: np.ndarray | None = None) -> np.ndarray:
        """Return the (p, p) covariance of the estimate, propagated from the readings and the priors.

        A⁻¹ (M + P) A⁻¹ with the estimator's matrix A, the covariance M of the normal equations' right side, and the priors' part P.

        ``score_covariance``: (p, p) M in the derivatives' units; if None, that of readings with the covariance of the weights, JᵀJ.
        """
        scale = self.spectrum.scale
        j = self.triangle[:, :-1]
        middle = (j.T @ j if score_covariance is None else score_covariance) * np.outer(scale, scale)
        held = np.zeros(len(scale))
        held[: len(self.theta)] = (self.priors.precision * scale[: len(self.theta)]) ** 2 * self.priors.variance
        inner = self.basis.T @ (middle + np.diag(held)) @ self.basis
        inner += np.diag(_with_prior(self.spectrum.values, incomplete=self.incomplete))
        root = self.basis * scale[:, None] / self.stiffness
        return np.asarray(root @ inner @ root.T)

    @property
    def chi2(self) -> float:
        """Sum of squared whitened residuals."""
        return float(np.sum(self.triangle[:, -1] ** 2))

    def rank_of(self, columns: Sequence[int], datum: np.ndarray) -> int:
        """Return the rank of the set-up and some of the machine's columns in the data, with the datum's conditions."""
        machine = datum.shape[1]
        scale = self.spectrum.scale
        kept = [*columns, *range(machine, len(scale))]
        conditions = np.zeros((len(datum), len(scale)))
        conditions[:, :machine] = datum
        whole = np.concatenate([self.triangle[:, :-1] * scale, DATUM_WEIGHT * conditions])[:, kept]
        return int(np.count_nonzero(np.linalg.svd(whole, compute_uv=False) > SINGULAR_VALUE_TOLERANCE))

    def determinability(self, unknowns: Unknowns, readings: int) -> Determinability:
        """Return what the readings determine, with names and the user's units."""
        return Determinability(all_unknowns(unknowns, self.setup), self.spectrum, SINGULAR_VALUE_TOLERANCE, readings)


def all_unknowns(unknowns: Unknowns, setup: StationsAndTargets) -> tuple[Unknown, ...]:
    """Return every unknown of a machine and its set-up with a name for the user.

    ``unknowns``: unknowns of the machine: µm and µrad; ``setup``: stations and targets: metres and radians inside, mm and µrad outside.
    """
    curves, of_machine = {curve.name for curve in unknowns.curves}, []
    for column, size in zip(unknowns.columns, unknowns.plausible.tolist(), strict=True):
        name = f"{column.entity} order {column.index}" if column.entity in curves else column.entity
        of_machine.append(Unknown(name, unit_of(column.entity), size))
    return (*of_machine, *setup_unknowns(setup))


def setup_unknowns(setup: StationsAndTargets) -> tuple[Unknown, ...]:
    """Return every unknown of a set-up with a name for the user."""
    setup_unknowns = []
    for name, size in zip(setup.names, setup.plausible, strict=True):
        unit, factor = ("urad", URAD) if " turn " in name else ("mm", MM)
        setup_unknowns.append(Unknown(name, unit, float(size) / factor, factor))
    return tuple(setup_unknowns)


def solve(
    network: Network,
    theta: np.ndarray,
    setup: StationsAndTargets,
    weight: np.ndarray,
    *,
    priors: Priors | None = None,
    incomplete: bool = False,
    steps: int = STEPS,
    triangle: np.ndarray | None = None,
) -> FitSolution:
    """Return the Gauss-Newton estimate from an initial value that fulfils the datum's conditions.

    ``theta``: initial values of the machine's unknowns, µm and µrad; ``setup``: initial stations and targets; their deviation from the
    prior is in it (`StationsAndTargets.shift`); ``weight``: (n,) weight of each point; ``priors``: priors of the machine's unknowns;
    none if None; ``incomplete``: whether the model does not fit within the noise; see the module; ``triangle``: factor of [J | r] at
    the initial value; computed if None.
    """
    problem = _Problem.of(network, setup, priors, incomplete=incomplete)
    iterate = _Iterate(theta, setup)
    weakest = LEAST_STRENGTH if priors is not None else SINGULAR_VALUE_TOLERANCE
    taken, damping, before, last = 0, 0.0, np.inf, (iterate, np.zeros((0, 0)))
    newton: _Newton | None = None
    newton_steps: list[np.ndarray] = []
    steps_taken: list[np.ndarray] = []
    while True:
        triangular = factor(network, iterate.theta, iterate.setup, weight) if triangle is None else triangle
        triangle = None
        cost = problem.cost(iterate, triangular)
        worse = cost > before * (1.0 + COST_TOLERANCE)
        if worse and newton is not None and taken < steps:
            # The step is too long for its derivatives: try the plain one, then damped ones. The history of steps is not valid either.
            accelerated = damping == 0.0 and steps_taken[-1] is not newton_steps[-1]
            if not accelerated:
                damping = max(damping * DAMPING_FACTOR, newton.least_damping)
            newton_steps = newton_steps[-1:]
            steps_taken = [newton_steps[0] if accelerated else newton.step(damping)]
            iterate, taken = last[0].stepped(steps_taken[0] * problem.near), taken + 1
            continue
        if worse:
            iterate, triangular = last
        left, spectrum = problem.decomposed(triangular, problem.near)
        if taken == steps:
            return problem.solution(iterate, triangular, spectrum, taken, converged=False)
        along = left.T @ np.concatenate([triangular[:, -1], -problem.root @ iterate.theta])
        newton = _Newton.at(spectrum, along, iterate.deviation / problem.near, weakest, incomplete=incomplete)
        step = newton.step()
        converged = newton.change <= CONVERGED_CHANGE or bool(np.abs(step).max(initial=0.0) < 1e-14)
        newton_steps.append(step)
        damping = 0.0 if damping <= newton.least_damping else damping / DAMPING_FACTOR
        if damping and not converged:
            step = newton.step(damping)
        elif taken >= PLAIN_STEPS and not converged:
            step = _anderson_step(newton_steps, steps_taken, spectrum)
        steps_taken.append(step)
        last, before = (iterate, triangular), cost
        iterate = iterate.stepped(step * problem.near)
        taken += 1
        if converged:
            # The last step is too small to change the derivatives; only the residuals are updated.
            triangular = np.array(triangular)
            triangular[:, -1] -= triangular[:, :-1] @ (step * problem.near)
            return problem.solution(iterate, triangular, spectrum, taken, converged=True)


@final
@dataclass(frozen=True)
class _Iterate:
    """An iterate: the machine's unknowns and the set-up."""

    theta: np.ndarray
    setup: StationsAndTargets

    @property
    def deviation(self) -> np.ndarray:
        """Deviation of every unknown from its prior mean, (p,)."""
        shift = np.zeros(len(self.setup)) if self.setup.shift is None else self.setup.shift
        return np.concatenate([self.theta, shift])

    def stepped(self, step: np.ndarray) -> _Iterate:
        """Return the iterate after a step of all unknowns."""
        machine = len(self.theta)
        return _Iterate(self.theta + step[:machine], self.setup.moved(step[machine:]))


@final
@dataclass(frozen=True)
class _Problem:
    """Constants of the iteration.

    Attributes:
        incomplete: see `solve`.
        root: (columns, columns) root of their precision.
        free: (p, f) orthonormal directions that fulfil the datum's conditions.
        scale: (p,) prior standard deviations.
        near: (p,) prior standard deviations during the iteration (`SETUP_SHARE`).
    """

    incomplete: bool
    priors: Priors
    root: np.ndarray
    free: np.ndarray
    scale: np.ndarray
    near: np.ndarray

    @classmethod
    def of(cls, network: Network, setup: StationsAndTargets, priors: Priors | None, *, incomplete: bool) -> _Problem:
        """Return the constants of an estimate; arguments as of `solve`."""
        machine = len(network.unknowns)
        held = Priors(np.zeros(machine), np.zeros(machine)) if priors is None else priors
        scale = np.concatenate([network.unknowns.plausible, setup.plausible])
        near = np.array(scale)
        near[machine:] *= SETUP_SHARE if incomplete else 1.0
        free = free_directions(network.unknowns.datum, machine, len(setup))
        return cls(incomplete, held, np.diag(np.sqrt(held.precision)), free, scale, near)

    def cost(self, iterate: _Iterate, triangle: np.ndarray) -> float:
        """Return the sum of squares of readings and priors."""
        cost = float(np.sum(triangle[:, -1] ** 2) + np.sum((self.root @ iterate.theta) ** 2))
        return cost + (float(np.sum((iterate.deviation / self.near) ** 2)) if self.incomplete else 0.0)

    def decomposed(self, triangle: np.ndarray, scale: np.ndarray) -> tuple[np.ndarray, Spectrum]:
        """Return the left singular vectors of all directions that contribute to the step, and the spectrum split at the noise.

        ``triangle``: factor of [J | r]; ``scale``: (p,) prior standard deviations.
        """
        prior = np.zeros((len(self.root), len(scale)))
        prior[:, : len(self.root)] = self.root
        matrix = np.concatenate([triangle[:, :-1], prior]) * scale
        if not self.incomplete:
            return decompose(matrix, scale, free=self.free)
        # Here the prior limits the step, so even weakly determined directions count; otherwise no step reaches the minimum.
        left, all_directions = decompose(matrix, scale, free=self.free, tolerance=0.0)
        basis = np.concatenate([all_directions.directions, all_directions.null_space], axis=1)
        seen = int(np.count_nonzero(all_directions.values > 1.0))
        return left, Spectrum(
            all_directions.scale, all_directions.values, read_only(basis[:, :seen]), read_only(basis[:, seen:])
        )

    def solution(
        self, iterate: _Iterate, triangle: np.ndarray, spectrum: Spectrum, taken: int, *, converged: bool
    ) -> FitSolution:
        """Return the estimate at the last iterate."""
        if self.incomplete:
            _, spectrum = self.decomposed(triangle, self.scale)
        solution = FitSolution(
            theta=iterate.theta,
            setup=iterate.setup,
            triangle=triangle,
            spectrum=spectrum,
            determined=0.0,
            converged=converged,
            steps=taken,
            incomplete=self.incomplete,
            priors=self.priors,
            free=self.free,
        )
        share = np.sum((triangle[:, :-1] * self.scale @ solution.basis) ** 2 / solution.stiffness)
        return replace(solution, determined=float(share))


def _with_prior(strength: np.ndarray, *, incomplete: bool) -> np.ndarray:
    """Return (f,) one for each direction on which the prior acts: if the model fits, those that the readings do not determine."""
    return np.ones_like(strength) if incomplete else (strength <= SINGULAR_VALUE_TOLERANCE).astype(float)


def factor(network: Network, theta: np.ndarray, setup: StationsAndTargets, weight: np.ndarray) -> np.ndarray:
    """Return the (p + 1, p + 1) triangular factor of [J | r], rows weighted, which contains all that a least-squares step needs.

    ``weight``: (n,) weight of each point; zero leaves it out.
    """
    size = len(theta) + len(setup) + 1

    def summed(chunks: Sequence[np.ndarray]) -> np.ndarray:
        found = np.zeros((size, size), order="F")
        for rows in chunks:
            piece = network.chunk(theta, setup, rows)
            both = piece.columns
            both *= np.sqrt(weight[piece.rows])[:, None]
            found = _append_rows(found, both.reshape(size, -1).T)
        return found

    whole, *others = map_chunks(network.row_chunks, summed)
    for part in others:
        whole = _append_rows(whole, np.asfortranarray(np.triu(part)))
    certified = network.certified(setup)
    if len(certified):
        whole = _append_rows(whole, np.asfortranarray(certified))
    return np.triu(whole)


def _append_rows(triangle: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the factor of a triangle on top of rows, by LAPACK's factorisation of a triangular-pentagonal matrix."""
    append_rows, _, _, _ = scipy.linalg.lapack.dtpqrt(
        0, min(PANEL, len(triangle)), triangle, rows, overwrite_a=1, overwrite_b=1
    )
    return np.asarray(append_rows)


@final
@dataclass(frozen=True)
class _Newton:
    """Gauss-Newton steps from one iterate, for readings and prior.

    ``basis``: (p, d) directions, the null directions last; ``right``: (d,) gradient along them; ``stiffness``: (d,) curvature along
    them.
    """

    basis: np.ndarray
    right: np.ndarray
    stiffness: np.ndarray

    @staticmethod
    def at(
        spectrum: Spectrum, along: np.ndarray, deviation: np.ndarray, weakest: float, *, incomplete: bool
    ) -> _Newton:
        """Return the steps from an iterate.

        ``along``: (d,) residuals along the directions that contribute, strongest first; ``deviation``: (p,) deviation of every unknown
        from its prior mean, in prior standard deviations; ``weakest``: strength up to which a direction keeps its value, if the model
        fits; ``incomplete``: see `solve`.
        """
        basis = np.concatenate([spectrum.directions, spectrum.null_space], axis=1)
        values = spectrum.values
        prior = _with_prior(values, incomplete=incomplete)
        right = -prior * (basis.T @ deviation) if incomplete else np.zeros(len(values))
        right[: len(along)] += values[: len(along)] * along
        if not incomplete:
            # Hardly determined directions keep their values: derivatives across a plane of points hold over a short distance only.
            right[values <= weakest] = 0.0
        return _Newton(basis, right, values**2 + prior)

    @property
    def change(self) -> float:
        """Change of the residuals by the step, root of the sum of squares."""
        return float(np.linalg.norm(self.right / np.sqrt(self.stiffness)))

    @property
    def least_damping(self) -> float:
        """Damping that halves the weakest of the directions that move."""
        return float(self.stiffness[self.right != 0.0].min(initial=np.inf))

    def step(self, damping: float = 0.0) -> np.ndarray:
        """Return the step, damped as by Levenberg (1944, Q. Appl. Math. 2, 164): first along what the readings determine least."""
        return np.asarray(self.basis @ (self.right / (self.stiffness + damping)))


def _anderson_step(
    newton_steps: Sequence[np.ndarray], steps_taken: Sequence[np.ndarray], spectrum: Spectrum
) -> np.ndarray:
    """Return the Anderson-accelerated step from the last few steps (Anderson 1965; Walker and Ni 2011).

    ``newton_steps``: (p,) each, Gauss-Newton steps at the last iterates and at this one; ``steps_taken``: (p,) each, the steps taken
    between these iterates; ``spectrum``: at this iterate; directions times strength give the change of the whitened residuals by a
    step.
    """
    last = list(newton_steps)[-MEMORY - 1 :]
    more = np.stack([after - before for before, after in pairwise(last)], axis=1)
    steps_between = np.stack(list(steps_taken)[1 - len(last) :], axis=1)
    changes = spectrum.singular_values[:, None] * spectrum.directions.T
    share = np.linalg.lstsq(changes @ more, changes @ last[-1], rcond=1e-6)[0]
    return np.asarray(last[-1] - (steps_between + more) @ share)


def free_directions(datum: np.ndarray, machine: int, setup: int) -> np.ndarray:
    """Return (p, p − conditions) orthonormal directions that fulfil the datum's conditions."""
    if len(datum) == 0:
        return np.eye(machine + setup)
    _, values, v = np.linalg.svd(datum, full_matrices=True)
    rank = int(np.count_nonzero(values > 1e-9 * values[0]))
    inside = v[rank:].T
    free_directions = np.zeros((machine + setup, inside.shape[1] + setup))
    free_directions[:machine, : inside.shape[1]] = inside
    free_directions[machine:, inside.shape[1] :] = np.eye(setup)
    return free_directions


# --- Residuals and repeats compared with the noise that is stated ---------------------------------

SIGNIFICANCE: Final = 1e-3
"""Level at which repeats contradict the stated noise."""
FALSE_ALARM: Final = 0.01
"""Probability that repeats without any outlier contain a reading that is left out."""
ITERATIONS: Final = 6
"""Repetitions of the search for outliers among the repeats, at most."""
Spread = Literal["stated", "repeats", "between poses", "between rounds"]


@final
@dataclass(frozen=True)
class FitStatistics:
    """Residuals compared with the stated covariance of the readings; nothing is scaled by it.

    Attributes:
        chi2, dof: sum of squared whitened residuals and its degrees of freedom (not an integer: beyond the chosen orders, the readings
            determine a share of each parameter).
        p_value: probability of a chi² at least as large if the stated covariance holds.
        pure_chi2, pure_dof: part of it between repeats of the same point (pure error).
        lack_p_value: p-value of the remainder compared with the repeats (F test of lack of fit); NaN without repeats.
    """

    chi2: float
    dof: float
    p_value: float
    pure_chi2: float
    pure_dof: int
    lack_p_value: float

    @property
    def reduced(self) -> float:
        """chi² per degree of freedom: one if model and stated covariance hold."""
        return self.chi2 / self.dof if self.dof else float("nan")

    @property
    def pure_reduced(self) -> float:
        """The same for repeats alone: one if the stated covariance holds, whatever the model."""
        return self.pure_chi2 / self.pure_dof if self.pure_dof else float("nan")


def misfit(
    whitened: np.ndarray,
    read: np.ndarray,
    data: Measurements,
    determined: float,
    used: np.ndarray,
    certified: Sequence[float] | np.ndarray = (),
) -> FitStatistics:
    """Return the misfit of an estimate.

    ``whitened``: (n, 3) whitened residuals; ``read``: (n, 3) which coordinates were read; ``used``: (n,) which points were used;
    ``certified``: (r,) whitened residuals of the certificates' statements, which count as readings (`Network.certified`).
    """
    chi2 = float(np.sum(whitened[used] ** 2) + np.sum(np.square(certified)))
    dof = float(np.count_nonzero(read[used]) + len(certified)) - determined
    group = repeat_groups(data)
    pure_chi2, pure_dof = 0.0, 0
    order = np.flatnonzero(used)
    for pattern in np.unique(read[order], axis=0):
        rows = order[np.all(read[order] == pattern, axis=1)]
        size = np.bincount(group[rows], minlength=group.max() + 1)
        total = np.stack([np.bincount(group[rows], whitened[rows, i], minlength=len(size)) for i in range(3)], axis=1)
        mean = total / np.maximum(size, 1)[:, None]
        pure_chi2 += float(np.sum((whitened[rows] - mean[group[rows]]) ** 2))
        pure_dof += int(np.sum(np.maximum(size - 1, 0)) * np.count_nonzero(pattern))
    lack_dof, lack = dof - pure_dof, chi2 - pure_chi2
    lack_p = float("nan")
    if pure_dof > 0 and lack_dof > 0 and pure_chi2 > 0.0:
        lack_p = float(f_sf((lack / lack_dof) / (pure_chi2 / pure_dof), lack_dof, pure_dof))
    p_value = float(chi2_sf(chi2, dof)) if dof > 0 else float("nan")
    return FitStatistics(chi2, max(dof, 0.0), p_value, pure_chi2, pure_dof, lack_p)


@final
@dataclass(frozen=True, eq=False)
class Repeats:
    """Repeated readings of one instrument, without outliers.

    Attributes:
        rows: (k,) its rows in the data.
        covariance: (k, 3, 3) of all its readings, from the repeats, m²: the instrument's model, pooled.
        reduced_chi2: mean square of the repeats in units of the stated covariance.
        p_value: probability of one at least as large if the stated covariance holds.
    """

    instrument: Instrument
    rows: np.ndarray
    covariance: np.ndarray
    dof: int
    reduced_chi2: float
    p_value: float

    @property
    def decide(self) -> bool:
        """Whether the repeats are enough to test the stated covariance."""
        return self.dof >= FEWEST_REPEATS

    @property
    def contradict(self) -> bool:
        """Whether the repeats vary more than the stated covariance allows."""
        return self.decide and self.p_value < SIGNIFICANCE


def noise_text(instrument: Instrument, readings: np.ndarray, covariance: np.ndarray) -> str:
    """Return the median standard deviations of an instrument's readings in words.

    ``readings``: (k, 3) metres; NaN where nothing was read; ``covariance``: (k, 3, 3) of them, m².
    """
    read = np.isfinite(readings)
    variance = np.where(read, np.einsum("nii->ni", covariance), 0.0)
    if instrument.specification.beam and read.all():
        beam = readings / np.linalg.norm(readings, axis=1, keepdims=True)
        along = np.einsum("ni,nij,nj->n", beam, covariance, beam)
        across = (variance.sum(axis=1) - along) / 2.0
        sizes = [Number(f"{1e6 * np.sqrt(np.median(own)):.2g} µm") for own in (along, across)]
        return Message("{along} along the beam, {across} across", along=sizes[0], across=sizes[1])
    each = variance.sum(axis=1)[read.any(axis=1)] / np.count_nonzero(read[read.any(axis=1)], axis=1)
    return Number(f"{1e6 * np.sqrt(np.median(each)):.2g} µm")


def repeats_of(
    machine: Machine, data: Measurements, instruments: StationInstruments, stated: np.ndarray
) -> tuple[Repeats, ...]:
    """Return the repeats of each instrument that has any; ``stated``: (n, 3, 3) stated covariance of the readings, m²."""
    points = np.where(np.isfinite(data.point_mm), data.point_mm, 0.0) * MM
    # A probe reads zero: its repeats differ in the axis positions.
    points = np.where(at_origin(data)[:, None], nominal_carriers(machine, data).points, points)
    every, read = repeat_groups(data), np.isfinite(data.point_mm)
    repeats = []
    for instrument, rows in instruments.groups(data.station):
        group, own = every[rows], points[rows]
        kept = np.ones(len(rows), dtype=bool)
        for _ in range(ITERATIONS):
            size = np.bincount(group[kept], minlength=group.max() + 1)
            again = kept & (size[group] > 1)
            dof = int(np.sum(np.maximum(size - 1, 0)))
            if dof == 0:
                break
            total = np.stack([np.bincount(group[kept], own[kept, i], minlength=len(size)) for i in range(3)], axis=1)
            deviations = np.where(again[:, None], own - (total / np.maximum(size, 1)[:, None])[group], 0.0)
            pooled = instrument.pooled(own, deviations, dof)
            each = deviations / np.sqrt(1.0 - 1.0 / np.maximum(size, 2))[group, None]
            square, count = _squares(pooled, each, read[rows]), np.count_nonzero(read[rows], axis=1)
            if not np.any(square[again] > 0.0):
                break
            median = np.array([chi2_isf(0.5, k) if k else 1.0 for k in range(4)])[count]
            limit = np.array([chi2_isf(FALSE_ALARM / len(rows), k) if k else np.inf for k in range(4)])[count]
            wrong = again & (square > limit * float(np.median(square[again] / median[again])))
            if not np.any(wrong):
                break
            kept &= ~wrong
        if dof > 0:
            chi2 = float(np.sum(_squares(stated[rows], deviations, read[rows])))
            free = dof * int(np.count_nonzero(read[rows].any(axis=0)))
            repeats.append(Repeats(instrument, rows, pooled, dof, chi2 / free, float(chi2_sf(chi2, free))))
    return tuple(repeats)


def _squares(covariance: np.ndarray, deviations: np.ndarray, read: np.ndarray) -> np.ndarray:
    """Return (k,) squared deviations in units of their covariance, over the coordinates that were read."""
    both = read[:, :, None] & read[:, None, :]
    safe = np.where(both, covariance, 0.0) + np.eye(3) * ~read[:, None, :]
    if not np.all(np.linalg.eigvalsh(safe)[:, 0] > 0.0):
        return np.zeros(len(read))
    kept = np.where(read, deviations, 0.0)
    return np.asarray(np.einsum("ni,ni->n", kept, np.linalg.solve(safe, kept[:, :, None])[:, :, 0]))


def covariance_from_repeats(
    data: Measurements, instruments: StationInstruments, repeats: Sequence[Repeats]
) -> np.ndarray:
    """Return (n, 3, 3) the covariance of the readings from repeats, m²: each instrument's model, pooled over all its points.

    Raises `InputError`: fewer than ten degrees of freedom of repeats of an instrument.
    """
    covariance_from_repeats = np.zeros((len(data), 3, 3))
    by_instrument = {id(repeat.instrument): repeat for repeat in repeats}
    for instrument, rows in instruments.groups(data.station):
        own = by_instrument.get(id(instrument))
        if own is None or own.dof < FEWEST_REPEATS:
            raise data.error(
                f"too few repeats to estimate the noise of the {instrument.name}",
                expected="at least ten repeated readings",
                value=0 if own is None else own.dof,
            )
        covariance_from_repeats[rows] = own.covariance
    return read_only(covariance_from_repeats)
