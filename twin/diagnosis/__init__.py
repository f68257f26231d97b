"""What the simulation gets wrong about measured data, and why.

    twin diagnose measured.csv --calibration mine.yaml --json diagnosis.json --html diagnosis.html --extended better.yaml

Stations and targets are fitted, nothing else; what is left of the readings is judged against their scatter: the table's `u_x_mm
…`, else the figures of the instrument that was named, else the repeats (compared after everything that may honestly differ
between them is taken out), else what no plain form of any cause accounts for. Rows too far off to be chance are listed and left
out, unless one of the causes is why. Then every effect of a catalogue is tried wherever the machine can have it: reversal, constant
or along the travel, pitch errors, squareness, axis locations, curves of the linear axes, harmonics of the rotary ones, thermal
expansion, growth and drift, one axis's error growing with another, a drooping cradle, compliance under gravity and a payload; and the
instrument's own: a frame re-aligned, a station that creeps, a bumped target, the refractive index, scales and right angles of one of
several stations or rounds, positions reported before an axis had settled, readings taken later than the positions (column
`feed_mm_min`, or rows read on the way); and
what can be wrong with the calibration itself: a polynomial fitted without its constant, terms the machine does not have, a
wrong sign, a curve under another name or at another joint. A cause is judged by what it explains after everything the set-up
and the calibration's own uncertainty can absorb has been projected out; every form tried is paid for, so that data with nothing
hidden raise an alarm in at most 5 of 100 sets. A cause that would have to be larger than physics allows, or many times larger than
what is to be explained, is none.

Drifts of the machine and of the instrument have the same forms: a straight line, or an exponential with a time constant within the
record. A straight drift of the machine is a `thermal_drift` with its rate, and its amplitude over the record (`bounded`: the time
constant is longer); in a calibration it is `{effect: thermal_drift, where: Z, parameters: {rate: 3.2}}`, µm/h. Which of the two
creeps, targets on both sides decide; where they are on one side only, both are named.

Joints give way (`gravity_compliance`) under the weights of the URDF and under a payload that it does not have: one `payload` a side,
mass and centre of gravity in the tool's or the work's frame, the same for all joints that carry it. In a calibration it is
`{effect: payload, where: tool, parameters: {mass: 2.4, centre_x_mm: 35, centre_y_mm: -20, centre_z_mm: 60}}`, part of the load of every
`gravity_compliance` in the file, whose uncertainties there are those under exactly this payload. Where the machine's own weight does
not show, as if the control corrected it, only the products of compliance and mass are known: the mass is then at its bound, the
compliances are lower limits (`bounded`), and the evidence gives the products.

Positions finer than the axis's least increment are no commands. A reversal found with them may be none: reported before the axis
had settled, they are off by the side it came from. Such a reversal has `read_back` among its `equivalent`; commanded positions with a
column `readback_<axis>_<unit>` beside them decide.

Beside the causes, every column and every pair of columns is tested for a pattern without a name, on each side of the machine:
short waves, steps, lost motion that depends on the position (`twin.diagnosis.selection.unnamed`). Where one is left, the causes are
judged anew by likelihood beside it (`twin.diagnosis.selection.structure`). A cause that carries most of what goes with its columns
keeps its name, and what its form leaves is given in µm as unexplained; a cause that only imitates a part of a pattern is not named.

With few readings, many causes fit and predict nothing. Where held-out positions or poses fit much worse than those in the fit, only
those causes are named that are significant against the residual and lower the held-out error; the others are listed as not named. With
24 poses of an arm whose joints have random errors, 30 causes fitted everything; none is named.

The verdict is `consistent`, `explained` (the causes carry nine tenths), `ambiguous` (a cause these data cannot tell from others,
which are named, with points that would tell them) or `unexplained`. Each cause carries the probability that a second, Bayesian
method gives it (sum of single effects, `twin.diagnosis.judgement.second_opinion`); where the two disagree, the verdict is
`ambiguous`. Causes of the instrument never enter a calibration, nor do curves through few positions that foretell none of those left
out and pitch errors at evenly spaced positions, where another period fits as well (`promised: false`). Every figure of gain is that
of the calibration as it is written, evaluated on the readings anew; held out is what the claim is about: positions or poses for
functions of position, rounds or blocks of time for changes in time, with an interval from six groups on. The causes are those found
on all readings; each is fitted to the other groups, and stays only where it is worth it there. So what was selected has seen all
readings, and the payload's mass and centre stay as all readings have them: held-out figures are slightly favourable. `--extended`
writes the calibration with what was found of the machine, parameters and covariance (`effects:` entries
`{effect: pitch_error, where: X, parameters: {amplitude: 1.9, period: 10.0, phase: 0.5}}` beside the curves), and `compensate`,
`scene` and `info` use it:

- Thermal effects need `--temperature X=23.1 bed=21`, a warm-up `--time S`; where one is missing the program is refused, naming
  it.
- Reversals need nothing: the side each axis comes from follows from the program, and where an axis turns round an extra move
  takes the reversal up; the account says how often.

What is left unexplained on one side of the machine can extend the calibration too: `--extended better.yaml --empirical` adds an effect
`empirical` for each pattern, without a known cause. It shifts that side by a smooth function of the pattern's columns (positions,
directions of approach, temperatures), with the most likely coefficients and their covariance:

- It is written only where readings held out confirm it: positions of its axes that the fit has not seen, rounds or blocks of time for
  temperatures, at least six of them. A pattern that goes with time or rounds is not written, for a later program does not know them.
  What was decided, and why, is in `unexplained.extension` of the JSON.
- It corrects what was measured, inside the range measured, and says nothing outside: there `compensate`, `simulate`, `scene`, `control`
  and all others refuse with exit status 2, rapid moves included. Without the effect the calibration has no such limit. A rotary axis
  that turned round in the measurement has no range.
- With it, every figure of gain is that of the file written; at the tool it is taken over the range only.
- If the instrument made the pattern and not the machine, parts become worse. Check the instrument, and look for the cause.

On the truth machine (a product of short waves in X and Y, 20 µm; 160 places measured, noise 3 µm): 9.4 → 3.7 µm and 10.3 → 2.7 µm
RMS at the cutting points of two programs compensated without it and with it; a reversal of Y that goes from −10 to +10 µm over Z: 5.1 →
0.8 µm. On the plate of 2003, poses held out: 4.77 µm with the named causes, 4.31 µm with the effect beside them, 6.41 µm with neither.

Where more than scatter is left, sizes carry the larger of two uncertainties: that of the scatter, and the one that what is left
shows from round to round or from place to place. `--html` writes one page: its first screen says what is wrong, how much it
makes at the tool, what to do and what not; then expected, seen, tried, why this one, what it could be mistaken for, what
changes, what to measure next. `notebooks/02_diagnose.ipynb` follows one case from parts that are off to the measurement that
tells two causes apart; `twin.diagnosis.wording.plots` (extra `plots`) has the pictures.

How often it is right, on 200 draws a row (`python -m tests.diagnosis.battery ROW --poses 100 --seed 11`; effects drawn from the
whole catalogue and scaled to a noncentrality λ after projection; scatter alike in all directions, or that of a tracker):

| | right or in the group it states | right where nothing equals it | nothing found | one too many | 95 % intervals cover |
|---|---|---|---|---|---|
| one, λ = 60 | 99.5 %, tracker 100 % | 99 %, tracker 100 % | 0 % | 1.5 %, tracker 0 % | 95 %, tracker 94 % |
| one, λ = 30 | 89.5 %, tracker 94 % | 89 %, tracker 85 % | 9 %, tracker 6 % | 1 %, tracker 0 % | 95 %, tracker 94 % |
| two, λ = 60 each | 98 %, tracker 94 % | 98 %, tracker 90 % | 0 % | 0.5 %, tracker 1 % | 96 %, tracker 95 % |
| nothing | 2 %, tracker 1.5 % raise an alarm | | | | |

At λ = 30 a test that knew λ and how the effects are drawn would find 93 to 94 % at the same rate of alarms.

On data of four machines that are simulated without linearisation (`python -m tests.benchmark -o DIR --kinds outside nothing mixed300
--draws 2`), 64 cases with a pattern at λ = 300 that no catalogue has (short waves, products, lost motion that depends on the position,
jumps, bumps, sawteeth, drifts that come and go): 100 % unexplained, 98 % with the right column, 5 % with a cause of the machine that is
not there. Of 8 with such a pattern and a known effect at once, 7 had the right name.

The same cases of three of these machines given to plain methods with the same candidates (`python -m tests.benchmark -o DIR --machines
trunnion robot stage --kinds known60 nothing outside-smooth outside-lost --draws 3 --method twin --method stepwise-bic --method
stepwise-ebic --method lasso`, statsmodels and scikit-learn; 36 cases, 9 of them with one effect at λ = 60, 9 with nothing, 18 with a
pattern that no catalogue has):

| | one: right or in group | one: false machine cause | nothing: alarm | pattern: false machine cause | pattern: unexplained |
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
