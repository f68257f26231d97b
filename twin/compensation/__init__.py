"""Compensation: rewrite an NC program so that the machine, with its errors, follows the programmed path.

    twin compensate cone_frustum.nc -o out.nc --tool-length 120 --report out.txt --json out.json

**Languages.** ISO (`.nc .ngc .tap .mpf .txt .iso .eia`), Heidenhain plain language (`.h`) and APT cutter locations (`.cls .apt`;
`-o x.nc|x.h` posts them as axis words). Everything that is not a motion word passes through byte for byte; every block carries
every word that changed. Words may hold arithmetic with parameters (`X[#1+2]`, `X=R1*2`, `X+Q1`) that have a known value there.
Warnings on the origin of the calibration's numbers (`twin doc files`) are written as comments at the head of the program, after
tape mark and program number, `BEGIN PGM` or `PARTNO`; once only, however often the program is compensated.

**Set-up.** `--offsets` and `--tools` are the machine's own tables, from which the program selects (`G54`, `G54.1 P3`, `G505`, cycle
247; `T` with `M6`, `G43 H`, `D`, `TOOL CALL`):

    twin compensate part.mpf -o out.mpf --offsets uifr.ini --tools toa.ini

They are read as CSV (`offset,X_mm,Y_mm,Z_mm,B_deg,C_deg` and `tool,length_mm`, optionally `name`), LinuxCNC `.var` and `.tbl`,
SINUMERIK archives (`$P_UIFR`, `$TC_DP3`), Fanuc `G10` blocks, and Heidenhain `.pr` and `.t`. Offsets are those of the spindle
nose with the rotary axes at zero; lengths are measured from the nose. Every section of a program is corrected with its own offset
and tool; the report lists them. A program without a selection uses `G54`, or the only offset of the table, and the report says
so.

**Cycles, subprograms, tilted planes.** `G73`, `G81` to `G83`, `G85`, `G89`, `CYCLE81` to `CYCLE83`, `CYCLE85` and `CYCLE89` (with
`MCALL` or alone) are expanded into their strokes, with the original block in a comment. Between the steps of a deep hole a control
feeds from a distance above the bottom that only its parameters know; 0.5 mm is used. Threads (`G74`, `G84`, `CYCLE84`, `CYCLE840`)
stay with the control's cycle, at a corrected position. Subprograms in the same file or folder are written out in place of their calls
(`M98`, `G65`, LinuxCNC `o100 call`, SINUMERIK `NAME(..)`, `L100`, `CALL`, Heidenhain `CALL LBL`, `CALL PGM`), so the output needs none;
line numbers are those of the input files. In a tilted plane (`G68.2` with `G53.1`, `PLANE SPATIAL .. TURN|MOVE`, `CYCLE800`) the words
stay in the plane: linear axes are corrected, the rotary axes stay where the nominal kinematics puts them.

**Coordinates.** In `--mode axis` (default) the words are axis positions to which `--work-offset` is added; without the tables
above, offsets that the control adds (`G54`, `G43 H`) belong in `--work-offset`. In `--mode tcp`, or where the program switches it
on (`G43.4`, `G43.5`, `G234` of Haas, `TRAORI`, `M128`, `FUNCTION TCPM`, words named in the machine file), the words are tool-tip
coordinates in the work frame (origin at the table centre, moved by `--work-origin`), with B and C or a tool vector.

**What is not known.** A statement of unknown effect (`TRAOOF`, a G or M code of the machine's builder, a call of an unknown name) makes
positions, frame, offsets and modes unknown until every axis has an absolute position in machine coordinates (`G53`, `SUPA`, `M91`).
Blocks in between are left as written and listed; a feed among them is exit status 3. Harmless words of the builder belong in the
machine file (`programs: {harmless: [M51, AIRBLAST]}`). Without `--offsets` and `--tools` a second work offset, tool or tool length is
refused. Where the tool or its length changes, the position along the tool is unknown until an absolute word.

**Scope.** `--scope` takes classes of ISO/TR 16907: `L-POS L-STR L-SQU L-ANG L-VOL L-VOL+ R-POS R-RAX R-POR R-ANG R-VOL R-VOL+ FOR`.
The linear axes correct the functional point, the rotary axes the functional orientation (`FOR`), and each rotary axis its own
position (`R-POS`). The default is everything the program can carry: a program that never names a rotary axis gets no rotary words.
For positioned (3+2) work with clamped rotary axes use `--scope L-VOL R-VOL` without `R-POS` (`L-VOL R-RAX R-POR R-ANG`); B and C
then stay as written.

**Rounding.** Rotary words are rounded to the least increment first, then the linear axes are solved for the rounded values. Only the
rounding of the linear words remains (≤ 0.9 µm).

**Splitting.** A block is split only if the error between its end points would exceed `--tolerance` (1 µm); arcs become chords within
that tolerance. A straight block that leaves an axis's range is left as written and listed. An arc that does so is an error, because
it cannot be left as written between compensated neighbours.

**Limits.** Where the compensated position is beyond an axis's range, the axis stops at its limit. If the point is nearer with the
rotary axes as programmed, these stay so and the tool axis is listed as not corrected; if no position is nearer than the programmed one,
the block stays as programmed. So no point is farther off than before, apart from the least increment (`--method thesis` excepted).

**Singular poses.** Near B = 0, turning C does not change the orientation. No rotary axis moves by more than `--rotary-limit`
(0.5°) to correct an orientation, and C stays continuous. The point is still reached; the remaining orientation error is listed.

**Report and exit status.** The report lists what was not corrected, one line per reason, with the number of blocks and the worst
case. Exit status 3: the point of a cutting block remains out of `--tolerance` (plus rounding), an orientation requested by
`--scope FOR` is not reached, a feed goes to an unknown place, or nothing could be corrected at all; with
`--strict`, if anything is listed.

**Accuracy.** Error at the tool in µm, RMS / max, dense points between blocks included, compared with `--method thesis`
(Ellingsdalen 2021, listings 3.1–3.4 as they run) on the same machine (`python -m tests.benchmarks.figures`):

| program | before | thesis | twin | of this, rounding |
|---|---|---|---|---|
| X = 50 … 450 at Y 225, Z −200, tool 120 mm | 82.95 / 115.96 | 68.54 / 103.57 | 0.53 / 0.96 | ≤ 0.74 |
| cone frustum, tool 120 mm | 67.68 / 83.60 | 58.28 / 81.59 | 0.43 / 1.22 | ≤ 0.81 |
| X = 50 … 500 at Y = Z = 0 (figure 3.11) | 28.30 / 36.81 | 23.38 / 36.34 | 21.59 / 30.95 | – |
| errors identified first: 27 points over X, Y, Z | 78.1 / 145.3 | 91.2 / 162.3 | 11.3 / 26.8 | – |
| errors identified first: 40 poses of five axes | 65.7 / 147.7 | 86.3 / 161.2 | 9.2 / 19.9 | – |

The third row is at the limits of Y and Z: the correction needs Y < 0 and Z > 0, which the axes do not have; the report lists each such
block, and the exit status is 3. In the first three rows the errors are known. The thesis's method has no locations of rotary axes and
uses the curves as drawn (`twin.samples.dmu50_calibration.as_drawn`); `twin` uses them in the datum of mean lines. In the last two rows
each method identified the errors from one simulated laser tracker measurement (`thesis_plan.csv`, seed 7). These rows are evaluated at
the block end points by an independent machine model that shares no code with `twin`, tool 120 mm, after touching off tool and
workpiece.
"""

# Stages of a compensation; `Compensator.compensate` runs them on a program in memory, `stream` on one of any length.
#
#   program          twin.nc                      bytes                  → Program
#   blocks           Dialect.moves                Program                → Reading
#   tool path        toolpath.follow              Reading                → ToolPath
#   pieces           solving.Pieces               ToolPath               → Pieces
#   correction       solving.correct              Pieces                 → Corrected
#   output           solving.new_positions        Corrected              → NewPositions, text
#   check            checked.check                NewPositions, output read back
#   report           account.CompensationAccount  Corrected              → Report
#
# `prepared` holds what is common to all programs: the machine, its errors, and which of them are corrected.

from twin.compensation.account import Report
from twin.compensation.compensator import Compensation, Compensator, compensate, compensate_file
from twin.compensation.prepared import Options

__all__ = ["Compensation", "Compensator", "Options", "Report", "compensate", "compensate_file"]
