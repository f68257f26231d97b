"""Whitened nonlinear least squares with a weak prior, which acts only where the readings say little.

Every unknown is counted in its plausible size: an error in that of its kind (`Machine.plausible`: one standard deviation before
anything is measured), a station or a target in that of `setup`. In these units each singular direction of the derivatives has a
strength σ, the ratio of signal to noise. The noise s is one where the model fits within the stated uncertainty; where the model leaves
something out, it is the size of the whitened residuals, because a direction that is weaker than the misfit would be fitted to the
misfit.

Every error has a Gaussian prior about zero with its plausible size, stations and targets one about where the estimate begins. Where the
model fits, s = 1, only directions with σ ≤ 1 have it, and stay where they are: nothing that the readings determine is pulled, and
readings without noise give the errors to the last digits. The covariance is that of this estimator: of the readings' scatter and of the
prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Final, final

import numpy as np
from scipy.linalg.lapack import dtpqrt

from twin._common.arrays import locked
from twin._common.threads import side_by_side
from twin._common.units import MM, URAD
from twin.identification.network import Network
from twin.identification.setup import SetUp
from twin.identification.unknowns import UnknownNumber, Unknowns
from twin.machine.effects import unit_of
from twin.numerics.observability import WEAKEST, Determinability, Spectrum, Unknown, decompose

FIRM: Final = 1e9
"""Weight of a condition of the datum where it stands as one more reading."""
STEPS: Final = 50
PLAIN: Final = 6
"""Steps as Gauss and Newton have them, enough for a five-axis machine seen from everywhere. Where few axes leave a station or target
known hardly better than beforehand, the derivatives change over that uncertainty and such steps shrink by a tenth each, some to and
fro: from here on the last few say how."""
MEMORY: Final = 4
WORSE: Final = 1e-6
"""Share by which the sum of squares may grow in a step: rounding."""
HALVINGS: Final = 10
FIRM_STEP: Final = 30.0
"""Strength up to which priors of the machine's unknowns move no station or target: they would move it far for little, as no prior of
its own holds it, and the covariance has this strength all the same."""
PANEL: Final = 32
"""Columns of a block of the factorisation: of no consequence but time."""
NEAR: Final = 5e-3
"""Share of its plausible size that a station or target is held within where the model leaves something out: they were fitted to the
machine as drawn. Else one plane of points, or a place that no rotation shows, would move by decimetres to make an error smaller."""
STILL: Final = 1e-4
"""A step that changes the whitened residuals by no more than this (root of the sum of squares) is the last: the errors of a machine
are small, the next step is a thousandth of it or less, and what is left 1e-7 of a standard uncertainty."""


@final
@dataclass(frozen=True)
class FitSolution:
    """An estimate.

    Attributes:
        theta: (columns,) µm and µrad.
        setup: stations and targets.
        triangle: (p + 1, p + 1) factor of [J | r] at the estimate.
        spectrum: directions (machine's and set-up's, plausible units) that the data determine, their singular values, and those
            directions that they do not; the datum's conditions respected.
        determined: how many numbers the readings settle: the trace of their share in the estimate.
        converged: whether the last step was still.
        steps: how many were taken.
        noise: size of the whitened residuals that the prior was weighed against; one where the model fits.
        precision: (columns,) of the machine's unknowns about zero beside the weak prior, one over µm² or µrad².
        free: (p, f) orthonormal directions that keep the datum.
    """

    theta: np.ndarray
    setup: SetUp
    triangle: np.ndarray
    spectrum: Spectrum
    determined: float
    converged: bool
    steps: int
    noise: float
    precision: np.ndarray
    free: np.ndarray

    @cached_property
    def basis(self) -> np.ndarray:
        """(p, f) all directions that the datum allows, plausible units, strongest first."""
        return locked(np.concatenate([self.spectrum.directions, self.spectrum.null_space], axis=1))

    @cached_property
    def stiffness(self) -> np.ndarray:
        """(f,) precision of the estimate along each direction, prior included."""
        return locked(self.spectrum.values**2 + self.noise**2 * _with_prior(self.spectrum.values, self.noise))

    @property
    def unseen(self) -> np.ndarray:
        """(p,) share of each unknown's plausible variance that readings with this noise leave."""
        return np.asarray(self.basis**2 @ (self.noise**2 / (self.spectrum.values**2 + self.noise**2)))

    def covariance(self, scatter: np.ndarray | None = None) -> np.ndarray:
        """Return the (p, p) covariance of the estimate: that of the readings carried through, and that of the priors.

        A⁻¹ (M + P) A⁻¹ with the estimator's own A, the scatter M of the normal equations' right side and the priors' share P of it.

        Args:
            scatter: (p, p) M in the derivatives' units, if not that of the stated uncertainty, JᵀJ (`twin.identification.spread`).
        """
        scale = self.spectrum.scale
        j = self.triangle[:, :-1]
        middle = (j.T @ j if scatter is None else scatter) * np.outer(scale, scale)
        held = np.zeros(len(scale))
        held[: len(self.precision)] = self.noise**2 * self.precision * scale[: len(self.precision)] ** 2
        inner = self.basis.T @ (middle + np.diag(held)) @ self.basis
        inner += np.diag(self.noise**4 * _with_prior(self.spectrum.values, self.noise))
        root = self.basis * scale[:, None] / self.stiffness
        return np.asarray(root @ inner @ root.T)

    @property
    def chi2(self) -> float:
        """Sum of squared whitened residuals."""
        return float(np.sum(self.triangle[:, -1] ** 2))

    def rank_of(self, columns: Sequence[int], datum: np.ndarray) -> int:
        """How many directions the data see of the set-up and some of the machine's columns, the datum's conditions kept."""
        machine = datum.shape[1]
        scale = self.spectrum.scale
        kept = [*columns, *range(machine, len(scale))]
        conditions = np.zeros((len(datum), len(scale)))
        conditions[:, :machine] = datum
        whole = np.concatenate([self.triangle[:, :-1] * scale, FIRM * conditions])[:, kept]
        return int(np.count_nonzero(np.linalg.svd(whole, compute_uv=False) > WEAKEST))

    def told(self, unknowns: Unknowns, readings: int) -> Determinability:
        """What the readings determine, with names, in the units users see.

        Args:
            unknowns: the machine's.
            readings: how many they are.
        """
        return Determinability(named(unknowns, self.setup), self.spectrum, WEAKEST, readings)


def named(unknowns: Unknowns, setup: SetUp) -> tuple[Unknown, ...]:
    """Every unknown number of a machine and its set-up, as it is to be read in a sentence.

    Args:
        unknowns: the machine's: µm and µrad.
        setup: stations and targets: metres and radians inside, mm and µrad outside.
    """
    found = [
        Unknown(_name(column, unknowns), unit_of(column.entity), size)
        for column, size in zip(unknowns.columns, unknowns.plausible.tolist(), strict=True)
    ]
    return (*found, *named_setup(setup))


def named_setup(setup: SetUp) -> tuple[Unknown, ...]:
    """The set-up's part of `named`."""
    found = []
    for name, size in zip(setup.names, setup.plausible, strict=True):
        unit, factor = ("urad", URAD) if " turn " in name else ("mm", MM)
        found.append(Unknown(name, unit, float(size) / factor, factor))
    return tuple(found)


def _name(column: UnknownNumber, unknowns: Unknowns) -> str:
    curve = any(one.name == column.entity for one in unknowns.curves)
    return f"{column.entity} order {column.index}" if curve else column.entity


def solve(
    network: Network,
    theta: np.ndarray,
    setup: SetUp,
    weight: np.ndarray,
    *,
    precision: np.ndarray | None = None,
    noise: float = 1.0,
    steps: int = STEPS,
    triangle: np.ndarray | None = None,
) -> FitSolution:
    """Gauss-Newton from a start that fulfils the datum's conditions.

    Args:
        network: data and model.
        theta: machine's unknowns to start from, µm and µrad.
        setup: stations and targets to start from; how far they are from their prior places is in it (`SetUp.shift`).
        weight: (n,) of each point.
        precision: (columns,) of the machine's unknowns about zero, one over µm² or µrad²; none if None.
        noise: size of the whitened residuals that this model leaves, one at least; see the module.
        steps: at most.
        triangle: factor of [J | r] at the start, for whoever has it; found if None.
    """
    problem = _Problem.of(network, setup, noise, precision)
    here = _Place(theta, setup)
    weakest = FIRM_STEP if precision is not None else WEAKEST
    taken, halved, before, last = 0, 0, np.inf, here
    wanted: list[np.ndarray] = []
    gone: list[np.ndarray] = []
    while True:
        found = factor(network, here.theta, here.setup, weight) if triangle is None else triangle
        triangle = None
        cost = problem.cost(here, found)
        if cost > before * (1.0 + WORSE) and taken < steps:
            # The derivatives do not hold as far as the step: the plain one, then half of it. What was learnt of how steps change does
            # not hold either.
            wanted = wanted[-1:]
            gone = [wanted[0] * 0.5**halved if halved <= HALVINGS else np.zeros_like(wanted[0])]
            here, halved, taken = last.after(gone[0] * problem.near), halved + 1, taken + 1
            continue
        left, spectrum = problem.decomposed(found, problem.near)
        if taken == steps:
            return problem.solution(here, found, spectrum, taken, converged=False)
        along = left.T @ np.concatenate([found[:, -1], -problem.root @ here.theta])
        step, change = _newton(spectrum, along, here.off / problem.near, noise, weakest)
        converged = change <= STILL * noise or bool(np.abs(step).max(initial=0.0) < 1e-14)
        wanted.append(step)
        if taken >= PLAIN and not converged:
            step = _ahead(wanted, gone, spectrum)
        gone.append(step)
        last, before, halved = here, cost, 0
        here = here.after(step * problem.near)
        taken += 1
        if converged:
            # The last step is too small to change the derivatives: only what is left of the readings moves.
            found = np.array(found)
            found[:, -1] -= found[:, :-1] @ (step * problem.near)
            return problem.solution(here, found, spectrum, taken, converged=True)


@final
@dataclass(frozen=True)
class _Place:
    """Where a search stands: the machine's unknowns and the set-up."""

    theta: np.ndarray
    setup: SetUp

    @property
    def off(self) -> np.ndarray:
        """(p,) how far every unknown is from its prior place."""
        shift = np.zeros(len(self.setup)) if self.setup.shift is None else self.setup.shift
        return np.concatenate([self.theta, shift])

    def after(self, step: np.ndarray) -> _Place:
        """After a step of all unknowns."""
        machine = len(self.theta)
        return _Place(self.theta + step[:machine], self.setup.moved(step[machine:]))


@final
@dataclass(frozen=True)
class _Problem:
    """What stays the same from step to step.

    Attributes:
        noise: see `solve`.
        precision: (columns,) of the machine's unknowns about zero.
        root: (columns, columns) root of it, times the noise.
        free: (p, f) orthonormal directions that keep the datum.
        scale: (p,) plausible sizes.
        near: (p,) sizes of the priors in the search (`NEAR`).
    """

    noise: float
    precision: np.ndarray
    root: np.ndarray
    free: np.ndarray
    scale: np.ndarray
    near: np.ndarray

    @classmethod
    def of(cls, network: Network, setup: SetUp, noise: float, precision: np.ndarray | None) -> _Problem:
        """Of an estimate; arguments as of `solve`."""
        machine = len(network.unknowns)
        held = np.zeros(machine) if precision is None else precision
        scale = np.concatenate([network.unknowns.plausible, setup.plausible])
        near = np.array(scale)
        near[machine:] *= NEAR if noise > 1.0 else 1.0
        free = free_directions(network.unknowns.datum, machine, len(setup))
        return cls(noise, held, np.diag(noise * np.sqrt(held)), free, scale, near)

    def cost(self, here: _Place, triangle: np.ndarray) -> float:
        """Sum of squares of readings and priors."""
        cost = float(np.sum(triangle[:, -1] ** 2) + np.sum((self.root @ here.theta) ** 2))
        return cost + (float(self.noise**2 * np.sum((here.off / self.near) ** 2)) if self.noise > 1.0 else 0.0)

    def decomposed(self, triangle: np.ndarray, scale: np.ndarray) -> tuple[np.ndarray, Spectrum]:
        """Left singular vectors of all directions that have a say in the step, and the spectrum: seen is what exceeds the noise.

        Args:
            triangle: factor of [J | r].
            scale: (p,) sizes of the priors.
        """
        prior = np.zeros((len(self.root), len(scale)))
        prior[:, : len(self.root)] = self.root
        matrix = np.concatenate([triangle[:, :-1], prior]) * scale
        if self.noise <= 1.0:
            return decompose(matrix, scale, free=self.free)
        # The prior is what holds here: every direction counts, however weak the readings along it, or no step would reach the least.
        left, every = decompose(matrix, scale, free=self.free, tolerance=0.0)
        basis = np.concatenate([every.directions, every.null_space], axis=1)
        seen = int(np.count_nonzero(every.values > self.noise))
        return left, Spectrum(every.scale, every.values, locked(basis[:, :seen]), locked(basis[:, seen:]))

    def solution(
        self, here: _Place, triangle: np.ndarray, spectrum: Spectrum, taken: int, *, converged: bool
    ) -> FitSolution:
        """The estimate where a search ended."""
        if self.noise > 1.0:
            _, spectrum = self.decomposed(triangle, self.scale)
        found = FitSolution(
            theta=here.theta,
            setup=here.setup,
            triangle=triangle,
            spectrum=spectrum,
            determined=0.0,
            converged=converged,
            steps=taken,
            noise=self.noise,
            precision=self.precision,
            free=self.free,
        )
        share = np.sum((triangle[:, :-1] * self.scale @ found.basis) ** 2 / found.stiffness)
        return replace(found, determined=float(share))


def _with_prior(strength: np.ndarray, noise: float) -> np.ndarray:
    """(f,) one for each direction that has the prior: where the model fits, those that the readings do not see."""
    return np.ones_like(strength) if noise > 1.0 else (strength <= WEAKEST).astype(float)


def factor(network: Network, theta: np.ndarray, setup: SetUp, weight: np.ndarray) -> np.ndarray:
    """(p + 1, p + 1) triangular factor of [J | r], rows weighted: everything a least-squares step needs.

    Args:
        network: data and model.
        theta: machine's unknowns.
        setup: stations and targets.
        weight: (n,) of each point; zero leaves it out.
    """
    size = len(theta) + len(setup) + 1

    def summed(share: Sequence[np.ndarray]) -> np.ndarray:
        found = np.zeros((size, size), order="F")
        for rows in share:
            piece = network.piece(theta, setup, rows)
            both = piece.columns
            both *= np.sqrt(weight[piece.rows])[:, None]
            found = _on_top(found, both.reshape(size, -1).T)
        return found

    whole, *others = side_by_side(network.shares, summed)
    for part in others:
        whole = _on_top(whole, np.asfortranarray(np.triu(part)))
    return np.triu(whole)


def _on_top(triangle: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Factor of a triangle on top of rows: LAPACK's factorisation that knows it is one."""
    found, _, _, _ = dtpqrt(0, min(PANEL, len(triangle)), triangle, rows, overwrite_a=1, overwrite_b=1)
    return np.asarray(found)


def _newton(
    spectrum: Spectrum, along: np.ndarray, off: np.ndarray, noise: float, weakest: float
) -> tuple[np.ndarray, float]:
    """The step to the least sum of squares of readings and prior, and how much it changes them, root of the sum of squares.

    Args:
        spectrum: of the derivatives, with the directions that are not seen.
        along: (d,) residuals along the directions that have a say, strongest first.
        off: (p,) how far every unknown is from its prior place, plausible units.
        noise: see `solve`.
        weakest: strength up to which a direction stays where it is, if the model fits.
    """
    basis = np.concatenate([spectrum.directions, spectrum.null_space], axis=1)
    values = spectrum.values
    prior = noise**2 * _with_prior(values, noise)
    right = -prior * (basis.T @ off) if noise > 1.0 else np.zeros(len(values))
    right[: len(along)] += values[: len(along)] * along
    if noise <= 1.0:
        # What the readings hardly show stays where it is: derivatives across a plane of points do not hold for long.
        right[values <= weakest] = 0.0
    stiffness = values**2 + prior
    coefficients = right / stiffness
    return basis @ coefficients, float(np.linalg.norm(np.sqrt(stiffness) * coefficients))


def _ahead(wanted: Sequence[np.ndarray], gone: Sequence[np.ndarray], spectrum: Spectrum) -> np.ndarray:
    """The step to where the last few, taken as straight in what they change, would want none (Anderson 1965; Walker and Ni 2011).

    Args:
        wanted: (p,) each, what Gauss and Newton wanted at the last places and want here.
        gone: (p,) each, the steps between these places.
        spectrum: here; its directions times their strength say what a step changes in the whitened residuals.
    """
    last = list(wanted)[-MEMORY - 1 :]
    more = np.stack([after - before for before, after in pairwise(last)], axis=1)
    way = np.stack(list(gone)[1 - len(last) :], axis=1)
    changes = spectrum.singular_values[:, None] * spectrum.directions.T
    share = np.linalg.lstsq(changes @ more, changes @ last[-1], rcond=1e-6)[0]
    return np.asarray(last[-1] - (way + more) @ share)


def free_directions(datum: np.ndarray, machine: int, setup: int) -> np.ndarray:
    """(p, p − conditions) orthonormal directions that keep the datum."""
    if len(datum) == 0:
        return np.eye(machine + setup)
    _, values, v = np.linalg.svd(datum, full_matrices=True)
    rank = int(np.count_nonzero(values > 1e-9 * values[0]))
    inside = v[rank:].T
    found = np.zeros((machine + setup, inside.shape[1] + setup))
    found[:machine, : inside.shape[1]] = inside
    found[machine:, inside.shape[1] :] = np.eye(setup)
    return found
