"""Errors that data do not determine are named, not guessed: too few targets, axes at rest, unknown places and stations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.identification.plans import PLACES, read_by_truth, table, with_places
from tests.identification.test_identify import EXACT, as_the_thesis, differences
from tests.truth.machine import TruthMachine, in_datum, written
from twin.identification import identify
from twin.machine.machine import Machine
from twin.measurement.instruments import TouchProbe
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.planning import InstrumentSizes, measuring_sequence


@pytest.fixture(scope="module")
def errors() -> dict[str, dict]:
    return in_datum(np.random.default_rng(51), size=30.0)


@pytest.fixture
def truth(errors: dict[str, dict], tmp_path: Path) -> TruthMachine:
    return written(tmp_path / "t.yaml", errors)


def test_unknown_places_and_linear_axes_only(dmu50: Machine, truth: TruthMachine, errors: dict[str, dict]) -> None:
    """Angular error times an unknown distance looks like straightness: stated, and included in u; with known places it is gone."""
    plan = as_the_thesis(dmu50)
    data = read_by_truth(plan.select(plan.carrier == "tool"), truth)
    unknown, known = identify(data, dmu50), identify(with_places(data), dmu50)
    # Without noise, the residuals are far below the stated one, which is a notice of its own.
    (notice,) = (one for one in unknown.notices if "stated measurement noise" not in one)
    assert "whose distance from the machine's own origin is not known" in notice
    for name in ("E_XX", "E_YX", "E_ZX", "E_C0Y"):
        assert name in notice.split(" refer to")[0]
    assert all("stated measurement noise" in one for one in known.notices)
    for name, curve in known.calibration.curves.items():
        q = np.linspace(*curve.domain, 11)
        (wide, u_wide), (exact, u) = unknown.interval(name, q), known.interval(name, q)
        if name in notice:
            assert u_wide.max() > 1.2 * u.max(), name
            # 0.2 m is one standard deviation of each target's coordinate; these sit up to 0.2 m away.
            assert np.all(np.abs(wide - exact) <= 5.0 * u_wide), name
    numbers = {**known.calibration.squareness, **known.calibration.location}
    worst = {k: v for k, v in differences(known.calibration, truth, errors).items() if k[3] in "XYZ" and k[2] != "0"}
    assert max(value for name, value in worst.items() if name in known.calibration.curves) <= EXACT
    for name, value in errors["squareness"].items():
        assert numbers[name] == pytest.approx(value, abs=EXACT)


def test_axes_that_rest_are_named(dmu50: Machine, truth: TruthMachine) -> None:
    plan = as_the_thesis(dmu50)
    found = identify(read_by_truth(plan.select(plan.carrier == "tool"), truth), dmu50)
    reasons = {one.name: one.reason for one in found.unidentified}
    for letter in "XYZABC":
        assert reasons[f"E_{letter}B"] == "B did not move" and reasons[f"E_{letter}C"] == "C did not move"
    assert reasons["E_A0C"] == "C did not move"
    assert set(found.calibration.curves) == {f"E_{letter}{axis}" for letter in "XYZABC" for axis in "XYZ"}
    assert "B did not move" in found.to_text()


def test_two_targets_on_a_line_along_x(dmu50: Machine, tmp_path: Path) -> None:
    """Through the origin of X's error frame. A rotation about it is undetermined: E_AX is named, not reported; errors that do not
    depend on it are exact.
    """
    errors = in_datum(np.random.default_rng(52), ("E_XX", "E_BX", "E_CX"), constants=False)
    truth = written(tmp_path / "t.yaml", errors)
    positions = np.tile([250.0, 225.0, -200.0, 0.0, 0.0], (44, 1))
    positions[:22, 0] = np.tile(np.linspace(0.0, 500.0, 11), 2)
    positions[22:, 1] = np.tile(np.linspace(0.0, 450.0, 11), 2)
    places = dict(PLACES)
    PLACES.update(L=("tool", (-150.0, -225.0, 200.0)), R=("tool", (100.0, -225.0, 200.0)))
    try:
        plan = with_places(table(dmu50, positions, np.tile(np.repeat(["L", "R"], 11), 2), np.full(44, "1")))
        found = identify(read_by_truth(plan, truth), dmu50)
    finally:
        PLACES.clear()
        PLACES.update(places)
    reasons = {one.name: one.reason for one in found.unidentified}
    assert "measure three targets that are not on a line" in reasons["E_AX"]
    # Both targets lie on one line along x through the frame of X: its roll alone moves neither, and moves with nothing else.
    assert reasons["E_AX"].startswith("it changes no reading")
    assert [one.direction for one in found.unidentified if one.name == "E_AX"] == ["E_AX order 1 +1000 µrad alone"]
    assert "E_AX" not in found.calibration.curves
    worst = differences(found.calibration, truth, errors)
    assert max(worst[name] for name in ("E_XX", "E_YX", "E_ZX", "E_BX", "E_CX")) <= EXACT


def test_two_targets_on_any_line(dmu50: Machine, truth: TruthMachine, errors: dict[str, dict]) -> None:
    """On an oblique line, so that a combination of three angles is undetermined: reported values still hold within 4 u."""
    plan = as_the_thesis(dmu50)
    data = with_places(read_by_truth(plan.select(np.isin(plan.target, ("P", "Q"))), truth))
    found = identify(data, dmu50)
    assert any(name in {one.name for one in found.unidentified} for name in ("E_AX", "E_BX", "E_CX"))
    for name, curve in found.calibration.curves.items():
        q = np.linspace(*curve.domain, 11)
        value, u = found.interval(name, q)
        true = np.array([truth.curve(name, float(v)) for v in q])
        assert np.all(np.abs(value - true) <= 4.0 * u + EXACT), name


def test_what_to_enter_for_a_probe(dmu50: Machine) -> None:
    """The reasons name tip and spheres; entering what they name determines the error."""
    plan = measuring_sequence(dmu50, "probe", "turns", sizes=InstrumentSizes(120.0)).table
    truth = replace(Calibration.zero(dmu50), location={"E_X0B": 12.0, "E_Y0B": -7.0, "E_Y0C": 9.0})
    data, _ = simulate(plan, dmu50, truth, TouchProbe(), np.random.default_rng(3))

    def unidentified(table: Measurements) -> dict[str, str]:
        found = identify(table, dmu50, wanted=lambda name: name[3] == "0")
        return {one.name: one.reason for one in found.unidentified}

    reasons = unidentified(data)
    tip, sphere = "the tip's offset from the spindle nose (station_x_mm …)", "the spheres' places on the table"
    assert set(reasons) == {"E_X0B", "E_Y0B", "E_Y0C"}
    assert all(tip in reason and "target" not in reason for reason in reasons.values())
    assert [name for name, reason in reasons.items() if sphere in reason] == ["E_Y0C"]
    assert reasons["E_X0B"].startswith("cannot be separated from tip of probe; enter the tip's offset")
    assert set(unidentified(replace(data, place_mm=plan.place_mm))) == {"E_X0B", "E_Y0B"}
    assert not {"E_X0B", "E_Y0C"} & set(unidentified(replace(data, station_pose=plan.station_pose)))


@pytest.mark.slow
def test_locations_that_need_places(dmu50: Machine, tmp_path: Path, errors: dict[str, dict]) -> None:
    """E_X0B, E_Y0B, E_Y0C: named with the reason if no place is known; found if all are."""
    more = {**errors, "location": {**errors["location"], "E_X0B": 12.0, "E_Y0B": -7.0, "E_Y0C": 9.0}}
    truth = written(tmp_path / "t.yaml", more)
    data = read_by_truth(as_the_thesis(dmu50), truth)
    unknown, known = identify(data, dmu50), identify(with_places(data), dmu50)
    reasons = {one.name: one.reason for one in unknown.unidentified}
    assert set(reasons) == {"E_X0B", "E_Y0B", "E_Y0C"}
    assert all("enter the targets' places" in reason for reason in reasons.values())
    assert reasons["E_X0B"].startswith("cannot be separated from station 1, target K, target P, target Q; ")
    # The cradle's frame shifted along its own axis is stations and tool targets shifted the other way, one for one.
    direction = next(one.direction for one in unknown.unidentified if one.name == "E_X0B")
    shown = direction.removeprefix("E_X0B +1000 µm with ").split(", ")
    assert sorted(shown) == [f"{name} x +1 mm" for name in ("station 1", "target K", "target P", "target Q")]
    assert known.unidentified == ()
    for name, value in more["location"].items():
        assert known.calibration.location[name] == pytest.approx(value, abs=EXACT), name
    assert max(differences(known.calibration, truth, more).values()) <= EXACT
