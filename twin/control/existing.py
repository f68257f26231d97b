"""What tables that are there already say, and how the model differs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, final

import numpy as np

from twin._common.provenance import ILLUSTRATIVE, SourceWarning, texts, to_json
from twin.control.account import unit_shown
from twin.control.remains import Remains, remains
from twin.control.wanted import Wanted, middle_of
from twin.machine.calibration import Calibration
from twin.machine.conditions import Conditions
from twin.machine.control import Content, ControlSection, Correction, TableEntry, TableFormat, format_named
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
        files, kind: what was read.
        contents: every table.
        differences: against the model, along every axis.
        remains: at the tool over the volume; None where the model's errors are those left under tables.
        at: where the other axes stand.
        tool_length_mm: taken.
        source: the calibration's file.
        remaining: whether the model's errors were measured with tables on.
        warnings: of where the model's numbers come from.
    """

    files: tuple[Path, ...]
    kind: str
    contents: tuple[Content, ...]
    differences: tuple[Difference, ...]
    remains: Remains | None
    at: Mapping[str, float]
    tool_length_mm: float
    source: str
    remaining: bool
    warnings: tuple[SourceWarning, ...]

    def to_text(self) -> str:
        """As it is printed."""
        where = ", ".join(f"{name} {value:g}" for name, value in self.at.items())
        width = max([len(one.name) for one in self.contents] + [5])
        lines = [f"{self.kind}: {', '.join(file.name for file in self.files)}"]
        lines += [
            f"  {one.name:<{width}}  {one.low:g} … {one.high:g}, {one.nodes} nodes, step {one.step:g}, largest {one.largest:.3f} "
            f"{unit_shown(one.unit)}"
            for one in self.contents
        ]
        lines += ["", f"Against {self.source}, tool length {self.tool_length_mm:g} mm, the other axes at {where}"]
        lines += [f"  {text}" for text in texts(self.warnings)]
        if self.remaining:
            lines.append(
                "  The errors of this calibration were measured with tables on: what it wants is what is still to be added, and no "
                "difference tells "
                "whether these tables are right."
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
            "schema": "twin.machine.control-read/1",
            "format": self.kind,
            "files": [str(file) for file in self.files],
            "tables": [asdict(one) for one in self.contents],
            "calibration": self.source,
            "calibration_errors_are_remaining": self.remaining,
            "illustrative": ILLUSTRATIVE in self.warnings,
            "warnings": to_json(self.warnings),
            "tool_length_mm": self.tool_length_mm,
            "at": dict(self.at),
            "differences": [asdict(one) for one in self.differences],
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
    length = machine.tool_length_mm if tool_length_mm is None else tool_length_mm
    remaining = calibration.control is not None and calibration.control.errors_are == "remaining"
    wanted = Wanted(
        machine, calibration.with_control(None), middle_of(machine, at), length, frozenset(BASIC), conditions
    )
    section = ControlSection("uncorrected", tuple(TableEntry.of(file, kind, ()) for file in files))
    left = None if remaining else remains(wanted, calibration.with_control(section))
    return Existing(
        tuple(files),
        kind,
        correction.contents(),
        _differences(correction, wanted, form),
        left,
        wanted.at,
        length,
        str(calibration.path or "the machine as drawn"),
        remaining,
        calibration.warnings,
    )


def _differences(correction: Correction, wanted: Wanted, form: TableFormat[Any]) -> tuple[Difference, ...]:
    machine = wanted.machine
    linear = [machine.axes[i].name for i in machine.linear]
    # Tables of single axes are about linear axes' own errors; a control that knows the machine moves them for the rotary ones' too.
    about = tuple(machine.names) if form.knows_machine else tuple(linear)
    found = []
    for axis in machine.axes:
        low, high = wanted.range_of(axis)
        q = np.linspace(low, high, PLACES)
        line = wanted.line(axis, q)
        for moved in correction.axes:
            own = machine.by_name[moved]
            if not own.linear and moved != axis.name:
                continue
            said, off = [], []
            for side in (1, -1):
                state: dict[str, Any] = {name: line[:, i] for i, name in enumerate(machine.names)}
                state |= {f"approach_{name}": np.full(PLACES, float(side)) for name in machine.names}
                shift = np.broadcast_to(correction.shift(moved, state), PLACES)
                wants = (
                    wanted.point(about, line, side)[:, linear.index(moved)] if own.linear else wanted.turn(own, q, side)
                )
                said.append(shift)
                off.append(shift - wants)
            constant = float(np.mean(off))
            if axis.linear or not own.linear or form.knows_machine:
                found.append(
                    Difference(
                        moved,
                        axis.name,
                        "um" if own.linear else "urad",
                        float(np.abs(said).max()),
                        float(np.abs(off).max()),
                        constant,
                    )
                )
    return tuple(found)
