"""Tabulate what each measuring sequence determines of the constant errors: ``python -m tests.benchmarks sequences`` (half a minute).

One row for each instrument, sequence and state of knowledge of the set-up. The uncertainties are predicted before anything is measured
(`twin plan --instrument … --json`), at the nominal machine, with the instrument's default noise, k = 1. Scales (µm/m) count with the
angles. The head–head machine is that of `tests/real`; its sphere is in the middle of the ranges.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from twin.machine.machine import Machine
from twin.model.effects import unit_of
from twin.planning import InstrumentSizes, measuring_sequence

TIP_MM: Final = 120.0
MINUTES: Final = 30.0
SPHERES: Final = {"a": (150.0, 0.0, 60.0), "b": (-80.0, 110.0, 40.0), "c": (-60.0, -120.0, 80.0)}
HEAD_HEAD: Final = Path(__file__).parents[1] / "real" / "head_head.yaml"
Places = Mapping[str, tuple[float, float, float]] | None
ROWS: Final[tuple[tuple[str, str, str, Places], ...]] = (
    *(("dmu50", "probe", name, {"a": SPHERES["a"]}) for name in ("best", "turns")),
    *(("dmu50", "probe", name, SPHERES) for name in ("best", "turns")),
    *(("dmu50", "r-test", name, None) for name in ("best", "turns", "bk1", "bk2", "bk4")),
    ("dmu50", "ball-bar", "circles", None),
    *((str(HEAD_HEAD), "probe", name, None) for name in ("best", "turns")),
    *((str(HEAD_HEAD), "r-test", name, None) for name in ("best", "turns", "ak1", "ak2", "ak4")),
)
"""Machine, instrument, sequence, and places of the parts on the table."""
HEADERS: Final = (
    *("machine", "instrument", "sequence", "known", "min", "determined", "lost"),
    *("angles, scales: median", "worst / µrad", "locations: median", "worst / µm"),
)


def rows() -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table as text."""
    for name, instrument, sequence, places in ROWS:
        machine = Machine.load(name)
        found = measuring_sequence(
            machine, instrument, sequence, places_mm=places, minutes=MINUTES, sizes=InstrumentSizes(TIP_MM)
        )
        count = (
            ""
            if instrument != "probe"
            else f", {len(found.task.places_mm)} sphere{'s' * (len(found.task.places_mm) > 1)}"
        )
        for known, constants in found.expected.by_knowledge.items():
            by_unit: dict[bool, list[float]] = {True: [], False: []}
            for error, u in constants.u.items():
                if np.isfinite(u):
                    by_unit["0" in error and unit_of(error) == "um"].append(u)
            sizes = [
                f"{figure(values):.2g}" if values else "–"
                for values in (by_unit[False], by_unit[True])
                for figure in (np.median, np.max)
            ]
            yield (
                machine.name,
                instrument + count,
                sequence,
                known,
                f"{found.minutes:.0f}",
                f"{constants.determined} of {len(constants.u)}",
                "; ".join(constants.lost) or "–",
                *sizes,
            )


def main() -> None:
    """Print the table as Markdown, row by row."""
    print(f"| {' | '.join(HEADERS)} |\n|{'---|' * len(HEADERS)}")
    for row in rows():
        print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
