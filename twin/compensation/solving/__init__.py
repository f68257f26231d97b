"""Tool path → correction: the commands for the ends of every block's pieces, and how many pieces a block needs."""

from twin.compensation.solving.corrected import Corrected, corrected, replacing
from twin.compensation.solving.pieces import Pieces

__all__ = ["Corrected", "Pieces", "corrected", "replacing"]
