"""Least-squares sphere through probed points: centre and radius, with their covariance.

The geometric fit minimises the sum of the squared distances of the points from the sphere (the Gaussian associated feature of ISO
10360-6; A. B. Forbes: Least-squares best-fit geometric elements, NPL report DITC 140/89, 1989). It starts from the algebraic fit, which
is linear in c and R² − c² and has a bias for incomplete spheres: |p|² = 2 p·c + (R² − c²).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np
import scipy

from twin._common.arrays import first_largest, read_only
from twin._common.errors import InputError
from twin._common.units import count_with_noun
from twin.numerics.spatial import algebraic_sphere

FEWEST: Final = 4
"""Least number of contacts. Three on a sphere of known radius still have two centres, one on either side of their plane."""
SMALLEST_SINGULAR_VALUE: Final = 1e-6
"""Relative singular value of a design matrix below which the contacts do not determine a centre."""
UNDETERMINED: Final = 0.1
"""Standard uncertainty of the centre, as a fraction of the radius, above which it counts as not determined. A linearised covariance
says nothing there: contacts in one plane, with their noise, fit spheres on both of its sides."""


@final
@dataclass(frozen=True)
class Sphere:
    """A sphere fitted to n points, mm.

    Attributes:
        centre_mm: (3,).
        radius_mm: fitted or known radius.
        residuals_mm: (n,) distances of the points from the sphere, positive outside.
        leverage: (n,) share of each point in its own fitted value, 0 … 1.
        cofactor: (p, p) covariance of centre and radius (p = 4), or of the centre (p = 3, known radius), for a noise of 1 mm.
    """

    centre_mm: np.ndarray
    radius_mm: float
    residuals_mm: np.ndarray
    leverage: np.ndarray
    cofactor: np.ndarray

    @property
    def dof(self) -> int:
        """Degrees of freedom of the residuals."""
        return len(self.residuals_mm) - len(self.cofactor)

    @property
    def noise_mm(self) -> float:
        """Standard deviation of a contact along the normal, from the residuals; NaN without degrees of freedom."""
        return float(np.sqrt(self.residuals_mm @ self.residuals_mm / self.dof)) if self.dof else float("nan")

    def covariance_mm2(self, noise_mm: float) -> np.ndarray:
        """Return (3, 3) the covariance of the centre for a standard deviation of a contact, mm²."""
        return read_only(noise_mm**2 * self.cofactor[:3, :3])

    def check_determined(self, noise_mm: float, *, file: str | Path | None = None, line: int | None = None) -> None:
        """Raise `InputError` if the contacts hardly determine the centre.

        Raises:
            InputError: a standard uncertainty of the centre above `UNDETERMINED` times the radius.
        """
        variances, directions = np.linalg.eigh(self.covariance_mm2(noise_mm))
        u = float(np.sqrt(variances[-1]))
        if not u <= UNDETERMINED * self.radius_mm:
            raise _undetermined(f"u = {u:.3g} mm along {_direction(directions[:, -1])}", file, line)


def fit_sphere(
    points_mm: np.ndarray,
    radius_mm: float | None = None,
    *,
    file: str | Path | None = None,
    line: int | None = None,
) -> Sphere:
    """Return the sphere with the smallest sum of squared orthogonal distances from the points.

    ``points_mm``: (n, 3); ``radius_mm``: known radius; None to fit it.

    Raises:
        InputError: fewer than `FEWEST` points, a point that is not finite, points in one plane or that do not determine the centre
            otherwise, or a fit that does not converge.
    """
    points = np.asarray(points_mm, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < FEWEST:
        raise InputError(
            f"{count_with_noun(len(points), 'contact')} on a sphere",
            expected=f"at least {FEWEST} contacts of three coordinates, not all in one plane",
            file=file,
            line=line,
        )
    if not np.isfinite(points).all():
        raise InputError("a contact is not finite", expected="numbers", file=file, line=line)
    middle = points.mean(axis=0)
    local = points - middle
    size = float(np.abs(local).max()) or 1.0
    local = local / size
    _, singular, directions = np.linalg.svd(local, full_matrices=False)
    if singular[-1] <= SMALLEST_SINGULAR_VALUE * singular[0] or singular[0] == 0.0:
        raise _undetermined(f"all in one plane with the normal {_direction(directions[-1])}", file, line)
    # Start at the algebraic fit.
    centre, radius = algebraic_sphere(local)
    local, centre = local - centre, middle + size * centre
    start = np.zeros(3) if radius_mm is not None else np.array([0.0, 0.0, 0.0, radius])

    def residuals(x: np.ndarray) -> np.ndarray:
        return np.linalg.norm(local - x[:3], axis=1) - (x[3] if radius_mm is None else radius_mm / size)

    def jacobian(x: np.ndarray) -> np.ndarray:
        away = local - x[:3]
        lengths = np.maximum(np.linalg.norm(away, axis=1), np.finfo(float).tiny)
        normals = away / lengths[:, None]
        return np.column_stack([-normals, -np.ones(len(normals))]) if radius_mm is None else -normals

    least_squares = scipy.optimize.least_squares(
        residuals, start, jac=jacobian, method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14
    )
    design = jacobian(least_squares.x)
    left, singular, right = np.linalg.svd(design, full_matrices=False)
    if not np.isfinite(least_squares.x).all() or not least_squares.success:
        raise _undetermined("the fit does not converge", file, line)
    if singular[-1] <= SMALLEST_SINGULAR_VALUE * singular[0]:
        raise _undetermined(f"no change along {_direction(right[-1, :3])}", file, line)
    return Sphere(
        centre_mm=read_only(centre + size * least_squares.x[:3]),
        radius_mm=size * float(least_squares.x[3]) if radius_mm is None else radius_mm,
        residuals_mm=read_only(size * least_squares.fun),
        leverage=read_only((left**2).sum(axis=1)),
        cofactor=read_only((right.T / singular**2) @ right),
    )


def _undetermined(why: str, file: str | Path | None, line: int | None) -> InputError:
    return InputError(
        "the contacts do not determine the sphere's centre",
        expected="contacts spread over the sphere, not on one plane or circle",
        file=file,
        line=line,
        value=why,
    )


def _direction(vector: np.ndarray) -> str:
    """Return a direction of either sign in words, the first of its largest components positive."""
    vector = vector * np.sign(vector[first_largest(np.abs(vector))])
    return ", ".join(f"{component:.2f}" for component in vector + 0.0)
