"""SINUMERIK 840D sl: sag and angularity compensation (CEC, "cross error compensation"), as a program that writes system variables.

Checked against public descriptions: SINUMERIK Function Manual, Extended Functions, 03/2013, 6FC5397-1BP40-3BA1, chapter K3
(www.easymanua.ls/siemens/sinumerik-series/manual/275710):

- p. 245, 248, 249, 250: ``$AN_CEC[t,N]`` at ``$AN_CEC_MIN[t] + N·$AN_CEC_STEP[t]``; the setpoint of ``$AN_CEC_INPUT_AXIS[t]`` is
  the argument, ``$AN_CEC_OUTPUT_AXIS[t]`` the axis moved; below MIN the first value, above MAX the last; ``$AN_CEC_DIRECTION[t]``
  0 both, 1 and −1 one direction of the base axis; ``$AN_CEC_IS_MODULO[t] = 1`` repeats from MIN to MAX. The sum of all tables of
  an axis is output "as an additional setpoint": values have the sign of the correction. Linear interpolation between the points:
  p. 237. The machine data to set: MD32710, MD32720, MD18342, SD41300.
- p. 252: ``$AN_CEC_MULT_BY_TABLE[0] = 2`` multiplies table 1 (index 0) by table 2 (index 1): ΔX1 = Z1·β(X1), with Z1 → X1 a
  straight line.
- p. 264: the 828D has 8 tables of 200 points.
- "AX1" … are the machine axes by their order, independent of their names (p. 248).

**Not checked**: `unchecked`; the example of p. 252 requires that its second table alone does not move X1 by Z1.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, final

from twin._common.errors import InputError
from twin.controls.correction import BOTH, DOWN, UP, ControlCurve, ControlTerm, TableSum
from twin.controls.format import URAD_IN_DEG, TableFormat, TableLine, fixed_decimals, table_lines, unit_of
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

    ``pattern``: of an assignment, with groups ``name`` of a variable, ``table``, ``node`` and ``value``; ``example``: for messages. It
    raises `InputError` for a line that is no assignment, comment, program header or end, a table in two files, a value written twice.
    """
    entries: dict[str, Entry] = {}
    for path in files:
        for whole in table_lines(path):
            line = TableLine(path, whole.number, whole.text.partition(";")[0].strip())
            if not line.text or _OTHER.fullmatch(line.text):
                continue
            match = pattern.match(line.text)
            if match is None:
                what = "not a line of a compensation table"
                raise line.error(what, f"{example}… = …, a comment, M17 or M30", line.text)
            name, table, node = match["name"], match["table"].upper(), match["node"]
            entry = entries.setdefault(table, Entry(line))
            if entry.line.path != path:
                raise line.error(f"table {table} is in two files", "each table in one file", entry.line.path.name)
            if (name is None) != (node is not None):
                expected = "the index of the point for a value, no such index for other variables"
                raise line.error("wrong indices", expected, line.text)
            if (int(node) in entry.points) if name is None else (name.upper() in entry.fields):
                raise line.error("assigned twice", "one assignment", line.text)
            value = TableLine(path, line.number, match["value"].strip())
            if name is None:
                entry.points[int(node)] = value
            else:
                entry.fields[name.upper()] = value
    if not entries:
        what = "no compensation table"
        raise InputError(what, expected=f"{example}… = …", file=files[0] if len(files) == 1 else None)
    return entries


def axis_of(place: TableLine, text: str, machine: Machine) -> Axis:
    """Return the axis of a name: ``AX2`` is the second axis, ``X1`` and ``X`` are X; raise `InputError` if there is none."""
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
    """Return nodes, values and period of a table; raise `InputError`, with its names, if it is incomplete or inconsistent."""
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


FILE: Final = "cec.mpf"
_FACTOR_DIGITS: Final = 9
_LIMIT_FACTOR: Final = 1.2
"""Recommended limit in the control as a multiple of the largest correction, to stop a table that is interpreted differently."""
_FIELD: Final = re.compile(
    r"^\$AN_CEC(?:_(?P<name>STEP|MIN|MAX|INPUT_AXIS|OUTPUT_AXIS|DIRECTION|MULT_BY_TABLE|IS_MODULO))?\s*"
    r"\[\s*(?P<table>\d{1,9})\s*(?:,\s*(?P<node>\d{1,9})\s*)?\]\s*=\s*(?P<value>.+)$",
    re.IGNORECASE,
)


@final
class Siemens(TableFormat[TableSum]):
    """SINUMERIK 840D sl: cross error compensation (CEC)."""

    name = "siemens"
    title = "SINUMERIK 840D sl"
    what = "CEC"
    carries = "also angular errors at all levers, by products of two tables: X by E_BX(X) times Z"
    leaves = "errors of rotary axes except R-POS"
    written = (FILE,)
    correction = TableSum
    classes = ("L-POS", "L-STR", "L-SQU", "L-ANG", "R-POS")
    points = 200
    tables = 62  # not checked: two for each of 31 axes
    fewer_tables = "828D: 8"
    products = True
    """Points of a table of the 828D; on the 840D sl MD18342 sets the number."""
    rounding = (0.0005, 0.0088)
    directions = True
    across = True
    wraps = True
    crossed_directions = True
    unchecked = (
        "products: that only the product moves the axis and not the single values of the two tables too (as the manual's example "
        "requires)",
        "rotary output axes: values in degrees",
    )

    def write(self, correction: TableSum, notes: Sequence[str] = ()) -> dict[str, str]:
        """Return the program, with one table per factor; see `TableFormat.write`.

        Nodes of every curve are equidistant, and products are of two tables. The axes are AX1, AX2, … in command order.
        """
        machine = correction.machine
        blocks: list[str] = []
        for term in correction.terms:
            scale = unit_of(machine.by_name[term.axis])
            if len(term.factors) > 2:
                raise InputError("a product of three tables", expected="at most two", value=term.axis)
            first, *others = term.factors
            by = len(blocks) + 2 if others else 0
            blocks.append(_block(len(blocks), term.axis, first.scaled(scale), DIGITS, machine, by))
            blocks += [_block(len(blocks), term.axis, factor, _FACTOR_DIGITS, machine, 0) for factor in others]
        if self.tables is not None and len(blocks) > self.tables:
            raise InputError("too many compensation tables", expected=f"at most {self.tables}", value=len(blocks))
        head = ["%_N_CEC_MPF", *(f"; {note}" for note in notes), f"; {axis_numbers(machine, 'is')}"]
        return {FILE: "\n".join([*head, *blocks, "M30"]) + "\n"}

    def read(self, files: Sequence[Path], machine: Machine) -> TableSum:
        """Return the tables from programs that write ``$AN_CEC…``; see `TableFormat.read` and `entries`."""
        by_index = {int(index): entry for index, entry in entries(files, _FIELD, "$AN_CEC").items()}
        curves = {index: _curve(index, entry, machine) for index, entry in by_index.items()}
        factors: dict[int, int] = {}
        for index, entry in by_index.items():
            by = entry.fields.get("MULT_BY_TABLE", TableLine(entry.line.path, entry.line.number, "0"))
            number = int(by.decimal("MULT_BY_TABLE"))
            if number and number - 1 not in curves:
                raise by.error("no such table to multiply by", "the index of a table plus 1", by.text)
            if number:
                factors[index] = number - 1
        terms = []
        for index in sorted(set(by_index) - (set(factors.values()) - set(factors))):
            axis, curve = curves[index]
            own = curve.scaled(1.0 / unit_of(axis))
            if index not in factors:
                terms.append(ControlTerm(axis.name, (own,)))
                continue
            by = by_index[index].fields["MULT_BY_TABLE"]
            if index in factors.values():
                what = f"table {index} multiplies another and is itself multiplied"
                raise by.error(what, "products of two tables", by.text)
            other_axis, factor = curves[factors[index]]
            if other_axis.name != axis.name:
                what = f"tables {index} and {factors[index]} are multiplied but move different axes"
                raise by.error(what, axis.name, other_axis.name)
            terms.append(ControlTerm(axis.name, (own, factor)))
        return TableSum(tuple(terms), machine)

    def loading(self, correction: TableSum, largest: Mapping[str, float]) -> tuple[str, ...]:
        """See `TableFormat.loading`."""
        machine = correction.machine
        counts = [len(factor.at) for term in correction.terms for factor in term.factors]
        limits = ", ".join(
            f"{name} {math.ceil(_LIMIT_FACTOR * peak) * 1e-3:.3f} mm"
            if machine.by_name[name].linear
            else f"{name} {_LIMIT_FACTOR * peak * URAD_IN_DEG:.5f} deg"
            for name, peak in largest.items()
        )
        moved = ", ".join(largest)
        products = (
            "Products: a table with $AN_CEC_MULT_BY_TABLE and the one after it are an angular error times its lever (up to 1). If "
            "the control also adds the single values, the sum exceeds MD32720: it raises an alarm and holds the correction at that "
            "limit. In that case make the tables without products."
        )
        return (
            f"Check the axes: {axis_numbers(machine, '=')} "
            "(MD10000 $MN_AXCONF_MACHAX_NAME_TAB); input and output axes are written by these numbers.",
            f"MD18342 $MN_MM_CEC_MAX_POINTS[t] for t = 0 ... {len(counts) - 1}: {', '.join(map(str, counts))} or more "
            "(reorganises the memory: back up first; a restart follows). The 828D has 8 tables of 200 points.",
            f"MD32710 $MA_CEC_ENABLE = 0 for {moved}: tables can be loaded only while this is 0.",
            f"Run {FILE} once as a part program.",
            f"MD32720 $MA_CEC_MAX_SUM, a limit with an alarm, slightly above the largest correction: {limits}.",
            f"SD41300 $SN_CEC_TABLE_ENABLE[t] = 1 for all tables, then MD32710 $MA_CEC_ENABLE = 1 for {moved}; reset. Axes must be "
            "referenced.",
            *([products] if any(len(term.factors) > 1 for term in correction.terms) else []),
            "Leadscrew error compensation (MD32700) of the same axis is added to it: errors that it corrects must not be in the "
            "calibration.",
        )


def _block(index: int, moved: str, curve: ControlCurve, digits: int, machine: Machine, by: int) -> str:
    """Return the lines of one table, in the control's units."""
    step = step_of(curve)
    if step is None:
        what = "nodes of a CEC table"
        raise InputError(what, expected="two or more equidistant nodes", value=f"{moved} over {curve.argument}")
    side = {0: "both directions", 1: f"{curve.argument} moving up", -1: f"{curve.argument} moving down"}[
        curve.direction
    ]
    fields = {
        "INPUT_AXIS": f"(AX{machine.names.index(curve.argument) + 1})",
        "OUTPUT_AXIS": f"(AX{machine.names.index(moved) + 1})",
        "STEP": fixed_decimals(step, DIGITS),
        "MIN": fixed_decimals(curve.at[0], DIGITS),
        "MAX": fixed_decimals(curve.at[-1], DIGITS),
        "DIRECTION": curve.direction,
        "MULT_BY_TABLE": by,
        "IS_MODULO": int(curve.period is not None),
    }
    lines = [f"; table {index + 1}: {moved} by {curve.argument}, {side}{f', times table {by}' if by else ''}"]
    lines += [f"$AN_CEC[{index},{n}]={fixed_decimals(value, digits)}" for n, value in enumerate(curve.values)]
    lines += [f"$AN_CEC_{name}[{index}]={value}" for name, value in fields.items()]
    return "\n".join(lines)


def _curve(index: int, entry: Entry, machine: Machine) -> tuple[Axis, ControlCurve]:
    """Return the axis that a table moves, and its curve in the units of the file, mm and degrees."""
    fields = entry.fields
    at, values, period = table_of(f"table {index}", "$AN_CEC", entry)
    for name in ("INPUT_AXIS", "OUTPUT_AXIS"):
        if name not in fields:
            raise entry.line.error(f"table {index} lacks $AN_CEC_{name}", "an assignment to it")
    of, moved = (axis_of(fields[name], fields[name].text, machine) for name in ("INPUT_AXIS", "OUTPUT_AXIS"))
    side = fields["DIRECTION"].decimal("$AN_CEC_DIRECTION") if "DIRECTION" in fields else 0.0
    direction = {-1.0: DOWN, 0.0: BOTH, 1.0: UP}.get(side)
    if direction is None:
        raise fields["DIRECTION"].error("$AN_CEC_DIRECTION", "-1, 0 or 1", f"{side:g}")
    return moved, ControlCurve(of.name, at, values, period, direction)
