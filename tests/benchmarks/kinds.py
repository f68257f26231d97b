"""Programs for `tests.benchmarks.programs`: other languages, tool-tip words, drilling cycles, arcs, and a machine with backlash."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.effects import Reversal

HOLES_EACH = 5
"""Strokes that a drilled hole takes; they count as blocks."""
CHORDS_EACH = 136
"""About how many chords replace a full circle; they count as blocks."""


class Kind(NamedTuple):
    """Kind of program: function from number of blocks to text, suffix of the file, mode, and whether the machine has backlash."""

    text: Callable[[int], str]
    suffix: str
    tcp: bool = False
    reversals: bool = False


def _axes(blocks: int) -> list[list[float]]:
    t = np.arange(blocks) / 1e5
    linear = [250 + 150 * np.cos(40 * t), 225 + 120 * np.sin(43 * t), -200 + 80 * np.sin(9 * t)]
    return np.stack([*linear, 45 + 30 * np.sin(5 * t), 180 + 150 * np.cos(7 * t)], axis=1).tolist()


def _tips(blocks: int) -> np.ndarray:
    t = np.arange(blocks) / 1e5
    return np.stack([60 * np.cos(40 * t), 50 * np.sin(43 * t), 80 + 30 * np.sin(9 * t)], axis=1)


def _iso(rows: list[list[float]]) -> str:
    lines = ("G1 X{:.3f} Y{:.3f} Z{:.3f} B{:.3f} C{:.3f}\n".format(*row) for row in rows)
    return f"%\nG90 G21\nG1 F2000\n{''.join(lines)}M30\n%\n"


def _tool_tip(blocks: int) -> str:
    t = np.arange(blocks) / 1e5
    turned = np.stack([30 + 20 * np.sin(5 * t), 180 + 150 * np.cos(7 * t)], axis=1)
    return _iso(np.hstack([_tips(blocks), turned]).tolist())


def _heidenhain(blocks: int) -> str:
    words = "{} L X{:+.3f} Y{:+.3f} Z{:+.3f} B{:+.3f} C{:+.3f} F2000\n"
    lines = (words.format(number, *row) for number, row in enumerate(_axes(blocks), start=1))
    return f"0 BEGIN PGM P MM\n{''.join(lines)}{blocks + 1} END PGM P MM\n"


def _apt(blocks: int) -> str:
    t = np.arange(blocks) / 1e5
    tilt, turn = np.radians(10 + 5 * np.sin(5 * t)), np.cos(7 * t)
    axis = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], axis=1)
    rows = np.hstack([_tips(blocks), axis]).tolist()
    lines = ("GOTO/{:.4f},{:.4f},{:.4f},{:.6f},{:.6f},{:.6f}\n".format(*row) for row in rows)
    return f"UNITS/MM\nFEDRAT/2000\n{''.join(lines)}FINI\n"


def _drilled(blocks: int) -> str:
    first, *others = _axes(blocks // HOLES_EACH)
    holes = "".join("X{:.3f} Y{:.3f}\n".format(*row[:2]) for row in others)
    cycle = "G81 X{:.3f} Y{:.3f} Z-200 R-150 F500\n".format(*first[:2])
    return f"G90 G21\nG0 Z-100 B0 C0\n{cycle}{holes}G80\nM30\n"


def _circles(blocks: int) -> str:
    lines = []
    for i in range(blocks // CHORDS_EACH):
        lines += [f"G1 X{200 + i % 97 * 0.5:.3f} Y{200 + i % 53 * 0.7:.3f}", f"G2 I{5 + i % 11}. J0."]
    return "\n".join(["G90 G21 G17", "G0 X200 Y200 Z-100 B0 C0", "G1 F1000 X200.", *lines, "M30", ""])


KINDS = {
    "ISO, axis words": Kind(lambda blocks: _iso(_axes(blocks)), ".nc"),
    "ISO, tool-tip words": Kind(_tool_tip, ".nc", tcp=True),
    "Heidenhain": Kind(_heidenhain, ".h"),
    "APT": Kind(_apt, ".cls"),
    "drilling, strokes": Kind(_drilled, ".nc"),
    "ISO, circles": Kind(_circles, ".nc"),
    "ISO, with backlash": Kind(lambda blocks: _iso(_axes(blocks)), ".nc", reversals=True),
}


def reversed_calibration(machine: Machine) -> Calibration:
    """Return the default calibration with reversal values of X, Y and B."""
    given = Calibration.default(machine)
    sizes = {"X": -8.0, "Y": -12.0, "B": -60.0}
    added = tuple(Reversal(machine.by_name[name], size) for name, size in sizes.items())
    return replace(given, extra=(*given.extra, *added))
