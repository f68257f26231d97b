"""Plan a measurement, or predict the result of an existing plan."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.progress import Progress, silent
from twin._common.threads import one_blas_thread
from twin.machine.calibration import Calibration
from twin.machine.machine import Machine
from twin.measurement.instruments import INSTRUMENTS, Instrument
from twin.measurement.simulate import Placement
from twin.measurement.table import Measurements
from twin.planning.aims import aim_of
from twin.planning.candidates import candidates
from twin.planning.design import DesignProblem
from twin.planning.fill import fill
from twin.planning.forecast import Forecast, forecast
from twin.planning.kit import Kit
from twin.planning.model import PlanModel
from twin.planning.result import Plan
from twin.planning.task import Task


def plan(
    machine: Machine,
    kit: Kit | None = None,
    *,
    minutes: float = 210.0,
    reduce: str | Sequence[str] = "tool",
    expected: Calibration | None = None,
    tool_length_mm: float | None = None,
    seed: int = 0,
    progress: Progress = silent,
) -> Plan:
    """Plan the measurement with the smallest uncertainty in the time budget.

    Args:
        machine: the machine.
        kit: instruments, stations, reflectors and times; `Kit.default` if None.
        minutes: time budget, including set-up.
        reduce: uncertainty to minimise: ``tool`` (of the tool point over the volume), ``everything`` (D-optimality), ``weakest``
            (E-optimality), or names of errors (``E_C0Y``, ``E_*C``).
        expected: expected size of the errors, for the prior; None: the machine file's calibration.
        tool_length_mm: tool length; None: that of the machine file, or 100 mm.
        seed: random seed.
        progress: progress callback: stage and share done.

    Raises:
        InputError: the time budget is too short, too few poses have clearance, a reflector is visible from no station, or the machine
            has no error of a given name.
    """
    with one_blas_thread():
        task = Task.of(machine, kit, minutes, expected, seed, progress, reduce)
        task.progress("drawing candidates", 0.0)
        every = candidates(machine, task.kit, task.rng, task.levels)
        models = [task.model(every.plan, instrument) for instrument in task.kit.instruments]
        aims = [aim_of(one, task.reduce, tool_length_mm) for one in models]
        problems = [
            DesignProblem(one.instrument, every, one.prior, one.rows, aim)
            for one, aim in zip(models, aims, strict=True)
        ]
        filled = fill(task, problems)
        task.progress("predicting", 0.95)
        predicted = forecast(
            task.model(filled.route.plan, filled.station_choices[0].problem.instrument), tool_length_mm
        )
        return Plan.of(task, " ".join(task.reduce), filled, forecast=predicted)


def judge(
    table: Measurements,
    machine: Machine,
    *,
    instrument: Instrument | None = None,
    expected: Calibration | None = None,
    known: Collection[str] = (),
    tool_length_mm: float | None = None,
) -> Forecast:
    """Predict the uncertainties that an existing plan will give.

    Args:
        table: the plan; stations and targets without a position get one as in `twin simulate`.
        machine: the machine.
        instrument: the instrument; a laser tracker (AT960) if None.
        expected: see `plan`.
        known: names of stations and targets that an evaluation treats as exactly known.
        tool_length_mm: see `plan`.

    Raises:
        InputError: no axis moves in the plan.
    """
    if not np.any(np.ptp(table.positions, axis=0) > 0.0):
        raise InputError("no axis moves", expected="two or more positions of an axis", file=table.source)
    setting = Placement.draw(table, np.random.default_rng(0))
    placed = replace(
        table,
        station_pose=read_only(np.array([setting.stations[name].pose for name in table.station])),
        place_mm=read_only(np.array([setting.places_mm[name] for name in table.target])),
    )
    reader = INSTRUMENTS[0] if instrument is None else instrument
    sizes = Calibration.default(machine) if expected is None else expected
    return forecast(PlanModel.of(machine, placed, setting, reader, sizes, known), tool_length_mm)
