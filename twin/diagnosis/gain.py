"""What modelling the causes gains: of the calibration that is written, on all readings, on readings held out, and at the tool."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, Final

import numpy as np

from twin._common.distributions import student_isf
from twin.diagnosis import payload
from twin.diagnosis.folds import Parts, at_positions, in_time, parts
from twin.diagnosis.likelihood import Likelihood
from twin.diagnosis.pool import Form, Pool
from twin.diagnosis.problem import Problem
from twin.diagnosis.result import HeldOut
from twin.diagnosis.structure import Findings, again
from twin.identification.network import Network
from twin.identification.solve import solve
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.machine.effects import Effect
from twin.machine.effects.empirical import Empirical, state_name
from twin.machine.effects.names import axis_of
from twin.machine.effects.waves import APPROACH
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.numerics.covariance import Covariance
from twin.numerics.functions import Rows
from twin.uncertainty.budget import volume

TOOL_MM: Final = 100.0
DENSE: Final = 20
"""Positions of an axis from which on what repeats at them holds between them as well."""
ENOUGH: Final = 6
"""Independent groups below which no interval is given."""


def of_file(problem: Problem, extended: Calibration, instrument: np.ndarray) -> np.ndarray:
    """(n, 3) residual of the readings in µm with a calibration as it is written, the set-up fitted anew; NaN where nothing was read.

    Args:
        problem: the data.
        extended: the calibration.
        instrument: (3n,) whitened, what was found of the instrument; taken out of the readings first.
    """
    network = problem.network
    judged = Network(
        network.machine,
        network.data,
        network.instrument,
        network.unknowns,
        extended,
        network.covariance,
        check=False,
    )
    placed = Problem(judged, solve(judged, np.zeros(0), problem.setup, np.ones(len(network.data))).setup, None)
    return unwhitened(placed, placed.project(placed.residual - instrument))


def unwhitened(problem: Problem, residual: np.ndarray) -> np.ndarray:
    """(n, 3) µm of a (3n,) whitened residual; NaN where nothing was read."""
    found = plain(problem, residual.reshape(-1, 3)[:, :, None])[:, :, 0]
    return np.where(problem.network.read, found * 1e6, np.nan)


def plain(problem: Problem, whitened: np.ndarray, rows: Rows = slice(None)) -> np.ndarray:
    """(rows, 3, k) as it was before it was whitened; zero where nothing was read."""
    read = problem.network.read[rows]
    safe = np.where(read[:, :, None] & read[:, None, :], problem.network.whitening[rows], np.eye(3))
    return np.asarray(np.linalg.solve(safe, np.where(read[:, :, None], whitened, 0.0)))


def rms(values: np.ndarray, read: np.ndarray) -> float:
    """Of the coordinates that were read."""
    return float(np.sqrt(np.mean(values[read] ** 2)))


def held_out(
    found: Findings, forms: Sequence[Form], barred: Collection[tuple[str, str]], written: Collection[int] = ()
) -> HeldOut | None:
    """Residuals of readings that the fit has not seen, without and with the causes that are worth their price on the others.

    The search begins with the causes that stand; where a period lies or what cannot be is forgotten first. None where nothing can be
    held out.

    Args:
        found: the causes and patterns.
        forms: the causes that stand in the end: they decide what is held out (`twin.diagnosis.folds`).
        barred: causes that foretell nothing, for they are not promised.
        written: numbers of the patterns that are in the file as well.
    """
    problem, pool = found.problem, found.pool
    split = parts(problem.network.data, problem.network.machine, [form.candidate for form in forms])
    pool.judge(problem)
    payload.again(pool, forms)
    if split is None:
        return None

    def judged(small: Pool) -> tuple[np.ndarray, np.ndarray]:
        # Where causes were refuted by readings left out, those that stand are not searched anew.
        chosen = forms if found.refuted else payload.chosen_on(small, forms).forms
        kept, likelihood = again(small, chosen, found.structure)
        after = foretold(problem, small, [form for form in kept if form.key not in barred])
        if written and likelihood is not None:
            after = after + foretold_patterns(likelihood, kept, written)
        return np.zeros_like(after), after

    return _held_out(pool, split, judged)


def held_out_patterns(found: Findings, forms: Sequence[Form], written: Collection[int]) -> HeldOut | None:
    """Residuals of readings held out, with the causes alone and with some patterns beside them, all fitted to the other readings.

    Args:
        found: the causes and patterns.
        forms: the causes that stand; the same on every part.
        written: numbers of the patterns.
    """
    problem, structure = found.problem, found.structure
    network, pool = problem.network, found.pool
    names = {name for k in written for name in structure.traces[k].pattern.names}
    # A direction of approach is that of a position as well.
    axes = {state_name(name).removeprefix(APPROACH) for name in names}
    moving = [i for i, name in enumerate(network.machine.names) if name in axes]
    split = at_positions(network.data, moving) if moving else in_time(network.data)
    if split is None:
        return None

    def judged(small: Pool) -> tuple[np.ndarray, np.ndarray]:
        named = foretold(problem, small, forms)
        return named, named + foretold_patterns(Likelihood(small, structure.traces), forms, written)

    return _held_out(pool, split, judged)


def _held_out(pool: Pool, split: Parts, judged: Callable[[Pool], tuple[np.ndarray, np.ndarray]]) -> HeldOut | None:
    table = on_parts(pool, split, judged)
    if table is None:
        return None
    total = table.sum(axis=0)
    before, after = np.sqrt(total[:2] / total[2])
    return HeldOut(split.of, len(table), float(before), float(after), interval(table))


def foretold_patterns(likelihood: Likelihood, forms: Sequence[Form], written: Collection[int]) -> np.ndarray:
    """(3n,) what some patterns, fitted to a part of the readings beside causes, do to all of them.

    Args:
        likelihood: the patterns on that part.
        forms: the causes.
        written: numbers of the patterns.
    """
    which, values, _ = likelihood.most_likely(likelihood.fit(forms), likelihood.slope_beside(forms))
    own = np.isin(likelihood.group[which] // 3, list(written))
    return likelihood.made(which[own], values[own])


def foretold(problem: Problem, part: Pool, forms: Sequence[Form]) -> np.ndarray:
    """(3n,) what causes fitted to a part of the readings do to all of them.

    Nothing along what that part does not see: it would be noise times a lever on the rest.
    """
    columns, values, _ = part.fitted(forms)
    signature = problem.signature([part.products.columns[i] for i in columns])
    return np.asarray(signature @ values)


def interval(table: np.ndarray) -> tuple[float, float] | None:
    """95 % interval of the difference of two RMS values, by leaving out one group at a time; None for fewer than `ENOUGH`.

    The jackknife's pseudo-values with Student's t (Tukey 1958): groups, not readings, are independent.

    Args:
        table: (groups, 3) sums of squares before and after, and how many values.
    """
    count = len(table)
    if count < ENOUGH:
        return None
    total = table.sum(axis=0)
    rest = np.maximum(total - table, 0.0)
    used = np.maximum(rest[:, 2], 1.0)
    whole = float(np.sqrt(total[0] / total[2]) - np.sqrt(total[1] / total[2]))
    without = np.sqrt(rest[:, 0] / used) - np.sqrt(rest[:, 1] / used)
    pseudo = count * whole - (count - 1) * without
    half = float(student_isf(0.025, count - 1) * pseudo.std(ddof=1) / np.sqrt(count))
    return whole - half, whole + half


def foretells(pool: Pool, form: Form, forms: Sequence[Form]) -> bool:
    """Whether a function of an axis's position foretells positions of that axis that were left out of its fit.

    A variant of another effect has to foretell more than that does: a reversal that changes along the travel more than the plain one.

    Args:
        pool: the data.
        form: the cause.
        forms: all causes.
    """
    if not form.candidate.specification.curve:
        return True
    machine, data = pool.problem.network.machine, pool.problem.network.data
    where = form.candidate.where
    axis = machine.names.index(axis_of(where))
    if len(np.unique(np.round(data.positions[:, axis], 3))) > DENSE:
        return True
    split = at_positions(data, [axis])
    if split is None:
        return False
    others = [one for one in forms if one is not form]
    if form.candidate.specification.more_of:
        others += [one for one in pool.forms if one.key == (form.candidate.specification.more_of, where)]
    gained = positions_held_out(pool, form, others, split)
    return gained is not None and gained[0] > 0.0


def positions_held_out(pool: Pool, form: Form, others: Sequence[Form], split: Parts) -> tuple[float, float] | None:
    """95 % interval of what one cause gains at positions that it was not fitted to, all others kept; None where none is given.

    Args:
        pool: the data.
        form: the cause.
        others: the other causes.
        split: the positions.
    """

    def judged(small: Pool) -> tuple[np.ndarray, np.ndarray]:
        return foretold(pool.problem, small, others), foretold(pool.problem, small, [*others, form])

    table = on_parts(pool, split, judged)
    return None if table is None else interval(table)


def on_parts(pool: Pool, split: Parts, judged: Callable[[Pool], Sequence[np.ndarray]]) -> np.ndarray | None:
    """(groups, models + 1) sums of squares of what is held out, µm², with each model, and how many values.

    Args:
        pool: all data.
        split: what is held out together.
        judged: the rest of the data → (3n,) what each model, fitted to it, does to the whitened readings, all of them.
    """
    problem = pool.problem
    table: np.ndarray | None = None
    for k in range(int(split.part.max()) + 1):
        rows = split.part == k
        part = problem.without(rows)
        if part is None:
            return None
        small = pool.on(part)
        squares = []
        for made in judged(small):
            left = part.following(problem.residual - made).reshape(-1, 3, 1)[rows]
            squares.append(np.sum((plain(problem, left, rows)[:, :, 0] * 1e6) ** 2, axis=1))
        read = np.count_nonzero(problem.network.read[rows], axis=1).astype(float)
        counted = np.stack([*squares, read], axis=1)
        table = np.zeros((int(split.group.max()) + 1, counted.shape[1])) if table is None else table
        np.add.at(table, split.group[rows], counted)
    return table


def tool_mm(machine: Machine) -> float:
    """Of the machine file, or of a usual tool: at the spindle nose itself a turn about it would seem to do no harm."""
    return machine.tool_length_mm or TOOL_MM


def at_tool(
    data: Measurements, machine: Machine, effects: Sequence[Effect], covariance: Covariance
) -> tuple[float, float]:
    """RMS at the tool over the volume after compensating, with the old model and with the extended one, executed on the extended one.

    The old model's compensation leaves what the effects do there, to first order; the extended one's what they are uncertain by. The
    volume ends where the range of an empirical effect does.

    Args:
        data: the measurements, for their temperatures and times.
        machine: the machine.
        effects: what was found of it.
        covariance: of their parameters.
    """
    if not effects:
        return 0.0, 0.0
    positions = _inside(volume(machine, 400), machine, effects)
    rng = np.random.default_rng(16907)
    state: dict[str, Any] = {axis.name: positions[:, i] for i, axis in enumerate(machine.axes)}
    state |= {f"approach_{axis.name}": rng.choice([-1.0, 1.0], len(positions)) for axis in machine.axes}
    rows = rng.integers(0, len(data), len(positions))
    state["time_s"] = np.asarray(data.time_s)[rows]
    state |= {f"T_{name}_degC": np.asarray(values)[rows] for name, values in data.temperature_degC.items()}
    at_tip = Kinematics(machine, Calibration.zero(machine), tool_length_mm=tool_mm(machine))
    by_error = at_tip.sensitivities(positions).error[:, :3]
    index = {(frame.axis, frame.role): 6 * i for i, frame in enumerate(machine.frames)}

    def moved(effect: Effect, own: Mapping[int, Any]) -> np.ndarray:
        at = index[effect.frame.axis, effect.frame.role]
        values = {at + i: np.broadcast_to(np.asarray(v, dtype=float), len(positions)) for i, v in own.items()}
        return np.asarray(sum(by_error[:, :, i] * v[:, None] for i, v in values.items()))

    whole = np.sum([moved(effect, effect.components(state)) for effect in effects], axis=0)
    by_parameter = {
        parameter.name: moved(effect, own)
        for effect in effects
        for parameter, own in zip(effect.parameters, effect.derivatives(state), strict=True)
    }
    known = [name for name in covariance.names if name in by_parameter]
    columns = np.stack([by_parameter[name] for name in known], axis=2)
    variance = np.sum((columns @ covariance.of(known).matrix) * columns, axis=(1, 2))
    return float(np.sqrt(np.mean(np.sum(whole**2, axis=1)))), float(np.sqrt(np.mean(np.maximum(variance, 0.0))))


def _inside(positions: np.ndarray, machine: Machine, effects: Sequence[Effect]) -> np.ndarray:
    """(n, axes) positions of the whole volume, brought into the ranges of the empirical effects among some."""
    found = np.array(positions)
    for i, axis in enumerate(machine.axes):
        ranges = [
            own
            for effect in effects
            if isinstance(effect, Empirical)
            for column, own in effect.ranges.items()
            if state_name(column) == axis.name
        ]
        span = np.ptp(positions[:, i])
        if ranges and span > 0.0:
            low, high = max(own[0] for own in ranges), min(own[1] for own in ranges)
            found[:, i] = low + (positions[:, i] - positions[:, i].min()) / span * (high - low)
    return found
