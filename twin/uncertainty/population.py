"""What a million machines like this one would show: machines drawn from a calibration's covariance, over the volume.

Each draw is one whole machine: the same numbers at every pose, correlations included, each run through the whole nonlinear chain
(JCGM 101:2008). That gives the tool point's uncertainty at every pose without first order and without a normal error, whether first
order was enough there (its clause 8), and what no first order gives: how the error over the volume is spread from machine to machine.

The draws are cut into tasks of a fixed size with a seed each (`numpy.random.SeedSequence`, spawn key: number of the task), so that the
same seed gives the same bits on any number of workers, wherever they are (`twin.compute.parallel`). Memory does not grow with the
number of machines: distributions are kept as counts over fine bins.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from typing import Any, Final, final

import casadi as ca
import numpy as np
from threadpoolctl import threadpool_limits

from twin._common.arrays import locked
from twin._common.errors import InputError
from twin._common.json_form import json_form
from twin._common.provenance import SourceWarning, to_json
from twin._common.units import MM, UM
from twin.compute.batch import BatchFunction
from twin.compute.parallel import Workers, in_order
from twin.display import card, histogram, note, pairs, several, table
from twin.display.numbers import COVERAGE, COVERAGE_FACTOR
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.machine.conditions import Conditions
from twin.machine.machine import Machine
from twin.uncertainty.at_tool import DEFINITION, ToolUncertainty
from twin.uncertainty.budget import drawn_sides, volume, within

SCHEMA: Final = "twin.volume/1"
TRIALS: Final = 100_000
FEWEST_TRIALS: Final = 1000
"""Fewer leave under 25 draws beyond each end of a 95 % interval."""
MOST_TRIALS: Final = 100_000_000
POSES: Final = 200
MOST_POSES: Final = 5_000
"""More would make the counts of a task larger than the work of sending them is worth."""
TRIALS_A_TASK: Final = 16_384
"""Machines a task, whatever the number of workers: with 200 poses about a second of work."""
ROWS_A_STEP: Final = 65_536
"""Poses of all machines evaluated in one call: from 50,000 the chain is compiled (`twin.compute.native`)."""
PILOT: Final = 2_048
"""Machines drawn beforehand, between whose extremes the bins lie: fifty of them are beyond each end of a 95 % interval."""
BINS: Final = 512
"""Some seven standard deviations in 512 bins: read off by straight lines, a quantile is within 1e-4 of a standard deviation."""
NUMERICAL_UM: Final = 1e-6
"""What double precision leaves of a chain metres long, µm: no endpoint is compared more closely."""
TAIL: Final = (1.0 - COVERAGE) / 2.0

LED: Final = ("machines", "seed", "as_it_is", "compensated", "without_uncertainty", "warnings")
"""What stands before the poses in JSON."""
POINT: Final = 4
"""Quantities kept a pose: deviation from the estimated point along x, y, z, and its length."""
MEASURES: Final = ("as_it_is.rms", "as_it_is.max", "compensated.rms", "compensated.max")
"""Quantities kept a machine: over the poses, the error against the machine as drawn and against the estimated one."""


@final
@dataclass(frozen=True)
class Counts:
    """Distributions of several quantities, as counts over even bins.

    Attributes:
        lower, upper: (n,) ends of the bins.
        counts: (n, bins + 2), the first of what lies below all bins, the last of what lies above.
    """

    lower: np.ndarray
    upper: np.ndarray
    counts: np.ndarray

    def quantile(self, share: float) -> np.ndarray:
        """(n,) by straight lines within a bin; NaN where it lies beyond the bins."""
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
    """What a number of machines adds.

    Attributes:
        machines: how many.
        point: (poses·4, bins + 2) counts of the quantities of a pose.
        sums: (poses, 3) of the point's deviation, µm.
        squares: (poses, 3, 3) of its products, µm².
        measures: (4, bins + 2) counts of `MEASURES`.
        totals: (4,) their sums, µm.
        largest: (4,) µm.
    """

    machines: int
    point: np.ndarray
    sums: np.ndarray
    squares: np.ndarray
    measures: np.ndarray
    totals: np.ndarray
    largest: np.ndarray

    def plus(self, other: Tally) -> Tally:
        """Both together."""
        added = {one.name: getattr(self, one.name) + getattr(other, one.name) for one in fields(self)}
        return Tally(**added | {"largest": np.maximum(self.largest, other.largest)})


@final
@dataclass(frozen=True)
class Spread:
    """How one number is spread over the drawn machines, µm.

    Attributes:
        mean: over the machines.
        low, high: ends of the probabilistically symmetric 95 % interval.
        largest: of all machines drawn.
    """

    mean: float
    low: float
    high: float
    largest: float

    def to_dict(self) -> dict[str, float]:
        """For JSON."""
        return {f"{name}_um": value for name, value in asdict(self).items()}


@final
@dataclass(frozen=True)
class Population:
    """What the drawn machines show.

    Attributes:
        axes: names, in the order of the columns of ``positions``.
        positions: (n, axes) commands, mm and degrees.
        machines: how many were drawn.
        seed: of the draws.
        first_order_um: (n,) U by first order; see `twin.uncertainty.at_tool.DEFINITION`.
        by_draws_um: (n,) radius within which 95 % of the drawn points lie of the estimated one.
        standard_um: (n, 3) standard deviation of the drawn points along x, y, z of the work frame.
        bias_um: (n, 3) how far the mean of the drawn points is from the estimated one: what first order takes as zero.
        interval_um: (n, 3, 2) 95 % interval of the drawn points along x, y, z.
        difference_um: (n, 3) by how much the ends of the first order interval miss those of ``interval_um``.
        tolerance_um: (n, 3) numerical tolerance of the first order u (JCGM 101, 7.9.2).
        validated: of every pose whether first order was enough (JCGM 101, 8.1); None where the draws are too few to tell.
        as_it_is: error of the machines against the machine as drawn, uncompensated: of its RMS and of its maximum over the poses.
        compensated: the same of what is left where the estimated errors are compensated exactly.
        without_uncertainty: what has a value and no uncertainty, and is therefore the same for all machines.
        warnings: of where the calibration's numbers come from.
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
            for words, pair in (("as they are", self.as_it_is), ("as the calibration leaves them", self.compensated))
            for of, one in zip(("RMS over the poses", "largest of the poses"), pair, strict=True)
        ]
        u = self.by_draws_um
        place = ", ".join(f"{name} {value:.0f}" for name, value in self.where.items()).replace("-", "−")
        rows = [
            ("U by draws", f"{np.sqrt(np.mean(u**2)):.3g} µm RMS, {u.max():.3g} µm largest at {place}"),
            ("U by first order", f"{np.sqrt(np.mean(self.first_order_um**2)):.3g} µm RMS"),
            ("first order enough (JCGM 101, 8.1)", enough(self.validated)),
            (
                "alike in all machines",
                f"{', '.join(self.without_uncertainty)} (no covariance)" if self.without_uncertainty else "",
            ),
        ]
        headers = ("machines", "error at the tool, µm", "mean", "95 % of the machines", "largest of all")
        small = f"{self.machines:,} drawn at {several(len(self.positions), 'pose')}, seed {self.seed}"
        parts = (
            pairs(rows),
            table(headers, spread, right=(2, 3, 4)),
            histogram(u, "U by draws (µm)"),
            note(DEFINITION),
        )
        return card("Machines drawn from the calibration", *parts, small=small).text

    @property
    def where(self) -> dict[str, float]:
        """Position of the largest U by draws, by axis."""
        row = self.positions[int(np.argmax(self.by_draws_um))]
        return dict(zip(self.axes, row.tolist(), strict=True))

    def to_dict(self) -> dict[str, Any]:
        """For JSON: the same bits for the same seed, on any workers."""

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
            "warnings": to_json(self.warnings),
            "without_uncertainty": list(self.without_uncertainty),
            "by_draws": summary(self.by_draws_um),
            "first_order": summary(self.first_order_um),
            "where": self.where,
            "first_order_enough": {name: self.validated.count(answer) for name, answer in answers.items()},
            "as_it_is": spreads(self.as_it_is),
            "compensated": spreads(self.compensated),
            **json_form(self, leave_out=LED),
        }


@final
@dataclass(frozen=True)
class Draws:
    """How machines are drawn: all that a worker needs to know.

    Attributes:
        machine, calibration, tool_length_mm, conditions: as of `Kinematics`.
        positions: (n, axes) commands, mm and degrees.
        sides: (n, axes) the sides the axes come from.
        seed: of all draws.
        bins: of the quantities of a pose (n·4) and of a machine (4), lower and upper ends; None while they are being sought.
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
        """For a pickle: the attributes, not what was made of them here."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @cached_property
    def tool(self) -> ToolUncertainty:
        """The calibration's uncertainty at the tool."""
        return ToolUncertainty(
            Kinematics(self.machine, self.calibration, tool_length_mm=self.tool_length_mm, conditions=self.conditions)
        )

    @cached_property
    def steps(self) -> _Steps:
        """The chain, made ready for these poses."""
        return _Steps(self)

    def part(self, task: tuple[int, int]) -> Tally:
        """One task.

        Args:
            task: its number, and how many machines.
        """
        if self.bins is None:
            raise InputError("draws without bins", expected="those of `pilot`")
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
        """With bins, between the extremes of the first machines and a tenth beyond."""
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
    """Machines at all poses, some at a time."""

    def __init__(self, draws: Draws) -> None:
        self._seed = draws.seed
        self._tool = draws.tool
        kinematics = draws.tool.kinematics
        q, sides = draws.positions, draws.sides
        rates = draws.tool.rates(q, sides)
        errors = kinematics.error_frames(q, sides).reshape(len(q), -1)
        moved = {component for component, _, _ in rates}
        own = [i for i in range(errors.shape[1]) if i in moved or errors[:, i].any()]
        # One more number, which is 1, for the estimate itself: errors are one product.
        one = len(draws.tool.parameters)
        self._rates = [
            (own.index(component), [*columns, one], np.column_stack([shape * UM, errors[:, component]]))
            for component, columns, shape in rates
        ]
        self.each = max(-(-ROWS_A_STEP // len(q)), 1)
        shape = (len(q), self.each)
        self._errors = np.empty((len(own), *shape))
        self._errors[:] = errors.T[own][:, :, None]
        commands = (q * kinematics.machine.scale).T
        self._commands = np.ascontiguousarray(np.broadcast_to(commands[:, :, None], (len(commands), *shape)))
        self._tip = BatchFunction(_tip(kinematics, own))
        as_drawn = Kinematics(
            kinematics.machine, Calibration.zero(kinematics.machine), tool_length_mm=kinematics.tool_length_mm
        )
        estimated = kinematics.forward(q, sides).point_mm
        self._estimated = estimated.T[:, :, None] * 1e3
        self._off = (estimated - as_drawn.forward(q).point_mm).T[:, :, None] * 1e3

    def run(self, task: int, machines: int) -> Any:
        """Of each step the (3, poses, k) deviations from the estimated points, their (poses, k) lengths, and (4, k) `MEASURES`; µm."""
        rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(task,)))
        for start in range(0, machines, self.each):
            count = min(self.each, machines - start)
            # Always as many at once: a machine is the same machine, to the last bit, however many follow.
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
    poses: int = POSES,
    seed: int = 0,
    digits: int = 1,
    workers: Workers | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Population:
    """Draw machines from the calibration's covariance and run each over the volume.

    Args:
        kinematics: machine, calibration, tool and conditions.
        trials: machines.
        poses: spread evenly over the ranges (`twin.uncertainty.budget.volume`), as far as the curves are defined; a reversal counts
        as ± half
            its size, drawn with a seed.
        seed: of the draws.
        digits: significant digits of u taken as meaningful (JCGM 101, 7.9.2): 1 or 2.
        workers: who does it; None for one process a core.
        progress: called with a stage and the fraction done.

    Raises:
        InputError: numbers out of place; a calibration without covariance; as `twin.compute.parallel.finished`.
    """
    if not FEWEST_TRIALS <= trials <= MOST_TRIALS:
        raise InputError(
            "a number of machines out of place",
            expected=f"at least {FEWEST_TRIALS}, at most {MOST_TRIALS}",
            value=trials,
        )
    if not 1 <= poses <= MOST_POSES:
        raise InputError("a number of poses out of place", expected=f"1 … {MOST_POSES}", value=poses)
    if seed < 0:
        raise InputError("the seed is negative", expected="0 or more", value=seed)
    # The factor of a covariance and first order have other last digits with another number of threads.
    with threadpool_limits(limits=1, user_api="blas"):
        return _drawn(kinematics, trials, poses, seed, digits, workers, progress or (lambda stage, fraction: None))


def _drawn(
    kinematics: Kinematics,
    trials: int,
    poses: int,
    seed: int,
    digits: int,
    workers: Workers | None,
    say: Callable[[str, float], None],
) -> Population:
    calibration = kinematics.calibration
    tool = ToolUncertainty(kinematics)
    if not tool.parameters:
        raise InputError(
            "nothing to draw from: how uncertain its errors are is unknown",
            expected="a calibration with a covariance, as `twin identify` writes it",
            file=calibration.path,
        )
    q = within(volume(kinematics.machine, poses), calibration)
    sides = drawn_sides(q)
    say("preparing", 0.0)
    draws = Draws(
        kinematics.machine, calibration, kinematics.tool_length_mm, kinematics.conditions, q, sides, seed
    ).pilot()
    tasks = [(i, min(TRIALS_A_TASK, trials - start)) for i, start in enumerate(range(0, trials, TRIALS_A_TASK))]
    parts = in_order(Draws.part, draws, tasks, workers, name=lambda task: f"machines of task {task[0]}")
    total = next(parts)
    for part in parts:
        say("drawing", total.machines / trials)
        total = total.plus(part)
    say("drawing", 1.0)
    return _population(draws, total, tool, digits)


def _population(draws: Draws, total: Tally, tool: ToolUncertainty, digits: int) -> Population:
    n, trials = len(draws.positions), total.machines
    lower, upper, least, most = draws.bins  # type: ignore[misc]
    first = tool.at(draws.positions, draws.sides)
    points = Counts(lower, upper, total.point)
    interval = np.stack([points.quantile(share).reshape(n, POINT)[:, :3] for share in (TAIL, 1.0 - TAIL)], axis=2)
    # The rank of a quantile is binomial: the ends' standard error without assuming a density.
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
    within = np.all(ends + 2.0 * noise <= tolerance[:, :, None], axis=(1, 2))
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
        positions=locked(draws.positions),
        machines=trials,
        seed=draws.seed,
        first_order_um=first.expanded_um,
        by_draws_um=locked(points.quantile(COVERAGE).reshape(n, POINT)[:, 3].copy()),
        standard_um=locked(np.sqrt(np.maximum(variance, 0.0) * trials / (trials - 1.0))),
        bias_um=locked(mean),
        interval_um=locked(interval),
        difference_um=locked(ends.max(axis=2)),
        tolerance_um=locked(tolerance),
        validated=tuple(True if good else False if bad else None for good, bad in zip(within, beyond, strict=True)),
        as_it_is=(spreads[0], spreads[1]),
        compensated=(spreads[2], spreads[3]),
        without_uncertainty=tool.without_uncertainty,
        warnings=draws.calibration.warnings,
    )


def _tip(kinematics: Kinematics, own: list[int]) -> ca.Function:
    """(q, those components of the error frames) → tip, metres and radians; the other components are zero."""
    machine = kinematics.machine
    q, some = ca.SX.sym("q", len(machine.axes)), ca.SX.sym("e", len(own))
    errors = ca.SX.zeros(6 * len(machine.frames))
    for row, component in enumerate(own):
        errors[component] = some[row]
    _, point = kinematics.chain(q, errors, kinematics.tool_length_mm * MM)
    return ca.Function("tip", [q, some], [ca.cse(point)])


def _widened(lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A tenth more either way; what does not vary needs some width too."""
    more = np.maximum(0.1 * (upper - lower), NUMERICAL_UM)
    return lower - more, upper + more


def _binned(values: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """(n, bins + 2) counts of (n, k) values."""
    width = BINS + 2
    place = (values - lower[:, None]) * (BINS / (upper - lower))[:, None]
    np.clip(place, -1.0, BINS, out=place)
    place += 1.0
    found = np.floor(place, out=place).astype(np.int64)
    found += width * np.arange(len(values))[:, None]
    return np.bincount(found.reshape(-1), minlength=width * len(values)).reshape(len(values), width)


def enough(validated: Sequence[bool | None]) -> str:
    """At how many poses first order was enough, in words."""
    told = {"yes": validated.count(True), "no": validated.count(False), "too few draws to tell": validated.count(None)}
    return ", ".join(f"{words} at {several(count, 'pose')}" for words, count in told.items() if count)


def numerical_tolerance(standard: np.ndarray, digits: int) -> np.ndarray:
    """δ of JCGM 101, 7.9.2: u is written c·10^l with so many digits in the whole number c; δ = ½·10^l.

    Args:
        standard: u, any shape.
        digits: significant digits, 1 or 2.
    """
    safe = np.where(standard > 0.0, standard, 1.0)
    power = np.floor(np.log10(safe)) - (digits - 1)
    power += np.round(safe / 10.0**power) >= 10.0**digits  # 0.996 is 1.0 to two digits
    return np.asarray(np.where(standard > 0.0, 0.5 * 10.0**power, 0.0))
