"""Solving fast on one machine: straight-line code from CasADi's, compiled to SIMD where there is a compiler, run by NumPy where not.

`python -m tests.benchmarks` measures all of this (half an hour; a name after it, `solve`, `programs`, `diagnosis`, `growth`,
alone). Below: AMD EPYC (family 25, AVX-512), two shared cores.

**Solving.** From 50,000 poses in one call on, the inverse and the kinematics run as C++ generated for the machine and compiled
once (one or two seconds) where `c++`, `g++`, `clang++` or `$CXX` is found. Five-axis poses with all 30 curves, µs of processor
a pose: 0.19 (B 20 to 160°), 0.29 over all of B; 4.3 and 5.7 by NumPy, where there is no compiler. Both ways give the same
statuses, and positions within 1e-9 mm. Libraries are kept in `$XDG_CACHE_HOME/twin` (`~/.cache/twin`); `TWIN_NATIVE=0` switches
them off; `twin info` says which way is in use. The same work beside it in the same run, times as long a pose and core (smallest
to largest of the repeats):

| `scipy.optimize.root` on Pinocchio | pink, one iteration, no errors | the thesis's, refitted | forward: Pinocchio from Python |
|---|---|---|---|
| 7,500 (4,200 to 11,800) | 630 (350 to 920) | 7,000 (4,000 to 8,900) | 30 (24 to 33) |

**Programs.** `twin compensate` works through ISO programs of any length in stretches: a million five-axis blocks in 4.6 s
(217,000 a second; 195,000 in another run), in 410 to 490 MB whatever the length, read, solved, checked, split, written, read
back and accounted for; 109 times as long as copying the same bytes. Plain language, APT, drilling cycles and calibrations with
reversals are still held in memory. `twin.compensate_file(…)` is the same from a script. Where the calibration has a covariance,
U of a long program is worked out at some block ends and interpolated between them, within 1 %
(`twin/compensation/account/interpolation.py`).

**Measurements.** 100,000 points: `identify` 46 s and 1.2 GB, `diagnose` 40 s and 1.2 GB (the command, with table and page, 46
s). A calibration that is itself uncertain takes `diagnose` longer: in 188 numbers 79 s and 1.9 GB, in 350 numbers 102 s and 2.4
GB. Both grow in proportion to the points. From readings to names, stepwise BIC with statsmodels on the same candidates takes
1.3 times as long (1.2 to 1.7) at 1,000 points and 3.7 times (3.3 to 4.4) at 3,000; of 25 draws each (± 10 %) it names right and
nothing beside 56, 64 and 68 % (one effect at λ = 30, one at 60, two at 60), `twin` 80, 100 and 92 %; with nothing hidden it
raises an alarm in 12 %, `twin` in none.
"""

from twin.compute.native.loading import in_use
from twin.compute.native.problem import (
    CONVERGED,
    OUT_OF_RANGE,
    SINGULAR,
    Batch,
    BatchOutcome,
    InverseProblem,
    StepFunctions,
)
from twin.compute.native.rows import RowFunction, Taken
from twin.compute.native.solver import Solver

__all__ = [
    "CONVERGED",
    "OUT_OF_RANGE",
    "SINGULAR",
    "Batch",
    "BatchOutcome",
    "InverseProblem",
    "RowFunction",
    "Solver",
    "StepFunctions",
    "Taken",
    "in_use",
]
