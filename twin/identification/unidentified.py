"""Errors that the data do not determine, with the reason, and what a measurement will determine before it is made.

Which constant errors of a machine a measurement determines: scales, squareness and locations, before or after it is made.

The set-up (tips, spheres, stations) is unknown too. A combination of constant errors that only the set-up can compensate is lost,
whatever the number of readings: one sphere at an unknown place does not show the common scale of X, Y and Z, for example.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, final

import numpy as np

from twin._common.messages import Message, joined
from twin._common.units import count_with_noun
from twin.display.numbers import either, listed
from twin.identification.inputs import PreparedData
from twin.identification.network import Network, Unknowns
from twin.identification.solve import FitSolution, solve
from twin.machine.machine import Machine
from twin.measurement.instruments import StationInstruments
from twin.measurement.instruments.base import SetUpWords
from twin.measurement.set_up import StationsAndTargets
from twin.measurement.table import Measurements
from twin.model.effects import split_name
from twin.model.unknown_errors import NO_REFERENCE, at_rest
from twin.numerics.curves import POWER, Basis, CurveSpace, bases_for
from twin.numerics.observability import NOT_DETERMINED, SINGULAR_VALUE_TOLERANCE, Determinability, NullDirection

MOST_FUNCTIONS: Final = 13
"""Largest number of functions of a curve: degree 12, or six harmonics."""
FEWER_FUNCTIONS: Final = (9, 6, 4)  # tried if curves are not determined from readings of several instruments
SHARED_VARIANCE: Final = 1e-3
"""Share of an error's prior variance above which a null direction affects it."""
Wanted = Callable[[str], bool]


@final
@dataclass(frozen=True)
class DeterminedModel:
    """The unknowns that the data determine.

    Attributes:
        triangle: factor of [J | r] of the nominal machine for these unknowns and the set-up.
        left_out: names of the errors left out, which only stations, targets and other errors left out can compensate.
        confounded: names of the errors among the unknowns that are confounded with each other.
        determinability: determinability of all errors that were considered.
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

    The positions in readings of one instrument do not bring functions to a curve that only those of another determine: if curves of
    several instruments together are not determined, models with fewer functions are candidates as well.

    ``wanted``: whether an error of that name is to be estimated; ``covariance``: (n, 3, 3) of the readings, m²; the stated one if None.

    Raises `InputError`: no axis moved.
    """
    families = _families(machine, placed, wanted)

    def models(most: int) -> tuple[list[DeterminedModel], int]:
        made = [_determined_model(machine, placed, bases, wanted, covariance, most) for bases in families]
        motions = set(machine.motion_names)
        return made, min(len(motions.intersection((*model.left_out, *model.confounded))) for model in made)

    best, lost = models(MOST_FUNCTIONS)
    several = len(list(placed.instruments.groups(placed.data.station))) > 1
    for most in FEWER_FUNCTIONS if several else ():
        if not lost:
            break
        fewer, lost_by_fewer = models(most)
        if lost_by_fewer < lost:
            best, lost = [*fewer, *best], lost_by_fewer
    return best


def _determined_model(
    machine: Machine,
    placed: PreparedData,
    bases: dict[str, Basis],
    wanted: Wanted,
    covariance: np.ndarray | None,
    most: int,
) -> DeterminedModel:
    """Return the model of one family of bases, without the unknowns that the data do not determine."""
    data, setup = placed.data, placed.setup
    largest_unknowns = Unknowns.largest(machine, data, bases=bases, most=most, wanted=wanted)
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

    ``entity``: (columns,) the error of each unknown; ``shared``: (columns, columns) inner products of the null directions' rows, in
    prior standard deviations.
    """
    touched = np.diag(shared) > SHARED_VARIANCE
    group = [name]
    for one in group:
        rows = (entity == one) & touched
        linked = np.any(np.abs(shared[rows]) > SHARED_VARIANCE, axis=0) & touched
        group += [str(other) for other in dict.fromkeys(entity[linked]) if other not in group]
    return group


# --- Which constant errors of a machine a measurement determines: scales, squareness and locations, before or after it is mad

LOST_ALONE: Final = 0.98
"""Share of a constant error within the lost combinations above which it is lost itself."""
NEGLIGIBLE: Final = 0.02
"""Share below which a combination does not contain a constant error."""
EQUAL: Final = 0.05
"""Relative difference of slopes that count as a common scale."""


@final
@dataclass(frozen=True)
class ConstantErrors:
    """The constant errors of a machine's moved axes, and what a measurement tells about them.

    ``u``: standard uncertainty of each by name, µm/m of a scale, µm or µrad of the others; NaN where it is not determined;
    ``determined``: number of independent combinations that are determined.
    """

    u: Mapping[str, float]
    determined: int
    lost: tuple[str, ...]

    @property
    def text(self) -> str:
        """The result in one sentence."""
        known = f"{self.determined} of {count_with_noun(len(self.u), 'constant error')} (scales, squareness, locations) determined"
        return f"{known}; not: {'; '.join(self.lost)}" if self.lost else known


def constant_errors(
    machine: Machine,
    data: Measurements,
    instruments: StationInstruments,
    setup: StationsAndTargets,
    covariance: np.ndarray | None = None,
) -> ConstantErrors | None:
    """Return what a measurement determines of the constant errors of the axes that it moves, linearised at the nominal machine.

    ``data``: the positions, targets and stations, and which coordinates are read; ``setup``: stations and targets; those that are known
    are not among the unknowns; ``covariance``: (n, 3, 3) of the readings, m²; that of the table and the instruments if None.

    Returns:
        The constant errors; None if no axis with any moves.
    """
    found = constant_rows(machine, data, instruments, setup, covariance)
    if found is None:
        return None
    unknowns, rows = found
    scales, constants = unknowns.curves, list(unknowns.constants)
    size, directions = without_setup(rows, len(unknowns))
    seen = size > 1.0
    variance = np.sum((directions[seen] / size[seen, None]) ** 2, axis=0)
    lost = directions[~seen]
    within = np.sum(lost**2, axis=0)
    per_unit = np.array([scale_unit(curve) for curve in scales] + [1.0] * len(constants))
    labels = [f"E_{curve.name[2:]}" for curve in scales] + constants
    u = np.where(within < NEGLIGIBLE, np.sqrt(variance) * unknowns.plausible * per_unit, np.nan)
    slopes = unknowns.plausible[: len(scales)] * per_unit[: len(scales)]
    return ConstantErrors(
        dict(zip(labels, (float(v) for v in u), strict=True)), int(np.sum(seen)), _lost(labels, lost, within, slopes)
    )


def without_setup(rows: np.ndarray, machine: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the strengths (machine,) and directions (machine, machine) of the machine's unknowns, the set-up eliminated.

    ``rows``: (n, 3, machine + set-up) whitened derivatives per plausible size.
    """
    flat, setup = rows.reshape(-1, rows.shape[-1]), rows.shape[-1] - machine
    # The prior of the set-up is so wide that it only regularises what the readings do not determine.
    whole = np.concatenate([np.roll(flat, setup, axis=1), np.eye(setup, rows.shape[-1])])
    triangle = np.asarray(np.linalg.qr(whole, mode="r"))[setup:, setup:]
    _, size, directions = np.linalg.svd(triangle)
    # Fewer readings than unknowns leave directions without any strength.
    return np.append(size, np.zeros(machine - len(size))), directions


def constant_rows(
    machine: Machine,
    data: Measurements,
    instruments: StationInstruments,
    setup: StationsAndTargets,
    covariance: np.ndarray | None = None,
) -> tuple[Unknowns, np.ndarray] | None:
    """Return the constant errors of the moved axes, and the derivatives of each reading; arguments as of `constant_errors`.

    Returns:
        The unknowns of the machine, and (n, 3, unknowns + set-up) whitened derivatives per plausible size; None if no axis with any
        moves.
    """
    unknowns = constant_unknowns(machine, data.moved(machine))
    if not len(unknowns):
        return None
    network = Network(machine, data, instruments, unknowns, covariance=covariance)
    rows = [chunk.jacobian for chunk in network.chunks(np.zeros(len(unknowns)), setup)]
    certified = network.certified(setup)[:, :-1]
    if len(certified):
        blank = np.zeros((-len(certified) % 3, certified.shape[1]))
        rows.append(np.concatenate([certified, blank]).reshape(-1, 3, certified.shape[1]))
    return unknowns, np.concatenate(rows) * np.concatenate([unknowns.plausible, setup.plausible])


def constant_unknowns(machine: Machine, axes: Collection[str]) -> Unknowns:
    """Return the constant errors of some axes, by name, as unknowns: scales, then squareness and locations."""
    scales = [
        CurveSpace(f"E_{'XYZ'[int(np.argmax(np.abs(axis.machine_direction)))]}{axis.name}", POWER, axis.domain, 1, 2)
        for axis in machine.axes
        if axis.linear and axis.name in axes
    ]
    constants = [name for name in (*machine.squareness_names, *machine.location_names) if name[4:] in axes]
    return Unknowns(machine, scales, constants)


def scale_unit(curve: CurveSpace) -> float:
    """Return the scale error, µm/m, of one µm RMS of the linear term of a positioning error."""
    lo, hi = curve.domain
    return float(np.diff(curve.functions(np.array([lo, hi]))[:, 1])[0]) / (hi - lo) * 1e3


def _lost(names: list[str], lost: np.ndarray, within: np.ndarray, slopes: np.ndarray) -> tuple[str, ...]:
    """Return the lost combinations in words, from an orthonormal basis (k, p) of them in plausible units."""
    alone = [i for i in range(len(names)) if within[i] > LOST_ALONE]
    found = [names[i] for i in alone]
    rest = np.delete(lost, alone, axis=1)
    others = [name for i, name in enumerate(names) if i not in alone]
    count = len(lost) - len(alone)
    if count <= 0:
        return tuple(found)
    _, _, basis = np.linalg.svd(rest, full_matrices=False)
    shares = np.sum(basis[:count] ** 2, axis=0)
    included = [i for i, share in enumerate(shares) if share > NEGLIGIBLE]
    scales = [names.index(others[i]) for i in included]
    if count == 1 and len(scales) > 1 and max(scales) < len(slopes):
        value = basis[0][np.array(included)] * slopes[np.array(scales)]
        if np.ptp(value) < EQUAL * np.abs(value).max():
            return (Message("the common scale of {names}", names=listed([names[i][-1] for i in scales])), *found)
    combined = ", ".join(others[i] for i in included)
    if count == 1:
        return (Message("1 combination of {names}", names=combined), *found)
    return (Message("{count} combinations of {names}", count=count, names=combined), *found)


# --- Errors that the data do not determine, with the reason, and errors that depend on an undetermined part of the set-up

MORE_POSITIONS: Final = Message("measure at five or more positions of the axis for a straightness curve")
SAYS_LESS: Final = Message("these data determine it no better than its prior")


@final
@dataclass(frozen=True)
class Unidentified:
    """An error that these data do not determine.

    ``name``: ISO 230-1 name; ``remedy``: what to enter or to measure, empty if it is part of ``why``; ``direction``: the null
    direction: changes of this error and of others that together change no reading; empty if there is none.
    """

    name: str
    why: str
    remedy: str = ""
    direction: str = ""

    @property
    def reason(self) -> str:
        """Reason and remedy."""
        return joined("; ", [self.why, self.remedy]) if self.remedy else self.why


class _Part(NamedTuple):
    """A station or target: its name in words, what to enter so that its place is known, and the words of its instrument."""

    words: str
    enter: str
    instrument: SetUpWords


def held_by_prior(model: DeterminedModel, solution: FitSolution, u: np.ndarray) -> list[str]:
    """Return the names of the errors in the estimate that the readings, with their noise, determine no better than the prior.

    Curves that are confounded with each other share what the readings say by their priors alone. A squareness or a location that is
    confounded with such curves, and with no other constant, is determined if its uncertainty, in which these curves have the sizes that
    the readings give to all, is well below its prior.

    ``u``: (columns,) standard uncertainties of the machine's unknowns, µm and µrad.
    """
    unknowns = model.network.unknowns
    unseen = solution.unseen[: len(unknowns)] > NOT_DETERMINED
    determined = _determined_without_curves(model.network, solution.setup) if model.confounded else set()
    share = u**2 / unknowns.plausible**2
    determined = {name for name in determined if share[unknowns.of(name)[0]] <= NOT_DETERMINED}
    return [
        name
        for name in unknowns.entities
        if unknowns.lowest_unseen(name, unseen) or (name in model.confounded and name not in determined)
    ]


def _determined_without_curves(network: Network, setup: StationsAndTargets) -> set[str]:
    """Return the squareness and locations of a network that its readings determine, each alone, if all curves are straight lines."""
    found = constant_rows(network.machine, network.data, network.instruments, setup, network.covariance)
    if found is None:
        return set()
    unknowns, rows = found
    strength, directions = without_setup(rows, len(unknowns))
    lost = np.sum(directions[strength <= SINGULAR_VALUE_TOLERANCE] ** 2, axis=0)
    return {
        name
        for name in network.unknowns.constants
        if name in unknowns.constants and lost[unknowns.of(name)[0]] <= SHARED_VARIANCE
    }


def unidentified(
    machine: Machine,
    data: Measurements,
    model: DeterminedModel,
    wanted: Wanted,
    setup: StationsAndTargets,
    held: Sequence[str],
) -> tuple[Unidentified, ...]:
    """Return the errors to be estimated that are not determined, and why.

    ``wanted``: whether an error of that name is to be estimated; ``held``: names of the errors held by a prior (`held_by_prior`).
    """
    unidentified, parts = [], _parts(setup, data)
    for name in (*machine.motion_names, *machine.squareness_names, *machine.location_names):
        axis = split_name(name)[2]
        if not wanted(name):
            continue
        if not np.ptp(data.positions[:, machine.names.index(axis)]) > 0.0:
            unidentified.append(Unidentified(name, at_rest(axis)))
        elif name in machine.motion_names and name not in model.considered.entities:
            unidentified.append(
                Unidentified(name, Message("{axis} has too few different positions", axis=axis), MORE_POSITIONS)
            )
        elif name in model.left_out or (name in model.confounded and name in held):
            direction = model.determinability.null_direction_of(
                model.determinability.names[model.considered.of(name)[0]]
            )
            unidentified.append(_inseparable(name, machine, setup, parts, direction, name in model.confounded))
        elif name in held:
            unidentified.append(Unidentified(name, SAYS_LESS))
    return tuple(unidentified)


def inseparable(
    name: str, machine: Machine, data: Measurements, setup: StationsAndTargets, direction: NullDirection | None
) -> Unidentified:
    """Return why an error is not determined, from which others it cannot be separated, and what to do; ``direction``: with them."""
    return _inseparable(name, machine, setup, _parts(setup, data), direction, confounded=False)


def _inseparable(
    name: str,
    machine: Machine,
    setup: StationsAndTargets,
    parts: Mapping[str, _Part],
    direction: NullDirection | None,
    confounded: bool,
) -> Unidentified:
    why = SAYS_LESS if direction is None else _confounded_with(name, direction, parts)
    return Unidentified(name, why, _remedy(name, machine, setup, parts, direction, confounded), str(direction or ""))


def _parts(setup: StationsAndTargets, data: Measurements) -> dict[str, _Part]:
    """Return the stations and targets of a set-up, by their names among the unknowns."""
    reads = dict(zip(setup.stations, setup.reads, strict=True))
    reader = dict(zip(data.target[::-1].tolist(), data.station[::-1].tolist(), strict=True))
    stations = [
        _Part(Message(f"{one.set_up.station} {{name}}", name=name), one.set_up.station_place, one.set_up)
        for name, one in reads.items()
    ]
    by_target = [reads[reader[name]] for name in setup.targets]
    targets = [
        _Part(Message(f"{one.set_up.target} {{name}}", name=name), one.set_up.target_place, one.set_up)
        for name, one in zip(setup.targets, by_target, strict=True)
    ]
    names = [*(f"station {name}" for name in setup.stations), *(f"target {name}" for name in setup.targets)]
    return dict(zip(names, (*stations, *targets), strict=True))


def _moved(name: str, direction: NullDirection) -> list[str]:
    """Return the other errors, stations and targets that move along a null direction."""
    others = [move.name for move in direction.moves if move.name.split(" ")[0] != name]
    # The axis at the end of "station 1 x" and "target K rotation z" does not matter here.
    parts = [
        re.sub(r" (?:(?:turn|rotation) )?[xyz]$", "", other)
        if other.startswith(("station ", "target "))
        else other.split(" ")[0]
        for other in others
    ]
    return list(dict.fromkeys(parts))


def _confounded_with(name: str, direction: NullDirection, parts: Mapping[str, _Part]) -> str:
    """Say with which errors, stations and targets an error is confounded."""
    moved = _moved(name, direction)
    if not moved:
        return Message("it changes no reading")
    names = joined(", ", [parts[one].words if one in parts else one for one in moved])
    if direction.left_out:
        names = Message("{names} and {count} more", names=names, count=str(direction.left_out))
    return Message("cannot be separated from {names}", names=names)


def _remedy(
    name: str,
    machine: Machine,
    setup: StationsAndTargets,
    parts: Mapping[str, _Part],
    direction: NullDirection | None,
    confounded: bool,
) -> str:
    """Say what to enter or to measure so that an error is determined."""
    _, average, axis = split_name(name)
    words = list(dict.fromkeys(part.instrument for part in parts.values()))
    # Both sides of such an instrument ride on the machine: it has no reference outside.
    relative = all(word.station_place for word in words)
    if confounded and relative:
        return Message("measure at more positions of all axes, or identify squareness and locations only")
    if confounded and average:
        return _reference(axis, machine)
    if confounded and len(setup.targets) > 2:
        places = listed([Message(place) for place in dict.fromkeys(word.target_place for word in words)])
        return Message("enter {places}, or measure with another instrument too", places=places)
    if confounded:
        return Message("measure a third target that is not on a line with the others")
    if average and not machine.by_name[axis].linear and not setup.target_known.all():
        return _location_remedy(name, machine, parts, words, direction)
    if average:
        return NO_REFERENCE
    if relative:
        return Message("measure at other positions of the other axes")
    return Message("measure three targets that are not on a line, or other positions of the other axes")


def _location_remedy(
    name: str,
    machine: Machine,
    parts: Mapping[str, _Part],
    words: Sequence[SetUpWords],
    direction: NullDirection | None,
) -> str:
    """Say which places of the set-up determine the location of a rotary axis: any of those with which it is confounded.

    A second probe of another length, its offset unknown too, adds as many unknowns as it determines.
    """
    moved = [parts[one] for one in _moved(name, direction) if one in parts] if direction is not None else []
    places = list(dict.fromkeys(part.enter for part in moved if part.enter)) or [word.target_place for word in words]
    enter = Message("enter {places}", places=either([Message(place) for place in places]))
    return Message("{enter}, or {probe}", enter=enter, probe=_reference(split_name(name)[2], machine))


def _reference(axis: str, machine: Machine) -> str:
    """Say what to probe in a shop, and where, so that the average line of an axis is determined.

    The tip must be known, because a shift of the tip looks like a shift of the axis.
    """
    one = machine.by_name[axis]
    if one.linear:
        return Message("probe a granite square or a sphere plate on the table, and identify both tables together")
    others = any(not other.linear and other.name != axis for other in machine.axes)
    also = Message(", and again with the other rotary axis turned") if others else ""
    return Message(
        "probe a sphere on the table, at least 100 mm from the rotary axis (or a bore there, for two directions), at four positions of "
        "that axis 90° apart or over its whole range{also}, with a probe whose length and run-out are calibrated (station_x_mm …), and "
        "identify both tables together: `twin plan --instrument probe` plans it",
        also=also,
    )


def unknown_reference(solution: FitSolution, unknowns: Unknowns) -> list[Message]:
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
    places = joined(", ", list(dict.fromkeys(read.set_up.target_place for read in solution.setup.reads)))
    return [
        Message(
            "{names} refer to a point of the targets' carrier whose distance from the machine's own origin is not "
            "known; their uncertainty includes 0.2 m for it. Enter {places} to reduce it",
            names=", ".join(names),
            places=places,
        )
    ]


# --- The part of each instrument in an estimate from the readings of several ----------------------


@final
@dataclass(frozen=True)
class InstrumentShare:
    """One instrument's part in an estimate.

    Attributes:
        readings: number of coordinates or lengths that were used.
        reduced_chi2: mean square of their whitened residuals; about 1 if their stated uncertainty is right.
        alone: which constant errors its readings alone determine; None if it moved no axis that has any.
    """

    instrument: str
    stations: tuple[str, ...]
    readings: int
    rms_um: float
    reduced_chi2: float
    alone: ConstantErrors | None

    @property
    def text(self) -> str:
        """One line."""
        alone = "" if self.alone is None else f"; alone: {self.alone.text}"
        return (
            f"{self.instrument} ({', '.join(self.stations)}): {count_with_noun(self.readings, 'reading')}, residuals "
            f"{self.rms_um:.3g} µm RMS, reduced chi² {self.reduced_chi2:.3g}{alone}"
        )


def instrument_shares(
    network: Network, setup: StationsAndTargets, used: np.ndarray, residual_mm: np.ndarray, whitened: np.ndarray
) -> tuple[InstrumentShare, ...]:
    """Return the part of each instrument; empty if there is only one.

    ``used``: (n,) rows that were used; ``residual_mm``: (n, 3) residuals, NaN where nothing was read; ``whitened``: (n, 3) the same
    divided by the stated standard deviations.
    """
    data, instrument_shares = network.data, []
    if len(network.instruments.every) == 1:
        return ()
    for instrument, rows in network.instruments.groups(data.station):
        own = rows[used[rows]]
        read = network.read[own]
        part = data.select(own)
        alone = None
        if len(own):
            part_setup, part_covariance = setup.of(part), network.covariance[own]
            alone = constant_errors(network.machine, part, network.instruments, part_setup, part_covariance)
        square = float(np.mean(whitened[own][read] ** 2)) if read.any() else float("nan")
        rms = float(np.sqrt(np.nanmean(residual_mm[own] ** 2))) * 1e3 if read.any() else float("nan")
        stations = tuple(dict.fromkeys(data.station[rows].tolist()))
        instrument_shares.append(InstrumentShare(instrument.name, stations, int(read.sum()), rms, square, alone))
    return tuple(instrument_shares)
