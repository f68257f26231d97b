"""What a reader of the account must know beside the numbers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from twin.compensation.account.report import LineNote, ReversalNote
from twin.compensation.bench import Bench, CorrectionAim
from twin.compensation.solving import Corrected
from twin.machine.conditions import TIME, Listening

WARM_UP_S: Final = 600.0
"""Over which it is said how far a warm-up goes on."""


def of_setup(bench: Bench, *, all_tcp: bool, any_tcp: bool) -> Iterator[LineNote]:
    """Offsets the user gave that this program has no words for: better said than silently ignored.

    Args:
        bench: machine, calibration, options.
        all_tcp: whether all words of the program are tool-tip coordinates.
        any_tcp: whether any are.
    """
    setup = bench.options.setup
    if all_tcp and any(setup.work_offset.get(name) for name in bench.space.axes.linear):
        text = "work offsets of linear axes are not used: the words are tool-tip coordinates (--work-origin)"
        yield LineNote(1, text)
    if not any_tcp and any(setup.work_origin_mm):
        yield LineNote(1, "the work origin is not used: the words are axis positions (--work-offset)")


def of_channels(bench: Bench) -> Iterator[LineNote]:
    """What a reader must know of temperatures and time."""
    conditions = bench.options.conditions
    for name in conditions.unused(bench.calibration):
        yield LineNote(1, f"{name} was given and the calibration does not need it")
    if conditions.time_s is None:
        return
    for effect in bench.calibration.effects:
        now, later = Listening(bench.machine), Listening(bench.machine)
        now[TIME], later[TIME] = np.array([conditions.time_s]), np.array([conditions.time_s]) + WARM_UP_S
        before, after = effect.components(now), effect.components(later)
        grown = np.sqrt(sum((after[i] - before[i]) ** 2 for i in before if i < 3))
        if np.any(grown >= 0.1):
            size, minutes = f"{float(grown[0]):.1f} µm", f"{WARM_UP_S / 60:g}"
            yield LineNote(1, f"{effect.name} goes on by {size} in the {minutes} minutes after --time")


def of_sides(corrected: Corrected) -> Iterator[LineNote]:
    """Where the side an axis comes from is not known, and what taking up a reversal looks like."""
    bench, rows = corrected.pieces.bench, corrected.own
    for axis in corrected.pieces.aim.lost.axes:
        name = bench.machine.axes[axis].name
        blocks = np.unique(rows.motion[(rows.approach[:, axis] == 0.0) & ~rows.untouched])
        if blocks.size:
            where = "here" if len(blocks) == 1 else f"in {len(blocks)} blocks from here on"
            yield LineNote(
                int(corrected.lines[blocks[0]]),
                f"the program has not said from which side {name} comes {where}: taken as the middle of its reversal",
            )
        if bench.lost.size[axis] > 0.0 and np.any(rows.taken):
            yield LineNote(
                1,
                f"the reversal of {name} is positive (it jumps ahead when it turns): taking it up moves {name} beyond the "
                "turning point for a moment, by its size and three increments",
            )


def of_reversals(bench: Bench, aim: CorrectionAim, taken_up: np.ndarray) -> Iterator[ReversalNote]:
    """What was done about every reversal of the calibration; ``taken_up`` (axes,): at how many turns."""
    for i in np.flatnonzero(bench.lost.size).tolist():
        axis = bench.machine.axes[i]
        unit, scale = ("um", 1e3) if axis.linear else ("urad", axis.scale * 1e6)
        yield ReversalNote(axis.name, unit, float(bench.lost.size[i] * scale), i in aim.lost.axes, int(taken_up[i]))
