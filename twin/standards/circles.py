"""Circular tests of two linear axes by ISO 230-4, from coordinates or from the length of a ball bar."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
import scipy

from twin._common.errors import InputError
from twin._common.units import DEG, MM, UM
from twin.machine.machine import Machine
from twin.measurement.evaluation import CircularTest, circular_test
from twin.standards.readings import NotPossible
from twin.standards.result import StandardTest, StandardValue
from twin.standards.runs import MeasuredRun, fit_circle
from twin.standards.words import place_of

CIRCULAR: Final = "ISO 230-4:2005 and 2022, clause 3 (H: 1996)"
LARGEST_OFFSET_MM: Final = 1.0
"""Difference of the mean length from the nominal radius up to which a length is absolute."""
BAR_CENTRE: Final = (
    "radii are the lengths of the table (ball bar); its centre pivot is taken to be at the circle's centre"
)
NOT_VERIFIED: Final = "definitions from public abstracts and publications, not checked against the text of the standard"


def circle_test(run: MeasuredRun, machine: Machine, u_mm: np.ndarray) -> StandardTest:
    """Evaluate a circular test.

    Args:
        run: a run of two linear axes on a circle.
        machine: the machine.
        u_mm: (n, 3) standard uncertainties of its readings.

    Raises:
        NotPossible: too little of the circle was read.
    """
    names = tuple(machine.axes[i].name for i in run.axes)
    centre, commanded = fit_circle(run.positions)
    angle = np.arctan2(*(run.positions - centre).T[::-1]) / DEG
    length_only = run.read.tolist() == [True, False, False]
    remarks = [NOT_VERIFIED]
    if length_only:
        remarks.append(BAR_CENTRE)
    radius = np.asarray(run.data.point_mm[:, 0]) if length_only else _radii(run, centre)
    bar_mm = float(run.data.bar_mm[0])
    nominal = bar_mm if length_only and np.isfinite(bar_mm) else commanded
    absolute = abs(float(radius.mean()) - nominal) < LARGEST_OFFSET_MM
    if not absolute:
        remarks.append(
            f"the mean length differs from the nominal radius by {radius.mean() - nominal:.3f} mm: lengths are taken as relative, "
            "and radial deviations F and D are not determined"
        )
        radius = radius - radius.mean() + nominal
    step = _travel(angle, run.part)
    paths = [(angle[step == side], radius[step == side]) if np.any(step == side) else None for side in (1.0, -1.0)]
    try:
        found = circular_test(nominal, *paths, name="".join(names))
    except InputError as error:
        raise NotPossible(error.what) from error
    found = found if absolute else replace(found, D_um=None)
    remarks += [f"not a full test: {text}" for text in found.shortfalls]
    feed = run.data.feed_mm_min
    place = (
        place_of(run)
        + f"; radius {nominal:.3f} mm, centre "
        + ", ".join(
            f"{name} {value:g}".replace("-", "−") for name, value in zip(names, np.round(centre, 3), strict=True)
        )
    )
    if np.isfinite(feed).all():
        place += f", feed {np.median(feed):g} mm/min"
    column = u_mm[:, :1] if length_only else u_mm
    u = float(np.sqrt(np.nanmean(column**2))) * (MM / UM) if np.isfinite(column).any() else float("nan")
    values = _values(found, u, len(run.data), absolute=absolute)
    return StandardTest("circular", "".join(names), CIRCULAR, names, place, values, tuple(remarks), found)


def _radii(run: MeasuredRun, centre: np.ndarray) -> np.ndarray:
    """Return the distances from the centre in the plane of the circle, after a rigid alignment of the commands to the points.

    The alignment has no scale and no shear, which would hide squareness and scale errors.

    Raises:
        NotPossible: not all coordinates were read.
    """
    if not run.read.all():
        raise NotPossible("needs three coordinates, or a length in x_mm alone")
    points, commands = run.data.point_mm, run.positions - centre
    flat = np.column_stack([commands, np.zeros(len(commands))])
    offset, middle = points.mean(axis=0), flat.mean(axis=0)
    turned, _ = scipy.spatial.transform.Rotation.align_vectors(flat - middle, points - offset)
    aligned = turned.apply(points - offset) + middle
    return np.asarray(np.hypot(aligned[:, 0], aligned[:, 1]))


def _travel(angle: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Return (n,) the direction of travel of each row, from the order of the rows."""
    found = np.zeros(len(angle))
    for number in np.unique(part):
        rows = np.flatnonzero(part == number)
        step = np.sign(np.round((np.diff(angle[rows]) + 180.0) % 360.0 - 180.0, 9))
        before = np.concatenate([step[:1], step])
        for i in range(1, len(before)):  # a repeated reading has the direction of the one before
            before[i] = before[i] or before[i - 1]
        found[rows] = before
    return found


def _values(found: CircularTest, u: float, count: int, *, absolute: bool) -> tuple[StandardValue, ...]:
    range_u = float(np.sqrt(2.0) * u)
    rows: list[tuple[str, str, float | None, str, float]] = [
        ("G(b)", "G_b", found.G_b_um, "bi-directional circular deviation", range_u),
        ("H", "H", found.H_um, "circular hysteresis (ISO 230-4:1996)", range_u),
        ("D", "D", found.D_um if absolute else None, "mean bi-directional radial deviation", u / np.sqrt(count)),
    ]
    for arrow, path in found.paths:
        side = "forward" if arrow == "↺" else "backward"
        words = "counter-clockwise" if arrow == "↺" else "clockwise"
        rows.append((f"G{arrow}", f"G_{side}", path.G_um, f"circular deviation, {words}", range_u))
        for end, value in (("max", path.F_max_um), ("min", path.F_min_um)):
            kept = value if absolute else None
            rows.append((f"F{end}{arrow}", f"F_{end}_{side}", kept, f"{end}. radial deviation, {words}", u))
    rows.append(("G", "G", max(path.G_um for _, path in found.paths), "circular deviation, the larger one", range_u))
    return tuple(
        StandardValue(sign, key, float("nan") if value is None else value, "um", words, float(uu))
        for sign, key, value, words, uu in rows
    )
