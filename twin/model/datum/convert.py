"""Conversion of a calibration to another datum: the same poses of the tool, other curves, squareness and locations."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin.machine.error_names import DIRECTIONS
from twin.model.datum.conditions import (
    AS_GIVEN,
    DATUMS,
    END_POINTS,
    LAST_AXES,
    MEAN_LINES,
    Condition,
    Datum,
    DatumLink,
    Numbers,
    conditions_of,
    links_of,
)
from twin.model.effects import split_name, unit_of
from twin.model.motion_curve import Curve, conversion_of
from twin.numerics.covariance import Covariance
from twin.numerics.curves import Basis, bases_for, legendre_in_basis

FIT_TOLERANCE: Final = 3e-5
"""Largest difference of a converted curve from the converted values, µm or µrad: 0.03 nm."""
MAX_COEFFICIENTS: Final = 60
"""Largest number of coefficients of a converted curve."""


def with_values(
    curve: Curve | None, name: str, link: DatumLink, difference: np.ndarray, numbers: Numbers
) -> Curve | None:
    """Return a curve with values at the nodes added, with as few coefficients as possible; None for a new curve that would be zero."""
    if curve is None:
        if np.abs(difference).max() <= FIT_TOLERANCE:
            return None
        basis = bases_for(rotary=not link.axis.linear, endless=link.axis.lower is None)[0]
        illustrative = any(known.illustrative for known in numbers.curves.values())
        curve = Curve(
            name, unit_of(name), link.domain, basis.name, (0.0,), None, "from a change of datum", illustrative
        )
    if curve.domain != link.domain and link.axis.lower is not None:
        curve = _over(curve, link)
    basis, own = curve.family, len(curve.coefficients)
    for count in range(own, max(MAX_COEFFICIENTS, own) + 1):
        if basis.count_problem(count, rotary=not link.axis.linear) is not None:
            continue
        added = fit(basis, curve.domain, link, count) @ difference
        if np.abs(functions(basis, curve.domain, link, count) @ added - difference).max() <= FIT_TOLERANCE:
            total = conversion_of(name, basis, basis, own, count) @ curve.coefficients + added
            return replace(curve, coefficients=tuple(float(v) for v in total), covariance=None)
    raise InputError(
        f"{name} cannot be converted to this datum in basis {basis.name}",
        expected="a curve over the whole range of its axis, in a basis that can represent the constants and waves of the datum",
        value=f"domain {curve.domain[0]:g} to {curve.domain[1]:g}",
    )


def _over(curve: Curve, link: DatumLink) -> Curve:
    """Return the same curve over the range that all curves of its axis cover; raise `InputError` if the basis cannot represent it."""
    values = functions(curve.family, curve.domain, link, len(curve.coefficients)) @ curve.coefficients
    basis, count = curve.family.restricted(link.domain, len(curve.coefficients))
    found = fit(basis, link.domain, link, count) @ values
    own = tuple(float(v) for v in found)
    return replace(curve, domain=link.domain, coefficients=own, covariance=None, knots=basis.knots)


def functions(basis: Basis, domain: tuple[float, float], link: DatumLink, count: int) -> np.ndarray:
    """Return the functions (n, count) of a basis at a link's nodes, wrapped for an unlimited axis."""
    lo, hi = domain
    q = link.nodes
    if link.axis.lower is None and not basis.periodic:
        q = np.where(q == link.nodes[-1], hi, lo + np.mod(q - lo, hi - lo)) if domain == link.domain else (
            lo + np.mod(q - lo, hi - lo)
        )  # fmt: skip
    return np.stack(basis.functions(q, domain, count), axis=1)


def fit(basis: Basis, domain: tuple[float, float], link: DatumLink, count: int) -> np.ndarray:
    """Return the matrix (count, n) from values at the nodes to coefficients, by least squares over the range."""
    legendre = legendre_in_basis(basis, count) if domain == link.domain else None
    if legendre is not None:
        polynomials = np.polynomial.legendre.legvander(link.u, count - 1) * (2.0 * np.arange(count) + 1.0)
        return np.asarray(legendre @ (polynomials * link.weights[:, None]).T)
    root = np.sqrt(link.weights)
    return np.asarray(np.linalg.pinv(functions(basis, domain, link, count) * root[:, None], rcond=1e-13) * root)


DATUM_TOLERANCE: Final = 1e-3
"""Tolerance for rounded coefficients when a file's stated datum is checked, µm or µrad."""
STEP_TOLERANCE: Final = 1e-7
"""The iteration ends at a step of this size, µm or µrad."""
STEPS: Final = 20
RANK_TOLERANCE: Final = 1e-9
"""Singular values below this fraction of the largest count as zero."""


@final
@dataclass(frozen=True)
class Converted:
    """Result of a conversion to a datum."""

    numbers: Numbers  # curves without covariance, squareness, locations
    names: tuple[str, ...]
    matrix: np.ndarray  # (new, old) first derivatives of the new parameters by the old ones
    old: tuple[str, ...]

    def covariance(self, known: Covariance) -> Covariance:
        """Return the covariance of the new parameters.

        It omits parameters that depend on an old one of unknown uncertainty, and errors that only the conversion introduced: the
        calibration did not state that they are zero.
        """
        index = {name: i for i, name in enumerate(known.names)}
        others = [name for name in known.names if name not in self.old]  # parameters of effects: unchanged
        names = (*self.names, *others)
        through = np.zeros((len(names), len(index)))
        through[range(len(self.names), len(names)), [index[name] for name in others]] = 1.0
        open_ = np.zeros(len(names), dtype=bool)
        for column, name in enumerate(self.old):
            if name in index:
                through[: len(self.names), index[name]] = self.matrix[:, column]
            else:
                open_[: len(self.names)] |= np.abs(self.matrix[:, column]) > RANK_TOLERANCE
        entity = np.array([name.partition("[")[0] for name in names])
        without = set(entity[open_]) | set(entity) - {name.partition("[")[0] for name in (*self.old, *others)}
        keep = [i for i, name in enumerate(entity) if name not in without]
        # With a root of the matrix, so that no variance becomes negative by rounding.
        values, vectors = np.linalg.eigh(known.matrix)
        root = through[keep] @ (vectors * np.sqrt(np.maximum(values, 0.0)))
        return Covariance(tuple(names[i] for i in keep), read_only(root @ root.T))


def datum_of(numbers: Numbers) -> Datum:
    """Return the datum that the numbers fulfil: mean lines before end points; as given if neither."""
    return next((datum for datum in (MEAN_LINES, END_POINTS) if violation(numbers, datum) is None), AS_GIVEN)


def violation(numbers: Numbers, datum: Datum) -> tuple[str, str, float] | None:
    """Return the largest violation of a datum: curve, kind (``mean``, ``slope``, …) and size, µm or µrad; None if only rounding."""
    if datum == AS_GIVEN:
        return None
    gauge = _Gauge(numbers, datum)
    change = gauge.change(gauge.amounts(numbers))
    if not len(change) or np.abs(change).max() <= DATUM_TOLERANCE:
        return None
    worst = int(np.argmax(np.abs(change)))
    condition = gauge.conditions[worst]
    return condition.curve, condition.what, -float(change[worst])


def convert(numbers: Numbers, datum: Datum, names: Collection[str] | None = None) -> Converted:
    """Convert the numbers of a calibration to a datum.

    With a restriction to errors that may change (``names``), conditions that these errors cannot absorb remain violated, and poses
    agree to first order: up to the product of two errors, some nanometres.
    """
    if datum not in (MEAN_LINES, END_POINTS):
        raise InputError("not a datum to convert to", expected=" or ".join(DATUMS[:2]), value=datum)
    gauge = _Gauge(numbers, datum, names)
    new = _iterate(gauge, numbers)
    return _linear(gauge, numbers, new)


def _iterate(gauge: _Gauge, numbers: Numbers) -> Numbers:
    """Return the converted numbers: first-order steps, each applied without approximation, repeated until convergence."""
    values = [link.values(numbers) for link in gauge.links]
    start = [np.array(value) for value in values]
    constants = gauge.constants(numbers)
    for _ in range(STEPS):
        step = gauge.step @ np.concatenate([gauge.measured(values), constants])
        if np.abs(step).max(initial=0.0) <= STEP_TOLERANCE:
            break
        inserted, changed = step[: 6 * gauge.gaps], constants + step[6 * gauge.gaps :]
        values = [
            gauge.moved(i, one, inserted, constants, changed)
            for i, one in enumerate(values)
        ]  # fmt: skip
        constants = changed
    else:
        raise InputError(
            "a calibration that cannot be converted to another datum",
            expected="error motions small enough for the conversion to converge",
            value=f"a step of {np.abs(step).max():.2g} µm or µrad",
        )
    curves = dict(numbers.curves)
    for link, before, after in zip(gauge.links, start, values, strict=True):
        for c, letter in enumerate(DIRECTIONS):
            name = f"E_{letter}{link.axis.name}"
            difference = after[c] - before[c]
            if np.any(difference) and gauge.may_change(name):
                curve = with_values(numbers.curves.get(name), name, link, difference, numbers)
                if curve is not None:
                    curves[name] = curve
    ordered = {name: curves[name] for name in sorted(curves, key=numbers.machine.motion_names.index)}
    named = dict(zip(gauge.names, (float(v) for v in constants), strict=True))
    groups = []
    for given, allowed in (
        (numbers.squareness, numbers.machine.squareness_names),
        (numbers.location, numbers.machine.location_names),
    ):
        kept = {name: named.get(name, given.get(name, 0.0)) for name in allowed}
        groups.append({name: v for name, v in kept.items() if name in given or abs(v) > FIT_TOLERANCE})
    return Numbers(numbers.machine, MappingProxyType(ordered), *(MappingProxyType(group) for group in groups))


def _linear(gauge: _Gauge, old: Numbers, new: Numbers) -> Converted:
    """Return the conversion with the first derivatives of the new parameters by the old ones."""
    names = [f"{name}[{k}]" for name, c in old.curves.items() for k in range(len(c.coefficients))]
    names += [*old.squareness, *old.location]
    column = {name: i for i, name in enumerate(names)}
    steps = gauge.step @ _amounts(gauge, old, column)
    link_of = {link.axis.name: i for i, link in enumerate(gauge.links)}
    rows, into = [], []
    for name, curve in new.curves.items():
        component, _, axis = split_name(name)
        own = _coefficient_map(old, new, name, gauge.links[link_of[axis]] if axis in link_of else None)
        block = np.zeros((len(curve.coefficients), len(names)))
        if own is not None:
            start = column[f"{name}[0]"]
            block[:, start : start + own.shape[1]] = own
        if axis in link_of and gauge.may_change(name):
            i = link_of[axis]
            into_curve = fit(curve.family, curve.domain, gauge.links[i], len(curve.coefficients))
            block += into_curve @ (gauge.rates[i][component] @ steps)
        rows.append(block)
        into += [f"{name}[{k}]" for k in range(len(block))]
    for name in (*new.squareness, *new.location):
        row = np.zeros((1, len(names)))
        if name in gauge.names:
            row += steps[6 * gauge.gaps + gauge.names.index(name)]
        if name in column:
            row[0, column[name]] += 1.0
        rows.append(row)
        into.append(name)
    return Converted(
        new, tuple(into), read_only(np.concatenate(rows) if rows else np.zeros((0, len(names)))), tuple(names)
    )


def _amounts(gauge: _Gauge, numbers: Numbers, column: Mapping[str, int]) -> np.ndarray:
    """Return the first derivatives (conditions + constants, parameters) of the amounts by the parameters."""
    conditions = len(gauge.conditions)
    amounts = np.zeros((conditions + len(gauge.names), len(column)))
    for i, link in enumerate(gauge.links):
        for c, letter in enumerate(DIRECTIONS):
            curve = numbers.curves.get(f"E_{letter}{link.axis.name}")
            if curve is not None:
                count, start = len(curve.coefficients), column[f"{curve.name}[0]"]
                values = functions(curve.family, curve.domain, link, count)
                amounts[:conditions, start : start + count] = gauge.weights[i][:, c] @ values
    for k, name in enumerate(gauge.names):
        if name in column:
            amounts[conditions + k, column[name]] = 1.0
    return amounts


def _coefficient_map(old: Numbers, new: Numbers, name: str, link: DatumLink | None) -> np.ndarray | None:
    """Return the matrix (new, old) from the old coefficients of a curve to new ones; None if there was no curve."""
    was, curve = old.curves.get(name), new.curves[name]
    if was is None:
        return None
    size, count = len(was.coefficients), len(curve.coefficients)
    if was.domain == curve.domain or link is None:
        return conversion_of(name, was.family, curve.family, size, count)
    return fit(curve.family, curve.domain, link, count) @ functions(was.family, was.domain, link, size)


@final
class _Gauge:
    """Gauge freedom of a calibration: the changes of ``names`` (all if None) that keep every pose, and the step to a datum."""

    def __init__(self, numbers: Numbers, datum: Datum, names: Collection[str] | None = None) -> None:
        self._allowed = names
        self.links, self.gaps = links_of(numbers)
        self.conditions: tuple[Condition, ...] = conditions_of(self.links, datum)
        own = {link.axis.name for link in self.links}
        machine = numbers.machine
        self.names = tuple(
            name for name in (*machine.squareness_names, *machine.location_names) if split_name(name)[2] in own
        )

    def may_change(self, name: str) -> bool:
        """Return whether an error may change."""
        return self._allowed is None or name in self._allowed

    @cached_property
    def free(self) -> np.ndarray:
        """Orthonormal directions (unknowns, f) that do not change the fixed errors."""
        size = 6 * self.gaps + len(self.names)
        fixed = [np.eye(size)[6 * self.gaps + k] for k, name in enumerate(self.names) if not self.may_change(name)]
        for link, rates in zip(self.links, self.rates, strict=True):
            for c, letter in enumerate(DIRECTIONS):
                if not self.may_change(f"E_{letter}{link.axis.name}"):
                    fixed += list(rates[c])
        if not fixed:
            return np.eye(size)
        _, values, right = np.linalg.svd(np.array(fixed), full_matrices=True)
        return np.asarray(right[int(np.count_nonzero(values > RANK_TOLERANCE * max(values[0], 1e-3))) :].T)

    @cached_property
    def weights(self) -> list[np.ndarray]:
        """Weights of the conditions by link, (conditions, 6, n)."""
        weights = [np.zeros((len(self.conditions), 6, len(link.nodes))) for link in self.links]
        for row, condition in enumerate(self.conditions):
            for i, c, values in condition.weights:
                weights[i][row, c] += values
        return weights

    @cached_property
    def rates(self) -> list[np.ndarray]:
        """First derivatives of the curves by the motions at the gaps and the constants, by link, (6, n, unknowns)."""
        rates = []
        for link in self.links:
            own = np.zeros((6, len(link.nodes), len(self.names)))
            for k, name in enumerate(self.names):
                if split_name(name)[2] == link.axis.name:
                    own[:, :, k] = -link.shape(name)
            rates.append(np.concatenate([link.rates(self.gaps), own], axis=2))
        return rates

    @cached_property
    def derivative(self) -> np.ndarray:
        """First derivatives of the conditions by the unknowns (conditions, unknowns)."""
        size = 6 * self.gaps + len(self.names)
        total = np.zeros((len(self.conditions), size))
        for weights, rates in zip(self.weights, self.rates, strict=True):
            total += np.tensordot(weights, rates, axes=([1, 2], [0, 1]))
        return total

    @cached_property
    def step(self) -> np.ndarray:
        """Matrix (unknowns, conditions + constants) from the amounts to the change that removes them, group by group."""
        size, count = self.derivative.shape[1], len(self.conditions)
        amounts = np.eye(count + len(self.names))
        groups = [
            [k for k, one in enumerate(self.conditions) if one.group == group] for group in range(1, LAST_AXES + 1)
        ]
        whole = np.concatenate([self.derivative, np.eye(size)[6 * self.gaps :]])
        step, free = np.zeros((size, count + len(self.names))), self.free
        for rows in (*groups, list(range(count, count + len(self.names)))):
            if not rows or not free.shape[1]:
                continue
            left, values, right = np.linalg.svd(whole[rows] @ free, full_matrices=True)
            rank = int(np.count_nonzero(values > RANK_TOLERANCE * max(values.max(initial=0.0), 1e-3)))
            want = amounts[rows] + whole[rows] @ step
            step = step - free @ (right[:rank].T / values[:rank]) @ left[:, :rank].T @ want
            free = free @ right[rank:].T
        return step

    def measured(self, values: Sequence[np.ndarray]) -> np.ndarray:
        """Return the amounts (conditions,) of curve values at the nodes, µm and µrad."""
        total = np.zeros(len(self.conditions))
        for weights, one in zip(self.weights, values, strict=True):
            total += np.tensordot(weights, one, axes=([1, 2], [0, 1]))
        return total

    def amounts(self, numbers: Numbers) -> np.ndarray:
        """Return the amounts (conditions + constants,) of a calibration."""
        values = [link.values(numbers) for link in self.links]
        return np.concatenate([self.measured(values), self.constants(numbers)])

    def constants(self, numbers: Numbers) -> np.ndarray:
        """Return squareness and locations (names,), zero if a calibration has none."""
        named: Mapping[str, float] = {**numbers.squareness, **numbers.location}
        return np.array([named.get(name, 0.0) for name in self.names])

    def change(self, amounts: np.ndarray) -> np.ndarray:
        """Return the changes (conditions,) of the amounts of the curves by the conversion."""
        if not self.derivative.size:
            return np.zeros(len(self.conditions))
        # How two locations share a shift does not affect the lines: the amounts of the constants are omitted.
        only = np.concatenate([amounts[: len(self.conditions)], np.zeros(len(self.names))])
        return np.asarray(self.derivative @ (self.step @ only))

    def moved(
        self, i: int, values: np.ndarray, inserted: np.ndarray, before: np.ndarray, after: np.ndarray
    ) -> np.ndarray:
        """Return the curves (6, n) of a link after a step: constants ``before`` and ``after``, motions inserted at the gaps."""
        link = self.links[i]
        old, new = self._acting(link, before), self._acting(link, after)
        if link.axis.linear:
            return link.moved(values + old, np.zeros(6), np.zeros(6), inserted) - new
        return link.moved(values, old[:, 0], new[:, 0], inserted)

    def _acting(self, link: DatumLink, constants: np.ndarray) -> np.ndarray:
        """Return the contribution (6, n) of squareness and locations to a link's error frame, µm and µrad."""
        total = np.zeros((6, len(link.nodes)))
        for name, amount in zip(self.names, constants, strict=True):
            if split_name(name)[2] == link.axis.name:
                total += amount * link.shape(name)
        return total
