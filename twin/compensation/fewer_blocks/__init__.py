"""Tool paths: reduce a program's runs of short blocks, or points of a curve, to as few blocks as a tolerance allows.

Manual: `twin doc paths`.
"""

from twin.compensation.fewer_blocks.refit import PathReport, Refit, Refitter, UncertaintyContribution, combined, refit

__all__ = ["PathReport", "Refit", "Refitter", "UncertaintyContribution", "combined", "refit"]
