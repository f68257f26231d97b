"""Points inside a motion at which it is simulated."""

from __future__ import annotations

from typing import Final

import numpy as np

SAMPLE_SPACING: Final = (10.0, 3.0)
"""Largest distance between two samples: mm of linear and degrees of rotary motion."""
SAMPLES_A_PIECE: Final = 5
"""Least number of interior points at which a piece is simulated; long pieces have more."""

CHORD_MM: Final = 0.01
"""Chord tolerance on arcs in a simulated execution."""
MOST_SAMPLES: Final = 100_000
"""Samples of one motion beyond which it is refused: 1 km, 833 turns of a rotary axis, an arc of as many chords."""


def spacings(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return (n,) the distance between (n, axes) words and others, in units of `SAMPLE_SPACING`."""
    limits = np.repeat(SAMPLE_SPACING, [3, start.shape[1] - 3])
    return np.maximum.reduce([np.abs(b - a) / limit for a, b, limit in zip(start.T, end.T, limits, strict=True)])
