"""Candidate causes: the frame of an instrument or a target displaced, from a round on, in one round, or in the middle of one.

With all targets of a side displaced, the side jumped: that is no known cause (`of_a_jumped_side`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from twin._common.units import UM
from twin.diagnosis.candidates.candidate import (
    Candidate,
    CandidateInputs,
    CandidateSource,
    Catalogue,
    Freedom,
    Variant,
    masked_columns,
)
from twin.diagnosis.candidates.instrument import MOST_ROUNDS
from twin.measurement.observation import order_in_time
from twin.measurement.table import Measurements
from twin.model.effects.specification import NOTHING, REST, Advice, Drawing, FittedCause, Specification

FRAME: Final[tuple[Freedom, ...]] = tuple((name, i) for name in ("station", "station turn") for i in range(3))
FEWEST_READINGS: Final = 2
"""Least number of readings of a target before and after it was displaced; a single one is an outlier."""
MOST_LINES: Final = 32
"""Largest number of lines of one round, evenly spaced, from which on something is tried as displaced."""
AT_ONCE: Final = 0.05
"""Share of the readings within which targets count as displaced at one time: the line is uncertain, and a target is not always read."""
PLACE: Final[tuple[Freedom, ...]] = tuple(("place", i) for i in range(3))
SHIFTS: Final = tuple((f"shift_{a}", "um") for a in "xyz")
TURNS: Final = tuple((f"turn_{a}", "urad") for a in "xyz")


ONE_ROUND: Final = " only"
"""End of the place of an alignment of one round: ``round 2 only``."""
FRAME_ALONE: Final = "frame"
"""Event of the frame where there is one station."""
WITHIN: Final = "within round "
"""Beginning of the place of a change in the middle of a round; the line from which on is its parameter ``line``."""


def _frame_shift_title(where: str) -> str:
    station, _, number = where.rpartition("round ")
    station = station.removesuffix("within ").strip()
    at = f" at {station.removesuffix(' from').removesuffix(' in')}" if station else ""
    if WITHIN in where:
        return f"instrument{at} displaced within round {number}"
    if number.endswith(ONE_ROUND):
        return f"instrument{at} aligned differently in round {number}"
    return f"instrument{at} re-aligned from round {number} on"


def _target_shift_title(where: str) -> str:
    if WITHIN in where:
        target, _, number = where.rpartition(f" {WITHIN}")
        return f"target {target} displaced {WITHIN}{number}"
    target, _, moment = where.rpartition(" from ")
    return f"target {target} displaced from {moment} on"


def _changed_in(where: str) -> tuple[str, ...]:
    return ("time_s",) if WITHIN in where else ("round",)


def _frame_shift_evidence(of: FittedCause) -> str:
    if "line" in of.numbers:
        return f"the instrument was displaced {of.where}, from line {of.numbers['line']:.0f} of the table on"
    if of.where.endswith(ONE_ROUND):
        return f"the instrument's frame was aligned differently in {of.where}"
    return f"the instrument's frame was re-aligned from {of.where} on"


def _target_shift_evidence(of: FittedCause) -> str:
    if "line" not in of.numbers:
        return f"target {of.where} was displaced"
    target, _, number = of.where.rpartition(f" {WITHIN}")
    return f"target {target} was displaced {WITHIN}{number}, from line {of.numbers['line']:.0f} of the table on"


FRAME_SHIFT: Final = Specification(
    name="frame_shift",
    kind="instrument",
    title=_frame_shift_title,
    family="instrument re-aligned",
    advice=Advice(
        "Metrology: check the alignment of the instrument ({where}): a new alignment, a tripod that was knocked.",
        f"{REST} Better, measure again in one alignment.",
        NOTHING,
    ),
    evidence=_frame_shift_evidence,
    fixed={"line": "1"},
    varies="with time",
    drawing=Drawing(columns=_changed_in, by_state=True, shared="station"),
    most=1,
)
TARGET_SHIFT: Final = Specification(
    name="target_shift",
    kind="instrument",
    title=_target_shift_title,
    family="displaced targets",
    advice=Advice("Metrology: check the mounting of that target.", REST, NOTHING),
    evidence=_target_shift_evidence,
    fixed={"line": "1"},
    varies="with time",
    drawing=Drawing(columns=_changed_in, by_state=True, shared="target"),
    most=1,
)


def alignments(inputs: CandidateInputs) -> Catalogue:
    """Return a candidate for the instrument's frame and for every target, from each round but the first on, and within each round.

    And for the frame in one round alone; in the first or the last it is the same as from a round on.
    """
    station, rounds = inputs.data.station, list(dict.fromkeys(inputs.data.round))
    number = np.array([rounds.index(name) for name in inputs.data.round])
    single = len(dict.fromkeys(station)) == 1
    frame_shifts, target_shifts = [], []

    def add_frame_shifts(aligned: np.ndarray, name: str, preposition: str) -> None:
        for at, mask in [("", aligned)] if single else _changed(aligned, station):
            where = f"round {name}" if single else f"station {at} {preposition} round {name}"
            variant = Variant(masked_columns(FRAME, mask, UM))
            event = f"station {at}" if at else FRAME_ALONE
            frame_shifts.append(Candidate(FRAME_SHIFT, where, (*SHIFTS, *TURNS), (variant,), 1.0, event=event))

    for k, name in enumerate(rounds[1:], 1):
        later = number >= k
        add_frame_shifts(later, name, "from")
        if k < len(rounds) - 1 <= MOST_ROUNDS:
            add_frame_shifts(number == k, f"{name}{ONE_ROUND}", "in")
        for target, mask in _changed(later, inputs.data.target):
            variant = Variant(masked_columns(PLACE, mask, UM))
            where = f"{target} from round {name}"
            target_shifts.append(Candidate(TARGET_SHIFT, where, SHIFTS, (variant,), 1.0, event=target))
    if len(rounds) <= MOST_ROUNDS:
        sides = {str(side): set(inputs.data.target[inputs.data.carrier == side]) for side in inputs.data.carrier}
        # With one side only, or one target on a side, a jump of the machine is the same.
        for name in dict.fromkeys(station.tolist()) if len(sides) > 1 else ():
            where = "" if single else f"station {name} "
            frame_shifts += _within_rounds(inputs.data, FRAME_SHIFT, where, station == name, FRAME)
        for name in sorted(set().union(*(targets for targets in sides.values() if len(targets) > 1))):
            own = inputs.data.target == name
            target_shifts += _within_rounds(inputs.data, TARGET_SHIFT, f"{name} ", own, PLACE)
    return Catalogue((*frame_shifts, *target_shifts))


def of_a_jumped_side(data: Measurements, chosen: Sequence[tuple[Candidate, Variant]]) -> set[tuple[str, str]]:
    """Return effect and place of displaced targets that are all targets of a side, at one time: then the side jumped, and no target."""
    rank = np.empty(len(data), dtype=int)
    rank[order_in_time(data)] = np.arange(len(data))
    shifted = []
    for candidate, variant in chosen:
        if candidate.specification is TARGET_SHIFT:
            moved = variant.columns[0].terms[0].functions.values(slice(None))[:, 0] != 0.0
            shifted.append((candidate.key, set(data.target[moved]), int(rank[moved].min())))
    for side in dict.fromkeys(data.carrier.tolist()):
        targets = set(data.target[data.carrier == side])
        for _, _, first in shifted:
            own = [
                (key, moved)
                for key, moved, at in shifted
                if moved <= targets and 0 <= at - first <= AT_ONCE * len(data)
            ]
            if len(targets) > 1 and set().union(*(moved for _, moved in own)) == targets:
                return {key for key, _ in own}
    return set()


def _within_rounds(
    data: Measurements, of: Specification, where: str, own: np.ndarray, freedoms: Sequence[Freedom]
) -> list[Candidate]:
    """Return a candidate for each round in the middle of which a station or target may have been displaced, from a line on.

    Args:
        where: the beginning of the place.
        own: (n,) the readings of that station or target.
    """
    order = order_in_time(data)
    read, candidates = order[own[order]], []
    for name in dict.fromkeys(data.round[read].tolist()):
        inside = np.flatnonzero(data.round[read] == name)
        # From the first reading of a later round on is the same as from that round on.
        inside = inside[(inside >= FEWEST_READINGS) & (inside <= len(read) - FEWEST_READINGS) & (inside > inside[:1])]
        tried = inside[np.unique(np.linspace(0, len(inside) - 1, min(len(inside), MOST_LINES)).astype(int))]
        variants = []
        for first in tried.tolist():
            later = np.zeros(len(data), dtype=bool)
            later[read[first:]] = True
            variants.append(Variant(masked_columns(freedoms, later, UM), {"line": float(data.lines[read[first]])}))
        if variants:
            names = SHIFTS if freedoms is PLACE else (*SHIFTS, *TURNS)
            place = f"{where}{WITHIN}{name}"
            candidates.append(Candidate(of, place, names, tuple(variants), 1.0, event=where.strip() or FRAME_ALONE))
    return candidates


def _changed(later: np.ndarray, names: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Return stations or targets with readings both before and after a change, with the mask of the later readings."""
    masks = [(str(name), names == name) for name in dict.fromkeys(names)]
    return [(name, later & mask) for name, mask in masks if 0 < np.count_nonzero(later & mask) < np.count_nonzero(mask)]


ALIGNMENT_SOURCE: Final = CandidateSource((FRAME_SHIFT, TARGET_SHIFT), alignments)
