"""Compensation tables of the machine's own control: made from a calibration, read back, and counted in with programs.

    twin control --to siemens -o tables/ --tool-length 120
    twin control --to linuxcnc -o tables/ -c mine.yaml --at Y=225 Z=-200 --tolerance 0.0005 --json tables.json
    twin control --read X.comp Y.comp joints.ini --format linuxcnc -c mine.yaml

The folder gets the files the control reads, `README.txt` (how to load them and switch them on, what they leave) and
`calibration.yaml`: the same errors, and what the control now takes out of them by itself. **Compensate programs with that file
and no other** while the tables are on, or the same errors are taken out twice.

| format | carries | leaves |
|---|---|---|
FORMATS

**What a table says.** Corrections are worked out from the machine's own kinematics, not from signs: with the errors of one axis
alone the point is off by δ, and the linear axes undo it by −J⁻¹δ, on whichever side of the machine they stand; a rotary axis
undoes its own E_BB or E_CC. With one linear axis or two, what lies along them is undone, and what of an error no axis can undo is
said; `isg` and `grid` want three. Linear axes that move the point the same way are refused.

A table of one axis over another is right only where the other axes and the tool are as they were taken: the middle of the linear
ranges, or `--at`. An angular error makes its angle times the distance from there elsewhere; the products of `siemens` carry that,
and so do `isg` and `grid`.

**Nodes** stand in equal steps, as few as keep the model within `--tolerance` of the straight lines between them (1 µm; 2 µrad a
µm of a rotary axis; a grid 5 µm), or at most `--step` apart. Every file is read back from its text and compared with the model
at places drawn: no farther off than between the nodes plus half of the last digit, or the exit status is 3.

**What remains** is printed for the machine at hand: point and tool axis over the volume as it is, with the tables, with a
compensated program on top; and every error of the calibration with whether it is taken out. These are the model's figures. U (95 %) of
the point stands beside them, from the calibration's covariance, and the RMS to be expected with it; where the calibration gives no
covariance they are unknown. `twin report` gives the same figures for `siemens`, `heidenhain` and `linuxcnc` at the same tool
length, the other axes in the middle of their ranges. Warnings of where the numbers come from stand in the comments of every file.

**Errors measured with tables on** (`control: errors_are: remaining`) are what those leave. New tables in their place would lose
what they take out, and are refused; `--add` writes old and new together, on the nodes of the old ones. `calibration.yaml` then
names the new part alone (`added/`): its errors are those left under the old tables. Where the errors are `uncorrected`, new
tables take the place of the old ones.

**Another tool.** Tables of axes and the grid move the axes by the same whatever tool is in: with a longer one they leave more, the
model knows it, and a program is corrected for that. The control of `isg` counts the active tool in, and so does the model. Errors
measured with its tables on hold for the tool that was active then; every account of them says so.

**What was not checked** against a public description of a control is said in the module of its format
(`help(twin.machine.control.formats.siemens)`), and again beside every table that is written. One sign the wrong way round
doubles an error: the text says how to try a table before anything is cut.

    from pathlib import Path
    from twin.machine.calibration import Calibration
    from twin.machine.control import read_tables
    from twin.control import Request, account_of, make
    from twin.machine.machine import Machine

    machine = Machine.load("dmu50")
    errors = Calibration.default(machine)
    made = make(machine, errors, Request("siemens", tool_length_mm=120.0))
    text = account_of(made, errors, errors, {}).to_text()
    tables = read_tables("siemens", [Path("cec.mpf")], machine)
    tables.shift("X", {"X": 100.0, "Y": 0.0, "Z": -50.0, "B": 0.0, "C": 0.0})    # µm
"""

from twin.machine.control.correction import BasicClass, Content, Correction
from twin.machine.control.curve import ControlCurve, ControlTerm, Terms
from twin.machine.control.format import TableFormat
from twin.machine.control.formats import FORMATS, format_named, read_tables
from twin.machine.control.section import ControlSection, TableEntry

__all__ = [
    "FORMATS",
    "BasicClass",
    "Content",
    "ControlCurve",
    "ControlSection",
    "ControlTerm",
    "Correction",
    "TableEntry",
    "TableFormat",
    "Terms",
    "format_named",
    "read_tables",
]

_ROWS = "\n".join(f"| `{form.name}` {form.what} | {form.carries} | {form.leaves} |" for form in FORMATS)
__doc__ = (__doc__ or "").replace("FORMATS\n", f"{_ROWS}\n", 1)
