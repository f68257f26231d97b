"""The one unit system inside: metre and radian, as URDF and Pinocchio have them.

Users see mm, degrees, µm and µrad; a name that carries a unit (``_mm``, ``_deg``, ``_um``, ``_urad``) is on their side of
the line, a name without one on ours. Multiply by these on the way in, divide on the way out.
"""

from math import pi
from typing import Final

MM: Final = 1e-3
UM: Final = 1e-6
DEG: Final = pi / 180.0
URAD: Final = 1e-6
TURN: Final = 360.0
"""Degrees."""
