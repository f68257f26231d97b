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
    Given,
    Missing,
)
from twin.diagnosis.candidates.signatures import Column, first_component, of_components, of_units
from twin.machine.effects import MACHINE_EFFECTS, GravityCompliance, Payload, Specification
from twin.machine.effects.places import single
from twin.machine.effects.specification import Forms
from twin.machine.machine import Machine

TRIED: Final = tuple(
    one for one in MACHINE_EFFECTS if one.forms is not None or (one.make is not None and not one.curve)
)


def machine_effects(given: Given) -> Catalogue:
    """Every effect of the machine that is no curve, on data that have the columns for it."""
    told = [effect for effect in given.calibration.extra if isinstance(effect, GravityCompliance)]
    payloads = tuple(dict.fromkeys(payload for effect in told for payload in effect.payloads)) if told else None
    found: list[Candidate] = []
    missing: list[Missing] = []
    for one in TRIED:
        places, lacking = one.tried_at(given.machine, given.state)
        missing += [(one.name, where, what) for where, what in lacking]
        found += [_candidate(one, where, given, payloads) for where in places]
    return Catalogue(tuple(found), tuple(missing))


def _candidate(one: Specification, where: str, given: Given, payloads: Sequence[Payload] | None) -> Candidate:
    if one.forms is not None:
        forms = one.forms(given.machine, where, given.state, payloads)
    else:
        forms = _single(one, where, given)
    if forms.drifts:
        drift = _drift(forms, given)
        return Candidate(
            one, where, forms.names, drift.variants, forms.tests or 1.0, forms.build, forms.units, drift=drift
        )
    variants = tuple(Cell(columns, fixed) for columns, fixed in zip(_columns(forms, given), forms.trials, strict=True))
    tests = float(max(len(variants), 1)) if forms.tests is None else forms.tests
    return Candidate(one, where, forms.names, variants, tests, forms.build, forms.units, forms.space)


def _single(one: Specification, where: str, given: Given) -> Forms:
    """Of an effect of one parameter."""
    make, (name,) = one.make, one.parameters
    if make is None:
        raise TypeError(f"{one.name} can neither be made nor tried")
    unit = make(given.machine, where, {name: 1.0}, ()).parameters[0].unit
    return single((name, unit), lambda value: make(given.machine, where, {name: value}, ()))


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
    return Cell(tuple(of_units(candidate.units(fixed), machine, state)), fixed)


def _columns(forms: Forms, given: Given) -> list[tuple[Column, ...]]:
    """Of every trial."""
    together, made = forms.together, forms.units
    if together is None and made is not None:
        units = [made(fixed) for fixed in forms.trials]
        columns = iter(of_units([unit for some in units for unit in some], given.machine, given.state))
        return [tuple(next(columns) for _ in some) for some in units]
    if together is None:
        raise TypeError("forms without columns")
    at = first_component(given.machine, together.frame.axis, together.frame.role)
    return [
        tuple(of_components([(at + i, together.functions, k, part) for i, part in together.parts]) for k in some)
        for some in together.columns
    ]


def _drift(forms: Forms, given: Given) -> Drift:
    made = forms.units
    if made is None:
        raise TypeError("a drift without columns at other time constants")

    def of(constants: Sequence[float]) -> list[Column]:
        fixed = [{} if constant == STRAIGHT else {"time_constant": constant} for constant in constants]
        return of_units([unit for one in fixed for unit in made(one)], given.machine, given.state)

    tried = tuple(fixed["time_constant"] for fixed in forms.trials if fixed)
    # The functions of those that are tried are evaluated together.
    known = dict(zip(tried, of(tried), strict=True))

    def columns(constant: float) -> tuple[Column, ...]:
        return (known[constant] if constant in known else of([constant])[0],)

    return Drift(columns, tried, straight=False)


SOURCE: Final = CandidateSource(TRIED, machine_effects)
