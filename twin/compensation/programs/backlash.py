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

STANDING_STILL: Final = 1e-6
"""Distance (mm, degrees) below which an axis stands still; the control's kinematics are solved to a thousandth of it."""

LARGEST_VARIATION: Final = 0.05
"""Largest variation along an axis (µm, µrad) of the reversal value that a control's table corrects: one digit of the table."""

NEGLIGIBLE_REVERSAL: Final = 1e-8
"""Reversal value (mm, degrees) below which the control corrects it fully, apart from rounding."""

AT_END: Final = 1e-8
"""Distance from an end of the play, as a share of half of it, at which the end counts as reached: rounding of positions of metres in a
play of a micrometre is a hundredth of it.
"""

LEAST_REVERSAL: Final = 1.5
"""Least increments by which an axis must come back to count as reversed: one is rounding, two are a reversal."""


@final
class Backlash:
    """The reversal values of a calibration, less those corrected by the control itself.

    ``size``: (axes,) mm and degrees; 0 if an axis has none. ``axes``: indices of those that have one, or on whose direction an
    empirical effect depends, which changes at once when the axis reverses. `InputError` if the difference between both directions in a
    table of the control varies along the axis.
    """

    def __init__(self, calibration: Calibration) -> None:
        machine = calibration.machine
        ranges = {axis.name: axis.domain for axis in machine.axes}
        self.size = np.zeros(len(machine.axes))
        turning = {name for effect in calibration.empirical for name in effect.directed}
        for effect in calibration.effects:
            if isinstance(effect, ControlCorrection):
                low, high = effect.reversal_range(ranges)
                if high - low > LARGEST_VARIATION:
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
        self.size[np.abs(self.size) < NEGLIGIBLE_REVERSAL] = 0.0
        self.axes = [i for i, name in enumerate(machine.names) if self.size[i] != 0.0 or name in turning]
        self._dead_band = LEAST_REVERSAL * np.array([axis.increment for axis in machine.axes])

    def sides(self, path: ToolPath, motion: np.ndarray, commands: np.ndarray) -> np.ndarray:
        """Return the (n, axes) approach directions, from −1 to +1, that result from (n, axes) commands given one after the other.

        ``path``: for lines between its motions that are passed through; ``motion``: (n,) index of the motion of each, ascending.
        """
        return ApproachTracker(self, path).after(motion, commands)

    def width(self, axis: int) -> float:
        """Return the distance over which an axis reverses: its backlash, or the dead band if it changes its side at once."""
        return float(-self.size[axis] if self.size[axis] < 0.0 else self._dead_band[axis])

    def commanded_sides(self, path: ToolPath, motion: np.ndarray, intended: np.ndarray) -> np.ndarray:
        """Return the sides, +1, −1 or 0, to command for on the way to each intended axis position; arguments as for `sides`.

        They change directly after the extreme point of a reversal, the last one of equal points.
        """
        commanded_sides = np.zeros(intended.shape)
        for axis in self.axes:
            way, own = _with_passages(path.passages, motion, intended[:, axis], axis)
            commanded_sides[:, axis] = _from_reversal(way, _play(way, self._dead_band[axis])[1])[own]
        return commanded_sides


@final
class ApproachTracker:
    """Approach directions that result from commands given one after the other, in one portion or several."""

    def __init__(self, backlash: Backlash, path: ToolPath) -> None:
        self._backlash, self._passages = backlash, path.passages
        # Position, position within the play, and end of it last reached, of every axis.
        self._last = np.tile([np.nan, 0.0, 0.0], (len(backlash.size), 1))
        self._motion = -1

    def after(self, motion: np.ndarray, commands: np.ndarray) -> np.ndarray:
        """Return the approach directions at the next positions; arguments and result as for `Backlash.sides`."""
        sides = np.zeros(commands.shape)
        if not len(motion):
            return sides
        between = [passage for passage in self._passages if self._motion < passage.before <= motion[-1]]
        for axis in self._backlash.axes:
            way, own = _with_passages(between, motion, commands[:, axis], axis)
            state, side = _play(way, self._backlash.width(axis), *self._last[axis])
            self._last[axis] = way[-1], state[-1], side[-1]
            sides[:, axis] = (state if self._backlash.size[axis] < 0.0 else side)[own]
        self._motion = int(motion[-1])
        return sides


def _play(
    way: np.ndarray, width: float, start: float = np.nan, begun: float = 0.0, reached: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return (n,) the position of an axis within its play, −1 to +1, and (n,) the end of it last reached, +1, −1 or 0 for none.

    The position is 0 until the axis moves, and again where it is unknown (NaN in ``way``). ``start``, ``begun``, ``reached``: before
    the first.

    A step moves the position and stops it at the ends: x → min(high, max(low, x + shift)). Steps one after the other are again of this
    form, so those of 1, 2, 4, … steps are made of those of half as many, for all positions at once (Hillis and Steele, 1986).
    """
    step = np.diff(way, prepend=start)
    moves = np.flatnonzero(step != 0.0)  # gaps are NaN, and unequal to zero
    gap = np.isnan(step[moves])
    shift = np.where(gap, 0.0, step[moves] * (2.0 / width))
    low, high = np.where(gap, 0.0, -1.0), np.where(gap, 0.0, 1.0)
    back = 1
    while back < len(moves) and (low[back:] < high[back:]).any():
        before = shift[:-back], low[:-back], high[:-back]
        after = shift[back:].copy(), low[back:].copy(), high[back:].copy()
        shift[back:] = before[0] + after[0]
        low[back:], high[back:] = (np.clip(end + after[0], after[1], after[2]) for end in before[1:])
        back *= 2
    state = np.clip(begun + shift, low, high)
    state = np.where(np.abs(state) > 1.0 - AT_END, np.sign(state), state)
    says = np.maximum.accumulate(np.where(gap | (np.abs(state) == 1.0), np.arange(len(moves)), -1))
    side = np.where(says >= 0, state[says], reached) if len(moves) else state
    last = np.cumsum(step != 0.0)
    return np.append(begun, state)[last], np.append(reached, side)[last]


def _from_reversal(way: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Return sides that are detected late, moved back to the preceding extreme point."""
    moved = sides.copy()
    at = np.flatnonzero(np.diff(sides) != 0.0) + 1
    at = at[sides[at] != 0.0]
    if not at.size:
        return moved
    # The extreme point lies behind the detection of the reversal before, which is behind the extreme point of that one.
    gaps = np.append(-1, np.flatnonzero(np.isnan(way)))
    begin = np.maximum(np.append(0, at[:-1]), gaps[np.searchsorted(gaps, at) - 1] + 1)
    places, length = _ranges(begin, at)
    heights = way[places] * np.repeat(sides[at], length)
    firsts = np.cumsum(length) - length
    lowest = np.repeat(np.minimum.reduceat(heights, firsts), length)
    extreme = np.maximum.reduceat(np.where(heights <= lowest + STANDING_STILL, places, -1), firsts)
    places, length = _ranges(extreme + 1, at)
    moved[places] = np.repeat(sides[at], length)
    return moved


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
