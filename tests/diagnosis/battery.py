"""The statistics of `twin diagnose`: many hidden effects of a set size, drawn over the whole catalogue; how often each is named right.

It tests the search: effects are the package's own signatures, which are linear, put into a residual that is already whitened. For files
in and `diagnosis.json` out, on truth machines that share no code with the package and are not linear, see `tests.scored_cases`.

One data set of the truth machine (`tests.truth.hidden`) gives poses, set-up and noise; into its whitened residual go new noise and
new effects, scaled to a noncentrality λ after everything the set-up absorbs is projected out. Run one row of the table by

    python -m tests.diagnosis.battery ROW [--draws 200] [--noise isotropic|repeats|tracker|tracker-repeats] [--poses 390] [--seed 1]
                                [--workers N] [--scheduler tcp://…]

A data set with its draws is one task, so that the same seed gives the same answers on any workers.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import stats

from tests.truth import hidden
from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin.compute.parallel import Workers, map_in_order
from twin.diagnosis.alternatives import equivalent, together
from twin.diagnosis.candidates.candidate import Candidate, unit_columns
from twin.diagnosis.estimate import estimate
from twin.diagnosis.forms import Form
from twin.diagnosis.patterns import patterns
from twin.diagnosis.problem import Problem
from twin.diagnosis.readings import DiagnosisTask, readings
from twin.diagnosis.search import candidates_of
from twin.diagnosis.structure import Findings, Structure, search, without_variants_in_time
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker
from twin.measurement.observation import machine_state
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import PitchError, ThermalDrift
from twin.numerics.covariance import Covariance

FAR = 4.0
"""Standard uncertainties: of three hundred normal ones, one in fifty sets of draws has one beyond."""
HERE = Workers(1)
FRESH = 25
"""Draws from one data set before another is measured."""
ROWS = {
    "one60": (1, 60.0),
    "one30": (1, 30.0),
    "two60": (2, 60.0),
    "three100": (3, 100.0),
    "nothing": (0, 0.0),
    "outside300": (0, 300.0),
}
Key = tuple[str, str]
Truth = tuple[Key, np.ndarray, Candidate, dict[str, float], np.ndarray]


UNHIDDEN = ("misplaced", "error_motion")
"""Families that are not of the contract's table: mistakes in the calibration have separate tests."""


class Searcher:
    """Candidates and patterns of one data set, before and after a search."""

    def __init__(self, task: DiagnosisTask) -> None:
        network = task.problem.network
        self.task, self.problem = task, task.problem
        self.candidates, self.patterns = candidates_of(task), patterns(network.machine, network.data)

    def run(self) -> Findings:
        return search(self.task, self.candidates, self.patterns)


def basis_of(problem: Problem) -> np.ndarray:
    """Return (3n, directions) the readings' part of the nuisance basis at all points."""
    rows = problem.nuisances.rows(slice(None))
    return rows.reshape(3 * len(rows), rows.shape[2])


class Finding:
    """The hidden effects of one draw, and the causes named."""

    truth: tuple[Key, ...]
    named: tuple[Key, ...]

    @property
    def right(self) -> bool:
        """Return whether every hidden effect is named."""
        return set(self.truth) <= set(self.named)

    @property
    def too_many(self) -> bool:
        """Return whether there are more causes than effects."""
        return len(self.named) > len(self.truth)


@dataclass(frozen=True)
class Answer(Finding):
    """The hidden effects of one draw, and the diagnosis; ``alone`` if the effect is not confounded even without noise."""

    truth: tuple[Key, ...]
    columns: tuple[str, ...]
    named: tuple[Key, ...]
    equivalent: tuple[tuple[Key, ...], ...]
    unnamed: tuple[str, ...]
    alone: bool
    covered: tuple[bool, ...]
    pulls: tuple[tuple[str, float], ...]
    seconds: float

    @property
    def in_group(self) -> bool:
        """Return whether every hidden effect is named, or equivalent to a named cause; each cause counts for one effect."""
        left = [{name, *others} for name, others in zip(self.named, self.equivalent, strict=True)]
        return matched(list(self.truth), left)

    @property
    def unexplained(self) -> bool:
        return bool(self.unnamed)


def matched(truth: list[Key], groups: list[set[Key]]) -> bool:
    """Return whether every hidden effect belongs to a different group."""
    if not truth:
        return True
    return any(truth[0] in group and matched(truth[1:], groups[:i] + groups[i + 1 :]) for i, group in enumerate(groups))


def measured(
    rng: np.random.Generator, machine: Machine, noise: str, poses: int, uncertain: bool
) -> tuple[Problem, Searcher, np.ndarray]:
    """A data set with nothing in it: the problem, its search, and (n, 3, 3) root of the true covariance in whitened units."""
    plan = hidden.rounded(hidden.plan(rng, poses=poses))
    kind = "tracker" if noise.startswith("tracker") else "isotropic"
    exact = hidden.points(plan)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "measured.csv"
        u = 3e-3 if noise == "isotropic" else None
        data = Measurements.load(hidden.write(path, plan, hidden.noisy(exact, rng, kind), u_mm=u), machine)
    calibration = Calibration.default(machine)
    if uncertain:
        calibration = _doubted(calibration)
    instrument = LaserTracker() if noise == "tracker" else None
    placed = readings(data, machine, calibration, instrument)
    task = placed.without(placed.bad)
    problem = task.problem
    used = problem.network.data
    rows = np.searchsorted(data.lines, used.lines)
    true = (
        LaserTracker().covariance(exact[rows] * 1e-3)
        if kind == "tracker"
        else np.tile(9e-12 * np.eye(3), (len(rows), 1, 1))
    )
    return problem, Searcher(without_variants_in_time(task)), problem.network.whitening @ np.linalg.cholesky(true)


def _doubted(calibration: Calibration) -> Calibration:
    """Return the calibration with a covariance of 0.7 µm and 4 µrad per coefficient, typical of an identification."""
    names = [p.name for effect in calibration.effects for p in effect.parameters]
    units = [p.unit for effect in calibration.effects for p in effect.parameters]
    u = np.array([0.7 if unit == "um" else 4.0 for unit in units])
    return replace(calibration, joint=Covariance(tuple(names), read_only(np.diag(u**2))))


def noise_of(rng: np.random.Generator, problem: Problem, root: np.ndarray) -> np.ndarray:
    """Return (3n,) new noise, with a new error of the calibration if it has a covariance."""
    found = np.einsum("nij,nj->ni", root, rng.standard_normal((len(root), 3))).reshape(-1)
    uncertain = problem.nuisances.coordinates[:, len(problem.setup) :]
    return found + basis_of(problem) @ (uncertain @ rng.standard_normal(uncertain.shape[1]))


def some_effect(rng: np.random.Generator, problem: Problem, families: dict[str, list[Candidate]], size: float) -> Truth:
    """An effect of a random family at a random place, scaled to a noncentrality: key, (3n,) signature, fixed and linear parameters."""
    machine, state = problem.network.machine, machine_state(problem.network.data, problem.network.machine)
    while True:
        effect = list(families)[rng.integers(len(families))]
        candidate = families[effect][rng.integers(len(families[effect]))]
        # What a dropped constant does is a form of the same curve, not another effect.
        variants = [
            one
            for one in candidate.variants
            if not {"stops", "payload"} & one.fixed.keys() and not one.fixed.get("first", 0.0)
        ]
        variant = variants[rng.integers(len(variants))]
        fixed, columns = dict(variant.fixed), list(variant.columns)
        # Periods and time constants as they come, not as the search has them on its grid.
        if effect == "pitch_error":
            spacing = [1.0 / one.fixed["period"] for one in candidate.variants]
            fixed["period"] = float(1.0 / rng.uniform(min(spacing), max(spacing)))
            axis = machine.by_name[candidate.where]
            columns = [
                unit_columns([PitchError(axis, 1.0, fixed["period"], phase)], machine, state)[0]
                for phase in (0.0, np.pi / 2.0)
            ]
        if effect == "thermal_drift":
            constants = [one.fixed["time_constant"] for one in candidate.variants if one.fixed]
            fixed["time_constant"] = float(np.exp(rng.uniform(np.log(min(constants)), np.log(max(constants)))))
            built = candidate.build(np.ones(1), fixed)[0] if candidate.build else None
            if isinstance(built, ThermalDrift):
                columns = unit_columns([built], machine, state)
        raw = problem.signature(columns)
        seen = np.diag(problem.inner(raw)) > 25.0
        values = rng.standard_normal(raw.shape[1]) * seen
        if effect == "gravity_compliance":
            values = np.abs(values)
        if candidate.space is not None:
            # In the datum of the calibration: a constant is a zero, a slope of a straightness a squareness.
            values[: 2 if effect == "straightness" else 1] = 0.0
        signature = raw @ values
        after = float(problem.inner(signature[:, None])[0, 0])
        # As large as plausible it must be seen: what the set-up absorbs is no hidden effect.
        if after > size and after > 1e-7 * float(signature @ signature):
            factor = np.sqrt(size / after)
            linear = values * factor * np.array([column.scale for column in columns])
            return candidate.key, signature * factor, candidate, fixed, linear


def some_effects(
    rng: np.random.Generator, problem: Problem, families: dict[str, list[Candidate]], count: int, size: float
) -> list[Truth]:
    """Different effects, each of which keeps half of its noncentrality beside the others: what cancels is not there to be found."""
    while True:
        found = [some_effect(rng, problem, families, size) for _ in range(count)]
        if len({one[0] for one in found}) < count:
            continue
        signatures = np.stack([one[1] for one in found], axis=1) if found else np.zeros((len(problem.residual), 0))
        gram = problem.inner(signatures)
        if count < 2 or np.all(1.0 / np.diag(np.linalg.inv(gram + 1e-9 * np.eye(count))) > 0.5 * size):
            return found


def outside(rng: np.random.Generator, problem: Problem, size: float) -> tuple[tuple[str, ...], np.ndarray]:
    """A smooth function of two columns on one side that is in no catalogue, scaled: names, (3n,) signature."""
    data, machine = problem.network.data, problem.network.machine
    values = {f"{a.name}_{a.unit}": np.asarray(data.positions[:, i]) for i, a in enumerate(machine.axes)}
    values |= {"time_s": np.asarray(data.time_s)}
    values |= {f"T_{name}_degC": np.asarray(v) for name, v in data.temperature_degC.items()}
    names = tuple(str(name) for name in rng.choice(list(values), 2, replace=False))
    u, v = ((2.0 * values[n] - np.ptp(values[n]) - 2.0 * values[n].min()) / np.ptp(values[n]) for n in names)
    total = np.zeros(len(u))
    for _ in range(3):
        a, b = rng.uniform(1.0, 3.0, 2)
        total += rng.normal() * np.sin(a * u + rng.uniform(0, 6.3)) * np.cos(b * v + rng.uniform(0, 6.3))
    side = ("tool", "work")[rng.integers(2)]
    direction = rng.standard_normal(3)
    moved = (problem.view.by_base @ direction) * (total * (data.carrier == side))[:, None] * 1e-6
    signature = moved.reshape(-1)
    after = float(problem.inner(signature[:, None])[0, 0])
    return names, signature * np.sqrt(size / after)


@dataclass(frozen=True)
class Case:
    """The parameters of a row of the table.

    Attributes:
        row: name of the row.
        seed: random seed of all draws.
        noise: ``isotropic``, ``tracker``, and the same from ``repeats``.
        poses: number of poses of a data set.
        uncertain: whether the calibration has a covariance.
        every: for `tests.diagnosis.rivals`.
    """

    row: str
    seed: int
    noise: str = "isotropic"
    poses: int = 390
    uncertain: bool = False
    every: bool = False


@dataclass(frozen=True)
class Draw:
    """The hidden causes of a data set, the columns of a pattern outside the catalogue, and the (3n,) residual."""

    truth: tuple[Truth, ...]
    columns: tuple[str, ...]
    residual: np.ndarray


class DataSet:
    """A data set without errors, and draws of hidden effects for it: one task, with its own seed (`twin.compute.parallel`).

    The first data set uses the seed itself, so that its draws are those of a battery of one data set.

    Args:
        case: parameters common to all data sets.
        number: number of this data set.
    """

    def __init__(self, case: Case, number: int) -> None:
        self._case = case
        key = (number,) if number else ()
        self._rng = np.random.default_rng(np.random.SeedSequence(case.seed, spawn_key=key))
        machine = Machine.load("dmu50")
        self.problem, self.searcher, self._root = measured(self._rng, machine, case.noise, case.poses, case.uncertain)
        self._families: dict[str, list[Candidate]] = {}
        # By name: what is drawn does not depend on the order they are tried in.
        for candidate in sorted(self.searcher.task.catalogue.candidates, key=lambda one: one.key):
            if candidate.effect not in UNHIDDEN:
                self._families.setdefault(candidate.effect, []).append(candidate)

    def draw(self) -> Draw:
        """The next one."""
        count, size = ROWS[self._case.row]
        total = noise_of(self._rng, self.problem, self._root)
        truth = some_effects(self._rng, self.problem, self._families, count, size)
        total = total + sum((one[1] for one in truth), np.zeros_like(total))
        columns: tuple[str, ...] = ()
        if self._case.row.startswith("outside"):
            columns, extra = outside(self._rng, self.problem, size)
            total = total + extra
        return Draw(tuple(truth), columns, total)


def tasks(draws: int) -> list[tuple[int, int]]:
    """Number of each data set, and how many draws it has."""
    return [(number, min(FRESH, draws - start)) for number, start in enumerate(range(0, draws, FRESH))]


def task_name(task: tuple[int, int]) -> str:
    """Name of a task."""
    return f"data set {task[0]}"


def answers(
    row: str,
    draws: int,
    seed: int,
    *,
    noise: str = "isotropic",
    poses: int = 390,
    uncertain: bool = False,
    workers: Workers = HERE,
) -> list[Answer]:
    """Draws of one row of the table: the same for the same seed on any workers, but for the seconds."""
    case = Case(row, seed, noise, poses, uncertain)
    return [one for found in map_in_order(answers_of, case, tasks(draws), workers, name=task_name) for one in found]


def answers_of(case: Case, task: tuple[int, int]) -> list[Answer]:
    """Return the answers of one data set."""
    number, draws = task
    data = DataSet(case, number)
    problem, searcher = data.problem, data.searcher
    found = []
    for _ in range(draws):
        draw = data.draw()
        by_itself = ROWS[case.row][0] == 1 and alone(searcher, draw.truth[0][0], draw.truth[0][1])
        problem.set_residual(draw.residual)
        began = time.process_time()
        searcher.candidates.set_problem(problem)
        best = searcher.run()
        seconds = time.process_time() - began
        found.append(_answer(best, draw.truth, draw.columns, by_itself, seconds))
    return found


def _answer(
    found: Findings,
    truth: Sequence[Truth],
    columns: tuple[str, ...],
    alone: bool,
    seconds: float,
) -> Answer:
    candidates = found.given_patterns
    named = [candidates.forms[form.index] for form in found.structure.forms]
    groups = []
    for form in named:
        others = [one for one in named if one is not form]
        several = () if found.structure.pattern_tests else together(found.candidates, form, others)
        groups.append((*equivalent(found, form, others), *(key for group in several for key in group)))
    unnamed = tuple(name for pattern_test in found.structure.pattern_tests for name in pattern_test.pattern.names)
    pulls = () if unnamed else _pulls(found.problem, found.structure.forms, truth)
    return Answer(
        truth=tuple(one[0] for one in truth),
        columns=columns,
        named=tuple(form.key for form in named),
        equivalent=tuple(groups),
        unnamed=unnamed,
        alone=alone if len(truth) == 1 else not any(groups),
        covered=tuple(bool(abs(pull) < stats.norm.isf(0.025)) for _, pull in pulls),
        pulls=pulls,
        seconds=seconds,
    )


def alone(searcher: Searcher, key: Key, signature: np.ndarray) -> bool:
    """Return whether a cause has no equivalent even without noise."""
    problem, candidates = searcher.problem, searcher.candidates
    problem.set_residual(signature)
    candidates.set_problem(problem)
    explained, dof = candidates.scan([])
    form = max(
        (one for one in candidates.forms if one.key == key and dof[one.index] > 0),
        key=lambda one: explained[one.index] - candidates.critical_value(one, float(dof[one.index])),
    )
    only = Structure((form,), problem)
    found = Findings(replace(searcher.task, problem=problem), (), candidates, only, candidates)
    return not equivalent(found, form, []) and not together(candidates, form, [])


def _pulls(
    problem: Problem,
    named: Sequence[Form],
    truth: Sequence[Truth],
) -> tuple[tuple[str, float], ...]:
    """(value − truth)/u of every parameter of the causes that are right, where all are."""
    if {form.key for form in named} != {one[0] for one in truth} or not named:
        return ()
    estimated = estimate(problem, named)
    found: list[tuple[str, float]] = []
    for form, quantities in zip(named, estimated.quantities, strict=True):
        _, _, candidate, fixed, linear = next(one for one in truth if one[0] == form.key)
        if fixed.get("order", 0.0) != form.variant.fixed.get("order", 0.0):
            continue
        if candidate.effect in ("station_drift", "scale_drift") and ("time_constant" in fixed) != any(
            q.name == "time_constant" for q in quantities
        ):
            continue  # the rate at the beginning of an exponential, and the mean rate: not the same number
        if candidate.space is not None:
            # The truth has no constant, a straightness no slope; a form without them is as good.
            linear = linear[round(form.variant.fixed.get("first", 0.0)) :]
            if len(linear) != len(form.variant.columns) or "stops" in form.variant.fixed:
                continue
            first = round(form.variant.fixed.get("first", 0.0))
            linear = candidate.space.transform[: first + len(linear), first : first + len(linear)] @ linear
        true = dict(
            zip([q.name for q in quantities if q.name not in candidate.specification.fixed], linear, strict=False)
        )
        if candidate.effect == "pitch_error":
            true = {"amplitude": float(np.hypot(*linear)), "period": fixed["period"]}
        elif candidate.effect == "thermal_drift":
            true = {"amplitude": float(linear[0]), "time_constant": fixed["time_constant"]}
        elif candidate.effect == "scale_drift" and "time_constant" not in fixed:
            true = dict(zip(("rate", "offset_rate"), linear, strict=True))
        found += [
            (f"{candidate.effect}.{q.name}", (q.value - true[q.name]) / q.u)
            for q in quantities
            if q.name in true and q.u > 0.0
        ]
    return tuple(found)


def summary(row: str, found: Sequence[Answer]) -> dict[str, float]:
    """Shares of the draws."""
    n = len(found)

    def share(values: list[bool]) -> float:
        return float(np.mean(values)) if values else float("nan")

    always = {"seconds": float(np.mean([a.seconds for a in found]))}
    if row == "nothing":
        return always | {"any alarm": share([bool(a.named or a.unnamed) for a in found])}
    if row.startswith("outside"):
        hit = [a.unexplained and bool(set(a.columns) & set(a.unnamed)) for a in found]
        return always | {
            "unexplained": share([a.unexplained for a in found]),
            "unexplained, right column": share(hit),
            "both columns": share([set(a.columns) <= set(a.unnamed) for a in found]),
            "named causes": float(np.mean([len(a.named) for a in found])),
        }
    covered = [one for a in found for one in a.covered]
    pulls = [pull for a in found for _, pull in a.pulls]
    alone = [a for a in found if a.alone]
    return always | {
        "right": share([a.right for a in found]),
        "right or in group": share([a.in_group for a in found]),
        "right where nothing is equivalent": share([a.right for a in alone]),
        "share with equivalents": 1.0 - len(alone) / n,
        "mean group": float(np.mean([1 + len(g) for a in found for g in a.equivalent] or [0.0])),
        "nothing found": share([not a.named and not a.unnamed for a in found]),
        "an effect too many": share([a.too_many for a in found]),
        "unexplained": share([a.unexplained for a in found]),
        "coverage": share(covered),
        "intervals": float(len(covered)),
        # The uncertainty of a period holds near it: an alias of the period at these positions is hundreds of them off.
        "rms of pulls": float(np.sqrt(np.mean([pull**2 for pull in pulls if abs(pull) <= FAR] or [np.nan]))),
        "far pulls": float(np.mean([abs(pull) > FAR for pull in pulls] or [0.0])),
    }


def parsed(parser: argparse.ArgumentParser) -> tuple[argparse.Namespace, Workers]:
    """The options, and who does the work."""
    parser.add_argument("--workers", type=int, help="processes of this computer: one a core if not given")
    parser.add_argument("--scheduler", help="address of a Dask scheduler, whose workers have this folder on their path")
    options = parser.parse_args()
    try:
        return options, Workers(options.workers, options.scheduler)
    except InputError as error:
        parser.error(str(error))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", nargs="+", choices=ROWS)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--noise", default="isotropic")
    parser.add_argument("--poses", type=int, default=390)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--uncertain", action="store_true")
    parser.add_argument("--wrong", type=int, default=0)
    options, workers = parsed(parser)
    for row in options.rows:
        found = answers(
            row,
            options.draws,
            options.seed,
            noise=options.noise,
            poses=options.poses,
            uncertain=options.uncertain,
            workers=workers,
        )
        said = ", ".join(f"{name} {value:.3g}" for name, value in summary(row, found).items())
        sys.stdout.write(f"{row} {options.noise}{' uncertain' if options.uncertain else ''} {len(found)}: {said}\n")
        wrong = [a for a in found if not a.in_group or a.too_many or (a.truth and a.unexplained)]
        if row == "nothing":
            wrong = [a for a in found if a.named or a.unnamed]
        if row.startswith("outside"):
            wrong = [a for a in found if not set(a.columns) & set(a.unnamed)]
        for a in wrong[: options.wrong]:
            sys.stdout.write(f"   {a.truth or a.columns} -> {a.named} {a.equivalent} {a.unnamed}\n")
        worst = Counter(name for a in found for name, pull in a.pulls if abs(pull) > 1.96)
        of = Counter(name for a in found for name, _ in a.pulls)
        if options.wrong:
            sys.stdout.write(
                "   not covered: " + ", ".join(f"{k} {v}/{of[k]}" for k, v in worst.most_common(12)) + "\n"
            )
        sys.stdout.flush()


if __name__ == "__main__":
    from tests.diagnosis import battery  # workers know it by this name

    battery.main()
