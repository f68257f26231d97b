"""Which unknowns of the machine the data determine, for one family of bases: the largest model that is fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.identification.inputs import Placed
from twin.identification.network import Network
from twin.identification.solve import FitSolution, solve
from twin.identification.unknowns import Unknowns
from twin.machine.machine import Machine
from twin.numerics.curves import Basis, bases_for
from twin.numerics.observability import UNSEEN, Determinability

MOST: Final = 13
"""Functions of a curve at most: degree 12, six harmonics."""
TOUCHED: Final = 1e-3
"""Share of an error's plausible variance that a silent direction must carry to count."""
Wanted = Callable[[str], bool]


@final
@dataclass(frozen=True)
class Determined:
    """The unknowns that the data determine.

    Attributes:
        network: data and these unknowns.
        triangle: factor of [J | r] of the machine as drawn, of these unknowns and the set-up.
        left_out: names of the errors left out, which only stations, targets and others like them take up.
        together: names of the errors that are among the unknowns and only show together.
        seen: what the readings determine of all errors that were tried.
        tried: all of them.
    """

    network: Network
    triangle: np.ndarray
    left_out: tuple[str, ...]
    together: tuple[str, ...]
    seen: Determinability
    tried: Unknowns


def _families(machine: Machine, placed: Placed, wanted: Wanted) -> list[dict[str, Basis]]:
    """The bases worth trying: powers for travels, harmonics for full turns, either for part of a turn."""
    tried = {axis.name: bases_for(rotary=not axis.linear, endless=axis.lower is None) for axis in machine.axes}
    first = {name: bases[0] for name, bases in tried.items()}
    other = {name: bases[-1] for name, bases in tried.items()}
    moved = any(
        first[axis.name] != other[axis.name]
        and np.ptp(placed.data.positions[:, i]) > 0.0
        and any(wanted(f"E_{letter}{axis.name}") for letter in "XYZABC")
        for i, axis in enumerate(machine.axes)
    )
    return [first, other] if moved else [first]


def determined(machine: Machine, placed: Placed, wanted: Wanted, covariance: np.ndarray | None) -> list[Determined]:
    """The unknowns that the data determine of the machine as drawn, one model for each family of bases worth trying.

    Args:
        machine: the machine.
        placed: rows, instrument and set-up.
        wanted: whether an error of that name is sought.
        covariance: (n, 3, 3) of the readings, m²; that stated if None.

    Raises:
        InputError: no axis moved.
    """
    families = _families(machine, placed, wanted)
    return [_determined(machine, placed, bases, wanted, covariance) for bases in families]


def _determined(
    machine: Machine, placed: Placed, bases: dict[str, Basis], wanted: Wanted, covariance: np.ndarray | None
) -> Determined:
    """For one family of bases; what the data cannot tell goes first, so that it does not compete."""
    data, setup = placed.data, placed.setup
    every = Unknowns.largest(machine, data, bases=bases, most=MOST, wanted=wanted)
    if not every.entities:
        raise data.error("no axis moved", expected="two or more positions of an axis", row=0)

    def network(unknowns: Unknowns) -> Network:
        return Network(machine, data, placed.instrument, unknowns, covariance=covariance)

    while True:
        whole = network(every)
        drawn = solve(whole, np.zeros(len(every)), setup, np.ones(len(data)), steps=0)
        without = every.without_unseen_offset(drawn.spectrum.remaining_variance)
        if without is every:
            break
        every = without
    kept, left_out, together = _seen(every, drawn)
    columns = [every.index[column] for column in kept.columns] + list(range(len(every), drawn.triangle.shape[1]))
    seen = drawn.told(every, int(np.count_nonzero(np.isfinite(data.point_mm))))
    fitted = whole if kept is every else network(kept)
    return Determined(fitted, drawn.triangle[:, columns], tuple(left_out), tuple(together), seen, every)


def _seen(unknowns: Unknowns, solution: FitSolution) -> tuple[Unknowns, list[str], list[str]]:
    """The unknowns of the fit, the names of those left out of it, and of those in it that only show together.

    An error that only stations, targets and others like it take up is left out: nothing else then changes. Errors that take each
    other up stay in, none of them reported, since leaving one out would lay its share at the others' door.
    A curve of which only higher orders are unseen is cut there.
    """
    count = len(unknowns)
    unseen = solution.spectrum.remaining_variance[:count] > UNSEEN
    silent = solution.spectrum.null_space[:count]
    shared = silent @ silent.T
    entity = np.array([column.entity for column in unknowns.columns])
    lost = [name for name in unknowns.entities if unknowns.lowest_unseen(name, unseen)]
    rank = solution.rank_of(range(count), unknowns.datum)
    dropped: list[str] = []
    together: list[str] = []
    for name in lost:
        if name in together or name in dropped:
            continue
        group = _group(name, entity, shared)
        left = np.flatnonzero(~np.isin(entity, [*dropped, *group]))
        safe = set(group) <= set(lost) and solution.rank_of(left.tolist(), unknowns.datum) == rank
        (dropped if safe else together).extend(one for one in group if one not in dropped and one not in together)
    return unknowns.fewer(unseen, dropped, together), dropped, together


def _group(name: str, entity: np.ndarray, shared: np.ndarray) -> list[str]:
    """An error and all that the same silent directions move, directly or through others.

    Args:
        name: of the error.
        entity: (columns,) the error of each unknown.
        shared: (columns, columns) what silent directions carry of two unknowns, plausible units.
    """
    touched = np.diag(shared) > TOUCHED
    found = [name]
    for one in found:
        rows = (entity == one) & touched
        linked = np.any(np.abs(shared[rows]) > TOUCHED, axis=0) & touched
        found += [str(other) for other in dict.fromkeys(entity[linked]) if other not in found]
    return found
