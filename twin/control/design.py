"""Which tables a format gets, and what each must say: the tables as they will be written, beside the truth they are checked against."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.units import TURN
from twin.control.nodes import RESOLUTION, Nodes, at, chosen
from twin.control.wanted import Wanted
from twin.machine.control import Curve, Term, Terms
from twin.machine.machine import Axis

URAD_A_UM: Final = 2.0
"""Tolerance of an angle for each µm of the tolerance: a µm at half a metre."""
WORTH: Final = 0.1
"""A table whose largest value is no more than this share of the tolerance is not written."""
TURNS: Final = (-TURN, 2.0 * TURN)
"""Where a table of an axis that turns without end goes, in a format that does not wrap positions."""


@final
@dataclass(frozen=True)
class Format:
    """What a format can hold.

    Attributes:
        points: most points of a table.
        across: whether an axis can move another one.
        products: whether two tables can be multiplied.
        wraps: whether positions of an axis that turns without end are wrapped into a turn.
        crossed_directions: whether a table of another axis may differ by direction.
        digits: half of the last digit written: µm and µrad.
    """

    points: int
    across: bool
    products: bool
    wraps: bool
    crossed_directions: bool
    digits: tuple[float, float]


@final
@dataclass(frozen=True)
class Planned:
    """One table or product, with its truth.

    Attributes:
        term: as it will be written.
        truth: positions of the first factor's axis → µm or µrad.
        off: largest distance of the truth from the straight lines, µm or µrad.
    """

    term: Term
    truth: Callable[[np.ndarray], np.ndarray]
    off: float

    @property
    def peak(self) -> float:
        """Largest value, µm or µrad."""
        peaks = [max(abs(value) for value in factor.values) for factor in self.term.factors]
        return float(np.prod(peaks))

    @property
    def key(self) -> tuple[object, ...]:
        """What it is a table of."""
        return key_of(self.term)


def key_of(term: Term) -> tuple[object, ...]:
    """Axis moved, and axis and direction of every factor."""
    return (term.axis, *((curve.of, curve.direction) for curve in term.factors))


@final
@dataclass(frozen=True)
class Columns:
    """All that is wanted over one axis: a column an axis moved and direction, then the slopes of products."""

    singles: tuple[tuple[str, int], ...]
    products: tuple[tuple[str, str], ...]
    truth: Callable[[np.ndarray], np.ndarray]


def tables(
    wanted: Wanted,
    form: Format,
    *,
    tolerance_um: float,
    step: float | None,
    products: bool,
    most: int,
    old: Terms | None = None,
) -> tuple[tuple[Planned, ...], tuple[str, ...]]:
    """The tables, axis by axis.

    Args:
        wanted: what the machine wants.
        form: what the format can hold.
        tolerance_um: of the interpolation.
        step: asked for; None: as the tolerance wants.
        products: whether to use products where the format has them.
        most: tables there may be; the weakest for their number are left out.
        old: tables whose nodes are to be kept.

    Returns:
        The tables, and what was left out for want of tables.
    """
    machine = wanted.machine
    found: list[Planned] = []
    for axis in machine.axes:
        columns = _columns(wanted, form, axis, tolerance_um, products=products and form.products)
        if columns is None:
            continue
        low, high = wanted.range_of(axis)
        if axis.lower is None and not form.wraps:
            low, high = TURNS
        period = TURN if axis.lower is None and form.wraps else None
        limits = np.array([tolerance_of(machine.by_name[moved], tolerance_um) for moved, _ in columns.singles])
        limits = np.concatenate([limits, np.full(len(columns.products), tolerance_um)])
        kept = None if old is None else _old_nodes(old, axis)
        nodes = (
            chosen(columns.truth, low, high, limits, step=step, most=form.points)
            if kept is None
            else at(columns.truth, np.array(kept))
        )
        found += _planned(wanted, axis, columns, nodes, period)
    return _within(found, most)


def tolerance_of(axis: Axis, tolerance_um: float) -> float:
    """µm, or µrad of a rotary axis."""
    return tolerance_um if axis.linear else tolerance_um * URAD_A_UM


def _columns(wanted: Wanted, form: Format, axis: Axis, tolerance_um: float, *, products: bool) -> Columns | None:
    machine = wanted.machine
    low, high = wanted.range_of(axis)
    dense = np.round(np.linspace(low, high, 501) / RESOLUTION) * RESOLUTION
    linear = [machine.axes[i].name for i in machine.linear]
    if not axis.linear:
        split = np.abs(wanted.turn(axis, dense, 1) - wanted.turn(axis, dense, -1)).max()
        sides = (1, -1) if split > WORTH * tolerance_of(axis, tolerance_um) else (0,)
        if max(np.abs(wanted.turn(axis, dense, side)).max() for side in sides) <= WORTH * tolerance_of(
            axis, tolerance_um
        ):
            return None
        return Columns(
            tuple((axis.name, side) for side in sides),
            (),
            lambda q: np.stack([wanted.turn(axis, q, side) for side in sides], axis=1),
        )
    up, down = (wanted.point((axis.name,), wanted.line(axis, dense), side) for side in (1, -1))
    singles: list[tuple[str, int]] = []
    for k, moved in enumerate(linear):
        if not form.across and moved != axis.name:
            continue
        if max(np.abs(up[:, k]).max(), np.abs(down[:, k]).max()) <= WORTH * tolerance_um:
            continue
        directed = np.abs(up[:, k] - down[:, k]).max() > WORTH * tolerance_um
        can = form.crossed_directions or moved == axis.name
        singles += [(moved, 1), (moved, -1)] if directed and can else [(moved, 0)]
    pairs: list[tuple[str, str]] = []
    for by in linear if products else ():
        if by != axis.name:
            peaks = np.abs(_slope(wanted, axis, by, dense)).max(axis=0)
            pairs += [(moved, by) for moved, peak in zip(linear, peaks, strict=True) if peak > 0.5 * tolerance_um]
    if not singles and not pairs:
        return None

    def truth(q: np.ndarray) -> np.ndarray:
        line = wanted.line(axis, q)
        by_side = {side: wanted.point((axis.name,), line, side) for side in {side for _, side in singles}}
        slopes = {by: _slope(wanted, axis, by, q) for by in {by for _, by in pairs}}
        values = [by_side[side][:, linear.index(moved)] for moved, side in singles]
        return np.stack([*values, *(slopes[by][:, linear.index(moved)] for moved, by in pairs)], axis=1)

    return Columns(tuple(singles), tuple(pairs), truth)


def _slope(wanted: Wanted, axis: Axis, by: str, q: np.ndarray) -> np.ndarray:
    """(n, linear axes) µm: how much more correction another axis asks for when it moves on by half its range."""
    low, high = wanted.range_of(wanted.machine.by_name[by])
    ends = [wanted.point((axis.name,), wanted.line(axis, q, {by: end})) for end in (low, high)]
    return np.asarray(0.5 * (ends[1] - ends[0]))


def _planned(wanted: Wanted, axis: Axis, columns: Columns, nodes: Nodes, period: float | None) -> list[Planned]:
    where = tuple(float(q) for q in nodes.at)
    truth = _remembered(columns.truth)
    found = []
    for k, (moved, side) in enumerate(columns.singles):
        values = tuple(float(value) for value in nodes.values[:, k])
        curve = Curve(axis.name, where, values, period, side)  # type: ignore[arg-type]
        found.append(Planned(Term(moved, (curve,)), _column(truth, k), float(nodes.off[k])))
    for j, (moved, by) in enumerate(columns.products):
        k = len(columns.singles) + j
        low, high = wanted.range_of(wanted.machine.by_name[by])
        half, middle = 0.5 * (high - low), wanted.at[by]
        arm = Curve(by, (low, high), ((low - middle) / half, (high - middle) / half))
        curve = Curve(axis.name, where, tuple(float(value) for value in nodes.values[:, k]), period)
        reach = max(abs(value) for value in arm.values)
        found.append(Planned(Term(moved, (curve, arm)), _column(truth, k), float(nodes.off[k]) * reach))
    return found


def _remembered(truth: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    """The same, which knows its last answer: every column is asked for at the same positions."""
    last: list[tuple[bytes, np.ndarray]] = []

    def again(q: np.ndarray) -> np.ndarray:
        key = np.asarray(q, dtype=float).tobytes()
        if not last or last[0][0] != key:
            last[:] = [(key, truth(q))]
        return last[0][1]

    return again


def _column(truth: Callable[[np.ndarray], np.ndarray], k: int) -> Callable[[np.ndarray], np.ndarray]:
    return lambda q: np.asarray(truth(q)[:, k])


def _within(found: Sequence[Planned], most: int) -> tuple[tuple[Planned, ...], tuple[str, ...]]:
    """As many as there may be: those that take out most a table."""
    order = sorted(range(len(found)), key=lambda i: -found[i].peak / len(found[i].term.factors))
    kept: set[int] = set()
    used = 0
    for i in order:
        need = len(found[i].term.factors)
        if used + need <= most:
            kept.add(i)
            used += need
    left = tuple(f"{named(found[i].term)}: {found[i].peak:.1f}" for i in range(len(found)) if i not in kept)
    return tuple(found[i] for i in range(len(found)) if i in kept), left


def named(term: Term) -> str:
    """``Y by X``, ``X by X up``, ``X by X times Z``."""
    first = term.factors[0]
    side = {0: "", 1: f", {first.of} moving up", -1: f", {first.of} moving down"}[first.direction]
    return f"{term.axis} by {first.of}{''.join(f' times {other.of}' for other in term.factors[1:])}{side}"


def _old_nodes(old: Terms, axis: Axis) -> tuple[float, ...] | None:
    curves = [term.factors[0] for term in old.terms if term.factors[0].of == axis.name]
    if not curves:
        return None
    if any(curve.at != curves[0].at for curve in curves):
        raise InputError(
            f"the tables over {axis.name} that are to be added to have different nodes",
            expected="the same nodes in all tables over one axis",
            value=[f"{len(curve.at)} points" for curve in curves],
        )
    return curves[0].at


def summed(new: Sequence[Planned], old: Terms) -> tuple[Term, ...]:
    """New tables and old ones together, on the same nodes: a table each where one is there already, beside it otherwise."""
    singles: dict[tuple[str, str], list[Term]] = {}
    products: list[Term] = []
    for term in (*old.terms, *(one.term for one in new)):
        if len(term.factors) > 1:
            products.append(term)
        else:
            singles.setdefault((term.axis, term.factors[0].of), []).append(term)
    found: list[Term] = []
    for terms in singles.values():
        sides = (0,) if all(term.factors[0].direction == 0 for term in terms) else (1, -1)
        for side in sides:
            curves = [term.factors[0] for term in terms if term.factors[0].direction in (0, side)]
            values = np.sum([curve.values for curve in curves], axis=0)
            whole = replace(curves[0], values=tuple(float(value) for value in values), direction=side)  # type: ignore[arg-type]
            found.append(Term(terms[0].axis, (whole,)))
    return (*found, *products)


def by_key(terms: Sequence[Term]) -> Mapping[tuple[object, ...], Term]:
    """Terms by what they are tables of."""
    return {key_of(term): term for term in terms}
