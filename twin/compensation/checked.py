"""Written program → checked: what was written, read back, beside what was meant."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin._common.errors import InputError, OutputError
from twin.compensation.solving.rows import counted
from twin.nc.iso.bulk import NewPositions

PRINTED_MM: Final = 2e-4
"""What printing may change of a word (mm, degrees): half a unit of the last decimal, of inch words too."""


def check(source: str, lines: np.ndarray, new: NewPositions, got: np.ndarray) -> None:
    """Compare the output with what was meant.

    Args:
        source: the program's name.
        lines: (moves,) line numbers of the program's moves.
        new: what replaces them.
        got: (n, axes) where the moves of the output end.

    Raises:
        OutputError: they differ.
    """
    of, within = counted(np.arange(len(lines)), np.maximum(new.count, 1))
    if len(got) != len(of):
        line = int(lines[of[min(len(got), len(of) - 1)]]) if len(of) else 0
        raise OutputError(f"{source}:{line}: {len(got)} moves in the output, {len(of)} meant")
    changed = new.count[of] > 0
    wanted = new.positions[(new.first[of] + within)[changed]]
    got = got[changed]
    off = (np.abs(got - wanted) > PRINTED_MM).any(axis=1)
    if np.any(off):
        at = int(np.flatnonzero(off)[0])
        raise OutputError(f"{source}:{int(lines[of[changed][at]])}: the output says {got[at]}, not {wanted[at]}")


def unreadable(source: str, error: InputError) -> OutputError:
    """Return the error for a text made of a program that cannot be read back; its line is the output's, not the program's."""
    return OutputError(f"{source}: line {error.line} of what would be written cannot be read back: {error.what}")


def motionless(source: str) -> InputError:
    """Return the error for a program without a motion."""
    return InputError("no block that moves an axis to a known place", expected="a program with motion", file=source)
