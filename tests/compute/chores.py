"""Tasks for `tests.compute.test_parallel`, in a module of its own that a worker imports quickly."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np

from twin._common.errors import InputError
from twin.tool.population import Draws, Tally


def squared(shared: int, task: int) -> int:
    return shared + task * task


def product(shared: int, task: int) -> np.ndarray:
    """Return a matrix product, whose last digits depend on the number of threads."""
    a = np.random.default_rng(np.random.SeedSequence(shared, spawn_key=(task,))).standard_normal((300, 300))
    return a @ a


def refusing(shared: int, task: int) -> int:
    if task == shared:
        raise InputError("no such number", expected="another", file="numbers.csv", line=7, value=task)
    return task


def drawn_and_once_dead(shared: tuple[Draws, Path], task: tuple[int, int]) -> Tally:
    """Return drawn machines; the first worker that has the third task kills itself."""
    draws, mark = shared
    if task[0] == 2 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return draws.part(task)


def deadly(shared: int, task: int) -> int:
    if task == shared:
        os.kill(os.getpid(), signal.SIGKILL)
    return task


def patient(shared: Path, task: int) -> int:
    """Leave a file named by task and process and sleep for a minute, or until the folder is gone, except in the first task."""
    (shared / f"{task} {os.getpid()}").touch()
    end = time.monotonic() + 60.0
    while task and shared.exists() and time.monotonic() < end:
        time.sleep(0.1)
    return task
