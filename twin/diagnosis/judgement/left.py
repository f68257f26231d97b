"""What the causes leave: patterns without a name, or more scatter than stated; and what the misfit goes with before any is out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.distributions import chi2_sf, f_sf
from twin.diagnosis.judgement.sizes import Sized
from twin.diagnosis.problem.noise import Scatter
from twin.diagnosis.problem.problem import Problem, unwhitened
from twin.diagnosis.result import Trend, Unexplained
from twin.diagnosis.selection.structure import Findings
from twin.diagnosis.selection.unnamed import Trace, scan

SEEN_AT: Final = 0.05
"""Chance below which a column is said to go with the misfit."""
LARGE: Final = 1e-4
SMALL: Final = 0.01
"""Share of the excess below which what is left beside causes is noted, and no finding: real machines have some everywhere."""


@final
@dataclass(frozen=True)
class WholeMisfit:
    """The misfit of the readings.

    Attributes:
        p_value: chance of as large a one without any cause.
        expected_um: RMS a coordinate that the scatter lets expect.
        trends: columns it goes with, one by one, before any cause is taken out.
        left: what the causes leave of it; None where that is no more than scatter.
    """

    p_value: float
    expected_um: float
    trends: tuple[Trend, ...]
    left: Unexplained | None


def misfit_of(sized: Sized) -> WholeMisfit:
    """The misfit, and what the causes leave of it.

    Args:
        sized: the causes, with their sizes.
    """
    problem, found = sized.found.problem, sized.found
    chances = [_p_value(problem, found.posed.scatter), *(float(np.exp(t.log_paid)) for t in found.structure.traces)]
    return WholeMisfit(min(chances), _expected_um(problem), _trends(found), _unexplained(sized))


def _unexplained(sized: Sized) -> Unexplained | None:
    """What the causes leave: the patterns, or more scatter than stated."""
    found, forms, excess = sized.found, sized.forms, sized.excess
    problem, structure = found.problem, found.structure
    if structure.traces:
        patterns_um = unwhitened(problem, structure.pattern(forms))
        share = float(np.clip(structure.explained(forms) / excess, 0.0, 1.0))
        columns = tuple(dict.fromkeys(name for trace in structure.traces for name in trace.pattern.names))
        sides = {trace.pattern.side for trace in structure.traces}
        carrier = sides.pop() if len(sides) == 1 else "both"
        size = float(np.sqrt(np.nansum(patterns_um**2) / max(np.count_nonzero(problem.network.read), 1)))
        text = (
            f"a pattern that goes with {' and '.join(columns)} on the {carrier} side, {size:.2g} µm RMS a coordinate, "
            f"{100 * share:.2g} % of the excess, fits no effect that is known here"
        )
        return Unexplained(share, columns, carrier, text, size)
    after = problem.chi2 - sized.estimate.explained
    share = float((after - problem.dof) / excess) if forms else 1.0
    more = _p_value(problem, found.posed.scatter, after, len(forms))
    if more >= LARGE or (forms and share <= SMALL):
        return None
    size = float(np.sqrt(max(after / problem.dof - 1.0, 0.0))) * _expected_um(problem)
    what = "more scatter than stated" + (" is left" if forms else "")
    return Unexplained(share, (), "both", f"{what}, without any pattern in the columns given", size)


def _trends(found: Findings) -> tuple[Trend, ...]:
    """Columns the misfit goes with, one by one, before any cause is taken out."""
    single = [pattern for pattern in found.patterns if len(pattern.channels) == 1]
    best: dict[tuple[str, str], Trace] = {}
    for trace in scan(found.problem, [one for one in single if one.field == "base"], (), found.posed.scatter.dof):
        best.setdefault((trace.pattern.side, trace.pattern.names[0]), trace)
    return tuple(
        Trend(column, side, trace.explained, float(np.exp(trace.log_paid)))
        for (side, column), trace in best.items()
        if trace.log_paid < np.log(SEEN_AT)
    )


def _p_value(problem: Problem, scatter: Scatter, chi2: float | None = None, fitted: int = 0) -> float:
    """Chance of as large a misfit without any cause, or of a misfit once some numbers were fitted."""
    chi2, dof = problem.chi2 if chi2 is None else chi2, max(problem.dof - fitted, 1)
    if np.isfinite(scatter.dof):
        return float(f_sf(chi2 / dof, dof, scatter.dof))
    return float(chi2_sf(chi2, dof))


def _expected_um(problem: Problem) -> float:
    """RMS a coordinate that the scatter lets expect, µm."""
    variances = np.einsum("nii->ni", problem.network.covariance)[problem.network.read]
    return float(np.sqrt(np.mean(variances) * problem.dof / problem.readings)) * 1e6
