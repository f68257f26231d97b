"""Whitened nonlinear least squares, its rank judged by what is plausible, its covariance honest where the data are silent.

Every unknown is counted in its plausible size (a millimetre or milliradian for an error, `setup` for the rest). In these units a
direction in which the data say less than that is no finding: it is left where it was, and the covariance carries the plausible size
itself. That is the limit of a Gaussian prior that never pulls on what is measured (so that no residual is regularised away).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.identification.network import Network
from twin.identification.network import triangle as factor
from twin.identification.setup import SetUp
from twin.identification.unknowns import PLAUSIBLE

WEAKEST: Final = 1.0
"""Singular values below it, in plausible units, are directions the data do not see."""
UNSEEN: Final = 0.25
"""An unknown whose variance stays above this share of its plausible one has not been determined."""
FIRM: Final = 1e9
"""Weight of a condition of the datum where it stands as one more reading."""
STEPS: Final = 25
STILL: Final = 1e-4
"""A step that changes the whitened residuals by no more than this (root of the sum of squares) is the last: the errors of a machine
are small, the next step is a thousandth of it or less, and what is left 1e-7 of a standard uncertainty."""


@final
@dataclass(frozen=True)
class Solution:
    """An estimate.

    Attributes:
        theta: (columns,) µm and µrad.
        setup: stations and targets.
        triangle: (p + 1, p + 1) factor of [J | r] at the estimate.
        directions: (p, d) unknown directions (machine's and set-up's, plausible units) that the data determine.
        strength: (d,) their singular values.
        silent: (p, s) directions they do not, the datum's conditions respected.
        scale: (p,) plausible sizes.
        determined: how many numbers the readings settle: the trace of their share in the estimate.
        converged: whether the last step was still.
        steps: how many were taken.
    """

    theta: np.ndarray
    setup: SetUp
    triangle: np.ndarray
    directions: np.ndarray
    strength: np.ndarray
    silent: np.ndarray
    scale: np.ndarray
    determined: float
    converged: bool
    steps: int

    @property
    def chi2(self) -> float:
        """Sum of squared whitened residuals."""
        return float(np.sum(self.triangle[:, -1] ** 2))

    def covariance(self, *, silent: bool = True) -> np.ndarray:
        """(p, p) of all unknowns, their own units; with the plausible size of what the data do not see, or without."""
        root = self.directions / self.strength
        if silent:
            root = np.concatenate([root, self.silent], axis=1)
        root = root * self.scale[:, None]
        return np.asarray(root @ root.T)

    def rank_of(self, columns: Sequence[int], datum: np.ndarray) -> int:
        """How many directions the data see of the set-up and some of the machine's columns, the datum's conditions kept."""
        machine = datum.shape[1]
        kept = [*columns, *range(machine, len(self.scale))]
        conditions = np.zeros((len(datum), len(self.scale)))
        conditions[:, :machine] = datum
        whole = np.concatenate([self.triangle[:, :-1] * self.scale, FIRM * conditions])[:, kept]
        return int(np.count_nonzero(np.linalg.svd(whole, compute_uv=False) > WEAKEST))

    @property
    def unseen(self) -> np.ndarray:
        """(p,) share of each unknown's plausible variance that is left: near one where the data say nothing of it."""
        seen = np.sum(self.directions**2 / (self.strength**2 + 1.0), axis=1)
        return np.asarray(seen + np.sum(self.silent**2, axis=1))


def solve(
    network: Network,
    theta: np.ndarray,
    setup: SetUp,
    weight: np.ndarray,
    *,
    precision: np.ndarray | None = None,
    steps: int = STEPS,
    triangle: np.ndarray | None = None,
) -> Solution:
    """Gauss-Newton from a start that fulfils the datum's conditions.

    Args:
        network: data and model.
        theta: machine's unknowns to start from, µm and µrad.
        setup: stations and targets to start from.
        weight: (n,) of each point.
        precision: (columns,) of the machine's unknowns about zero, one over µm² or µrad² (`twin.identification.remainder`); none
            if None.
        steps: at most.
        triangle: factor of [J | r] at the start, for whoever has it; found if None.
    """
    machine = len(network.unknowns)
    scale = np.concatenate([np.full(machine, PLAUSIBLE), setup.plausible])
    free = free_directions(network.unknowns.datum, machine, len(setup))
    root = np.zeros((machine, len(scale)))
    if precision is not None:
        root[:, :machine] = np.diag(np.sqrt(precision))
    taken, converged = 0, False
    while True:
        found = factor(network, theta, setup, weight) if triangle is None else triangle
        triangle = None
        data = found[:, :-1] * scale @ free
        u, values, v = np.linalg.svd(np.concatenate([data, root * scale @ free]), full_matrices=True)
        strong = int(np.count_nonzero(values > WEAKEST))
        directions = free @ v[:strong].T
        if taken < steps:
            along = u[:, :strong].T @ np.concatenate([found[:, -1], -root[:, :machine] @ theta])
            step = (directions @ (along / values[:strong])) * scale
            theta, setup = theta + step[:machine], setup.moved(step[machine:])
            taken += 1
            converged = bool(np.linalg.norm(along) <= STILL) or bool(np.abs(step / scale).max(initial=0.0) < 1e-14)
            if not converged:
                continue
            # The last step is too small to change the derivatives: only what is left of the readings moves.
            found = np.array(found)
            found[:, -1] -= found[:, :-1] @ step
        silent = free @ v[strong:].T
        determined = float(np.sum((data @ (v[:strong].T / values[:strong])) ** 2))
        return Solution(theta, setup, found, directions, values[:strong], silent, scale, determined, converged, taken)


def free_directions(datum: np.ndarray, machine: int, setup: int) -> np.ndarray:
    """(p, p − conditions) orthonormal directions that keep the datum."""
    if len(datum) == 0:
        return np.eye(machine + setup)
    _, values, v = np.linalg.svd(datum, full_matrices=True)
    rank = int(np.count_nonzero(values > 1e-9 * values[0]))
    inside = v[rank:].T
    found = np.zeros((machine + setup, inside.shape[1] + setup))
    found[:machine, : inside.shape[1]] = inside
    found[machine:, inside.shape[1] :] = np.eye(setup)
    return found
