"""Approach directions and backlash: the direction from which every axis reaches its positions, and how to command for it.

A *side* is an effect's ``approach_<axis>``: +1 approached from below, −1 from above, 0 unknown. It is unknown for an axis that has
not moved yet, or that a line passed through unchanged has left at an unknown position. The path of a rapid move is not modelled: the
side at the end point is that of the direct way from its start.

**Model of the machine** (`Backlash.sides`). A negative reversal value (the axis lags) is backlash: the axis stands still until its
command has come back by that value, so the side changes gradually over this distance (the play operator of Krasnosel'skii and
Pokrovskii, 1989). A positive reversal value (the axis jumps ahead) is not mechanical play but an overcompensating control, which acts
at once when the command reverses; it is modelled that way.

**Compensation** (`Backlash.commanded_sides`). The inverse of the play operator is a step of the reversal value at every reversal of the
intended axis motion, even if the way back is short. The intended motion is the corrected one: if the program holds an axis still and a
straightness correction moves it back by some micrometres, backlash would absorb that motion. A way back of less than `LEAST_REVERSAL`
least increments does not count as a reversal, because rounding of words causes as much; the error left by this rule is of that size.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.units import UM, URAD
from twin.compensation.programs.motions import Passage, ToolPath
from twin.model.calibration import Calibration
from twin.model.effects import ControlCorrection

STILL: Final = 1e-6
"""Distance (mm, degrees) below which an axis stands still; the control's kinematics are solved to a thousandth of it."""

UNEVEN: Final = 0.05
"""Largest variation along an axis (µm, µrad) of the reversal value that a control's table corrects: one digit of the table."""

NEGLIGIBLE: Final = 1e-8
"""Reversal value (mm, degrees) below which the control corrects it fully, apart from rounding."""

FEW: Final = 16
"""Stretches of a way up to which each is followed step by step; more are followed together."""

LEAST_REVERSAL: Final = 1.5
"""Least increments by which an axis must come back to count as reversed: one is rounding, two are a reversal."""


@final
class Backlash:
    """The reversal values of a calibration, less those corrected by the control itself.

    Args:
        calibration: the machine's errors; only its reversals are used, and tables of the control that differ by direction.

    Attributes:
        size: (axes,) reversal value of each axis, mm and degrees; 0 if it has none or the control corrects it.
        axes: indices of the axes that have one, or on whose direction an empirical effect depends; such an effect changes at once when
            the axis reverses.

    Raises:
        InputError: a table of the control in which the difference between both directions varies along the axis.
    """

    def __init__(self, calibration: Calibration) -> None:
        machine = calibration.machine
        ranges = {axis.name: axis.domain for axis in machine.axes}
        self.size = np.zeros(len(machine.axes))
        turning = {name for effect in calibration.empirical for name in effect.directed}
        for effect in calibration.effects:
            if isinstance(effect, ControlCorrection):
                low, high = effect.reversal_range(ranges)
                if high - low > UNEVEN:
                    raise InputError(
                        f"the control's table corrects a reversal value of {effect.axis.name} that varies along the axis",
                        expected="the same difference between both directions everywhere, or it cannot be compensated",
                        value=f"{low:.2f} to {high:.2f}",
                    )
                size = 0.5 * (low + high)
            else:
                size = effect.reversal_value
            axis = machine.by_name[effect.frame.axis]
            self.size[machine.names.index(axis.name)] += size * (UM if axis.linear else URAD) / axis.scale
        self.size[np.abs(self.size) < NEGLIGIBLE] = 0.0
        self.axes = [i for i, name in enumerate(machine.names) if self.size[i] != 0.0 or name in turning]
        self._dead_band = LEAST_REVERSAL * np.array([axis.increment for axis in machine.axes])

    def sides(self, path: ToolPath, motion: np.ndarray, commands: np.ndarray) -> np.ndarray:
        """Return the (n, axes) approach directions, from −1 to +1, that result from commands given one after the other.

        Args:
            path: the program they belong to, for lines between its motions that are passed through.
            motion: (n,) index of the motion each belongs to, ascending.
            commands: (n, axes) mm and degrees.
        """
        return ApproachTracker(self, path).after(motion, commands)

    def width(self, axis: int) -> float:
        """Return the distance over which an axis reverses: its backlash, or the dead band if it changes its side at once."""
        return float(-self.size[axis] if self.size[axis] < 0.0 else self._dead_band[axis])

    def commanded_sides(self, path: ToolPath, motion: np.ndarray, intended: np.ndarray) -> np.ndarray:
        """Return the sides to command for, from the intended axis positions; arguments as for `sides`.

        Returns:
            (n, axes) +1, −1 or 0 on the way to each position. It changes directly after the extreme point of a reversal, the last one
            of equal points.
        """
        found = np.zeros(intended.shape)
        for axis in self.axes:
            way, own = _with_passages(path.passages, motion, intended[:, axis], axis)
            found[:, axis] = _from_reversal(way, _play(way, self._dead_band[axis])[1])[own]
        return found


@final
class ApproachTracker:
    """Approach directions that result from commands given one after the other, in one portion or several.

    Args:
        backlash: the reversal values.
        path: the program, for lines between its motions that are passed through.
    """

    def __init__(self, backlash: Backlash, path: ToolPath) -> None:
        self._backlash, self._passages = backlash, path.passages
        # Position, position within the play, and end of it last reached, of every axis.
        self._last = np.tile([np.nan, 0.0, 0.0], (len(backlash.size), 1))
        self._motion = -1

    def after(self, motion: np.ndarray, commands: np.ndarray) -> np.ndarray:
        """Return the approach directions at the next positions; arguments and result as for `Backlash.sides`."""
        if not len(motion):
            return np.zeros(commands.shape)
        sides, _, self._last = self._follow(motion, commands)
        self._motion = int(motion[-1])
        return sides

    def steady(self, motion: np.ndarray, commands: np.ndarray, row: np.ndarray, first: np.ndarray) -> np.ndarray:
        """Return (lines,) whether all axes keep their approach directions on straight lines to some of the next positions.

        Args:
            motion: motions of the next positions, as for `after`, which must still be called for them.
            commands: these positions.
            row: (lines,) index of the position at which each line ends.
            first: (lines, axes) a point near the beginning of each.
        """
        before = np.concatenate([self._last[None, :, 0], commands[:-1]])[row]
        ways = first - before, commands[row] - first
        # A line that begins elsewhere may first lead back.
        apart = np.isin(motion[row], [passage.before for passage in self._passages])
        apart |= ~(ways[0] * ways[1] >= 0.0)[:, self._backlash.axes].all(axis=1)
        at = row[apart]
        _, states, _ = self._follow(np.insert(motion, at, motion[at]), np.insert(commands, at, first[apart], axis=0))
        own = np.insert(np.ones(len(motion), dtype=bool), at, False)
        states = np.concatenate([self._last[None, :, 1], states[own][:-1]])[row]
        onward = [(way == 0.0) | (np.sign(way) == states) for way in ways]
        return np.asarray(~apart & (onward[0] & onward[1])[:, self._backlash.axes].all(axis=1))

    def _follow(self, motion: np.ndarray, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return approach directions and positions within the play after n > 0 commands, and the last of the latter, as kept."""
        sides, states, last = np.zeros(commands.shape), np.zeros(commands.shape), self._last.copy()
        between = [passage for passage in self._passages if self._motion < passage.before <= motion[-1]]
        for axis in self._backlash.axes:
            way, own = _with_passages(between, motion, commands[:, axis], axis)
            lag = self._backlash.size[axis] < 0.0
            state, side = _play(way, self._backlash.width(axis), *last[axis])
            last[axis] = way[-1], state[-1], side[-1]
            states[:, axis], sides[:, axis] = state[own], (state if lag else side)[own]
        return sides, states, last


def _play(
    way: np.ndarray, width: float, start: float = np.nan, begun: float = 0.0, reached: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return the position of an axis within its play, and the end of the play it last reached.

    Args:
        way: (n,) positions, NaN if unknown.
        width: width of the play, in the same unit.
        start: position before the first, NaN if unknown.
        begun: position within the play there.
        reached: the end of the play last reached there.

    Returns:
        (n,) from −1 to +1, changing over a distance of ``width``; 0 until the axis moves, and again where its position is unknown. (n,)
        +1, −1, or 0 before it has reached either end.
    """
    states, sides = np.zeros(len(way)), np.zeros(len(way))
    if not len(way):
        return states, sides
    rate, step = 2.0 / width, np.diff(way, prepend=start)
    first, last, behind, known = _stretches(step, rate)
    at, state, side = first.copy(), np.append(begun, known[:-1]), np.append(reached, known[:-1])
    those = np.flatnonzero(at < behind)
    while len(those) > FEW:
        here, moved = at[those], step[at[those]]
        gap, before = np.isnan(moved), state[those]
        now = np.where(gap, 0.0, np.clip(before + rate * moved, -1.0, 1.0))
        state[those], side[those] = now, np.where(gap | (np.abs(now) == 1.0), now, side[those])
        states[here], sides[here] = now, side[those]
        at[those] = here + 1
        those = those[((here < last[those]) | (now != known[those])) & (here + 1 < behind[those])]
    for one in those.tolist():
        part = slice(at[one], behind[one])
        states[part], sides[part] = _followed(step[part], rate, state[one], side[one])
        at[one] = behind[one]
    rest, left = _ranges(at, behind)
    states[rest], sides[rest] = np.repeat(state, left), np.repeat(side, left)
    return states, sides


def _stretches(step: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return stretches of a way at whose ends the position within the play is known whatever it was before.

    It is known at an end of the play after a way in one direction that is longer than the play, and 0 after a gap.

    Args:
        step: (n,) steps of the axis, NaN at gaps; n > 0.
        rate: change of the position within the play per step of one.

    Returns:
        (m,) first step of each stretch, (m,) first step of its last way in one direction, (m,) the step behind it, and (m,) the
        position behind it; NaN where it is unknown.
    """
    direction = np.sign(np.nan_to_num(step))
    says = np.where((direction != 0.0) | np.isnan(step), np.arange(len(step)), 0)
    direction = direction[np.maximum.accumulate(says)]
    begins = np.append(0, np.flatnonzero(direction[1:] != direction[:-1]) + 1)
    one_way, direction = np.add.reduceat(np.nan_to_num(step), begins), direction[begins]
    known = np.where(np.abs(one_way) * rate >= 2.0 + STILL, direction, np.nan)
    known[np.isnan(step[begins])] = 0.0
    certain = np.isfinite(known)
    certain[-1] = True
    behind = np.append(begins[1:], len(step))[certain]
    return np.append(0, behind[:-1]), begins[certain], behind, known[certain]


def _followed(step: np.ndarray, rate: float, state: float, side: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions within the play and the ends last reached, as `_play`, after steps one by one."""
    # Steps that change the state: any step unless it has reached an end, there only those back; and gaps.
    changes = {end: np.flatnonzero((step * end < 0.0) | np.isnan(step)) for end in (1.0, -1.0)}
    between = np.flatnonzero(step != 0.0)
    states, sides, steps = np.zeros(len(step)), np.zeros(len(step)), step.tolist()
    at = 0
    while at < len(steps):
        moved = steps[at]
        if moved == 0.0 or (moved * state > 0.0 and state in changes):
            those = changes.get(state, between)
            place = int(np.searchsorted(those, at))
            end = int(those[place]) if place < len(those) else len(steps)
            states[at:end], sides[at:end] = state, side
            at = end
            continue
        state = 0.0 if moved != moved else min(1.0, max(-1.0, state + rate * moved))
        side = 0.0 if moved != moved else state if state in changes else side
        states[at], sides[at] = state, side
        at += 1
    return states, sides


def _from_reversal(way: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Return sides that are detected late, moved back to the preceding extreme point."""
    found = sides.copy()
    at = np.flatnonzero(np.diff(sides) != 0.0) + 1
    at = at[sides[at] != 0.0]
    if not at.size:
        return found
    # The extreme point lies behind the detection of the reversal before, which is behind the extreme point of that one.
    gaps = np.append(-1, np.flatnonzero(np.isnan(way)))
    begin = np.maximum(np.append(0, at[:-1]), gaps[np.searchsorted(gaps, at) - 1] + 1)
    places, length = _ranges(begin, at)
    heights = way[places] * np.repeat(sides[at], length)
    firsts = np.cumsum(length) - length
    lowest = np.repeat(np.minimum.reduceat(heights, firsts), length)
    extreme = np.maximum.reduceat(np.where(heights <= lowest + STILL, places, -1), firsts)
    places, length = _ranges(extreme + 1, at)
    found[places] = np.repeat(sides[at], length)
    return found


def _ranges(begin: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the whole numbers of (n,) ranges, one range after the other, and the (n,) length of each."""
    length = np.maximum(end - begin, 0)
    return np.repeat(begin - np.cumsum(length) + length, length) + np.arange(length.sum()), length


def _with_passages(
    passages: Sequence[Passage], motion: np.ndarray, way: np.ndarray, axis: int
) -> tuple[np.ndarray, np.ndarray | slice]:
    """Return one axis's positions with those of passed-through lines inserted, and which are the original ones."""
    moved = [passage for passage in passages if passage.moved[axis]]
    if not moved:
        return way, slice(None)
    at = np.searchsorted(motion, [passage.before for passage in moved], side="left")
    places = np.insert(way, at, [passage.commands[axis] for passage in moved])
    return places, np.insert(np.ones(len(way), dtype=bool), at, False)
