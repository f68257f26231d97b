"""Frames, fields, plots and sliders for notebooks."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import twin
from tests.model.errors import random_calibration
from tests.truth.machine import TruthMachine
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

mpl.use("Agg")


@pytest.fixture(scope="module")
def errors(dmu50: Machine) -> Calibration:
    return random_calibration(dmu50, np.random.default_rng(4), size=20.0)


def simulated(machine: Machine, errors: Calibration) -> Measurements:
    instrument = twin.instruments.LaserTracker()
    return twin.simulate(twin.thesis_plan.plan(machine), machine, errors, instrument, np.random.default_rng(3))[0]


@pytest.fixture(scope="module")
def identified(dmu50: Machine, errors: Calibration) -> Calibration:
    """Return a calibration with a joint covariance, identified from simulated readings of one round."""
    readings = simulated(dmu50, errors)
    return twin.identify(readings.select(readings.round == "1"), dmu50).calibration


def test_a_calibration_is_the_same_after_a_frame(dmu50: Machine, errors: Calibration, tmp_path: Path) -> None:
    frame = twin.to_frame(errors)
    back = twin.calibration_from_frame(frame.sample(frac=1.0, random_state=1), errors)
    assert back.to_yaml() == errors.to_yaml()
    assert set(frame.kind) == {"curve", "squareness", "location"}
    assert len(frame) == sum(len(curve.coefficients) for curve in errors.curves.values()) + len(
        errors.squareness
    ) + len(errors.location)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_changed_values_arrive(errors: Calibration, data: st.DataObject) -> None:
    frame = twin.to_frame(errors)
    row = data.draw(st.integers(0, len(frame) - 1))
    value = data.draw(st.floats(-500, 500))
    frame.loc[row, "value"] = value
    again = twin.to_frame(twin.calibration_from_frame(frame, errors))
    assert again.equals(frame)


def test_wrong_frames_are_refused(errors: Calibration, dmu50: Machine) -> None:
    frame = twin.to_frame(errors)
    wrong = {
        "missing column": frame.drop(columns="term"),
        "missing row": frame.iloc[1:],
        "unknown row": frame.replace({"error": {"E_C0Y": "E_C9Y"}}),
        "row given twice": pd.concat([frame, frame.iloc[:1]]),
        "not a number": frame.assign(value=np.nan),
    }
    for words, one in wrong.items():
        with pytest.raises(InputError, match=words if words != "unknown row" else "missing row|unknown row"):
            twin.calibration_from_frame(one, errors)
    with pytest.raises(InputError, match="needs its machine"):
        twin.to_frame(twin.thesis_plan.plan(dmu50))


def test_uncertainties_stand_beside_the_values(identified: Calibration) -> None:
    frame = twin.to_frame(identified).set_index(["error", "term"])
    covariance = identified.covariance
    for name, variance in zip(covariance.names, np.diagonal(covariance.matrix), strict=True):
        error, _, term = name.partition("[")
        if (error, int(term[:-1] or 0) if term else 0) in frame.index:
            assert frame.loc[(error, int(term[:-1]) if term else 0), "u"] == pytest.approx(np.sqrt(variance))
    assert frame.u.notna().sum() > 20


def test_a_table_is_the_same_after_a_frame(dmu50: Machine, errors: Calibration) -> None:
    table = simulated(dmu50, errors)
    frame = twin.to_frame(table, dmu50)
    back = twin.measurements_from_frame(frame, dmu50)
    assert back.to_csv(dmu50) == table.to_csv(dmu50)
    assert back.simulated
    for name, values in table.arrays().items():
        if name == "lines":
            continue  # of the file, whose comments come first
        if name in ("point_mm", "positions"):
            values = np.round(values, 6)  # simulated readings are written in nanometres
        assert np.array_equal(getattr(back, name), values, equal_nan=values.dtype.kind == "f"), name
    some = twin.measurements_from_frame(frame[frame.X_mm > 100.0], dmu50)
    assert 0 < len(some) < len(table)
    with pytest.raises(InputError, match="not a number") as caught:
        twin.measurements_from_frame(frame.assign(X_mm="a"), dmu50)
    assert caught.value.file == "frame"


def test_a_field_is_that_of_an_independent_machine(dmu50: Machine, errors: Calibration, tmp_path: Path) -> None:
    errors.save(tmp_path / "c.yaml")
    truth = TruthMachine(tmp_path / "c.yaml", 120.0)
    x, b = np.linspace(50.0, 450.0, 4), np.array([0.0, 40.0])
    kinematics = twin.Kinematics(dmu50, errors, tool_length_mm=120.0)
    field = twin.error_field(kinematics, {"X": x, "B": b}, {"Y": 200.0, "C": 30.0})
    for one in x:
        for other in b:
            q = np.array([one, 200.0, -200.0, other, 30.0])
            wanted = (truth.pose(q) - truth.pose(q, real=False))[:3, 3] * 1e3
            got = field.sel(X=one, B=other)
            assert [float(got[name]) for name in ("dx", "dy", "dz")] == pytest.approx(wanted, abs=1e-4)
            assert float(got.distance) == pytest.approx(np.linalg.norm(wanted), abs=1e-4)
    assert field.X.attrs["units"] == "mm"
    assert field.dx.attrs["units"] == "um"
    assert float(field.Z) == -200.0
    assert "U" not in field


def test_a_field_has_its_uncertainty(dmu50: Machine, identified: Calibration) -> None:
    kinematics = twin.Kinematics(dmu50, identified, tool_length_mm=120.0)
    field = twin.error_field(kinematics, {"X": [100.0, 300.0]})
    wanted = twin.ToolUncertainty(kinematics).at(np.array([[100.0, 225.0, -200.0, 0.0, 0.0]])).expanded_um[0]
    assert float(field.U[0]) == pytest.approx(wanted)
    assert float(field.U[0]) > 0.0


def test_fields_refuse_what_is_not_an_axis(dmu50: Machine, errors: Calibration) -> None:
    kinematics = twin.Kinematics(dmu50, errors)
    for along, at, words in (
        ({"Q": [1.0]}, {}, "unknown axis"),
        ({"X": [1.0]}, {"X": 2.0}, "twice"),
        ({}, {"X": 2.0}, "no axis"),
    ):
        with pytest.raises(InputError, match=words):
            twin.error_field(kinematics, along, at)
    outside = twin.error_field(kinematics, {"X": [-1000.0, 100.0]})
    assert np.isnan(outside.distance[0])
    assert np.isfinite(outside.distance[1])


def test_plots_return_axes(dmu50: Machine, identified: Calibration) -> None:
    import matplotlib.pyplot as plt

    ax = twin.plot_curve(identified, "E_XX", color="k")
    line = ax.lines[0]
    assert line.get_ydata() == pytest.approx(identified.curves["E_XX"](line.get_xdata()))
    assert len(ax.collections) == 1
    assert twin.plot_curve(identified, "E_YX", ax=ax) is ax
    assert [one.get_label() for one in ax.lines] == ["E_XX", "E_YX"]
    field = twin.error_field(twin.Kinematics(dmu50, identified), {"X": [100.0, 200.0, 300.0], "Y": [50.0, 150.0]})
    shown = twin.plot_field(field)
    assert np.asarray(shown.collections[0].get_array()).reshape(2, 3) == pytest.approx(field.distance.values.T)
    assert "µm" in shown.figure.axes[1].get_ylabel()
    assert twin.plot_field(field.isel(Y=0), "dx").lines[0].get_ydata() == pytest.approx(field.dx.values[:, 0])
    drawn = twin.plot_machine(twin.Kinematics(dmu50, identified), [250.0, 225.0, -200.0, 45.0, 0.0])
    assert len(drawn.collections) >= 4
    with pytest.raises(InputError, match="no such curve"):
        twin.plot_curve(identified, "E_QQ")
    with pytest.raises(InputError, match="no such variable"):
        twin.plot_field(field, "q")
    illustrative = twin.Calibration.default(dmu50)
    marked = (
        twin.plot_curve(illustrative, "E_XX"),
        twin.plot_field(twin.error_field(twin.Kinematics(dmu50, illustrative), {"X": [1.0, 2.0]})),
    )
    assert all("ILLUSTRATIVE" in ax.texts[0].get_text() for ax in marked)
    plt.close("all")


def test_sliders_move_the_machine(dmu50: Machine, identified: Calibration) -> None:
    kinematics = twin.Kinematics(dmu50, identified, tool_length_mm=120.0)
    box = twin.axis_sliders(kinematics)
    assert list(box.sliders) == ["X", "Y", "Z", "B", "C"]
    picture = box.children[0].children[1]
    before, text = bytes(picture.value), box.error.value
    assert before.startswith(b"\x89PNG")
    box.sliders["B"].value = 60.0
    assert bytes(picture.value) != before
    assert box.error.value != text
    q = np.array([[slider.value for slider in box.sliders.values()]])
    nominal = twin.Kinematics(dmu50, Calibration.zero(dmu50), tool_length_mm=120.0)
    error = np.linalg.norm(kinematics.forward(q).point_mm - nominal.forward(q).point_mm) * 1e3
    assert f"{error:.1f} ±" in box.error.value


@pytest.mark.parametrize("package", ["pandas", "xarray", "ipywidgets"])
def test_a_missing_package_is_named(
    package: str, errors: Calibration, dmu50: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    monkeypatch.setitem(sys.modules, package, None)
    kinematics = twin.Kinematics(dmu50, errors)
    call = {
        "pandas": lambda: twin.to_frame(errors),
        "xarray": lambda: twin.error_field(kinematics, {"X": [1.0]}),
        "ipywidgets": lambda: twin.axis_sliders(kinematics),
    }[package]
    with pytest.raises(InputError, match=rf"{package} is not installed"):
        call()
