"""Candidates of the machine: every effect wherever on this machine it can sit, from its specification alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from twin.diagnosis.candidates.candidate import (
    STRAIGHT,
    Candidate,
    CandidateSource,
    Catalogue,
    Cell,
    Drift,
    CandidateInputs,
    Missing,
)
from twin.diagnosis.candidates.signatures import Column, component_column, first_component, unit_columns
from twin.machine.effects import MACHINE_EFFECTS, GravityCompliance, Payload, Specification
from twin.machine.effects.places import single
from twin.machine.effects.specification import Forms
from twin.machine.machine import Machine

TRIED: Final = tuple(
    one for one in MACHINE_EFFECTS if one.forms is not None or (one.make is not None and not one.curve)
)


def machine_effects(inputs: CandidateInputs) -> Catalogue:
    """Every effect of the machine that is no curve, on data that have the columns for it."""
    told = [effect for effect in inputs.calibration.extra if isinstance(effect, GravityCompliance)]
    payloads = tuple(dict.fromkeys(payload for effect in told for payload in effect.payloads)) if told else None
    found: list[Candidate] = []
    missing: list[Missing] = []
    for one in TRIED:
        places, lacking = one.tried_at(inputs.machine, inputs.state)
        missing += [(one.name, where, what) for where, what in lacking]
        found += [_candidate(one, where, inputs, payloads) for where in places]
    return Catalogue(tuple(found), tuple(missing))


def _candidate(one: Specification, where: str, inputs: CandidateInputs, payloads: Sequence[Payload] | None) -> Candidate:
    if one.forms is not None:
        forms = one.forms(inputs.machine, where, inputs.state, payloads)
    else:
        forms = _single(one, where, inputs)
    if forms.drifts:
        drift = _drift(forms, inputs)
        return Candidate(
            one, where, forms.names, drift.variants, forms.tests or 1.0, forms.build, forms.units, drift=drift
        )
    variants = tuple(Cell(columns, fixed) for columns, fixed in zip(_columns(forms, inputs), forms.trials, strict=True))
    tests = float(max(len(variants), 1)) if forms.tests is None else forms.tests
    return Candidate(one, where, forms.names, variants, tests, forms.build, forms.units, forms.space)


def _single(one: Specification, where: str, inputs: CandidateInputs) -> Forms:
    """Of an effect of one parameter."""
    make, (name,) = one.make, one.parameters
    if make is None:
        raise TypeError(f"{one.name} can neither be made nor tried")
    unit = make(inputs.machine, where, {name: 1.0}, ()).parameters[0].unit
    return single((name, unit), lambda value: make(inputs.machine, where, {name: value}, ()))


def variant_at(candidate: Candidate, fixed: Mapping[str, float], machine: Machine, state: Mapping[str, Any]) -> Cell:
    """The form of a candidate at any values of its non-linear parameters.

    Args:
        candidate: whose columns are those of an effect each.
        fixed: the values.
        machine: the machine.
        state: of all readings.
    """
    if candidate.drift is not None:
        return Cell(candidate.drift.columns(fixed.get("time_constant", STRAIGHT)), fixed)
    if candidate.units is None:
        raise TypeError(f"{candidate.effect} has no columns at other values")
    return Cell(tuple(unit_columns(candidate.units(fixed), machine, state)), fixed)


def _columns(forms: Forms, inputs: CandidateInputs) -> list[tuple[Column, ...]]:
    """Of every trial."""
    together, made = forms.together, forms.units
    if together is None and made is not None:
        units = [made(fixed) for fixed in forms.trials]
        columns = iter(unit_columns([unit for some in units for unit in some], inputs.machine, inputs.state))
        return [tuple(next(columns) for _ in some) for some in units]
    if together is None:
        raise TypeError("forms without columns")
    at = first_component(inputs.machine, together.frame.axis, together.frame.role)
    return [
        tuple(component_column([(at + i, together.functions, k, part) for i, part in together.parts]) for k in some)
        for some in together.columns
    ]


def _drift(forms: Forms, inputs: CandidateInputs) -> Drift:
    made = forms.units
    if made is None:
        raise TypeError("a drift without columns at other time constants")

    def of(constants: Sequence[float]) -> list[Column]:
        fixed = [{} if constant == STRAIGHT else {"time_constant": constant} for constant in constants]
        return unit_columns([unit for one in fixed for unit in made(one)], inputs.machine, inputs.state)

    tried = tuple(fixed["time_constant"] for fixed in forms.trials if fixed)
    # The functions of those that are tried are evaluated together.
    known = dict(zip(tried, of(tried), strict=True))

    def columns(constant: float) -> tuple[Column, ...]:
        return (known[constant] if constant in known else of([constant])[0],)

    return Drift(columns, tried, straight=False)


SOURCE: Final = CandidateSource(TRIED, machine_effects)
