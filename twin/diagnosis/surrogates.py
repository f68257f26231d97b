"""What no name is given to: smooth functions of each column and of pairs of columns, on each side, in each direction.

They compete with the named causes. A pattern that one of them carries better, after its higher price, than all named causes together
is left unexplained, with the columns it depends on.
"""

from __future__ import annotations

from itertools import combinations
from typing import Final

import numpy as np

from twin.diagnosis.catalogue import Candidate, Cell
from twin.diagnosis.functions import Functions, Rows
from twin.diagnosis.signatures import Column, of_base
from twin.machine import Machine
from twin.measurement import CARRIERS, Measurements, state_of

EFFECT: Final = "surrogate"
ALONE: Final = 4
PAIRED: Final = 2
ANY: Final = 6


def surrogates(machine: Machine, data: Measurements) -> list[Candidate]:
    """Every column and pair of columns, on each side of the machine, along each direction of the base or all three."""
    state = _with_rounds(machine, data)
    names = [name for name, values in state.items() if np.ptp(values) > 0.0]
    single = [_smooth(name, state[name], machine, ALONE) for name in names]
    low = [_smooth(name, state[name], machine, PAIRED) for name in names]
    found: list[Candidate] = []
    for side in CARRIERS:
        own = data.carrier == side
        if not own.any():
            continue
        # All of one side in one table: each is worked out once, for all directions.
        of: list[tuple[tuple[str, ...], int]] = [((name,), one.count) for name, one in zip(names, single, strict=True)]
        of += [((names[a], names[b]), low[a].count * low[b].count) for a, b in combinations(range(len(names)), 2)]

        def values(rows: Rows, own: np.ndarray = own) -> np.ndarray:
            few = [one.values(rows) for one in low]
            products = [(x[:, :, None] * y[:, None, :]).reshape(len(x), -1) for x, y in combinations(few, 2)]
            every = np.concatenate([*(one.values(rows) for one in single), *products], axis=1)
            return np.asarray(every * own[rows, None])

        functions = Functions(len(own), sum(count for _, count in of), values, own)
        start = 0
        for columns, count in of:
            found.append(_candidate(columns, functions, range(start, start + count), side, machine))
            start += count
    return found


def whatever(candidate: Candidate, machine: Machine, data: Measurements) -> list[Column]:
    """Any smooth function of an unnamed pattern's columns, on its side, in all directions: what a pattern is if one knows no better."""
    side, *columns = candidate.where.split("|")
    state = _with_rounds(machine, data)
    mask = (data.carrier == side).astype(float)
    named = {column_name(name, machine): name for name in state}
    own = [_smooth(named[column], state[named[column]], machine, ANY) for column in columns]

    def values(rows: Rows) -> np.ndarray:
        found = mask[rows, None]
        for one in own:
            each = np.concatenate([np.ones((len(found), 1)), one.values(rows)], axis=1)
            found = (found[:, :, None] * each[:, None, :]).reshape(len(found), -1)
        return found

    functions = Functions(len(mask), int(np.prod([one.count + 1 for one in own])), values)
    return [of_base(i, functions, k) for i in range(3) for k in range(functions.count)]


def _with_rounds(machine: Machine, data: Measurements) -> dict[str, np.ndarray]:
    """What patterns may depend on."""
    state = dict(state_of(data, machine))
    if len(set(data.round)) > 2:
        rounds = list(dict.fromkeys(data.round))
        state["round"] = np.array([float(rounds.index(name)) for name in data.round])
    return state


def _candidate(names: tuple[str, ...], functions: Functions, own: range, side: str, machine: Machine) -> Candidate:
    where = f"{side}|{'|'.join(column_name(name, machine) for name in names)}"
    directions = [tuple(of_base(i, functions, k) for k in own) for i in range(3)]
    cells = [Cell(columns) for columns in directions]
    if len(names) > 1:
        # Of one column alone, most of it has a name: positioning, straightness, squareness.
        cells.append(Cell(tuple(column for columns in directions for column in columns)))
    return Candidate(EFFECT, where, "unknown", (), tuple(cells), float(len(cells)))


def _smooth(name: str, values: np.ndarray, machine: Machine, most: int) -> Functions:
    """A few smooth functions of a column, no constant."""
    axis = machine.by_name.get(name)
    if axis is not None and not axis.linear:
        orders = most // 2

        def turning(rows: Rows) -> np.ndarray:
            angle = np.radians(values[rows])
            return np.stack([f(k * angle) for k in range(1, orders + 1) for f in (np.cos, np.sin)], axis=1)

        return Functions(len(values), 2 * orders, turning)
    lo, hi = float(values.min()), float(values.max())
    degree = min(most, len(np.unique(values)) - 1)

    def powers(rows: Rows) -> np.ndarray:
        return np.asarray(np.polynomial.legendre.legvander((2.0 * values[rows] - lo - hi) / (hi - lo), degree)[:, 1:])

    return Functions(len(values), degree, powers)


def column_name(name: str, machine: Machine) -> str:
    """The table's name of a channel: ``X`` → ``X_mm``."""
    axis = machine.by_name.get(name)
    return name if axis is None else f"{axis.name}_{axis.unit}"


def depends_on(candidate: Candidate) -> tuple[str, list[str]]:
    """Side and columns of a surrogate."""
    side, *columns = candidate.where.split("|")
    return side, columns
