"""The internal units: metre and radian, as in URDF and Pinocchio.

Users see mm, degrees, µm and µrad. A name with a unit (``_mm``, ``_deg``, ``_um``, ``_urad``) holds a value in that unit; a name
without one holds metres or radians. Multiply by these constants on input, divide on output.
"""

from __future__ import annotations

from math import pi
from typing import Final

MM: Final = 1e-3
UM: Final = 1e-6
DEG: Final = pi / 180.0
URAD: Final = 1e-6
TURN: Final = 360.0
"""Degrees in one turn."""
HOUR: Final = 3600.0
"""Seconds in one hour."""

# --- Counts with their nouns ----------------------------------------------------------------------


def count_with_noun(count: int, one: str) -> str:
    """Return a count with its noun: ``1 row``, ``1,234 rows``."""
    return f"{count:,} {one}{'' if count == 1 else 's'}"
