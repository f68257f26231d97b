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
from twin.diagnosis.selection.payload import asked, axis_of_form, weights
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
        if load is None:
            continue
        known = payloads_of(axis_of_form(pool, load.joints[0]), load.joints[0].cell.fixed)
        if not known:
            continue
        (payload,) = known
        four = load.four(payload)
        at = [forms.index(form) for form in load.joints]
        u = np.array([causes[k].parameters[0].u for k in at])
        more, variances = load.covariances(four, u)
        explained, compliances = load.under(four)
        own, _ = load.under(np.zeros(4))
        heaviest = payload.mass_kg > AT_BOUND * load.heaviest
        for k, times, value in zip(at, more.tolist(), compliances.tolist(), strict=True):
            (first, *_), cause = causes[k].parameters, causes[k]
            product = f"{value * payload.mass_kg:.3g} {readable_unit(first.unit)}·kg"
            text = f"{cause.evidence}; compliance times mass of the payload {product}"
            text += ", the compliance a lower limit" if heaviest else ""
            causes[k] = replace(
                cause,
                # A limit is that of the largest mass: as if it were known.
                parameters=(first if heaviest else replace(first, u=first.u * times),),
                evidence=text,
                bounded=cause.bounded or heaviest,
            )
        log_p = float(log_chance(np.array(max(explained - own, 0.0)), 4.0, pool.dof)) + load.joints[0].price
        excess = max(pool.problem.chi2 - pool.problem.dof, explained)
        text = f"the {side} side carries a mass that the URDF does not have: joints give way under it"
        if heaviest:
            text += (
                f". The mass is at the largest considered ({load.heaviest:.3g} kg): the machine's own weight shows less than "
                "its URDF says, as if the control corrected it; only the products of mass and compliance are known"
            )
        size = np.concatenate([[column.scale for column in form.cell.columns] for form in load.free])
        columns = [column for form in load.free for column in form.cell.columns]
        shape = np.kron(compliances, weights(four) - weights(np.zeros(4)))
        found.append(
            Cause(
                effect=PAYLOAD.name,
                where=side,
                origin="machine",
                parameters=_quantities(payload, np.sqrt(variances), load.heaviest),
                p_value=pool.chance(min(log_p, 0.0)),
                share=float(np.clip((explained - own) / excess, 0.0, 1.0)),
                equivalent=(),
                evidence=text,
                pattern_um=locked(unwhitened(pool.problem, (pool.problem.signature(columns) / size) @ shape)),
                bounded=heaviest,
            )
        )
    return causes, found


def _quantities(payload: Payload, u: np.ndarray, heaviest: float) -> tuple[Quantity, ...]:
    units, sizes = ("kg", "mm", "mm", "mm"), (heaviest, *[SOUGHT_MM] * 3)
    return tuple(
        Quantity(name, value, unit, float(own) * size)
        for (name, value), unit, own, size in zip(payload.numbers.items(), units, u, sizes, strict=True)
    )
