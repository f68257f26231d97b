"""Plan a measurement, or predict the result of an existing plan: the uncertainty of every error and of the tool point."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.messages import Message, joined, say
from twin._common.provenance import SourceWarning, warning_texts
from twin._common.records import json_form
from twin._common.resources import Progress, one_blas_thread, silent
from twin._common.units import count_with_noun
from twin.display import UNKNOWN, Html, bar, chips, expanded, note, pairs, readable, table
from twin.display.results import Display, DisplayedResult, Result
from twin.identification.unidentified import Unidentified
from twin.machine.machine import Machine
from twin.measurement.instruments import INSTRUMENTS, Instrument
from twin.measurement.simulate import Placement
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import split_name, unit_of
from twin.numerics.observability import Determinability, Observability, observability
from twin.planning.clearance import Clearance, candidates
from twin.planning.design import DesignProblem, FilledPlan, Route, covariance_of, fill
from twin.planning.kit import Kit, PlanModel
from twin.planning.task import POSES, SEED, Task, aim_of
from twin.tool.forward import Kinematics
from twin.tool.uncertainty import DEFINITION, ToolUncertainty, UncertaintyMap, volume


@final
@dataclass(frozen=True, repr=False)
class Forecast(Result):
    """Predicted uncertainties of a planned measurement.

    Attributes:
        model: the unknowns and their prior.
        covariance: (f, f) covariance of the model's coordinates after the readings.
        determined: names of the errors that the readings determine.
        observability: indices O1 to O5 of the machine's unknowns, in units of their plausible sizes; set-up unknowns projected out.
        tool_length_mm: tool length for the uncertainty of the tool point.
        positions: (n, axes) poses over the volume for it, mm and degrees.
    """

    model: PlanModel
    covariance: np.ndarray
    determined: tuple[str, ...]
    observability: Observability
    tool_length_mm: float
    positions: np.ndarray

    @property
    def readings(self) -> int:
        """Number of coordinates read."""
        return self.model.determinability.measurements

    @property
    def hidden(self) -> tuple[Unidentified, ...]:
        """Errors that the readings do not determine, with the reason."""
        return self.model.hidden

    @cached_property
    def calibration(self) -> Calibration:
        """Calibration with all errors zero and the predicted covariance, for functions that take a calibration."""
        model = self.model
        half = model.to_parameters(self.covariance)
        covariance = model.to_parameters(half.T)
        kept = [i for i, column in enumerate(model.unknowns.columns) if column.entity in self.determined]
        calibration, _ = model.unknowns.calibration(
            np.zeros(len(model.unknowns)),
            kept,
            "predicted by twin plan: uncertainties only, all values are zero",
            covariance,
        )
        return calibration

    @cached_property
    def at_tool(self) -> UncertaintyMap:
        """Expanded uncertainty U of the tool point over the volume."""
        kinematics = Kinematics(self.model.machine, self.calibration, tool_length_mm=self.tool_length_mm)
        return UncertaintyMap(self.model.machine.names, self.positions, ToolUncertainty(kinematics).at(self.positions))

    @property
    def tool_um(self) -> float:
        """RMS over the volume of the tool point's standard uncertainty in µm (root sum of squares of x, y, z)."""
        return float(np.sqrt(np.mean(np.sum(self.at_tool.uncertainty.standard_um**2, axis=1))))

    @cached_property
    def errors(self) -> Mapping[str, float]:
        """Standard uncertainty by name in µm or µrad, of a curve the largest over its range; without errors not determined."""
        errors: dict[str, float] = {}
        for name, space in self.model.curves.items():
            if name in self.determined:
                q = np.linspace(*space.domain, 201)
                columns = self.model.unknowns.of(name)
                shape = space.functions(q)[:, space.first : space.count]
                own = self._of(columns)
                errors[name] = float(np.sqrt(np.einsum("ni,ij,nj->n", shape, own, shape).max()))
        for name in self.model.unknowns.constants:
            if name in self.determined:
                errors[name] = float(np.sqrt(self._of(self.model.unknowns.of(name))[0, 0]))
        return errors

    @property
    def brief(self) -> str:
        """Predicted U of the tool point."""
        u = f"{expanded(self.at_tool.rms_um)} RMS, {expanded(self.at_tool.max_um)} largest"
        return f"U of the tool point predicted from {self.readings:,} coordinates: {u}; {len(self.hidden)} errors not identifiable"

    def shown(self) -> list[Html]:
        """Return the parts of the HTML display."""
        over, o = self.at_tool, self.observability
        place = ", ".join(f"{name} {value:.0f}" for name, value in over.where.items()).replace("-", "−")
        rows = [(axis, chips(found)) for axis, found in self._by_axis(".2g").items()]
        why: dict[str, list[str]] = {}
        for one in self.hidden:
            why.setdefault(one.reason, []).append(one.name)
        at_tool = f"{over.rms_um:.2g} µm RMS over the volume, {over.max_um:.2g} µm largest at {place}"
        return [
            pairs(
                [
                    ("U of the tool point", at_tool if over.uncertainty.known else UNKNOWN),
                    ("tool", f"{self.tool_length_mm:g} mm long"),
                ]
            ),
            table(("axis", "standard uncertainty (k = 1); for a curve the largest over its range"), rows),
            table(
                ("unknown: not identifiable from these readings", "reason"),
                [(", ".join(names), text) for text, names in why.items()],
            ),
            note(f"O1 {o.o1:.3g}, O2 {o.o2:.3g}, O3 {o.o3:.3g}, O4 {o.o4:.3g}, O5 {o.o5:.3g} (observability)"),
            note(DEFINITION),
        ]

    def to_text(self) -> str:
        """Return the text report."""
        o = self.observability
        over = self.at_tool
        where = ", ".join(f"{name} {round(value)}" for name, value in over.where.items())
        lines = [
            Message(
                "tool point, tool length {length:g} mm: U {rms:.2f} µm RMS over the volume, {largest:.2f} µm largest (at "
                "{where}); {definition}",
                length=self.tool_length_mm,
                rms=over.rms_um,
                largest=over.max_um,
                where=where,
                definition=DEFINITION,
            ),
            "",
            Message(
                "errors, standard uncertainty (k = 1; for a curve the largest over its range) from {count} coordinates "
                "read:",
                count=self.readings,
            ),
        ]
        lines += [f"  {', '.join(found)}" for found in self._by_axis(".2f").values()] or [
            Message("  no error is determined")
        ]
        lines += [
            "",
            Message(
                "observability of the machine's unknowns in units of their plausible sizes (Sun and Hollerbach 2008; "
                "larger is better):"
            ),
            f"  O1 {o.o1:.3g}, O2 {o.o2:.3g}, O3 {o.o3:.3g}, O4 {o.o4:.3g}, O5 {o.o5:.3g}",
        ]
        if self.hidden:
            lines += [
                "",
                Message("not identifiable from these readings:"),
            ]
            lines += [Message("  {name}: {reason}", name=one.name, reason=one.reason) for one in self.hidden]
        return "\n".join(map(say, lines)) + "\n"

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object."""
        o = self.observability
        return {
            "readings": self.readings,
            "errors": [{"name": name, "unit": unit_of(name), "u": u} for name, u in self.errors.items()],
            "tool_point": {
                "tool_length_mm": self.tool_length_mm,
                "u_rms_um": self.tool_um,
                "expanded_rms_um": self.at_tool.rms_um,
                "expanded_max_um": self.at_tool.max_um,
                "where": self.at_tool.where,
            },
            "observability": {"O1": o.o1, "O2": o.o2, "O3": o.o3, "O4": o.o4, "O5": o.o5},
            "not_identifiable": [
                {"name": one.name, "reason": one.reason, "direction": one.direction} for one in self.hidden
            ],
        }

    def _by_axis(self, digits: str) -> dict[str, list[str]]:
        """Return every error with its standard uncertainty as text, grouped by axis."""
        texts: dict[str, list[str]] = {}
        for name, u in self.errors.items():
            texts.setdefault(split_name(name)[2], []).append(f"{name} {u:{digits}} {readable(unit_of(name))}")
        return texts

    def _of(self, columns: list[int]) -> np.ndarray:
        """Return the predicted covariance of some of the machine's unknowns."""
        rows = self.model.plausible[columns, None] * self.model.free[columns]
        return np.asarray(rows @ self.covariance @ rows.T)


def forecast(model: PlanModel, tool_length_mm: float | None = None) -> Forecast:
    """Predict the uncertainties that planned readings will give; tool length: by default that of the machine file, else 100 mm."""
    gone = {one.name for one in model.hidden}
    determined = tuple(name for name in model.unknowns.entities if name not in gone)
    return Forecast(
        model=model,
        covariance=covariance_of(model.prior, model.rows),
        determined=determined,
        observability=_observability(model.determinability, {*determined}),
        tool_length_mm=model.tool_length(tool_length_mm),
        positions=volume(model.machine, POSES, SEED),
    )


def _observability(found: Determinability, names: Collection[str]) -> Observability:
    """Return the observability of the machine's determined unknowns in plausible units, everything else projected out."""
    mine = np.array([unknown.name.split(" ")[0] in names for unknown in found.unknowns])
    if not mine.any():
        return observability(np.zeros(1), found.measurements)
    covariance = found.spectrum.covariance(null_space=False) / np.outer(found.spectrum.scale, found.spectrum.scale)
    values = np.linalg.eigvalsh(covariance[np.ix_(mine, mine)])
    # Directions fixed by the datum have no variance and are not unknown.
    return observability(1.0 / np.sqrt(values[values > 1e-14 * values[-1]]), found.measurements)


# --- The plan -------------------------------------------------------------------------------------

SCHEMA: Final = "twin.plan/1"
ODDS: Final = 100
"""Odds below which `twin diagnose` reports two causes as equivalent."""
SPENT: Final = MappingProxyType(
    {
        "station": Message("set-up"),
        "target": Message("changing targets"),
        "aim": Message("turning reflectors"),
        "travel": Message("travel"),
        "point": Message("readings"),
    }
)
"""Operations that take time (`Route.spent`), as displayed."""
SHOWN: Final = 5
"""Number of alternatives printed."""


@final
@dataclass(frozen=True)
class Alternative:
    """Choice of stations for one instrument, with the criterion after a first choice of readings."""

    instrument: str
    stations: tuple[str, ...]
    points: int  # number of readings the time allows
    value: float  # value of the criterion
    unit: str  # unit of ``value``


@final
@dataclass(frozen=True)
class Separation:
    """Sizes at which a plan distinguishes two causes."""

    names: tuple[str, str]  # names of the two causes
    # (value, unit) smallest size of each that is distinguished from the other with odds of `ODDS`:1
    sizes: tuple[tuple[float, str], tuple[float, str]]
    given_sizes: tuple[float, float]  # size of each as given by the user, in the same unit; NaN if none was given

    def lines(self) -> list[str]:
        """Return the text lines: smallest distinguishable size of each cause, compared with the size given."""
        lines = [
            f"the two causes are distinguished with odds of {ODDS}:1 or better in 19 of 20 measurements, both estimated together:"
        ]
        for name, (size, unit), given in zip(self.names, self.sizes, self.given_sizes, strict=True):
            shown = unit.replace("um", "µm").replace("urad", "µrad")
            text = f"  {name}, if it is {size:.3g} {shown} or more"
            if given == given:
                share = abs(given) / size
                text += f"; {abs(given):.3g} {shown} are {'enough' if share >= 1.0 else 'NOT ENOUGH'} ({share:.2g} times that)"
            lines.append(text)
        return lines

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object."""
        return {
            "odds": ODDS,
            "causes": [
                {"name": name, "least_size": size, "unit": unit, "meant": None if given != given else given}
                for name, (size, unit), given in zip(self.names, self.sizes, self.given_sizes, strict=True)
            ],
        }


@final
@dataclass(frozen=True, repr=False)
class Plan(DisplayedResult):
    """Plan of a measurement.

    Attributes:
        machine, kit: the machine and the equipment.
        aim: the uncertainty that is minimised.
        stations: names of the stations in order.
        route: the readings in order, with times.
        forecast: predicted uncertainty of every error; None for a plan that separates two causes.
        alternatives: station choices compared, best first, the plan's own included.
        seed: random seed.
        separation: how well two causes are distinguished; None for other plans.
        warnings: warnings about the origin of the expected calibration.
    """

    machine: Machine
    kit: Kit
    aim: str
    instrument: Instrument
    stations: tuple[str, ...]
    route: Route
    forecast: Forecast | None
    alternatives: tuple[Alternative, ...]
    seed: int
    separation: Separation | None = None
    warnings: tuple[SourceWarning, ...] = ()

    @classmethod
    def of(
        cls,
        task: Task,
        aim: str,
        filled: FilledPlan,
        *,
        forecast: Forecast | None = None,
        separation: Separation | None = None,
    ) -> Plan:
        """Return the plan for the best of the station choices, with its route."""
        best = filled.station_choices[0]
        alternatives = tuple(
            Alternative(
                station_choice.problem.instrument.name,
                station_choice.stations,
                station_choice.points,
                station_choice.value,
                station_choice.problem.aim.unit,
            )
            for station_choice in filled.station_choices
        )
        return cls(
            task.machine,
            task.kit,
            aim,
            best.problem.instrument,
            best.stations,
            filled.route,
            forecast,
            alternatives,
            task.seed,
            separation,
            task.expected.warnings,
        )

    @property
    def table(self) -> Measurements:
        """Readings in order, as a measurement table without coordinates."""
        return self.route.plan

    @property
    def minutes(self) -> float:
        """Duration in minutes, including set-up."""
        return self.route.seconds / 60.0

    @property
    def complete(self) -> bool:
        """Whether every pose can be reached by a straight move with clearance from the one before."""
        return not self.route.blocked

    def notices(self) -> list[Message]:
        """Return the instructions for carrying out the plan."""
        notices = [
            Message(
                "approach_… is the direction of approach of each axis: overrun the position by more than the reversal "
                "value and return"
            ),
            Message(
                "planned_… are approximate positions, which no evaluation treats as known; place_… and station_… count as "
                "exactly known"
            ),
        ]
        if Clearance(self.machine, self.kit).has_shapes:
            notices.append(
                Message(
                    "poses and straight moves keep the tool side clear of the work side for the shapes in the URDF and the "
                    "reflectors. Holders, clamps and workpiece are not checked: make a dry run first"
                )
            )
        else:
            notices.append(
                Message(
                    "THE URDF HAS NO SHAPES: only the reflectors are kept clear of each other. Check every pose and every move"
                )
            )
        notices += [
            Message("before reading {row}: {words}", row=row + 1, words=words) for row, words in self.route.sessions
        ]
        if self.route.blocked:
            rows = ", ".join(str(row + 1) for row in self.route.blocked[:20])
            more = (
                Message(" and {count} more", count=len(self.route.blocked) - 20) if len(self.route.blocked) > 20 else ""
            )
            notices.append(
                Message(
                    "RETRACT before readings {rows}{more}: the straight move to them has too little clearance",
                    rows=rows,
                    more=more,
                )
            )
        return notices

    def save(self, path: str | Path) -> None:
        """Write the plan atomically as a measurement table without coordinates."""
        planned = {*self.kit.stations, *self.kit.targets} - self.kit.known
        self.table.save(path, self.machine, comment=self.comment(), planned=planned)

    def comment(self) -> str:
        """Return the comment lines of the file."""
        lines = [
            f"plan by twin: {self.machine.name}, {count_with_noun(len(self.table), 'reading')} with {self.instrument.name}, "
            f"{self.minutes:.0f} minutes, aim: {self.aim}, seed {self.seed}",
            *self._costs(),
            *self.notices(),
        ]
        return "\n".join(lines)

    def _costs(self) -> list[Message]:
        """Return the kit, and what takes how long."""
        spent = [
            Message("{words} {minutes:.0f} min", words=words, minutes=self.route.spent[key] / 60)
            for key, words in SPENT.items()
        ]
        return [Message("kit: {source}", source=self.kit.source), joined(", ", spent)]

    @property
    def brief(self) -> str:
        """Number of readings, duration and aim."""
        readings = count_with_noun(len(self.table), "reading")
        return (
            f"{self.machine.name}: {readings} with {self.instrument.name}, {self.minutes:.0f} minutes, aim: {self.aim}"
        )

    def display(self) -> Display:
        """Return durations, predicted uncertainties, alternatives and instructions."""
        parts = ((words, self.route.spent[key]) for key, words in SPENT.items())
        whole = max(self.route.seconds, 1.0)
        rows = [(words, f"{seconds / 60:.0f}", bar(seconds / whole)) for words, seconds in parts]
        facts = [("aim", self.aim), ("instrument", self.instrument.name), ("stations", ", ".join(self.stations))]
        facts.append(("kit", self.kit.source))
        tried = [
            (
                alternative.instrument,
                ", ".join(alternative.stations),
                f"{alternative.points:,}",
                f"{alternative.value:.3g} {alternative.unit}",
            )
            for alternative in self.alternatives[:SHOWN]
        ]
        separation = [] if self.separation is None else [note(line) for line in self.separation.lines()]
        forecast = [] if self.forecast is None else self.forecast.shown()
        headers = ("instrument", "stations", "readings", "uncertainty to minimise")
        title = "stations compared (after a first choice of readings), best first"
        below = (
            table(("time for", "minutes", ""), rows, right=(1,)),
            *separation,
            *forecast,
            table(headers, tried, right=(2, 3), title=title),
            *(note(notice, loud=notice.startswith(("RETRACT", "THE URDF"))) for notice in self.notices()),
        )
        small = f"{count_with_noun(len(self.table), 'reading')}, {self.minutes:.0f} minutes"
        return Display(f"Plan for {self.machine.name}", facts, below=below, small=small, wrong=not self.complete)

    def to_text(self) -> str:
        """Return the text report."""
        lines = [
            Message(
                "{machine}: {count:,} readings with {instrument} from {stations}, {minutes:.0f} minutes",
                machine=self.machine.name,
                count=len(self.table),
                instrument=self.instrument.name,
                stations=", ".join(self.stations),
                minutes=self.minutes,
            ),
            *self._costs(),
            *(Message("expected errors: {text}", text=text) for text in warning_texts(self.warnings)),
            "",
            *([] if self.separation is None else [*self.separation.lines(), ""]),
            *([] if self.forecast is None else [*self.forecast.to_text().splitlines(), ""]),
            Message("stations compared (after a first choice of readings):"),
        ]
        for alternative in self.alternatives[:SHOWN]:
            chosen = (
                Message("  <- chosen")
                if (alternative.instrument, alternative.stations) == (self.instrument.name, self.stations)
                else ""
            )
            lines.append(
                Message(
                    "  {instrument} at {stations}: {count} readings, {value:.3g} {unit}{chosen}",
                    instrument=alternative.instrument,
                    stations=", ".join(alternative.stations),
                    count=alternative.points,
                    value=alternative.value,
                    unit=alternative.unit,
                    chosen=chosen,
                )
            )
        lines += ["", *(Message("note: {notice}", notice=notice) for notice in self.notices())]
        return "\n".join(map(say, lines)) + "\n"

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object (``schema: twin.plan/1``)."""
        return json_form(
            {
                "schema": SCHEMA,
                "machine": self.machine.name,
                "kit": self.kit.source,
                "aim": self.aim,
                "instrument": self.instrument.name,
                "stations": self.stations,
                "points": len(self.table),
                "minutes": self.minutes,
                "seconds": {key if key == "travel" else f"{key}s": self.route.spent[key] for key in SPENT},
                "separation": self.separation,
                "forecast": self.forecast,
                "definition": DEFINITION,
                "alternatives": self.alternatives,
                "retract_before": [row + 1 for row in self.route.blocked],
                "notices": self.notices(),
                "warnings": self.warnings,
                "seed": self.seed,
            }
        )


# --- Plan a measurement, or predict the result of an existing plan --------------------------------


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

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> plan = twin.plan(machine, minutes=30.0, tool_length_mm=120)
        >>> plan.minutes <= 30.0
        True
        >>> plan.save("plan.csv")

    References:
        - V. V. Fedorov: Theory of Optimal Experiments, Academic Press, 1972.
        - A. C. Atkinson, A. N. Donev, R. D. Tobias: Optimum Experimental Designs, with SAS, Oxford University Press, 2007, chapters 10
          to 12.
    """
    with one_blas_thread():
        task = Task.of(machine, kit, minutes, expected, seed, progress, reduce)
        task.progress("drawing candidates", 0.0)
        every = candidates(machine, task.kit, task.rng, task.levels)
        models = [task.model(every.plan, instrument) for instrument in task.kit.instruments]
        aims = [aim_of(model, task.reduce, tool_length_mm) for model in models]
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

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> forecast = twin.judge(twin.thesis_plan.plan(machine), machine, tool_length_mm=120)
        >>> round(forecast.tool_um, 1)
        23.8
        >>> [error.name for error in forecast.hidden][:3]
        ['E_X0B', 'E_Y0B', 'E_Y0C']

    References:
        - Y. Sun, J. M. Hollerbach: Observability index selection for robot calibration, ICRA 2008, 831-836.
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
    sizes = Calibration.given(machine, expected)
    return forecast(PlanModel.of(machine, placed, setting, reader, sizes, known), tool_length_mm)
