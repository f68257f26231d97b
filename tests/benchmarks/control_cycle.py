"""Cycle time of the kinematics with errors inside LinuxCNC: ``python -m tests.benchmarks control_cycle``, as root.

The control's servo thread is timed by the control itself, with its own kinematics and with the module, while the same program runs. In
every cycle the control calls the inverse and the forward kinematics, and the module's ``update``. Its times are clock cycles of the
processor (``rtapi_get_clocks``).
"""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import twin
from tests.benchmarks.timing import machine_name
from tests.linuxcnc.control import control
from twin.compensation.live import make_module, write_module

MODULE = Path("/usr/lib/linuxcnc/modules/twinkins.so")
PINS = ("#motion-controller.time", "#servo-thread.time")
PROGRAM = "G21 G90 G94\nF20000\nG53 G1 X100 Y100 Z-100 B80 C100\nG53 G1 X400 Y350 Z-300 B20 C300\nG53 G1 X200 Y225 Z-200 B60 C0\nM2\n"
HOME = {"X": 250.0, "Y": 225.0, "Z": -200.0, "B": 20.0, "C": 0.0}
ROUNDS = 3
CLOCK = """
#include <stdio.h>
#include <time.h>
#include <x86intrin.h>
int main(void) {
    struct timespec a, b;
    clock_gettime(CLOCK_MONOTONIC, &a);
    unsigned long long first = __rdtsc();
    do clock_gettime(CLOCK_MONOTONIC, &b); while (b.tv_sec - a.tv_sec + 1e-9 * (b.tv_nsec - a.tv_nsec) < 0.2);
    printf("%.6f", (__rdtsc() - first) / (1e6 * (b.tv_sec - a.tv_sec) + 1e-3 * (b.tv_nsec - a.tv_nsec)));
}
"""


def clocks_per_us() -> float:
    """Return the clock cycles of a microsecond."""
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "clock.c").write_text(CLOCK)
        subprocess.run(["gcc", "clock.c", "-o", "clock"], cwd=name, check=True)
        return float(subprocess.run([f"{name}/clock"], check=True, capture_output=True, text=True).stdout)


def times(machine: twin.Machine, module: Path | None) -> np.ndarray:
    """Return (cycles, 3) times in clock cycles: motion controller, servo thread, and the module's own function (0 without it)."""
    on: list[list[Any]] = [["hal", ["setp", "twinkins.enable", "1"]], ["sleep", 2.0]] if module else []
    own = ["#twinkins.update.time"] if module else []
    with tempfile.TemporaryDirectory(prefix="twin-cycle-") as name:
        folder = Path(name)
        (folder / "part.ngc").write_text(PROGRAM)
        ran = control(
            folder,
            machine,
            [["home"], *on, ["record", "times.txt"], ["program", "part.ngc"], ["stop"]],
            home=HOME,
            kinematics="twinkins" if module else "",
            hal=(module / "twinkins.hal").read_text() if module else "",
            pins=[*PINS, *own],
        )
        found = ran.samples("times.txt")
    return found if module else np.hstack([found, np.zeros((len(found), 1))])


def main() -> None:
    """Print the medians of all cycles, and what the module adds."""
    machine = twin.Machine.load("dmu50")
    with tempfile.TemporaryDirectory(prefix="twin-module-") as name:
        folder = Path(name)
        write_module(make_module(twin.Calibration.default(machine), tool_length_mm=120.0), folder)
        subprocess.run(["halcompile", "--install", "twinkins.c"], cwd=folder, check=True, capture_output=True)
        try:
            both = [(times(machine, None), times(machine, folder)) for _ in range(ROUNDS)]
        finally:
            MODULE.unlink()
    plain, errors = (np.vstack(one) / clocks_per_us() for one in zip(*both, strict=True))
    print(machine_name())
    for name, rows in (("trivkins", plain), ("twinkins", errors)):
        controller, thread, update = np.median(rows, axis=0)
        print(
            f"{name}: {len(rows)} cycles, median {controller:.1f} µs motion controller, {update:.1f} µs update, "
            f"{thread:.1f} µs thread, largest {rows[:, 1].max():.0f} µs thread"
        )
    added = np.median(errors, axis=0) - np.median(plain, axis=0)
    print(f"added: {added[0]:.1f} µs inverse and forward kinematics, {added[1]:.1f} µs servo thread in all")


if __name__ == "__main__":
    main()
