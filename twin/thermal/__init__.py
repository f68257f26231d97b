"""Fit displacements to temperatures and spindle speed over time, and state the expected error of predictions.

    twin thermal first.csv -o thermal.yaml --html thermal.html
    twin thermal second.csv --model thermal.yaml --continues --predicted predicted.csv

`twin.fit_thermal(twin.ThermalRecord.load("first.csv")).predict(other)` does the same from a script.
`save_model` and `load_model` of this package write and read `schema: twin.thermal-model/1`.

**Record.** A CSV table, a row a reading: `time_s`, optionally `spindle_rpm`, temperatures `T_<sensor>_degC`, displacements `<name>_um`.
Every cell is a number. A gap longer than five median intervals is refused: lags cannot be followed over it. Displacements and
temperatures count from the first row.

**Terms.** Each displacement is a sum of these, with standard uncertainties:

- `thermal_lag`, "d1 by t4": µm/K in the steady state, following the sensor with a first-order lag;
- `spindle_growth`: µm at the highest speed, following the speed (exponent 1: friction from load; 2: viscous friction) with a lag;
- `spindle_shift`: µm at the highest speed, at once with the speed;
- `thermal_drift`: µm, decaying from the unknown state at the start. It has no measured cause and is chosen only if nothing else fits.

**Choice.** A warm-up of hours holds few independent events, and a fit on all sensors predicts badly. Models are drawn from all subsets
of the candidates by their evidence. Residuals are taken as correlated in time; coefficients have physical prior limits (8 µm/K:
a metal part of 0.7 m). The prediction is the average of the drawn models. A term sums what the models say about one input; its
uncertainty contains their disagreement. "In 76 % of the models, else t9" means that the data do not decide between the two.

**Groups.** Sensors whose temperatures correlate above 0.95 cannot be distinguished: a term names the group and follows its mean.
Displacements that move together share the choice of terms.

**Expected error.** Parts of the record are left out and predicted: the rest after 40, 55 and 70 %, each of six blocks of time, and the
highest speed. The ratio of the errors found to the uncertainties computed widens every later uncertainty. Outside the fitted
temperatures and speeds the uncertainty grows, and a warning says so.

**Continuing.** A record that begins where the fitted one ended continues its lags; `--continues` says so where its clock starts anew.
Any other record starts in steady state at its first row, with larger uncertainty until the lags have settled.

**Limits.** Effects are linear in the temperatures. The correlation of errors is assumed stationary. Nothing is compensated in programs.
"""

from twin.thermal.fit import fit_thermal
from twin.thermal.model import ThermalModel, ThermalPrediction, ThermalTerm
from twin.thermal.model_file import load_model, save_model
from twin.thermal.record import ThermalRecord

__all__ = [
    "ThermalModel",
    "ThermalPrediction",
    "ThermalRecord",
    "ThermalTerm",
    "fit_thermal",
    "load_model",
    "save_model",
]
