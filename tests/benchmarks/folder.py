"""Measure a folder of programs: run ``python -m tests.benchmarks.folder [PROGRAMS] [REPEATS]`` (default 200 and 3; five minutes).

`twin compensate` of programs of 5,000 to 20,000 five-axis blocks, start-up included, in one process, in two processes, and on a Dask
scheduler with two workers of one thread on this computer. The table gives wall-clock and processor seconds of every repeat (for Dask,
those of the command without its workers) and the ratio of the wall-clock times; below it, the memory of the largest process. With two
cores, the ratio means something only on an idle computer: the load stands above and beside the table.
"""

from __future__ import annotations

import os
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from shutil import rmtree

import numpy as np

from tests.benchmarks.programs import program
from tests.benchmarks.timing import machine_name

PROGRAMS = 200
REPEATS = 3
SHORTEST, LONGEST = 5_000, 20_000
LAUNCHED_S = 60.0


def written(folder: Path, count: int) -> list[Path]:
    """Write the programs, with lengths spread evenly and in random order."""
    lengths = np.random.default_rng(1).permutation(np.linspace(SHORTEST, LONGEST, count).astype(int))
    paths = [folder / f"p{i:03d}.nc" for i in range(count)]
    for path, blocks in zip(paths, lengths.tolist(), strict=True):
        program(path, blocks)
    return paths


@contextmanager
def cluster(folder: Path) -> Iterator[str]:
    """Run a Dask scheduler with two workers; yield its address."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    dask, log = [sys.executable, "-m", "dask"], subprocess.DEVNULL
    scheduler = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    worker = [
        "worker",
        address,
        "--nworkers",
        "2",
        "--nthreads",
        "1",
        "--no-dashboard",
        "--local-directory",
        str(folder),
    ]
    running = [subprocess.Popen([*dask, *one], stdout=log, stderr=log) for one in (scheduler, worker)]
    try:
        from distributed import Client

        with Client(address, timeout=LAUNCHED_S) as client:
            client.wait_for_workers(2, timeout=LAUNCHED_S)
        yield address
    finally:
        for process in reversed(running):
            process.send_signal(signal.SIGINT)
            process.wait(LAUNCHED_S)


def run(paths: list[Path], out: Path, more: list[str]) -> tuple[float, float]:
    """Compensate into a new folder; return wall-clock seconds, and processor seconds of the command and its processes."""
    rmtree(out, ignore_errors=True)
    command = [
        sys.executable,
        "-m",
        "twin.cli",
        "compensate",
        *map(str, paths),
        "-o",
        str(out),
        "--tool-length",
        "120",
        *more,
    ]
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main(arguments: list[str]) -> None:
    """Measure and print the table."""
    count, repeats = (*map(int, arguments), *(PROGRAMS, REPEATS)[len(arguments) :])
    print(machine_name())
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "programs").mkdir()
        paths = written(folder / "programs", count)
        found: dict[str, list[tuple[float, float]]] = {"one process": [], "two processes": [], "Dask, two workers": []}
        with cluster(folder) as address:
            ways = dict(zip(found, (["--workers", "1"], ["--workers", "2"], ["--scheduler", address]), strict=True))
            for _ in range(repeats):
                for name, more in ways.items():
                    found[name].append(run(paths, folder / "out", more))
    alone = min(wall for wall, _ in found["one process"])
    print(
        f"{'':<20}{'wall clock / s':<26}{'processor / s':<26}times as fast   load at the end {os.getloadavg()[0]:.1f}"
    )
    for name, runs in found.items():
        walls, processor = (" ".join(f"{value:.1f}" for value in column) for column in zip(*runs, strict=True))
        print(f"{name:<20}{walls:<26}{processor:<26}{alone / min(wall for wall, _ in runs):.2f}")
    print(f"largest process of the commands: {resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024.0:.0f} MB")


if __name__ == "__main__":
    main(sys.argv[1:])
