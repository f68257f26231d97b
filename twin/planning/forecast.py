"""What a plan will tell, before anybody goes to the machine: the uncertainty of every error and of the tool point; what is hidden."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, final

import numpy as np

from twin.display import UNKNOWN, Html, card, chips, note, pairs, readable, table
from twin.identification.solve import named
from twin.identification.unknowns import offset_unseen
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.machine.effects import split_name, unit_of
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument
from twin.measurement.simulate import Setting
from twin.measurement.table import Measurements
from twin.numerics.observability import UNSEEN, Determinability, Observability, determinability, observability
from twin.planning.design import covariance_of
from twin.planning.information import Model
from twin.uncertainty.at_tool import DEFINITION, ToolUncertainty, UncertaintyMap
from twin.uncertainty.budget import volume

NAMED: Final = 5
"""Unknowns that a reason names."""
VAGUE: Final = "the readings say less of it than is plausible anyway"
POSES: Final = 300
SEED: Final = 10


@final
@dataclass(frozen=True)
class Hidden:
    """An error a plan cannot show.

    Attributes:
        name: ISO 230-1 name.
        reason: what moves with it and leaves every reading as it is.
    """

    name: str
    reason: str


@final
@dataclass(frozen=True)
class Forecast:
    """What readings will tell.

    Attributes:
        model: the unknowns and what is known of them beforehand.
        covariance: (f, f) of the model's coordinates afterwards.
        readings: how many numbers are read.
        determined: names of the errors that the readings determine.
        hidden: those they do not, and why.
        observability: indices O1 to O5 of the machine's unknowns, stations and targets taken out, in plausible units.
        tool_length_mm: of the tool whose point is asked for.
        positions: (n, axes) the volume it is asked for over, mm and degrees.
    """

    model: Model
    covariance: np.ndarray
    readings: int
    determined: tuple[str, ...]
    hidden: tuple[Hidden, ...]
    observability: Observability
    tool_length_mm: float
    positions: np.ndarray

    @cached_property
    def calibration(self) -> Calibration:
        """Zero everywhere, with the covariance that an estimate will have: for whatever takes a calibration."""
        model = self.model
        half = model.to_parameters(self.covariance)
        covariance = model.to_parameters(half.T)
        kept = [i for i, column in enumerate(model.unknowns.columns) if column.entity in self.determined]
        found, _ = model.unknowns.calibration(
            np.zeros(len(model.unknowns)),
            kept,
            "foretold by twin plan: no values, only how well they will be known",
            covariance,
        )
        return found

    @cached_property
    def at_tool(self) -> UncertaintyMap:
        """U of the tool point over the volume."""
        kinematics = Kinematics(self.model.machine, self.calibration, tool_length_mm=self.tool_length_mm)
        return UncertaintyMap(self.model.machine.names, self.positions, ToolUncertainty(kinematics).at(self.positions))

    @property
    def tool_um(self) -> float:
        """RMS over the volume of the standard uncertainty of the tool point (root of the sum of squares of x, y, z), µm."""
        return float(np.sqrt(np.mean(np.sum(self.at_tool.uncertainty.standard_um**2, axis=1))))

    @cached_property
    def errors(self) -> Mapping[str, float]:
        """Standard uncertainty by name, µm or µrad: of a curve the largest over its range; of what is hidden none."""
        found: dict[str, float] = {}
        for name, space in self.model.curves.items():
            if name in self.determined:
                q = np.linspace(*space.domain, 201)
                columns = self.model.unknowns.of(name)
                shape = space.functions(q)[:, space.first : space.count]
                own = self._of(columns)
                found[name] = float(np.sqrt(np.einsum("ni,ij,nj->n", shape, own, shape).max()))
        for name in self.model.unknowns.constants:
            if name in self.determined:
                found[name] = float(np.sqrt(self._of(self.model.unknowns.of(name))[0, 0]))
        return found

    def _repr_html_(self) -> str:
        return card(
            "What the readings will tell", *self.shown(), small=f"{self.readings:,} numbers read, none of them yet"
        ).text

    def shown(self) -> list[Html]:
        """What a display says of it."""
        over, o = self.at_tool, self.observability
        place = ", ".join(f"{name} {value:.0f}" for name, value in over.where.items()).replace("-", "−")
        by_axis: dict[str, list[str]] = {}
        for name, u in self.errors.items():
            by_axis.setdefault(split_name(name)[2], []).append(f"{name} {u:.2g} {readable(unit_of(name))}")
        rows = [(axis, chips(found)) for axis, found in by_axis.items()]
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
            table(("axis", "standard uncertainty (k = 1), of a curve the largest over its range"), rows),
            table(
                ("hidden: unknown whatever is read", "why"), [(", ".join(names), text) for text, names in why.items()]
            ),
            note(f"O1 {o.o1:.3g}, O2 {o.o2:.3g}, O3 {o.o3:.3g}, O4 {o.o4:.3g}, O5 {o.o5:.3g} (observability)"),
            note(DEFINITION),
        ]

    def to_text(self) -> str:
        """The account for people."""
        o = self.observability
        over = self.at_tool
        where = ", ".join(f"{name} {round(value)}" for name, value in over.where.items())
        lines = [
            f"the tool point, tool length {self.tool_length_mm:g} mm: U {over.rms_um:.2f} µm RMS over the volume, "
            f"{over.max_um:.2f} µm largest (at {where}); {DEFINITION}",
            "",
            f"errors, standard uncertainty (k = 1; of a curve the largest over its range) from {self.readings} numbers read:",
        ]
        by_axis: dict[str, list[str]] = {}
        for name, u in self.errors.items():
            unit = "µm" if unit_of(name) == "um" else "µrad"
            by_axis.setdefault(split_name(name)[2], []).append(f"{name} {u:.2f} {unit}")
        lines += [f"  {', '.join(found)}" for found in by_axis.values()] or ["  none is determined"]
        lines += [
            "",
            "observability of the machine's unknowns, each in its plausible size (Sun and Hollerbach 2008; larger is better):",
            f"  O1 {o.o1:.3g}, O2 {o.o2:.3g}, O3 {o.o3:.3g}, O4 {o.o4:.3g}, O5 {o.o5:.3g}",
        ]
        if self.hidden:
            lines += ["", "not identifiable from these readings, whatever they say:"]
            lines += [f"  {one.name}: {one.reason}" for one in self.hidden]
        return "\n".join(lines) + "\n"

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
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
            "not_identifiable": [{"name": one.name, "reason": one.reason} for one in self.hidden],
        }

    def _of(self, columns: list[int]) -> np.ndarray:
        rows = self.model.plausible[columns, None] * self.model.free[columns]
        return np.asarray(rows @ self.covariance @ rows.T)


def forecast(
    machine: Machine,
    plan: Measurements,
    setting: Setting,
    instrument: Instrument,
    expected: Calibration,
    *,
    known: Collection[str] = (),
    tool_length_mm: float | None = None,
) -> Forecast:
    """What a plan will tell when it is carried out.

    Args:
        machine: the machine.
        plan: what is to be read.
        setting: where stations and targets are.
        instrument: what reads.
        expected: how large the errors are (`Model.of`).
        known: stations and targets that an evaluation is told exactly.
        tool_length_mm: of the tool whose point is asked for; the machine file's, or 100 mm where it says none.
    """
    return of_rows(*informed(machine, plan, setting, instrument, expected, known), tool_length_mm)


def informed(
    machine: Machine,
    plan: Measurements,
    setting: Setting,
    instrument: Instrument,
    expected: Calibration,
    known: Collection[str] = (),
) -> tuple[Model, np.ndarray]:
    """The unknowns of a plan as `identify` has them, and (n, 3, f) the derivatives of its readings.

    A constant that the readings do not show is a station's or a location's: its curve has none.
    """
    model = Model.of(machine, plan, setting, instrument, expected, known)
    rows = model.rows(plan, instrument)
    while model.unknowns.offsets:
        unseen = offset_unseen(model.unknowns, told_by(model, rows).unseen)
        if unseen is None:
            break
        left = [name for name in model.unknowns.offsets if name != unseen]
        model = Model.of(machine, plan, setting, instrument, expected, known, left)
        rows = model.rows(plan, instrument)
    return model, rows


def of_rows(model: Model, rows: np.ndarray, tool_length_mm: float | None = None) -> Forecast:
    """The same from the derivatives (n, 3, f) of a plan's readings."""
    told = told_by(model, rows)
    lost = hidden_by(model, told)
    gone = {one.name for one in lost}
    determined = tuple(name for name in model.unknowns.entities if name not in gone)
    return Forecast(
        model=model,
        covariance=covariance_of(model.prior, rows),
        readings=told.measurements,
        determined=determined,
        hidden=lost,
        observability=_observability(told, {*determined}),
        tool_length_mm=length_of(model.machine, tool_length_mm),
        positions=volume(model.machine, POSES, SEED),
    )


def told_by(model: Model, rows: np.ndarray) -> Determinability:
    """What readings with derivatives (n, 3, f) determine, unknown by unknown, with nothing known beforehand but what is plausible."""
    flat = rows.reshape(-1, rows.shape[-1])
    triangle = np.linalg.qr(flat, mode="r") if len(flat) > flat.shape[1] else flat
    # The coordinates' own derivatives, carried back to the unknowns: outside the datum's directions there is nothing to carry.
    return determinability(
        triangle @ model.free.T / model.plausible,
        named(model.unknowns, model.setup),
        free=model.free,
        measurements=int(np.count_nonzero(np.any(flat != 0.0, axis=1))),
    )


def _observability(told: Determinability, names: Collection[str]) -> Observability:
    """Of the machine's own unknowns that are determined, in plausible units, everything else projected out."""
    mine = np.array([one.name.split(" ")[0] in names for one in told.unknowns])
    if not mine.any():
        return observability(np.zeros(1), told.measurements)
    covariance = told.spectrum.covariance(silent=False) / np.outer(told.spectrum.scale, told.spectrum.scale)
    values = np.linalg.eigvalsh(covariance[np.ix_(mine, mine)])
    # What the datum fixes has no variance and is no unknown.
    return observability(1.0 / np.sqrt(values[values > 1e-14 * values[-1]]), told.measurements)


def hidden_by(model: Model, told: Determinability) -> tuple[Hidden, ...]:
    """The errors of which not even the lowest order is determined, as `identify` would leave them out."""
    unseen = dict(zip(told.names, told.unseen, strict=True))
    names = dict(zip(model.unknowns.columns, (one.name for one in named(model.unknowns, model.setup)), strict=False))
    found = []
    for name in model.unknowns.entities:
        space = model.curves.get(name)
        columns = [column for column in model.unknowns.columns if column.entity == name]
        lowest = [names[column] for column in (columns if space is None else columns[: len(space.groups()[0])])]
        worst = max(lowest, key=lambda one: unseen[one])
        if unseen[worst] > UNSEEN:
            direction = told.moving(worst)
            found.append(Hidden(name, VAGUE if direction is None else str(direction.shortened(NAMED))))
    return tuple(found)


def length_of(machine: Machine, tool_length_mm: float | None) -> float:
    """As given, else the machine file's, else 100 mm: at the nose itself a turn about it would look harmless."""
    return tool_length_mm if tool_length_mm is not None else machine.tool_length_mm or 100.0
