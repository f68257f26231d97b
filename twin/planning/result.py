"""A plan as it is shown: what to do, how long it takes, what it will tell."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, final

from twin._common.json_form import json_form
from twin._common.provenance import SourceWarning, texts
from twin.display import bar, card, note, pairs, several, table
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument
from twin.measurement.table import Measurements
from twin.planning.clearance import Clearance
from twin.planning.fill import Filled
from twin.planning.forecast import Forecast
from twin.planning.kit import Kit
from twin.planning.route import Route
from twin.planning.task import Task
from twin.uncertainty.at_tool import DEFINITION

SCHEMA: Final = "twin.plan/1"
ODDS: Final = 100
"""As `twin diagnose` counts: below them two causes are equivalent."""
SPENT: Final = MappingProxyType(
    {
        "station": "setting up",
        "target": "changing targets",
        "aim": "turning reflectors",
        "travel": "travel",
        "point": "readings",
    }
)
"""What time goes into (`Route.spent`), in words."""
SHOWN: Final = 5
"""Alternatives that are printed."""


@final
@dataclass(frozen=True)
class Alternative:
    """A way to stand with one instrument, and what a first choice of readings from there gives.

    Attributes:
        instrument: its name.
        stations: where it stands.
        points: readings there is time for.
        value: what was to become small.
        unit: of ``value``.
    """

    instrument: str
    stations: tuple[str, ...]
    points: int
    value: float
    unit: str


@final
@dataclass(frozen=True)
class Separation:
    """How well two causes are told apart.

    Attributes:
        names: of the two.
        sizes: (value, unit) at which each, with the other one free to stand in for it, is told from it with odds of `ODDS`:1.
        meant: what each was said to be, in the same unit; NaN where nothing was said.
    """

    names: tuple[str, str]
    sizes: tuple[tuple[float, str], tuple[float, str]]
    meant: tuple[float, float]

    def lines(self) -> list[str]:
        """For people."""
        found = [
            f"told apart with odds of {ODDS}:1 or better in 19 of 20 measurements, the other one free to stand in for it:"
        ]
        for name, (size, unit), meant in zip(self.names, self.sizes, self.meant, strict=True):
            shown = unit.replace("um", "µm").replace("urad", "µrad")
            text = f"  {name}, if it is {size:.3g} {shown} or more"
            if meant == meant:
                share = abs(meant) / size
                text += f"; {abs(meant):.3g} {shown} are {'enough' if share >= 1.0 else 'NOT ENOUGH'} ({share:.2g} times that)"
            found.append(text)
        return found

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "odds": ODDS,
            "causes": [
                {"name": name, "least_size": size, "unit": unit, "meant": None if meant != meant else meant}
                for name, (size, unit), meant in zip(self.names, self.sizes, self.meant, strict=True)
            ],
        }


@final
@dataclass(frozen=True)
class Plan:
    """The next measurement.

    Attributes:
        machine, kit: what it is for and made with.
        aim: what it makes small.
        instrument: what reads.
        stations: where it stands, in order.
        route: the readings in order, with times.
        forecast: what they will tell of every error; None where they are only to tell two causes apart.
        alternatives: other ways to stand, the best first; the plan's own among them.
        seed: of the poses tried.
        separation: how well it tells two causes apart, if that is what it is for.
        warnings: of where the calibration that it starts from comes from.
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
        filled: Filled,
        *,
        forecast: Forecast | None = None,
        separation: Separation | None = None,
    ) -> Plan:
        """From the ways to stand that were tried and the route from the best of them."""
        best = filled.stands[0]
        alternatives = tuple(
            Alternative(one.readings.instrument.name, one.stations, one.points, one.value, one.readings.aim.unit)
            for one in filled.stands
        )
        return cls(
            task.machine,
            task.kit,
            aim,
            best.readings.instrument,
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
        """The readings in the order they are to be taken: a measurement table without coordinates."""
        return self.route.plan

    @property
    def minutes(self) -> float:
        """How long it takes."""
        return self.route.seconds / 60.0

    @property
    def complete(self) -> bool:
        """Whether every point can be reached from the one before by a straight move."""
        return not self.route.blocked

    @cached_property
    def _clearance(self) -> Clearance:
        return Clearance(self.machine, self.kit)

    def notices(self) -> list[str]:
        """What whoever carries it out must know."""
        found = [
            "approach_… is the side each axis comes from: run over by more than any reversal and come back",
            "planned_… say about where things go, and no evaluation takes that for known; place_… and station_… count as exactly known",
        ]
        if self._clearance.known:
            found.append(
                "poses and straight moves keep what the URDF draws of the tool side, reflectors included, clear of the work side; it "
                "knows no holders, clamps or workpiece: dry-run it"
            )
        else:
            found.append(
                "THE URDF DRAWS NO SHAPES: only the reflectors are kept clear of each other. Check every pose and every move"
            )
        found += [f"before reading {row + 1}: {words}" for row, words in self.route.sessions]
        if self.route.blocked:
            rows = ", ".join(str(row + 1) for row in self.route.blocked[:20])
            more = f" and {len(self.route.blocked) - 20} more" if len(self.route.blocked) > 20 else ""
            found.append(f"RETRACT before readings {rows}{more}: the straight move there comes too near to something")
        return found

    def save(self, path: str | Path) -> None:
        """Write the plan as a table without coordinates, whole or not at all."""
        meant = {*self.kit.stations, *self.kit.targets} - self.kit.known
        self.table.save(path, self.machine, comment=self.comment(), planned=meant)

    def comment(self) -> str:
        """The lines the file carries."""
        lines = [
            f"plan by twin: {self.machine.name}, {len(self.table)} readings with {self.instrument.name}, {self.minutes:.0f} minutes, "
            f"aim: {self.aim}, seed {self.seed}",
            f"kit: {self.kit.source}",
            ", ".join(f"{words} {self.route.spent[key] / 60:.0f} min" for key, words in SPENT.items()),
            *self.notices(),
        ]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        parts = ((words, self.route.spent[key]) for key, words in SPENT.items())
        whole = max(self.route.seconds, 1.0)
        rows = [(words, f"{seconds / 60:.0f}", bar(seconds / whole)) for words, seconds in parts]
        told = [("aim", self.aim), ("instrument", self.instrument.name), ("stations", ", ".join(self.stations))]
        told.append(("kit", self.kit.source))
        tried = [
            (one.instrument, ", ".join(one.stations), f"{one.points:,}", f"{one.value:.3g} {one.unit}")
            for one in self.alternatives[:SHOWN]
        ]
        separation = [] if self.separation is None else [note(line) for line in self.separation.lines()]
        forecast = [] if self.forecast is None else self.forecast.shown()
        headers = ("from where", "stations", "readings", "what is to become small")
        return card(
            f"Plan for {self.machine.name}",
            pairs(told),
            table(("time for", "minutes", ""), rows, right=(1,)),
            *separation,
            *forecast,
            table(headers, tried, right=(2, 3), title="at a first choice of readings, the best first"),
            *(note(notice, loud=notice.startswith(("RETRACT", "THE URDF"))) for notice in self.notices()),
            small=f"{several(len(self.table), 'reading')}, {self.minutes:.0f} minutes",
            wrong=not self.complete,
        ).text

    def to_text(self) -> str:
        """The account for people."""
        lines = [
            f"{self.machine.name}: {len(self.table)} readings with {self.instrument.name} from {', '.join(self.stations)}, "
            f"{self.minutes:.0f} minutes",
            *self.comment().splitlines()[1:3],
            *(f"expected errors: {text}" for text in texts(self.warnings)),
            "",
            *([] if self.separation is None else [*self.separation.lines(), ""]),
            *([] if self.forecast is None else [*self.forecast.to_text().splitlines(), ""]),
            "from where (at a first choice of readings):",
        ]
        for one in self.alternatives[:SHOWN]:
            chosen = "  <- taken" if (one.instrument, one.stations) == (self.instrument.name, self.stations) else ""
            lines.append(
                f"  {one.instrument} at {', '.join(one.stations)}: {one.points} readings, {one.value:.3g} {one.unit}{chosen}"
            )
        lines += ["", *(f"note: {notice}" for notice in self.notices())]
        return "\n".join(lines) + "\n"

    def to_dict(self) -> dict[str, Any]:
        """For JSON (``schema: twin.plan/1``)."""
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
