"""What the simulation gets wrong about measured data, and why.

    twin diagnose measured.csv --calibration mine.yaml --json diagnosis.json --html diagnosis.html --extended better.yaml

Stations and targets are fitted, nothing else; what is left of the readings is judged against their scatter: the table's `u_x_mm
…`, else the figures of the instrument that was named, else the repeats (compared after everything that may honestly differ
between them is taken out), else what no plain form of any cause accounts for. Rows too far off to be chance are listed and left
out, unless one of the causes is why. Then every effect of a catalogue is tried wherever the machine can have it: reversal,
pitch errors, squareness, axis locations, curves of the linear axes, harmonics of the rotary ones, thermal expansion, growth and
drift, one axis's error growing with another, a drooping cradle, compliance under gravity; and the instrument's own: a frame
re-aligned, a station that creeps, a bumped target, the refractive index, positions reported before an axis had settled; and
what can be wrong with the calibration itself: a polynomial fitted without its constant, terms the machine does not have, a
wrong sign, a curve under another name or at another joint. A cause is judged by what it explains after everything the set-up
and the calibration's own uncertainty can absorb has been projected out; every form tried is paid for, so that data with nothing
hidden raise an alarm in at most 5 of 100 sets. A cause that would have to be larger than physics allows, or many times larger than
what is to be explained, is none.

Beside the causes, every column and every pair of columns is tested for a pattern without a name, on each side of the machine:
short waves, steps, lost motion that depends on the position (`twin.diagnosis.unnamed`). Where one is left, the causes are judged
anew by likelihood beside it (`twin.diagnosis.structure`). A cause that carries most of what goes with its columns keeps its name,
and what its form leaves is given in µm as unexplained; a cause that only imitates a part of a pattern is not named.

The verdict is `consistent`, `explained` (the causes carry nine tenths), `ambiguous` (a cause these data cannot tell from others,
which are named, with points that would tell them) or `unexplained`. Each cause carries the probability that a second, Bayesian
method gives it (sum of single effects, `twin.diagnosis.second_opinion`); where the two disagree, the verdict is `ambiguous`.
Causes of the instrument never enter a calibration, nor do curves through few positions that foretell none of those left out
(`promised: false`). Every figure of gain is that of the calibration as it is written, evaluated on the readings anew; held out is
what the claim is about: positions or poses for functions of position, rounds or blocks of time for changes in time, with an
interval from six groups on. `--extended` writes the calibration with what was found of the machine, parameters and covariance
(`effects:` entries `{effect: pitch_error, where: X, parameters: {amplitude: 1.9, period: 10.0, phase: 0.5}}` beside the curves),
and `compensate`, `scene` and `info` use it:

- Thermal effects need `--temperature X=23.1 bed=21`, a warm-up `--time S`; where one is missing the program is refused, naming
  it.
- Reversals need nothing: the side each axis comes from follows from the program, and where an axis turns round an extra move
  takes the reversal up; the account says how often.

Where more than scatter is left, sizes carry the larger of two uncertainties: that of the scatter, and the one that what is left
shows from round to round or from place to place. `--html` writes one page: its first screen says what is wrong, how much it
makes at the tool, what to do and what not; then expected, seen, tried, why this one, what it could be mistaken for, what
changes, what to measure next. `notebooks/02_diagnose.ipynb` follows one case from parts that are off to the measurement that
tells two causes apart; `twin.diagnosis.plots` (extra `plots`) has the pictures.

How often it is right, on 200 draws a row (`python -m tests.battery ROW [--noise …]`; 3,000 points; effects drawn from the whole
catalogue and scaled to a noncentrality λ after projection; right or inside the equivalence group it states / right outright
where nothing could be mistaken for it; alarms: with nothing hidden; outside: the right column named for what is outside the
catalogue; intervals: how often 95 % ones cover):

| scatter | one, 60 | one, 30 | two, 60 | three, 100 | one too many | alarms | outside, 300 | intervals |
|---|---|---|---|---|---|---|---|---|
| alike in all directions, given | 100 / 100 | 89.5 / 89.4 | 97 | 95.5 | 0.5–3 | 4 | 96 | 92.8–94.5 |
| alike, from repeats | 100 / 100 | 89 / 88.7 | 97 | 95.5 | 0.5–3 | 4 | 96 | 93.1–94.5 |
| a tracker's, given | 99 / 97.9 | 92 / 86.8 | 94.5 | 93 | 0–1 | 3.5 | 97 | 92.9–94.9 |
| a tracker's, from repeats | 99 / 97.9 | 90.5 / 85.1 | 94 | 93 | 0–1 | 3.5 | 97.5 | 92.5–94.9 |
| alike; the calibration itself uncertain (earlier draws) | 100 / 100 | 88 / 86.2 | 97 | 97.5 | 0–2 | 1.5 | 96 | 94.5–96.7 |

Of 600 draws alike in all directions (seeds 1 to 3) 5.0 % raised an alarm with nothing hidden, and 90.8 % of effects at 30 were right
or in the group; over seeds 1 to 6, 93.7 % of 2,314 intervals at 60 covered.

The same draws given to plain methods on the same candidates (`python -m tests.rivals`, 50 draws, isotropic): right or in group
and nothing beside it for one effect at λ = 60 / at 30 / two at 60: `twin` 100 / 84 / 94 %, stepwise BIC (statsmodels) 62 / 56 /
60 %, extended BIC 86 / 60 / 84 %, LASSO by BIC (scikit-learn) 76 / 54 / 48 %. With nothing hidden they raise an alarm in 2, 12,
0 and 0 %; before a pattern outside the catalogue they name some cause in 22, 78, 70 and 54 %, and only `twin` says that it is
none it knows.
"""

from twin.diagnosis.diagnose import diagnose
from twin.diagnosis.result import Cause, Diagnosis

__all__ = ["Cause", "Diagnosis", "diagnose"]
