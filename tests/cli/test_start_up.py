"""Tests of the start of a command: help and errors of use need none of the large packages."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.commands import refused
from twin.cli.commands import COMMANDS

HEAVY = {"scipy", "casadi", "pinocchio", "pydantic", "matplotlib", "joblib", "jinja2"}
PROGRAM = """
import sys
from twin.cli.commands import load
for name in sys.argv[2:]:
    load(name)
print(*({name.split(".")[0] for name in sys.modules} & set(sys.argv[1].split())))
"""


def test_no_command_imports_a_large_package_before_it_runs() -> None:
    """`doctor` checks these packages."""
    names = [name for name in COMMANDS if name != "doctor"]
    ran = subprocess.run(
        [sys.executable, "-c", PROGRAM, " ".join(HEAVY), *names], capture_output=True, text=True, check=True
    )
    assert ran.stdout.split() == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("identify", "m.csv", "-o", "x.yaml"), "m.csv: cannot be read"),
        (("compensate", "part.nc", "-o", "x.nc"), "part.nc: no such program"),
        (("compensate", "cone_frustum.n", "-o", "x.nc"), "(did you mean cone_frustum.nc"),
        (("report", "-o", "x.html", "-c", "mine.yaml"), "mine.yaml: cannot be read"),
        (("simulate", "thesis_plan.cs", "-o", "x.csv"), "(did you mean thesis_plan.csv"),
        (("diagnose", "measured.csv"), "(did you mean measured1.csv"),
        (("control", "--to", "fanuk", "-o", "x"), "not one of 'linuxcnc'"),
    ],
)
def test_a_missing_input_is_named(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    arguments: tuple[str, ...],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "measured1.csv").write_text("")
    assert message in refused(capsys, *arguments)
    assert [file.name for file in tmp_path.iterdir()] == ["measured1.csv"]
