"""Candidates among the curves: an error motion of the calibration that is wrong or missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from twin.diagnosis.candidates.candidate import Build, Candidate, CandidateSource, Catalogue, Cell, CandidateInputs
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
from twin.machine.machine import DIRECTIONS, Axis
from twin.machine.motion_curve import Curve
from twin.numerics.curves import POWER, CurveSpace, conversion
from twin.numerics.functions import Functions, Rows

CUBIC: Final = 3
"""Degree of what is added to a curve that is no polynomial."""
DEGREES: Final = 8
"""Largest degree of a curve that is tried."""


def curves(inputs: CandidateInputs) -> Catalogue:
    """Curves in orthonormal functions, written as powers: of the linear axes, and of rotary ones that have polynomials."""
    every = [(axis, component) for axis in inputs.machine.axes for component in range(len(DIRECTIONS))]
    found = [_candidate(inputs, axis, component) for axis, component in every]
    return Catalogue(tuple(one for one in found if one is not None))


def _candidate(inputs: CandidateInputs, axis: Axis, component: int) -> Candidate | None:
    """One error motion; None where none can be tried, or too few positions show it."""
    name, curve = f"E_{DIRECTIONS[component]}{axis.name}", None
    if (known := inputs.calibration.curves.get(name)) is not None:
        curve = known.in_powers()
    tried = _tried(axis, known, curve)
    if tried is None:
        return None
    domain, degrees = tried
    q = inputs.state[axis.name]
    at = np.clip(q if axis.lower is not None else domain[0] + np.mod(q - domain[0], 360.0), *domain)
    count = min(degrees, len(np.unique(np.round(at, 3))) - 1) + 1
    space = CurveSpace(name, POWER, domain, 0, max(count, 1))
    specification = specification_of(axis, component)
    # What the datum leaves a curve (`twin.identification.unknowns`): no constant, and a straightness no slope.
    own = 2 if specification is STRAIGHTNESS else 1
    if count <= own:
        return None
    patterns = mistakes(space, curve)
    functions = _shaped(space, at, tuple(patterns.values()))
    at_frame = first_component(inputs.machine, axis.name) + component
    columns = tuple(component_column([(at_frame, functions, k, 1.0)]) for k in range(functions.count))
    variants = [
        Cell(columns[first : degree + 1], {"first": float(first)}) for degree in range(own, count) for first in (0, own)
    ]
    short = [Cell((columns[space.count + k],), {"stops": stops}) for k, stops in enumerate(patterns)]
    tests = float(count - own + min(len(short), 2))
    names = tuple((f"g{k}", unit_of(name)) for k in range(count))
    build = _builder(space, patterns, wrapped=axis.lower is None)
    return Candidate(specification, name, names, (*variants, *short), tests, build, space=space)


def _tried(axis: Axis, known: Curve | None, curve: Curve | None) -> tuple[tuple[float, float], int] | None:
    """Domain and largest degree of what may be added to a curve, as the calibration has it and in powers; None for nothing."""
    if curve is not None:
        return curve.domain, max(DEGREES, len(curve.coefficients) - 1)
    if known is not None:
        # Of another kind: no more than can be added to it.
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


def _shaped(space: CurveSpace, at: np.ndarray, patterns: Sequence[np.ndarray]) -> Functions:
    """A curve's orthonormal functions, and after them sums of these.

    Args:
        space: the functions.
        at: (n,) positions.
        patterns: (count,) coefficients of each sum.
    """
    sums = np.stack(patterns, axis=1) if patterns else np.zeros((space.count, 0))

    def values(rows: Rows) -> np.ndarray:
        found = space.functions(at[rows])
        return np.concatenate([found, found @ sums], axis=1)

    return Functions(len(at), space.count + sums.shape[1], values)


SOURCE: Final = CandidateSource((POSITIONING, STRAIGHTNESS, ANGULAR_ERROR_MOTION, ROTARY_ERROR_MOTION), curves)
