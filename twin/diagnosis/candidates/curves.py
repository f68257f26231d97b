"""Candidates: an error motion whose curve in the calibration is wrong or missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from twin.diagnosis.candidates.candidate import Build, Candidate, CandidateInputs, CandidateSource, Catalogue, Variant
from twin.diagnosis.candidates.flaws import mistakes
from twin.diagnosis.candidates.signatures import Column, component_column, first_component
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
    return Catalogue(tuple(one for axis in inputs.machine.axes for one in _of_axis(inputs, axis)))


def _of_axis(inputs: CandidateInputs, axis: Axis) -> list[Candidate]:
    """Return the candidates of the error motions of an axis; those of one domain and degree share their functions."""
    alike: dict[tuple[tuple[float, float], int], dict[int, tuple[CurveSpace, dict[float, np.ndarray]]]] = {}
    for component in range(len(DIRECTIONS)):
        found = _space_and_mistakes(inputs, axis, component)
        if found is not None:
            alike.setdefault((found[0].domain, found[0].count), {})[component] = found
    candidates: dict[int, Candidate] = {}
    for (domain, count), own in alike.items():
        shapes = [shape for _, patterns in own.values() for shape in patterns.values()]
        functions = _functions_with_sums(next(iter(own.values()))[0], _positions(inputs, axis, domain), shapes)
        start = count
        for component, (space, patterns) in own.items():
            index = [*range(count), *range(start, start + len(patterns))]
            at = first_component(inputs.machine, axis.name) + component
            columns = tuple(component_column([(at, functions, k, 1.0)]) for k in index)
            candidates[component] = _candidate(axis, component, space, patterns, columns)
            start += len(patterns)
    return [candidates[component] for component in sorted(candidates)]


def _space_and_mistakes(
    inputs: CandidateInputs, axis: Axis, component: int
) -> tuple[CurveSpace, dict[float, np.ndarray]] | None:
    """Return the functions of the correction of one error motion, and the coefficients of mistakes in its curve.

    None if its curve cannot be corrected or has too few positions.
    """
    name, curve = f"E_{DIRECTIONS[component]}{axis.name}", None
    if (known := inputs.calibration.curves.get(name)) is not None:
        curve = known.in_powers()
    limits = _domain_and_degree(axis, known, curve)
    if limits is None:
        return None
    domain, degrees = limits
    count = min(degrees, len(np.unique(np.round(_positions(inputs, axis, domain), 3))) - 1) + 1
    if count <= _fixed_by_datum(axis, component):
        return None
    space = CurveSpace(name, POWER, domain, 0, count)
    return space, mistakes(space, curve)


def _positions(inputs: CandidateInputs, axis: Axis, domain: tuple[float, float]) -> np.ndarray:
    """Return the (n,) positions of an axis inside a domain."""
    q = inputs.state[axis.name]
    return np.clip(q if axis.lower is not None else domain[0] + np.mod(q - domain[0], 360.0), *domain)


def _fixed_by_datum(axis: Axis, component: int) -> int:
    """Return the number of coefficients that the datum fixes: the constant, and the slope of a straightness.

    See `twin.identification.unknowns`.
    """
    return 2 if specification_of(axis, component) is STRAIGHTNESS else 1


def _candidate(
    axis: Axis,
    component: int,
    space: CurveSpace,
    patterns: Mapping[float, np.ndarray],
    columns: tuple[Column, ...],
) -> Candidate:
    """Return the candidate of one error motion, from the columns of its functions and of the mistakes in its curve."""
    first_free = _fixed_by_datum(axis, component)
    variants = [
        Variant(columns[first : degree + 1], {"first": float(first)})
        for degree in range(first_free, space.count)
        for first in (0, first_free)
    ]
    single_mistakes = [Variant((columns[space.count + k],), {"stops": stops}) for k, stops in enumerate(patterns)]
    tests = float(space.count - first_free + min(len(single_mistakes), 2))
    names = tuple((f"g{k}", unit_of(space.name)) for k in range(space.count))
    build = _builder(space, patterns, wrapped=axis.lower is None)
    specification = specification_of(axis, component)
    return Candidate(specification, space.name, names, (*variants, *single_mistakes), tests, build, space=space)


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
