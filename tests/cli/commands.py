"""Run `twin` as a command, in a child process or in this one."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from twin import cli

TWIN = [sys.executable, "-m", "twin.cli"]


def twin(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*TWIN, *map(str, arguments)], capture_output=True, text=True, cwd=cwd, timeout=120, check=False
    )


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Run a command in this process, which must exit with status 2 and one line on stderr; return that line."""
    with pytest.raises(SystemExit) as stopped:
        cli.main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    assert stopped.value.code == 2, captured
    assert captured.err.count("\n") == 1
    return captured.err


def status(*arguments: object) -> int:
    """Run a command in this process and return its exit status."""
    with pytest.raises(SystemExit) as stopped:
        cli.main([str(argument) for argument in arguments])
    return int(stopped.value.code or 0)
