"""Messages of a test run: tests skipped because files are missing, and the seed of its random examples."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import NEEDED, SHARED, skipped_for_want

ROOT = Path(__file__).resolve().parents[2]
DRAWN = """
from pathlib import Path
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.conftest import beside

@settings(max_examples=3)
@given(st.integers(0, 10**9))
def test_draws(number):
    with Path("drawn").open("a") as file:
        file.write(f"{number} ")

@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 2])
def test_files(number):
    beside("of others")
"""


def test_skips_for_missing_files_are_one_line() -> None:
    assert skipped_for_want([]) == skipped_for_want(["Skipped: no Chromium here"]) == ""
    reasons = [f"Skipped: {NEEDED.format(name)}" for name in ("data/programs", "data/real", "data/programs")]
    line = skipped_for_want([*reasons, "Skipped: no Chromium here"])
    assert "\n" not in line and line.startswith("3 tests skipped") and str(SHARED) in line
    assert line.endswith("data/programs (2), data/real (1)")


@pytest.mark.slow
def test_the_slow_run_draws_new_examples_and_prints_their_seed(tmp_path: Path) -> None:
    """By default the same three numbers every time; with slow tests selected other ones, reproducible from the seed."""
    folder = tmp_path / "tests"
    folder.mkdir()
    (folder / "__init__.py").touch()
    shutil.copy(ROOT / "tests" / "conftest.py", folder)
    (folder / "slow.txt").touch()
    (folder / "test_drawn.py").write_text(DRAWN)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = slow\naddopts = -q -n 2 --dist loadfile")

    def run(*arguments: str) -> tuple[str, str]:
        (tmp_path / "drawn").unlink(missing_ok=True)
        command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *arguments]
        # In the common folder of temporary files it would take the rights of the user that runs LinuxCNC away.
        own = {**os.environ, "PYTEST_DEBUG_TEMPROOT": str(tmp_path)}
        done = subprocess.run(command, cwd=tmp_path, env=own, capture_output=True, text=True, timeout=300, check=True)
        return (tmp_path / "drawn").read_text(), done.stdout

    default, said = run("-m", "not slow")
    assert default == run("-m", "not slow")[0] and "seed" not in said
    new, said = run("-m", "slow or hypothesis")
    assert "2 tests skipped" in said and "of others (2)" in said
    seed = said.split("--hypothesis-seed=")[1].split()[0]
    assert new != default and new == run("-m", "slow or hypothesis", "--hypothesis-seed", seed)[0]
    assert new != run("-m", "slow or hypothesis", "--hypothesis-seed", "1")[0]
