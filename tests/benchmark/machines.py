"""The truth machines: what the benchmark asks of one, and the DMU 50 of `tests.hidden`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import final

import numpy as np

from tests import hidden
from tests.benchmark.plan import Plan, TruthAxis
from tests.hidden import Hidden
from tests.truth import AXES, RANGES


class TruthMachine(ABC):
    """A machine in plain numpy that measures itself.

    Attributes:
        name: of the machine in the benchmark.
        axes: in command order.
        bundled: name of its machine file, if that comes with `twin`.
        sigma_mm: standard deviation of a coordinate that is read.
        squareness, locations: names of the constants that it may have.
        drooping: rotary axes whose cradle may droop.
        loaded: axes along which gravity acts with a load that varies.
    """

    name: str
    axes: tuple[TruthAxis, ...]
    bundled: str = ""
    sigma_mm: float = 3e-3
    squareness: tuple[str, ...] = ()
    locations: tuple[str, ...] = ()
    drooping: tuple[str, ...] = ()
    loaded: tuple[str, ...] = ()

    def write_machine(self, folder: Path) -> Path:
        """Write its machine file and URDF into a folder, unless it is bundled; return the machine file."""
        raise NotImplementedError

    @abstractmethod
    def plan(self, rng: np.random.Generator) -> Plan:
        """Draw what is measured."""

    @abstractmethod
    def readings(self, plan: Plan, effects: Sequence[Hidden] = (), moved: np.ndarray | None = None) -> np.ndarray:
        """(n, 3) what a perfect instrument reads, mm.

        Args:
            plan: what is measured.
            effects: known effects.
            moved: (n, 3) a shift of each target in the base, mm.
        """

    @abstractmethod
    def set_up(self, plan: Plan) -> np.ndarray:
        """(3n, k) how the readings change with the pose of each station and the place of each target."""

    @abstractmethod
    def carried(self, plan: Plan, vector: np.ndarray) -> np.ndarray:
        """(n, 3) in the base: a vector that is fixed to the side of each row's target."""

    @abstractmethod
    def direction(self, axis: str) -> np.ndarray:
        """(3,) in the base: where a linear axis moves its side, all axes at zero."""

    def left_over(self, plan: Plan, change: np.ndarray) -> np.ndarray:
        """(3n,) a change of the readings in standard deviations of the noise, less what the set-up absorbs.

        Args:
            plan: what is measured.
            change: (n, 3) mm.
        """
        basis = _absorbed(self, plan)
        scaled = change.reshape(-1) / self.sigma_mm
        return np.asarray(scaled - basis @ (basis.T @ scaled))

    def noncentrality(self, plan: Plan, change: np.ndarray) -> float:
        """λ of a change of the readings: chi² of what the set-up leaves of it."""
        return float(np.sum(self.left_over(plan, change) ** 2))


@lru_cache(maxsize=2)
def _absorbed(machine: TruthMachine, plan: Plan) -> np.ndarray:
    """(3n, r) orthonormal basis of what the set-up absorbs."""
    columns = machine.set_up(plan)
    q, r = np.linalg.qr(columns / np.linalg.norm(columns, axis=0))
    # Some columns may be the same change: all targets together move as their station does.
    u, values, _ = np.linalg.svd(r)
    return np.asarray(q @ u[:, values > 1e-7 * values[0]])


@final
class Dmu50(TruthMachine):
    """The DMU 50 with its calibration's errors, which the method knows: `tests.hidden` with its plan.

    Args:
        stops: of each axis's run.
        poses: of all axes, a round.
    """

    name = bundled = "dmu50"
    axes = tuple(
        TruthAxis(a, a in "XYZ", *RANGES[a], side="tool" if a in "XYZ" else "work", endless=a == "C") for a in AXES
    )
    squareness = ("E_C0Y", "E_B0Z", "E_A0Z")
    locations = tuple(f"E_{letter}0{axis}" for axis in "BC" for letter in "XYAB")
    drooping = ("B",)
    loaded = ("B",)

    def __init__(self, stops: int = 13, poses: int = 390) -> None:
        self._stops, self._poses = stops, poses

    def plan(self, rng: np.random.Generator) -> Plan:
        p = hidden.rounded(hidden.plan(rng, stops=self._stops, poses=self._poses))
        return Plan(self.axes, p.q, p.approach, p.target, p.carrier, p.station, p.round, p.time_s, p.warm)

    def readings(self, plan: Plan, effects: Sequence[Hidden] = (), moved: np.ndarray | None = None) -> np.ndarray:
        return hidden.points(_hidden(plan), effects, outside=None if moved is None else lambda _: moved)

    def set_up(self, plan: Plan) -> np.ndarray:
        return hidden.set_up(_hidden(plan))

    def carried(self, plan: Plan, vector: np.ndarray) -> np.ndarray:
        return hidden.turned(_hidden(plan), np.broadcast_to(vector, (len(plan), 3)))

    def direction(self, axis: str) -> np.ndarray:
        return np.asarray(np.eye(3)["XYZ".index(axis)])


def _hidden(plan: Plan) -> hidden.Plan:
    return hidden.Plan(plan.q, plan.approach, plan.target, plan.station, plan.round, plan.time_s, plan.warm)
