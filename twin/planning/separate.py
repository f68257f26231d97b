"""Plan a measurement that distinguishes two causes which are confounded in the data so far.

Both causes, the set-up and the errors of the calibration are estimated together. A cause of size s is distinguished from the other if
s² divided by the variance of its estimate is at least λ: then the expected log-likelihood ratio of the two is λ/2 in its favour
(T-optimality of Atkinson and Fedorov 1975; for two models linear in their sizes it is the D_s-optimality of the model with both). The
criterion is the sum of both variances, each relative to the given size.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError, closest_name
from twin._common.records import TIME, is_temperature, sensor_of
from twin._common.resources import Progress, one_blas_thread, silent
from twin.diagnosis.candidates import SPECIFICATIONS, catalogue
from twin.diagnosis.candidates.candidate import Candidate, Variant
from twin.diagnosis.nuisance import RANK_TOLERANCE
from twin.diagnosis.problem import Problem
from twin.identification.network import Network, Unknowns
from twin.machine.machine import Machine
from twin.measurement.agreement import agreeing_rows
from twin.measurement.instruments import Instrument, Reads, StationInstruments, default_instrument
from twin.measurement.set_up import StationsAndTargets
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.planning.clearance import ANY_STATE, CandidateReadings, Session, candidates
from twin.planning.design import DesignProblem, covariance_of, fill
from twin.planning.kit import Kit, as_evaluated, setup_of
from twin.planning.plan import ODDS, Plan, Separation
from twin.planning.task import LinearAim, Task

POWER: Final = 1.645
"""One-sided 95 % quantile of the normal distribution: probability that the odds are reached."""
LAMBDA: Final = (POWER + float(np.sqrt(POWER**2 + 2.0 * np.log(ODDS)))) ** 2
"""s²/Var needed to distinguish a cause: the log-likelihood ratio is normal with mean λ/2 and variance λ."""
WARM_K: Final = 5.0
"""Temperature rise of a sensor in its session, K."""
SETUP_PRECISION: Final = 1e-4
"""Prior precision of the set-up, relative to that of its plausible size."""
SIZE: Final = "size"
"""Word for the size of any cause."""
LATER_S: Final = 4.0 * 3600.0
"""Seconds after a cold start when most of a drift has passed."""


@final
@dataclass(frozen=True)
class NamedCause:
    """Cause as named by the user."""

    effect: str  # effect, where: name of the effect and where it acts, as in a diagnosis
    where: str
    numbers: Mapping[str, float]  # the parameter values that are given, by name

    @classmethod
    def parse(cls, text: str) -> NamedCause:
        """Read a cause such as ``cross_axis E_AX by Z`` or ``pitch_error X amplitude=2 period=10``, or raise `InputError`."""
        words = shlex.split(text.replace(":", " ", 1))
        numbers: dict[str, float] = {}
        while words and "=" in words[-1]:
            name, _, value = words.pop().partition("=")
            try:
                numbers[name] = float(value)
            except ValueError:
                raise InputError("not a number", expected=f"{name}=<number>", value=text) from None
        if not words:
            raise InputError("no effect named", expected="an effect and where it acts, such as reversal Y", value=text)
        return cls(words[0], " ".join(words[1:]) or "—", MappingProxyType(numbers))

    @property
    def text(self) -> str:
        """Effect and where it acts."""
        return f"{self.effect} {self.where}"


def separate(  # noqa: PLR0913
    machine: Machine,
    first: str,
    second: str,
    kit: Kit | None = None,
    *,
    minutes: float = 60.0,
    calibration: Calibration | None = None,
    after: Measurements | None = None,
    seed: int = 0,
    progress: Progress = silent,
) -> Plan:
    """Plan the measurement that best distinguishes two causes.

    Args:
        machine: the machine.
        first: a cause, such as ``cross_axis E_AX by Z``, with its numbers if known (``pitch_error X amplitude=2 period=10``).
        second: the cause it may be confused with.
        kit: instruments, stations, reflectors and times; `Kit.default` if None.
        minutes: time budget, including set-up.
        calibration: calibration whose uncertainty is included; None: that of the machine file.
        after: earlier readings to be evaluated together with the new ones; stations and targets are set up anew.
        seed: random seed.
        progress: progress callback: stage and share done.

    Raises:
        InputError: a cause does not exist on this machine or cannot be planned for, the two causes are the same, or the time budget is
            too short.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> first, second = "cross_axis E_AX by Z coefficient=60", "cross_axis E_AY by Z coefficient=60"
        >>> plan = twin.separate(machine, first, second, minutes=30.0)
        >>> [value < 60 for value, unit in plan.separation.sizes]  # distinguished at the given sizes, µrad/m
        [True, True]

    References:
        - A. C. Atkinson, V. V. Fedorov: The design of experiments for discriminating between two rival models, Biometrika 62 (1975)
          57-70.
    """
    with one_blas_thread():
        causes = (NamedCause.parse(first), NamedCause.parse(second))
        if causes[0].text == causes[1].text:
            raise InputError(
                "the two causes are the same", expected="two effects, or one effect in two places", value=second
            )
        task = Task.of(machine, kit, minutes, calibration, seed, progress)
        if after is not None:
            rounds = max((int(name) for name in after.round if str(name).isdecimal()), default=0)
            task = replace(task, kit=_with_new_names(task.kit, after), first_round=1 + rounds)
        task.progress("drawing candidates", 0.0)
        every = _in_sessions(candidates(machine, task.kit, task.rng).plan, _sessions(causes))
        question = _Question(task, causes, after)
        cells = question.cells(every.plan)
        filled = fill(task, [question.problem(instrument, every, cells) for instrument in task.kit.instruments])
        chosen = filled.route.plan
        last = question.cells(chosen)
        in_order = CandidateReadings(chosen, np.zeros(len(chosen), dtype=int))
        final = question.problem(filled.station_choices[0].problem.instrument, in_order, last)
        aim = f"separate {causes[0].text} from {causes[1].text}"
        separation = _separation(causes, last, covariance_of(final.prior, final.rows))
        return Plan.of(task, aim, filled, separation=separation)


CauseForm = tuple[Candidate, Variant]
"""A cause and the form of it that is planned for."""


@final
@dataclass(frozen=True)
class _Question:
    """Design problem of distinguishing two causes."""

    task: Task  # machine, kit and the calibration whose uncertainty is included
    causes: tuple[NamedCause, NamedCause]  # both causes
    after: Measurements | None  # earlier readings, or None

    def cells(self, plan: Measurements) -> tuple[CauseForm, CauseForm]:
        """Return the forms of both causes at the readings of a plan."""
        first, second = (cause_form(cause, self.task.machine, plan, self.task.expected) for cause in self.causes)
        return first, second

    def problem(
        self, instrument: Instrument, every: CandidateReadings, cells: tuple[CauseForm, CauseForm]
    ) -> DesignProblem:
        """Return the derivatives with respect to set-up, calibration errors and the two causes, with their prior precision."""
        problem = self._planned(instrument, every.plan)
        columns = [problem.signature(cell.columns) for _, cell in cells]
        setup, calibration_errors = len(problem.setup), len(problem.nuisances.prior)
        whole = np.concatenate([problem.nuisance, *columns], axis=1)
        total = whole.shape[1]
        # `twin diagnose` has no prior on the set-up: a target's position on its carrier may have to follow from machine angles alone.
        prior = np.diag(np.where(np.arange(total) < setup, SETUP_PRECISION, 1.0))
        if self.after is not None:
            prior[setup:, setup:] += self._earlier_precision(instrument, self.after)
        ends = np.cumsum([setup + calibration_errors, *(block.shape[1] for block in columns)])
        sizes = tuple(
            _given_size(one, cell) / float(np.mean([column.scale for column in cell[1].columns]))
            for one, cell in zip(self.causes, cells, strict=True)
        )
        # Without given sizes both causes have equal weight, in units of their plausible size.
        safe = (sizes[0], sizes[1]) if all(size == size and size > 0.0 for size in sizes) else (1.0, 1.0)
        both = np.zeros((total, total))
        for (begin, end), size in zip(pairwise(ends), safe, strict=True):
            both[range(begin, end), range(begin, end)] = 1.0 / size
        aim = LinearAim(both[None], "separate", "of the given sizes")
        return DesignProblem(instrument, every, prior, whole.reshape(-1, 3, total), aim)

    def _planned(self, instrument: Instrument, every: Measurements) -> Problem:
        machine, kit = self.task.machine, self.task.kit
        zero, rng = Calibration.zero(machine), np.random.default_rng(0)
        measured, _ = simulate(every, machine, zero, instrument, rng, setting=kit.setting, noise=False)
        evaluated = as_evaluated(replace(measured, station_pose=every.station_pose, place_mm=every.place_mm), kit.known)
        return self._problem(evaluated, instrument, setup_of(evaluated, kit.setting, instrument))

    def _problem(self, data: Measurements, instrument: Instrument, setup: StationsAndTargets) -> Problem:
        machine, known = self.task.machine, self.task.expected
        instruments = StationInstruments.same(instrument, data.station)
        return Problem(Network(machine, data, instruments, Unknowns(machine, [], []), known), setup, known)

    def _earlier_precision(self, instrument: Instrument, after: Measurements) -> np.ndarray:
        """Return the precision (k, k) of calibration errors and causes from earlier readings, their set-up projected out."""
        lengths_only = bool(np.isnan(after.point_mm[:, 1:]).all())
        reads: Reads = "length" if lengths_only else "point"
        reader = instrument if instrument.specification.reads == reads else default_instrument(reads)
        kept, setup = agreeing_rows(self.task.machine, after, StationInstruments.same(reader, after.station))
        problem = self._problem(kept, reader, setup)
        columns = [problem.signature(cell.columns) for _, cell in self.cells(kept)]
        own, calibration_errors = np.split(problem.nuisance, [len(problem.setup)], axis=1)
        rest = np.concatenate([calibration_errors, *columns], axis=1)
        # Part of a set-up may be undetermined: a frame and everything read in it can move together.
        basis, strength, _ = np.linalg.svd(own, full_matrices=False)
        basis = basis[:, strength > RANK_TOLERANCE * strength[0]]
        projected = rest - basis @ (basis.T @ rest)
        return np.asarray(projected.T @ projected)


def _with_new_names(kit: Kit, after: Measurements) -> Kit:
    """Return the kit with names not used in the earlier table: after a new set-up a station or reflector has new unknowns."""

    def fresh(name: str, taken: set[str]) -> str:
        number = 2
        new = name
        while new in taken:
            new, number = f"{name} {number}", number + 1
        return new

    stations, targets = {*after.station}, {*after.target}
    return replace(
        kit,
        stations=MappingProxyType({fresh(name, stations): one for name, one in kit.stations.items()}),
        stations_known=frozenset(fresh(name, stations) for name in kit.stations_known),
        targets=MappingProxyType({fresh(name, targets): one for name, one in kit.targets.items()}),
    )


def _sessions(causes: Sequence[NamedCause]) -> tuple[Session, ...]:
    """Return the sessions in which the two causes differ: cold, one sensor warm at a time, hours later; only where needed."""
    sensors: list[str] = []
    drifts = False
    for cause in causes:
        needed = () if cause.effect not in SPECIFICATIONS else SPECIFICATIONS[cause.effect].channels(cause.where)
        sensors += [sensor_of(name) for name in needed if is_temperature(name)]
        drifts = drifts or TIME in needed
    if not sensors and not drifts:
        return ANY_STATE
    names = tuple(dict.fromkeys(sensors))
    level = dict.fromkeys(names, 20.0)
    what = " and ".join(names)
    sessions = [Session("machine cold" + (f", {what} at 20 °C" if names else ""), 0.0, MappingProxyType(level))]
    at = 0.0
    for name in names:
        at += LATER_S
        words = f"{name} {WARM_K:g} K warmer" + (", everything else as before" if len(names) > 1 else "")
        sessions.append(Session(words, at, MappingProxyType({**level, name: 20.0 + WARM_K})))
    if drifts:
        at += LATER_S
        words = f"{LATER_S / 3600.0:g} hours later, machine running" + (f", {what} back at 20 °C" if names else "")
        sessions.append(Session(words, at, MappingProxyType(level)))
    return tuple(sessions)


def _in_sessions(plain: Measurements, sessions: tuple[Session, ...]) -> CandidateReadings:
    """Return every candidate reading in every session."""
    n = len(plain)
    session = np.repeat(np.arange(len(sessions)), n)
    every = plain.select(np.tile(np.arange(n), len(sessions)))
    names = dict.fromkeys(name for one in sessions for name in one.temperatures)
    temperatures = {name: read_only(np.array([one.temperatures[name] for one in sessions])[session]) for name in names}
    starts = np.array([one.start_s for one in sessions])
    timed = replace(every, time_s=read_only(starts[session]), temperature_degC=MappingProxyType(temperatures))
    return CandidateReadings(timed, session, sessions)


def cause_form(one: NamedCause, machine: Machine, plan: Measurements, calibration: Calibration) -> CauseForm:
    """Return the form of a cause with the given non-linear parameters, else the simplest; `InputError` if no plan can separate it.

    A drift is exponential if a parameter of its entry is given (``amplitude``, ``time_constant``), else linear with a ``rate``.
    """
    tried = catalogue(machine, plan, calibration)
    candidate = next((c for c in tried.candidates if c.key == (one.effect, one.where)), None)
    if candidate is None or candidate.origin == "instrument":
        places = [c.where for c in tried.candidates if c.effect == one.effect and c.origin == "machine"]
        effects = dict.fromkeys(c.effect for c in tried.candidates if c.origin == "machine")
        if candidate is not None or not (places or one.effect in effects):
            expected = f"an effect of the machine: {', '.join(effects)}"
        else:
            expected = f"{one.effect} at one of {', '.join(places)}"
        texts = [f"{c.effect} {c.where}" for c in tried.candidates if c.origin == "machine"]
        raise InputError(
            "not a cause that a plan can separate",
            expected=expected,
            value=one.text,
            nearest=closest_name(one.text, texts),
        )
    names = {name for cell in candidate.variants for name in cell.fixed}
    drift, specification = candidate.drift, candidate.specification
    # The parameters of a drift's entry are those of an exponential.
    exponential = drift is not None and not one.numbers.keys().isdisjoint(specification.parameters)
    cells = [cell for cell in candidate.variants if drift is None or bool(cell.fixed) == exponential]
    plainest = min(cells, key=lambda cell: len(cell.columns))
    known = {
        SIZE,
        *(name for name, _ in candidate.names),
        *names,
        *specification.parameters,
        *_built(candidate, plainest),
    }
    if drift is not None and not exponential:
        known -= {*specification.parameters, *names}
    strange = [name for name in one.numbers if name not in known]
    if strange:
        raise InputError(
            f"{one.text} has no such parameter",
            expected=", ".join(sorted(known)),
            value=strange[0],
            nearest=closest_name(strange[0], known),
        )

    def off(cell: Variant) -> float:
        if any(name in names and name not in cell.fixed for name in one.numbers):
            return np.inf
        wanted = {name: value for name, value in one.numbers.items() if name in cell.fixed}
        return sum(abs(np.log(abs(cell.fixed[name]) / abs(value))) for name, value in wanted.items() if value)

    return candidate, min(cells, key=lambda cell: (off(cell), len(cell.columns) - len(plainest.columns)))


def _built(candidate: Candidate, cell: Variant) -> set[str]:
    """Return the names of the numbers of the effect that a form of a candidate builds."""
    effects = () if candidate.build is None else candidate.build(np.ones(len(cell.columns)), cell.fixed)
    return {name for effect in effects for name in effect.numbers}


def _given_size(one: NamedCause, cell: CauseForm) -> float:
    """Return the given size of a cause; NaN if none was given."""
    others = {*cell[1].fixed, *cell[0].specification.nonlinear}
    linear = [value for name, value in one.numbers.items() if name not in others]
    return float(np.sqrt(np.sum(np.square(linear)))) if linear else float("nan")


def _separation(
    causes: tuple[NamedCause, NamedCause], cells: tuple[CauseForm, CauseForm], covariance: np.ndarray
) -> Separation:
    """Return the smallest size of each cause that is distinguished, from the predicted covariance."""
    sizes: list[tuple[float, str]] = []
    start = len(covariance) - sum(len(cell.columns) for _, cell in cells)
    for candidate, cell in cells:
        end = start + len(cell.columns)
        scale = np.array([column.scale for column in cell.columns])
        own = covariance[start:end, start:end] * np.outer(scale, scale)
        start = end
        # With several parameters, the least certain direction.
        worst = float(np.sqrt(LAMBDA * np.linalg.eigvalsh(own)[-1]))
        straight = candidate.drift is not None and not cell.fixed
        sizes.append((worst, "um/h" if straight else candidate.names[0][1]))
    given = tuple(_given_size(one, cell) for one, cell in zip(causes, cells, strict=True))
    return Separation((causes[0].text, causes[1].text), (sizes[0], sizes[1]), (given[0], given[1]))
