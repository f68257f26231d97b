"""Optimality criteria of a plan: uncertainty of the tool point, D-optimality, E-optimality, or of a few errors by name.

Each criterion gives the weight matrix M of the unknowns in `twin.planning.design`. This is that of the variance of the tool point
over the volume (L- or I-optimality), the inverse of the covariance of the machine's unknowns (D, the determinant), the projector on
the least certain direction (E), or that of the variance of a few errors by name.
"""

from __future__ import annotations

import fnmatch
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin.planning.model import PlanModel
from twin.planning.task import AIMS
from twin.uncertainty.budget import volume

POSES: Final = 300
SEED: Final = 10
"""Random seed of the poses over the volume at which the uncertainty of the tool point is evaluated."""
OPEN: Final = 0.1
"""Share of the plausible variance above which an unknown counts as unconstrained by the prior; the datum takes part of some."""


class Aim(ABC):
    """Criterion that a plan minimises."""

    name: str
    unit: str

    @abstractmethod
    def weight(self, covariance: np.ndarray) -> np.ndarray:
        """Return M (f, f), the derivative of the criterion with respect to the covariance (f, f)."""

    @abstractmethod
    def value(self, covariance: np.ndarray) -> float:
        """Return the criterion in its unit; smaller is better."""


@final
class LinearAim(Aim):
    """RMS standard uncertainty of quantities linear in the unknowns, for example of the tool point over the volume in µm.

    Args:
        derivatives: (n, k, f) with respect to the coordinates.
        name: name of the criterion.
        unit: unit of its value.
    """

    def __init__(self, derivatives: np.ndarray, name: str = "tool", unit: str = "µm") -> None:
        self.name = name
        self.unit = unit
        flat = derivatives.reshape(-1, derivatives.shape[-1])
        self._matrix = flat.T @ flat / len(derivatives)

    def weight(self, covariance: np.ndarray) -> np.ndarray:
        """See `Aim.weight`."""
        return self._matrix

    def value(self, covariance: np.ndarray) -> float:
        """See `Aim.value`."""
        return float(np.sqrt(np.sum(self._matrix * covariance)))


@final
class DOptimality(Aim):
    """D-optimality: mean logarithm of the standard uncertainties of the machine's unknowns over all directions.

    Args:
        machine: (m, f) orthonormal rows that span the machine's unknowns in the coordinates.
    """

    name = "everything"
    unit = "mean logarithm per direction"

    def __init__(self, machine: np.ndarray) -> None:
        self._machine = machine

    def weight(self, covariance: np.ndarray) -> np.ndarray:
        """See `Aim.weight`."""
        own = self._machine @ covariance @ self._machine.T
        return np.asarray(self._machine.T @ np.linalg.solve(own, self._machine))

    def value(self, covariance: np.ndarray) -> float:
        """See `Aim.value`."""
        return float(np.linalg.slogdet(self._machine @ covariance @ self._machine.T)[1]) / (2.0 * len(self._machine))


@final
class EOptimality(Aim):
    """E-optimality: largest standard uncertainty over all directions, relative to the prior.

    Args:
        machine: see `DOptimality`.
        prior: (f, f) prior precision.
    """

    name = "weakest"
    unit = "of the prior standard deviation"

    def __init__(self, machine: np.ndarray, prior: np.ndarray) -> None:
        root = np.linalg.cholesky(machine @ np.linalg.inv(prior) @ machine.T)
        self._machine = np.linalg.solve(root, machine)

    def weight(self, covariance: np.ndarray) -> np.ndarray:
        """See `Aim.weight`."""
        values, vectors = np.linalg.eigh(self._machine @ covariance @ self._machine.T)
        # Smooth maximum over the worst directions: the single worst one changes with every reading.
        power = (values / values[-1]) ** 8
        turned = vectors.T @ self._machine
        return np.asarray(turned.T @ (power[:, None] * turned))

    def value(self, covariance: np.ndarray) -> float:
        """See `Aim.value`."""
        return float(np.sqrt(np.linalg.eigvalsh(self._machine @ covariance @ self._machine.T)[-1]))


def aim_of(model: PlanModel, names: Sequence[str], tool_length_mm: float | None) -> Aim:
    """Return the criterion, restricted to the directions that the candidate readings together determine.

    Args:
        model: model of all candidate readings.
        names: see `Task.reduce`.
        tool_length_mm: tool length; None: see `PlanModel.tool_length`.

    Raises:
        InputError: no reading depends on any of the named errors.
    """
    lost = {one.name for one in model.hidden}
    # Directions that no candidate determines keep their prior variance: project them out, or they would dominate the criterion.
    silent = model.free.T @ model.determinability.spectrum.null_space
    seen = np.eye(model.free.shape[1]) - silent @ silent.T
    columns = [i for i, column in enumerate(model.unknowns.columns) if column.entity not in lost]
    own = model.plausible[columns, None] * model.free[columns]
    (first, *_) = names
    if first == "tool":
        return LinearAim(
            model.at_tool(volume(model.machine, POSES, SEED), model.tool_length(tool_length_mm), lost) @ seen
        )
    if first in AIMS:
        if first == "weakest":
            # Directions constrained by the prior stay as they are, whatever is read: leave them out.
            reach = np.einsum("ki,ij,kj->k", own, np.linalg.inv(model.prior), own)
            own = own[reach > OPEN * model.plausible[columns] ** 2] @ seen
        basis = np.linalg.svd(own, full_matrices=False)
        machine = basis.Vh[basis.S > 1e-9 * basis.S[0]]
        return DOptimality(machine) if first == "everything" else EOptimality(machine, model.prior)
    chosen = [
        k
        for k, i in enumerate(columns)
        if any(fnmatch.fnmatchcase(model.unknowns.columns[i].entity, pattern) for pattern in names)
    ]
    if not chosen:
        raise InputError(
            "no reading possible with this kit depends on these errors",
            expected="errors that readings depend on; more targets, known target positions or other stations may help",
            value=" ".join(names),
        )
    return LinearAim((own[chosen] @ seen)[None], "errors", "µm and µrad")
