"""The next measurement worth making: what to read, from where, in which order, and what it will tell."""

from __future__ import annotations

import fnmatch
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from threadpoolctl import threadpool_limits

from twin._common.arrays import locked
from twin._common.errors import InputError, nearest
from twin.machine.calibration import Calibration
from twin.machine.machine import Machine
from twin.measurement.instruments import INSTRUMENTS, Instrument
from twin.measurement.simulate import Setting
from twin.measurement.table import Measurements
from twin.planning.candidates import candidates, levels_for, safe_poses, setting_of
from twin.planning.design import Aim, AtTool, Everything, Say, Weakest
from twin.planning.fill import Filler, Readings
from twin.planning.forecast import POSES, SEED, Forecast, forecast, hidden_by, informed, length_of, told_by
from twin.planning.information import Model
from twin.planning.kit import Kit
from twin.planning.result import Plan, alternatives
from twin.planning.route import ALWAYS
from twin.uncertainty.budget import volume

AIMS: Final = ("tool", "everything", "weakest")
OPEN: Final = 0.1
"""Share of the plausible variance from which nothing holds an unknown beforehand: the datum takes part of some."""


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
        names = [reduce] if isinstance(reduce, str) else list(reduce)
        _check(machine, names)
        own = Kit.default(machine) if kit is None else kit
        tell: Say = say or (lambda stage, part: None)
        sizes = Calibration.default(machine) if expected is None else expected
        length = length_of(machine, tool_length_mm)
        filler = Filler(machine, own, minutes, seed, tell)
        tell("looking", 0.0)
        # A curve gets as many functions as its axis has positions: a short plan keeps to few.
        numbers = min(int(np.isfinite(one.read(np.ones((1, 3)))).sum()) for one in own.instruments)
        levels = levels_for(machine, filler.expected_points, numbers, sizes)
        every = candidates(machine, own, safe_poses(machine, own, filler.rng, levels=levels), filler.rng)
        stands = []
        for instrument in own.instruments:
            model, rows = informed(machine, every, setting_of(own), instrument, sizes, own.known)
            aim = _aim(model, rows, names, length)
            stands += filler.stands(
                Readings(instrument, every, np.zeros(len(every), dtype=int), ALWAYS, model.prior, rows, aim)
            )
        stands = filler.best(stands)
        best = stands[0]
        found = filler.filled(best)
        tell("foretelling", 0.95)
        told = forecast(
            machine,
            found.plan,
            setting_of(own),
            best.readings.instrument,
            sizes,
            known=own.known,
            tool_length_mm=length,
        )
        return Plan(
            machine,
            own,
            " ".join(names),
            best.readings.instrument,
            best.stations,
            found,
            told,
            alternatives(stands),
            seed,
            warnings=sizes.warnings,
        )


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
    setting = Setting.drawn(table, np.random.default_rng(0))
    placed = replace(
        table,
        station_pose=locked(np.array([setting.stations[name].pose for name in table.station])),
        place_mm=locked(np.array([setting.places_mm[name] for name in table.target])),
    )
    return forecast(
        machine,
        placed,
        setting,
        INSTRUMENTS[0] if instrument is None else instrument,
        Calibration.default(machine) if expected is None else expected,
        known=known,
        tool_length_mm=tool_length_mm,
    )


def _check(machine: Machine, wanted: Sequence[str]) -> None:
    names = (*machine.motion_names, *machine.squareness_names, *machine.location_names)
    if len(wanted) == 1 and wanted[0] in AIMS:
        return
    for pattern in wanted or [""]:
        if not fnmatch.filter(names, pattern):
            expected = f"{', '.join(AIMS)}, or errors among {', '.join(names)}"
            meant = nearest(pattern, (*AIMS, *names))
            raise InputError("nothing of that name to reduce", expected=expected, value=pattern, nearest=meant)


def _aim(model: Model, rows: np.ndarray, names: list[str], tool_length_mm: float) -> Aim:
    """What is to become small, of what the candidates together can determine at all."""
    told = told_by(model, rows)
    lost = {one.name for one in hidden_by(model, told)}
    # What no candidate shows stays as uncertain as it is, in whatever it moves: it must not drown what can be made small.
    silent = model.free.T @ told.spectrum.silent
    seen = np.eye(model.free.shape[1]) - silent @ silent.T
    columns = [i for i, column in enumerate(model.unknowns.columns) if column.entity not in lost]
    own = model.plausible[columns, None] * model.free[columns]
    if names == ["tool"]:
        return AtTool(model.at_tool(volume(model.machine, POSES, SEED), tool_length_mm, lost) @ seen)
    if names in (["everything"], ["weakest"]):
        if names == ["weakest"]:
            # What is held to be small anyway stays as it is held, however much is read.
            reach = np.einsum("ki,ij,kj->k", own, np.linalg.inv(model.prior), own)
            own = own[reach > OPEN * model.plausible[columns] ** 2] @ seen
        basis = np.linalg.svd(own, full_matrices=False)
        machine = basis.Vh[basis.S > 1e-9 * basis.S[0]]
        return Everything(machine) if names == ["everything"] else Weakest(machine, model.prior)
    wanted = [
        k
        for k, i in enumerate(columns)
        if any(fnmatch.fnmatchcase(model.unknowns.columns[i].entity, pattern) for pattern in names)
    ]
    if not wanted:
        raise InputError(
            "nothing measured with this kit shows it",
            expected="an error that some reading depends on: known places of the targets, more of them, other stations",
            value=" ".join(names),
        )
    return AtTool((own[wanted] @ seen)[None], "errors", "µm and µrad")
