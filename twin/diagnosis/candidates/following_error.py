"""Candidate: positions reported by the control differ from the command, due to following error or because they were read too early.

The parameter is the share s of the difference that appears in the readings. s = 1: the axis was at the reported position
(``following_error``). s = 0: the position was reported before the axis had settled (``read_back``;
`twin.diagnosis.judgement.causes`).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from twin._common.units import UM
from twin.diagnosis.candidates.candidate import Candidate, CandidateInputs, CandidateSource, Catalogue, Variant
from twin.diagnosis.candidates.signatures import along_command, tabulated_column
from twin.machine.effects.specification import NOTHING, Advice, Drawing, Specification

LEAST_UM: Final = 1e-3
"""µm or µrad: smaller differences between report and command are ignored."""

FOLLOWING_ERROR: Final = Specification(
    name="following_error",
    kind="machine",
    title=lambda where: f"{where} did not reach its commanded position",
    advice=Advice(
        "Service: the drive of {axis}, which does not reach the commanded position. Set-up: the dwell before each reading.",
        "Let {axis} settle and measure again. It does not go into the calibration.",
        "Do not compensate it: how far the axis lags depends on speed and load.",
    ),
    evidence=lambda of: f"{of.where} was at the position that the control reported, not at the commanded one",
    rare=True,
    all_or_nothing=True,
    drawing=Drawing(size_of="report", by_state=True),
)
READ_BACK: Final = Specification(
    name="read_back",
    kind="instrument",
    title=lambda where: f"reported positions of {where} were read too early",
    family="reported positions",
    advice=Advice(
        "Metrology: the moment at which the control's positions were read.",
        "Use the commanded positions, or wait until {axis} stands still before reading.",
        NOTHING,
    ),
    evidence=lambda of: f"the positions reported for {of.where} were read before it had settled",
    drawing=Drawing(size_of="report", by_state=True),
)


def following_errors(inputs: CandidateInputs) -> Catalogue:
    """Return a candidate for every axis with reported positions that differ from the command."""
    found, missing = [], []
    for i, axis in enumerate(inputs.machine.axes):
        reported = inputs.data.readback[:, i]
        if np.all(np.isnan(reported)):
            missing.append((READ_BACK.name, axis.name, f"readback_{axis.name}_{axis.unit}"))
            continue
        difference = np.where(np.isfinite(reported), (reported - inputs.data.positions[:, i]) * axis.scale / UM, 0.0)
        if np.abs(difference).max() >= LEAST_UM:
            column = tabulated_column({i: difference * part for i, part in along_command(inputs.machine, axis)})
            found.append(Candidate(FOLLOWING_ERROR, axis.name, (("share", "1"),), (Variant((column,)),), 1.0))
    return Catalogue(tuple(found), tuple(missing))


SOURCE: Final = CandidateSource((FOLLOWING_ERROR, READ_BACK), following_errors)
