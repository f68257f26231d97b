"""Compensation tables of the machine's control: made from a calibration, read back, and taken into account for programs.

    twin control --to siemens -o tables/ --tool-length 120
    twin control --to linuxcnc -o tables/ -c mine.yaml --at Y=225 Z=-200 --tolerance 0.0005 --json tables.json
    twin control --kinematics siemens-chain --to siemens -o control/ --tool-length 120
    twin control --read X.comp Y.comp joints.ini --format linuxcnc -c mine.yaml

The folder receives the files for the control, `README.txt` (how to load and activate them, and the remaining errors) and
`calibration.yaml`: the same errors with a record of the active tables. **Compensate programs only with that file** while the tables
are active; otherwise the same errors are corrected twice.

| format | corrects | does not correct |
|---|---|---|
FORMATS

**Values of a table.** Corrections are calculated from the kinematics of the machine: the errors of one axis alone displace the
functional point by δ, and the linear axes, on either side of the machine, correct it by −J⁻¹δ; a rotary axis corrects its own E_BB or
E_CC. One or two linear axes correct only the part along them; the part that no axis can correct is reported. `isg` and `grid` need
three linear axes. Linear axes that move the point in the same direction are refused.

A table of one axis as a function of another is exact only at the assumed positions of the other axes (the middle of the linear
ranges, or `--at`) and the assumed tool length. Elsewhere an angular error causes an error of its angle times the distance from there;
the products of `siemens` correct this, and so do `isg` and `grid`.

**Nodes** are equidistant. Their number is the smallest for which the straight lines between them stay within `--tolerance` of the
model (1 µm; for a rotary axis 2 µrad per µm; for a grid 5 µm), or `--step` limits their distance. Every file is read back and compared
with the model at random positions. If the difference exceeds the interpolation error plus half of the last digit, the exit status
is 3.

**Remaining errors** are printed for this machine: of the functional point and the tool axis over the volume without tables, with the
tables, and with a compensated program in addition; and for every error of the calibration whether it is corrected. These are figures
of the model. They are given with U (95 %) of the point from the calibration's covariance and the expected RMS; without a covariance
both are unknown. `twin report` gives the same figures for `siemens`, `heidenhain` and `linuxcnc` at the same tool length, with the
other axes in the middle of their ranges. Warnings about the origin of the numbers are in the comments of every file.

**Not written.** A table is written only if it is shown to be an improvement: the RMS of its correction over the table exceeds the RMS
of the correction's U (95 %). A machine without that error would otherwise get a table in 19 of 20 cases. The account lists the others.
If the calibration says that it could not determine the error, the exit status is 3; if no table is left, it is 2: nothing is written.
`--force` writes them all, with the warning in the files. Without a covariance U is unknown and every table is written.

**Errors measured with active tables** (`control: errors_are: remaining`) are the errors that remain with those tables. New tables
instead of them would lose their corrections and are refused; `--add` writes the sum of old and new tables, on the nodes of the old
ones. `calibration.yaml` then names only the added part (`added/`), because its errors are those remaining with the old tables. If the
errors are `uncorrected`, new tables replace the old ones.

**Other tools.** Tables of axes and the grid apply the same corrections with every tool; a longer tool leaves larger errors, which the
model includes and programs are corrected for. The control of `isg` uses the length of the active tool, and so does the model. Errors
measured with its tables active are valid for the tool that was active then; every report on them states this.

**Kinematics of the transformation** (`--kinematics`, with or without `--to`). In tool centre point mode a control calculates the
linear axes from the lines of its rotary axes. The location errors of the calibration (`E_X0C` …) give these lines and the place of
the workpiece on the table:

| format | holds | does not hold |
|---|---|---|
KINEMATICS

Kinematics are refused if the calibration says that a location was not identified (with a tracker: targets at unknown places). The file
would hold the nominal value for it and overwrite what the control's own cycle has calibrated. `--force` writes the file, with the
warning in it.

The machine needs a table with two rotary axes. Other machines are refused, and so are those that a transformation cannot represent
(`linuxcnc-trt` needs A about X or B about Y). A format that does not hold everything gets the values with the least sum of squares of
the remaining displacement of the functional point, over the volume and with this tool; the account states what remains. Linear axes
are written as square: squareness is left to the tables, which also act without a transformation. Tables of `isg` correct locations
themselves and cannot be combined with kinematics.

The account gives the error of the point in tool centre point mode with nominal kinematics, with the kinematics, with the tables, and
with a compensated program in least increments, each with U, from the files as read back. `calibration.yaml` records the file. A
program is compensated for the kinematics only with `--mode tcp`: in axis coordinates they do not act. A program that switches the
mode is refused with such a calibration: split it. The shift of the workpiece zero is part of the kinematics; probing the workpiece
afterwards replaces it.

**Unverified assumptions**, which were not checked against a public description of a control, are listed in the module of its format
(`help(twin.machine.control.formats.siemens)`) and with every table that is written. One wrong sign doubles an error: the text
explains how to test a table before machining.

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

from twin.control.account import Account
from twin.control.deliver import account_of, outputs_of, write_folder, written_by
from twin.control.design import Table
from twin.control.existing import Existing, compare_tables
from twin.control.kinematics import (
    KinematicsAccount,
    KinematicsRequest,
    ReadKinematics,
    compare_kinematics,
    kinematics_outputs,
    kinematics_written,
    make_both,
    write_kinematics,
)
from twin.control.make import ControlTables, make
from twin.control.remains import CorrectedShare, RemainingErrors, VolumeError
from twin.control.request import Request
from twin.machine.control import kinematics_formats, table_formats

__all__ = [
    "Account",
    "ControlTables",
    "CorrectedShare",
    "Existing",
    "KinematicsAccount",
    "KinematicsRequest",
    "ReadKinematics",
    "RemainingErrors",
    "Request",
    "Table",
    "VolumeError",
    "account_of",
    "compare_kinematics",
    "compare_tables",
    "kinematics_outputs",
    "kinematics_written",
    "make",
    "make_both",
    "outputs_of",
    "write_folder",
    "write_kinematics",
    "written_by",
]

_KINEMATICS = "\n".join(
    f"| `{form.name}` {form.title}: {form.what} | {form.carries} | {form.leaves} |" for form in kinematics_formats()
)
_ROWS = "\n".join(f"| `{form.name}` {form.what} | {form.carries} | {form.leaves} |" for form in table_formats())
__doc__ = (__doc__ or "").replace("FORMATS\n", f"{_ROWS}\n", 1).replace("KINEMATICS\n", f"{_KINEMATICS}\n", 1)
