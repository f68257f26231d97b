"""The corrections of the linear axes for their own errors, over their box."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin.control.design import CHECKS, SEED, Design, Share, Table, TablePlan, depending
from twin.control.nodes import chosen
from twin.control.request import Request
from twin.control.wanted import Wanted
from twin.machine.control.spatial import CorrectionGrid
from twin.machine.effects import Effect
from twin.machine.machine import Axis

SHARES: Final = (0.6, 0.4, 0.3, 0.2)
"""Of the tolerance for one axis, tried in turn: the interpolations of three add up, how much depends on the machine."""
MARGIN: Final = 1.05
"""Not every cell is looked at."""
CELLS: Final = 4000
CELL_SEED: Final = 230
Truth = Callable[[np.ndarray], np.ndarray]
"""(n, axes) positions → (n, 3) µm."""


@final
class GridDesign(Design[CorrectionGrid]):
    """Corrections of the three linear axes at the points of their box."""

    correction = CorrectionGrid

    def plan(self, wanted: Wanted, request: Request, old: CorrectionGrid | None) -> TablePlan[CorrectionGrid]:
        """See `Design.plan`."""
        machine = wanted.machine
        axes = [machine.axes[i] for i in machine.linear]
        names = tuple(axis.name for axis in axes)
        if len(names) != 3:
            raise InputError(
                f"{machine.name} has not three linear axes",
                expected="three, which span the grid's box; linuxcnc, heidenhain and siemens have tables of single axes",
                file=machine.path,
                value=" ".join(names) or "none",
            )

        def truth(positions: np.ndarray) -> np.ndarray:
            return wanted.point(names, positions)

        tolerance = request.tolerance_um
        if old is not None:
            grid = _on_nodes(wanted, tuple(np.array(nodes) for nodes in old.at), truth)
            off = _between(wanted, grid, truth)
        else:
            for share in SHARES:
                where = tuple(_nodes(wanted, axis, truth, share * tolerance, request) for axis in axes)
                grid = _on_nodes(wanted, where, truth)
                off = _between(wanted, grid, truth)
                if off <= tolerance or request.step is not None:
                    break
        return TablePlan(grid, lambda back: _tables(wanted, request, grid, truth, off, back))

    def share(self, wanted: Wanted, effect: Effect, others: Sequence[Axis], request: Request) -> tuple[Share, str]:
        """See `Design.share`."""
        if not wanted.machine.by_name[effect.frame.axis].linear:
            return "no", "an error of a rotary axis: a grid knows X, Y and Z only"
        return depending([axis for axis in others if not axis.linear])


def _tables(
    wanted: Wanted, request: Request, grid: CorrectionGrid, truth: Truth, off: float, back: CorrectionGrid
) -> tuple[Table, ...]:
    """Every axis's corrections as written and as read back beside the truth, at places drawn in the box."""
    rng = np.random.default_rng(SEED)
    q = np.stack([rng.uniform(nodes[0], nodes[-1], CHECKS) for nodes in grid.at], axis=1)
    state, meant = _state(wanted, q), truth(_full(wanted, q))
    found = []
    for k, (name, content) in enumerate(zip(grid.axes, grid.contents(), strict=True)):
        written, read = (float(np.abs(one.shift(name, state) - meant[:, k]).max()) for one in (grid, back))
        # Where a place drawn here is farther off than all that were looked at before, that is what is said of the grid.
        found.append(Table(content, max(off, written), request.form.rounding[0], request.tolerance_um, read))
    return tuple(found)


def _nodes(wanted: Wanted, axis: Axis, truth: Truth, limit_um: float, request: Request) -> np.ndarray:
    """Nodes of one axis, looked for on the edges of the box: there the levers of angular errors are longest."""
    others = [wanted.machine.axes[i] for i in wanted.machine.linear if wanted.machine.axes[i] is not axis]
    corners = [
        {one.name: end for one, end in zip(others, ends, strict=True)}
        for ends in product(*(wanted.range_of(one) for one in others))
    ]

    def along(q: np.ndarray) -> np.ndarray:
        return np.concatenate([truth(wanted.line(axis, q, corner)) for corner in corners], axis=1)

    limits = np.full(3 * len(corners), limit_um)
    return chosen(along, *wanted.range_of(axis), limits, step=request.step, most=request.form.points).at


def _on_nodes(wanted: Wanted, where: tuple[np.ndarray, ...], truth: Truth) -> CorrectionGrid:
    mesh = np.stack(np.meshgrid(*where, indexing="ij"), axis=-1).reshape(-1, 3)
    values = truth(_full(wanted, mesh)).reshape(*(len(nodes) for nodes in where), 3)
    return CorrectionGrid(wanted.machine, tuple(tuple(nodes.tolist()) for nodes in where), values)


def _between(wanted: Wanted, grid: CorrectionGrid, truth: Truth) -> float:
    """Largest distance of the truth from a grid between its points, µm, over the places looked at.

    These are middles of cells, and of the cells' sides along the edges of the box, where the interpolation is farthest off.
    """
    rng, where = np.random.default_rng(CELL_SEED), [np.array(nodes) for nodes in grid.at]
    inside = np.stack([rng.choice(0.5 * (nodes[1:] + nodes[:-1]), CELLS) for nodes in where], axis=1)
    ends = np.stack([rng.choice(nodes[[0, -1]], CELLS) for nodes in where], axis=1)
    on_edges = np.where(rng.integers(0, 3, (CELLS, 1)) == np.arange(3), inside, ends)
    q = np.concatenate([inside, on_edges])
    state = _state(wanted, q)
    seen = np.stack([grid.shift(name, state) for name in grid.axes], axis=1)
    return float(MARGIN * np.abs(seen - truth(_full(wanted, q))).max())


def _full(wanted: Wanted, linear: np.ndarray) -> np.ndarray:
    """(n, axes) with the other axes where they stand."""
    rows = np.tile([wanted.at[name] for name in wanted.machine.names], (len(linear), 1))
    rows[:, list(wanted.machine.linear)] = linear
    return np.asarray(rows)


def _state(wanted: Wanted, linear: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(wanted.machine.names, _full(wanted, linear).T, strict=True))
