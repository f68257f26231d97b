"""Measure the compensation of programs: run ``python -m tests.benchmarks.programs [BLOCKS ...]`` (three minutes; default 10³ to 10⁶).

Five-axis programs from file to file: read, solve, check, split, write, read back, report. For comparison between computers the table
gives the times to copy the same bytes and of a plain Python loop that parses and prints the same words; the ratio is to that loop. Each
length runs in its own process, for its peak memory, after a program of 60,000 blocks that triggers compilation (`twin.compute.native`).

A second table gives other kinds of programs at `OF_A_KIND` blocks (`tests.benchmarks.kinds`).
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.benchmarks.kinds import KINDS, reversed_calibration
from tests.benchmarks.timing import machine_name, peak_mb
from twin.compensation import Compensator, Options
from twin.machine.machine import Machine
from twin.model.calibration import Calibration

LENGTHS = (1_000, 10_000, 100_000, 1_000_000)
WARM = 60_000
OF_A_KIND = 200_000
AT_ONCE = 50_000


def program(path: Path, blocks: int) -> None:
    """Write a program over most of the DMU 50: all axes move by some tenths of a millimetre in every block; three decimals."""
    with path.open("w") as out:
        out.write("%\nG90 G21\nG1 F2000\n")
        for first in range(0, blocks, AT_ONCE):
            t = np.arange(first, min(first + AT_ONCE, blocks)) / 1e5
            x, y, z = 250 + 150 * np.cos(40 * t), 225 + 120 * np.sin(43 * t), -200 + 80 * np.sin(9 * t)
            b, c = 45 + 30 * np.sin(5 * t), 180 + 150 * np.cos(7 * t)
            rows = np.stack([x, y, z, b, c], axis=1)
            out.write("".join("G1 X{:.3f} Y{:.3f} Z{:.3f} B{:.3f} C{:.3f}\n".format(*row) for row in rows.tolist()))
        out.write("M30\n%\n")


def copied(source: Path, target: Path) -> float:
    """Return the seconds to copy a file and sync it to disk, as `twin._common.files.atomic_file` does."""
    start = time.perf_counter()
    with source.open("rb") as data, target.open("wb") as out:
        while block := data.read(1 << 20):
            out.write(block)
        out.flush()
        os.fsync(out.fileno())
    return time.perf_counter() - start


def plain_loop(source: Path, target: Path) -> float:
    """Return the seconds of a plain Python loop that reads, splits, parses and prints the same words."""
    start = time.perf_counter()
    with source.open() as data, target.open("w") as out:
        for line in data:
            words = line.split()
            out.write(" ".join([f"{word[0]}{float(word[1:]):.3f}" if word[0] in "XYZBC" else word for word in words]))
            out.write("\n")
    return time.perf_counter() - start


def one(blocks: int) -> None:
    """Print one line of the table."""
    machine = Machine.load("dmu50")
    compensator = Compensator(machine, Calibration.default(machine), Options(tool_length_mm=120.0))
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "p.nc", Path(folder) / "out.nc"
        program(source, WARM)
        compensator.compensate_file(source, target)
        program(source, blocks)
        floor, loop = copied(source, target), plain_loop(source, target)
        start, used = time.perf_counter(), time.process_time()
        report = compensator.compensate_file(source, target)
        seconds, used = time.perf_counter() - start, time.process_time() - used
    peak = peak_mb()
    print(
        f"{report.moves:>10,} {seconds:>9.2f} {report.moves / seconds:>11,.0f} {used / report.moves * 1e6:>12.1f} "
        f"{floor:>9.3f} {loop:>8.2f} {seconds / loop:>8.2f} {peak:>8.0f}",
        flush=True,
    )


def one_of_a_kind(name: str) -> None:
    """Print processor time and peak memory of one kind of program."""
    kind, machine = KINDS[name], Machine.load("dmu50")
    calibration = reversed_calibration(machine) if kind.reversals else Calibration.default(machine)
    compensator = Compensator(machine, calibration, Options(tool_length_mm=120.0, tcp=kind.tcp))
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / f"p{kind.suffix}", Path(folder) / f"out{kind.suffix}"
        for blocks in (WARM, OF_A_KIND):
            source.write_text(kind.text(blocks))
            start, used = time.perf_counter(), time.process_time()
            compensator.compensate_file(source, target)
            seconds, used = time.perf_counter() - start, time.process_time() - used
    print(f"{name:>24} {seconds:>9.2f} {used / OF_A_KIND * 1e6:>12.1f} {peak_mb():>8.0f}", flush=True)


def main(arguments: list[str]) -> None:
    """Run all lengths and kinds, each in its own process."""
    if arguments[:1] == ["--one"]:
        one(int(arguments[1]))
        return
    if arguments[:1] == ["--kind"]:
        one_of_a_kind(arguments[1])
        return
    print(machine_name())
    print(
        f"{'blocks':>10} {'s':>9} {'blocks/s':>11} {'µs/block':>12} {'copy, s':>9} {'loop, s':>8} {'ratio':>8} {'MB':>8}",
        flush=True,
    )
    print(f"{'':>10} {'':>9} {'':>11} {'(processor)':>12}", flush=True)
    for blocks in [int(argument) for argument in arguments] or LENGTHS:
        subprocess.run([sys.executable, "-m", "tests.benchmarks.programs", "--one", str(blocks)], check=True)
    if not arguments:
        print(f"{f'{OF_A_KIND:,} blocks of':>24} {'s':>9} {'µs/block':>12} {'MB':>8}", flush=True)
        for name in KINDS:
            subprocess.run([sys.executable, "-m", "tests.benchmarks.programs", "--kind", name], check=True)


if __name__ == "__main__":
    main(sys.argv[1:])
