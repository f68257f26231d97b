"""Nodes of a table: equally spaced, and as few as keep the linear interpolation within a tolerance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError

Truth = Callable[[np.ndarray], np.ndarray]
"""Function from (n,) positions in mm or degrees to (n, k) values."""
RESOLUTION: Final = 1e-4
"""Nodes are multiples of this, in mm or degrees, so that no format rounds them."""
BETWEEN: Final = 20
"""Positions checked between two nodes: the peak of a parabola is missed by 0.1 %."""
MARGIN: Final = 1.02


@final
@dataclass(frozen=True)
class Nodes:
    """Nodes of the tables over one axis.

    Attributes:
        at: positions in mm or degrees.
        values: (nodes, k) values there.
        deviation: (k,) largest deviation from linear interpolation, in the unit of the values.
    """

    at: np.ndarray
    values: np.ndarray
    deviation: np.ndarray


def choose_nodes(
    truth: Truth, low: float, high: float, tolerance: np.ndarray, *, step: float | None, most: int
) -> Nodes:
    """Return the nodes for a range.

    Args:
        truth: the function to be interpolated.
        low: start of the range, mm or degrees.
        high: end of the range.
        tolerance: (k,) tolerance of the interpolation.
        step: distance between nodes, reduced to one that divides the range; None: as wide as the tolerance allows.
        most: largest number of nodes in the format.

    Raises:
        InputError: the step is not positive or needs too many nodes.
    """
    whole = round((high - low) / RESOLUTION)
    counts = [n for n in range(1, most) if whole % n == 0]
    if step is not None:
        if step <= 0.0:
            raise InputError("step must be positive", expected="mm (degrees for a rotary axis)", value=step)
        fine = [n for n in counts if (high - low) / n <= step * (1.0 + 1e-9)]
        if not fine:
            raise InputError(
                "the step needs more points than the format has",
                expected=f"at least {(high - low) / counts[-1]:g} over {low:g} … {high:g}",
                value=step,
                setting="step",
            )
        return nodes_at(truth, np.linspace(low, high, fine[0] + 1))
    for n in counts:
        found = nodes_at(truth, np.linspace(low, high, n + 1))
        if np.all(found.deviation <= tolerance):
            break
    return found


def nodes_at(truth: Truth, nodes: np.ndarray) -> Nodes:
    """Return the values at given nodes and the largest deviation from linear interpolation between them."""
    nodes = np.round(nodes / RESOLUTION) * RESOLUTION
    dense = np.interp(np.arange(BETWEEN * (len(nodes) - 1) + 1) / BETWEEN, np.arange(len(nodes)), nodes)
    seen = truth(dense)
    values = seen[::BETWEEN]
    lines = np.stack([np.interp(dense, nodes, column) for column in values.T], axis=1)
    return Nodes(read_only(nodes), read_only(values), read_only(MARGIN * np.abs(seen - lines).max(axis=0)))
