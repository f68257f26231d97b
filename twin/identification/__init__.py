"""From measured points to error motions, with their uncertainty."""

from twin.identification.identify import identify
from twin.identification.result import Identification, Unidentified

__all__ = ["Identification", "Unidentified", "identify"]
