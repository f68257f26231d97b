"""What speaks for a cause, in a sentence, and what was done wrong in making the calibration where that is plain."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from twin.diagnosis.estimate import Estimate
from twin.diagnosis.flaws import ITSELF, constant_dropped, flaw, times
from twin.diagnosis.gain import foretells
from twin.diagnosis.pool import Form, Pool
from twin.diagnosis.result import readable_unit
from twin.diagnosis.waves import SHORTEST_PERIOD, sampling
from twin.diagnosis.words import listed
from twin.machine.calibration import Calibration
from twin.machine.effects import ReversalCurve

ALIKE: Final = 9.0
"""Chi² (three standard deviations) by which a period must fit worse to be another than the best."""


def evidence(form: Form, found: Estimate, k: int) -> str:
    """What the k-th cause does, and how far beyond its uncertainty that is."""
    sizes = [q for q in found.quantities[k] if q.name not in ("order", "period", "phase", "time_constant")]
    size = max(sizes, key=lambda q: abs(q.value) / q.u if q.u > 0.0 else 0.0)
    unit = readable_unit(size.unit)
    where = form.candidate.where
    text = {
        "reversal": f"{where} stands {abs(size.value):.3g} {unit} apart depending on the side it came from",
        "reversal_curve": _lost_motion(found, where, k),
        "pitch_error": f"{where} errs periodically along its travel",
        "squareness": f"{where}: the axes are out of square by {size.value:.3g} {unit} more than the model says",
        "axis_location": f"{where}: the axis's average line lies {size.value:.3g} {unit} from where the model has it",
        "angular_error_motion": f"{where}: the axis turns as it travels, otherwise than the model says",
        "straightness": f"{where}: the axis runs along another curve than the model says",
        "positioning": f"{where}: the axis stands elsewhere along its travel than the model says",
        "error_motion": f"{where}: the axis errs along another curve than the model says",
        "harmonic": f"{where}: an error that repeats with the turn of the axis",
        "thermal_expansion": f"{where}'s scale lengthens by {size.value:.3g} {unit} as it warms",
        "thermal_growth": f"the tool side moves along {where} as that sensor warms",
        "thermal_drift": f"the tool side creeps along {where} as the machine warms up{_course(found, k)}",
        "cross_axis": f"{where}: one axis's error grows with another axis's position",
        "table_load": f"the cradle on {where} droops by {size.value:.3g} {unit} when turned",
        "frame_shift": f"the instrument's frame was re-aligned from {where} on",
        "gravity_compliance": f"{where} gives way under gravity",
        "zero_offset": f"{where}'s zero is off by {size.value:.3g} {unit}",
        "following_error": f"{where} stood where the control reported it, not where it was told to go",
        "refraction_scale": f"all lengths are read {size.value:.3g} {unit} too long",
        "time_skew": f"readings and positions of {where} were taken {abs(size.value):.3g} {unit} apart while it moved",
        "affine_scale": f"the instrument's own scales and right angles are off in {where}, by up to {size.value:.3g} {unit}",
        "station_drift": f"station {where} creeps while it measures{_course(found, k)}",
        "misplaced": _misplaced(where),
        "target_shift": f"target {where} sits elsewhere than before",
    }.get(form.candidate.effect, f"{where}: an error of the kind {form.candidate.effect.replace('_', ' ')}")
    return f"{text} ({abs(size.value) / size.u:.0f} standard uncertainties)" if size.u > 0.0 else text


def _lost_motion(found: Estimate, where: str, k: int) -> str:
    """How a reversal changes along the travel."""
    effect = found.effects[k][0] if found.effects[k] else None
    if not isinstance(effect, ReversalCurve):
        return ""
    low, high = effect.lost_motion()
    unit = readable_unit(effect.parameters[0].unit)
    return (
        f"{where} stands apart depending on the side it came from, and by how much changes along its travel: from {low:.3g} {unit} "
        f"to {high:.3g} {unit}"
    )


def _course(found: Estimate, k: int) -> str:
    """How a drift runs in time."""
    numbers = {q.name: q for q in found.quantities[k]}
    if "time_constant" in numbers:
        return f", and slows down (time constant {numbers['time_constant'].value:.3g} s)"
    if "rate" in numbers:
        return f", at {numbers['rate'].value:.3g} µm/h throughout: its time constant is longer than the record"
    return ", at the same rate throughout"


def curve_flaw(pool: Pool, forms: Sequence[Form], form: Form, calibration: Calibration) -> str:
    """What was done wrong in making the calibration's own curve, if that is plain."""
    space, curve = form.candidate.space, calibration.curves.get(form.candidate.where)
    if curve is not None:
        curve = curve.in_powers()
    if space is None or curve is None or curve.basis != space.basis.name or curve.domain != space.domain:
        return ""
    # With as many functions as the calibration's curve has: what they all are is asked, not what need be corrected.
    count = max(len(curve.coefficients), len(form.columns))
    wide = next(
        (f for f in pool.forms if f.key == form.key and len(f.columns) == count and f.cell.fixed.get("first") == 0.0),
        form,
    )
    if "stops" in form.cell.fixed:
        wide = form
    columns, values, inverse = pool.fitted([wide, *(one for one in forms if one is not form)])
    own = np.searchsorted(columns, wide.columns)
    scale = np.array([column.scale for column in wide.cell.columns])
    if "stops" in form.cell.fixed:
        size = float(values[own[0]] * scale[0])
        text = times(1.0 + size) if form.cell.fixed["stops"] == ITSELF else constant_dropped(curve, size)
    else:
        # Functions that the form leaves out it says nothing of: no correction, and none known.
        first = round(wide.cell.fixed.get("first", 0.0))
        correction = np.concatenate([np.zeros(first), values[own] * scale])
        covariance = np.zeros((len(correction), len(correction)))
        covariance[first:, first:] = inverse[np.ix_(own, own)] * np.outer(scale, scale)
        text = flaw(space, curve, correction, covariance)
    return f"; {text}" if text else ""


def between_positions(pool: Pool, forms: Sequence[Form], form: Form) -> str:
    """Why a cause is not promised between the measured positions; empty if it is.

    Args:
        pool: the data.
        forms: the causes.
        form: one of them.
    """
    periods = _other_periods(pool, forms, form)
    if periods:
        other = listed([f"{one:.3g}" for one in periods])
        return f"; with other periods, as {other}, it fits as well at these positions: nothing is promised between them"
    if not foretells(pool, form, forms):
        return "; no curve through the positions measured foretells those left out: nothing is promised between them"
    return ""


def _other_periods(pool: Pool, forms: Sequence[Form], form: Form) -> list[float]:
    """Periods, mm, at which a pitch error fits the readings as well (aliases)."""
    if form.candidate.effect != "pitch_error":
        return []
    network = pool.problem.network
    q = network.data.positions[:, network.machine.names.index(form.candidate.where)]
    span, even = float(np.ptp(q)), sampling(q)
    if even is not None:
        own = 1.0 / form.cell.fixed["period"]
        aliases = (1.0 / max(abs(even - own), 1e-9), 1.0 / (even + own))
        return [float(one) for one in aliases if one >= SHORTEST_PERIOD]
    tried = [one for one in pool.forms if one.key == form.key and one is not form]
    periods = np.array([one.cell.fixed["period"] for one in tried])
    explained = pool.scores([one for one in forms if one is not form], [one.index for one in (form, *tried)])[:, 0]
    away = np.abs(1.0 / periods - 1.0 / form.cell.fixed["period"]) * span
    found: list[float] = []
    for i in np.argsort(-explained[1:]):
        if explained[1 + i] < explained[0] - ALIKE:
            break
        if away[i] > 1.0 and all(abs(1.0 / periods[i] - 1.0 / one) * span > 1.0 for one in found):
            found.append(float(periods[i]))
    return found


def _misplaced(where: str) -> str:
    curve, _, other = where.partition(" as ")
    if other:
        return f"the calibration's curve {curve} is what the machine does as {other}"
    if where.endswith("exchanged"):
        return f"in the calibration, the curves of {where.removesuffix(' exchanged')} stand under each other's names"
    axis, _, joint = where.partition(" at ")
    return f"the calibration's error motions of {axis} act at {joint} instead of {axis}'s own joint"
