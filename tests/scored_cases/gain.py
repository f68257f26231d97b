"""Share of the machine's true error that a written calibration removes, computed by the truth machine."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.scored_cases.cases import Case, truth_machines, truth_of
from tests.scored_cases.known import origin
from tests.truth.any_chain import rotations
from tests.truth.hidden import STATIONS
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.measurement.observation import Observation
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration


def removed(case: Case, table: Path, machine: str, calibration: Path) -> float | None:
    """Return the share of the hidden error's sum of squares that a calibration removes, on the same rows without noise.

    The set-up is projected out of the error and of the remaining error. Effects of the instrument do not count as machine errors: the
    share is None without a hidden machine error, and zero for a calibration that cannot be evaluated.

    Args:
        case: the case.
        table: its measurement table, for the channels.
        machine: its machine file.
        calibration: calibration file that a method wrote.
    """
    truth, drawn = truth_machines()[case.machine], truth_of(case)
    effects = [one for one in drawn.effects if origin(one.effect) == "machine"]
    if not effects and drawn.outside is None:
        return None
    plan = drawn.plan
    moved = None if drawn.outside is None else drawn.outside.moved(truth, plan)
    error = truth.readings(plan, effects, moved) - truth.readings(plan)
    own = Machine.load(machine)
    data = Measurements.load(table, own)
    try:
        with_it, without = (
            Observation(own).points_mm(one, data, truth.places(plan))
            for one in (Calibration.load(calibration, own), Calibration.default(own))
        )
    except InputError:
        return 0.0
    turn = rotations(np.array([STATIONS[name][1] for name in plan.station]))
    corrected = np.einsum("nji,nj->ni", turn, with_it - without)
    before, after = (np.sum(truth.left_over(plan, one) ** 2) for one in (error, error - corrected))
    return float(1.0 - after / before)
