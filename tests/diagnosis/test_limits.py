"""Every parameter that an extended calibration can hold has physical limits, and a fit beyond them is not written."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from tests.truth import hidden
from tests.truth.few_axes import write_robot
from twin.diagnosis.candidates import catalogue
from twin.diagnosis.candidates.candidate import Candidate, Variant
from twin.diagnosis.causes import _is_impossible
from twin.diagnosis.estimate import _quantities
from twin.diagnosis.forms import Form
from twin.diagnosis.result import Quantity
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import MACHINE_EFFECTS
from twin.numerics.covariance import Covariance

Built = tuple[Form, tuple[Quantity, ...]]


@pytest.fixture(scope="module")
def candidates(dmu50: Machine, calibration: Calibration, tmp_path_factory: pytest.TempPathFactory) -> list[Candidate]:
    """Return all candidates of readings with every channel, without and with a known compliance, and those of an arm."""
    rng = np.random.default_rng(3)
    plan = hidden.rounded(hidden.plan(rng, poses=40, stops=8, rounds=2))
    speed, load = rng.choice([0.0, 6e3, 1.2e4], len(plan.q)), rng.choice([0.0, 80.0], len(plan.q))
    plan = replace(plan, spindle_rpm=speed, load_kg=load)
    folder = tmp_path_factory.mktemp("limits")
    path = hidden.write(folder / "m.csv", plan, hidden.points(plan, []), u_mm=3e-3)
    data = Measurements.load(path, dmu50)
    (compliant,) = (one for one in MACHINE_EFFECTS if one.name == "gravity_compliance")
    assert compliant.make is not None
    effect = compliant.make(dmu50, "B", {"compliance": 2.0}, ())
    known = calibration.extended([effect], Covariance.none(), "a test")
    arm = Machine.load(str(write_robot(folder, 2)))
    rows = [f"{first},{second},P,tool,1,2,3,{second}" for first in (-60, 0, 60) for second in (0, 40, 80)]
    (folder / "arm.csv").write_text("\n".join(["J1_deg,J2_deg,target,carrier,x_mm,y_mm,z_mm,load_kg", *rows]))
    of_arm = Measurements.load(folder / "arm.csv", arm), Calibration.default(arm)
    every = [(dmu50, data, calibration), (dmu50, data, known), (arm, *of_arm)]
    return [one for of in every for one in catalogue(*of).candidates if one.build is not None]


def built(candidate: Candidate, variant: Variant) -> Built:
    width = len(variant.columns)
    form = Form(candidate, variant, np.arange(width), 0.0, 0)
    assert candidate.build is not None
    values = np.full(width, 0.1)
    effects = candidate.build(values, variant.fixed)
    count = max(width, *(len(effect.parameters) for effect in effects))
    return form, _quantities(form, variant.fixed, effects, values, np.eye(count))


def extremes(candidates: list[Candidate]) -> Iterator[Built]:
    """Yield the narrowest and the widest form of one candidate for every effect and unit."""
    seen = {}
    for candidate in candidates:
        seen.setdefault((candidate.effect, candidate.names[0][1], candidate.reported is None), candidate)
    for candidate in seen.values():
        widest = max(candidate.variants, key=lambda variant: len(variant.columns))
        for variant in {
            id(variant): variant for variant in (candidate.variants[0], candidate.variants[-1], widest)
        }.values():
            yield built(candidate, variant)


def test_every_machine_effect_is_among_them(candidates: list[Candidate]) -> None:
    assert {one.name for one in MACHINE_EFFECTS} <= {one.effect for one in candidates}


def test_every_parameter_has_a_limit_beyond_which_it_is_impossible(candidates: list[Candidate]) -> None:
    tested = 0
    for form, quantities in extremes(candidates):
        specification = form.candidate.specification
        if specification.all_or_nothing:
            continue  # its parameter is 1
        plausible = tuple(
            replace(q, value=specification.least.get(q.unit, 0.0) if q.name not in specification.fixed else q.value)
            for q in quantities
        )
        assert not _is_impossible(form, plausible, ()), (form.key, plausible)
        for k, q in enumerate(quantities):
            if q.name in specification.fixed or (q.coefficient and k):
                continue  # a curve is judged by its largest value: that of its constant
            largest, least = specification.limits[q.unit], specification.least.get(q.unit)
            for value in (1.01 * largest, -1.01 * largest, *([] if least is None else [0.99 * least])):
                # However uncertain it is.
                beyond = (*plausible[:k], replace(q, value=value, u=10.0 * largest), *plausible[k + 1 :])
                assert _is_impossible(form, beyond, ()), (form.key, q.name, value)
                tested += 1
    assert tested > 2 * len(MACHINE_EFFECTS)
