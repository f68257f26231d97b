"""Corrections of the three linear axes for their own errors, on a grid over their ranges."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin.control.design import (
    CHECKS,
    SEED,
    U_EVERY,
    Design,
    ProofOfTables,
    Share,
    Table,
    TablePlan,
    share_depending_on,
)
from twin.control.nodes import choose_nodes
from twin.control.request import Request
from twin.control.required import RequiredCorrections
from twin.machine.classes import BASIC
from twin.machine.control import TableSummary
from twin.machine.control.spatial import CorrectionGrid
from twin.machine.effects import Effect
from twin.machine.machine import Axis

SHARES: Final = (0.6, 0.4, 0.3, 0.2)
"""Shares of the tolerance for one axis, tried in turn: interpolation errors of three axes add up, depending on the machine."""
MARGIN: Final = 1.05
"""Safety factor, as only a sample of the cells is checked."""
CELLS: Final = 4000
CELL_SEED: Final = 230
Truth = Callable[[np.ndarray], np.ndarray]
"""Function from (n, axes) positions to (n, 3) required corrections in µm."""


@final
class GridDesign(Design[CorrectionGrid]):
    """Compute the corrections of the three linear axes at the points of a grid."""

    correction = CorrectionGrid

    def plan(
        self, required: RequiredCorrections, request: Request, old: CorrectionGrid | None
    ) -> TablePlan[CorrectionGrid]:
        """See `Design.plan`."""
        machine = required.machine
        axes = [machine.axes[i] for i in machine.linear]
        names = tuple(axis.name for axis in axes)
        if len(names) != 3:
            raise InputError(
                f"{machine.name} does not have three linear axes",
                expected="three linear axes for a grid; linuxcnc, heidenhain and siemens have tables of single axes",
                file=machine.path,
                value=" ".join(names) or "none",
            )

        proof = ProofOfTables(required, keep_all=request.unproven)
        kept = np.array(_proven(required, axes, proof), dtype=float)

        def truth(positions: np.ndarray) -> np.ndarray:
            return required.linear_corrections(names, positions) * kept

        tolerance = request.tolerance_um
        if old is not None:
            grid = _on_nodes(required, tuple(np.array(nodes) for nodes in old.at), truth)
            off = _largest_deviation(required, grid, truth)
        else:
            for share in SHARES:
                where = tuple(_nodes(required, axis, truth, share * tolerance, request) for axis in axes)
                grid = _on_nodes(required, where, truth)
                off = _largest_deviation(required, grid, truth)
                if off <= tolerance or request.step is not None:
                    break
        return TablePlan(
            grid, lambda back: _tables(required, request, grid, truth, off, back), unproven=tuple(proof.unproven)
        )

    def share(
        self, required: RequiredCorrections, effect: Effect, others: Sequence[Axis], request: Request
    ) -> tuple[Share, str]:
        """See `Design.share`."""
        if not required.machine.by_name[effect.frame.axis].linear:
            return "no", "error of a rotary axis: the grid depends on X, Y and Z only"
        return share_depending_on([axis for axis in others if not axis.linear])


def _proven(required: RequiredCorrections, axes: Sequence[Axis], proof: ProofOfTables) -> list[bool]:
    """Return for each of the linear axes whether its correction over the box is written; otherwise it is zero."""
    names = tuple(axis.name for axis in axes)
    rng = np.random.default_rng(SEED)
    q = _full(required, np.stack([rng.uniform(*required.range_of(axis), CHECKS // U_EVERY) for axis in axes], axis=1))
    values, factors = required.linear_corrections(names, q), required.linear_factors(names, q)
    return [
        # Without any correction there is nothing to prove.
        not values[:, k].any()
        or proof.keeps(
            TableSummary.over(f"d{name} over the box", (0.0,), 0.0, "um"), names, BASIC, values[:, k], factors[:, k]
        )
        for k, name in enumerate(names)
    ]


def _tables(
    required: RequiredCorrections,
    request: Request,
    grid: CorrectionGrid,
    truth: Truth,
    off: float,
    back: CorrectionGrid,
) -> tuple[Table, ...]:
    """Compare the corrections of every axis, as written and as read back, with the required ones at random positions."""
    rng = np.random.default_rng(SEED)
    q = np.stack([rng.uniform(nodes[0], nodes[-1], CHECKS) for nodes in grid.at], axis=1)
    state, meant = _state(required, q), truth(_full(required, q))
    found = []
    for k, (name, content) in enumerate(zip(grid.axes, grid.contents(), strict=True)):
        written, read = (float(np.abs(one.shift(name, state) - meant[:, k]).max()) for one in (grid, back))
        # A random position may show a larger deviation than the cells checked before: report the larger one.
        found.append(Table(content, max(off, written), request.form.rounding[0], request.tolerance_um, read))
    return tuple(found)


def _nodes(required: RequiredCorrections, axis: Axis, truth: Truth, limit_um: float, request: Request) -> np.ndarray:
    """Return the nodes of one axis, chosen along the edges of the box, where the levers of angular errors are longest."""
    others = [required.machine.axes[i] for i in required.machine.linear if required.machine.axes[i] is not axis]
    corners = [
        {one.name: end for one, end in zip(others, ends, strict=True)}
        for ends in product(*(required.range_of(one) for one in others))
    ]

    def along(q: np.ndarray) -> np.ndarray:
        return np.concatenate([truth(required.positions_along(axis, q, corner)) for corner in corners], axis=1)

    limits = np.full(3 * len(corners), limit_um)
    return choose_nodes(along, *required.range_of(axis), limits, step=request.step, most=request.form.points).at


def _on_nodes(required: RequiredCorrections, where: tuple[np.ndarray, ...], truth: Truth) -> CorrectionGrid:
    """Return the grid with the required corrections at its points."""
    mesh = np.stack(np.meshgrid(*where, indexing="ij"), axis=-1).reshape(-1, 3)
    values = truth(_full(required, mesh)).reshape(*(len(nodes) for nodes in where), 3)
    return CorrectionGrid(required.machine, tuple(tuple(nodes.tolist()) for nodes in where), values)


def _largest_deviation(required: RequiredCorrections, grid: CorrectionGrid, truth: Truth) -> float:
    """Return the largest deviation in µm of the required correction from the grid's interpolation.

    It is evaluated at the centres of a sample of cells and at the midpoints of cell sides along the edges of the box, where the
    interpolation error is largest.
    """
    rng, where = np.random.default_rng(CELL_SEED), [np.array(nodes) for nodes in grid.at]
    inside = np.stack([rng.choice(0.5 * (nodes[1:] + nodes[:-1]), CELLS) for nodes in where], axis=1)
    ends = np.stack([rng.choice(nodes[[0, -1]], CELLS) for nodes in where], axis=1)
    on_edges = np.where(rng.integers(0, 3, (CELLS, 1)) == np.arange(3), inside, ends)
    q = np.concatenate([inside, on_edges])
    state = _state(required, q)
    seen = np.stack([grid.shift(name, state) for name in grid.axes], axis=1)
    return float(MARGIN * np.abs(seen - truth(_full(required, q))).max())


def _full(required: RequiredCorrections, linear: np.ndarray) -> np.ndarray:
    """Return (n, axes) positions: the linear axes as given, the other axes at their reference positions."""
    rows = np.tile([required.at[name] for name in required.machine.names], (len(linear), 1))
    rows[:, list(required.machine.linear)] = linear
    return np.asarray(rows)


def _state(required: RequiredCorrections, linear: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(required.machine.names, _full(required, linear).T, strict=True))
