"""A measured part as measurements of the machine: where each measured point was cut, and how far the real surface is off there.

A point of the part is where the tool's contact was (`twin.part.contact`). Its row of the measurement table has the axis positions of
that contact, the point of the tool as target, the part as station on the work side, and one reading: the coordinate along the
surface's normal. The part's place on the machine, and the radius, length and deflection of each tool, are unknowns of the set-up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError, closest_name
from twin._common.units import MM, count_with_noun
from twin.compensation.programs.block_conditions import velocity_limits
from twin.compensation.programs.execute import Execution
from twin.compensation.programs.prepared import Options
from twin.machine.machine import Machine
from twin.measurement.contacts import approach_of
from twin.measurement.formats import ConvertedFiles
from twin.measurement.formats.base import FormatSpecification
from twin.measurement.observation import nominal_carriers
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.nc.blocks import Program
from twin.nc.dialect import Dialect, FeedUnit
from twin.part.contact import ToolContacts, contacts
from twin.part.features import PartDrawing, Surface, ToolShape, Turned, across
from twin.part.made import STEP_MM, Maker, finely
from twin.part.measured_table import MeasuredPoint, MeasuredTable, read_measured
from twin.tool.forward import Kinematics

CMM: Final = FormatSpecification(
    name="cmm",
    title="part measured on a coordinate measuring machine",
    suffixes=(".csv", ".xlsx"),
    gives="coordinates along the normals of surfaces",
    instrument="cmm",
    needs="the program that cut the part, and its file of features",
    source="columns for feature, nominal and measured coordinates, as measuring programs export them",
    unverified=(),
)
FARTHEST_MM: Final = 1.0
"""Deviation of a measured point from its nominal place that is no error of a machine: another unit, frame or point."""
NOMINAL_MM: Final = 0.05
"""Distance of a nominal point from its nominal surface, at most."""
SCALLOP_MM: Final = 0.1
"""Height of a point over what the tool left, at most."""
SAME_MM: Final = 1e-3
"""Differences between two passes below which the later one counts."""
CENTRE_SHARE: Final = 0.25
"""Distance from an axis, as a share of the radius, up to which a point is its centre."""
STATION: Final = "part"
MIDDLE: Final = 0.5


@final
@dataclass(frozen=True, eq=False)
class MeasuredCut:
    """The contact that made each of m points.

    Attributes:
        positions: (m, axes) axis positions, mm and degrees.
        side: (m, axes + 1) directions of approach, and the time, s.
        contact_mm: (m, 3) the tool's point in the work frame, nominally.
        normal: (m, 3) outward normal there.
        axis: (m, 3) the tool's axis.
        excess_mm: (m,) what the program leaves at the measured point, over the nominal surface.
        line: (m,) of the program.
        tool: (m,) number or name.
        distance_mm: (m,) from the measured point to the contact.
        drilled: (m,) whether the tool's tip made it.
        by_tool: (m, 3) see `by_tool`.
        turning: (m,) whether an axis reverses within a sample of it, so that its direction of approach is not known.
    """

    positions: np.ndarray
    side: np.ndarray
    contact_mm: np.ndarray
    normal: np.ndarray
    axis: np.ndarray
    excess_mm: np.ndarray
    line: np.ndarray
    tool: np.ndarray
    distance_mm: np.ndarray
    drilled: np.ndarray
    by_tool: np.ndarray
    turning: np.ndarray


def import_part(
    path: str | Path,
    part: PartDrawing,
    read: tuple[Program, Dialect],
    machine: Machine,
    options: Options | None = None,
    *,
    sheet: str | None = None,
) -> ConvertedFiles:
    """Return the points of a measured part as measurements of the machine that cut it.

    Args:
        path: table of a coordinate measuring machine, CSV or Excel (`twin.part.measured_table`).
        part: its nominal features and the shapes of the tools.
        read: the program that cut it, with its dialect (`twin.read_program`).
        machine: the machine.
        options: set-up and tool length of the program.
        sheet: sheet of a workbook.

    Raises:
        InputError: with file, line and value: an unknown feature; a nominal point off its surface, or a measured one far from it; a
            surface that no block of the program cuts there; units in doubt; too few points to show anything but the set-up.
    """
    return measure_part(read_measured(Path(path), sheet), part, read, machine, options)


def measure_part(
    table: MeasuredTable,
    part: PartDrawing,
    read: tuple[Program, Dialect],
    machine: Machine,
    options: Options | None = None,
) -> ConvertedFiles:
    """Return measured points that were read already; see `import_part`."""
    maker = Maker(part, machine, Calibration.zero(machine), Options() if options is None else options, (1, 0))
    run = maker.run(*read)
    zero = maker.zero_mm(run)
    run, timed = _with_sides(_finely(run, maker), *read, machine)
    rows = [_rows(table, part, name, maker, run, zero) for name in _features(table, part)]
    points = [point for own, _, _ in rows for point in own]
    off_um = np.concatenate([off for _, off, _ in rows])
    cut = _joined([one for _, _, one in rows])
    kept = np.flatnonzero(~cut.turning)
    left_out = len(points) - len(kept)
    if not len(kept):
        raise InputError("at every point an axis reverses", expected="points elsewhere", file=table.path)
    points, off_um = [points[i] for i in kept], off_um[kept]
    cut = MeasuredCut(*(getattr(cut, name)[kept] for name in MeasuredCut.__dataclass_fields__))
    data = _table(machine, table, points, off_um, cut, timed=timed)
    turned = (
        f"left out: {count_with_noun(left_out, 'reading')} where an axis reverses: which way it came is not known there"
    )
    notes = (
        *table.notes,
        *([turned] if left_out else []),
        *_notes(points, cut, timed=timed),
        *_check_fixed(data, part, points, cut),
    )
    return ConvertedFiles(CMM, data, notes, (), (table.origin,))


def points_of_program(
    part: PartDrawing, read: tuple[Program, Dialect], machine: Machine, options: Options | None = None
) -> MeasuredTable:
    """Return points to measure: some of each feature, spread over what the program cuts, on their nominal places.

    Raises `InputError`: no block makes a feature.
    """
    maker = Maker(part, machine, Calibration.zero(machine), Options() if options is None else options, (1, 0))
    run = maker.run(*read)
    zero = maker.zero_mm(run)
    points: list[MeasuredPoint] = []
    for name, feature in part.features.items():
        if feature.made == "elsewhere":
            continue
        _, parts = maker.touching(name, run, zero, compensated=False)
        for found, *_ in parts:
            if found.drilled and isinstance(feature, Turned):
                at = feature.axis_point(np.array([MIDDLE * (feature.depth or 0.0)]))
            else:
                count = max(FOR_FEATURE, FOR_PART // len(part.features))
                at = found.place_mm[np.unique(np.linspace(0, len(found) - 1, count + 2).astype(int))[1:-1]]
            for place in at:
                x, y, z = (float(value) for value in place)
                normal = tuple(float(value) for value in feature.signed_mm(place[None])[1][0])
                points.append(MeasuredPoint(len(points) + 2, name, (x, y, z), (x, y, z), normal))  # type: ignore[arg-type]
    return MeasuredTable(part.path, tuple(points), stated=True, simulated=True, origin=str(part.path))


FOR_FEATURE: Final = 16
FOR_PART: Final = 120
"""Points that are planned on a feature that a tool goes over, and on all of a part's, at least."""


def _features(table: MeasuredTable, part: PartDrawing) -> list[str]:
    """Return the features that were measured, in the table's order; `InputError` for one that the part does not have."""
    for point in table.points:
        if point.feature not in part.features:
            raise InputError(
                "no such feature",
                expected=f"one of {', '.join([*part.features][:12])}, as in {part.path}",
                file=table.path,
                line=point.line,
                value=point.feature,
                nearest=closest_name(point.feature, [*part.features]),
            )
    return [*dict.fromkeys(point.feature for point in table.points)]


def _finely(run: Execution, maker: Maker) -> Execution:
    """Return an execution with samples 1 mm apart on straight ways, and the nominal tips there."""
    run = finely(run, run.cutting, STEP_MM)
    meant = np.array(run.meant_mm)
    for length in np.unique(run.lengths_mm):
        own = run.lengths_mm == length
        meant[own] = maker.kinematics(length)[0].forward(run.positions[own]).point_mm
    return replace(run, meant_mm=meant)


def _with_sides(run: Execution, program: Program, dialect: Dialect, machine: Machine) -> tuple[Execution, bool]:
    """Return an execution with (n, axes + 1) directions of approach and time in ``sides``, and whether the time is known."""
    approach = approach_of(machine, run.positions, linear=True)
    moved = np.abs(np.diff(run.positions, axis=0, prepend=run.positions[:1]))
    approach[np.cumsum(moved, axis=0) == 0.0] = 0.0
    said = dialect.technology(program)
    at = np.clip(np.searchsorted(program.numbers, run.lines), 0, len(program.numbers) - 1)
    tip = np.linalg.norm(np.diff(run.meant_mm, axis=0, prepend=run.meant_mm[:1]), axis=1)
    way = np.where(tip > 0.0, tip, np.linalg.norm(moved, axis=1))
    least = (moved / velocity_limits(machine)).max(axis=1)
    rate = np.where(said.unit[at] == FeedUnit.TURN, said.feed[at] * said.speed_rpm[at], said.feed[at])
    with np.errstate(divide="ignore", invalid="ignore"):
        taken = np.where(run.cutting & (way > 0.0), np.maximum(60.0 * way / rate, least), least)
    known = bool(np.isfinite(taken).all()) and not np.any(said.unit[at] == FeedUnit.INVERSE)
    time = np.cumsum(taken) if known else np.full(len(taken), np.nan)
    return replace(run, sides=np.column_stack([approach, time])), known


def _rows(
    table: MeasuredTable, part: PartDrawing, name: str, maker: Maker, run: Execution, zero_mm: np.ndarray
) -> tuple[list[MeasuredPoint], np.ndarray, MeasuredCut]:
    """Return the rows of one feature: the point of each, its deviation (n,) along the normal, µm, and its cut."""
    feature = part.features[name]
    points, places, normals, deviations, centre = [], [], [], [], []
    for point in (one for one in table.points if one.feature == name):
        seen = _seen(table, feature, point)
        for place, normal, off in seen:
            centre.append(len(seen) > 1)
            points.append(point)
            places.append(place)
            normals.append(normal)
            deviations.append(off)
    run, parts = maker.touching(name, run, zero_mm, compensated=False)
    cuts = [
        _nearest(
            feature,
            part.tools[number],
            found,
            (some, axis, run, zero_mm, number, maker.kinematics(float(run.lengths_mm[some[0]]))[0]),
            np.array(places),
        )
        for found, some, axis, number in parts
    ]
    cut = _best(cuts)
    for row in np.flatnonzero(np.array(centre) & ~cut.drilled):
        raise InputError(
            f"the centre of {name}, which a tool went around, is not one place of the machine",
            expected="points of its surface; the centre only of a hole that was drilled",
            file=table.path,
            line=points[row].line,
        )
    for row in np.flatnonzero(~np.isfinite(cut.excess_mm) | (np.abs(cut.excess_mm) > SCALLOP_MM)):
        raise InputError(
            f"the program cuts {name} nowhere near this point",
            expected=f"a point within {part.touch_mm:g} mm of a way of the tool on the surface",
            file=table.path,
            line=points[row].line,
            value=", ".join(f"{value:g}" for value in places[row]),
        )
    normal = np.where(cut.drilled[:, None], np.array(normals), cut.normal)
    excess = np.array(cut.excess_mm)
    if isinstance(feature, Turned):
        tip = cut.contact_mm - zero_mm
        beside = ((tip - feature.axis_point(feature.along_mm(tip))) * normal).sum(axis=1)
        excess = np.where(cut.drilled, beside, excess)
    engagement = np.array([point.engagement_mm for point in points])
    sizes = np.zeros((len(points), 3))
    for number in np.unique(cut.tool):
        own = cut.tool == number
        sizes[own] = by_tool(part.tools[number], normal[own], cut.axis[own], engagement[own])
    sizes[centre] = 0.0
    return (
        points,
        np.array(deviations) * 1e3 - excess * 1e3,
        replace(cut, normal=normal, excess_mm=excess, by_tool=sizes),
    )


def _seen(table: MeasuredTable, feature: Surface, point: MeasuredPoint) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Return nominal place, outward normal and deviation, mm, where a measured point shows a surface: once, or twice at a centre."""

    def refused(what: str, expected: str, value: object) -> InputError:
        return InputError(what, expected=expected, file=table.path, line=point.line, value=value)

    nominal, measured = np.array(point.nominal_mm), np.array(point.measured_mm)
    given = np.isfinite(nominal).any()
    place = np.where(np.isfinite(nominal), nominal, measured) if given else measured
    if isinstance(feature, Turned):
        # A centre is often given without its depth.
        along = feature.axis_point(np.array([MIDDLE * (feature.depth or 0.0)]))[0]
        place = np.where(np.isfinite(place), place, along)
    if not np.isfinite(place).all() or (np.isfinite(nominal) & ~np.isfinite(measured)).any():
        raise refused(
            "a coordinate is missing", "x, y and z of the point; of the centre of a hole, two", point.measured_mm
        )
    moved = np.where(np.isfinite(nominal) & np.isfinite(measured), measured - nominal, 0.0)
    if given and np.abs(moved).max() > FARTHEST_MM:
        raise refused(
            f"measured {np.abs(moved).max():.4g} mm from its nominal place{_inches(measured, nominal)}",
            f"within {FARTHEST_MM:g} mm, in millimetres, in the frame of the part's datums",
            ", ".join(f"{value:g}" for value in measured),
        )
    distance, away = feature.signed_mm(place[None])
    if isinstance(feature, Turned) and hasattr(feature, "diameter"):
        radial = float(feature.radial(place[None])[0][0])
        if radial < CENTRE_SHARE * feature.diameter / 2.0:
            if given and radial > NOMINAL_MM:
                raise refused(
                    f"a nominal centre {radial:.4g} mm from the axis of {point.feature}{_in_inches(feature, place, radial)}",
                    "its place on the drawing, in mm", ", ".join(f"{value:g}" for value in place),
                )  # fmt: skip
            axis = feature.axis_point(feature.along_mm(place[None]))[0]
            shift = moved if given else measured - axis
            return [(axis, side, float(shift @ side)) for side in across(feature.unit)]
    limit = NOMINAL_MM if given else FARTHEST_MM
    if abs(distance[0]) > limit:
        raise refused(
            f"a point {abs(distance[0]):.4g} mm from the nominal surface of {point.feature}{_in_inches(feature, place, limit)}",
            f"within {limit:g} mm, in millimetres, in the part's frame",
            ", ".join(f"{value:g}" for value in place),
        )
    normal = _normal_of(table, point, away[0])
    off = float(moved @ normal) if given else float(distance[0])
    return [(place - distance[0] * away[0], normal, off)]


def _normal_of(table: MeasuredTable, point: MeasuredPoint, normal: np.ndarray) -> np.ndarray:
    """Return the drawing's normal, which that of the table must not contradict."""
    if np.isfinite(point.normal).all() and abs(float(np.array(point.normal) @ normal)) < np.cos(np.radians(5.0)):
        raise InputError(
            f"a normal that is not that of {point.feature}",
            expected=", ".join(f"{value:.3f}" for value in normal),
            file=table.path,
            line=point.line,
            value=", ".join(f"{value:g}" for value in point.normal),
        )
    return normal


def _inches(measured: np.ndarray, nominal: np.ndarray) -> str:
    """Return a hint, if the measured point is in inches."""
    return "; it would be in inches" if np.nanmax(np.abs(25.4 * measured - nominal)) < FARTHEST_MM else ""


def _in_inches(feature: Surface, place: np.ndarray, limit: float) -> str:
    near = float(np.abs(feature.signed_mm(25.4 * place[None])[0][0])) < limit
    return "; in inches it would lie on it" if near else ""


def _nearest(
    feature: Surface,
    tool: ToolShape,
    found: ToolContacts,
    at: tuple[np.ndarray, np.ndarray, Execution, np.ndarray, str, Kinematics],
    places: np.ndarray,
) -> MeasuredCut:
    """Return the contact of one tool nearest to each of (m, 3) places, between two samples; excess NaN where none is near."""
    some, axis, run, zero_mm, number, nominal = at
    # One contact for each sample: that at the lower end of a flank; the places along the flank follow from the point.
    first = _lowest(found.part(np.unique(found.sample, return_index=True)[1]), axis, tool)
    if found.drilled and isinstance(feature, Turned):
        places = feature.axis_point(feature.along_mm(places))
    begin, share, far = _on_way(first, axis, tool, places, run.gaps[some])
    rows = some[first.sample]
    end = np.minimum(begin + 1, len(first) - 1)

    def between(values: np.ndarray) -> np.ndarray:
        return np.asarray(values[begin] + share[:, None] * (values[end] - values[begin]))

    positions, sides = _on_curve(run, rows[begin], share), run.sides[rows]
    later = np.where(share > 0.0, end, begin)
    side = np.column_stack([sides[later, :-1], between(sides[:, -1:])])
    follows = np.diff(first.sample, append=-1) == 1
    turns = follows & (sides[:, :-1] != np.roll(sides[:, :-1], -1, axis=0)).any(axis=1)
    turning = turns[begin] | turns[later] | turns[np.maximum(begin - 1, 0)]
    poses = nominal.forward(positions)
    tip, axes = poses.point_mm, poses.axis
    normal, lever, off = between(first.normal), between(first.lever_mm), between(first.off_mm[:, None])[:, 0]
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    if not found.drilled:
        again = contacts(feature, tool, tip - zero_mm, axes, np.inf)
        again = _lowest(again.part(np.unique(again.sample, return_index=True)[1]), axes, tool)
        normal[again.sample], lever[again.sample], off[again.sample] = again.normal, again.lever_mm, again.off_mm
    flank = np.abs((normal * axes).sum(axis=1)) < FLANK
    height = np.clip(((places + zero_mm - tip - lever) * axes).sum(axis=1), 0.0, tool.reach - tool.corner_radius)
    if not found.drilled:
        lever = lever + np.where(flank, height, 0.0)[:, None] * axes
    excess, reach = off, np.full(len(places), REACH_MM)
    if not found.drilled and tool.corner_radius > 0.0:
        round_edge = ~flank & (np.abs((normal * axes).sum(axis=1)) < 1.0 - FLANK) | (tool.corner_radius == tool.radius)
        centre = tip - zero_mm + lever + tool.corner_radius * normal
        gap = np.linalg.norm(places - centre, axis=1) - tool.corner_radius
        excess = np.where(round_edge, gap, off)
        reach = np.where(round_edge, np.inf, reach)
    bottom = np.abs((normal * axes).sum(axis=1)) > 1.0 - FLANK
    reach = np.where(bottom & ~np.isinf(reach), tool.radius + REACH_MM, reach)
    excess = np.where(far <= reach, excess, np.nan)
    return MeasuredCut(
        positions, side, tip + lever, normal, axes, excess, run.lines[rows[later]],
        np.full(len(places), number, dtype=object), far, np.full(len(places), found.drilled), np.zeros((len(places), 3)), turning,
    )  # fmt: skip


FLANK: Final = 1e-4
REACH_MM: Final = 1.5
"""Distance of a point from the nearest way of the tool, where it cuts in a line: samples are 1 mm apart."""


def _on_curve(run: Execution, before: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return (m, axes) positions at shares of the way from samples (m,) to the next, through up to four samples of the same block.

    Lagrange polynomials in the length of the chords: samples of an arc lie on it, and so does what is between them.
    """
    samples = len(run.lines)
    at = before[:, None] + np.array([-1, 0, 1, 2])
    inside = np.clip(at, 0, samples - 1)
    steps = np.linalg.norm(np.diff(run.positions[inside], axis=1), axis=2)
    node = np.column_stack([-steps[:, 0], np.zeros(len(at)), steps[:, 1], steps[:, 1] + steps[:, 2]])
    same = run.lines[inside] == run.lines[inside[:, 2:3]]
    used = (at == inside) & same
    used[:, 0] &= steps[:, 0] > 1e-9
    used[:, 3] &= steps[:, 2] > 1e-9
    used[:, 0] &= ~run.gaps[inside[:, 1]]
    used[:, 3] &= ~run.gaps[inside[:, 3]]
    # The end of the block before is the beginning of this one.
    used[:, 1] = True
    used[:, 2] = (at[:, 2] == inside[:, 2]) & (steps[:, 1] > 1e-9) & (share > 0.0)
    where = share * steps[:, 1]
    positions = np.zeros((len(at), run.positions.shape[1]))
    for j in range(4):
        weight = used[:, j].astype(float)
        for k in range(4):
            if k != j:
                apart = np.where(used[:, j] & used[:, k], node[:, j] - node[:, k], 1.0)
                weight *= np.where(used[:, k], (where - node[:, k]) / apart, 1.0)
        positions += weight[:, None] * run.positions[inside[:, j]]
    return positions


def _lowest(found: ToolContacts, axis: np.ndarray, tool: ToolShape) -> ToolContacts:
    """Return contacts with those along a flank at its lower end; ``axis``: (s, 3) of the samples."""
    if found.drilled:
        return found
    along = axis[found.sample]
    flank = np.abs((found.normal * along).sum(axis=1)) < FLANK
    above = np.where(flank, (found.lever_mm * along).sum(axis=1) - tool.corner_radius, 0.0)[:, None] * along
    return replace(found, place_mm=found.place_mm - above, lever_mm=found.lever_mm - above)


def _on_way(
    first: ToolContacts, axis: np.ndarray, tool: ToolShape, places: np.ndarray, gaps: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return for (m, 3) places the contact before the nearest point of the way, the share of the way to the next, and the distance."""
    start = first.place_mm
    step = np.diff(start, axis=0, append=start[-1:])
    after = np.minimum(np.arange(len(first)) + 1, len(first) - 1)
    connected = (np.diff(first.sample, append=-1) == 1) & ~gaps[first.sample[after]]
    step[~connected] = 0.0
    length = np.maximum((step**2).sum(axis=1), 1e-18)
    along = axis[first.sample]
    flank = (np.abs((first.normal * along).sum(axis=1)) < FLANK) & ~np.array(first.drilled)
    begin, share, far = (np.zeros(len(places), dtype=int), np.zeros(len(places)), np.zeros(len(places)))
    for i, place in enumerate(places):
        off = place - start
        height = np.where(flank, np.clip((off * along).sum(axis=1), 0.0, tool.reach), 0.0)
        off = off - height[:, None] * along
        part = np.clip((off * step).sum(axis=1) / length, 0.0, 1.0)
        distance = np.linalg.norm(off - part[:, None] * step, axis=1)
        # The deepest of several passes makes the surface; of equal ones the last.
        near = np.flatnonzero(distance <= distance.min() + SAME_MM)
        deepest = near[first.off_mm[near] <= first.off_mm[near].min() + SAME_MM]
        begin[i], share[i], far[i] = deepest[-1], part[deepest[-1]], distance[deepest[-1]]
    return begin, share, far


def _best(cuts: Sequence[MeasuredCut]) -> MeasuredCut:
    """Return for each point the cut that leaves least of it; of equal ones the last."""
    excess = np.array([np.where(np.isfinite(one.excess_mm), one.excess_mm, np.inf) for one in cuts])
    least = excess.min(axis=0)
    which = len(cuts) - 1 - (excess[::-1] <= least + SAME_MM).argmax(axis=0)
    rows = np.arange(excess.shape[1])
    return MeasuredCut(
        *(np.stack([getattr(one, name) for one in cuts])[which, rows] for name in MeasuredCut.__dataclass_fields__)
    )


def _joined(cuts: Sequence[MeasuredCut]) -> MeasuredCut:
    return MeasuredCut(
        *(np.concatenate([getattr(one, name) for one in cuts]) for name in MeasuredCut.__dataclass_fields__)
    )


def by_tool(tool: ToolShape, normal: np.ndarray, axis: np.ndarray, engagement_mm: np.ndarray) -> np.ndarray:
    """Return (m, 3) the change of a surface along its normal by the tool's radius, its length, and its deflection (`BY_TOOL_COLUMNS`).

    A larger radius removes more beside the axis, a larger one of a ball more the farther from its pole; a longer tool removes more
    along its axis. The cutting force, proportional to the engagement, pushes the tool away from the surface across its axis.
    """
    along = (normal * axis).sum(axis=1)
    across_share = np.sqrt(np.maximum(1.0 - along**2, 0.0))
    ball = abs(tool.corner_radius - tool.radius) < 1e-9
    radius = along - 1.0 if ball else -across_share
    return np.column_stack([radius, -along, np.nan_to_num(engagement_mm) * across_share**2])


def _table(
    machine: Machine,
    table: MeasuredTable,
    points: Sequence[MeasuredPoint],
    off_um: np.ndarray,
    cut: MeasuredCut,
    *,
    timed: bool,
) -> Measurements:
    """Return the measurement table; the station's frame is the work frame, moved with the part."""
    n = len(points)

    def words(values: object) -> np.ndarray:
        return read_only(np.array(values if isinstance(values, list) else [values] * n, dtype=object))

    names: dict[str, int] = {}
    target = []
    for point in points:
        names[point.feature] = names.get(point.feature, 0) + 1
        target.append(f"{point.feature} {names[point.feature]}")
    u = np.full((n, 3), np.nan)
    u[:, 0] = [point.u_mm for point in points]
    reading = np.full((n, 3), np.nan)
    reading[:, 0] = (cut.normal * cut.contact_mm).sum(axis=1) + off_um * 1e-3
    data = Measurements(
        source=str(table.path),
        lines=read_only(np.array([point.line for point in points])),
        positions=read_only(cut.positions),
        target=words(target),
        carrier=words("tool"),
        station=words(STATION),
        station_carrier=words("work"),
        instrument=words(CMM.instrument),
        point_mm=read_only(reading),
        u_mm=read_only(u),
        by_tool=read_only(cut.by_tool),
        time_s=read_only(cut.side[:, -1]) if timed else read_only(np.full(n, np.nan)),
        approach=read_only(cut.side[:, :-1]),
        along=read_only(cut.normal),
        tool=words([f"T{name}" for name in cut.tool]),
        simulated=table.simulated,
    )
    carried = nominal_carriers(machine, data)
    place = np.einsum("nji,nj->ni", carried.rotation, cut.contact_mm - carried.points / MM)
    return replace(data, place_mm=read_only(place))


def _notes(points: Sequence[MeasuredPoint], cut: MeasuredCut, *, timed: bool) -> list[str]:
    """Return for each feature how many readings it gives, by which tool and lines; and what is known of times and uncertainties."""
    notes = []
    names = np.array([point.feature for point in points])
    for name in dict.fromkeys(names):
        own = names == name
        tools = ", ".join(dict.fromkeys(map(str, cut.tool[own])))
        notes.append(
            f"{name}: {count_with_noun(int(own.sum()), 'reading')}, tool {tools}, lines {cut.line[own].min()} to "
            f"{cut.line[own].max()}; the program itself is off by up to {np.abs(cut.excess_mm[own]).max() * 1e3:.1f} µm, which is "
            "taken off"
        )
    if not timed:
        notes.append("no times: a feed is missing, or counts time; what grows with time cannot be found")
    else:
        notes.append("times follow from path and feed, without accelerations, tool changes and waiting")
    if not np.isfinite([point.u_mm for point in points]).all():
        notes.append(
            "uncertainties that the table does not give are those of the instrument cmm (1.8 µm + L/300, k = 2)"
        )
    return notes


def _check_fixed(data: Measurements, part: PartDrawing, points: Sequence[MeasuredPoint], cut: MeasuredCut) -> list[str]:
    """Return a note on the motions of the part that its points do not fix; `InputError` if they show nothing but the set-up."""
    arm = (cut.contact_mm - cut.contact_mm.mean(axis=0)) / 100.0
    motions = np.hstack([cut.normal, np.cross(arm, cut.normal)])
    values = np.linalg.svd(motions, compute_uv=False)
    fixed = int(np.count_nonzero(values > RANK * values[0]))
    sizes = [cut.by_tool[cut.tool == name] for name in np.unique(cut.tool)]
    tools = int(sum(np.any(own != 0.0, axis=0).sum() for own in sizes))
    if len(data) <= fixed + tools:
        raise InputError(
            f"{count_with_noun(len(data), 'reading')} for {fixed} motions of the part and {tools} sizes of tools: "
            "they show nothing of the machine",
            expected="more points, on surfaces in several directions",
            file=data.source,
            line=points[-1].line,
        )
    if fixed == MOTIONS:
        return []
    return [
        f"the points fix {fixed} of the part's six motions: errors of the machine that act like the others do not show"
    ]


RANK: Final = 1e-6
MOTIONS: Final = 6
