"""A multi-axis interferometer: beams on the plane mirrors of a carriage, read relative to its reference pose.

A beam leaves its source s along d, is reflected by the mirror, and returns to the plane through the source across the beam. With n the
mirror's outward normal, h its distance from the carriage's origin r, and c = −d·n the cosine of incidence, the path there and back is

    L = 2c / (2c² − 1) · ((s − r)·n − h),        n = R·n₀,

and the reading is its change since the reference pose r = 0, R = 1. In the plane this is eq. 1 to 4 of Wen et al. (2023) with the
sign of beams 4 to 6 corrected: their eq. 3 and 4 print + (x − x_d) sin θ where the mirror's normal (−sin θ, cos θ) gives −. As printed,
the path is wrong by millimetres at ±50 mm and ±10 mrad.

T. Wen, J. Hu, Y. Zhu, G. Hua: Multi-axis laser interferometer not affected by installation errors based on nonlinear computation,
Appl. Sci. 13 (2023) 10887.

Motions of a carriage from the readings of a multi-axis interferometer with an uncertain installation.

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
from functools import cached_property
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.messages import Message
from twin.measurement.instruments.base import InstrumentSpecification
from twin.numerics.spatial import cross_matrix, rotation_exp

LEAST_COSINE: Final = np.cos(np.radians(30.0))
"""Least cosine of incidence of a layout: beyond 45° the beam never returns to its source's plane."""
PLANE_MOTIONS: Final = (0, 1, 5)
"""x, y and the rotation about z: the motions of a planar stage."""


@final
@dataclass(frozen=True)
class MultiAxis:
    """A layout of m beams on k plane mirrors; metres and radians, the carriage's frame in its reference pose.

    Attributes:
        beams: (m) names.
        source: (m, 3) nominal points from which the beams leave.
        direction: (m, 3) nominal unit vectors.
        mirror: (m,) index of the mirror of each beam.
        mirrors: (k) names.
        normal: (k, 3) nominal outward unit normals, towards the sources.
        distance: (k,) distances of the mirrors from the carriage's origin along their normals.
        planar: whether carriage and beams stay in the xy-plane (three motions, not six).

    Raises:
        InputError: shapes that do not match, a vector that is not a unit vector, a beam that meets its mirror at more than 30° or from
            behind, a planar layout with a beam or mirror that leaves the plane.
    """

    beams: tuple[str, ...]
    source: np.ndarray
    direction: np.ndarray
    mirror: np.ndarray
    mirrors: tuple[str, ...]
    normal: np.ndarray
    distance: np.ndarray
    planar: bool

    def __post_init__(self) -> None:
        m, k = len(self.beams), len(self.mirrors)
        shapes = (self.source.shape, self.direction.shape, self.mirror.shape, self.normal.shape, self.distance.shape)
        if shapes != ((m, 3), (m, 3), (m,), (k, 3), (k,)) or m == 0:
            raise InputError("arrays of a layout do not match", expected=f"{m} beams, {k} mirrors", value=shapes)
        if len(set(self.beams)) < m or len(set(self.mirrors)) < k:
            raise InputError("two beams or mirrors with the same name", expected="each name once", value=self.beams)
        for name, vectors in (("direction", self.direction), ("normal", self.normal)):
            if np.any(np.abs(np.linalg.norm(vectors, axis=1) - 1.0) > 1e-12):
                raise InputError(f"a {name} is not a unit vector", expected="length one", value=vectors.tolist())
            if self.planar and np.any(vectors[:, 2] != 0.0):
                raise InputError(
                    f"a {name} leaves the plane", expected="z zero in a planar layout", value=vectors.tolist()
                )
        n = self.normal[self.mirror]
        for i, name in enumerate(self.beams):
            if not -float(self.direction[i] @ n[i]) > LEAST_COSINE:
                raise InputError(
                    f"beam {name} meets mirror {self.mirrors[self.mirror[i]]} at too large an angle",
                    expected="a direction against the mirror's outward normal, within 30°",
                    value=self.direction[i].tolist(),
                )
            if not float(self.source[i] @ n[i] - self.distance[self.mirror[i]]) > 0.0:
                raise InputError(
                    f"beam {name} starts behind mirror {self.mirrors[self.mirror[i]]}",
                    expected="a source on the outward side",
                    value=self.source[i].tolist(),
                )

    @property
    def specification(self) -> InstrumentSpecification:
        """Description as an instrument: one column for each beam, counted from the reference pose."""
        return InstrumentSpecification(
            name="multi-axis",
            title=Message("multi-axis interferometer"),
            columns=tuple(f"beam_{name}_mm" for name in self.beams),
            reads="length",
            free_start=True,
            rides_on=("base",),
            effects=("refraction_scale",),
            source="standard deviation of a beam, stated by the layout",
        )

    @property
    def motions(self) -> tuple[int, ...]:
        """Indices of the free components of a pose."""
        return PLANE_MOTIONS if self.planar else tuple(range(6))

    @cached_property
    def installation(self) -> tuple[str, ...]:
        """Names of the installation's parameters: of each beam, then of each mirror, then the scale of all readings."""
        names: list[str] = []
        for beam, vector in zip(self.beams, self.direction, strict=True):
            names += [f"beam {beam} {axis}" for axis in ("xy" if self.planar else "xyz")]
            names += [f"beam {beam} turn {axis}" for axis in tilt_letters(vector, planar=self.planar)]
        for mirror, vector in zip(self.mirrors, self.normal, strict=True):
            names += [f"mirror {mirror} turn {axis}" for axis in tilt_letters(vector, planar=self.planar)]
        return (*names, "scale")

    def readings(self, poses: np.ndarray, installation: np.ndarray | None = None) -> np.ndarray:
        """Return the noise-free readings of the beams.

        Args:
            poses: (n, 6) of the carriage from its reference pose: translation, metres, and rotation vector, radians.
            installation: (p,) deviations from the nominal layout in the order of `installation`; metres, radians, and one for the
                scale; zero if None.

        Returns:
            (n, m) change of path, there and back, metres.
        """
        return self._evaluate(np.atleast_2d(np.asarray(poses, dtype=float)), installation, derivatives=False)[0]

    def derivatives(
        self, poses: np.ndarray, installation: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the readings and their derivatives; arguments as of `readings`.

        Returns:
            (n, m) readings, (n, m, f) with respect to the free motions of the same pose, (n, m, p) with respect to the installation.
        """
        return self._evaluate(np.atleast_2d(np.asarray(poses, dtype=float)), installation, derivatives=True)

    @cached_property
    def _beam_tilts(self) -> np.ndarray:
        return tilt_axes(self.direction, planar=self.planar)

    @cached_property
    def _mirror_tilts(self) -> np.ndarray:
        return tilt_axes(self.normal, planar=self.planar)

    def _evaluate(
        self, poses: np.ndarray, installation: np.ndarray | None, *, derivatives: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        m, k = len(self.beams), len(self.mirrors)
        count = len(self.installation)
        deviations = np.zeros(count) if installation is None else np.asarray(installation, dtype=float)
        if poses.ndim != 2 or poses.shape[1] != 6 or deviations.shape != (count,):
            raise InputError(
                "poses or installation have the wrong shape",
                expected=f"(n, 6) and ({count},)",
                value=f"{poses.shape} and {deviations.shape}",
            )
        turns, places = (1, 2) if self.planar else (2, 3)
        per = places + turns
        by_beam = deviations[: m * per].reshape(m, per)
        s = np.array(self.source)
        s[:, :places] += by_beam[:, :places]
        d, d_by = tilted(self.direction, self._beam_tilts, by_beam[:, places:])
        n0, n0_by = tilted(self.normal, self._mirror_tilts, deviations[m * per : -1].reshape(k, turns))
        n0, n0_by, h = n0[self.mirror], n0_by[self.mirror], self.distance[self.mirror]
        scale = 1.0 + deviations[-1]
        rotation, left = rotation_and_jacobian(poses[:, 3:])
        normal = np.einsum("nij,mj->nmi", rotation, n0)
        away = s[None] - poses[:, None, :3]
        c = -np.einsum("nmi,mi->nm", normal, d)
        gap = np.einsum("nmi,nmi->nm", away, normal) - h
        c0 = -np.einsum("mi,mi->m", n0, d)
        gap0 = np.einsum("mi,mi->m", s, n0) - h
        change = _factor(c) * gap - _factor(c0) * gap0
        if not derivatives:
            return scale * change, np.empty(0), np.empty(0)
        f, f0, slope, slope0 = _factor(c), _factor(c0), _slope(c) * gap, _slope(c0) * gap0
        # A rotation w of the carriage changes the normal by (J w) × n.
        by_turn = np.cross(left.transpose(0, 2, 1)[:, None], normal[:, :, None])
        by_normal = f[..., None] * away - slope[..., None] * d
        by_pose = np.concatenate([-f[..., None] * normal, np.einsum("nmi,nmki->nmk", by_normal, by_turn)], axis=2)
        by_source = f[..., None] * normal - f0[:, None] * n0
        by_direction = -slope[..., None] * normal + slope0[:, None] * n0
        at_rest = f0[:, None] * s - slope0[:, None] * d
        by_mirror = np.einsum("nmi,nij->nmj", by_normal, rotation) - at_rest
        by_installation = np.zeros((len(poses), m, count))
        for i in range(m):
            at = i * per
            by_installation[:, i, at : at + places] = by_source[:, i, :places]
            by_installation[:, i, at + places : at + per] = by_direction[:, i] @ d_by[i]
            at = m * per + turns * int(self.mirror[i])
            by_installation[:, i, at : at + turns] = by_mirror[:, i] @ n0_by[i]
        by_installation *= scale
        by_installation[:, :, -1] = change
        return scale * change, scale * by_pose[:, :, list(self.motions)], by_installation


def rotation_and_jacobian(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rotations of rotation vectors and their left Jacobians: Exp(w + δ) = Exp(J δ)·Exp(w) to first order.

    ``vectors``: (n, 3) radians.

    Returns:
        (n, 3, 3) and (n, 3, 3).
    """
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    # (1 − cos t) / t² and (t − sin t) / t³ cancel near zero; there by their series.
    small = angle < 1e-2
    t = np.where(small, 1.0, angle)
    q = np.where(small, angle, 0.0) ** 2
    b = np.where(small, 0.5 - q / 24.0 * (1.0 - q / 30.0 * (1.0 - q / 56.0)), (1.0 - np.cos(t)) / t**2)
    c = np.where(small, (1.0 - q / 20.0 * (1.0 - q / 42.0 * (1.0 - q / 72.0))) / 6.0, (t - np.sin(t)) / t**3)
    skew = cross_matrix(vectors)
    return np.asarray(rotation_exp(vectors)), np.eye(3) + b * skew + c * (skew @ skew)


def tilt_letters(vector: np.ndarray, *, planar: bool) -> str:
    """Return the letters of the axes about which a vector is tilted: z, y, x without the one nearest to it; in the plane only z."""
    nearest = "xyz"[int(np.argmax(np.abs(vector)))]
    return "z" if planar else "zyx".replace(nearest, "")


def tilt_axes(vectors: np.ndarray, *, planar: bool) -> np.ndarray:
    """Return (m, 3, 1 or 2) the unit vectors about which each vector is tilted: the axes of `tilt_letters`, orthogonalised."""
    tilt_axes = np.zeros((len(vectors), 3, 1 if planar else 2))
    for i, vector in enumerate(vectors):
        basis: list[np.ndarray] = []
        for letter in tilt_letters(vector, planar=planar):
            axis = np.eye(3)["xyz".index(letter)]
            square = axis - sum((axis @ v * v for v in [vector, *basis]), np.zeros(3))
            basis.append(square / np.linalg.norm(square))
        tilt_axes[i] = np.stack(basis, axis=1)
    return read_only(tilt_axes)


def tilted(vectors: np.ndarray, axes: np.ndarray, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return vectors rotated by small angles about axes across them, and the derivatives.

    ``vectors``: (m, 3); ``axes``: (m, 3, k) of `tilt_axes`; ``angles``: (m, k) radians.

    Returns:
        (m, 3), and (m, 3, k) derivatives with respect to the angles.
    """
    rotation, left = rotation_and_jacobian(np.einsum("mik,mk->mi", axes, angles))
    vectors_tilted = np.einsum("mij,mj->mi", rotation, vectors)
    by = np.cross(np.einsum("mij,mjk->mki", left, axes), vectors_tilted[:, None]).transpose(0, 2, 1)
    return vectors_tilted, by


def _factor(c: np.ndarray) -> np.ndarray:
    return 2.0 * c / (2.0 * c**2 - 1.0)


def _slope(c: np.ndarray) -> np.ndarray:
    """Return the derivative of `_factor`."""
    return -(4.0 * c**2 + 2.0) / (2.0 * c**2 - 1.0) ** 2


# --- Motions of a carriage from the readings of a multi-axis interferometer with an uncertain installation

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
    installation, measured, motions = np.zeros(len(installation_u)), np.array(poses, dtype=float), list(layout.motions)
    step, taken, converged = run.step(measured, installation), 0, False
    while not converged and taken < STEPS:
        taken += 1
        before = run.chi2(measured, installation)
        # The tilt of a beam acts by its square only, so a full step may change its sign back and forth.
        for halvings in range(HALVINGS):
            next_installation, next_found = installation.copy(), measured.copy()
            next_installation[run.free] += step.installation * 0.5**halvings
            next_found[:, motions] += step.poses * 0.5**halvings
            after = run.chi2(next_found, next_installation)
            if after < before:
                installation, measured = next_installation, next_found
                break
        converged = before - after <= SETTLED
        step = run.step(measured, installation)
    by_installation = np.zeros((*step.poses.shape, len(installation)))
    by_installation[:, :, run.free] = step.by_installation
    covariance = np.zeros((len(installation), len(installation)))
    covariance[np.ix_(run.free, run.free)] = step.root @ step.root.T
    return Displacement(
        poses=read_only(measured),
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
