"""Solving fast on one machine: straight-line code from CasADi's, compiled to SIMD where there is a compiler, run by NumPy where not."""

from twin.native.loading import in_use
from twin.native.problem import CONVERGED, OUT_OF_RANGE, SINGULAR, Batch, Functions, Outcome, Problem
from twin.native.rows import RowFunction, Taken
from twin.native.solver import Solver

__all__ = [
    "CONVERGED",
    "OUT_OF_RANGE",
    "SINGULAR",
    "Batch",
    "Functions",
    "Outcome",
    "Problem",
    "RowFunction",
    "Solver",
    "Taken",
    "in_use",
]
