"""The state of a machine on one page: what is wrong most, what it makes at the tool, what to do, and what it rests on.

    twin report --calibration mine.yaml --identified identified.json --tool-length 120 -o report.html --json report.json
    twin report --calibration mine.yaml --measured measured.csv -o report.html

One self-contained HTML file for a screen, a phone and paper (print it from the browser); `--json` has every number on it
(`schema: twin.report/1`). It needs the extra `plots`.

**In this order.** What a shop can act on: the largest errors, what they make at the tool with U, what to adjust, what to put into the
control or into programs, what to measure again, and what not to do. The error budget as bars, by error motion and by class of ISO/TR
16907. Every error motion with its 95 % interval: both directions where a linear axis has a reversal, polar for a rotary one.
Squareness and locations. The error over the volume as a field in 3D, and in planes. Before and after compensation. U over the volume.
What could not be identified, has no uncertainty, or is not in the calibration at all. Files with their digests, versions, seeds.
Warnings of where the numbers come from (illustrative, simulated readings, unsettled estimate, unknown uncertainty) stand above all.

**What it can know.** The calibration gives errors and their covariance; where it gives none, U is unknown and never zero, and what is
known in part reads "at least". `--identified` (the JSON of `twin identify`) adds how well the model fitted and what the data could not
show; if its numbers are not those of the calibration, the first screen says so and the exit status is 3. `--measured` shows the points
stop by stop, those that are far off too: a screening would hide a lost motion.

**How it is reckoned.** "Compensated" is what a program would get: rotary words rounded and the linear axes solved again, rounded,
stopped at the ends of travel; what the calibration is uncertain by comes on top, drawn from its covariance. What tables in the control
leave is worked out by making them, as `twin control` does, with its defaults. Adjusting is advised only
for what takes off a twentieth of the error over the volume and is larger than its own 95 % half-width. The field stands at rotary zero
and shows no wave shorter than its grid; the budget covers all axes. Effects that need a temperature or a time take `--temperature` and
`--time`; without them they are left out, listed, and the exit status is 3.
"""

from twin.report.result import SCHEMA, MachineReport, machine_report

__all__ = ["SCHEMA", "MachineReport", "machine_report"]
