"""Evidence for a cause in a sentence, and likely mistakes in the making of the calibration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from twin._common.arrays import largest_first
from twin.diagnosis.candidates.flaws import ITSELF, constant_dropped, flaw, times
from twin.diagnosis.estimate.estimate import Estimate
from twin.diagnosis.problem.forms import Candidates, Form
from twin.diagnosis.result import readable_unit
from twin.diagnosis.selection.cross_validation import predicts_held_out
from twin.display.sentences import listed
from twin.machine.calibration import Calibration
from twin.machine.effects.specification import FittedCause
from twin.numerics.waves import SHORTEST_PERIOD, sampling_frequency

ALIKE: Final = 9.0
"""χ² (three standard deviations) by which a period must fit worse than the best to be ruled out."""


def evidence(form: Form, found: Estimate, k: int) -> str:
    """Return the effect of the k-th cause in words, with its size in standard uncertainties."""
    specification = form.candidate.specification
    sizes = [q for q in found.quantities[k] if q.name not in {*specification.nonlinear, *form.variant.fixed}]
    size = max(sizes, key=lambda q: abs(q.value) / q.u if q.u > 0.0 else 0.0)
    numbers = {q.name: q.value for q in found.quantities[k]}
    what = FittedCause(form.candidate.where, size.value, readable_unit(size.unit), numbers, found.effects[k])
    text = specification.evidence(what)
    return f"{text} ({abs(size.value) / size.u:.0f} standard uncertainties)" if size.u > 0.0 else text


def curve_flaw(candidates: Candidates, forms: Sequence[Form], form: Form, calibration: Calibration) -> str:
    """Return the likely mistake in the calibration's curve, in words; empty if none is recognised."""
    space, curve = form.candidate.space, calibration.curves.get(form.candidate.where)
    if curve is not None:
        curve = curve.in_powers()
    if space is None or curve is None or curve.basis != space.basis.name or curve.domain != space.domain:
        return ""
    # With as many functions as the calibration's curve: all coefficients are needed, not only significant corrections.
    count = max(len(curve.coefficients), len(form.columns))
    wide = next(
        (
            f
            for f in candidates.forms
            if f.key == form.key and len(f.columns) == count and f.variant.fixed.get("first") == 0.0
        ),
        form,
    )
    if "stops" in form.variant.fixed:
        wide = form
    columns, values, inverse = candidates.fitted([wide, *(one for one in forms if one is not form)])
    own = np.searchsorted(columns, wide.columns)
    scale = np.array([column.scale for column in wide.variant.columns])
    if "stops" in form.variant.fixed:
        size = float(values[own[0]] * scale[0])
        text = times(1.0 + size) if form.variant.fixed["stops"] == ITSELF else constant_dropped(curve, size)
    else:
        # For functions not in the form the correction is zero and has no uncertainty.
        first = round(wide.variant.fixed.get("first", 0.0))
        correction = np.concatenate([np.zeros(first), values[own] * scale])
        covariance = np.zeros((len(correction), len(correction)))
        covariance[first:, first:] = inverse[np.ix_(own, own)] * np.outer(scale, scale)
        text = flaw(space, curve, correction, covariance)
    return f"; {text}" if text else ""


def between_positions(candidates: Candidates, forms: Sequence[Form], form: Form) -> str:
    """Return why a cause is not valid between the measured positions; empty if it is.

    Args:
        candidates: the data.
        forms: the causes.
        form: one of them.
    """
    periods = _other_periods(candidates, forms, form)
    if periods:
        other = listed([f"{one:.3g}" for one in periods])
        return f"; other periods ({other} mm) fit equally well at these positions, so the error between them is unknown"
    if not predicts_held_out(candidates, form, forms):
        return "; a curve through these positions does not predict held-out ones, so the error between them is unknown"
    return ""


def _other_periods(candidates: Candidates, forms: Sequence[Form], form: Form) -> list[float]:
    """Return other periods, mm, at which a pitch error fits the readings equally well (aliases)."""
    if "period" not in form.variant.fixed:
        return []
    network = candidates.problem.network
    q = network.data.positions[:, network.machine.names.index(form.candidate.where)]
    span, even = float(np.ptp(q)), sampling_frequency(q)
    if even is not None:
        own = 1.0 / form.variant.fixed["period"]
        aliases = (1.0 / max(abs(even - own), 1e-9), 1.0 / (even + own))
        return [float(one) for one in aliases if one >= SHORTEST_PERIOD]
    tried = [one for one in candidates.forms if one.key == form.key and one is not form]
    periods = np.array([one.variant.fixed["period"] for one in tried])
    explained = candidates.scores([one for one in forms if one is not form], [one.index for one in (form, *tried)])[
        :, 0
    ]
    away = np.abs(1.0 / periods - 1.0 / form.variant.fixed["period"]) * span
    found: list[float] = []
    for i in largest_first(explained[1:]):
        if explained[1 + i] < explained[0] - ALIKE:
            break
        if away[i] > 1.0 and all(abs(1.0 / periods[i] - 1.0 / one) * span > 1.0 for one in found):
            found.append(float(periods[i]))
    return found
