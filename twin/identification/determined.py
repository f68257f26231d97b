"""The unknowns of the machine that the data determine, for one family of bases: the largest model that is fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.identification.inputs import PreparedData
from twin.identification.network import Network
from twin.identification.solve import FitSolution, solve
from twin.identification.unknowns import Unknowns
from twin.machine.machine import Machine
from twin.numerics.curves import Basis, bases_for
from twin.numerics.observability import NOT_DETERMINED, Determinability

MOST_FUNCTIONS: Final = 13
"""Largest number of functions of a curve: degree 12, or six harmonics."""
SHARED_VARIANCE: Final = 1e-3
"""Share of an error's prior variance above which a null direction affects it."""
Wanted = Callable[[str], bool]


@final
@dataclass(frozen=True)
class DeterminedModel:
    """The unknowns that the data determine.

    Attributes:
        network: data and these unknowns.
        triangle: factor of [J | r] of the nominal machine for these unknowns and the set-up.
        left_out: names of the errors left out, which only stations, targets and other errors left out can compensate.
        confounded: names of the errors among the unknowns that are confounded with each other.
        determinability: determinability of all errors that were considered.
        considered: all of these unknowns.
    """

    network: Network
    triangle: np.ndarray
    left_out: tuple[str, ...]
    confounded: tuple[str, ...]
    determinability: Determinability
    considered: Unknowns


def _families(machine: Machine, placed: PreparedData, wanted: Wanted) -> list[dict[str, Basis]]:
    """Return the bases to be compared: powers for travels, harmonics for full turns, either of them for part of a turn."""
    candidates = {axis.name: bases_for(rotary=not axis.linear, endless=axis.lower is None) for axis in machine.axes}
    first = {name: bases[0] for name, bases in candidates.items()}
    other = {name: bases[-1] for name, bases in candidates.items()}
    moved = any(
        first[axis.name] != other[axis.name]
        and np.ptp(placed.data.positions[:, i]) > 0.0
        and any(wanted(f"E_{letter}{axis.name}") for letter in "XYZABC")
        for i, axis in enumerate(machine.axes)
    )
    return [first, other] if moved else [first]


def determined_models(
    machine: Machine, placed: PreparedData, wanted: Wanted, covariance: np.ndarray | None
) -> list[DeterminedModel]:
    """Return the unknowns that the data determine at the nominal machine, one model for each family of bases.

    Args:
        machine: the machine.
        placed: rows, instrument and set-up.
        wanted: whether an error of that name is to be estimated.
        covariance: (n, 3, 3) of the readings, m²; the stated one if None.

    Raises:
        InputError: no axis moved.
    """
    families = _families(machine, placed, wanted)
    return [_determined_model(machine, placed, bases, wanted, covariance) for bases in families]


def _determined_model(
    machine: Machine, placed: PreparedData, bases: dict[str, Basis], wanted: Wanted, covariance: np.ndarray | None
) -> DeterminedModel:
    """Return the model of one family of bases, without the unknowns that the data do not determine."""
    data, setup = placed.data, placed.setup
    largest_unknowns = Unknowns.largest(machine, data, bases=bases, most=MOST_FUNCTIONS, wanted=wanted)
    if not largest_unknowns.entities:
        raise data.error("no axis moved", expected="two or more positions of an axis", row=0)

    def network(unknowns: Unknowns) -> Network:
        return Network(machine, data, placed.instruments, unknowns, covariance=covariance)

    while True:
        largest_network = network(largest_unknowns)
        nominal = solve(largest_network, np.zeros(len(largest_unknowns)), setup, np.ones(len(data)), steps=0)
        without = largest_unknowns.without_unseen_offset(nominal.spectrum.remaining_variance)
        if without is largest_unknowns:
            break
        largest_unknowns = without
    kept, left_out, confounded = _partition(largest_unknowns, nominal)
    columns = [largest_unknowns.index[column] for column in kept.columns] + list(
        range(len(largest_unknowns), nominal.triangle.shape[1])
    )
    determinability = nominal.determinability(largest_unknowns, int(np.count_nonzero(np.isfinite(data.point_mm))))
    fitted = largest_network if kept is largest_unknowns else network(kept)
    return DeterminedModel(
        fitted, nominal.triangle[:, columns], tuple(left_out), tuple(confounded), determinability, largest_unknowns
    )


def _partition(unknowns: Unknowns, solution: FitSolution) -> tuple[Unknowns, list[str], list[str]]:
    """Return the unknowns of the fit, the names of the errors left out, and of those in it that are confounded.

    An error that only stations, targets and other such errors can compensate is left out: nothing else changes then. Errors that are
    confounded with each other stay in the fit but none is reported, since leaving one out would attribute its share to the others.
    A curve of which only higher orders are undetermined is cut below them.
    """
    count = len(unknowns)
    unseen = solution.spectrum.remaining_variance[:count] > NOT_DETERMINED
    silent = solution.spectrum.null_space[:count]
    shared = silent @ silent.T
    entity = np.array([column.entity for column in unknowns.columns])
    undetermined = [name for name in unknowns.entities if unknowns.lowest_unseen(name, unseen)]
    rank = solution.rank_of(range(count), unknowns.datum)
    dropped: list[str] = []
    confounded: list[str] = []
    for name in undetermined:
        if name in confounded or name in dropped:
            continue
        group = _group(name, entity, shared)
        remaining = np.flatnonzero(~np.isin(entity, [*dropped, *group]))
        safe = set(group) <= set(undetermined) and solution.rank_of(remaining.tolist(), unknowns.datum) == rank
        (dropped if safe else confounded).extend(one for one in group if one not in dropped and one not in confounded)
    return unknowns.restricted(unseen, dropped, confounded), dropped, confounded


def _group(name: str, entity: np.ndarray, shared: np.ndarray) -> list[str]:
    """Return an error and all errors that share null directions with it, directly or through others.

    Args:
        name: name of the error.
        entity: (columns,) the error of each unknown.
        shared: (columns, columns) inner products of the null directions' rows, in prior standard deviations.
    """
    touched = np.diag(shared) > SHARED_VARIANCE
    found = [name]
    for one in found:
        rows = (entity == one) & touched
        linked = np.any(np.abs(shared[rows]) > SHARED_VARIANCE, axis=0) & touched
        found += [str(other) for other in dict.fromkeys(entity[linked]) if other not in found]
    return found
