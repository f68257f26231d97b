"""Tests of one axis: positioning by ISO 230-2, straightness and squareness by ISO 230-1."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, Literal

import numpy as np

from twin._common.messages import Message, joined
from twin._common.units import MM, UM
from twin.machine.machine import Machine
from twin.standards.iso230_1 import PAIRS, LineKind, Straightness, angular_error, squareness, straightness
from twin.standards.iso230_2 import Positioning, UnidirectionalPositioning, bidirectional, unidirectional
from twin.standards.readings import (
    AS_GIVEN,
    DECIMALS,
    SAME_AS_MACHINE,
    MeasuredRun,
    NotPossible,
    StationFrame,
    across_axis_um,
    along_axis_mm,
    carried_sides,
    directions,
    place_of,
    rms_um,
    station_rotation,
)
from twin.standards.result import StandardTest, StandardValue

POSITIONING: Final = Message("ISO 230-2:2014, clause 3 (tests: 4.3)")
STRAIGHTNESS: Final = Message("ISO 230-1:2012, 3.4 and 8.2")
SQUARENESS: Final = Message("ISO 230-1:2012, squareness of two linear motions")
LINE_NAMES: Final[dict[str, Message]] = {
    "least squares": Message("least squares"),
    "end point": Message("end point"),
    "minimum zone": Message("minimum zone"),
}
LINES: Final[tuple[LineKind, ...]] = ("least squares", "end point", "minimum zone")
CODES: Final = ("", "_EP", "_MZ")
"""The reference lines, and what their keys of values end with."""
Approaches = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Targets (m,), and deviations (m, n) of the approaches from below and from above; an array without columns if there are none."""


def linear_positioning(run: MeasuredRun, machine: Machine, u_mm: np.ndarray) -> StandardTest:
    """Evaluate the positioning of a linear axis by ISO 230-2, from readings with standard uncertainties (n, 3) in mm."""
    axis = machine.axes[run.axes[0]]
    position, u, own_zero = along_axis_mm(run, axis, u_mm)
    deviation = (position - run.positions[:, 0]) * (MM / UM)
    remarks = []
    if not own_zero:
        deviation = deviation - deviation[0]
        remarks.append(
            Message("deviations count from the first reading: the zero of the readings is not that of the axis")
        )
    return positioning(run, machine, deviation, float(np.sqrt(np.mean(u**2))) * (MM / UM), remarks)


def positioning(
    run: MeasuredRun, machine: Machine, deviation: np.ndarray, u: float, remarks: Sequence[Message] = ()
) -> StandardTest:
    """Evaluate the positioning of an axis by ISO 230-2, from both directions of approach or one.

    The deviations (n,) are actual minus target, µm or µrad; ``u`` is the standard uncertainty of one of them, NaN if unknown.
    """
    axis = machine.axes[run.axes[0]]
    approach, _ = directions(run)
    notes = [*remarks]
    targets, up, down = _approaches(run.positions[:, 0], deviation, approach, notes)
    if len(targets) < 2:
        raise NotPossible(Message("fewer than two target positions were approached from the same direction"))
    unit: Literal["mm", "deg"] = "mm" if axis.linear else "deg"
    found: Positioning | UnidirectionalPositioning
    if up.shape[1] and down.shape[1]:
        found = bidirectional(targets, up, down, unit, axis=axis.name, fewest_cycles=1)
        values = _values(found, u)
    else:
        direction = 1 if up.shape[1] else -1
        found = unidirectional(targets, up if direction > 0 else down, unit, direction, axis=axis.name)
        values = _values_of_one_direction(found, u)
    notes += [Message("not by the standard (4.3): {text}", text=text) for text in found.shortfalls]
    if max(up.shape[1], down.shape[1]) < 2:
        notes.append(Message("a single cycle: repeatability R and accuracy A are not determined"))
    return StandardTest(
        kind="positioning",
        name=axis.name,
        standard=POSITIONING,
        axes=(axis.name,),
        place=place_of(run),
        values=values,
        remarks=tuple(notes),
        detail=found,
    )


def _approaches(q: np.ndarray, deviation: np.ndarray, approach: np.ndarray, notes: list[Message]) -> Approaches:
    """Return the deviations as tables, with as many cycles as every target has."""
    rounded = np.round(q, DECIMALS)
    targets = np.unique(rounded)
    both = {side: [deviation[(rounded == target) & (approach == side)] for target in targets] for side in (1.0, -1.0)}
    counts = {side: np.array([len(one) for one in of]) for side, of in both.items()}
    sides = [side for side in both if counts[side].any()]
    if len(sides) == 2 and np.count_nonzero((counts[1.0] > 0) & (counts[-1.0] > 0)) < 2:
        sides = [max(sides, key=lambda side: np.count_nonzero(counts[side]))]
        notes.append(Message("approaches from the other direction are left out: fewer than two targets have both"))
    keep = np.all([counts[side] > 0 for side in sides], axis=0) if sides else np.zeros(len(targets), dtype=bool)
    if not keep.all() and keep.any():
        gone = ", ".join(f"{target:g}" for target in targets[~keep])
        notes.append(Message("targets without all directions of approach are left out: {gone}", gone=gone))
    if np.count_nonzero(keep) < 2:
        return targets[:0], np.zeros((0, 0)), np.zeros((0, 0))
    cycles = min(int(counts[side][keep].min()) for side in sides)
    if any(counts[side][keep].max() > cycles for side in sides):
        notes.append(Message("{cycles} approaches of each target are used; some targets have more", cycles=cycles))
    tables = {
        side: np.array([of[:cycles] for of, kept in zip(both[side], keep, strict=True) if kept])
        if side in sides
        else np.zeros((np.count_nonzero(keep), 0))
        for side in both
    }
    return targets[keep], tables[1.0], tables[-1.0]


def _values(found: Positioning, u: float) -> tuple[StandardValue, ...]:
    """Return the values with uncertainties propagated from independent readings.

    A range is the difference of two values; s of n readings has the standard uncertainty u/√(2(n − 1)) from the readings.
    """
    n = found.cycles
    mean = u / np.sqrt(n)
    s = u / np.sqrt(2.0 * (n - 1)) if n > 1 else float("nan")
    edge = np.sqrt(2.0 * (mean**2 + 4.0 * s**2))
    reversal = np.sqrt(2.0) * mean
    rows = (
        ("A", "A", found.A, Message("bi-directional accuracy"), edge),
        ("A↑", "A_forward", found.A_forward, Message("unidirectional accuracy, positive approach"), edge),
        ("A↓", "A_backward", found.A_backward, Message("unidirectional accuracy, negative approach"), edge),
        ("E", "E", found.E, Message("bi-directional systematic deviation"), reversal),
        (
            "E↑",
            "E_forward",
            found.E_forward,
            Message("unidirectional systematic deviation, positive approach"),
            reversal,
        ),
        (
            "E↓",
            "E_backward",
            found.E_backward,
            Message("unidirectional systematic deviation, negative approach"),
            reversal,
        ),
        ("M", "M", found.M, Message("range of the mean bi-directional deviation"), mean),
        ("R", "R", found.R, Message("bi-directional repeatability"), np.sqrt(8.0 * s**2 + 2.0 * mean**2)),
        ("R↑", "R_forward", found.R_forward, Message("unidirectional repeatability, positive approach"), 4.0 * s),
        ("R↓", "R_backward", found.R_backward, Message("unidirectional repeatability, negative approach"), 4.0 * s),
        ("B", "B", found.B, Message("reversal error"), reversal),
        ("B̄", "B_mean", found.B_mean, Message("mean reversal error"), reversal / np.sqrt(len(found.target))),
    )
    return tuple(StandardValue(sign, key, value, found.unit, words, float(uu)) for sign, key, value, words, uu in rows)


def _values_of_one_direction(found: UnidirectionalPositioning, u: float) -> tuple[StandardValue, ...]:
    n = found.deviations.shape[1]
    mean = u / np.sqrt(n)
    s = u / np.sqrt(2.0 * (n - 1)) if n > 1 else float("nan")
    arrow, side = ("↑", "forward") if found.direction > 0 else ("↓", "backward")
    rows = (
        ("A", found.A, Message("unidirectional accuracy"), np.sqrt(2.0 * (mean**2 + 4.0 * s**2))),
        ("E", found.E, Message("unidirectional systematic deviation"), np.sqrt(2.0) * mean),
        ("R", found.R, Message("unidirectional repeatability"), 4.0 * s),
    )
    return tuple(
        StandardValue(f"{key}{arrow}", f"{key}_{side}", value, found.unit, words, float(uu))
        for key, value, words, uu in rows
    )


def straightness_tests(
    run: MeasuredRun, machine: Machine, frame: StationFrame, u_mm: np.ndarray
) -> Iterator[StandardTest]:
    """Yield the straightness of a linear axis in each direction that was read."""
    targets, which, visits = np.unique(np.round(run.positions[:, 0], DECIMALS), return_inverse=True, return_counts=True)
    across = across_axis_um(run, frame, machine)
    if len(targets) < 3:
        raise NotPossible(Message("fewer than three positions"))
    axis = machine.axes[run.axes[0]].name
    u = rms_um(u_mm)
    u_mean = u / float(np.sqrt(visits.min()))
    for name, deviation in across.items():
        mean = np.bincount(which, deviation) / visits
        found = straightness(targets, mean, name=name, u_um=u_mean if np.isfinite(u_mean) else None)
        remarks = (
            [frame.known] if run.read.all() and frame.known else [Message("directions as the columns of the table")]
        )
        if visits.max() > 1:
            remarks.append(
                Message(
                    "mean of all readings at a position, at least {count}, from all directions of approach",
                    count=visits.min(),
                )
            )
        ends = dict(zip((str(line) for line in LINES), CODES, strict=True))
        values = tuple(
            StandardValue(
                joined("", [f"{name} (", LINE_NAMES[line.kind], ")"]), f"{name}{ends[line.kind]}", line.value_um, "um",
                Message("straightness error, reference line: {line}", line=LINE_NAMES[line.kind]), np.sqrt(2.0) * u_mean,
            )
            for line in found.lines
        )  # fmt: skip
        yield StandardTest("straightness", name, STRAIGHTNESS, (axis,), place_of(run), values, tuple(remarks), found)


def squareness_tests(found: Sequence[tuple[MeasuredRun, Straightness]], machine: Machine) -> Iterator[StandardTest]:
    """Yield the squareness of every two linear axes measured with the same target from one station."""
    for name, (first, second, _) in PAIRS.items():
        done: set[tuple[str, str]] = set()
        for run, datum in found:
            key = run.station, run.target
            others = [(r, s) for r, s in found if (r.station, r.target) == key and s.name == second]
            if datum.name != first or not others or key in done:
                continue
            done.add(key)
            other_run, other = others[0]
            axes = tuple(machine.axes[one.axes[0]] for one in (run, other_run))
            if any(axis.machine_direction.min() < -0.5 for axis in axes):
                continue
            lines = [squareness(datum, other, line=kind) for kind in LINES]
            values = tuple(
                StandardValue(
                    joined("", [f"{name} (", LINE_NAMES[line.line], ")"]), f"{name}{code}", line.value_urad, "urad",
                    Message("squareness error, reference lines: {line}", line=LINE_NAMES[line.line]),
                    float("nan") if line.u_urad is None else line.u_urad,
                )
                for line, code in zip(lines, CODES, strict=True)
            )  # fmt: skip
            names = tuple(axis.name for axis in axes)
            runs = zip(names, (run, other_run), strict=True)
            place = joined("; ", [joined(" ", [n, place_of(one)]) for n, one in runs])
            remark = Message("the station's frame must not have moved between the two runs")
            yield StandardTest("squareness", name, SQUARENESS, names, place, values, (remark,), lines[0])


# --- Angular error motions of a linear axis by ISO 230-1, from the angles that a level or an autocollimator reads

ANGULAR: Final = Message("ISO 230-1:2012, 3.4.16 and 8.4")
NOT_VERIFIED: Final = Message(
    "the angular error is the largest minus the smallest deviation over both directions, without removing a "
    "slope; the text of the standard was not available to check this"
)
BLIND: Final = 1e-6
"""Share of the rotation about the station's z, which is not read, up to which a direction counts as read."""


def angular_tests(run: MeasuredRun, machine: Machine, u_mm: np.ndarray) -> Iterator[StandardTest]:
    """Yield the angular error of a linear axis about each direction that was read; ``u_mm`` (n, 3) are mm at 1 m."""
    axis = machine.axes[run.axes[0]]
    target, station = carried_sides(run, axis)
    if not axis.linear or target == station:
        raise NotPossible(
            Message("the angles do not show {name}", name=axis.name)
            if axis.linear
            else Message(Message("angular errors are those of linear axes"))
        )
    if not run.read[:2].all():
        raise NotPossible(Message("one of the two angles was not read in every row"))
    approach, derived = directions(run)
    if not np.all(approach):
        raise NotPossible(Message("the direction of approach of {name} is unknown in some rows", name=axis.name))
    found = {f"E_{letter}{axis.name}": angle for letter, angle in _about_machine_axes(run).items()}
    if not found:
        raise NotPossible(Message("the station's pose has no axis of rotation parallel to an axis of the machine"))
    known = AS_GIVEN if np.isfinite(run.data.station_pose[0]).all() else SAME_AS_MACHINE
    u = rms_um(u_mm[:, :2])
    position = np.round(run.positions[:, 0], DECIMALS)
    visits = np.unique(np.stack([position, approach]), axis=1, return_counts=True)[1]
    range_u = float(np.sqrt(2.0 / visits.min())) * u
    for name, angle in found.items():
        error = angular_error(position, angle if target else -angle, approach, name=name)
        rows = (
            ("", "", error.value_urad, Message("angular error, both directions")),
            ("↑", "_forward", error.forward_value_urad, Message("range of the angular deviation, positive approach")),
            ("↓", "_backward", error.backward_value_urad, Message("range of the angular deviation, negative approach")),
            (" reversal", "_reversal", error.reversal_urad, Message("largest difference of the two directions")),
        )
        values = tuple(
            StandardValue(f"{name}{sign}", f"{name}{key}", value, "urad", words, range_u)
            for sign, key, value, words in rows
            if value is not None
        )
        remarks = [NOT_VERIFIED, known, *(Message("not a full test: {text}", text=text) for text in error.shortfalls)]
        remarks += [Message("direction of approach from the order of the readings")] if derived else []
        yield StandardTest("angular error", name, ANGULAR, (axis.name,), place_of(run), values, tuple(remarks), error)


def _about_machine_axes(run: MeasuredRun) -> dict[str, np.ndarray]:
    """Return the rotations (n,) of the target relative to the station, µrad, about the machine's axes: ``A``, ``B``, ``C``."""
    turn = station_rotation(run.data.station_pose[0])
    # A reading is the shift (b, −a) of the end of a line of 1 m.
    read = np.column_stack([-run.data.point_mm[:, 1], run.data.point_mm[:, 0]]) * (MM / UM)
    angles = read @ turn[:, :2].T
    return {letter: angles[:, k] for k, letter in enumerate("ABC") if abs(turn[k, 2]) < BLIND}
