"""The shortest measurement that shows whether what was written into a control took effect (`twin.monitoring.confirmation`).

A measurement shows a written value if it excludes every hypothesis of one or two mistakes by which the value is absent or reversed.
Such a hypothesis changes the factors of the written values by d; with I the information on the factors, the set-up and the errors of
the machine integrated out, its log-likelihood ratio is normal with mean λ/2 and variance λ = dᵀ I d.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.messages import Message, joined
from twin._common.resources import Progress, one_blas_thread, silent
from twin._common.units import UM
from twin.display.numbers import listed
from twin.display.results import Result
from twin.identification.network import Network, Unknowns
from twin.identification.unidentified import constant_unknowns
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument, StationInstruments, instrument_named
from twin.measurement.observation import machine_state
from twin.measurement.set_up import StationsAndTargets
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.monitoring.confirmation import ACTIVE
from twin.monitoring.written import POSES, SEED, WrittenValue, effects_on, groups_of, mattering, mistakes
from twin.planning.clearance import candidates
from twin.planning.design import DesignProblem, Exchange, covariance_of, fill
from twin.planning.kit import Kit, as_evaluated, setup_of
from twin.planning.measure import SequencePlan, sequence_task
from twin.planning.plan import Plan
from twin.planning.separate import LAMBDA
from twin.planning.sequences.contacts import reach
from twin.planning.sequences.moves import grid, ordered
from twin.planning.sequences.specification import (
    CONTACTS,
    SET_UPS,
    InstrumentSizes,
    MeasuringSequence,
    SequencePoints,
    SequenceTask,
    expectation,
    minutes_of,
    seconds_of,
    sequence_table,
    with_nominal_readings,
)
from twin.planning.task import Aim, Task
from twin.tool.forward import Kinematics
from twin.tool.uncertainty import volume

SHOWN_U: Final = float(LAMBDA**-0.5)
"""Standard uncertainty, relative to the least distinct mistake of a value, from which `twin confirm` excludes it in 95 of 100 cases."""
RESERVE: Final = 2.0
"""Factor by which all candidate readings together must be better, for a value to be planned for."""
DURATIONS: Final = (8.0, 10.0, 12.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 120.0, 180.0)
"""Durations tried with a kit, in minutes."""
FEWEST: Final = 4
HIGHER_MM: Final = 100.0
"""Height of a second place of the sphere above the first: a table over Z, or times Z, needs heights that differ."""
MOST: Final = 60
"""Poses of a probe in one plan."""
BEYOND: Final = 1e-2
"""Weight of mistakes that are distinct already."""
CONFIRM: Final = "whether every table and value of the kinematics is in effect, with its sign"
PROBED: Final = MeasuringSequence(
    name="confirm",
    title=Message("the fewest poses that show what was written"),
    source=Message("exchange (Fedorov 1972) over a grid of the rotary axes"),
    instruments=("probe",),
    unverified=Message(""),
    limits=Message("Three or more mistakes that compensate each other in these poses are not seen."),
    make=grid,
)


@final
class WeakestMistake(Aim):
    """Standard uncertainty of the least distinct mistake, relative to its size.

    Args:
        changes: (h, k) changes of the factors, which are the first k coordinates with prior 1.
    """

    name = CONFIRM
    unit = "of the least distinct mistake"

    def __init__(self, changes: np.ndarray) -> None:
        self.changes = changes

    def strengths(self, covariance: np.ndarray) -> np.ndarray:
        """Return λ (h,) of each change."""
        count = self.changes.shape[1]
        information = np.linalg.inv(covariance[:count, :count]) - np.eye(count)
        found = np.einsum("hk,kl,hl->h", self.changes, information, self.changes)
        return np.asarray(np.maximum(found, 1e-12))

    def weight(self, covariance: np.ndarray) -> np.ndarray:
        """See `Aim.weight`."""
        count, strengths = self.changes.shape[1], self.strengths(covariance)
        # All mistakes that are not distinct yet count: the single worst one changes with every reading.
        part = np.maximum(1.0 - strengths / LAMBDA, 0.0) + BEYOND / (1.0 + strengths) ** 2
        along = np.linalg.solve(covariance[:count, :count], self.changes.T)
        found = np.zeros_like(covariance)
        found[:count, :count] = (along * part) @ along.T
        return found

    def value(self, covariance: np.ndarray) -> float:
        """See `Aim.value`."""
        return float(self.strengths(covariance).min() ** -0.5)


@final
@dataclass(frozen=True, repr=False)
class ConfirmationPlan(Result):
    """A plan to confirm what was written, and what it shows.

    Attributes:
        u: standard uncertainty of the least distinct mistake of each written value that matters, relative to its size, by name.
        hidden: those that no reading with this equipment shows.
        twice: those for which the plan must be measured before and after.
        shown: whether it shows all others.
        steps: minute of the (second) measurement, and the values that are shown from then on.
        alone: those that the plan shows if it is measured afterwards only.
        others: other equipment that was compared, with its minutes.
        set_up: minutes for setting up, which a second measurement needs only if the set-up was taken down.
    """

    plan: Plan | SequencePlan
    u: Mapping[str, float]
    hidden: tuple[str, ...]
    twice: tuple[str, ...]
    shown: bool
    steps: tuple[tuple[float, tuple[str, ...]], ...]
    alone: tuple[str, ...]
    others: tuple[str, ...] = ()
    set_up: float = 0.0

    @property
    def brief(self) -> str:
        """Duration, and what is shown."""
        lacking = len(self.hidden) + sum(u > SHOWN_U for u in self.u.values())
        return Message(
            "plan to confirm {count} written values in {minutes:.0f} min: {lacking} not shown",
            count=len(self.u) + len(self.hidden),
            minutes=self.minutes,
            lacking=lacking,
        )

    @property
    def minutes(self) -> float:
        """Duration of all, set up once."""
        return self.plan.minutes + (self.plan.minutes - self.set_up if self.twice else 0.0)

    def lines(self) -> list[str]:
        """Return the text lines: how well each written value is shown, and by which minute."""
        lines = [
            "",
            *self._contact_words(),
            Message(
                "{minutes:.0f} minutes in all{twice}. What each minute shows, set-up included:",
                minutes=self.minutes,
                twice=self._twice_words(),
            ),
        ]
        lines += [
            Message("  by minute {minute:.0f}: {names}", minute=minute, names=", ".join(names))
            for minute, names in self.steps
        ]
        lines += [
            Message("  not at this duration: {name} ({u:.2f}, needed {needed:.2f})", name=name, u=u, needed=SHOWN_U)
            for name, u in self.u.items()
            if u > SHOWN_U
        ]
        lines.append(
            Message(
                "shown: absent and reversed are excluded, by one mistake or two. Noise relative to the least distinct of these "
                "mistakes: {values}",
                values=joined(", ", [Message("{name} {u:.2f}", name=name, u=u) for name, u in self.u.items()]),
            )
        )
        if self.hidden:
            cure = Message("plan with other places of the spheres (higher, nearer the rim, two of them), or with a kit")
            lines.append(
                Message(
                    "NOT SHOWN by any reading with this equipment: {names}; {cure}",
                    names=", ".join(self.hidden),
                    cure=cure,
                )
            )
        if self.twice:
            lines.append(
                Message(
                    "MEASURE THIS PLAN TWICE, before and after the values are switched on: {names} cannot be seen against the "
                    "uncertainty of the calibration. Then: twin confirm BEFORE.csv AFTER.csv --written FOLDER",
                    names=listed(list(self.twice)),
                )
            )
            lines.append(
                Message(
                    "measured afterwards only, against the calibration, it shows: {names}",
                    names=listed(list(self.alone)) or Message("nothing"),
                )
            )
        lines += [Message("compared: {text}", text=text) for text in self.others]
        if any(name.startswith("kinematics") for name in (*self.u, *self.hidden)):
            lines.append(Message("note: {notice}", notice=ACTIVE))
        return lines

    def _contact_words(self) -> list[Message]:
        """Return what takes the time of a probe."""
        if not isinstance(self.plan, SequencePlan):
            return []
        contact = self.plan.task.kit.seconds.contact
        return [
            Message(
                "contacts take {minutes:.0f} minutes of each measurement: {poses} poses, {count} a pose, {seconds:g} s each. If your "
                "probing cycle is quicker, state it in a kit (seconds: contact)",
                minutes=len(self.plan.table) * CONTACTS * contact / 60.0,
                poses=len(self.plan.table),
                count=CONTACTS,
                seconds=contact,
            )
        ]

    def _twice_words(self) -> str:
        if not self.twice:
            return ""
        return Message(
            ": set-up {set_up:.0f}, and {each:.0f} before and after",
            set_up=self.set_up,
            each=self.plan.minutes - self.set_up,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object (``schema: twin.plan/1``)."""
        found = {"u": dict(self.u), "not_shown": self.hidden, "twice_for": self.twice, "shown": self.shown}
        found |= {
            "minutes": self.minutes,
            "steps": [{"minute": minute, "shows": list(names)} for minute, names in self.steps],
            "shown_alone": list(self.alone),
            "compared": list(self.others),
        }
        return {**self.plan.to_dict(), "confirmation": found}


@final
@dataclass(frozen=True)
class _Sensitivity:
    """Derivatives of readings by written values, errors of the machine and set-up."""

    calibration: Calibration
    written: Sequence[WrittenValue]
    unknowns: Unknowns

    def important(self, tool_length_mm: float) -> list[int]:
        """Return the indices of the written values that matter at the tool."""
        machine = self.calibration.machine
        zero, q = Calibration.zero(machine), volume(machine, POSES, SEED)
        sides = {f"approach_{name}": np.ones(len(q)) for name in machine.names}
        state = dict(zip(machine.names, q.T, strict=True)) | sides
        by_error = Kinematics(machine, zero, tool_length_mm=tool_length_mm).sensitivities(q).error[:, :3]
        effects = effects_on(by_error, machine, zero, self.written, self.unknowns, None, state)[0]
        return np.flatnonzero(mattering(effects.reshape(len(q), 3, -1) / UM)[1]).tolist() if self.written else []

    def of_kit(self, task: Task, plan: Measurements, instrument: Instrument, *, twice: bool) -> np.ndarray:
        """Return (n, 3, f) derivatives of readings with a kit, as `rows`."""
        machine = self.calibration.machine
        setup = setup_of(as_evaluated(plan, task.kit.known), task.kit.setting, instrument)
        rng, zero = np.random.default_rng(0), Calibration.zero(machine)
        readings, _ = simulate(plan, machine, zero, instrument, rng, setting=task.kit.setting, noise=False)
        return self._rows(readings, plan, instrument, setup, twice=twice)

    def of_probe(self, task: SequenceTask, points: SequencePoints, *, twice: bool) -> np.ndarray:
        """Return (n, 3, f) derivatives of poses of a probe, as `rows`; tip and spheres unknown."""
        table = with_nominal_readings(task.machine, sequence_table(task, points), task.instrument)
        setup = StationsAndTargets.from_table(table, StationInstruments.same(task.instrument, table.station))
        stations, targets = (np.zeros(len(one), dtype=bool) for one in (setup.stations, setup.targets))
        setup = replace(setup, station_known=stations, target_known=targets)
        return self._rows(table, table, task.instrument, setup, twice=twice)

    def _rows(
        self,
        readings: Measurements,
        plan: Measurements,
        instrument: Instrument,
        setup: StationsAndTargets,
        *,
        twice: bool,
    ) -> np.ndarray:
        """Return (n, 3, f) derivatives: factors of written values, errors of the machine, set-up.

        Measured before and after, the errors of the machine cancel, and the noise grows by √3 (`twin.monitoring.confirmation`).
        """
        machine = self.calibration.machine
        network = Network(machine, readings, StationInstruments.same(instrument, readings.station), self.unknowns)
        view = network.view(np.zeros(len(self.unknowns)), setup, np.arange(len(readings)))
        errors = Calibration.zero(machine) if twice else self.calibration
        state = machine_state(plan, machine)
        own, _, _, known = effects_on(view.by_error, machine, errors, self.written, self.unknowns, None, state)
        by_setup = np.zeros((len(plan), 3, len(setup)))
        network.fill_setup_columns(view, setup, by_setup)
        flat = np.concatenate([own, known], axis=1).reshape(len(plan), 3, -1)
        return np.concatenate([flat, by_setup * setup.plausible], axis=2) / np.sqrt(3.0 if twice else 1.0)


@final
class _Hypotheses:
    """The mistakes by which a written value that matters is absent or reversed."""

    def __init__(self, written: Sequence[WrittenValue], important: Sequence[int]) -> None:
        changes = mistakes(list(groups_of(written).values()), len(written))
        self._changes = changes[np.any(changes[:, list(important)] != 0.0, axis=1)]
        self._important = list(important)

    def u(self, rows: np.ndarray) -> np.ndarray:
        """Return (k,) the standard uncertainty of the least distinct mistake of each value that matters, relative to its size."""
        strengths = WeakestMistake(self._changes).strengths(covariance_of(np.eye(rows.shape[2]), rows))
        touched = self._changes[:, self._important] != 0.0
        return np.asarray([strengths[own].min() ** -0.5 for own in touched.T])

    def aim(self, rows: np.ndarray) -> tuple[WeakestMistake, np.ndarray] | None:
        """Return the criterion over the values that some readings show with reserve, and which these are; None without any."""
        seen = self.u(rows) <= SHOWN_U / RESERVE
        # A mistake of a value that is not seen, together with one that is: not seen either.
        strengths = WeakestMistake(self._changes).strengths(covariance_of(np.eye(rows.shape[2]), rows))
        own = strengths >= LAMBDA * RESERVE**2
        return (WeakestMistake(self._changes[own]), seen) if seen.any() else None


def plan_confirmation(  # noqa: PLR0913
    calibration: Calibration,
    written: Sequence[WrittenValue],
    kit: Kit | None = None,
    *,
    probe: bool | None = None,
    spheres_mm: Mapping[str, tuple[float, float, float]] | None = None,
    sizes: InstrumentSizes | None = None,
    minutes: float | None = None,
    seed: int = 0,
    progress: Progress = silent,
) -> ConfirmationPlan:
    """Return the shortest plan that shows every written value that matters: with a probe and spheres, or with a kit.

    Args:
        calibration: the machine's errors without the written values.
        written: what was written.
        kit: instruments as in `plan`, with the speeds and ranges of the axes.
        probe: whether to plan for a touch probe and spheres, or for the kit; None: for the kit that is
            given, else whichever is quicker.
        spheres_mm: spheres on the table by name, in the work frame; None: one near its rim.
        sizes: length of the probe and of the tool at which values matter, sizes of probe and sphere.
        minutes: duration of one measurement; None: the shortest that suffices.

    Raises:
        InputError: nothing that matters was written, or the time budget is too short.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> errors = twin.Calibration.default(machine)
        >>> _, written = twin.written_values(machine, errors, compensated=True)
        >>> found = twin.plan_confirmation(errors, written, probe=True, sizes=twin.InstrumentSizes(120.0))
        >>> found.shown, found.minutes < 40
        (True, True)
    """
    machine = calibration.machine
    model = _Sensitivity(calibration.with_control(None), written, constant_unknowns(machine, machine.names))
    sizes = sizes or InstrumentSizes()
    length = machine.tool_length_mm if sizes.tool_length_mm is None else sizes.tool_length_mm
    important = model.important(length)
    if not important:
        what = "nothing that matters at the tool was written"
        raise InputError(what, expected="tables or kinematics", file=calibration.path)
    names = [written[k].name for k in important]
    planner = _Planner(model, _Hypotheses(written, important), names, minutes, seed, progress)
    found, failed = list[ConfirmationPlan](), list[InputError]()
    with one_blas_thread():
        for places in _places(machine, kit, sizes, spheres_mm) if probe or (probe is None and kit is None) else ():
            try:
                found.append(planner.with_probe(kit, places, sizes))
            except InputError as error:
                failed.append(error)
        if not probe:
            try:
                found.append(planner.with_kit(kit))
            except InputError as error:
                failed.append(error)
    if not found:
        raise failed[0]
    best = min(found, key=lambda one: (len(one.hidden), not one.shown, one.minutes))
    others = tuple(
        Message(
            "{plan}{twice}: {minutes:.0f} minutes in all{hidden}",
            plan=one.plan.brief,
            twice=Message(" twice") if one.twice else "",
            minutes=one.minutes,
            hidden=Message(", does not show {names}", names=listed(list(one.hidden))) if one.hidden else "",
        )
        for one in found
        if one is not best
    )
    return replace(best, others=(*others, *map(str, failed)))


def _places(
    machine: Machine,
    kit: Kit | None,
    sizes: InstrumentSizes,
    spheres_mm: Mapping[str, tuple[float, float, float]] | None,
) -> list[Mapping[str, tuple[float, float, float]]]:
    """Return the places of spheres to plan for: those given, else one sphere near the table's rim, low or high."""
    if spheres_mm is not None or len(machine.linear) != 3 or not machine.rotary:
        return [spheres_mm or {}]
    low = sequence_task(machine, instrument_named("probe"), kit, None, 60.0, sizes).places_mm
    ((name, (x, _, z)),) = low.items()
    if all(machine.axes[i].side == "tool" for i in machine.rotary):
        return [low]
    return [low, {name: (round(-0.7 * x), round(0.7 * x), z + HIGHER_MM)}]


@final
@dataclass(frozen=True)
class _Planner:
    """Search for the shortest plan."""

    model: _Sensitivity
    hypotheses: _Hypotheses
    names: Sequence[str]
    minutes: float | None
    seed: int
    progress: Progress

    def chosen(self, both: Sequence[np.ndarray]) -> tuple[bool, WeakestMistake, np.ndarray, np.ndarray]:
        """Return whether to measure twice, the criterion, which values are seen, and which of them in one measurement.

        Args:
            both: derivatives of all candidate readings, for one measurement and for two.

        Raises:
            InputError: no value is seen.
        """
        once, again = (self.hypotheses.aim(rows) for rows in both)
        none = np.zeros(len(self.names), dtype=bool)
        twice = again is not None and (once is None or int(again[1].sum()) > int(once[1].sum()))
        aim = again if twice else once
        if aim is None:
            what = "no reading with this equipment shows what was written"
            raise InputError(
                what, expected="other equipment, or other places of the spheres", value=", ".join(self.names)
            )
        return twice, *aim, none if once is None else once[1]

    def with_kit(self, kit: Kit | None) -> ConfirmationPlan:
        """Return the shortest plan with a kit."""
        model, machine = self.model, self.model.calibration.machine
        tried = DURATIONS if self.minutes is None else (self.minutes,)
        task = Task.of(machine, kit, tried[-1], model.calibration, self.seed, self.progress)
        every, instrument = candidates(machine, task.kit, task.rng), task.kit.instruments[0]
        both = [model.of_kit(task, every.plan, instrument, twice=twice) for twice in (False, True)]
        twice, aim, seen, once = self.chosen(both)
        rows = both[1] if twice else both[0]
        problem = DesignProblem(instrument, every, np.eye(rows.shape[2]), rows, aim)
        for duration in tried:
            short = replace(task, minutes=duration)
            try:
                filled = fill(short, [problem])
            except InputError:
                if duration == tried[-1]:
                    raise
                continue
            own = [
                model.of_kit(short, filled.route.plan, instrument, twice=again) for again in (False, True)[: 1 + twice]
            ]
            if self.hypotheses.u(own[-1])[seen].max() <= SHOWN_U:
                break
        made = Plan.of(short, CONFIRM, filled)
        set_up = len(made.stations) * short.kit.seconds.station / 60.0
        return self._plan(made, own, filled.route.plan.time_s / 60.0, seen, once, set_up)

    def with_probe(
        self,
        kit: Kit | None,
        spheres_mm: Mapping[str, tuple[float, float, float]] | None,
        sizes: InstrumentSizes,
    ) -> ConfirmationPlan:
        """Return the shortest plan with a touch probe: the fewest poses over a grid of the rotary axes."""
        machine = self.model.calibration.machine
        most = 60.0 if self.minutes is None else self.minutes
        task = sequence_task(machine, instrument_named("probe"), kit, spheres_mm, most, sizes)
        task = replace(task, seed=self.seed)
        reached = reach(task, grid(task))
        points = reached.points
        if len(points) < FEWEST:
            what = f"too few poses are reached with clearance ({', '.join(f'{n}: {v}' for n, v in reached.dropped.items())})"
            raise InputError(
                what, expected="other places of the spheres, or another length of the probe", value=len(points)
            )
        both = [self.model.of_probe(task, points, twice=twice) for twice in (False, True)]
        twice, aim, seen, once = self.chosen(both)
        rows = both[1] if twice else both[0]
        exchange = Exchange(np.eye(rows.shape[2]), rows, np.ones(len(rows)), aim, most=1, among=len(rows))
        first = np.random.default_rng(self.seed).permutation(len(rows))
        for count in range(FEWEST, min(MOST, len(rows)) + 1):
            self.progress("choosing poses", count / MOST)
            picked = exchange.choose(count, first, 2)
            shown = self.hypotheses.u(rows[picked])[seen].max() <= SHOWN_U
            chosen = ordered(task, points.select(picked))
            table = sequence_table(task, chosen)
            minutes = minutes_of(machine, task.kit, table)
            if shown or (self.minutes is not None and minutes + minutes / count > self.minutes):
                break
        if minutes > most:
            what = "the time budget is too short for a measurement"
            raise InputError(what, expected=f"{minutes:.0f} minutes or more", value=most)
        made = SequencePlan(
            replace(
                task, minutes=minutes, places_mm={n: p for n, p in task.places_mm.items() if n in set(chosen.place)}
            ),
            PROBED,
            table,
            reached.dropped,
            expectation(machine, table, task.instrument),
            best=None,
        )
        set_up = len(set(chosen.place)) * SET_UPS["probe"].set_up_s / 60.0
        ends = set_up + np.cumsum(seconds_of(machine, task.kit, table)) / 60.0
        own = [self.model.of_probe(task, chosen, twice=again) for again in (False, True)[: 1 + twice]]
        return self._plan(made, own, ends, seen, once, set_up)

    def _plan(
        self,
        made: Plan | SequencePlan,
        own: Sequence[np.ndarray],
        ends: np.ndarray,
        seen: np.ndarray,
        once: np.ndarray,
        set_up: float,
    ) -> ConfirmationPlan:
        """Return the result of a plan.

        Args:
            made: the plan.
            own: (n, 3, f) derivatives of its readings in order, if it is measured once; and twice, if it is.
            ends: (n,) minutes at which they end.
            seen, once: as from `chosen`.
            set_up: minutes for setting up.
        """
        rows, twice = own[-1], len(own) > 1
        u = self.hypotheses.u(rows)
        names = np.array(self.names, dtype=object)
        steps, known = list[tuple[float, tuple[str, ...]]](), np.zeros(len(names), dtype=bool)
        for count in range(2, len(rows) + 1):
            now = self.hypotheses.u(rows[:count]) <= SHOWN_U
            if np.any(now & ~known):
                steps.append((float(ends[count - 1]), tuple(names[now & ~known])))
            known |= now
        return ConfirmationPlan(
            made,
            dict(zip(names[seen], u[seen].tolist(), strict=True)),
            tuple(names[~seen]),
            tuple(names[seen & ~once]) if twice else (),
            bool(u[seen].max() <= SHOWN_U),
            tuple(steps),
            tuple(names[self.hypotheses.u(own[0]) <= SHOWN_U]),
            set_up=set_up,
        )
