"""From measured points to error motions, with their uncertainty.

    twin simulate thesis_plan.csv -o measured.csv --seed 7
    twin identify measured.csv -o mine.yaml --json identified.json

The first measures the illustrative machine as the thesis measured the real one; with a table of your own, start at the second.
It takes some ten seconds and asks neither where the tracker stood nor where the reflectors sat. `notebooks/01_identify.ipynb`
goes through the result in pictures (`twin.identification.plots`, extra `plots`).

**The report, from the top.** What is left, against what the instrument is good for: reduced chi² is one where the model and the
stated uncertainty hold. Repeats alone say whether the instrument is as good as stated; lack of fit, whether something the model
leaves out comes back at the same place. One line judges the two; where it complains, the intervals below do not cover what it
complains of. Then each error with its largest value and the half width of its widest 95 % interval, how many orders it was
given, and the held-out error beside that of degree 8 (for this curve, the others as chosen). Then what is not identifiable and
why, and every row set aside with line and reason (exit status 3).

**The estimate.** Whitened nonlinear least squares of all readings at once: error motions, squareness, locations, stations and
targets. Every reading is weighted by its own uncertainty (`u_x_mm …`, else the instrument's model at that place), derivatives
are analytic, no covariance is scaled by chi². The datum is the machine's own: x is X's mean line, the xy-plane holds Y's.

- No curve has a constant: it is the axis's zero, a location, or the place of the targets.
- No straightness has a slope: the line is least squares over the range, and its direction is squareness. Two curves from two
  set-ups compare as they are.
- What a shift or tilt of all that a rotary axis carries would do (first harmonics of E_X with E_Y, and of E_A with E_B, that
  turn with it) is no error motion.

How many functions a curve gets is chosen curve by curve, by the error on a round and positions held out together; part of a
turn may have powers or harmonics, whichever predicts better. A low order is no claim of zero: what may lie beyond it is
estimated from how the curve's own coefficients fall, and the intervals allow for it. A few wrong points do not pull: robust
weights find them, a false alarm comes in one data set of a hundred, and the final estimate is least squares without them.
`--uncertainty` says whose scatter the intervals carry: the readings' stated one, that of their `repeats`, or the one `'between
poses'`, for data in which the model leaves something out. `--only` takes all errors it does not name as zero.

**Not identifiable** means that these data look the same with and without it, however large it is. It is left out, not set to
zero with a small uncertainty. Most often: reflectors of unknown place move with the table, so where B and C lie in X and Y
needs their places (`place_x_mm …`) or a reference on the machine.

**Uncertainty at the tool.** U is the radius within which 95 % of a normal error of the point lies: not twice a standard
deviation, which in space covers less. `twin info -c mine.yaml` gives each error's peak with its standard uncertainty, and U
of the tool point over the volume with the place of the largest. `compensate` prints the correction ± U, lists the blocks whose
correction is no larger than its own U and does not call them improved; in JSON all of it is under `uncertainty`. Where a
calibration gives no covariance, U is unknown, never zero. U covers the calibration's own numbers only: no repeatability, no
temperature, no rounding.
"""

from twin.identification.identify import identify
from twin.identification.result import Identification, Unidentified

__all__ = ["Identification", "Unidentified", "identify"]
