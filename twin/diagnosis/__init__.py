"""Find the errors that measured data show beyond the model of the machine, and name their causes.

    twin diagnose measured.csv --calibration mine.yaml --json diagnosis.json --html diagnosis.html --extended better.yaml

**Residuals.** The positions of stations and targets are fitted, nothing else. The residuals are compared with measurement noise: the
table's `u_x_mm …`, else the noise model of the named instrument unless repeats contradict it, else the spread of repeats (after
removing everything that may differ between them), else the residuals that no simple form of any cause explains. Outliers are listed
and set aside, unless one of the causes explains them.

**Causes.** Every effect of a catalogue is tested wherever the machine can have it: reversal, constant or along the travel; pitch
errors; squareness; axis locations; curves of the linear axes; harmonics of the rotary axes; thermal expansion, growth and drift; an
error of one axis that grows with another; droop of the cradle; compliance under gravity, payload and carried load. So are errors of the
instrument: a re-aligned frame, a drifting station, a bumped target, the refractive index, scales and shears of one of several stations
or rounds, positions reported before an axis had settled, readings taken later than the positions (column `feed_mm_min`, or rows read in
motion). So are errors of the calibration: a polynomial fitted without its constant, terms that the machine does not have, a wrong
sign, a curve under another name or at another joint.

A cause is tested on the residuals after projecting out the positions of stations and targets and the uncertainty of the calibration.
p-values are corrected for the number of causes tested: data without an error raise a false alarm in at most 5 of 100 sets. A cause that
would have to be larger than physically possible, or many times larger than the residuals it explains, is rejected.

Drifts of the machine and of the instrument have the same forms: a straight line, or an exponential with a time constant within the
record. A straight drift of the machine is a `thermal_drift` with its rate, and its amplitude over the record (`bounded`: the time
constant is longer); in a calibration it is `{effect: thermal_drift, where: Z, parameters: {rate: 3.2}}`, µm/h. Targets on both sides
separate the two; with targets on one side only, both are named.

Joints deflect (`gravity_compliance`) under the weights of the URDF and under a payload that it does not contain: one `payload` per
side, mass and centre of gravity in the tool's or the work's frame, the same for all joints that carry it. In a calibration it is
`{effect: payload, where: tool, parameters: {mass: 2.4, centre_x_mm: 35, centre_y_mm: -20, centre_z_mm: 60}}`, part of the load of every
`gravity_compliance` in the file, whose uncertainties there hold for exactly this payload. If the machine's own weight has no effect
on the readings, as if the control corrected it, only the products of compliance and mass are known: the mass is then at its bound, the
compliances are lower limits (`bounded`), and the evidence gives the products.

A load that is known for each reading stands in the column `load_kg`. If it differs between readings, joints are also tested with it in
their load. A `carried_load` on the tool or the work side is named if the readings show it, with the coordinates of its centre of
gravity that they determine. If compliances are known from a calibration without it, readings under one load are enough: `mass_ratio` is
then the mass that acts per kg of `load_kg`. It is 1 if that mass, the masses of the URDF and the compliances are right. Without known
compliances, a load that is the same in all readings cannot be separated from a payload and is found as one, with a free mass. In a
calibration it is `{effect: carried_load, where: tool, parameters: {centre_x_mm: 35, centre_y_mm: -20, centre_z_mm: 60}}`, with
`mass_ratio` if it is not 1; there is one at most. A carried load has no covariance in the file: the uncertainties there hold for
exactly this load and place.

The droop of a cradle (`table_load`) has a constant `tilt`. With a `moment` in its parameters, the torque of gravity about the axis at
+90° in N·m at which the tilt was found, it grows with the torque of payload and carried load on the work side: tilt·(1 + load/moment).
`diagnose` gives the moment of the URDF's masses if the calibration has such a load. About a horizontal axis along x the droop is the
same as `gravity_compliance` of this axis; about an inclined axis it is not, because the compliance turns about the axis.

Positions finer than the axis's least increment cannot be commands. A reversal found with them may not exist: positions reported before
the axis had settled depend on the approach direction too. Such a reversal has `read_back` among its `equivalent`; commanded
positions with a column `readback_<axis>_<unit>` decide.

**Unnamed patterns.** Every column and every pair of columns is also tested for a pattern that no cause describes, on each side of the
machine: short waves, steps, a reversal that depends on the position (`twin.diagnosis.selection.pattern_test`). If one is found, the
causes are selected again by likelihood with the pattern in the model (`twin.diagnosis.selection.structure`). A cause that carries most
of the dependence on its columns keeps its name, and the remainder is given in µm as unexplained; a cause that only imitates part of a
pattern is not named.

**Overfitting.** With few readings, many causes fit and predict nothing. If held-out positions or poses fit much worse than those in the
fit, only those causes are named that are significant against the residuals and reduce the held-out error; the others are listed as not
named. On 24 poses of an arm whose joints have random errors, 30 causes fitted everything; none is named.

**Verdict.** `consistent`, `explained` (the causes carry nine tenths of the excess), `ambiguous` (a cause is confounded with others,
which are named, with points to measure that separate them) or `unexplained`. Each cause has the probability given by a second, Bayesian
method (sum of single effects, `twin.diagnosis.judgement.second_opinion`); if the two methods disagree, the verdict is `ambiguous`.

**Extended calibration.** `--extended` writes the calibration with the errors of the machine that were found, parameters and
covariance (`effects:` entries `{effect: pitch_error, where: X, parameters: {amplitude: 1.9, period: 10.0, phase: 0.5}}` beside the
curves); `compensate`, `scene` and `info` use it. Errors of the instrument never enter a calibration. Neither do curves through
few positions that do not predict held-out ones, nor pitch errors at evenly spaced positions, where another period fits equally well
(`promised: false`).

- Thermal effects need `--temperature X=23.1 bed=21`, a warm-up `--time S`, a carried load `--load KG`; if one is missing, the program
  is refused with its name.
- Reversals need nothing: the approach direction of each axis follows from the program, and where an axis reverses, an extra move takes
  up the backlash; the account gives their number.

**Gain.** Every figure of gain is evaluated anew on the readings with the calibration as written. What is held out depends on the
claim: positions or poses for functions of position, rounds or blocks of time for changes in time, with a confidence interval from six
groups on. The causes are those found on all readings; each is fitted to the other groups, and stays only if it is significant there.
The selection has therefore seen all readings, and the payload's mass and centre are those of all readings: held-out figures are
slightly optimistic.

**Empirical effects.** `--extended better.yaml --empirical` adds an effect `empirical` for each unexplained pattern on one side of the
machine, without a known cause. It shifts that side by a smooth function of the pattern's columns (positions, approach directions,
temperatures), with the most likely coefficients and their covariance:

- It is written only if held-out readings confirm it: positions of its axes that the fit has not seen, rounds or blocks of time for
  temperatures, at least six of them. A pattern that depends on time or rounds is not written, because a later program does not know
  them. The decision and its reason are in `unexplained.extension` of the JSON.
- It is valid within the measured range only: outside, `compensate`, `simulate`, `scene`, `control` and all others refuse with exit
  status 2, for rapid moves too. Without the effect the calibration has no such limit. A rotary axis that made a whole turn in the
  measurement has no range.
- With it, every figure of gain is that of the file written; at the tool it is taken over the range only.
- If the instrument caused the pattern and not the machine, parts become worse. Check the instrument, and look for the cause.

On the simulated truth machine (a product of short waves in X and Y, 20 µm; 160 positions measured, noise 3 µm): 9.4 → 3.7 µm and
10.3 → 2.7 µm RMS at the cutting points of two programs compensated without it and with it; a reversal of Y that changes from −10 to
+10 µm over Z: 5.1 → 0.8 µm. On the plate of 2003, held-out poses: 4.77 µm with the named causes, 4.31 µm with the effect added, 6.41 µm
with neither.

If the causes leave more than the noise, they are selected and their sizes estimated again with weights of noise and discrepancy
(`twin doc identify`), so that neither the causes nor the written file follow the unexplained residuals along a tracker's beam. On
2,773 poses of a UR10 measured with a tracker (`--instrument tracker`), held-out poses: 91 µm instead of 278 µm with the weights of the
noise. Whether the model is complete is decided against the noise alone.
Sizes then carry the larger of two uncertainties: that from the noise, and that from the variation of the residuals between rounds or
positions. `--html` writes one page: its first screen gives the error, its effect at the tool, what to do and what to avoid; then
residuals, causes tested, evidence, alternatives, gain, and what to measure next. `notebooks/02_diagnose.ipynb` follows one case from
faulty parts to the measurement that separates two causes; `twin.diagnosis.wording.plots` (extra `plots`) has the pictures.

**Success rates**, on 200 simulated data sets per row (`python -m tests.diagnosis.battery ROW --poses 100 --seed 11`; effects drawn from
the whole catalogue and scaled to a noncentrality λ after projection; isotropic noise, or that of a tracker):

| | correct or in the stated group | correct if not confounded | nothing found | false extra cause | coverage of 95 % intervals |
|---|---|---|---|---|---|
| one, λ = 60 | 99.5 %, tracker 100 % | 99 %, tracker 100 % | 0 % | 1.5 %, tracker 0 % | 95 %, tracker 94 % |
| one, λ = 30 | 89.5 %, tracker 94 % | 89 %, tracker 85 % | 9 %, tracker 6 % | 1 %, tracker 0 % | 95 %, tracker 94 % |
| two, λ = 60 each | 98 %, tracker 94 % | 98 %, tracker 90 % | 0 % | 0.5 %, tracker 1 % | 96 %, tracker 95 % |
| nothing | 2 %, tracker 1.5 % false alarms | | | | |

At λ = 30 a test that knew λ and the distribution of the effects would find 93 to 94 % at the same rate of false alarms.

On data of four machines simulated without linearisation (`python -m tests.benchmark -o DIR --kinds outside nothing mixed300
--draws 2`), 64 cases with a pattern at λ = 300 that is in no catalogue (short waves, products, reversals that depend on the position,
jumps, bumps, sawteeth, temporary drifts): 100 % unexplained, 98 % with the right column, 5 % with a false cause of the machine. Of 8
cases with both such a pattern and a known effect, 7 had the right name.

Standard methods with the same candidates on the same cases of three of these machines (`python -m tests.benchmark -o DIR --machines
trunnion robot stage --kinds known60 nothing outside-smooth outside-lost --draws 3 --method twin --method stepwise-bic --method
stepwise-ebic --method lasso`, statsmodels and scikit-learn; 36 cases, 9 of them with one effect at λ = 60, 9 with nothing, 18 with a
pattern in no catalogue):

| | one: correct or in group | one: false machine cause | nothing: false alarm | pattern: false machine cause | pattern: unexplained |
|---|---|---|---|---|---|
| `twin` | 100 % | 0 % | 0 % | 0 % | 100 % |
| stepwise BIC | 89 % | 33 % | 33 % | 89 % | 0 % |
| stepwise, extended BIC | 89 % | 11 % | 0 % | 50 % | 0 % |
| LASSO by BIC | 100 % | 22 % | 11 % | 39 % | 0 % |
"""

from twin.diagnosis.diagnose import diagnose
from twin.diagnosis.diagnosis import Diagnosis
from twin.diagnosis.result import Cause

__all__ = ["Cause", "Diagnosis", "diagnose"]
