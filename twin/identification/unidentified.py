"""Errors that the data do not determine, with the reason, and errors that depend on an undetermined part of the set-up."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, final

import numpy as np

from twin.identification.determined import DeterminedModel, Wanted
from twin.identification.setup import SetUp
from twin.identification.solve import FitSolution
from twin.identification.unknowns import Unknowns
from twin.machine.effects import split_name
from twin.machine.machine import Machine
from twin.machine.unknown_errors import NO_REFERENCE, at_rest
from twin.measurement.instruments.base import SetUpWords
from twin.measurement.table import Measurements
from twin.numerics.observability import NOT_DETERMINED, NullDirection

SAYS_LESS: Final = "these data determine it no better than its prior"

TOO_FEW: Final = "{axis} has too few different positions for a straightness curve; measure at five or more"


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


class _Part(NamedTuple):
    """A station or target: its name in words, what to enter so that its place is known, and the words of its instrument."""

    words: str
    enter: str
    instrument: SetUpWords


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
    found, parts = [], _parts(setup, data)
    for name in (*machine.motion_names, *machine.squareness_names, *machine.location_names):
        axis = split_name(name)[2]
        if not wanted(name):
            continue
        if not np.ptp(data.positions[:, machine.names.index(axis)]) > 0.0:
            found.append(Unidentified(name, at_rest(axis)))
        elif name in machine.motion_names and name not in model.considered.entities:
            found.append(Unidentified(name, TOO_FEW.format(axis=axis)))
        elif name in model.confounded or name in model.left_out:
            direction = model.determinability.null_direction_of(
                model.determinability.names[model.considered.of(name)[0]]
            )
            why = SAYS_LESS if direction is None else _confounded_with(name, direction, parts)
            remedy = _remedy(name, machine, setup, parts, direction, name in model.confounded)
            found.append(Unidentified(name, f"{why}; {remedy}", str(direction or "")))
        elif name in held:
            found.append(Unidentified(name, SAYS_LESS))
    return tuple(found)


def _parts(setup: SetUp, data: Measurements) -> dict[str, _Part]:
    """Return the stations and targets of a set-up, by their names among the unknowns."""
    reads = dict(zip(setup.stations, setup.reads, strict=True))
    reader = dict(zip(data.target[::-1].tolist(), data.station[::-1].tolist(), strict=True))
    stations = [
        _Part(f"{one.set_up.station} {name}", one.set_up.station_place, one.set_up) for name, one in reads.items()
    ]
    by_target = [reads[reader[name]] for name in setup.targets]
    targets = [
        _Part(f"{one.set_up.target} {name}", one.set_up.target_place, one.set_up)
        for name, one in zip(setup.targets, by_target, strict=True)
    ]
    names = [*(f"station {name}" for name in setup.stations), *(f"target {name}" for name in setup.targets)]
    return dict(zip(names, (*stations, *targets), strict=True))


def _moved(name: str, direction: NullDirection) -> list[str]:
    """Return the other errors, stations and targets that move along a null direction."""
    others = [move.name for move in direction.moves if move.name.split(" ")[0] != name]
    # The axis at the end of "station 1 x" and "target K rotation z" does not matter here.
    parts = [
        re.sub(r" (?:(?:turn|rotation) )?[xyz]$", "", one)
        if one.startswith(("station ", "target "))
        else one.split(" ")[0]
        for one in others
    ]
    return list(dict.fromkeys(parts))


def _confounded_with(name: str, direction: NullDirection, parts: Mapping[str, _Part]) -> str:
    """Say with which errors, stations and targets an error is confounded."""
    moved = _moved(name, direction)
    if not moved:
        return "it changes no reading"
    more = f" and {direction.left_out} more" if direction.left_out else ""
    return f"cannot be separated from {', '.join(parts[one].words if one in parts else one for one in moved)}{more}"


def _remedy(
    name: str,
    machine: Machine,
    setup: SetUp,
    parts: Mapping[str, _Part],
    direction: NullDirection | None,
    confounded: bool,
) -> str:
    """Say what to enter or to measure so that an error is determined."""
    _, average, axis = split_name(name)
    words = list(dict.fromkeys(part.instrument for part in parts.values()))
    # Both sides of such an instrument ride on the machine: it has no reference outside.
    relative = all(one.station_place for one in words)
    if confounded and relative:
        return "measure at more positions of all axes, or identify squareness and locations only"
    if confounded and average:
        return "measure a reference on the machine"
    if confounded and len(setup.targets) > 2:
        places = " and ".join(dict.fromkeys(one.target_place for one in words))
        return f"enter {places}, or measure with another instrument too"
    if confounded:
        return "measure a third target that is not on a line with the others"
    if average and not machine.by_name[axis].linear and not setup.target_known.all():
        return _location_remedy(name, parts, words, direction)
    if average:
        return NO_REFERENCE
    if relative:
        return "measure at other positions of the other axes"
    return "measure three targets that are not on a line, or other positions of the other axes"


def _location_remedy(
    name: str, parts: Mapping[str, _Part], words: Sequence[SetUpWords], direction: NullDirection | None
) -> str:
    """Say which places of the set-up determine the location of a rotary axis: any of those with which it is confounded.

    A second probe of another length, its offset unknown too, adds as many unknowns as it determines.
    """
    moved = [parts[one] for one in _moved(name, direction) if one in parts] if direction is not None else []
    places = list(dict.fromkeys(part.enter for part in moved if part.enter)) or [one.target_place for one in words]
    return ", or ".join([f"enter {places[0]}", *places[1:], "measure a reference on the machine"])


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
    places = " and ".join(dict.fromkeys(one.set_up.target_place for one in solution.setup.reads))
    return [
        f"{', '.join(names)} refer to a point of the targets' carrier whose distance from the machine's own origin is not known; "
        f"their uncertainty includes 0.2 m for it. Enter {places} to reduce it"
    ]
