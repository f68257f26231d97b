"""Candidate: lobing of a touch probe, whose pre-travel depends on the direction of the contact in the probe's own frame.

The three supports of a kinematic probe give a pre-travel r(φ) = A·cos 3(φ − φ0) in the direction φ of the contact about the stylus. If
the machine turns the probe by θ and probes in the directions of its linear axes, opposite contacts give a centre that is off by
A·cos(3θ + ψ) along x and −A·sin(3θ + ψ) along y. If the probe never turns, the shift is constant and belongs to the tip.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from twin._common.units import UM
from twin.diagnosis.candidates.candidate import Candidate, CandidateInputs, CandidateSource, Catalogue, Variant
from twin.diagnosis.candidates.signatures import Column, SignatureTerm
from twin.machine.effects.specification import NOTHING, REST, Advice, Specification
from twin.machine.machine import Axis
from twin.measurement.state import at_origin
from twin.numerics.functions import tabulated

LOBES: Final = 3
"""Number of supports of a kinematic probe."""
UPRIGHT: Final = 0.9
"""Cosine between the axis and z of the base from which a rotary axis turns the probe about its stylus."""
PLAUSIBLE: Final = 10.0
"""Largest plausible amplitude, µm."""

PROBE_LOBING: Final = Specification(
    name="probe_lobing",
    kind="instrument",
    title=lambda where: f"lobing of {where}",
    family="lobing of a touch probe",
    advice=Advice(
        "Metrology: calibrate the probe in the directions and orientations in which it measures, or orient it in the direction of "
        "each contact.",
        f"{REST} Better, measure again with a calibrated probe.",
        NOTHING,
    ),
    evidence=lambda of: f"the centres move with three times the rotation of {of.where}, by {of.measure}",
    limits={"um": PLAUSIBLE},
)


def probe_lobings(inputs: CandidateInputs) -> Catalogue:
    """Return a candidate for each probe that a rotary axis of the tool side turned about its stylus."""
    data, found = inputs.data, []
    probed = at_origin(data) & (data.station_carrier == "tool")
    for i, axis in enumerate(inputs.machine.axes):
        if axis.linear or axis.side != "tool" or abs(_upright(axis)) < UPRIGHT or np.ptp(data.positions[:, i]) == 0.0:
            continue
        angle = LOBES * np.sign(_upright(axis)) * np.radians(data.positions[:, i])
        for station in dict.fromkeys(data.station[probed]):
            own = (probed & (data.station == station)).astype(float)
            # Orthogonal parts of the amplitude: A·cos ψ and A·sin ψ.
            parts = ((np.cos(angle), -np.sin(angle)), (-np.sin(angle), -np.cos(angle)))
            columns = tuple(Column(_terms(own, both), PLAUSIBLE) for both in parts)
            names = (("cos", "um"), ("sin", "um"))
            found.append(Candidate(PROBE_LOBING, f"probe {station}", names, (Variant(columns),), 1.0))
        break
    return Catalogue(tuple(found))


def _terms(own: np.ndarray, both: Sequence[np.ndarray]) -> tuple[SignatureTerm, ...]:
    """Return the terms of shifts (n,) of some centres along x and y of the base."""
    return tuple(SignatureTerm(("base", k), tabulated((own * part)[:, None]), 0, UM) for k, part in enumerate(both))


def _upright(axis: Axis) -> float:
    """Return the cosine between the axis of rotation and z of the base at zero."""
    return float(axis.machine_direction[2])


SOURCE: Final = CandidateSource((PROBE_LOBING,), probe_lobings)
