"""Curves of the calibration that are right, but not where they stand: read for another component, or at another joint.

One number each, the share of the curves that belongs elsewhere: 1 if the calibration was filed wrongly. A program that reads E_BB for
E_CB, or puts a rotary axis's errors before the whole chain (Ellingsdalen 2021, listing 3.3), leaves just this.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations, zip_longest
from typing import Any, Final

import numpy as np

from twin._common.units import UM
from twin.diagnosis.candidates.candidate import Build, Candidate, Catalogue, Cell, Given, Source
from twin.diagnosis.candidates.signatures import Column, Part, first_component, of_components, of_values, scaled_to
from twin.machine.calibration import Calibration
from twin.machine.effects import Effect, ErrorMotion, split_name
from twin.machine.effects.specification import Advice, Found, Specification
from twin.machine.machine import DIRECTIONS, Axis
from twin.numerics.functions import Functions
from twin.numerics.functions import given as known

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


def misplaced(given: Given) -> Catalogue:
    """Every curve as another component, every axis's curves at another joint and before the chain, and what is exchanged."""
    machine, data, calibration, state = given.machine, given.data, given.calibration, given.state
    index = {axis.name: first_component(machine, axis.name) for axis in machine.axes}
    motions = [effect for effect in calibration.effects if isinstance(effect, ErrorMotion)]
    if not motions:
        return Catalogue(())
    curves = known(np.stack([np.broadcast_to(_values(motion, state), len(data)) for motion in motions], axis=1))
    found = []
    for k, motion in enumerate(motions):
        component, _, name = split_name(motion.name)
        for other, letter in enumerate(DIRECTIONS):
            if other != component and (other < 3) == _kind(motion):
                parts = [(index[name] + component, curves, k, -1.0), (index[name] + other, curves, k, 1.0)]
                where = f"{motion.name} as E_{letter}{name}"
                found.append(_one(where, of_components(parts), _renamed(motion, f"E_{letter}{name}", calibration)))
    for (k, one), (n, other_motion) in combinations(enumerate(motions), 2):
        if one.frame == other_motion.frame and _kind(one) == _kind(other_motion):
            at = index[one.frame.axis]
            places = [at + split_name(motion.name)[0] for motion in (one, other_motion)]
            parts = [
                (i, curves, c, sign)
                for i, way in zip(places, (1.0, -1.0), strict=True)
                for c, sign in ((n, way), (k, -way))
            ]
            found.append(_swapped_names(one, other_motion, of_components(parts)))
    for axis in machine.axes:
        own = {split_name(m.name)[0]: k for k, m in enumerate(motions) if m.frame.axis == axis.name}
        if not own:
            continue
        taken = [(index[axis.name] + i, curves, k, -1.0) for i, k in own.items()]
        for other_axis in machine.axes:
            if other_axis.name != axis.name and other_axis.side == axis.side:
                placed = [(index[other_axis.name] + i, curves, k, 1.0) for i, k in own.items()]
                found.append(_one(f"{axis.name} at {other_axis.name}", of_components([*taken, *placed])))
        before = _before_the_chain(own, curves, data.carrier == axis.side)
        found.append(_one(f"{axis.name} at {BASE}", scaled_to([*of_components(taken).parts, *before])))
    for a, b in combinations(machine.axes, 2):
        column = _swapped_axes(a, b, motions, state, index) if a.side == b.side and a.linear == b.linear else None
        if column is not None:
            found.append(_one(f"{a.name} and {b.name} exchanged", column))
    return Catalogue(tuple(found))


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
    return of_values(parts) if parts else None


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


def _before_the_chain(own: Mapping[int, int], curves: Functions, carried: np.ndarray) -> list[Part]:
    """An axis's errors as a shift and a turn about the base frame's origin of all that its side carries.

    Args:
        own: component → which curve it is.
        curves: all of them.
        carried: (n,) whether a reading's target is.
    """
    masked = Functions(curves.points, curves.count, lambda rows: curves.values(rows) * carried[rows, None])
    return [Part(("base", i) if i < 3 else ("base turn", i - 3), masked, k, UM) for i, k in own.items()]


SOURCE: Final = Source((MISPLACED,), misplaced)
