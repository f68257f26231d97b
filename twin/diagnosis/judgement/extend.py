"""Empirical effects, without a known cause, fitted to the patterns that no named cause explains.

Their coefficients are the most likely ones at the variances of the patterns, with the causes fixed at their written sizes. They enter
a calibration only if held-out readings confirm them, and are valid only within the measured ranges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin.diagnosis.judgement.held_out import held_out_patterns
from twin.diagnosis.judgement.sizes import SizedCauses
from twin.diagnosis.problem.problem import Problem, in_um, rms
from twin.diagnosis.result import Extension, HeldOut, Term
from twin.diagnosis.selection.cross_validation import ENOUGH
from twin.diagnosis.selection.likelihood import Likelihood
from twin.diagnosis.selection.pattern_test import PatternTest
from twin.machine.calibration import Calibration
from twin.machine.effects import Empirical
from twin.machine.empirical_entry import acting_frame, available_in_programs, unused_place
from twin.machine.machine import Machine
from twin.numerics.covariance import Covariance

DIRECTIONS: Final = 3


@final
@dataclass(frozen=True, eq=False)
class EmpiricalExtension:
    """Empirical effects fitted to the unexplained patterns.

    Attributes:
        extension: their description in the result.
        effects: those that are written; empty if held-out readings do not confirm them.
        covariance: of their parameters.
        written: numbers of their patterns.
        left_um: RMS per coordinate of the patterns that are not written.
    """

    extension: Extension
    effects: tuple[Empirical, ...]
    covariance: Covariance
    written: tuple[int, ...]
    left_um: float


def extend(sized: SizedCauses, calibration: Calibration) -> EmpiricalExtension:
    """Fit an empirical effect to each pattern, and test on held-out readings whether the effects reduce the residuals.

    Args:
        sized: the causes with their sizes.
        calibration: the calibration tested.
    """
    found, forms = sized.found, sized.forms
    likelihood = found.structure.likelihood
    if likelihood is None or not likelihood.pattern_tests:
        return _not_extended(Extension((), 0.0, None, False, "it depends on no column of the table"))
    machine, problem = found.problem.network.machine, found.problem
    model = likelihood.fit(forms, found.structure.model)
    left = problem.residual - sized.estimate.signature.sum(axis=1)
    which, values, covariance = likelihood.most_likely(model, likelihood.slope_with(left))
    terms: list[Term] = []
    effects: list[Empirical] = []
    written: list[int] = []
    kept = np.zeros(len(which), dtype=bool)
    moved, stays = np.zeros((2, len(problem.residual)))
    taken = [effect.name for effect in calibration.extra]
    for k, pattern_test in enumerate(likelihood.pattern_tests):
        own = likelihood.group[which] // DIRECTIONS == k
        made = likelihood.effect_on_readings(which[own], values[own])
        term = _term(pattern_test, machine, _rms(problem, made), taken)
        if term.reason is None:
            effects.append(_effect(term, pattern_test, machine, likelihood, k, which[own], values[own]))
            taken.append(effects[-1].name)
            written.append(k)
            kept |= own
            moved += made
        else:
            stays += made
        terms.append(term)
    held = held_out_patterns(found, forms, written) if effects else None
    reason = _unproven(held) if effects else "; ".join(dict.fromkeys(str(term.reason) for term in terms))
    extension = Extension(tuple(terms), _rms(problem, moved), held, reason is None, reason)
    if reason is not None:
        return _not_extended(extension)
    names = tuple(parameter.name for effect in effects for parameter in effect.parameters)
    matrix = read_only(covariance[np.ix_(kept, kept)])
    return EmpiricalExtension(
        extension, tuple(effects), Covariance(names, matrix), tuple(written), _rms(problem, stays)
    )


def _not_extended(extension: Extension) -> EmpiricalExtension:
    return EmpiricalExtension(extension, (), Covariance.none(), (), 0.0)


def _rms(problem: Problem, made: np.ndarray) -> float:
    """Return the RMS per coordinate, µm, of (3n,) whitened shifts after projecting out the set-up."""
    return rms(in_um(problem.network, problem.project(made)), problem.network.read)


def _term(pattern_test: PatternTest, machine: Machine, size: float, taken: Sequence[str]) -> Term:
    """Return the term of a pattern, with the reason if it cannot become an effect."""
    pattern = pattern_test.pattern
    columns = pattern.waves(pattern_test.level)
    along = _along(pattern_test)
    reason = None
    unknown = [one.column for one in columns if not available_in_programs(one.column, machine)]
    if unknown:
        reason = f"it depends on {' and '.join(unknown)}, which a later program does not know"
    elif size == 0.0:
        reason = "with the causes in the model its size is zero"
    else:
        try:
            acting_frame(pattern.side, along, machine)
        except InputError as error:
            reason = error.what
    ranges = {one.column: one.range for one in columns if one.range is not None}
    return Term(unused_place(pattern.side, columns, taken), along, pattern.names, ranges, size, reason)


def _along(pattern_test: PatternTest) -> Literal["base", "tool", "work"]:
    if pattern_test.pattern.field == "base":
        return "base"
    return "tool" if pattern_test.pattern.side == "tool" else "work"


def _effect(
    term: Term,
    pattern_test: PatternTest,
    machine: Machine,
    likelihood: Likelihood,
    k: int,
    which: np.ndarray,
    values: np.ndarray,
) -> Empirical:
    """Return the empirical effect of one pattern.

    Args:
        term: side, columns and ranges of the effect.
        pattern_test: the pattern.
        machine: the machine.
        likelihood: of all patterns.
        k: number of this pattern.
        which: numbers of its columns with a coefficient.
        values: their coefficients, µm.
    """
    columns = pattern_test.pattern.waves(pattern_test.level)
    # Columns are sorted by direction, then by function.
    names = np.array(Empirical.names(columns)).ravel()
    own = np.flatnonzero(likelihood.group // DIRECTIONS == k)
    chosen = names[np.searchsorted(own, which)].tolist()
    frame, turning = acting_frame(pattern_test.pattern.side, _along(pattern_test), machine)
    numbers = dict(zip(chosen, values.tolist(), strict=True))
    return Empirical(term.where, _along(pattern_test), columns, numbers, frame, turning)


def _unproven(held: HeldOut | None) -> str | None:
    """Return why held-out readings do not confirm the effects; None if they do."""
    if held is None:
        return "no readings could be held out to confirm it"
    if held.ci95_um is None:
        return f"fewer than {ENOUGH} {held.of} could be held out, too few to confirm it"
    if held.ci95_um[0] <= 0.0:
        return (
            f"held-out {held.of} do not confirm it ({held.before_um:.3g} µm without it, {held.after_um:.3g} µm with it)"
        )
    return None
