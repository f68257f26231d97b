"""Report of the state of a machine on one HTML page: largest errors, their effect at the tool, actions, uncertainty, sources.

    twin report --calibration mine.yaml --identified identified.json --tool-length 120 -o report.html --json report.json
    twin report --calibration mine.yaml --measured measured.csv -o report.html

One self-contained HTML file for a screen, a phone and paper (print it from the browser); `--json` has every number on it
(`schema: twin.reporting/1`). It needs the extra `plots`.

**Contents, in this order.** Summary: the largest errors, their effect at the tool with U, and what to adjust, to compensate in the
control or in programs, to measure again, and not to do. Error budget as bars, by error motion and by class of ISO/TR 16907. Every error
motion with its 95 % interval: both directions of approach for an axis with backlash, a polar plot for a rotary axis. Squareness and
axis locations. Error over the volume as a 3D field and in planes. Error before and after compensation. U over the volume. Errors that
were not identifiable, have no uncertainty, or are absent from the calibration. Files with their SHA-256 digests, versions, random
seeds. Warnings about the source of the numbers (illustrative, simulated readings, unsettled estimate, unknown uncertainty) stand at the
top.

**Input.** The calibration gives errors and their covariance. Without a covariance U is unknown, never zero; if only some errors have
one, U is given as "at least". `--identified` (the JSON of `twin identify`) adds the quality of the fit and the errors that were not
identifiable; if its numbers differ from those of the calibration, the summary states this and the exit status is 3. `--measured` shows
the measured points at each position, including outliers, because removing them could hide backlash.

**Computation.** "Compensated" is the error after compensation of a program: rotary words are rounded, the linear axes are solved again,
rounded, and limited to the axis travel. The uncertainty of the calibration is added by 1,000 machines drawn from its covariance: RMS
and percentiles are over all of them, the largest error is its mean over the machines, with their 95 % interval. Errors that tables in
the control leave are computed by making these tables with the defaults of `twin control`. An adjustment is recommended only if it
reduces the RMS error over the volume by at least 5 % and the error exceeds its own 95 % half-width. The field is computed with the
rotary axes at zero and cannot show wavelengths shorter than its grid; the budget covers all axes. Effects that need a temperature or a
time use `--temperature` and `--time`; without them they are omitted and listed, and the exit status is 3. A tolerance whose value is
exceeded or unknown is 3 as well.
"""

from twin.reporting.result import SCHEMA, MachineReport, machine_report

__all__ = ["SCHEMA", "MachineReport", "machine_report"]
