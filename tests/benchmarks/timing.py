"""Processor times of repeated runs, peak memory, and the name of the computer."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Timing:
    """Processor seconds of every repeat, all threads together, and wall-clock seconds of the fastest."""

    processor_s: np.ndarray
    clock_s: float

    @property
    def best(self) -> float:
        return float(self.processor_s.min())

    def each(self, items: int) -> Timing:
        """Return microseconds per item."""
        return Timing(self.processor_s / items * 1e6, self.clock_s / items * 1e6)


def timed(work: Callable[[], object], repeats: int) -> Timing:
    """Time a function; processor time hardly depends on other load."""
    processor, clock = [], []
    for _ in range(repeats):
        start, begun = time.perf_counter(), time.process_time()
        work()
        processor.append(time.process_time() - begun)
        clock.append(time.perf_counter() - start)
    return Timing(np.array(processor), min(clock))


def ratio_range(other: Timing, ours: Timing) -> tuple[float, float, float]:
    """Return the ratio of the best times, and its smallest and largest value over the repeats."""
    low, high = other.processor_s.min() / ours.processor_s.max(), other.processor_s.max() / ours.best
    return other.best / ours.best, float(low), float(high)


def ratio(other: Timing, ours: Timing) -> str:
    """Return the ratio of two times, with its smallest and largest value over the repeats."""
    best, low, high = map(number, ratio_range(other, ours))
    return f"{best:>9} times ours ({low} to {high})"


def number(ratio: float) -> str:
    """Return a ratio with two significant digits, from 100 on as a whole number."""
    return f"{ratio:,.0f}" if ratio >= 100.0 else f"{ratio:.2g}"


def peak_mb() -> float:
    """Return the peak memory of this process in MB; ``ru_maxrss`` may include that of the parent process."""
    status = Path("/proc/self/status").read_text()
    return int(next(line for line in status.splitlines() if line.startswith("VmHWM")).split()[1]) / 1024.0


def machine_name() -> str:
    """Return processor, number of cores and load."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    widest = next((kind for kind in ("avx512f", "avx2") if any(kind in line for line in lines)), "")
    return (
        f"{names[0] if names else platform.processor()} {widest}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}"
    )
