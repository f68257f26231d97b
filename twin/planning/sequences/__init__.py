"""Measuring sequences for instruments that measure the tool relative to the table: touch probe, R-test, ball bar.

A new sequence is one file with a `MeasuringSequence` and one entry in `twin._common.families.SEQUENCES`. A sequence gives rotary
positions, parts on the table and offsets; `reach` computes the linear axes from the nominal kinematics and drops the points that are
out of reach.
"""

from __future__ import annotations

from typing import Final

from twin._common import families
from twin._common.errors import InputError, closest_name
from twin.planning.sequences.contacts import (
    ContactPose,
    Reached,
    apart_clearance,
    clearance_of,
    contact_poses,
    default_place,
    reach,
)
from twin.planning.sequences.moves import NOT_DESCRIBED
from twin.planning.sequences.specification import (
    SET_UPS,
    Expectation,
    InstrumentSizes,
    MeasuringSequence,
    SequencePoints,
    SequenceTask,
    expectation,
    minutes_of,
    sequence_table,
)

SEQUENCES: Final[tuple[MeasuringSequence, ...]] = families.members(__name__, families.SEQUENCES)
"""All sequences; the first for an instrument is its default."""


def sequence_named(name: str | None, instrument: str) -> MeasuringSequence:
    """Return the sequence of a name for an instrument, the default one if None; `InputError` if it has none of this name."""
    known = [sequence for sequence in SEQUENCES if instrument in sequence.instruments]
    names = [one.name for one in known]
    if name is None and known:
        return known[0]
    if name is not None and name.lower() in NOT_DESCRIBED:
        raise InputError(
            f"test {name.upper()} of ISO 10791-6 is not included: no public description says {NOT_DESCRIBED[name.lower()]}",
            expected=f"one of {', '.join(names)}" if names else f"an instrument among {', '.join(SET_UPS)}",
        )
    if name not in names:
        raise InputError(
            f"no such sequence for instrument {instrument}",
            expected=f"one of {', '.join(names)}" if names else f"an instrument among {', '.join(SET_UPS)}",
            value=name,
            nearest=closest_name(str(name), names),
        )
    return known[names.index(name)]


__all__ = [
    "SEQUENCES",
    "SET_UPS",
    "ContactPose",
    "Expectation",
    "InstrumentSizes",
    "MeasuringSequence",
    "Reached",
    "SequencePoints",
    "SequenceTask",
    "apart_clearance",
    "clearance_of",
    "contact_poses",
    "default_place",
    "expectation",
    "minutes_of",
    "reach",
    "sequence_named",
    "sequence_table",
]
