"""The error budget: what each error motion is, and what it does to the tool over the working volume."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from twin.kinematics.forward import Kinematics, rms_and_max
from twin.machine.calibration import Calibration
from twin.machine.conditions import APPROACH, Conditions
from twin.machine.iso16907 import acts_as, iso_class
from twin.machine.machine import Machine

POSES: Final = 2000
SEED: Final = 16907
CURVE_POINTS: Final = 721
"""Points of a curve at which its peak is looked for: half a degree of a turn."""


@final
@dataclass(frozen=True)
class BudgetRow:
    """One error motion, squareness or location, or one class of them.

    Attributes:
        name: ISO 230-1 name, or ISO/TR 16907 class.
        iso_class: its class.
        unit: ``um`` or ``urad``; empty for a class.
        peak: largest absolute value over its domain; NaN for a class.
        peak_u: largest standard uncertainty (k = 1) over its domain, in ``unit``; NaN for a class, and where it is not known.
        tool_rms_um, tool_max_um: what it alone does to the tool point over the volume.
        tilt_rms_urad, tilt_max_urad: how it alone makes the tool axis lean, about x and about y of the tool frame
            (`twin.kinematics.forward.Poses.tilt_urad`); the largest by amount.
        illustrative: whether it is drawn, not measured.
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
    """(poses, axes) commands spread evenly over the ranges, mm and degrees; an unlimited axis over one turn."""
    return latin_hypercube(np.array([axis.domain for axis in machine.axes]), poses, np.random.default_rng(seed))


def known_volume(calibration: Calibration) -> np.ndarray:
    """(n, axes) those of `volume` where every error of a calibration is known."""
    q = volume(calibration.machine)
    return np.asarray(q[~calibration.outside(q).any(axis=1)])


def latin_hypercube(ranges: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, k) points drawn over (k, 2) ranges: every one of ``count`` slices of every range once."""
    lower, upper = ranges.T
    cells = np.argsort(rng.random((count, len(ranges))), axis=0)
    return np.asarray(lower + (cells + rng.random(cells.shape)) / count * (upper - lower))


def drawn_sides(positions: np.ndarray) -> np.ndarray:
    """The side every axis comes from at (n, axes) positions, +1 or −1, drawn with a seed."""
    return np.asarray(np.random.default_rng(SEED).choice([-1.0, 1.0], np.shape(positions)))


def error_budget(
    machine: Machine,
    calibration: Calibration,
    *,
    tool_length_mm: float | None = None,
    conditions: Conditions | None = None,
) -> tuple[tuple[BudgetRow, ...], tuple[BudgetRow, ...]]:
    """Rows by error, and rows by class with the total last.

    A reversal counts as ± half its size, the axes come to from either side.

    Args:
        machine: the machine.
        calibration: its errors, among them none whose channel the conditions do not give (`known_at`).
        tool_length_mm: None for the machine file's own.
        conditions: temperatures and time.
    """
    q = known_volume(calibration)
    meant = Kinematics(machine, Calibration.zero(machine), tool_length_mm=tool_length_mm).forward(q)
    sides = drawn_sides(q)
    acts = {effect.name: acts_as(effect, machine) for effect in calibration.effects}

    def at_tool(limited: Calibration) -> tuple[float, float, tuple[float, float], tuple[float, float]]:
        real = Kinematics(machine, limited, tool_length_mm=tool_length_mm, conditions=conditions)
        reached = real.forward(q, sides)
        distance = np.linalg.norm(reached.point_mm - meant.point_mm, axis=1) * 1e3
        return float(np.sqrt(np.mean(distance**2))), float(distance.max()), *rms_and_max(reached.tilt_urad(meant))

    rows = []
    uncertainty = peak_uncertainty(calibration)
    others = _others(calibration, q, sides, Conditions() if conditions is None else conditions)
    uncertainty |= {name: peak_u for name, _, peak_u, _ in others}
    for name, peak, unit, illustrative in (
        *_entries(calibration),
        *((name, peak, unit, False) for name, peak, _, unit in others),
    ):
        alone = at_tool(calibration.where(lambda other, name=name: other == name))  # type: ignore[misc]
        rows.append(
            BudgetRow(name, iso_class(acts[name], machine), unit, peak, uncertainty[name], *alone, illustrative)
        )
    classes = []
    for found in dict.fromkeys(row.iso_class for row in rows):
        of_class = calibration.where(lambda name, found=found: iso_class(acts[name], machine) == found)  # type: ignore[misc]
        drawn = any(row.illustrative for row in rows if row.iso_class == found)
        classes.append(BudgetRow(found, found, "", np.nan, np.nan, *at_tool(of_class), drawn))
    drawn = any(row.illustrative for row in rows)
    classes.append(BudgetRow("all", "all", "", np.nan, np.nan, *at_tool(calibration), drawn))
    return tuple(rows), tuple(classes)


def known_at(conditions: Conditions, calibration: Calibration) -> tuple[Calibration, dict[str, tuple[str, ...]]]:
    """A calibration without the effects whose channel nobody gave, and those channels with the effects left out."""
    missing = conditions.missing(calibration)
    left_out = {name for by in missing.values() for name in by}
    return calibration.where(lambda name: name not in left_out), missing


def peak_uncertainty(calibration: Calibration) -> dict[str, float]:
    """Largest standard uncertainty of every error motion over its domain, of squareness and location as they are.

    √(fᵀ Σ f) with the functions f of the curve (JCGM 100, eq. 13); NaN where any number of the error has no uncertainty.
    """
    covariance = calibration.covariance
    known = set(covariance.names)
    found = {}
    for effect in calibration.where(lambda name: name.startswith("E_")).effects:
        names = [parameter.name for parameter in effect.parameters]
        found[effect.name] = np.nan
        if known.issuperset(names):
            matrix = covariance.of(names).matrix
            curve = calibration.curves.get(effect.name)
            if curve is None:
                variance = np.diag(matrix)
            else:
                q = np.linspace(*curve.domain, CURVE_POINTS)
                rates = effect.derivatives({effect.frame.axis: q})
                shape = np.array([next(iter(rate.values())) for rate in rates])
                variance = np.einsum("kn,kl,ln->n", shape, matrix, shape)
            found[effect.name] = float(np.sqrt(max(variance.max(), 0.0)))
    return found


def _entries(calibration: Calibration) -> list[tuple[str, float, str, bool]]:
    found = []
    for curve in calibration.curves.values():
        values = curve(np.linspace(*curve.domain, CURVE_POINTS))
        found.append((curve.name, float(np.abs(values).max()), curve.unit, curve.illustrative))
    for name, value in (*calibration.squareness.items(), *calibration.location.items()):
        found.append((name, abs(value), "um" if name[2] in "XYZ" else "urad", False))
    return found


def _others(
    calibration: Calibration, q: np.ndarray, sides: np.ndarray, conditions: Conditions
) -> list[tuple[str, float, float, str]]:
    """Of every effect that is no error motion, squareness or location: name, peak over the poses, its u (NaN: not known), unit.

    What the control corrects by itself is among them, exactly known.
    """
    names = calibration.machine.names
    state: dict[str, Any] = {name: q[:, i] for i, name in enumerate(names)}
    state |= {f"{APPROACH}{name}": sides[:, i] for i, name in enumerate(names)}
    state |= conditions.channels
    covariance = calibration.covariance
    found = []
    for effect in (*calibration.extra, *calibration.corrections):
        component, values = max(effect.components(state).items(), key=lambda one: float(np.max(np.abs(one[1]))))
        numbers = [parameter.name for parameter in effect.parameters]
        peak_u = np.nan
        if not numbers:
            peak_u = 0.0
        elif set(numbers) <= set(covariance.names):
            rates = [np.broadcast_to(rate.get(component, 0.0), len(q)) for rate in effect.derivatives(state)]
            variance = np.einsum("kn,kl,ln->n", rates, covariance.of(numbers).matrix, rates)
            peak_u = float(np.sqrt(max(variance.max(), 0.0)))
        found.append((effect.name, float(np.max(np.abs(values))), peak_u, "um" if component < 3 else "urad"))
    return found
