"""Single contacts of a touch probe with spheres, reduced to sphere centres with their covariance.

A contact is the position of the linear axes when the probe touched, in axis coordinates. In them the tip's centre lies on a sphere of
the radius R + r around the position at which it would be at the sphere's centre (R sphere, r tip), whatever the probing direction. With
a probing direction and a tip radius, the point of contact itself is used: the contact plus r along the direction. That is exact only
where the direction is the normal of the sphere.

The result has one row for each sphere and pose in the form of the measurement table for a probe: the station is the probe's tip and
rides on the tool, the target is the sphere's centre on the work side, the reading is 0, 0, 0 and the positions are those at which the
tip was at the centre. `u_x_mm …` follow from the covariance of the fit.

The geometric fit of a sphere minimises the sum of the squared distances of the points from it (the Gaussian associated feature of ISO
10360-6; A. B. Forbes: Least-squares best-fit geometric elements, NPL report DITC 140/89, 1989). It starts from the algebraic fit, which
is linear in c and R² − c² and has a bias for incomplete spheres: |p|² = 2 p·c + (R² − c²).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, final

import numpy as np
import scipy

from twin._common.arrays import first_largest, read_only
from twin._common.distributions import chi2_sf, normal_sf, student_sf
from twin._common.errors import InputError
from twin._common.units import count_with_noun
from twin.machine.machine import Machine
from twin.measurement.observation import Observation
from twin.measurement.table import Measurements
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

        Raises `InputError`: a standard uncertainty of the centre above `UNDETERMINED` times the radius.
        """
        variances, directions = np.linalg.eigh(self.covariance_mm2(noise_mm))
        u = float(np.sqrt(variances[-1]))
        if not u <= UNDETERMINED * self.radius_mm:
            raise _undetermined(f"u = {u:.3g} mm along {_direction(directions[:, -1])}", file, line)


def fit_sphere(
    points_mm: np.ndarray, radius_mm: float | None = None, *, file: str | Path | None = None, line: int | None = None
) -> Sphere:
    """Return the sphere with the smallest sum of squared orthogonal distances from the points.

    ``points_mm``: (n, 3); ``radius_mm``: known radius; None to fit it.

    Raises `InputError`: fewer than `FEWEST` points, a point that is not finite, points in one plane or that do not determine the centre
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


# --- Contacts reduced to sphere centres ----------------------------------------------------------

CARTESIAN: Final = ("X", "Y", "Z")
"""Names of the linear axes that contacts are given in."""
STATION: Final = "probe"
OUTLIER_P: Final = 1e-3
"""p-value, corrected for the number of contacts, below which a contact is an outlier."""
ORTHOGONAL: Final = 1e-6
"""Largest deviation from orthogonality of the machine's nominal linear axes."""
FREE: Final = 1e-6
"""Least share of a contact that its own fit leaves free; below it the residual is rounding."""
ROUNDING_MM: Final = 1e-7
"""Residuals below this are rounding of the numbers in the file."""
WEAK: Final = 0.05
"""Relative singular value below which contacts do not show the size of a sphere along an axis."""
SAME_CONTRAST: Final = 0.05
"""Largest share of a third axis in a difference of two."""
UNIT_LENGTH: Final = 1e-3
"""Largest deviation of the length of a probing direction from one."""


@final
@dataclass(frozen=True)
class Contacts:
    """Contacts of a probe, n rows; arrays are read-only.

    Attributes:
        lines: (n,) lines in the file.
        positions: (n, axes) positions of all axes at the contact, mm and degrees, command order.
        sphere: (n,) names.
        round: (n,) names; contacts with one sphere in one pose and round belong together.
        direction: (n, 3) unit vectors of the probing motion along X, Y, Z; NaN where unknown.
        simulated: whether the contacts were simulated.
    """

    source: str
    lines: np.ndarray
    positions: np.ndarray
    sphere: np.ndarray
    round: np.ndarray
    direction: np.ndarray
    simulated: bool = False

    def __len__(self) -> int:
        return len(self.lines)


@final
@dataclass(frozen=True)
class Probing:
    """Sizes and noise, which a file of contacts does not contain.

    Attributes:
        sphere_radius_mm: known radius of the spheres; None to fit one for each sphere and pose.
        tip_radius_mm: effective radius of the tip; None if unknown.
        u_contact_mm: standard uncertainty of a contact along the normal; None to estimate it from the residuals of all spheres.
        tip_mm: (3,) known place of the tip's centre from the spindle nose, frame of the tool; None if unknown.
    """

    sphere_radius_mm: float | None = None
    tip_radius_mm: float | None = None
    u_contact_mm: float | None = None
    tip_mm: tuple[float, float, float] | None = None


@final
@dataclass(frozen=True)
class SphereCentre:
    """One sphere in one pose.

    ``positions``: (axes,) positions at which the tip was at the centre, mm and degrees; ``covariance_mm2``: (3, 3) of the positions of
    X, Y, Z; ``radius_mm``: radius of the fit: of the tip's centre around the sphere's, or of the sphere (see `Probing`).
    """

    sphere: str
    round: str
    line: int
    contacts: int
    positions: np.ndarray
    covariance_mm2: np.ndarray
    radius_mm: float
    rms_mm: float

    def to_dict(self) -> dict[str, Any]:
        """Return JSON data."""
        values = {name: getattr(self, name) for name in ("sphere", "round", "line", "contacts", "radius_mm", "rms_mm")}
        return values | {"positions": self.positions.tolist(), "covariance_mm2": self.covariance_mm2.tolist()}


@final
@dataclass(frozen=True)
class ReducedContacts:
    """Sphere centres of a file of contacts.

    ``centres``: the same with their covariances; ``u_contact_mm``: standard uncertainty of a contact that the covariances are computed
    from.
    """

    measurements: Measurements
    centres: tuple[SphereCentre, ...]
    u_contact_mm: float
    notes: tuple[str, ...]


def linear_columns(machine: Machine) -> tuple[int, ...]:
    """Return the indices of X, Y and Z among the machine's axes. Raises `InputError`: the linear axes are not X, Y and Z."""
    names = [machine.axes[i].name for i in machine.linear]
    if sorted(names) != list(CARTESIAN):
        raise InputError(
            "contacts need a machine with the linear axes X, Y and Z", expected="X Y Z", value=" ".join(names)
        )
    return tuple(machine.names.index(name) for name in CARTESIAN)


def reduce_contacts(contacts: Contacts, machine: Machine, probing: Probing) -> ReducedContacts:
    """Return the sphere centres of all spheres and poses.

    Raises `InputError`: with the line: fewer than four contacts with a sphere in a pose, contacts that do not determine its centre, an
    outlier, a direction that is not a unit vector; no residuals to estimate the noise from, and none stated; a known radius without
    that of the tip; a machine whose linear axes are not X, Y, Z.
    """
    columns = linear_columns(machine)
    points, radius, notes = _surface(contacts, contacts.positions[:, columns], probing)
    groups = _groups(contacts, columns)
    fits = [
        fit_sphere(points[rows], radius, file=contacts.source, line=int(contacts.lines[rows[0]])) for rows in groups
    ]
    noise, dof = _noise(fits, probing, contacts)
    _check_outliers(fits, groups, contacts, probing, dof)
    centres = []
    for rows, fit in zip(groups, fits, strict=True):
        first = int(rows[0])
        fit.check_determined(noise, file=contacts.source, line=int(contacts.lines[first]))
        at = np.array(contacts.positions[first])
        at[list(columns)] = fit.centre_mm
        centres.append(
            SphereCentre(
                str(contacts.sphere[first]),
                str(contacts.round[first]),
                int(contacts.lines[first]),
                len(rows),
                read_only(at),
                fit.covariance_mm2(noise),
                fit.radius_mm,
                float(np.sqrt(np.mean(fit.residuals_mm**2))),
            )
        )
    how = "as stated" if probing.u_contact_mm is not None else f"from the residuals, {dof} degrees of freedom"
    notes = (*notes, *_normals(contacts, points, fits, groups, probing), *_sizes_by_axis(points, fits, groups))
    notes = (f"standard uncertainty of a contact: {noise * 1e3:.3g} µm, {how}", *_excess(fits, dof, probing), *notes)
    table = _table(contacts, machine, centres, columns)
    approach = approach_of(machine, table.positions, linear=False)
    # The way to the first pose is unknown.
    approach[np.cumsum(np.diff(table.positions, axis=0, prepend=table.positions[:1]) != 0.0, axis=0) == 0] = 0.0
    if approach.any():
        table = replace(table, approach=read_only(approach))
        notes = (*notes, "assumed: the rotary axes turn straight from one pose to the next")
    if probing.tip_mm is not None:
        pose = np.tile([*probing.tip_mm, 0.0, 0.0, 0.0], (len(table), 1))
        table = replace(table, station_pose=read_only(pose))
        notes = (
            *notes,
            f"the tip is known: {', '.join(f'{value:g}' for value in probing.tip_mm)} mm from the spindle nose",
        )
    return ReducedContacts(table, tuple(centres), noise, notes)


def probe_table(
    machine: Machine,
    positions: np.ndarray,
    *,
    source: str,
    lines: np.ndarray,
    target: np.ndarray,
    round_name: np.ndarray,
    u_mm: np.ndarray,
    simulated: bool = False,
) -> Measurements:
    """Return sphere centres in the form of the measurement table for a probe.

    ``positions``: (n, axes) positions at which the tip was at the centre; ``lines``: (n,) lines; ``target``: (n,) names of the spheres;
    ``round_name``: (n,) names of the rounds; ``u_mm``: (n, 3) standard uncertainties of the reading, NaN where unknown; ``simulated``:
    whether the contacts were simulated.
    """
    n = len(positions)

    def words(word: str) -> np.ndarray:
        return read_only(np.full(n, word, dtype=object))

    return Measurements(
        source=source,
        lines=read_only(np.asarray(lines, dtype=int)),
        positions=read_only(np.asarray(positions, dtype=float).reshape(n, len(machine.axes))),
        target=read_only(np.asarray(target, dtype=object)),
        carrier=words("work"),
        station=words(STATION),
        station_carrier=words("tool"),
        round=read_only(np.asarray(round_name, dtype=object)),
        point_mm=read_only(np.zeros((n, 3))),
        u_mm=read_only(np.asarray(u_mm, dtype=float).reshape(n, 3)),
        simulated=simulated,
    )


def approach_of(machine: Machine, positions: np.ndarray, *, linear: bool) -> np.ndarray:
    """Return the direction of approach (n, axes) of positions in their order: +1, −1, or 0 for an axis that never moves.

    ``positions``: (n, axes) mm and degrees; the first is approached in the direction in which each axis continues; ``linear``: whether
    the linear axes have one; a probe touches the sphere from both sides.
    """
    sign = np.sign(np.diff(positions, axis=0, prepend=positions[:1]))
    approach = np.zeros(positions.shape)
    for i, axis in enumerate(machine.axes):
        moving = np.flatnonzero(sign[:, i])
        if len(moving) and (linear or not axis.linear):
            last = np.maximum.accumulate(np.where(sign[:, i] != 0.0, np.arange(len(sign)), moving[0]))
            last[: moving[0]] = moving[0]
            approach[:, i] = sign[last, i]
    return approach


def _surface(
    contacts: Contacts, points: np.ndarray, probing: Probing
) -> tuple[np.ndarray, float | None, tuple[str, ...]]:
    """Return the points to fit, the known radius of their sphere or None, and notes."""
    tip, sphere = probing.tip_radius_mm, probing.sphere_radius_mm
    given = np.isfinite(contacts.direction).all(axis=1)
    lengths = np.linalg.norm(contacts.direction, axis=1)
    for row in np.flatnonzero(given & (np.abs(lengths - 1.0) > UNIT_LENGTH)):
        raise InputError(
            "a probing direction is not a unit vector",
            expected="length 1",
            file=contacts.source,
            line=int(contacts.lines[row]),
            value=f"{lengths[row]:.4g}",
        )
    if tip is not None and given.all():
        note = f"tip radius {tip:g} mm compensated along the probing direction"
        return points + tip * contacts.direction, sphere, (note,)
    if sphere is None:
        used = () if tip is None else ("the tip radius has no influence: the radius of the tip's centre is fitted",)
        return points, None, used
    if tip is None:
        raise InputError(
            "a known sphere radius needs the radius of the tip", expected="both radii, or none", setting="tip radius"
        )
    return points, sphere + tip, (f"radius of the tip's centre {sphere + tip:g} mm, not fitted",)


def _groups(contacts: Contacts, columns: Sequence[int]) -> list[np.ndarray]:
    """Return the rows of each sphere, pose and round, in the order of their first contact."""
    poses = np.delete(contacts.positions, list(columns), axis=1) + 0.0
    rows: dict[tuple[str, str, bytes], list[int]] = {}
    for i, key in enumerate(zip(contacts.sphere, contacts.round, poses, strict=True)):
        rows.setdefault((str(key[0]), str(key[1]), key[2].tobytes()), []).append(i)
    return [np.array(group) for group in rows.values()]


def _noise(fits: Sequence[Sphere], probing: Probing, contacts: Contacts) -> tuple[float, int]:
    """Return the standard uncertainty of a contact and the degrees of freedom of all residuals."""
    dof = sum(fit.dof for fit in fits)
    if probing.u_contact_mm is not None:
        return probing.u_contact_mm, dof
    if dof == 0:
        raise InputError(
            "no residuals to estimate the noise from: no sphere has more contacts than unknowns",
            expected="five contacts or more with at least one sphere, or the standard uncertainty of a contact",
            file=contacts.source,
            line=int(contacts.lines[0]),
            setting="contact uncertainty",
        )
    return float(np.sqrt(sum(float(fit.residuals_mm @ fit.residuals_mm) for fit in fits) / dof)), dof


def _check_outliers(
    fits: Sequence[Sphere], groups: Sequence[np.ndarray], contacts: Contacts, probing: Probing, dof: int
) -> None:
    """Raise `InputError` if the worst contact is an outlier.

    Its residual is divided by the stated noise, or by that of all other contacts (externally studentised) where none is stated or
    theirs is significantly larger: a statement that is too small makes no outliers.
    """
    rows, of = np.concatenate(groups), np.repeat(np.arange(len(fits)), [len(group) for group in groups])
    residuals = np.concatenate([fit.residuals_mm for fit in fits])
    free = 1.0 - np.concatenate([fit.leverage for fit in fits])
    tested = free > FREE
    scaled = np.where(tested, residuals, 0.0) / np.sqrt(np.where(tested, free, 1.0))
    worst = int(np.argmax(np.abs(scaled)))
    others = max(float(residuals @ residuals) - scaled[worst] ** 2, ROUNDING_MM**2)
    if probing.u_contact_mm is not None and not _exceeds(others, dof - 1, probing.u_contact_mm):
        p = 2.0 * float(normal_sf(abs(scaled[worst]) / probing.u_contact_mm))
    elif dof > 1:
        p = 2.0 * float(student_sf(abs(scaled[worst]) / np.sqrt(others / (dof - 1)), dof - 1))
    else:
        return
    p *= np.count_nonzero(tested)
    if p >= OUTLIER_P or abs(scaled[worst]) < ROUNDING_MM:
        return
    alone = fits[of[worst]].dof > 1
    row = rows[worst] if alone else groups[of[worst]][0]
    which = "a contact" if alone else f"one of the {len(groups[of[worst]])} contacts from here on"
    raise InputError(
        f"{which} is an outlier (p = {p:.1g}, corrected for the number of contacts)",
        expected="all contacts on one sphere within their noise; remove the contact, or correct it",
        file=contacts.source,
        line=int(contacts.lines[row]),
        value=f"residual {residuals[worst] * 1e3:.3g} µm",
    )


def _exceeds(sum_mm2: float, dof: int, noise_mm: float) -> bool:
    """Return whether a sum of squared residuals is significantly larger than a noise lets expect."""
    return dof > 0 and float(chi2_sf(sum_mm2 / noise_mm**2, dof)) < OUTLIER_P


def _excess(fits: Sequence[Sphere], dof: int, probing: Probing) -> tuple[str, ...]:
    """Return a note if the residuals are significantly larger than the stated noise."""
    total = sum(float(fit.residuals_mm @ fit.residuals_mm) for fit in fits)
    if probing.u_contact_mm is None or not _exceeds(total, dof, probing.u_contact_mm):
        return ()
    return (
        f"the residuals correspond to {np.sqrt(total / dof) * 1e3:.3g} µm for each contact, significantly more than stated: the "
        "uncertainties of the centres are too small (form of the sphere, lobing of the probe, drift)",
    )


def _normals(
    contacts: Contacts, points: np.ndarray, fits: Sequence[Sphere], groups: Sequence[np.ndarray], probing: Probing
) -> tuple[str, ...]:
    """Return a note on the largest angle between probing direction and normal, if the tip is compensated along the direction."""
    if probing.tip_radius_mm is None or not np.isfinite(contacts.direction).all():
        return ()
    cosines = []
    for rows, fit in zip(groups, fits, strict=True):
        inward = fit.centre_mm - points[rows]
        cosines.append(np.einsum("ij,ij->i", contacts.direction[rows], inward) / np.linalg.norm(inward, axis=1))
    least = float(np.clip(np.concatenate(cosines).min(), -1.0, 1.0))
    angle, size = float(np.degrees(np.arccos(least))), probing.tip_radius_mm * (1.0 - least)
    return (
        f"largest angle between probing direction and normal {angle:.2g}°: up to {size * 1e3:.2g} µm of the compensation",
    )


def _sizes_by_axis(points: np.ndarray, fits: Sequence[Sphere], groups: Sequence[np.ndarray]) -> tuple[str, ...]:
    """Return a note for two axes along which the spheres differ in size significantly: backlash of b makes them smaller by b."""
    sizes, left = [np.empty((0, 3))], [np.empty(0)]
    for rows, fit in zip(groups, fits, strict=True):
        normals = points[rows] - fit.centre_mm
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        fitted = np.column_stack([normals, np.ones(len(rows))])[:, : len(fit.cofactor)]
        free = np.linalg.qr(fitted, mode="complete")[0][:, len(fit.cofactor) :].T
        # Both sides are touched towards the sphere: half of the difference of the diameters at each.
        sizes.append(0.5 * free @ np.abs(normals))
        left.append(free @ fit.residuals_mm)
    design, residuals = np.concatenate(sizes), np.concatenate(left)
    inverse = np.linalg.pinv(design, rcond=WEAK)
    found = inverse @ residuals
    dof = len(residuals) - 3
    if dof < 1:
        return ()
    noise, seen = float(np.linalg.norm(residuals - design @ found) / np.sqrt(dof)), inverse @ design
    notes = []
    for i, j in ((0, 1), (1, 2), (0, 2)):
        contrast = np.eye(3)[i] - np.eye(3)[j]
        u = max(noise * float(np.linalg.norm(contrast @ inverse)), ROUNDING_MM)
        difference = float(contrast @ found)
        p = 2.0 * float(student_sf(abs(difference) / u, dof)) * 3.0
        if p < OUTLIER_P and np.linalg.norm(contrast @ seen - contrast) < SAME_CONTRAST:
            small, large = (i, j) if difference < 0.0 else (j, i)
            notes.append(
                f"the spheres are {abs(difference) * 1e3:.1f} ± {1.96 * u * 1e3:.1f} µm (95 %) smaller along "
                f"{CARTESIAN[small]} than along {CARTESIAN[large]}: backlash of {CARTESIAN[small]}, or a probe that needs more "
                "travel there; centres between contacts from both sides are right"
            )
    return tuple(notes)


def _table(
    contacts: Contacts, machine: Machine, centres: Sequence[SphereCentre], columns: Sequence[int]
) -> Measurements:
    """Return the centres as a measurement table; the covariance is turned into the frame of the tool."""
    positions = np.array([centre.positions for centre in centres])
    motion = _reading_by_axis(machine, positions, columns)
    covariance = np.array([centre.covariance_mm2 for centre in centres])
    turned = motion @ covariance @ motion.transpose(0, 2, 1)
    return probe_table(
        machine,
        positions,
        source=contacts.source,
        lines=np.array([centre.line for centre in centres]),
        target=np.array([centre.sphere for centre in centres], dtype=object),
        round_name=np.array([centre.round for centre in centres], dtype=object),
        u_mm=np.sqrt(np.diagonal(turned, axis1=1, axis2=2)),
        simulated=contacts.simulated,
    )


def _reading_by_axis(machine: Machine, positions: np.ndarray, columns: Sequence[int]) -> np.ndarray:
    """Return (n, 3, 3) the derivative of a point of the work side, seen from the tool, with respect to X, Y and Z.

    Raises `InputError`: the linear axes are not orthogonal, so that contacts in axis coordinates do not lie on a sphere.
    """
    n, observation = len(positions), Observation(machine)

    def seen(q: np.ndarray) -> np.ndarray:
        errors, sides = np.zeros((n, 6 * len(machine.frames))), np.full(n, "work", dtype=object)
        return observation.points(q, errors, sides, np.zeros((n, 3)), np.full(n, "tool", dtype=object))

    start = positions * machine.scale
    steps = []
    for column in columns:
        moved = start.copy()
        moved[:, column] += 1.0
        steps.append(seen(moved) - seen(start))
    motion = np.stack(steps, axis=2)
    if np.abs(motion.transpose(0, 2, 1) @ motion - np.eye(3)).max() > ORTHOGONAL:
        raise InputError("the linear axes are not orthogonal", expected="orthogonal X, Y, Z", value=machine.name)
    return motion


def numbered_rounds(sphere: np.ndarray, poses: np.ndarray, per_sphere: int | None = None) -> np.ndarray:
    """Return (n,) round names of contacts in the order in which they were made.

    A pose that a sphere was already probed in begins a new round for that sphere and pose.

    ``sphere``: (n,) names; ``poses``: (n, k) positions of the other axes; ``per_sphere``: number of contacts that belong together; None
    for all consecutive ones of one sphere and pose.
    """
    n = len(sphere)
    same = [bool(a == b) and bool(np.array_equal(p, q)) for (a, p), (b, q) in pairwise(zip(sphere, poses, strict=True))]
    seen: dict[tuple[str, bytes], int] = {}
    rounds, count = np.full(n, "1", dtype=object), 0
    for i in range(n):
        new = i == 0 or not same[i - 1] or (per_sphere is not None and count == per_sphere)
        key = (str(sphere[i]), (np.asarray(poses[i], dtype=float) + 0.0).tobytes())
        if new:
            seen[key] = seen.get(key, 0) + 1
        count = 1 if new else count + 1
        rounds[i] = str(seen[key])
    return read_only(rounds)
