"""What was asked for and these data do not determine, and why; what the set-up leaves open that shows in the errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.identification.determined import Determined, Wanted
from twin.identification.setup import SetUp
from twin.identification.solve import FitSolution
from twin.identification.unknowns import Unknowns
from twin.machine.effects import split_name
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.numerics.observability import UNSEEN

SAYS_LESS: Final = "these data say less of it than is plausible beforehand"


@final
@dataclass(frozen=True)
class Unidentified:
    """Something these data cannot tell.

    Attributes:
        name: ISO 230-1 name.
        reason: why, and what would change it.
    """

    name: str
    reason: str


def held_by_prior(model: Determined, solution: FitSolution) -> list[str]:
    """Names of the errors in the estimate that the readings, with their noise, determine no better than was known before."""
    unknowns = model.network.unknowns
    unseen = solution.unseen[: len(unknowns)] > UNSEEN
    return [name for name in unknowns.entities if name in model.together or unknowns.lowest_unseen(name, unseen)]


def unidentified(
    machine: Machine, data: Measurements, model: Determined, wanted: Wanted, setup: SetUp, held: Sequence[str]
) -> tuple[Unidentified, ...]:
    """What was asked for and is not determined, and why.

    Args:
        machine: the machine.
        data: the measurements.
        model: what they determine of it.
        wanted: whether an error of that name was sought.
        setup: stations and targets.
        held: names of the errors that a prior holds (`held_by_prior`).
    """
    found = []
    for name in (*machine.motion_names, *machine.squareness_names, *machine.location_names):
        axis = split_name(name)[2]
        if not wanted(name):
            continue
        if not np.ptp(data.positions[:, machine.names.index(axis)]) > 0.0:
            found.append(Unidentified(name, f"{axis} was not moved"))
        elif name in model.together or name in model.left_out:
            moving = model.seen.null_direction_of(model.seen.names[model.tried.of(name)[0]])
            why = SAYS_LESS if moving is None else f"no reading shows {moving}"
            found.append(Unidentified(name, f"{why}: {_remedy(name, machine, setup, name in model.together)}"))
        elif name in held:
            found.append(Unidentified(name, SAYS_LESS))
    return tuple(found)


def _remedy(name: str, machine: Machine, setup: SetUp, together: bool) -> str:
    _, average, axis = split_name(name)
    if together:
        return "a third target apart from one line tells them"
    if average and not machine.by_name[axis].linear and not setup.target_known.all():
        return "give the targets' places, or a reference on the machine"
    if average:
        return "the other axes' motions, which would be its reference, are not among these data"
    return "it takes three targets apart from one line, or other poses of the other axes"


def unknown_reference(solution: FitSolution, unknowns: Unknowns) -> list[str]:
    """Return a notice of the errors that refer to a point of the targets' carrier that the set-up leaves open."""
    if solution.spectrum.null_space.shape[1] == 0:
        return []
    carried = solution.spectrum.reach[: len(unknowns)]
    seen = solution.spectrum.covariance(null_space=False)
    own = np.sqrt(np.diag(seen)[: len(unknowns)])
    names = dict.fromkeys(
        column.entity for column, open_, u in zip(unknowns.columns, carried, own, strict=True) if open_ > u
    )
    if not names:
        return []
    return [
        f"{', '.join(names)} refer to a point of the targets' carrier whose distance from the machine's own origin is not known; "
        "their uncertainty allows for 0.2 m. Give the targets' places (place_x_mm …) to narrow it"
    ]
