"""The motions of the carriage from the readings of a multi-axis interferometer whose installation is known as well as is stated.

The readings alone do not determine x and y, whatever the number of positions: y_d + c of every beam on the x mirror with
x_n + c·sin θ_n cos θ_n and y_n + c·sin² θ_n changes no reading, and likewise for the y mirror. θ is free of it; but what separates θ
from the beams' angles is so weak that it drowns in 0.1 nm of noise. So the self-calibration of Wen et al. (2023), their Algorithm 2, is
wrong in proportion to the installation's error. `measure` takes what is stated of the installation as further readings, and its
covariance contains what they leave open.

T. Wen, J. Hu, Y. Zhu, G. Hua: Multi-axis laser interferometer not affected by installation errors based on nonlinear computation,
Appl. Sci. 13 (2023) 10887.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.arrays import locked
from twin._common.errors import InputError
from twin.measurement.instruments.multi_axis import MultiAxis

STEPS: Final = 25
SETTLED: Final = 1e-3
"""Of chi²: a step that takes less off it leaves the estimate three hundredths of a standard uncertainty from its minimum."""
HALVINGS: Final = 10


@final
@dataclass(frozen=True)
class Displacement:
    """Motions of the carriage at n positions and their covariance: what noise does to each, and what the installation does to all.

    Attributes:
        poses: (n, 6) metres and radians.
        installation: (p,) deviations from the nominal layout, estimated.
        own: (n, f, f) covariance that the noise of its own readings gives each pose's free motions.
        lever: (n, f, p) change of those motions by the installation.
        installation_covariance: (p, p) what is left of the installation's, after these readings.
        residual: (n, m) readings less predicted, metres; NaN where nothing was read.
        steps: taken.
        converged: whether the last one was still.
    """

    poses: np.ndarray
    installation: np.ndarray
    own: np.ndarray
    lever: np.ndarray
    installation_covariance: np.ndarray
    residual: np.ndarray
    steps: int
    converged: bool


@final
@dataclass(frozen=True)
class _Run:
    """Readings of a run: (n, m) metres, zero where nothing was read, their weights, and what is stated of the installation.

    Attributes:
        layout: nominal.
        readings: (n, m) metres.
        weight: (n, m) one over the standard uncertainty, zero where nothing was read.
        free: indices of the installation's numbers that are not known exactly.
        prior: (free,) their standard uncertainties.
    """

    layout: MultiAxis
    readings: np.ndarray
    weight: np.ndarray
    free: np.ndarray
    prior: np.ndarray

    def chi2(self, poses: np.ndarray, installation: np.ndarray) -> float:
        """Whitened sum of squares of readings and installation together."""
        left = (self.readings - self.layout.readings(poses, installation)) * self.weight
        return float(np.sum(left**2) + np.sum((installation[self.free] / self.prior) ** 2))

    def step(self, poses: np.ndarray, installation: np.ndarray) -> _Step:
        """The Gauss-Newton step, poses eliminated position by position."""
        predicted, by_pose, by_installation = self.layout.derivatives(poses, installation)
        residual = self.readings - predicted
        a, b = by_pose * self.weight[:, :, None], by_installation[:, :, self.free] * self.weight[:, :, None]
        n, m, f = a.shape
        q, r = np.linalg.qr(a, mode="complete")
        turned = q.transpose(0, 2, 1) @ np.concatenate([b, (residual * self.weight)[:, :, None]], axis=2)
        # What of the readings no pose takes up tells of the installation; so does what is stated of it.
        stated = np.column_stack([np.diag(1.0 / self.prior), -installation[self.free] / self.prior])
        rows = np.concatenate([turned[:, f:].reshape(n * (m - f), -1), stated])
        triangle = np.asarray(np.linalg.qr(rows, mode="r")) if len(rows) else np.zeros((0, 1))
        count = len(self.free)
        root = np.linalg.inv(triangle[:count, :count])
        change = root @ triangle[:count, -1]
        inverse = np.linalg.inv(r[:, :f])
        moved = inverse @ (turned[:, :f, -1] - turned[:, :f, :-1] @ change)[:, :, None]
        return _Step(residual, change, moved[:, :, 0], inverse, -inverse @ turned[:, :f, :-1], root)


@final
@dataclass(frozen=True)
class _Step:
    """One step and what it rests on.

    Attributes:
        residual: (n, m) readings less predicted, metres.
        installation: (free,) change.
        poses: (n, f) change of the free motions.
        inverse: (n, f, f) inverse factor of each pose's normal matrix.
        lever: (n, f, free) change of the motions by the installation.
        root: (free, free) root of the installation's covariance.
    """

    residual: np.ndarray
    installation: np.ndarray
    poses: np.ndarray
    inverse: np.ndarray
    lever: np.ndarray
    root: np.ndarray


def measure(
    layout: MultiAxis, readings: np.ndarray, *, noise: float, installation_u: np.ndarray, poses: np.ndarray
) -> Displacement:
    """Motions of the carriage with an installation that is known as well as is stated.

    Whitened Gauss-Newton: the nominal layout is one more set of readings, each with its standard uncertainty. Linear in the
    uncertainties of the installation; what is of second order in them (the cosine of a beam askew by δ: δ²/2 of the travel) is not in
    the covariance.

    Args:
        layout: nominal.
        readings: (n, m) metres; NaN for a beam that was not read there.
        noise: standard uncertainty of a reading, metres.
        installation_u: (p,) standard uncertainty of every number of the installation, metres, radians, one: 0 for known.
        poses: (n, 6) to start from.

    Raises:
        InputError: arrays of the wrong shape; too few beams at a position.
    """
    run = _checked(layout, readings, noise, np.asarray(installation_u, dtype=float), poses)
    installation, found, motions = np.zeros(len(installation_u)), np.array(poses, dtype=float), list(layout.motions)
    step, taken, converged = run.step(found, installation), 0, False
    while not converged and taken < STEPS:
        taken += 1
        before = run.chi2(found, installation)
        # A beam askew shows only by the square of its angle: a full step may throw it from one side to the other.
        for halvings in range(HALVINGS):
            next_installation, next_found = installation.copy(), found.copy()
            next_installation[run.free] += step.installation * 0.5**halvings
            next_found[:, motions] += step.poses * 0.5**halvings
            after = run.chi2(next_found, next_installation)
            if after < before:
                installation, found = next_installation, next_found
                break
        converged = before - after <= SETTLED
        step = run.step(found, installation)
    lever = np.zeros((*step.poses.shape, len(installation)))
    lever[:, :, run.free] = step.lever
    covariance = np.zeros((len(installation), len(installation)))
    covariance[np.ix_(run.free, run.free)] = step.root @ step.root.T
    return Displacement(
        poses=locked(found),
        installation=locked(installation),
        own=locked(step.inverse @ step.inverse.transpose(0, 2, 1)),
        lever=locked(lever),
        installation_covariance=locked(covariance),
        residual=locked(np.where(run.weight > 0.0, step.residual, np.nan)),
        steps=taken,
        converged=converged,
    )


def _checked(layout: MultiAxis, readings: np.ndarray, noise: float, u: np.ndarray, poses: np.ndarray) -> _Run:
    given = np.asarray(readings, dtype=float)
    if given.ndim != 2 or given.shape[1] != len(layout.beams) or np.shape(poses) != (len(given), 6):
        raise InputError(
            "readings and poses do not match",
            expected=f"(n, {len(layout.beams)}) and (n, 6)",
            value=f"{given.shape} and {np.shape(poses)}",
        )
    if not noise > 0.0:
        raise InputError("noise of a reading not positive", expected="a standard uncertainty", value=noise)
    if u.shape != (len(layout.installation),) or not np.all((u >= 0.0) & np.isfinite(u)):
        raise InputError(
            "uncertainty of the installation of the wrong shape",
            expected=f"{len(layout.installation)} numbers, finite and none negative",
            value=u.shape,
        )
    read, free = np.isfinite(given), np.flatnonzero(u > 0.0)
    weight = np.where(read, 1.0 / noise, 0.0)
    _check_beams(layout, layout.derivatives(poses)[1] * weight[:, :, None])
    return _Run(layout, np.where(read, given, 0.0), weight, free, u[free])


def _check_beams(layout: MultiAxis, whitened: np.ndarray) -> None:
    # Turns count by a lever of a tenth of a metre: only whether six motions are fixed at all is asked.
    sizes = np.array([1.0 if k < 3 else 10.0 for k in layout.motions])
    values = np.linalg.svd(whitened * sizes, compute_uv=False)
    weak = values[:, -1] < 1e-6 * values[:, 0] if values.shape[1] == len(sizes) else np.ones(len(values), dtype=bool)
    if np.any(weak):
        raise InputError(
            f"the beams read at position {int(np.argmax(weak)) + 1} do not fix its {len(sizes)} motions",
            expected="as many beams on mirrors apart from each other",
            value=f"{np.count_nonzero(np.any(whitened[int(np.argmax(weak))] != 0.0, axis=1))} beams",
        )
