"""Candidates: a change between rounds, the instrument's frame re-aligned or a target displaced."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin._common.units import UM
from twin.diagnosis.candidates.candidate import Candidate, CandidateInputs, CandidateSource, Catalogue, Variant
from twin.diagnosis.candidates.signatures import Freedom, masked_columns
from twin.machine.effects.specification import NOTHING, REST, Advice, Drawing, Specification

FRAME: Final[tuple[Freedom, ...]] = tuple((name, i) for name in ("station", "station turn") for i in range(3))
PLACE: Final[tuple[Freedom, ...]] = tuple(("place", i) for i in range(3))
SHIFTS: Final = tuple((f"shift_{a}", "um") for a in "xyz")
TURNS: Final = tuple((f"turn_{a}", "urad") for a in "xyz")


def _frame_shift_title(where: str) -> str:
    station, _, number = where.rpartition("round ")
    if not station:
        return f"instrument re-aligned from round {number} on"
    return f"instrument at {station.removesuffix(' from ')} re-aligned from round {number} on"


def _target_shift_title(where: str) -> str:
    target, _, number = where.partition(" from round ")
    return f"target {target} displaced from round {number} on"


FRAME_SHIFT: Final = Specification(
    name="frame_shift",
    kind="instrument",
    title=_frame_shift_title,
    family="instrument re-aligned",
    advice=Advice(
        "Metrology: check what happened before {where}: a new alignment, a tripod that was knocked.",
        f"{REST} Better, measure again in one alignment.",
        NOTHING,
    ),
    evidence=lambda of: f"the instrument's frame was re-aligned from {of.where} on",
    varies="with time",
    drawing=Drawing(columns=lambda where: ("round",), by_state=True, shared="station"),
)
TARGET_SHIFT: Final = Specification(
    name="target_shift",
    kind="instrument",
    title=_target_shift_title,
    family="displaced targets",
    advice=Advice("Metrology: check the mounting of that target.", REST, NOTHING),
    evidence=lambda of: f"target {of.where} was displaced",
    varies="with time",
    drawing=Drawing(columns=lambda where: ("round",), by_state=True, shared="target"),
)


def _later(inputs: CandidateInputs) -> list[tuple[str, np.ndarray]]:
    """Return each round but the first, with the mask of the readings from that round on."""
    rounds = list(dict.fromkeys(inputs.data.round))
    number = np.array([rounds.index(name) for name in inputs.data.round])
    return [(str(rounds[k]), number >= k) for k in range(1, len(rounds))]


def _changed(later: np.ndarray, names: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Return stations or targets with readings both before and after a change, with the mask of the later readings."""
    masks = [(str(name), names == name) for name in dict.fromkeys(names)]
    return [(name, later & own) for name, own in masks if 0 < np.count_nonzero(later & own) < np.count_nonzero(own)]


def alignments(inputs: CandidateInputs) -> Catalogue:
    """Return a candidate for the instrument's frame and for every target, from each round on."""
    return Catalogue((*_frame_shifts(inputs), *_target_shifts(inputs)))


def _frame_shifts(inputs: CandidateInputs) -> list[Candidate]:
    """Return frame shifts from each round on, for each station separately where there are several."""
    found = []
    for name, later in _later(inputs):
        single = len(dict.fromkeys(inputs.data.station)) == 1
        changed = [("", later)] if single else _changed(later, inputs.data.station)
        for station, mask in changed:
            where = f"round {name}" if single else f"station {station} from round {name}"
            columns = masked_columns(FRAME, mask, UM)
            found.append(Candidate(FRAME_SHIFT, where, (*SHIFTS, *TURNS), (Variant(columns),), 1.0))
    return found


def _target_shifts(inputs: CandidateInputs) -> list[Candidate]:
    """Return target shifts from each round on."""
    return [
        Candidate(TARGET_SHIFT, f"{target} from round {name}", SHIFTS, (Variant(masked_columns(PLACE, mask, UM)),), 1.0)
        for name, later in _later(inputs)
        for target, mask in _changed(later, inputs.data.target)
    ]


SOURCE: Final = CandidateSource((FRAME_SHIFT, TARGET_SHIFT), alignments)
