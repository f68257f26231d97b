"""Memory of a worker of a cluster, counted by the system: page faults of arrays made and freed again and again."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

COUNT = """
import resource
import numpy as np
from twin.compute.parallel import keep_freed_memory

def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(50):
        np.ones(100_000)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

before = faults()
keep_freed_memory()
faults()
print(before, faults())
"""
PAGES = 50 * 800_000 // 4096


def counted(limit: str) -> tuple[int, int]:
    """Return the page faults before and after `keep_freed_memory` in a new process in which this limit is set."""
    environment = {**os.environ, "MALLOC_TRIM_THRESHOLD_": limit}
    done = subprocess.run([sys.executable, "-c", COUNT], env=environment, capture_output=True, text=True, check=True)
    before, after = map(int, done.stdout.split())
    return before, after


@pytest.mark.skipif(sys.platform != "linux", reason="counts page faults of the GNU C library")
def test_the_limit_of_dask_is_lifted() -> None:
    """With it every array's pages are new; afterwards the freed memory is used again."""
    before, after = counted("65536")
    if before < PAGES // 2:
        pytest.skip("not the GNU C library")
    assert after < PAGES // 20


@pytest.mark.skipif(sys.platform != "linux", reason="counts page faults of the GNU C library")
def test_another_limit_stays() -> None:
    """A limit other than that of Dask is the choice of the user."""
    before, after = counted("65537")
    assert after > before // 2
