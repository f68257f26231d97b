"""Errors that the data do not determine, with the reason, and errors that depend on an undetermined part of the set-up."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.identification.determined import DeterminedModel, Wanted
from twin.identification.setup import SetUp
from twin.identification.solve import FitSolution
from twin.identification.unknowns import Unknowns
from twin.machine.effects import split_name
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.numerics.observability import NOT_DETERMINED, NullDirection

SAYS_LESS: Final = "these data determine it no better than its prior"


@final
@dataclass(frozen=True)
class Unidentified:
    """An error that these data do not determine.

    Attributes:
        name: ISO 230-1 name.
        reason: why, and which measurement would change it.
        direction: the null direction: changes of this error and of others that together change no reading; empty if there is none.
    """

    name: str
    reason: str
    direction: str = ""


def held_by_prior(model: DeterminedModel, solution: FitSolution) -> list[str]:
    """Return the names of the errors in the estimate that the readings, with their noise, determine no better than the prior."""
    unknowns = model.network.unknowns
    unseen = solution.unseen[: len(unknowns)] > NOT_DETERMINED
    return [name for name in unknowns.entities if name in model.confounded or unknowns.lowest_unseen(name, unseen)]


def unidentified(
    machine: Machine, data: Measurements, model: DeterminedModel, wanted: Wanted, setup: SetUp, held: Sequence[str]
) -> tuple[Unidentified, ...]:
    """Return the errors to be estimated that are not determined, and why.

    Args:
        machine: the machine.
        data: the measurements.
        model: the unknowns that they determine.
        wanted: whether an error of that name is to be estimated.
        setup: stations and targets.
        held: names of the errors held by a prior (`held_by_prior`).
    """
    found = []
    for name in (*machine.motion_names, *machine.squareness_names, *machine.location_names):
        axis = split_name(name)[2]
        if not wanted(name):
            continue
        if not np.ptp(data.positions[:, machine.names.index(axis)]) > 0.0:
            found.append(Unidentified(name, f"{axis} did not move"))
        elif name in model.confounded or name in model.left_out:
            direction = model.determinability.null_direction_of(
                model.determinability.names[model.considered.of(name)[0]]
            )
            why = SAYS_LESS if direction is None else _confounded_with(name, direction)
            remedy = _remedy(name, machine, setup, name in model.confounded)
            found.append(Unidentified(name, f"{why}; {remedy}", str(direction or "")))
        elif name in held:
            found.append(Unidentified(name, SAYS_LESS))
    return tuple(found)


def _confounded_with(name: str, direction: NullDirection) -> str:
    """Say with which errors, stations and targets an error is confounded."""
    others = [move.name for move in direction.moves if move.name.split(" ")[0] != name]
    # The axis at the end of "station 1 x" and "target K rotation z" does not matter here.
    parts = [
        re.sub(r" (?:(?:turn|rotation) )?[xyz]$", "", one)
        if one.startswith(("station ", "target "))
        else one.split(" ")[0]
        for one in others
    ]
    if not parts:
        return "it changes no reading"
    more = f" and {direction.left_out} more" if direction.left_out else ""
    return f"cannot be separated from {', '.join(dict.fromkeys(parts))}{more}"


def _remedy(name: str, machine: Machine, setup: SetUp, confounded: bool) -> str:
    _, average, axis = split_name(name)
    if confounded and average:
        return "measure a reference on the machine"
    if confounded and len(setup.targets) > 2:
        return "enter the targets' places (place_x_mm …), or measure with another instrument too"
    if confounded:
        return "measure a third target that is not on a line with the others"
    if average and not machine.by_name[axis].linear and not setup.target_known.all():
        return "enter the targets' places (place_x_mm …) or measure a reference on the machine"
    if average:
        return "the motions of the other axes, its reference, are not in these data"
    return "measure three targets that are not on a line, or other positions of the other axes"


def unknown_reference(solution: FitSolution, unknowns: Unknowns) -> list[str]:
    """Return a notice of the errors that refer to a point of the targets' carrier which the set-up does not determine."""
    if solution.spectrum.null_space.shape[1] == 0:
        return []
    carried = solution.spectrum.reach[: len(unknowns)]
    seen = solution.spectrum.covariance(null_space=False)
    own = np.sqrt(np.diag(seen)[: len(unknowns)])
    names = dict.fromkeys(
        column.entity
        for column, undetermined_part, u in zip(unknowns.columns, carried, own, strict=True)
        if undetermined_part > u
    )
    if not names:
        return []
    return [
        f"{', '.join(names)} refer to a point of the targets' carrier whose distance from the machine's own origin is not known; "
        "their uncertainty includes 0.2 m for it. Give the targets' places (place_x_mm …) to reduce it"
    ]
