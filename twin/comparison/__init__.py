"""Compare two calibrations of one machine: which errors changed, which changes are significant, and their effect at the tool.

    twin compare last_year.yaml this_year.yaml --tool-length 120 --tolerance 0.01 --json changes.json

Use it for the yearly check, after a collision, or to detect drift. `twin.compare(older, newer)` does the same from a script; its
result has every number, `twin.comparison.text_of` puts it into words. The verdict is `changed`, `unchanged`, `same` (identical
numbers), `reworded` (the numbers changed but the tool position did not: changes of several errors cancel) or `unknown`. The exit status
is 0 whatever changed, and 3 if an error could not be compared or tested; all of these are listed.

**What is compared.** Curves are compared as functions over the common part of both domains, whatever their basis and degree;
squareness, locations and the parameters of `effects:` as numbers. An error that only one calibration contains is not compared, because
a missing error is not a zero error. A change without an uncertainty on both sides is `unknown`, neither significant nor zero; so is a
change in a direction for which neither gives an uncertainty, such as a constant fixed by a convention. The two calibrations are taken
as independent of each other, except for errors with identical numbers. Two calibrations that relate differently to the control's
compensation tables, or that were measured under different tables, are refused.

**What is significant.** The same change is tested in four ways, and an unchanged machine is called changed in at most one comparison of
twenty over all four together: χ² of all numbers; each error by itself with the others free (Holm's correction); the smallest set of
errors that explains the whole change, the others taken as unchanged; the tool point over the volume. The third is the most sensitive
if few errors changed: a measurement in which errors are strongly correlated gives each a large uncertainty by itself. Errors that
would explain the change equally well are named as alternatives. On two identifications of `thesis_plan.csv` a squareness E_C0Y known to
± 38 µrad (95 %) by itself is detected from a change of 12.9 µrad on if nothing else changed. For an unchanged machine, the account
gives this detection limit for each number.

**At the tool.** The change of the tool point over 400 poses: RMS, maximum and its position, with its expanded uncertainty U, and for
each RMS the limit it stays below by chance. It is given as it is, and after aligning the workpiece: without the common shift and
rotation that touching off the workpiece removes. It is also given by class of ISO/TR 16907 and error by error. Then follows the error
that remains if the older calibration compensates the machine described by the newer one. With `--tolerance` the comparison says whether
that is good enough: yes or no only if the uncertainty leaves no doubt (ISO 14253-1); the exit status is 3 if it is not.

**What it means.** Sentences name what the changed errors have in common, if anything: one axis, all scales alike, squareness only, the
location of a rotary axis. They say where to look first; they do not know the cause.

The covariances are used as stated. They contain neither a misfit reported by `twin identify` nor errors common to both
measurements, such as the scale error of the same instrument or the same temperature.
"""

from twin.comparison.compare import compare
from twin.comparison.result import Changes, Culprits, ErrorChange
from twin.comparison.text import text_of
from twin.comparison.tool import DisplacementSize, Remaining, ToolChange, ToolDisplacement

__all__ = [
    "Changes",
    "Culprits",
    "DisplacementSize",
    "ErrorChange",
    "Remaining",
    "ToolChange",
    "ToolDisplacement",
    "compare",
    "text_of",
]
