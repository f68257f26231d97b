"""Spatial error grid: corrections of the three linear axes at the points of a box, as CSV; twin's own format.

A header line ``X_mm,Y_mm,Z_mm,dX_um,dY_um,dZ_um``, then one point per row: every combination of the positions once, in any order;
``#`` comments. **The sign is that of the correction**, which is added to the command of the axis. The error of the axes at that point
is its negative. Values are interpolated trilinearly between the points; outside the box the value of its nearest point applies. The
grid is valid for one tool length and one position of the rotary axes, which the comments state.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.csv_tables import read_table
from twin._common.errors import InputError
from twin.controls.correction import CorrectionGrid
from twin.controls.format import TableFormat, TableLine, fixed_decimals
from twin.machine.machine import Machine

FILE: Final = "grid.csv"
_DIGITS: Final = 4
"""Number of decimals, mm and µm."""


@final
class SpatialGrid(TableFormat[CorrectionGrid]):
    """Spatial error grid, twin's own format."""

    name = "grid"
    title = "spatial error grid"
    what = "(twin's own)"
    carries = "all errors of the three linear axes, at one tool length"
    leaves = "errors of rotary axes; backlash"
    correction = CorrectionGrid
    written = (FILE,)
    classes = ("L-POS", "L-STR", "L-SQU", "L-ANG")
    points = 101
    tolerance_um = 5.0
    rounding = (0.5 * 10.0**-_DIGITS, 0.0)

    def write(self, correction: CorrectionGrid, notes: Sequence[str] = ()) -> dict[str, str]:
        """See `TableFormat.write`."""
        sign = "correction: the value is ADDED to the command of the axis; the error is its negative"
        lines = [*(f"# {note}" for note in (sign, *notes)), ",".join(_columns(correction.axes))]
        for q, values in zip(product(*correction.at), correction.values.reshape(-1, 3), strict=True):
            lines.append(",".join(fixed_decimals(value, _DIGITS) for value in (*q, *values)))
        return {FILE: "\n".join(lines) + "\n"}

    def read(self, files: Sequence[Path], machine: Machine) -> CorrectionGrid:
        """Return the grid of one file; raise `InputError` for other columns, or a point that is missing or given twice."""
        if len(files) != 1:
            what = "a grid is a single file"
            raise InputError(what, expected="one file", value=" ".join(file.name for file in files))
        path = files[0]
        names = tuple(machine.axes[i].name for i in machine.linear)
        header, rows, _ = read_table(path)
        if len(names) != 3 or header != _columns(names):
            what = "wrong columns for a grid"
            raise InputError(what, expected=",".join(_columns(names)), file=path, value=",".join(header))
        if not rows:
            raise InputError("no points", expected="one or more rows", file=path)
        lines = [TableLine(path, line, ",".join(row)) for line, row in rows]
        numbers = np.array(
            [
                [line.decimal(name, cell) for cell, name in zip(row, header, strict=True)]
                for line, (_, row) in zip(lines, rows, strict=True)
            ]
        )
        at = tuple(tuple(np.unique(numbers[:, i]).tolist()) for i in range(3))
        shape = tuple(len(nodes) for nodes in at)
        if min(shape) < 2:
            what = "too few positions of an axis"
            raise InputError(what, expected="two or more of each axis", file=path, value=" × ".join(map(str, shape)))
        values = np.full((*shape, 3), np.nan)
        for line, found in zip(lines, numbers, strict=True):
            place = tuple(at[i].index(float(found[i])) for i in range(3))
            if not np.isnan(values[place][0]):
                raise line.error("duplicate point", "each once", line.text)
            values[place] = found[3:]
        if np.isnan(values).any():
            place = np.argwhere(np.isnan(values[..., 0]))[0]
            what, shown = "a point is missing", " ".join(f"{name} {at[i][place[i]]:g}" for i, name in enumerate(names))
            raise InputError(what, expected="every combination of the positions", file=path, value=shown)
        return CorrectionGrid(machine, at, values)

    def loading(self, correction: CorrectionGrid, largest: Mapping[str, float]) -> tuple[str, ...]:
        """See `TableFormat.loading`."""
        return (
            "grid.csv is twin's own format: corrections (added to the commands), um, at the points of a box; trilinear interpolation "
            "between them.",
            "The program that reads it must use the sign stated in its first line.",
        )


def _columns(names: Sequence[str]) -> list[str]:
    return [*(f"{name}_mm" for name in names), *(f"d{name}_um" for name in names)]
