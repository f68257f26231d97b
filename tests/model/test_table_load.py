"""Sag of a table under a load: its growth with the moment of the load, against a truth that shares no code with `twin`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.truth import hidden
from tests.truth.hidden import Hidden
from twin._common.errors import InputError
from twin.diagnosis import diagnose
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects.base import Payload
from twin.model.effects.entries import effect_named

SIGMA_MM = 3e-3
TORQUE = -380.598
"""Torque of the weights of `tests.truth.hidden.MASSES` about B at +90°, N·m."""
HEADER = "schema: twin.calibration/1\nmachine: DMU 50 eVolution\nsource: a test\ncurves: {}\neffects:\n"
CARRIED = "- {effect: carried_load, where: work, parameters: {centre_x_mm: 60, centre_y_mm: 0, centre_z_mm: 20}}\n"


def entry(moment: str) -> str:
    return f"- {{effect: table_load, where: B, parameters: {{tilt: 60{moment}}}}}\n"


def test_a_calibration_predicts_the_sag_under_other_loads(dmu50: Machine, tmp_path: Path) -> None:
    """With the moment the readings are explained; with a constant tilt they are not."""
    rng = np.random.default_rng(3)
    of = hidden.rounded(hidden.plan(rng, poses=60, rounds=2))
    of = replace(of, load_kg=np.array([0.0, 100.0, 200.0])[(12 * np.arange(len(of.q)) // len(of.q)) % 3])
    truth = Hidden("table_load", "B", {"tilt": 60.0, "load_x": 60.0, "load_y": 0.0, "load_z": 20.0})
    nothing = tmp_path / "nothing.yaml"
    nothing.write_text(HEADER.replace("effects:\n", ""))
    read = hidden.noisy(hidden.points(of, [truth], calibration=nothing), rng, "isotropic", SIGMA_MM)
    data = Measurements.load(hidden.write(tmp_path / "measured.csv", of, read, u_mm=SIGMA_MM), dmu50)
    path = tmp_path / "table.yaml"
    verdicts = []
    for text in (CARRIED + entry(f", moment: {TORQUE}"), entry("")):
        path.write_text(HEADER + text)
        verdicts.append(diagnose(data, dmu50, Calibration.load(path, dmu50)).verdict)
    assert verdicts[0] == "consistent" and verdicts[1] != "consistent"


def test_about_a_level_trunnion_it_is_the_compliance_of_the_axis() -> None:
    """A load adds as much as a compliance about A would: µrad/(N·m) times the torque of the load at each angle."""
    machine, compliance, mass = Machine.load("trunnion_ac"), 7.0, 25.0
    payload = Payload("work", mass, (0.0, 0.0, 80.0))
    state = {name: np.linspace(-90.0, 30.0, 7) if name == "A" else np.zeros(7) for name in machine.names}
    sags = []
    for loaded in ((), (payload,)):
        entry = {"tilt": compliance * 100.0, "moment": 100.0}
        sags.append(effect_named("table_load", "A", entry, machine, loaded).components(state))
    turned = effect_named("gravity_compliance", "A", {"compliance": compliance}, machine, (payload,)).components(state)
    (component,) = sags[0]
    difference = sags[1][component] - sags[0][component]
    assert np.ptp(difference) > 10.0
    # A is commanded about −x of the base.
    np.testing.assert_allclose(difference, -turned[component], rtol=1e-9, atol=1e-9)


def test_a_load_needs_a_moment_other_than_zero(dmu50: Machine, tmp_path: Path) -> None:
    path = tmp_path / "table.yaml"
    for text, what in (
        (CARRIED + entry(""), "a carried_load that loads no joint"),
        (entry(", moment: 0"), "moment of table_load B"),
        (CARRIED + CARRIED.replace("work", "tool") + entry(", moment: 5"), "more than one carried_load"),
        (CARRIED.replace("{centre_x", "{mass_ratio: -1, centre_x") + entry(", moment: 5"), "mass_ratio of the load"),
    ):
        path.write_text(HEADER + text)
        with pytest.raises(InputError, match=what):
            Calibration.load(path, dmu50)
    path.write_text(HEADER + CARRIED + entry(", moment: 5"))
    calibration = Calibration.load(path, dmu50)
    calibration.save(tmp_path / "again.yaml")
    assert Calibration.load(tmp_path / "again.yaml", dmu50).to_yaml(tmp_path) == calibration.to_yaml(tmp_path)
