"""Candidate: a delay between positions and readings of a moving axis, with velocities from the feed or from the times of rows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from twin._common.units import UM
from twin.diagnosis.candidates.candidate import Candidate, CandidateInputs, CandidateSource, Catalogue, Variant
from twin.diagnosis.candidates.signatures import along_command, tabulated_column
from twin.machine.effects.specification import NOTHING, REST, Advice, Specification
from twin.machine.machine import Machine
from twin.measurement.table import Measurements

IN_MOTION: Final = 1.0
"""s: rows at shorter intervals, while an axis moves, count as sampled in motion."""

TIME_SKEW: Final = Specification(
    name="time_skew",
    kind="instrument",
    title=lambda where: f"readings and positions of {where} not taken at the same moment",
    family="delay between readings and positions",
    advice=Advice(
        "Metrology: synchronisation of readings and positions of {axis}: trigger, filter, delay of the instrument.",
        f"{REST} Better, measure again at standstill, or at half the feed.",
        NOTHING,
    ),
    evidence=lambda of: (
        f"readings and positions of {of.where} were taken {abs(of.size):.3g} {of.unit} apart while it moved"
    ),
    limits={"s": 1.0},
)


def velocities(data: Measurements, machine: Machine) -> Mapping[str, np.ndarray]:
    """Return the velocity (n,) in mm/s or °/s of each axis that moved while it was measured; other axes are left out.

    The feed is the speed along the path of the linear axes, in the direction from the previous row. A row where nothing moved has the
    direction of the one before, a first row that of the next. The direction of approach, where given, sets the sign.
    """
    timed = bool(np.all(np.isfinite(data.time_s)))
    order = np.argsort(data.time_s, kind="stable") if timed else np.arange(len(data))
    q = data.positions[order]
    step = np.diff(q, axis=0, prepend=q[:1])
    interval = np.diff(data.time_s[order], prepend=data.time_s[order][:1]) if timed else np.full(len(q), np.inf)
    moved = np.any(step != 0.0, axis=1)
    in_motion = moved & (interval > 0.0) & (interval < IN_MOTION)
    last = np.maximum.accumulate(np.where(moved, np.arange(len(q)), int(np.argmax(moved))))
    direction = step[last]
    linear = [axis.linear for axis in machine.axes]
    path = np.linalg.norm(direction[:, linear], axis=1)
    feed = np.nan_to_num(data.feed_mm_min[order]) / 60.0
    along = np.where(path > 0.0, feed / np.where(path > 0.0, path, 1.0), 0.0)
    found = direction * along[:, None]
    found = np.where(in_motion[:, None], step / np.where(in_motion, interval, 1.0)[:, None], found)
    side = data.approach[order]
    found = np.where(side != 0.0, np.abs(found) * side, found)
    velocity = np.empty_like(found)
    velocity[order] = found
    return {axis.name: velocity[:, i] for i, axis in enumerate(machine.axes) if np.any(velocity[:, i] != 0.0)}


def time_skews(inputs: CandidateInputs) -> Catalogue:
    """Return a candidate for every axis that moved: the readings are displaced by velocity times delay."""
    machine, moving = inputs.machine, velocities(inputs.data, inputs.machine)
    found, missing = [], []
    for axis in machine.axes:
        if axis.name in moving:
            displacement = moving[axis.name] * axis.scale / UM
            column = tabulated_column({i: displacement * part for i, part in along_command(machine, axis)})
            found.append(Candidate(TIME_SKEW, axis.name, (("delay", "s"),), (Variant((column,)),), 1.0))
        elif not np.any(np.isfinite(inputs.data.feed_mm_min)):
            missing.append((TIME_SKEW.name, axis.name, "feed_mm_min"))
    return Catalogue(tuple(found), tuple(missing))


SOURCE: Final = CandidateSource((TIME_SKEW,), time_skews)
