"""What no name is given to: smooth functions of each column and of pairs of columns, on each side, in each direction.

They compete with the named causes. A pattern that one of them carries better, after its higher price, than all named causes together
is left unexplained, with the columns it depends on.
"""

from __future__ import annotations

from itertools import combinations
from typing import Final

import numpy as np

from twin.diagnosis.catalogue import Candidate, Cell
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
    single = {name: _functions(name, state[name], machine, ALONE) for name in names}
    low = {name: _functions(name, state[name], machine, PAIRED) for name in names}
    found: list[Candidate] = []
    for side in CARRIERS:
        mask = (data.carrier == side).astype(float)
        if not mask.any():
            continue
        for name in names:
            found += _candidates((name,), single[name], side, mask, machine)
        for a, b in combinations(names, 2):
            products = np.stack([x * y for x in low[a].T for y in low[b].T], axis=1)
            found += _candidates((a, b), products, side, mask, machine)
    return found


def whatever(candidate: Candidate, machine: Machine, data: Measurements) -> list[Column]:
    """Any smooth function of an unnamed pattern's columns, on its side, in all directions: what a pattern is if one knows no better."""
    side, *columns = candidate.where.split("|")
    state = _with_rounds(machine, data)
    mask = (data.carrier == side).astype(float)
    named = {column_name(name, machine): name for name in state}
    functions = np.ones((len(mask), 1))
    for column in columns:
        own = _functions(named[column], state[named[column]], machine, ANY)
        own = np.concatenate([np.ones((len(mask), 1)), own], axis=1)
        functions = (functions[:, :, None] * own[:, None, :]).reshape(len(mask), -1)
    return [of_base(i, functions[:, k] * mask) for i in range(3) for k in range(functions.shape[1])]


def _with_rounds(machine: Machine, data: Measurements) -> dict[str, np.ndarray]:
    """What patterns may depend on."""
    state = dict(state_of(data, machine))
    if len(set(data.round)) > 2:
        rounds = list(dict.fromkeys(data.round))
        state["round"] = np.array([float(rounds.index(name)) for name in data.round])
    return state


def _candidates(
    names: tuple[str, ...], functions: np.ndarray, side: str, mask: np.ndarray, machine: Machine
) -> list[Candidate]:
    where = f"{side}|{'|'.join(column_name(name, machine) for name in names)}"
    directions = [tuple(of_base(i, functions[:, k] * mask) for k in range(functions.shape[1])) for i in range(3)]
    cells = [Cell(columns) for columns in directions]
    if len(names) > 1:
        # Of one column alone, most of it has a name: positioning, straightness, squareness.
        cells.append(Cell(tuple(column for columns in directions for column in columns)))
    return [Candidate(EFFECT, where, "unknown", (), tuple(cells), float(len(cells)))]


def _functions(name: str, values: np.ndarray, machine: Machine, most: int) -> np.ndarray:
    """(n, k) a few smooth functions of a column, no constant."""
    axis = machine.by_name.get(name)
    if axis is not None and not axis.linear:
        angle = np.radians(values)
        return np.stack([f(k * angle) for k in range(1, most // 2 + 1) for f in (np.cos, np.sin)], axis=1)
    lo, hi = float(values.min()), float(values.max())
    u = (2.0 * values - lo - hi) / (hi - lo)
    distinct = len(np.unique(values))
    return np.polynomial.legendre.legvander(u, min(most, distinct - 1))[:, 1:]


def column_name(name: str, machine: Machine) -> str:
    """The table's name of a channel: ``X`` → ``X_mm``."""
    axis = machine.by_name.get(name)
    return name if axis is None else f"{axis.name}_{axis.unit}"


def depends_on(candidate: Candidate) -> tuple[str, list[str]]:
    """Side and columns of a surrogate."""
    side, *columns = candidate.where.split("|")
    return side, columns
