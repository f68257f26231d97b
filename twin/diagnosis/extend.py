"""Effects without a known cause, made of the patterns that no named cause explains.

Their coefficients are what is most likely at the variances of the patterns, beside the causes as they are written. They enter a
calibration only where readings held out confirm them, and hold only within the ranges that were measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np

from twin.arrays import locked
from twin.calibration import Calibration
from twin.covariance import Covariance
from twin.diagnosis.estimate import Estimate
from twin.diagnosis.gain import ENOUGH, held_out_patterns, rms, unwhitened
from twin.diagnosis.likelihood import Likelihood
from twin.diagnosis.pool import Form
from twin.diagnosis.result import Extension, HeldOut, Term
from twin.diagnosis.structure import Findings
from twin.diagnosis.unnamed import Trace
from twin.effects import Empirical
from twin.empirical_entry import acting_frame, usable, where_of
from twin.errors import InputError
from twin.machine import Machine

DIRECTIONS: Final = 3


@final
@dataclass(frozen=True, eq=False)
class Extended:
    """What is made of the patterns.

    Attributes:
        extension: what is said of it.
        effects: those that are written; none where held-out readings do not confirm them.
        covariance: of their parameters.
        written: numbers of the patterns they are made of.
        left_um: RMS a coordinate of the patterns that are not written.
    """

    extension: Extension
    effects: tuple[Empirical, ...]
    covariance: Covariance
    written: tuple[int, ...]
    left_um: float


def extend(found: Findings, forms: Sequence[Form], estimated: Estimate, calibration: Calibration) -> Extended:
    """Make an effect of each pattern, and hold readings out to see whether they gain.

    Args:
        found: causes and patterns.
        forms: the causes that stand.
        estimated: their sizes.
        calibration: the model that was judged.
    """
    likelihood = found.structure.likelihood
    if likelihood is None or not likelihood.traces:
        return _refused((), None, "it goes with no column of the table", 0.0)
    machine, problem = found.problem.network.machine, found.problem
    model = likelihood.fit(forms, found.structure.model)
    left = problem.residual - estimated.signature.sum(axis=1)
    which, values, covariance = likelihood.most_likely(model, likelihood.slope_with(left))
    terms: list[Term] = []
    effects: list[Empirical] = []
    written: list[int] = []
    kept = np.zeros(len(which), dtype=bool)
    taken = [effect.name for effect in calibration.extra]
    for k, trace in enumerate(likelihood.traces):
        own = likelihood.group[which] // DIRECTIONS == k
        moved = unwhitened(problem, problem.project(likelihood.made(which[own], values[own])))
        term = _term(trace, machine, rms(moved, problem.network.read), taken)
        if term.reason is None:
            effects.append(_effect(term, trace, machine, likelihood, k, which[own], values[own]))
            taken.append(effects[-1].name)
            written.append(k)
            kept |= own
        terms.append(term)
    size = float(np.sqrt(sum(term.rms_um**2 for term in terms)))
    if not effects:
        reasons = dict.fromkeys(str(term.reason) for term in terms)
        return _refused(terms, None, "; ".join(reasons), size)
    held = held_out_patterns(found, forms, written)
    reason = _unproven(held)
    if reason is not None:
        return _refused(terms, held, reason, size)
    names = tuple(parameter.name for effect in effects for parameter in effect.parameters)
    left_um = float(np.sqrt(sum(term.rms_um**2 for term in terms if term.reason is not None)))
    return Extended(
        Extension(tuple(terms), held, True, None),
        tuple(effects),
        Covariance(names, locked(covariance[np.ix_(kept, kept)])),
        tuple(written),
        left_um,
    )


def _refused(terms: Sequence[Term], held: HeldOut | None, reason: str, size: float) -> Extended:
    return Extended(Extension(tuple(terms), held, False, reason), (), Covariance.none(), (), size)


def _term(trace: Trace, machine: Machine, size: float, taken: Sequence[str]) -> Term:
    """What an effect of a pattern would be, and why there can be none."""
    pattern = trace.pattern
    columns = pattern.waves(trace.level)
    along = _along(trace)
    reason = None
    unknown = [one.column for one in columns if not usable(one.column, machine)]
    if unknown:
        reason = f"it goes with {' and '.join(unknown)}, which a later program does not know"
    elif size == 0.0:
        reason = "beside the causes nothing of it is left"
    else:
        try:
            acting_frame(pattern.side, along, machine)
        except InputError as error:
            reason = error.what
    ranges = {one.column: one.range for one in columns if one.range is not None}
    return Term(where_of(pattern.side, columns, taken), along, pattern.names, ranges, size, reason)


def _along(trace: Trace) -> Literal["base", "tool", "work"]:
    if trace.pattern.field == "base":
        return "base"
    return "tool" if trace.pattern.side == "tool" else "work"


def _effect(
    term: Term, trace: Trace, machine: Machine, likelihood: Likelihood, k: int, which: np.ndarray, values: np.ndarray
) -> Empirical:
    """The effect of one pattern.

    Args:
        term: its place.
        trace: the pattern.
        machine: the machine.
        likelihood: of all patterns.
        k: number of this one.
        which: numbers of its columns that are followed.
        values: how much of each, µm.
    """
    columns = trace.pattern.waves(trace.level)
    # Columns of a direction stand together, in the order of the functions.
    names = np.array(Empirical.names(columns)).ravel()
    own = np.flatnonzero(likelihood.group // DIRECTIONS == k)
    chosen = names[np.searchsorted(own, which)].tolist()
    frame, turning = acting_frame(trace.pattern.side, _along(trace), machine)
    numbers = dict(zip(chosen, values.tolist(), strict=True))
    return Empirical(term.where, _along(trace), columns, numbers, frame, turning)


def _unproven(held: HeldOut | None) -> str | None:
    """Why held-out readings do not show that the effects gain; None where they do."""
    if held is None:
        return "nothing could be held out to confirm it"
    if held.ci95_um is None:
        return f"fewer than {ENOUGH} {held.of} could be held out, too few to confirm it"
    if held.ci95_um[0] <= 0.0:
        return (
            f"{held.of} held out do not confirm it ({held.before_um:.3g} µm without it, {held.after_um:.3g} µm with it)"
        )
    return None
