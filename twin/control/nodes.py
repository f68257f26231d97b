"""Where the nodes of a table stand: in equal steps, as few as keep the straight lines between them within a tolerance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.arrays import locked
from twin._common.errors import InputError

Truth = Callable[[np.ndarray], np.ndarray]
"""(n,) positions, mm or degrees → (n, k) values."""
RESOLUTION: Final = 1e-4
"""mm and degrees: nodes are whole numbers of these, so that no format rounds them."""
BETWEEN: Final = 20
"""Places looked at between a node and the next: the peak of a parabola is missed by a thousandth."""
MARGIN: Final = 1.02


@final
@dataclass(frozen=True)
class Nodes:
    """Nodes of the tables over one axis.

    Attributes:
        at: positions, mm or degrees.
        values: (nodes, k) the truth there.
        off: (k,) largest distance of the truth from the straight lines, in its unit.
    """

    at: np.ndarray
    values: np.ndarray
    off: np.ndarray


def chosen(truth: Truth, low: float, high: float, tolerance: np.ndarray, *, step: float | None, most: int) -> Nodes:
    """The nodes.

    Args:
        truth: what is to be interpolated, (n, k).
        low: where the range begins, mm or degrees.
        high: where it ends.
        tolerance: (k,) of the interpolation.
        step: asked for; None: as wide as the tolerance allows. The next smaller one that divides the range is taken.
        most: points the format has.

    Raises:
        InputError: a step that is not positive, or that wants more points than there are.
    """
    whole = round((high - low) / RESOLUTION)
    counts = [n for n in range(1, most) if whole % n == 0]
    if step is not None:
        if step <= 0.0:
            raise InputError("--step is not positive", expected="mm (degrees of a rotary axis)", value=step)
        fine = [n for n in counts if (high - low) / n <= step * (1.0 + 1e-9)]
        if not fine:
            raise InputError(
                "--step wants more points than the format has",
                expected=f"at least {(high - low) / counts[-1]:g} over {low:g} … {high:g}",
                value=step,
            )
        return at(truth, np.linspace(low, high, fine[0] + 1))
    for n in counts:
        found = at(truth, np.linspace(low, high, n + 1))
        if np.all(found.off <= tolerance):
            break
    return found


def at(truth: Truth, nodes: np.ndarray) -> Nodes:
    """The truth at given nodes, and how far it is from the straight lines between them."""
    nodes = np.round(nodes / RESOLUTION) * RESOLUTION
    dense = np.interp(np.arange(BETWEEN * (len(nodes) - 1) + 1) / BETWEEN, np.arange(len(nodes)), nodes)
    seen = truth(dense)
    values = seen[::BETWEEN]
    lines = np.stack([np.interp(dense, nodes, column) for column in values.T], axis=1)
    return Nodes(locked(nodes), locked(values), locked(MARGIN * np.abs(seen - lines).max(axis=0)))
