"""Fast solution on one computer: CasADi functions as straight-line code, compiled to SIMD, or run by NumPy without a compiler.

`python -m tests.benchmarks` measures all of this (half an hour; with a name after it, `solve`, `programs`, `diagnosis` or `growth`,
only that part). The figures below: AMD EPYC (family 25, AVX-512), two shared cores.

**Solving.** From 50,000 poses per call, the forward and inverse kinematics run as C++ generated for the machine and compiled
once (one or two seconds), if `c++`, `g++`, `clang++` or `$CXX` is found. Five-axis poses with all 30 curves, µs of processor time per
pose: 0.19 (B 20 to 160°), 0.29 over the whole range of B; 4.3 and 5.7 with NumPy, where there is no compiler. Both give the same
statuses, and positions within 1e-9 mm. Libraries are cached in `$XDG_CACHE_HOME/twin` (`~/.cache/twin`); `TWIN_NATIVE=0` switches
compiled code off; `twin info` shows which solver is in use. For comparison, other solvers in the same run, as multiples of the time per
pose and core (minimum to maximum of the repeats):

| `scipy.optimize.root` on Pinocchio | pink, one iteration, no errors | the thesis's, refitted | forward: Pinocchio from Python |
|---|---|---|---|
| 7,500 (4,200 to 11,800) | 630 (350 to 920) | 7,000 (4,000 to 8,900) | 30 (24 to 33) |

**Programs.** `twin compensate` processes ISO programs of any length in chunks: a million five-axis blocks in 2.0 to 2.7 s with
start-up, 1.5 to 1.9 s (520,000 a second or more) in a process that has started, in 275 MB whatever the length, including reading,
solving, checking, splitting, writing, reading back and reporting: 0.45 to 0.65 times as long as a plain Python loop that only parses
and prints the same words. A command takes 0.6 to 0.8 s before and after its program (AMD EPYC and Intel Xeon, two shared cores,
AVX-512; 2026-11-26). The check between block end points and the account are one compiled pass that keeps no value of a single point
(`along.cpp`). Plain language, APT, drilling cycles and calibrations with reversals are held in memory; processor time per block in µs:
axis words 2.5 to 3.5, tool-tip words 4 to 5, drilling strokes 5 to 7, plain language 5 to 6, APT 7 to 8.5, reversals 6.5 to 8, and 14
per chord of a circle. `twin.compensate_file(…)` does the same from a script.
If the calibration has a covariance, U of a long program is computed at some block ends and interpolated between them, within 1 %
(`twin/compensation/account/interpolation.py`).

**Measurements.** 100,000 points: `identify` 46 s and 1.2 GB (an earlier run), `diagnose` 41 s and 1.4 GB, with a calibration
that is uncertain in some 400 parameters 57 to 71 s and 1.9 GB (2026-11-26). Both grow in proportion to the points. Stepwise BIC with
statsmodels on the same candidates takes, from readings to named causes, 1.3 times as long (1.2 to 1.7) at 1,000 points and 3.7 times
(3.3 to 4.4) at 3,000. In 25 draws each (± 10 %) it finds exactly the true effects in 56, 64 and 68 % (one effect at λ = 30, one at 60,
two at 60), `twin` in 80, 100 and 92 %. Without any effect it raises a false alarm in 12 %, `twin` in none.
"""

from twin.compute.native.along import CompiledAlong, Totals
from twin.compute.native.cpp import ROUNDING
from twin.compute.native.loading import equal_portions, only_idle_threads, solver_description, worth_compiling
from twin.compute.native.problem import (
    CONVERGED,
    OUT_OF_RANGE,
    SINGULAR,
    Batch,
    BatchOutcome,
    InverseProblem,
    StepFunctions,
)
from twin.compute.native.rows import RowFunction
from twin.compute.native.solver import Solver

__all__ = [
    "CONVERGED",
    "OUT_OF_RANGE",
    "ROUNDING",
    "SINGULAR",
    "Batch",
    "BatchOutcome",
    "CompiledAlong",
    "InverseProblem",
    "RowFunction",
    "Solver",
    "StepFunctions",
    "Totals",
    "equal_portions",
    "only_idle_threads",
    "solver_description",
    "worth_compiling",
]
