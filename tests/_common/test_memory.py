"""The memory that a process may use: the lowest of the computer's, its own limit, and those of its control groups."""

from __future__ import annotations

from pathlib import Path

import pytest

from twin._common import resources as memory

FILES = {
    "version 2": ("0::/app/job\n", {"app/memory.max": "300000", "app/job/memory.max": "max"}, 300_000.0),
    "version 2, inside a container": ("0::/../..\n", {"memory.max": "200000"}, 200_000.0),
    "version 1": (
        "5:cpu,cpuacct:/x\n4:memory:/docker/a\n1:name=systemd:/\n",
        {"memory/docker/a/memory.limit_in_bytes": "100000", "cpu/x/memory.limit_in_bytes": "1"},
        100_000.0,
    ),
    "version 1, named from outside": (
        "4:memory:/docker/a\n0::/\n",
        {"memory/memory.limit_in_bytes": "400000"},
        400_000.0,
    ),
}


@pytest.mark.parametrize("name", FILES)
def test_the_limit_of_a_control_group_counts(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    groups, files, expected = FILES[name]
    for place, text in {"proc/self/cgroup": groups, **{f"sys/fs/cgroup/{one}": v for one, v in files.items()}}.items():
        (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / place).write_text(f"{text.rstrip()}\n")
    monkeypatch.setattr(memory, "SYSTEM_ROOT", tmp_path)
    assert memory.memory_bytes() == expected


def test_no_limit_is_the_memory_of_the_computer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Version 1 writes a number larger than any memory where there is no limit."""
    monkeypatch.setattr(memory, "SYSTEM_ROOT", tmp_path)
    whole = memory.memory_bytes()
    (tmp_path / "proc/self").mkdir(parents=True)
    (tmp_path / "proc/self/cgroup").write_text("3:memory:/\n")
    (tmp_path / "sys/fs/cgroup/memory").mkdir(parents=True)
    (tmp_path / "sys/fs/cgroup/memory/memory.limit_in_bytes").write_text("9223372036854771712\n")
    assert memory.memory_bytes() == whole
