"""Check of the output: the written program is read back and compared with the intended positions."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin._common.errors import InputError, OutputError
from twin.compensation.solving.rows import repeat_with_index
from twin.nc.columns import NewPositions

PRINTED_MM: Final = 2e-4
"""Largest difference (mm, degrees) that printing can cause: half a unit of the last decimal, also for inch words."""


def check(source: str, lines: np.ndarray, new: NewPositions, got: np.ndarray) -> None:
    """Compare the output with the intended positions.

    Args:
        source: the program's name.
        lines: (moves,) line numbers of the program's moves.
        new: positions that replace them.
        got: (n, axes) end positions of the moves read back from the output.

    Raises:
        OutputError: they differ.
    """
    one_each = len(got) == len(new.count) == len(new.positions) and bool(np.all(new.count == 1))
    if one_each and np.all(np.abs(got - new.positions) <= PRINTED_MM):  # the usual case
        return
    of, within = repeat_with_index(np.arange(len(lines)), np.maximum(new.count, 1))
    if len(got) != len(of):
        line = int(lines[of[min(len(got), len(of) - 1)]]) if len(of) else 0
        raise OutputError(f"{source}:{line}: {len(got)} moves in the output, {len(of)} expected")
    changed = new.count[of] > 0
    wanted = new.positions[(new.first[of] + within)[changed]]
    got = got[changed]
    off = np.abs(got - wanted) > PRINTED_MM
    if np.any(off):
        at = int(np.flatnonzero(off.any(axis=1))[0])
        raise OutputError(f"{source}:{int(lines[of[changed][at]])}: the output has {got[at]}, expected {wanted[at]}")


def unreadable(source: str, error: InputError) -> OutputError:
    """Return the error for output that cannot be read back; the line number is that of the output, not of the program."""
    return OutputError(f"{source}: line {error.line} of the output cannot be read back: {error.what}")
