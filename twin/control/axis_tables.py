"""Tables of one axis over another: which tables a format needs, and their values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.units import TURN
from twin.control.design import (
    NEGLIGIBLE_SHARE,
    U_EVERY,
    Design,
    ProofOfTables,
    Share,
    Table,
    TablePlan,
    check_positions,
    share_depending_on,
    tolerance_of,
)
from twin.control.nodes import RESOLUTION, Nodes, choose_nodes, nodes_at
from twin.control.request import Request
from twin.control.required import RequiredCorrections
from twin.machine.control import ControlCurve, ControlTerm, TableFormat, TableSum, TableSummary
from twin.machine.control.curve import BOTH, DOWN, UP, Direction, period_of
from twin.machine.effects import Effect
from twin.machine.machine import Axis

TURNS: Final = (-TURN, 2.0 * TURN)
"""Range of a table over an unlimited rotary axis, degrees, in a format that does not wrap positions."""
LINEAR: Final = ("L-POS", "L-STR", "L-SQU", "L-ANG")
ROTARY: Final = ("R-POS",)
"""Classes that a table over an axis corrects."""
SOME_BEYOND: Final = 0.01
ALL_BEYOND: Final = 0.99
"""Limits of the share of an error that no linear axis can correct; products of two errors contribute about 0.001."""


@final
@dataclass(frozen=True)
class TableColumn:
    """Column of the tables over one axis.

    Attributes:
        moved: the axis that is corrected.
        side: the direction of approach the column is for.
        by: axis of the lever the column is multiplied by; None without a product.
    """

    moved: str
    side: Direction
    by: str | None = None


@final
@dataclass(frozen=True)
class Planned:
    """One table or product to be written.

    Attributes:
        term: the table.
        deviation: largest deviation of the required correction from it, µm or µrad.
        q: (n,) random positions at which the file read back is checked.
        truth: (n,) required correction there.
    """

    term: ControlTerm
    deviation: float
    q: np.ndarray
    truth: np.ndarray


@final
class AxisTables(Design[TableSum]):
    """Tables of one axis over another, and products of two of them."""

    correction = TableSum

    def plan(self, required: RequiredCorrections, request: Request, old: TableSum | None) -> TablePlan[TableSum]:
        """See `Design.plan`. If there are more tables than the control has, those that correct least are left out."""
        form, machine, found = request.form, required.machine, list[Planned]()
        proof = ProofOfTables(required, keep_all=request.unproven)
        for axis in machine.axes:
            columns = _columns(required, form, axis, request)
            if not columns:
                continue
            truth = _required_values(required, axis, columns)
            kept = None if old is None else _nodes_of_old_tables(old, axis)
            if kept is None:
                low, high = TURNS if axis.lower is None and not form.wraps else required.range_of(axis)
                limits = [tolerance_of(machine.by_name[one.moved], request.tolerance_um) for one in columns]
                nodes = choose_nodes(truth, low, high, np.array(limits), step=request.step, most=form.points)
            else:
                nodes = nodes_at(truth, np.array(kept))
            planned = _planned(required, axis, columns, nodes, truth, period_of(axis) if form.wraps else None)
            factors = _factors(required, axis, columns, planned[0].q[::U_EVERY])
            for k, one in enumerate(planned):
                (content,) = TableSum((one.term,), machine).contents()
                if proof.keeps(content, [axis.name], LINEAR if axis.linear else ROTARY, one.truth, factors[:, k]):
                    found.append(one)
        most = None if form.tables is None else request.most or form.tables
        within, left_out = _strongest(found, most)

        def compared(back: TableSum) -> tuple[Table, ...]:
            return tuple(
                _table(one, content, back, required, request) for one, content in zip(within, contents, strict=True)
            )

        correction = TableSum(tuple(one.term for one in within), machine)
        contents = correction.contents()
        return TablePlan(correction, compared, left_out, tuple(proof.unproven))

    def share(
        self, required: RequiredCorrections, effect: Effect, others: Sequence[Axis], request: Request
    ) -> tuple[Share, str]:
        """See `Design.share`."""
        form, iso_class = request.form, required.class_of(effect)
        if not required.machine.by_name[effect.frame.axis].linear:
            if iso_class != "R-POS":
                return "no", "the direction of its effect turns with the rotary axes"
            return share_depending_on(others)
        if not form.across and iso_class in ("L-STR", "L-SQU"):
            return "no", "needs a table that corrects another axis: the format has none"
        beyond = required.uncorrectable_share(effect)
        if beyond > ALL_BEYOND:
            return "no", "no linear axis moves the point in its direction"
        if beyond > SOME_BEYOND:
            return "line", f"no linear axis moves the point in the direction of {100.0 * beyond:.0f} % of it"
        if iso_class != "L-ANG" or others or (form.products and request.products):
            return share_depending_on(others)
        if not form.across:
            return "line", "only along its own axis, and exact only with the other axes at their reference positions"
        return "line", "exact only with the other axes at their reference positions"


def _columns(required: RequiredCorrections, form: TableFormat[Any], axis: Axis, request: Request) -> list[TableColumn]:
    """Return the columns over one axis whose largest value matters: per corrected axis and direction, then the products."""
    machine = required.machine
    tolerance = tolerance_of(axis, request.tolerance_um)
    dense = np.round(np.linspace(*required.range_of(axis), 501) / RESOLUTION) * RESOLUTION
    if not axis.linear:
        turns = {side: required.rotary_correction(axis, dense, side) for side in (UP, DOWN, BOTH)}
        split = form.directions and np.abs(turns[UP] - turns[DOWN]).max() > NEGLIGIBLE_SHARE * tolerance
        used = (UP, DOWN) if split else (BOTH,)
        worth = max(np.abs(turns[side]).max() for side in used) > NEGLIGIBLE_SHARE * tolerance
        return [TableColumn(axis.name, side) for side in used] if worth else []
    linear = [machine.axes[i].name for i in machine.linear]
    sides = (UP, DOWN) if form.directions else (BOTH, BOTH)
    up, down = (
        required.linear_corrections((axis.name,), required.positions_along(axis, dense), side) for side in sides
    )
    found: list[TableColumn] = []
    for k, moved in enumerate(linear):
        if not form.across and moved != axis.name:
            continue
        if max(np.abs(up[:, k]).max(), np.abs(down[:, k]).max()) <= NEGLIGIBLE_SHARE * tolerance:
            continue
        can = form.crossed_directions or moved == axis.name
        directed = can and np.abs(up[:, k] - down[:, k]).max() > NEGLIGIBLE_SHARE * tolerance
        found += [TableColumn(moved, side) for side in ((UP, DOWN) if directed else (BOTH,))]
    for by in linear if form.products and request.products else ():
        if by != axis.name:
            peaks = np.abs(_slope(required, axis, by, dense)).max(axis=0)
            found += [
                TableColumn(moved, BOTH, by)
                for moved, peak in zip(linear, peaks, strict=True)
                if peak > 0.5 * tolerance
            ]
    return found


def _required_values(
    required: RequiredCorrections, axis: Axis, columns: Sequence[TableColumn]
) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function of the required values of the columns over one axis: (n,) positions → (n, columns) µm or µrad."""
    linear = [required.machine.axes[i].name for i in required.machine.linear]

    def truth(q: np.ndarray) -> np.ndarray:
        if not axis.linear:
            return np.stack([required.rotary_correction(axis, q, one.side) for one in columns], axis=1)
        line, found = required.positions_along(axis, q), {}
        for side, by in {(one.side, one.by) for one in columns}:
            found[side, by] = (
                required.linear_corrections((axis.name,), line, side) if by is None else _slope(required, axis, by, q)
            )
        return np.stack([found[one.side, one.by][:, linear.index(one.moved)] for one in columns], axis=1)

    return truth


def _factors(required: RequiredCorrections, axis: Axis, columns: Sequence[TableColumn], q: np.ndarray) -> np.ndarray:
    """Return the factors (n, columns, r) of the covariance of the required values of the columns, as `_required_values`."""
    if not axis.linear:
        return np.stack([required.rotary_factors(axis, q, one.side) for one in columns], axis=1)
    linear, line = [required.machine.axes[i].name for i in required.machine.linear], required.positions_along(axis, q)
    found: dict[tuple[Direction, str | None], np.ndarray] = {}
    for side, by in {(one.side, one.by) for one in columns}:
        if by is None:
            found[side, by] = required.linear_factors((axis.name,), line, side)
        else:
            ends = [
                required.linear_factors((axis.name,), required.positions_along(axis, q, {by: end}))
                for end in required.range_of(required.machine.by_name[by])
            ]
            found[side, by] = 0.5 * (ends[1] - ends[0])
    return np.stack([found[one.side, one.by][:, linear.index(one.moved)] for one in columns], axis=1)


def _slope(required: RequiredCorrections, axis: Axis, by: str, q: np.ndarray) -> np.ndarray:
    """Return the change (n, linear axes) in µm of the correction when axis ``by`` moves by half its range."""
    low, high = required.range_of(required.machine.by_name[by])
    ends = [
        required.linear_corrections((axis.name,), required.positions_along(axis, q, {by: end})) for end in (low, high)
    ]
    return np.asarray(0.5 * (ends[1] - ends[0]))


def _planned(
    required: RequiredCorrections,
    axis: Axis,
    columns: Sequence[TableColumn],
    nodes: Nodes,
    truth: Callable[[np.ndarray], np.ndarray],
    period: float | None,
) -> list[Planned]:
    """Return the tables over one axis on the nodes, with the required values at the random positions."""
    where = tuple(nodes.at.tolist())
    q = check_positions(where[0], where[-1])
    meant = truth(q)
    found = []
    for k, one in enumerate(columns):
        factors = [ControlCurve(axis.name, where, tuple(nodes.values[:, k].tolist()), period, one.side)]
        if one.by is not None:
            low, high = required.range_of(required.machine.by_name[one.by])
            half, middle = 0.5 * (high - low), required.at[one.by]
            factors.append(ControlCurve(one.by, (low, high), ((low - middle) / half, (high - middle) / half)))
        reach = factors[1].peak if one.by is not None else 1.0
        found.append(Planned(ControlTerm(one.moved, tuple(factors)), float(nodes.deviation[k]) * reach, q, meant[:, k]))
    return found


def _strongest(found: Sequence[Planned], most: int | None) -> tuple[tuple[Planned, ...], tuple[str, ...]]:
    """Return at most ``most`` tables, those with the largest correction per table, and the names of those left out."""
    order = sorted(range(len(found)), key=lambda i: -found[i].term.peak / len(found[i].term.factors))
    kept: set[int] = set()
    used = 0
    for i in order:
        need = len(found[i].term.factors)
        if most is None or used + need <= most:
            kept.add(i)
            used += need
    left_out = tuple(f"{one.term.name}: {one.term.peak:.1f}" for i, one in enumerate(found) if i not in kept)
    return tuple(one for i, one in enumerate(found) if i in kept), left_out


def _table(
    one: Planned, content: TableSummary, back: TableSum, required: RequiredCorrections, request: Request
) -> Table:
    """Return one table compared with the file read back; a product at the position where its lever is longest."""
    moved, factors = required.machine.by_name[one.term.axis], one.term.factors
    found = next(term for term in back.terms if term.key == one.term.key)
    rounding, scale = request.form.rounding[0 if moved.linear else 1], 1.0
    truth, said = one.truth, found.factors[0].along(one.q)
    for factor, read in zip(factors[1:], found.factors[1:], strict=True):
        end, scale = factor.at[int(np.argmax(np.abs(factor.values)))], factor.peak
        truth, said = truth * factor.along(end), said * read.along(end)
        rounding = rounding * scale + one.term.peak * 1e-9
    tolerance = tolerance_of(moved, request.tolerance_um) * scale
    return Table(content, one.deviation, rounding, tolerance, float(np.abs(truth - said).max()))


def _nodes_of_old_tables(old: TableSum, axis: Axis) -> tuple[float, ...] | None:
    """Return the nodes of the old tables over an axis; None if there are none."""
    curves = [term.factors[0] for term in old.terms if term.factors[0].argument == axis.name]
    if not curves:
        return None
    if any(curve.at != curves[0].at for curve in curves):
        raise InputError(
            f"the old tables over {axis.name}, to which new ones are added, have different nodes",
            expected="the same nodes in all tables over one axis",
            value=[f"{len(curve.at)} points" for curve in curves],
        )
    return curves[0].at
