"""Read existing tables of a control and compare them with a calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, final

import numpy as np

from twin._common.families import BASIC
from twin._common.provenance import ILLUSTRATIVE, warning_texts, warnings_to_json
from twin._common.records import json_form
from twin.compensation.tables.account import displayed_unit
from twin.compensation.tables.design import RequiredCorrections
from twin.compensation.tables.remains import RemainingErrors, remaining_errors
from twin.controls import ControlSection, Correction, TableEntry, TableFormat, format_named
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.conditions import APPROACH, Conditions

POSITIONS = 1001


@final
@dataclass(frozen=True)
class Difference:
    """Correction of one axis along the range of another, compared with the correction the model requires."""

    moved: str  # the axis that is corrected
    along: str  # the axis that moves; all others stand still
    unit: str  # ``um`` or ``urad``
    largest: float  # largest correction in the tables
    differs: float  # largest difference from the model's correction
    constant: float  # mean of the difference


@final
@dataclass(frozen=True)
class Existing:
    """Existing tables compared with a calibration."""

    kind: str  # name of the format
    files: tuple[Path, ...]  # the files that were read
    correction: Correction  # corrections in the tables
    calibration: Calibration  # the calibration they are compared with
    required: RequiredCorrections  # corrections that the calibration requires
    differences: tuple[Difference, ...]  # differences between the two, along every axis
    # error at the tool over the volume; None if the calibration was measured with tables on
    remains: RemainingErrors | None

    @property
    def source(self) -> str:
        """Path of the calibration, as text."""
        return str(self.calibration.path or "the nominal machine")

    def to_text(self) -> str:
        """Return the text that is printed."""
        where = ", ".join(f"{name} {value:g}" for name, value in self.required.at.items())
        contents = self.correction.contents()
        width = max([len(content.name) for content in contents] + [5])
        lines = [f"{self.kind}: {', '.join(file.name for file in self.files)}"]
        lines += [
            f"  {content.name:<{width}}  {content.low:g} … {content.high:g}, {content.nodes} nodes, step {content.step:g}, "
            f"largest {content.largest:.3f} {displayed_unit(content.unit)}"
            for content in contents
        ]
        lines += [
            "",
            f"Compared with {self.source}; tool length {self.required.tool_length_mm:g} mm, the other axes at {where}",
        ]
        lines += [f"  {text}" for text in warning_texts(self.calibration.warnings)]
        if self.remains is None:
            lines.append(
                "  This calibration was measured with tables switched on: it requires only what is still to be added, so the "
                "differences do not show whether these tables are right."
            )
        lines.append("  moved  along   largest correction  difference   of which constant")
        lines += [
            f"  {difference.moved:<5}  {difference.along:<5}  {difference.largest:>12.2f} {displayed_unit(difference.unit):<6}  "
            f"{difference.differs:>10.2f}  {difference.constant:>18.2f}"
            for difference in self.differences
        ]
        if self.remains is not None:
            found = self.remains
            lines += ["", *found.to_lines()]
            if found.tables.rms_um > found.before.rms_um:
                lines.append(
                    "  According to this calibration the machine is worse with these tables: wrong sign, axes or machine."
                )
        return "\n".join(lines) + "\n"

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as JSON (``schema: twin.compensation.tables-read/1``)."""
        return {
            "schema": "twin.compensation.tables-read/1",
            "format": self.kind,
            "files": [str(file) for file in self.files],
            "tables": json_form(self.correction.contents()),
            "calibration": self.source,
            "calibration_errors_are_remaining": self.remains is None,
            "illustrative": ILLUSTRATIVE in self.calibration.warnings,
            "warnings": warnings_to_json(self.calibration.warnings),
            "tool_length_mm": self.required.tool_length_mm,
            "at": dict(self.required.at),
            "differences": json_form(self.differences),
            "error_at_tool": None if self.remains is None else self.remains.to_dict(),
        }


def compare_tables(
    machine: Machine,
    calibration: Calibration,
    kind: str,
    files: Sequence[Path],
    at: Mapping[str, float],
    tool_length_mm: float | None,
    conditions: Conditions,
) -> Existing:
    """Read tables and compare them with a calibration.

    ``kind``: a format of `twin.controls`; ``at``: positions of the other axes while one moves, mm and degrees; ``tool_length_mm``: tool
    length; None: that of the machine file. Raises `InputError`: a file cannot be read as this format.
    """
    form = format_named(kind)
    correction = form.read(files, machine)
    remaining = calibration.control is not None and calibration.control.errors_are == "remaining"
    required = RequiredCorrections(machine, calibration, at, tool_length_mm, frozenset(BASIC), conditions)
    section = ControlSection("uncorrected", tuple(TableEntry.of(file, kind, ()) for file in files))
    error = None if remaining else remaining_errors(required, calibration.with_control(section))
    return Existing(
        kind, tuple(files), correction, calibration, required, _differences(correction, required, form), error
    )


def _differences(
    correction: Correction, required: RequiredCorrections, form: TableFormat[Any]
) -> tuple[Difference, ...]:
    """Return the differences between tables and model, for every corrected axis along every axis."""
    machine = required.machine
    linear = [machine.axes[i].name for i in machine.linear]
    # Tables of single axes correct errors of the linear axes only; a control with a kinematic model also those of rotary axes.
    about = tuple(machine.names) if form.knows_machine else tuple(linear)
    differences = []
    for axis, moved in product(machine.axes, (machine.by_name[name] for name in correction.axes)):
        if moved.name != axis.name and not (moved.linear and (axis.linear or form.knows_machine)):
            continue
        q = np.linspace(*required.range_of(axis), POSITIONS)
        line = required.positions_along(axis, q)
        said, off = [], []
        for side in (1, -1):
            state: dict[str, Any] = dict(zip(machine.names, line.T, strict=True))
            state |= {f"{APPROACH}{name}": np.full(POSITIONS, float(side)) for name in machine.names}
            said.append(np.broadcast_to(correction.shift(moved.name, state), POSITIONS))
            wants = (
                required.linear_corrections(about, line, side)[:, linear.index(moved.name)] if moved.linear else None
            )
            off.append(said[-1] - (required.rotary_correction(moved, q, side) if wants is None else wants))
        largest, differs = (float(np.abs(one).max()) for one in (said, off))
        unit = "um" if moved.linear else "urad"
        differences.append(Difference(moved.name, axis.name, unit, largest, differs, float(np.mean(off))))
    return tuple(differences)
