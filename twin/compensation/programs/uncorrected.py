"""Find the blocks that a compensation could not correct, or not within the tolerance.

A smooth function of axis positions along many short blocks is evaluated at a few nodes, first far apart. Where the axes between two
nodes leave the straight line, or the function is not linear within `ACCURACY`, the interval is halved, down to single blocks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final, Literal, NamedTuple, final

import numpy as np

from twin._common.arrays import distinct
from twin._common.messages import Message, joined
from twin._common.units import count_with_noun
from twin.compensation.programs.backlash import ApproachTracker
from twin.compensation.programs.comparison import Commands
from twin.compensation.programs.correction import Corrected
from twin.compensation.programs.follow import Section
from twin.compensation.programs.motions import INCREMENTS, LostBlock, by_reason, numbers_of_increments
from twin.compensation.programs.path_errors import Samples, rows_of
from twin.compensation.programs.pieces import Rows, Ways
from twin.compensation.programs.prepared import PreparedMachine
from twin.display import readable
from twin.tool.inverse import SLACK

LINES_SHOWN: Final = 8
"""Line numbers printed before the rest is counted; the JSON report has all."""

Kind = Literal["range", "orientation", "tolerance", "unknown"]


@final
@dataclass(frozen=True)
class Shortfall:
    """Blocks that could not be corrected, or not within the tolerance, for one reason."""

    # ``range``: an axis would leave its range; ``orientation``, ``tolerance``: the tool axis or the point keeps an error;
    # ``unknown``: nothing is known of where the block goes
    kind: Kind
    reason: str  # why they were not corrected
    lines: tuple[int, ...]  # line numbers of all of them in the input
    # line numbers that affect the exit status: the point of a cutting block is out of tolerance, or an orientation that was requested
    # is not reached
    missed: tuple[int, ...]
    worst_line: int  # line of the worst case
    worst: float  # its size, in ``unit``
    unit: str  # ``um`` or ``urad`` at the tool; ``mm`` or ``deg`` beyond an axis's range; empty if the size is unknown

    @property
    def text(self) -> str:
        """Summary in one line."""
        blocks = f"{count_with_noun(len(self.lines), 'block')} ({line_numbers(self.lines)})"
        if not self.unit:
            return f"{blocks}: {self.reason}"
        size = f"{self.worst:{'.2f' if self.unit in ('um', 'urad') else '.4g'}} {readable(self.unit)}"
        return f"{blocks}: {self.reason}; worst {size} (line {self.worst_line})"

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON report."""
        return {
            "kind": self.kind,
            "reason": self.reason,
            "blocks": len(self.lines),
            "lines": list(self.lines),
            "missed": list(self.missed),
            "worst": {"value": self.worst if self.unit else None, "unit": self.unit, "line": self.worst_line},
        }


class FoundShortfalls(NamedTuple):
    """Blocks found that could not be corrected, for one reason."""

    kind: Kind  # kind, reason, unit: as in `Shortfall`
    reason: str
    unit: str
    lines: np.ndarray  # (n,) line numbers
    sizes: np.ndarray  # (n,) remaining error of each, in ``unit``
    missed: np.ndarray  # (n,) whether it affects the exit status


@final
class ShortfallTally:
    """Collects shortfalls by reason, stretch by stretch."""

    def __init__(self) -> None:
        self._found: dict[tuple[Kind, str, str], list[tuple[np.ndarray, np.ndarray]]] = {}
        self._worst: dict[tuple[Kind, str, str], tuple[float, int]] = {}

    def add(self, found: FoundShortfalls) -> None:
        """Add the blocks found for one reason."""
        if not found.lines.size:
            return
        key = found.kind, found.reason, found.unit
        self._found.setdefault(key, []).append((found.lines, found.lines[found.missed]))
        at = int(np.argmax(found.sizes))
        if key not in self._worst or found.sizes[at] > self._worst[key][0]:
            self._worst[key] = float(found.sizes[at]), int(found.lines[at])

    def shortfalls(self) -> tuple[Shortfall, ...]:
        """Return all of them, the reason with the most blocks first."""
        collected = []
        for (kind, reason, unit), parts in self._found.items():
            lines, missed = (tuple(np.unique(np.concatenate(part)).tolist()) for part in zip(*parts, strict=True))
            worst, worst_line = self._worst[kind, reason, unit]
            collected.append(Shortfall(kind, reason, lines, missed, worst_line, worst, unit))
        return tuple(sorted(collected, key=lambda shortfall: -len(shortfall.lines)))


def line_numbers(lines: Sequence[int]) -> Message:
    """Return line numbers as text: ``line 3``; ``lines 3, 5, 7 … and 1,810 more``."""
    if len(lines) == 1:
        return Message("line {line}", line=str(lines[0]))
    more = Message(" … and {count:,} more", count=len(lines) - LINES_SHOWN) if len(lines) > LINES_SHOWN else ""
    return Message("lines {lines}{more}", lines=", ".join(map(str, lines[:LINES_SHOWN])), more=more)


# --- Work offsets and tools that a program uses, as the report lists them -------------------------


@final
@dataclass(frozen=True)
class FrameUse:
    """Work offset and tool from a line on."""

    line: int
    offset: str  # name of the work offset; empty if there is no table of them
    assumed: bool  # whether the program has not selected it
    tool: str  # number or name of the tool; empty if the program has called none
    tool_length_mm: float
    # what is added to the words of each axis, mm and degrees; the tool length is included where the control adds it
    work_offset: Mapping[str, float]
    work_origin_mm: tuple[float, float, float]  # the program's zero in the work frame, for tool-tip coordinates
    tilted_deg: Mapping[str, float]  # positions of the rotary axes in a tilted plane; empty if there is none
    # by which the program shifts its coordinates, by axis, mm and degrees; outside a plane it is part of ``work_offset``
    shift: Mapping[str, float]
    turned: bool  # whether it turns them

    @property
    def sentence(self) -> str:
        """Statement in the report."""
        length = self.tool_length_mm
        tool = (
            Message("tool {name}, {length:g} mm", name=self.tool, length=length)
            if self.tool
            else Message("tool of {length:g} mm", length=length)
        )
        assumed = Message(" (assumed: none selected yet)") if self.assumed else ""
        name = Message("{name}{assumed}", name=self.offset, assumed=assumed) if self.offset else Message("work offset")
        added = " ".join(f"{axis} {value:.6g}" for axis, value in self.work_offset.items())
        at = " ".join(f"{axis} {value:.6g}°" for axis, value in self.tilted_deg.items())
        tilted = (
            Message("; tilted plane, rotary axes as the control positions them ({at}), not corrected", at=at)
            if at
            else ""
        )
        by = " ".join(f"{axis} {value:.6g}" for axis, value in self.shift.items() if value)
        shifted = Message("; shifted by the program: {by}", by=by) if by else ""
        turned = Message("; turned by the program") if self.turned else ""
        return Message(
            "from line {line}: {tool}; {name} with tool length: {added}{more}",
            line=self.line,
            tool=tool,
            name=name,
            added=added or Message("none"),
            more=joined("", [tilted, shifted, turned]),
        )


def frame_uses(sections: Sequence[Section], number_of: Callable[[int], int]) -> tuple[FrameUse, ...]:
    """Return the work offsets and tools of a program's sections; ``number_of``: number of a line by its 0-based index."""
    return tuple(
        FrameUse(
            number_of(section.line),
            section.frame.offset or section.assumed_offset,
            not section.frame.offset,
            section.frame.length or section.frame.tool,
            section.space.nominal.tool_length_mm,
            section.space.setup.work_offset,
            section.space.setup.work_origin_mm,
            {}
            if section.space.tilt is None or section.frame.inclined
            else dict(zip(section.space.axes.rotary, section.space.tilt.rotary_deg.tolist(), strict=True)),
            dict(zip(section.space.axes.names, section.frame.shift, strict=False)),
            section.frame.turn is not None or section.frame.inclined,
        )
        for section in sections
    )


# --- Interpolation of a smooth function of axis positions along a path of many short blocks -------

EVALUATED_POINTS: Final = 2048
"""Up to this number of points the function is evaluated at each."""
FIRST_INTERVAL: Final = 256
"""Points per interval at the start."""
ACCURACY: Final = 0.01
"""Largest deviation from linearity in the middle of an interval, relative to the largest value of its group. The middle then becomes
a node, which reduces the remaining error to a quarter.
"""


def interpolated(values: Callable[[np.ndarray], np.ndarray], places: np.ndarray, straight: np.ndarray) -> np.ndarray:
    """Return (n, groups, m) values along a path (n, axes), evaluated at some points and interpolated linearly between them.

    ``values``: function of (k,) distinct indices; the values of a group have one unit. ``straight``: (axes,) deviation from the
    straight line between two points up to which the path counts as straight.
    """
    count = len(places)
    if count <= EVALUATED_POINTS:
        return values(np.arange(count))
    nodes = np.append(np.arange(0, count - 1, FIRST_INTERVAL), count - 1)
    at_nodes = values(nodes)
    interpolated = np.empty((count, *at_nodes.shape[1:]))
    interpolated[nodes] = at_nodes
    scaled = places / straight
    way = np.cumsum(np.abs(np.diff(scaled, axis=0, prepend=scaled[:1])).max(axis=1))
    begin, end = nodes[:-1], nodes[1:]
    while True:
        several = end - begin > 1
        begin, end = begin[several], end[several]
        if not begin.size:
            return interpolated
        middle = (begin + end) // 2
        interpolated[middle] = values(middle)
        guess = _on_line(interpolated, way, middle, begin, end)
        allowed = ACCURACY * np.abs(interpolated[middle]).max(axis=2, keepdims=True)
        good = _straight(scaled, way, begin, end) & (np.abs(guess - interpolated[middle]) <= allowed).all(axis=(1, 2))
        for first, last in ((begin[good], middle[good]), (middle[good], end[good])):
            of, between = _between(first, last)
            interpolated[between] = _on_line(interpolated, way, between, first[of], last[of])
        begin, end = (
            np.concatenate([begin[~good], middle[~good]]),
            np.concatenate([middle[~good], end[~good]]),
        )


def _between(begin: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return all points inside intervals: the interval each is in, and its index."""
    inside = end - begin - 1
    of = np.repeat(np.arange(len(begin)), inside)
    return of, np.arange(len(of)) + np.repeat(begin + 1 - np.cumsum(inside) + inside, inside)


def _on_line(values: np.ndarray, way: np.ndarray, at: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return values at points, interpolated linearly between two others by the distance travelled."""
    length = way[end] - way[begin]
    share = (way[at] - way[begin]) / np.where(length > 0.0, length, 1.0)
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(values[begin] + share * (values[end] - values[begin]))


def _straight(scaled: np.ndarray, way: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return (intervals,) whether all points inside (at least one) lie within one unit of the line between the end points."""
    of, between = _between(begin, end)
    off = np.abs(_on_line(scaled, way, between, begin[of], end[of]) - scaled[between]).max(axis=1)
    return np.maximum.reduceat(off, np.searchsorted(of, np.arange(len(begin)))) <= 1.0


# --- Sample of a program's poses, spread evenly over a program whose length is not known in advance

CLASS_POSES: Final = 5000
"""Poses at which the shares of the classes are evaluated: enough for a share. Totals are taken over all poses."""
LEAST_SHARE: Final = 1e-9
"""Smallest share of the blocks. If a single block has more than `CLASS_POSES` poses, all of them are kept."""
GOLDEN_RATIO: Final = (5.0**0.5 - 1.0) / 2.0
"""A block is in a sample of share s if the fractional part of its number times this is below s. Such a sample is spread as evenly as
possible and is not in step with anything a program repeats (H. Weyl, Math. Ann. 77, 1916; V. Sós, 1958).
"""


class SimulatedPoints(NamedTuple):
    """Simulated points of a program, on straight lines."""

    motion: np.ndarray  # (lines,) motion each line is on
    nominal: Commands  # nominal, written: nominal commands and written commands
    written: Commands
    # nominal_sides, written_sides: (lines, axes + channels) approach directions and conditions at these commands; None if the machine
    # does not depend on them
    nominal_sides: np.ndarray | None = None
    written_sides: np.ndarray | None = None

    def of(self, lines: np.ndarray) -> SimulatedPoints:
        """Return the points of some lines, given in ascending order, each as a line of its own."""
        if self.nominal.points is None and self.written.points is None and len(lines) == len(self.motion):
            return self  # all of them, single points already
        number = np.repeat(lines, self.nominal.counts[lines])
        nominal, written = (Commands(one.of(lines).as_array()) for one in (self.nominal, self.written))
        before, after = (None if one is None else one[number] for one in (self.nominal_sides, self.written_sides))
        return SimulatedPoints(self.motion[number], nominal, written, before, after)


@final
class Sample:
    """Poses of an evenly spread share of the blocks; the share is halved whenever there are more than `CLASS_POSES`."""

    def __init__(self) -> None:
        self._share = 1.0
        self._parts: list[tuple[np.ndarray, ...]] = []

    def add(self, first: int, points: SimulatedPoints, known: Callable[[SimulatedPoints], np.ndarray]) -> None:
        """Add those points that belong to the sample; ``first``: number of the first motion within the program."""
        # By motion, of which every one has many points.
        turns = (first + np.arange(points.motion.max(initial=-1) + 1)) * GOLDEN_RATIO
        place = turns - np.floor(turns)
        of_line, counts = place[points.motion], points.nominal.counts
        share = self._share
        while share > LEAST_SHARE and counts[of_line < share / 2.0].sum() > CLASS_POSES:
            share /= 2.0  # will be the share afterwards, if enough of these points are known
        for trial in (share, self._share):
            some = points.of(np.flatnonzero(of_line < trial))
            keep = known(some)
            if trial == self._share or np.count_nonzero(keep) > CLASS_POSES:
                break
        poses = []
        for commands, sides in ((some.nominal, some.nominal_sides), (some.written, some.written_sides)):
            written = commands.as_array()[keep]
            poses += [written, np.zeros(written.shape) if sides is None else sides[keep]]
        self._parts.append((place[some.motion[keep]], *poses))
        self._thin()

    def _thin(self) -> None:
        """Halve the share as often as necessary, and keep the poses that belong to it."""
        share, places = self._share, np.concatenate([part[0] for part in self._parts])
        while np.count_nonzero(places < share) > CLASS_POSES and share > LEAST_SHARE and np.any(places < share / 2.0):
            share /= 2.0
        self._share = share
        for i, part in enumerate(self._parts):
            keep = np.flatnonzero(part[0] < share)
            if len(keep) < len(part[0]):
                self._parts[i] = tuple(array.take(keep, axis=0) for array in part)

    def poses(self) -> tuple[np.ndarray, ...]:
        """Return four (n, axes) arrays: nominal commands, their approach directions, written commands, their approach directions."""
        return tuple(np.concatenate(arrays) for arrays in list(zip(*self._parts, strict=True))[1:])


# --- Find the blocks that a compensation could not correct, or not within the tolerance -----------

UNSOLVED_UM: Final = 0.01
"""Largest residual (µm) accepted as a solution; the solver usually leaves a thousandth of it."""


def uncorrected(corrected: Corrected, residual_um: Mapping[str, np.ndarray]) -> Iterator[FoundShortfalls]:
    """Yield the blocks of a stretch that could not be corrected, by reason.

    ``residual_um``: by cause (``rounding``, ``solver``), (rows,) distance of the tool point from its target at the end points of its
    own.
    """
    yield from _beyond_range(corrected, residual_um["rounding"])
    yield from _off_in_orientation(corrected)
    if corrected.pieces.prepared.thesis is None:
        yield from _not_solved(corrected, residual_um["solver"])
        yield from _off_between(corrected)
        yield from _beginning_off(corrected)


def of_unknown(moves: Sequence[LostBlock]) -> Iterator[FoundShortfalls]:
    """Yield blocks that go to unknown places, by reason; the lines of ``moves`` are numbers from 0."""
    for reason, group in by_reason(moves).items():
        lines, cutting = np.array([(move.line + 1, move.cutting) for move in group]).T
        yield FoundShortfalls("unknown", f"{reason}: left as written", "", lines, np.zeros(len(lines)), cutting > 0)


def hinted(shortfall: Shortfall, text_of: Callable[[int], str]) -> Shortfall:
    """Return blocks outside the range of an axis with a hint if a number of the worst one may count increments."""
    if shortfall.kind != "range" or shortfall.unit not in ("mm", "deg"):
        return shortfall
    if not any(number >= shortfall.worst for _, number in numbers_of_increments(text_of(shortfall.worst_line))):
        return shortfall
    return replace(shortfall, reason=f"{shortfall.reason}; {INCREMENTS}")


def _allowed_um(prepared: PreparedMachine) -> float:
    """Return the tolerance plus the error of rounding to the least increment, µm."""
    return 1e3 * (prepared.options.tolerance_mm + 0.5 * float(np.linalg.norm(prepared.increment[:3])))


def _cutting(corrected: Corrected) -> np.ndarray:
    return ~corrected.pieces.path.columns.rapid


def _beyond_range(corrected: Corrected, off_um: np.ndarray) -> Iterator[FoundShortfalls]:
    """Yield blocks whose commands leave the range of an axis; ``off_um``: (rows,) distance of the tool point from its target."""
    prepared, rows = corrected.pieces.prepared, corrected.own
    machine = prepared.machine
    ranges = machine.limits / machine.scale[:, None]
    for mask, requested, limits in (
        (rows.untouched, rows.nominal, ranges),
        (rows.clamped & ~rows.as_programmed, rows.exact, prepared.limits),
    ):
        at = np.flatnonzero(mask)
        if not at.size:
            continue
        beyond = np.maximum(limits[:, 0] - requested[at], requested[at] - limits[:, 1])
        beyond = np.where(beyond > SLACK, beyond, 0.0)
        for axes in np.unique(beyond > 0.0, axis=0):
            which = np.flatnonzero(((beyond > 0.0) == axes).all(axis=1))
            names = " ".join(axis.name for axis, out in zip(machine.axes, axes, strict=True) if out)
            motion = rows.motion[at[which]]
            lines, cuts = corrected.lines[motion], _cutting(corrected)[motion]
            if limits is prepared.limits:
                off = off_um[at[which]]
                reason = f"the compensated position is beyond the range of {names or 'an axis'}: stopped at the limit"
                yield FoundShortfalls("range", reason, "um", lines, off, cuts & (off > _allowed_um(prepared)))
            else:
                what = f"outside the range of {names}" if names else "outside the range of an axis between end points"
                unit = machine.axes[int(np.argmax(axes))].unit
                yield FoundShortfalls("range", f"{what}: left as written", unit, lines, beyond[which].max(axis=1), cuts)
    at = np.flatnonzero(rows.as_programmed)
    motion, off = rows.motion[at], off_um[at]
    reason = (
        "no position within the ranges of the axes is nearer to the point than the programmed one: left as programmed"
    )
    cuts = _cutting(corrected)[motion] & (off > _allowed_um(prepared))
    yield FoundShortfalls("range", reason, "um", corrected.lines[motion], off, cuts)


def _off_in_orientation(corrected: Corrected) -> Iterator[FoundShortfalls]:
    rows, scope = corrected.own, corrected.pieces.aim.scope
    at = np.flatnonzero(rows.singular & ~rows.untouched)
    why = _why_not(corrected.pieces.prepared, rows.commands[at])
    why[rows.relaxed[at]] = "a linear axis is at its limit, and the point would be farther off"
    for reason in dict.fromkeys(why.tolist()):
        which = at[why == reason]
        motion = rows.motion[which]
        missed = _cutting(corrected)[motion] & (scope.explicit and scope.orientation)
        reason = f"orientation not corrected: {reason}"
        yield FoundShortfalls(
            "orientation", reason, "urad", corrected.lines[motion], rows.orientation_residual_rad[which] * 1e6, missed
        )


def _why_not(prepared: PreparedMachine, commands: np.ndarray) -> np.ndarray:
    """Return (n,) why the rotary axes cannot correct the orientation at (n, axes) commands."""
    turn = prepared.options.rotary_limit_deg
    default = f"near a singular pose, a rotary axis would have to turn by more than {turn:g}°"
    why_not = np.full(len(commands), default, dtype=object)
    limits = [(i, limit) for i in prepared.machine.rotary for limit in prepared.limits[i].tolist()]
    for i, limit in limits[::-1]:
        axis = prepared.machine.axes[i]
        why_not[np.abs(commands[:, i] - limit) < axis.increment] = f"{axis.name} is at its limit of {limit:g}°"
    return why_not


def _not_solved(corrected: Corrected, off_um: np.ndarray) -> Iterator[FoundShortfalls]:
    """Yield blocks for which no axis positions were found that reach the point; ``off_um``: (rows,) remaining distance, µm."""
    rows = corrected.own
    at = np.flatnonzero(~rows.untouched & ~rows.clamped & ~(off_um <= UNSOLVED_UM))
    motion, size = rows.motion[at], np.nan_to_num(off_um[at], nan=np.inf)
    reason = "no axis positions found that reach the point"
    yield FoundShortfalls("tolerance", reason, "um", corrected.lines[motion], size, _cutting(corrected)[motion])


def _off_between(corrected: Corrected) -> Iterator[FoundShortfalls]:
    """Yield blocks whose error between end points exceeds the tolerance."""
    pieces, rows = corrected.pieces, corrected.rows
    error_um, count = corrected.path_errors.motion_errors_mm(rows) * 1e3, pieces.count(rows)
    error_um[rows.motion[rows.as_programmed | rows.untouched]] = 0.0
    error_um[: corrected.context] = 0.0
    over = np.flatnonzero(error_um > 1e3 * pieces.prepared.options.tolerance_mm)
    for pieces_each in distinct(count[over]):
        which = over[count[over] == pieces_each]
        reason = f"error between end points above the tolerance, with {pieces_each} pieces per block"
        yield FoundShortfalls(
            "tolerance", reason, "um", corrected.lines[which], error_um[which], np.full(len(which), True)
        )


def _beginning_off(corrected: Corrected) -> Iterator[FoundShortfalls]:
    """Yield blocks that begin at a position left uncorrected."""
    begins = np.flatnonzero(corrected.path_errors.starts_uncorrected(corrected.rows))
    begins = begins[begins >= corrected.context]
    if begins.size:
        off = corrected.path_errors.motion_errors_as_run_mm(begins, corrected.rows) * 1e3
        which = off > _allowed_um(corrected.pieces.prepared)
        reason = "begins at an uncorrected position"
        yield FoundShortfalls(
            "tolerance", reason, "um", corrected.lines[begins[which]], off[which], np.full(which.sum(), True)
        )


# --- Simulated points of a program on a machine with backlash: in order of travel, because approach directions depend on it

Both = tuple[Commands, Commands]
"""Nominal and written commands."""


def directed_points(
    corrected: Corrected, prepared: PreparedMachine, ends: Both, portions: Sequence[np.ndarray], ways: Ways
) -> Iterator[SimulatedPoints]:
    """Yield the end points of pieces and the dense points inside them, each a line of its own, portion by portion."""
    rows, context = corrected.own, len(corrected.rows.leg) - len(corrected.own.leg)
    trackers = [ApproachTracker(prepared.backlash, corrected.pieces.path) for _ in ends]
    begins = [0, *(int(np.searchsorted(rows.leg, portion[0])) for portion in portions[1:]), len(rows.leg)]
    for place, (first, last) in enumerate(pairwise(begins)):
        samples = corrected.path_errors.samples(portions[place] if portions else np.zeros(0, dtype=int))
        row = rows_of(samples, ways) - context - first
        inside = corrected.path_errors.commands(samples, ways)
        inside = (inside[0], inside[0]) if corrected.pieces.idle else inside
        begun = (Commands(ends[0].begin[first:last]), Commands(ends[1].begin[first:last]))
        yield from _portion(corrected, rows.where(slice(first, last)), trackers, begun, samples, inside, row)


def _portion(
    corrected: Corrected,
    rows: Rows,
    trackers: Sequence[ApproachTracker],
    ends: Both,
    samples: Samples,
    inside: Both,
    row: np.ndarray,
) -> Iterator[SimulatedPoints]:
    """Yield the end points and the dense points of one portion; ``row``: (pieces,) end point of each piece."""
    pieces, line = corrected.pieces, samples.piece
    motion = pieces.legs.motion[samples.leg][line]
    before = np.zeros(len(rows.leg), dtype=int)
    before[row] = samples.points
    at_end = np.arange(len(before)) + np.cumsum(before)
    within = np.ones(len(before) + before.sum(), dtype=bool)
    within[at_end] = False
    of = np.repeat(rows.motion, before + 1)
    fraction = corrected.path_errors.fractions(samples) if pieces.conditions.names else np.zeros(len(line))
    nominal, written = (
        commands if commands.points is None else commands.split(line, samples.within) for commands in inside
    )
    at_ends, on_lines = [], []
    for tracker, end, commands in zip(trackers, ends, (nominal, written), strict=True):
        places = np.empty((len(of), end.begin.shape[1]))
        places[at_end], places[within] = end.begin, commands.begin
        sides = tracker.after(of, places)
        at_ends.append(pieces.conditions.at(sides[at_end], rows.motion, rows.fraction))
        on_lines.append(pieces.conditions.at(sides[within], motion, fraction))
    # A move that only takes up backlash has no nominal position.
    yield SimulatedPoints(rows.motion, *ends, *at_ends).of(np.flatnonzero(~rows.backlash_move))
    yield SimulatedPoints(motion, nominal, written, *on_lines)
