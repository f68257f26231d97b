"""Two causes that data could not tell apart: the measurement that can.

With both in one model, each free to stand in for the other, set-up and the calibration's own doubt free too, a cause of size s is
told from the other where s² over the variance of its estimate is λ: then the expected log-likelihood ratio between the two is λ/2 in
its favour (T-optimality of Atkinson and Fedorov 1975; for two models linear in their sizes it is the D_s-optimality of the model that
holds both). What is made small is the sum of both variances, each in the size that is meant.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType
from typing import Final, final

import numpy as np
from threadpoolctl import threadpool_limits

from twin._common.arrays import locked
from twin._common.errors import InputError, nearest
from twin.diagnosis.candidates.candidate import Candidate, Cell
from twin.diagnosis.candidates.catalogue import SPECIFICATIONS, catalogue
from twin.diagnosis.problem.problem import TOLD_APART, Problem
from twin.identification.fitting import fitting
from twin.identification.network import Network
from twin.identification.setup import SetUp
from twin.identification.unknowns import Unknowns
from twin.machine.calibration import Calibration
from twin.machine.conditions import TIME
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument, usual
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.planning.aims import AtTool
from twin.planning.candidates import ALWAYS, Candidates, Session, candidates
from twin.planning.design import DesignProblem, covariance_of
from twin.planning.fill import fill
from twin.planning.kit import Kit
from twin.planning.model import as_told, setup_of
from twin.planning.result import ODDS, Plan, Separation
from twin.planning.task import Say, Task

POWER: Final = 1.645
"""Quantile of 95 %: the chance that the odds come out that good."""
LAMBDA: Final = (POWER + float(np.sqrt(POWER**2 + 2.0 * np.log(ODDS)))) ** 2
"""s²/Var of a cause so told from the other: the log-likelihood ratio is normal about λ/2 with variance λ."""
WARM_K: Final = 5.0
"""K: how much warmer a sensor is in a session than in the others."""
HOLD: Final = 1e-4
"""Precision of a set-up beforehand, over that of its plausible size."""
LATER_S: Final = 4.0 * 3600.0
"""After a cold start, when a drift has mostly gone through."""


@final
@dataclass(frozen=True)
class Named:
    """A cause as somebody names it.

    Attributes:
        effect, where: contract §5.
        numbers: its parameters, those given.
    """

    effect: str
    where: str
    numbers: Mapping[str, float]

    @classmethod
    def parse(cls, text: str) -> Named:
        """``cross_axis E_AX by Z``, ``reversal:Y``, ``pitch_error X amplitude=2 period=10``.

        Raises:
            InputError: it is not one.
        """
        words = shlex.split(text.replace(":", " ", 1))
        numbers: dict[str, float] = {}
        while words and "=" in words[-1]:
            name, _, value = words.pop().partition("=")
            try:
                numbers[name] = float(value)
            except ValueError:
                raise InputError("no number", expected=f"{name}=<number>", value=text) from None
        if not words:
            raise InputError("no effect", expected="an effect and where: reversal Y", value=text)
        return cls(words[0], " ".join(words[1:]) or "—", MappingProxyType(numbers))

    @property
    def text(self) -> str:
        """Effect and where."""
        return f"{self.effect} {self.where}"


def separate(
    machine: Machine,
    first: str,
    second: str,
    kit: Kit | None = None,
    *,
    minutes: float = 60.0,
    calibration: Calibration | None = None,
    after: Measurements | None = None,
    seed: int = 0,
    say: Say | None = None,
) -> Plan:
    """The measurement that tells one cause from another.

    Args:
        machine: the machine.
        first: a cause, as ``cross_axis E_AX by Z``; its numbers where they are known (``pitch_error X amplitude=2 period=10``).
        second: what it could be mistaken for.
        kit: what there is to measure with; `Kit.default` if None.
        minutes: that it may take, setting up included.
        calibration: whose own doubt counts; the machine file's if None.
        after: what has been measured already; the new readings are taken beside it, with stations and targets set up anew.
        seed: of the poses tried.
        say: told what is being done and how far it is.

    Raises:
        InputError: a cause that is none of this machine's, or whose place and time no plan can choose; two that are one; no time.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        causes = (Named.parse(first), Named.parse(second))
        if causes[0].text == causes[1].text:
            raise InputError("two causes that are one", expected="two effects, or two places of one", value=second)
        task = Task.of(machine, kit, minutes, calibration, seed, say)
        if after is not None:
            rounds = max((int(name) for name in after.round if str(name).isdecimal()), default=0)
            task = replace(task, kit=_beside(task.kit, after), first_round=1 + rounds)
        task.say("looking", 0.0)
        every = _in_sessions(candidates(machine, task.kit, task.rng).plan, _sessions(causes))
        question = _Question(task, causes, after)
        cells = question.cells(every.plan)
        filled = fill(task, [question.problem(one, every, cells) for one in task.kit.instruments])
        chosen = filled.route.plan
        last = question.cells(chosen)
        in_order = Candidates(chosen, np.zeros(len(chosen), dtype=int))
        told = question.problem(filled.stands[0].readings.instrument, in_order, last)
        aim = f"separate {causes[0].text} from {causes[1].text}"
        separation = _separation(causes, last, covariance_of(told.prior, told.rows))
        return Plan.of(task, aim, filled, separation=separation)


Meant = tuple[Candidate, Cell]
"""A cause and the form of it that is meant."""


@final
@dataclass(frozen=True)
class _Question:
    """Which of two causes it is.

    Attributes:
        task: whose calibration's own doubt counts.
        causes: both.
        after: what has been measured already.
    """

    task: Task
    causes: tuple[Named, Named]
    after: Measurements | None

    def cells(self, plan: Measurements) -> tuple[Meant, Meant]:
        """The forms that are meant, at the readings of a plan."""
        first, second = (form_meant(one, self.task.machine, plan, self.task.expected) for one in self.causes)
        return first, second

    def problem(self, instrument: Instrument, every: Candidates, cells: tuple[Meant, Meant]) -> DesignProblem:
        """Derivatives by set-up, the calibration's doubt and the two causes, and what is known of these before the new readings."""
        problem = self._planned(instrument, every.plan)
        columns = [problem.signature(cell.columns) for _, cell in cells]
        setup, doubt = len(problem.setup), len(problem.prior)
        whole = np.concatenate([problem.nuisance, *columns], axis=1)
        total = whole.shape[1]
        # `twin diagnose` holds a set-up by nothing: where on its carrier a target sits, angles of the machine alone may have to tell.
        prior = np.diag(np.where(np.arange(total) < setup, HOLD, 1.0))
        if self.after is not None:
            prior[setup:, setup:] += self._told_already(instrument, self.after)
        ends = np.cumsum([setup + doubt, *(block.shape[1] for block in columns)])
        sizes = tuple(
            _meant(one, cell) / float(np.mean([column.scale for column in cell[1].columns]))
            for one, cell in zip(self.causes, cells, strict=True)
        )
        # Where nothing is said of a size, both count alike: in the size that is plausible.
        safe = (sizes[0], sizes[1]) if all(size == size and size > 0.0 for size in sizes) else (1.0, 1.0)
        both = np.zeros((total, total))
        for (begin, end), size in zip(pairwise(ends), safe, strict=True):
            both[range(begin, end), range(begin, end)] = 1.0 / size
        aim = AtTool(both[None], "separate", "of the sizes meant")
        return DesignProblem(instrument, every, prior, whole.reshape(-1, 3, total), aim)

    def _planned(self, instrument: Instrument, every: Measurements) -> Problem:
        machine, kit = self.task.machine, self.task.kit
        zero, rng = Calibration.zero(machine), np.random.default_rng(0)
        measured, _ = simulate(every, machine, zero, instrument, rng, setting=kit.setting, noise=False)
        told = as_told(replace(measured, station_pose=every.station_pose, place_mm=every.place_mm), kit.known)
        return self._problem(told, instrument, setup_of(told, kit.setting, instrument))

    def _problem(self, data: Measurements, instrument: Instrument, setup: SetUp) -> Problem:
        machine, known = self.task.machine, self.task.expected
        return Problem(Network(machine, data, instrument, Unknowns(machine, [], []), known), setup, known)

    def _told_already(self, instrument: Instrument, after: Measurements) -> np.ndarray:
        """(k, k) precision that earlier readings give to the calibration's doubt and the two causes, their own set-up projected out."""
        lengths_only = bool(np.isnan(after.point_mm[:, 1:]).all())
        kept, setup = fitting(self.task.machine, after, lengths_only=lengths_only)
        reader = instrument if lengths_only or not instrument.lengths_only else usual(lengths_only=False)
        problem = self._problem(kept, reader, setup)
        columns = [problem.signature(cell.columns) for _, cell in self.cells(kept)]
        own, doubts = np.split(problem.nuisance, [len(problem.setup)], axis=1)
        rest = np.concatenate([doubts, *columns], axis=1)
        # Not all of a set-up need show: a frame and everything that was read in it may move together.
        basis, strength, _ = np.linalg.svd(own, full_matrices=False)
        basis = basis[:, strength > TOLD_APART * strength[0]]
        left = rest - basis @ (basis.T @ rest)
        return np.asarray(left.T @ left)


def _beside(kit: Kit, after: Measurements) -> Kit:
    """The kit with names that the earlier table does not have: set up anew, a station or reflector is another one."""

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


def _sessions(causes: Sequence[Named]) -> tuple[Session, ...]:
    """The states in which two causes differ: cold and later, one sensor warm at a time; only those that one of them feels."""
    sensors: list[str] = []
    drifts = False
    for one in causes:
        needed = () if one.effect not in SPECIFICATIONS else SPECIFICATIONS[one.effect].channels(one.where)
        sensors += [name[2:-5] for name in needed if name.startswith("T_")]
        drifts = drifts or TIME in needed
    if not sensors and not drifts:
        return ALWAYS
    names = tuple(dict.fromkeys(sensors))
    level = dict.fromkeys(names, 20.0)
    what = " and ".join(names)
    found = [Session("machine cold" + (f", {what} at 20 °C" if names else ""), 0.0, MappingProxyType(level))]
    at = 0.0
    for name in names:
        at += LATER_S
        words = f"{name} {WARM_K:g} K warmer" + (", everything else as before" if len(names) > 1 else "")
        found.append(Session(words, at, MappingProxyType({**level, name: 20.0 + WARM_K})))
    if drifts:
        at += LATER_S
        words = f"{LATER_S / 3600.0:g} hours later, machine running" + (f", {what} back at 20 °C" if names else "")
        found.append(Session(words, at, MappingProxyType(level)))
    return tuple(found)


def _in_sessions(plain: Measurements, sessions: tuple[Session, ...]) -> Candidates:
    """Every reading in every session."""
    n = len(plain)
    session = np.repeat(np.arange(len(sessions)), n)
    every = plain.select(np.tile(np.arange(n), len(sessions)))
    names = dict.fromkeys(name for one in sessions for name in one.temperatures)
    temperatures = {name: locked(np.array([one.temperatures[name] for one in sessions])[session]) for name in names}
    starts = np.array([one.start_s for one in sessions])
    timed = replace(every, time_s=locked(starts[session]), temperature_degC=MappingProxyType(temperatures))
    return Candidates(timed, session, sessions)


def form_meant(one: Named, machine: Machine, plan: Measurements, calibration: Calibration) -> Meant:
    """The form of a cause that is meant: with the non-linear parameters given, else the plainest.

    A drift is an exponential if its ``amplitude`` or ``time_constant`` is given, else a straight line with a ``rate``.

    Raises:
        InputError: no such cause, or none that a plan can look for.
    """
    tried = catalogue(machine, plan, calibration)
    found = next((c for c in tried.candidates if c.key == (one.effect, one.where)), None)
    if found is None or found.origin == "instrument":
        places = [c.where for c in tried.candidates if c.effect == one.effect and c.origin == "machine"]
        effects = dict.fromkeys(c.effect for c in tried.candidates if c.origin == "machine")
        if found is not None or not (places or one.effect in effects):
            expected = f"an effect of the machine: {', '.join(effects)}"
        else:
            expected = f"{one.effect} at one of {', '.join(places)}"
        texts = [f"{c.effect} {c.where}" for c in tried.candidates if c.origin == "machine"]
        raise InputError(
            "no cause that a plan can look for", expected=expected, value=one.text, nearest=nearest(one.text, texts)
        )
    names = {name for cell in found.variants for name in cell.fixed}
    linear = {name for name, _ in found.names} | {"size", "amplitude", "phase", "cos", "sin"}
    exponential = found.drift is not None and not one.numbers.keys().isdisjoint(("amplitude", "time_constant"))
    if found.drift is not None and not exponential:
        linear = {"rate", "amplitude", "size"}
    strange = [name for name in one.numbers if name not in names | linear]
    if strange:
        raise InputError(
            f"{one.text} has no such parameter",
            expected=", ".join(sorted(names | linear)),
            value=strange[0],
            nearest=nearest(strange[0], names | linear),
        )

    def off(cell: Cell) -> float:
        if any(name in names and name not in cell.fixed for name in one.numbers):
            return np.inf
        wanted = {name: value for name, value in one.numbers.items() if name in cell.fixed}
        return sum(abs(np.log(abs(cell.fixed[name]) / abs(value))) for name, value in wanted.items() if value)

    cells = [cell for cell in found.variants if found.drift is None or bool(cell.fixed) == exponential]
    plainest = min(len(cell.columns) for cell in cells)
    return found, min(cells, key=lambda cell: (off(cell), len(cell.columns) - plainest))


def _meant(one: Named, cell: Meant) -> float:
    """How large a cause was said to be; NaN if nothing was said."""
    linear = [value for name, value in one.numbers.items() if name not in cell[1].fixed and name != "phase"]
    return float(np.sqrt(np.sum(np.square(linear)))) if linear else float("nan")


def _separation(causes: tuple[Named, Named], cells: tuple[Meant, Meant], covariance: np.ndarray) -> Separation:
    sizes: list[tuple[float, str]] = []
    start = len(covariance) - sum(len(cell.columns) for _, cell in cells)
    for candidate, cell in cells:
        end = start + len(cell.columns)
        scale = np.array([column.scale for column in cell.columns])
        own = covariance[start:end, start:end] * np.outer(scale, scale)
        start = end
        # Of several numbers the one known worst.
        worst = float(np.sqrt(LAMBDA * np.linalg.eigvalsh(own)[-1]))
        straight = candidate.drift is not None and not cell.fixed
        sizes.append((worst, "um/h" if straight else candidate.names[0][1]))
    meant = tuple(_meant(one, cell) for one, cell in zip(causes, cells, strict=True))
    return Separation((causes[0].text, causes[1].text), (sizes[0], sizes[1]), (meant[0], meant[1]))
