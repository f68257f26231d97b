"""Error motions, squareness and axis locations from measured points, with their uncertainty.

    twin simulate thesis_plan.csv -o measured.csv --seed 7
    twin identify measured.csv -o mine.yaml --json identified.json

The first command simulates the thesis's measurement on the illustrative machine; with a table of your own, start at the second. It
takes some ten seconds and needs neither the pose of the tracker nor the places of the reflectors. `notebooks/01_identify.ipynb`
shows the result in plots (`twin.identification.plots`, extra `plots`).

**The report, from top to bottom.**

1. Residuals compared with the noise. The reduced chi² is one if the model and the noise hold; the lack-of-fit test shows whether there
   are residuals that repeat, which the model does not describe. One line gives the RMS at held-out poses, in micrometres: every fifth
   pose is predicted from the others. If the model has a discrepancy, one line gives its size. One line gives the verdict.
2. Each error with its peak value, the half width of its widest 95 % interval, the degree of its curve, and the held-out error next to
   that of degree 8 (for this curve, with the other curves as chosen).
3. Errors that are not identifiable, with the reason, and every row that was set aside, with its line and reason (exit status 3).

**The estimate** is a whitened nonlinear least-squares fit to all readings at once: error motions, squareness, axis locations, poses of
the stations and places of the targets. Every reading is weighted with its own uncertainty (`u_x_mm …`, otherwise the instrument's
model). Derivatives are analytic. No covariance is scaled by chi². A station may ride on the tool or the table (column
`station_carrier`: `base`, `tool` or `work`); its readings are then in the frame of that side. The datum is the machine's own: x is the
mean line of X, and the xy-plane contains the mean line of Y.

**The noise.** A tracker that measures absolute lengths is ten times worse along its beam than one that counts fringes, and air in a
workshop can be worse than both. Where repeats vary more than the noise that the instrument or the table states (chi² of repeats,
p < 0.001, ten degrees of freedom or more; lost readings left out), their standard deviation is taken for the weights and the
intervals, and the report says so. If there are too few repeats, and neither the table (column `instrument`) nor `--instrument` names
the instrument, the report states the one that is assumed. Repeats that vary less than stated change nothing.

**A model that is wrong** leaves a *discrepancy* beyond the noise. With the weights of a tracker's noise (up to 625 : 1 in variance
along and across the beam) the errors would be fitted along the beam at the expense of the others. The discrepancy is a variance for
each target and station, along and across the beam (for other instruments: per coordinate), estimated by restricted maximum
likelihood; the readings are weighted by the inverse of noise plus discrepancy (`twin.identification.discrepancy`). It is zero where
the residuals do not show it (score test, 0.1 % for all together), so a model that fits has the weights of its noise. It counts in the
intervals, as random from pose to pose: repeats and targets of a pose share it. The tests of the model compare the residuals with the
noise alone.

**Several instruments.** `twin identify probe.csv tracker.csv -o mine.yaml` fits the readings of several tables at once, each station
with the noise of its own instrument; the report gives the residuals of each instrument and what it determines alone. A probe that finds
the centre of a sphere reads zero: the axis positions in the row are the measurement (`twin doc files`).

**Constant errors.** One line says how many of the scales, squareness errors and axis locations the readings determine, and which not.
Spheres at unknown places, found by a probe of unknown length, show neither the common scale of X, Y and Z nor the locations that a
shift of spheres or tip can compensate. Known places (`place_x_mm …`) or a known tip (`station_x_mm …`) add them.

- Curves have no constant: it belongs to the axis's zero, to a location, or to the places of the targets.
- Straightness curves have no slope: the reference line is the least-squares line over the range, and its direction is squareness.
  Curves from two set-ups can therefore be compared directly.
- A shift or tilt of everything that a rotary axis carries (first harmonics of E_X and E_Y, and of E_A and E_B, that rotate with the
  axis) is not part of its error motions.

The number of functions of each curve is chosen by its prediction error on held-out data: one round and some positions are held out
together. For part of a turn, powers or harmonics are used, whichever predicts better. Functions are neither set to zero nor left
free: each has a prior, whose size and decay are integrated over (`twin.identification.priors`). A curve within the noise therefore
has an interval that allows for undetected components, and a low order does not mean that higher orders are zero.

**Outliers.** Robust weights find a few wrong points; a false alarm occurs in one data set of a hundred. The final estimate is least
squares without them. Each point is compared with the other points of its target from its station. Where most of these have residuals
larger than the instrument's noise, the model is wrong, not the readings: they stay in, and only points that differ from them are set
aside. The report gives the RMS over all rows next to that over the rows used.

`--uncertainty` selects the noise on which the intervals are based: the stated uncertainty of the readings (unless repeats contradict
it), the standard deviation of `repeats`, or the variation `'between poses'` or `'between rounds'` for data that the model does not
describe completely. `--only` sets all errors that it does not name to zero.

**The file is the fit.** The calibration is written, read back and evaluated on the rows; the residuals in the report are those of the
file. Where the model is incomplete, an error that the readings hardly determine would be fitted to the misfit. It therefore has a weak
prior with a standard deviation of 1000 µm or µrad, or the value in the machine file:

    plausible:
      motion: {um: 200, urad: 200}
      location: {um: 5000, urad: 5000}      # and squareness

**Not identifiable** means that an error of any size has no influence on the residuals of these data. If only stations and targets can
compensate it, it is left out. If it is confounded with other errors, all of them stay in the calibration, limited by their priors:
their sum is known, and the covariance shows that each of them is not. The most frequent case are reflectors of unknown place that
move with the table: the position of B and C in X and Y then needs the places of the reflectors (`place_x_mm …`) or a reference on the
machine. The file names these errors (`not_identifiable`), and whatever is made from it repeats that. Those left out count in U at the
tool with the machine file's plausible size, not as zero.

**Uncertainty at the tool.** U is the radius of the sphere that contains 95 % of a normally distributed error of the point. It is not
twice a standard deviation, which in space covers less. `twin info -c mine.yaml` gives each error's peak with its standard
uncertainty, and U of the tool point over the volume with the place of the largest. `compensate` prints the correction ± U, lists the
blocks whose correction does not exceed its own U and does not count them as improved; in JSON all of it is under `uncertainty`. If a
calibration has no covariance, U is unknown, never zero. U covers the calibration only: no repeatability, no temperature, no rounding.

**The stages**, in `twin.identification.identify`; each takes the results of the stages before it.

1. `inputs.prepared`: measurements → `PreparedData`: rows that agree with their commands, the instrument, and initial values of stations
   and targets. `noise.reading_noise`: → `NoiseOfReadings`: their noise, as stated or from repeats.
2. `determined.determined_models`: → `DeterminedModel`: the unknowns that the data determine, one model for each family of curves.
3. `robust.robust_start`: → `RobustStart`: an estimate that is not affected by a few wrong points.
4. `orders.choose`: → `Choice`: the number of functions of each curve that the held-out readings support.
5. `priors.prior_precision`: → the precision of each function's prior about zero.
6. `robust.without_outliers`: → `FinalEstimate`: least squares (`solve.solve`) without the outliers, weighted by noise and discrepancy.
7. `discrepancy.covariance_of`: → its covariance; `held_out.held_out_residuals`: residuals at held-out poses.
8. → `Identification`: the calibration, the errors that are not identifiable, and the residuals of the calibration.
"""

from twin.identification.identify import identify
from twin.identification.result import Identification
from twin.identification.unidentified import Unidentified

__all__ = ["Identification", "Unidentified", "identify"]
