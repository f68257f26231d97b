"""Find the blocks that a compensation could not correct, or not within the tolerance."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from twin._common.arrays import distinct
from twin.compensation.account.shortfalls import FoundShortfalls, Shortfall
from twin.compensation.prepared import PreparedMachine
from twin.compensation.solving import Corrected
from twin.compensation.toolpath import INCREMENTS, LostBlock, by_reason, numbers_of_increments
from twin.kinematics.inverse import SLACK

UNSOLVED_UM: Final = 0.01
"""Largest residual (µm) accepted as a solution; the solver usually leaves a thousandth of it."""


def uncorrected(corrected: Corrected, residual_um: Mapping[str, np.ndarray]) -> Iterator[FoundShortfalls]:
    """Yield the blocks of a program, or of a stretch of it, that could not be corrected, by reason.

    Args:
        corrected: the stretch.
        residual_um: by cause (``rounding``, ``solver``), (rows,) distance in µm of the tool point from its target at the end points
            after the context.
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
    """Return blocks outside the range of an axis with a hint if a number of the worst one may count increments.

    Args:
        shortfall: the blocks.
        text_of: function that returns the text of a line by its number; empty where numbers never count increments.
    """
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
    """Yield blocks whose commands leave the range of an axis.

    Args:
        corrected: the stretch.
        off_um: (rows,) distance of the tool point from its target at the end points, µm.
    """
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
    found = np.full(len(commands), default, dtype=object)
    limits = [(i, limit) for i in prepared.machine.rotary for limit in prepared.limits[i].tolist()]
    for i, limit in limits[::-1]:
        axis = prepared.machine.axes[i]
        found[np.abs(commands[:, i] - limit) < axis.increment] = f"{axis.name} is at its limit of {limit:g}°"
    return found


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
