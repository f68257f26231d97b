"""Correction of a tool path: commands for the end points of every block's pieces, and the number of pieces per block."""

from twin.compensation.solving.corrected import Corrected, correct, new_positions
from twin.compensation.solving.path_errors import EndState
from twin.compensation.solving.pieces import Pieces

__all__ = ["Corrected", "EndState", "Pieces", "correct", "new_positions"]
