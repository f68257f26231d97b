"""SINUMERIK 840D sl: sag and angularity compensation (CEC, "cross error compensation"), as a program that writes its system variables.

Checked against public descriptions: SINUMERIK Function Manual, Extended Functions, 03/2013, 6FC5397-1BP40-3BA1, chapter K3
(www.easymanua.ls/siemens/sinumerik-series/manual/275710):

- p. 245, 248, 249, 250: ``$AN_CEC[t,N]`` at ``$AN_CEC_MIN[t] + N·$AN_CEC_STEP[t]``; the setpoint of ``$AN_CEC_INPUT_AXIS[t]`` is
  the argument, ``$AN_CEC_OUTPUT_AXIS[t]`` the axis moved; below MIN the first value, above MAX the last; ``$AN_CEC_DIRECTION[t]``
  0 both, 1 and −1 one direction of the base axis; ``$AN_CEC_IS_MODULO[t] = 1`` repeats from MIN to MAX. The sum of all tables of
  an axis is put out "as an additional setpoint": values have the sign of the correction. Straight lines between the points: p.
  237. The machine data to set: MD32710, MD32720, MD18342, SD41300.
- p. 252: ``$AN_CEC_MULT_BY_TABLE[0] = 2`` multiplies table 1 (index 0) by table 2 (index 1): ΔX1 = Z1·β(X1), with Z1 → X1 a
  straight line.
- p. 264: on the 828D there are 8 tables of 200 points.
- "AX1" … are machine axes in their order whatever their names (p. 248).

**Not checked** (`UNCHECKED`): that of two tables multiplied only the product moves the axis, as the example of p. 252 needs it
(its second table alone would move X1 by Z1), and not their single values too. Values of rotary output axes in degrees.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, final

from twin._common.errors import InputError
from twin.machine.control.curve import BOTH, DOWN, UP, Curve, Term, Terms
from twin.machine.control.lines import axis_named, number, numbered, plain, unit_of
from twin.machine.machine import Axis, Machine

POINTS: Final = 200
"""Of a table of the 828D; the 840D sl has as many as MD18342 says."""
TABLES: Final = 62
"""Tables written at most where nobody says how many the control has (not checked; two for each of 31 axes). The 828D has 8."""
DIGITS: Final = 6
FACTOR_DIGITS: Final = 9
FILE: Final = "cec.mpf"
UNCHECKED: Final = (
    "products: that only the product moves the axis and not the single values of the two tables too (as the manual's example needs it)",
    "rotary output axes: values in degrees",
)
_FIELD: Final = re.compile(
    r"^\$AN_CEC(?:_(STEP|MIN|MAX|INPUT_AXIS|OUTPUT_AXIS|DIRECTION|MULT_BY_TABLE|IS_MODULO))?\s*"
    r"\[\s*(\d{1,9})\s*(?:,\s*(\d{1,9})\s*)?\]\s*=\s*(.+)$",
    re.IGNORECASE,
)
_NEEDED: Final = ("STEP", "MIN", "MAX", "INPUT_AXIS", "OUTPUT_AXIS")


def write(terms: Sequence[Term], machine: Machine, notes: Sequence[str] = ()) -> dict[str, str]:
    """The program by its name: one table a factor.

    Args:
        terms: tables, and products of two; nodes of every curve in equal steps.
        machine: its axes are taken as AX1, AX2, … in command order.
        notes: said in comments at its head.

    Raises:
        InputError: steps that are not equal; more tables than there can be.
    """
    blocks: list[str] = []
    index = 0
    for term in terms:
        scale = unit_of(machine.by_name[term.axis])
        if len(term.factors) > 2:
            raise InputError("a product of three tables", expected="two", value=term.axis)
        blocks.append(
            _block(index, term.axis, term.factors[0], scale, DIGITS, machine, index + 2 if len(term.factors) > 1 else 0)
        )
        index += 1
        for factor in term.factors[1:]:
            blocks.append(_block(index, term.axis, factor, 1.0, FACTOR_DIGITS, machine, 0))
            index += 1
    if index > TABLES:
        raise InputError("too many compensation tables", expected=f"at most {TABLES}", value=index)
    axes = ", ".join(f"AX{i} is {name}" for i, name in enumerate(machine.names, start=1))
    head = ["%_N_CEC_MPF", *(f"; {note}" for note in notes), f"; {axes}"]
    return {FILE: "\n".join([*head, *blocks, "M30"]) + "\n"}


def _block(index: int, moved: str, curve: Curve, scale: float, digits: int, machine: Machine, by: int) -> str:
    steps = [b - a for a, b in zip(curve.at, curve.at[1:], strict=False)]
    if not steps or max(steps) - min(steps) > 1e-9 * max(abs(q) for q in curve.at):
        raise InputError(
            "nodes of a CEC table", expected="two or more in equal steps", value=f"{moved} over {curve.of}"
        )
    side = {0: "both directions", 1: f"{curve.of} moving up", -1: f"{curve.of} moving down"}[curve.direction]
    lines = [f"; table {index + 1}: {moved} by {curve.of}, {side}{f', times table {by}' if by else ''}"]
    lines += [f"$AN_CEC[{index},{n}]={plain(value * scale, digits)}" for n, value in enumerate(curve.values)]
    lines += [
        f"$AN_CEC_INPUT_AXIS[{index}]=(AX{machine.names.index(curve.of) + 1})",
        f"$AN_CEC_OUTPUT_AXIS[{index}]=(AX{machine.names.index(moved) + 1})",
        f"$AN_CEC_STEP[{index}]={plain(steps[0], DIGITS)}",
        f"$AN_CEC_MIN[{index}]={plain(curve.at[0], DIGITS)}",
        f"$AN_CEC_MAX[{index}]={plain(curve.at[-1], DIGITS)}",
        f"$AN_CEC_DIRECTION[{index}]={curve.direction}",
        f"$AN_CEC_MULT_BY_TABLE[{index}]={by}",
        f"$AN_CEC_IS_MODULO[{index}]={int(curve.period is not None)}",
    ]
    return "\n".join(lines)


@final
@dataclass
class _Entry:
    """One table while it is read."""

    line: int
    fields: dict[str, tuple[int, str]] = field(default_factory=dict)
    values: dict[int, tuple[int, str]] = field(default_factory=dict)


def read(files: Sequence[Path], machine: Machine) -> Terms:
    """Tables from programs that write ``$AN_CEC…``.

    Raises:
        InputError: a line that is neither an assignment to a table, a comment, a head nor an end; whatever is missing in a table or
        does not fit.
    """
    terms: list[Term] = []
    seen: dict[int, Path] = {}
    entries: dict[int, tuple[Path, _Entry]] = {}
    for path in files:
        for index, entry in _entries(path).items():
            if index in seen:
                raise InputError(
                    f"table {index} is in two files",
                    expected="once",
                    file=path,
                    line=entry.line,
                    value=seen[index].name,
                )
            seen[index] = path
            entries[index] = (path, entry)
    curves = {index: _curve(index, path, entry, machine) for index, (path, entry) in entries.items()}
    multiplied = set()
    for path, entry in entries.values():
        line, by = entry.fields.get("MULT_BY_TABLE", (entry.line, "0"))
        other = int(number(by, path, line, "MULT_BY_TABLE"))
        if other and other - 1 not in curves:
            raise InputError(
                "no such table to multiply by", expected="the index of one plus 1", file=path, line=line, value=by
            )
        if other:
            multiplied.add(other - 1)
    for index, (path, entry) in sorted(entries.items()):
        line, by = entry.fields.get("MULT_BY_TABLE", (entry.line, "0"))
        other = int(float(by))
        axis, curve = curves[index]
        if index in multiplied:
            if other:
                raise InputError(
                    f"table {index} multiplies another and is itself multiplied",
                    expected="products of two",
                    file=path,
                    line=line,
                    value=by,
                )
            continue
        scale = unit_of(axis)
        own = _scaled(curve, 1.0 / scale)
        if not other:
            terms.append(Term(axis.name, (own,)))
            continue
        factor_axis, factor = curves[other - 1]
        if factor_axis.name != axis.name:
            raise InputError(
                f"tables {index} and {other - 1} are multiplied and move different axes",
                expected=axis.name,
                file=path,
                line=line,
                value=factor_axis.name,
            )
        terms.append(Term(axis.name, (own, factor)))
    return Terms(terms, machine)


def _scaled(curve: Curve, by: float) -> Curve:
    return Curve(curve.of, curve.at, tuple(value * by for value in curve.values), curve.period, curve.direction)


def _entries(path: Path) -> dict[int, _Entry]:
    found: dict[int, _Entry] = {}
    for line, text in numbered(path):
        text = text.partition(";")[0].strip()
        if not text or text.startswith("%") or re.fullmatch(r"(?i)N?\d*\s*(M17|M30|M02|M2|RET|CHANDATA\(\d+\))", text):
            continue
        match = _FIELD.match(text)
        if match is None:
            raise InputError(
                "no line of a compensation table",
                expected="$AN_CEC… = …, a comment, M17 or M30",
                file=path,
                line=line,
                value=text,
            )
        name, index, node, value = match.groups()
        entry = found.setdefault(int(index), _Entry(line))
        if (name is None) != (node is not None):
            raise InputError(
                "indices that do not fit",
                expected="[table,point] of a value, [table] of the rest",
                file=path,
                line=line,
                value=text,
            )
        place: dict[int, tuple[int, str]] | dict[str, tuple[int, str]] = entry.values if name is None else entry.fields
        key: int | str = int(node) if name is None else name.upper()
        if key in place:
            raise InputError("written twice", expected="once", file=path, line=line, value=text)
        place[key] = (line, value.strip())  # type: ignore[index]
    if not found:
        raise InputError("no compensation table", expected="$AN_CEC[0,0] = …", file=path)
    return found


def _curve(index: int, path: Path, entry: _Entry, machine: Machine) -> tuple[Axis, Curve]:
    """The axis a table moves, and its curve as written: mm and degrees."""
    for name in _NEEDED:
        if name not in entry.fields:
            raise InputError(f"table {index} lacks $AN_CEC_{name}", expected="it", file=path, line=entry.line)

    def value(name: str, default: str = "0") -> float:
        line, text = entry.fields.get(name, (entry.line, default))
        return number(text, path, line, f"$AN_CEC_{name}")

    step, low, high = value("STEP"), value("MIN"), value("MAX")
    steps = (high - low) / step if step > 0.0 else 0.0
    intervals = round(steps) if math.isfinite(steps) else 0
    if intervals < 1 or abs(low + intervals * step - high) > 1e-5 * max(1.0, abs(high), abs(low)):
        line = entry.fields["STEP"][0]
        raise InputError(
            f"table {index}: STEP does not divide MIN … MAX",
            expected="a whole number of steps",
            file=path,
            line=line,
            value=f"{step:g}",
        )
    missing = next((n for n in range(intervals + 1) if n not in entry.values), None)
    if missing is not None or max(entry.values) > intervals:
        raise InputError(
            f"table {index} has not the points that MIN, MAX and STEP say",
            expected=f"0 … {intervals}",
            file=path,
            line=entry.line,
            value=max(entry.values) if missing is None else f"{missing} missing",
        )
    axes = []
    for name in ("INPUT_AXIS", "OUTPUT_AXIS"):
        line, text = entry.fields[name]
        axes.append(_axis(text, machine, path, line))
    direction = value("DIRECTION")
    if direction not in (-1.0, 0.0, 1.0):
        raise InputError(
            "$AN_CEC_DIRECTION",
            expected="-1, 0 or 1",
            file=path,
            line=entry.fields["DIRECTION"][0],
            value=f"{direction:g}",
        )
    values = tuple(number(entry.values[n][1], path, entry.values[n][0], "a value") for n in range(intervals + 1))
    at = tuple(low + n * (high - low) / intervals for n in range(intervals + 1))
    period = high - low if value("IS_MODULO") else None
    return axes[1], Curve(axes[0].name, at, values, period, {-1.0: DOWN, 0.0: BOTH, 1.0: UP}[direction])


def _axis(text: str, machine: Machine, path: Path, line: int) -> Axis:
    """``(AX2)``: the second axis; ``(X1)``, ``(X)``: X."""
    name = text.strip("() ").upper()
    general = re.fullmatch(r"AX(\d{1,9})", name)
    if general is not None and 1 <= int(general[1]) <= len(machine.axes):
        return machine.axes[int(general[1]) - 1]
    shorter = name[:-1] if name.endswith("1") and name not in machine.by_name else name
    return axis_named(shorter, machine, path, line)
