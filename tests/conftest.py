from __future__ import annotations

import datetime
import gc
import os
import re
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from xdist.scheduler import LoadFileScheduling

from twin._common.resources import one_blas_thread
from twin.cli import OBJECTS, commands
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.planning import Kit, Plan, duration, plan
from twin.samples import thesis_plan

# Bytecode is kept even where PYTHONDONTWRITEBYTECODE is set: else every command that a test starts compiles twin anew.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

os.environ.setdefault("OMP_NUM_THREADS", "1")  # of the commands that tests start: the run itself uses all cores
# Three workers share two cores (pyproject.toml): threads of a linear algebra library would only stand in each other's way.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
one_blas_thread()

# As every command does: searching for reference cycles takes a third of the time of the collection of tests.
gc.set_threshold(OBJECTS, 10, 10)

# Each call builds every command that is imported: one in a user's process, twenty here.
commands.load = cache(commands.load)

# No deadline: two shared cores make time no measure of right or wrong. By default the same few examples every time; a slow run
# draws new ones, and more, from a seed (`pytest_configure`), and keeps no database, so that the seed alone brings a failure back.
settings.register_profile(
    "twin", deadline=None, derandomize=True, max_examples=25, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile(
    "new examples", settings.get_profile("twin"), derandomize=False, max_examples=200, database=None
)
settings.load_profile("twin")

SHARED = Path(__file__).resolve().parents[2] / "shared"
NEEDED = "needs shared/{}, which is not beside this checkout"
"""Reason of a skip, with the path that is missing."""


def beside(*parts: str) -> Path:
    """Return the file or folder of that name under `SHARED`; skip the test if it is not there."""
    found = SHARED.joinpath(*parts)
    if not found.exists():
        pytest.skip(NEEDED.format("/".join(parts)))
    return found


def skipped_for_want(reasons: Iterable[str]) -> str:
    """Return one line on the tests that were skipped because files are missing; empty if none was.

    Args:
        reasons: of all skips.
    """
    pattern = re.compile(re.escape(NEEDED).replace(r"\{\}", "(.+)"))
    missing = Counter(found[1] for reason in reasons if (found := pattern.search(reason)))
    count = sum(missing.values())
    names = ", ".join(f"{name} ({number})" for name, number in sorted(missing.items()))
    return f"{count} tests skipped: they need files of others that are not in {SHARED}: {names}" if count else ""


def pytest_configure(config: pytest.Config) -> None:
    """Draw new examples where slow tests are selected; the seed is the day's date unless one is given."""
    words = re.sub(r"\bnot slow\b", "", str(config.getoption("markexpr", "")))
    if not re.search(r"\bslow\b", words) or config.getoption("hypothesis_profile", None):
        return
    settings.load_profile("new examples")
    if config.getoption("hypothesis_seed", None) is None:
        config.option.hypothesis_seed = f"{datetime.datetime.now(datetime.UTC):%Y%m%d}"


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark as slow what `sample(n)` leaves out of the default run: all cases of a test but n, spread evenly over their order."""
    cases: dict[tuple[str, int], list[pytest.Item]] = {}
    for item in items:
        mark = item.get_closest_marker("sample")
        if mark is not None and item.get_closest_marker("slow") is None:
            cases.setdefault((item.nodeid.partition("[")[0], mark.args[0]), []).append(item)
    for (_, count), of_test in cases.items():
        chosen = set(np.linspace(0, len(of_test) - 1, count).round().astype(int).tolist())
        for place, item in enumerate(of_test):
            if place not in chosen:
                item.add_marker(pytest.mark.slow)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Say how many tests were skipped for want of files, and how the run's examples can be drawn again."""
    skips = terminalreporter.stats.get("skipped", [])
    line = skipped_for_want(one.longrepr[2] for one in skips if isinstance(one.longrepr, tuple))
    if line:
        terminalreporter.write_line(line)
    seed = config.getoption("hypothesis_seed", None)
    if seed is not None:
        terminalreporter.write_line(f"new examples of hypothesis, drawn with --hypothesis-seed={seed}")


class OneControl(LoadFileScheduling):
    """Modules stay together, and those that run LinuxCNC go to one process: a computer runs one control.

    They go first: a control moves in real time, so that this process waits for minutes, in which the others have both cores.
    """

    CONTROL = "tests/linuxcnc"

    def _split_scope(self, nodeid: str) -> str:
        return self.CONTROL if nodeid.startswith(f"{self.CONTROL}/") else str(super()._split_scope(nodeid))

    def _assign_work_unit(self, node: Any) -> None:
        if self.CONTROL in self.workqueue:
            self.workqueue.move_to_end(self.CONTROL, last=False)
        super()._assign_work_unit(node)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> OneControl:
    return OneControl(config, log)


@pytest.fixture(scope="session")
def dmu50() -> Machine:
    return Machine.load("dmu50")


@pytest.fixture(scope="session")
def calibration(dmu50: Machine) -> Calibration:
    return Calibration.default(dmu50)


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep compiled code in a folder of the run, so that the user's cache is neither read nor written; its workers share it."""
    base = tmp_path_factory.getbasetemp()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str((base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "cache"))
        yield


@pytest.fixture
def without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Embed an empty picture for each figure of a page: drawing them takes half of a page's time."""
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda figure, file, **more: file.write(b"<svg/>"))


def two_stations(dmu50: Machine) -> Kit:
    """Return the kit of the machine with a tracker left and right."""
    own = Kit.default(dmu50)
    return replace(own, stations=MappingProxyType({name: own.stations[name] for name in ("left", "right")}))


@pytest.fixture(scope="session")
def half(dmu50: Machine) -> Plan:
    """A plan that takes as long as half of the thesis's, by the same clock, with a tracker left and right."""
    own = two_stations(dmu50)
    whole = thesis_plan.plan(dmu50)
    first = whole.select(np.isin(whole.round, ["1", "2"]))
    return plan(dmu50, own, minutes=duration(dmu50, own, first) / 60.0)


@pytest.fixture(scope="session")
def programs() -> Path:
    return beside("data", "programs")
