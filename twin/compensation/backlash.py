"""The side every axis comes from as a program runs, for reversals: what a machine makes of commands, and what to command.

A *side* is the effects' ``approach_<axis>``: +1 come to from below, −1 from above, 0 not known: an axis that has not moved yet, or
that a line passed through as written has left in a place unknown. What a rapid does between its ends is the control's own affair: the
side at its end is that of the way from its start.

**What the machine does** (`LostMotion.sides`). Lost motion (a negative size: the axis lags) is play: the axis stands still until its
command has come back by the size, so that the side changes over that way and not at once (the play operator of Krasnosel'skii and
Pokrovskii, 1989). A positive size, the axis jumping ahead, is no play but a control that compensates too much: it does so at once when
the command turns, and that is the model.

**What to command** (`LostMotion.turned`). The inverse of play is a step of the size at every turn of the way the axis is really to go,
however short the way back. That way is the corrected one: where the program holds an axis still and the correction of a straightness
moves it back by some micrometres, play would swallow them. A way back of less than `TURN` least increments is no turn: the rounding of
words makes as much. So what this rule leaves is that much.
"""

from __future__ import annotations

from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.units import UM, URAD
from twin.compensation.toolpath import Path
from twin.machine.calibration import Calibration
from twin.machine.effects import ControlCorrection, Reversal, ReversalCurve

STILL: Final = 1e-6
"""mm or degrees: closer than this an axis stands still; the control's kinematics are solved to a thousandth of it."""

UNEVEN: Final = 0.05
"""µm or µrad by which what a control takes up may change along an axis: a digit of its table."""

NOTHING: Final = 1e-8
"""mm or degrees: a reversal the control takes up whole, but for rounding."""

TURN: Final = 1.5
"""Least increments: an axis that comes back by more has turned. Not by one, which is rounding, and by two for certain."""


@final
class LostMotion:
    """The reversals of a calibration, less what the control takes up by itself.

    Args:
        calibration: the machine's errors; only its reversals matter, and tables of the control that differ by direction.

    Attributes:
        size: (axes,) of each axis, mm and degrees; 0 where it has none or the control takes it up.
        axes: indices of the axes that have one, or whose direction an empirical effect depends on: that changes at the turn, at once.

    Raises:
        InputError: a table of the control whose two directions differ by more in one place than in another.
    """

    def __init__(self, calibration: Calibration) -> None:
        machine = calibration.machine
        ranges = {axis.name: axis.domain for axis in machine.axes}
        self.size = np.zeros(len(machine.axes))
        turning = {name for effect in calibration.empirical for name in effect.directed}
        for effect in calibration.effects:
            if isinstance(effect, Reversal):
                size = effect.size
            elif isinstance(effect, ReversalCurve):
                # The play is as wide as the lost motion is at its largest; by how much the axis is off is asked of the effect itself.
                size = max(effect.reversal_range(), key=abs)
            elif isinstance(effect, ControlCorrection):
                low, high = effect.reversal_range(ranges)
                if high - low > UNEVEN:
                    raise InputError(
                        f"a table of the control takes up a reversal of {effect.axis.name} that changes along the axis",
                        expected="the same difference between both directions everywhere: the rest cannot be taken up by a program",
                        value=f"{low:.2f} to {high:.2f}",
                    )
                size = 0.5 * (low + high)
            else:
                continue
            axis = effect.axis
            self.size[machine.names.index(axis.name)] += size * (UM if axis.linear else URAD) / axis.scale
        self.size[np.abs(self.size) < NOTHING] = 0.0
        self.axes = [i for i, name in enumerate(machine.names) if self.size[i] != 0.0 or name in turning]
        self._dead_band = TURN * np.array([axis.increment for axis in machine.axes])

    def sides(self, path: Path, motion: np.ndarray, commands: np.ndarray) -> np.ndarray:
        """What the machine makes of commands as they are given, one after the other.

        Args:
            path: the program they belong to, for what it passes through between its motions.
            motion: (n,) index of the motion each belongs to, ascending.
            commands: (n, axes) mm and degrees.

        Returns:
            (n, axes) sides, from −1 to +1.
        """
        found = np.zeros(commands.shape)
        for axis in self.axes:
            way, own = _with_passages(path, motion, commands[:, axis], axis)
            lag = self.size[axis] < 0.0
            found[:, axis] = (_play(way, -self.size[axis])[0] if lag else self._held(way, axis))[own]
        return found

    def turned(self, path: Path, motion: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """The sides to command for: as `sides`, of where the axes are really to be.

        Returns:
            (n, axes) +1, −1 or 0 on the way to each; it changes right behind the furthest point of a turn, the last of equals.
        """
        found = np.zeros(wanted.shape)
        for axis in self.axes:
            way, own = _with_passages(path, motion, wanted[:, axis], axis)
            found[:, axis] = _from_the_turn(way, self._held(way, axis))[own]
        return found

    def _held(self, way: np.ndarray, axis: int) -> np.ndarray:
        return _play(way, self._dead_band[axis])[1]


def _play(way: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Where in its play an axis is, and the end of its play it was at last.

    Args:
        way: (n,) positions, NaN where not known.
        width: the play, in the same unit.

    Returns:
        (n,) from −1 to +1, changing over a way of ``width``; 0 until it moves, and again where the position is not known. (n,) +1, −1,
        or 0 before it was at one end.
    """
    rate = 2.0 / width
    state = side = 0.0
    last = np.nan
    states, sides = [], []
    for place in way.tolist():
        if place != place:
            state = side = 0.0
        elif last == last:
            state = min(1.0, max(-1.0, state + rate * (place - last)))
            if state in (-1.0, 1.0):
                side = state
        last = place
        states.append(state)
        sides.append(side)
    return np.array(states), np.array(sides)


def _from_the_turn(way: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Sides that are known a little late, taken back to the furthest point before."""
    found = sides.copy()
    unknown = np.flatnonzero(np.isnan(way))
    first = 0
    for at in np.flatnonzero(np.diff(sides) != 0.0) + 1:
        side = sides[at]
        if side == 0.0:
            continue
        gaps = unknown[: np.searchsorted(unknown, at)]
        first = max(first, int(gaps[-1]) + 1 if gaps.size else 0)
        window = way[first:at] * side
        first += int(np.flatnonzero(window <= window.min() + STILL)[-1])
        found[first + 1 : at] = side
    return found


def _with_passages(path: Path, motion: np.ndarray, way: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """One axis's positions with those of the passages between, and which are its own."""
    moved = [passage for passage in path.passages if passage.moved[axis]]
    at = np.searchsorted(motion, [passage.before for passage in moved], side="left")
    places = np.insert(way, at, [passage.commands[axis] for passage in moved])
    return places, np.insert(np.ones(len(way), dtype=bool), at, False)
