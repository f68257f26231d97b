"""Motions of a carriage from the readings of a multi-axis interferometer with an uncertain installation.

The readings alone do not determine x and y, whatever the number of positions: y_d + c of every beam on the x mirror with
x_n + c·sin θ_n cos θ_n and y_n + c·sin² θ_n changes no reading, and likewise for the y mirror. θ is not affected, but its separation
from the beams' angles is so weak that it disappears in 0.1 nm of noise. So the self-calibration of Wen et al. (2023), their
Algorithm 2, has an error proportional to that of the installation. `measure` uses the stated installation and its uncertainties as
additional observations; its covariance contains what remains undetermined.

T. Wen, J. Hu, Y. Zhu, G. Hua: Multi-axis laser interferometer not affected by installation errors based on nonlinear computation,
Appl. Sci. 13 (2023) 10887.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin.measurement.instruments.multi_axis import MultiAxis

STEPS: Final = 25
SETTLED: Final = 1e-3
"""Change of chi² that ends the iteration: the estimate is then within three hundredths of a standard uncertainty of its minimum."""
HALVINGS: Final = 10


@final
@dataclass(frozen=True)
class Displacement:
    """Motions of the carriage at n positions, with the covariance from noise and from the installation.

    Attributes:
        poses: (n, 6) metres and radians.
        installation: (p,) estimated deviations from the nominal layout.
        noise_covariance: (n, f, f) covariance of each pose's free motions from the noise of its own readings.
        by_installation: (n, f, p) derivative of those motions with respect to the installation.
        installation_covariance: (p, p) covariance of the installation after these readings.
        residual: (n, m) readings minus predicted, metres; NaN where nothing was read.
        steps: number of steps taken.
        converged: whether the iteration converged.
    """

    poses: np.ndarray
    installation: np.ndarray
    noise_covariance: np.ndarray
    by_installation: np.ndarray
    installation_covariance: np.ndarray
    residual: np.ndarray
    steps: int
    converged: bool


@final
@dataclass(frozen=True)
class _Run:
    """Readings of a run, with their weights and the prior of the installation.

    Attributes:
        layout: nominal.
        readings: (n, m) metres, zero where nothing was read.
        weight: (n, m) one over the standard uncertainty, zero where nothing was read.
        free: indices of the installation's parameters that are not known exactly.
        prior: (free,) their standard uncertainties.
    """

    layout: MultiAxis
    readings: np.ndarray
    weight: np.ndarray
    free: np.ndarray
    prior: np.ndarray

    def chi2(self, poses: np.ndarray, installation: np.ndarray) -> float:
        """Return the whitened sum of squares of readings and installation."""
        left = (self.readings - self.layout.readings(poses, installation)) * self.weight
        return float(np.sum(left**2) + np.sum((installation[self.free] / self.prior) ** 2))

    def step(self, poses: np.ndarray, installation: np.ndarray) -> _Step:
        """Return the Gauss-Newton step, with the poses eliminated position by position."""
        predicted, by_pose, by_installation = self.layout.derivatives(poses, installation)
        residual = self.readings - predicted
        a, b = by_pose * self.weight[:, :, None], by_installation[:, :, self.free] * self.weight[:, :, None]
        n, m, f = a.shape
        q, r = np.linalg.qr(a, mode="complete")
        turned = q.transpose(0, 2, 1) @ np.concatenate([b, (residual * self.weight)[:, :, None]], axis=2)
        # The part of the readings that no pose explains determines the installation, together with its prior.
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
    """A Gauss-Newton step and its factors.

    Attributes:
        residual: (n, m) readings minus predicted, metres.
        installation: (free,) change.
        poses: (n, f) change of the free motions.
        inverse: (n, f, f) inverse factor of each pose's normal matrix.
        by_installation: (n, f, free) derivative of the motions with respect to the installation.
        root: (free, free) root of the installation's covariance.
    """

    residual: np.ndarray
    installation: np.ndarray
    poses: np.ndarray
    inverse: np.ndarray
    by_installation: np.ndarray
    root: np.ndarray


def measure(
    layout: MultiAxis, readings: np.ndarray, *, noise: float, installation_u: np.ndarray, poses: np.ndarray
) -> Displacement:
    """Estimate the motions of the carriage with an installation of stated uncertainty.

    Whitened Gauss-Newton with the nominal layout as additional observations, each with its standard uncertainty. The model is linear in
    the uncertainties of the installation. Second-order terms (the cosine of a beam tilted by δ: δ²/2 of the travel) are not in the
    covariance.

    Args:
        layout: nominal.
        readings: (n, m) metres; NaN for a beam that was not read there.
        noise: standard uncertainty of a reading, metres.
        installation_u: (p,) standard uncertainty of every parameter of the installation, metres, radians, one; 0 if known exactly.
        poses: (n, 6) initial values.

    Raises:
        InputError: arrays of the wrong shape; too few beams at a position.
    """
    run = _checked(layout, readings, noise, np.asarray(installation_u, dtype=float), poses)
    installation, found, motions = np.zeros(len(installation_u)), np.array(poses, dtype=float), list(layout.motions)
    step, taken, converged = run.step(found, installation), 0, False
    while not converged and taken < STEPS:
        taken += 1
        before = run.chi2(found, installation)
        # The tilt of a beam acts by its square only, so a full step may change its sign back and forth.
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
    by_installation = np.zeros((*step.poses.shape, len(installation)))
    by_installation[:, :, run.free] = step.by_installation
    covariance = np.zeros((len(installation), len(installation)))
    covariance[np.ix_(run.free, run.free)] = step.root @ step.root.T
    return Displacement(
        poses=read_only(found),
        installation=read_only(installation),
        noise_covariance=read_only(step.inverse @ step.inverse.transpose(0, 2, 1)),
        by_installation=read_only(by_installation),
        installation_covariance=read_only(covariance),
        residual=read_only(np.where(run.weight > 0.0, step.residual, np.nan)),
        steps=taken,
        converged=converged,
    )


def _checked(layout: MultiAxis, readings: np.ndarray, noise: float, u: np.ndarray, poses: np.ndarray) -> _Run:
    values = np.asarray(readings, dtype=float)
    if values.ndim != 2 or values.shape[1] != len(layout.beams) or np.shape(poses) != (len(values), 6):
        raise InputError(
            "readings and poses do not match",
            expected=f"(n, {len(layout.beams)}) and (n, 6)",
            value=f"{values.shape} and {np.shape(poses)}",
        )
    if not noise > 0.0:
        raise InputError("noise of a reading must be positive", expected="a standard uncertainty", value=noise)
    if u.shape != (len(layout.installation),) or not np.all((u >= 0.0) & np.isfinite(u)):
        raise InputError(
            "uncertainties of the installation are not valid",
            expected=f"{len(layout.installation)} finite numbers, none negative",
            value=u.shape,
        )
    read, free = np.isfinite(values), np.flatnonzero(u > 0.0)
    weight = np.where(read, 1.0 / noise, 0.0)
    _check_beams(layout, layout.derivatives(poses)[1] * weight[:, :, None])
    return _Run(layout, np.where(read, values, 0.0), weight, free, u[free])


def _check_beams(layout: MultiAxis, whitened: np.ndarray) -> None:
    # Rotations are scaled by a lever arm of 0.1 m; only the rank matters.
    sizes = np.array([1.0 if k < 3 else 10.0 for k in layout.motions])
    values = np.linalg.svd(whitened * sizes, compute_uv=False)
    weak = values[:, -1] < 1e-6 * values[:, 0] if values.shape[1] == len(sizes) else np.ones(len(values), dtype=bool)
    if np.any(weak):
        raise InputError(
            f"the beams read at position {int(np.argmax(weak)) + 1} do not determine its {len(sizes)} motions",
            expected="at least as many beams, on mirrors with different normals or distances",
            value=f"{np.count_nonzero(np.any(whitened[int(np.argmax(weak))] != 0.0, axis=1))} beams",
        )
