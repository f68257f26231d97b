"""Candidates: curves of the calibration that are correct but assigned to the wrong component or joint.

The parameter is the share of the curves that belongs elsewhere: 1 if they are misassigned. This happens if a program reads E_BB for
E_CB, or applies a rotary axis's errors before the whole chain (Ellingsdalen 2021, listing 3.3).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, zip_longest
from typing import Any, Final, final

import numpy as np

from twin._common.units import UM
from twin.diagnosis.candidates.candidate import (
    Build,
    Candidate,
    CandidateInputs,
    CandidateSource,
    Catalogue,
    Column,
    SignatureTerm,
    Variant,
    component_column,
    first_component,
    scaled_column,
    tabulated_column,
)
from twin.machine.error_names import DIRECTIONS
from twin.machine.machine import Axis
from twin.model.calibration import Calibration
from twin.model.effects import Effect, ErrorMotion, split_name
from twin.model.effects.specification import Advice, FittedCause, Specification
from twin.numerics.functions import Functions, tabulated

BASE: Final = "the base"


def _title(where: str) -> str:
    curve, _, other = where.partition(" as ")
    if other:
        return f"calibration: curve {curve} belongs under {other}"
    if where.endswith("exchanged"):
        return f"calibration: curves of {where.removesuffix(' exchanged')} exchanged"
    axis, _, joint = where.partition(" at ")
    return f"calibration: errors of {axis} assigned to {joint if joint.startswith('the ') else f'joint {joint}'}"


def _evidence(of: FittedCause) -> str:
    curve, _, other = of.where.partition(" as ")
    if other:
        return f"the calibration's curve {curve} is the machine's {other}"
    if of.where.endswith("exchanged"):
        return f"in the calibration, the names of the curves of {of.where.removesuffix(' exchanged')} are exchanged"
    axis, _, joint = of.where.partition(" at ")
    return f"the calibration's error motions of {axis} act at {joint} instead of {axis}'s own joint"


MISPLACED: Final = Specification(
    name="misplaced",
    kind="calibration",
    title=_title,
    family="misassigned curves of the calibration",
    advice=Advice(
        "Calibration: the author and source of the file.",
        "Correct the file and diagnose again.",
        "Do not look for it in the machine: nothing mechanical is wrong here.",
    ),
    evidence=_evidence,
    rare=True,
    all_or_nothing=True,
    plain_forms=0,
)


@final
@dataclass(frozen=True, eq=False)
class _Curves:
    """The calibration's curves."""

    inputs: CandidateInputs
    motions: Sequence[ErrorMotion]
    functions: Functions  # one for each curve
    index: Mapping[str, int]  # of each axis's first error component

    def of(self, axis: Axis) -> dict[int, int]:
        """Return component → index of the curve, for one axis."""
        return {split_name(m.name)[0]: k for k, m in enumerate(self.motions) if m.frame.axis == axis.name}


def misplaced(inputs: CandidateInputs) -> Catalogue:
    """Return the ways in which curves may be misassigned: to another component, joint, the base frame, or exchanged in pairs."""
    motions = [effect for effect in inputs.calibration.effects if isinstance(effect, ErrorMotion)]
    if not motions:
        return Catalogue(())
    count, index = (
        len(inputs.data),
        {axis.name: first_component(inputs.machine, axis.name) for axis in inputs.machine.axes},
    )
    values = [np.broadcast_to(_values(motion, inputs.state), count) for motion in motions]
    curves = _Curves(inputs, motions, tabulated(np.stack(values, axis=1)), index)
    generators = (_other_components, _exchanged_names, _at_other_joints, _exchanged_axes)
    return Catalogue(tuple(candidate for generator in generators for candidate in generator(curves)))


def _other_components(curves: _Curves) -> Iterator[Candidate]:
    for k, motion in enumerate(curves.motions):
        component, _, name = split_name(motion.name)
        at = curves.index[name]
        for other, letter in enumerate(DIRECTIONS):
            if other != component and (other < 3) == _is_translation(motion):
                meant = f"E_{letter}{name}"
                parts = [(at + component, curves.functions, k, -1.0), (at + other, curves.functions, k, 1.0)]
                build = _renamed(motion, meant, curves.inputs.calibration)
                yield _candidate(f"{motion.name} as {meant}", component_column(parts), build)


def _exchanged_names(curves: _Curves) -> Iterator[Candidate]:
    for (k, one), (n, other) in combinations(enumerate(curves.motions), 2):
        if one.frame == other.frame and _is_translation(one) == _is_translation(other):
            first, second = (curves.index[one.frame.axis] + split_name(motion.name)[0] for motion in (one, other))
            parts = [
                (place, curves.functions, c, sign)
                for place, sign_of in ((first, 1.0), (second, -1.0))
                for c, sign in ((n, sign_of), (k, -sign_of))
            ]
            yield _swapped_names(one, other, component_column(parts))


def _at_other_joints(curves: _Curves) -> Iterator[Candidate]:
    data, axes = curves.inputs.data, curves.inputs.machine.axes
    for axis in axes:
        own = curves.of(axis)
        if not own:
            continue
        removed = [(curves.index[axis.name] + i, curves.functions, k, -1.0) for i, k in own.items()]
        for other in axes:
            if other.name != axis.name and other.side == axis.side:
                added = [(curves.index[other.name] + i, curves.functions, k, 1.0) for i, k in own.items()]
                yield _candidate(f"{axis.name} at {other.name}", component_column([*removed, *added]))
        in_base = _in_base_frame(own, curves.functions, data.carrier == axis.side)
        yield _candidate(f"{axis.name} at {BASE}", scaled_column([*component_column(removed).terms, *in_base]))


def _exchanged_axes(curves: _Curves) -> Iterator[Candidate]:
    for a, b in combinations(curves.inputs.machine.axes, 2):
        if a.side == b.side and a.linear == b.linear:
            column = _swapped_axes(a, b, curves.motions, curves.inputs.state, curves.index)
            if column is not None:
                yield _candidate(f"{a.name} and {b.name} exchanged", column)


def _is_translation(motion: ErrorMotion) -> bool:
    """Return whether a curve is a translation; only curves of the same unit can be confused."""
    return split_name(motion.name)[0] < 3


def _swapped_names(a: ErrorMotion, b: ErrorMotion, column: Column) -> Candidate:
    """Return the candidate that two curves of one axis have each other's names."""

    def build(values: np.ndarray, fixed: Mapping[str, float]) -> tuple[Effect, ...]:
        share = float(values[0])
        return _difference(a, b, share), _difference(b, a, share)

    alike = a.basis.nested or len(a.coefficients) == len(b.coefficients)
    same = a.basis == b.basis and a.domain == b.domain and alike
    return _candidate(f"{a.name} and {b.name} exchanged", column, build if same else None)


def _difference(motion: ErrorMotion, other: ErrorMotion, share: float) -> ErrorMotion:
    """Return ``share`` times the difference from a curve to another; both have the same basis and domain."""
    pairs = zip_longest(other.coefficients, motion.coefficients, fillvalue=0.0)
    return ErrorMotion(
        motion.name, motion.basis, motion.domain, tuple(share * (b - a) for b, a in pairs), wrapped=motion.wrapped
    )


def _swapped_axes(
    a: Axis, b: Axis, motions: Sequence[ErrorMotion], state: Mapping[str, Any], index: Mapping[str, int]
) -> Column | None:
    """Return the column for exchanged curves of two axes; None where a curve does not cover the other axis's positions."""
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


def _candidate(where: str, column: Column, build: Build | None = None) -> Candidate:
    return Candidate(MISPLACED, where, (("share", "1"),), (Variant((column,)),), 1.0, build)


def _values(motion: ErrorMotion, state: Mapping[str, Any]) -> np.ndarray:
    (values,) = motion.components(state).values()
    return np.asarray(values, dtype=float)


def _renamed(motion: ErrorMotion, name: str, calibration: Calibration) -> Build | None:
    """Return the function that moves a curve to another name; None if that name has a curve of another basis or domain."""
    there = calibration.curves.get(name)
    if there is not None and (there.family != motion.basis or there.domain != motion.domain):
        return None

    def build(values: np.ndarray, fixed: Mapping[str, float]) -> tuple[Effect, ...]:
        share = float(values[0])
        return _scaled(motion, motion.name, -share), _scaled(motion, name, share)

    return build


def _in_base_frame(own: Mapping[int, int], curves: Functions, carried: np.ndarray) -> list[SignatureTerm]:
    """Return an axis's errors (component → curve) as movements, about the base's origin, of all that its side carries (n,)."""
    masked = Functions(curves.points, curves.count, lambda rows: curves.values(rows) * carried[rows, None])
    return [SignatureTerm(("base", i) if i < 3 else ("base turn", i - 3), masked, k, UM) for i, k in own.items()]


SOURCE: Final = CandidateSource((MISPLACED,), misplaced)
