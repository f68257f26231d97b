"""Correction of a tool path: commands for the end points of every block's pieces, and the number of pieces per block."""

from twin.compensation.solving.corrected import Corrected, correct, new_positions
from twin.compensation.solving.pieces import Pieces

__all__ = ["Corrected", "Pieces", "correct", "new_positions"]
