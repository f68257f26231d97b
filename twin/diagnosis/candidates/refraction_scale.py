"""Candidate: a scale error of all lengths, because the instrument uses a wrong refractive index."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin.diagnosis.candidates.candidate import Candidate, CandidateInputs, CandidateSource, Catalogue, Variant
from twin.diagnosis.candidates.signatures import masked_columns
from twin.machine.effects.specification import NOTHING, REST, Advice, Drawing, Specification

PPM: Final = 1e-6
LARGEST_PPM: Final = 20.0
"""Corresponds to air 20 K away from the temperature set on the instrument."""
PLAUSIBLE: Final = 100.0
"""ppm: scale of the column."""

REFRACTION_SCALE: Final = Specification(
    name="refraction_scale",
    kind="instrument",
    title=lambda where: "all lengths read too long or too short",
    family="scale of all lengths",
    advice=Advice(
        "Metrology: air temperature, pressure and humidity at the instrument, and its certificate.", REST, NOTHING
    ),
    evidence=lambda of: f"all lengths are read {of.measure} too long",
    limits={"ppm": LARGEST_PPM},
    varies="with the frame",
    drawing=Drawing(size_of="distance", by_state=True),
)


def refraction_scale(inputs: CandidateInputs) -> Catalogue:
    """Return one candidate for all readings."""
    columns = masked_columns([("length", 0)], np.ones(len(inputs.data)), PPM, PLAUSIBLE)
    return Catalogue((Candidate(REFRACTION_SCALE, "—", (("scale", "ppm"),), (Variant(columns),), 1.0),))


SOURCE: Final = CandidateSource((REFRACTION_SCALE,), refraction_scale)
