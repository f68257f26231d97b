"""Candidates: curves of the calibration that are misassigned; and single mistakes in making a curve, which explain its correction.

The parameter of a misassigned curve is the share that belongs elsewhere: 1 if a program reads E_BB for E_CB, or applies a rotary axis's
errors before the whole chain (Ellingsdalen 2021, listing 3.3).

A correction Δ of a curve f was estimated in orthonormal functions, with covariance C. A mistake predicts Δ up to a few parameters;
the rest is tested by a Wald chi². The simplest mistake that is not rejected is named:
- f was applied with a wrong factor (zero, wrong sign, twice, another unit): Δ = (s − 1)·f;
- f was fitted without a constant term (Ellingsdalen 2021, listing 3.1: every degree above one), so that it is zero at q = 0 where the
  machine's error is not: Δ = c·(1 − the least-squares fit of 1 by q, q² … qⁿ at the stops);
- f is a polynomial of too high a degree for its stops and oscillates between them: Δ cancels f above some degree.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, zip_longest
from typing import Any, Final, final

import numpy as np

from twin._common.distributions import chi2_sf
from twin._common.messages import Message
from twin._common.units import UM
from twin.diagnosis.candidates.candidate import (
    Build,
    Candidate,
    CandidateInputs,
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
from twin.model.motion_curve import Curve
from twin.numerics.curves import CurveSpace
from twin.numerics.functions import Functions, tabulated

BASE: Final = "the base"


def _joint(name: str) -> str:
    return Message("the base") if name == BASE else Message("joint {name}", name=name)


def _title(where: str) -> str:
    curve, _, other = where.partition(" as ")
    if other:
        return Message("calibration: curve {curve} belongs under {other}", curve=curve, other=other)
    if where.endswith("exchanged"):
        return Message("calibration: curves of {curves} exchanged", curves=where.removesuffix(" exchanged"))
    axis, _, joint = where.partition(" at ")
    return Message("calibration: errors of {axis} assigned to {joint}", axis=axis, joint=_joint(joint))


def _evidence(of: FittedCause) -> str:
    curve, _, other = of.where.partition(" as ")
    if other:
        return Message("the calibration's curve {curve} is the machine's {other}", curve=curve, other=other)
    if of.where.endswith("exchanged"):
        return Message(
            "in the calibration, the names of the curves of {curves} are exchanged",
            curves=of.where.removesuffix(" exchanged"),
        )
    axis, _, joint = of.where.partition(" at ")
    return Message(
        "the calibration's error motions of {axis} act at {joint} instead of {axis}'s own joint",
        axis=axis,
        joint=_joint(joint),
    )


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


MISTAKE_REJECTED_P: Final = 1e-3  # p-value below which a mistake is rejected: the rest of the correction is not noise
MAIN_SHARE: Final = 0.97
"""Share of the correction's chi² above which a mistake is named even if rejected: the curve's other errors are small."""
CURVE_STOPS: Final = (9, 11, 13, 16, 21, 51)  # numbers of evenly spaced stops at which a curve may have been fitted
ITSELF: Final = 0.0  # key, in place of a number of stops, for the curve itself with another factor
RANK_TOLERANCE: Final = 1e-9


def flaw(space: CurveSpace, curve: Curve, correction: np.ndarray, covariance: np.ndarray) -> str:  # noqa: C901
    """Return the mistake in words; empty if none explains the correction, or the curve has more coefficients than functions.

    ``correction`` are coefficients (k,) of the first functions, µm or µrad, with their covariance, zero where not identifiable.
    """
    if len(curve.coefficients) > space.count:
        return ""
    calibrated = _coefficients(space, curve)
    weight, rank = _inverse(covariance)
    k = len(correction)
    whole = float(correction @ weight @ correction)
    unit = curve.unit.replace("urad", "µrad").replace("um", "µm")

    def tested(known: np.ndarray, free: np.ndarray) -> tuple[float, np.ndarray, bool]:
        """Return chi² of the correction less known + free·s, the best s, and whether the mistake is accepted."""
        gram = free.T @ weight @ free
        s = np.linalg.pinv(gram, hermitian=True) @ (free.T @ weight @ (correction - known))
        rest = correction - known - free @ s
        chi2 = float(rest @ weight @ rest)
        dof = rank - int(np.linalg.matrix_rank(gram, hermitian=True))
        accepted = dof > 0 and (chi2_sf(chi2, dof) > MISTAKE_REJECTED_P or chi2 < (1.0 - MAIN_SHARE) * whole)
        return chi2, s, accepted

    # A factor is tested only if the correction's functions contain nearly all of the curve.
    if np.linalg.norm(calibrated[k:]) < (1.0 - MAIN_SHARE) * np.linalg.norm(calibrated):
        _, factor, accepted = tested(np.zeros(k), calibrated[:k, None])
        if accepted:
            return times(1.0 + float(factor[0]))
    fits = []
    for stops in CURVE_STOPS:
        pattern = without_constant(space, len(curve.coefficients) - 1, stops)
        if pattern is not None and np.linalg.norm(pattern[k:]) < (1.0 - MAIN_SHARE) * np.linalg.norm(pattern):
            chi2, size, accepted = tested(np.zeros(k), pattern[:k, None])
            fits.append((chi2, float(size[0]), accepted))
    if fits:
        _, constant, accepted = min(fits)
        if accepted:
            return constant_dropped(curve, constant)
    degree = len(curve.coefficients) - 1
    for lower in range(1, degree if k > degree else 1):
        known = np.where(np.arange(k) > lower, -calibrated[:k], 0.0)
        free = np.eye(k)[:, : lower + 1]
        if tested(np.zeros(k), free)[2]:
            break  # the terms above this degree may just as well be right
        if tested(known, free)[2]:
            q, _ = space.grid()
            oscillation = space.functions(q)[:, lower + 1 :] @ calibrated[lower + 1 :]
            return (
                f"its polynomial of degree {degree} oscillates by up to {float(np.abs(oscillation).max()):.2g} {unit} where the "
                f"machine does not: the terms above degree {lower} are spurious"
            )
    return ""


def constant_dropped(curve: Curve, size: float) -> str:
    """Return a sentence on a constant term of a given size that was left out of a fit."""
    unit = curve.unit.replace("urad", "µrad").replace("um", "µm")
    return (
        f"its polynomial of degree {len(curve.coefficients) - 1} was fitted without a constant term, "
        f"so it is forced through zero at 0, where the machine's error is {size:.3g} {unit}"
    )


def without_constant(space: CurveSpace, degree: int, stops: int) -> np.ndarray | None:
    """Return coefficients (count,) of 1 less its fit by q, q² … qⁿ at evenly spaced stops; None if the fit is exact or impossible."""
    lo, hi = space.domain
    if not lo <= 0.0 <= hi or degree < 2 or degree >= space.count or stops <= degree:
        return None
    q = np.linspace(lo, hi, stops)
    scale = max(abs(lo), abs(hi))
    # Scaled to u = q/scale for the conditioning.
    powers = np.stack([(q / scale) ** n for n in range(1, degree + 1)], axis=1)
    fitted, *_ = np.linalg.lstsq(powers, np.ones(stops), rcond=None)
    at, weight = space.grid()
    values = 1.0 - np.stack([(at / scale) ** n for n in range(1, degree + 1)], axis=1) @ fitted
    functions = space.functions(at)
    return np.asarray(functions.T @ (weight * values))


def _coefficients(space: CurveSpace, curve: Curve) -> np.ndarray:
    padded = np.concatenate([curve.coefficients, np.zeros(space.count - len(curve.coefficients))])
    return np.asarray(np.linalg.solve(space.transform, padded))


def mistakes(space: CurveSpace, curve: Curve | None) -> dict[float, np.ndarray]:
    """Return coefficients of the corrections by one mistake each, by number of stops or `ITSELF`; each has one unknown factor."""
    if curve is None:
        return {}
    shapes = {float(n): without_constant(space, len(curve.coefficients) - 1, n) for n in CURVE_STOPS}
    if len(curve.coefficients) <= space.count and np.any(curve.coefficients):
        shapes[ITSELF] = _coefficients(space, curve)
    return {stops: shape for stops, shape in shapes.items() if shape is not None}


def times(factor: float) -> str:
    """Return a sentence on a machine whose error motion is the calibration's curve times a factor."""
    if abs(factor) < 0.1:
        return Message(
            "the machine does not have this error motion at all: it is already corrected, or the curve is of another "
            "machine"
        )
    if abs(factor + 1.0) < 0.1:
        return Message("the calibration's curve has the wrong sign")
    return Message("the machine's error motion is {factor:.2g} times the calibration's curve", factor=factor)


def _inverse(covariance: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the pseudo-inverse over the identifiable directions, and their number."""
    values, vectors = np.linalg.eigh(covariance)
    identifiable = values > RANK_TOLERANCE * values[-1] if len(values) else np.zeros(0, dtype=bool)
    return np.asarray((vectors[:, identifiable] / values[identifiable]) @ vectors[:, identifiable].T), int(
        identifiable.sum()
    )
