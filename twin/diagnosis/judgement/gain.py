"""The gain of the extended calibration as written: on all readings, on held-out readings, and at the tool."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from twin.diagnosis.judgement.extend import EmpiricalExtension
from twin.diagnosis.judgement.held_out import held_out
from twin.diagnosis.judgement.sizes import SizedCauses
from twin.diagnosis.problem.nuisance import setup_basis
from twin.diagnosis.problem.problem import Problem, in_um, rms, unwhiten
from twin.diagnosis.result import Gain, Unexplained
from twin.identification.network import Network
from twin.identification.solve import solve
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.machine.effects import Effect
from twin.machine.effects.empirical import Empirical, channel_name
from twin.machine.machine import Machine
from twin.measurement.state import machine_state
from twin.measurement.table import Measurements
from twin.numerics.covariance import Covariance
from twin.uncertainty.budget import volume

LARGEST_UM: Final = 1e5
"""Error at the tool above which none is stated: small rotations and compliances do not describe a machine that is 100 mm off."""
DEFAULT_TOOL_MM: Final = 100.0
"""Tool length assumed if the machine file has none."""


def gain(
    sized: SizedCauses,
    residuals: tuple[np.ndarray, np.ndarray],
    left: Unexplained | None,
    empirical_extension: EmpiricalExtension | None,
) -> Gain:
    """Return the gain of the extended calibration.

    Args:
        sized: the causes with their sizes.
        residuals: (n, 3) µm with the given and with the extended calibration.
        left: the unexplained residuals.
        empirical_extension: the empirical effects fitted to them; None if not requested.
    """
    network, problem = sized.found.problem.network, sized.found.problem
    held = held_out(sized, () if empirical_extension is None else empirical_extension.written)
    effects, covariance = sized.effects, sized.covariance
    # Errors that are not in the file remain: causes that are not promised, and unexplained residuals.
    stays = [
        float(np.nansum(in_um(problem.network, sized.estimate.signature[:, k]) ** 2) / len(network.data))
        for k, own in enumerate(sized.promised)
        if not own
    ]
    size = 0.0 if left is None or not left.depends_on else left.size_um
    unseen = 0.0
    if empirical_extension is not None and empirical_extension.effects:
        effects = [*effects, *empirical_extension.effects]
        covariance, size = (
            Covariance.of_blocks([covariance, empirical_extension.covariance]),
            empirical_extension.left_um,
        )
        # The true pattern is larger than the most likely one by its uncertainty, so that is part of the machine's error too.
        unseen = error_at_tool(
            network.data, network.machine, empirical_extension.effects, empirical_extension.covariance
        )[1]
    moved, doubt = error_at_tool(network.data, network.machine, effects, covariance)
    rest = sum(stays) + 3.0 * size**2
    before, after = residuals
    return Gain(
        rms(before, network.read),
        rms(after, network.read),
        held,
        *_plausible(np.sqrt(moved**2 + unseen**2 + rest), np.sqrt(doubt**2 + rest)),
        tool_length_of(network.machine),
    )


def _plausible(before: float, after: float) -> tuple[float, float]:
    """Return the errors at the tool before and after; both NaN if either is larger than the model describes."""
    known = max(before, after) <= LARGEST_UM
    return (float(before), float(after)) if known else (float("nan"), float("nan"))


def residuals_as_written(
    problem: Problem, extended: Calibration, instrument: np.ndarray, root: np.ndarray
) -> np.ndarray:
    """Return the (n, 3) residuals in µm with a calibration as written, the set-up refitted; NaN where no coordinate was measured.

    Args:
        problem: the data.
        extended: the calibration.
        instrument: (3n,) whitened effect of the instrument errors found, subtracted from the readings first.
        root: (n, 3, 3) square root of the covariance by the discrepancy, metres, for the weights of the set-up.
    """
    network = problem.network.with_discrepancy(root)
    as_written = Network(
        network.machine,
        network.data,
        network.instruments,
        network.unknowns,
        extended,
        network.covariance,
        check=False,
    )
    setup = solve(as_written, np.zeros(0), problem.setup, np.ones(len(network.data))).setup
    columns = np.empty((len(setup) + 1, len(network.data), 3))
    for chunk in as_written.chunks(np.zeros(0), setup):
        columns[:, chunk.rows] = chunk.columns
    columns[:-1] *= setup.plausible[:, None, None]
    *_, residual = flat = columns.reshape(len(columns), -1)
    moved = unwhiten(problem.network, instrument.reshape(-1, 3)[:, :, None])
    residual -= (network.whitening @ moved).reshape(-1)
    basis, _ = setup_basis(flat[:-1].T)
    return in_um(as_written, residual - basis @ (basis.T @ residual))


def tool_length_of(machine: Machine) -> float:
    """Return the machine file's tool length, or `DEFAULT_TOOL_MM`: with zero length a rotation about the spindle nose has no effect."""
    return machine.tool_length_mm or DEFAULT_TOOL_MM


def error_at_tool(
    data: Measurements, machine: Machine, effects: Sequence[Effect], covariance: Covariance
) -> tuple[float, float]:
    """Return the RMS error at the tool over the volume with the given and with the extended calibration, on the extended machine.

    With the given calibration the effects themselves remain, to first order; with the extended one their uncertainty. The volume is
    limited to the ranges of empirical effects.

    Args:
        data: the measurements, for their temperatures and times.
        machine: the machine.
        effects: the effects found.
        covariance: of their parameters.
    """
    if not effects:
        return 0.0, 0.0
    positions = _inside(volume(machine, 400), machine, effects)
    rng = np.random.default_rng(16907)
    sides = rng.choice([-1.0, 1.0], (len(machine.axes), len(positions)))
    rows = rng.integers(0, len(data), len(positions))
    measured = machine_state(data, machine)
    state: dict[str, Any] = {name: values[rows] for name, values in measured.items()}
    state |= {f"approach_{name}": own for name, own in zip(machine.names, sides, strict=True)}
    state |= {axis.name: positions[:, i] for i, axis in enumerate(machine.axes)}
    at_tip = Kinematics(machine, Calibration.zero(machine), tool_length_mm=tool_length_of(machine))
    by_error = at_tip.sensitivities(positions).error[:, :3]
    index = {(frame.axis, frame.role): 6 * i for i, frame in enumerate(machine.frames)}

    def moved(effect: Effect, own: Mapping[int, Any]) -> np.ndarray:
        at, found = index[effect.frame.axis, effect.frame.role], np.zeros((len(positions), 3))
        for i, value in own.items():
            # Effects that depend on earlier readings were evaluated on all readings in their order.
            values = np.asarray(value, dtype=float)[rows] if effect.history else np.asarray(value, dtype=float)
            found += by_error[:, :, at + i] * np.broadcast_to(values, len(positions))[:, None]
        return found

    states = [measured if effect.history else state for effect in effects]
    whole = np.sum([moved(one, one.components(own)) for one, own in zip(effects, states, strict=True)], axis=0)
    by_parameter: dict[str, np.ndarray] = {}
    for effect, own in zip(effects, states, strict=True):
        for parameter, derivative in zip(effect.parameters, effect.derivatives(own), strict=True):
            # Effects in several frames share the parameters of an added load.
            by_parameter[parameter.name] = by_parameter.get(parameter.name, 0.0) + moved(effect, derivative)
    known = [name for name in covariance.names if name in by_parameter]
    columns = np.stack([by_parameter[name] for name in known], axis=2)
    variance = np.sum((columns @ covariance.of(known).matrix) * columns, axis=(1, 2))
    return float(np.sqrt(np.mean(np.sum(whole**2, axis=1)))), float(np.sqrt(np.mean(np.maximum(variance, 0.0))))


def _inside(positions: np.ndarray, machine: Machine, effects: Sequence[Effect]) -> np.ndarray:
    """Return (n, axes) positions of the volume, scaled into the ranges of the empirical effects."""
    found = np.array(positions)
    for i, axis in enumerate(machine.axes):
        ranges = [
            own
            for effect in effects
            if isinstance(effect, Empirical)
            for column, own in effect.ranges.items()
            if channel_name(column) == axis.name
        ]
        span = np.ptp(positions[:, i])
        if ranges and span > 0.0:
            low, high = max(own[0] for own in ranges), min(own[1] for own in ranges)
            found[:, i] = low + (positions[:, i] - positions[:, i].min()) / span * (high - low)
    return found
