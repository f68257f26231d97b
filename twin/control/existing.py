"""What tables that are there already say, and how the model differs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, final

import numpy as np

from twin._common.json_form import json_form
from twin._common.provenance import ILLUSTRATIVE, texts, to_json
from twin.control.account import unit_shown
from twin.control.remains import Remains, remains
from twin.control.wanted import Wanted
from twin.machine.calibration import Calibration
from twin.machine.conditions import APPROACH, Conditions
from twin.machine.control import ControlSection, Correction, TableEntry, TableFormat, format_named
from twin.machine.iso16907 import BASIC
from twin.machine.machine import Machine

PLACES = 1001


@final
@dataclass(frozen=True)
class Difference:
    """What moves one axis along another one's range, the others where they stand, against what the model wants there.

    Attributes:
        moved: the axis that is moved.
        along: the axis that runs.
        unit: ``um`` or ``urad``.
        largest: correction of the tables.
        differs: largest distance from the model's.
        constant: the part of that which is the same everywhere.
    """

    moved: str
    along: str
    unit: str
    largest: float
    differs: float
    constant: float


@final
@dataclass(frozen=True)
class Existing:
    """What was found.

    Attributes:
        kind: name of the format.
        files: what was read.
        correction: what they do.
        calibration: they are compared with.
        wanted: what that wants.
        differences: against the model, along every axis.
        remains: at the tool over the volume; None where the model's errors are those left under tables.
    """

    kind: str
    files: tuple[Path, ...]
    correction: Correction
    calibration: Calibration
    wanted: Wanted
    differences: tuple[Difference, ...]
    remains: Remains | None

    @property
    def source(self) -> str:
        """The calibration's file."""
        return str(self.calibration.path or "the machine as drawn")

    def to_text(self) -> str:
        """As it is printed."""
        where = ", ".join(f"{name} {value:g}" for name, value in self.wanted.at.items())
        contents = self.correction.contents()
        width = max([len(one.name) for one in contents] + [5])
        lines = [f"{self.kind}: {', '.join(file.name for file in self.files)}"]
        lines += [
            f"  {one.name:<{width}}  {one.low:g} … {one.high:g}, {one.nodes} nodes, step {one.step:g}, largest {one.largest:.3f} "
            f"{unit_shown(one.unit)}"
            for one in contents
        ]
        lines += [
            "",
            f"Against {self.source}, tool length {self.wanted.tool_length_mm:g} mm, the other axes at {where}",
        ]
        lines += [f"  {text}" for text in texts(self.calibration.warnings)]
        if self.remains is None:
            lines.append(
                "  The errors of this calibration were measured with tables on: what it wants is what is still to be added, and no "
                "difference tells whether these tables are right."
            )
        lines.append("  moves  along    largest correction    differs by    of that the same everywhere")
        lines += [
            f"  {one.moved:<5}  {one.along:<5}  {one.largest:>12.2f} {unit_shown(one.unit):<6}  {one.differs:>10.2f}  "
            f"{one.constant:>18.2f}"
            for one in self.differences
        ]
        if self.remains is not None:
            found = self.remains
            lines += ["", *found.to_lines()]
            if found.tables.rms_um > found.before.rms_um:
                lines.append(
                    "  By this model the machine is worse with them: wrong sign, other axes, or not this machine's errors."
                )
        return "\n".join(lines) + "\n"

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            "schema": "twin.control-read/1",
            "format": self.kind,
            "files": [str(file) for file in self.files],
            "tables": json_form(self.correction.contents()),
            "calibration": self.source,
            "calibration_errors_are_remaining": self.remains is None,
            "illustrative": ILLUSTRATIVE in self.calibration.warnings,
            "warnings": to_json(self.calibration.warnings),
            "tool_length_mm": self.wanted.tool_length_mm,
            "at": dict(self.wanted.at),
            "differences": json_form(self.differences),
            "error_at_tool": None if self.remains is None else self.remains.to_dict(),
        }


def compared(
    machine: Machine,
    calibration: Calibration,
    kind: str,
    files: Sequence[Path],
    at: Mapping[str, float],
    tool_length_mm: float | None,
    conditions: Conditions,
) -> Existing:
    """Read tables and compare them with a calibration.

    Args:
        machine: the machine.
        calibration: its errors, none whose channel nobody gave.
        kind: one of `twin.machine.control.FORMATS`.
        files: of the control.
        at: where the other axes stand while one moves.
        tool_length_mm: None: the machine file's.
        conditions: temperatures and time.

    Raises:
        InputError: whatever does not fit in a file.
    """
    form = format_named(kind)
    correction = form.read(files, machine)
    remaining = calibration.control is not None and calibration.control.errors_are == "remaining"
    wanted = Wanted(machine, calibration, at, tool_length_mm, frozenset(BASIC), conditions)
    section = ControlSection("uncorrected", tuple(TableEntry.of(file, kind, ()) for file in files))
    left = None if remaining else remains(wanted, calibration.with_control(section))
    return Existing(kind, tuple(files), correction, calibration, wanted, _differences(correction, wanted, form), left)


def _differences(correction: Correction, wanted: Wanted, form: TableFormat[Any]) -> tuple[Difference, ...]:
    machine = wanted.machine
    linear = [machine.axes[i].name for i in machine.linear]
    # Tables of single axes are about linear axes' own errors; a control that knows the machine moves them for the rotary ones' too.
    about = tuple(machine.names) if form.knows_machine else tuple(linear)
    found = []
    for axis, moved in product(machine.axes, (machine.by_name[name] for name in correction.axes)):
        if moved.name != axis.name and not (moved.linear and (axis.linear or form.knows_machine)):
            continue
        q = np.linspace(*wanted.range_of(axis), PLACES)
        line = wanted.line(axis, q)
        said, off = [], []
        for side in (1, -1):
            state: dict[str, Any] = dict(zip(machine.names, line.T, strict=True))
            state |= {f"{APPROACH}{name}": np.full(PLACES, float(side)) for name in machine.names}
            said.append(np.broadcast_to(correction.shift(moved.name, state), PLACES))
            wants = wanted.point(about, line, side)[:, linear.index(moved.name)] if moved.linear else None
            off.append(said[-1] - (wanted.turn(moved, q, side) if wants is None else wants))
        largest, differs = (float(np.abs(one).max()) for one in (said, off))
        unit = "um" if moved.linear else "urad"
        found.append(Difference(moved.name, axis.name, unit, largest, differs, float(np.mean(off))))
    return tuple(found)
