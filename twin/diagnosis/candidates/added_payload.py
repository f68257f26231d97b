"""Candidates: a load that is missing from the machine description, or is known for each reading, where joints have a known compliance.

With known compliances the deflection is linear in the mass and its first moments (Khalil and Dombre 2002, Modeling, Identification and
Control of Robots, ch. 12). Compliances that are not known are estimated together with the load (`twin.diagnosis.selection.payload`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from twin.diagnosis.candidates.candidate import Candidate, CandidateInputs, CandidateSource, Catalogue, Missing, Variant
from twin.diagnosis.candidates.signatures import Column, component_column, first_component
from twin.machine.calibration import Calibration
from twin.machine.effects.base import along, channel
from twin.machine.effects.gravity_compliance import (
    CARRIED_LOAD,
    PAYLOAD,
    AddedLoad,
    GravityCompliance,
    gravity_compliance,
    loads_of,
)
from twin.machine.effects.payload import LOAD, LOAD_NUMBERS, NUMBERS, SIDES, Side, is_carrying, side_of
from twin.machine.machine import Machine
from twin.numerics.functions import tabulated

LOADS: Final = 4
"""Mass and three first moments."""


def added_payloads(inputs: CandidateInputs) -> Catalogue:
    """Return the candidates for each side on which the calibration has compliances: a payload, and the load that the readings carry.

    If all readings carry the same load, it is confounded with a payload: it is tested where compliances are known without it, else the
    payload is.
    """
    compliant = [one for one in inputs.calibration.extra if isinstance(one, GravityCompliance)]
    every = {side: [one for one in compliant if side_of(one.axis) == side] for side in SIDES}
    sides = [side for side in SIDES if every[side]]
    known = {payload.side for one in compliant for payload in one.payloads if payload.carried}
    found: list[Candidate] = []
    missing: list[Missing] = []
    carrying = is_carrying(inputs.state)
    varied = carrying and bool(np.ptp(inputs.state[LOAD]) > 0.0)
    if carrying and not varied and not sides:
        own = dict.fromkeys(side_of(axis) for axis in inputs.machine.axes)
        missing += [(CARRIED_LOAD.name, side, f"readings at different {LOAD}") for side in own]
    for side in sides:
        if not carrying or varied:
            found.append(_candidate(inputs, side, every[side], carried=False))
        else:
            missing.append((PAYLOAD.name, side, f"readings at different {LOAD}"))
        if carrying and side in (known or sides):
            found.append(_candidate(inputs, side, every[side], carried=True))
        elif not carrying:
            missing.append((CARRIED_LOAD.name, side, LOAD))
    return Catalogue(tuple(found), tuple(missing))


def _candidate(
    inputs: CandidateInputs, side: Side, compliant: Sequence[GravityCompliance], *, carried: bool
) -> Candidate:
    first = 1 + LOADS * SIDES.index(side)
    loads_at = loads_of(inputs.machine)
    measured = loads_at(inputs.state)
    mass = np.asarray(inputs.state[LOAD], dtype=float)[:, None] if carried else 1.0

    def column(k: int) -> Column:
        parts = []
        for one in compliant:
            at = first_component(inputs.machine, one.axis.name, "motion")
            functions = tabulated(mass * np.asarray(measured[one.axis.name][first + k], dtype=float)[:, None])
            parts += [(at + i, functions, 0, one.compliance * part) for i, part in along(one.axis, 1.0).items()]
        return component_column(parts)

    def loads_along(axis: str) -> Callable[[Mapping[str, Any]], Sequence[Any]]:
        def along_axis(positions: Mapping[str, Any]) -> Sequence[Any]:
            units = loads_at(positions)[axis][first : first + LOADS]
            if not carried:
                return units
            held = channel(positions, LOAD, f"{CARRIED_LOAD.name}:{side}")
            return [held * unit for unit in units]

        return along_axis

    rigid = _rigid(inputs.machine, side, compliant)
    doubt = _standard_uncertainties(inputs.calibration, compliant)

    def build(values: np.ndarray, fixed: Mapping[str, float]) -> tuple[AddedLoad, ...]:
        weights = values if len(values) == LOADS else values[0] * first_moments(fixed)

        def load(one: GravityCompliance, u: float, beside: Sequence[AddedLoad] = ()) -> AddedLoad:
            return AddedLoad(one, loads_along(one.axis.name), side, weights, carried=carried, u=u, beside=beside)

        others = [load(one, abs(one.compliance)) for one in rigid]
        return tuple(
            load(one, u, others if k == 0 else ()) for k, (one, u) in enumerate(zip(compliant, doubt, strict=True))
        )

    columns = tuple(column(k) for k in range(LOADS))
    units = ("1" if carried else "kg", "mm", "mm", "mm")
    return Candidate(
        CARRIED_LOAD if carried else PAYLOAD,
        side,
        tuple(zip(LOAD_NUMBERS if carried else NUMBERS, units, strict=True)),
        # The mass at the origin of the frame that carries it, or with its centre.
        (Variant(columns[:1]), Variant(columns)),
        2.0,
        build,
        reported=_mass_and_centre,
    )


def first_moments(fixed: Mapping[str, float]) -> np.ndarray:
    """Return (4,) mass and first moments, kg·m, of a load of 1 kg with the centre that a variant fixes; at the origin without one."""
    return np.array([1.0, *(1e-3 * fixed.get(name, 0.0) for name in NUMBERS[1:])])


def with_centre(candidate: Candidate, centre_mm: Sequence[float] | np.ndarray) -> Variant:
    """Return the variant of an added load with a given centre: its only coefficient is the mass.

    Args:
        candidate: an added load.
        centre_mm: centre in the frame that carries it.
    """
    fixed = dict(zip(NUMBERS[1:], map(float, centre_mm), strict=True))
    parts = list(zip(candidate.variants[-1].columns, first_moments(fixed), strict=True))
    terms = [replace(term, weight=term.weight * weight) for one, weight in parts for term in one.terms]
    # The effect of 1 kg is at most the sum of those of its mass and moments, so that this mass has the largest plausible effect.
    scale = 1.0 / sum(abs(weight) / one.scale for one, weight in parts)
    return Variant((Column(tuple(terms), float(scale)),), fixed)


def _standard_uncertainties(calibration: Calibration, compliant: Sequence[GravityCompliance]) -> list[float]:
    """Return the standard uncertainty of each compliance in the calibration; 0 where it gives none."""
    known = calibration.covariance
    deviations = dict(zip(known.names, np.sqrt(np.diag(known.matrix)), strict=True))
    return [float(deviations.get(one.parameters[0].name, 0.0)) for one in compliant]


def _rigid(machine: Machine, side: Side, compliant: Sequence[GravityCompliance]) -> list[GravityCompliance]:
    """Return the axes of a side without a known compliance, as if they gave way as much as the known ones do (RMS, same kind of axis).

    The calibration says nothing of them: readings without the load may not have loaded them.
    """
    known = {one.axis.name for one in compliant}
    found = []
    for axis in machine.axes:
        like = [one.compliance for one in compliant if one.axis.linear == axis.linear]
        if like and axis.name not in known and side_of(axis) == side:
            found.append(gravity_compliance(machine, axis.name, float(np.sqrt(np.mean(np.square(like))))))
    return found


def _mass_and_centre(values: np.ndarray) -> np.ndarray:
    """Return mass, kg, and centre, mm, from mass and first moments, kg·m; of the mass alone the mass."""
    return np.concatenate([values[:1], 1e3 * values[1:] / values[0]])


SOURCE: Final = CandidateSource((PAYLOAD, CARRIED_LOAD), added_payloads)
