"""Monte Carlo simulation: machines drawn from a calibration's covariance, evaluated over the volume (JCGM 101:2008).

Each draw is one machine with the same parameters at every pose, correlations included, evaluated with the full nonlinear kinematics.
The result is the tool point's uncertainty at every pose without linearisation and without assuming a normal distribution, a check of
whether first order is sufficient there (clause 8), and the distribution from machine to machine of the error over the volume.

Draws are divided into tasks of a fixed size with a seed each (`numpy.random.SeedSequence`, spawn key: number of the task), so that
the same seed gives identical results on any number of workers (`twin.compute.parallel`). Memory use does not grow with the number of
machines: distributions are stored as counts over fine bins.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Final, final

import casadi as ca
import numpy as np

from twin._common.arrays import read_only
from twin._common.bundled import TRIALS, VOLUME_POSES
from twin._common.errors import InputError
from twin._common.provenance import SourceWarning, warnings_to_json
from twin._common.records import json_form
from twin._common.resources import Progress, one_blas_thread, silent
from twin._common.units import UM, count_with_noun
from twin.compute.along import BatchFunction
from twin.compute.native.compiler import equal_portions
from twin.compute.parallel import Workers, map_in_order
from twin.display.numbers import COVERAGE, COVERAGE_FACTOR
from twin.display.results import Result
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions
from twin.tool.forward import Kinematics
from twin.tool.uncertainty import DEFINITION, ToolUncertainty, inside_domains, random_approach, volume

BINS: Final = 512
"""Number of bins over some seven standard deviations: an interpolated quantile is within 1e-4 of a standard deviation."""
MEASURES: Final = ("as_it_is.rms", "as_it_is.max", "compensated.rms", "compensated.max")
"""Quantities per machine, over the poses: error relative to the nominal machine and relative to the estimated one."""


@final
@dataclass(frozen=True)
class Counts:
    """Distributions of several quantities, as counts over equal bins."""

    lower: np.ndarray  # lower, upper: limits of the range of the bins, any shape
    upper: np.ndarray
    counts: np.ndarray  # (…, bins + 2), the first below all bins, the last above all bins

    def quantile(self, share: float) -> np.ndarray:
        """Return the quantiles, interpolated linearly within a bin; NaN outside the bins."""
        bins = self.counts.shape[-1] - 2
        below = np.cumsum(self.counts, axis=-1)
        wanted = share * below[..., -1:]
        at = np.sum(below < wanted, axis=-1, keepdims=True)
        inside = (at >= 1) & (at <= bins)
        at = np.clip(at, 1, bins)
        own, before = (np.take_along_axis(*one, axis=-1) for one in ((self.counts, at), (below, at - 1)))
        place = (at - 1 + (wanted - before) / np.maximum(own, 1))[..., 0]
        found = self.lower + (self.upper - self.lower) * place / bins
        return np.asarray(np.where(inside[..., 0], found, np.nan))


@final
@dataclass(frozen=True)
class Tally:
    """Sums and counts over a number of machines."""

    machines: int
    point: np.ndarray  # (4, poses, bins + 2) counts of the deviation of the point along x, y, z, and of its length
    sums: np.ndarray  # (poses, 3) sums of the point's deviation, µm
    squares: np.ndarray  # (poses, 3, 3) sums of its products, µm²
    measures: np.ndarray  # (4, bins + 2) counts of `MEASURES`
    totals: np.ndarray  # (4,) sums of `MEASURES`, µm
    largest: np.ndarray  # (4,) maxima of `MEASURES`, µm

    def plus(self, other: Tally) -> Tally:
        """Return the sum of both."""
        added = {one.name: getattr(self, one.name) + getattr(other, one.name) for one in fields(self)}
        return Tally(**added | {"largest": np.maximum(self.largest, other.largest)})


def binned(values: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Return the counts (…, bins + 2) of values (…, k) over equal bins from ``lower`` to ``upper`` (…)."""
    width, shape = BINS + 2, lower.shape
    scale = BINS / (upper - lower)
    # The first bin is 0, and places are positive: a conversion to integers rounds them down.
    place = values * scale[..., None]
    place += (1.0 - lower * scale)[..., None]
    np.clip(place, 0.0, BINS + 1.0, out=place)
    found = place.astype(np.intp)
    found += width * np.arange(lower.size).reshape(shape)[..., None]
    return np.bincount(found.reshape(-1), minlength=width * lower.size).reshape(*shape, width)


# --- Machines drawn from a calibration's covariance and evaluated at the poses of the volume, in tiles that fit the cache of

PILOT: Final = 2_048
"""Machines of a pilot run that sets the range of the bins: fifty of them lie beyond each limit of a 95 % interval."""
MACHINES_PER_STEP: Final = 1024
"""Machines drawn and evaluated together, at some poses at a time."""
ROWS_PER_TILE: Final = 16_384
"""Poses of all machines evaluated in one call: few enough for the cache of a core, enough to make the cost of the calls small."""
NUMERICAL_UM: Final = 1e-6
"""Rounding error of the kinematics in double precision, µm: the smallest tolerance of a comparison."""
POINT: Final = 4
"""Quantities per pose: deviation from the estimated point along x, y, z, and its length."""
See = Callable[[slice, np.ndarray], None]
"""Function of some of the poses (p) and of the deviations there (4, p, k), µm."""


@final
@dataclass(frozen=True)
class Draws:
    """Settings of a simulation, as sent to the workers."""

    machine: Machine  # machine, calibration, tool_length_mm, conditions: see `Kinematics`
    calibration: Calibration
    tool_length_mm: float | None
    conditions: Conditions
    positions: np.ndarray  # (n, axes) commands, mm and degrees
    sides: np.ndarray  # (n, axes) directions of approach
    seed: int
    # lower and upper limits of the bins for the quantities per pose (4, n) and per machine (4); None before the pilot run
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
        """Evaluate one task: its number and its number of machines."""
        if self.bins is None:
            raise InputError("the bins are not set", expected="settings returned by `pilot`")
        lower, upper, least, most = self.bins
        count = len(self.positions)
        point = np.zeros((POINT, count, BINS + 2), dtype=np.int64)
        sums, squares = np.zeros((count, 3)), np.zeros((count, 3, 3))

        def see(tile: slice, values: np.ndarray) -> None:
            point[:, tile] += binned(values, lower[:, tile], upper[:, tile])
            by_pose = np.ascontiguousarray(values[:3].transpose(1, 0, 2))
            sums[tile] += by_pose.sum(axis=2)
            squares[tile] += by_pose @ by_pose.transpose(0, 2, 1)

        of_machine = self.steps.run(*task, see)
        measures = binned(of_machine, least, most)
        return Tally(task[1], point, sums, squares, measures, of_machine.sum(axis=1), of_machine.max(axis=1))

    def pilot(self) -> Draws:
        """Return the settings with bins over the range of a pilot run, widened by a tenth at either end."""
        ends = np.full((2, POINT, len(self.positions)), [[[np.inf]], [[-np.inf]]])

        def see(tile: slice, values: np.ndarray) -> None:
            ends[0, :, tile] = np.minimum(ends[0, :, tile], values.min(axis=2))
            ends[1, :, tile] = np.maximum(ends[1, :, tile], values.max(axis=2))

        of_machine = self.steps.run(0, PILOT, see)
        return replace(self, bins=(*_widened(*ends), *_widened(of_machine.min(axis=1), of_machine.max(axis=1))))


@final
class _Steps:
    """Evaluation of machines at all poses, in tiles: some machines at some poses."""

    def __init__(self, draws: Draws) -> None:
        self._seed, self._tool = draws.seed, draws.tool
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
        self._fixed = [(k, errors[:, i, None]) for k, i in enumerate(own) if i not in moved]
        self._components = len(own)
        self._commands = (q * kinematics.machine.scale).T
        self._tip = BatchFunction(_tip(kinematics, own))
        nominal = Kinematics(
            kinematics.machine, Calibration.zero(kinematics.machine), tool_length_mm=kinematics.tool_length_mm
        )
        estimated = kinematics.forward(q, sides).point_mm
        self._estimated = estimated.T[:, :, None] * 1e3
        self._off = (estimated - nominal.forward(q).point_mm).T[:, :, None] * 1e3
        # Nearly equal tiles: none is too small for the compiled kinematics.
        ends = np.linspace(0, len(q), max(len(q) * MACHINES_PER_STEP // ROWS_PER_TILE, 1) + 1).round().astype(int)
        self._tiles = [slice(a, b) for a, b in pairwise(ends.tolist())]

    def run(self, task: int, machines: int, see: See) -> np.ndarray:
        """Return `MEASURES` (4, machines), µm; task and seed determine the machines, and ``see`` is called for every tile."""
        rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(task,)))
        found = []
        with equal_portions(len(self._tiles) * -(-machines // MACHINES_PER_STEP)):
            for start in range(0, machines, MACHINES_PER_STEP):
                count = min(MACHINES_PER_STEP, machines - start)
                # Steps have a fixed size, so that a machine's results do not depend on how many follow.
                numbers = np.concatenate([self._tool.draw(rng, MACHINES_PER_STEP), np.ones((1, MACHINES_PER_STEP))])
                found.append(self._step(numbers, count, see))
        return np.concatenate(found, axis=1)

    def _step(self, numbers: np.ndarray, count: int, see: See) -> np.ndarray:
        """Evaluate the first ``count`` of machines given by their parameters (parameters + 1, k)."""
        chosen = [numbers[columns] for _, columns, _ in self._rates]
        sums, most = np.zeros((2, count)), np.zeros((2, count))
        for tile in self._tiles:
            values, uncompensated = self._deviations(tile, chosen, count)
            for i, squared in enumerate((uncompensated, values[3])):
                sums[i] += squared.sum(axis=0)
                np.maximum(most[i], squared.max(axis=0), out=most[i])
            np.sqrt(values[3], out=values[3])
            see(tile, values)
        mean = sums / self._commands.shape[1]
        return np.sqrt(np.stack([mean[0], most[0], mean[1], most[1]]))

    def _deviations(self, tile: slice, chosen: list[np.ndarray], count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return deviations from the estimated points and their squared lengths (4, p, k), and squares of the whole error (p, k)."""
        commands, poses = self._commands[:, tile], tile.stop - tile.start
        errors = np.empty((self._components, poses, MACHINES_PER_STEP))
        for (row, _, shape), some in zip(self._rates, chosen, strict=True):
            np.matmul(shape[tile], some, out=errors[row])
        for row, fixed in self._fixed:
            errors[row] = fixed[tile]
        (tip,) = self._tip(np.repeat(commands, MACHINES_PER_STEP, axis=1).T, errors.reshape(self._components, -1).T)
        values = np.empty((POINT, poses, count))
        point = values[:3]
        np.multiply(tip.T.reshape(3, poses, -1)[:, :, :count], 1.0 / UM, out=point)
        point -= self._estimated[:, tile]
        np.einsum("kpt,kpt->pt", point, point, out=values[3])
        whole = point + self._off[:, tile]
        return values, np.einsum("kpt,kpt->pt", whole, whole)


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


SCHEMA: Final = "twin.volume/1"
FEWEST_TRIALS: Final = 1000
"""With fewer machines less than 25 draws lie beyond each limit of a 95 % interval."""
MOST_TRIALS: Final = 100_000_000
MOST_POSES: Final = 5_000
"""With more poses sending the counts of a task would take longer than computing them."""
TRIALS_PER_TASK: Final = 16_384
"""Machines per task for any number of workers: about one second with 200 poses."""
TAIL: Final = (1.0 - COVERAGE) / 2.0
UNDECIDED: Final = 3.5
"""Standard errors of an interval's limit within which first order is neither sufficient nor insufficient. A pose has six limits, and
their standard errors are estimates: with two, one pose in four was called insufficient where first order is exact."""

LEADING_KEYS: Final = (
    *("machines", "seed", "as_it_is", "compensated"),
    *("without_uncertainty", "warnings", "not_identified", "identified_um"),
)
"""Attributes that come before the poses in JSON."""


@final
@dataclass(frozen=True)
class Spread:
    """Distribution of one quantity over the drawn machines, µm."""

    mean: float  # mean over the machines
    low: float  # low, high: limits of the probabilistically symmetric 95 % interval
    high: float
    largest: float  # maximum over all machines drawn

    def to_dict(self) -> dict[str, float]:
        """Return the JSON object."""
        return {f"{name}_um": value for name, value in asdict(self).items()}


@final
@dataclass(frozen=True, repr=False)
class Population(Result):
    """Result of a Monte Carlo simulation of machines."""

    axes: tuple[str, ...]  # names, in the order of the columns of ``positions``
    positions: np.ndarray  # (n, axes) commands, mm and degrees
    machines: int
    seed: int
    first_order_um: np.ndarray  # (n,) U by first-order propagation; see `twin.tool.uncertainty.DEFINITION`
    by_draws_um: np.ndarray  # (n,) radius about the estimated point that contains 95 % of the drawn points
    standard_um: np.ndarray  # (n, 3) standard deviation of the drawn points along x, y, z of the work frame
    # (n, 3) deviation of the mean of the drawn points from the estimated point; zero to first order
    bias_um: np.ndarray
    interval_um: np.ndarray  # (n, 3, 2) 95 % interval of the drawn points along x, y, z
    # (n, 3) largest difference between the limits of the first-order interval and ``interval_um``
    difference_um: np.ndarray
    tolerance_um: np.ndarray  # (n, 3) numerical tolerance of the first-order u (JCGM 101, 7.9.2)
    # (n,) whether first order is sufficient (JCGM 101, 8.1); None if the draws are too few to decide
    validated: tuple[bool | None, ...]
    # error of the uncompensated machines relative to the nominal machine: of its RMS and of its maximum over the poses
    as_it_is: tuple[Spread, Spread]
    # the same for the error that remains when the estimated errors are compensated exactly
    compensated: tuple[Spread, Spread]
    # errors with a value but no uncertainty, which are therefore the same for all machines
    without_uncertainty: tuple[str, ...]
    warnings: tuple[SourceWarning, ...] = ()  # warnings about the origin of the calibration
    # errors that could not be determined; each machine has its own, drawn from their plausible size
    not_identified: tuple[str, ...] = ()
    # (n,) U by first-order propagation without these errors
    identified_um: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def brief(self) -> str:
        """U by Monte Carlo, and the error left when compensated."""
        u = self.by_draws_um
        drawn = f"{self.machines:,} machines at {count_with_noun(len(self.positions), 'pose')}"
        left = f"{self.compensated[0].mean:.3g} µm RMS left when compensated"
        return f"{drawn}: U by Monte Carlo {np.sqrt(np.mean(u**2)):.3g} µm RMS, {u.max():.3g} µm largest; {left}"

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
            "not_identified": list(self.not_identified),
            "first_order_identified_errors": summary(self.identified_um) if len(self.identified_um) else None,
            "by_draws": summary(self.by_draws_um),
            "first_order": summary(self.first_order_um),
            "where": self.where,
            "first_order_enough": {name: self.validated.count(answer) for name, answer in answers.items()},
            "as_it_is": spreads(self.as_it_is),
            "compensated": spreads(self.compensated),
            **json_form(self, leave_out=LEADING_KEYS),
        }


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
        poses: number of poses, spread evenly over the ranges (`twin.tool.uncertainty.volume`), inside the domains of the curves; with
            random directions of approach a reversal counts as ± half its size.
        seed: random seed.
        digits: significant digits of u regarded as meaningful (JCGM 101, 7.9.2): 1 or 2.
        workers: workers for the computation; None: one process per core.
        progress: progress callback: stage and fraction done.

    Raises:
        InputError: a number outside its limits, or a calibration without covariance; see also `twin.compute.parallel.map_as_completed`.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> expected = twin.judge(twin.thesis_plan.plan(machine), machine).calibration  # zero, with its covariance
        >>> kinematics = twin.Kinematics(machine, expected, tool_length_mm=120)
        >>> population = twin.draw_machines(kinematics, trials=10_000, poses=20, workers=twin.Workers(1))
        >>> ratio = population.by_draws_um / population.first_order_um  # U by Monte Carlo and by first order
        >>> bool(abs(ratio - 1.0).max() < 0.05)
        True

    References:
        - JCGM 101:2008, Propagation of distributions using a Monte Carlo method, clauses 7 and 8.
    """
    if not FEWEST_TRIALS <= trials <= MOST_TRIALS:
        raise InputError(
            "number of machines outside its limits", expected=f"{FEWEST_TRIALS} … {MOST_TRIALS}", value=trials
        )
    if not 1 <= poses <= MOST_POSES:
        raise InputError("number of poses outside its limits", expected=f"1 … {MOST_POSES}", value=poses)
    if seed < 0:
        raise InputError("seed must not be negative", expected="0 or more", value=seed)
    calibration, machine = kinematics.calibration, kinematics.machine
    tasks = [(i, min(TRIALS_PER_TASK, trials - start)) for i, start in enumerate(range(0, trials, TRIALS_PER_TASK))]
    # The last digits of matrix products depend on the number of threads.
    with one_blas_thread(scipy=False):
        tool = ToolUncertainty(kinematics)
        if not tool.parameters:
            raise InputError(
                "no machines can be drawn: the calibration has no uncertainties",
                expected="a calibration with a covariance, as `twin identify` writes it",
                file=calibration.path,
            )
        q = inside_domains(volume(machine, poses), calibration)
        progress("preparing", 0.0)
        settings = machine, calibration, kinematics.tool_length_mm, kinematics.conditions
        draws = Draws(*settings, q, random_approach(q), seed).pilot()
        parts = map_in_order(Draws.part, draws, tasks, workers, name=lambda task: f"machines of task {task[0]}")
        total = next(parts)
        for part in parts:
            progress("drawing", total.machines / trials)
            total = total.plus(part)
        progress("drawing", 1.0)
        return _population(draws, total, tool, digits)


def _population(draws: Draws, total: Tally, tool: ToolUncertainty, digits: int) -> Population:
    trials = total.machines
    lower, upper, least, most = draws.bins  # type: ignore[misc]
    first = tool.at(draws.positions, draws.sides)
    identified_um = first.expanded_um
    if tool.unknown:  # without the errors that could not be determined; zero without other uncertain parameters
        alone = ToolUncertainty(tool.kinematics, "identified")
        known = (
            alone.at(draws.positions, draws.sides).expanded_um if alone.parameters else np.zeros(len(draws.positions))
        )
        identified_um = read_only(known)
    points = Counts(lower, upper, total.point)
    interval = np.stack([points.quantile(share)[:3].T for share in (TAIL, 1.0 - TAIL)], axis=2)
    # The rank of a quantile is binomially distributed: standard errors of the limits without assuming a density.
    step = np.sqrt(TAIL * (1.0 - TAIL) / trials)
    noise = np.stack(
        [
            (points.quantile(min(at + step, 1.0)) - points.quantile(max(at - step, 0.0)))[:3].T / 2.0
            for at in (TAIL, 1.0 - TAIL)
        ],
        axis=2,
    )
    ends = np.abs(interval - first.standard_um[:, :, None] * np.array([-COVERAGE_FACTOR, COVERAGE_FACTOR]))
    tolerance = np.maximum(numerical_tolerance(first.standard_um, digits), NUMERICAL_UM)
    inside_domains = np.all(ends + UNDECIDED * noise <= tolerance[:, :, None], axis=(1, 2))
    beyond = np.any(ends - UNDECIDED * noise > tolerance[:, :, None], axis=(1, 2))
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
        by_draws_um=read_only(points.quantile(COVERAGE)[3].copy()),
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
        not_identified=tool.unknown,
        identified_um=identified_um,
    )


def numerical_tolerance(standard: np.ndarray, digits: int) -> np.ndarray:
    """Return δ of JCGM 101, 7.9.2: with u = c·10^l, where the integer c has ``digits`` digits, 1 or 2, δ = ½·10^l."""
    safe = np.where(standard > 0.0, standard, 1.0)
    power = np.floor(np.log10(safe)) - (digits - 1)
    power += np.round(safe / 10.0**power) >= 10.0**digits  # 0.996 is 1.0 to two digits
    return np.asarray(np.where(standard > 0.0, 0.5 * 10.0**power, 0.0))
