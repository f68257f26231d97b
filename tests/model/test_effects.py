"""Checks of every machine effect against its specification."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from twin._common.errors import InputError
from twin.diagnosis.candidates import SPECIFICATIONS
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.effects import MACHINE_EFFECTS, Effect, Specification
from twin.model.effects.entries import effect_named, entry_of
from twin.model.effects.harmonic import Waves
from twin.model.effects.specification import FittedCause, title_of
from twin.numerics.covariance import Covariance

MADE = [specification for specification in MACHINE_EFFECTS if specification.make is not None]
EVERY_MADE = pytest.mark.parametrize("one", MADE, ids=lambda one: one.name)
EVERY = pytest.mark.parametrize("one", list(SPECIFICATIONS.values()), ids=lambda one: one.name)
SIZES = {
    "size": 5.1,
    "offset": -7.0,
    "amplitude": 3.3,
    "period": 10.0,
    "phase": 0.4,
    "coefficient": 4.0,
    "time_constant": 900.0,
    "tilt": 12.0,
    "order": 3.0,
    "cos": 1.5,
    "sin": -2.5,
    "compliance": 2.0,
    "exponent": 1.3,
    "highest_rpm": 12000.0,
    "c0": 2.0,
    "c1": -1.0,
}
OTHER = 2.5
"""Size of a parameter of another name."""


@pytest.fixture(scope="module")
def machine(dmu50: Machine) -> Machine:
    return dmu50


def place(one: Specification, machine: Machine) -> str:
    where = one.places(machine)[-1]
    return f"{where} bed" if where.endswith(" by") else where


def sizes(one: Specification) -> dict[str, float]:
    return {name: SIZES.get(name, OTHER) for name in one.parameters}


def made(one: Specification, machine: Machine, **changed: float) -> Effect:
    numbers = sizes(one) | changed
    return effect_named(one.name, place(one, machine), numbers, machine)


def state(machine: Machine, rows: int = 40) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(5)
    found = {
        axis.name: rng.uniform(axis.lower if axis.lower is not None else 0.0, axis.upper or 360.0, rows)
        for axis in machine.axes
    }
    found |= {f"approach_{name}": rng.choice([-1.0, 1.0], rows) for name in machine.names}
    found |= {f"T_{name}_degC": rng.uniform(18.0, 30.0, rows) for name in (*machine.names, "bed")}
    return found | {
        "time_s": np.sort(rng.uniform(0.0, 7200.0, rows)),
        "spindle_rpm": rng.choice([0.0, 6e3, 1.2e4], rows),
    }


def table(values: Any, rows: int) -> np.ndarray:
    found = np.zeros((6, rows))
    for component, part in values.items():
        found[component] = np.broadcast_to(np.asarray(part, dtype=float), rows)
    return found


@EVERY_MADE
def test_an_entry_survives_writing_and_reading(one: Specification, machine: Machine, tmp_path: Path) -> None:
    effect = made(one, machine)
    calibration = Calibration.zero(machine).extended([effect], Covariance.none(), "a test")
    path = tmp_path / "calibration.yaml"
    calibration.save(path)
    (again,) = Calibration.load(path, machine).extra
    assert entry_of(again) == entry_of(effect)
    assert entry_of(effect)["effect"] == one.name and entry_of(effect)["where"] == place(one, machine)
    given = state(machine)
    np.testing.assert_array_equal(table(again.components(given), 40), table(effect.components(given), 40))


@EVERY_MADE
def test_derivatives_agree_with_differences(one: Specification, machine: Machine) -> None:
    effect, given = made(one, machine), state(machine)
    numbers = [name for name in one.parameters if name not in one.fixed]
    for parameter, derivative in zip(effect.parameters, effect.derivatives(given), strict=True):
        name = parameter.name.rpartition(".")[2]
        assert name in numbers
        size = sizes(one)[name]
        step = 1e-6 * abs(size)
        sides = [table(made(one, machine, **{name: size + way * step}).components(given), 40) for way in (1, -1)]
        # Central differences: rounding over the step is 1e-10 of the value; of a wave at 50 periods the third derivative adds 1e-8.
        np.testing.assert_allclose(table(derivative, 40), (sides[0] - sides[1]) / (2.0 * step), atol=1e-6, rtol=1e-6)


@EVERY_MADE
def test_numbers_and_expressions_give_the_same_result(one: Specification, machine: Machine) -> None:
    effect = made(one, machine)
    given = {name: float(values[3]) for name, values in state(machine).items()}
    symbols = {name: ca.SX.sym(name) for name in machine.names}
    values = effect.components(given | symbols)
    function = ca.Function("effect", list(symbols.values()), [ca.SX(values.get(i, 0.0)) for i in range(6)])
    found = np.array(function(*[given[name] for name in symbols])).reshape(-1)
    # An effect with a history takes single values as held since time zero.
    alone = {name: np.float64(value) if effect.history else np.array([value]) for name, value in given.items()}
    np.testing.assert_allclose(found, table(effect.components(alone), 1)[:, 0], rtol=1e-12, atol=1e-12)


@EVERY_MADE
def test_a_missing_channel_is_reported(one: Specification, machine: Machine) -> None:
    effect = made(one, machine)
    wanted = [*one.channels(place(one, machine)), *(["T_bed_degC"] if "by bed" in effect.name else [])]
    given = {name: values for name, values in state(machine).items() if name in machine.names}
    if not wanted:
        effect.components(given)
        return
    with pytest.raises(InputError, match=wanted[0]):
        effect.components(given)


@EVERY_MADE
def test_unknown_places_and_parameters_are_refused(one: Specification, machine: Machine) -> None:
    numbers = sizes(one)
    with pytest.raises(InputError, match=f"no such place for {one.name}"):
        effect_named(one.name, "Q", numbers, machine)
    with pytest.raises(InputError, match=f"parameters of {one.name}"):
        effect_named(one.name, place(one, machine), {**numbers, "nonsense": 1.0}, machine)


@EVERY
def test_every_cause_has_title_evidence_and_advice(one: Specification, machine: Machine) -> None:
    where = place(one, machine) if one.places(machine) else "E_XX as E_YX" if one.kind == "calibration" else "E_XX"
    numbers = {"time_constant": 900.0, "rate": 1.0}
    for text in (one.title(where), one.plural, one.evidence(FittedCause(where, 1.5, "µm", numbers))):
        assert text == text.strip() and not text.endswith(".")
    for text in (one.advice.look, one.advice.do, one.advice.never):
        assert text[0].isupper() and text.endswith(".") and "{" not in text.format(axis="X", where=where)


def test_names_are_distinct() -> None:
    names = [one.name for one in MACHINE_EFFECTS]
    assert len(set(names)) == len(names)


def test_spindle_growth_obeys_its_differential_equation(machine: Machine) -> None:
    """dL/dt = (s − L)/τ integrated by scipy; the speed of each reading applies from the previous one on; readings in any order."""
    effect = made(SPECIFICATIONS["spindle_growth"], machine)
    time = np.array([300.0, 1200.0, 2000.0, 2100.0, 5000.0])
    speed = np.array([12000.0, 6000.0, 0.0, 9000.0, 3000.0])
    level, at, expected = 0.0, 0.0, []
    for end, rpm in zip(time, speed, strict=True):
        driven = (rpm / SIZES["highest_rpm"]) ** SIZES["exponent"]
        solved = solve_ivp(
            lambda _, value, driven=driven: (driven - value) / SIZES["time_constant"],
            (at, end),
            [level],
            rtol=1e-10,
            atol=1e-12,
        )
        level, at = float(solved.y[0, -1]), end
        expected.append(SIZES["amplitude"] * level)
    order = np.array([3, 0, 4, 1, 2])
    given = {name: np.zeros(5) for name in machine.names} | {"time_s": time[order], "spindle_rpm": speed[order]}
    moved = np.linalg.norm(table(effect.components(given), 5)[:3], axis=0)
    np.testing.assert_allclose(moved, np.array(expected)[order], rtol=1e-8)


def test_thermal_lag_obeys_its_differential_equation(machine: Machine) -> None:
    """dL/dt = (s − L)/τ integrated by scipy; the temperature changes linearly between readings; readings in any order."""
    effect = made(SPECIFICATIONS["thermal_lag"], machine)
    time = np.array([300.0, 1200.0, 2000.0, 2100.0, 5000.0])
    warm = np.array([21.0, 26.0, 25.0, 31.0, 24.0])
    solved = solve_ivp(
        lambda t, value: (np.interp(t, time, warm - 20.0) - value) / SIZES["time_constant"],
        (time[0], time[-1]),
        [warm[0] - 20.0],
        t_eval=time,
        max_step=10.0,
        rtol=1e-10,
        atol=1e-12,
    )
    order = np.array([3, 0, 4, 1, 2])
    given = {name: np.zeros(5) for name in machine.names} | {"time_s": time[order], "T_bed_degC": warm[order]}
    moved = np.linalg.norm(table(effect.components(given), 5)[:3], axis=0)
    np.testing.assert_allclose(moved, SIZES["coefficient"] * solved.y[0][order], rtol=1e-6)


def test_an_effect_without_specification_is_titled_by_its_name() -> None:
    known = SPECIFICATIONS["reversal"]
    assert title_of(known, "reversal", "Y") == known.title("Y")[:1].upper() + known.title("Y")[1:]
    assert title_of(None, "worn_nut", "Y") == "Worn nut Y"


def test_half_waves_of_an_unlimited_axis_are_counted_about_their_range() -> None:
    """The cut of the turn is opposite to the middle of the range: rounding at its low end does not lead to the other end."""
    column = Waves("C_deg", "half_waves", 3, (-30.0, 200.0), wrapped=True)
    for turns in (-720.0, 0.0, 360.0):
        assert column.share(np.array([-30.0, 85.0, 200.0]) + turns) == pytest.approx([0.0, 0.5, 1.0])
        assert not np.any(column.outside(np.array([-30.0 - 1e-6, 200.0 + 1e-6]) + turns))
        assert column.share(-40.0 + turns) == pytest.approx(-10.0 / 230.0)
        assert np.all(column.outside(np.array([-40.0, 210.0, 265.0]) + turns))
