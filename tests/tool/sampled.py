"""Monte Carlo uncertainty of the tool point from sorted draws, pose by pose (JCGM 101:2008), as a reference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from twin._common.units import MM, UM
from twin.compute.along import BatchFunction
from twin.display.numbers import COVERAGE, COVERAGE_FACTOR
from twin.tool.population import NUMERICAL_UM, numerical_tolerance
from twin.tool.uncertainty import ToolUncertainty


@final
@dataclass(frozen=True)
class Sampled:
    """Monte Carlo result for n poses.

    Attributes:
        mean: (n, 6) mean deviation from the estimated pose, µm and µrad; zero to first order.
        covariance: (n, 6, 6) covariance of the deviation, µm and µrad.
        interval_um: (n, 3, 2) probabilistically symmetric 95 % interval of the point's deviation along x, y, z.
        radius_um: (n,) radius about the estimated point that contains 95 % of the drawn points.
        tolerance_um: (n, 3) numerical tolerance δ (JCGM 101, 7.9.2) of u_x, u_y, u_z by first order.
        difference_um: (n, 3) difference between the limits of the first-order interval, ± 1.96 u, and ``interval_um``.
        validated: (n,) whether every difference is within its tolerance (JCGM 101, 8.1); None if the trials are too few: twice the
            standard error of an interval's limit would change the answer.
    """

    mean: np.ndarray
    covariance: np.ndarray
    interval_um: np.ndarray
    radius_um: np.ndarray
    tolerance_um: np.ndarray
    difference_um: np.ndarray
    validated: tuple[bool | None, ...]


def sampled(
    tool: ToolUncertainty,
    positions: Any,
    rng: np.random.Generator,
    trials: int = 10_000,
    *,
    digits: int = 1,
    approach: Any = None,
) -> Sampled:
    """Draw the calibration's parameters and evaluate the kinematics for each; every pose has its own draws."""
    q = tool.kinematics.check(positions)
    sides = np.zeros(q.shape) if approach is None else np.atleast_2d(np.asarray(approach, dtype=float))
    found = [
        _summary(_deviations(tool, row[None], side[None], rng, trials), u, digits)
        for row, side, u in zip(q, sides, tool.at(q, sides).standard_um, strict=True)
    ]
    *arrays, validated = zip(*found, strict=True)
    return Sampled(*(np.array(one) for one in arrays), validated)


def _deviations(
    tool: ToolUncertainty, q: np.ndarray, side: np.ndarray, rng: np.random.Generator, trials: int
) -> np.ndarray:
    """Return deviations (trials, 6) of the pose from the estimated one, µm and µrad."""
    kinematics = tool.kinematics
    numbers = tool.draw(rng, trials)
    drawn = np.tile(kinematics.error_frames(q, side)[0].reshape(-1), (trials, 1))
    for component, columns, shape in tool.rates(q, side):
        drawn[:, component] += (shape[0] @ numbers[columns]) * UM
    own = (q * kinematics.machine.scale)[0]
    rotation, reached = BatchFunction(kinematics.chain)(own, drawn, np.array([kinematics.tool_length_mm * MM]))
    estimate = kinematics.forward(q, side)
    turn = rotation.reshape(-1, 3, 3).transpose(0, 2, 1) @ estimate.rotation[0].T
    # The sine replaces the angle: a relative error of 1e-6 at 2 mrad.
    sine = np.stack(
        [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=1
    )
    return np.concatenate([(reached / MM - estimate.point_mm[0]) * 1e3, 0.5e6 * sine], axis=1)


def _summary(deviation: np.ndarray, standard: np.ndarray, digits: int) -> tuple[Any, ...]:
    """Return the values of `Sampled` for one pose from its deviations (trials, 6) and its first-order u (3,)."""
    trials = len(deviation)
    distance = np.sort(np.linalg.norm(deviation[:, :3], axis=1))
    ordered = np.sort(deviation[:, :3], axis=0)
    tail = (1.0 - COVERAGE) / 2.0
    low = round(trials * tail)  # JCGM 101, 7.7.2: ranks r and r + pM
    high = low + round(trials * COVERAGE)
    interval = ordered[[low - 1, high - 1]].T
    # The rank of a quantile is binomially distributed: standard errors of the limits without assuming a density.
    step = round(np.sqrt(trials * tail * (1.0 - tail)))
    noise = np.stack(
        [(ordered[min(at + step, trials - 1)] - ordered[max(at - step, 0)]) / 2.0 for at in (low - 1, high - 1)], axis=1
    )
    tolerance = np.maximum(numerical_tolerance(standard, digits), NUMERICAL_UM)
    ends = np.abs(interval - standard[:, None] * np.array([-COVERAGE_FACTOR, COVERAGE_FACTOR]))
    within = np.all(ends + 2.0 * noise <= tolerance[:, None])
    beyond = np.any(ends - 2.0 * noise > tolerance[:, None])
    return (
        deviation.mean(axis=0),
        np.cov(deviation.T),
        interval,
        distance[round(trials * COVERAGE) - 1],
        tolerance,
        ends.max(axis=1),
        True if within else False if beyond else None,
    )
