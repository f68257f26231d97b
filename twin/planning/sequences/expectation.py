"""The table of a sequence, its duration, and what it determines of the constant errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.json_form import json_form
from twin._common.units import MM
from twin.display import readable
from twin.identification.constant_errors import ConstantErrors, constant_errors
from twin.identification.setup import SetUp
from twin.machine.calibration import Calibration
from twin.machine.effects import unit_of
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument, StationInstruments
from twin.measurement.observation import Observation
from twin.measurement.simulate import Station
from twin.measurement.table import Measurements
from twin.planning.kit import Kit
from twin.planning.sequences.specification import SET_UPS, SequencePoints, SequenceTask

CONTACTS: Final = 5
"""Contacts per sphere: four at the equator and one at the pole."""
CONTACT_S: Final = 6.0
"""Seconds for one contact: approach, touch and retraction."""
POINT_S: Final = 3.0
"""Seconds for a reading of an R-test at rest."""
RETRACT_MM: Final = 100.0
"""Length of the retraction before rotary axes turn and of the approach after it, assumed for the duration of probing."""


def sequence_table(task: SequenceTask, points: SequencePoints) -> Measurements:
    """Return the measurement table of points whose linear positions are known, with the readings of the nominal machine."""
    n, words = len(points), task.words
    on_tool = probing = task.instrument.specification.reads == "null"
    place = np.array([task.places_mm[str(name)] for name in points.place]).reshape(n, 3)
    tip = np.tile(np.array(task.tip_mm), (n, 1))
    reader, target = (tip, place) if on_tool else (place, tip)
    tip_name = words.station if on_tool else words.target
    names = np.full(n, tip_name, dtype=object)
    table = Measurements(
        source=f"plan {task.instrument.name}",
        lines=read_only(np.arange(1, n + 1)),
        positions=read_only(points.positions.copy()),
        target=read_only(points.place if on_tool else names),
        carrier=read_only(np.full(n, "work" if on_tool else "tool", dtype=object)),
        station=read_only(names if on_tool else points.place),
        station_carrier=read_only(np.full(n, "tool" if on_tool else "work", dtype=object)),
        instrument=read_only(np.full(n, task.instrument.name, dtype=object)),
        round=read_only(points.run.astype(str).astype(object)),
        approach=read_only(approach_of(task.machine, points.positions, linear=not probing)),
        place_mm=read_only(target),
        station_pose=read_only(np.concatenate([reader, np.zeros((n, 3))], axis=1)),
        feed_mm_min=read_only(np.full(n, task.sizes.feed_mm_min if _along_path(task.instrument) else np.nan)),
        bar_mm=read_only(np.full(n, task.sizes.bar_mm if task.instrument.specification.nominal_length else np.nan)),
    )
    return replace(table, time_s=read_only(np.round(np.cumsum(seconds_of(task.machine, task.kit, table)), 1)))


def approach_of(machine: Machine, positions: np.ndarray, *, linear: bool) -> np.ndarray:
    """Return the direction of approach (n, axes) of positions in their order: +1, −1, or 0 for an axis that never moves.

    Args:
        machine: the machine.
        positions: (n, axes) mm and degrees; the first is approached in the direction in which each axis continues.
        linear: whether the linear axes have one; a probe touches the sphere from both sides.
    """
    sign = np.sign(np.diff(positions, axis=0, prepend=positions[:1]))
    found = np.zeros(positions.shape)
    for i, axis in enumerate(machine.axes):
        moving = np.flatnonzero(sign[:, i])
        if len(moving) and (linear or not axis.linear):
            last = np.maximum.accumulate(np.where(sign[:, i] != 0.0, np.arange(len(sign)), moving[0]))
            last[: moving[0]] = moving[0]
            found[:, i] = sign[last, i]
    return found


def seconds_of(machine: Machine, kit: Kit, table: Measurements) -> np.ndarray:
    """Return the seconds (n,) from each reading of a plan to the next, in its order, without setting up."""
    instrument = str(table.instrument[0])
    away = np.abs(np.diff(table.positions, axis=0, prepend=table.positions[:1]))
    if instrument == "ball-bar":
        linear = list(machine.linear)
        path = np.linalg.norm(away[:, linear], axis=1)
        feed = np.where(np.isfinite(table.feed_mm_min), table.feed_mm_min, 1000.0) / 60.0
        return np.asarray(path / feed)
    travel = (away / kit.speeds).max(axis=1)
    if instrument != "probe":
        return np.asarray(travel + POINT_S)
    linear_speed = float(kit.speeds[list(machine.linear)].min())
    return np.asarray(travel + 2.0 * RETRACT_MM / linear_speed + CONTACTS * CONTACT_S)


def minutes_of(machine: Machine, kit: Kit, table: Measurements) -> float:
    """Return the minutes that a plan takes, set-up of each part on the table included."""
    parts = len({*table.target, *table.station}) - 1
    return (float(seconds_of(machine, kit, table).sum()) + parts * SET_UPS[str(table.instrument[0])].set_up_s) / 60.0


def _along_path(instrument: Instrument) -> bool:
    return instrument.specification.reads == "length"


@final
@dataclass(frozen=True)
class Expectation:
    """The constant errors that a sequence determines, for several states of knowledge of the set-up.

    Attributes:
        by_knowledge: the constant errors by the known parts, in words; nothing known first.
    """

    by_knowledge: Mapping[str, ConstantErrors]

    @property
    def unknown(self) -> ConstantErrors:
        """The constant errors if nothing of the set-up is known."""
        return next(iter(self.by_knowledge.values()))

    def lines(self, others: Mapping[str, Mapping[str, float]] | None = None) -> list[str]:
        """Return the text: one line per constant error, then the errors that are not determined.

        Args:
            others: further columns by title, u by name.
        """
        headers, rows = self.rows(others)
        width = max(len(title) for title in headers[1:]) + 2
        found = [
            "constant errors, predicted standard uncertainty (k = 1); - where this sequence cannot determine it:",
            " " * 16 + "".join(f"{title:>{width}}" for title in headers[1:]),
            *(f"  {name:<14}" + "".join(f"{cell:>{width}}" for cell in cells) for name, *cells in rows),
        ]
        found.append("what this sequence cannot tell:")
        for title, constants in self.by_knowledge.items():
            lost = "; ".join(constants.lost) or "nothing among the errors of the axes that it moves"
            found.append(f"  {title}: {lost} ({constants.determined} of {len(constants.u)} determined)")
        return found

    def rows(
        self, others: Mapping[str, Mapping[str, float]] | None = None
    ) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Return headers and rows of the table of uncertainties, one row per constant error; arguments as of `lines`."""
        columns = {name: found.u for name, found in self.by_knowledge.items()} | dict(others or {})
        rows = []
        for name in dict.fromkeys(name for found in columns.values() for name in found):
            unit = readable(unit_of(name)) if "0" in name else "µm/m"
            rows.append((f"{name:<6} {unit}", *(_short(own.get(name, np.nan)) for own in columns.values())))
        return ("error", *columns), rows

    def to_dict(self) -> list[dict[str, Any]]:
        """Return the JSON list, one entry for each state of knowledge."""
        return [
            {
                "known": title,
                "determined": constants.determined,
                "errors": json_form(
                    [
                        {
                            "name": name,
                            "unit": unit_of(name) if "0" in name else "um_per_m",
                            "u": None if value != value else value,
                        }
                        for name, value in constants.u.items()
                    ]
                ),
                "cannot_tell": list(constants.lost),
            }
            for title, constants in self.by_knowledge.items()
        ]


def _short(value: float) -> str:
    """Return an uncertainty with two digits, or a dash."""
    return "-" if value != value else f"{value:.0f}" if value >= 100.0 else f"{value:.2g}"


def expectation(machine: Machine, table: Measurements, instrument: Instrument) -> Expectation:
    """Return what a plan determines of the constant errors: with nothing of the set-up known, with its parts known.

    Args:
        machine: the machine.
        table: the plan, with planned places of stations and targets.
        instrument: its instrument.
    """
    read = with_nominal_readings(machine, table, instrument)
    instruments = StationInstruments.same(instrument, read.station)
    setup = SetUp.from_table(read, instruments)
    words, probing = SET_UPS[instrument.name], instrument.specification.reads == "null"
    stations, targets = np.zeros(len(setup.stations), dtype=bool), np.zeros(len(setup.targets), dtype=bool)
    places = f"{words.places} known"
    states = {
        "nothing known": (stations, targets),
        places: (stations, ~targets) if probing else (~stations, targets),
        f"{words.places} and {words.tip} known": (~stations, ~targets),
    }
    found = {}
    for name, (station_known, target_known) in states.items():
        of = replace(setup, station_known=station_known, target_known=target_known)
        constants = constant_errors(machine, read, instruments, of)
        if constants is not None:
            found[name] = constants
    return Expectation(MappingProxyType(found))


def with_nominal_readings(machine: Machine, table: Measurements, instrument: Instrument) -> Measurements:
    """Return a plan with the readings of the nominal machine: they show which coordinates are read, and how well."""
    if instrument.specification.reads == "null":
        return replace(table, point_mm=read_only(np.zeros((len(table), 3))))
    points = Observation(machine).points_mm(Calibration.zero(machine), table, table.place_mm)
    seen = np.empty((len(table), 3))
    for name in dict.fromkeys(table.station):
        rows = table.station == name
        seen[rows] = Station.at(table.station_pose[rows][0]).to_station_mm(points[rows])
    return replace(table, point_mm=read_only(instrument.read(seen * MM) / MM))
