"""Compensation: a program in, the program out that lands where the first one meant.

    twin compensate cone_frustum.nc -o out.nc --tool-length 120 --report out.txt --json out.json

- **ISO** (`.nc .ngc .tap .mpf .txt .iso .eia`), **Heidenhain plain language** (`.h`), **APT** cutter locations (`.cls .apt`;
  `-o x.nc|x.h` posts them as axis words). Everything that is not a motion word passes through byte for byte; every block
  carries every word that changed. Warnings of where the calibration's numbers come from (`twin doc files`) stand at the head in
  comments of the language, behind tape mark and program number, `BEGIN PGM` or `PARTNO`; once, however often it is compensated.
- `--mode axis` (default): words are axis positions after adding `--work-offset`. `--mode tcp`, or where the program switches it
  on itself (`G43.4`, `G43.5`, `TRAORI`, `M128`, `FUNCTION TCPM`, words the machine file names): words are tool-tip coordinates
  in the work frame (table centre, moved by `--work-origin`) with B and C or a tool vector. In mode axis what the control adds
  to a word (`G54`, `G43 H`) goes into `--work-offset`.
- `--scope` takes classes of ISO/TR 16907: `L-POS L-STR L-SQU L-ANG L-VOL L-VOL+ R-POS R-RAX R-POR R-ANG R-VOL R-VOL+ FOR`. The
  functional point is corrected by the linear axes; the functional orientation (`FOR`) by the rotary ones, `R-POS` by the axis
  itself. The default is everything the program can carry: a program that never names a rotary axis gets no rotary words. For
  positioned (3+2) work with clamped rotary axes say `--scope L-VOL R-VOL` without `R-POS` (`L-VOL R-RAX R-POR R-ANG`), and B
  and C stay as written.
- Rotary words are rounded first and the linear axes solved for what was rounded, so that only the linear words' own rounding (≤
  0.9 µm) is left.
- Blocks are split only where the error between their ends would exceed `--tolerance` (1 µm); arcs become chords within it. A
  straight block that leaves an axis's range is left as written and listed; an arc that does is refused, since it cannot be left as
  written between compensated neighbours.
- The account names what is not corrected, one line a reason, with the number of blocks and the worst. Exit status 3: the point of a
  cutting block stays off by more than `--tolerance` (and the rounding), an orientation that `--scope FOR` asked for is not reached, or
  nothing could be corrected at all; `--strict`: anything is listed.
- Near B = 0 turning C repairs nothing: no rotary axis moves further than `--rotary-limit` (0.5°) for an orientation, C stays
  continuous, the point is reached all the same and the orientation left is listed.

What `--method thesis` leaves (Ellingsdalen 2021, listings 3.1–3.4 as they run) beside ours, on the same machine, µm at the
tool, RMS / max, dense points between blocks included (`python -m tests.benchmarks.figures`):

| program | before | thesis | ours | of which rounding |
|---|---|---|---|---|
| X = 50 … 450 at Y 225, Z −200, tool 120 mm | 82.95 / 115.96 | 68.54 / 103.57 | 0.53 / 0.96 | ≤ 0.74 |
| cone frustum, tool 120 mm | 67.68 / 83.60 | 58.28 / 81.59 | 0.43 / 1.22 | ≤ 0.81 |
| X = 50 … 500 at Y = Z = 0 (figure 3.11) | 28.30 / 36.81 | 23.38 / 36.34 | 21.75 / 30.95 | – |
| errors identified first: 27 points over X, Y, Z | 78.1 / 145.3 | 93.9 / 169.5 | 18.9 / 39.6 | – |
| errors identified first: 40 poses of five axes | 65.7 / 147.7 | 97.4 / 169.1 | 14.7 / 35.0 | – |

The third row stands at the ends of Y and Z: the correction asks for Y < 0 and Z > 0, which the axes do not have; the report
lists each such block. The first three rows know the errors; the thesis's method, which has no locations of rotary axes, as they
were drawn (`twin.samples.dmu50_calibration.as_drawn`), ours in mean lines. The last two know what one simulated tracker saw of them
(`thesis_plan.csv`, seed 7), identified by either method; they are judged by a machine that shares no code with `twin`, at the
block ends, tool 120 mm, after touching off tool and workpiece.
"""

# The way of a program, stage by stage; `Compensator.compensate` goes it with a program in memory, `stream` with one of any length.
#
#   program          twin.nc                      bytes                  → Program
#   blocks           Dialect.moves                Program                → Reading
#   tool path        toolpath.follow              Reading                → Path
#   pieces           solving.Pieces               Path                   → Pieces
#   what the machine would do, and its correction
#                    solving.corrected            Pieces                 → Corrected
#   written          solving.replacing, Dialect   Corrected              → NewPositions, text
#   checked          checked.check                NewPositions, read back
#   account          account.Account              Corrected              → Report
#
# `bench` has what is the same for every program: the machine, its errors, and what of these is to be corrected.

from twin.compensation.account import Report
from twin.compensation.bench import Options
from twin.compensation.compensator import Compensation, Compensator, compensate, compensate_file

__all__ = ["Compensation", "Compensator", "Options", "Report", "compensate", "compensate_file"]
