"""The next measurement worth making: what to read, from where, in which order, and what it will tell."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from twin._common.arrays import locked
from twin._common.errors import InputError
from twin.machine.calibration import Calibration
from twin.machine.machine import Machine
from twin.measurement.instruments import INSTRUMENTS, Instrument
from twin.measurement.simulate import Setting
from twin.measurement.table import Measurements
from twin.planning.aims import aim_of
from twin.planning.candidates import candidates
from twin.planning.design import DesignProblem
from twin.planning.fill import fill
from twin.planning.forecast import Forecast, forecast
from twin.planning.kit import Kit
from twin.planning.model import PlanModel
from twin.planning.result import Plan
from twin.planning.task import Say, Task


def plan(
    machine: Machine,
    kit: Kit | None = None,
    *,
    minutes: float = 210.0,
    reduce: str | Sequence[str] = "tool",
    expected: Calibration | None = None,
    tool_length_mm: float | None = None,
    seed: int = 0,
    say: Say | None = None,
) -> Plan:
    """The measurement that tells most in the time there is.

    Args:
        machine: the machine.
        kit: what there is to measure with; `Kit.default` if None.
        minutes: that it may take, setting up included.
        reduce: what to make small: ``tool`` (the uncertainty of the tool point over the volume), ``everything`` (D-optimality),
            ``weakest`` (the direction known worst), or names of errors (``E_C0Y``, ``E_*C``).
        expected: how large errors are, for what is known beforehand; the machine file's own calibration if None.
        tool_length_mm: of the tool whose point is meant; the machine file's, or 100 mm.
        seed: of the poses tried.
        say: told what is being done and how far it is.

    Raises:
        InputError: no time to measure anything; no room for any pose; a reflector nobody sees; a name of no error of the machine.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        task = Task.of(machine, kit, minutes, expected, seed, say, reduce)
        task.say("looking", 0.0)
        every = candidates(machine, task.kit, task.rng, task.levels)
        models = [task.model(every.plan, instrument) for instrument in task.kit.instruments]
        aims = [aim_of(one, task.wanted, tool_length_mm) for one in models]
        problems = [
            DesignProblem(one.instrument, every, one.prior, one.rows, aim)
            for one, aim in zip(models, aims, strict=True)
        ]
        filled = fill(task, problems)
        task.say("foretelling", 0.95)
        told = forecast(task.model(filled.route.plan, filled.stands[0].readings.instrument), tool_length_mm)
        return Plan.of(task, " ".join(task.wanted), filled, forecast=told)


def judge(
    table: Measurements,
    machine: Machine,
    *,
    instrument: Instrument | None = None,
    expected: Calibration | None = None,
    known: Collection[str] = (),
    tool_length_mm: float | None = None,
) -> Forecast:
    """What somebody else's plan will tell.

    Args:
        table: the plan; stations and targets it does not place are placed as `twin simulate` would.
        machine: the machine.
        instrument: what reads; a laser tracker (AT960) if None.
        expected: as of `plan`.
        known: names of stations and targets that an evaluation is told exactly.
        tool_length_mm: as of `plan`.

    Raises:
        InputError: a plan in which nothing moves.
    """
    if not np.any(np.ptp(table.positions, axis=0) > 0.0):
        raise InputError("no axis moves", expected="two or more positions of an axis", file=table.source)
    setting = Setting.draw(table, np.random.default_rng(0))
    placed = replace(
        table,
        station_pose=locked(np.array([setting.stations[name].pose for name in table.station])),
        place_mm=locked(np.array([setting.places_mm[name] for name in table.target])),
    )
    reader = INSTRUMENTS[0] if instrument is None else instrument
    sizes = Calibration.default(machine) if expected is None else expected
    return forecast(PlanModel.of(machine, placed, setting, reader, sizes, known), tool_length_mm)
