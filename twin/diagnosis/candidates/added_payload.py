"""Candidates: a load that is missing from the machine description, on a side whose joints have a known compliance.

With known compliances the deflection is linear in the mass and its first moments (Khalil and Dombre 2002, Modeling, Identification and
Control of Robots, ch. 12). Compliances that are not known are estimated together with the load (`twin.diagnosis.selection.payload`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from twin.diagnosis.candidates.candidate import Candidate, CandidateInputs, CandidateSource, Catalogue, Variant
from twin.diagnosis.candidates.signatures import Column, component_column, first_component
from twin.machine.effects.base import along
from twin.machine.effects.gravity_compliance import PAYLOAD, AddedLoad, GravityCompliance, loads_of
from twin.machine.effects.payload import NUMBERS, SIDES, Side, side_of
from twin.numerics.functions import tabulated

LOADS: Final = 4
"""Mass and three first moments."""


def added_payloads(inputs: CandidateInputs) -> Catalogue:
    """Return a candidate for each side on which the calibration has compliances."""
    compliant = [one for one in inputs.calibration.extra if isinstance(one, GravityCompliance)]
    every = {side: [one for one in compliant if side_of(one.axis) == side] for side in SIDES}
    return Catalogue(tuple(_candidate(inputs, side, own) for side, own in every.items() if own))


def _candidate(inputs: CandidateInputs, side: Side, compliant: Sequence[GravityCompliance]) -> Candidate:
    first = 1 + LOADS * SIDES.index(side)
    loads_at = loads_of(inputs.machine)
    measured = loads_at(inputs.state)

    def column(k: int) -> Column:
        parts = []
        for one in compliant:
            at = first_component(inputs.machine, one.axis.name, "motion")
            functions = tabulated(np.asarray(measured[one.axis.name][first + k], dtype=float)[:, None])
            parts += [(at + i, functions, 0, one.compliance * part) for i, part in along(one.axis, 1.0).items()]
        return component_column(parts)

    def loads_along(axis: str) -> Any:
        return lambda positions: loads_at(positions)[axis][first : first + LOADS]

    def build(values: np.ndarray, fixed: Mapping[str, float]) -> tuple[AddedLoad, ...]:
        weights = np.concatenate([values, np.zeros(LOADS - len(values))])
        return tuple(AddedLoad(one, loads_along(one.axis.name), side, weights) for one in compliant)

    columns = tuple(column(k) for k in range(LOADS))
    units = ("kg", "mm", "mm", "mm")
    return Candidate(
        PAYLOAD,
        side,
        tuple(zip(NUMBERS, units, strict=True)),
        # The mass at the origin of the frame that carries it, or with its centre.
        (Variant(columns[:1]), Variant(columns)),
        2.0,
        build,
        reported=_mass_and_centre,
    )


def _mass_and_centre(values: np.ndarray) -> np.ndarray:
    """Return mass, kg, and centre, mm, from mass and first moments, kg·m; of the mass alone the mass."""
    return np.concatenate([values[:1], 1e3 * values[1:] / values[0]])


SOURCE: Final = CandidateSource((PAYLOAD,), added_payloads)
