"""Candidates among the curves: an error motion of the calibration that is wrong or missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from twin.diagnosis.candidates.candidate import Candidate, Catalogue, Cell, Given, Source
from twin.diagnosis.candidates.flaws import ITSELF, STOPS, of_curve, without_constant
from twin.diagnosis.candidates.signatures import first_component, of_components
from twin.machine.effects import Effect, ErrorMotion
from twin.machine.effects.error_motion import (
    ANGULAR_ERROR_MOTION,
    POSITIONING,
    ROTARY_ERROR_MOTION,
    STRAIGHTNESS,
    specification_of,
)
from twin.machine.machine import DIRECTIONS
from twin.numerics.curves import POWER, CurveSpace, conversion
from twin.numerics.functions import Functions, Rows

CUBIC: Final = 3
"""Degree of what is added to a curve that is no polynomial."""
DEGREES: Final = 8
"""Largest degree of a curve that is tried."""


def curves(given: Given) -> Catalogue:
    """Curves in orthonormal functions, written as powers: of the linear axes, and of rotary ones that have polynomials."""
    machine, state, calibration = given.machine, given.state, given.calibration
    found = []
    for axis in machine.axes:
        q = state[axis.name]
        for component, letter in enumerate(DIRECTIONS):
            name = f"E_{letter}{axis.name}"
            own_curve = calibration.curves.get(name)
            curve = None if own_curve is None else own_curve.in_powers()
            if curve is not None:
                domain, degrees = curve.domain, max(DEGREES, len(curve.coefficients) - 1)
            elif own_curve is not None:
                # Of another kind: no more than can be added to it.
                domain, degrees = own_curve.domain, CUBIC
                if conversion(POWER, own_curve.family, CUBIC + 1, len(own_curve.coefficients)) is None:
                    continue
            elif axis.linear and axis.lower is not None and axis.upper is not None:
                domain, degrees = (axis.lower, axis.upper), DEGREES
            else:
                continue
            at = np.clip(q if axis.lower is not None else domain[0] + np.mod(q - domain[0], 360.0), *domain)
            count = min(degrees, len(np.unique(np.round(at, 3))) - 1) + 1
            space = CurveSpace(name, POWER, domain, 0, max(count, 1))
            specification = specification_of(axis, component)
            wrapped = axis.lower is None
            # What one mistake did to the calibration's polynomial is one number, not as many as the polynomial has.
            shapes: dict[float, np.ndarray | None] = {}
            if curve is not None:
                shapes = {float(n): without_constant(space, len(curve.coefficients) - 1, n) for n in STOPS}
                shapes[ITSELF] = of_curve(space, curve)
            patterns = {stops: shape for stops, shape in shapes.items() if shape is not None}
            functions = _shaped(space, at, tuple(patterns.values()))
            at_frame = first_component(machine, axis.name) + component
            columns = tuple(of_components([(at_frame, functions, k, 1.0)]) for k in range(functions.count))

            def build(
                values: np.ndarray,
                fixed: Mapping[str, float],
                space: CurveSpace = space,
                wrapped: bool = wrapped,
                patterns: Mapping[float, np.ndarray] = patterns,
            ) -> tuple[Effect, ...]:
                if "stops" in fixed:
                    values = values[0] * patterns[fixed["stops"]]
                first = round(fixed.get("first", 0.0))
                n = first + len(values)
                coefficients = tuple(float(v) for v in space.transform[:n, first:n] @ values)
                return (ErrorMotion(space.name, space.basis, space.domain, coefficients, wrapped=wrapped),)

            # What the datum leaves a curve (`twin.identification.unknowns`): no constant, and a straightness no slope.
            own = 2 if specification is STRAIGHTNESS else 1
            cells = tuple(
                Cell(columns[first : degree + 1], {"first": float(first)})
                for degree in range(own, count)
                for first in (0, own)
            )
            if cells:
                short = tuple(Cell((columns[space.count + k],), {"stops": stops}) for k, stops in enumerate(patterns))
                tests = float(count - own + min(len(short), 2))
                names = tuple((f"g{k}", "um" if component < 3 else "urad") for k in range(count))
                found.append(Candidate(specification, name, names, (*cells, *short), tests, build, space=space))
    return Catalogue(tuple(found))


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


SOURCE: Final = Source((POSITIONING, STRAIGHTNESS, ANGULAR_ERROR_MOTION, ROTARY_ERROR_MOTION), curves)
