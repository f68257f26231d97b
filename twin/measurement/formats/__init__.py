"""Measured data of other programs as measurement tables: contacts of a probe, ball bar, interferometer, tracker.

    twin convert probe.txt -o measured.csv --at B=0 C=0 --work-offset X=250 Y=225 Z=-200
    twin convert contacts.csv -o measured.csv --contact-uncertainty 0.001
    twin convert x.rtl -o measured.csv --axis X --at Y=225 Z=-200 B=0 C=0
    twin convert circle.b5r -o measured.csv --at X=250 Y=225 Z=-200 B=0 C=0
    twin convert "Round 1.csv" "Round 2.csv" -o measured.csv --plan plan.csv

The format is recognised by its content; `--format` names it where several fit. The command prints the number of rows, what it assumed
and what of the format could not be verified; the same lines, and name, size and SHA-256 of every file, are comments of the table.
`twin identify measured.csv`, `diagnose` and the other commands then read it.

| format | files | the rows | not in the file |
|---|---|---|---|
FORMATS

**Not guessed.** An element, unit or code that is not known stops the conversion with file, line, value and what was expected. So does a
count in the file that is not met (truncated files), a document type in XML, and a file larger than 64 MB.

**Single contacts.** Contacts with one sphere in one pose are reduced to the position at which the tip was at the sphere's centre. The
fit is geometric: it minimises the orthogonal distances. Its radius is that of the tip's centre around the sphere's and is fitted, or
known (`--sphere-radius` and `--tip-radius` together). A tip radius alone is compensated along the probing direction where the table
gives one. The noise of a contact is `--contact-uncertainty`, or is estimated from the residuals of all spheres together; the command
states which. `u_x_mm, u_y_mm, u_z_mm` follow from the covariance of the fit, in the frame of the tool; the whole covariance is in the
`--json` report. Contacts that do not determine a centre (fewer than four, in one plane, on one circle), and outliers (p < 0.001,
corrected for the number of contacts), are errors with the line of the contact. Consecutive contacts in one pose belong together;
`--contacts 6` says how many if the file has no names of spheres. The machine needs orthogonal linear axes X, Y, Z.

**Axis positions.** A table has positions in machine coordinates. `--work-offset` is added to the file's coordinates of an axis; `--at`
gives axes that the file does not contain: those that stood still during a positioning run, or the centre of a ball bar's circle.

**Renishaw ball bar.** No public description says where a `.b5r` file stores the readings of a run. They are taken from the only list of
numbers with a unit of length in each run; `--trace` names the element otherwise. The readings are assumed at equal steps of the angle
from `--start-angle` (0°: +A) over `--sweep` (360°), counter-clockwise from +A to +B. Compare the table with the plot of the ball bar's
own program before you use it.

**Heidenhain.** The logs of the control's own cycles (`TCHPR451.TXT` and the like) hold no sphere centres and are refused. A program can
print the contacts: `TCH PROBE 0` touches, `FN 18: SYSREAD` with `ID360 NR2 IDX1` … `IDX3` reads the touch point in machine coordinates,
and `FN 16: F-PRINT` prints it with this mask. Q204 and Q205 are the rotary axes; other machines have entries with the names of their
axes. `SPHERE` (a number) and `DX DY DZ` (the probing direction) are optional.

    MASK

    import twin
    from twin.measurement.formats import Given

    machine = twin.Machine.load("dmu50")
    found = twin.convert("x.rtl", machine, Given(axis="X", at={"Y": 225, "Z": -200, "B": 0, "C": 0}))
    found.save("measured.csv", machine)
    data = found.measurements

**Not verified**, because no public description covers it, and **sources**:

NOT VERIFIED
"""

from twin.measurement.formats.base import Conversion, FormatSpecification, Given, MeasuredFormat
from twin.measurement.formats.convert import FORMATS, ConvertedFiles, convert, format_named, format_of, other_format
from twin.measurement.formats.heidenhain import MASK

__all__ = [
    "FORMATS",
    "Conversion",
    "ConvertedFiles",
    "FormatSpecification",
    "Given",
    "MeasuredFormat",
    "convert",
    "format_named",
    "format_of",
    "other_format",
]

_SPECIFICATIONS = [form.specification for form in FORMATS]
_GENERATED = {
    "FORMATS": [
        f"| `{one.name}` {one.title} | {' '.join(one.suffixes)} | {one.gives} | {one.needs or '(complete)'} |"
        for one in _SPECIFICATIONS
    ],
    "    MASK": [f"    {MASK}"],
    "NOT VERIFIED": [
        f"- `{one.name}` ({one.source}): {'; '.join(one.unverified) or 'complete'}." for one in _SPECIFICATIONS
    ],
}
for _mark, _lines in _GENERATED.items():
    __doc__ = (__doc__ or "").replace(f"\n{_mark}\n", "\n" + "\n".join(_lines) + "\n", 1)
