"""Tests of one rotary axis: positioning by ISO 230-2, error motions by ISO 230-7, from coordinates of one target."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np

from twin._common.units import DEG, MM, UM, URAD
from twin.machine.machine import Axis, Machine
from twin.measurement.evaluation import RotaryMotion, error_motion
from twin.measurement.evaluation.circular import WIDEST_GAP_DEG
from twin.standards.linear import positioning
from twin.standards.readings import NotPossible, carried_sides
from twin.standards.result import StandardTest, StandardValue
from twin.standards.runs import DECIMALS, MeasuredRun, fit_circle
from twin.standards.words import place_of

ERROR_MOTION: Final = "ISO 230-7:2015, clause 3"
ON_AXIS_MM: Final = 1.0
"""Distance of a target from the rotary axis up to which it counts as centred on it."""
LEAST_ARC_DEG: Final = 90.0
"""Arc below which the centre of the target's circle is not determined well enough."""


@final
@dataclass(frozen=True)
class Circle:
    """Circle of a target about a rotary axis.

    Attributes:
        radius_mm: its radius.
        radial_mm: (n,) distance from the axis.
        axial_mm: (n,) distance from the plane of the circle, positive on the side from which the angle rises anticlockwise.
        angle_deg: (n,) angle about the axis, rising with the commanded angle.
    """

    radius_mm: float
    radial_mm: np.ndarray
    axial_mm: np.ndarray
    angle_deg: np.ndarray


def rotary_tests(run: MeasuredRun, machine: Machine, u_mm: np.ndarray) -> Iterator[StandardTest]:
    """Yield positioning and error motions of a rotary axis.

    Args:
        run: a run of the axis.
        machine: the machine.
        u_mm: (n, 3) standard uncertainties of its readings.

    Raises:
        NotPossible: not all coordinates were read, or they cover too short an arc.
    """
    axis = machine.axes[run.axes[0]]
    theta = run.positions[:, 0]
    if not turns_readings(run, axis):
        raise NotPossible("turns neither the target nor the station, or both: the readings do not show it")
    if not run.read.all():
        raise NotPossible("needs three coordinates of a target; lengths alone give no angle")
    if float(np.ptp(theta)) < LEAST_ARC_DEG:
        raise NotPossible(f"turns by {np.ptp(theta):g}° only; at least {LEAST_ARC_DEG:g}° are needed")
    u = float(np.sqrt(np.nanmean(u_mm**2))) if np.isfinite(u_mm).any() else float("nan")
    points = run.data.point_mm
    spread = float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())
    if spread <= ON_AXIS_MM:
        yield from _on_axis(run, machine, u)
        return
    circle = _circle(points, theta)
    deviation = circle.angle_deg - theta
    deviation = (deviation - deviation[0] + 180.0) % 360.0 - 180.0
    remarks = [f"angles of one target at {circle.radius_mm:.1f} mm from the axis, about its least-squares circle"]
    remarks.append("deviations count from the first reading")
    yield positioning(run, machine, deviation * (DEG / URAD), u / circle.radius_mm / URAD, remarks)
    at = f"target at {circle.radius_mm:.1f} mm from the axis"
    for name, values, kind, remark in (
        (f"{axis.name} radial", circle.radial_mm, "radial", f"rotating sensitive direction: {at}"),
        (f"{axis.name} face", circle.axial_mm, "axial", f"face error motion (axial and tilt together): {at}"),
    ):
        motion = _motion(theta, values * (MM / UM), kind, name)  # type: ignore[arg-type]
        if motion is not None:
            yield _motion_test(run, motion, axis.name, u * (MM / UM), (remark,))


def turns_readings(run: MeasuredRun, axis: Axis) -> bool:
    """Return whether the axis carries the target or the station, and not both."""
    target, station = carried_sides(run, axis)
    return target != station


def _on_axis(run: MeasuredRun, machine: Machine, u: float) -> Iterator[StandardTest]:
    """Yield the error motions in the directions of the station's frame, for a target centred on the axis."""
    axis = machine.axes[run.axes[0]]
    along = int(np.argmax(np.abs(axis.machine_direction)))
    found = 0
    for k, letter in enumerate("XYZ"):
        kind: Literal["radial", "axial"] = "axial" if k == along else "radial"
        motion = _motion(run.positions[:, 0], run.data.point_mm[:, k] * (MM / UM), kind, f"E_{letter}{axis.name}")
        if motion is not None:
            found += 1
            remark = "directions of the station's frame, taken as parallel to the machine's; centred target"
            yield _motion_test(run, motion, axis.name, u * (MM / UM), (remark,))
    if not found:
        raise NotPossible(f"angles do not cover a turn with gaps below {WIDEST_GAP_DEG:g}°")


def _circle(points: np.ndarray, theta: np.ndarray) -> Circle:
    """Return the circle of a target: plane by principal components, centre and radius by least squares."""
    centred = points - points.mean(axis=0)
    _, _, directions = np.linalg.svd(centred, full_matrices=False)
    plane = centred @ directions[:2].T
    centre, radius = fit_circle(plane)
    x, y = (plane - centre).T
    angle, normal = np.arctan2(y, x) / DEG, np.cross(directions[0], directions[1])
    step = np.exp(1j * (angle - theta) * DEG), np.exp(1j * (-angle - theta) * DEG)
    if abs(step[1].mean()) > abs(step[0].mean()):  # the plane is seen from behind
        angle, normal = -angle, -normal
    return Circle(radius, np.hypot(x, y), centred @ normal, angle)


def _motion(theta: np.ndarray, values: np.ndarray, kind: Literal["radial", "axial"], name: str) -> RotaryMotion | None:
    """Return the error motion over the turns, or None if the angles do not cover a turn."""
    angles, which, visits = np.unique(np.round(theta, DECIMALS) % 360.0, return_inverse=True, return_counts=True)
    if len(angles) < 3 or np.diff(angles, append=angles[0] + 360.0).max() > WIDEST_GAP_DEG:
        return None
    turns = int(visits.min())
    readings = np.array([values[which == k][:turns] for k in range(len(angles))]).T
    return error_motion(angles, readings, kind, name=name)


def _motion_test(run: MeasuredRun, motion: RotaryMotion, axis: str, u: float, remarks: tuple[str, ...]) -> StandardTest:
    range_u = float(np.sqrt(2.0) * u)
    rows = (
        ("total", "total", motion.total_value, "total error motion"),
        ("synchronous", "synchronous", motion.synchronous_value, "synchronous error motion"),
        ("asynchronous", "asynchronous", motion.asynchronous_value, "asynchronous error motion"),
        ("residual synchronous", "residual_synchronous", motion.residual_value, "residual synchronous error motion"),
    )
    values = tuple(
        StandardValue(sign, key, float("nan") if value is None else value, motion.unit, words, range_u)
        for sign, key, value, words in rows
    )
    notes = remarks if motion.asynchronous_value is not None else (*remarks, "one turn: no asynchronous error motion")
    return StandardTest("rotary error motion", motion.name, ERROR_MOTION, (axis,), place_of(run), values, notes, motion)
