"""Candidates: every machine effect at every place where this machine can have it, generated from its specification."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from twin.diagnosis.candidates.candidate import (
    STRAIGHT,
    Candidate,
    CandidateInputs,
    CandidateSource,
    Catalogue,
    Drift,
    Missing,
    Variant,
)
from twin.diagnosis.candidates.signatures import Column, component_column, first_component, unit_columns
from twin.machine.effects import MACHINE_EFFECTS, GravityCompliance, Payload, Specification
from twin.machine.effects.places import single_parameter_form
from twin.machine.effects.specification import Forms
from twin.machine.effects.table_load import TableLoad
from twin.machine.machine import Machine

TRIED: Final = tuple(
    one for one in MACHINE_EFFECTS if one.forms is not None or (one.make is not None and not one.curve)
)


def machine_effects(inputs: CandidateInputs) -> Catalogue:
    """Return every machine effect, except curves, for which the data have the columns."""
    loaded = [effect for effect in inputs.calibration.extra if isinstance(effect, (GravityCompliance, TableLoad))]
    payloads: tuple[Payload, ...] | None = tuple(
        dict.fromkeys(payload for effect in loaded for payload in effect.payloads)
    )
    if not payloads and not any(isinstance(effect, GravityCompliance) for effect in loaded):
        payloads = None
    found: list[Candidate] = []
    missing: list[Missing] = []
    for specification in TRIED:
        places, lacking = specification.candidate_places(inputs.machine, inputs.state)
        missing += [(specification.name, where, what) for where, what in lacking]
        found += [_candidate(specification, where, inputs, payloads) for where in places]
    return Catalogue(tuple(found), tuple(missing))


def _candidate(
    specification: Specification, where: str, inputs: CandidateInputs, payloads: Sequence[Payload] | None
) -> Candidate:
    if specification.forms is not None:
        forms = specification.forms(inputs.machine, where, inputs.state, payloads)
    else:
        forms = _single(specification, where, inputs)
    if forms.is_drift:
        drift = _drift(forms, inputs)
        return Candidate(
            specification, where, forms.names, drift.variants, forms.tests or 1.0, forms.build, forms.units, drift=drift
        )
    variants = tuple(
        Variant(columns, fixed) for columns, fixed in zip(_columns(forms, inputs), forms.trials, strict=True)
    )
    tests = float(max(len(variants), 1)) if forms.tests is None else forms.tests
    return Candidate(specification, where, forms.names, variants, tests, forms.build, forms.units, forms.space)


def _single(specification: Specification, where: str, inputs: CandidateInputs) -> Forms:
    """Return the forms of an effect of one parameter."""
    make, (name,) = specification.make, specification.parameters
    if make is None:
        raise TypeError(f"{specification.name} has neither forms nor a constructor")
    unit = make(inputs.machine, where, {name: 1.0}, ()).parameters[0].unit
    return single_parameter_form((name, unit), lambda value: make(inputs.machine, where, {name: value}, ()))


def variant_at(candidate: Candidate, fixed: Mapping[str, float], machine: Machine, state: Mapping[str, Any]) -> Variant:
    """Return the variant of a candidate at given values of its non-linear parameters.

    Args:
        candidate: the candidate; it has ``units`` or ``drift``.
        fixed: values of the non-linear parameters, by name.
        machine: the machine.
        state: positions and channels of all readings.
    """
    if candidate.drift is not None:
        return Variant(candidate.drift.columns(fixed.get("time_constant", STRAIGHT)), fixed)
    if candidate.units is None:
        raise TypeError(f"{candidate.effect}: columns exist only at the values tried")
    return Variant(tuple(unit_columns(candidate.units(fixed), machine, state)), fixed)


def _columns(forms: Forms, inputs: CandidateInputs) -> list[tuple[Column, ...]]:
    """Return the columns of every trial."""
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
        raise TypeError("a drift needs columns at any time constant")

    def columns_at(constants: Sequence[float]) -> list[Column]:
        fixed = [{} if constant == STRAIGHT else {"time_constant": constant} for constant in constants]
        return unit_columns([unit for values in fixed for unit in made(values)], inputs.machine, inputs.state)

    tried = tuple(fixed["time_constant"] for fixed in forms.trials if fixed)
    # The functions of all time constants tried are evaluated together.
    known = dict(zip(tried, columns_at(tried), strict=True))

    def columns(constant: float) -> tuple[Column, ...]:
        return (known[constant] if constant in known else columns_at([constant])[0],)

    return Drift(columns, tried, straight=False)


SOURCE: Final = CandidateSource(TRIED, machine_effects)
