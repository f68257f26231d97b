"""Correction of a tool path: commands for the end points of every block's pieces, and the number of pieces per block."""

from twin.compensation.solving.corrected import Corrected, corrected, replacing
from twin.compensation.solving.pieces import Pieces

__all__ = ["Corrected", "Pieces", "corrected", "replacing"]
