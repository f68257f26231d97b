"""Spatial error grid: corrections of the three linear axes at the points of a box, as CSV; a format of ours.

A head line ``X_mm,Y_mm,Z_mm,dX_um,dY_um,dZ_um``, one point a row, every combination of the positions once, in any order; ``#``
comments. **The sign is that of the correction**: what is added to the command of the axis. The error of the axes at that point is
its negative. Between the points linear along each axis (trilinear), outside the box the value of the nearest place on it. One
tool length and one position of the rotary axes: the comments say which.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Final, final

import casadi as ca
import numpy as np

from twin._common.arrays import locked
from twin._common.csv_tables import read_table
from twin._common.errors import InputError
from twin.machine.control.base import Correction
from twin.machine.control.curve import Curve
from twin.machine.control.lines import number, plain
from twin.machine.machine import Machine

FILE: Final = "grid.csv"
DIGITS: Final = 4
"""Behind the point, µm."""
EXACT_UM: Final = 0.005
"""What the expression of a grid may differ from its points by: the text of them says no more than a tenth of a nanometre, a machine
less."""


@final
class Grid(Correction):
    """Corrections at the points of a box.

    Args:
        names: the three linear axes in command order.
        at: positions of each, mm, rising.
        values: (nodes of the first, of the second, of the third, 3) µm.
    """

    def __init__(self, names: tuple[str, ...], at: tuple[tuple[float, ...], ...], values: np.ndarray) -> None:
        self.names = names
        self.at = at
        self.values = locked(np.asarray(values, dtype=float))

    @property
    def axes(self) -> tuple[str, ...]:
        """See `Correction.axes`."""
        return self.names

    def shift(self, axis: str, positions: Mapping[str, Any]) -> Any:
        """See `Correction.shift`."""
        table = self.values[..., self.names.index(axis)]
        q = [positions[name] for name in self.names]
        if any(isinstance(one, ca.SX) for one in q):
            return self._expression(self.names.index(axis), q)
        q = [np.asarray(one, dtype=float) for one in np.broadcast_arrays(*q)]
        found: Any = np.zeros(q[0].shape)
        places = [_place(nodes, one) for nodes, one in zip(self.at, q, strict=True)]
        for corner in np.ndindex(2, 2, 2):
            weight: Any = 1.0
            index = []
            for (start, part), far in zip(places, corner, strict=True):
                weight = weight * (part if far else 1.0 - part)
                index.append(start + far)
            found = found + weight * table[tuple(index)]
        return found

    def _expression(self, output: int, q: Sequence[Any]) -> Any:
        """Sums of products of curves of one axis each, which make the same grid within `EXACT_UM`."""
        cores, shapes = self._products
        factors = [
            [Curve(name, nodes, tuple(column)).along(one) for column in shape.T.tolist()]
            for name, nodes, shape, one in zip(self.names, self.at, shapes, q, strict=True)
        ]
        total: Any = 0.0
        for i, first in enumerate(factors[0]):
            middle: Any = 0.0
            for j, second in enumerate(factors[1]):
                inner: Any = 0.0
                for k, third in enumerate(factors[2]):
                    inner = inner + third * float(cores[i, j, k, output])
                middle = middle + second * inner
            total = total + first * middle
        return total

    @cached_property
    def _products(self) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """The grid as few products of curves (Tucker's decomposition): cores (r, s, t, 3), and a column a curve for every axis.

        A machine's correction is a few curves times straight lines: some ten products instead of every point of the box. Between
        the points both are averages of what they are at them, so that what holds there holds everywhere.
        """
        spectra = []
        for i in range(3):
            flat = np.moveaxis(self.values, i, 0).reshape(len(self.at[i]), -1)
            u, s, _ = np.linalg.svd(flat, full_matrices=False)
            spectra.append((u, s))
        limit = 1.0
        while True:
            shapes = tuple(u[:, : max(1, int(np.sum(s > limit)))] for u, s in spectra)
            cores = np.einsum("xyzo,xi,yj,zk->ijko", self.values, *shapes, optimize=True)
            again = np.einsum("ijko,xi,yj,zk->xyzo", cores, *shapes, optimize=True)
            if np.abs(again - self.values).max() <= EXACT_UM or limit < 1e-12:
                return cores, shapes
            limit *= 0.5


def _place(nodes: tuple[float, ...], q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index of the node before, and the part of the way to the next."""
    at = np.array(nodes)
    inside = np.clip(q, at[0], at[-1])
    start = np.clip(np.searchsorted(at, inside, side="right") - 1, 0, len(at) - 2)
    return start, (inside - at[start]) / (at[start + 1] - at[start])


def write(grid: Grid, notes: Sequence[str] = ()) -> dict[str, str]:
    """The file by its name.

    Args:
        grid: the corrections.
        notes: said in comments at the head.
    """
    lines = [
        f"# {note}"
        for note in ("correction: what is ADDED to the command of an axis; the error there is its negative", *notes)
    ]
    lines.append(",".join([*(f"{name}_mm" for name in grid.names), *(f"d{name}_um" for name in grid.names)]))
    for i, x in enumerate(grid.at[0]):
        for j, y in enumerate(grid.at[1]):
            for k, z in enumerate(grid.at[2]):
                cells = [plain(q, 4) for q in (x, y, z)] + [plain(value, DIGITS) for value in grid.values[i, j, k]]
                lines.append(",".join(cells))
    return {FILE: "\n".join(lines) + "\n"}


def read(files: Sequence[Path], machine: Machine) -> Grid:
    """The grid of one file.

    Raises:
        InputError: more than one file, other columns than the machine's three linear axes want, a point missing or given twice.
    """
    if len(files) != 1:
        raise InputError("a grid is one file", expected="one", value=" ".join(file.name for file in files))
    path = files[0]
    names = tuple(machine.axes[i].name for i in machine.linear)
    columns = [*(f"{name}_mm" for name in names), *(f"d{name}_um" for name in names)]
    header, rows, _ = read_table(path)
    if len(names) != 3 or header != columns:
        raise InputError("columns of a grid", expected=",".join(columns), file=path, value=",".join(header))
    if not rows:
        raise InputError("no points", expected="one or more rows", file=path)
    numbers = np.array(
        [[number(cell, path, line, name) for cell, name in zip(row, header, strict=True)] for line, row in rows]
    )
    at = tuple(tuple(float(q) for q in np.unique(numbers[:, i])) for i in range(3))
    shape = tuple(len(nodes) for nodes in at)
    if min(shape) < 2:
        raise InputError(
            "one position of an axis", expected="two or more of each", file=path, value=" × ".join(map(str, shape))
        )
    values = np.full((*shape, 3), np.nan)
    for (line, row), found in zip(rows, numbers, strict=True):
        place = tuple(at[i].index(float(found[i])) for i in range(3))
        if not np.isnan(values[place][0]):
            raise InputError("a point given twice", expected="each once", file=path, line=line, value=",".join(row))
        values[place] = found[3:]
    if np.isnan(values).any():
        place = np.argwhere(np.isnan(values[..., 0]))[0]
        raise InputError(
            "a point is missing",
            expected="every combination of the positions",
            file=path,
            value=" ".join(f"{name} {at[i][place[i]]:g}" for i, name in enumerate(names)),
        )
    return Grid(names, at, values)
