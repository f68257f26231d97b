"""Compare measured points with a calibration.

Only unknown positions of stations and targets are fitted (`twin.diagnosis.problem.readings`). An estimate is the curve's value plus the
change that would remove the residuals at that position, all else fixed (component plus residual, as in regression diagnostics: Larsen
and McCleary 1972). Its 95 % interval follows from the spread of the readings.
"""

from __future__ import annotations

from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np

from twin._common.arrays import read_only
from twin._common.units import UM
from twin.diagnosis.candidates.signatures import first_component
from twin.diagnosis.problem.readings import readings
from twin.diagnosis.wording.panels import group_means, group_numbers
from twin.identification.network import Network
from twin.identification.setup import SetUp
from twin.identification.solve import solve
from twin.identification.unknowns import Unknowns
from twin.machine.calibration import Calibration
from twin.machine.conditions import APPROACH, required_channels
from twin.machine.effects import split_name
from twin.machine.machine import Machine
from twin.measurement.state import machine_state
from twin.measurement.table import Measurements
from twin.reporting.readings import PointComparison, PositionEstimates, is_motion, sum_of_effects

LEGIBLE: Final = 5.0
"""An estimate is omitted if its interval exceeds the curve's largest value by this factor."""
FEWEST: Final = 3
"""Smallest number of positions of an axis for a curve."""
NO_SIDE: Final = 0


def compare_points(data: Measurements, machine: Machine, calibration: Calibration, path: Path) -> PointComparison:
    """Fit the set-up to measured points with a fixed calibration and return the residuals.

    Args:
        data: the measurements.
        machine: the machine.
        calibration: the calibration, not changed.
        path: file of the data.

    Raises:
        InputError: data that do not fit the machine, or positions outside the curves.
    """
    given = machine_state(data, machine)
    needed = required_channels(calibration.effects, machine)
    absent = {name for channel, by in needed.items() if channel not in given for name in by}
    held = calibration.where(lambda name: name not in absent)
    evaluated = {effect.name for effect in held.effects}
    placed = readings(data, machine, held)
    network, good = placed.network, ~placed.bad
    nominal_network = Network(
        machine, network.data, network.instruments, Unknowns(machine, (), ()), None, network.covariance
    )
    nominal_setup = solve(nominal_network, np.zeros(0), placed.setup, good.astype(float)).setup
    every = np.arange(len(network.data))
    nominal_residual = nominal_network.residuals_m(np.zeros(0), nominal_setup, every)
    residual = network.residuals_m(np.zeros(0), placed.setup, every)
    read = network.read
    return PointComparison(
        source=str(path),
        points=len(every),
        far=int(np.count_nonzero(placed.bad)),
        rms_before_um=_rms(nominal_residual, read),
        rms_after_um=_rms(residual, read),
        scatter=placed.noise.source,
        before_um=read_only(np.linalg.norm(nominal_residual, axis=1) / UM),
        after_um=read_only(np.linalg.norm(residual, axis=1) / UM),
        stops=MappingProxyType(_estimates(network, placed.setup, held)),
        rows=tuple((note.line, note.text) for note in network.data.set_aside),
        notices=network.data.notices,
        left_out=tuple(effect.name for effect in calibration.effects if effect.name not in evaluated),
    )


def _rms(residual: np.ndarray, read: np.ndarray) -> float:
    return float(np.sqrt(np.mean(residual[read] ** 2))) / UM


def _estimates(network: Network, setup: SetUp, calibration: Calibration) -> dict[str, tuple[PositionEstimates, ...]]:
    machine, data = network.machine, network.data
    view = network.view(np.zeros(0), setup, np.arange(len(data)))
    state = machine_state(data, machine)
    found: dict[str, tuple[PositionEstimates, ...]] = {}
    for name in machine.motion_names:
        component, _, axis = split_name(name)
        q = state[axis]
        if len(np.unique(np.round(q, 3))) < FEWEST:
            continue
        derivative = view.by_error[:, :, first_component(machine, axis) + component]
        weight = np.einsum("ni,ni->n", derivative, derivative)
        if not np.any(weight > 0.0):
            continue
        safe = np.where(weight > 0.0, weight, 1.0)
        off = np.einsum("ni,ni->n", derivative, view.residual) / safe / UM
        # The value of the curve at each reading already includes the direction of approach.
        effects = [one for one in calibration.effects if is_motion(one, axis, calibration)]
        value = sum_of_effects(effects, state, component)
        side = state.get(f"{APPROACH}{axis}", np.zeros(len(q)))
        both = bool(np.any(side > 0) and np.any(side < 0))
        parts = [
            _estimates_of_side(name, way, q, value + off, weight, np.sign(side) == way)
            for way in ((1, -1) if both else ())
        ]
        parts = [part for part in parts if len(part.position)] or [
            _estimates_of_side(name, NO_SIDE, q, value + off, weight, np.ones(len(q), dtype=bool))
        ]
        found[name] = tuple(parts)
    return found


def _estimates_of_side(
    name: str, side: int, q: np.ndarray, value: np.ndarray, weight: np.ndarray, rows: np.ndarray
) -> PositionEstimates:
    rows = rows & (weight > 0.0)
    if np.count_nonzero(rows) < FEWEST:
        return PositionEstimates(name, side, np.zeros(0), np.zeros(0), np.zeros(0))
    at, mean, half = group_means(q[rows], value[rows], weight[rows], group_numbers(q[rows]))
    legible = half <= LEGIBLE * max(float(np.abs(mean).max(initial=0.0)), 1.0)
    return PositionEstimates(name, side, read_only(at[legible]), read_only(mean[legible]), read_only(half[legible]))
