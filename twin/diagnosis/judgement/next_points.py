"""What to measure next: points at which two causes that these data cannot tell apart would differ most.

Both are fitted to the data, each with its own set-up. Where their predictions then differ by d in readings of covariance V, one reading
adds dᵀV⁻¹d to the discrimination between them (twice the expected log-likelihood ratio; Atkinson and Fedorov 1975, T-optimality).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from twin._common.arrays import locked
from twin._common.units import MM
from twin.diagnosis.estimate.estimate import estimate
from twin.diagnosis.problem.pool import Form
from twin.diagnosis.problem.problem import Problem
from twin.identification.network import Network
from twin.machine.effects import Effect, assemble
from twin.measurement.table import state_of
from twin.uncertainty.budget import volume

POSES: Final = 400
SEED: Final = 1975
WANTED: Final = 3
APART: Final = 0.15
"""Share of the ranges two suggested poses are apart at least."""


def next_points(
    problem: Problem, form: Form, rivals: Sequence[Form], others: Sequence[Form]
) -> tuple[Mapping[str, Any], ...]:
    """Points that tell a cause from its rivals.

    Args:
        problem: the data.
        form: the cause.
        rivals: what could stand in its place.
        others: the other causes.
    """
    network = problem.network
    plan = _possible(problem)
    found: list[Mapping[str, Any]] = []
    ours = _prediction(problem, [form, *others], plan)
    for rival in rivals:
        theirs = _prediction(problem, [rival, *others], plan)
        name = f"{form.candidate.effect} {form.candidate.where}", f"{rival.candidate.effect} {rival.candidate.where}"
        if ours is None or theirs is None:
            text = f"to tell {name[0]} from {name[1]}: repeat the first round without touching the instrument or the targets"
            found.append({"separates": list(name), "text": text})
            continue
        sigma = np.sqrt(np.einsum("nii->n", network.covariance).mean() / max(network.read.sum(axis=1).mean(), 1.0))
        gain = np.sum(((ours - theirs) / sigma) ** 2, axis=1)
        for row in _apart(problem, plan.positions, gain):
            pose = {axis.name: round(float(plan.positions[row, i]), 1) for i, axis in enumerate(network.machine.axes)}
            approach = {
                axis.name: int(plan.approach[row, i])
                for i, axis in enumerate(network.machine.axes)
                if np.any(network.data.approach[:, i])
            }
            where = " ".join(f"{axis}{value:g}" for axis, value in pose.items())
            sides = " ".join(f"{axis}{'+' if sign > 0 else '−'}" for axis, sign in approach.items())
            text = (
                f"{where}, target {plan.target[row]}, station {plan.station[row]}"
                + (f", arriving {sides}" if sides else "")
                + f": tells {name[0]} from {name[1]} by {gain[row]:.2g} a point (25 is enough)"
            )
            found.append(
                {
                    "separates": list(name),
                    "pose": pose,
                    "approach": approach,
                    "target": str(plan.target[row]),
                    "station": str(plan.station[row]),
                    "expected_chi2": float(gain[row]),
                    "text": text,
                }
            )
    return tuple(found)


def _possible(problem: Problem) -> Any:
    """Poses over the whole volume, both directions, every target from every station that has seen it."""
    data, machine = problem.network.data, problem.network.machine
    rng = np.random.default_rng(SEED)
    positions = volume(machine, POSES, SEED)
    rows = rng.integers(0, len(data), POSES)
    approach = np.where(np.any(data.approach != 0, axis=0), rng.choice([-1.0, 1.0], (POSES, len(machine.axes))), 0.0)
    # Targets, time and temperatures as some measured point had them; the reading is only there to be replaced.
    some = data.select(rows)
    return replace(some, positions=locked(positions), approach=locked(approach))


def _prediction(problem: Problem, forms: Sequence[Form], plan: Any) -> np.ndarray | None:
    """(n, 3) metres: what the causes and the set-up fitted with them change at other points; None for an instrument's cause."""
    if any(form.candidate.build is None for form in forms):
        return None
    found = estimate(problem, forms)
    left = problem.residual - found.signature.sum(axis=1)
    effects = [effect for own in found.effects for effect in own]
    return _moves(problem, effects, problem.followed(left), plan)


def _moves(problem: Problem, effects: Sequence[Effect], moved: np.ndarray, plan: Any) -> np.ndarray:
    network = problem.network
    one = np.broadcast_to(np.eye(3), (len(plan), 3, 3))
    other = Network(network.machine, plan, network.instrument, network.unknowns, covariance=one)
    view = other.view(np.zeros(0), problem.setup, np.arange(len(plan)))
    by_setup = np.zeros((len(plan), 3, len(problem.setup)))
    other.by_setup(view, problem.setup, by_setup)
    frames = assemble(effects, network.machine.frames, state_of(plan, network.machine))
    errors = np.stack([np.broadcast_to(np.asarray(v, dtype=float), len(plan)) for row in frames for v in row], axis=1)
    return np.asarray(by_setup @ moved + np.einsum("nij,nj->ni", view.by_error, errors))


def _apart(problem: Problem, positions: np.ndarray, gain: np.ndarray) -> list[int]:
    span = np.maximum(np.ptp(positions, axis=0), MM)
    taken: list[int] = []
    for row in np.argsort(-gain):
        if all(np.linalg.norm((positions[row] - positions[k]) / span) > APART for k in taken):
            taken.append(int(row))
        if len(taken) == WANTED:
            break
    return taken
