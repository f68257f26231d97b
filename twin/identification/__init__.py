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
are analytic, no covariance is scaled by chi². A station may ride on the tool or the table (column `station_carrier`: `base`, `tool`
or `work`); its readings are then in the frame of that side. The datum is the machine's own: x is X's mean line, the xy-plane holds Y's.

- No curve has a constant: it is the axis's zero, a location, or the place of the targets.
- No straightness has a slope: the line is least squares over the range, and its direction is squareness. Two curves from two
  set-ups compare as they are.
- What a shift or tilt of all that a rotary axis carries would do (first harmonics of E_X with E_Y, and of E_A with E_B, that
  turn with it) is no error motion.

How many functions of a curve the readings support is chosen curve by curve, by the error on a round and positions held out together;
part of a turn may have powers or harmonics, whichever predicts better. The estimate takes no function as zero and none as free: each
has a prior whose size and fall are integrated over (`twin.identification.priors`). So a curve within the noise has an interval that
allows for what it may still hold, and a low order is no claim of zero.

**Outliers.** A few wrong points do not pull: robust weights find them, a false alarm comes in one data set of a hundred, and the
final estimate is least squares without them. A point is compared with the points of its target from its station. Where most of
these miss by more than the instrument's noise, the model is what is wrong: they stay in, and only what stands out of them is set
aside. The RMS over all rows stands beside that over the rows used.

`--uncertainty` says which scatter the intervals carry: the stated uncertainty of the readings, that of their `repeats`, or the scatter
`'between poses'` or `'between rounds'`, for data in which the model leaves something out. `--only` takes all errors it does not name
as zero.

**The file is the fit.** The calibration is written, read back and evaluated on the rows; the residuals of the report are those of
the file. Where the model leaves something out, an error that the readings hardly show would be fitted to the misfit. It has a weak
prior instead: a standard deviation of 1000 µm or µrad, or what the machine file says:

    plausible:
      motion: {um: 200, urad: 200}
      location: {um: 5000, urad: 5000}      # and squareness

**Not identifiable** means that these data look the same with and without an error, however large it is. Where only stations and
targets can take its place, it is left out. Where it can be exchanged for other errors, all of them stay in the calibration, held by
their priors: their sum is known, and the covariance says that each by itself is not. Most often reflectors of unknown place move with
the table, so where B and C lie in X and Y needs their places (`place_x_mm …`) or a reference on the machine.

**Uncertainty at the tool.** U is the radius within which 95 % of a normal error of the point lies: not twice a standard
deviation, which in space covers less. `twin info -c mine.yaml` gives each error's peak with its standard uncertainty, and U
of the tool point over the volume with the place of the largest. `compensate` prints the correction ± U, lists the blocks whose
correction is no larger than its own U and does not call them improved; in JSON all of it is under `uncertainty`. Where a
calibration gives no covariance, U is unknown, never zero. U covers the calibration's own numbers only: no repeatability, no
temperature, no rounding.

**The stages**, in `twin.identification.identify`; each takes the values before it and returns one.

1. `inputs.prepared`: measurements → `Placed`: rows that fit their commands, the instrument, and stations and targets to start from.
2. `determined.determined`: → `Determined`: the unknowns that the data determine, one model for each family of curves.
3. `robust.robust_start`: → `Start`: an estimate that a few wrong points do not pull.
4. `orders.choose`: → `Choice`: how many functions of each curve the held-out readings support.
5. `priors.prior_precision`: → how firmly each function is held about zero.
6. `robust.without_outliers`: → `Estimate`: least squares (`solve.solve`) without the outliers.
7. `spread.covariance_of`: → its covariance.
8. → `Identification`: the calibration, what is not identifiable, and the residuals of the calibration.
"""

from twin.identification.identify import identify
from twin.identification.result import Identification
from twin.identification.unidentified import Unidentified

__all__ = ["Identification", "Unidentified", "identify"]
