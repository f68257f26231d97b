"""What a plan will tell, before anybody goes to the machine: the uncertainty of every error and of the tool point; what is hidden."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np

from twin._common.json_form import json_form
from twin.display import UNKNOWN, Html, card, chips, note, pairs, readable, table
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.machine.effects import split_name, unit_of
from twin.numerics.observability import Determinability, Observability, observability
from twin.planning.aims import POSES, SEED
from twin.planning.design import covariance_of
from twin.planning.model import Hidden, PlanModel
from twin.uncertainty.at_tool import DEFINITION, ToolUncertainty, UncertaintyMap
from twin.uncertainty.budget import volume


@final
@dataclass(frozen=True)
class Forecast:
    """What readings will tell.

    Attributes:
        model: the unknowns and what is known of them beforehand.
        covariance: (f, f) of the model's coordinates afterwards.
        determined: names of the errors that the readings determine.
        observability: indices O1 to O5 of the machine's unknowns, stations and targets taken out, in plausible units.
        tool_length_mm: of the tool whose point is asked for.
        positions: (n, axes) the volume it is asked for over, mm and degrees.
    """

    model: PlanModel
    covariance: np.ndarray
    determined: tuple[str, ...]
    observability: Observability
    tool_length_mm: float
    positions: np.ndarray

    @property
    def readings(self) -> int:
        """How many numbers are read."""
        return self.model.told.measurements

    @property
    def hidden(self) -> tuple[Hidden, ...]:
        """The errors that the readings do not determine, and why."""
        return self.model.hidden

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
        lines += [f"  {', '.join(found)}" for found in self._by_axis(".2f").values()] or ["  none is determined"]
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
            "not_identifiable": json_form(self.hidden),
        }

    def _by_axis(self, digits: str) -> dict[str, list[str]]:
        """Every error with its standard uncertainty, by the axis it belongs to."""
        found: dict[str, list[str]] = {}
        for name, u in self.errors.items():
            found.setdefault(split_name(name)[2], []).append(f"{name} {u:{digits}} {readable(unit_of(name))}")
        return found

    def _of(self, columns: list[int]) -> np.ndarray:
        rows = self.model.plausible[columns, None] * self.model.free[columns]
        return np.asarray(rows @ self.covariance @ rows.T)


def forecast(model: PlanModel, tool_length_mm: float | None = None) -> Forecast:
    """What readings will tell when they are taken.

    Args:
        model: of the readings.
        tool_length_mm: of the tool whose point is asked for; the machine file's, or 100 mm where it says none.
    """
    gone = {one.name for one in model.hidden}
    determined = tuple(name for name in model.unknowns.entities if name not in gone)
    return Forecast(
        model=model,
        covariance=covariance_of(model.prior, model.rows),
        determined=determined,
        observability=_observability(model.told, {*determined}),
        tool_length_mm=model.tool_length(tool_length_mm),
        positions=volume(model.machine, POSES, SEED),
    )


def _observability(told: Determinability, names: Collection[str]) -> Observability:
    """Of the machine's own unknowns that are determined, in plausible units, everything else projected out."""
    mine = np.array([one.name.split(" ")[0] in names for one in told.unknowns])
    if not mine.any():
        return observability(np.zeros(1), told.measurements)
    covariance = told.spectrum.covariance(null_space=False) / np.outer(told.spectrum.scale, told.spectrum.scale)
    values = np.linalg.eigvalsh(covariance[np.ix_(mine, mine)])
    # What the datum fixes has no variance and is no unknown.
    return observability(1.0 / np.sqrt(values[values > 1e-14 * values[-1]]), told.measurements)
