"""A thermal model at work: effects of a calibration for programs and live kinematics, on a machine that shares no code with `twin`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import twin
from tests.thermal.chains import short_chains
from tests.thermal.machine_room import simulate, write
from twin import cli
from twin._common.errors import InputError
from twin.compensation.live.folder import make_module
from twin.compensation.live.module import channels_of
from twin.thermal import ThermalModel, ThermalRecord, fit_thermal, load_model, save_model

LATER = 300
"""First row of the later part of the records, two minutes each."""
PROGRAM = "G21 G90 G94\nG0 X60 Y140 Z-100 B0 C0\nF10 S2000 M3\nG1 X160\nG1 X360\nM30\n"


@pytest.fixture(scope="module")
def machine() -> twin.Machine:
    return twin.Machine.load("dmu50")


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> tuple[ThermalRecord, ThermalRecord]:
    """Two parts of one day, fitted and later."""
    folder = tmp_path_factory.mktemp("room")
    columns = simulate(8, hours=16.0, speeds=(0, 1500, 0, 3000, 0, 2000, 0, 2500))
    columns["T_room_degC"] = np.clip(columns["T_room_degC"], *np.sort(columns["T_room_degC"][:LATER])[[5, -5]])
    first, later = write(columns, folder / "first.csv", 0, LATER), write(columns, folder / "later.csv", LATER)
    write({name: values for name, values in columns.items() if name != "Z_um"}, folder / "log.csv")
    return ThermalRecord.load(first), ThermalRecord.load(later)


@pytest.fixture(scope="module")
def model(records: tuple[ThermalRecord, ThermalRecord]) -> ThermalModel:
    with short_chains():
        return fit_thermal(records[0])


def state_of(record: ThermalRecord) -> dict[str, np.ndarray]:
    assert record.speed_rpm is not None
    return {
        "time_s": record.time_s,
        "spindle_rpm": record.speed_rpm,
        "T_room_degC": record.temperature_degC[:, record.sensors.index("room")],
    }


def test_the_effect_is_what_the_model_predicts_and_is_read_back(
    model: ThermalModel, records: tuple[ThermalRecord, ThermalRecord], machine: twin.Machine, tmp_path: Path
) -> None:
    first, later = records
    prediction = model.predict(later)
    twin_of = model.extend(twin.Calibration.zero(machine), {"Z": "Z", "X": "-Z"}, prediction)
    twin_of.save(tmp_path / "warm.yaml")
    loaded = twin.Calibration.load(tmp_path / "warm.yaml", machine)
    along_z, along_x = loaded.extra
    both = {name: np.concatenate([one, state_of(later)[name]]) for name, one in state_of(first).items()}
    found = along_z.components({**both, "Z": np.zeros(len(both["time_s"]))})
    # Drifts are left out, as decayed.
    drift = sum(
        value * np.exp(-both["time_s"] / term.time_constant_s)
        for term, value in zip(model.candidates, model.displacements[0].coefficients[:-1], strict=True)
        if term.effect == "thermal_drift"
    )
    expected = np.concatenate([model.predict(first).displacement_um[:, 0], prediction.displacement_um[:, 0]]) + drift
    assert found[2] == pytest.approx(expected, abs=0.02)
    assert along_x.components(both)[0] == pytest.approx(-expected, abs=0.02)
    # The error that is stated is that on the later record, by hand.
    off = later.displacement_um[:, 0] - prediction.displacement_um[:, 0]
    assert np.diag(loaded.covariance.matrix) == pytest.approx([np.mean(off**2)] * 2)
    assert f"RMS error on later data {np.sqrt(np.mean(off**2)):.2g} µm" in loaded.source
    # Without one, and for the fitted record itself, it is that on what followed parts of the fitted record.
    for shown in (None, model.predict(first)):
        inside = model.extend(twin.Calibration.zero(machine), {"Z": "Z"}, shown).covariance.matrix
        assert inside == pytest.approx(np.mean(np.square(model.displacements[0].forward_um)))


def test_a_program_is_compensated_for_a_machine_that_warms_up(
    model: ThermalModel, records: tuple[ThermalRecord, ThermalRecord], machine: twin.Machine
) -> None:
    """At the moments of every point, the simulated machine's own displacement is taken off to within the stated error."""
    _, later = records
    errors = model.extend(twin.Calibration.zero(machine), {"Z": "Z"}, model.predict(later))
    folder, largest = Path(later.path).parent, int(np.argmax(np.abs(later.displacement_um[:160, 0])))
    (folder / "part.nc").write_text(PROGRAM)
    log, start = twin.MachineLog.load(folder / "log.csv"), float(later.time_s[largest - 10])
    conditions = twin.Conditions(log=log, time_s=start)
    options = twin.Options(tool_length_mm=120.0, conditions=conditions)
    result = twin.compensate(folder / "part.nc", machine, errors, options=options)
    x = result.nominal[:, 0]
    time = start + np.where(x <= 160.0, (x - 60.0) * 6.0, 600.0 + (x - 160.0) * 6.0)
    moved = np.interp(time, later.time_s, later.displacement_um[:, 0])
    left = moved + 1e3 * (result.commands[:, 2] - result.nominal[:, 2])
    (u,) = np.sqrt(np.diag(errors.covariance.matrix))
    assert np.sqrt(np.mean(moved**2)) > 5.0 > 3.0 * u
    assert np.sqrt(np.mean(left**2)) < 3.0 * u and np.ptp(left) < 0.5 * np.ptp(moved) + 3.0 * u


@pytest.mark.parametrize(("column", "value"), [("T_room_degC", 31.0), ("spindle_rpm", 4500.0)])
def test_outside_the_fitted_range_it_is_refused(
    model: ThermalModel,
    records: tuple[ThermalRecord, ThermalRecord],
    machine: twin.Machine,
    tmp_path: Path,
    column: str,
    value: float,
) -> None:
    _, later = records
    errors = model.extend(twin.Calibration.zero(machine), {"Z": "Z"})
    columns = state_of(later)
    columns[column] = columns[column].copy()
    columns[column][40] = value
    path = write(columns, tmp_path / "log.csv")
    (tmp_path / "part.nc").write_text(PROGRAM)
    conditions = twin.Conditions(log=twin.MachineLog.load(path), time_s=float(later.time_s[36]))
    options = twin.Options(tool_length_mm=120.0, conditions=conditions)
    with pytest.raises(InputError, match=f"{column} is outside the range .* thermal_response Z") as raised:
        twin.compensate(tmp_path / "part.nc", machine, errors, options=options)
    assert raised.value.file == str(path)
    single = {"T_room_degC": 22.0, "spindle_rpm": 0.0} | {column: value}
    held = twin.Conditions({"room": single["T_room_degC"]}, time_s=10.0, spindle_rpm=single["spindle_rpm"])
    with pytest.raises(InputError, match=f"{column} is outside the range"):
        twin.Kinematics(machine, errors, tool_length_mm=120.0, conditions=held)


def test_live_kinematics_follow_it(model: ThermalModel, machine: twin.Machine) -> None:
    """The lags of the module, stepped as the control does, give the shift of a settled machine and of one that has warmed."""
    errors = model.extend(twin.Calibration.zero(machine), {"Z": "Z"})
    (effect,) = errors.extra
    live = make_module(errors, tool_length_mm=120.0).live
    pins = {one.name: (one.low, one.high) for one in channels_of(live)}
    assert pins == effect.ranges
    room, speed = np.mean(pins["T_room_degC"]), 1800.0
    rng, seconds, time = np.random.default_rng(1), 20.0, np.arange(0.0, 14400.0, 20.0)
    warm = room + np.cumsum(rng.normal(0.0, 0.01, len(time)))
    fast = np.where(time > 3600.0, speed, 0.0)
    state = np.array([0.0] * 5 + [warm[0], 0.0] + [0.0] * len(live.lags))
    lags = np.array(live.drives(state)).ravel() * [one.starts_settled for one in live.lags]
    for one, rpm in zip(warm[1:], fast[1:], strict=True):
        state[5:7] = (one, rpm) if next(iter(pins)) == "T_room_degC" else (rpm, one)
        driven = np.array(live.drives(state)).ravel()
        lags += (driven - lags) * (1.0 - np.exp(-seconds / np.array([lag.time_constant for lag in live.lags])))
    found = np.array(live.correction([0.2, 0.2, -0.1, 0.0, 0.0], [*state[:7], *lags], [0.0, 0.0, 0.12], 1.0)).ravel()
    shift = effect.components({"time_s": time, "T_room_degC": warm, "spindle_rpm": fast})[2][-1]
    assert -1e6 * found[2] == pytest.approx(shift, abs=0.05)


def test_what_cannot_be_added(
    model: ThermalModel, records: tuple[ThermalRecord, ThermalRecord], machine: twin.Machine, tmp_path: Path
) -> None:
    zero = twin.Calibration.zero(machine)
    warm = model.extend(zero, {"Z": "Z"})
    not_validated = replace(model, displacements=tuple(replace(one, forward_um=()) for one in model.displacements))
    for one, errors, along, expected in (
        (model, zero, {}, "X, Y or Z"),
        (model, zero, {"Z": "d5"}, "one of Z"),
        (model, zero, {"W": "Z"}, "one of X, Y, Z"),
        (model, warm, {"Z": "Z"}, "before that was added"),
        (not_validated, zero, {"Z": "Z"}, "with validation"),
    ):
        with pytest.raises(InputError, match=expected):
            one.extend(errors, along)
    warm.save(tmp_path / "warm.yaml")
    text = (tmp_path / "warm.yaml").read_text()
    for before, after, expected in (
        ("where: Z\n", "where: W\n", "one of X, Y, Z"),
        ("{offset", "{size", "offset"),
        ("    T_room_degC: [", "    T_room_degC: [99, 20]\n    T_other_degC: [", "a lower and a higher"),
        ("- columns: [T_room_degC]", "- columns: [T_bed_degC]", "with a range"),
        ("effect: thermal_response", "effect: thermal_growth", "only with thermal_response"),
    ):
        assert before in text
        (tmp_path / "bad.yaml").write_text(text.replace(before, after, 1))
        with pytest.raises(InputError, match=expected):
            twin.Calibration.load(tmp_path / "bad.yaml", machine)


def test_the_command_writes_the_calibration(
    model: ThermalModel,
    records: tuple[ThermalRecord, ThermalRecord],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    save_model(model, "m.yaml")
    later = records[1].path
    with pytest.raises(SystemExit) as raised:
        cli.main(
            [
                "thermal",
                later,
                "--model",
                "m.yaml",
                "--extended",
                "warm.yaml",
                "--along",
                "X=-Z",
                "Y=Z",
                "--json",
                "t.json",
            ]
        )
    assert raised.value.code == 0
    found = twin.Calibration.load("warm.yaml", twin.Machine.load("dmu50"))
    rms = json.loads(Path("t.json").read_text())["predictions"][0]["rms_um"]["Z"]
    assert found.covariance.matrix[-1, -1] == pytest.approx(rms**2) and [one.name[-1] for one in found.extra[-2:]] == [
        "X",
        "Y",
    ]
    assert rms == pytest.approx(load_model("m.yaml").predict(records[1]).rms_um[0])
    for words, expected in ((["--along", "Z=Z"], "--extended"), (["--extended", "w.yaml", "--along", "Z"], "Z=d5")):
        with pytest.raises(SystemExit) as raised:
            cli.main(["thermal", later, "--model", "m.yaml", *words])
        assert raised.value.code == 2 and expected in capsys.readouterr().err
