"""Curves of the calibration that are right, but not where they stand: read for another component, or at another joint.

One number each, the share of the curves that belongs elsewhere: 1 if the calibration was filed wrongly. A program that reads E_BB for
E_CB, or puts a rotary axis's errors before the whole chain (Ellingsdalen 2021, listing 3.3), leaves just this.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations, zip_longest
from typing import Any, Final

import numpy as np

from twin.calibration import Calibration
from twin.diagnosis.catalogue import Candidate, Cell
from twin.diagnosis.signatures import LARGEST, Column, of_components
from twin.effects import Effect, ErrorMotion, split_name
from twin.identification.network import View
from twin.machine import DIRECTIONS, Axis, Machine
from twin.measurement import Measurements, state_of
from twin.spatial import cross_matrix
from twin.units import UM

EFFECT: Final = "misplaced"
BASE: Final = "the base"


def misplaced(machine: Machine, data: Measurements, calibration: Calibration) -> list[Candidate]:
    """Every curve as another component, every axis's curves at another joint and before the chain, and what is exchanged."""
    state = state_of(data, machine)
    index = {frame.axis: 6 * i for i, frame in enumerate(machine.frames) if frame.role == "motion"}
    motions = [effect for effect in calibration.effects if isinstance(effect, ErrorMotion)]
    found = []
    for motion in motions:
        component, _, name = split_name(motion.name)
        values = _values(motion, state)
        for other, letter in enumerate(DIRECTIONS):
            if other != component and (other < 3) == _kind(motion):
                parts = {index[name] + component: -values, index[name] + other: values}
                where = f"{motion.name} as E_{letter}{name}"
                found.append(_one(where, of_components(parts), _renamed(motion, f"E_{letter}{name}", calibration)))
    for one, other_motion in combinations(motions, 2):
        if one.frame == other_motion.frame and _kind(one) == _kind(other_motion):
            found.append(_swapped_names(one, other_motion, state, index))
    for axis in machine.axes:
        own = {split_name(m.name)[0]: _values(m, state) for m in motions if m.frame.axis == axis.name}
        if not own:
            continue
        taken = {index[axis.name] + i: -values for i, values in own.items()}
        for other_axis in machine.axes:
            if other_axis.name != axis.name and other_axis.side == axis.side:
                placed = taken | {index[other_axis.name] + i: values for i, values in own.items()}
                found.append(_one(f"{axis.name} at {other_axis.name}", of_components(placed)))
        found.append(_one(f"{axis.name} at {BASE}", _before_the_chain(taken, own, data.carrier == axis.side)))
    for a, b in combinations(machine.axes, 2):
        column = _swapped_axes(a, b, motions, state, index) if a.side == b.side and a.linear == b.linear else None
        if column is not None:
            found.append(_one(f"{a.name} and {b.name} exchanged", column))
    return found


def _kind(motion: ErrorMotion) -> bool:
    """Whether it is a translation: µm are no µrad, and a curve keeps its kind."""
    return split_name(motion.name)[0] < 3


def _swapped_names(a: ErrorMotion, b: ErrorMotion, state: Mapping[str, Any], index: Mapping[str, int]) -> Candidate:
    """Two curves of one axis, each under the other's name."""
    difference = _values(b, state) - _values(a, state)
    at = index[a.frame.axis]
    parts = {at + split_name(a.name)[0]: difference, at + split_name(b.name)[0]: -difference}

    def build(values: np.ndarray, fixed: Mapping[str, float]) -> tuple[Effect, ...]:
        share = float(values[0])
        return _less(a, b, share), _less(b, a, share)

    alike = a.basis.nested or len(a.coefficients) == len(b.coefficients)
    same = a.basis == b.basis and a.domain == b.domain and alike
    return _one(f"{a.name} and {b.name} exchanged", of_components(parts), build if same else None)


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
    return of_components(parts) if parts else None


def _scaled(motion: ErrorMotion, name: str, factor: float) -> ErrorMotion:
    return ErrorMotion(
        name, motion.basis, motion.domain, tuple(factor * c for c in motion.coefficients), wrapped=motion.wrapped
    )


def _one(
    where: str, column: Column, build: Callable[[np.ndarray, Mapping[str, float]], tuple[Effect, ...]] | None = None
) -> Candidate:
    return Candidate(EFFECT, where, "machine", (("share", "1"),), (Cell((column,)),), 1.0, build)


def _values(motion: ErrorMotion, state: Mapping[str, Any]) -> np.ndarray:
    (values,) = motion.components(state).values()
    return np.asarray(values, dtype=float)


def _renamed(
    motion: ErrorMotion, name: str, calibration: Calibration
) -> Callable[[np.ndarray, Mapping[str, float]], tuple[Effect, ...]] | None:
    """What moves a curve to another name; None where the curve that stands there is of another kind."""
    there = calibration.curves.get(name)
    if there is not None and (there.basis != motion.basis.name or there.domain != motion.domain):
        return None

    def build(values: np.ndarray, fixed: Mapping[str, float]) -> tuple[Effect, ...]:
        share = float(values[0])
        return _scaled(motion, motion.name, -share), _scaled(motion, name, share)

    return build


def _before_the_chain(taken: Mapping[int, np.ndarray], own: Mapping[int, np.ndarray], carried: np.ndarray) -> Column:
    """The axis's errors as a shift and a turn about the base frame's origin of all that its side carries."""
    away = of_components(taken)
    largest = max(float(np.abs(values).max(initial=0.0)) for values in own.values())

    def reading(view: View) -> np.ndarray:
        found = away.reading(view)
        mask = carried[view.rows]
        turned = -cross_matrix(view.points)
        for i, values in own.items():
            moved = view.by_base[:, :, i] if i < 3 else np.einsum("nij,nj->ni", view.by_base, turned[:, :, i - 3])
            found += moved * (values[view.rows] * mask * UM)[:, None]
        return found

    return Column(reading, LARGEST / largest if largest > 0.0 else 1.0)
