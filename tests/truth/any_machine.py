"""The truth machines of the benchmark: their interface, and the DMU 50 of `tests.truth.hidden`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import final

import numpy as np

from tests.scored_cases.plan import Plan, TruthAxis
from tests.truth import hidden
from tests.truth.hidden import Hidden
from tests.truth.machine import AXES, RANGES

SHIFTS = ("thermal_growth", "thermal_drift", "thermal_lag", "spindle_growth")
"""Effects that shift the tool side along a direction of the base."""
SPEEDS = (0.0, 6000.0, 12000.0, 3000.0, 0.0, 9000.0, 12000.0, 0.0)
"""Spindle speeds, rpm, one after the other for equal times."""


class TruthMachine(ABC):
    """A machine in plain numpy that measures itself.

    Attributes:
        name: name of the machine in the benchmark.
        axes: in command order.
        bundled: name of its machine file, if that comes with `twin`.
        sigma_mm: standard deviation of a measured coordinate.
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

    def readings(self, plan: Plan, effects: Sequence[Hidden] = (), moved: np.ndarray | None = None) -> np.ndarray:
        """Return (n, 3) the readings of a perfect instrument, mm.

        Args:
            plan: what is measured.
            effects: known effects.
            moved: (n, 3) a shift of each target in the base, mm.
        """
        total = np.zeros((len(plan), 3)) if moved is None else moved
        # Shifts of the tool side and errors of the instrument are the same on every machine.
        rest = [effect for effect in effects if effect.effect not in (*SHIFTS, "affine_scale")]
        total = sum((_shift(plan, effect) for effect in effects if effect.effect in SHIFTS), total)
        read = self._readings(plan, rest, total)
        for effect in effects:
            if effect.effect == "affine_scale":
                rows = plan.round == effect.where.removeprefix("round ")
                # About the middle of the readings: an instrument is realigned in every round.
                read = read + rows[:, None] * ((read - read[rows].mean(axis=0)) @ _affine(effect))
        return read

    @abstractmethod
    def _readings(self, plan: Plan, effects: Sequence[Hidden], moved: np.ndarray) -> np.ndarray:
        """See `readings`."""

    @abstractmethod
    def set_up(self, plan: Plan) -> np.ndarray:
        """Return (3n, k) the change of the readings with the pose of each station and the place of each target."""

    @abstractmethod
    def carried(self, plan: Plan, vector: np.ndarray) -> np.ndarray:
        """Return (n, 3) in the base: a vector that is fixed to the side of each row's target."""

    @abstractmethod
    def direction(self, axis: str) -> np.ndarray:
        """Return (3,) in the base: the direction in which a linear axis moves its side, all axes at zero."""

    @abstractmethod
    def places(self, plan: Plan) -> np.ndarray:
        """Return (n, 3) each row's target in the frame of its side, mm."""

    def left_over(self, plan: Plan, change: np.ndarray) -> np.ndarray:
        """Return (3n,) a change of the readings in standard deviations of the noise, without what the set-up absorbs.

        Args:
            plan: what is measured.
            change: (n, 3) mm.
        """
        basis = absorbed(self, plan)
        scaled = change.reshape(-1) / self.sigma_mm
        return np.asarray(scaled - basis @ (basis.T @ scaled))

    def noncentrality(self, plan: Plan, change: np.ndarray) -> float:
        """Return λ of a change of the readings: its chi² without what the set-up absorbs."""
        return float(np.sum(self.left_over(plan, change) ** 2))


def spindle(time_s: np.ndarray) -> dict[str, np.ndarray]:
    """Return the column ``spindle_rpm``: the spindle speed up to each reading."""
    return {"spindle_rpm": np.array(SPEEDS)[(np.linspace(0.0, len(SPEEDS) - 1e-9, len(time_s))).astype(int)]}


def _shift(plan: Plan, effect: Hidden) -> np.ndarray:
    """Return (n, 3) mm shift of the tool side along a direction of the base, as a function of time, temperature or speed."""
    v = effect.numbers
    direction, _, sensor = effect.where.partition(" by ")
    if effect.effect == "thermal_drift":
        shape = v["amplitude"] * (1.0 - np.exp(-plan.time_s / v["time_constant"]))
    elif effect.effect == "spindle_growth":
        speed = plan.channels["spindle_rpm"]
        driven = (speed / speed.max()) ** v["exponent"]
        shape = v["amplitude"] * lagged(plan.time_s, driven, v["time_constant"], 0.0)
    elif effect.effect == "thermal_growth":
        shape = v["coefficient"] * (plan.warm[sensor] - 20.0)
    else:
        warm = plan.warm[sensor] - 20.0
        shape = v["coefficient"] * lagged(plan.time_s, warm, v["time_constant"], float(warm[0]))
    return np.outer(1e-3 * shape * (plan.carrier == "tool"), np.eye(3)["XYZ".index(direction)])


def lagged(time_s: np.ndarray, values: np.ndarray, constant: float, start: float) -> np.ndarray:
    """Return (n,) the first-order lag of values, with the mean of two neighbours in between.

    Args:
        time_s: (n,) increasing.
        values: (n,) the input.
        constant: time constant, s.
        start: initial value.
    """
    found = np.full(len(values), start)
    follows = 1.0 - np.exp(-np.diff(time_s) / constant)
    for i, share in enumerate(follows, start=1):
        found[i] = found[i - 1] + share * (0.5 * (values[i] + values[i - 1]) - found[i - 1])
    return found


def _affine(effect: Hidden) -> np.ndarray:
    """Return (3, 3) symmetric: scales (ppm) and shears (µrad, the change of a right angle) of an instrument."""
    v = effect.numbers
    shears = np.array([[0.0, v["shear_xy"], v["shear_xz"]], [0.0, 0.0, v["shear_yz"]], [0.0] * 3])
    return 1e-6 * (np.diag([v["scale_x"], v["scale_y"], v["scale_z"]]) + 0.5 * (shears + shears.T))


@lru_cache(maxsize=2)
def absorbed(machine: TruthMachine, plan: Plan) -> np.ndarray:
    """Return (3n, r) an orthonormal basis of the changes that the set-up absorbs."""
    columns = machine.set_up(plan)
    q, r = np.linalg.qr(columns / np.linalg.norm(columns, axis=0))
    # Columns may be dependent: a shift of all targets equals one of their station.
    u, values, _ = np.linalg.svd(r)
    return np.asarray(q @ u[:, values > 1e-7 * values[0]])


@final
class Dmu50(TruthMachine):
    """The DMU 50 with its calibration's errors, which the method knows: `tests.truth.hidden` with its plan.

    Args:
        stops: number of stops of each axis's run.
        poses: number of poses of all axes per round.
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
        return Plan(
            self.axes, p.q, p.approach, p.target, p.carrier, p.station, p.round, p.time_s, p.warm, spindle(p.time_s)
        )

    def _readings(self, plan: Plan, effects: Sequence[Hidden], moved: np.ndarray) -> np.ndarray:
        return hidden.points(_hidden(plan), effects, outside=lambda _: moved)

    def set_up(self, plan: Plan) -> np.ndarray:
        return hidden.set_up(_hidden(plan))

    def carried(self, plan: Plan, vector: np.ndarray) -> np.ndarray:
        return hidden.turned(_hidden(plan), np.broadcast_to(vector, (len(plan), 3)))

    def direction(self, axis: str) -> np.ndarray:
        return np.asarray(np.eye(3)["XYZ".index(axis)])

    def places(self, plan: Plan) -> np.ndarray:
        return np.array([hidden.TARGETS[name][1] for name in plan.target])


def _hidden(plan: Plan) -> hidden.Plan:
    return hidden.Plan(plan.q, plan.approach, plan.target, plan.station, plan.round, plan.time_s, plan.warm)
