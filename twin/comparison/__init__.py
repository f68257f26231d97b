"""What changed between two calibrations of one machine, what of it is significant, and what it means at the tool.

    twin compare last_year.yaml this_year.yaml --tool-length 120 --tolerance 0.01 --json changes.json

For the yearly check, after a collision, for drift. `twin.compare(older, newer)` is the same from a script; its result has every
number, `twin.comparison.text_of` puts it into words. The verdict is `changed`, `unchanged`, `same` (the very same numbers),
`reworded` (the numbers changed and the tool did not: one error takes away what another adds) or `unknown`. The exit status is 0
whatever changed, and 3 if an error could not be compared or judged; all of these are listed.

**What is compared.** Curves as functions over what both domains have in common, whatever basis and degree they are written in;
squareness, locations and the parameters of `effects:` as numbers. An error only one of the two gives is not compared: saying nothing
is not the same as zero. What has no uncertainty on both sides is `unknown`, never significant and never zero; so is a change along what
neither gives an uncertainty for, a constant where the convention knows none. The two are taken as independent of each other, but for
errors with the very same numbers. Two calibrations that stand to the control's tables differently, or under other tables, are refused.

**What is significant.** Four looks are taken at the same change, and an unchanged machine is called changed in at most one
comparison of twenty over all of them together: χ² of all numbers at once; each error by itself, nothing assumed of the others
(Holm's correction); the fewest errors that account for everything, the others taken as unchanged; the tool over the volume. The
third is the sharp one where little has changed: a measurement that tells errors apart only badly gives each a large uncertainty by
itself, and what would do as well in an error's place is named. On two identifications of `thesis_plan.csv` a squareness E_C0Y
known to ± 38 µrad (95 %) by itself shows alone from 12.9 µrad on. An unchanged machine's account says from where on each number
would have shown.

**At the tool.** Change of the tool point over 400 poses, RMS, largest and where, with U there; beside each RMS what chance alone stays
below. As it is, and aligned anew: less the shift and turn of everything together that touching off the workpiece takes out. By class of
ISO/TR 16907, and error by error. Then what remains where the older calibration compensates the machine that the newer one
describes; with `--tolerance` whether that is good enough: yes or no only where the uncertainty leaves no doubt (ISO 14253-1).

**What it means.** The sentences say what those errors that changed have in common, if anything: one axis, all scales alike, squareness
alone, where a rotary axis lies. They say where to look first; they do not know what happened.

The covariances are taken as they are. A misfit that `twin identify` complained of is in none of them, nor is what both measurements
had in common: the same instrument's scale, the same temperature.
"""

from twin.comparison.compare import compare
from twin.comparison.result import Changes, Culprits, ErrorChange
from twin.comparison.text import text_of
from twin.comparison.tool import Displaced, Moved, Remaining, ToolChange

__all__ = ["Changes", "Culprits", "Displaced", "ErrorChange", "Moved", "Remaining", "ToolChange", "compare", "text_of"]
