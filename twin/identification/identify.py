"""The estimate: from a measurement table to a calibration with its covariance, and everything it rests on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, Literal, final

import numpy as np
from threadpoolctl import threadpool_limits

from twin._common.arrays import locked
from twin._common.errors import InputError
from twin._common.units import MM
from twin.identification.inputs import prepared
from twin.identification.network import Network
from twin.identification.orders import Choice, Folds, choose
from twin.identification.outliers import Judged, explained, judged, model_is_wrong
from twin.identification.priors import prior_precision
from twin.identification.result import Identification, Unidentified, residuals_of
from twin.identification.setup import SetUp
from twin.identification.solve import Solution, solve
from twin.identification.spread import between_poses, between_rounds, covariance_from_repeats, misfit
from twin.identification.unknowns import CurveSpace, Unknowns, axes_told, offset_unseen, spaces_for
from twin.machine.effects import split_name
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument
from twin.measurement.table import Measurements
from twin.numerics.curves import Basis, bases_for
from twin.numerics.observability import UNSEEN, Determinability

MOST: Final = 13
"""Functions of a curve at most: degree 12, six harmonics."""
ROBUST_ROUNDS: Final = 8
FAR: Final = 100.0
"""Whitened residuals of the machine as drawn beyond which it is not tried whether the model fits: no machine tool before a tracker."""
TRIED: Final = 8
"""Steps of that trial."""
TOUCHED: Final = 1e-3
"""Share of an error's plausible variance that a silent direction must carry to count."""
Say = Callable[[str, float], None]
Spread = Literal["stated", "repeats", "between poses", "between rounds"]


def identify(
    data: Measurements,
    machine: Machine,
    *,
    instrument: Instrument | None = None,
    wanted: Callable[[str], bool] | None = None,
    spread: Spread = "stated",
    say: Say | None = None,
) -> Identification:
    """Identify a machine's error motions, squareness and locations together with stations and targets.

    Whitened nonlinear least squares with analytic derivatives of every reading by every unknown. The datum is the machine's own
    (`twin.identification.unknowns`); the covariance is that of the readings carried through, never rescaled by chi².

    Args:
        data: the measurements.
        machine: the machine.
        instrument: what read them; a tracking interferometer if only lengths were read, else a laser tracker (AT960).
        wanted: whether an error of that ISO 230-1 name is sought at all; all if None.
        spread: whose scatter the covariance carries: the stated uncertainty of the readings; the scatter of their repeats; or the
            scatter from pose to pose or from round to round, for a model that leaves something out (`twin.identification.spread`).
        say: told what is being done and how far it is.

    Raises:
        InputError: data that cannot be a measurement of this machine; too few repeats for ``spread="repeats"``; nothing that moved.
    """
    # On a shared machine the threads of a linear algebra library wait for each other longer than they work.
    with threadpool_limits(limits=1, user_api="blas"):
        return _identify(
            data, machine, instrument, wanted or (lambda name: True), spread, say or (lambda stage, part: None)
        )


def _identify(
    data: Measurements,
    machine: Machine,
    instrument: Instrument | None,
    wanted: Callable[[str], bool],
    spread: Spread,
    say: Say,
) -> Identification:
    say("placing the stations", 0.0)
    reader, data, setup = prepared(machine, data, instrument)
    covariance = covariance_from_repeats(data, reader)[0] if spread == "repeats" else None

    def network(unknowns: Unknowns) -> Network:
        return Network(machine, data, reader, unknowns, covariance=covariance)

    def attempt(bases: dict[str, Basis]) -> _Attempt:
        spaces, constants = spaces_for(machine, data.positions, bases=bases, most=MOST, wanted=wanted)
        if not spaces and not constants:
            raise InputError(
                "no axis moved", expected="two or more positions of an axis", file=data.source, line=int(data.lines[0])
            )
        every = Unknowns(machine, spaces, constants, axes_told(machine, data))
        whole = network(every)
        # What the data cannot tell of the machine as drawn goes first, so that it does not compete.
        drawn = solve(whole, np.zeros(len(every)), setup, np.ones(len(data)), steps=0)
        while (unseen := offset_unseen(every, drawn.spectrum.unseen)) is not None:
            left = [name for name in every.offsets if name != unseen]
            every = Unknowns(machine, spaces, constants, every.told, left)
            whole = network(every)
            drawn = solve(whole, np.zeros(len(every)), setup, np.ones(len(data)), steps=0)
        seen, lost, together = _seen(every, drawn)
        kept = [every.index[column] for column in seen.columns] + list(range(len(every), drawn.triangle.shape[1]))
        whole = whole if seen is every else network(seen)
        solution, weight = _robust(whole, setup, drawn.triangle[:, kept])
        choice = choose(whole, solution, weight, Folds.of(data), together)
        return _Attempt(choice, whole.unknowns, solution, weight, lost, together, every, drawn)

    say("choosing the curves", 0.1)
    best, *others = map(attempt, _families(machine, data, wanted))
    for other in others:
        if other.choice.held_out < best.choice.held_out * (1.0 - 1e-6):
            best = other
    say("estimating", 0.75)
    final = network(best.unknowns)
    readings = int(np.count_nonzero(final.read[best.weight > 0.0]))
    precision = prior_precision(best.unknowns, best.solution, readings)
    solution, rows = _without_outliers(final, best.solution, best.weight, precision)
    say("uncertainty", 0.9)
    return _result(final, solution, rows, best, spread, wanted)


@final
@dataclass(frozen=True)
class _Attempt:
    """The largest model in one family of bases, and how many functions of it pay."""

    choice: Choice
    unknowns: Unknowns
    solution: Solution
    weight: np.ndarray
    lost: list[str]
    together: list[str]
    every: Unknowns
    drawn: Solution


def _families(machine: Machine, data: Measurements, wanted: Callable[[str], bool]) -> list[dict[str, Basis]]:
    """The bases worth trying: powers for travels, harmonics for full turns, either for part of a turn."""
    tried = {axis.name: bases_for(rotary=not axis.linear, endless=axis.lower is None) for axis in machine.axes}
    first = {name: bases[0] for name, bases in tried.items()}
    other = {name: bases[-1] for name, bases in tried.items()}
    moved = any(
        first[axis.name] != other[axis.name]
        and np.ptp(data.positions[:, i]) > 0.0
        and any(wanted(f"E_{letter}{axis.name}") for letter in "XYZABC")
        for i, axis in enumerate(machine.axes)
    )
    return [first, other] if moved else [first]


def _robust(network: Network, setup: SetUp, triangle: np.ndarray) -> tuple[Solution, np.ndarray]:
    """An estimate that a few wrong points do not pull, and (n,) the weights it ended with.

    If the model does not fit, it begins with the misfit of the machine as drawn as its noise, so that what the readings say most of is
    fitted first, and goes on with what each estimate leaves.

    Args:
        network: data and model.
        setup: to start from, the machine as drawn.
        triangle: factor of [J | r] there.
    """
    weight = np.ones(len(network.data))
    nothing = np.zeros(len(network.unknowns))
    drawn = judged(network, network.residual(nothing, setup))
    if drawn.noise <= FAR:
        solution = solve(network, nothing, setup, weight, steps=TRIED, triangle=triangle)
        found = judged(network, network.residual(solution.theta, solution.setup))
    if drawn.noise > FAR or found.noise > 1.0:
        solution = solve(network, nothing, setup, weight, noise=drawn.noise, triangle=triangle)
        found = judged(network, network.residual(solution.theta, solution.setup))
    for _ in range(ROBUST_ROUNDS):
        fits = found.noise >= 0.9 * solution.noise
        if not np.any(found.bad) and np.all(weight == 1.0) and fits and solution.converged:
            return solution, weight
        fresh = found.weight if np.any(found.bad) or np.any(weight < 1.0) else weight
        still = float(np.abs(fresh - weight).max()) < 0.01 and fits
        weight = fresh
        if still:
            break
        pulled = solution.noise > found.noise == 1.0
        solution = solve(network, solution.theta, solution.setup, weight, noise=found.noise, moved=solution.moved)
        if pulled:
            # From where a prior held it, one step more than to a still one: readings without noise give the errors to the last digits.
            solution = solve(network, solution.theta, solution.setup, weight, moved=solution.moved, steps=1)
        found = judged(network, network.residual(solution.theta, solution.setup))
    weight = (~found.bad).astype(float)
    moved = solution.moved
    return solve(network, solution.theta, solution.setup, weight, noise=found.noise, moved=moved), weight


def _seen(unknowns: Unknowns, solution: Solution) -> tuple[Unknowns, list[str], list[str]]:
    """The unknowns of the fit, the names of those left out of it, and of those in it that only show together.

    An error that only stations, targets and others like it take up is left out: nothing else then changes. Errors that take each
    other up stay in, none of them reported, since leaving one out would lay its share at the others' door.
    A curve of which only higher orders are unseen is cut there.
    """
    count = len(unknowns)
    unseen = solution.spectrum.unseen[:count] > UNSEEN
    silent = solution.spectrum.silent[:count]
    shared = silent @ silent.T
    touched = np.diag(shared) > TOUCHED
    entity = np.array([column.entity for column in unknowns.columns])
    lost = [name for name in unknowns.entities if _unseen_whole(unknowns, name, unseen)]
    rank = solution.rank_of(range(count), unknowns.datum)
    dropped: list[str] = []
    together: list[str] = []
    for name in lost:
        if name in together or name in dropped:
            continue
        group = _group(name, entity, shared, touched)
        gone = np.isin(entity, [*dropped, *group])
        safe = (
            set(group) <= set(lost)
            and solution.rank_of([int(k) for k in np.flatnonzero(~gone)], unknowns.datum) == rank
        )
        (dropped if safe else together).extend(one for one in group if one not in dropped and one not in together)
    curves = []
    for curve in unknowns.curves:
        bad = [k for k, i in enumerate(unknowns.of(curve.name)) if unseen[i]]
        if curve.name in dropped:
            continue
        if not bad or curve.name in together:
            curves.append(curve)
            continue
        kept = [0, *(group[-1] + 1 for group in curve.groups() if group[-1] - curve.first < bad[0])]
        curves.append(CurveSpace(curve.name, curve.basis, curve.domain, curve.first, kept[-1]))
    constants = [name for name in unknowns.constants if name not in dropped]
    same = len(constants) == len(unknowns.constants) and list(unknowns.curves) == curves
    fewer = Unknowns(unknowns.machine, curves, constants, unknowns.told, unknowns.offsets)
    return (unknowns if same else fewer), dropped, together


def _unseen_whole(unknowns: Unknowns, name: str, unseen: np.ndarray) -> bool:
    """Whether even the lowest order of a curve, or a constant itself, is unseen."""
    columns = unknowns.of(name)
    lowest = next((len(c.groups()[0]) for c in unknowns.curves if c.name == name), 1)
    return bool(np.any(unseen[columns[:lowest]]))


def _group(name: str, entity: np.ndarray, shared: np.ndarray, touched: np.ndarray) -> list[str]:
    """An error and all that the same silent directions move, directly or through others."""
    found = [name]
    for one in found:
        rows = (entity == one) & touched
        linked = (
            np.any(np.abs(shared[rows]) > TOUCHED, axis=0) & touched
            if np.any(rows)
            else np.zeros(len(entity), dtype=bool)
        )
        found += [str(other) for other in dict.fromkeys(entity[linked]) if other not in found]
    return found


def _without_outliers(
    network: Network, solution: Solution, weight: np.ndarray, precision: np.ndarray
) -> tuple[Solution, Judged]:
    """Least squares on all points that are no outliers of it: one is let back in when it fits after all."""
    bad = weight == 0.0
    seen: set[bytes] = set()
    triangle: np.ndarray | None = solution.triangle
    while True:
        solution = solve(
            network,
            solution.theta,
            solution.setup,
            (~bad).astype(float),
            precision=precision,
            noise=solution.noise,
            triangle=triangle,
            moved=solution.moved,
        )
        triangle = None
        found = judged(network, network.residual(solution.theta, solution.setup))
        if np.array_equal(found.bad, bad) or found.bad.tobytes() in seen:
            return solution, replace(found, bad=bad)
        seen.add(found.bad.tobytes())
        bad = found.bad


def _result(
    network: Network,
    solution: Solution,
    rows: Judged,
    best: _Attempt,
    spread: Spread,
    wanted: Callable[[str], bool],
) -> Identification:
    data, unknowns = network.data, network.unknowns
    count, used = len(unknowns), ~rows.bad
    weight = used.astype(float)
    if spread == "between poses":
        whole = between_poses(network, solution, weight)
    elif spread == "between rounds":
        whole = between_rounds(network, solution, weight)
    else:
        whole = solution.covariance()
    source = f"identified by twin from {data.source}: {int(used.sum())} points"
    estimate, _ = unknowns.calibration(solution.theta, range(count), source, whole[:count, :count])
    calibration = replace(estimate, settled=solution.converged, simulated=data.simulated)
    u = np.sqrt(np.maximum(np.diag(whole)[count:], 0.0))
    held = _held_by_prior(unknowns, solution, best.together)
    left, whitened = residuals_of(calibration, network, solution.setup)
    return Identification(
        calibration=calibration,
        unidentified=_unidentified(network.machine, data, best, wanted, solution.setup, held),
        held_by_prior={name: float(network.machine.plausible(name)) for name in held},
        setup=solution.setup,
        setup_u=dict(zip(solution.setup.names, (float(v) for v in u), strict=True)),
        misfit=misfit(whitened, network.read, data, solution.determined, used),
        choice=best.choice,
        spread=spread,
        data=data,
        used=locked(used),
        residual_mm=locked(np.where(network.read, left / MM, np.nan)),
        whitened=locked(whitened),
        set_aside=(*data.set_aside, *explained(network, left, whitened, rows.bad)),
        notices=(
            *data.notices,
            *model_is_wrong(rows),
            *_notices(solution, unknowns),
        ),
        converged=solution.converged,
        network=network,
        solution=solution,
    )


def _held_by_prior(unknowns: Unknowns, solution: Solution, together: list[str]) -> list[str]:
    """Names of the errors in the estimate that the readings, with their noise, determine no better than was known before."""
    unseen = solution.unseen[: len(unknowns)] > UNSEEN
    return [name for name in unknowns.entities if name in together or _unseen_whole(unknowns, name, unseen)]


def _unidentified(
    machine: Machine,
    data: Measurements,
    best: _Attempt,
    wanted: Callable[[str], bool],
    setup: SetUp,
    held: list[str],
) -> tuple[Unidentified, ...]:
    """What was asked for and is not determined, and why."""
    found = []
    seen = best.drawn.told(best.every, int(np.count_nonzero(np.isfinite(data.point_mm))))
    names = (*machine.motion_names, *machine.squareness_names, *machine.location_names)
    for name in names:
        axis = split_name(name)[2]
        moved = np.ptp(data.positions[:, machine.names.index(axis)]) > 0.0
        if not wanted(name):
            continue
        if not moved:
            found.append(Unidentified(name, f"{axis} was not moved"))
        elif name in best.together or name in best.lost:
            why = _direction(seen, best.every.of(name)[0])
            found.append(Unidentified(name, f"{why}: {_remedy(name, machine, setup, name in best.together)}"))
        elif name in held:
            found.append(Unidentified(name, "these data say less of it than is plausible beforehand"))
    return tuple(found)


def _direction(told: Determinability, column: int) -> str:
    """What moves together with an unknown and changes no reading."""
    found = told.moving(told.names[column])
    if found is None:
        return "these data say less of it than is plausible beforehand"
    return f"no reading shows {found}"


def _remedy(name: str, machine: Machine, setup: SetUp, together: bool) -> str:
    _, average, axis = split_name(name)
    if together:
        return "a third target apart from one line tells them"
    if average and not machine.by_name[axis].linear and not setup.target_known.all():
        return "give the targets' places, or a reference on the machine"
    if average:
        return "the other axes' motions, which would be its reference, are not among these data"
    return "it takes three targets apart from one line, or other poses of the other axes"


def _notices(solution: Solution, unknowns: Unknowns) -> list[str]:
    """What the set-up leaves open that shows in the errors."""
    if solution.spectrum.silent.shape[1] == 0:
        return []
    carried = solution.spectrum.reach[: len(unknowns)]
    seen = solution.spectrum.covariance(silent=False)
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
