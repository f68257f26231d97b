"""A program, or a stretch of it, cut into pieces, with the commands for their end points.

For each end point: nominal pose → commands that reach it → rotary words rounded to the least increment → linear axes solved again for
the rounded rotary axes → linear words rounded.

Where a limit stops an axis, the position nearest to the point is taken: with the corrected tool axis, else with the rotary axes as
programmed, else the programmed position itself.

Within a leg no axis with backlash reverses; legs are then cut into pieces. A straight motion of axis words is one leg. On an arc, and
in tool-tip coordinates while the tool turns, an axis can reverse inside the block.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import Final, NamedTuple, final

import numpy as np

from twin._common.arrays import all_within, distinct, rows_all_true
from twin._common.errors import InputError
from twin.compensation.programs.block_conditions import CONSTANT, BlockConditions
from twin.compensation.programs.comparison import Commands
from twin.compensation.programs.motions import PathMotion, ToolPath
from twin.compensation.programs.prepared import CorrectionAim, PreparedMachine
from twin.model.calibration import Calibration
from twin.nc.dialect import Dialect
from twin.tool.forward import Poses, angle_between_rad
from twin.tool.inverse import SLACK, Status

PRINTED_ALIKE: Final = 1e-9
"""Words closer than this are printed alike."""


@final
@dataclass(frozen=True)
class Rows:
    """n end points of pieces, in the order of the program."""

    leg: np.ndarray  # leg, motion: (n,) leg and motion of each end point
    motion: np.ndarray
    # (n,) whether the row is an inserted move that only takes up backlash, at its fraction of the motion
    backlash_move: np.ndarray
    approach: np.ndarray  # (n, axes) approach directions for which it is solved
    reverses: np.ndarray  # (n, axes) whether each axis reverses before it
    overshoot: np.ndarray  # (n, axes) intentional overshoot, mm and degrees
    fraction: np.ndarray  # (n,) fraction of its motion
    words: np.ndarray  # words, nominal: (n, axes) nominal words and commands
    nominal: np.ndarray
    target_mm: np.ndarray  # target_mm, target_rotation: (n, 3) and (n, 3, 3) nominal pose
    target_rotation: np.ndarray
    exact: np.ndarray  # (n, axes) compensated commands before linear words were rounded
    commands: np.ndarray  # commands, printed: (n, axes) compensated commands as printed, and the printed words
    printed: np.ndarray
    vectors: np.ndarray  # (n, 3) printed tool vectors; NaN where there is none
    orientation_residual_rad: np.ndarray  # (n,) orientation residual in radians that the rotary axes do not correct
    singular: np.ndarray  # (n,) whether that residual exceeds the solver's numerical noise
    clamped: np.ndarray  # (n,) whether an axis stops at its limit
    # (n,) whether the rotary axes stay as programmed, because with the corrected tool axis the point would be farther off
    relaxed: np.ndarray
    # (n,) whether all axes stay as programmed, because no other position is nearer; such a row is also clamped
    as_programmed: np.ndarray
    untouched: np.ndarray  # (n,) whether it is left as written because it is out of range

    @property
    def target(self) -> Poses:
        """Nominal poses."""
        return Poses(self.target_mm, self.target_rotation)

    def where(self, keep: np.ndarray | slice) -> Rows:
        """Return a selection of the rows: (n,) booleans or a slice."""
        return _of_each(lambda column: column[keep], self)

    def put(self, which: np.ndarray, new: Rows) -> Rows:
        """Return the rows with some of them, (n,) booleans, replaced."""

        def put(mine: np.ndarray, others: np.ndarray) -> np.ndarray:
            found = np.array(mine)
            found[which] = others
            return found

        return _of_each(put, self, new)

    def replaced(self, legs: np.ndarray, new: Rows) -> Rows:
        """Return the rows with those of some legs replaced, still in order."""
        kept = np.flatnonzero(~np.isin(self.leg, legs))
        if not kept.size:
            return new
        order = np.argsort(np.concatenate([self.leg[kept], new.leg]), kind="stable")
        place = np.flatnonzero(order >= len(kept))
        source = kept.take(order, mode="clip")

        def merged(mine: np.ndarray, others: np.ndarray) -> np.ndarray:
            found = mine.take(source, axis=0)
            found[place] = others[order[place] - len(kept)]
            return found

        return _of_each(merged, self, new)

    def distinct(self) -> Rows:
        """Return the rows without inserted moves that, as printed, equal the position before or after."""
        rows = self
        for behind in (False, True):
            vectors = np.nan_to_num(rows.vectors)
            alike = (np.abs(np.diff(rows.printed, axis=0)) < PRINTED_ALIKE).all(axis=1) & ~np.diff(vectors, axis=0).any(
                axis=1
            )
            omitted = rows.backlash_move & (np.append(alike, False) if behind else np.append(False, alike))
            rows = rows.where(~omitted) if np.any(omitted) else rows
        return rows


def _of_each(make: Callable[..., np.ndarray], *rows: Rows) -> Rows:
    return Rows(**{field.name: make(*(getattr(row, field.name) for row in rows)) for field in fields(Rows)})


class Ways(NamedTuple):
    """Start and displacement of pieces."""

    begin: np.ndarray  # (rows, axes) words at the start of each piece
    way: np.ndarray  # (rows, axes) displacement
    rows: np.ndarray  # (pieces,) rows that are end points of pieces
    first: np.ndarray  # (legs,) index in ``rows`` of each leg's first piece


def taken(values: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return some rows of an array; the array itself if these are all of them, in order."""
    n = len(values)
    if len(rows) == n and (n == 0 or (rows[0] == 0 and rows[-1] == n - 1 and bool(np.all(rows[1:] > rows[:-1])))):
        return values
    return values.take(rows, axis=0)


def repeat_with_index(things: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Repeat each of (n,) items by its count, and number the repetitions 0, 1, 2 … within each."""
    return np.repeat(things, count), np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)


def even_cuts(sizes: np.ndarray, most: float) -> list[int]:
    """Return where to cut items of (n,) sizes into the fewest portions of about equal size, none much larger than ``most``."""
    total = np.cumsum(sizes)
    count = int(np.ceil(total[-1] / most)) if len(total) else 0
    if count <= 1:
        return []
    return distinct(np.searchsorted(total, total[-1] * np.arange(1, count) / count))


# --- Check that a program stays in one mode, if the control holds kinematics that act in tool centre point mode only


def check_one_mode(calibration: Calibration, modes: np.ndarray, source: str, *, tcp: bool) -> None:
    """Raise `InputError` if the control holds kinematics and a program is not wholly in one mode: ``tcp``, that from the start."""
    control = calibration.control
    if control is not None and control.kinematics and np.any(modes != tcp):
        raise InputError(
            "the kinematics of the control act in tool centre point mode only, and this program has motions in both modes, or in the "
            "other mode",
            expected="all motions in the mode that is chosen; split a program that switches the transformation between motions",
            file=source,
            setting="mode",
            value="tcp" if tcp else "axis",
        )


# --- Legs: parts of motions within which no axis with backlash reverses; legs are then cut into pieces

STEP_DEG: Final = 2.0
"""Step of the search for reversals on an arc or a turn of the tool, degrees."""
HALF_INTERVAL: Final = 1e-4
"""Half the interval for numerical velocities, as a fraction of the motion."""
AT_REST: Final = 1e-8
"""Displacement (mm, degrees) over that interval below which an axis stands still; the solver's numerical noise is smaller."""
HALVINGS: Final = 24
"""Bisection steps: 2 degrees become 1e-7 of a degree."""


@final
@dataclass
class Legs:
    """Parts of motions, in order."""

    motion: np.ndarray  # (legs,) motion of each leg
    begin: np.ndarray  # begin, end: (legs,) fractions of that motion
    end: np.ndarray
    count: np.ndarray  # (legs,) number of pieces; 0 for a leg merged into another

    @classmethod
    def of(cls, motions: int, turning: tuple[np.ndarray, np.ndarray]) -> Legs:
        """Create the legs of ``motions`` motions, cut at the points ``turning``: (k,) motions and (k,) fractions."""
        motion = np.concatenate([np.arange(motions), turning[0]])
        begin = np.concatenate([np.zeros(motions), turning[1]])
        order = np.lexsort((begin, motion))
        motion, begin = motion[order], begin[order]
        last = np.append(motion[1:] != motion[:-1], True)
        end = np.where(last, 1.0, np.append(begin[1:], 1.0))
        return cls(motion, begin, end, np.ones(len(motion), dtype=int))

    def merge(self, motions: np.ndarray) -> None:
        """Merge the legs of some motions into one leg in one piece."""
        mine = np.isin(self.motion, motions)
        last = mine & (self.end == 1.0)
        self.begin[last], self.count[mine], self.count[last] = 0.0, 0, 1

    def whole(self, legs: np.ndarray) -> bool:
        """Return whether each of some legs is a motion in one piece."""
        columns = ((self.count, 1), (self.begin, 0.0), (self.end, 1.0))
        return all(bool(np.all(taken(column, legs) == value)) for column, value in columns)

    def ends(self, legs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the leg of every piece of some legs, and the fraction of the motion at the piece's end point."""
        if self.whole(legs):
            return legs, np.ones(len(legs))
        of, number = repeat_with_index(legs, self.count[legs])
        share = (number + 1) / self.count[of]
        return of, np.where(share == 1.0, self.end[of], self.at(of, share))

    def at(self, legs: np.ndarray, share: np.ndarray) -> np.ndarray:
        """Return the fractions of the motions at fractions of legs."""
        return np.asarray(self.begin[legs] + share * (self.end[legs] - self.begin[legs]))


def turning_points(
    prepared: PreparedMachine, path: ToolPath, which: np.ndarray, axes: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return (k,) motions and (k,) fractions at which axes reverse inside motions, in order.

    Points closer than two least increments to another one or to an end point are omitted: rounded words cannot represent them.
    """
    columns, motions = path.columns, path.motions
    can_turn = np.array(columns.tcp)
    if can_turn.any():
        can_turn &= (columns.start[:, 3:] != columns.end[:, 3:]).any(axis=1)
    can_turn[list(columns.special)] = True
    curved = which[can_turn[which]]
    if not axes or not curved.size:
        return np.zeros(0, dtype=int), np.zeros(0)
    counts = np.array([_steps(motions[i]) for i in curved])
    of, index = repeat_with_index(curved, counts + 1)
    grid = index / np.repeat(counts, counts + 1)
    found_of, found_at = [], []
    velocity = np.where(np.abs(v := _velocity(prepared, motions, of, grid)) > AT_REST, np.sign(v), 0.0)
    for axis in axes:
        moving = np.flatnonzero(velocity[:, axis])
        first, last = moving[:-1], moving[1:]
        turns = (of[first] == of[last]) & (velocity[first, axis] != velocity[last, axis])
        first, last = first[turns], last[turns]
        low, high, sign = grid[first], grid[last], velocity[first, axis]
        for _ in range(HALVINGS if first.size else 0):
            middle = (low + high) / 2.0
            before = _velocity(prepared, motions, of[first], middle)[:, axis] * sign > 0.0
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        found_of.append(of[first])
        found_at.append((low + high) / 2.0)
    return _resolvable(prepared, motions, np.concatenate(found_of), np.concatenate(found_at))


def _steps(motion: PathMotion) -> int:
    turned = float(np.abs(motion.end[3:] - motion.start[3:]).max(initial=0.0)) if motion.move.tcp else 0.0
    arc = 0.0 if motion.move.arc is None else abs(np.degrees(motion.move.arc.angle_rad))
    return max(4, int(np.ceil(max(turned, arc) / STEP_DEG)))


def _velocity(
    prepared: PreparedMachine, motions: Sequence[PathMotion], of: np.ndarray, fraction: np.ndarray
) -> np.ndarray:
    """Return (n, axes) differences of commands just after and just before fractions of motions, in ascending order."""
    bounds = np.append(np.flatnonzero(np.diff(of, prepend=-1)), len(of))
    tcp = np.array([motions[i].move.tcp for i in of])

    def commands(at: np.ndarray) -> np.ndarray:
        words = np.concatenate([motions[of[i]].along(at[i:j]) for i, j in pairwise(bounds)])
        return prepared.space.commands(words, tcp)

    before, behind = np.clip(fraction - HALF_INTERVAL, 0.0, 1.0), np.clip(fraction + HALF_INTERVAL, 0.0, 1.0)
    return commands(behind) - commands(before)


def _resolvable(
    prepared: PreparedMachine, motions: Sequence[PathMotion], of: np.ndarray, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the points in order, without those that rounded words cannot distinguish from the one before or from an end point."""
    kept: list[tuple[int, float]] = []
    for motion in np.unique(of).tolist():
        places = np.sort(at[of == motion])
        words = motions[motion].along(np.array([0.0, *places, 1.0]))
        last = words[0]
        for place, here in zip(places.tolist(), words[1:-1], strict=True):
            if all(np.any(np.abs(here - there) >= 2.0 * prepared.increment) for there in (last, words[-1])):
                kept.append((motion, place))
                last = here
    return np.array([point[0] for point in kept], dtype=int), np.array([point[1] for point in kept], dtype=float)


# --- A program, or a stretch of it, cut into pieces, with the commands for their end points -------

ORIENTATION_NOISE_RAD: Final = 1e-9
"""Orientation residual below which it is numerical noise of the solver."""


@final
class Pieces:
    """One program, or a stretch of it, cut into pieces.

    ``dialect``: the program's language; ``number_of``: function that returns the numbers of lines by their 0-based indices; ``posted``:
    whether axis words are written even for tool-tip input (cutter locations posted for a control).

    Attributes:
        lines: (motions,) line number of each motion.
        idle: whether no error motion is in scope: arcs stay arcs, and the program is written unchanged.
        increment: (axes,) least increments of the output words.
        legs: the motions, cut where an axis with backlash in scope reverses, and the number of pieces of each.
        tcp: (motions,) whether the input words are tool-tip coordinates.
        tcp_out: (motions,) whether the output words are.
        start, end: (motions, axes) nominal words.
        straight: (motions,) whether the motion is not an arc.
        by_vector: (motions,) whether the output has a tool vector.
        whole: (motions,) whether the motion stays one block, and an arc an arc.
        interpolated: (motions,) whether the control follows a line or arc from a known start, and the path is computed.
    """

    def __init__(
        self,
        prepared: PreparedMachine,
        path: ToolPath,
        aim: CorrectionAim,
        dialect: Dialect,
        *,
        source: str,
        number_of: Callable[[np.ndarray], np.ndarray],
        conditions: BlockConditions = CONSTANT,
        posted: bool = False,
    ) -> None:
        self.prepared, self.path, self.aim, self.source, self.posted = prepared, path, aim, source, posted
        self.conditions = conditions
        self.lines = number_of(path.columns.line)
        self.space = prepared.space
        self.idle = aim.idle and not posted
        self.increment = prepared.printed_increment(dialect, posted=posted)
        self.vector_decimals = dialect.vector_decimals
        columns = path.columns
        self.tcp, self.start, self.end = columns.tcp, columns.start, columns.end
        self.tcp_out = self.tcp & (not posted)
        check_one_mode(prepared.calibration, self.tcp_out, source, tcp=prepared.options.tcp)
        self.straight = np.ones(len(columns), dtype=bool)
        self.straight[[i for i, move in columns.special.items() if move.arc is not None]] = False
        self.whole = np.zeros(len(columns), dtype=bool)
        self.whole[[i for i, move in columns.special.items() if move.whole]] = True
        self._check_whole()
        self.by_vector = columns.by_vector & (not posted)
        self.interpolated = ~columns.rapid & rows_all_true(np.isfinite(self.start)) & (self.straight | ~self.whole)
        # From outside the range there is no nominal path; such a start is reported with its own block.
        if self.interpolated.any():
            self.interpolated &= ~prepared.outside(self.space.commands(self.start, self.tcp))
        turning = turning_points(prepared, path, np.flatnonzero(self.interpolated), aim.backlash.axes)
        self.legs = Legs.of(len(columns), turning)
        if not self.idle:
            whole = np.ones(len(columns), dtype=int)
            for i in np.flatnonzero(~self.straight & ~self.whole).tolist():
                whole[i] = path.motions[i].chords(prepared.options.tolerance_mm)
            share = self.legs.end - self.legs.begin
            self.legs.count = np.maximum(np.ceil(whole[self.legs.motion] * share), 1).astype(int)

    def _check_whole(self) -> None:
        """Raise `InputError` for blocks that stay whole on a machine with backlash, whose correction inserts blocks."""
        if self.whole.any() and self.aim.backlash.axes and not self.idle:
            raise InputError(
                "cutter radius compensation where backlash is corrected",
                expected="the tool centre path from the CAM system (G40), or a calibration without backlash",
                file=self.source,
                line=int(self.path.columns.line[np.flatnonzero(self.whole)[0]] + 1),
            )

    @cached_property
    def ways(self) -> tuple[np.ndarray, np.ndarray]:
        """(motions, axes) nominal words at the start of each motion (its end point if the start is unknown), and the displacement."""
        known = np.isfinite(self.start)
        begin = self.start if known.all() else np.where(known, self.start, self.end)
        return begin, self.end - begin

    def words_at(self, of: np.ndarray, fraction: np.ndarray) -> np.ndarray:
        """Return (n, axes) nominal words at fractions of motions."""
        if np.all(fraction == 1.0):
            return taken(self.end, of)
        begin, way = self.ways
        words = begin.take(of, axis=0) + fraction[:, None] * way.take(of, axis=0)
        whole = np.flatnonzero(fraction == 1.0)
        words[whole] = self.end.take(of[whole], axis=0)
        if not self.straight.all():
            curved = np.flatnonzero(~self.straight[of])
            curved = curved[np.argsort(of[curved], kind="stable")]
            for rows in np.split(curved, np.flatnonzero(np.diff(of[curved])) + 1) if curved.size else ():
                words[rows] = self.path.motions[of[rows[0]]].along(fraction[rows])
        return words

    def state(self, rows: Rows) -> np.ndarray:
        """Return (n, axes + channels) directions of approach and conditions of rows, as `Kinematics.directed` describes."""
        return self.conditions.at(rows.approach, rows.motion, rows.fraction)

    def count(self, rows: Rows) -> np.ndarray:
        """Return (motions,) the number of output blocks of each motion."""
        return np.bincount(rows.motion, minlength=len(self.start))

    def left_as_written(self, rows: Rows) -> np.ndarray:
        """Return (motions,) whether any end point of each is left as written."""
        left_as_written = np.zeros(len(self.start), dtype=bool)
        left_as_written[rows.motion[rows.untouched]] = True
        return left_as_written

    # --- commands for end points of pieces ---------------------------------------------------------------------------

    def ends(self, legs: np.ndarray) -> Rows:
        """Solve for the end points of all pieces of some legs."""
        return self.solve(*self.legs.ends(legs))

    def solve(self, leg: np.ndarray, fraction: np.ndarray, approach: np.ndarray | None = None) -> Rows:
        """Solve for points at (n,) fractions of the motions of (n,) legs; ``approach``: (n, axes); unknown if None."""
        limits = self.prepared.limits
        of = taken(self.legs.motion, leg)
        sides = np.zeros((len(of), len(limits))) if approach is None else approach
        words = self.words_at(of, fraction)
        nominal = self.space.commands(words, taken(self.tcp, of))
        untouched = self.prepared.outside(nominal)
        safe = nominal
        if untouched.any():
            safe = np.where(untouched[:, None], np.clip(nominal, limits[:, 0], limits[:, 1]), nominal)
        target = self.space.nominal.forward(safe)
        vectors, orientation_residual_rad = np.full((len(of), 3), np.nan), np.zeros(len(of))
        if self.prepared.thesis is not None:
            exact, unsolved = self.prepared.thesis.commands(safe), np.zeros(len(of), dtype=bool)
        else:
            state = self.conditions.at(sides, of, fraction)
            commands, orientation_residual_rad = self.oriented(target, safe, state)
            commands, vectors = self._rotary_as_printed(commands, of)
            solution = self.aim.point_inverse.solve(target, commands, rotary=False, approach=state)
            exact, unsolved = solution.positions, solution.where(Status.OUT_OF_RANGE)
        no, nowhere = np.zeros(len(of), dtype=bool), np.zeros(sides.shape)
        rows = Rows(
            leg=leg,
            motion=of,
            backlash_move=no,
            approach=sides,
            reverses=nowhere.astype(bool),
            overshoot=nowhere,
            fraction=fraction,
            words=words,
            nominal=nominal,
            target_mm=target.point_mm,
            target_rotation=target.rotation,
            exact=exact,
            commands=exact,
            printed=words,
            vectors=vectors,
            orientation_residual_rad=orientation_residual_rad,
            singular=orientation_residual_rad > 0.0,
            clamped=no,
            relaxed=no,
            as_programmed=no,
            untouched=untouched,
        )
        return self.printed(rows, unsolved)

    def oriented(self, target: Poses, start: np.ndarray, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (n, axes) start commands with the rotary axes turned to correct the orientation, and (n,) the residual in radians.

        Whether a linear axis has the travel that the point then needs is decided later (`printed`).
        """
        commands = np.array(start)
        inverse = self.aim.orientation_inverse
        if inverse is None:
            return commands, np.zeros(len(start))
        solution = inverse.solve(target, start, approach=state)
        rotary = list(self.prepared.machine.rotary)
        low, high = self.prepared.limits[rotary].T
        turned = solution.positions[:, rotary]
        able = rows_all_true((turned >= low - SLACK) & (turned <= high + SLACK))
        commands[:, rotary] = np.where(able[:, None], turned, commands[:, rotary])
        left = np.where(
            solution.orientation_residual_rad > ORIENTATION_NOISE_RAD, solution.orientation_residual_rad, 0.0
        )
        unable = np.flatnonzero(~able)
        if unable.size:
            target = Poses(target.point_mm[unable], target.rotation[unable])
            left[unable] = self._orientation_residual_rad(target, commands[unable], state[unable])
        return commands, left

    def printed(self, rows: Rows, unsolved: np.ndarray | None = None) -> Rows:
        """Return rows with ``exact`` as rounded words, none farther from its point than as programmed; ``unsolved``: (n,)."""
        rounded = self._rounded(rows)
        stopped = rounded.clamped & ~rounded.as_programmed & ~rows.overshoot.any(axis=1)
        if unsolved is not None:
            stopped |= unsolved & ~rows.untouched
        if not stopped.any() or self.prepared.thesis is not None:
            return rounded
        return rounded.put(stopped, self._nearest(rounded.where(stopped)))

    def _rounded(self, rows: Rows) -> Rows:
        """Return the rows with ``exact`` stopped at the limits, converted to words and rounded to their increments."""
        limits = self.prepared.limits
        wanted = rows.exact + rows.overshoot
        clipped, clamped = wanted, np.zeros(len(wanted), dtype=bool)
        if not all_within(wanted, limits[:, 0], limits[:, 1]):
            clipped = np.clip(wanted, limits[:, 0], limits[:, 1])
            clamped = ~rows_all_true(np.abs(clipped - wanted)[:, self.space.order] <= 0.5 * self.prepared.increment)
        tcp_out = taken(self.tcp_out, rows.motion)
        out = self.space.words(clipped, tcp_out)
        printed = self.prepared.on_grid(out, tcp_out, self.increment)
        if self.by_vector.any():
            free = np.ix_(self.by_vector[rows.motion], range(3, printed.shape[1]))
            printed[free] = out[free]
        left = rows.untouched
        if left.any():
            printed[left] = self.space.words(rows.nominal, tcp_out)[left] if self.posted else rows.words[left]
        commands = self.space.commands(printed, tcp_out)
        return replace(rows, printed=printed, commands=commands, clamped=(clamped | rows.as_programmed) & ~left)

    def _nearest(self, stopped: Rows) -> Rows:
        """Return rows stopped at a limit, each with the position that puts the tool nearest to its point.

        Among equally near ones, apart from rounding, the tool axis is corrected rather than not, and the point rather than nothing.
        """
        state, target = self.state(stopped), stopped.target
        commands, vectors = self._rotary_as_printed(stopped.nominal, stopped.motion)
        residual_rad = self._orientation_residual_rad(target, np.clip(stopped.nominal, *self.prepared.limits.T), state)
        yes = np.ones(len(commands), dtype=bool)
        as_programmed = replace(
            stopped,
            exact=commands,
            vectors=vectors,
            orientation_residual_rad=residual_rad,
            singular=residual_rad > ORIENTATION_NOISE_RAD,
            relaxed=yes,
            as_programmed=yes,
        )
        exact = self.aim.point_inverse.solve(target, commands, rotary=False, approach=state).positions
        relaxed = replace(as_programmed, exact=exact, as_programmed=stopped.as_programmed)
        best, rounding_mm = stopped, 0.5 * float(np.linalg.norm(self.increment[:3]))
        for other in map(self._rounded, (relaxed, as_programmed)):
            nearer = self._off_mm(best, state) > self._off_mm(other, state) + rounding_mm
            best = best.put(nearer, other.where(nearer))
        return best

    def _off_mm(self, rows: Rows, state: np.ndarray) -> np.ndarray:
        """Return (n,) the distance of the tool point from its target; infinite for commands that are no numbers."""
        distance = self.aim.comparison.distance_mm(Commands(rows.nominal), Commands(rows.commands), state)
        return np.nan_to_num(distance, nan=np.inf)

    def _orientation_residual_rad(self, target: Poses, commands: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Return (n,) the angle between the tool axis and its target; 0 if the rotary axes do not move for it."""
        real = self.aim.orientation
        return (
            np.zeros(len(commands))
            if real is None
            else angle_between_rad(real.forward(commands, state).axis, target.axis)
        )

    def _rotary_as_printed(self, commands: np.ndarray, of: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return commands with the rotary axes at the rounded words, and tool vectors for programs that use these."""
        rotary, space = list(self.prepared.machine.rotary), self.space
        commands = np.array(commands)
        vectors = np.full((len(of), 3), np.nan)
        vector = taken(self.by_vector, of)
        words = commands[:, space.order] - space.offset
        tips = np.ones(len(words), dtype=bool)
        rounded = self.prepared.on_grid(words, tips, self.increment)[:, 3:] + space.offset[3:]
        commands[:, rotary] = np.where(vector[:, None], commands[:, rotary], rounded) if vector.any() else rounded
        rows = np.flatnonzero(vector)
        if rows.size:
            vectors[rows] = np.round(space.nominal.forward(commands[rows]).axis, self.vector_decimals)
            unit = vectors[rows] / np.linalg.norm(vectors[rows], axis=1, keepdims=True)
            before = commands[:, rotary][rows]
            nearest = space.branches.nearest(space.branches.all(unit), before)
            commands[rows[:, None], rotary] = np.where(np.isnan(nearest), before, nearest)
        return commands, vectors
