"""Tool paths: points of a curve, or a program's runs of short blocks, as few blocks as a tolerance allows.

    twin path cone_frustum.cls -o fewer.nc --tolerance 0.02

The input is a program (ISO, Heidenhain, APT) or points (`.csv`: `x_mm,y_mm,z_mm`, then nothing, `B_deg,C_deg` or `i,j,k`). Runs
of short feed blocks are fitted from corner to corner with fg-Bernstein curves, with as few control points as the tolerance
allows, cut into as few blocks as it allows, and compensated. The tolerance holds for the executed path against the input's,
both ways: fit, chords, compensation and rounding together; the report says what each used and what that makes of the
uncertainty. Everything else passes through byte for byte; a run that cannot get shorter stays as it is, inverse-time blocks
(G93) too. A five-axis path of 20,000 blocks, words rounded to 1 µm and 0.001°, tolerance 10 µm, compensated: 1,439 blocks on
242 control points, 7.2 µm off at most on the machine with errors. From a script: `twin.refit("part.nc", machine,
options=twin.Options(tolerance_mm=0.01)).text`.
"""

from twin.compensation.fewer_blocks.refit import Refit, Refitter, refit
from twin.compensation.fewer_blocks.report import PathReport, UncertaintyContribution, combined

__all__ = ["PathReport", "Refit", "Refitter", "UncertaintyContribution", "combined", "refit"]
