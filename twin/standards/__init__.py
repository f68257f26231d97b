"""Evaluate the tests of ISO 230 and ISO 10791-6 for which a measurement table has the runs.

    twin evaluate measured.csv --tolerance A=10 B=3 H=5 --html tests.html --json tests.json

`twin.evaluate(data, machine, tolerances={"A": 10})` does the same from a script. The table is the one of `twin doc files`; no
calibration is used. Every test that the table allows is evaluated; the others are listed with the reason.

**Runs.** Rows of one target, read from one station, in the order of `time_s` where every row has it, else in the order of the rows;
a run ends where the round changes. Runs of one axis at the same place are joined: their repeats are the cycles. The direction of
approach is that of the columns `approach_<axis>`; without them it follows from the order, and the result says so.

The tests with their runs, and the keys of their values in the JSON and for tolerances:

- Positioning, ISO 230-2:2014: one axis moves to three targets or more, or repeatedly to two. `A`, `E` and `R`, each also with
  `_forward` (↑) and `_backward` (↓); `M`, `B`, `B_mean`.
- Straightness, ISO 230-1:2012: a linear axis, with coordinates across its travel. `E_YX` about the least-squares line, `E_YX_EP` about
  the end-point line, `E_YX_MZ` minimum zone.
- Squareness, ISO 230-1:2012: two linear axes with one target and station. `E_C0Y`, `E_C0Y_EP`, `E_C0Y_MZ`.
- Angular error, ISO 230-1:2012: a linear axis, with the angles of a level or an autocollimator. `E_AX`, also with `_forward` (↑),
  `_backward` (↓) and `_reversal`.
- Circular test, ISO 230-4: two linear axes on a circle; coordinates, or a ball bar's length in `x_mm`. `G_b`, `H`, `D`, `G`;
  `G_forward`, `F_max_forward`, `F_min_forward` (counter-clockwise) and `_backward` (clockwise).
- Rotary error motion, ISO 230-7:2015: one rotary axis over a turn, three coordinates. `total`, `synchronous`, `asynchronous`,
  `residual_synchronous`.
- Kinematic test, after ISO 10791-6:2014: linear and rotary axes move, the nominal point stands still. `range_x`, `range_y`,
  `range_z`, or `range_length`.

**Positioning.** A length counts as along the axis if it changes by 1 mm per mm; from three coordinates it is the component along the
least-squares line. The angle of a rotary axis is that of a target about its least-squares circle, over at least 90°. Fewer targets
or cycles than clause 4.3 requires are evaluated and reported; with a single cycle R and A are not determined.

**Angular errors.** Columns `a_urad` and `b_urad` are rotations about x and y of the station's frame, which is taken as parallel to the
machine's unless the table gives its pose. `E_AX` is the range of the deviations over both directions of motion, each the mean of the
readings at a position. No slope is removed. Straightness is not computed from angles: they are those of the carriage, not of its path.

**Circular tests.** A circle is fitted to the commands; coordinates are aligned to it by a rigid motion, so that squareness and
scale errors stay. G and G(b) are minimum zones. F and D need absolute lengths. Those of a ball bar count from its nominal length:
that of the table's comment (`# ball bar length: 150 mm`) or `--length`, else the radius of the commands; readings near zero are
deviations from it. H belongs to the edition of 1996; those of 2005 and 2022 have G(b). The definitions come from the public
abstracts and from publications, not from the text of the standard.

**Rotary error motions.** A target within 1 mm of the axis gives radial and axial error motion in the directions of the station's
frame. A target farther away gives its radial motion in the rotating direction, and the face error motion at its radius. One target
cannot show tilt by itself.

**Kinematic tests.** AK for rotary axes in the head, BK for rotary tables, CK for one of each; 1 and 2 for a single rotary axis counted
from the base, 4 for both together. The text of ISO 10791-6 was not available: what is evaluated is the range of the deviation
in each direction of the station's frame, and neither the names nor the quantity are verified against the standard.

**Thermal tests** after ISO 230-3 are evaluated from displacements over time, one file at a time:

    twin evaluate record.csv --iso230-3 --sensors d1=X1 d2=X2 d3=Y1 d4=Y2 d5=Z X1-X2=76 Y1-Y2=76 t5=ambient --html drift.html
    twin evaluate measured.csv --iso230-3 --tolerance d_Z_t=20 ETVE_Z=10

The file is a record of sensors (`time_s`, `<name>_um`, `<name>_urad` of a level or an autocollimator; optional `spindle_rpm`,
`T_<sensor>_degC`, axis positions, `round`) or a measurement table with `time_s` of a probe, an R-test or a tracker. An angle keeps the
name of its column (`ETVE_angle_<name>`). In a table, the nominal motion between the positions is
subtracted, and the displacement is that of the tool relative to the work; a tracker needs a target on each side for that. Directions
of sensors are given by `--sensors` or a comment `# sensors: d1=X1 …`, and never guessed: without them each sensor has values
of its own. X1 and Y1 are near the end of the mandrel, X2 and Y2 near the spindle nose; `d1=-X1` turns a sign. With the distances
(`X1-X2=76`, mm) the tilts A and B follow, right-handed for a spindle along Z. The ambient temperature is that of a sensor `ambient`.

- One pose, spindle at rest: environmental temperature variation error. `ETVE_X` … range over the test; `ETVE_X_per_K` the same divided
  by the range of the ambient temperature, `T_ambient`.
- Spindle ran: `d_X_end` displacement at the end of running, `d_X_60` range in the first 60 min, `d_X_t` range over the running period.
  All count from the last reading before the spindle ran. A rest of more than 60 min begins a new test (`spindle1`, `spindle2`).
- One linear axis at two target positions: `e_X_1`, `e_X_2` range at each, `e_X_1_end` … displacement at the end, `e_X_21` change of
  their distance. Several axes are separate rounds. For Z the places may lie beside each other.
- One rotary axis at three positions or more, cycle after cycle, in a table of a probe or an R-test: changes of location, orientation
  and zero of the axis (`E_X0C_end`, `E_A0C_end`, `zero_C_end`), of the shift along it and of the radial expansion (`axial_C_end`,
  `radial_C_end`) by least squares; with `_t` their ranges. They count from the first cycle, at the level of the sphere along the axis.

The kinds of test and the name ETVE come from the public scope of ISO 230-3:2020. Its text was not available: figures, symbols and
the signs of the tilts are not verified against it. `twin plan --drift` makes the schedule.

**Tolerances.** `A=10` applies to every test that has the value, `X:A=8` to that of X; µm or µrad. The absolute value is compared. The
verdict is that of ISO 14253-1: PASS if the value plus U is within the tolerance, FAIL if the value minus U exceeds it, otherwise
UNDECIDED. The exit status is 3 if a value exceeds its tolerance, decided or not, if no test gives it, or if the table allows no test at
all. U (95 %) is
propagated from the uncertainties of the readings (columns `u_x_mm` …, or `--instrument`), taken as independent; it does not contain
the instrument's scale error, temperature or set-up. Without an uncertainty PASS and FAIL are by the value alone and nothing is proven.
"""

from twin.standards.drift import evaluate_drift
from twin.standards.evaluate import evaluate
from twin.standards.result import EvaluationResult, NotEvaluated, StandardTest, StandardValue, ToleranceCheck

__all__ = [
    "EvaluationResult",
    "NotEvaluated",
    "StandardTest",
    "StandardValue",
    "ToleranceCheck",
    "evaluate",
    "evaluate_drift",
]
