"""Measure a forecast of a part: run ``python -m tests.benchmarks.part [--blocks N]`` (100,000 blocks, twenty features, a minute).

Bars: 20 s and 1 GB, the command as a user calls it, on an idle machine. The process of the command is measured, start-up included.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import twin
from tests.benchmarks.timing import machine_name

BLOCKS, FEATURES = 100_000, 20
BAR_S, BAR_MB = 20.0, 1000.0
PITCH_MM = 20.0


def write(folder: Path, blocks: int) -> tuple[Path, Path]:
    """Write a program of faces, circled bores and drilled holes in a raster, and the part."""
    holes = [(PITCH_MM * (i % 5 - 2), PITCH_MM * (i // 5 - 1.5)) for i in range(FEATURES - 1)]
    lines = ["G90 G21 G17", "B0 C0"]
    each = blocks // FEATURES
    rows = max(2, each // 100)
    for k, y in enumerate(np.linspace(-50.0, 50.0, rows)):
        xs = np.linspace(-60.0, 60.0, max(2, each // rows))
        lines += [
            f"G{int(k > 0 or i > 0)} X{250 + x:.4f} Y{225 + y:.4f} Z-240 F900" for i, x in enumerate(xs[:: (-1) ** k])
        ]
    lines.append("G0 Z-200")
    for i, (x, y) in enumerate(holes):
        if i % 2:
            turn = np.linspace(0.0, 2.0 * np.pi, 73)
            lines.append(f"G0 X{253 + x:.4f} Y{225 + y:.4f} Z-200")
            for level in np.linspace(-241.0, -255.0, max(2, each // len(turn))):
                lines += [
                    f"G1 X{250 + x + 3 * np.cos(t):.4f} Y{225 + y + 3 * np.sin(t):.4f} Z{level:.4f}" for t in turn
                ]
        else:
            lines.append(f"G0 X{250 + x:.4f} Y{225 + y:.4f} Z-200")
            lines += [f"G1 Z{z:.4f}" for z in np.linspace(-239.0, -255.0, each)]
        lines.append("G0 Z-200")
    features = "".join(
        f"  H{i}: {{kind: hole, point: [{x:g}, {y:g}, 40], depth: 14, diameter: {16 if i % 2 else 10}, tool: 1}}\n"
        for i, (x, y) in enumerate(holes)
    )
    tolerances = "".join(
        f"  - {{kind: position, of: H{i}, zone: 0.1, datums: [A, H{i - 1}, H{i - 2}]}}\n" for i in range(2, len(holes))
    )
    (folder / "part.yaml").write_text(
        "schema: twin.part/1\nunits: mm\nzero: table\ntools: [{number: 1, diameter: 10, cutting_length: 1}]\nfeatures:\n"
        "  A: {kind: plane, point: [0, 0, 40], normal: [0, 0, 1], within: [[-60, -50, 39], [60, 50, 41]]}\n"
        f"{features}tolerances:\n  - {{kind: flatness, of: A, zone: 0.02}}\n{tolerances}"
    )
    (folder / "part.nc").write_text("\n".join([*lines, "M30", ""]))
    return folder / "part.nc", folder / "part.yaml"


def main(arguments: list[str] | None = None) -> None:
    """Print time and memory beside their bars."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--blocks", type=int, default=BLOCKS)
    blocks = parser.parse_args(arguments).blocks
    machine = twin.Machine.load("dmu50")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        program, part = write(folder, blocks)
        twin.judge(twin.thesis_plan.plan(machine), machine).calibration.save(folder / "known.yaml")
        twin_at = Path(sys.executable).with_name("twin")
        call = [
            str(twin_at),
            "forecast",
            str(program),
            "--features",
            str(part),
            "--tool-length",
            "120",
            "-c",
            str(folder / "known.yaml"),
        ]
        begin, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run(call, capture_output=True, text=True, check=False)
        wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode not in (0, 3):
        raise SystemExit(done.stderr)
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    print(machine_name())
    print(f"{blocks:,} blocks, {FEATURES} features: {wall:.1f} s, of processor {processor:.1f} s (bar {BAR_S:.0f} s),")
    print(f"{after.ru_maxrss / 1024.0:.0f} MB (bar {BAR_MB:.0f} MB)")


if __name__ == "__main__":
    main()
