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
from dataclasses import asdict, dataclass, field
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.counts import count_with_noun
from twin._common.defaults import TRIALS, VOLUME_POSES
from twin._common.errors import InputError
from twin._common.json_form import json_form
from twin._common.progress import Progress, silent
from twin._common.provenance import SourceWarning, warnings_to_json
from twin._common.threads import one_blas_thread
from twin.compute.parallel import Workers, map_in_order
from twin.display import card, histogram, note, pairs, table
from twin.display.numbers import COVERAGE, COVERAGE_FACTOR
from twin.kinematics.forward import Kinematics
from twin.uncertainty.at_tool import DEFINITION, PoseUncertainty, ToolUncertainty
from twin.uncertainty.budget import inside_domains, random_approach, volume
from twin.uncertainty.draws import NUMERICAL_UM, Draws
from twin.uncertainty.tally import Counts, Tally

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
    *(
        "machines",
        "seed",
        "as_it_is",
        "compensated",
        "without_uncertainty",
        "warnings",
        "not_identified",
        "identified_um",
    ),
)
"""Attributes that come before the poses in JSON."""


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
        not_identified: errors that could not be determined; each machine has its own, drawn from their plausible size.
        identified_um: (n,) U by first-order propagation without these errors.
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
    not_identified: tuple[str, ...] = ()
    identified_um: np.ndarray = field(default_factory=lambda: np.zeros(0))

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
            ("not identified, drawn from the plausible size", ", ".join(self.not_identified)),
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
    with one_blas_thread(scipy=False):
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
    trials = total.machines
    lower, upper, least, most = draws.bins  # type: ignore[misc]
    first = tool.at(draws.positions, draws.sides)
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
        identified_um=_identified_u(draws, tool, first),
    )


def _identified_u(draws: Draws, tool: ToolUncertainty, first: PoseUncertainty) -> np.ndarray:
    """Return (n,) U without the errors that could not be determined, to first order; zero without other uncertain parameters."""
    if not tool.unknown:
        return first.expanded_um
    alone = ToolUncertainty(tool.kinematics, "identified")
    if not alone.parameters:
        return read_only(np.zeros(len(draws.positions)))
    return alone.at(draws.positions, draws.sides).expanded_um


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
