"""Circular tests with a ball bar in the planes XY, YZ and ZX, in both directions."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin.planning.sequences.specification import MeasuringSequence, SequencePoints, SequenceTask

STEP_DEG: Final = 5.0
FULL_DEG: Final = (0.0, 360.0)
ARC_DEG: Final = (-20.0, 200.0)
"""Arc of the vertical planes: the ball cannot go below the pivot, which stands on the table."""
PLANES: Final = ((0, 1), (1, 2), (2, 0))
"""Base directions of the planes XY, YZ and ZX; the angle counts from the first of them towards the second."""


def _points(task: SequenceTask) -> SequencePoints:
    runs: list[np.ndarray] = []
    places: list[str] = []
    for name in task.places_mm:
        for first, second in PLANES:
            arc = FULL_DEG if 2 not in (first, second) else ARC_DEG
            count = round((arc[1] - arc[0]) / STEP_DEG) + 1
            # The arc is centred on the upward direction of a vertical plane.
            start = -90.0 if first == 2 else 0.0
            angle = np.radians(np.linspace(*arc, count) + start)
            circle = np.zeros((count, 3))
            circle[:, first], circle[:, second] = np.cos(angle), np.sin(angle)
            runs += [task.sizes.bar_mm * circle, task.sizes.bar_mm * circle[::-1]]
            places += [name, name]
    size = [len(run) for run in runs]
    return SequencePoints(
        np.tile(task.rest(), (sum(size), 1)),
        np.repeat(np.array(places, dtype=object), size),
        np.concatenate(runs),
        np.repeat(np.arange(1, len(runs) + 1), size),
    )


CIRCLES: Final = MeasuringSequence(
    name="circles",
    title="circles in XY and arcs of 220° in YZ and ZX, in both directions, rotary axes at rest",
    source="ISO 230-4:2022, circular tests",
    instruments=("ball-bar",),
    unverified=(
        "The text of the standard was not available; the number of points is a choice. Arcs of 220° replace the circles of the "
        "vertical planes, as is usual with a pivot on the table. The bar itself is not checked for collisions."
    ),
    limits="Rotary axes do not move, so their errors do not show. Scales rest on the calibrated length of the bar.",
    make=_points,
)
