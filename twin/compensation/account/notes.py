"""Notes of the report: settings that were ignored, conditions that change, assumptions about backlash."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from twin._common.records import TIME
from twin.compensation.account.report import LineNote, ReversalNote
from twin.compensation.prepared import CorrectionAim, PreparedMachine
from twin.compensation.solving import Corrected
from twin.machine.effects.base import RecordingState

WARM_UP_S: Final = 600.0
"""Time over which the further change of a thermal effect is reported, s."""


def setup_notes(prepared: PreparedMachine, *, all_tcp: bool, any_tcp: bool) -> Iterator[LineNote]:
    """Yield a note for every work offset or origin that was given but does not apply to this program."""
    setup = prepared.options.setup
    if all_tcp and any(setup.work_offset.get(name) for name in prepared.space.axes.linear):
        text = (
            "work offsets of linear axes are ignored: the words are tool-tip coordinates, which the work origin shifts"
        )
        yield LineNote(1, text)
    if not any_tcp and any(setup.work_origin_mm):
        yield LineNote(1, "the work origin is ignored: the words are axis positions, which work offsets shift")


def condition_notes(prepared: PreparedMachine, by_block: str) -> Iterator[LineNote]:
    """Yield notes on temperatures and time: values that no effect uses, and effects that still change considerably.

    Args:
        prepared: machine, calibration and options.
        by_block: the conditions that changed during the program, in words; empty if none did.
    """
    conditions = prepared.options.conditions
    if by_block:
        yield LineNote(1, by_block)
    for name in conditions.unused(prepared.calibration):
        yield LineNote(1, f"{name} was given and the calibration does not need it")
    if conditions.time_s is None or TIME in prepared.by_block:
        return
    for effect in prepared.calibration.effects:
        now, later = RecordingState(prepared.machine), RecordingState(prepared.machine)
        now[TIME], later[TIME] = np.array([conditions.time_s]), np.array([conditions.time_s]) + WARM_UP_S
        before, after = effect.components(now), effect.components(later)
        grown = np.sqrt(sum((after[i] - before[i]) ** 2 for i in before if i < 3))
        if np.any(grown >= 0.1):
            size, minutes = f"{float(grown[0]):.1f} µm", f"{WARM_UP_S / 60:g}"
            yield LineNote(
                1, f"{effect.name} changes by a further {size} in the {minutes} minutes after the given time"
            )


def approach_notes(corrected: Corrected) -> Iterator[LineNote]:
    """Yield notes on axes whose approach direction is unknown, and on axes that overshoot while a positive reversal is taken up."""
    prepared, rows = corrected.pieces.prepared, corrected.own
    for axis in corrected.pieces.aim.backlash.axes:
        name = prepared.machine.axes[axis].name
        blocks = np.unique(rows.motion[(rows.approach[:, axis] == 0.0) & ~rows.untouched])
        if blocks.size:
            where = "in this block" if len(blocks) == 1 else f"in {len(blocks)} blocks from here on"
            yield LineNote(
                int(corrected.lines[blocks[0]]),
                f"approach direction of {name} unknown {where}: the middle of its reversal value is assumed",
            )
        if prepared.backlash.size[axis] > 0.0 and np.any(rows.backlash_move):
            yield LineNote(
                1,
                f"the reversal value of {name} is positive (the axis jumps ahead when it reverses): compensating it moves {name} "
                "briefly beyond the reversal point, by that value plus three least increments",
            )


def reversal_notes(prepared: PreparedMachine, aim: CorrectionAim, taken_up: np.ndarray) -> Iterator[ReversalNote]:
    """Yield how each reversal of the calibration was treated; ``taken_up`` (axes,): number of reversals at which it was taken up."""
    for i in np.flatnonzero(prepared.backlash.size).tolist():
        axis = prepared.machine.axes[i]
        unit, scale = ("um", 1e3) if axis.linear else ("urad", axis.scale * 1e6)
        yield ReversalNote(
            axis.name, unit, float(prepared.backlash.size[i] * scale), i in aim.backlash.axes, int(taken_up[i])
        )
