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
from twin.measurement.state import has_times, order_in_time
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

    The feed is the speed along the path of the linear axes. Its direction is the mean of those from the previous row and to the next
    one of the round, which is the tangent of a circle read at equal steps; from the previous row alone it would lag by half a step. A
    row where nothing moved has the direction of the one before. The direction of approach, where given, sets the sign.
    """
    timed, order = has_times(data), order_in_time(data)
    q = data.positions[order]
    step = np.diff(q, axis=0, prepend=q[:1])
    interval = np.diff(data.time_s[order], prepend=data.time_s[order][:1]) if timed else np.full(len(q), np.inf)
    moved = np.any(step != 0.0, axis=1)
    in_motion = moved & (interval > 0.0) & (interval < IN_MOTION)
    last = np.maximum.accumulate(np.where(moved, np.arange(len(q)), int(np.argmax(moved))))
    linear = [axis.linear for axis in machine.axes]
    direction = _tangent(step[last], np.linalg.norm(step[last][:, linear], axis=1), data.round[order])
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


def _tangent(step: np.ndarray, length: np.ndarray, rounds: np.ndarray) -> np.ndarray:
    """Return (n, axes) directions at the rows from the steps that lead to them.

    The mean of the steps before and after a row, where both are of one round and not opposite; at the ends of a round the direction is
    extrapolated. A row between opposite steps, or of a short round, has the direction of the step before it.
    """
    unit = step / np.where(length > 0.0, length, 1.0)[:, None]
    found = unit.copy()
    ends = np.flatnonzero(np.append(True, rounds[1:] != rounds[:-1]))
    for first, end in zip(ends, [*ends[1:], len(unit)], strict=True):
        own = unit[first + 1 : end]  # the step to the first row is of another round
        if len(own) < 2:
            continue
        ends_on = [2.0 * own[i] - own[j] if own[i] @ own[j] > 0.0 else own[i] for i, j in ((0, 1), (-1, -2))]
        before, after = np.concatenate([[ends_on[0]], own]), np.concatenate([own, [ends_on[1]]])
        smooth = np.einsum("ni,ni->n", before, after) > 0.0
        found[first] = after[0]
        found[first:end][smooth] = (before + after)[smooth]
    return found


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
