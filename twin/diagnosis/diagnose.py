"""Given measured data: is there anything beyond noise, what is it, what could it be mistaken for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from threadpoolctl import threadpool_limits

from twin.diagnosis.account import account
from twin.diagnosis.candidates.candidate import Catalogue
from twin.diagnosis.candidates.machine_effects import cell_at
from twin.diagnosis.estimate import estimate
from twin.diagnosis.folds import parts
from twin.diagnosis.gain import foretells
from twin.diagnosis.held_up import held_up
from twin.diagnosis.noise import Scatter
from twin.diagnosis.patterns import patterns
from twin.diagnosis.payload import chosen
from twin.diagnosis.pool import Form, Pool
from twin.diagnosis.problem import Problem
from twin.diagnosis.readings import ROBUST, Readings, readings
from twin.diagnosis.result import Diagnosis
from twin.diagnosis.search import Selection, every, glimpse, prices
from twin.diagnosis.structure import Findings, Structure, named, settled
from twin.identification.outliers import outliers
from twin.machine.calibration import Calibration
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument
from twin.measurement.table import Measurements, state_of

WITNESSES: Final = 3
"""Rows set aside below which no cause can be read off them."""
CLEAR: Final = 3
"""Causes, at most, that rows too far off are blamed on."""
TAKEN_BACK: Final = (1.0, 0.9, 0.5)
"""Shares of the rows set aside, the least far off first, that are looked at again: all, or without what lost its beam as well."""
LOOKED_AT: Final = 20_000
"""Rows that are enough to see whether one of the causes is why others are too far off."""
SEED: Final = 1964
LARGE: Final = 100.0
"""Chi² of a cause from which on what it leaves between two values that were tried could pass for another cause."""
REFINED: Final = 2
STAYS: Final = 0.2
"""Standard uncertainties by which a period or time constant that was put there once may still move."""
Say = Callable[[str, float], None]


def diagnose(
    data: Measurements,
    machine: Machine,
    calibration: Calibration | None = None,
    *,
    instrument: Instrument | None = None,
    empirical: bool = False,
    say: Say | None = None,
) -> Diagnosis:
    """Show what the model gets wrong about measured data, and name the cause.

    Args:
        data: the measurements.
        machine: the machine.
        calibration: the model to be judged; the machine file's own if None.
        instrument: what read the data; None where the table's uncertainties or the repeats say how it scatters.
        empirical: whether what is left unexplained and belongs to the machine extends the calibration too, without a known cause
            (`twin.diagnosis.extend`).
        say: told what is being done and how far it is.

    Raises:
        InputError: data that cannot be a measurement of this machine.
    """
    tell = say or (lambda stage, part: None)
    errors = Calibration.default(machine) if calibration is None else calibration
    with threadpool_limits(limits=1, user_api="blas"):
        tell("placing the stations", 0.0)
        placed = readings(data, machine, errors, instrument)
        tell("searching", 0.2)
        found = search(placed)
        tell("weighing", 0.7)
        return account(found, errors, empirical=empirical)


def search(placed: Readings) -> Findings:
    """The best set of causes; rows too far off to be chance count where one of the causes is why."""
    bad = _still_bad(placed) if np.count_nonzero(placed.bad) >= WITNESSES else placed.bad
    problem, known, scatter = placed.without(bad)
    return Searcher(problem, known, scatter).run()


def _still_bad(placed: Readings) -> np.ndarray:
    """(n,) rows that are too far off whatever the cause: those of the start, unless causes account for more than half of them.

    What moves rows so far shows in some of the others as well: of very many, some are looked at.
    """
    count, bad = len(placed.bad), np.flatnonzero(placed.bad)
    if count > LOOKED_AT and len(bad) < LOOKED_AT // 4:
        drawn = np.random.default_rng(SEED).choice(np.flatnonzero(~placed.bad), LOOKED_AT - len(bad), replace=False)
        rows = np.sort(np.concatenate([bad, drawn]))
        found = np.zeros(count, dtype=bool)
        found[rows] = _still_bad(placed.some(rows))
        return found
    whole, known, scatter = placed.without(np.zeros(len(placed.bad), dtype=bool))
    pool = Searcher(whole, known, scatter).pool
    size = np.linalg.norm(placed.network.residual(np.zeros(0), placed.setup), axis=1)
    for share in TAKEN_BACK:
        bad = placed.bad & (size > np.quantile(size[placed.bad], share))
        for _ in range(ROBUST):
            still = _beyond(placed, whole, pool, bad)
            settled = np.count_nonzero(still & ~bad) == 0 and np.count_nonzero(still) > 0.9 * np.count_nonzero(bad)
            if settled or np.count_nonzero(still) > 0.5 * np.count_nonzero(placed.bad):
                break
            bad = still
        if np.count_nonzero(still) <= 0.5 * np.count_nonzero(placed.bad):
            return still
    return placed.bad


def _beyond(placed: Readings, whole: Problem, pool: Pool, bad: np.ndarray) -> np.ndarray:
    """(n,) rows too far off once the causes that the other rows show are taken out of all."""
    part = whole.without(bad) if np.any(bad) else whole
    if part is None:
        return placed.bad
    forms = glimpse(pool.on(part), CLEAR)
    left = whole.residual - estimate(part, forms).signature.sum(axis=1)
    return outliers(placed.network, part.following(left).reshape(-1, 3))


class Searcher:
    """The catalogue and the patterns without a name, on one data set.

    Args:
        problem: the data.
        known: the causes to try.
        scatter: of the readings.
    """

    def __init__(self, problem: Problem, known: Catalogue, scatter: Scatter) -> None:
        self.problem = problem
        self.known = known
        self.scatter = scatter
        forms = every(known.candidates, prices(known.candidates))
        split = parts(problem.network.data, problem.network.machine, ())
        self.pool = Pool(problem, forms, scatter.dof, None if split is None else split.part)
        self.patterns = patterns(problem.network.machine, problem.network.data)

    def run(self) -> Findings:
        """The best set of causes, and the patterns without a name that stand beside them."""
        found, refuted = self._settled()
        # What a variant does between positions is asked of positions left out: refuted there, it is the plain effect and a rest.
        while varying := [
            form
            for form in found.forms
            if form.candidate.specification.more_of and not foretells(self.pool, form, found.forms)
        ]:
            self.pool.forbid({form.key for form in varying})
            found, refuted = self._settled()
        beside = self.pool.beside(found.problem) if found.traces else self.pool
        return Findings(self.problem, self.known, self.scatter, self.patterns, self.pool, beside, found, refuted)

    def _settled(self) -> tuple[Structure, tuple[Form, ...]]:
        """The causes that stand and the patterns beside them, and the causes that readings left out refute.

        Where these are too few for what was fitted to them, they are too few as well to ask what causes a pattern could do.
        """
        chosen = self._best().forms
        kept = held_up(self.pool, chosen)
        if len(kept) == len(chosen):
            found = settled(self.pool, chosen, self.patterns)
            chosen, kept = found.forms, held_up(self.pool, found.forms)
            if len(kept) == len(chosen):
                return found, ()
        return named(self.pool, kept, self.patterns), tuple(form for form in chosen if form not in kept)

    def _best(self) -> Selection:
        """Named causes alone.

        Between two periods or time constants that were tried, a large cause leaves more than another cause is: what is large is put
        where the data have it, and the search made again.
        """
        best = chosen(self.pool)
        for _ in range(REFINED):
            if not self._refined(best):
                break
            best = chosen(self.pool, best.forms)
        return best

    def _refined(self, best: Selection) -> bool:
        machine, data = self.problem.network.machine, self.problem.network.data
        bent = [form for form in best.forms if form.bent]
        large = [
            form
            for form in bent
            if self.pool.scores([one for one in best.forms if one is not form], [form.index])[0, 0] > LARGE
        ]
        if not large:
            return False
        state = state_of(data, machine)
        found = estimate(self.problem, best.forms)
        moved = False
        for form, quantities in zip(best.forms, found.quantities, strict=True):
            # A straight drift has a time constant to show, but none in its columns.
            put = {q.name: q for q in quantities if form in large and q.name in form.bent}
            if not any(abs(form.cell.fixed[q.name] - q.value) > STAYS * q.u for q in put.values()):
                continue
            moved = True
            fixed = {name: q.value for name, q in put.items()}
            self.pool.refine(form, cell_at(form.candidate, fixed, machine, state))
        return moved
