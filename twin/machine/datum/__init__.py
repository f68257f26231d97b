"""The datum of a calibration: different numbers can describe the same machine; this is how to compare them.

Errors of neighbouring axes can be equivalent. A mean rotation of X's carriage (the mean of E_CX) turns everything that the carriage
bears. A squareness E_C0Y of Y, together with the location of the next rotary axis and a rotation of the tool, moves the tool in the
same way. The same applies to a slope of a straightness, a constant of a curve, and a shift or tilt of the parts on a rotary axis. No
measurement of the tool can distinguish such descriptions. The numbers of a calibration are therefore meaningful only together with
the convention that was used: its datum, `datum:` in the file.

- `mean lines` (what `twin identify` writes): the reference line of every linear axis is its least-squares mean line over the range
  (ISO 230-1, 3.4.12). A straightness has no mean and no slope, an angular or positioning curve has no mean. Squareness is the angle
  between mean lines, and a location is the position or orientation of a rotary axis's mean line. The curves of a rotary axis contain no
  fixed shift and no fixed tilt of the parts that turn with it: these belong to the next axis or to the workpiece.
- `end points`: the same, but the reference line of a straightness passes through the two ends of its curve.
- `as given`: neither of them. This applies to files without the entry whose numbers fulfil neither rule, for example files made by
  other programs.

The entry is checked when the file is read; a file whose numbers contradict it is refused. A file without the entry gets the datum
that its numbers fulfil.

`twin info` shows the datum of a calibration and converts it to another one:

    twin info --calibration mine.yaml
    twin info --calibration mine.yaml --datum 'mean lines' --output lines.yaml

A conversion keeps the pose of the tool in the work frame: the two calibrations agree to 1 nm and 1 nrad at every position. A covariance
is converted too. Effects under `effects:` keep their numbers; with such effects the difference is up to the effect times the angle
that was transferred (50 µm times 100 µrad: 5 nm). Each condition is fulfilled if another entry can absorb the amount. Amounts that no
other entry can absorb stay in the curves of the last axes: a mean tilt of the spindle in E_AZ, the position of the workpiece on the
last rotary axis, and on a machine without rotary axes the zeros of the scales and the direction of the machine frame. A converted
curve gets more coefficients if necessary: a fixed shift of the parts on a rotary axis is a cosine of its angle, which needs about
twelve powers over half a turn. Curves of one axis with different domains are converted over their common part.

`twin compare` and `twin report` convert every calibration to mean lines and state this.

Method: between two neighbouring axes any small, fixed motion G can be inserted together with its inverse. The error frame of one
neighbour absorbs G, that of the other the inverse. The motions, the squareness errors and the locations are chosen so that the
conditions of the datum hold, in the order of `twin.machine.datum.conditions`; the error frames are then computed without
approximation (`twin.machine.datum.links`), and the curves are fitted to them (`twin.machine.datum.convert`).
"""

from twin.machine.datum.conditions import AS_GIVEN, DATUMS, END_POINTS, EXPLANATION, MEAN_LINES, Datum
from twin.machine.datum.convert import Converted, convert, datum_of, violation
from twin.machine.datum.links import Numbers

__all__ = [
    "AS_GIVEN",
    "DATUMS",
    "END_POINTS",
    "EXPLANATION",
    "MEAN_LINES",
    "Converted",
    "Datum",
    "Numbers",
    "convert",
    "datum_of",
    "violation",
]
