"""What compensation by this calibration would leave: rounding to least increments, travel that is missing, and what is not known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import locked
from twin._common.json_form import json_form
from twin.compute.parallel import Workers
from twin.kinematics.forward import rms_and_max
from twin.kinematics.inverse import Inverse, Status
from twin.report.contributions import Budget, without
from twin.uncertainty.at_tool import ToolUncertainty
from twin.uncertainty.population import Spread, draw_machines

DRAWS_A_POSE: Final = 8
"""Of what is not known: 16,000 at 2,000 poses put the 99th percentile within 2 %."""
MACHINES: Final = 1000
MACHINE_POSES: Final = 100
SHARES: Final = (0.5, 0.95, 0.99)


@final
@dataclass(frozen=True)
class Level:
    """Error of the tool point over the volume, in one case.

    Attributes:
        name: the case, in words.
        size_um: (k,) sizes, sorted.
    """

    name: str
    size_um: np.ndarray

    @property
    def rms_um(self) -> float:
        """Root mean square."""
        return float(np.sqrt(np.mean(self.size_um**2)))

    @property
    def max_um(self) -> float:
        """Largest."""
        return float(self.size_um[-1])

    def quantile(self, share: float) -> float:
        """What so many poses stay below."""
        return float(np.quantile(self.size_um, share))

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "rms_um": self.rms_um,
            "max_um": self.max_um,
            "quantiles_um": {f"{share:g}": self.quantile(share) for share in SHARES},
        }


@final
@dataclass(frozen=True)
class After:
    """Before and after.

    Attributes:
        before: as the machine is.
        bare: without what the control takes out by itself; None where it takes nothing out.
        exact: compensated, were the calibration exactly true: what rounding and travel leave; None where the machine runs no programs.
        likely: compensated, with what is not known of the calibration drawn; None where U is not known, or ``exact`` is.
        complete: whether everything that has a value has an uncertainty; if not, ``likely`` is too small.
        poses: how many were tried.
        out_of_range: of how many the correction asks for travel the axes do not have.
        out_of_range_um: what is left there at most.
        no_orientation: at how many the point is reached and the orientation is not.
        tilt_before_urad, tilt_after_urad: RMS and largest lean of the tool axis, about x and about y; after as ``exact``.
        machines: how the RMS over the volume is spread over machines that fit the calibration as well, as they are and compensated
            but for rounding; None where U is not known.
        seed: of the draws.
    """

    before: Level
    bare: Level | None
    exact: Level | None
    likely: Level | None
    complete: bool
    poses: int
    out_of_range: int
    out_of_range_um: float
    no_orientation: int
    tilt_before_urad: tuple[tuple[float, float], tuple[float, float]]
    tilt_after_urad: tuple[tuple[float, float], tuple[float, float]] | None
    machines: tuple[Spread, Spread] | None
    seed: int

    @property
    def levels(self) -> tuple[Level, ...]:
        """All cases there are, worst known last."""
        return tuple(one for one in (self.bare, self.before, self.exact, self.likely) if one is not None)

    def to_dict(self) -> dict[str, Any]:
        """For JSON; null for what is not known."""
        tilts = [tilt and {"rms": tilt[0], "max": tilt[1]} for tilt in (self.tilt_before_urad, self.tilt_after_urad)]
        spread = self.machines
        return json_form(
            {
                "poses": self.poses,
                "before": self.before,
                "without_control": self.bare,
                "compensated_if_exactly_true": self.exact,
                "compensated": self.likely,
                "compensated_complete": self.likely is not None and self.complete,
                "out_of_range": self.out_of_range,
                "out_of_range_max_um": self.out_of_range_um,
                "orientation_not_reached": self.no_orientation,
                "tilt_before_urad": tilts[0],
                "tilt_after_urad": tilts[1],
                "machines": None if spread is None else {"as_it_is_rms": spread[0], "compensated_rms": spread[1]},
                "seed": self.seed,
            }
        )


def after(found: Budget, seed: int) -> After:
    """Compensate every pose of a budget.

    The commands are those a program would get: rotary words rounded to their increment, linear ones solved for what was rounded, then
    rounded; beyond an axis's travel they stop at its end.

    Args:
        found: the budget, whose poses they are.
        seed: of the draws of what is not known.
    """
    real, q, sides = found.kinematics, found.positions, found.sides
    before = np.linalg.norm(found.error_um, axis=1)
    bare = None
    if real.calibration.corrections:
        alone = without(real, {table.name for table in real.calibration.corrections})
        off = (alone.forward(q, sides).point_mm - found.drawn().point_mm) * 1e3
        bare = _level("as the machine would be without the control's tables", off)
    exact = likely = tilt_after = spreads = None
    out = lost = 0
    worst_out = np.nan
    uncertainty = ToolUncertainty(real)
    if real.machine.runs_programs:
        commands, beyond, untold = _commanded(found)
        meant, reached = found.drawn(), real.forward(commands, sides)
        left = (reached.point_mm - meant.point_mm) * 1e3
        exact = _level("compensated, were the calibration exactly true", left)
        tilt_after = rms_and_max(reached.tilt_urad(meant))
        out, lost = int(np.count_nonzero(beyond)), int(np.count_nonzero(untold))
        if out:
            worst_out = float(np.linalg.norm(left[beyond], axis=1).max())
        if uncertainty.parameters:
            likely = _level("compensated, with what is not known", _with_doubt(left, uncertainty, q, sides, seed))
    if uncertainty.parameters:
        drawn = draw_machines(real, trials=MACHINES, poses=MACHINE_POSES, seed=seed, workers=Workers(1))
        spreads = (drawn.as_it_is[0], drawn.compensated[0])
    return After(
        before=Level("as the machine is", locked(np.sort(before))),
        bare=bare,
        exact=exact,
        likely=likely,
        complete=not uncertainty.without_uncertainty,
        poses=len(q),
        out_of_range=out,
        out_of_range_um=worst_out,
        no_orientation=lost,
        tilt_before_urad=rms_and_max(found.tilt_urad),
        tilt_after_urad=tilt_after,
        machines=spreads,
        seed=seed,
    )


def _level(name: str, error_um: np.ndarray) -> Level:
    return Level(name, locked(np.sort(np.linalg.norm(error_um, axis=1))))


def _commanded(found: Budget) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n, axes) commands as they would be written; (n,) where travel is missing; (n,) where the orientation is not reached."""
    real, q, sides = found.kinematics, found.positions, found.sides
    machine, inverse, meant = real.machine, Inverse(real), found.drawn()
    approach = sides if real.directed else None
    increment = np.array([axis.increment for axis in machine.axes])
    ranges, domains = machine.limits / machine.scale[:, None], real.calibration.domains()
    low, high = np.maximum(ranges[:, 0], domains[:, 0]), np.minimum(ranges[:, 1], domains[:, 1])
    rotary, linear = list(machine.rotary), list(machine.linear)
    first = inverse.solve(meant, q, approach=approach)
    commands = _within(first.positions, low, high)
    commands[:, rotary] = _within(np.round(commands / increment) * increment, low, high)[:, rotary]
    second = inverse.solve(meant, commands, rotary=False, approach=approach)
    commands[:, linear] = _within(np.round(second.positions / increment) * increment, low, high)[:, linear]
    beyond = second.where(Status.OUT_OF_RANGE)
    return commands, beyond, first.where(Status.SINGULAR) | first.where(Status.OUT_OF_RANGE)


def _within(commands: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return np.clip(commands, low, high)


def _with_doubt(
    left: np.ndarray, uncertainty: ToolUncertainty, q: np.ndarray, sides: np.ndarray, seed: int
) -> np.ndarray:
    """(n·draws, 3) what is left and what the calibration may be off by there: normal, with its covariance at the point."""
    covariance = uncertainty.at(q, sides).covariance[:, :3, :3]
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    drawn = np.random.default_rng(seed).standard_normal((len(q), 3, DRAWS_A_POSE))
    return np.asarray((left[:, :, None] + root @ drawn).transpose(0, 2, 1).reshape(-1, 3))
