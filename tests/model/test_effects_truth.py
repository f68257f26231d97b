"""Every effect with a definition, at its places, against the readings of `tests.truth.hidden`, which shares no code with `twin`.

Each calibration is written and read back, so that units of the file, of the effect and of the readings are all checked.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.model.test_table_load import TORQUE
from tests.truth import hidden
from tests.truth.hidden import Hidden
from tests.truth.machine import AXES
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker
from twin.measurement.simulate import Placement, Station, simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import MACHINE_EFFECTS
from twin.model.effects.base import Payload, loads, loads_per_kg, sum_of

HEAD = {"schema": "twin.calibration/1", "machine": "DMU 50 eVolution", "source": "a test"}
LINEAR, ROTARY = "XYZ", "BC"
CENTRE = {"centre_x_mm": 60.0, "centre_y_mm": -25.0, "centre_z_mm": 140.0}
LOAD = {"load_x": 60.0, "load_y": -25.0, "load_z": 140.0}
"""Centre of gravity of a load on the table, as the calibration and as the truth name it."""
WITHOUT_TRUTH = {"gravity_compliance", "table_load", "base_tilt"}
"""Effects of loads, which have tests of their own below, and of arms (`tests.diagnosis.test_hidden_base_tilt`)."""


def cases() -> list[tuple[Hidden, ...]]:
    """Return every effect at all of its places, with numbers of both signs and no two alike; components of one axis together."""
    every: list[tuple[Hidden, ...]] = []

    def add(effect: str, numbers: Mapping[str, float], *places: str, step: str = "") -> None:
        """Add one case; ``step`` names the number that differs from place to place."""
        different = [
            dict(numbers) | ({step: numbers[step] * (1.0 + 0.1 * k)} if step else {}) for k in range(len(places))
        ]
        every.append(tuple(Hidden(effect, place, own) for place, own in zip(places, different, strict=True)))

    for k, axis in enumerate(AXES):
        scale = 10.0 if axis in ROTARY else 1.0
        add("reversal", {"size": scale * (7.0 + k)}, axis)
        add("zero_offset", {"offset": -scale * (11.0 + k)}, axis)
    for k, axis in enumerate((*LINEAR, "B")):
        add("reversal_curve", {"c0": 5.0 + k, "c1": -3.0, "c2": 2.0 + k}, axis)
    for k, axis in enumerate(LINEAR):
        add("pitch_error", {"amplitude": 6.0 + k, "period": 17.0 + k, "phase": 0.7}, axis)
        add("scale_step", {"size": 12.0 + k, "place": (210.0, 260.0, -190.0)[k], "width": 40.0}, axis)
        add("thermal_expansion", {"coefficient": 9.0 + k}, axis)
        add("scale_growth", {"coefficient": -8.0 - k, "offset": 6.0 + k}, axis)
        add("thermal_growth", {"coefficient": -12.0 + k}, f"{axis} by bed")
        add("thermal_lag", {"coefficient": 14.0 + k, "time_constant": 1500.0}, f"{axis} by bed")
        add("thermal_drift", {"amplitude": 25.0 + k, "time_constant": 2200.0}, axis)
        add("thermal_drift", {"rate": 31.0 + k}, axis)
        add("scale_drift", {"amplitude": 60.0 + k, "offset": -9.0, "time_constant": 1800.0}, axis)
        add("scale_drift", {"rate": 70.0 + k, "offset_rate": 5.0}, axis)
        add("spindle_growth", {"amplitude": 18.0 + k, "exponent": 1.4, "time_constant": 400.0}, axis)
        add(
            "thermal_tilt", {"coefficient": 15.0}, *(f"E_{letter}{axis} by bed" for letter in "ABC"), step="coefficient"
        )
        for by in (other for other in (*LINEAR, "B") if other != axis):
            add(
                "cross_axis",
                {"coefficient": 30.0},
                *(f"E_{letter}{axis} by {by}" for letter in "XYZABC"),
                step="coefficient",
            )
    for axis in ROTARY:
        motions = [f"E_{letter}{axis}" for letter in "XYZABC"]
        add("harmonic", {"order": 3.0, "cos": 6.0, "sin": -9.0}, *motions, step="cos")
        add("cross_axis", {"coefficient": 30.0}, *(f"{name} by Y" for name in motions), step="coefficient")
        add(
            "thermal_tilt",
            {"coefficient": -13.0},
            *(f"E_{letter}0{axis} by bed" for letter in "AB"),
            step="coefficient",
        )
    return every


@pytest.fixture(scope="module")
def of() -> hidden.Plan:
    rng = np.random.default_rng(5)
    plan = hidden.rounded(hidden.plan(rng, rounds=1, stops=4, poses=25, stations=2))
    speed = np.repeat([0.0, 6000.0, 12000.0, 3000.0], -(-len(plan.q) // 4))[: len(plan.q)]
    return replace(plan, spindle_rpm=speed, load_kg=np.array([0.0, 120.0, 60.0])[np.arange(len(plan.q)) % 3])


@pytest.fixture(scope="module")
def measured(of: hidden.Plan, dmu50: Machine, tmp_path_factory: pytest.TempPathFactory) -> Measurements:
    path = tmp_path_factory.mktemp("plan") / "m.csv"
    return Measurements.load(hidden.write(path, of, np.ones((len(of.q), 3)), u_mm=None), dmu50)


def readings(measured: Measurements, machine: Machine, folder: Path, entries: list[dict]) -> np.ndarray:
    """Return (n, 3) mm what twin predicts for a calibration with these entries."""
    path = folder / "c.yaml"
    path.write_text(yaml.safe_dump(HEAD | {"curves": {}, "effects": entries}))
    Calibration.load(path, machine).save(folder / "again.yaml")
    setting = Placement(
        {name: Station(*pose) for name, pose in hidden.STATIONS.items()},
        {name: place for name, (_, place) in hidden.TARGETS.items()},
    )
    calibration = Calibration.load(folder / "again.yaml", machine)
    return simulate(
        measured, machine, calibration, LaserTracker(), np.random.default_rng(0), setting=setting, noise=False
    )[0].point_mm


def truth(of: hidden.Plan, folder: Path, *effects: Hidden) -> np.ndarray:
    nothing = folder / "nothing.yaml"
    nothing.write_text("curves: {}")
    return hidden.points(of, effects, calibration=nothing)


def test_every_effect_with_numbers_has_a_case() -> None:
    covered = {effect.effect for case in cases() for effect in case} | WITHOUT_TRUTH
    made = {one.name for one in MACHINE_EFFECTS if one.make is not None}
    assert made - covered == {"empirical"} & made, made - covered


@pytest.mark.parametrize(
    "case", cases(), ids=lambda case: f"{case[0].effect} {case[0].where} {next(iter(case[0].numbers))}"
)
def test_an_effect_moves_the_readings_as_defined(
    dmu50: Machine, of: hidden.Plan, measured: Measurements, tmp_path: Path, case: tuple[Hidden, ...]
) -> None:
    speed = {"highest_rpm": 12000.0} if case[0].effect == "spindle_growth" else {}
    entries = [{"effect": one.effect, "where": one.where, "parameters": dict(one.numbers) | speed} for one in case]
    found = readings(measured, dmu50, tmp_path, entries)
    expected, nominal = truth(of, tmp_path, *case), truth(of, tmp_path)
    assert 1e3 * np.abs(expected - nominal).max() > 0.5, "the effect shows"
    # Temperature in steps of a second: parts in ten thousand of the lag of the truth. The others agree to rounding.
    np.testing.assert_allclose(found, expected, atol=2e-5 if case[0].effect == "thermal_lag" else 1e-9)


@pytest.mark.parametrize("mass", [0.0, 75.0])
@pytest.mark.parametrize("effect", ["gravity_compliance", "table_load"])
def test_loads_on_the_table(
    dmu50: Machine, of: hidden.Plan, measured: Measurements, tmp_path: Path, effect: str, mass: float
) -> None:
    """A payload of constant mass and one known for each reading, at a centre away from all axes."""
    own = {"compliance": 0.4} if effect == "gravity_compliance" else {"tilt": 45.0, "moment": TORQUE}
    entries = [{"effect": "carried_load", "where": "work", "parameters": CENTRE}]
    entries += [{"effect": "payload", "where": "work", "parameters": {"mass": mass, **CENTRE}}] if mass else []
    found = readings(measured, dmu50, tmp_path, [*entries, {"effect": effect, "where": "B", "parameters": own}])
    loaded = replace(of, load_kg=of.load_kg + mass)
    numbers = {name: value for name, value in own.items() if name != "moment"} | LOAD
    # Differences of a potential over steps of 1e-3 rad, in the truth: 1e-7 of the torque.
    np.testing.assert_allclose(found, truth(loaded, tmp_path, Hidden(effect, "B", numbers)), atol=1e-7)


def test_payloads_add_as_masses_and_first_moments() -> None:
    one = Payload("work", 20.0, (100.0, -40.0, 250.0))
    two = Payload("work", 5.0, (-300.0, 80.0, 10.0))
    moments = np.array([20.0 + 5.0, 2.0 - 1.5, -0.8 + 0.4, 5.0 + 0.05])
    expected = np.zeros(9)
    expected[0], expected[5:] = 1.0, moments
    np.testing.assert_allclose(loads([one, two]), expected)
    np.testing.assert_allclose(loads([sum_of([one, two])]), expected)
    assert sum_of([one, two]).mass_kg == 25.0
    np.testing.assert_allclose(sum_of([one, two]).centre_mm, 1e3 * moments[1:] / 25.0)
    carried = replace(one, carried=True), replace(two, side="tool", carried=True)
    np.testing.assert_allclose(loads([*carried]), np.eye(9)[0])
    np.testing.assert_allclose(loads_per_kg(carried, "work"), [0, 0, 0, 0, 0, 20.0, 2.0, -0.8, 5.0])
    np.testing.assert_allclose(loads_per_kg(carried, "tool"), [0, 5.0, -1.5, 0.4, 0.05, 0, 0, 0, 0])
