"""Two periodic errors of one axis, of a screw and its coupling or of two pinions: both are named, each with its period."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.truth import hidden, trunnion
from tests.truth.hidden import Hidden
from twin.diagnosis import Cause, Diagnosis, diagnose
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

SIGMA_MM = 3e-3


def looked_at(effects: list[Hidden], machine: Machine, calibration: Calibration, folder: Path, seed: int) -> Diagnosis:
    rng = np.random.default_rng(seed)
    plan = hidden.rounded(hidden.plan(rng, poses=90))
    read = hidden.noisy(hidden.points(plan, effects), rng, "isotropic", SIGMA_MM)
    path = hidden.write(folder / "measured.csv", plan, read, u_mm=SIGMA_MM)
    return diagnose(Measurements.load(path, machine), machine, calibration)


def wave(axis: str, amplitude: float, period: float, phase: float) -> Hidden:
    return Hidden("pitch_error", axis, {"amplitude": amplitude, "period": period, "phase": phase})


def number(cause: Cause, name: str) -> tuple[float, float]:
    """Return the value and the standard uncertainty of a parameter."""
    return next((q.value, q.u) for q in cause.parameters if q.name == name)


@pytest.fixture(scope="module")
def look(
    dmu50: Machine, calibration: Calibration, tmp_path_factory: pytest.TempPathFactory
) -> Callable[..., Diagnosis]:
    """Diagnose waves of X by amplitude, period and phase; the same ones once."""

    @cache
    def looked(sizes: tuple[tuple[float, float, float], ...]) -> Diagnosis:
        truth = [wave("X", *one) for one in sizes]
        return looked_at(truth, dmu50, calibration, tmp_path_factory.mktemp("waves"), 5)

    return looked


TWO = ((5.0, 22.7, 0.4), (4.0, 10.0, -1.1))


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    "sizes",
    [
        TWO,
        # What the first leaves between two tabulated periods is larger than the second.
        ((40.0, 31.3, 0.4), (3.0, 12.4, 2.0)),
        ((6.0, 41.0, 1.0), (5.0, 27.0, 0.2)),
    ],
)
def test_both_periods_are_named(sizes: tuple[tuple[float, float, float], ...], look: Callable[..., Diagnosis]) -> None:
    truth = [wave("X", *one) for one in sizes]
    result = look(sizes)
    assert [(cause.effect, cause.where) for cause in result.causes] == [("pitch_error", "X")] * 2
    assert result.verdict == "explained" and all(not cause.equivalent for cause in result.causes)
    found = sorted(result.causes, key=lambda cause: -number(cause, "period")[0])
    for cause, one in zip(found, truth, strict=True):
        for name in ("amplitude", "period"):
            value, u = number(cause, name)
            assert abs(value - one.numbers[name]) < 4.0 * u, name
        assert cause.promised
    held = result.gain.held_out if result.gain else None
    assert held is not None and held.ci95_um is not None and held.ci95_um[0] > 0.0


def test_each_has_its_own_numbers_in_the_file(look: Callable[..., Diagnosis], dmu50: Machine, tmp_path: Path) -> None:
    result = look(TWO)
    result.extended.save(tmp_path / "extended.yaml")
    again = Calibration.load(tmp_path / "extended.yaml", dmu50)
    assert [effect.name for effect in again.extra] == ["pitch_error:X", "pitch_error:X[2]"]
    deviations = np.sqrt(np.diag(again.covariance.matrix))
    u = dict(zip(again.covariance.names, deviations, strict=True))
    by_period = {round(effect.numbers["period"]): effect.name for effect in again.extra}
    for cause in result.causes:
        name = by_period[round(number(cause, "period")[0])]
        assert u[f"{name}.period"] == pytest.approx(number(cause, "period")[1], rel=1e-6)


@pytest.mark.sample(1)  # of 2
@pytest.mark.parametrize("period", [22.7, 31.3])
def test_one_large_one_leaves_no_second(
    period: float, dmu50: Machine, calibration: Calibration, tmp_path: Path
) -> None:
    """Between two tabulated periods, 400 times what is needed to be seen."""
    result = looked_at([wave("X", 60.0, period, 0.4)], dmu50, calibration, tmp_path, 7)
    assert [(cause.effect, cause.where) for cause in result.causes] == [("pitch_error", "X")]


@pytest.mark.parametrize(("jitter_mm", "decided"), [(2.5, True), (1.0, False)])
def test_a_wave_on_a_grid_of_uneven_positions(jitter_mm: float, decided: bool, tmp_path: Path) -> None:
    """12 mm on a grid of 50 mm: 2.5 mm beside it tell this period from its aliases, 1 mm do not, and nothing is written."""
    rng, machine = np.random.default_rng(6), Machine.load("trunnion_ac")
    of = trunnion.plan(rng)
    places, back = np.unique(of.q[:, 0], return_inverse=True)
    q = of.q.copy()
    grid = np.round(places / 50.0) * 50.0 + rng.uniform(-jitter_mm, jitter_mm, len(places))
    q[:, 0] = np.round(np.clip(grid, *trunnion.RANGES["X"]), 3)[back]
    of, motion = replace(of, q=q), np.zeros((len(q), 6))
    motion[:, 0] = 9e-3 * np.sin(2.0 * np.pi * q[:, 0] / 12.0 + 1.0)
    path = trunnion.write(
        tmp_path / "m.csv", of, trunnion.readings(of, trunnion.Errors({"X": motion}), rng), temperatures=False
    )
    (cause,) = diagnose(Measurements.load(path, machine), machine, Calibration.zero(machine)).causes
    assert (cause.effect, cause.where, cause.promised) == ("pitch_error", "X", decided)
    period, u = number(cause, "period")
    if decided:
        assert abs(period - 12.0) < 4.0 * u < 0.1
    else:
        assert abs(period - 12.0) < 0.1 or "12 mm" in cause.evidence or "12," in cause.evidence
