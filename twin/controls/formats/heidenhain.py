"""HEIDENHAIN: compensation value tables (``.COM``), one per input axis, and the table that assigns them (``.CMA``).

Checked against public descriptions:

- MANUALplus 620 Technical Manual (01/2012) 6.10.3, www.easymanua.ls/heidenhain/manualplus-620/manual/506189?p=716 and ?p=718:
  column AXISPOS contains the positions of the input axis from the machine datum, a column named after an axis the values that move
  it, BACKLASH the values measured in the negative direction of traverse; in the ``.CMA`` the column of an axis names the table that
  is read at that axis's position ([axis of the column in the .COM] = F(axis of the column of the .CMA)), and ``*`` in
  ACTIVE activates its line. Several axes of one ``.COM`` are corrected at once (screw pitch and sag).
- TNC 407/415/425 Technical Manual, azmanual.top/manuals/797826/heidenhain-tnc-407-243-020-technical-manual.html?page=151 and
  ?page=153, ?page=156: an axis error is entered with its own sign, positive where the travel is too long; the tables' example is
  plotted as "error in Z"; a table has at most 256 entries (module 9095); for a rotary axis entries from 0 to 360 are used.
- The frame of a table file (``BEGIN … MM``, header line, rows, ``[END]``): iTNC 530 HSCI Technical Manual,
  www.easymanua.ls/heidenhain/itnc-530-hsci/manual/716772?p=684.

**Not checked**: `unchecked`. Older controls (TNC 4xx, iTNC 530) require a datum and a spacing that is a power of two instead of
AXISPOS; this is not written.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, final

from twin._common.errors import InputError
from twin._common.units import TURN, count_with_noun
from twin.controls.correction import BOTH, DOWN, UP, ControlCurve, ControlTerm, TableSum, period_of
from twin.controls.format import (
    TableFormat,
    TableLine,
    check_increasing,
    check_letters,
    fixed_decimals,
    single_file,
    table_lines,
    unit_of,
)
from twin.machine.machine import Axis, Machine

CMA: Final = "CONFIG.CMA"
_DIGITS: Final = {True: 4, False: 5}
"""Number of decimals: mm of a linear axis, degrees of a rotary one."""
_COMMENT: Final = ";"


@final
class HeidenhainTables(TableFormat[TableSum]):
    """HEIDENHAIN: compensation value tables."""

    name = "heidenhain"
    title = "HEIDENHAIN"
    what = "`.COM`, `.CMA`"
    carries = "also straightness and squareness (Y by X …); angular errors at one lever"
    leaves = "angular errors at other levers"
    written = ("{}_CORR.COM", CMA)
    correction = TableSum
    classes = ("L-POS", "L-STR", "L-SQU", "L-ANG", "R-POS")
    points = 256
    rounding = (0.05, 0.0875)
    directions = True
    across = True
    wraps = True
    unchecked = (
        "sign of the values: taken as that of the error (actual - nominal), as HEIDENHAIN defines it for linear axis-error "
        "compensation",
        "linear interpolation between the points, the end value beyond them; BACKLASH: absolute values for the negative direction",
        "rotary axes: degrees, wrapped into 0 ... 360 (the TNC 407 accepts only entries from 0 to 360); number of digits and "
        "column widths",
    )

    def write(self, correction: TableSum, notes: Sequence[str] = ()) -> dict[str, str]:
        """Return ``X_CORR.COM`` … for every input axis, and the ``.CMA``; see `TableFormat.write`.

        All tables of one input axis have the same nodes, and only those of an axis over itself may depend on the direction. Axes are
        named by one of X Y Z A B C U V W. Notes are comments after the end of each file.
        """
        machine, terms = correction.machine, correction.terms
        check_letters([name for term in terms for name in (term.axis, term.factors[0].argument)], self.title)
        files: dict[str, str] = {}
        inputs = [axis for axis in machine.axes if any(term.factors[0].argument == axis.name for term in terms)]
        for axis in inputs:
            name = f"{axis.name}_CORR.COM"
            columns = self._columns([term for term in terms if term.factors[0].argument == axis.name], axis)
            moved = {key: machine.by_name[axis.name if key == "BACKLASH" else key] for key in columns}
            rows = [["NR", "AXISPOS", *columns]]
            for i, q in enumerate(next(iter(columns.values())).at):
                values = [
                    _signed(-curve.values[i] * unit_of(moved[key]), _DIGITS[moved[key].linear])
                    for key, curve in columns.items()
                ]
                rows.append([str(i), _signed(q, 4), *values])
            files[name] = _table(name, rows, notes)
        names = [axis.name for axis in inputs]
        rows = [["NR", "ACTIVE", *names], ["0", "*", *(f"{name}_CORR" for name in names)]]
        return {**files, CMA: _table(CMA, rows, notes)}

    def _columns(self, terms: Sequence[ControlTerm], axis: Axis) -> dict[str, ControlCurve]:
        """Return the curves by column, the axis's own first, followed by its other direction."""
        columns: dict[str, ControlCurve] = {}
        for term in sorted(terms, key=lambda term: (term.axis != axis.name, -term.factors[0].direction)):
            curve = term.factors[0]
            key = "BACKLASH" if curve.direction == DOWN else term.axis
            fits = len(term.factors) == 1 and key not in columns and (curve.direction == 0 or term.axis == axis.name)
            if not fits or len(curve.at) > self.points or any(other.at != curve.at for other in columns.values()):
                what = f"not possible as a HEIDENHAIN table: {term.axis} over {axis.name}"
                expected = f"single tables with the same nodes, at most {self.points}; by direction only for an axis over itself"
                shown = f"{len(curve.at)} points, direction {curve.direction}, {len(term.factors)} factors"
                raise InputError(what, expected=expected, value=shown)
            columns[key] = curve
        own = [term.factors[0].direction for term in terms if term.axis == axis.name]
        if sorted(own) not in ([], [BOTH], [DOWN, UP]):
            what = f"a table for one direction of {axis.name} only"
            raise InputError(what, expected="tables for both, or one for both", value=str(sorted(own)))
        return columns

    def read(self, files: Sequence[Path], machine: Machine) -> TableSum:
        """Return the tables from a ``.CMA`` and the ``.COM`` files named in its only active line; see `TableFormat.read`."""
        what = "HEIDENHAIN tables are read with the .CMA that assigns them"
        cma = _Rows(single_file(files, ".cma", what, "one .CMA and the .COM files named in its active line"))
        given = {file.stem.upper(): file for file in files if file is not cma.path}
        active = [(line, row) for line, row in cma.rows if row.get("ACTIVE") == "*"]
        if len(active) != 1:
            raise InputError("number of lines with * in ACTIVE", expected="one", file=cma.path, value=len(active))
        line, chosen = active[0]
        terms: list[ControlTerm] = []
        for name, table in chosen.items():
            if name in ("NR", "ACTIVE", "DOC") or not table:
                continue
            axis = line.axis(name, machine)
            file = given.pop(Path(table).stem.upper(), None)
            if file is None:
                raise line.error("missing table", f"{table}.COM", sorted(given))
            terms += self._terms(_Rows(file), axis, machine)
        if given:
            what = "tables that the active line does not name"
            raise InputError(what, expected="all tables named in the .CMA", file=cma.path, value=sorted(given))
        return TableSum(tuple(terms), machine)

    def _terms(self, table: _Rows, axis: Axis, machine: Machine) -> list[ControlTerm]:
        """Return the tables of one file."""
        path, head = table.path, table.head
        if "AXISPOS" not in head or not table.rows:
            raise InputError("no positions", expected="a column AXISPOS, and rows", file=path, value=" ".join(head))
        if len(table.rows) > self.points:
            raise InputError("too many points", expected=f"at most {self.points}", file=path, value=len(table.rows))
        at, lines = table.column("AXISPOS"), [line for line, _ in table.rows]
        check_increasing(at, lines)
        period = period_of(axis)
        if period is not None and at[-1] - at[0] > TURN:
            raise lines[-1].error("more than one turn", "positions from 0 to 360", at[-1])
        two = "BACKLASH" in head
        if two and axis.name not in head:
            raise table.head_line.error("BACKLASH without the axis itself", f"a column {axis.name}")
        terms = []
        for name in head:
            if name in ("NR", "AXISPOS", "DOC"):
                continue
            moved = axis if name == "BACKLASH" else table.head_line.axis(name, machine)
            values = tuple(-value / unit_of(moved) for value in table.column(name))
            direction = BOTH if not two or moved is not axis else DOWN if name == "BACKLASH" else UP
            terms.append(ControlTerm(moved.name, (ControlCurve(axis.name, at, values, period, direction),)))
        return terms

    def loading(self, correction: TableSum, largest: Mapping[str, float]) -> tuple[str, ...]:
        """See `TableFormat.loading`."""
        return (
            f"Copy the .COM files and {CMA} into the folder of the OEM tables. Open each in the table editor before "
            "moving the machine: the columns must be where the editor expects them.",
            "Positions (AXISPOS) are measured from the machine datum (MP_refPosition), like those of the calibration.",
            f"If there is a {CMA} already, merge them: the line with * in ACTIVE is the one in use.",
            "Activate nonlinear axis-error compensation for these axes (MP730 on older controls; the machine configuration on "
            "newer ones).",
            "BACKLASH columns: set MP_backLash / MP710 of these axes to zero, or the backlash is corrected twice.",
        )


def _table(name: str, rows: Sequence[Sequence[str]], notes: Sequence[str]) -> str:
    widths = [max(len(row[i]) for row in rows) + 2 for i in range(len(rows[0]))]
    lines = ["".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return "\n".join([f"BEGIN {name} MM", *lines, "[END]", *(f"{_COMMENT} {note}" for note in notes)]) + "\n"


def _signed(value: float, digits: int) -> str:
    text = fixed_decimals(value, digits)
    return text if text.startswith("-") else f"+{text}"


@final
class _Rows:
    """A table file, with its columns named in the header line."""

    def __init__(self, path: Path) -> None:
        self.path = path
        lines = [line for line in table_lines(path) if line.text and not line.text.startswith((_COMMENT, "#"))]
        first = lines[0] if lines else TableLine(path, None, "")
        if not first.text.upper().startswith("BEGIN "):
            raise first.error("not a table", "BEGIN … as the first line")
        if first.text.upper().split()[-1] != "MM":
            raise first.error("not in mm", "BEGIN … MM", first.text)
        ends = [i for i, line in enumerate(lines) if line.text.upper() == "[END]"]
        if ends != [len(lines) - 1] or len(lines) < 3:
            raise lines[-1].error("no end", "[END] after the last row", lines[-1].text)
        self.head_line = lines[1]
        self.head = tuple(self.head_line.text.split())
        if len(set(self.head)) != len(self.head):
            raise self.head_line.error("duplicate column", "each once", self.head_line.text)
        self.rows: list[tuple[TableLine, Mapping[str, str]]] = []
        for line in lines[2:-1]:
            cells = line.text.split()
            if len(cells) != len(self.head):
                what = count_with_noun(len(cells), "cell")
                raise line.error(what, f"{len(self.head)}: {' '.join(self.head)}", line.text)
            self.rows.append((line, dict(zip(self.head, cells, strict=True))))

    def column(self, name: str) -> tuple[float, ...]:
        """Return the numbers of a column."""
        return tuple(line.decimal(name, row[name]) for line, row in self.rows)
