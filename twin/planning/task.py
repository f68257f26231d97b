"""Task of a plan: machine, kit, time budget, and the uncertainty to minimise.

Each criterion gives the weight matrix M of the unknowns in `twin.planning.design`. This is that of the variance of the tool point
over the volume (L- or I-optimality), the inverse of the covariance of the machine's unknowns (D, the determinant), the projector on
the least certain direction (E), or that of the variance of a few errors by name.
"""

from __future__ import annotations

import fnmatch
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, final

import numpy as np

from twin._common.errors import InputError, closest_name, require_type
from twin._common.resources import Progress
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.planning.kit import MOST_FUNCTIONS, Kit, PlanModel
from twin.tool.uncertainty import volume

AIMS: Final = ("tool", "everything", "weakest")
MOST_READINGS: Final = 10_000
"""Limit of the number of readings: computing time grows with its square; a day allows some 5,000."""
NUMBERS_PER_FUNCTION: Final = 3.0
"""Coordinates read per function of a curve: two thirds of them for stations, reflectors and redundancy."""
REDUNDANT: Final = 2
"""Positions in excess of functions, for redundancy."""
LEAST_LEVELS: Final = 3 + REDUNDANT
"""Fewest positions of an axis: three functions and redundancy."""
FEWEST: Final = 12
"""Fewest readings of a plan: a station and two reflectors alone need four."""


@final
@dataclass(frozen=True)
class Task:
    """Task of a plan."""

    machine: Machine
    kit: Kit  # instruments, stations, reflectors and times
    minutes: float  # time budget, including set-up
    expected: Calibration  # expected size of the errors, for the prior
    seed: int  # random seed
    progress: Progress  # progress callback: stage and share done
    reduce: tuple[str, ...]  # uncertainty to minimise: one of `AIMS`, or names of errors (``E_*C``)
    first_round: int = 1

    @classmethod
    def of(
        cls,
        machine: Machine,
        kit: Kit | None,
        minutes: float,
        expected: Calibration | None,
        seed: int,
        progress: Progress,
        reduce: str | Sequence[str] = "tool",
    ) -> Task:
        """Return the task, by default for `Kit.default` and the machine file's calibration, or raise `InputError`."""
        require_type("machine", machine, Machine)
        names = _names_to_minimise(machine, reduce)
        own = Kit.default(machine) if kit is None else kit
        longest = MOST_READINGS * own.seconds.point / 60.0
        if not minutes <= longest:
            raise InputError(
                f"time budget for more than {MOST_READINGS} readings",
                expected=f"at most {longest:.4g} minutes, or a kit with more time per reading",
                value=minutes,
            )
        sizes = Calibration.given(machine, expected)
        return cls(machine, own, minutes, sizes, seed, progress, names)

    @cached_property
    def rng(self) -> np.random.Generator:
        """Random generator for poses and initial readings."""
        return np.random.default_rng(self.seed)

    def model(self, plan: Measurements, instrument: Instrument) -> PlanModel:
        """Return the model of an instrument's readings."""
        return PlanModel.of(self.machine, plan, self.kit.setting, instrument, self.expected, self.kit.known)

    @property
    def levels(self) -> int | None:
        """Number of positions of each axis that the plan can afford; None: no limit needed."""
        return levels_for(self.machine, self.expected_points, self.kit.coordinates_per_reading, self.expected)

    @property
    def seconds(self) -> float:
        """Time budget in seconds."""
        return 60.0 * self.minutes

    @property
    def expected_points(self) -> int:
        """Approximate number of readings, if travel takes as long as the readings."""
        return max(FEWEST, int((self.seconds - self.kit.seconds.station) / (2.0 * self.kit.seconds.point)))


def levels_for(machine: Machine, readings: int, numbers: int, expected: Calibration) -> int | None:
    """Return how many positions of each axis a plan can afford, as each adds a function to every curve; None if no limit is needed.

    It is at least the number that the expected curves need: with fewer an evaluation could not represent the machine, and no
    uncertainty would include the part left out.
    """
    functions = int(readings * numbers / (NUMBERS_PER_FUNCTION * len(machine.motion_names)))
    needed = max((len(curve.coefficients) for curve in expected.curves.values()), default=0)
    levels = max(LEAST_LEVELS, functions + REDUNDANT, needed + REDUNDANT)
    return None if levels >= MOST_FUNCTIONS + REDUNDANT else levels


def _names_to_minimise(machine: Machine, reduce: str | Sequence[str]) -> tuple[str, ...]:
    """Return the uncertainty to minimise: one of `AIMS`, or names of errors (``E_*C``) that the machine has, or raise `InputError`."""
    patterns = (reduce,) if isinstance(reduce, str) else tuple(reduce)
    if len(patterns) == 1 and patterns[0] in AIMS:
        return patterns
    names = (*machine.motion_names, *machine.squareness_names, *machine.location_names)
    for pattern in patterns or ("",):
        if not fnmatch.filter(names, pattern):
            expected = f"{', '.join(AIMS)}, or errors among {', '.join(names)}"
            meant = closest_name(pattern, (*AIMS, *names))
            raise InputError("no such uncertainty to minimise", expected=expected, value=pattern, nearest=meant)
    return patterns


# --- Optimality criteria of a plan: uncertainty of the tool point, D-optimality, E-optimality, or of a few errors by name

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
    """RMS standard uncertainty of quantities with (n, k, f) derivatives by the unknowns, such as the tool point over the volume."""

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
    """D-optimality: mean logarithm of the standard uncertainties over the span of ``machine`` (m, f), orthonormal rows."""

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
    """E-optimality: largest standard uncertainty over all directions of ``machine``, relative to the prior precision (f, f)."""

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
    """Return the criterion of ``names``, in the directions that all candidate readings determine, or raise `InputError`."""
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
