"""Table of single contacts, twin's own format: CSV with one row for each contact.

Columns ``contact_x_mm, contact_y_mm, contact_z_mm`` are the positions of the linear axes at the contact, ``B_deg`` … those of the
rotary axes. Optional: ``sphere``, ``round``, and ``direction_x, direction_y, direction_z``, the unit vector of the probing motion along
X, Y, Z.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.csv_tables import Cells, read_table, unused_column_note
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.measurement.columns import CONTACT_COLUMNS, simulated_comments
from twin.measurement.contacts import linear_columns
from twin.measurement.formats.base import ContactRow, Conversion, FormatSpecification, Given, MeasuredFormat, reduced

DIRECTION: Final = ("direction_x", "direction_y", "direction_z")


@final
class ContactTable(MeasuredFormat):
    """Table of single contacts."""

    specification = FormatSpecification(
        name="contacts",
        title="table of single contacts",
        suffixes=(".csv",),
        gives="sphere centres",
        instrument="probe",
        needs="positions of rotary axes that have no column",
        source="twin's own format",
        unverified=(),
    )

    def recognises(self, text: str) -> bool:
        """See `MeasuredFormat.recognises`."""
        header = next((line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")), "")
        return CONTACT_COLUMNS[0] in [cell.strip() for cell in header.split(",")]

    def read(self, path: Path, machine: Machine, given: Given, round_name: str) -> Conversion:
        """See `MeasuredFormat.read`."""
        header, rows, comments = read_table(path)
        rotary = [f"{machine.axes[i].name}_deg" for i in machine.rotary]
        optional = ("sphere", "round", *DIRECTION, *rotary)
        cells = Cells(path, {name: i for i, name in enumerate(header)}, rows)
        missing = [name for name in CONTACT_COLUMNS if name not in header]
        if missing or (0 < sum(name in header for name in DIRECTION) < 3):
            absent = ", ".join(missing or [name for name in DIRECTION if name not in header])
            raise InputError(
                f"column {absent} is missing", expected=", ".join((*CONTACT_COLUMNS, *optional)), file=path
            )
        names = [machine.axes[i].name for i in linear_columns(machine)]
        columns = dict(zip(names, CONTACT_COLUMNS, strict=True)) | {
            name[:-4]: name for name in rotary if name in header
        }
        values = {axis: cells.numbers(column) for axis, column in columns.items()}
        for axis, column in columns.items():
            for i in np.flatnonzero(~np.isfinite(values[axis])):
                raise InputError(f"{column} is empty", expected="a number", file=path, line=rows[int(i)][0])
        directions = np.stack([cells.numbers(name) for name in DIRECTION], axis=1)
        spheres, rounds = cells.words("sphere", "sphere"), cells.words("round", "1")
        contacts = [
            ContactRow(
                line,
                {axis: float(column[i]) for axis, column in values.items()},
                str(spheres[i]),
                (float(directions[i, 0]), float(directions[i, 1]), float(directions[i, 2])),
                str(rounds[i]) if "round" in header else None,
            )
            for i, (line, _) in enumerate(rows)
        ]
        known = {*CONTACT_COLUMNS, *optional}
        notes = [unused_column_note(name, sorted(known)) for name in header if name not in known]
        conversion = reduced(contacts, path, machine, given, simulated=bool(simulated_comments(comments)))
        return conversion.with_notes(*notes)
