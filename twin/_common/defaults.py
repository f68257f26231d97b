"""Defaults that commands show in their help, and the folder of the machines that come with `twin`."""

from __future__ import annotations

from pathlib import Path
from typing import Final

DEFAULT: Final = "dmu50"
"""Machine file that is used if none is named; it comes with twin."""
DEFAULT_ROTARY_LIMIT_DEG: Final = 0.5
"""Largest motion of a rotary axis to correct an orientation, degrees."""
DEFAULT_TOLERANCE_MM: Final = 0.01
"""Largest distance of a tool path with fewer blocks from the programmed one, mm."""
TRIALS: Final = 100_000
"""Number of machines drawn from a calibration's covariance."""
VOLUME_POSES: Final = 200
"""Number of positions at which each of them is evaluated."""


def bundled_folder() -> Path:
    """Return the folder of the machines that come with `twin`: inside the installed package, or next to it in a checkout."""
    package = Path(__file__).parents[1]
    inside = package / "urdf"
    return inside if inside.is_dir() else package.parent / "urdf"
