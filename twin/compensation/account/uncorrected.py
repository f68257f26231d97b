"""Finds the blocks that a compensation could not correct, or not to within the tolerance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from twin.compensation.account.shortfalls import FoundShortfalls
from twin.compensation.bench import Bench
from twin.compensation.solving import Corrected
from twin.kinematics.inverse import SLACK

UNSOLVED_UM: Final = 0.01
"""More left by the solver than this is no solution; it usually leaves a thousandth of it."""


def uncorrected(corrected: Corrected, left_um: Mapping[str, np.ndarray]) -> Iterator[FoundShortfalls]:
    """What of a program, or of a stretch of it, could not be corrected.

    Args:
        corrected: the stretch.
        left_um: (rows,) how far the point is off at the ends behind the context, by ``rounding`` and ``solver``.
    """
    yield from _beyond_range(corrected, left_um["rounding"])
    yield from _off_in_orientation(corrected)
    if corrected.pieces.bench.thesis is None:
        yield from _not_solved(corrected, left_um["solver"])
        yield from _off_between(corrected)
        yield from _beginning_off(corrected)


def _allowed_um(bench: Bench) -> float:
    """The tolerance, and what rounding to the least increment leaves on top of it."""
    return 1e3 * (bench.options.tolerance_mm + 0.5 * float(np.linalg.norm(bench.increment[:3])))


def _cutting(corrected: Corrected) -> np.ndarray:
    return ~corrected.pieces.path.columns.rapid


def _beyond_range(corrected: Corrected, off_um: np.ndarray) -> Iterator[FoundShortfalls]:
    """Blocks a command of which leaves the range of an axis; ``off_um``: (rows,) how far the point is off at their ends."""
    bench, rows = corrected.pieces.bench, corrected.own
    machine = bench.machine
    ranges = machine.limits / machine.scale[:, None]
    for left, asked, limits in ((rows.untouched, rows.nominal, ranges), (rows.clamped, rows.exact, bench.limits)):
        at = np.flatnonzero(left)
        beyond = np.maximum(limits[:, 0] - asked[at], asked[at] - limits[:, 1])
        beyond = np.where(beyond > SLACK, beyond, 0.0)
        for axes in np.unique(beyond > 0.0, axis=0):
            which = np.flatnonzero(((beyond > 0.0) == axes).all(axis=1))
            names = " ".join(axis.name for axis, out in zip(machine.axes, axes, strict=True) if out)
            of = rows.motion[at[which]]
            lines, cuts = corrected.lines[of], _cutting(corrected)[of]
            if left is rows.clamped:
                off = off_um[at[which]]
                reason = f"the compensated position is beyond the end of {names or 'an axis'}: stopped at the limit"
                yield FoundShortfalls("range", reason, "um", lines, off, cuts & (off > _allowed_um(bench)))
            else:
                what = f"outside the range of {names}" if names else "the way leaves the range of an axis"
                unit = machine.axes[int(np.argmax(axes))].unit
                yield FoundShortfalls("range", f"{what}: left as written", unit, lines, beyond[which].max(axis=1), cuts)


def _off_in_orientation(corrected: Corrected) -> Iterator[FoundShortfalls]:
    rows, scope = corrected.own, corrected.pieces.aim.scope
    at = np.flatnonzero(rows.singular & ~rows.untouched)
    why = np.array([_why_not(corrected.pieces.bench, rows.commands[row]) for row in at], dtype=object)
    for reason in dict.fromkeys(why.tolist()):
        which = at[why == reason]
        of = rows.motion[which]
        missed = _cutting(corrected)[of] & (scope.explicit and scope.orientation)
        reason = f"orientation not corrected: {reason}"
        yield FoundShortfalls(
            "orientation", reason, "urad", corrected.lines[of], rows.orientation_left[which] * 1e6, missed
        )


def _why_not(bench: Bench, commands: np.ndarray) -> str:
    """Why the rotary axes cannot repair an orientation at these commands."""
    for i in bench.machine.rotary:
        axis = bench.machine.axes[i]
        for limit in bench.limits[i]:
            if abs(commands[i] - limit) < axis.increment:
                return f"{axis.name} stands at its limit of {limit:g}°"
    return f"near a singular pose, it would take more than {bench.options.rotary_limit_deg:g}° of a rotary axis"


def _not_solved(corrected: Corrected, off_um: np.ndarray) -> Iterator[FoundShortfalls]:
    """Blocks for which no commands were found that reach the point; ``off_um``: (rows,) how far it is off."""
    rows = corrected.own
    at = np.flatnonzero(~rows.untouched & ~rows.clamped & ~(off_um <= UNSOLVED_UM))
    of, size = rows.motion[at], np.nan_to_num(off_um[at], nan=np.inf)
    reason = "no commands found that reach the point"
    yield FoundShortfalls("tolerance", reason, "um", corrected.lines[of], size, _cutting(corrected)[of])


def _off_between(corrected: Corrected) -> Iterator[FoundShortfalls]:
    """Blocks off by more than the tolerance between their ends."""
    pieces, rows = corrected.pieces, corrected.rows
    left, count = corrected.between.left(rows) * 1e3, pieces.count(rows)
    left[rows.motion[rows.clamped | rows.untouched]] = 0.0
    left[: corrected.context] = 0.0
    over = np.flatnonzero(left > 1e3 * pieces.bench.options.tolerance_mm)
    for pieces_each in np.unique(count[over]).tolist():
        which = over[count[over] == pieces_each]
        reason = f"off between its ends, after splitting in {pieces_each}"
        yield FoundShortfalls("tolerance", reason, "um", corrected.lines[which], left[which], np.full(len(which), True))


def _beginning_off(corrected: Corrected) -> Iterator[FoundShortfalls]:
    """Blocks that begin where the axes were left uncorrected."""
    begins = np.flatnonzero(corrected.between.begins_off(corrected.rows))
    begins = begins[begins >= corrected.context]
    if begins.size:
        off = corrected.between.left_as_run(begins, corrected.rows) * 1e3
        which = off > _allowed_um(corrected.pieces.bench)
        reason = "begins where the axes stand uncorrected"
        yield FoundShortfalls(
            "tolerance", reason, "um", corrected.lines[begins[which]], off[which], np.full(which.sum(), True)
        )
