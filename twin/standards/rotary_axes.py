"""Kinematic tests with linear and rotary axes after ISO 10791-6: deviations while the nominal point of contact stands still.

A run counts as such a test if the nominal machine, for some place of the target, keeps the target at one point of the frame on which
the station rides (R-test, ball bar, touch probe and sphere). Names follow the machine: A where both rotary axes carry the tool, B where
both carry the work, C for one of each; 1 and 2 for a single rotary axis, counted from the base, and 4 for both together. The exact
content of the standard's clauses was not available: names and quantities are not verified against its text.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final, Literal

import numpy as np
import scipy

from twin._common.errors import InputError
from twin._common.messages import Message
from twin._common.units import DEG, MM, UM, URAD
from twin.machine.machine import Axis, Machine
from twin.measurement.observation import nominal_carriers
from twin.numerics.spatial import algebraic_sphere
from twin.standards.iso230_4 import WIDEST_GAP_DEG, CircularTest, RotaryMotion, circular_test, error_motion
from twin.standards.linear_axes import positioning
from twin.standards.readings import DECIMALS, MeasuredRun, NotPossible, carried_sides, place_of, rms_um
from twin.standards.result import StandardTest, StandardValue

KINEMATIC: Final = "after ISO 10791-6:2014 (not verified)"
STANDS_STILL_MM: Final = 1.0
"""Motion of the nominal point, mm, up to which it counts as standing still."""
LEAST_TURN_DEG: Final = 5.0


def kinematic_test(run: MeasuredRun, machine: Machine, u_mm: np.ndarray) -> StandardTest | None:
    """Evaluate an interpolated motion of linear and rotary axes; None if the nominal point does not stand still."""
    data = run.data
    turning = [i for i in run.axes if not machine.axes[i].linear]
    if max(float(np.ptp(data.positions[:, i])) for i in turning) < LEAST_TURN_DEG:
        return None
    nominal = nominal_carriers(machine, data).least_motion(data.place_mm[0]) / MM
    if float(np.abs(nominal).max()) > STANDS_STILL_MM:
        return None
    if not run.read.any():
        raise NotPossible(Message("no coordinate was read in every row"))
    constant = bool(np.ptp(data.point_mm[:, run.read], axis=0).max() == 0.0)
    length_only = run.read.tolist() == [True, False, False]
    readings = data.point_mm - data.point_mm.mean(axis=0)
    if not length_only:
        readings = readings - nominal
    deviation = np.where(run.read, readings, np.nan) * (MM / UM)
    remarks = [
        Message(
            "what was evaluated: the range (largest minus smallest) of the deviation in each direction of the "
            "station's frame; the name of the test and the quantity are not verified against the text of the standard"
        ),
        Message(
            "the directions are those of the station's frame; the zero of the readings and the place of the target "
            "have no influence"
        )
        if np.isfinite(data.place_mm[0]).all()
        else Message("the place of the target is the one that keeps the nominal point most nearly at rest"),
    ]
    if constant:
        remarks.append(
            Message("the readings are constant: the deviations are those of the recorded axis positions (touch probe)")
        )
    columns = ("length",) if length_only else ("x", "y", "z")
    values = []
    for k, name in enumerate(columns):
        if run.read[k]:
            u = u_mm[:, k]
            u_um = float(np.sqrt(np.mean(u**2))) * (MM / UM)
            words = (
                Message("range of the deviation, length")
                if length_only
                else Message("range of the deviation, {name} of the station", name=name)
            )
            values.append(
                StandardValue(f"range {name}", f"range_{name}", float(np.ptp(deviation[:, k])), "um", words, float(np.sqrt(2.0) * u_um))
            )  # fmt: skip
    names = tuple(machine.axes[i].name for i in run.axes)
    return StandardTest(
        kind="kinematic",
        name=f"{_name(machine, turning)} ({''.join(names)})",
        standard=KINEMATIC,
        axes=names,
        place=place_of(run),
        values=tuple(values),
        remarks=tuple(remarks),
        detail=deviation,
    )


def _name(machine: Machine, turning: list[int]) -> str:
    """Return the name of the test by the sides that the rotary axes carry."""
    rotary = machine.rotary
    sides = {machine.axes[i].side for i in rotary}
    if len(rotary) != 2 or not sides <= {"tool", "work"}:
        return "kinematic"
    letter = "C" if len(sides) == 2 else "A" if sides == {"tool"} else "B"
    if len(turning) == 2:
        return f"{letter}K4"
    # Of two axes on one side, the one nearer the base carries the other.
    order = sorted(rotary, key=lambda i: machine.axis_joints[i])
    return f"{letter}K{order.index(turning[0]) + 1}"


# --- Tests of one rotary axis: positioning by ISO 230-2, error motions by ISO 230-7, from coordinates of one target

ERROR_MOTION: Final = Message("ISO 230-7:2015, clause 3")
ON_AXIS_MM: Final = 1.0
"""Distance of a target from the rotary axis up to which it counts as centred on it."""
LEAST_ARC_DEG: Final = 90.0
"""Arc below which the centre of the target's circle is not determined well enough."""


def rotary_tests(run: MeasuredRun, machine: Machine, u_mm: np.ndarray) -> Iterator[StandardTest]:
    """Yield positioning and error motions of a rotary axis."""
    axis = machine.axes[run.axes[0]]
    theta = run.positions[:, 0]
    if not turns_readings(run, axis):
        raise NotPossible(Message("turns neither the target nor the station, or both: the readings do not show it"))
    if not run.read.all():
        raise NotPossible(Message("needs three coordinates of a target; lengths alone give no angle"))
    if float(np.ptp(theta)) < LEAST_ARC_DEG:
        raise NotPossible(
            Message("turns by {turn:g}° only; at least {least:g}° are needed", turn=np.ptp(theta), least=LEAST_ARC_DEG)
        )
    u = float(np.sqrt(np.nanmean(u_mm**2))) if np.isfinite(u_mm).any() else float("nan")
    points = run.data.point_mm
    spread = float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())
    if spread <= ON_AXIS_MM:
        yield from _on_axis(run, machine, u)
        return
    radius_mm, radial_mm, axial_mm, angle_deg = _circle(points, theta)
    deviation = angle_deg - theta
    deviation = (deviation - deviation[0] + 180.0) % 360.0 - 180.0
    remarks = [
        Message(
            "angles of one target at {radius_mm:.1f} mm from the axis, about its least-squares circle",
            radius_mm=radius_mm,
        )
    ]
    remarks.append(Message("deviations count from the first reading"))
    yield positioning(run, machine, deviation * (DEG / URAD), u / radius_mm / URAD, remarks)
    at = Message("target at {radius_mm:.1f} mm from the axis", radius_mm=radius_mm)
    for name, values, kind, remark in (
        (f"{axis.name} radial", radial_mm, "radial", Message("rotating sensitive direction: {at}", at=at)),
        (f"{axis.name} face", axial_mm, "axial", Message("face error motion (axial and tilt together): {at}", at=at)),
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
            remark = Message("directions of the station's frame, taken as parallel to the machine's; centred target")
            yield _motion_test(run, motion, axis.name, u * (MM / UM), (remark,))
    if not found:
        raise NotPossible(Message("angles do not cover a turn with gaps below {gap:g}°", gap=WIDEST_GAP_DEG))


def _circle(points: np.ndarray, theta: np.ndarray) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Return the circle of a target about a rotary axis: plane by principal components, centre and radius by least squares.

    The radius, mm; (n,) the distance from the axis, and from the plane of the circle, positive on the side from which the angle rises
    anticlockwise, mm; (n,) the angle about the axis, rising with the commanded angle, degrees.
    """
    centred = points - points.mean(axis=0)
    _, _, directions = np.linalg.svd(centred, full_matrices=False)
    plane = centred @ directions[:2].T
    centre, radius = algebraic_sphere(plane)
    x, y = (plane - centre).T
    angle, normal = np.arctan2(y, x) / DEG, np.cross(directions[0], directions[1])
    step = np.exp(1j * (angle - theta) * DEG), np.exp(1j * (-angle - theta) * DEG)
    if abs(step[1].mean()) > abs(step[0].mean()):  # the plane is seen from behind
        angle, normal = -angle, -normal
    return radius, np.hypot(x, y), centred @ normal, angle


def _motion(theta: np.ndarray, values: np.ndarray, kind: Literal["radial", "axial"], name: str) -> RotaryMotion | None:
    """Return the error motion over the turns, or None if the angles do not cover a turn."""
    angles, which, visits = np.unique(np.round(theta, DECIMALS) % 360.0, return_inverse=True, return_counts=True)
    if len(angles) < 3 or np.diff(angles, append=angles[0] + 360.0).max() > WIDEST_GAP_DEG:
        return None
    turns = int(visits.min())
    readings = np.array([values[which == k][:turns] for k in range(len(angles))]).T
    return error_motion(angles, readings, kind, name=name)


def _motion_test(
    run: MeasuredRun, motion: RotaryMotion, axis: str, u: float, remarks: tuple[Message, ...]
) -> StandardTest:
    range_u = float(np.sqrt(2.0) * u)
    rows = (
        (Message("total"), "total", motion.total_value, Message("total error motion")),
        (Message("synchronous"), "synchronous", motion.synchronous_value, Message("synchronous error motion")),
        (Message("asynchronous"), "asynchronous", motion.asynchronous_value, Message("asynchronous error motion")),
        (
            Message("residual synchronous"),
            "residual_synchronous",
            motion.residual_value,
            Message("residual synchronous error motion"),
        ),
    )
    values = tuple(
        StandardValue(sign, key, float("nan") if value is None else value, motion.unit, words, range_u)
        for sign, key, value, words in rows
    )
    notes = (
        remarks
        if motion.asynchronous_value is not None
        else (*remarks, Message("one turn: no asynchronous error motion"))
    )
    return StandardTest("rotary error motion", motion.name, ERROR_MOTION, (axis,), place_of(run), values, notes, motion)


# --- Circular tests of two linear axes by ISO 230-4, from coordinates or from the length of a ball bar

CIRCULAR: Final = Message("ISO 230-4:2005 and 2022, clause 3 (H: 1996)")
LARGEST_OFFSET_MM: Final = 1.0
"""Difference of the mean length from the nominal radius up to which a length is absolute."""
BAR_CENTRE: Final = Message(
    "radii are the lengths of the table (ball bar); its centre pivot is taken to be at the circle's centre"
)
NOT_VERIFIED: Final = Message(
    "definitions from public abstracts and publications, not checked against the text of the standard"
)


def circle_test(run: MeasuredRun, machine: Machine, u_mm: np.ndarray) -> StandardTest:
    """Evaluate a circular test: a run of two linear axes on a circle."""
    names = tuple(machine.axes[i].name for i in run.axes)
    centre, commanded = algebraic_sphere(run.positions)
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
            Message(
                "the mean length differs from the nominal radius by {difference:.3f} mm: lengths are taken as relative, and "
                "radial deviations F and D are not determined",
                difference=radius.mean() - nominal,
            )
        )
        radius = radius - radius.mean() + nominal
    step = _travel(angle, run.part)
    paths = [(angle[step == side], radius[step == side]) if np.any(step == side) else None for side in (1.0, -1.0)]
    try:
        found = circular_test(nominal, *paths, name="".join(names))
    except InputError as error:
        raise NotPossible(Message("{reason}", reason=error.what)) from error
    found = found if absolute else replace(found, D_um=None)
    remarks += [Message("not a full test: {text}", text=text) for text in found.shortfalls]
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
    u = rms_um(column)
    values = _values(found, u, len(run.data), absolute=absolute)
    return StandardTest("circular", "".join(names), CIRCULAR, names, place, values, tuple(remarks), found)


def _radii(run: MeasuredRun, centre: np.ndarray) -> np.ndarray:
    """Return the distances from the centre in the plane of the circle, after a rigid alignment of the commands to the points.

    The alignment has no scale and no shear, which would hide squareness and scale errors.
    """
    if not run.read.all():
        raise NotPossible(Message("needs three coordinates, or a length in x_mm alone"))
    points, commands = run.data.point_mm, run.positions - centre
    flat = np.column_stack([commands, np.zeros(len(commands))])
    offset, middle = points.mean(axis=0), flat.mean(axis=0)
    turned, _ = scipy.spatial.transform.Rotation.align_vectors(flat - middle, points - offset)
    aligned = turned.apply(points - offset) + middle
    return np.asarray(np.hypot(aligned[:, 0], aligned[:, 1]))


def _travel(angle: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Return (n,) the direction of travel of each row, from the order of the rows."""
    travel = np.zeros(len(angle))
    for number in np.unique(part):
        rows = np.flatnonzero(part == number)
        step = np.sign(np.round((np.diff(angle[rows]) + 180.0) % 360.0 - 180.0, 9))
        before = np.concatenate([step[:1], step])
        for i in range(1, len(before)):  # a repeated reading has the direction of the one before
            before[i] = before[i] or before[i - 1]
        travel[rows] = before
    return travel


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
