"""Monte Carlo simulation: machines drawn from a calibration's covariance, evaluated over the volume (JCGM 101:2008).

Each draw is one machine with the same parameters at every pose, correlations included, evaluated with the full nonlinear kinematics.
The result is the tool point's uncertainty at every pose without linearisation and without assuming a normal distribution, a check of
whether first order is sufficient there (clause 8), and the distribution from machine to machine of the error over the volume.

Draws are divided into tasks of a fixed size with a seed each (`numpy.random.SeedSequence`, spawn key: number of the task), so that
the same seed gives identical results on any number of workers (`twin.compute.parallel`). Memory use does not grow with the number of
machines: distributions are stored as counts over fine bins.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from typing import Any, Final, final

import casadi as ca
import numpy as np
from threadpoolctl import threadpool_limits

from twin._common.arrays import read_only
from twin._common.counts import count_with_noun
from twin._common.defaults import TRIALS, VOLUME_POSES
from twin._common.errors import InputError
from twin._common.json_form import json_form
from twin._common.progress import Progress, silent
from twin._common.provenance import SourceWarning, warnings_to_json
from twin._common.units import UM
from twin.compute.batch import BatchFunction
from twin.compute.parallel import Workers, map_in_order
from twin.display import card, histogram, note, pairs, table
from twin.display.numbers import COVERAGE, COVERAGE_FACTOR
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.machine.conditions import Conditions
from twin.machine.machine import Machine
from twin.uncertainty.at_tool import DEFINITION, ToolUncertainty
from twin.uncertainty.budget import inside_domains, random_approach, volume

SCHEMA: Final = "twin.volume/1"
FEWEST_TRIALS: Final = 1000
"""With fewer machines less than 25 draws lie beyond each limit of a 95 % interval."""
MOST_TRIALS: Final = 100_000_000
MOST_POSES: Final = 5_000
"""With more poses sending the counts of a task would take longer than computing them."""
TRIALS_PER_TASK: Final = 16_384
"""Machines per task for any number of workers: about one second with 200 poses."""
ROWS_PER_STEP: Final = 65_536
"""Poses of all machines evaluated in one call: from 50,000 the kinematics are compiled (`twin.compute.native`)."""
PILOT: Final = 2_048
"""Machines of a pilot run that sets the range of the bins: fifty of them lie beyond each limit of a 95 % interval."""
BINS: Final = 512
"""Number of bins over some seven standard deviations: an interpolated quantile is within 1e-4 of a standard deviation."""
NUMERICAL_UM: Final = 1e-6
"""Rounding error of the kinematics in double precision, µm: the smallest tolerance of a comparison."""
TAIL: Final = (1.0 - COVERAGE) / 2.0

LEADING_KEYS: Final = ("machines", "seed", "as_it_is", "compensated", "without_uncertainty", "warnings")
"""Attributes that come before the poses in JSON."""
POINT: Final = 4
"""Quantities per pose: deviation from the estimated point along x, y, z, and its length."""
MEASURES: Final = ("as_it_is.rms", "as_it_is.max", "compensated.rms", "compensated.max")
"""Quantities per machine, over the poses: error relative to the nominal machine and relative to the estimated one."""


@final
@dataclass(frozen=True)
class Counts:
    """Distributions of several quantities, as counts over equal bins.

    Attributes:
        lower, upper: (n,) limits of the range of the bins.
        counts: (n, bins + 2), the first below all bins, the last above all bins.
    """

    lower: np.ndarray
    upper: np.ndarray
    counts: np.ndarray

    def quantile(self, share: float) -> np.ndarray:
        """Return the quantiles (n,), interpolated linearly within a bin; NaN outside the bins."""
        bins = self.counts.shape[1] - 2
        below = np.cumsum(self.counts, axis=1)
        wanted = share * below[:, -1]
        at = np.sum(below < wanted[:, None], axis=1)
        rows = np.arange(len(at))
        inside = (at >= 1) & (at <= bins)
        at = np.clip(at, 1, bins)
        own = np.maximum(self.counts[rows, at], 1)
        place = at - 1 + (wanted - below[rows, at - 1]) / own
        found = self.lower + (self.upper - self.lower) * place / bins
        return np.asarray(np.where(inside, found, np.nan))


@final
@dataclass(frozen=True)
class Tally:
    """Sums and counts over a number of machines.

    Attributes:
        machines: number of machines.
        point: (poses·4, bins + 2) counts of the quantities per pose.
        sums: (poses, 3) sums of the point's deviation, µm.
        squares: (poses, 3, 3) sums of its products, µm².
        measures: (4, bins + 2) counts of `MEASURES`.
        totals: (4,) sums of `MEASURES`, µm.
        largest: (4,) maxima of `MEASURES`, µm.
    """

    machines: int
    point: np.ndarray
    sums: np.ndarray
    squares: np.ndarray
    measures: np.ndarray
    totals: np.ndarray
    largest: np.ndarray

    def plus(self, other: Tally) -> Tally:
        """Return the sum of both."""
        added = {one.name: getattr(self, one.name) + getattr(other, one.name) for one in fields(self)}
        return Tally(**added | {"largest": np.maximum(self.largest, other.largest)})


@final
@dataclass(frozen=True)
class Spread:
    """Distribution of one quantity over the drawn machines, µm.

    Attributes:
        mean: mean over the machines.
        low, high: limits of the probabilistically symmetric 95 % interval.
        largest: maximum over all machines drawn.
    """

    mean: float
    low: float
    high: float
    largest: float

    def to_dict(self) -> dict[str, float]:
        """Return the JSON object."""
        return {f"{name}_um": value for name, value in asdict(self).items()}


@final
@dataclass(frozen=True)
class Population:
    """Result of a Monte Carlo simulation of machines.

    Attributes:
        axes: names, in the order of the columns of ``positions``.
        positions: (n, axes) commands, mm and degrees.
        machines: number of machines drawn.
        seed: random seed.
        first_order_um: (n,) U by first-order propagation; see `twin.uncertainty.at_tool.DEFINITION`.
        by_draws_um: (n,) radius about the estimated point that contains 95 % of the drawn points.
        standard_um: (n, 3) standard deviation of the drawn points along x, y, z of the work frame.
        bias_um: (n, 3) deviation of the mean of the drawn points from the estimated point; zero to first order.
        interval_um: (n, 3, 2) 95 % interval of the drawn points along x, y, z.
        difference_um: (n, 3) largest difference between the limits of the first-order interval and ``interval_um``.
        tolerance_um: (n, 3) numerical tolerance of the first-order u (JCGM 101, 7.9.2).
        validated: (n,) whether first order is sufficient (JCGM 101, 8.1); None if the draws are too few to decide.
        as_it_is: error of the uncompensated machines relative to the nominal machine: of its RMS and of its maximum over the poses.
        compensated: the same for the error that remains when the estimated errors are compensated exactly.
        without_uncertainty: errors with a value but no uncertainty, which are therefore the same for all machines.
        warnings: warnings about the origin of the calibration.
    """

    axes: tuple[str, ...]
    positions: np.ndarray
    machines: int
    seed: int
    first_order_um: np.ndarray
    by_draws_um: np.ndarray
    standard_um: np.ndarray
    bias_um: np.ndarray
    interval_um: np.ndarray
    difference_um: np.ndarray
    tolerance_um: np.ndarray
    validated: tuple[bool | None, ...]
    as_it_is: tuple[Spread, Spread]
    compensated: tuple[Spread, Spread]
    without_uncertainty: tuple[str, ...]
    warnings: tuple[SourceWarning, ...] = ()

    def _repr_html_(self) -> str:
        spread = [
            (words, of, f"{one.mean:.3g}", f"{one.low:.3g} … {one.high:.3g}", f"{one.largest:.3g}")
            for words, pair in (
                ("uncompensated", self.as_it_is),
                ("compensated with this calibration", self.compensated),
            )
            for of, one in zip(("RMS over the poses", "maximum over the poses"), pair, strict=True)
        ]
        u = self.by_draws_um
        place = ", ".join(f"{name} {value:.0f}" for name, value in self.where.items()).replace("-", "−")
        rows = [
            ("U by Monte Carlo", f"{np.sqrt(np.mean(u**2)):.3g} µm RMS, {u.max():.3g} µm largest at {place}"),
            ("U to first order", f"{np.sqrt(np.mean(self.first_order_um**2)):.3g} µm RMS"),
            ("first order sufficient (JCGM 101, 8.1)", _sufficiency_text(self.validated)),
            (
                "the same in all machines",
                f"{', '.join(self.without_uncertainty)} (no covariance)" if self.without_uncertainty else "",
            ),
        ]
        headers = ("machines", "error at the tool, µm", "mean", "95 % of the machines", "maximum")
        small = f"{self.machines:,} drawn at {count_with_noun(len(self.positions), 'pose')}, seed {self.seed}"
        parts = (
            pairs(rows),
            table(headers, spread, right=(2, 3, 4)),
            histogram(u, "U by Monte Carlo (µm)"),
            note(DEFINITION),
        )
        return card("Machines drawn from the calibration", *parts, small=small).text

    @property
    def where(self) -> dict[str, float]:
        """Position of the largest U by Monte Carlo, by axis."""
        row = self.positions[int(np.argmax(self.by_draws_um))]
        return dict(zip(self.axes, row.tolist(), strict=True))

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object (``schema: twin.volume/1``); the same seed gives identical text on any workers."""

        def summary(u: np.ndarray) -> dict[str, float]:
            return {"rms_um": float(np.sqrt(np.mean(u**2))), "max_um": float(u.max())}

        def spreads(pair: tuple[Spread, Spread]) -> dict[str, Any]:
            return {"rms": pair[0].to_dict(), "max": pair[1].to_dict()}

        answers = {"yes": True, "no": False, "too_few_draws": None}
        return {
            "schema": SCHEMA,
            "machines": self.machines,
            "poses": len(self.positions),
            "seed": self.seed,
            "definition": DEFINITION,
            "warnings": warnings_to_json(self.warnings),
            "without_uncertainty": list(self.without_uncertainty),
            "by_draws": summary(self.by_draws_um),
            "first_order": summary(self.first_order_um),
            "where": self.where,
            "first_order_enough": {name: self.validated.count(answer) for name, answer in answers.items()},
            "as_it_is": spreads(self.as_it_is),
            "compensated": spreads(self.compensated),
            **json_form(self, leave_out=LEADING_KEYS),
        }


@final
@dataclass(frozen=True)
class Draws:
    """Settings of a simulation, as sent to the workers.

    Attributes:
        machine, calibration, tool_length_mm, conditions: see `Kinematics`.
        positions: (n, axes) commands, mm and degrees.
        sides: (n, axes) directions of approach.
        seed: random seed.
        bins: lower and upper limits of the bins for the quantities per pose (n·4) and per machine (4); None before the pilot run.
    """

    machine: Machine
    calibration: Calibration
    tool_length_mm: float | None
    conditions: Conditions
    positions: np.ndarray
    sides: np.ndarray
    seed: int
    bins: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for pickling: the fields, without cached properties."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @cached_property
    def tool(self) -> ToolUncertainty:
        """Uncertainty of the calibration at the tool."""
        return ToolUncertainty(
            Kinematics(self.machine, self.calibration, tool_length_mm=self.tool_length_mm, conditions=self.conditions)
        )

    @cached_property
    def steps(self) -> _Steps:
        """Evaluation of machines, prepared for these poses."""
        return _Steps(self)

    def part(self, task: tuple[int, int]) -> Tally:
        """Evaluate one task.

        Args:
            task: number of the task and number of machines.
        """
        if self.bins is None:
            raise InputError("the bins are not set", expected="settings returned by `pilot`")
        count = len(self.positions)
        point = np.zeros((count * POINT, BINS + 2), dtype=np.int64)
        measures = np.zeros((len(MEASURES), BINS + 2), dtype=np.int64)
        sums, squares = np.zeros((count, 3)), np.zeros((count, 3, 3))
        totals, largest = np.zeros(len(MEASURES)), np.zeros(len(MEASURES))
        for point_um, distance_um, of_machine in self.steps.run(*task):
            for k, values in enumerate((*point_um, distance_um)):
                lower, upper = (ends.reshape(count, POINT)[:, k] for ends in self.bins[:2])
                point[k::POINT] += _binned(values, lower, upper)
            measures += _binned(of_machine, *self.bins[2:])
            sums += point_um.sum(axis=2).T
            by_pose = point_um.transpose(1, 0, 2)
            squares += by_pose @ by_pose.transpose(0, 2, 1)
            totals += of_machine.sum(axis=1)
            largest = np.maximum(largest, of_machine.max(axis=1))
        return Tally(task[1], point, sums, squares, measures, totals, largest)

    def pilot(self) -> Draws:
        """Return the settings with bins over the range of a pilot run, widened by a tenth at either end."""
        seen: list[list[np.ndarray]] = [[], [], [], []]
        for point_um, distance_um, of_machine in self.steps.run(0, PILOT):
            of_pose = np.concatenate([point_um, distance_um[None]]).transpose(1, 0, 2).reshape(-1, point_um.shape[2])
            ends = of_pose.min(axis=1), of_pose.max(axis=1), of_machine.min(axis=1), of_machine.max(axis=1)
            for found, one in zip(seen, ends, strict=True):
                found.append(one)
        low, high, least, most = (np.array(found) for found in seen)
        return replace(
            self, bins=(*_widened(low.min(axis=0), high.max(axis=0)), *_widened(least.min(axis=0), most.max(axis=0)))
        )


@final
class _Steps:
    """Evaluation of machines at all poses, in steps of bounded size."""

    def __init__(self, draws: Draws) -> None:
        self._seed = draws.seed
        self._tool = draws.tool
        kinematics = draws.tool.kinematics
        q, sides = draws.positions, draws.sides
        rates = draws.tool.rates(q, sides)
        errors = kinematics.error_frames(q, sides).reshape(len(q), -1)
        moved = {component for component, _, _ in rates}
        own = [i for i in range(errors.shape[1]) if i in moved or errors[:, i].any()]
        # One more parameter, equal to 1, for the estimate itself: the errors are then one matrix product.
        one = len(draws.tool.parameters)
        self._rates = [
            (own.index(component), [*columns, one], np.column_stack([shape * UM, errors[:, component]]))
            for component, columns, shape in rates
        ]
        self.each = max(-(-ROWS_PER_STEP // len(q)), 1)
        shape = (len(q), self.each)
        self._errors = np.empty((len(own), *shape))
        self._errors[:] = errors.T[own][:, :, None]
        commands = (q * kinematics.machine.scale).T
        self._commands = np.ascontiguousarray(np.broadcast_to(commands[:, :, None], (len(commands), *shape)))
        self._tip = BatchFunction(_tip(kinematics, own))
        nominal = Kinematics(
            kinematics.machine, Calibration.zero(kinematics.machine), tool_length_mm=kinematics.tool_length_mm
        )
        estimated = kinematics.forward(q, sides).point_mm
        self._estimated = estimated.T[:, :, None] * 1e3
        self._off = (estimated - nominal.forward(q).point_mm).T[:, :, None] * 1e3

    def run(self, task: int, machines: int) -> Any:
        """Yield per step, in µm: deviations (3, poses, k) from the estimated points, their lengths (poses, k), `MEASURES` (4, k)."""
        rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(task,)))
        for start in range(0, machines, self.each):
            count = min(self.each, machines - start)
            # Steps have a fixed size, so that a machine's results do not depend on how many follow.
            numbers = np.concatenate([self._tool.draw(rng, self.each), np.ones((1, self.each))])
            for row, columns, shape in self._rates:
                np.matmul(shape, numbers[columns], out=self._errors[row])
            flat = (len(self._errors), -1)
            (tip,) = self._tip(self._commands.reshape(len(self._commands), -1).T, self._errors.reshape(flat).T)
            point = np.ascontiguousarray(tip.T).reshape(3, -1, self.each)
            point *= 1.0 / UM
            point -= self._estimated
            point = np.ascontiguousarray(point[:, :, :count])
            squared = np.einsum("kpt,kpt->pt", point, point)
            total = point + self._off
            uncompensated = np.einsum("kpt,kpt->pt", total, total)
            of_machine = np.sqrt(
                np.stack(
                    [
                        uncompensated.mean(axis=0),
                        uncompensated.max(axis=0),
                        squared.mean(axis=0),
                        squared.max(axis=0),
                    ]
                )
            )
            yield point, np.sqrt(squared), of_machine


def draw_machines(
    kinematics: Kinematics,
    *,
    trials: int = TRIALS,
    poses: int = VOLUME_POSES,
    seed: int = 0,
    digits: int = 1,
    workers: Workers | None = None,
    progress: Progress = silent,
) -> Population:
    """Draw machines from the calibration's covariance and evaluate each over the volume.

    Args:
        kinematics: machine, calibration, tool and conditions.
        trials: number of machines.
        poses: number of poses, spread evenly over the ranges (`twin.uncertainty.budget.volume`), inside the domains of the curves; with
            random directions of approach a reversal counts as ± half its size.
        seed: random seed.
        digits: significant digits of u regarded as meaningful (JCGM 101, 7.9.2): 1 or 2.
        workers: workers for the computation; None: one process per core.
        progress: progress callback: stage and fraction done.

    Raises:
        InputError: a number outside its limits, or a calibration without covariance; see also `twin.compute.parallel.map_as_completed`.
    """
    if not FEWEST_TRIALS <= trials <= MOST_TRIALS:
        raise InputError(
            "number of machines outside its limits",
            expected=f"{FEWEST_TRIALS} … {MOST_TRIALS}",
            value=trials,
        )
    if not 1 <= poses <= MOST_POSES:
        raise InputError("number of poses outside its limits", expected=f"1 … {MOST_POSES}", value=poses)
    if seed < 0:
        raise InputError("seed must not be negative", expected="0 or more", value=seed)
    # The last digits of matrix products depend on the number of threads.
    with threadpool_limits(limits=1, user_api="blas"):
        return _drawn(kinematics, trials, poses, seed, digits, workers, progress)


def _drawn(
    kinematics: Kinematics,
    trials: int,
    poses: int,
    seed: int,
    digits: int,
    workers: Workers | None,
    progress: Progress,
) -> Population:
    calibration = kinematics.calibration
    tool = ToolUncertainty(kinematics)
    if not tool.parameters:
        raise InputError(
            "no machines can be drawn: the calibration has no uncertainties",
            expected="a calibration with a covariance, as `twin identify` writes it",
            file=calibration.path,
        )
    q = inside_domains(volume(kinematics.machine, poses), calibration)
    sides = random_approach(q)
    progress("preparing", 0.0)
    draws = Draws(
        kinematics.machine, calibration, kinematics.tool_length_mm, kinematics.conditions, q, sides, seed
    ).pilot()
    tasks = [(i, min(TRIALS_PER_TASK, trials - start)) for i, start in enumerate(range(0, trials, TRIALS_PER_TASK))]
    parts = map_in_order(Draws.part, draws, tasks, workers, name=lambda task: f"machines of task {task[0]}")
    total = next(parts)
    for part in parts:
        progress("drawing", total.machines / trials)
        total = total.plus(part)
    progress("drawing", 1.0)
    return _population(draws, total, tool, digits)


def _population(draws: Draws, total: Tally, tool: ToolUncertainty, digits: int) -> Population:
    n, trials = len(draws.positions), total.machines
    lower, upper, least, most = draws.bins  # type: ignore[misc]
    first = tool.at(draws.positions, draws.sides)
    points = Counts(lower, upper, total.point)
    interval = np.stack([points.quantile(share).reshape(n, POINT)[:, :3] for share in (TAIL, 1.0 - TAIL)], axis=2)
    # The rank of a quantile is binomially distributed: standard errors of the limits without assuming a density.
    step = np.sqrt(TAIL * (1.0 - TAIL) / trials)
    noise = np.stack(
        [
            (points.quantile(min(at + step, 1.0)) - points.quantile(max(at - step, 0.0))).reshape(n, POINT)[:, :3] / 2.0
            for at in (TAIL, 1.0 - TAIL)
        ],
        axis=2,
    )
    ends = np.abs(interval - first.standard_um[:, :, None] * np.array([-COVERAGE_FACTOR, COVERAGE_FACTOR]))
    tolerance = np.maximum(numerical_tolerance(first.standard_um, digits), NUMERICAL_UM)
    inside_domains = np.all(ends + 2.0 * noise <= tolerance[:, :, None], axis=(1, 2))
    beyond = np.any(ends - 2.0 * noise > tolerance[:, :, None], axis=(1, 2))
    mean = total.sums / trials
    variance = np.einsum("nii->ni", total.squares) / trials - mean**2
    measures = Counts(least, most, total.measures)
    low, high = measures.quantile(TAIL).tolist(), measures.quantile(1.0 - TAIL).tolist()
    spreads = [
        Spread(*values)
        for values in zip((total.totals / trials).tolist(), low, high, total.largest.tolist(), strict=True)
    ]
    return Population(
        axes=draws.machine.names,
        positions=read_only(draws.positions),
        machines=trials,
        seed=draws.seed,
        first_order_um=first.expanded_um,
        by_draws_um=read_only(points.quantile(COVERAGE).reshape(n, POINT)[:, 3].copy()),
        standard_um=read_only(np.sqrt(np.maximum(variance, 0.0) * trials / (trials - 1.0))),
        bias_um=read_only(mean),
        interval_um=read_only(interval),
        difference_um=read_only(ends.max(axis=2)),
        tolerance_um=read_only(tolerance),
        validated=tuple(
            True if good else False if bad else None for good, bad in zip(inside_domains, beyond, strict=True)
        ),
        as_it_is=(spreads[0], spreads[1]),
        compensated=(spreads[2], spreads[3]),
        without_uncertainty=tool.without_uncertainty,
        warnings=draws.calibration.warnings,
    )


def _tip(kinematics: Kinematics, own: list[int]) -> ca.Function:
    """Return the function (q, some components of the error frames) → tip, metres and radians; other components are zero."""
    machine = kinematics.machine
    q, some = ca.SX.sym("q", len(machine.axes)), ca.SX.sym("e", len(own))
    errors = ca.SX.zeros(6 * len(machine.frames))
    for row, component in enumerate(own):
        errors[component] = some[row]
    point, _ = kinematics.tip_and_axis_with(q, errors)
    return ca.Function("tip", [q, some], [ca.densify(point)])


def _widened(lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a range widened by a tenth at either end, and at least by `NUMERICAL_UM`."""
    more = np.maximum(0.1 * (upper - lower), NUMERICAL_UM)
    return lower - more, upper + more


def _binned(values: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Return the counts (n, bins + 2) of values (n, k)."""
    width = BINS + 2
    place = (values - lower[:, None]) * (BINS / (upper - lower))[:, None]
    np.clip(place, -1.0, BINS, out=place)
    place += 1.0
    found = np.floor(place, out=place).astype(np.int64)
    found += width * np.arange(len(values))[:, None]
    return np.bincount(found.reshape(-1), minlength=width * len(values)).reshape(len(values), width)


def _sufficiency_text(validated: Sequence[bool | None]) -> str:
    """Return as text at how many poses first order is sufficient."""
    counts = {
        "yes": validated.count(True),
        "no": validated.count(False),
        "too few draws to decide": validated.count(None),
    }
    return ", ".join(f"{words} at {count_with_noun(count, 'pose')}" for words, count in counts.items() if count)


def numerical_tolerance(standard: np.ndarray, digits: int) -> np.ndarray:
    """Return δ of JCGM 101, 7.9.2: with u = c·10^l, where the integer c has ``digits`` digits, δ = ½·10^l.

    Args:
        standard: standard uncertainty u, any shape.
        digits: significant digits, 1 or 2.
    """
    safe = np.where(standard > 0.0, standard, 1.0)
    power = np.floor(np.log10(safe)) - (digits - 1)
    power += np.round(safe / 10.0**power) >= 10.0**digits  # 0.996 is 1.0 to two digits
    return np.asarray(np.where(standard > 0.0, 0.5 * 10.0**power, 0.0))
