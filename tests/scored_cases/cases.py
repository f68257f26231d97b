"""Benchmark cases: draw hidden errors from a seed, scale them to a noncentrality λ, and write each case to a folder."""

from __future__ import annotations

import json
import shutil
import tempfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from tests.scored_cases.builds import machines
from tests.scored_cases.carried import largest
from tests.scored_cases.known import PLACED, drawn, families, origin, two
from tests.scored_cases.outside import PATTERNS, Outside
from tests.scored_cases.plan import Plan, write_table
from tests.truth.any_machine import TruthMachine
from tests.truth.hidden import Hidden

OUTSIDE = 300.0
"""Noncentrality λ of a pattern outside the catalogue."""
LEAST_LEFT = 0.05
"""Smallest share of a pattern's sum of squares that the set-up may leave."""
MOST_CARRIED = 0.5
"""Largest share of a pattern's λ that a known effect may explain; naming an effect that explains more would be right."""
LARGEST_MM = 0.2
KINDS = (
    "known30",
    "known60",
    "known300",
    "further300",
    "two60",
    "nothing",
    "mixed300",
    *(f"outside-{pattern}" for pattern in PATTERNS),
)
"""A known effect with λ = 30, 60 or 300; one of `known.FURTHER` with 300; two with 60 each; nothing; one with 300 together with a
pattern outside the catalogue with 300; and each such pattern alone."""


@dataclass(frozen=True)
class Case:
    """Identification of a case, which is the same on every computer.

    Attributes:
        machine: name of a truth machine.
        kind: one of `KINDS`.
        number: number of the case among those of this kind and machine.
        seed: random seed of the benchmark.
    """

    machine: str
    kind: str
    number: int
    seed: int = 1

    @property
    def name(self) -> str:
        """Name of its folder."""
        return f"{self.machine}-{self.kind}-{self.seed}-{self.number:03d}"

    def rng(self) -> np.random.Generator:
        """Return the random generator of the case."""
        key = zlib.crc32(f"{self.machine} {self.kind}".encode())
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(key, self.number)))


@dataclass(frozen=True)
class Truth:
    """Hidden errors of a case.

    Attributes:
        plan: the measurement plan.
        effects: hidden effects of the catalogue.
        outside: hidden pattern outside the catalogue.
        read: (n, 3) readings with noise, mm.
    """

    plan: Plan
    effects: tuple[Hidden, ...]
    outside: Outside | None
    read: np.ndarray


@lru_cache(maxsize=1)
def truth_machines() -> dict[str, TruthMachine]:
    """Return all truth machines by name, made once."""
    return machines()


def truth_of(case: Case) -> Truth:
    """Draw the hidden errors and the readings of a case."""
    machine, rng = truth_machines()[case.machine], case.rng()
    plan = machine.plan(rng)
    effects: Sequence[Hidden] = ()
    outside = None
    if case.kind == "two60":
        effects = two(rng, machine, plan, 60.0)
    elif case.kind.startswith(("known", "further", "mixed")):
        effects = [_known(rng, machine, plan, case)]
    if case.kind.startswith("outside"):
        outside = outside_of(rng, machine, plan, case.kind.removeprefix("outside-"))
    elif case.kind.startswith("mixed"):
        outside = outside_of(rng, machine, plan, list(PATTERNS)[case.number % len(PATTERNS)])
    moved = None if outside is None else outside.moved(machine, plan)
    exact = machine.readings(plan, effects, moved)
    return Truth(plan, tuple(effects), outside, exact + machine.sigma_mm * rng.standard_normal(exact.shape))


def _known(rng: np.random.Generator, machine: TruthMachine, plan: Plan, case: Case) -> Hidden:
    """Draw an effect, cycling through the families; skip a family of which no effect is visible in these data."""
    names = families(machine, plan, further=case.kind.startswith("further"))
    size = float(case.kind.lstrip("abcdefghijklmnopqrstuvwxyz"))
    for k in range(len(names)):
        found = drawn(rng, machine, plan, names[(case.number + k) % len(names)], size)
        if found is not None:
            return found
    raise ValueError(f"no effect of {machine.name} is visible in its data")


def outside_of(
    rng: np.random.Generator, machine: TruthMachine, plan: Plan, pattern: str, size: float = OUTSIDE
) -> Outside:
    """Draw a pattern and scale it to a noncentrality."""
    silent = machine.readings(plan)
    for _ in range(PLACED):
        found = PATTERNS[pattern].draw(rng, machine, plan)
        change = machine.readings(plan, moved=found.moved(machine, plan)) - silent
        raw = float(np.sum((change / machine.sigma_mm) ** 2))
        seen = machine.noncentrality(plan, change)
        if seen <= LEAST_LEFT * raw or raw == 0.0:
            continue
        # A shift in the base is exactly linear in its size.
        found = Outside.from_dict(found.to_dict() | {"size_um": found.size_um * float(np.sqrt(size / seen))})
        if largest(machine, plan, change)[1] > MOST_CARRIED:
            continue
        if np.abs(found.moved(machine, plan)).max() < LARGEST_MM:
            return found
    raise ValueError(f"no {pattern} is visible in the data of {machine.name}")


def write_case(case: Case, folder: Path) -> Path:
    """Write the folder of a case, if new: ``measured.csv``, ``machine.txt`` and, last, ``truth.json``.

    Args:
        case: the case.
        folder: folder of all cases; machine files are written to ``machines`` in it.
    """
    own = folder / "cases" / case.name
    if (own / "truth.json").exists():
        return own
    own.mkdir(parents=True, exist_ok=True)
    machine, truth = truth_machines()[case.machine], truth_of(case)
    (own / "machine.txt").write_text(machine_file(machine, folder) + "\n", encoding="utf-8")
    write_table(own / "measured.csv", truth.plan, truth.read, machine.sigma_mm)
    write_whole(own / "truth.json", to_dict(case, machine, truth))
    return own


def machine_file(machine: TruthMachine, folder: Path) -> str:
    """Return the name of a bundled machine, or the path of its machine file in ``machines``, which is written if new."""
    if machine.bundled:
        return machine.bundled
    files = folder / "machines" / machine.name
    if not files.exists():
        files.parent.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(prefix=".part", dir=files.parent))
        machine.write_machine(made)
        try:
            made.rename(files)  # atomic, since another worker may look for the files
        except OSError:
            shutil.rmtree(made)
    return str(next(files.glob("*.yaml")).resolve())


def to_dict(case: Case, machine: TruthMachine, truth: Truth) -> dict[str, Any]:
    """Return the content of ``truth.json``."""
    plan, silent = truth.plan, machine.readings(truth.plan)

    def size(change: np.ndarray) -> float:
        return machine.noncentrality(plan, change - silent)

    outside = None
    if truth.outside is not None:
        moved = truth.outside.moved(machine, plan)
        (effect, where), share = largest(machine, plan, machine.readings(plan, moved=moved) - silent)
        outside = truth.outside.to_dict() | {
            "depends_on": list(truth.outside.depends_on(machine, plan)),
            "rms_um": 1e3 * float(np.sqrt(np.mean(np.sum(moved[plan.carrier == truth.outside.side] ** 2, axis=1)))),
            "lambda": size(machine.readings(plan, moved=moved)),
            "carried": {"effect": effect, "where": where, "share": share},
        }
    return {
        "schema": "twin.benchmark.truth/1",
        "machine": case.machine,
        "kind": case.kind,
        "number": case.number,
        "seed": case.seed,
        "sigma_um": 1e3 * machine.sigma_mm,
        "effects": [
            {
                "effect": one.effect,
                "where": one.where,
                "origin": origin(one.effect),
                "parameters": [{"name": name, "value": value} for name, value in one.numbers.items()],
                "lambda": size(machine.readings(plan, [one])),
            }
            for one in truth.effects
        ],
        "outside": outside,
    }


def write_whole(path: Path, data: Any) -> None:
    """Write a JSON file atomically."""
    part = path.with_name(f".{path.name}.part")
    part.write_text(json.dumps(data, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    part.replace(path)
