"""SINUMERIK: leadscrew and measuring system error compensation (LEC, MSEC), as a program that writes system variables.

Checked against public descriptions: SINUMERIK Function Manual, Extended Functions, 03/2013, 6FC5397-1BP40-3BA1, chapter K3, section
4.4.2 (www.easymanua.ls/siemens/sinumerik-series/manual/275710?p=240; adjacent pages at
manual.onestart.ai/manuals/Siemens-SINUMERIK-Series-Function-Manual-5628364?page=238), and SINUMERIK 808D Function Manual, 01/2017
(www.easymanua.ls/siemens/sinumerik-808d/manual/217421?p=106):

- p. 237: linear interpolation between the points; tables are loaded only while MD32700 is 0.
- p. 238: a positive value makes the axis move in the negative direction, so that values have the sign of the error; the value at the
  reference point should be zero, otherwise the axis jumps when the compensation is activated.
- p. 240: ``$AA_ENC_COMP[e,N,AXi]`` at ``$AA_ENC_COMP_MIN[e,AXi] + N·$AA_ENC_COMP_STEP[e,AXi]``, 0 ≤ N < MD38000; ``e`` is the
  measuring system; below MIN the first value, above MAX the last; ``$AA_ENC_COMP_IS_MODULO[e,AXi] = 1`` repeats from MIN to MAX.
- p. 242: the structure of the program; a machine axis is given by its name or as AX1, AX2, … by their order.
- 808D, p. 106: up to 200 points.

It cannot move one axis as a function of another (straightness, squareness, levers of angular errors; the tables of `siemens`, CEC,
can), and it does not distinguish directions, so that backlash remains (backlash compensation, MD32450). The tables are for the first
measuring system of every axis.

**Not checked**: `unchecked`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, final

from twin._common.errors import InputError
from twin.controls.correction import ControlCurve, ControlTerm, TableSum
from twin.controls.format import TableFormat, fixed_decimals, unit_of
from twin.controls.formats.siemens import DIGITS, axis_numbers, axis_of, entries, step_of, table_of
from twin.machine.machine import Axis, Machine

FILE: Final = "eec.mpf"
_FIELD: Final = re.compile(
    r"^\$AA_ENC_COMP(?:_(?P<name>STEP|MIN|MAX|IS_MODULO))?\s*"
    r"\[\s*0\s*,\s*(?:(?P<node>\d{1,9})\s*,\s*)?(?P<table>\w+)\s*\]\s*=\s*(?P<value>.+)$",
    re.IGNORECASE,
)


@final
class SiemensEec(TableFormat[TableSum]):
    """SINUMERIK: leadscrew and measuring system error compensation."""

    name = "siemens_eec"
    title = "SINUMERIK"
    what = "LEC, MSEC"
    carries = "positioning; of angular errors the part along the axis"
    leaves = "straightness, squareness; backlash"
    written = (FILE,)
    correction = TableSum
    classes = ("L-POS", "L-ANG", "R-POS")
    points = 200
    """Points per axis of the 808D; on the 840D sl MD38000 sets the number."""
    rounding = (0.0005, 0.0088)
    wraps = True
    unchecked = ("rotary axes: values and positions in degrees",)

    def write(self, correction: TableSum, notes: Sequence[str] = ()) -> dict[str, str]:
        """See `TableFormat.write`: one table of each axis over itself, for both directions, with equidistant nodes."""
        machine = correction.machine
        lines = ["%_N_AX_EEC_MPF", *(f"; {note}" for note in notes), f"; {axis_numbers(machine, 'is')}"]
        for index, axis in enumerate(machine.axes, start=1):
            own = [term for term in correction.terms if term.axis == axis.name]
            if own:
                curve, step = self._only(own, axis)
                values = [fixed_decimals(-value * unit_of(axis), DIGITS) for value in curve.values]
                lines += [f"; {axis.name}", *(f"$AA_ENC_COMP[0,{n},AX{index}]={text}" for n, text in enumerate(values))]
                for name, value in (("STEP", step), ("MIN", curve.at[0]), ("MAX", curve.at[-1])):
                    lines.append(f"$AA_ENC_COMP_{name}[0,AX{index}]={fixed_decimals(value, DIGITS)}")
                lines.append(f"$AA_ENC_COMP_IS_MODULO[0,AX{index}]={int(curve.period is not None)}")
        return {FILE: "\n".join([*lines, "M30"]) + "\n"}

    def _only(self, own: Sequence[ControlTerm], axis: Axis) -> tuple[ControlCurve, float]:
        """Return the curve of an axis and the distance of its nodes."""
        curve = own[0].factors[0]
        step = step_of(curve)
        alone = len(own) == 1 and own[0].key == (axis.name, (axis.name, 0))
        if not alone or step is None or len(curve.at) > self.points:
            what = f"not possible as leadscrew error compensation: {axis.name}"
            expected = f"one table of the axis over itself for both directions, 2 to {self.points} equidistant points"
            shown = [f"{term.name}, {len(term.factors[0].at)} points" for term in own]
            raise InputError(what, expected=expected, value=shown)
        return curve, step

    def read(self, files: Sequence[Path], machine: Machine) -> TableSum:
        """Return the tables from programs that write ``$AA_ENC_COMP…`` of the first measuring system; see `entries`."""
        terms: dict[str, ControlTerm] = {}
        found = entries(files, _FIELD, "$AA_ENC_COMP[0,")
        for axis, entry in [(axis_of(entry.line, of, machine), entry) for of, entry in found.items()]:
            if axis.name in terms:
                raise entry.line.error("an axis with two names", "one name", axis.name)
            at, values, period = table_of(f"the table of {axis.name}", "$AA_ENC_COMP", entry)
            shifts = tuple(-value / unit_of(axis) for value in values)
            terms[axis.name] = ControlTerm(axis.name, (ControlCurve(axis.name, at, shifts, period),))
        return TableSum(tuple(terms[name] for name in machine.names if name in terms), machine)

    def loading(self, correction: TableSum, largest: Mapping[str, float]) -> tuple[str, ...]:
        """See `TableFormat.loading`."""
        machine, moved = correction.machine, ", ".join(largest)
        counts = ", ".join(f"{term.axis} {len(term.factors[0].at)}" for term in correction.terms)
        return (
            f"Check the axes: {axis_numbers(machine, '=')} (MD10000 $MN_AXCONF_MACHAX_NAME_TAB).",
            f"MD38000 $MA_MM_ENC_COMP_MAX_POINTS[0]: {counts} or more (reorganises the memory: back up first; a restart follows).",
            f"MD32700 $MA_ENC_COMP_ENABLE[0] = 0 for {moved}: tables can be loaded only while this is 0.",
            f"Run {FILE} once as a part program.",
            f"MD32700 $MA_ENC_COMP_ENABLE[0] = 1 for {moved}; reset. Axes must be referenced. An axis whose table is not zero at the "
            "reference point jumps by that value when the compensation is activated.",
            "Backlash compensation (MD32450) and sag compensation (MD32710) of the same axis are added to it: errors that they "
            "correct must not be in the calibration.",
        )
