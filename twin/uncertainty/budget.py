"""Error budget: size of each error motion and its effect at the tool over the working volume."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from twin._common.errors import InputError
from twin.kinematics.forward import Kinematics, Poses, rms_and_max
from twin.machine.calibration import Calibration
from twin.machine.conditions import APPROACH, Conditions
from twin.machine.display import standard_uncertainty
from twin.machine.effects import Effect, assemble, unit_of
from twin.machine.iso16907 import error_motion_of, iso_class
from twin.machine.machine import Machine

POSES: Final = 2000
SEED: Final = 16907
CURVE_POINTS: Final = 721
"""Number of points at which a curve's peak is sought: every half degree of a turn."""
ROWS: Final = 16_384
"""Largest number of poses evaluated in one call, fewer than are worth compiling for."""


@final
@dataclass(frozen=True)
class BudgetRow:
    """Row of the error budget: one error motion, squareness or location error, or one class of them.

    Attributes:
        name: ISO 230-1 name, or ISO/TR 16907 class.
        iso_class: its class.
        unit: ``um`` or ``urad``; empty for a class.
        peak: largest absolute value over its domain; NaN for a class.
        peak_u: largest standard uncertainty (k = 1) over its domain, in ``unit``; NaN for a class, and if unknown.
        tool_rms_um, tool_max_um: displacement of the tool point due to it alone, over the volume.
        tilt_rms_urad, tilt_max_urad: tilt of the tool axis due to it alone, about x and about y of the tool frame
            (`twin.kinematics.forward.Poses.tilt_urad`); the maximum by absolute value.
        illustrative: whether its values are illustrative and not measured.
    """

    name: str
    iso_class: str
    unit: str
    peak: float
    peak_u: float
    tool_rms_um: float
    tool_max_um: float
    tilt_rms_urad: tuple[float, float]
    tilt_max_urad: tuple[float, float]
    illustrative: bool


def volume(machine: Machine, poses: int = POSES, seed: int = SEED) -> np.ndarray:
    """Return commands (poses, axes) spread evenly over the ranges, mm and degrees; an unlimited axis over one turn."""
    return latin_hypercube(np.array([axis.domain for axis in machine.axes]), poses, np.random.default_rng(seed))


def volume_inside_domains(calibration: Calibration) -> np.ndarray:
    """Return the poses (n, axes) of `volume` that lie inside the domain of every curve of a calibration."""
    q = volume(calibration.machine)
    return np.asarray(q[~calibration.outside(q).any(axis=1)])


def latin_hypercube(ranges: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return a Latin hypercube sample (count, k) of (k, 2) ranges: one point in each of ``count`` slices of every range."""
    lower, upper = ranges.T
    cells = np.argsort(rng.random((count, len(ranges))), axis=0)
    return np.asarray(lower + (cells + rng.random(cells.shape)) / count * (upper - lower))


def random_approach(positions: np.ndarray) -> np.ndarray:
    """Return random directions of approach (n, axes), +1 or −1, from a fixed seed."""
    return np.asarray(np.random.default_rng(SEED).choice([-1.0, 1.0], np.shape(positions)))


def inside_domains(positions: np.ndarray, *calibrations: Calibration) -> np.ndarray:
    """Return the positions (n, axes) that lie inside the domain of every curve of all calibrations.

    Raises:
        InputError: there are none.
    """
    outside = np.any([calibration.outside(positions).any(axis=1) for calibration in calibrations], axis=0)
    if np.all(outside):
        raise InputError("no pose of the volume lies within every curve's domain", expected="curves over the ranges")
    return np.asarray(positions[~outside])


def state_at(
    machine: Machine, q: np.ndarray, sides: np.ndarray, conditions: Conditions, by_pose: Sequence[str] = ()
) -> dict[str, Any]:
    """Return the arguments of effects by name, each (n,): positions (n, axes), directions of approach, and channels.

    Columns of ``sides`` after the directions are the channels ``by_pose``.
    """
    found: dict[str, Any] = dict(zip(machine.names, q.T, strict=True))
    names = [*(f"{APPROACH}{name}" for name in machine.names), *by_pose]
    return found | dict(conditions.channels) | dict(zip(names, sides.T, strict=True))


def errors_in(state: Mapping[str, Any], effects: Sequence[Effect], machine: Machine, count: int) -> np.ndarray:
    """Return the errors (n, 6·frames) of effects in ``count`` states (`state_at`), as `Kinematics.with_errors` takes them."""
    rows = assemble(effects, machine.frames, state)
    return np.stack([np.broadcast_to(value, count) for row in rows for value in row], axis=1)


@final
class PartialErrors:
    """Poses of a machine with some of its errors: each error is evaluated once, and many selections at a time.

    Args:
        real: the machine with all its errors.
        q: (n, axes) commands, mm and degrees.
        sides: (n, axes) directions of approach, +1 or −1.

    Raises:
        InputError: a position outside the domain of a curve.
    """

    def __init__(self, real: Kinematics, q: np.ndarray, sides: np.ndarray) -> None:
        self._real = real
        self._q = real.check(q)
        state = state_at(real.machine, q, sides, real.conditions)
        self._errors: dict[str, np.ndarray] = {}
        for effect in real.calibration.effects:
            own = errors_in(state, [effect], real.machine, len(q))
            self._errors[effect.name] = self._errors.get(effect.name, 0.0) + own

    def poses(self, selections: Sequence[Collection[str]]) -> Iterator[tuple[Poses, Poses]]:
        """Yield the (n,) nominal poses, and those with each selection of errors, given by the names of their effects.

        Both are results of one call, so that an error without effect gives exactly zero.
        """
        count, size = len(self._q), 6 * len(self._real.machine.frames)
        step = max(1, ROWS // max(count, 1))
        for first in range(0, len(selections), step):
            some = [(), *selections[first : first + step]]
            errors = np.zeros((len(some), count, size))
            for total, names in zip(errors, some, strict=True):
                for name, own in self._errors.items():
                    if name in names:
                        total += own
            found = self._real.with_errors(np.tile(self._q, (len(some), 1)), errors.reshape(-1, size))
            parts = [slice(i * count, (i + 1) * count) for i in range(len(some))]
            nominal, *reached = (Poses(found.point_mm[rows], found.rotation[rows]) for rows in parts)
            yield from ((nominal, one) for one in reached)


def error_budget(
    machine: Machine,
    calibration: Calibration,
    *,
    tool_length_mm: float | None = None,
    conditions: Conditions | None = None,
) -> tuple[tuple[BudgetRow, ...], tuple[BudgetRow, ...]]:
    """Return the budget: rows by error, and rows by class with the total last.

    A reversal counts as ± half its size, as directions of approach are random.

    Args:
        machine: the machine.
        calibration: its errors, without effects whose channel the conditions do not give (`without_missing_channels`).
        tool_length_mm: tool length; None: that of the machine file.
        conditions: temperatures and time.
    """
    q = volume_inside_domains(calibration)
    sides = random_approach(q)
    classes = {effect.name: iso_class(error_motion_of(effect, machine), machine) for effect in calibration.effects}

    real = Kinematics(machine, calibration, tool_length_mm=tool_length_mm, conditions=conditions)
    partial = PartialErrors(real, q, sides)

    def at_tool(nominal: Poses, reached: Poses) -> tuple[float, float, tuple[float, float], tuple[float, float]]:
        distance = np.linalg.norm(reached.point_mm - nominal.point_mm, axis=1) * 1e3
        return float(np.sqrt(np.mean(distance**2))), float(distance.max()), *rms_and_max(reached.tilt_urad(nominal))

    state = state_at(machine, q, sides, Conditions() if conditions is None else conditions)
    entries = list(_entries(calibration, state))
    rows = [
        BudgetRow(effect.name, classes[effect.name], unit, peak, u, *at_tool(*alone), illustrative)
        for (effect, peak, u, unit, illustrative), alone in zip(
            entries, partial.poses([{effect.name} for effect, *_ in entries]), strict=True
        )
    ]
    totals = []
    members = {
        iso: [row for row in rows if row.iso_class == iso] for iso in dict.fromkeys(row.iso_class for row in rows)
    }
    selections = [{row.name for row in some} for some in members.values()]
    for (iso, some), own in zip(members.items(), partial.poses(selections), strict=True):
        totals.append(BudgetRow(iso, iso, "", np.nan, np.nan, *at_tool(*own), any(row.illustrative for row in some)))
    drawn = any(row.illustrative for row in rows)
    (whole,) = partial.poses([{row.name for row in rows}])
    totals.append(BudgetRow("all", "all", "", np.nan, np.nan, *at_tool(*whole), drawn))
    return tuple(rows), tuple(totals)


def without_missing_channels(
    conditions: Conditions, calibration: Calibration
) -> tuple[Calibration, dict[str, tuple[str, ...]]]:
    """Return the calibration without effects whose channel is not given, and the effects left out by channel."""
    missing = conditions.missing(calibration)
    left_out = {name for by in missing.values() for name in by}
    return calibration.where(lambda name: name not in left_out), missing


def _entries(calibration: Calibration, state: Mapping[str, Any]) -> Iterator[tuple[Effect, float, float, str, bool]]:
    """Yield for every effect its largest value, its largest standard uncertainty (NaN if unknown), unit, whether illustrative.

    Curves are evaluated over their domains, other effects over the poses of ``state``. Corrections by the control are among the other
    effects and have zero uncertainty.
    """
    covariance = calibration.covariance
    constants = {**calibration.squareness, **calibration.location}
    for effect in calibration.effects:
        name, numbers = effect.name, [parameter.name for parameter in effect.parameters]
        curve = calibration.curves.get(name)
        known = set(numbers) <= set(covariance.names)
        if curve is not None:
            q = np.linspace(*curve.domain, CURVE_POINTS)
            u = float(standard_uncertainty(effect, covariance, q).max())
            yield effect, float(np.abs(curve(q)).max()), u, curve.unit, curve.illustrative
        elif name in constants:
            u = float(np.sqrt(covariance.of(numbers).matrix[0, 0])) if known else np.nan
            yield effect, abs(constants[name]), u, unit_of(name), False
        else:
            component, values = max(effect.components(state).items(), key=lambda one: float(np.max(np.abs(one[1]))))
            u = np.nan if numbers else 0.0
            if numbers and known:
                shape = np.shape(state[calibration.machine.names[0]])
                rates = [np.broadcast_to(rate.get(component, 0.0), shape) for rate in effect.derivatives(state)]
                variance = np.einsum("kn,kl,ln->n", rates, covariance.of(numbers).matrix, rates)
                u = float(np.sqrt(max(variance.max(), 0.0)))
            yield effect, float(np.max(np.abs(values))), u, "um" if component < 3 else "urad", False
