"""Folders of ball bar checks, of R-test checks, and of both: what changed is found, with its date and size."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import twin
from tests.monitoring.folder import CALIBRATION, write_bar_check, write_check, write_folder, write_nest_check
from tests.truth.machine import TruthMachine
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.monitoring.check import CheckFile, read_check

AFTER, CHECKS = 8, 14
PROBE_NOISE_MM = 0.0013
"""As the noise model of the probe states it."""
STEP = {"E_C0Y": 12.0, "E_A0C": 15.0}


def changed(i: int, machine: TruthMachine, degrees: dict[str, float]) -> None:
    machine.squareness["E_C0Y"] += STEP["E_C0Y"] * (i >= AFTER)
    machine.location["E_A0C"] += STEP["E_A0C"] * (i >= AFTER)


@pytest.mark.parametrize("write", [write_bar_check, write_nest_check])
def test_a_check_shows_the_changes(
    dmu50: Machine, calibration: Calibration, tmp_path: Path, write: Callable[..., Path]
) -> None:
    """The same set-up and noise before and after: what differs is the machine. The nest's readings were once fitted to nothing."""
    found = []
    for i in (AFTER - 1, AFTER):
        machine, now = TruthMachine(CALIBRATION), datetime(2026, 3, 2)
        changed(i, machine, {})
        path = write(tmp_path / "c.csv", machine, np.random.default_rng(8))
        found.append(read_check(CheckFile(path.name, "", path), (now, "given"), dmu50, calibration, now))
    first, second = (dict(zip(check.errors, check.value, strict=True)) for check in found)
    assert found[0].reduced_chi2 < 2.0 and set(STEP) <= set(first)
    for name, value in first.items():
        assert second[name] - value == pytest.approx(STEP.get(name, 0.0), abs=0.5), name


@pytest.mark.slow
@pytest.mark.parametrize("write", [write_bar_check, write_nest_check])
def test_a_folder_of_one_instrument(
    dmu50: Machine, calibration: Calibration, tmp_path: Path, write: Callable[..., Path]
) -> None:
    write_folder(
        tmp_path / "c", TruthMachine(CALIBRATION), CHECKS, seed=5, deviation=changed, repeatability=0.8, write=write
    )
    found = twin.watch(tmp_path / "c", dmu50, calibration)
    wanted = set(STEP) - ({"E_A0C"} if write is write_bar_check else set())  # the bar shows it with u = 5 µrad only
    assert {one.series.name for one in found.alarms} == wanted, found.not_determined
    for one in found.alarms:
        assert one.change is not None and one.change.shape == "step"
        days = [check.day for check in found.checks[AFTER - 1 : AFTER + 1]]
        assert one.change.earliest_day <= days[0] and days[1] <= one.change.latest_day
        assert abs(one.change.size - STEP[one.series.name]) <= one.change.expanded < 4.0
    assert {check.instruments for check in found.checks} == {"ball-bar" if write is write_bar_check else "r-test"}


@pytest.mark.slow
def test_a_folder_of_two_instruments(dmu50: Machine, calibration: Calibration, tmp_path: Path) -> None:
    """Every third check is of a ball bar, the others of a probe: each has its own level."""
    count = iter(range(CHECKS))
    probing = partial(write_check, noise_mm=PROBE_NOISE_MM)

    def write(path: Path, *rest: object, **more: object) -> Path:
        return (write_bar_check if next(count) % 3 == 2 else probing)(path, *rest, **more)  # type: ignore[operator]

    truth = TruthMachine(CALIBRATION)
    write_folder(tmp_path / "c", truth, CHECKS, seed=6, deviation=changed, repeatability=0.8, write=write)
    found = twin.watch(tmp_path / "c", dmu50, calibration)
    assert "E_C0Y" in {one.series.name for one in found.alarms}
    one = found.named("E_C0Y")
    assert one.change is not None and abs(one.change.size - STEP["E_C0Y"]) <= 2.0 * one.change.expanded
