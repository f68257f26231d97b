"""Temperatures, spindle speed and time of every block of a program.

The time of a block is the length of its path divided by its feed; no axis moves faster than its velocity limit in the URDF, at which
rapids run. Accelerations, overrides and tool changes are not counted. In axis mode a degree of a rotary axis counts as a millimetre;
in tool-tip coordinates the path is that of the tip, unless only rotary axes move. The spindle speed is that of the S words. A log of
the machine supplies temperatures during the program, and temperatures and speeds before it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.records import SPEED, TIME, is_temperature, sensor_of
from twin.compensation.programs.motions import MotionColumns, ToolPath
from twin.compensation.programs.words import WordSpace
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions, needed, temperature_channel
from twin.model.effects.base import HistoryShift
from twin.model.effects.empirical import check_ranges
from twin.nc.blocks import Program
from twin.nc.dialect import Dialect, FeedUnit, Technology

UNLIMITED_SPEED: Final = 1e6
"""m/s and rad/s; a limit above is none."""
STEP_S: Final = 10.0
"""Longest time between two moments at which conditions are evaluated, s."""
STANDING_STILL: Final = 1e-9
"""Length of a path (mm, degrees) below which nothing moves."""


@final
@dataclass(frozen=True)
class BlockConditions:
    """Channels at every place of every motion, by the time at which the tool is there."""

    names: tuple[str, ...] = ()  # names of the channels, as in `Kinematics.by_pose`
    begin_s: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (motions,) when each begins
    duration_s: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (motions,) how long each takes
    time_s: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (moments,) increasing
    # (moments, channels); linear between the moments, except a speed, which is that of the time up to its moment
    values: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    source: str = ""  # time, speeds and temperatures over the program, and where they are from, in words

    def at(self, sides: np.ndarray, motion: np.ndarray, fraction: np.ndarray) -> np.ndarray:
        """Return (n, axes + channels): (n, axes) ``sides``, and channels at fractions of motions, as of `Kinematics.directed`."""
        if not self.names:
            return sides
        moment = self.begin_s[motion] + np.asarray(fraction) * self.duration_s[motion]
        found = np.array([np.interp(moment, self.time_s, values) for values in self.values.T])
        if SPEED in self.names:
            after = np.minimum(np.searchsorted(self.time_s, moment), len(self.time_s) - 1)
            found[self.names.index(SPEED)] = self.values[after, self.names.index(SPEED)]
        return np.hstack([sides, found.T])

    def part(self, begin: int, end: int) -> BlockConditions:
        """Return the conditions of the motions from index ``begin`` up to ``end``."""
        return replace(self, begin_s=self.begin_s[begin:end], duration_s=self.duration_s[begin:end])

    def channels(self, motion: np.ndarray, fraction: np.ndarray) -> dict[str, np.ndarray]:
        """Return (n,) values by name; arguments as for `at`."""
        values = self.at(np.zeros((len(motion), 0)), motion, fraction)
        return dict(zip(self.names, values.T, strict=True))


CONSTANT: Final = BlockConditions()
"""Conditions that apply to the whole program are none of a block."""


def channels_by_block(calibration: Calibration, conditions: Conditions) -> tuple[str, ...]:
    """Return the channels that differ from block to block; none if all conditions apply to the whole program."""
    if not conditions.by_block(calibration):
        return ()
    log = () if conditions.log is None else map(temperature_channel, conditions.log.temperature_degC)
    varying = {TIME, *log} | ({SPEED} if conditions.spindle_rpm is None else set())
    plain = tuple(name for name in needed(calibration) if name in varying)
    histories = (effect for effect in calibration.effects if isinstance(effect, HistoryShift))
    return plain + tuple(name for effect in histories for name in effect.factor_channels)


def block_conditions(
    program: Program,
    dialect: Dialect,
    path: ToolPath,
    spaces: Sequence[tuple[int, WordSpace]],
    calibration: Calibration,
    conditions: Conditions,
) -> BlockConditions:
    """Return the conditions of every motion of a program; ``spaces``: conversions of its words, each from a motion (its index) on.

    `InputError`, with the line or the times, if a feed, a speed, or a part of the log is missing.
    """
    names = channels_by_block(calibration, conditions)
    if not names:
        return CONSTANT
    said = dialect.technology(program)
    start = conditions.time_s or 0.0
    lengths = durations_s(program.source, said, path, spaces)
    end = start + np.cumsum(said.dwell_s)[path.columns.line] + np.cumsum(lengths)
    course = _Course(program.source, said, path.columns, (end - lengths, end), conditions, needed(calibration))
    state = course.state()
    check_ranges(calibration.bounded, state, file=None if conditions.log is None else conditions.log.path)
    for effect in calibration.effects:
        if isinstance(effect, HistoryShift):
            state |= dict(zip(effect.factor_channels, effect.factors(state), strict=True))
    values = np.stack([np.asarray(state[name], dtype=float) for name in names], axis=1)
    return BlockConditions(
        names,
        read_only(end - lengths),
        read_only(lengths),
        read_only(course.time_s),
        read_only(values),
        course.in_words(state),
    )


def durations_s(source: str, said: Technology, path: ToolPath, spaces: Sequence[tuple[int, WordSpace]]) -> np.ndarray:
    """Return (motions,) the time of every motion in seconds, 0 where the start is unknown; `InputError` without a feed."""
    columns = path.columns
    ends = [*(begin for begin, _ in spaces[1:]), len(columns)]
    parts = [(slice(begin, end), space) for (begin, space), end in zip(spaces, ends, strict=True)]
    commands = [
        np.concatenate([space.commands(words[part], columns.tcp[part]) for part, space in parts])
        for words in (columns.start, columns.end)
    ]
    fastest = velocity_limits(spaces[0][1].machine)
    moved = np.nan_to_num(np.abs(commands[1] - commands[0]))
    least = np.max(moved / fastest, axis=1, initial=0.0)
    way = _way(path)
    feed, unit, speed = said.feed[columns.line], said.unit[columns.line], said.speed_rpm[columns.line]
    inverse = unit == FeedUnit.INVERSE
    cutting = ~columns.rapid & ((way > STANDING_STILL) | inverse)
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = np.where(unit == FeedUnit.TURN, feed * speed, feed)
        taken = 60.0 * np.where(inverse, 1.0, way) / rate
    for i in np.flatnonzero(cutting & ~np.isfinite(taken))[:1].tolist():
        what = "the spindle is not turning" if np.isfinite(feed[i]) and feed[i] > 0.0 else "no feed"
        raise InputError(
            f"the time of a block is unknown: {what}",
            expected="a feed word with a number in this line or before",
            file=source,
            line=int(columns.line[i]) + 1,
        )
    return np.where(cutting, np.maximum(taken, least), least)


def velocity_limits(machine: Machine) -> np.ndarray:
    """Return (axes,) the velocity limits of the URDF in mm/s and degrees/s; very large where there is none."""
    model = machine.model
    limits = [model.velocityLimit[model.joints[model.getJointId(axis.joint)].idx_v] for axis in machine.axes]
    fastest = np.minimum(limits, UNLIMITED_SPEED) / machine.scale
    return np.where(fastest > 0.0, fastest, np.inf)


def _way(path: ToolPath) -> np.ndarray:
    """Return (motions,) the length of the path that a feed counts; zero for a motion with an unknown start."""
    columns = path.columns
    moved = columns.end - columns.start
    squares = np.nan_to_num(moved) ** 2
    for i, move in columns.special.items():
        if move.arc is not None:
            a, b, _ = move.arc.plane
            radius = np.hypot(*(columns.start[i, [a, b]] - move.arc.centre_mm))
            squares[i, a], squares[i, b] = (radius * move.arc.angle_rad) ** 2, 0.0
    linear = np.sqrt(squares[:, :3].sum(axis=1))
    tip = columns.tcp & (linear > STANDING_STILL)
    return np.asarray(np.where(tip, linear, np.sqrt(squares.sum(axis=1))))


@final
class _Course:
    """Channels at the moments ``time_s`` (n,): at the rows of the log, at beginning, end (``times``) and between of motions."""

    def __init__(
        self,
        source: str,
        said: Technology,
        columns: MotionColumns,
        times: tuple[np.ndarray, np.ndarray],
        conditions: Conditions,
        required: Collection[str],
    ) -> None:
        self._source, self._said, self._columns = source, said, columns
        self._begin, self._end = times
        self._conditions, self._needs_speed = conditions, SPEED in required
        self._sensors = [sensor_of(name) for name in required if is_temperature(name)]
        self._log = conditions.log
        before = np.zeros(0) if self._log is None else self._log.time_s[self._log.time_s < self._end[-1]]
        between = np.arange(self._begin[0], self._end[-1], STEP_S)
        self.time_s = np.unique(np.concatenate([before, between, *times]))
        self._check_log()

    def state(self) -> dict[str, np.ndarray]:
        """Return the channels at the moments. Raises `InputError`: the speed before or during the program is unknown."""
        state: dict[str, np.ndarray] = {
            name: np.full(len(self.time_s), value) for name, value in self._conditions.channels.items()
        }
        state[TIME] = self.time_s
        if self._log is not None:
            for name, values in self._log.temperature_degC.items():
                state[temperature_channel(name)] = np.interp(self.time_s, self._log.time_s, values)
        if self._needs_speed and self._conditions.spindle_rpm is None:
            state[SPEED] = self._speeds()
        return state

    def _speeds(self) -> np.ndarray:
        """Return the speed of the time up to each moment."""
        middle = np.append(self.time_s[:1], 0.5 * (self.time_s[1:] + self.time_s[:-1]))
        motion = np.minimum(np.searchsorted(self._end, middle), len(self._end) - 1)
        speed = self._said.speed_rpm[self._columns.line[motion]]
        log, start = self._log, self._begin[0]
        known = np.zeros(len(middle), dtype=bool)
        if log is not None and log.speed_rpm is not None:
            known = middle <= log.time_s[-1]
            speed = np.where(
                known, log.speed_rpm[np.minimum(np.searchsorted(log.time_s, middle), len(log.time_s) - 1)], speed
            )
        if not known.all() and not self._said.says_speed:
            raise InputError(
                "the program has no speed word (S), and the calibration needs the spindle speed",
                expected="S words, a log with spindle_rpm over the whole program, or a speed for the whole program",
                file=self._source,
                setting="rpm",
            )
        if start > 0.0 and not known[0]:
            raise InputError(
                f"the spindle speed before the program is unknown; the program begins at {start:g} s",
                expected="a log with spindle_rpm up to there, a program that begins at 0 s, or a speed for the whole program",
                file=self._source,
                setting="log",
            )
        return np.asarray(speed)

    def _check_log(self) -> None:
        """Raise `InputError` unless the log covers the program, if it has temperatures, or its beginning."""
        log, (begin, end) = self._log, (self._begin[0], self._end[-1])
        if log is None:
            return
        first, last = log.time_s[0], log.time_s[-1]
        if begin < first or (begin > last if not log.temperature_degC else end > last):
            raise InputError(
                f"the log is of {first:g} to {last:g} s; the program runs from {begin:g} to {end:.0f} s",
                expected="a log that covers the program: rows with the temperatures expected can be added",
                file=log.path,
                setting="time",
            )

    def in_words(self, state: Mapping[str, np.ndarray]) -> str:
        """Return time, speeds and temperatures over the program in words."""
        begin, end = self._begin[0], self._end[-1]
        inside = (self.time_s >= begin) & (self.time_s <= end)
        parts = [
            f"the program takes {(end - begin) / 60.0:.1f} min by feed and path (without accelerations and overrides), from "
            f"{begin:g} s on"
        ]
        if SPEED in state and self._conditions.spindle_rpm is None:
            logged = self._log is not None and self._log.speed_rpm is not None and self._log.time_s[-1] >= end
            parts.append(f"spindle {_span(state[SPEED][inside], 0)} 1/min ({'log' if logged else 'S words'})")
        if self._log is not None:
            for name in (sensor for sensor in self._sensors if sensor in self._log.temperature_degC):
                values = state[temperature_channel(name)][inside]
                parts.append(f"{name} {_span(values, 1)} °C (log)")
        return "; ".join(parts)


def _span(values: np.ndarray, decimals: int) -> str:
    """Return the range of values in words: "21.4 to 21.9", "6000"."""
    low, high = (f"{value:.{decimals}f}" for value in (values.min(), values.max()))
    return low if low == high else f"{low} to {high}"
