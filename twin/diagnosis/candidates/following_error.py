"""Where the control reported other positions than it was told: the axis stood there, or the report was taken too early.

With s the share of the difference that shows in the readings: s = 1, the axis stood where the control said (``following_error``); s
= 0, the report was taken before the axis had settled (``read_back``; `twin.diagnosis.judgement.causes`).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from twin._common.units import UM
from twin.diagnosis.candidates.candidate import Candidate, CandidateSource, Catalogue, Cell, CandidateInputs
from twin.diagnosis.candidates.signatures import along_command, tabulated_column
from twin.machine.effects.specification import NOTHING, Advice, Drawing, Specification

LEAST_UM: Final = 1e-3
"""µm or µrad: a report closer than that to the command says the same."""

FOLLOWING_ERROR: Final = Specification(
    name="following_error",
    kind="machine",
    title=lambda where: f"{where} stopped short of where it was told to go",
    advice=Advice(
        "Service: the drive of {axis}: it does not reach its command. Set-up: the dwell before each reading.",
        "Let {axis} settle and measure again. It does not go into the calibration.",
        "Do not compensate it: how far the axis lags depends on speed and load.",
    ),
    evidence=lambda of: f"{of.where} stood where the control reported it, not where it was told to go",
    seldom=True,
    whole=True,
    drawn=Drawing(size_of="report", by_state=True),
)
READ_BACK: Final = Specification(
    name="read_back",
    kind="instrument",
    title=lambda where: f"reported positions of {where} were read too early",
    family="whether the control's reports can be trusted",
    advice=Advice(
        "Who measured: when the control's positions were read.",
        "Go by the commands, or wait until {axis} stands still before reading.",
        NOTHING,
    ),
    evidence=lambda of: f"the positions reported for {of.where} were read before it had settled",
    drawn=Drawing(size_of="report", by_state=True),
)


def following_errors(inputs: CandidateInputs) -> Catalogue:
    """Every axis whose position was reported, and not always as commanded."""
    found, missing = [], []
    for i, axis in enumerate(inputs.machine.axes):
        reported = inputs.data.readback[:, i]
        if np.all(np.isnan(reported)):
            missing.append((READ_BACK.name, axis.name, f"readback_{axis.name}_{axis.unit}"))
            continue
        off = np.where(np.isfinite(reported), (reported - inputs.data.positions[:, i]) * axis.scale / UM, 0.0)
        if np.abs(off).max() >= LEAST_UM:
            column = tabulated_column({i: off * part for i, part in along_command(inputs.machine, axis)})
            found.append(Candidate(FOLLOWING_ERROR, axis.name, (("share", "1"),), (Cell((column,)),), 1.0))
    return Catalogue(tuple(found), tuple(missing))


SOURCE: Final = CandidateSource((FOLLOWING_ERROR, READ_BACK), following_errors)
