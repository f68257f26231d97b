"""The internal units: metre and radian, as in URDF and Pinocchio.

Users see mm, degrees, µm and µrad. A name with a unit (``_mm``, ``_deg``, ``_um``, ``_urad``) holds a value in that unit; a name
without one holds metres or radians. Multiply by these constants on input, divide on output.
"""

from math import pi
from typing import Final

MM: Final = 1e-3
UM: Final = 1e-6
DEG: Final = pi / 180.0
URAD: Final = 1e-6
TURN: Final = 360.0
"""Degrees in one turn."""
