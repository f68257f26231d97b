"""What a plan makes small: the tool point's uncertainty, everything, the weakest direction, or a few errors by name.

Each gives M, which weighs the unknowns in `twin.planning.design`: the tool point's variance over the volume (L- or I-optimality), the
inverse of the machine's own covariance (D, the determinant), the projector on the worst direction (E), or a few errors by name.
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
"""Of the poses over the volume at which the tool point is asked for."""
OPEN: Final = 0.1
"""Share of the plausible variance from which nothing holds an unknown beforehand: the datum takes part of some."""


class Aim(ABC):
    """What a plan is to make small."""

    name: str
    unit: str

    @abstractmethod
    def weight(self, covariance: np.ndarray) -> np.ndarray:
        """(f, f) M: derivative of what is aimed at by the covariance (f, f)."""

    @abstractmethod
    def value(self, covariance: np.ndarray) -> float:
        """What is aimed at, in a unit that says something; smaller is better."""


@final
class AtTool(Aim):
    """RMS standard uncertainty of the tool point over the volume, µm; or of anything else that is linear in the unknowns.

    Args:
        derivatives: (n, k, f) by the coordinates.
        name: of the aim.
        unit: of its value.
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
class Everything(Aim):
    """D-optimality: the mean logarithm of the machine's own standard uncertainties in all directions.

    Args:
        machine: (m, f) the machine's unknowns as directions among the coordinates, orthonormal rows.
    """

    name = "everything"
    unit = "in logarithm, a direction"

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
class Weakest(Aim):
    """E-optimality: the standard uncertainty of the direction known worst, as a share of what was plausible before.

    Args:
        machine: as of `Everything`.
        prior: (f, f) precision before any reading.
    """

    name = "weakest"
    unit = "of what is plausible"

    def __init__(self, machine: np.ndarray, prior: np.ndarray) -> None:
        root = np.linalg.cholesky(machine @ np.linalg.inv(prior) @ machine.T)
        self._machine = np.linalg.solve(root, machine)

    def weight(self, covariance: np.ndarray) -> np.ndarray:
        """See `Aim.weight`."""
        values, vectors = np.linalg.eigh(self._machine @ covariance @ self._machine.T)
        # The few worst together: the single worst one changes with every reading.
        power = (values / values[-1]) ** 8
        turned = vectors.T @ self._machine
        return np.asarray(turned.T @ (power[:, None] * turned))

    def value(self, covariance: np.ndarray) -> float:
        """See `Aim.value`."""
        return float(np.sqrt(np.linalg.eigvalsh(self._machine @ covariance @ self._machine.T)[-1]))


def aim_of(model: PlanModel, names: Sequence[str], tool_length_mm: float | None) -> Aim:
    """What is to become small, of what the readings together can determine at all.

    Args:
        model: of every reading that could be taken.
        names: as of `Task.wanted`.
        tool_length_mm: of the tool whose point is meant; as of `PlanModel.tool_length` if None.

    Raises:
        InputError: no reading depends on any of the errors named.
    """
    lost = {one.name for one in model.hidden}
    # What no candidate shows stays as uncertain as it is, in whatever it moves: it must not drown what can be made small.
    silent = model.free.T @ model.told.spectrum.null_space
    seen = np.eye(model.free.shape[1]) - silent @ silent.T
    columns = [i for i, column in enumerate(model.unknowns.columns) if column.entity not in lost]
    own = model.plausible[columns, None] * model.free[columns]
    (first, *_) = names
    if first == "tool":
        return AtTool(model.at_tool(volume(model.machine, POSES, SEED), model.tool_length(tool_length_mm), lost) @ seen)
    if first in AIMS:
        if first == "weakest":
            # What is held to be small anyway stays as it is held, however much is read.
            reach = np.einsum("ki,ij,kj->k", own, np.linalg.inv(model.prior), own)
            own = own[reach > OPEN * model.plausible[columns] ** 2] @ seen
        basis = np.linalg.svd(own, full_matrices=False)
        machine = basis.Vh[basis.S > 1e-9 * basis.S[0]]
        return Everything(machine) if first == "everything" else Weakest(machine, model.prior)
    wanted = [
        k
        for k, i in enumerate(columns)
        if any(fnmatch.fnmatchcase(model.unknowns.columns[i].entity, pattern) for pattern in names)
    ]
    if not wanted:
        raise InputError(
            "nothing measured with this kit shows it",
            expected="an error that some reading depends on: known places of the targets, more of them, other stations",
            value=" ".join(names),
        )
    return AtTool((own[wanted] @ seen)[None], "errors", "µm and µrad")
