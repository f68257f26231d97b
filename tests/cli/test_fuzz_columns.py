"""Subsets of the columns of valid tables, for every command that reads one: exit status 0, 2 or 3, never another exception.

A table without an optional column is the plainest of all, and each column that is left out takes another way through the program. Runs
are in this process, on few readings, so that a subset costs little.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.cli.hostile import machine, sample
from tests.cli.test_fuzz import done_or_refused
from tests.thermal.chains import short_chains
from twin import cli
from twin._common.files import scratch_folder

Columns = dict[str, list[str]]
NEEDED = {
    "measured": ("X_mm", "Y_mm", "Z_mm", "B_deg", "C_deg", "target", "carrier", "x_mm", "y_mm", "z_mm"),
    "record": ("time_s", "d_um"),
    "readings": ("X_mm",),
}
"""Columns without which a table is refused at once; they stay in nine of ten subsets."""
FEW, MANY = 6, 60
"""Subsets for a command in the default run and in a slow run, if it is not listed below."""
COSTLY = {"identify": (3, 20), "diagnose": (5, 12), "watch": (2, 8), "report": (2, 3)}


@cache
def measured() -> Columns:
    """Return a table of a tracker with every optional column: twelve positions, each from two stations and twice, two targets."""
    rng = np.random.default_rng(11)
    low, high = machine().limits.T / machine().scale
    places = np.round(rng.uniform(np.maximum(low, -300.0), np.minimum(high, 400.0), (12, 5)), 2)
    q = np.repeat(np.tile(places, (2, 1)), 2, axis=0)
    count = len(q)
    axes = [f"{axis.name}_{axis.unit}" for axis in machine().axes]
    found: Columns = {name: [f"{value:g}" for value in q[:, i]] for i, name in enumerate(axes)}
    place = np.tile([[10.0, 20.0, -30.0], [-40.0, 5.0, -60.0]], (count // 2, 1))
    found |= {"target": ["K1", "K2"] * (count // 2), "carrier": ["tool"] * count}
    found |= {f"place_{c}_mm": [f"{value:g}" for value in place[:, i]] for i, c in enumerate("xyz")}
    half = ["1"] * (count // 2) + ["2"] * (count // 2)
    found |= {"station": half, "round": half}
    at = {"x_mm": ("1500", "1200"), "y_mm": ("-900", "900"), "z_mm": ("400", "300")}
    at |= {f"{c}_deg": ("0", "0") for c in "abc"}
    found |= {f"station_{c}": [two[int(station) - 1] for station in half] for c, two in at.items()}
    found |= {"time_s": [f"{10 * k}" for k in range(count)]}
    found |= {f"approach_{axis.name}": [str(v) for v in rng.choice([-1, 1], count)] for axis in machine().axes}
    found |= {f"T_{s}_degC": [f"{20.0 + 0.02 * k * g:.2f}" for k in range(count)] for s, g in (("X", 1), ("bed", 2))}
    found |= {"spindle_rpm": ["0"] * count, "load_kg": [str(v) for v in rng.choice([0, 5], count)]}
    with scratch_folder() as folder:
        plan, made = folder / "plan.csv", folder / "made.csv"
        plan.write_text(text_of(found, list(found)))
        with pytest.raises(SystemExit) as ended:
            cli.main(["simulate", str(plan), "-o", str(made), "--seed", "1", "--quiet"])
        assert not ended.value.code
        rows = list(csv.DictReader(line for line in made.read_text().splitlines() if not line.startswith("#")))
    read = {f"{c}_mm": [row[f"{c}_mm"] for row in rows] for c in "xyz"}
    return found | read | {f"u_{c}_mm": ["0.005"] * count for c in "xyz"}


def record() -> Columns:
    """Return a record of a drift test."""
    t = np.arange(0.0, 7200.0, 60.0)
    rpm = np.where((t // 900) % 2 == 0, 0.0, 6000.0)
    warm = 22.0 + 4.0 * (1.0 - np.exp(-t / 1200.0))
    columns = {"time_s": t, "spindle_rpm": rpm, "T_nose_degC": warm, "T_bed_degC": 0.0 * t + 21.0}
    columns |= {"d_um": 3.0 * (warm - 22.0), "a_um": 0.5 * (warm - 22.0)}
    return {name: [f"{v:.3f}" for v in values] for name, values in columns.items()}


def readings() -> Columns:
    rows = list(csv.reader(line for line in io.StringIO(sample("readings")) if not line.startswith("#")))
    return {name: [row[i] for row in rows[1:]] for i, name in enumerate(rows[0])}


TABLES: dict[str, Callable[[], Columns]] = {"measured": measured, "record": record, "readings": readings}
COMMANDS: dict[str, tuple[str, list[str]]] = {
    "identify": (
        "measured",
        ["identify", "t.csv", "-o", "m.yaml", "--only", "E_XX", "E_YY", "E_C0Y", "--json", "m.json"],
    ),
    "diagnose": ("measured", ["diagnose", "t.csv", "--extended", "e.yaml", "--json", "d.json"]),
    "evaluate": ("measured", ["evaluate", "t.csv", "--json", "v.json", "--tolerance", "E=10"]),
    "watch": ("measured", ["watch", "checks", "--json", "w.json", "--tolerance", "0.1"]),
    "import": ("measured", ["import", "t.csv", "-o", "i.csv"]),
    "simulate": ("measured", ["simulate", "t.csv", "-o", "s.csv", "--seed", "1"]),
    "report": ("measured", ["report", "-o", "r.html", "--measured", "t.csv"]),
    "thermal": ("record", ["thermal", "t.csv", "-o", "m.yaml", "--json", "m.json"]),
    "drift": ("record", ["evaluate", "t.csv", "--iso230-3", "--sensors", "d=-Z", "a=X"]),
    "axis-run": (
        "readings",
        ["axis-run", "t.csv", "--layout", "nine_beams_x.yaml", "-o", "m.yaml", "--json", "m.json"],
    ),
}
"""Every command that reads a table, with the table and its words."""


def text_of(columns: Columns, names: list[str]) -> str:
    rows = zip(*(columns[name] for name in names), strict=True)
    return "\n".join([",".join(names), *(",".join(row) for row in rows)]) + "\n"


def subsets(table: str, count: int, seed: int) -> Iterator[tuple[Columns, list[str]]]:
    """Yield tables with subsets of the columns: none optional, all, each kind alone missing, then random ones."""
    columns = TABLES[table]()
    needed = [name for name in NEEDED[table] if name in columns]
    others = [name for name in columns if name not in needed]
    rng = np.random.default_rng(seed)
    yield columns, needed
    yield columns, [*needed, *others]
    for k in range(count - 2):
        kept = [name for name in others if rng.random() < rng.choice([0.2, 0.5, 0.8])]
        also = needed if k % 10 else [name for name in needed if rng.random() < 0.8]
        yield columns, [name for name in columns if name in {*also, *kept}]


def try_subsets(name: str, count: int, capsys: pytest.CaptureFixture[str]) -> None:
    table, words = COMMANDS[name]
    statuses = []
    for columns, names in subsets(table, count, seed=len(name)):
        target = Path("checks") if name == "watch" else Path()
        target.mkdir(exist_ok=True)
        for k in range(3 if name == "watch" else 1):
            (target / (f"c{k}.csv" if name == "watch" else "t.csv")).write_text(
                (f"# measured 2026-05-0{k + 1}\n" if name == "watch" else "") + text_of(columns, names)
            )
        try:
            statuses.append(done_or_refused(capsys, words))
        except (Exception, AssertionError) as error:
            raise AssertionError(f"{name} with the columns {' '.join(names)}: {error!r}") from error
        for left in ("checks.watch.sqlite", "i.csv.columns.yaml"):
            Path(left).unlink(missing_ok=True)
    assert {0, 3} & {*statuses}, "a valid subset is computed"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.sample(8)  # of 9
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name == "report" else []) for name in COMMANDS]
)
def test_a_subset_of_columns_is_computed_or_refused(
    folder: None, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    with short_chains():
        try_subsets(name, COSTLY.get(name, (FEW, MANY))[0], capsys)


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_many_subsets_of_columns_are_computed_or_refused(
    folder: None, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    try_subsets(name, COSTLY.get(name, (FEW, MANY))[1], capsys)
