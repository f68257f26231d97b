"""Tables that are not of one axis: component errors for a control that knows the machine, and the spatial grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.units import TURN
from twin.control.design import URAD_A_UM, WORTH
from twin.control.nodes import at, chosen
from twin.control.wanted import Wanted
from twin.machine.control import Curve
from twin.machine.control.geometry import Geometry
from twin.machine.control.grid import Grid
from twin.machine.control.isg import AxisErrors, Volumetric
from twin.machine.machine import Axis

ISG_POINTS: Final = 400
"""Records of an axis: `vol_comp[0].max_records` is to be their sum or more."""
GRID_POINTS: Final = 101
"""Of an axis."""
GRID_SHARES: Final = (0.6, 0.4, 0.3, 0.2)
"""Of the tolerance for one axis, tried in turn: the interpolations of three add up, how much depends on the machine."""
GRID_MARGIN: Final = 1.05
"""Not every cell is looked at."""
CHECKED: Final = 4000
SEED: Final = 230


@final
@dataclass(frozen=True)
class PlannedErrors:
    """Component errors of one axis, with their truth.

    Attributes:
        errors: as they will be written.
        truth: positions → (n, 6) µm and µrad.
        off: (6,) largest distance of the truth from the straight lines.
    """

    errors: AxisErrors
    truth: Callable[[np.ndarray], np.ndarray]
    off: np.ndarray


def component_errors(
    wanted: Wanted, geometry: Geometry, *, tolerance_um: float, step: float | None, old: Volumetric | None
) -> tuple[PlannedErrors, ...]:
    """What acts in the error frame of every axis, its place and squareness included, as the format has it."""
    found = []
    limit = np.array([tolerance_um] * 3 + [tolerance_um * URAD_A_UM] * 3)
    before = {} if old is None else {one.axis: one for one in old.errors}
    for axis in wanted.machine.axes:
        truth = _truth(wanted, geometry, axis)
        low, high = wanted.range_of(axis)
        used = [
            i
            for i, peak in enumerate(np.abs(truth(np.linspace(low, high, 501))).max(axis=0))
            if peak > WORTH * limit[i]
        ]
        if not used:
            continue
        period = TURN if axis.lower is None else None
        if axis.name in before:
            curve = next(iter(before[axis.name].curves.values()))
            nodes = at(truth, np.array(curve.at))
        else:
            nodes = chosen(truth, low, high, limit, step=step, most=ISG_POINTS)
        where = tuple(float(q) for q in nodes.at)
        curves = {i: Curve(axis.name, where, tuple(float(v) for v in nodes.values[:, i]), period) for i in used}
        found.append(PlannedErrors(AxisErrors(axis.name, curves), truth, nodes.off))
    return tuple(found)


def _truth(wanted: Wanted, geometry: Geometry, axis: Axis) -> Callable[[np.ndarray], np.ndarray]:
    frame = next(one for one in geometry.frames if one.axis == axis.name)
    turn, place = geometry.at_zero(frame)
    turn_array = np.array(turn, dtype=float)
    lever = np.array(geometry.centre(frame), dtype=float) - np.array(place, dtype=float)

    def truth(q: np.ndarray) -> np.ndarray:
        own = wanted.frame_errors(axis, q)
        shift, spin = own[:, :3] @ turn_array.T, own[:, 3:] @ turn_array.T
        # µrad times mm are nanometres.
        return np.concatenate([shift + 1e-3 * np.cross(spin, lever), spin], axis=1)

    return truth


def added_errors(new: tuple[PlannedErrors, ...], old: Volumetric) -> tuple[AxisErrors, ...]:
    """New component errors and old ones together."""
    found: dict[str, dict[int, Curve]] = {one.axis: dict(one.curves) for one in old.errors}
    for one in new:
        own = found.setdefault(one.errors.axis, {})
        for i, curve in one.errors.curves.items():
            values = (
                tuple(a + b for a, b in zip(curve.values, own[i].along(np.array(curve.at)), strict=True))
                if i in own
                else curve.values
            )
            own[i] = Curve(curve.of, curve.at, tuple(float(value) for value in values), curve.period)
    whole = []
    for name in old.geometry.machine.names:
        curves = found.get(name, {})
        if curves:
            widest = max(curves.values(), key=lambda curve: len(curve.at)).at
            whole.append(
                AxisErrors(
                    name,
                    {
                        i: Curve(c.of, widest, tuple(float(v) for v in c.along(np.array(widest))), c.period)
                        for i, c in curves.items()
                    },
                )
            )
    return tuple(whole)


@final
@dataclass(frozen=True)
class PlannedGrid:
    """A grid, with its truth.

    Attributes:
        grid: as it will be written.
        truth: (n, axes) positions → (n, 3) µm.
        off: largest distance of the truth from the grid between its points, µm; over the places looked at.
    """

    grid: Grid
    truth: Callable[[np.ndarray], np.ndarray]
    off: float


def spatial_grid(wanted: Wanted, *, tolerance_um: float, step: float | None, old: Grid | None) -> PlannedGrid:
    """The corrections of the linear axes for their own errors, over their box.

    Raises:
        InputError: the machine has not three linear axes; as `twin.control.nodes.chosen`.
    """
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

    if old is not None:
        return _on_nodes(wanted, names, tuple(np.array(old.at[old.names.index(name)]) for name in names), truth)
    found = None
    for share in GRID_SHARES:
        where = tuple(_nodes(wanted, axis, truth, share * tolerance_um, step) for axis in axes)
        found = _on_nodes(wanted, names, where, truth)
        if found.off <= tolerance_um or step is not None:
            break
    return found  # type: ignore[return-value]


def _nodes(
    wanted: Wanted, axis: Axis, truth: Callable[[np.ndarray], np.ndarray], limit_um: float, step: float | None
) -> np.ndarray:
    """Nodes of one axis, looked for on the edges of the box: there the levers of angular errors are longest."""
    low, high = wanted.range_of(axis)
    others = [wanted.machine.axes[i] for i in wanted.machine.linear if wanted.machine.axes[i] is not axis]
    corners = [
        {one.name: end for one, end in zip(others, ends, strict=True)}
        for ends in product(*(wanted.range_of(one) for one in others))
    ]

    def along(q: np.ndarray) -> np.ndarray:
        return np.concatenate([truth(wanted.line(axis, q, corner)) for corner in corners], axis=1)

    return chosen(along, low, high, np.full(3 * len(corners), limit_um), step=step, most=GRID_POINTS).at


def _on_nodes(
    wanted: Wanted,
    names: tuple[str, ...],
    where: tuple[np.ndarray, ...],
    truth: Callable[[np.ndarray], np.ndarray],
) -> PlannedGrid:
    mesh = np.stack(np.meshgrid(*where, indexing="ij"), axis=-1).reshape(-1, 3)
    values = truth(_full(wanted, names, mesh)).reshape(*(len(nodes) for nodes in where), 3)
    grid = Grid(names, tuple(tuple(float(q) for q in nodes) for nodes in where), values)
    rng = np.random.default_rng(SEED)
    inside = np.stack([rng.choice(0.5 * (nodes[1:] + nodes[:-1]), CHECKED) for nodes in where], axis=1)
    # Middles of cells, and of the cells' sides along the edges of the box, where the interpolation is farthest off.
    ends = np.stack([rng.choice(nodes[[0, -1]], CHECKED) for nodes in where], axis=1)
    on_edges = np.where(rng.integers(0, 3, (CHECKED, 1)) == np.arange(3), inside, ends)
    places = _full(wanted, names, np.concatenate([inside, on_edges]))
    state = {name: places[:, i] for i, name in enumerate(wanted.machine.names)}
    seen = np.stack([grid.shift(name, state) for name in names], axis=1)
    return PlannedGrid(grid, truth, float(GRID_MARGIN * np.abs(seen - truth(places)).max()))


def _full(wanted: Wanted, names: tuple[str, ...], linear: np.ndarray) -> np.ndarray:
    """(n, axes) with the other axes where they stand."""
    rows = np.tile([wanted.at[name] for name in wanted.machine.names], (len(linear), 1))
    rows[:, [wanted.machine.names.index(name) for name in names]] = linear
    return np.asarray(rows)
