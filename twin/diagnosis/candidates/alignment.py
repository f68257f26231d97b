"""What happened between the rounds: the instrument's frame was re-aligned, a target was displaced."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin._common.units import UM
from twin.diagnosis.candidates.candidate import Candidate, CandidateSource, Catalogue, Cell, CandidateInputs
from twin.diagnosis.candidates.signatures import Freedom, masked_columns
from twin.machine.effects.specification import NOTHING, REST, Advice, Drawing, Specification

FRAME: Final[tuple[Freedom, ...]] = tuple((name, i) for name in ("station", "station turn") for i in range(3))
PLACE: Final[tuple[Freedom, ...]] = tuple(("place", i) for i in range(3))
SHIFTS: Final = tuple((f"shift_{a}", "um") for a in "xyz")
TURNS: Final = tuple((f"turn_{a}", "urad") for a in "xyz")


def _again(where: str) -> str:
    station, _, number = where.rpartition("round ")
    if not station:
        return f"instrument re-aligned from round {number} on"
    return f"instrument at {station.removesuffix(' from ')} re-aligned from round {number} on"


def _bumped(where: str) -> str:
    target, _, number = where.partition(" from round ")
    return f"target {target} displaced from round {number} on"


FRAME_SHIFT: Final = Specification(
    name="frame_shift",
    kind="instrument",
    title=_again,
    family="instrument re-aligned",
    advice=Advice(
        "Who measured: what happened before {where}: a new alignment, a bumped tripod.",
        f"{REST} Better, measure again in one alignment.",
        NOTHING,
    ),
    evidence=lambda of: f"the instrument's frame was re-aligned from {of.where} on",
    varies="with time",
    drawn=Drawing(columns=lambda where: ("round",), by_state=True, shared="station"),
)
TARGET_SHIFT: Final = Specification(
    name="target_shift",
    kind="instrument",
    title=_bumped,
    family="displaced targets",
    advice=Advice("Who measured: how that target is held.", REST, NOTHING),
    evidence=lambda of: f"target {of.where} sits elsewhere than before",
    varies="with time",
    drawn=Drawing(columns=lambda where: ("round",), by_state=True, shared="target"),
)


def _later(inputs: CandidateInputs) -> list[tuple[str, np.ndarray]]:
    """Every round but the first, and which readings were made from then on."""
    rounds = list(dict.fromkeys(inputs.data.round))
    number = np.array([rounds.index(name) for name in inputs.data.round])
    return [(str(rounds[k]), number >= k) for k in range(1, len(rounds))]


def _parts(later: np.ndarray, names: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Stations or targets that were read both before and from then on, with the later readings of each."""
    some = [(str(name), names == name) for name in dict.fromkeys(names)]
    return [(name, later & of) for name, of in some if 0 < np.count_nonzero(later & of) < np.count_nonzero(of)]


def alignments(inputs: CandidateInputs) -> Catalogue:
    """The frame of the instrument, and every target, from each round on."""
    return Catalogue((*_frame_shifts(inputs), *_target_shifts(inputs)))


def _frame_shifts(inputs: CandidateInputs) -> list[Candidate]:
    """The frame of the instrument from each round on; of each station by itself where there are several."""
    found = []
    for name, later in _later(inputs):
        alone = len(dict.fromkeys(inputs.data.station)) == 1
        parts = [("", later)] if alone else _parts(later, inputs.data.station)
        for station, mask in parts:
            where = f"round {name}" if alone else f"station {station} from round {name}"
            columns = masked_columns(FRAME, mask, UM)
            found.append(Candidate(FRAME_SHIFT, where, (*SHIFTS, *TURNS), (Cell(columns),), 1.0))
    return found


def _target_shifts(inputs: CandidateInputs) -> list[Candidate]:
    """Every target from each round on."""
    return [
        Candidate(TARGET_SHIFT, f"{target} from round {name}", SHIFTS, (Cell(masked_columns(PLACE, mask, UM)),), 1.0)
        for name, later in _later(inputs)
        for target, mask in _parts(later, inputs.data.target)
    ]


SOURCE: Final = CandidateSource((FRAME_SHIFT, TARGET_SHIFT), alignments)
