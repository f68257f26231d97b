"""What modelling the causes gains: of the calibration that is written, on all readings, on readings held out, and at the tool."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from twin.diagnosis.judgement.extend import Extended
from twin.diagnosis.judgement.held_out import held_out
from twin.diagnosis.judgement.sizes import Sized
from twin.diagnosis.problem.problem import Problem, rms, unwhitened_um
from twin.diagnosis.result import Gain, Unexplained
from twin.identification.network import Network
from twin.identification.solve import solve
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.machine.effects import Effect
from twin.machine.effects.empirical import Empirical, state_name
from twin.machine.machine import Machine
from twin.measurement.table import Measurements, state_of
from twin.numerics.covariance import Covariance
from twin.uncertainty.budget import volume

TOOL_MM: Final = 100.0


def gain(
    sized: Sized, residuals: tuple[np.ndarray, np.ndarray], left: Unexplained | None, unnamed: Extended | None
) -> Gain:
    """What the extended calibration changes.

    Args:
        sized: the causes, with their sizes.
        residuals: (n, 3) µm of the readings with the calibration before and with the one that is written.
        left: what the causes leave.
        unnamed: what was made of it; None if nothing was asked for.
    """
    network, problem = sized.found.problem.network, sized.found.problem
    held = held_out(sized, () if unnamed is None else unnamed.written)
    effects, covariance = sized.effects, sized.covariance
    # What is not in the file stays: curves that are not promised, and what no effect in it explains.
    stays = [
        float(np.nansum(unwhitened_um(problem, sized.estimate.signature[:, k]) ** 2) / len(network.data))
        for k, own in enumerate(sized.promised)
        if not own
    ]
    size = 0.0 if left is None or not left.depends_on else left.size_um
    unseen = 0.0
    if unnamed is not None and unnamed.effects:
        effects = [*effects, *unnamed.effects]
        covariance, size = Covariance.of_blocks([covariance, unnamed.covariance]), unnamed.left_um
        # As far as it is not known it is in the machine as well: what is most likely is smaller than what is.
        unseen = at_tool(network.data, network.machine, unnamed.effects, unnamed.covariance)[1]
    moved, doubt = at_tool(network.data, network.machine, effects, covariance)
    rest = sum(stays) + 3.0 * size**2
    before, after = residuals
    return Gain(
        rms(before, network.read),
        rms(after, network.read),
        held,
        float(np.sqrt(moved**2 + unseen**2 + rest)),
        float(np.sqrt(doubt**2 + rest)),
        tool_mm(network.machine),
    )


def of_file(problem: Problem, extended: Calibration, instrument: np.ndarray) -> np.ndarray:
    """(n, 3) residual of the readings in µm with a calibration as it is written, the set-up fitted anew; NaN where nothing was read.

    Args:
        problem: the data.
        extended: the calibration.
        instrument: (3n,) whitened, what was found of the instrument; taken out of the readings first.
    """
    network = problem.network
    judged = Network(
        network.machine,
        network.data,
        network.instrument,
        network.unknowns,
        extended,
        network.covariance,
        check=False,
    )
    placed = Problem(judged, solve(judged, np.zeros(0), problem.setup, np.ones(len(network.data))).setup, None)
    return unwhitened_um(placed, placed.project(placed.residual - instrument))


def tool_mm(machine: Machine) -> float:
    """Of the machine file, or of a usual tool: at the spindle nose itself a turn about it would seem to do no harm."""
    return machine.tool_length_mm or TOOL_MM


def at_tool(
    data: Measurements, machine: Machine, effects: Sequence[Effect], covariance: Covariance
) -> tuple[float, float]:
    """RMS at the tool over the volume after compensating, with the old model and with the extended one, executed on the extended one.

    The old model's compensation leaves what the effects do there, to first order; the extended one's what they are uncertain by. The
    volume ends where the range of an empirical effect does.

    Args:
        data: the measurements, for their temperatures and times.
        machine: the machine.
        effects: what was found of it.
        covariance: of their parameters.
    """
    if not effects:
        return 0.0, 0.0
    positions = _inside(volume(machine, 400), machine, effects)
    rng = np.random.default_rng(16907)
    sides = rng.choice([-1.0, 1.0], (len(machine.axes), len(positions)))
    rows = rng.integers(0, len(data), len(positions))
    measured = state_of(data, machine)
    state: dict[str, Any] = {name: values[rows] for name, values in measured.items()}
    state |= {f"approach_{name}": own for name, own in zip(machine.names, sides, strict=True)}
    state |= {axis.name: positions[:, i] for i, axis in enumerate(machine.axes)}
    at_tip = Kinematics(machine, Calibration.zero(machine), tool_length_mm=tool_mm(machine))
    by_error = at_tip.sensitivities(positions).error[:, :3]
    index = {(frame.axis, frame.role): 6 * i for i, frame in enumerate(machine.frames)}

    def moved(effect: Effect, own: Mapping[int, Any]) -> np.ndarray:
        at, found = index[effect.frame.axis, effect.frame.role], np.zeros((len(positions), 3))
        for i, value in own.items():
            # What depends on the readings before it was worked out of all of them, in their order.
            values = np.asarray(value, dtype=float)[rows] if effect.history else np.asarray(value, dtype=float)
            found += by_error[:, :, at + i] * np.broadcast_to(values, len(positions))[:, None]
        return found

    states = [measured if effect.history else state for effect in effects]
    whole = np.sum([moved(one, one.components(own)) for one, own in zip(effects, states, strict=True)], axis=0)
    by_parameter = {
        parameter.name: moved(effect, derivative)
        for effect, own in zip(effects, states, strict=True)
        for parameter, derivative in zip(effect.parameters, effect.derivatives(own), strict=True)
    }
    known = [name for name in covariance.names if name in by_parameter]
    columns = np.stack([by_parameter[name] for name in known], axis=2)
    variance = np.sum((columns @ covariance.of(known).matrix) * columns, axis=(1, 2))
    return float(np.sqrt(np.mean(np.sum(whole**2, axis=1)))), float(np.sqrt(np.mean(np.maximum(variance, 0.0))))


def _inside(positions: np.ndarray, machine: Machine, effects: Sequence[Effect]) -> np.ndarray:
    """(n, axes) positions of the whole volume, brought into the ranges of the empirical effects among some."""
    found = np.array(positions)
    for i, axis in enumerate(machine.axes):
        ranges = [
            own
            for effect in effects
            if isinstance(effect, Empirical)
            for column, own in effect.ranges.items()
            if state_name(column) == axis.name
        ]
        span = np.ptp(positions[:, i])
        if ranges and span > 0.0:
            low, high = max(own[0] for own in ranges), min(own[1] for own in ranges)
            found[:, i] = low + (positions[:, i] - positions[:, i].min()) / span * (high - low)
    return found
