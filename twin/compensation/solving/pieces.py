"""A program, or a stretch of it, cut into pieces, with the commands for their end points.

For each end point: nominal pose → commands that reach it → rotary words rounded to the least increment → linear axes solved again for
the rounded rotary axes → linear words rounded.

Where a limit stops an axis, the position nearest to the point is taken: with the corrected tool axis, else with the rotary axes as
programmed, else the programmed position itself.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Final, final

import numpy as np

from twin._common.arrays import all_within, rows_all_true
from twin.compensation.block_conditions import CONSTANT, BlockConditions
from twin.compensation.comparison import Commands
from twin.compensation.one_mode import check_one_mode
from twin.compensation.prepared import CorrectionAim, PreparedMachine
from twin.compensation.solving.legs import Legs, turning_points
from twin.compensation.solving.rows import Rows, taken
from twin.compensation.toolpath import ToolPath
from twin.kinematics.forward import Poses, angle_between_rad
from twin.kinematics.inverse import SLACK, Status
from twin.nc.dialect import Dialect

ORIENTATION_NOISE_RAD: Final = 1e-9
"""Orientation residual below which it is numerical noise of the solver."""


@final
class Pieces:
    """One program, or a stretch of it, cut into pieces.

    Args:
        prepared: machine, calibration and options.
        path: the program as motions.
        aim: errors to correct.
        dialect: the program's language.
        source: its name, for messages.
        numbers: (lines,) number of every line of the program; in order if None.
        conditions: those of every motion.
        posted: whether axis words are written even for tool-tip input (cutter locations posted for a control).

    Attributes:
        lines: (motions,) line number of each motion.
        idle: whether no error motion is in scope: arcs stay arcs, and the program is written unchanged.
        increment: (axes,) least increments of the output words.
        vector_decimals: decimals of an output tool vector.
        legs: the motions, cut where an axis with backlash in scope reverses, and the number of pieces of each.
        tcp: (motions,) whether the input words are tool-tip coordinates.
        tcp_out: (motions,) whether the output words are.
        start, end: (motions, axes) nominal words.
        straight: (motions,) whether the motion is not an arc.
        by_vector: (motions,) whether the output has a tool vector.
        interpolated: (motions,) whether the control follows a line or arc from a known start.
    """

    def __init__(
        self,
        prepared: PreparedMachine,
        path: ToolPath,
        aim: CorrectionAim,
        dialect: Dialect,
        *,
        source: str,
        numbers: np.ndarray | None = None,
        conditions: BlockConditions = CONSTANT,
        posted: bool = False,
    ) -> None:
        self.prepared, self.path, self.aim, self.source, self.posted = prepared, path, aim, source, posted
        self.conditions = conditions
        self.lines = path.columns.line + 1 if numbers is None else numbers[path.columns.line]
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
        self.by_vector = columns.by_vector & (not posted)
        self.interpolated = ~columns.rapid & rows_all_true(np.isfinite(self.start))
        # From outside the range there is no nominal path; such a start is reported with its own block.
        self.interpolated &= ~prepared.outside(self.space.commands(self.start, self.tcp))
        turning = turning_points(prepared, path, np.flatnonzero(self.interpolated), aim.backlash.axes)
        self.legs = Legs.of(len(columns), turning)
        if not self.idle:
            whole = np.ones(len(columns), dtype=int)
            for i in np.flatnonzero(~self.straight).tolist():
                whole[i] = path.motions[i].chords(prepared.options.tolerance_mm)
            share = self.legs.end - self.legs.begin
            self.legs.count = np.maximum(np.ceil(whole[self.legs.motion] * share), 1).astype(int)

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
        found = np.zeros(len(self.start), dtype=bool)
        found[rows.motion[rows.untouched]] = True
        return found

    # --- commands for end points of pieces ---------------------------------------------------------------------------

    def ends(self, legs: np.ndarray) -> Rows:
        """Solve for the end points of all pieces of some legs."""
        return self.solve(*self.legs.ends(legs))

    def solve(self, leg: np.ndarray, fraction: np.ndarray, approach: np.ndarray | None = None) -> Rows:
        """Solve for points at fractions of the motions of legs.

        Args:
            leg: (n,) the legs.
            fraction: (n,) fractions of their motions.
            approach: (n, axes) approach directions; unknown if None.
        """
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
        """Return the rows with ``exact`` converted to words and rounded, none farther from its point than as programmed.

        Args:
            rows: as solved.
            unsolved: (n,) whether the solver did not reach the point within the limits.
        """
        found = self._rounded(rows)
        stopped = found.clamped & ~found.as_programmed & ~rows.overshoot.any(axis=1)
        if unsolved is not None:
            stopped |= unsolved & ~rows.untouched
        if not stopped.any() or self.prepared.thesis is not None:
            return found
        return found.put(stopped, self._nearest(found.where(stopped)))

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
            found = space.branches.nearest(space.branches.all(unit), before)
            commands[rows[:, None], rotary] = np.where(np.isnan(found), before, found)
        return commands, vectors
