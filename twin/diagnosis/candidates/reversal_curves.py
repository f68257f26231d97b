"""Candidates of reversals that change along an axis's travel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from twin.diagnosis.candidates.candidate import Candidate, Catalogue, Cell, Given, Source
from twin.diagnosis.candidates.signatures import along_command, of_components
from twin.identification.unknowns import CurveSpace
from twin.machine.effects import Effect, ReversalCurve
from twin.machine.effects.reversal_curve import REVERSAL_CURVE
from twin.machine.machine import Axis
from twin.numerics.curves import POWER
from twin.numerics.functions import Functions, Rows

DEGREES: Final = 4
"""Largest degree that is tried."""


def reversal_curves(given: Given) -> Catalogue:
    """Of axes of limited range whose approach is known."""
    some = [_candidate(given, given.machine.by_name[name]) for name in REVERSAL_CURVE.places(given.machine)]
    return Catalogue(tuple(one for one in some if one is not None))


def _candidate(given: Given, axis: Axis) -> Candidate | None:
    """Half the side of approach times each orthonormal function of the position; None if too few positions have both sides."""
    side, q = given.state.get(f"approach_{axis.name}"), given.state[axis.name]
    if side is None:
        return None
    places = [np.unique(np.round(q[side == sign], 3)) for sign in (1.0, -1.0)]
    # A curve through every position would foretell none.
    degrees = min(DEGREES, min(len(one) for one in places) - 2)
    if degrees < 1:
        return None
    space = CurveSpace(REVERSAL_CURVE.name, POWER, axis.domain, 0, degrees + 1)

    def values(rows: Rows) -> np.ndarray:
        return np.asarray(0.5 * side[rows, None] * space.functions(np.clip(q[rows], *axis.domain)))

    def build(values: np.ndarray, fixed: Mapping[str, float]) -> tuple[Effect, ...]:
        n = len(values)
        return (ReversalCurve(axis, tuple(float(v) for v in space.transform[:n, :n] @ values)),)

    functions = Functions(len(q), space.count, values)
    along = along_command(given.machine, axis)
    columns = [of_components([(i, functions, k, part) for i, part in along]) for k in range(space.count)]
    cells = tuple(Cell(tuple(columns[: degree + 1])) for degree in range(1, space.count))
    names = tuple((f"g{k}", "um" if axis.linear else "urad") for k in range(space.count))
    return Candidate(REVERSAL_CURVE, axis.name, names, cells, float(space.count - 1), build, space=space)


SOURCE: Final = Source((REVERSAL_CURVE,), reversal_curves)
