"""Plan the next measurement: which readings to take, from where, and which uncertainty they will give.

    twin plan -o plan.csv --minutes 210
    twin plan --judge thesis_plan.csv
    twin plan -o plan.csv --separate "cross_axis E_AX by Z" "cross_axis E_AY by Z" --after measured.csv

A kit file (`--kit`, `schema: twin.kit/1`) lists the instruments, the possible station positions, the reflectors and the time of each
operation. Copy `urdf/dmu50.kit.yaml`, which is `--kit dmu50`. Without a kit file `twin` assumes a laser tracker at one of four places
and three reflectors on each side.

Candidate poses are drawn over the axis ranges. A pose is kept if the shapes of the tool side in the URDF stay at least 25 mm away from
those of the work side. A reading is kept if no shape blocks the beam and the reflector accepts it. The derivatives of each reading with
respect to every unknown of `identify` are known beforehand, and so is the gain of taking it. `--reduce tool` (default) minimises the
uncertainty of the tool centre point over the volume, `everything` is D-optimal, `weakest` E-optimal; with names of errors their
uncertainty is minimised. Several station positions are tried. The readings are ordered to take little time, with a time for each; every
axis is approached from both directions. Moves with too little clearance are listed (exit status 3: retract there). The report predicts
the uncertainty of every error and at the tool, gives the observability indices O1–O5, and lists the errors that are not identifiable
and what each is confounded with.

`--judge` predicts the same for an existing plan, and how long it takes with the kit's times. The thesis's 840 readings take 4.6 hours.
A plan for the same time predicts 2.1 µm standard uncertainty at the tool (RMS over the volume, tool 120 mm) instead of 23.6 µm.
Simulated and identified, the error of the tool point is 1.7 µm instead of 14.5 µm (`notebooks/03_plan_a_measurement.ipynb`).

`--separate` plans a measurement that distinguishes two causes. Both are in one model and are estimated together; the report gives
the smallest size of each at which the measurement favours the right one by odds of 100:1 or better in 19 of 20 cases. If
temperature or time distinguishes them, the plan has several sessions (machine cold, one sensor warm, hours later). Afterwards give both
tables to `twin diagnose first.csv second.csv`. The same notebook has an example.

Sequences for a touch probe, an R-test or a ball bar:

    twin plan --instrument probe -o plan.csv --tool-length 120 --minutes 45
    twin plan --instrument probe --sequence turns -o plan.csv --tool-length 120 --spheres "150,0,60" "-90,120,100"
    twin plan --instrument probe -o plan.csv --tool-length 120 --program probe.ngc
    twin plan --instrument r-test --sequence bk2 -o plan.csv --tool-length 120

With `--instrument` a measuring sequence is planned for an instrument that measures the tool relative to the table. A sequence gives
positions of the rotary axes; X, Y and Z follow from the nominal kinematics. Points beyond a range or with too little clearance are
dropped, and their number is given. `--spheres` gives the spheres (nests, pivots) in the work frame.

- `best` (probe, R-test): poses of the rotary axes, chosen by exchange for the smallest sum of relative variances of the constant
  errors (scales, squareness, axis locations) in the time given (`--minutes`). Assumed are five contacts of 6 s per pose, and 3 min for
  setting up a sphere, 15 min for a nest. Spheres for which there is no time are listed.
- `turns` (probe, R-test): each rotary axis alone in seven steps, the other at zero and at 90°; poses as of HEIDENHAIN cycle 451.
- `bk1`, `bk2`, `bk4`, `ak1`, `ak2`, `ak4` (R-test): one or both rotary axes with X, Y and Z, in the manner of ISO 10791-6. The text
  of the standard was not available: number of points, ranges and place of the ball are choices of twin. `ak3`, `bk3` and the CK tests
  (one rotary axis on each side) are refused: no public description says which axes move in them.
- `circles` (ball bar): XY, YZ and ZX in both directions, as in ISO 230-4, with arcs of 220° in the vertical planes. Scales rest on
  the calibrated length of the bar.

The report gives the predicted uncertainty of each constant error with nothing known of the set-up, with the places of the spheres
known, and with these and the tip known. It lists what the sequence cannot tell, and compares it with `best` in the same time.
`--judge` gives the same for an existing plan. Error motions that depend on the position are neither in the criterion nor in the
prediction: identify them, or diagnose the residuals.

Thermal tests after ISO 230-3 (evaluated by `twin evaluate --iso230-3`):

    twin plan --drift environment --instrument displacement -o etve.csv
    twin plan --drift spindle --instrument probe --highest-rpm 12000 --minutes 300 --tool-length 120 -o spindle.csv
    twin plan --drift axes --axis X --feed 8000 --instrument r-test --tool-length 120 -o axis.csv

The plan has a time and a spindle speed for each reading; `spindle_rpm` is the speed from the reading before to this one. For
displacement sensors it is the record to fill in, with the comment that gives their directions.

- `environment`: machine at rest, a reading every 5 min for 24 h.
- `spindle`: 25, 50, 75 and 100 % of `--highest-rpm` for equal times, then rest for a fifth of the time. `--spectrum` changes the
  speed at random every 10 min instead, which separates speed from time.
- `axes`: two target positions of a linear axis, or several angles of a rotary one; between the readings the axis moves at `--feed`. Two
  `--spheres` give the places; for an axis perpendicular to the table the second place is on a riser beside the first.

A touch probe needs the spindle stopped. The plan says for how long (assumed), and what does not show because of it. Duration, steps and
intervals are choices of twin, not those of the standard. `--program` writes the
program of the test (not run on a machine).

`--program` writes the measuring program for a touch probe: `.ngc` or `.nc` (LinuxCNC), `.h` (HEIDENHAIN), `.mpf` (SINUMERIK). The
tool retracts, the rotary axes turn, and the tip touches the sphere five times: from the spindle and at four points of the equator
that keep the stylus away from the stem. Every position is checked for the ranges. Every move is checked with the shapes of the URDF
and an assumed probe (body 50 mm, stylus 50 mm long) and stem, square to the table. A pose without such a path is left out and
listed (exit status 3). No program was tried on a real control: read it, run it dry, then with low override. The control logs
the positions at the contacts; `twin convert` makes the measurement table of them (the command is in the program's header).
"""

# Stages of planning; each takes the result of the one before (`plan`; `separate` differs in the model and the last stage).
#
#     task         Task             machine, kit, time budget, and what to minimise
#     candidates   Candidates       every possible reading: poses with clearance, reflectors visible from each station
#     model        PlanModel        derivatives of the readings with respect to the unknowns (aims: criteria to minimise)
#     fill         FilledPlan       stations and readings: design chooses them, route orders them and adds up the time
#     forecast     Forecast         predicted uncertainties
#     result       Plan             the plan as displayed and written
#
# A measuring sequence: `sequences` (poses, reach, prediction), `measure` (SequencePlan), `programs` (for a control).
# A thermal test: `drift` (schedules; DriftPlan).

from twin.planning.forecast import Forecast
from twin.planning.kit import Kit
from twin.planning.measure import SequencePlan, judge_sequence, measuring_sequence
from twin.planning.plan import judge, plan
from twin.planning.result import Plan, Separation
from twin.planning.route import duration
from twin.planning.separate import separate
from twin.planning.sequences.specification import InstrumentSizes

__all__ = [
    "Forecast",
    "InstrumentSizes",
    "Kit",
    "Plan",
    "Separation",
    "SequencePlan",
    "duration",
    "judge",
    "judge_sequence",
    "measuring_sequence",
    "plan",
    "separate",
]
