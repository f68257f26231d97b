"""Errors along an axis itself: a reversal that changes along the travel, pitch and slow waves, teeth of gears.

The truth machines (`tests.truth.hidden`, `tests.compensation.test_compensate_effects`) share no code with `twin`.
"""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.compensation.test_compensate_effects import WornMachine, densely, done, extended, taking_up
from tests.truth import hidden
from tests.truth.few_axes import write_stage
from tests.truth.hidden import Hidden, Plan
from twin._common.errors import InputError
from twin.diagnosis import Diagnosis, diagnose
from twin.diagnosis.candidates import catalogue
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects.entries import effect_named

SIGMA_MM = 3e-3
TURNS = "G21 G90\nG0 X100 Y20 Z-100 B0 C0\nG1 Y60 F500\nY15\nX150 Y440\nY400\nY445\nX120 Y10\nY40\nM30\n"


def stage(folder: Path, reversal_um: np.ndarray, *, cycles: int = 5, seed: int = 61) -> Diagnosis:
    """Return readings along a slide of 500 mm, forwards and backwards at evenly spaced positions; noise 0.6 µm."""
    machine, rng = Machine.load(write_stage(folder)), np.random.default_rng(seed)
    positions = np.linspace(0.0, 500.0, len(reversal_um))
    with (folder / "stage.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow("X_mm approach_X target carrier x_mm y_mm z_mm round place_x_mm place_y_mm place_z_mm".split())
        for cycle in range(cycles):
            for way in (1, -1):
                for at, size in zip(positions[::way], reversal_um[::way], strict=True):
                    off = 0.5 * way * size + 0.6 * rng.standard_normal()
                    table.writerow([at, way, "slide", "tool", at + 1e-3 * off, "", "", cycle + 1, 0, 0, 0])
    return diagnose(Measurements.load(folder / "stage.csv", machine), machine, Calibration.zero(machine))


def test_a_reversal_that_grows_along_the_travel_is_found(tmp_path: Path) -> None:
    u = np.linspace(-1.0, 1.0, 9)
    result = stage(tmp_path, -10.0 + 6.0 * u)
    (cause,) = result.causes
    assert (cause.effect, cause.where, cause.promised) == ("reversal_curve", "X", True)
    found = {q.name: q for q in cause.parameters}
    for name, value in {"c0": -10.0, "c1": 6.0}.items():
        assert abs(found[name].value - value) < 3.0 * found[name].u
    assert "varies along its travel, from -16" in cause.evidence
    result.extended.save(tmp_path / "extended.yaml")
    (effect,) = Calibration.load(tmp_path / "extended.yaml", result.calibration.machine).effects
    state = {"X": np.array([0.0, 500.0, 500.0]), "approach_X": np.array([1.0, 1.0, -1.0])}
    # Half the reversal to either side, in µm; the ends are known to some 0.3 µm.
    assert effect.components(state)[0] == pytest.approx([-8.0, -2.0, 2.0], abs=1.0)
    assert result.gain is not None and result.gain.rms_after_um == pytest.approx(0.6, rel=0.15)


def test_a_constant_reversal_is_no_curve(tmp_path: Path) -> None:
    (cause,) = stage(tmp_path, np.full(9, -10.0)).causes
    assert (cause.effect, cause.where, cause.equivalent) == ("reversal", "X", ())
    # The second method counts a constant reversal curve as the same cause.
    assert cause.probability is not None and cause.probability > 0.95


def test_a_random_reversal_is_a_constant_one_and_a_remainder(tmp_path: Path) -> None:
    """The reversal varies randomly with position: the mean is named, and the error between the positions stays unknown."""
    rough = np.array([-9.0, 5.0, -7.0, 8.0, -6.0, 7.0, -8.0, 6.0, -5.0]) - 20.0
    result = stage(tmp_path, rough)
    (cause,) = result.causes
    assert (cause.effect, cause.where) == ("reversal", "X")
    (size,) = cause.parameters
    assert size.value == pytest.approx(rough.mean(), abs=1.0)
    left = result.unexplained
    assert left is not None and set(left.depends_on) == {"approach_X", "X_mm"} and left.size_um > 2.0


def test_a_reversal_that_changes_with_another_axis_is_none_of_its_own_travel(dmu50: Machine, tmp_path: Path) -> None:
    rng = np.random.default_rng(62)
    of = hidden.rounded(hidden.plan(rng, poses=60))
    truth = Hidden("reversal_curve", "Y", {"c0": 0.0, "c1": 12.0})
    read = hidden.noisy(hidden.points(of, [truth]), rng, "isotropic", SIGMA_MM)
    data = Measurements.load(hidden.write(tmp_path / "m.csv", of, read, u_mm=SIGMA_MM), dmu50)
    (cause,) = diagnose(data, dmu50, Calibration.default(dmu50)).causes
    assert (cause.effect, cause.where, cause.equivalent) == ("reversal_curve", "Y", ())


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_program_is_compensated_for_it(dmu50: Machine, tmp_path: Path, sign: float) -> None:
    """Y reverses at either end of its travel, where the reversal is 4 and 20 µm; a constant mean leaves most of the difference."""
    entry = f"effect: reversal_curve, where: Y, parameters: {{c0: {12.0 * sign}, c1: {8.0 * sign}}}"
    truth = WornMachine(extended(tmp_path), reversal={}, varying={"Y": (12.0 * sign, 8.0 * sign)})
    after = {}
    for name, one in {
        "curve": entry,
        "mean": f"effect: reversal, where: Y, parameters: {{size: {12.0 * sign}}}",
    }.items():
        result = done(TURNS, dmu50, extended(tmp_path, one))
        off = truth.off(densely(result.commands), densely(result.nominal))
        after[name] = float(np.sqrt(np.mean(off[~np.repeat(taking_up(result), 8)[7:]] ** 2)))
    assert after["curve"] < 0.6 and after["mean"] > 1.5


def test_a_reversal_curve_in_a_file(dmu50: Machine) -> None:
    effect = effect_named("reversal_curve", "Y", {"c0": 1.0, "c1": 2.0, "c2": 3.0}, dmu50)
    assert [one.name for one in effect.parameters] == [f"reversal_curve:Y.c{k}" for k in range(3)]
    with pytest.raises(InputError, match="an axis with a limited range"):
        effect_named("reversal_curve", "C", {"c0": 1.0}, dmu50)
    with pytest.raises(InputError, match="parameters of reversal_curve Y"):
        effect_named("reversal_curve", "Y", {"c0": 1.0, "c2": 2.0}, dmu50)


def slow_or_fast(folder: Path, period_mm: float) -> Diagnosis:
    """Return readings of a wave of 5 µm along 500 mm at 41 unevenly spaced positions, five times."""
    machine, rng = Machine.load(write_stage(folder)), np.random.default_rng(63)
    positions = np.sort(np.round(rng.uniform(0.0, 500.0, 41), 1))
    positions[[0, -1]] = 0.0, 500.0
    with (folder / "wave.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow("X_mm target carrier x_mm y_mm z_mm round place_x_mm place_y_mm place_z_mm".split())
        for cycle in range(5):
            for at in positions:
                off = 5.0 * np.sin(2.0 * np.pi * at / period_mm + 0.4) + 0.3 * rng.standard_normal()
                table.writerow([at, "slide", "tool", at + 1e-3 * off, "", "", cycle + 1, 0, 0, 0])
    return diagnose(Measurements.load(folder / "wave.csv", machine), machine, Calibration.zero(machine))


@pytest.mark.parametrize(
    ("period_mm", "name"), [(500.0 / 1.5, "positioning"), (290.0, "positioning"), (120.0, "pitch_error")]
)
def test_a_wave_longer_than_half_the_travel_is_a_curve(tmp_path: Path, period_mm: float, name: str) -> None:
    result = slow_or_fast(tmp_path, period_mm)
    named = {effect for cause in result.causes for effect, _ in ((cause.effect, cause.where), *cause.equivalent)}
    assert name in named and (name == "pitch_error" or "pitch_error" not in named)
    if name == "pitch_error":
        (cause,) = result.causes
        period = next(q for q in cause.parameters if q.name == "period")
        assert abs(period.value - period_mm) < 3.0 * period.u and not cause.bounded


def test_teeth_of_a_gear_are_a_harmonic_of_high_order(dmu50: Machine, tmp_path: Path) -> None:
    """Order 48 of C's angle at 151 angles, which resolve orders up to 75."""
    rng = np.random.default_rng(64)
    of = hidden.rounded(hidden.plan(rng, poses=140))
    truth = Hidden("harmonic", "E_CC", {"order": 48, "cos": 12.0, "sin": -9.0})
    read = hidden.noisy(hidden.points(of, [truth]), rng, "isotropic", SIGMA_MM)
    data = Measurements.load(hidden.write(tmp_path / "m.csv", of, read, u_mm=SIGMA_MM), dmu50)
    (cause,) = diagnose(data, dmu50, Calibration.default(dmu50)).causes
    assert (cause.effect, cause.where, cause.equivalent) == ("harmonic", "E_CC", ())
    found = {q.name: q for q in cause.parameters}
    assert found["order"].value == 48.0
    assert max(abs(found[name].value - truth.numbers[name]) / found[name].u for name in ("cos", "sin")) < 3.0


def test_aliased_orders_are_not_tested(dmu50: Machine, tmp_path: Path) -> None:
    """Orders are limited to half the number of positions of the grid in a revolution; off a grid, to four waves for each position."""
    rng = np.random.default_rng(65)
    for angles, most in (
        (np.arange(0.0, 360.0, 2.0), 89),
        (np.arange(0.0, 360.0, 0.5), 200),
        (np.arange(0.0, 90.0), 178),
        (rng.uniform(0.0, 340.0, 145), 200),
    ):
        of = hidden.rounded(hidden.plan(rng, poses=len(angles)))
        q = of.q.copy()
        q[:, 4] = np.resize(angles, len(q))
        of = replace(of, q=q)
        data = Measurements.load(hidden.write(tmp_path / "m.csv", of, hidden.points(of), u_mm=SIGMA_MM), dmu50)
        found = {one.where: one for one in catalogue(dmu50, data, Calibration.default(dmu50)).candidates}
        assert len(found["E_CC"].variants) == most and found["E_CC"].tests == most
        assert len(found["E_XC"].variants) == min((len(angles) - 1) // 2, 30)


def turned(seed: int, turns: int, amplitude: float) -> tuple[Plan, np.ndarray]:
    """Return a plan in which only C moves, to 145 uneven angles twice, and the readings of three targets on the table."""
    rng = np.random.default_rng(seed)
    angles = np.round(np.sort(rng.uniform(0.0, 340.0, 145)), 3)
    q = np.tile(hidden.HOME, (2 * 3 * len(angles), 1))
    q[:, 4] = np.tile(np.repeat(angles, 3), 2)
    n = len(q)
    of = replace(
        hidden.plan(rng, poses=31),
        q=q,
        approach=np.ones((n, 5)),
        target=np.tile(np.array(["T", "U", "V"]), n // 3),
        station=np.full(n, "1"),
        round=np.repeat(["1", "2"], n // 2),
        time_s=8.0 * np.arange(n),
        warm={name: np.full(n, 20.0) for name in ("X", "Y", "Z", "bed")},
    )
    effect = Hidden("harmonic", "E_CC", {"order": turns, "cos": amplitude, "sin": 0.3 * amplitude})
    return of, hidden.noisy(hidden.points(of, [effect]), rng, "isotropic", 2e-3)


@pytest.mark.parametrize(
    ("seed", "amplitude"),
    [(5, 70.0), *(pytest.param(*case, marks=pytest.mark.slow) for case in ((2, 0.0), (4, 0.0), (7, 70.0)))],
)
def test_where_only_one_axis_turns_the_set_up_is_found(
    seed: int, amplitude: float, calibration: Calibration, tmp_path: Path
) -> None:
    """The nominal machine does not tell how stations and targets are turned about C; its error motions do, along a curved valley.

    Ninety waves a turn at 145 uneven angles: more than half of the angles, and resolved.
    """
    of, read = turned(seed, 90, amplitude)
    machine = calibration.machine
    data = Measurements.load(hidden.write(tmp_path / "m.csv", of, read, u_mm=2e-3), machine)
    result = diagnose(data, machine, calibration)
    named = [(cause.effect, cause.where, round(cause.parameters[0].value)) for cause in result.causes]
    assert named == ([("harmonic", "E_CC", 90)] if amplitude else [])
