"""Common parts of SINUMERIK tables: programs that write system variables, axes by number, equidistant nodes."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, final

from twin._common.errors import InputError
from twin.machine.control.curve import ControlCurve
from twin.machine.control.lines import TableLine, table_lines
from twin.machine.machine import Axis, Machine

_OTHER: Final = re.compile(r"%.*|N?\d*\s*(M17|M30|M02|M2|RET|CHANDATA\(\d+\))", re.IGNORECASE)
DIGITS: Final = 6


@final
@dataclass
class Entry:
    """One table of a program: its first line, the values of its variables and of its points."""

    line: TableLine
    fields: dict[str, TableLine] = field(default_factory=dict)
    points: dict[int, TableLine] = field(default_factory=dict)


def entries(files: Sequence[Path], pattern: re.Pattern[str], example: str) -> dict[str, Entry]:
    """Return the tables in programs, by the text of their index.

    Args:
        files: the programs.
        pattern: pattern of an assignment; its groups are the ``name`` of a variable, ``table``, ``node`` and ``value``.
        example: example of an assignment, for messages.

    Raises:
        InputError: a line is not an assignment of that pattern, a comment, a program header or end; there is no table; a table is in
            two files, or a value is written twice.
    """
    found: dict[str, Entry] = {}
    for path in files:
        for whole in table_lines(path):
            line = TableLine(path, whole.number, whole.text.partition(";")[0].strip())
            if not line.text or _OTHER.fullmatch(line.text):
                continue
            match = pattern.match(line.text)
            if match is None:
                raise line.error(
                    "not a line of a compensation table", f"{example}… = …, a comment, M17 or M30", line.text
                )
            name, table, node = match["name"], match["table"].upper(), match["node"]
            entry = found.setdefault(table, Entry(line))
            if entry.line.path != path:
                raise line.error(f"table {table} is in two files", "each table in one file", entry.line.path.name)
            if (name is None) != (node is not None):
                raise line.error(
                    "wrong indices", "the index of the point for a value, no such index for other variables", line.text
                )
            if (int(node) in entry.points) if name is None else (name.upper() in entry.fields):
                raise line.error("assigned twice", "one assignment", line.text)
            value = TableLine(path, line.number, match["value"].strip())
            if name is None:
                entry.points[int(node)] = value
            else:
                entry.fields[name.upper()] = value
    if not found:
        raise InputError(
            "no compensation table", expected=f"{example}… = …", file=files[0] if len(files) == 1 else None
        )
    return found


def axis_of(place: TableLine, text: str, machine: Machine) -> Axis:
    """Return the axis of a name: ``AX2`` is the second axis, ``X1`` and ``X`` are X.

    Raises:
        InputError: the machine has no such axis.
    """
    name = text.strip("() ").upper()
    general = re.fullmatch(r"AX(\d{1,9})", name)
    if general is not None and 1 <= int(general[1]) <= len(machine.axes):
        return machine.axes[int(general[1]) - 1]
    return place.axis(name if name in machine.by_name else name.removesuffix("1"), machine)


def axis_numbers(machine: Machine, sign: str) -> str:
    """Return the assignment of numbers to axes as text: ``AX1 is X, AX2 is Y``."""
    return ", ".join(f"AX{i} {sign} {name}" for i, name in enumerate(machine.names, start=1))


def step_of(curve: ControlCurve) -> float | None:
    """Return the distance between the nodes of a curve; None if they are not equidistant, or fewer than two."""
    steps = [b - a for a, b in zip(curve.at, curve.at[1:], strict=False)]
    even = bool(steps) and max(steps) - min(steps) <= 1e-9 * max(abs(q) for q in curve.at)
    return steps[0] if even else None


def table_of(name: str, variable: str, entry: Entry) -> tuple[tuple[float, ...], tuple[float, ...], float | None]:
    """Return nodes, values and period of a table.

    Args:
        name: name of the table, for messages.
        variable: its system variable.
        entry: the table as read.

    Raises:
        InputError: the table is incomplete or inconsistent.
    """
    fields, points = entry.fields, entry.points
    for key in ("STEP", "MIN", "MAX"):
        if key not in fields:
            raise entry.line.error(f"{name} lacks {variable}_{key}", "an assignment to it")
    step, low, high = (fields[key].decimal(f"{variable}_{key}") for key in ("STEP", "MIN", "MAX"))
    steps = (high - low) / step if step > 0.0 else 0.0
    count = round(steps) if math.isfinite(steps) else 0
    if count < 1 or abs(low + count * step - high) > 1e-5 * max(1.0, abs(high), abs(low)):
        raise fields["STEP"].error(f"{name}: STEP does not divide MIN … MAX", "a whole number of steps", f"{step:g}")
    missing = next((n for n in range(count + 1) if n not in points), None)
    if missing is not None or max(points) > count:
        what, value = f"{name} does not have the points given by MIN, MAX and STEP", f"{missing} missing"
        raise entry.line.error(what, f"0 … {count}", max(points) if missing is None else value)
    at = tuple(low + n * (high - low) / count for n in range(count + 1))
    modulo = "IS_MODULO" in fields and fields["IS_MODULO"].decimal(f"{variable}_IS_MODULO") != 0.0
    return at, tuple(points[n].decimal("a value") for n in range(count + 1)), high - low if modulo else None
