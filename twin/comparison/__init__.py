"""Compare two calibrations of one machine: which errors changed, which changes are significant, and their effect at the tool.

Manual: `twin doc compare`.
"""

from twin.comparison.compare import compare
from twin.comparison.result import Changes, Culprits, ErrorChange
from twin.comparison.text import text_of
from twin.comparison.tool import DisplacementSize, Remaining, ToolChange, ToolDisplacement

__all__ = [
    "Changes",
    "Culprits",
    "DisplacementSize",
    "ErrorChange",
    "Remaining",
    "ToolChange",
    "ToolDisplacement",
    "compare",
    "text_of",
]
