"""Finds the blocks that a compensation could not correct, or not to within the tolerance."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Final, final

import numpy as np

from twin.compensation.bench import Aim, Bench
from twin.compensation.pieces import Pieces
from twin.compensation.rows import Rows
from twin.compensation.shortfalls import Shortfall, ShortfallTally
from twin.kinematics.inverse import SLACK

UNSOLVED_UM: Final = 0.01
"""More left by the solver than this is no solution; it usually leaves a thousandth of it."""


@final
class Uncorrected:
    """What of one program could not be corrected.

    Args:
        bench: machine, calibration, options.
        aim: what was to be corrected.
    """

    def __init__(self, bench: Bench, aim: Aim) -> None:
        self.bench = bench
        self.aim = aim
        self._tally = ShortfallTally()

    def add(
        self, pieces: Pieces, rows: Rows, context: int, lines: np.ndarray, left_um: Mapping[str, np.ndarray]
    ) -> None:
        """Take a stretch of the program.

        Args:
            pieces: the stretch cut into pieces.
            rows: the commands for their ends.
            context: how many of its motions, the first ones, belong to the stretch before.
            lines: (motions,) their line numbers.
            left_um: how far the point is off at the ends behind the context, by ``rounding`` and ``solver``.
        """
        own = rows.where(slice(int(np.searchsorted(rows.motion, context)), None))
        cutting = ~pieces.path.columns.rapid
        self._note_range(own, lines, cutting, left_um["rounding"])
        self._note_orientation(own, lines, cutting)
        if self.bench.options.method != "thesis":
            self._note_not_solved(own, lines, cutting, left_um["solver"])
            self._note_between(pieces, rows, context, lines)

    def shortfalls(self) -> tuple[Shortfall, ...]:
        """Return all of them."""
        return self._tally.shortfalls()

    @cached_property
    def _allowed_um(self) -> float:
        """The tolerance, and what rounding to the least increment leaves on top of it."""
        return 1e3 * (self.bench.options.tolerance_mm + 0.5 * float(np.linalg.norm(self.bench.increment[:3])))

    def _note_range(self, rows: Rows, lines: np.ndarray, cutting: np.ndarray, off_um: np.ndarray) -> None:
        """Blocks a command of which leaves the range of an axis; ``off_um``: (rows,) how far the point is off at their ends."""
        machine = self.bench.machine
        ranges = machine.limits / machine.scale[:, None]
        for left, asked, limits in (
            (rows.untouched, rows.nominal, ranges),
            (rows.clamped, rows.exact, self.bench.limits),
        ):
            at = np.flatnonzero(left)
            beyond = np.maximum(limits[:, 0] - asked[at], asked[at] - limits[:, 1])
            beyond = np.where(beyond > SLACK, beyond, 0.0)
            for axes in np.unique(beyond > 0.0, axis=0):
                which = np.flatnonzero(((beyond > 0.0) == axes).all(axis=1))
                names = " ".join(axis.name for axis, out in zip(machine.axes, axes, strict=True) if out)
                of, cuts = rows.motion[at[which]], cutting[rows.motion[at[which]]]
                if left is rows.clamped:
                    off = off_um[at[which]]
                    reason = f"the compensated position is beyond the end of {names or 'an axis'}: stopped at the limit"
                    self._tally.add("range", reason, "um", lines[of], off, cuts & (off > self._allowed_um))
                else:
                    first = int(np.argmax(axes)) if names else 0
                    reason = (
                        f"outside the range of {names}: left as written"
                        if names
                        else "the way leaves the range of an axis: left as written"
                    )
                    self._tally.add(
                        "range", reason, machine.axes[first].unit, lines[of], beyond[which].max(axis=1), cuts
                    )

    def _note_orientation(self, rows: Rows, lines: np.ndarray, cutting: np.ndarray) -> None:
        at = np.flatnonzero(rows.singular & ~rows.untouched)
        asked = self.aim.scope.asked and self.aim.scope.orientation
        why = np.array([self._why_not(rows.commands[row]) for row in at], dtype=object)
        for reason in dict.fromkeys(why.tolist()):
            which = at[why == reason]
            of = rows.motion[which]
            self._tally.add(
                "orientation",
                f"orientation not corrected: {reason}",
                "urad",
                lines[of],
                rows.orientation_left[which] * 1e6,
                cutting[of] & asked,
            )

    def _note_not_solved(self, rows: Rows, lines: np.ndarray, cutting: np.ndarray, off_um: np.ndarray) -> None:
        """Blocks for which no commands were found that reach the point; ``off_um``: (rows,) how far it is off."""
        at = np.flatnonzero(~rows.untouched & ~rows.clamped & ~(off_um <= UNSOLVED_UM))
        of, size = rows.motion[at], np.nan_to_num(off_um[at], nan=np.inf)
        self._tally.add("tolerance", "no commands found that reach the point", "um", lines[of], size, cutting[of])

    def _why_not(self, commands: np.ndarray) -> str:
        """Why the rotary axes cannot repair an orientation at these commands."""
        for i in self.bench.machine.rotary:
            axis = self.bench.machine.axes[i]
            for limit in self.bench.limits[i]:
                if abs(commands[i] - limit) < axis.increment:
                    return f"{axis.name} stands at its limit of {limit:g}°"
        return (
            f"near a singular pose, it would take more than {self.bench.options.rotary_limit_deg:g}° of a rotary axis"
        )

    def _note_between(self, pieces: Pieces, rows: Rows, context: int, lines: np.ndarray) -> None:
        """Blocks off by more than the tolerance between their ends, and those that begin where the axes were left uncorrected."""
        left, count = pieces.left(rows) * 1e3, pieces.count(rows)
        left[rows.motion[rows.clamped | rows.untouched]] = 0.0
        left[:context] = 0.0
        over = np.flatnonzero(left > 1e3 * self.bench.options.tolerance_mm)
        for pieces_each in np.unique(count[over]).tolist():
            which = over[count[over] == pieces_each]
            reason = f"off between its ends, after splitting in {pieces_each}"
            self._tally.add("tolerance", reason, "um", lines[which], left[which], np.ones(len(which), dtype=bool))
        begins = np.flatnonzero(pieces.begins_off(rows)[context:]) + context
        if not begins.size:
            return
        off = pieces.left_as_run(begins, rows) * 1e3
        which = off > self._allowed_um
        self._tally.add(
            "tolerance",
            "begins where the axes stand uncorrected",
            "um",
            lines[begins[which]],
            off[which],
            np.ones(int(which.sum()), dtype=bool),
        )
