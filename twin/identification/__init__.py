"""Error motions, squareness and axis locations from measured points, with their uncertainty.

Manual: `twin doc identify`.
"""

from twin.identification.identify import identify
from twin.identification.result import Identification
from twin.identification.unidentified import Unidentified

__all__ = ["Identification", "Unidentified", "identify"]
