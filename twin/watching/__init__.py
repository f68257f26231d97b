"""Watch a folder of short check measurements: which error changed, since when, is it temperature, is the calibration still good.

    twin watch checks --calibration mine.yaml --tolerance 0.02 --html watch.html

Each `.csv` file of the folder is a measurement table of the same machine (`twin doc files`): probed spheres, ball bars, R-tests, a
few points of a tracker. Repeat the same short check every few days, or every shift. `twin.watch(folder, machine, calibration)` does
the same from a script. The exit status is 3 if an error changed, or if the calibration is proven to be out of tolerance.

**Date.** A comment of the table gives it (`# measured 2026-03-02 08:10`, `# date: 2026-03-02`), else an ISO date in the file's name
(`spheres_2026-03-02.csv`), else `--date FILE=DATE`. The file system's time is never used, because copying a file changes it.

**Deviations.** For each check the scales, squareness errors and axis locations of the axes that it moves are estimated as deviations
from the calibration, together with the places of spheres and stations, which are set up anew each time. Error motions are those of
the calibration. What the readings of a check do not determine is named, and a change of it is not seen. Every error is compared with
its own history: a constant difference between the checks and the calibration is no change. Checks with other instruments have a level
of their own. The repeatability (standard deviation between checks, set-up included) is estimated from the checks; about five are
needed before a change can be found.

**Alarm rate.** An unchanged machine gives an alarm in at most one watch of twenty (`--alarm-rate`), whatever the number of checks and
of looks. The test statistic is an e-process (`twin.watching.evidence`, with sources): the likelihood ratio of a step or drift since
any date to no change, with unknown level and repeatability. Its limit needs no number of looks in advance. The alarm rate is spent
over the possible dates of the change, and divided over all constant errors of the machine and two tests. The bound is exact if the
deviations are independent and normal with the same repeatability; where checks with instruments of different noise are mixed, or
files with older dates come later, it holds approximately. Running the watch again without new files is not a look.

Two departures are allowed for. One check far off is no evidence by itself: its likelihood with an inflated variance counts as one of no
change. The correlation of the deviations from one check to the next (slow variations that no temperature column follows) is estimated
from all errors together, and the deviations are whitened with it; the bound is then as good as that estimate. False alarms in drawn
watches of 14 errors with 30 looks, at a rate of 5 % (500 of each): independent normal deviations below 1 %; Student's t with 4 degrees
of freedom 0.4 % (without the allowance up to 23 %, by single series); correlation 0.3: 1.2 % (7 %); 0.5: 3 % (54 %); 0.3 with heavy
tails 1 % (30 %). The price: a step of four times the repeatability is found within eight checks in 80 %, of six within five in 95 %, of
eight within three in 93 % of the watches; with correlation 0.3 in 57 %, 77 % and 87 %.

**Since when.** The date is the most likely one, with a 95 % interval from the profile likelihood (Hansen 2000); the size is given
with U (95 %, Student). A step and a drift are both tried, and the report states if they are about equally likely. One change of each
error is sought. After a repair or a new calibration begin a new watch: `--since DATE`, or the new calibration.

**Temperature.** The columns `T_<sensor>_degC` are averaged over each check. An error changed only if that is evident even if any one
of the sensors may have any linear influence. If a sensor explains the series better than any step or drift (likelihood ratio 20), the
error follows it, with its coefficient; that is no alarm. If time and temperature changed together, the verdict is undecided, which is
an alarm. Sensors must be given in four of five checks and vary by 0.2 K. Combinations of sensors and delays are not considered.

**Calibration.** With `--tolerance` the deviations at the last check are applied to the machine, and the error at the tool that
remains with the calibration is evaluated over the volume, after aligning the workpiece, as `twin compare` does. Yes or no is stated
only if the uncertainty leaves no doubt (ISO 14253-1). The instrument's uncertainty of one check is not reduced by the number of
checks, because it may be common to all. Errors that the checks do not determine are not included. This judgement is made at every
look with 95 %; the alarm rate does not cover it.

**Memory.** `FOLDER.watch.sqlite` beside the folder keeps the SHA-256, the date and the estimates of every file that was read, and all
statements. A file that changed or vanished since then is named, and what was read is still used. A copy of a file is not counted
twice. Another calibration, first day or alarm rate is another watch in the same file.
"""

from twin.watching.change import Change, ErrorSeries, TemperatureEffect, WatchedError
from twin.watching.check import Check
from twin.watching.result import Watch
from twin.watching.watch import WatchSettings, watch
from twin.watching.words import text_of

__all__ = [
    "Change",
    "Check",
    "ErrorSeries",
    "TemperatureEffect",
    "Watch",
    "WatchSettings",
    "WatchedError",
    "text_of",
    "watch",
]
