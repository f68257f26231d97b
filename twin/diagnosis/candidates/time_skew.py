"""How fast each axis moved when a point was read: from the feed of the table, or from times where it was sampled on the fly."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from twin._common.units import UM
from twin.diagnosis.candidates.candidate import Candidate, CandidateSource, Catalogue, Cell, CandidateInputs
from twin.diagnosis.candidates.signatures import along_command, tabulated_column
from twin.machine.effects.specification import NOTHING, REST, Advice, Specification
from twin.machine.machine import Machine
from twin.measurement.table import Measurements

ON_THE_FLY: Final = 1.0
"""s: rows that follow one another faster, while an axis moves, were read on the way."""

TIME_SKEW: Final = Specification(
    name="time_skew",
    kind="instrument",
    title=lambda where: f"readings and positions of {where} not taken at the same moment",
    family="delay between readings and positions",
    advice=Advice(
        "Who measured: how readings and positions of {axis} are brought together: trigger, filter, delay of the instrument.",
        f"{REST} Better, measure again at standstill, or at half the feed.",
        NOTHING,
    ),
    evidence=lambda of: (
        f"readings and positions of {of.where} were taken {abs(of.size):.3g} {of.unit} apart while it moved"
    ),
    largest={"s": 1.0},
)


def velocities(data: Measurements, machine: Machine) -> Mapping[str, np.ndarray]:
    """(n,) mm or degrees a second of each axis that moved while it was read; axes without any are left out.

    The feed holds along the path of the linear axes, whose share of it is that of the way from the row before. A row where nothing
    moved was read on the same way as the one before, and the first as the next. The side of approach, where it is given, is the
    direction.
    """
    timed = bool(np.all(np.isfinite(data.time_s)))
    order = np.argsort(data.time_s, kind="stable") if timed else np.arange(len(data))
    q = data.positions[order]
    step = np.diff(q, axis=0, prepend=q[:1])
    passed = np.diff(data.time_s[order], prepend=data.time_s[order][:1]) if timed else np.full(len(q), np.inf)
    moved = np.any(step != 0.0, axis=1)
    fly = moved & (passed > 0.0) & (passed < ON_THE_FLY)
    last = np.maximum.accumulate(np.where(moved, np.arange(len(q)), int(np.argmax(moved))))
    way = step[last]
    linear = [axis.linear for axis in machine.axes]
    path = np.linalg.norm(way[:, linear], axis=1)
    feed = np.nan_to_num(data.feed_mm_min[order]) / 60.0
    along = np.where(path > 0.0, feed / np.where(path > 0.0, path, 1.0), 0.0)
    found = way * along[:, None]
    found = np.where(fly[:, None], step / np.where(fly, passed, 1.0)[:, None], found)
    side = data.approach[order]
    found = np.where(side != 0.0, np.abs(found) * side, found)
    back = np.empty_like(found)
    back[order] = found
    return {axis.name: back[:, i] for i, axis in enumerate(machine.axes) if np.any(back[:, i] != 0.0)}


def time_skews(inputs: CandidateInputs) -> Catalogue:
    """What a second between a position and its reading does: the axis had gone on by its velocity."""
    machine, moving = inputs.machine, velocities(inputs.data, inputs.machine)
    found, missing = [], []
    for axis in machine.axes:
        if axis.name in moving:
            gone_on = moving[axis.name] * axis.scale / UM
            column = tabulated_column({i: gone_on * part for i, part in along_command(machine, axis)})
            found.append(Candidate(TIME_SKEW, axis.name, (("delay", "s"),), (Cell((column,)),), 1.0))
        elif not np.any(np.isfinite(inputs.data.feed_mm_min)):
            missing.append((TIME_SKEW.name, axis.name, "feed_mm_min"))
    return Catalogue(tuple(found), tuple(missing))


SOURCE: Final = CandidateSource((TIME_SKEW,), time_skews)
