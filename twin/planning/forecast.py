"""Predicted result of a plan: uncertainty of every error and of the tool point, and the errors that are not identifiable."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np

from twin._common.records import json_form
from twin.display import UNKNOWN, Html, chips, expanded, note, pairs, readable, table
from twin.display.results import Result
from twin.model.calibration import Calibration
from twin.model.effects import split_name, unit_of
from twin.numerics.observability import Determinability, Observability, observability
from twin.planning.design import covariance_of
from twin.planning.kit import NotIdentifiable, PlanModel
from twin.planning.task import POSES, SEED
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
    def hidden(self) -> tuple[NotIdentifiable, ...]:
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
            f"tool point, tool length {self.tool_length_mm:g} mm: U {over.rms_um:.2f} µm RMS over the volume, "
            f"{over.max_um:.2f} µm largest (at {where}); {DEFINITION}",
            "",
            f"errors, standard uncertainty (k = 1; for a curve the largest over its range) from {self.readings} coordinates read:",
        ]
        lines += [f"  {', '.join(found)}" for found in self._by_axis(".2f").values()] or ["  no error is determined"]
        lines += [
            "",
            "observability of the machine's unknowns in units of their plausible sizes (Sun and Hollerbach 2008; larger is better):",
            f"  O1 {o.o1:.3g}, O2 {o.o2:.3g}, O3 {o.o3:.3g}, O4 {o.o4:.3g}, O5 {o.o5:.3g}",
        ]
        if self.hidden:
            lines += [
                "",
                "not identifiable from these readings; combinations with other unknowns that leave all readings unchanged:",
            ]
            lines += [f"  {one.name}: {one.reason}" for one in self.hidden]
        return "\n".join(lines) + "\n"

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
            "not_identifiable": json_form(self.hidden),
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
    """Predict the uncertainties that planned readings will give.

    ``tool_length_mm``: tool length; None: that of the machine file, or 100 mm if it has none.
    """
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
