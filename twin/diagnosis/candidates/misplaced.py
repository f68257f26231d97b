"""Curves of the calibration that are right, but not where they stand: read for another component, or at another joint.

One number each, the share of the curves that belongs elsewhere: 1 if the calibration was filed wrongly. A program that reads E_BB for
E_CB, or puts a rotary axis's errors before the whole chain (Ellingsdalen 2021, listing 3.3), leaves just this.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, zip_longest
from typing import Any, Final, final

import numpy as np

from twin._common.units import UM
from twin.diagnosis.candidates.candidate import Build, Candidate, CandidateSource, Catalogue, Cell, CandidateInputs
from twin.diagnosis.candidates.signatures import (
    Column,
    SignatureTerm,
    component_column,
    first_component,
    scaled_column,
    tabulated_column,
)
from twin.machine.calibration import Calibration
from twin.machine.effects import Effect, ErrorMotion, split_name
from twin.machine.effects.specification import Advice, Found, Specification
from twin.machine.machine import DIRECTIONS, Axis
from twin.numerics.functions import Functions
from twin.numerics.functions import given as tabulated

BASE: Final = "the base"


def _title(where: str) -> str:
    curve, _, other = where.partition(" as ")
    if other:
        return f"calibration: curve {curve} belongs under {other}"
    if where.endswith("exchanged"):
        return f"calibration: curves of {where.removesuffix(' exchanged')} exchanged"
    axis, _, joint = where.partition(" at ")
    return f"calibration: errors of {axis} put at {joint if joint.startswith('the ') else f'joint {joint}'}"


def _evidence(of: Found) -> str:
    curve, _, other = of.where.partition(" as ")
    if other:
        return f"the calibration's curve {curve} is what the machine does as {other}"
    if of.where.endswith("exchanged"):
        return f"in the calibration, the curves of {of.where.removesuffix(' exchanged')} stand under each other's names"
    axis, _, joint = of.where.partition(" at ")
    return f"the calibration's error motions of {axis} act at {joint} instead of {axis}'s own joint"


MISPLACED: Final = Specification(
    name="misplaced",
    kind="calibration",
    title=_title,
    family="curves of the calibration in the wrong place",
    advice=Advice(
        "Whoever made the calibration file.",
        "Correct the file and diagnose again.",
        "Do not look for it in the machine: nothing mechanical is wrong here.",
    ),
    evidence=_evidence,
    seldom=True,
    whole=True,
    plain_forms=0,
)


@final
@dataclass(frozen=True, eq=False)
class _Curves:
    """The calibration's curves.

    Attributes:
        inputs: what candidates are made from.
        motions: the curves.
        functions: of the state, one a curve.
        index: of each axis's first error component.
    """

    inputs: CandidateInputs
    motions: Sequence[ErrorMotion]
    functions: Functions
    index: Mapping[str, int]

    def of(self, axis: Axis) -> dict[int, int]:
        """Component → number of the curve, of one axis."""
        return {split_name(m.name)[0]: k for k, m in enumerate(self.motions) if m.frame.axis == axis.name}


def misplaced(inputs: CandidateInputs) -> Catalogue:
    """Every curve as another component, every axis's curves at another joint and before the chain, and what is exchanged."""
    motions = [effect for effect in inputs.calibration.effects if isinstance(effect, ErrorMotion)]
    if not motions:
        return Catalogue(())
    count, index = (
        len(inputs.data),
        {axis.name: first_component(inputs.machine, axis.name) for axis in inputs.machine.axes},
    )
    values = [np.broadcast_to(_values(motion, inputs.state), count) for motion in motions]
    curves = _Curves(inputs, motions, tabulated(np.stack(values, axis=1)), index)
    every = (_as_others, _exchanged_names, _at_other_joints, _exchanged_axes)
    return Catalogue(tuple(candidate for some in every for candidate in some(curves)))


def _as_others(curves: _Curves) -> Iterator[Candidate]:
    for k, motion in enumerate(curves.motions):
        component, _, name = split_name(motion.name)
        at = curves.index[name]
        for other, letter in enumerate(DIRECTIONS):
            if other != component and (other < 3) == _kind(motion):
                meant = f"E_{letter}{name}"
                parts = [(at + component, curves.functions, k, -1.0), (at + other, curves.functions, k, 1.0)]
                build = _renamed(motion, meant, curves.inputs.calibration)
                yield _one(f"{motion.name} as {meant}", component_column(parts), build)


def _exchanged_names(curves: _Curves) -> Iterator[Candidate]:
    for (k, one), (n, other) in combinations(enumerate(curves.motions), 2):
        if one.frame == other.frame and _kind(one) == _kind(other):
            first, second = (curves.index[one.frame.axis] + split_name(motion.name)[0] for motion in (one, other))
            parts = [
                (place, curves.functions, c, sign)
                for place, way in ((first, 1.0), (second, -1.0))
                for c, sign in ((n, way), (k, -way))
            ]
            yield _swapped_names(one, other, component_column(parts))


def _at_other_joints(curves: _Curves) -> Iterator[Candidate]:
    data, axes = curves.inputs.data, curves.inputs.machine.axes
    for axis in axes:
        own = curves.of(axis)
        if not own:
            continue
        taken = [(curves.index[axis.name] + i, curves.functions, k, -1.0) for i, k in own.items()]
        for other in axes:
            if other.name != axis.name and other.side == axis.side:
                placed = [(curves.index[other.name] + i, curves.functions, k, 1.0) for i, k in own.items()]
                yield _one(f"{axis.name} at {other.name}", component_column([*taken, *placed]))
        before = _before_the_chain(own, curves.functions, data.carrier == axis.side)
        yield _one(f"{axis.name} at {BASE}", scaled_column([*component_column(taken).terms, *before]))


def _exchanged_axes(curves: _Curves) -> Iterator[Candidate]:
    for a, b in combinations(curves.inputs.machine.axes, 2):
        if a.side == b.side and a.linear == b.linear:
            column = _swapped_axes(a, b, curves.motions, curves.inputs.state, curves.index)
            if column is not None:
                yield _one(f"{a.name} and {b.name} exchanged", column)


def _kind(motion: ErrorMotion) -> bool:
    """Whether it is a translation: µm are no µrad, and a curve keeps its kind."""
    return split_name(motion.name)[0] < 3


def _swapped_names(a: ErrorMotion, b: ErrorMotion, column: Column) -> Candidate:
    """Two curves of one axis, each under the other's name."""

    def build(values: np.ndarray, fixed: Mapping[str, float]) -> tuple[Effect, ...]:
        share = float(values[0])
        return _less(a, b, share), _less(b, a, share)

    alike = a.basis.nested or len(a.coefficients) == len(b.coefficients)
    same = a.basis == b.basis and a.domain == b.domain and alike
    return _one(f"{a.name} and {b.name} exchanged", column, build if same else None)


def _less(motion: ErrorMotion, other: ErrorMotion, share: float) -> ErrorMotion:
    """What makes of a curve another, in full for a share of one; both of one basis and domain."""
    pairs = zip_longest(other.coefficients, motion.coefficients, fillvalue=0.0)
    return ErrorMotion(
        motion.name, motion.basis, motion.domain, tuple(share * (b - a) for b, a in pairs), wrapped=motion.wrapped
    )


def _swapped_axes(
    a: Axis, b: Axis, motions: Sequence[ErrorMotion], state: Mapping[str, Any], index: Mapping[str, int]
) -> Column | None:
    """The curves of two axes, each under the other's name; None where a curve does not reach over the other axis's positions."""
    parts: dict[int, np.ndarray] = {}
    for axis, other in ((a, b), (b, a)):
        q = np.asarray(state[axis.name], dtype=float)
        for motion in motions:
            at = index[axis.name] + split_name(motion.name)[0]
            if motion.frame.axis == axis.name:
                parts[at] = parts.get(at, 0.0) - _values(motion, state)
            elif motion.frame.axis == other.name:
                low, high = motion.domain
                if not motion.basis.periodic and (q.min() < low or q.max() > high):
                    return None
                parts[at] = parts.get(at, 0.0) + _values(motion, {**state, other.name: q})
    return tabulated_column(parts) if parts else None


def _scaled(motion: ErrorMotion, name: str, factor: float) -> ErrorMotion:
    return ErrorMotion(
        name, motion.basis, motion.domain, tuple(factor * c for c in motion.coefficients), wrapped=motion.wrapped
    )


def _one(where: str, column: Column, build: Build | None = None) -> Candidate:
    return Candidate(MISPLACED, where, (("share", "1"),), (Cell((column,)),), 1.0, build)


def _values(motion: ErrorMotion, state: Mapping[str, Any]) -> np.ndarray:
    (values,) = motion.components(state).values()
    return np.asarray(values, dtype=float)


def _renamed(motion: ErrorMotion, name: str, calibration: Calibration) -> Build | None:
    """What moves a curve to another name; None where the curve that stands there is of another kind."""
    there = calibration.curves.get(name)
    if there is not None and (there.family != motion.basis or there.domain != motion.domain):
        return None

    def build(values: np.ndarray, fixed: Mapping[str, float]) -> tuple[Effect, ...]:
        share = float(values[0])
        return _scaled(motion, motion.name, -share), _scaled(motion, name, share)

    return build


def _before_the_chain(own: Mapping[int, int], curves: Functions, carried: np.ndarray) -> list[SignatureTerm]:
    """An axis's errors as a shift and a turn about the base frame's origin of all that its side carries.

    Args:
        own: component → which curve it is.
        curves: all of them.
        carried: (n,) whether a reading's target is.
    """
    masked = Functions(curves.points, curves.count, lambda rows: curves.values(rows) * carried[rows, None])
    return [SignatureTerm(("base", i) if i < 3 else ("base turn", i - 3), masked, k, UM) for i, k in own.items()]


SOURCE: Final = CandidateSource((MISPLACED,), misplaced)
