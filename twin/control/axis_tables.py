"""Tables of one axis over another: which ones a format gets, and what each must say."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.units import TURN
from twin.control.design import WORTH, Design, Share, Table, TablePlan, depending, drawn, tolerance_of
from twin.control.nodes import RESOLUTION, Nodes, at, chosen
from twin.control.request import Request
from twin.control.wanted import Wanted
from twin.machine.control import Content, ControlCurve, ControlTerm, TableFormat, Terms
from twin.machine.control.curve import BOTH, DOWN, UP, Direction, period_of
from twin.machine.effects import Effect
from twin.machine.machine import Axis

TURNS: Final = (-TURN, 2.0 * TURN)
"""Where a table of an axis that turns without end goes, in a format that does not wrap positions."""
SOME_BEYOND: Final = 0.01
ALL_BEYOND: Final = 0.99
"""Share of an error that lies where no linear axis moves the point; products of two errors are a thousandth."""


@final
@dataclass(frozen=True)
class TableColumn:
    """One table that is wanted over an axis.

    Attributes:
        moved: the axis it moves.
        side: the direction it is for.
        by: the axis whose lever it is multiplied by.
    """

    moved: str
    side: Direction
    by: str | None = None


@final
@dataclass(frozen=True)
class Planned:
    """One table or product as it will be written, with how far the truth is from it, and the truth at places drawn."""

    term: ControlTerm
    off: float
    q: np.ndarray
    truth: np.ndarray


@final
class AxisTables(Design[Terms]):
    """Tables of one axis over another, and products of two of them."""

    correction = Terms

    def plan(self, wanted: Wanted, request: Request, old: Terms | None) -> TablePlan[Terms]:
        """The tables, axis by axis; the weakest for their number are left out where there are too many; see `Design.plan`."""
        form, machine, found = request.form, wanted.machine, list[Planned]()
        for axis in machine.axes:
            columns = _columns(wanted, form, axis, request)
            if not columns:
                continue
            truth = _truth(wanted, axis, columns)
            kept = None if old is None else _old_nodes(old, axis)
            if kept is None:
                low, high = TURNS if axis.lower is None and not form.wraps else wanted.range_of(axis)
                limits = [tolerance_of(machine.by_name[one.moved], request.tolerance_um) for one in columns]
                nodes = chosen(truth, low, high, np.array(limits), step=request.step, most=form.points)
            else:
                nodes = at(truth, np.array(kept))
            found += _planned(wanted, axis, columns, nodes, truth, period_of(axis) if form.wraps else None)
        most = None if form.tables is None else request.most or form.tables
        within, left = _within(found, most)

        def compared(back: Terms) -> tuple[Table, ...]:
            return tuple(
                _table(one, content, back, wanted, request) for one, content in zip(within, contents, strict=True)
            )

        correction = Terms(tuple(one.term for one in within), machine)
        contents = correction.contents()
        return TablePlan(correction, compared, left)

    def share(self, wanted: Wanted, effect: Effect, others: Sequence[Axis], request: Request) -> tuple[Share, str]:
        """See `Design.share`."""
        form, iso_class = request.form, wanted.class_of(effect)
        if not wanted.machine.by_name[effect.frame.axis].linear:
            if iso_class != "R-POS":
                return "no", "moves the point in a direction that turns with the rotary axes"
            return depending(others)
        if not form.across and iso_class in ("L-STR", "L-SQU"):
            return "no", "moves other axes than its own: the format has no such tables"
        beyond = wanted.beyond(effect)
        if beyond > ALL_BEYOND:
            return "no", "no linear axis moves the point that way"
        if beyond > SOME_BEYOND:
            return "line", f"no linear axis moves the point the way of {100.0 * beyond:.0f} % of it"
        if iso_class != "L-ANG" or others or (form.products and request.products):
            return depending(others)
        if not form.across:
            return "line", "along its own axis only, and there with the lever of the reference position"
        return "line", "with the lever of the reference position"


def _columns(wanted: Wanted, form: TableFormat[Any], axis: Axis, request: Request) -> list[TableColumn]:
    """What is worth a table over one axis: an axis moved and direction each, then the slopes of products."""
    machine = wanted.machine
    tolerance = tolerance_of(axis, request.tolerance_um)
    dense = np.round(np.linspace(*wanted.range_of(axis), 501) / RESOLUTION) * RESOLUTION
    if not axis.linear:
        turns = {side: wanted.turn(axis, dense, side) for side in (UP, DOWN, BOTH)}
        split = form.directions and np.abs(turns[UP] - turns[DOWN]).max() > WORTH * tolerance
        used = (UP, DOWN) if split else (BOTH,)
        worth = max(np.abs(turns[side]).max() for side in used) > WORTH * tolerance
        return [TableColumn(axis.name, side) for side in used] if worth else []
    linear = [machine.axes[i].name for i in machine.linear]
    sides = (UP, DOWN) if form.directions else (BOTH, BOTH)
    up, down = (wanted.point((axis.name,), wanted.line(axis, dense), side) for side in sides)
    found: list[TableColumn] = []
    for k, moved in enumerate(linear):
        if not form.across and moved != axis.name:
            continue
        if max(np.abs(up[:, k]).max(), np.abs(down[:, k]).max()) <= WORTH * tolerance:
            continue
        can = form.crossed_directions or moved == axis.name
        directed = can and np.abs(up[:, k] - down[:, k]).max() > WORTH * tolerance
        found += [TableColumn(moved, side) for side in ((UP, DOWN) if directed else (BOTH,))]
    for by in linear if form.products and request.products else ():
        if by != axis.name:
            peaks = np.abs(_slope(wanted, axis, by, dense)).max(axis=0)
            found += [
                TableColumn(moved, BOTH, by)
                for moved, peak in zip(linear, peaks, strict=True)
                if peak > 0.5 * tolerance
            ]
    return found


def _truth(wanted: Wanted, axis: Axis, columns: Sequence[TableColumn]) -> Callable[[np.ndarray], np.ndarray]:
    """What the tables over one axis should say: (n,) positions → (n, columns) µm or µrad."""
    linear = [wanted.machine.axes[i].name for i in wanted.machine.linear]

    def truth(q: np.ndarray) -> np.ndarray:
        if not axis.linear:
            return np.stack([wanted.turn(axis, q, one.side) for one in columns], axis=1)
        line, found = wanted.line(axis, q), {}
        for side, by in {(one.side, one.by) for one in columns}:
            found[side, by] = wanted.point((axis.name,), line, side) if by is None else _slope(wanted, axis, by, q)
        return np.stack([found[one.side, one.by][:, linear.index(one.moved)] for one in columns], axis=1)

    return truth


def _slope(wanted: Wanted, axis: Axis, by: str, q: np.ndarray) -> np.ndarray:
    """(n, linear axes) µm: how much more correction another axis asks for when it moves on by half its range."""
    low, high = wanted.range_of(wanted.machine.by_name[by])
    ends = [wanted.point((axis.name,), wanted.line(axis, q, {by: end})) for end in (low, high)]
    return np.asarray(0.5 * (ends[1] - ends[0]))


def _planned(
    wanted: Wanted,
    axis: Axis,
    columns: Sequence[TableColumn],
    nodes: Nodes,
    truth: Callable[[np.ndarray], np.ndarray],
    period: float | None,
) -> list[Planned]:
    where = tuple(nodes.at.tolist())
    q = drawn(where[0], where[-1])
    meant = truth(q)
    found = []
    for k, one in enumerate(columns):
        factors = [ControlCurve(axis.name, where, tuple(nodes.values[:, k].tolist()), period, one.side)]
        if one.by is not None:
            low, high = wanted.range_of(wanted.machine.by_name[one.by])
            half, middle = 0.5 * (high - low), wanted.at[one.by]
            factors.append(ControlCurve(one.by, (low, high), ((low - middle) / half, (high - middle) / half)))
        reach = factors[1].peak if one.by is not None else 1.0
        found.append(Planned(ControlTerm(one.moved, tuple(factors)), float(nodes.off[k]) * reach, q, meant[:, k]))
    return found


def _within(found: Sequence[Planned], most: int | None) -> tuple[tuple[Planned, ...], tuple[str, ...]]:
    """As many as there may be: those that take out most a table; and what is left out."""
    order = sorted(range(len(found)), key=lambda i: -found[i].term.peak / len(found[i].term.factors))
    kept: set[int] = set()
    used = 0
    for i in order:
        need = len(found[i].term.factors)
        if most is None or used + need <= most:
            kept.add(i)
            used += need
    left = tuple(f"{one.term.name}: {one.term.peak:.1f}" for i, one in enumerate(found) if i not in kept)
    return tuple(one for i, one in enumerate(found) if i in kept), left


def _table(one: Planned, content: Content, back: Terms, wanted: Wanted, request: Request) -> Table:
    """One table beside what was read back; a product where the other axis is farthest from its reference."""
    moved, factors = wanted.machine.by_name[one.term.axis], one.term.factors
    found = next(term for term in back.terms if term.key == one.term.key)
    rounding, scale = request.form.rounding[0 if moved.linear else 1], 1.0
    truth, said = one.truth, found.factors[0].along(one.q)
    for factor, read in zip(factors[1:], found.factors[1:], strict=True):
        end, scale = factor.at[int(np.argmax(np.abs(factor.values)))], factor.peak
        truth, said = truth * factor.along(end), said * read.along(end)
        rounding = rounding * scale + one.term.peak * 1e-9
    tolerance = tolerance_of(moved, request.tolerance_um) * scale
    return Table(content, one.off, rounding, tolerance, float(np.abs(truth - said).max()))


def _old_nodes(old: Terms, axis: Axis) -> tuple[float, ...] | None:
    """Nodes of the tables over an axis that are to be added to."""
    curves = [term.factors[0] for term in old.terms if term.factors[0].argument == axis.name]
    if not curves:
        return None
    if any(curve.at != curves[0].at for curve in curves):
        raise InputError(
            f"the tables over {axis.name} that are to be added to have different nodes",
            expected="the same nodes in all tables over one axis",
            value=[f"{len(curve.at)} points" for curve in curves],
        )
    return curves[0].at
