"""What a curve may still hold beyond the orders chosen for it.

Held-out error says which functions pay; it does not say that the others are zero. Taking them as zero makes intervals that miss
(on the thesis's plan 95 % intervals then cover 68 %). So the functions beyond are kept, as Gaussian with mean zero and a variance
that goes on falling by `FALL` a function from the curve's own size, which is estimated from all its coefficients together (EM;
Dempster, Laird and Rubin 1977). The chosen functions themselves are free: nothing pulls on what the data show.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from twin.identification.orders import Choice
from twin.identification.solve import Solution, free_directions
from twin.identification.unknowns import PLAUSIBLE, Unknowns

FALL: Final = 0.7
"""Ratio of variances from one orthonormal function to the next: gentler than a smooth curve's, which it does not assert."""
SWEEPS: Final = 30
FREE: Final = 1.0
"""Precision of what is free: its plausible size, which decides nothing that the data see."""


def remainder_precision(unknowns: Unknowns, solution: Solution, choice: Choice) -> np.ndarray:
    """(columns,) precision of each unknown about zero, one over µm² or µrad²; zero for what is free.

    Args:
        unknowns: of the largest model.
        solution: its estimate.
        choice: the functions each curve keeps.
    """
    machine = len(unknowns)
    free = free_directions(unknowns.datum, machine, len(solution.setup))
    triangle = solution.triangle[:, :-1] * solution.spectrum.scale
    normal = free.T @ (triangle.T @ triangle) @ free
    here = np.concatenate([solution.theta / PLAUSIBLE, np.zeros(len(solution.setup))])
    pull = free.T @ (triangle.T @ (solution.triangle[:, -1] + triangle @ here))
    own = {curve.name: np.array(unknowns.of(curve.name)) for curve in unknowns.curves}
    beyond = {
        curve.name: own[curve.name][max(choice.counts[curve.name] - curve.first, 0) :] for curve in unknowns.curves
    }
    fall = {name: FALL ** np.arange(len(columns)) for name, columns in own.items()}
    size = {name: (0.01) ** 2 for name in own}
    precision = np.full(len(here), FREE)
    for _ in range(SWEEPS):
        for name, columns in own.items():
            prior = 1.0 / (size[name] * fall[name] + 1e-18)
            precision[beyond[name]] = prior[len(columns) - len(beyond[name]) :]
        spread = np.linalg.inv(normal + free.T @ (precision[:, None] * free))
        mean = free @ (spread @ pull)
        variance = np.sum((free @ spread) * free, axis=1)
        for name, columns in own.items():
            # One less than there are: the size itself was estimated from them.
            size[name] = float(np.sum((mean[columns] ** 2 + variance[columns]) / fall[name])) / max(len(columns) - 1, 1)
    found = np.zeros(machine)
    for columns in beyond.values():
        found[columns] = precision[columns] / PLAUSIBLE**2
    return found
