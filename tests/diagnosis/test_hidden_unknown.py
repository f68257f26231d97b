"""Hidden patterns that are in no catalogue, or deviate from the form of their effect: what `twin diagnose` must call unexplained.

The truth machine (`tests.truth.hidden`, and for one axis the few lines here) shares no code with `twin`.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.truth import hidden
from tests.truth.few_axes import write_stage
from tests.truth.hidden import Hidden, Plan
from twin.diagnosis import Diagnosis, diagnose
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.calibration_file import MeasuredWith, MisfitEntry, UnidentifiedEntry

SIGMA_MM = 3e-3
NONCENTRALITY = 300.0


def unit(of: Plan, axis: str) -> np.ndarray:
    """Return (n,) positions of an axis, scaled to 0 to 1 over their range."""
    q = of.at(axis)
    return np.asarray((q - q.min()) / np.ptp(q))


def waves(of: Plan) -> np.ndarray:
    return np.sin(np.pi * 5.3 * unit(of, "X") + 0.4) * np.sin(np.pi * 6.1 * unit(of, "Y") + 1.0)


def lost_motion(of: Plan) -> np.ndarray:
    return np.asarray(of.approach[:, 1] * (unit(of, "Z") - 0.5))


def jump(of: Plan) -> np.ndarray:
    return np.asarray(unit(of, "B") > 0.43, dtype=float)


def bump(of: Plan) -> np.ndarray:
    off = (unit(of, "X") - 0.4) ** 2 + (unit(of, "Z") - 0.6) ** 2
    return np.asarray(np.exp(-off / (2.0 * 0.2**2)))


UNKNOWN = {
    "short waves": (waves, "tool", {"X_mm", "Y_mm"}),
    "reversal along Z": (lost_motion, "tool", {"approach_Y", "Z_mm"}),
    "a jump of B": (jump, "tool", {"B_deg"}),
    "a bump": (bump, "tool", {"X_mm", "Z_mm"}),
    "short waves on the table": (waves, "work", {"X_mm", "Y_mm"}),
}


def scaled(of: Plan, shape: np.ndarray, side: str, noncentrality: float) -> np.ndarray:
    """Return (n, 3) a shift of one side's targets, mm, scaled to a noncentrality after projecting out the set-up."""
    moved = (shape * (of.carrier == side))[:, None] * np.array([0.5, -0.6, 0.62])
    read = (hidden.points(of, outside=lambda _: 1e-3 * moved) - hidden.points(of))[:, :, None]
    size = float(np.sum(hidden.left_over(of, read, "isotropic", SIGMA_MM) ** 2))
    return np.asarray(1e-3 * moved * np.sqrt(noncentrality / size))


def look(
    folder: Path,
    calibration: Calibration,
    of: Plan,
    moved: np.ndarray,
    *effects: Hidden,
    without: Sequence[str] = (),
) -> Diagnosis:
    rng, machine = np.random.default_rng(9), calibration.machine
    read = hidden.noisy(hidden.points(of, effects, outside=lambda _: moved), rng, "isotropic", SIGMA_MM)
    table = hidden.write(folder / "m.csv", of, read, u_mm=SIGMA_MM, without=without)
    return diagnose(Measurements.load(table, machine), machine, calibration)


def planned(seed: int) -> Plan:
    return hidden.rounded(hidden.plan(np.random.default_rng(seed), poses=140))


@pytest.mark.slow
@pytest.mark.parametrize(
    "what",
    [
        pytest.param(what, marks=pytest.mark.slow) if what in ("a bump", "short waves on the table") else what
        for what in UNKNOWN
    ],
)
def test_a_pattern_in_no_catalogue_is_unexplained(what: str, calibration: Calibration, tmp_path: Path) -> None:
    shape, side, columns = UNKNOWN[what]
    of = planned(21)
    moved = scaled(of, shape(of), side, NONCENTRALITY)
    result = look(tmp_path, calibration, of, moved)
    assert result.verdict == "unexplained" and result.causes == ()
    left = result.unexplained
    assert left is not None and set(left.depends_on) == columns and left.carrier == side
    # The size after projecting out the set-up, RMS per coordinate: λ within three of its standard deviations, 2 √λ.
    size = 1e3 * SIGMA_MM * np.sqrt(NONCENTRALITY / (3 * len(of.q)))
    assert left.size_um == pytest.approx(size, rel=0.2)


SMALL_SIGMA_MM = 2e-3
ALONG_Z, ALONG_ALL = np.array([0.0, 0.0, 1.0]), np.array([0.5, -0.6, 0.62])


def dent(of: Plan, rng: np.random.Generator) -> np.ndarray:
    x, y = rng.uniform(0.3, 0.7, 2)
    width = rng.uniform(0.12, 0.22)
    return np.asarray(np.exp(-((unit(of, "X") - x) ** 2 + (unit(of, "Y") - y) ** 2) / (2.0 * width**2)))


def from_the_third_round(of: Plan, rng: np.random.Generator) -> np.ndarray:
    return np.asarray(of.round == "3", dtype=float)


def small(seed: int) -> tuple[Plan, np.random.Generator]:
    """486 readings, as many as a shop takes in an hour."""
    rng = np.random.default_rng(seed)
    return hidden.rounded(hidden.plan(rng, rounds=3, stops=5, poses=31)), rng


def diagnosed(
    folder: Path,
    calibration: Calibration,
    of: Plan,
    rng: np.random.Generator,
    *shapes: tuple[np.ndarray, np.ndarray, float],
) -> Diagnosis:
    """Return the diagnosis of shifts of the tool side: shape over the rows, direction, and noncentrality of each."""
    moved = np.zeros((len(of.q), 3))
    for shape, direction, noncentrality in shapes:
        own = 1e-3 * (shape * (of.carrier == "tool"))[:, None] * direction
        read = (hidden.points(of, outside=lambda _, own=own: own) - hidden.points(of))[:, :, None]
        moved += own * np.sqrt(noncentrality / np.sum(hidden.left_over(of, read, "isotropic", SMALL_SIGMA_MM) ** 2))
    machine = calibration.machine
    read = hidden.noisy(hidden.points(of, (), outside=lambda _: moved), rng, "isotropic", SMALL_SIGMA_MM)
    table = hidden.write(folder / "m.csv", of, read, u_mm=SMALL_SIGMA_MM)
    return diagnose(Measurements.load(table, machine), machine, calibration)


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3, 4, 5))])
def test_a_dent_is_not_the_straightness_of_two_axes(seed: int, calibration: Calibration, tmp_path: Path) -> None:
    """A function of X and Y together: the parts that are functions of X alone and of Y alone explain most of it."""
    of, rng = small(seed)
    result = diagnosed(tmp_path, calibration, of, rng, (dent(of, rng), ALONG_Z, NONCENTRALITY))
    assert result.verdict == "unexplained" and result.causes == ()
    assert result.unexplained is not None and set(result.unexplained.depends_on) == {"X_mm", "Y_mm"}


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3, 4, 5))])
def test_the_straightness_of_two_axes_is_not_a_dent(seed: int, calibration: Calibration, tmp_path: Path) -> None:
    of, rng = small(seed)
    shapes = [np.polynomial.legendre.legval(2.0 * unit(of, axis) - 1.0, rng.normal(size=5)) for axis in "XY"]
    result = diagnosed(tmp_path, calibration, of, rng, *((shape, ALONG_Z, 100.0) for shape in shapes))
    assert {(cause.effect, cause.where) for cause in result.causes} == {("straightness", f"E_Z{axis}") for axis in "XY"}


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3, 4, 5))])
def test_a_jump_of_the_tool_side_is_one_pattern_of_the_round(
    seed: int, calibration: Calibration, tmp_path: Path
) -> None:
    """Not three targets that moved by the same vector at the same time; what else changes with time may be named with the round."""
    of, rng = small(seed)
    result = diagnosed(tmp_path, calibration, of, rng, (from_the_third_round(of, rng), ALONG_ALL, NONCENTRALITY))
    assert result.verdict == "unexplained" and result.causes == ()
    left = result.unexplained
    assert left is not None and ("round",) in {left.depends_on, *left.or_on}


@pytest.mark.slow
def test_an_effect_of_another_column_is_found_with_an_unknown_pattern(calibration: Calibration, tmp_path: Path) -> None:
    """Short waves over X and Y on the tool side do not affect the effect of B."""
    of = planned(22)
    moved = scaled(of, waves(of), "tool", NONCENTRALITY)
    result = look(tmp_path, calibration, of, moved, Hidden("reversal", "B", {"size": 40.0}))
    assert [(cause.effect, cause.where) for cause in result.causes] == [("reversal", "B")]
    (size,) = result.causes[0].parameters
    assert abs(size.value - 40.0) < 3.0 * size.u
    assert result.unexplained is not None and set(result.unexplained.depends_on) == {"X_mm", "Y_mm"}


def growth(form: Callable[[np.ndarray], np.ndarray]) -> Callable[[Plan], np.ndarray]:
    """The tool's side moves along z with the bed's temperature, not quite in proportion."""

    def moved(of: Plan) -> np.ndarray:
        warm = of.warm["bed"] - 20.0
        return np.asarray((form(warm) * (of.carrier == "tool"))[:, None] * np.array([0.0, 0.0, 1e-3]))

    return moved


@pytest.mark.slow
def test_a_cause_of_imperfect_form_is_named(calibration: Calibration, tmp_path: Path) -> None:
    """30 µm/K with a curvature far above the noise: the growth is named, the size of the remainder is given."""
    of = planned(23)
    moved = growth(lambda warm: 30.0 * warm + 2.5 * warm**2)(of)
    # Other sensors and time in the table can together imitate the curvature.
    result = look(tmp_path, calibration, of, moved, without=("time_s", "T_X_degC", "T_Y_degC", "T_Z_degC"))
    assert [(cause.effect, cause.where) for cause in result.causes] == [("thermal_growth", "Z by bed")]
    (number,) = result.causes[0].parameters
    assert abs(number.value - 30.0) < 3.0 * number.u and number.value == pytest.approx(30.0, rel=0.05)
    assert result.verdict in ("explained", "ambiguous") and result.causes[0].share > 0.9
    left = result.unexplained
    assert left is not None and left.share < 0.1 and 0.2 < left.size_um < 3.0


def stage_table(path: Path, positions: np.ndarray, curve_um: np.ndarray, reversal_um: float, sigma_um: float) -> Path:
    """A slide measured along itself: five cycles there and back, one coordinate."""
    rng = np.random.default_rng(4)
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow("X_mm approach_X target carrier x_mm y_mm z_mm round place_x_mm place_y_mm place_z_mm".split())
        for cycle in range(5):
            for way in (1, -1):
                for i in range(len(positions))[::way]:
                    off = curve_um[i] + 0.5 * way * reversal_um + sigma_um * rng.standard_normal()
                    table.writerow(
                        [positions[i], way, "slide", "tool", positions[i] + 1e-3 * off, "", "", cycle + 1, 0, 0, 0]
                    )
    return path


def test_a_curve_that_does_not_predict_held_out_positions_is_not_promised(tmp_path: Path) -> None:
    """Random errors that repeat at six positions are named, but enter no calibration and no figure of gain."""
    machine = Machine.load(write_stage(tmp_path))
    positions = np.linspace(0.0, 500.0, 6)
    rough = np.array([-12.0, 21.0, 2.0, -17.0, 15.0, -9.0])
    data = Measurements.load(stage_table(tmp_path / "rough.csv", positions, rough, -4.0, 0.6), machine)
    found = diagnose(data, machine, Calibration.zero(machine))
    by_name = {(cause.effect, cause.where): cause for cause in found.causes}
    assert set(by_name) == {("positioning", "E_XX"), ("reversal", "X")}
    curve = by_name["positioning", "E_XX"]
    assert not curve.promised and curve.effects == () and "held-out" in curve.evidence
    assert "E_XX" not in {name for name in found.extended.curves}
    (size,) = by_name["reversal", "X"].parameters
    assert abs(size.value + 4.0) < 3.0 * size.u
    gain = found.gain
    assert gain is not None and gain.rms_after_um > 10.0 and gain.tool_after_um > 10.0
    assert gain.held_out is not None and gain.held_out.of == "positions"


def test_a_curve_that_predicts_held_out_positions_is_promised(tmp_path: Path) -> None:
    """A parabola through eleven positions."""
    machine = Machine.load(write_stage(tmp_path))
    positions = np.linspace(0.0, 500.0, 11)
    bow = 20.0 * ((positions - 250.0) / 250.0) ** 2
    data = Measurements.load(stage_table(tmp_path / "bow.csv", positions, bow, 0.0, 0.6), machine)
    found = diagnose(data, machine, Calibration.zero(machine))
    (curve,) = found.causes
    assert (curve.effect, curve.where, curve.promised) == ("positioning", "E_XX", True)
    gain = found.gain
    assert gain is not None and gain.rms_after_um == pytest.approx(0.6, rel=0.15)
    held = gain.held_out
    assert held is not None and (held.of, held.groups) == ("positions", 11)
    assert held.ci95_um is not None and held.ci95_um[0] > 0.0
    assert held.after_um < 1.0
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["causes"][0]["promised"] is True


def test_the_extended_calibration_states_its_limits(tmp_path: Path) -> None:
    """Errors unknown to the given file stay unknown; errors that these readings could not show, and their residuals, are added."""
    machine = Machine.load(write_stage(tmp_path))
    positions = np.linspace(0.0, 500.0, 6)
    rough = np.array([-12.0, 21.0, 2.0, -17.0, 15.0, -9.0])
    table = stage_table(tmp_path / "rough.csv", positions, rough, -4.0, 0.6)
    found = diagnose(Measurements.load(table, machine), machine, Calibration.zero(machine))
    found.extended.save(tmp_path / "rough.yaml")
    rewritten = Calibration.load(tmp_path / "rough.yaml", machine)
    # One coordinate along X: the other five errors move no reading; the sixth is not known between six positions.
    unknown = {one.name: one.why for one in rewritten.not_identifiable}
    assert set(unknown) == {f"E_{letter}X" for letter in "XYZABC"}
    assert "between the measured positions" in unknown["E_XX"] and "no motion" in unknown["E_YX"]
    assert rewritten.misfit is not None and rewritten.misfit.verdict == "systematic"
    assert "positioning E_XX" in rewritten.misfit.says
    assert rewritten.set_up is not None and (rewritten.set_up.targets_on_tool, rewritten.set_up.points) == (1, 60)
    names = {warning.name for warning in rewritten.warnings}
    assert {"not_identifiable", "misfit"} <= names

    positions = np.linspace(0.0, 500.0, 11)
    bow = 20.0 * ((positions - 250.0) / 250.0) ** 2
    data = Measurements.load(stage_table(tmp_path / "bow.csv", positions, bow, 0.0, 0.6), machine)
    before = replace(
        Calibration.zero(machine),
        not_identifiable=tuple(UnidentifiedEntry(name=name, why="given") for name in ("E_XX", "E_YX")),
        not_estimated=("E_AX",),
        instruments=("r_test",),
        set_up=MeasuredWith(stations=1, targets_on_tool=1, targets_on_work=0, points=9),
        misfit=MisfitEntry(verdict="systematic"),
    )
    after = diagnose(data, machine, before).extended
    # These readings determine E_XX. The file says how it was measured, so that an error without a value is none.
    assert after.not_identifiable == before.not_identifiable[1:] and after.not_estimated == ("E_AX",)
    assert after.misfit is not None and after.misfit.verdict == "consistent"
    assert after.instruments[0] == "r_test" and len(after.instruments) == 2 and after.set_up == before.set_up


def test_a_period_with_an_alias_is_not_promised(tmp_path: Path) -> None:
    """At every 25 mm, a period of 62.5 mm is one of 41.7 mm: 1/25 − 1/62.5."""
    machine = Machine.load(write_stage(tmp_path))
    found, uneven = [], np.random.default_rng(3).uniform(0.0, 500.0, 31).round(2)
    for positions in (np.arange(0.0, 501.0, 25.0), np.sort(uneven)):
        wave = 8.0 * np.sin(2.0 * np.pi * positions / 62.5 + 0.7)
        data = Measurements.load(stage_table(tmp_path / "wave.csv", positions, wave, 0.0, 0.6), machine)
        (cause,) = diagnose(data, machine, Calibration.zero(machine)).causes
        assert (cause.effect, cause.where) == ("pitch_error", "X")
        found.append(cause)
    even, apart = found
    assert not even.promised and even.effects == () and "fit equally well at these positions" in even.evidence
    period = next(q for q in apart.parameters if q.name == "period")
    assert apart.promised and abs(period.value - 62.5) < 3.0 * period.u


def test_a_cause_beyond_its_physical_limit_is_not_named(tmp_path: Path) -> None:
    """A length error of 200 ppm is no refractive index: 20 ppm would be air 20 K off."""
    machine = Machine.load(write_stage(tmp_path))
    positions = np.linspace(0.0, 500.0, 11)
    data = Measurements.load(stage_table(tmp_path / "long.csv", positions, 0.2 * positions, 0.0, 0.6), machine)
    found = diagnose(data, machine, Calibration.zero(machine))
    named = {effect for cause in found.causes for effect, _ in ((cause.effect, cause.where), *cause.equivalent)}
    assert "positioning" in named and "refraction_scale" not in named
