"""Linear algebra on one thread."""

from __future__ import annotations

import os
import subprocess
import sys


def test_every_library_of_linear_algebra_is_limited() -> None:
    """Limit a new process, in which scipy has not loaded its own library yet."""
    source = (
        "import numpy, threadpoolctl; from twin._common.resources import one_blas_thread; one_blas_thread(); import scipy.linalg;"
        "print(*(one['num_threads'] for one in threadpoolctl.threadpool_info() if one['user_api'] == 'blas'))"
    )
    given = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, "-c", source],
        capture_output=True,
        text=True,
        check=True,
        env=given | {"OPENBLAS_NUM_THREADS": "4"},
    )
    assert set(done.stdout.split()) == {"1"}
