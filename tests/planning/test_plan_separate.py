"""Tests of plans that distinguish two causes: the size a plan states is put into simulated data, which `diagnose` must name.

A plan distinguishes causes of the stated size in 19 of 20 measurements. So few draws may fail: at most the number that a binomial
distribution of 5 % exceeds with a probability below 0.001.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from tests.truth import hidden
from twin._common.errors import InputError
from twin.diagnosis import Diagnosis, diagnose
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects.entries import effect_named
from twin.planning import Plan, separate
from twin.planning.separate import NamedCause, cause_form
from twin.samples import thesis_plan

TRACKER = LaserTracker()
CROSS = ("cross_axis E_AX by Z", "cross_axis E_AY by Z")
WARM = ("thermal_drift Z", "thermal_growth Z by bed")
FEW, MANY = 3, 20  # of three draws, `allowed` is two


@pytest.fixture(scope="module")
def first(dmu50: Machine, calibration: Calibration) -> Measurements:
    """The thesis's measurement of a machine without hidden errors; its information does not depend on them."""
    return simulate(thesis_plan.plan(dmu50), dmu50, calibration, TRACKER, np.random.default_rng(0))[0]


@pytest.fixture(scope="module")
def cross(dmu50: Machine, calibration: Calibration, first: Measurements) -> Plan:
    return separate(dmu50, *CROSS, minutes=30.0, after=first, calibration=calibration)


@pytest.fixture(scope="module")
def warm(dmu50: Machine, calibration: Calibration) -> Plan:
    return separate(dmu50, *WARM, minutes=60.0, calibration=calibration)


def with_effect(known: Calibration, name: str, numbers: Mapping[str, float]) -> Calibration:
    effect, _, where = name.partition(" ")
    return replace(known, extra=(effect_named(effect, where, dict(numbers), known.machine),))


def diagnosed(real: Calibration, known: Calibration, made: Plan, seed: int, *, before: bool) -> Diagnosis:
    rng = np.random.default_rng(seed)
    tables = []
    if before:
        tables.append(simulate(thesis_plan.plan(known.machine), known.machine, real, TRACKER, rng)[0])
    tables.append(simulate(made.table, known.machine, real, TRACKER, rng, setting=made.kit.setting)[0])
    return diagnose(Measurements.join(tables), known.machine, known, instrument=TRACKER)


def distinguished(found: Diagnosis, name: str, other: str) -> bool:
    """Return whether the diagnosis names the cause, first or as equivalent, and not the other one."""
    every = [
        f"{effect} {where}"
        for cause in found.causes
        for effect, where in ((cause.effect, cause.where), *cause.equivalent)
    ]
    return name in every and other not in every


def allowed(draws: int) -> int:
    """Return the number of failures, 5 % each, that is exceeded with a probability below 0.001."""
    return int(stats.binom.isf(1e-3, draws, 0.05))


def check(known: Calibration, made: Plan, *, before: bool, draws: int, more: Mapping[str, Mapping[str, float]]) -> None:
    assert made.separation is not None
    names = made.separation.names
    for k, name in enumerate(names):
        size, unit = made.separation.sizes[k]
        parameter = "rate" if unit == "um/h" else "amplitude" if "drift" in name else "coefficient"
        numbers = {parameter: size, **more.get(name, {})}
        real = with_effect(known, name, numbers)
        failed = [
            seed
            for seed in range(draws)
            if not distinguished(diagnosed(real, known, made, seed, before=before), name, names[1 - k])
        ]
        assert len(failed) <= allowed(draws), (name, size, failed)


def test_the_thesis_does_not_distinguish_them(dmu50: Machine, calibration: Calibration, first: Measurements) -> None:
    """With the first table alone both causes are named: this is why a plan is needed."""
    real = with_effect(calibration, CROSS[0], {"coefficient": 110.0})
    data = simulate(thesis_plan.plan(dmu50), dmu50, real, TRACKER, np.random.default_rng(2))[0]
    found = diagnose(data, dmu50, calibration, instrument=TRACKER)
    assert found.verdict == "ambiguous" and not distinguished(found, *CROSS)


@pytest.mark.slow
def test_the_stated_size_is_distinguished_together_with_earlier_readings(calibration: Calibration, cross: Plan) -> None:
    check(calibration, cross, before=True, draws=FEW, more={})


@pytest.mark.slow
def test_the_stated_size_is_distinguished_by_the_plan_alone(calibration: Calibration, warm: Plan) -> None:
    assert warm.separation is not None and [unit for _, unit in warm.separation.sizes] == ["um/h", "um/K"]
    check(calibration, warm, before=False, draws=FEW, more={})


@pytest.mark.slow
def test_it_is_distinguished_in_nineteen_of_twenty(
    dmu50: Machine, calibration: Calibration, cross: Plan, warm: Plan
) -> None:
    check(calibration, cross, before=True, draws=MANY, more={})
    check(calibration, warm, before=False, draws=MANY, more={})
    bent = separate(dmu50, f"{WARM[0]} time_constant=3600", WARM[1], minutes=60.0, calibration=calibration)
    check(calibration, bent, before=False, draws=MANY, more={WARM[0]: {"time_constant": 3600.0}})


def test_earlier_readings_help(dmu50: Machine, calibration: Calibration, cross: Plan) -> None:
    """In the same time smaller sizes are distinguished; stations, targets and rounds get new names."""
    alone = separate(dmu50, *CROSS, minutes=30.0, calibration=calibration)
    assert alone.separation is not None and cross.separation is not None
    for with_it, without in zip(cross.separation.sizes, alone.separation.sizes, strict=True):
        assert with_it[0] < without[0]
    assert not {*cross.table.round} & {"1", "2", "3", "4"}
    assert cross.minutes <= 30.0 and alone.minutes <= 30.0 and cross.forecast is None


def test_sessions_are_in_table_and_notices(warm: Plan) -> None:
    """Cold, one sensor warm, hours later: temperatures are in the table, first readings in the notices."""
    table = warm.table
    bed = table.temperature_degC["bed"]
    assert {*bed} == {20.0, 25.0} and np.all(np.diff(table.time_s) > 0.0)
    words = [notice for notice in warm.notices() if notice.startswith("before reading")]
    assert len(words) == 3 and "cold" in words[0] and "bed 5 K warmer" in words[1] and "hours later" in words[2]
    begins = [int(text.split()[2].rstrip(":")) - 1 for text in words]
    assert begins[0] == 0 and bed[begins[1]] == 25.0 and bed[begins[1] - 1] == 20.0 and bed[begins[2]] == 20.0
    assert table.time_s[begins[2]] - table.time_s[0] > 4 * 3600.0


def test_given_sizes_are_assessed(dmu50: Machine, calibration: Calibration) -> None:
    made = separate(
        dmu50, f"{CROSS[0]} coefficient=500", f"{CROSS[1]} coefficient=1", minutes=30.0, calibration=calibration
    )
    assert made.separation is not None
    first, second = made.separation.lines()[1:]
    assert "500 µrad/m are enough" in first and "1 µrad/m are NOT ENOUGH" in second
    said = made.to_dict()["separation"]
    assert [row["meant"] for row in said["causes"]] == [500.0, 1.0] and said["odds"] == 100


@pytest.mark.parametrize(
    ("one", "what"),
    [
        ("warp X", "not a cause that a plan can separate"),
        ("reversal W", "not a cause that a plan can separate"),
        ("cross_axis E_AX", "not a cause that a plan can separate"),
        ("station_drift 1", "not a cause that a plan can separate"),
        ("refraction_scale", "not a cause that a plan can separate"),
        ("reversal X colour=1", "no such parameter"),
        ("reversal X size=five", "not a number"),
        ("", "no effect"),
    ],
)
def test_refusals(dmu50: Machine, one: str, what: str) -> None:
    with pytest.raises(InputError, match=what):
        separate(dmu50, one, "reversal Y", minutes=30.0)


def test_the_same_cause_twice_is_refused(dmu50: Machine) -> None:
    with pytest.raises(InputError):
        separate(dmu50, "reversal Y", "reversal Y", minutes=30.0)


def test_the_form_of_a_cause_has_the_given_time_constant(dmu50: Machine, tmp_path: Path) -> None:
    """Without a time constant or amplitude the drift is linear."""
    rng = np.random.default_rng(3)
    of = hidden.rounded(hidden.plan(rng, poses=20))
    table = Measurements.load(hidden.write(tmp_path / "m.csv", of, hidden.points(of), u_mm=None), dmu50)
    known = Calibration.default(dmu50)
    span = float(np.ptp(table.time_s))
    _, bent = cause_form(NamedCause.parse(f"thermal_drift Z time_constant={span / 5.0}"), dmu50, table, known)
    assert bent.fixed["time_constant"] == pytest.approx(span / 5.0, rel=0.06)
    _, straight = cause_form(NamedCause.parse("thermal_drift Z"), dmu50, table, known)
    assert not straight.fixed
    _, straight = cause_form(NamedCause.parse("thermal_drift Z rate=3"), dmu50, table, known)
    assert not straight.fixed
    _, bent = cause_form(NamedCause.parse("thermal_drift Z amplitude=3"), dmu50, table, known)
    assert bent.fixed
    with pytest.raises(InputError, match="no such parameter"):
        cause_form(NamedCause.parse("thermal_drift Z amplitude=3 rate=3"), dmu50, table, known)
