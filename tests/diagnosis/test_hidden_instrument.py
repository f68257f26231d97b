"""Effects of the machine or of the instrument: targets on both sides separate the two; otherwise both are named.

The truth machine (`tests.truth.hidden`) shares no code with `twin`.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.real import plates
from tests.truth import hidden
from tests.truth.few_axes import write_stage
from tests.truth.hidden import Hidden, Plan
from twin.diagnosis import Diagnosis, diagnose
from twin.diagnosis.candidates.instrument import velocities
from twin.diagnosis.causes import one_for_each_number
from twin.diagnosis.estimate import over_forms
from twin.diagnosis.readings import readings
from twin.diagnosis.search import candidates_of
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

SIGMA_MM = 3e-3
POSES = 60


def one(effect: str, where: str, **numbers: float) -> Hidden:
    return Hidden(effect, where, numbers)


def measured(
    folder: Path, machine: Machine, of: Plan, read: np.ndarray, rng: np.random.Generator, *, side: str | None = None
) -> Diagnosis:
    """Diagnose readings with isotropic noise, of all targets or of those on one side."""
    noisy = hidden.noisy(read, rng, "isotropic", SIGMA_MM)
    data = Measurements.load(hidden.write(folder / "measured.csv", of, noisy, u_mm=SIGMA_MM), machine)
    if side is not None:
        data = data.select(data.carrier == side)
    return diagnose(data, machine, Calibration.default(machine))


@pytest.fixture
def look(dmu50: Machine, tmp_path: Path) -> Callable[..., Diagnosis]:
    def found(effects: Sequence[Hidden], seed: int, *, side: str | None = None) -> Diagnosis:
        rng = np.random.default_rng(seed)
        of = hidden.rounded(hidden.plan(rng, poses=POSES))
        return measured(tmp_path, dmu50, of, hidden.points(of, effects), rng, side=side)

    return found


DRIFTS = {
    "machine, straight": one("thermal_drift", "Z", rate=6.0),
    "machine, exponential": one("thermal_drift", "Z", amplitude=12.0, time_constant=1500.0),
    "station, straight": one("station_drift", "1", rate_x=0.0, rate_y=0.0, rate_z=6.0),
    "station, exponential": one("station_drift", "1", rate_x=0.0, rate_y=0.0, rate_z=30.0, time_constant=1500.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", DRIFTS)
def test_targets_on_both_sides_decide_whose_drift_it_is(look: Callable[..., Diagnosis], name: str) -> None:
    truth = DRIFTS[name]
    result = look([truth], 41)
    (cause,) = result.causes
    assert (cause.effect, cause.where) == truth.key
    assert not {effect for effect, _ in cause.equivalent} & ({"thermal_drift", "station_drift"} - {truth.effect})
    found = {q.name: q for q in cause.parameters}
    # Three standard uncertainties, of at most four numbers.
    assert max(abs(found[key].value - value) / found[key].u for key, value in truth.numbers.items()) < 3.0
    assert cause.bounded == (name == "machine, straight")
    assert ("time_constant" in found) == ("exponential" in name)
    assert (", at " in cause.evidence) == ("straight" in name)


@pytest.mark.sample(1)  # of 4
@pytest.mark.parametrize("name", DRIFTS)
def test_targets_on_the_tool_side_alone_leave_open_whose_drift_it_is(look: Callable[..., Diagnosis], name: str) -> None:
    result = look([DRIFTS[name]], 42, side="tool")
    assert result.verdict == "ambiguous"
    (cause,) = result.causes
    group = {(cause.effect, cause.where), *cause.equivalent}
    assert {("thermal_drift", "Z"), ("station_drift", "1")} <= group
    assert ("thermal_drift", "X") not in group and ("thermal_drift", "Y") not in group


@pytest.mark.slow
def test_a_station_that_drifts_in_space_is_a_tool_side_that_drifts_along_each_direction(
    look: Callable[..., Diagnosis],
) -> None:
    truth = one("station_drift", "1", rate_x=6.0, rate_y=-5.0, rate_z=7.0)
    (cause,) = look([truth], 43, side="tool").causes
    group = {(cause.effect, cause.where), *cause.equivalent}
    assert {("station_drift", "1"), *(("thermal_drift", axis) for axis in "XYZ")} <= group
    (alone,) = look([truth], 43).causes
    assert (alone.effect, alone.where, alone.equivalent) == ("station_drift", "1", ())


@pytest.mark.slow
def test_a_straight_drift_goes_into_the_calibration_as_a_rate(look: Callable[..., Diagnosis], tmp_path: Path) -> None:
    result = look([DRIFTS["machine, straight"]], 41)
    result.extended.save(tmp_path / "extended.yaml")
    again = Calibration.load(tmp_path / "extended.yaml", result.calibration.machine)
    (effect,) = [one for one in again.effects if one.name == "thermal_drift:Z"]
    (rate,) = effect.parameters
    assert (rate.name, rate.unit) == ("thermal_drift:Z.rate", "um/h")
    assert effect.components({"time_s": np.array([0.0, 1800.0])})[2] == pytest.approx([0.0, rate.value / 2.0])


@pytest.mark.slow
def test_a_nearly_straight_drift_beside_a_large_pitch_error_whose_period_is_sought(
    look: Callable[..., Diagnosis],
) -> None:
    """An exponential fits as well as the straight line, which is preferred: no time constant is reported."""
    pitch = one("pitch_error", "X", amplitude=40.0, period=17.3, phase=0.4)
    result = look([one("thermal_drift", "Z", rate=3.0), pitch], 43)
    found = {(cause.effect, cause.where): {q.name: q for q in cause.parameters} for cause in result.causes}
    assert found.keys() == {("thermal_drift", "Z"), ("pitch_error", "X")}
    period = found["pitch_error", "X"]["period"]
    assert abs(period.value - 17.3) < 3.0 * period.u


AFFINE = dict(scale_x=-40.0, scale_y=25.0, scale_z=15.0, shear_xy=30.0, shear_xz=-20.0, shear_yz=10.0)


@pytest.mark.slow
@pytest.mark.parametrize("where", ["station 2", "round 2"])
def test_an_instrument_is_affine(dmu50: Machine, tmp_path: Path, where: str) -> None:
    rng = np.random.default_rng(51)
    of = hidden.rounded(hidden.plan(rng, poses=POSES, stations=2 if "station" in where else 1))
    truth = one("affine_scale", where, **AFFINE)
    result = measured(tmp_path, dmu50, of, hidden.points(of, [truth]), rng)
    (cause,) = result.causes
    assert (cause.effect, cause.where, cause.origin, cause.equivalent) == ("affine_scale", where, "instrument", ())
    assert result.extended.source == result.calibration.source
    found = {q.name: q for q in cause.parameters}
    assert max(abs(found[name].value - value) / found[name].u for name, value in AFFINE.items()) < 3.0


def test_the_size_of_an_affine_error_allows_for_its_centre(
    dmu50: Machine, calibration: Calibration, tmp_path: Path
) -> None:
    """Weak errors about the centre of the readings: the likelier of the two forms is often the wrong one, and u must include that."""
    rng = np.random.default_rng(53)
    of = hidden.rounded(hidden.plan(rng, poses=POSES))
    data = Measurements.load(hidden.write(tmp_path / "m.csv", of, hidden.points(of), u_mm=SIGMA_MM), dmu50)
    task = readings(data, dmu50, calibration).without(np.zeros(len(data), dtype=bool))
    problem, known = task.problem, task.catalogue
    variants = next(one for one in known.candidates if one.key == ("affine_scale", "round 2")).variants
    forms = [[replace(column, scale=1.0) for column in variant.columns] for variant in variants]
    columns = [problem.signature(own) for own in forms]
    covariances = [np.linalg.inv(problem.inner(own)) for own in columns]
    pulls, alone = [], []
    for _ in range(60):
        value = rng.standard_normal(6)
        value *= np.sqrt(30.0 / (value @ np.linalg.inv(covariances[1]) @ value))
        residual = problem.project(columns[1] @ value + rng.standard_normal(len(problem.residual)))
        problem.set_residual(residual)
        slopes = [own.T @ residual for own in columns]
        best = int(np.argmax([slope @ own @ slope for slope, own in zip(slopes, covariances, strict=True)]))
        off = covariances[best] @ slopes[best] - value
        spread = over_forms(problem, [forms[best], forms[1 - best]], [])
        pulls.append(off / np.sqrt(np.diag(spread)))
        alone.append(off / np.sqrt(np.diag(covariances[best])))
    assert 0.7 < np.sqrt(np.mean(np.square(pulls))) < 1.3 and np.mean(np.abs(pulls) < 1.96) > 0.93
    assert np.abs(alone).max() > 8.0 > 5.0 > np.abs(pulls).max()  # pulls with u from the likelier form alone


def plate(folder: Path, rng: np.random.Generator, strain: np.ndarray, *, station: str = "B", turn: float = 0.3) -> Path:
    """Return readings in x and y of a plate of 15 × 11 holes by two coordinate measuring machines, one with affine errors (2, 2)."""
    x, y = (a.reshape(-1) for a in np.meshgrid(np.linspace(-280.0, 280.0, 15), np.linspace(-200.0, 200.0, 11)))
    holes = np.stack([x, y], axis=1)
    lines = ["X_mm,Y_mm,target,carrier,station,x_mm,y_mm,z_mm,u_x_mm,u_y_mm"]
    for name, angle, shift in (("A", 0.0, (10.0, -5.0)), ("B", turn, (300.0, 210.0))):
        into = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        read = holes @ into.T + shift
        read = read + (read @ strain if name == station else 0.0) + 1e-3 * rng.standard_normal(read.shape)
        lines += [f"{X},{Y},drill,tool,{name},{a},{b},,0.001,0.001" for (X, Y), (a, b) in zip(holes, read, strict=True)]
    path = folder / "plate.csv"
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return path


def test_two_coordinate_measuring_machines_differ(tmp_path: Path) -> None:
    """Errors of 10.6 ppm along x and 13.9 µrad, as between two real machines; a plate read in x and y determines three numbers."""
    machine = Machine.load(plates.write_machine(tmp_path))
    strain = 1e-6 * np.array([[-10.6, -13.9 / 2.0], [-13.9 / 2.0, 0.0]])
    path = plate(tmp_path, np.random.default_rng(52), strain)
    result = diagnose(Measurements.load(path, machine), machine, Calibration.zero(machine))
    (cause,) = result.causes
    assert (cause.effect, cause.where, cause.origin) == ("affine_scale", "station B", "instrument")
    found = {q.name: q for q in cause.parameters}
    assert set(found) == {"scale_x", "scale_y", "shear_xy"}
    for name, value in {"scale_x": -10.6, "scale_y": 0.0, "shear_xy": -13.9}.items():
        assert abs(found[name].value - value) < 3.0 * found[name].u
    assert result.extended.source == result.calibration.source


def test_one_instrument_alone_is_not_blamed_for_what_the_machine_may_do(tmp_path: Path) -> None:
    """With one station and one round an affine error is confounded with the machine's scale and is not tested."""
    machine = Machine.load(plates.write_machine(tmp_path))
    strain = 1e-6 * np.array([[40.0, 0.0], [0.0, 0.0]])
    path = plate(tmp_path, np.random.default_rng(53), strain, turn=0.0)
    data = Measurements.load(path, machine)
    result = diagnose(data.select(data.station == "B"), machine, Calibration.zero(machine))
    assert "affine_scale" not in {effect for effect, _, _, _ in result.ranking}
    (scale,) = [cause for cause in result.causes if (cause.effect, cause.where) == ("positioning", "E_XX")]
    # The claim says that it rests on the instrument, and which measurement would decide.
    assert "calibrated length" in scale.assumes and scale.to_dict()["assumes"] == scale.assumes
    assert "assumes that the instrument reads to scale" in " ".join(result.to_text().split())
    # Two stations on different sides do not have the same error in the machine's frame.
    both = diagnose(data, machine, Calibration.zero(machine))
    assert not any(cause.assumes for cause in both.causes if cause.origin == "machine")


def test_equal_scales_of_one_station_are_confounded_with_refraction(tmp_path: Path) -> None:
    """A scale of station A, while B reads one place only: confounded with a scale of all lengths."""
    machine = Machine.load(plates.write_machine(tmp_path))
    path = plate(tmp_path, np.random.default_rng(54), 12e-6 * np.eye(2), station="A")
    data = Measurements.load(path, machine)
    few = (data.station == "A") | (np.abs(data.positions) < 60.0).all(axis=1)
    (cause,) = diagnose(data.select(few), machine, Calibration.zero(machine)).causes
    group = {(cause.effect, cause.where), *cause.equivalent}
    assert {("refraction_scale", "—"), ("affine_scale", "station A")} <= group


def on_the_way(folder: Path, feeds: Sequence[float], *, delay_s: float = 0.0, reversal_um: float = 0.0) -> Diagnosis:
    """Return readings of a slide of 500 mm in motion, forwards and backwards once at each feed, mm/min; noise 0.6 µm."""
    machine, rng = Machine.load(write_stage(folder)), np.random.default_rng(71)
    with (folder / "way.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(
            "X_mm approach_X feed_mm_min target carrier x_mm y_mm z_mm round place_x_mm place_y_mm place_z_mm".split()
        )
        for cycle, feed in enumerate(feeds):
            for way in (1, -1):
                # Start outside, so that the first position is approached as the others are.
                for at in np.linspace(20.0, 480.0, 24)[::way]:
                    gone_on = way * feed / 60.0 * delay_s
                    off = 0.5 * way * reversal_um + 0.6 * rng.standard_normal()
                    x = at + gone_on + 1e-3 * off
                    table.writerow([at, way, feed, "slide", "tool", x, "", "", cycle + 1, 0, 0, 0])
    return diagnose(Measurements.load(folder / "way.csv", machine), machine, Calibration.zero(machine))


def test_a_delay_grows_with_the_feed(tmp_path: Path) -> None:
    """0.4 ms at 500, 2000 and 4000 mm/min corresponds to 3 to 27 µm."""
    result = on_the_way(tmp_path, (500.0, 2000.0, 4000.0), delay_s=4e-4)
    (cause,) = result.causes
    assert (cause.effect, cause.where, cause.origin, cause.equivalent) == ("time_skew", "X", "instrument", ())
    (delay,) = cause.parameters
    assert (delay.name, delay.unit) == ("delay", "s") and abs(delay.value - 4e-4) < 3.0 * delay.u
    assert result.extended.source == result.calibration.source


def test_a_reversal_is_the_same_at_every_feed(tmp_path: Path) -> None:
    (cause,) = on_the_way(tmp_path, (500.0, 2000.0, 4000.0), reversal_um=9.0).causes
    assert (cause.effect, cause.where, cause.equivalent) == ("reversal", "X", ())


@pytest.mark.parametrize("numbers", [{"delay_s": 4e-4}, {"reversal_um": 9.0}], ids=["delay", "reversal"])
def test_at_one_feed_a_delay_and_a_reversal_are_the_same(tmp_path: Path, numbers: dict[str, float]) -> None:
    result = on_the_way(tmp_path, (2000.0, 2000.0, 2000.0), **numbers)
    (cause,) = result.causes
    assert result.verdict == "ambiguous"
    assert {("reversal", "X"), ("time_skew", "X")} <= {(cause.effect, cause.where), *cause.equivalent}


def test_without_a_feed_no_delay_is_tested(look: Callable[..., Diagnosis]) -> None:
    result = look([], 72)
    assert ("time_skew", "Y", "feed_mm_min") in result.not_evaluated


def test_rows_closer_than_a_second_were_sampled_in_motion(tmp_path: Path) -> None:
    """Velocities by hand: 10 mm in 0.5 s, at rest for 2 s, then back."""
    machine = Machine.load(write_stage(tmp_path))
    lines = ["X_mm,target,carrier,x_mm,y_mm,z_mm,time_s"]
    times = ((0, 0.0), (10, 0.5), (20, 1.0), (30, 3.0), (25, 3.5))
    lines += [f"{x},slide,tool,{x}.001,,,{t}" for x, t in times]
    (tmp_path / "fly.csv").write_text("\n".join([*lines, ""]), encoding="utf-8")
    data = Measurements.load(tmp_path / "fly.csv", machine)
    assert velocities(data, machine)["X"] == pytest.approx([0.0, 20.0, 20.0, 0.0, -10.0])
    data.save(tmp_path / "again.csv", machine)
    assert "feed" not in (tmp_path / "again.csv").read_text(encoding="utf-8")


def test_the_feed_is_shared_by_the_axes_that_moved(dmu50: Machine, tmp_path: Path) -> None:
    lines = ["X_mm,Y_mm,Z_mm,B_deg,C_deg,target,carrier,x_mm,y_mm,z_mm,feed_mm_min,approach_Y"]
    rows = ((0, 0, 0), (30, 40, 6000), (30, 40, 6000), (30, 10, 600))
    lines += [
        f"{x},{y},0,0,0,K,tool,{x}.00{i},{y},0,{feed},{1 if y != 10 else -1}" for i, (x, y, feed) in enumerate(rows)
    ]
    (tmp_path / "feed.csv").write_text("\n".join([*lines, ""]), encoding="utf-8")
    data = Measurements.load(tmp_path / "feed.csv", dmu50)
    found = velocities(data, dmu50)
    assert set(found) == {"X", "Y"}
    assert found["X"] == pytest.approx([0.0, 60.0, 60.0, 0.0]) and found["Y"] == pytest.approx([0.0, 80.0, 80.0, -10.0])
    data.save(tmp_path / "again.csv", dmu50)
    assert Measurements.load(tmp_path / "again.csv", dmu50).feed_mm_min.tolist() == [0.0, 6000.0, 6000.0, 600.0]


def of_one_station(
    folder: Path,
    change: Callable[[np.ndarray], np.ndarray] = lambda seen: seen,
    hide: Sequence[Hidden] = (),
    *,
    seed: int = 83,
) -> Diagnosis:
    """Return the diagnosis of readings of the DMU 50 from one station, 2 µm of noise; ``change``: the instrument's own error."""
    rng = np.random.default_rng(seed)
    plan = hidden.plan(rng, rounds=3, stops=7, poses=40)
    readings = hidden.noisy(change(hidden.points(plan, hide)), rng, "isotropic", 2e-3)
    machine = Machine.load("dmu50")
    data = Measurements.load(hidden.write(folder / "one.csv", plan, readings, u_mm=2e-3), machine)
    return diagnose(data, machine, Calibration.default(machine))


def test_equal_scales_of_all_axes_are_not_told_from_a_scale_of_all_lengths(tmp_path: Path) -> None:
    """20 µm/m of X, Y and Z: the machine is 1.8 K warm, or the air is wrong. One number, two causes: ambiguous, whichever is true."""
    warm = [Hidden("positioning", f"E_{a}{a}", {"c1": size}) for a, size in (("X", 5.0), ("Y", 4.5), ("Z", 4.0))]
    scales = {("positioning", f"E_{a}{a}") for a in "XYZ"}
    for hide in (warm, [Hidden("refraction_scale", "—", {"scale": 19.0})]):
        result = of_one_station(tmp_path, hide=hide)
        (cause,) = result.causes
        assert result.verdict == "ambiguous" and (cause.effect, cause.where) == ("refraction_scale", "—")
        assert [set(group) for group in cause.together] == [scales] and set(cause.equivalent) == scales
        assert all(len(entry["together_with"]) == 2 for entry in cause.to_dict()["equivalent"])
        text = " ".join(result.to_text().split())
        assert "calibrated length on the table" in text and "show no error of the machine" not in text
        assert "No effect: the error is in the readings only" not in text
        assert len(result.next_measurement) == 1


@pytest.mark.parametrize("seed", [83, 1])
def test_one_instrument_out_of_square_is_named_where_rotary_axes_turn_the_targets(tmp_path: Path, seed: int) -> None:
    """30 µrad of shear at two metres differ from a beam bent sideways by less than the noise: either is named, with the other."""
    strain = np.zeros((3, 3))
    strain[0, 1] = strain[1, 0] = 15e-6
    result = of_one_station(tmp_path, lambda seen: seen @ (np.eye(3) + strain), seed=seed)
    (cause,) = result.causes
    shear = ("affine_scale", "station 1")
    assert shear in {(cause.effect, cause.where), *cause.equivalent} and cause.origin == "instrument"
    assert {(cause.effect, cause.where), *cause.equivalent} <= {shear, ("beam_bending", "1")}
    assert result.verdict == ("ambiguous" if cause.equivalent else "explained")
    if (cause.effect, cause.where) == shear:
        found = {q.name: q for q in cause.parameters}
        for name in found:
            assert abs(found[name].value - (30.0 if name == "shear_xy" else 0.0)) < 3.5 * found[name].u


def test_a_sagging_beam_is_named(tmp_path: Path) -> None:
    """8 µm at one metre, 32 at two: not a squareness error and a load of the table."""
    down = np.array([0.0, 0.0, -8e-3])
    result = of_one_station(tmp_path, lambda seen: seen + np.sum(seen**2, axis=1, keepdims=True) * 1e-6 * down)
    (cause,) = result.causes
    assert (cause.effect, cause.where) == ("beam_bending", "1") and cause.origin == "instrument"
    found = {q.name: q for q in cause.parameters}
    for name, value in {"bend_x": 0.0, "bend_y": 0.0, "bend_z": -8.0}.items():
        assert abs(found[name].value - value) < 3.5 * found[name].u
    assert result.extended.source == result.calibration.source


def test_two_causes_that_are_one_number_are_named_once(tmp_path: Path) -> None:
    """Targets on the tool side alone: a straight drift of the machine along x and one of the station are the same readings."""
    rng = np.random.default_rng(84)
    plan = hidden.plan(rng, rounds=3, stops=7, poses=30)
    creep = Hidden("thermal_drift", "X", {"rate": 9.0})
    readings_mm = hidden.noisy(hidden.points(plan, [creep]), rng, "isotropic", SIGMA_MM)
    machine = Machine.load("dmu50")
    data = Measurements.load(hidden.write(tmp_path / "tool.csv", plan, readings_mm, u_mm=SIGMA_MM), machine)
    data = data.select(data.carrier == "tool")
    placed = readings(data, machine, Calibration.default(machine))
    candidates = candidates_of(placed.without(np.zeros(len(data), dtype=bool)))
    straight = [form for form in candidates.forms if np.isinf(form.nonlinear.get("time_constant", np.inf))]
    drift = next(form for form in straight if form.key == ("thermal_drift", "X"))
    station = next(form for form in straight if form.key == ("station_drift", "1"))
    other = next(form for form in straight if form.key == ("reversal", "Y"))
    assert one_for_each_number(candidates, [station, drift, other]) == [station, other]
    assert one_for_each_number(candidates, [drift, other]) == [drift, other]
    # The one that the other spans goes, in any order: a drift of the station is in three directions.
    assert one_for_each_number(candidates, [drift, station, other]) == [station, other]


MOVED = {"shift_x": 14.0, "shift_y": -9.0, "shift_z": 6.0, "turn_x": 3.0, "turn_y": -5.0, "turn_z": 6.0}


@pytest.mark.sample(2)  # of 3
@pytest.mark.parametrize("where", ["round 2 only", "round 2", "round 3"])
def test_one_round_that_is_aligned_differently_is_a_shift_of_it(look: Callable[..., Diagnosis], where: str) -> None:
    truth = one("frame_shift", where, **MOVED)
    result = look([truth], 61)
    (cause,) = result.causes
    assert (cause.effect, cause.where, cause.equivalent) == (*truth.key, ())
    assert result.verdict == "explained" and result.unexplained is None
    found = {q.name: q for q in cause.parameters}
    assert max(abs(found[key].value - value) / found[key].u for key, value in MOVED.items()) < 3.0
    assert ("aligned differently in" in cause.evidence) == where.endswith("only")
    assert result.extended.source == result.calibration.source


def test_a_scale_of_one_round_is_no_shift_of_it(look: Callable[..., Diagnosis]) -> None:
    strain = {"scale_x": 40.0, "scale_y": -35.0, "scale_z": 0.0, "shear_xy": 30.0, "shear_xz": 0.0, "shear_yz": -20.0}
    (cause,) = look([one("affine_scale", "round 2", **strain)], 62).causes
    assert (cause.effect, cause.where) == ("affine_scale", "round 2")
