"""Measure time and memory as functions of size: run ``python -m tests.benchmarks.growth [-o growth.png] [--most N]`` (ten minutes).

Inverse and forward kinematics of poses, compensation of blocks from file to file (10³ to 10⁶), identification and diagnosis of points
(10³ to 10⁵). Each runs in its own process, for its peak memory, after a small run that loads and compiles everything. Times are
wall-clock times on all cores.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.benchmarks import programs, solve
from tests.benchmarks.diagnosis import measured
from tests.benchmarks.timing import machine_name, peak_mb
from twin.compensation import Compensator, Options
from twin.diagnosis import diagnose
from twin.identification import identify
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.tool.forward import Kinematics
from twin.tool.inverse import Inverse

SIZES = (1_000, 3_162, 10_000, 31_623, 100_000, 316_228, 1_000_000)
MEASURED = 100_000
"""Largest number of points of identification and diagnosis."""
WARM = 1_000
COMPILED = 60_000
"""Number of poses or blocks that triggers all compilation."""

Work = Callable[[], object]


def _forward(machine: Machine, size: int) -> Work:
    real = Kinematics(machine, Calibration.default(machine), tool_length_mm=solve.LENGTH_MM)
    some = solve.poses(machine, size, (0.0, 180.0))[1]
    return lambda: real.forward(some)


def _inverse(machine: Machine, size: int) -> Work:
    inverse = Inverse(Kinematics(machine, Calibration.default(machine), tool_length_mm=solve.LENGTH_MM))
    target, q = solve.poses(machine, size, (20.0, 160.0))
    return lambda: inverse.solve(target, q)


def _program(machine: Machine, size: int) -> Work:
    compensator = Compensator(machine, Calibration.default(machine), Options(tool_length_mm=120.0))
    folder = tempfile.TemporaryDirectory()
    source, target = Path(folder.name) / "p.nc", Path(folder.name) / "out.nc"
    programs.program(source, size)

    def work(folder: tempfile.TemporaryDirectory[str] = folder) -> object:
        return compensator.compensate_file(source, target)

    return work


def _identify(machine: Machine, size: int) -> Work:
    data = measured(machine, size)
    return lambda: identify(data, machine)


def _diagnose(machine: Machine, size: int) -> Work:
    data = measured(machine, size)
    return lambda: diagnose(data, machine)


def _diagnose_uncertain(machine: Machine, size: int) -> Work:
    """Prepare a diagnosis with a calibration identified from other readings, which is uncertain in some 400 numbers."""
    calibration = identify(measured(machine, 3 * WARM, seed=9), machine).calibration
    data = measured(machine, size)
    return lambda: diagnose(data, machine, calibration)


KINDS: dict[str, tuple[Callable[[Machine, int], Work], int, int]] = {
    "forward, poses": (_forward, COMPILED, SIZES[-1]),
    "inverse with errors, poses": (_inverse, COMPILED, SIZES[-1]),
    "compensate, blocks": (_program, COMPILED, SIZES[-1]),
    "identify, points": (_identify, WARM, MEASURED),
    "diagnose, points": (_diagnose, WARM, MEASURED),
    "diagnose, uncertain calibration, points": (_diagnose_uncertain, WARM, MEASURED),
}
"""For every kind: the function that prepares the work, the size of the warm-up run, and the largest size."""


def one(kind: str, size: int) -> dict[str, float]:
    """Return seconds and peak memory in MB of one run."""
    make, warm, _ = KINDS[kind]
    machine = Machine.load("dmu50")
    make(machine, warm)()
    work = make(machine, size)
    start = time.perf_counter()
    work()
    seconds = time.perf_counter() - start
    return {"seconds": seconds, "mb": peak_mb()}


def drawn(path: Path, found: dict[str, list[tuple[int, float, float]]], title: str) -> None:
    """Plot time and memory on logarithmic axes, with a line of proportional growth."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 4.8), layout="constrained")
    for axes, column, label in zip(figure.subplots(1, 2), (1, 2), ("time / s", "peak memory / MB"), strict=True):
        for kind, rows in found.items():
            axes.loglog([row[0] for row in rows], [row[column] for row in rows], "o-", label=kind)
        axes.set_xlabel("size")
        axes.set_ylabel(label)
        axes.grid(visible=True, which="both", alpha=0.25)
        if column == 1:
            sizes = np.array([SIZES[0], SIZES[-1]])
            axes.loglog(sizes, sizes * 1e-4, "k:", label="proportional")
            lines = axes.get_legend_handles_labels()
    figure.legend(*lines, loc="outside lower center", ncols=4, fontsize="small")
    figure.suptitle(title)
    figure.savefig(path, dpi=110)


def main(arguments: list[str] | None = None) -> None:
    """Run all kinds and sizes; print a table with the exponents at the upper end, and save the plot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("growth.png"))
    parser.add_argument("--most", type=int, default=SIZES[-1])
    parser.add_argument("--one", nargs=2, metavar=("KIND", "SIZE"))
    options = parser.parse_args(arguments)
    if options.one:
        sys.stdout.write(json.dumps(one(options.one[0], int(options.one[1]))))
        return
    title = machine_name()
    print(title)
    found: dict[str, list[tuple[int, float, float]]] = {}
    for kind, (_, _, most) in KINDS.items():
        for size in [size for size in SIZES if size <= min(most, options.most)]:
            command = [sys.executable, "-m", "tests.benchmarks.growth", "--one", kind, str(size)]
            result = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
            found.setdefault(kind, []).append((size, result["seconds"], result["mb"]))
            print(f"  {kind:40} {size:>10,} {result['seconds']:>9.3f} s {result['mb']:>7.0f} MB", flush=True)
        if len(found[kind]) > 1:
            (n, first, _), (m, last, _) = found[kind][-2:]
            print(f"  {kind:40} grows with size to the power {np.log(last / first) / np.log(m / n):.2f} from {n:,} on")
    drawn(options.output, found, title)
    print(f"written: {options.output}")


if __name__ == "__main__":
    main()
