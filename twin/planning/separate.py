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
from twin.diagnosis.catalogue import Candidate, Cell, catalogue
from twin.diagnosis.problem import TOLD_APART, Problem
from twin.identification.fitting import fitting
from twin.identification.network import Network
from twin.identification.unknowns import Unknowns
from twin.machine.calibration import Calibration
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument, usual
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.planning.candidates import candidates, safe_poses, setting_of
from twin.planning.design import AtTool, Say, covariance_of
from twin.planning.fill import Filler, Readings
from twin.planning.information import as_told, setup_of
from twin.planning.kit import Kit
from twin.planning.result import ODDS, Plan, Separation, alternatives
from twin.planning.route import ALWAYS, Session

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
        own = Kit.default(machine) if kit is None else kit
        tell: Say = say or (lambda stage, part: None)
        known = Calibration.default(machine) if calibration is None else calibration
        first_round = 1
        if after is not None:
            own = _beside(own, after)
            first_round += max((int(name) for name in after.round if str(name).isdecimal()), default=0)
        filler = Filler(machine, own, minutes, seed, tell, first_round=first_round)
        tell("looking", 0.0)
        sessions = _sessions(causes)
        plain = candidates(machine, own, safe_poses(machine, own, filler.rng), filler.rng)
        every, session = _in_sessions(plain, sessions)
        cells = tuple(form_meant(one, machine, every, known) for one in causes)
        found: list[Readings] = []
        for instrument in own.instruments:
            found.append(_readings(machine, own, instrument, every, session, sessions, known, causes, cells, after))
        stands = filler.best([one for readings in found for one in filler.stands(readings)])
        best = stands[0]
        way = filler.filled(best)
        again = tuple(form_meant(one, machine, way.plan, known) for one in causes)
        last = _readings(
            machine,
            own,
            best.readings.instrument,
            way.plan,
            np.zeros(len(way.plan), dtype=int),
            ALWAYS,
            known,
            causes,
            again,
            after,
        )
        return Plan(
            machine,
            own,
            f"separate {causes[0].text} from {causes[1].text}",
            best.readings.instrument,
            best.stations,
            way,
            None,
            alternatives(stands),
            seed,
            _separation(causes, again, covariance_of(last.prior, last.rows)),
            known.warnings,
        )


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
    sensors = []
    for one in causes:
        if one.effect == "thermal_expansion":
            sensors.append(one.where)
        if one.effect == "thermal_growth":
            sensors.append(one.where.partition(" by ")[2])
    drifts = any(one.effect == "thermal_drift" for one in causes)
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


def _in_sessions(plain: Measurements, sessions: tuple[Session, ...]) -> tuple[Measurements, np.ndarray]:
    """Every reading in every session, and (n,) which session."""
    n = len(plain)
    session = np.repeat(np.arange(len(sessions)), n)
    every = plain.select(np.tile(np.arange(n), len(sessions)))
    names = dict.fromkeys(name for one in sessions for name in one.temperatures)
    temperatures = {name: locked(np.array([one.temperatures[name] for one in sessions])[session]) for name in names}
    starts = np.array([one.start_s for one in sessions])
    return replace(every, time_s=locked(starts[session]), temperature_degC=MappingProxyType(temperatures)), session


def form_meant(one: Named, machine: Machine, plan: Measurements, calibration: Calibration) -> tuple[Candidate, Cell]:
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
    names = {name for cell in found.cells for name in cell.fixed}
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

    cells = [cell for cell in found.cells if found.drift is None or bool(cell.fixed) == exponential]
    plainest = min(len(cell.columns) for cell in cells)
    return found, min(cells, key=lambda cell: (off(cell), len(cell.columns) - plainest))


def _readings(
    machine: Machine,
    kit: Kit,
    instrument: Instrument,
    every: Measurements,
    session: np.ndarray,
    sessions: tuple[Session, ...],
    calibration: Calibration,
    causes: tuple[Named, ...],
    cells: tuple[tuple[Candidate, Cell], ...],
    after: Measurements | None,
) -> Readings:
    """Derivatives by set-up, the calibration's doubt and the two causes, and what is known of these before the new readings."""
    problem = _problem(machine, kit, instrument, every, calibration)
    columns = [problem.signature(cell.columns) for _, cell in cells]
    setup, doubt = len(problem.setup), len(problem.prior)
    whole = np.concatenate([problem.nuisance, *columns], axis=1)
    total = whole.shape[1]
    # `twin diagnose` holds a set-up by nothing: where on its carrier a target sits, angles of the machine alone may have to tell.
    prior = np.diag(np.where(np.arange(total) < setup, HOLD, 1.0))
    if after is not None:
        prior[setup:, setup:] += _told_already(machine, instrument, after, calibration, causes, doubt)
    ends = np.cumsum([setup + doubt, *(block.shape[1] for block in columns)])
    sizes = tuple(
        _meant(one, cell) / float(np.mean([column.scale for column in cell[1].columns]))
        for one, cell in zip(causes, cells, strict=True)
    )
    # Where nothing is said of a size, both count alike: in the size that is plausible.
    safe = (sizes[0], sizes[1]) if all(size == size and size > 0.0 for size in sizes) else (1.0, 1.0)
    both = np.zeros((total, total))
    for (begin, end), size in zip(pairwise(ends), safe, strict=True):
        both[range(begin, end), range(begin, end)] = 1.0 / size
    aim = AtTool(both[None], "separate", "of the sizes meant")
    return Readings(instrument, every, session, sessions, prior, whole.reshape(len(every), 3, total), aim)


def _problem(
    machine: Machine, kit: Kit, instrument: Instrument, every: Measurements, calibration: Calibration
) -> Problem:
    setting = setting_of(kit)
    measured, _ = simulate(
        every, machine, Calibration.zero(machine), instrument, np.random.default_rng(0), setting=setting, noise=False
    )
    told = as_told(replace(measured, station_pose=every.station_pose, place_mm=every.place_mm), kit.known)
    setup = setup_of(told, setting, instrument)
    return Problem(Network(machine, told, instrument, Unknowns(machine, [], []), calibration), setup, calibration)


def _told_already(
    machine: Machine,
    instrument: Instrument,
    after: Measurements,
    calibration: Calibration,
    causes: tuple[Named, ...],
    doubt: int,
) -> np.ndarray:
    """(k, k) precision that earlier readings give to the calibration's doubt and the two causes, their own set-up projected out."""
    lengths_only = bool(np.isnan(after.point_mm[:, 1:]).all())
    reader = instrument if lengths_only or not instrument.lengths_only else usual(lengths_only=False)
    kept, setup = fitting(machine, after, lengths_only=lengths_only)
    problem = Problem(
        Network(machine, kept, reader, Unknowns(machine, [], []), calibration),
        setup,
        calibration,
    )
    columns = [problem.signature(form_meant(one, machine, kept, calibration)[1].columns) for one in causes]
    own, doubts = np.split(problem.nuisance, [len(problem.setup)], axis=1)
    rest = np.concatenate([doubts, *columns], axis=1)
    # Not all of a set-up need show: a frame and everything that was read in it may move together.
    basis, strength, _ = np.linalg.svd(own, full_matrices=False)
    basis = basis[:, strength > TOLD_APART * strength[0]]
    left = rest - basis @ (basis.T @ rest)
    return np.asarray(left.T @ left)


def _meant(one: Named, cell: tuple[Candidate, Cell]) -> float:
    """How large a cause was said to be; NaN if nothing was said."""
    linear = [value for name, value in one.numbers.items() if name not in cell[1].fixed and name != "phase"]
    return float(np.sqrt(np.sum(np.square(linear)))) if linear else float("nan")


def _separation(
    causes: tuple[Named, ...], cells: tuple[tuple[Candidate, Cell], ...], covariance: np.ndarray
) -> Separation:
    sizes: list[tuple[float, str]] = []
    end = len(covariance)
    starts: list[int] = []
    for _, cell in reversed(cells):
        starts.insert(0, end - len(cell.columns))
        end -= len(cell.columns)
    for start, (candidate, cell) in zip(starts, cells, strict=True):
        count = len(cell.columns)
        scale = np.array([column.scale for column in cell.columns])
        own = covariance[start : start + count, start : start + count] * np.outer(scale, scale)
        # Of several numbers the one known worst.
        worst = float(np.sqrt(LAMBDA * np.linalg.eigvalsh(own)[-1]))
        straight = candidate.drift is not None and not cell.fixed
        sizes.append((worst, "um/h" if straight else candidate.names[0][1]))
    meant = tuple(_meant(one, cell) for one, cell in zip(causes, cells, strict=True))
    return Separation((causes[0].text, causes[1].text), (sizes[0], sizes[1]), (meant[0], meant[1]))
