"""The payloads that joints were found to give way under, as causes of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from twin._common.arrays import locked
from twin.diagnosis.problem.pool import Form, Pool, log_chance
from twin.diagnosis.problem.problem import unwhitened
from twin.diagnosis.result import Cause, Quantity, readable_unit
from twin.diagnosis.selection.payload import Load, asked, axis_of_form, weights
from twin.machine.effects import Payload
from twin.machine.effects.gravity_compliance import PAYLOAD, payloads_of
from twin.machine.effects.payload import SIDES, SOUGHT_MM

AT_BOUND: Final = 0.99


def payload_causes(pool: Pool, forms: Sequence[Form], causes: Sequence[Cause]) -> tuple[list[Cause], list[Cause]]:
    """The causes with what they are uncertain by because the payload is an estimate as well, and the payloads.

    Args:
        pool: the forms.
        forms: the causes that stand.
        causes: what was said of them as if the payload were known.
    """
    causes, found = list(causes), []
    for side in SIDES:
        load = asked(pool, forms, side)
        known = () if load is None else payloads_of(axis_of_form(pool, load.joints[0]), load.joints[0].cell.fixed)
        if load is None or not known:
            continue
        (payload,) = known
        four = load.four(payload)
        at = [forms.index(form) for form in load.joints]
        more, variances = load.covariances(four, np.array([causes[k].parameters[0].u for k in at]))
        _, compliances = load.under(four)
        for k, times, value in zip(at, more.tolist(), compliances.tolist(), strict=True):
            causes[k] = _less_certain(causes[k], times, value * payload.mass_kg, at_bound=_heaviest(load, payload))
        found.append(_cause(pool, load, payload, variances))
    return causes, found


def _heaviest(load: Load, payload: Payload) -> bool:
    """Whether its mass stands at the bound."""
    return payload.mass_kg > AT_BOUND * load.heaviest


def _less_certain(cause: Cause, times: float, product: float, *, at_bound: bool) -> Cause:
    """A compliance as uncertain as the payload makes it; a limit is that of the largest mass: as if it were known."""
    first = cause.parameters[0]
    text = f"{cause.evidence}; compliance times mass of the payload {product:.3g} {readable_unit(first.unit)}·kg"
    if at_bound:
        return replace(cause, evidence=f"{text}, the compliance a lower limit", parameters=(first,), bounded=True)
    return replace(cause, evidence=text, parameters=(replace(first, u=first.u * times),))


def _cause(pool: Pool, load: Load, payload: Payload, variances: np.ndarray) -> Cause:
    """The payload: what the joints explain with it, more than without."""
    four, nothing = load.four(payload), np.zeros(4)
    explained, compliances = load.under(four)
    own, _ = load.under(nothing)
    log_p = float(log_chance(np.array(max(explained - own, 0.0)), 4.0, pool.dof)) + load.joints[0].price
    excess = max(pool.problem.chi2 - pool.problem.dof, explained)
    text = f"the {load.side} side carries a mass that the URDF does not have: joints give way under it"
    at_bound = _heaviest(load, payload)
    if at_bound:
        text += (
            f". The mass is at the largest considered ({load.heaviest:.3g} kg): the machine's own weight shows less than "
            "its URDF says, as if the control corrected it; only the products of mass and compliance are known"
        )
    columns = [column for form in load.free for column in form.cell.columns]
    size = np.array([column.scale for column in columns])
    shape = np.kron(compliances, weights(four) - weights(nothing))
    return Cause(
        effect=PAYLOAD.name,
        where=load.side,
        origin="machine",
        parameters=_quantities(payload, np.sqrt(variances), load.heaviest),
        p_value=pool.chance(min(log_p, 0.0)),
        share=float(np.clip((explained - own) / excess, 0.0, 1.0)),
        equivalent=(),
        evidence=text,
        pattern_um=locked(unwhitened(pool.problem, (pool.problem.signature(columns) / size) @ shape)),
        bounded=at_bound,
    )


def _quantities(payload: Payload, u: np.ndarray, heaviest: float) -> tuple[Quantity, ...]:
    units, sizes = ("kg", "mm", "mm", "mm"), (heaviest, *[SOUGHT_MM] * 3)
    return tuple(
        Quantity(name, value, unit, float(own) * size)
        for (name, value), unit, own, size in zip(payload.numbers.items(), units, u, sizes, strict=True)
    )
