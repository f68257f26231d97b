"""Candidates: an error motion whose curve in the calibration is wrong or missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from twin.diagnosis.candidates.candidate import Build, Candidate, CandidateInputs, CandidateSource, Catalogue, Variant
from twin.diagnosis.candidates.flaws import mistakes
from twin.diagnosis.candidates.signatures import component_column, first_component
from twin.machine.effects import Effect, ErrorMotion, unit_of
from twin.machine.effects.error_motion import (
    ANGULAR_ERROR_MOTION,
    POSITIONING,
    ROTARY_ERROR_MOTION,
    STRAIGHTNESS,
    specification_of,
)
from twin.machine.error_names import DIRECTIONS
from twin.machine.machine import Axis
from twin.machine.motion_curve import Curve
from twin.numerics.curves import POWER, CurveSpace, conversion
from twin.numerics.functions import Functions, Rows

CUBIC: Final = 3
"""Degree of the correction of a curve that is not a polynomial."""
DEGREES: Final = 8
"""Largest degree tried, unless the calibration's curve has a larger one."""


def curves(inputs: CandidateInputs) -> Catalogue:
    """Return corrections of the curves of linear axes, and of rotary axes with polynomial curves, in orthonormal polynomials."""
    every = [(axis, component) for axis in inputs.machine.axes for component in range(len(DIRECTIONS))]
    found = [_candidate(inputs, axis, component) for axis, component in every]
    return Catalogue(tuple(one for one in found if one is not None))


def _candidate(inputs: CandidateInputs, axis: Axis, component: int) -> Candidate | None:
    """Return the candidate of one error motion; None if its curve cannot be corrected or has too few positions."""
    name, curve = f"E_{DIRECTIONS[component]}{axis.name}", None
    if (known := inputs.calibration.curves.get(name)) is not None:
        curve = known.in_powers()
    limits = _domain_and_degree(axis, known, curve)
    if limits is None:
        return None
    domain, degrees = limits
    q = inputs.state[axis.name]
    at = np.clip(q if axis.lower is not None else domain[0] + np.mod(q - domain[0], 360.0), *domain)
    count = min(degrees, len(np.unique(np.round(at, 3))) - 1) + 1
    space = CurveSpace(name, POWER, domain, 0, max(count, 1))
    specification = specification_of(axis, component)
    # The datum fixes the constant of a curve, and the slope of a straightness (`twin.identification.unknowns`).
    fixed_by_datum = 2 if specification is STRAIGHTNESS else 1
    if count <= fixed_by_datum:
        return None
    patterns = mistakes(space, curve)
    functions = _functions_with_sums(space, at, tuple(patterns.values()))
    component_index = first_component(inputs.machine, axis.name) + component
    columns = tuple(component_column([(component_index, functions, k, 1.0)]) for k in range(functions.count))
    variants = [
        Variant(columns[first : degree + 1], {"first": float(first)})
        for degree in range(fixed_by_datum, count)
        for first in (0, fixed_by_datum)
    ]
    single_mistakes = [Variant((columns[space.count + k],), {"stops": stops}) for k, stops in enumerate(patterns)]
    tests = float(count - fixed_by_datum + min(len(single_mistakes), 2))
    names = tuple((f"g{k}", unit_of(name)) for k in range(count))
    build = _builder(space, patterns, wrapped=axis.lower is None)
    return Candidate(specification, name, names, (*variants, *single_mistakes), tests, build, space=space)


def _domain_and_degree(axis: Axis, known: Curve | None, curve: Curve | None) -> tuple[tuple[float, float], int] | None:
    """Return the domain and largest degree of the correction of a curve; None if it cannot be corrected.

    Args:
        axis: the axis.
        known: the calibration's curve; None if there is none.
        curve: the same in powers; None if it is not a polynomial.
    """
    if curve is not None:
        return curve.domain, max(DEGREES, len(curve.coefficients) - 1)
    if known is not None:
        # Another basis: only a correction that this basis can represent.
        fits = conversion(POWER, known.family, CUBIC + 1, len(known.coefficients)) is not None
        return (known.domain, CUBIC) if fits else None
    if axis.linear and axis.lower is not None and axis.upper is not None:
        return (axis.lower, axis.upper), DEGREES
    return None


def _builder(space: CurveSpace, patterns: Mapping[float, np.ndarray], *, wrapped: bool) -> Build:
    def build(values: np.ndarray, fixed: Mapping[str, float]) -> tuple[Effect, ...]:
        if "stops" in fixed:
            values = values[0] * patterns[fixed["stops"]]
        first = round(fixed.get("first", 0.0))
        n = first + len(values)
        coefficients = tuple(float(v) for v in space.transform[:n, first:n] @ values)
        return (ErrorMotion(space.name, space.basis, space.domain, coefficients, wrapped=wrapped),)

    return build


def _functions_with_sums(space: CurveSpace, at: np.ndarray, patterns: Sequence[np.ndarray]) -> Functions:
    """Return a curve's orthonormal functions, followed by linear combinations of them.

    Args:
        space: the functions.
        at: (n,) positions.
        patterns: coefficients (count,) of each combination.
    """
    sums = np.stack(patterns, axis=1) if patterns else np.zeros((space.count, 0))

    def values(rows: Rows) -> np.ndarray:
        found = space.functions(at[rows])
        return np.concatenate([found, found @ sums], axis=1)

    return Functions(len(at), space.count + sums.shape[1], values)


SOURCE: Final = CandidateSource((POSITIONING, STRAIGHTNESS, ANGULAR_ERROR_MOTION, ROTARY_ERROR_MOTION), curves)
