"""Measured tables as other programs write them: any CSV dialect and Excel workbooks as measurement tables.

    twin import shop_table.csv -o measured.csv
    twin import export.csv -o measured.csv
    twin import export.csv -o measured.csv --columns measured.csv.columns.yaml
    twin import book.xlsx -o measured.csv --sheet Messung
    twin import points.txt -o measured.csv --plan plan.csv

The first example is a sample that comes with twin. Files of a probe, a ball bar or a laser have formats of their own: `twin convert`
(`twin doc convert`).

**What is read.** Text in UTF-8, UTF-16, code page 1252 or Latin-1, with or without byte order mark; columns separated by semicolons,
tabs, commas, bars or blanks; decimal comma or point, thousands with the other sign, apostrophe or blank; quoted cells with line
breaks; title rows above the header, comment lines (`#`, `//`, `%`, `!`), a row of units below it, a header of two rows. One sheet of
an Excel workbook (`.xlsx`). Rows below the header without any number are left out and listed.

**What the columns mean.** Headers are compared with a vocabulary, English and German (`vocabulary.py`). The commanded position (Soll,
nominal, command, set) and the measured coordinate (Ist, actual, measured, reading) are different columns. A measured rotary axis is a
read-back value. A bare `X` is the command if there is an `X actual`, and the reading if there is an `X nominal` or a plan; if both
`X` and `x` exist, the capital letter is the command. Names of a measurement table (`X_mm`, `u_x_mm`, `T_bed_degC`; `twin doc files`)
always keep their meaning. Further columns: reflector, side (`tool`, Spindel, `work`, Tisch), station, round, direction of approach
(`+`, `-`, up, down, vorwärts), temperatures, uncertainties, spindle speed, feed, load; dates and times become `time_s`.

**Vocabulary**, beside the names of the axes, in any case; ä is the same as ae:

VOCABULARY

**Units** come from the header (`[mm]`, `(in)`, `_um`, °) or the row of units. Lengths: mm, m, cm, µm, inch. Angles: degrees, rad,
mrad, µrad, arcsec. Without a unit, one is proposed by the size of the numbers on this machine.

**Positions from a plan.** `--plan` gives what a file of points lacks: commanded positions, targets, sides, rounds. Rows are matched
by names of points, if the plan has a column `point` with all of them, otherwise by their order. The numbers of rows must agree, and
the first row with another command, target or name is an error. Lines of a name and x, y, z without a header are read with a plan.

**Nothing is guessed silently.** If everything is stated in the file, the table is written. Otherwise no table is written and the exit
status is 2: the command prints the first rows as it understood them, one line for each assumption, and the next command. It writes
the proposed mapping (`schema: twin.columns/1`) to the file of `--columns`, or beside the output as `OUTPUT.columns.yaml`, with a
comment at each entry to check. Change what is wrong, then run the command that is printed: it applies exactly this mapping.

    schema: twin.columns/1
    decimal: comma
    columns:
      X_mm: {from: "X-Soll", unit: mm, sign: 1}       # unit and sign of this column; offset: -250 is added afterwards
      B_deg: {value: 0.0}                              # the same for all rows
      carrier: {from: "Ort", words: {"oben": tool}}    # meaning of the words of this column
      time_s: {from: ["Datum", "Uhrzeit"], format: "%d.%m.%Y %H:%M:%S"}

**Mirrored, exchanged and scaled coordinates.** Differences between readings of one target in one orientation must agree with the
motion that the machine commanded, up to one rotation of the station. Where an improper rotation fits far better (RMS residual a tenth
or less, and above 0.5 mm otherwise), a line says so with both residuals: *z seems to be mirrored: 120 of 120 rows fit better with
−z*. The same test finds a rotary axis of opposite sign, exchanged columns, and readings in another unit; the ranges of the machine
show a commanded axis of opposite sign. These findings are never applied: set `sign: -1` in the mapping. A mirrored command and a
mirrored reading differ by a rotation of the station; where the station is not aligned with the machine, the data do not show which
one it is. No test is made with fewer than eight rows that can be compared, or where the commanded points lie in one plane.

    import twin

    machine = twin.Machine.load("dmu50")
    found = twin.import_table("export.csv", machine)
    found.to_text()
    found.save_columns("columns.yaml")                # then: twin.import_table("export.csv", machine, columns="columns.yaml")

The table begins with comments: name and SHA-256 of the file, the mapping, comments and titles of the file. A comment or title with
*simulated* (simuliert) marks simulated readings. Before it is written, the table is read back by the reader of all other commands.

**Limits.** Reports with one row for each characteristic (feature, axis, nominal, measured) are not read: export one row for each
point. Old workbooks (`.xls`) are refused. The names of columns and forms of files were chosen from general knowledge of measuring
programs and were tried on simulated files only, on no export of a real program.
"""

from twin.measurement.importing.importer import ImportedTable, import_table
from twin.measurement.importing.mapping import SCHEMA, ColumnMapping
from twin.measurement.importing.vocabulary import NAMES, ROLES

_ROWS = [
    *(f"- {role}: {', '.join(sorted(words))}" for role, words in ROLES.items()),
    *(f"- {name}: {', '.join(sorted(filter(None, phrases)))}" for name, phrases in NAMES.items()),
]
__doc__ = (__doc__ or "").replace("\nVOCABULARY\n", "\n" + "\n".join(_ROWS) + "\n", 1)

__all__ = ["SCHEMA", "ColumnMapping", "ImportedTable", "import_table"]
