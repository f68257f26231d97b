"""Candidate: an axis that sticks at its reversal while the others move on, and catches up: the spikes of a ball bar's circle.

The shift along the axis is −A·sign(v)·exp(−t/τ), t the time since the reversal. A and τ depend on the feed and on the friction
compensation of the drive, so it does not enter a calibration.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from twin.diagnosis.candidates.candidate import Candidate, CandidateInputs, CandidateSource, Catalogue, Variant
from twin.diagnosis.candidates.signatures import along_command, tabulated_column
from twin.diagnosis.candidates.time_skew import velocities
from twin.machine.effects.specification import NOTHING, REST, Advice, Drawing, Specification
from twin.measurement.state import has_times, order_in_time
from twin.measurement.table import Measurements

ROWS: Final = (1.0, 2.0, 4.0, 8.0)
"""Time constants tried, in intervals between rows: shorter ones fall between the readings, longer ones are backlash."""

REVERSAL_SPIKE: Final = Specification(
    name="reversal_spike",
    kind="machine",
    title=lambda where: f"{where} sticks for a moment when it reverses",
    family="spikes at reversals",
    advice=Advice(
        "Service: friction compensation of the drive of {axis} (its amplitude and time), and the friction of its guideway.",
        f"{REST} It does not enter the calibration.",
        NOTHING,
    ),
    evidence=lambda of: (
        f"{of.where} lags by {of.measure} right after each reversal and catches up within some readings"
    ),
    limits={"um": 200.0, "urad": 2000.0},
    drawing=Drawing(by_state=True),
)


def reversal_spikes(inputs: CandidateInputs) -> Catalogue:
    """Return a candidate for every axis that reversed while it was measured in motion."""
    found = []
    for name, velocity in velocities(inputs.data, inputs.machine).items():
        since, interval = time_since_reversal(inputs.data, velocity)
        if not np.any(np.isfinite(since)):
            continue
        axis = inputs.machine.by_name[name]
        variants = []
        for rows in ROWS:
            late = -np.sign(velocity) * np.exp(-since / (rows * interval))
            column = tabulated_column({i: late * part for i, part in along_command(inputs.machine, axis)})
            variants.append(Variant((column,), {"time_constant": rows * interval}))
        names = (("amplitude", "um" if axis.linear else "urad"),)
        found.append(Candidate(REVERSAL_SPIKE, name, names, tuple(variants), 2.0))
    return Catalogue(tuple(found))


def time_since_reversal(data: Measurements, velocity: np.ndarray) -> tuple[np.ndarray, float]:
    """Return (n,) the time in s since an axis reversed, infinite before the first reversal of a round, and the interval between rows.

    Args:
        data: the measurements; rows of a round follow each other, at a known feed or at known times.
        velocity: (n,) of the axis; a reversal is taken in the middle between two rows of opposite sign.
    """
    timed, order = has_times(data), order_in_time(data)
    q, rounds = data.positions[order], data.round[order]
    step = np.linalg.norm(np.diff(q, axis=0, prepend=q[:1]), axis=1)
    feed = np.nan_to_num(data.feed_mm_min[order]) / 60.0
    by_feed = np.where(feed > 0.0, step / np.where(feed > 0.0, feed, 1.0), 0.0)
    passed = np.diff(data.time_s[order], prepend=data.time_s[order][:1]) if timed else by_feed
    own, found, elapsed = np.sign(velocity[order]), np.full(len(q), np.inf), np.inf
    for i in range(1, len(q)):
        if rounds[i] != rounds[i - 1]:
            elapsed = np.inf
        elif own[i] * own[i - 1] < 0.0:
            elapsed = 0.5 * passed[i]
        else:
            elapsed += passed[i]
        found[i] = elapsed
    since = np.empty_like(found)
    since[order] = found
    return since, float(np.median(passed[passed > 0.0])) if np.any(passed > 0.0) else 1.0


SOURCE: Final = CandidateSource((REVERSAL_SPIKE,), reversal_spikes)
