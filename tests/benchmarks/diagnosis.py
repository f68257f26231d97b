"""Compare `twin diagnose` with an ordinary regression: run ``python -m tests.benchmarks.diagnosis [--draws N]`` (some minutes).

The other method is stepwise selection by BIC with `statsmodels`, on the same candidates and readings, with the set-up projected out
(`tests.diagnosis.rivals`). Times are from readings in memory to names. `twin` also computes sizes with intervals, confounded effects,
the gain on held-out rounds and the next measurement; its time is given with and without these. Names are compared on the same draws of
hidden effects (`tests.diagnosis.battery`).
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from tests.benchmarks.timing import machine_name, ratio, timed
from tests.diagnosis.battery import UNHIDDEN
from tests.truth import hidden
from tests.truth.hidden import Hidden
from twin.diagnosis import diagnose
from twin.diagnosis.readings import readings
from twin.diagnosis.search import exclude_outliers
from twin.diagnosis.structure import select_causes
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

POINTS = (1_000, 3_000)
REPEATS = 3
EFFECTS = (
    Hidden("reversal", "Y", {"size": 6.0}),
    Hidden("pitch_error", "X", {"amplitude": 3.0, "period": 13.7, "phase": 0.4}),
    Hidden("squareness", "E_A0Z", {"angle": 12.0}),
)
ROWS = ("nothing", "one30", "one60", "two60", "outside300")


def measured(machine: Machine, points: int, seed: int = 5) -> Measurements:
    """Return readings of a truth machine with `EFFECTS`, with 3 µm noise, at about the given number of points."""
    rng = np.random.default_rng(seed)
    plan = hidden.rounded(hidden.plan(rng, poses=max((points // 3 - 220) // 2, 20), same=False))
    read = hidden.noisy(hidden.points(plan, EFFECTS), rng, "isotropic", 3e-3)
    with tempfile.TemporaryDirectory() as folder:
        return Measurements.load(hidden.write(Path(folder) / "measured.csv", plan, read, u_mm=3e-3), machine)


def by_bic(data: Measurements, machine: Machine) -> tuple[tuple[str, str], ...]:
    """Return the causes that stepwise selection by BIC (`statsmodels`) names."""
    from tests.diagnosis import rivals  # needs statsmodels and scikit-learn

    placed = readings(data, machine, Calibration.default(machine))
    task = placed.without(placed.bad)
    candidates = [one for one in task.catalogue.candidates if one.effect not in UNHIDDEN]
    return rivals.stepwise_bic(task.problem, candidates, design=rivals.Design(task.problem, candidates))


def by_twin(data: Measurements, machine: Machine) -> tuple[tuple[str, str], ...]:
    """Return the causes that `twin` names, without sizes, intervals and advice."""
    found = select_causes(exclude_outliers(readings(data, machine, Calibration.default(machine))))
    return tuple(form.key for form in found.structure.forms)


def time_taken(machine: Machine) -> None:
    """Print the time from readings to names."""
    print("from readings to names, processor time in s:")
    for points in POINTS:
        data = measured(machine, points)
        names = timed(lambda data=data: by_twin(data, machine), REPEATS)  # type: ignore[misc]
        whole = timed(lambda data=data: diagnose(data, machine), REPEATS)  # type: ignore[misc]
        other = timed(lambda data=data: by_bic(data, machine), REPEATS)  # type: ignore[misc]
        print(f"  {len(data):,} points: {names.best:.2f} to the names, {whole.best:.2f} to the complete answer")
        print(f"    stepwise BIC (statsmodels) {other.best:.2f}: {ratio(other, names)}")
        print(f"    hidden: {'; '.join(' '.join(effect.key) for effect in EFFECTS)}")
        print(f"    twin: {'; '.join(f'{cause.effect} {cause.where}' for cause in diagnose(data, machine).causes)}")
        print(f"    BIC:  {'; '.join(' '.join(key) for key in by_bic(data, machine))}")


def named_right(draws: int) -> None:
    """Print shares of draws, with the standard deviation of a share of one half."""
    from tests.diagnosis import rivals

    print(f"causes named right, % of {draws} draws (± {50.0 / np.sqrt(draws):.0f}), seconds per answer, columns:")
    for row in ROWS:
        for method, found in rivals.compared(row, draws, 1).items():
            shares = rivals.summary(row, found)
            line = ", ".join(
                f"{name} {value:.2f}" if name in ("seconds", "causes named") else f"{name} {100 * value:.0f}"
                for name, value in shares.items()
            )
            print(f"  {row:11} {method:14} {line}", flush=True)


def main(arguments: list[str] | None = None) -> None:
    """Print times and shares of right names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=50)
    draws = parser.parse_args(arguments).draws
    print(machine_name())
    time_taken(Machine.load("dmu50"))
    named_right(draws)


if __name__ == "__main__":
    main()
