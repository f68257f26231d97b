"""HEIDENHAIN: compensation value tables (``.COM``), one an input axis, and the table that assigns them (``.CMA``).

Checked against public descriptions:

- MANUALplus 620 Technical Manual (01/2012) 6.10.3, www.easymanua.ls/heidenhain/manualplus-620/manual/506189?p=716 and ?p=718:
  column AXISPOS has the positions of the input axis counted from the machine datum, a column with the name of every axis that is
  moved its value, BACKLASH the values measured in the negative direction of traverse; in the ``.CMA`` a column an axis names the
  table that is read at that axis's position ([axis of the column in the .COM] = F(axis of the column of the .CMA)), and ``*`` in
  ACTIVE switches its line on. Several axes of one ``.COM`` are corrected at once (screw pitch and sag).
- TNC 407/415/425 Technical Manual, azmanual.top/manuals/797826/heidenhain-tnc-407-243-020-technical-manual.html?page=151 and
  ?page=153, ?page=156: an axis error is entered with its own sign, positive where the travel is too long; the tables' example is
  drawn as "error in Z"; a table has at most 256 entries (module 9095); of a rotary axis entries from 0 to 360 are used.
- The frame of a table file (``BEGIN … MM``, head line, rows, ``[END]``): iTNC 530 HSCI Technical Manual,
  www.easymanua.ls/heidenhain/itnc-530-hsci/manual/716772?p=684.

**Not checked** (`UNCHECKED`, also said in the files and in the account): that ``.COM`` values have the sign of the error as
linear axis-error compensation has; straight lines between the points and the end value beyond them; that BACKLASH holds whole
values and not differences; units of a rotary axis (degrees) and the number of digits; column widths. Older controls (TNC 4xx,
iTNC 530) want a datum and a distance that is a power of two instead of AXISPOS: not written.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, final

from twin._common.errors import InputError
from twin._common.units import TURN
from twin.machine.control.curve import BOTH, DOWN, UP, Curve, Term, Terms
from twin.machine.control.lines import axis_named, check_letters, number, numbered, plain, rising, unit_of
from twin.machine.machine import Axis, Machine

POINTS: Final = 256
DIGITS: Final = {True: 4, False: 5}
"""Behind the point: mm of a linear axis, degrees of a rotary one."""
CMA: Final = "CONFIG.CMA"
UNCHECKED: Final = (
    "sign of the values: taken as that of the error (actual - nominal), as HEIDENHAIN defines it for linear axis-error compensation",
    "straight lines between the points, the end value beyond them; BACKLASH: whole values coming from above",
    "rotary axes: degrees, wrapped into 0 ... 360 (the TNC 407 knows entries from 0 to 360 only, none below 0); digits and "
    "column widths",
)
_COMMENT: Final = ";"


def write(terms: Sequence[Term], machine: Machine, notes: Sequence[str] = ()) -> dict[str, str]:
    """Files by name: ``X_CORR.COM`` … for every axis that is read, and the ``.CMA``.

    Args:
        terms: single tables; all over one axis have the same nodes, and only one of an axis over itself differs by direction.
        machine: the machine.
        notes: said in a comment behind the end of each file.

    Raises:
        InputError: an axis that is none of X Y Z A B C U V W; what such tables cannot hold.
    """
    check_letters([name for term in terms for name in (term.axis, term.factors[0].of)], "HEIDENHAIN")
    files: dict[str, str] = {}
    inputs = [axis for axis in machine.axes if any(term.factors[0].of == axis.name for term in terms)]
    for axis in inputs:
        name = f"{axis.name}_CORR.COM"
        columns = _columns([term for term in terms if term.factors[0].of == axis.name], axis)
        at = next(iter(columns.values())).at
        head = ["NR", "AXISPOS", *columns]
        rows = [head]
        for i, q in enumerate(at):
            values = [
                _signed(-curve.values[i] * unit_of(moved), DIGITS[moved.linear])
                for moved, curve in (
                    (machine.by_name[axis.name if key == "BACKLASH" else key], curve) for key, curve in columns.items()
                )
            ]
            rows.append([str(i), _signed(q, 4), *values])
        files[name] = _table(name, rows, notes)
    rows = [["NR", "ACTIVE", *(axis.name for axis in inputs)], ["0", "*", *(f"{axis.name}_CORR" for axis in inputs)]]
    files[CMA] = _table(CMA, rows, notes)
    return files


def _columns(terms: Sequence[Term], axis: Axis) -> dict[str, Curve]:
    """Curves by column."""
    columns: dict[str, Curve] = {}
    for term in sorted(terms, key=lambda term: -term.factors[0].direction):
        curve = term.factors[0]
        key = "BACKLASH" if curve.direction == -1 else term.axis
        fits = len(term.factors) == 1 and key not in columns and (curve.direction == 0 or term.axis == axis.name)
        if not fits or len(curve.at) > POINTS or any(other.at != curve.at for other in columns.values()):
            raise InputError(
                f"no table of HEIDENHAIN: {term.axis} over {axis.name}",
                expected=f"single tables of the same nodes, at most {POINTS}; by direction only an axis over itself",
                value=f"{len(curve.at)} points, direction {curve.direction}, {len(term.factors)} factors",
            )
        columns[key] = curve
    own = [term.factors[0].direction for term in terms if term.axis == axis.name]
    if sorted(own) not in ([], [0], [-1, 1]):
        raise InputError(
            f"one direction of {axis.name} alone", expected="both, or a table for both", value=str(sorted(own))
        )
    # The own axis first, its other direction beside it.
    order = [key for key in (axis.name, "BACKLASH") if key in columns]
    return {key: columns[key] for key in (*order, *(key for key in columns if key not in order))}


def _table(name: str, rows: Sequence[Sequence[str]], notes: Sequence[str]) -> str:
    widths = [max(len(row[i]) for row in rows) + 2 for i in range(len(rows[0]))]
    lines = ["".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return "\n".join([f"BEGIN {name} MM", *lines, "[END]", *(f"{_COMMENT} {note}" for note in notes)]) + "\n"


def _signed(value: float, digits: int) -> str:
    text = plain(value, digits)
    return text if text.startswith("-") else f"+{text}"


def read(files: Sequence[Path], machine: Machine) -> Terms:
    """Tables from a ``.CMA`` and the ``.COM`` files its active line names.

    Raises:
        InputError: no ``.CMA``, no active line or several, a table it names is missing, or one it does not name is there; whatever does
            not fit in a table.
    """
    cmas = [file for file in files if file.suffix.lower() == ".cma"]
    if len(cmas) != 1:
        raise InputError(
            "HEIDENHAIN's tables are read with the one that assigns them",
            expected="one .CMA and the .COM files of its active line",
            value=" ".join(file.name for file in files),
        )
    given = {file.stem.upper(): file for file in files if file is not cmas[0]}
    cma = _Rows(cmas[0])
    active = [(line, row) for line, row in cma.rows if row.get("ACTIVE") == "*"]
    if len(active) != 1:
        raise InputError("lines with * in ACTIVE", expected="one", file=cmas[0], value=len(active))
    line, chosen = active[0]
    terms: list[Term] = []
    for name, table in chosen.items():
        if name in ("NR", "ACTIVE", "DOC") or not table:
            continue
        axis = axis_named(name, machine, cmas[0], line)
        file = given.pop(Path(table).stem.upper(), None)
        if file is None:
            raise InputError(
                "the table is not given", expected=f"{table}.COM", file=cmas[0], line=line, value=sorted(given)
            )
        terms += _terms(_Rows(file), axis, machine)
    if given:
        raise InputError(
            "tables the active line does not name", expected="them in the .CMA", file=cmas[0], value=sorted(given)
        )
    return Terms(terms, machine)


def _terms(table: _Rows, axis: Axis, machine: Machine) -> list[Term]:
    path = table.path
    if "AXISPOS" not in table.head or not table.rows:
        raise InputError("no positions", expected="a column AXISPOS and rows", file=path, value=" ".join(table.head))
    if len(table.rows) > POINTS:
        raise InputError("too many points", expected=f"at most {POINTS}", file=path, value=len(table.rows))
    lines = tuple(line for line, _ in table.rows)

    def column(name: str) -> tuple[float, ...]:
        return tuple(number(row.get(name, ""), path, line, name) for line, row in table.rows)

    at = column("AXISPOS")
    rising(at, lines, path)
    period = TURN if not axis.linear and axis.lower is None else None
    if period is not None and at[-1] - at[0] > TURN:
        raise InputError(
            "more than a turn", expected="positions from 0 to 360", file=path, line=lines[-1], value=at[-1]
        )
    terms = []
    for name in table.head:
        if name in ("NR", "AXISPOS", "DOC"):
            continue
        moved = axis if name == "BACKLASH" else axis_named(name, machine, path, table.head_line)
        values = tuple(-value / unit_of(moved) for value in column(name))
        two = moved is axis and "BACKLASH" in table.head
        if two and axis.name not in table.head:
            raise InputError(
                "BACKLASH without the axis itself", expected=f"a column {axis.name}", file=path, line=table.head_line
            )
        direction = (DOWN if name == "BACKLASH" else UP) if two else BOTH
        terms.append(Term(moved.name, (Curve(axis.name, at, values, period, direction),)))
    return terms


@final
class _Rows:
    """A table file: columns by the places of their names in the head line."""

    def __init__(self, path: Path) -> None:
        self.path = path
        lines = [(line, text) for line, text in numbered(path) if text and not text.startswith((_COMMENT, "#"))]
        if not lines or not lines[0][1].upper().startswith("BEGIN "):
            raise InputError(
                "no table", expected="BEGIN … as the first line", file=path, line=lines[0][0] if lines else None
            )
        if lines[0][1].upper().split()[-1] != "MM":
            raise InputError("not in mm", expected="BEGIN … MM", file=path, line=lines[0][0], value=lines[0][1])
        ends = [i for i, (_, text) in enumerate(lines) if text.upper() == "[END]"]
        if len(ends) != 1 or ends[0] != len(lines) - 1 or len(lines) < 3:
            raise InputError(
                "no end", expected="[END] behind the last row", file=path, line=lines[-1][0], value=lines[-1][1]
            )
        self.head_line, head = lines[1]
        self.head = tuple(head.split())
        if len(set(self.head)) != len(self.head):
            raise InputError("a column given twice", expected="each once", file=path, line=self.head_line, value=head)
        self.rows: list[tuple[int, Mapping[str, str]]] = []
        for line, text in lines[2:-1]:
            cells = text.split()
            if len(cells) != len(self.head):
                raise InputError(
                    f"{len(cells)} cells",
                    expected=f"{len(self.head)}: {' '.join(self.head)}",
                    file=path,
                    line=line,
                    value=text,
                )
            self.rows.append((line, dict(zip(self.head, cells, strict=True))))
