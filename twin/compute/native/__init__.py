"""Fast solution on one computer: CasADi functions as straight-line code, compiled to SIMD, or run by NumPy without a compiler.

Manual: `twin doc speed`.
"""

from twin.compute.native.compiler import (
    ROUNDING,
    equal_portions,
    only_idle_threads,
    solver_description,
    worth_compiling,
)
from twin.compute.native.rows import CompiledAlong, RowFunction, Totals
from twin.compute.native.solver import (
    CONVERGED,
    OUT_OF_RANGE,
    SINGULAR,
    Batch,
    BatchOutcome,
    InverseProblem,
    Solver,
    StepFunctions,
)

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
