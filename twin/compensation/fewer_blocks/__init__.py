"""Tool paths: reduce a program's runs of short blocks, or points of a curve, to as few blocks as a tolerance allows.

    twin path cone_frustum.cls -o fewer.nc --tolerance 0.02

**Input.** A program (ISO, Heidenhain, APT) or a table of points (`.csv` with `x_mm,y_mm,z_mm`, and for five axes also `B_deg,C_deg`
or a tool vector `i,j,k`).

**Method.** Runs of short feed blocks are fitted from corner to corner with fg-Bernstein curves of as few control points as possible.
The curves are then cut into as few straight blocks as possible, and the blocks are compensated. Everything else passes through byte
for byte. A run that cannot be shortened stays as it is, and so do inverse-time blocks (G93).

**Tolerance.** The tolerance holds for the executed path compared with the path of the input, in both directions: fit, chords,
compensation and rounding together. The report states how much of it each step used, and the resulting uncertainty of the path.

**Example.** A five-axis path of 20,000 blocks with words rounded to 1 µm and 0.001°, tolerance 10 µm, compensated: 1,439 blocks on
242 control points, largest deviation 7.2 µm on the machine with errors.

From a script: `twin.refit("part.nc", machine, options=twin.Options(tolerance_mm=0.01)).text`.
"""

from twin.compensation.fewer_blocks.refit import Refit, Refitter, refit
from twin.compensation.fewer_blocks.report import PathReport, UncertaintyContribution, combined

__all__ = ["PathReport", "Refit", "Refitter", "UncertaintyContribution", "combined", "refit"]
