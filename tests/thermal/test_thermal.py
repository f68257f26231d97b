"""Thermal models: true terms, decoys, expected errors and extrapolation on simulated records; the real record of a spindle."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.conftest import beside
from tests.thermal.machine_room import simulate, structure, write
from twin import cli
from twin._common.errors import InputError
from twin.thermal import ThermalModel, ThermalRecord, ThermalTerm, fit_thermal, load_model, save_model
from twin.thermal.evidence import lagged


@pytest.fixture(autouse=True)
def short_chain(monkeypatch: pytest.MonkeyPatch) -> None:
    """A few candidates need few draws."""
    monkeypatch.setattr("twin.thermal.fit.LONG_CHAIN", 1)
    monkeypatch.setattr("twin.thermal.fit.STEPS", 2000)


def record(tmp_path: Path, seed: int = 1, **made: Any) -> ThermalRecord:
    return ThermalRecord.load(write(simulate(seed, **made), tmp_path / "record.csv"))


def terms(model: ThermalModel) -> dict[str, ThermalTerm]:
    return {f"{term.effect} {term.input}": term for term in model.displacements[0].listed}


def test_a_lag_is_the_solution_of_its_differential_equation() -> None:
    time = np.cumsum(np.r_[0.0, np.random.default_rng(1).uniform(20.0, 90.0, 80)])
    values = np.sin(time / 500.0) + (time > 1500.0)
    fine = np.arange(0.0, time[-1], 0.05)
    state, states = 0.3, []
    for value in np.interp(fine, time, values):
        states.append(state)
        state += 0.05 / 400.0 * (value - state)
    found = lagged(values, time, 400.0, 0.3)
    assert np.abs(found - np.interp(time, fine, states)).max() < 1e-3
    even = np.arange(81) * 60.0
    assert np.allclose(
        lagged(values, even, 400.0), lagged(values, even + 1e-4 * np.random.default_rng(2).random(81), 400.0), atol=1e-5
    )


def test_the_true_terms_are_found(tmp_path: Path) -> None:
    """Allowed beyond three standard uncertainties: 3 %, for time constants on a grid and speeds that change between rows."""
    taus = []
    for seed in range(6):
        found = terms(fit_thermal(record(tmp_path, seed), validate=False))
        assert set(found) == {"thermal_lag room", "spindle_growth speed"}
        bed, growth = found["thermal_lag room"], found["spindle_growth speed"]
        assert abs(bed.coefficient - 6.0) < 3.0 * bed.standard_uncertainty + 0.18 and bed.standard_uncertainty < 0.5
        assert abs(growth.coefficient - 12.0) < 3.0 * growth.standard_uncertainty + 0.36
        assert growth.standard_uncertainty < 1.0
        assert growth.exponent is not None and growth.exponent > 1.8
        taus.append((bed.time_constant_s, growth.time_constant_s))
    assert np.all(np.abs(np.mean(taus, axis=0) / (2400.0, 1200.0) - 1.0) < 0.1)


def test_copies_of_a_sensor_are_one_group(tmp_path: Path) -> None:
    model = fit_thermal(record(tmp_path, copies=2), validate=False)
    assert model.groups == (("room", "copy0", "copy1"),)
    names = [term.name for term in model.displacements[0].terms if term.effect == "thermal_lag"]
    assert names == ["Z by group room, copy0, copy1"]


def test_an_unrelated_sensor_is_not_listed(tmp_path: Path) -> None:
    for seed in (3, 4):
        assert "thermal_lag office" not in terms(fit_thermal(record(tmp_path, seed, unrelated=True), validate=False))


def test_a_drift_without_cause_is_not_blamed_on_a_sensor(tmp_path: Path) -> None:
    model = fit_thermal(record(tmp_path, 5, bed_um_per_K=0.0, growth_um=0.0, drift_um=25.0), validate=False)
    found = terms(model)
    assert list(found) == ["thermal_drift drift"]


@pytest.mark.slow
def test_the_expected_error_holds_on_what_follows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Over draws, the squared ratio of the error found to the one expected averages below 1: the largest of three parts counts."""
    monkeypatch.setattr("twin.thermal.fit.STEPS", 400)
    ratios, inside = [], []
    for seed in range(10, 14):
        whole = record(tmp_path, seed, hours=16.0, speeds=(0, 1500, 0, 3000, 0, 2000, 0, 2500))
        half = len(whole) * 5 // 8
        model = fit_thermal(whole.rows(0, half))
        rest = model.predict(whole.rows(half, len(whole)))
        ratios.append(float(rest.rms_um[0] / rest.expected_rms_um[0]))
        inside.append(float((np.abs(rest.residual_um) < 2.0 * rest.standard_uncertainty_um).mean()))
    assert 0.3 < np.sqrt(np.mean(np.square(ratios))) < 1.4 and max(ratios) < 2.0 and np.mean(inside) > 0.85


def test_a_higher_speed_has_a_larger_uncertainty_that_covers(tmp_path: Path) -> None:
    # Its own record has the part of the uncertainty that does not depend on the speed, too.
    errors, growth = [], []
    for seed in (20, 21, 22):
        slow = {"speeds": (0, 1200, 0, 1800, 0, 2400, 0, 3600), "hours": 16.0}
        whole = record(tmp_path, seed, **slow)
        end = len(whole) * 7 // 8 - 2
        model = fit_thermal(whole.rows(0, end), validate=False)
        fast = model.predict(whole.rows(end, len(whole)))
        assert any("3600 rpm, fitted up to 2400" in text for text in fast.warnings)
        before = model.predict(whole.rows(0, end)).standard_uncertainty_um.mean()
        growth.append(float(fast.standard_uncertainty_um[-1, 0] / before))
        errors.append(float(fast.residual_um[-20:].mean() / fast.standard_uncertainty_um[-20:].mean()))
    assert np.abs(errors).max() < 3.0 and np.mean(growth) > 1.25 and min(growth) > 1.2


def test_a_saved_model_predicts_the_same(tmp_path: Path) -> None:
    whole = record(tmp_path)
    half = len(whole) // 2
    model = fit_thermal(whole.rows(0, half), validate=False)
    save_model(model, tmp_path / "m.yaml")
    again = load_model(tmp_path / "m.yaml")
    rest = whole.rows(half, len(whole))
    one, other = model.predict(rest), again.predict(rest)
    assert np.allclose(one.displacement_um, other.displacement_um, atol=1e-6) and one.warnings == other.warnings
    assert np.allclose(one.standard_uncertainty_um, other.standard_uncertainty_um, rtol=1e-4)
    # Rows that continue the fitted ones give what the whole record gives.
    assert np.allclose(one.displacement_um, model.predict(whole).displacement_um[half:], atol=1e-6)
    reset = ThermalRecord(**{**vars(rest), "time_s": rest.time_s - rest.time_s[0]})
    assert np.allclose(model.predict(reset, continues=True).displacement_um, one.displacement_um, atol=1e-6)
    alone = model.predict(reset)
    assert "does not continue" in alone.warnings[0]
    assert alone.standard_uncertainty_um[0, 0] > 1.2 * one.standard_uncertainty_um[0, 0]


@pytest.mark.parametrize(
    ("change", "line", "expected"),
    [
        (("T_room_degC", "room"), 1, "columns T_<sensor>"),
        (("time_s", "clock"), 1, "a column time_s"),
        (("240.0000,0.0000,", "240.0000,,"), 4, "a number in every row"),
        (("240.0000,0.0000,", "240.0000,warm,"), 4, "a number with a decimal point"),
        (("240.0000,0.0000,", "90.0000,0.0000,"), 4, "a later time"),
        (("240.0000,0.0000,", "240.0000,-5,"), 4, "0 or above"),
        (("\n240.0000,", "\n#"), None, ""),
    ],
)
def test_a_record_that_cannot_be_used(tmp_path: Path, change: tuple[str, str], line: int | None, expected: str) -> None:
    path = write(simulate(1, hours=1.0), tmp_path / "r.csv")
    text = path.read_text().replace(*change, 1)
    if change[0].startswith("T_room"):
        text = text.replace("spindle_rpm", "rpm")
    path.write_text(text)
    if line is None:
        assert len(ThermalRecord.load(path)) == 29
        return
    with pytest.raises(InputError, match=expected) as raised:
        ThermalRecord.load(path)
    assert raised.value.line == line and raised.value.file == str(path)


def test_a_gap_in_time_is_refused_with_its_line(tmp_path: Path) -> None:
    columns = {name: np.delete(values, slice(100, 110)) for name, values in simulate(1, hours=5.0).items()}
    with pytest.raises(InputError, match="gap of 1320 s") as raised:
        ThermalRecord.load(write(columns, tmp_path / "r.csv"))
    assert raised.value.line == 102


def test_a_prediction_names_what_it_lacks(tmp_path: Path) -> None:
    whole = record(tmp_path)
    model = fit_thermal(whole, validate=False)
    for missing, expected in (("T_room_degC", "T_room_degC"), ("spindle_rpm", "speed")):
        columns = {name: values for name, values in simulate(1).items() if name != missing}
        with pytest.raises(InputError, match=expected):
            model.predict(ThermalRecord.load(write(columns, tmp_path / "less.csv")))


def test_a_displacement_that_does_not_move_is_refused(tmp_path: Path) -> None:
    columns = simulate(1)
    columns["Z_um"][:] = 0.0
    with pytest.raises(InputError, match="constant"):
        fit_thermal(ThermalRecord.load(write(columns, tmp_path / "r.csv")))


@pytest.mark.slow
def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("twin.thermal.fit.STEPS", 800)
    columns = simulate(1)
    write(columns, Path("first.csv"), 0, 240)
    write(columns, Path("second.csv"), 240)
    fit = "thermal first.csv -o m.yaml --predict second.csv --predicted p.csv --json t.json --html t.html"
    for line in (fit, "thermal second.csv --model m.yaml --predicted q.csv"):
        with pytest.raises(SystemExit) as ended:
            cli.main(line.split())
        said = capsys.readouterr()
        assert ended.value.code == 0 and "Z by room" in said.out and "expected RMS error" in said.out
    assert Path("p.csv").read_text().splitlines()[0] == "time_s,Z_um,u_Z_um"
    both = [np.loadtxt(name, delimiter=",", skiprows=1) for name in ("p.csv", "q.csv")]
    assert np.allclose(both[0], both[1], atol=2e-3)
    report = json.loads(Path("t.json").read_text())
    assert report["schema"] == "twin.thermal/1" and len(report["predictions"]) == 2
    one = report["displacements"][0]
    assert (
        0.1 < one["uncertainty_factor"] < 10.0
        and 0.1 < one["held_out_rms_um"] < 5.0
        and len(one["forward_rms_um"]) == 3
    )
    assert "Z by room" in Path("t.json").read_text() and "<svg" not in Path("t.html").read_text()


def test_the_first_part_of_a_real_record_predicts_the_rest() -> None:
    """The ridge regression on 110 lagged inputs leaves 10.9, 10.4, 22, 28 and 21 µm here; all sensors unlagged 12, 6, 6, 7 and 17."""
    whole = ThermalRecord.load(beside("data", "real", "spindle-thermal", "first-half.csv"))
    part = round(0.55 * len(whole))
    rest = fit_thermal(whole.rows(0, part), validate=False).predict(whole.rows(part, len(whole)))
    assert np.all(rest.rms_um < (6.0, 6.0, 9.0, 9.0, 9.0))
    assert np.all(rest.rms_um < 2.5 * rest.expected_rms_um)
    assert any("3750 rpm" in text for text in rest.warnings)


def after(whole: ThermalRecord, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of the readings after a part of a record that 95 % intervals cover, and their RMS error, by displacement."""
    part = round(share * len(whole))
    rest = fit_thermal(whole.rows(0, part)).predict(whole.rows(part, len(whole)))
    return np.mean(np.abs(rest.residual_um) <= 1.96 * rest.standard_uncertainty_um, axis=0), rest.rms_um


LAGS_S = (
    (600.0, 1800.0, 5400.0, 14400.0),
    (300.0, 900.0, 2700.0, 8100.0),
    (900.0, 3600.0),
    (1800.0, 7200.0),
    (3600.0,),
    (),
)
"""Sets of time constants among which the peer chooses."""


def follower(inputs: np.ndarray, time_s: np.ndarray, tau: float) -> np.ndarray:
    """Return the first-order lags of inputs (n, m), each held over the interval before its row."""
    state, found = inputs[0], [inputs[0]]
    for row, step in zip(inputs[1:], np.diff(time_s), strict=True):
        state = row + (state - row) * np.exp(-step / tau)
        found.append(state)
    return np.array(found)


def ridge_on_lags(whole: ThermalRecord, part: int) -> np.ndarray:
    """Return the RMS error of ridge regression on lags of all inputs after a part of a record, by displacement.

    The peer: lags and penalty are chosen by blocks of time of the part that is fitted.
    """
    start, speed = whole.temperature_degC - whole.temperature_degC[0], np.asarray(whole.speed_rpm)[:, None] / 1000.0
    inputs = np.concatenate([start, speed, speed**2], axis=1)
    y, fitted = whole.displacement_um, np.arange(0, part, 5)
    best = np.full((2, y.shape[1]), np.inf)
    for lags in LAGS_S:
        x = np.concatenate([inputs, *(follower(inputs, whole.time_s, tau) for tau in lags)], axis=1)
        x = (x - x[:part].mean(axis=0)) / x[:part].std(axis=0)

        def predicted(rows: np.ndarray, penalty: float, x: np.ndarray = x) -> np.ndarray:
            centre = y[rows].mean(axis=0)
            normal = x[rows].T @ x[rows] + penalty * np.eye(x.shape[1])
            return np.asarray(centre + x @ np.linalg.solve(normal, x[rows].T @ (y[rows] - centre)))

        for penalty in 10.0 ** np.arange(-2.0, 4.1):
            blocks = np.array_split(fitted, 5)
            off = sum(np.sum((predicted(np.setdiff1d(fitted, one), penalty) - y)[one] ** 2, axis=0) for one in blocks)
            found = np.sqrt(np.mean((predicted(fitted, penalty) - y)[part:] ** 2, axis=0))
            best = np.where(off < best[0], np.stack([off, found]), best)
    return best[1]


@pytest.mark.slow
def test_a_real_record_is_predicted_after_nine_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors and 95 % intervals after 40, 45 … 80 % of the record, for each displacement, beside ridge regression on lags.

    Models of few terms alone covered 85 %, with errors of d1 and d2 twice as large; without the jackknife 61 to 68 % of some. At 50
    to 60 % the highest speed is still to come, and ridge is better for d3 (ratios of 2.1, 1.5, 1.3): nothing before shows its effect.
    """
    monkeypatch.undo()
    whole = ThermalRecord.load(beside("data", "real", "spindle-thermal", "first-half.csv"))
    shares = np.arange(0.4, 0.81, 0.05)
    inside, size_um = map(np.array, zip(*(after(whole, share) for share in shares), strict=True))
    ratios = size_um / [ridge_on_lags(whole, round(share * len(whole))) for share in shares]
    assert np.all(inside.mean(axis=0) >= 0.92) and inside.min() >= 0.75, inside
    assert np.all(np.sqrt(np.mean(size_um**2, axis=0)) <= (2.8, 2.8, 6.0, 5.6, 6.8)), size_um
    assert np.all(np.exp(np.log(ratios).mean(axis=0)) <= (0.8, 0.8, 0.8, 0.8, 1.0)), ratios


@pytest.mark.slow
def test_intervals_cover_what_a_network_of_heat_capacities_does_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second half from the first, over drawn machines that no sum of the fitted terms describes exactly."""
    monkeypatch.undo()
    inside, ratios = [], []
    for seed in range(8):
        whole = ThermalRecord.load(write(structure(seed), tmp_path / "record.csv"))
        covered, rms_um = after(whole, 0.5)
        inside.append(covered)
        ratios.append(rms_um / ridge_on_lags(whole, len(whole) // 2))
    assert 0.88 <= np.mean(inside) <= 0.99, inside
    assert np.exp(np.mean(np.log(ratios))) <= 0.6, ratios
