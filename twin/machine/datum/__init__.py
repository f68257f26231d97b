"""The datum of a calibration: how the same machine can be written in different numbers, and how to compare them.

Errors of neighbouring axes can stand for each other. A mean rotation of X's carriage (the mean of E_CX) turns everything the carriage
bears. A squareness E_C0Y of Y's line, with the location of the next rotary axis and a turn of the tool, moves the tool in the same way.
A slope of a straightness, a constant of a curve, and a shift or tilt of what a rotary axis carries are of the same kind. No measurement
of the tool can decide between such descriptions. So the numbers of a calibration mean something only with the rule that was used: its
datum, `datum:` in the file.

- `mean lines` (what `twin identify` writes): the reference line of every linear axis is its least-squares mean line over the range
  (ISO 230-1, 3.4.12). A straightness has no mean and no slope, an angular or positioning curve has no mean. Squareness is the angle
  between mean lines, and a location says where the mean line of a rotary axis lies. The curves of a rotary axis contain no fixed shift
  and no fixed tilt of what turns with the axis: these belong to the next axis or to the workpiece.
- `end points`: the same, but the reference line of a straightness passes through the two ends of its curve.
- `as given`: neither of them. So are files without the entry whose numbers fulfil no rule, for example those made by other programs.

The entry is checked when the file is read; a file whose numbers contradict it is refused. A file without it gets the datum that its
numbers fulfil.

`twin info` says which datum a calibration is in, and writes the same machine in another one:

    twin info --calibration mine.yaml
    twin info --calibration mine.yaml --datum 'mean lines' --output lines.yaml

A conversion keeps the pose of the tool in the work frame: the two calibrations agree to 1 nm and 1 nrad at every position. A covariance
is carried along. Effects under `effects:` keep their numbers; where they are present, the agreement is up to the effect times the
angle that was moved (50 µm times 100 µrad: 5 nm). Each rule holds as far as another entry can take the amount over. What
nothing else can take over stays in the curves of the last axes: a mean tilt of the spindle in E_AZ, the place of the workpiece on
the last rotary axis, and on a machine without rotary axes the zeros of the scales and the direction of the machine frame. Curves get
more coefficients where the converted curve needs them: a fixed shift of what a rotary axis carries is a cosine of its angle, and takes
about twelve powers over half a turn. Curves of one axis with different domains are converted over their common part.

`twin compare` and `twin report` use mean lines for every calibration, and say so.

How it works: between two neighbouring axes any small, fixed motion G can be inserted together with its inverse. One neighbour's error
frame takes G, the other one takes the inverse. The motions, the squareness errors and the locations are chosen so that the conditions
of the datum hold, in the order of `twin.machine.datum.conditions`; the error frames are then computed without approximation
(`twin.machine.datum.links`), and the curves are fitted to them (`twin.machine.datum.convert`).
"""

from twin.machine.datum.conditions import AS_GIVEN, DATUMS, END_POINTS, MEAN_LINES, MEANING, Datum
from twin.machine.datum.convert import Converted, convert, datum_of, violation
from twin.machine.datum.links import Numbers

__all__ = [
    "AS_GIVEN",
    "DATUMS",
    "END_POINTS",
    "MEANING",
    "MEAN_LINES",
    "Converted",
    "Datum",
    "Numbers",
    "convert",
    "datum_of",
    "violation",
]
