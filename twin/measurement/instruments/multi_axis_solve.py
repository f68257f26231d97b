"""From a multi-axis interferometer's readings to the carriage's motions: by the readings alone, and with a known installation.

The readings alone do not give x and y, whatever the number of positions: y_d + c of every beam on the x mirror with
x_n + c·sin θ_n cos θ_n and y_n + c·sin² θ_n changes no reading, and likewise for the y mirror. θ is free of it; but what tells θ from
the beams' angles is so weak that it drowns in 0.1 nm of noise. So what `self_calibrate`, Algorithm 2 of Wen et al. (2023), finds is
wrong in proportion to the installation's error, x and y and θ alike. `measure` says so: it takes what is stated of the installation
as readings of their own, and what they leave open stands in its covariance.

Of the paper, then, this holds: eq. 1 and 2 and beams 1 to 3 of eq. 3 and 4; Algorithm 2 in four steps at most; the twelve indices of
its fig. 7b, in the order x_d1, y_d1, α_1, x_d2, … (not in that of its eq. 30), in mm and rad, cut after the 33rd eigenvalue, and no
other way. This does not: the sign of beams 4 to 6 (`twin.measurement.instruments.multi_axis`); that x and y are unique (rank 46 of
48, and 159 of 165 with nine beams); that α is solved (a third of it lies in what the truncation leaves out); that the result does
not depend on the installation (tenfold error of it, tenfold error of x); and so that 1.884 nm is what 0.1 nm of noise does: with the
installation known that is 0.029 nm and 4.17e-7 mrad.

T. Wen, J. Hu, Y. Zhu, G. Hua: Multi-axis laser interferometer not affected by installation errors based on nonlinear computation,
Appl. Sci. 13 (2023) 10887.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.arrays import locked
from twin._common.errors import InputError
from twin._common.units import MM, UM, URAD
from twin.measurement.instruments.multi_axis import MOTIONS, MultiAxis
from twin.numerics.observability import Determinability, Unknown, decompose, determinability

STEPS: Final = 25
STILL: Final = 1e-3
"""A step that changes the readings by less than this, root of the sum of squares in standard uncertainties, is the last."""
MRAD: Final = 1e-3
SETTLED: Final = 1e-3
"""Of chi²: a step that takes less off it leaves the estimate three hundredths of a standard uncertainty from its minimum."""
HALVINGS: Final = 10
OPEN_LENGTH: Final = MM
OPEN_ANGLE: Final = MRAD
OPEN_SCALE: Final = 1e-3
"""How far an installation's number of which nothing is stated may be off: sizes to judge the readings by, no part of an estimate."""


@final
@dataclass(frozen=True)
class SelfCalibration:
    """What Algorithm 2 found.

    Attributes:
        poses: (n, 6) metres and radians.
        installation: (p,) deviations from the nominal layout.
        residual: (n, m) readings less predicted, metres.
        determinability: of all the unknowns at the solution, the truncation of the last step its tolerance.
        steps: taken.
        converged: whether the last one was still.
    """

    poses: np.ndarray
    installation: np.ndarray
    residual: np.ndarray
    determinability: Determinability
    steps: int
    converged: bool


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

    @property
    def covariance(self) -> np.ndarray:
        """(n·f, n·f) joint, position after position."""
        n, f, p = self.lever.shape
        flat = self.lever.reshape(n * f, p)
        whole = flat @ self.installation_covariance @ flat.T
        for i in range(n):
            whole[i * f : (i + 1) * f, i * f : (i + 1) * f] += self.own[i]
        return np.asarray((whole + whole.T) / 2.0)

    @property
    def u(self) -> np.ndarray:
        """(n, f) standard uncertainties, metres and radians."""
        return np.sqrt(np.einsum("nii->ni", self.own) + self.u_installation**2)

    @property
    def u_installation(self) -> np.ndarray:
        """(n, f) the installation's part of `u`: the same for all, so that no number of repeats takes it away."""
        return np.sqrt(np.einsum("nfp,pq,nfq->nf", self.lever, self.installation_covariance, self.lever))


def plausible_of(layout: MultiAxis, length: float, angle: float, scale: float) -> np.ndarray:
    """(p,) one size for the lengths of an installation, one for its angles, one for the scale."""
    return np.array(
        [scale if name == "scale" else angle if " turn " in name else length for name in layout.installation]
    )


def question(
    layout: MultiAxis,
    poses: np.ndarray,
    installation: np.ndarray,
    *,
    unknown: np.ndarray,
    pose_sizes: tuple[float, float],
    installation_sizes: np.ndarray,
) -> tuple[np.ndarray, tuple[Unknown, ...]]:
    """Derivatives and unknowns of a self-calibration: installation first, beam after beam, then position after position.

    Args:
        layout: nominal.
        poses: (n, 6).
        installation: (p,).
        unknown: (p,) mask of the installation's numbers that are.
        pose_sizes: plausible translation and turn, metres and radians.
        installation_sizes: (p,) plausible, metres, radians, one.

    Returns:
        (n·m, q) metres a metre or radian, and the q unknowns.
    """
    _, by_pose, by_installation = layout.derivatives(poses, installation)
    n, m, f = by_pose.shape
    kept = np.flatnonzero(unknown)
    matrix = np.zeros((n, m, len(kept) + n * f))
    matrix[:, :, : len(kept)] = by_installation[:, :, kept]
    for i in range(n):
        matrix[i, :, len(kept) + i * f : len(kept) + (i + 1) * f] = by_pose[i]
    unknowns = [_unknown(layout.installation[i], float(installation_sizes[i])) for i in kept]
    unknowns += [
        _unknown(f"position {i + 1} {MOTIONS[k]}", pose_sizes[k >= 3]) for i in range(n) for k in layout.motions
    ]
    return matrix.reshape(n * m, -1), tuple(unknowns)


def self_calibrate(
    layout: MultiAxis,
    readings: np.ndarray,
    *,
    noise: float,
    tolerance: float,
    poses: np.ndarray,
    installation: np.ndarray | None = None,
    unknown: np.ndarray | None = None,
    length: float = MM,
    angle: float = MRAD,
    steps: int = STEPS,
) -> SelfCalibration:
    """Algorithm 2 of Wen et al. (2023): Newton steps by a truncated Moore-Penrose inverse.

    Along the null space every step is the shortest: what is found there is the start, projected. The paper names neither the truncation
    nor the units that "shortest" is measured in; both are arguments here.

    Args:
        layout: nominal.
        readings: (n, m) metres.
        noise: standard uncertainty of a reading, metres.
        tolerance: singular values at or below this share of the largest are left out.
        poses: (n, 6) to start from.
        installation: (p,) to start from; the nominal layout if None.
        unknown: (p,) mask of the installation's numbers sought; all of the beams if None.
        length: unit of lengths in the singular values and in "shortest", metres; mm as in the paper's table 1.
        angle: unit of angles there, radians; mrad likewise.
        steps: at most.

    Raises:
        InputError: readings of the wrong shape or not finite; a tolerance not between 0 and 1; no noise.
    """
    given = _checked(layout, readings, poses, noise)
    if not np.all(np.isfinite(given)):
        raise InputError("a reading is missing", expected="every beam at every position", value="NaN")
    if not 0.0 < tolerance < 1.0:
        raise InputError("no truncation", expected="a share of the largest singular value, 0 to 1", value=tolerance)
    sought = layout.of_beams if unknown is None else np.asarray(unknown, dtype=bool)
    told = np.zeros(len(layout.installation)) if installation is None else np.array(installation, dtype=float)
    found = np.array(poses, dtype=float)
    n, motions, count = len(given), list(layout.motions), int(np.count_nonzero(sought))
    sizes = plausible_of(layout, length, angle, 1.0)
    taken, converged = 0, False
    while True:
        matrix, unknowns = question(
            layout, found, told, unknown=sought, pose_sizes=(length, angle), installation_sizes=sizes
        )
        residual = given - layout.readings(found, told)
        scale = np.array([one.plausible * one.factor for one in unknowns])
        whitened = matrix * scale / noise
        least = tolerance * float(np.linalg.norm(whitened, 2))
        if converged or taken == steps:
            answer = determinability(matrix / noise, unknowns, tolerance=least, measurements=n)
            return SelfCalibration(locked(found), locked(told), locked(residual), answer, taken, converged)
        left, spectrum = decompose(whitened, scale, tolerance=least)
        along = left.T @ residual.reshape(-1) / noise
        step = spectrum.directions @ (along / spectrum.strength) * scale
        told[sought] += step[:count]
        found[:, motions] += step[count:].reshape(n, -1)
        taken += 1
        converged = bool(np.linalg.norm(along) <= STILL)


def measure(
    layout: MultiAxis,
    readings: np.ndarray,
    *,
    noise: float | np.ndarray,
    installation_u: np.ndarray,
    poses: np.ndarray,
    steps: int = STEPS,
) -> Displacement:
    """Motions of the carriage with an installation that is known as well as is stated.

    Whitened Gauss-Newton: the nominal layout is one more set of readings, each with its standard uncertainty. Linear in the
    uncertainties of the installation; what is of second order in them (the cosine of a beam askew by δ: δ²/2 of the travel) is not in
    the covariance.

    Args:
        layout: nominal.
        readings: (n, m) metres; NaN for a beam that was not read there.
        noise: standard uncertainty of a reading, metres; one for all, or an array that fits (n, m).
        installation_u: (p,) standard uncertainty of every number of the installation, metres, radians, one: 0 for known, infinite
            for not known at all.
        poses: (n, 6) to start from.
        steps: at most.

    Raises:
        InputError: arrays of the wrong shape; too few beams at a position; an installation that these readings leave open where nothing
            is stated of it, with what moves along in words.
    """
    sigma = np.broadcast_to(np.asarray(noise, dtype=float), np.shape(readings))
    given = _checked(layout, readings, poses, sigma)
    prior = np.asarray(installation_u, dtype=float)
    if prior.shape != (len(layout.installation),) or not np.all(prior >= 0.0):
        raise InputError(
            "uncertainty of the installation of the wrong shape",
            expected=f"{len(layout.installation)} numbers, none negative",
            value=prior.shape,
        )
    read = np.isfinite(given)
    weight = np.where(read, 1.0 / sigma, 0.0)
    given = np.where(read, given, 0.0)
    told, found = np.zeros(len(prior)), np.array(poses, dtype=float)
    free = np.flatnonzero(prior > 0.0)
    stated = np.isfinite(prior[free])
    motions = list(layout.motions)
    n, m, f = len(given), len(layout.beams), len(motions)
    taken, converged = 0, False
    while True:
        predicted, by_pose, by_installation = layout.derivatives(found, told)
        residual = (given - predicted) * weight
        a, b = by_pose * weight[:, :, None], by_installation[:, :, free] * weight[:, :, None]
        if taken == 0:
            _enough(layout, a)
        q, r = np.linalg.qr(a, mode="complete")
        r = r[:, :f]
        turned = q.transpose(0, 2, 1) @ np.concatenate([b, residual[:, :, None]], axis=2)
        # What of the readings no pose takes up tells of the installation; so does what is stated of it.
        rows = np.concatenate([turned[:, f:].reshape(n * (m - f), -1), _prior(prior[free], told[free])])
        if taken == 0 and not np.all(stated):
            _not_open(layout, rows[:, :-1], free, stated, prior)
        triangle = np.asarray(np.linalg.qr(rows, mode="r")) if len(rows) else np.zeros((0, 1))
        root = np.linalg.inv(triangle[: len(free), : len(free)])
        step = root @ triangle[: len(free), -1]
        inverse = np.linalg.inv(r)
        by_step = (turned[:, :f, -1] - turned[:, :f, :-1] @ step)[:, :, None]
        by_pose_step = (inverse @ by_step)[:, :, 0]
        if converged or taken == steps:
            break
        taken += 1
        # A beam askew shows only by the square of its angle: a full step may throw it from one side to the other.
        before = float(np.sum(residual**2) + np.sum((told[free] / prior[free]) ** 2))
        for halvings in range(HALVINGS):
            next_told, next_found = told.copy(), found.copy()
            next_told[free] += step * 0.5**halvings
            next_found[:, motions] += by_pose_step * 0.5**halvings
            left = (given - layout.readings(next_found, next_told)) * weight
            after = float(np.sum(left**2) + np.sum((next_told[free] / prior[free]) ** 2))
            if after < before:
                told, found = next_told, next_found
                break
        converged = before - after <= SETTLED
    lever = np.zeros((n, f, len(prior)))
    lever[:, :, free] = -inverse @ turned[:, :f, :-1]
    covariance = np.zeros((len(prior), len(prior)))
    covariance[np.ix_(free, free)] = root @ root.T
    return Displacement(
        poses=locked(found),
        installation=locked(told),
        own=locked(inverse @ inverse.transpose(0, 2, 1)),
        lever=locked(lever),
        installation_covariance=locked(covariance),
        residual=locked(np.where(read, given - predicted, np.nan)),
        steps=taken,
        converged=converged,
    )


def _checked(layout: MultiAxis, readings: np.ndarray, poses: np.ndarray, noise: float | np.ndarray) -> np.ndarray:
    given = np.asarray(readings, dtype=float)
    if given.ndim != 2 or given.shape[1] != len(layout.beams) or np.shape(poses) != (len(given), 6):
        raise InputError(
            "readings and poses do not match",
            expected=f"(n, {len(layout.beams)}) and (n, 6)",
            value=f"{given.shape} and {np.shape(poses)}",
        )
    if not np.all(np.asarray(noise) > 0.0):
        raise InputError("noise of a reading not positive", expected="a standard uncertainty", value=np.min(noise))
    return given


def _enough(layout: MultiAxis, whitened: np.ndarray) -> None:
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


def _prior(u: np.ndarray, told: np.ndarray) -> np.ndarray:
    rows = np.diag(1.0 / u)
    return np.concatenate([rows, -(told / u)[:, None]], axis=1)


def _not_open(layout: MultiAxis, rows: np.ndarray, free: np.ndarray, stated: np.ndarray, prior: np.ndarray) -> None:
    sizes = np.where(stated, prior[free], plausible_of(layout, OPEN_LENGTH, OPEN_ANGLE, OPEN_SCALE)[free])
    unknowns = [_unknown(layout.installation[i], float(size)) for i, size in zip(free, sizes, strict=True)]
    # Whatever is stated has a singular value of one at least.
    found = determinability(rows, unknowns, tolerance=0.5)
    if found.null_directions:
        raise InputError(
            "these readings leave the installation open where nothing is stated of it",
            expected="a standard uncertainty of what moves together",
            value=found.null_directions[0],
        )


def _unknown(name: str, size: float) -> Unknown:
    if name == "scale":
        return Unknown(name, "ppm", size * 1e6, 1e-6)
    return Unknown(name, "urad", size / URAD, URAD) if " turn " in name else Unknown(name, "um", size / UM, UM)
