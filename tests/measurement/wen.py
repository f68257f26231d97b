"""Layouts and self-calibration (Algorithm 2) of Wen et al. (2023), which are not part of the package.

These statements of the paper hold: eq. 1 and 2 and beams 1 to 3 of eq. 3 and 4; Algorithm 2 in four steps at most; the twelve indices
of its fig. 7b, in the order x_d1, y_d1, α_1, x_d2, … (not in that of its eq. 30), in mm and rad, cut after the 33rd eigenvalue, and in
no other way. These do not: the sign of beams 4 to 6 (`twin.measurement.instruments.multi_axis`); that x and y are unique (rank 46 of
48, and 159 of 165 with nine beams); that α is solved (a third of it is in the truncated part); that the result does not depend on the
installation (ten times its error gives ten times the error of x); and therefore that 1.884 nm is due to 0.1 nm of noise: with a known
installation that is 0.029 nm and 4.17e-7 mrad.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from twin._common.arrays import read_only
from twin._common.units import MM, UM, URAD
from twin.measurement.instruments.multi_axis import Displacement, MultiAxis
from twin.numerics.observability import Determinability, Unknown, decompose, determinability

STEPS = 25
STILL = 1e-3
"""Change of the readings, root of the sum of squares in standard uncertainties, that ends the iteration."""
MRAD = 1e-3
MOTIONS = ("x", "y", "z", "turn x", "turn y", "turn z")


def six_beams(
    *, width: float = 0.2, depth: float = 0.2, gap: float = 0.15, base: float = 0.06, planar: bool = True
) -> MultiAxis:
    """Return three parallel beams on each of two adjacent sides of a planar stage (Wen et al., fig. 2 and 3).

    Args:
        width: b of the stage, metres.
        depth: h of the stage, metres.
        gap: from the sources to the sides, metres.
        base: distance between beams, metres.
        planar: as of `MultiAxis`.
    """
    steps = np.array([-base, 0.0, base])
    x = np.stack([np.full(3, -width / 2.0 - gap), steps, np.zeros(3)], axis=1)
    y = np.stack([steps, np.full(3, -depth / 2.0 - gap), np.zeros(3)], axis=1)
    return MultiAxis(
        beams=tuple(str(i + 1) for i in range(6)),
        source=read_only(np.concatenate([x, y])),
        direction=read_only(np.repeat(np.eye(3)[:2], 3, axis=0)),
        mirror=read_only(np.repeat([0, 1], 3)),
        mirrors=("x", "y"),
        normal=read_only(-np.eye(3)[:2]),
        distance=read_only(np.array([width / 2.0, depth / 2.0])),
        planar=planar,
    )


def nine_beams(*, side: float = 0.2, gap: float = 0.15, radius: float = 0.04) -> MultiAxis:
    """Return three beams in an equilateral triangle on each of three adjacent faces of a cube (Wen et al., fig. 4).

    Args:
        side: of the cube, metres.
        gap: from the sources to the faces, metres.
        radius: of the circle through the three beams of a face, metres.
    """
    angles = np.radians([90.0, 210.0, 330.0])
    across = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    sources = np.zeros((9, 3))
    for j in range(3):
        others = [(j + 1) % 3, (j + 2) % 3]
        sources[3 * j : 3 * j + 3, j] = -side / 2.0 - gap
        sources[3 * j : 3 * j + 3, others] = across
    return MultiAxis(
        beams=tuple(str(i + 1) for i in range(9)),
        source=read_only(sources),
        direction=read_only(np.repeat(np.eye(3), 3, axis=0)),
        mirror=read_only(np.repeat([0, 1, 2], 3)),
        mirrors=("x", "y", "z"),
        normal=read_only(-np.eye(3)),
        distance=read_only(np.full(3, side / 2.0)),
        planar=False,
    )


def of_beams(layout: MultiAxis) -> np.ndarray:
    """Return a mask of the installation's unknowns that belong to beams: all that Wen et al. have."""
    return np.array([name.startswith("beam ") for name in layout.installation])


def joint_covariance(found: Displacement) -> np.ndarray:
    """Return (n·f, n·f) the joint covariance of all motions, position after position."""
    n, f, p = found.by_installation.shape
    flat = found.by_installation.reshape(n * f, p)
    whole = flat @ found.installation_covariance @ flat.T
    for i in range(n):
        whole[i * f : (i + 1) * f, i * f : (i + 1) * f] += found.noise_covariance[i]
    return np.asarray((whole + whole.T) / 2.0)


def u_installation(found: Displacement) -> np.ndarray:
    """Return (n, f) the installation's part of the standard uncertainties of the motions."""
    return np.sqrt(
        np.einsum("nfp,pq,nfq->nf", found.by_installation, found.installation_covariance, found.by_installation)
    )


def standard_uncertainty(found: Displacement) -> np.ndarray:
    """Return (n, f) the standard uncertainties of the motions, metres and radians."""
    return np.sqrt(np.einsum("nii->ni", found.noise_covariance) + u_installation(found) ** 2)


@final
@dataclass(frozen=True)
class SelfCalibration:
    """Result of Algorithm 2.

    Attributes:
        poses: (n, 6) metres and radians.
        installation: (p,) deviations from the nominal layout.
        residual: (n, m) readings minus predicted, metres.
        determinability: of all unknowns at the solution, with the truncation of the last step as tolerance.
        steps: number of steps.
        converged: whether the iteration converged.
    """

    poses: np.ndarray
    installation: np.ndarray
    residual: np.ndarray
    determinability: Determinability
    steps: int
    converged: bool


def plausible_of(layout: MultiAxis, length: float, angle: float, scale: float) -> np.ndarray:
    """Return (p,) one size for the lengths of an installation, one for its angles, one for the scale."""
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
    """Return derivatives and unknowns of a self-calibration: installation first, beam after beam, then position after position.

    Args:
        layout: nominal.
        poses: (n, 6).
        installation: (p,).
        unknown: (p,) mask of the installation's unknown parameters.
        pose_sizes: plausible translation and rotation, metres and radians.
        installation_sizes: (p,) plausible, metres, radians, one.

    Returns:
        (n·m, q) metres per metre or radian, and the q unknowns.
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

    Along the null space every step has minimum norm: the result there is the projected initial value. The paper states neither the
    truncation nor the units of the norm; both are arguments here.

    Args:
        layout: nominal.
        readings: (n, m) metres.
        noise: standard uncertainty of a reading, metres.
        tolerance: singular values at or below this share of the largest are left out.
        poses: (n, 6) initial values.
        installation: (p,) initial values; the nominal layout if None.
        unknown: (p,) mask of the installation's parameters to be estimated; all of the beams if None.
        length: unit of lengths in the singular values and in the norm, metres; mm as in the paper's table 1.
        angle: unit of angles there, radians; mrad likewise.
        steps: largest number of steps.
    """
    given = np.asarray(readings, dtype=float)
    sought = of_beams(layout) if unknown is None else np.asarray(unknown, dtype=bool)
    assumed = np.zeros(len(layout.installation)) if installation is None else np.array(installation, dtype=float)
    found = np.array(poses, dtype=float)
    n, motions, count = len(given), list(layout.motions), int(np.count_nonzero(sought))
    sizes = plausible_of(layout, length, angle, 1.0)
    taken, converged = 0, False
    while True:
        matrix, unknowns = question(
            layout, found, assumed, unknown=sought, pose_sizes=(length, angle), installation_sizes=sizes
        )
        residual = given - layout.readings(found, assumed)
        scale = np.array([one.plausible * one.factor for one in unknowns])
        whitened = matrix * scale / noise
        least = tolerance * float(np.linalg.norm(whitened, 2))
        if converged or taken == steps:
            answer = determinability(matrix / noise, unknowns, tolerance=least, measurements=n)
            return SelfCalibration(read_only(found), read_only(assumed), read_only(residual), answer, taken, converged)
        left, spectrum = decompose(whitened, scale, tolerance=least)
        along = left.T @ residual.reshape(-1) / noise
        step = spectrum.directions @ (along / spectrum.singular_values) * scale
        assumed[sought] += step[:count]
        found[:, motions] += step[count:].reshape(n, -1)
        taken += 1
        converged = bool(np.linalg.norm(along) <= STILL)


def _unknown(name: str, size: float) -> Unknown:
    if name == "scale":
        return Unknown(name, "ppm", size * 1e6, 1e-6)
    return Unknown(name, "urad", size / URAD, URAD) if " turn " in name else Unknown(name, "um", size / UM, UM)
