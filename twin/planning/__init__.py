"""The next measurement worth making.

    twin plan -o plan.csv --minutes 210
    twin plan --judge thesis_plan.csv
    twin plan -o plan.csv --separate "cross_axis E_AX by Z" "cross_axis E_AY by Z" --after measured.csv

What can be measured with, where it may stand and how long things take stands in a kit file (`--kit`, `schema: twin.kit/1`);
copy `urdf/dmu50.kit.yaml`, which is `--kit dmu50`; without one `twin` guesses a tracker at four places and three reflectors a
side. Poses are drawn over the ranges, those are kept in which nothing drawn in the URDF comes nearer than 25 mm to the other
side, and of every reflector every station those readings that nothing drawn stands in the way of and the reflector accepts.
Each reading's derivatives by every unknown of `identify` are known beforehand, so its worth is: `--reduce tool` (default) makes
the uncertainty of the tool point over the volume small, `everything` is D-optimal, `weakest` lifts the direction known worst,
names of errors make theirs small. Where to stand is tried out; the readings are put in the order that is soonest done, with the
time of each; moves that come too near to something are listed (exit status 3: retract there). Both sides of approach occur. The
account foretells u of every error and at the tool, the observability indices O1–O5, and what stays hidden, with what moves
together unseen.

`--judge` says the same of anybody's plan, and how long it takes by the kit's clock. The thesis's 840 readings take 4.6 hours; a
plan for the same time foretells 2.1 µm standard uncertainty at the tool (RMS over the volume, tool 120 mm) instead of 23.6, and
simulated and identified the tool point is off by 1.7 µm instead of 14.5 (`notebooks/03_plan_a_measurement.ipynb`).

`--separate` plans for one question: which of two causes is it? Both stand in one model, each free to stand in for the other;
the account says from which size on they are told apart with odds of 100:1 in 19 of 20 measurements. Where temperature or time
tells them apart, the plan has sessions (cold, one sensor warm, hours later). Measured, both tables go to `twin diagnose
first.csv second.csv`. The same notebook does it.
"""

# How a plan is made; each stage takes what the one before returned (`plan`; `separate` differs in the model and the last stage).
#
#     task         Task             what is to be known, with what, in which time
#     candidates   Candidates       every reading that could be taken: safe poses, reflectors seen from each place
#     model        PlanModel        what each of them would tell of every unknown (aims: what is to become small)
#     fill         Filled           where to stand and what to read: design chooses, route puts in order and says what it takes
#     forecast     Forecast         what the readings chosen will tell
#     result       Plan             all of it, as it is shown and written

from twin.planning.forecast import Forecast
from twin.planning.kit import Kit
from twin.planning.plan import judge, plan
from twin.planning.result import Plan, Separation
from twin.planning.route import duration
from twin.planning.separate import separate

__all__ = ["Forecast", "Kit", "Plan", "Separation", "duration", "judge", "plan", "separate"]
