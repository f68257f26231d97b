"""Tool paths: points of a curve, or a program's runs of short blocks, as few blocks as a tolerance allows."""

from twin.paths.budget import Contribution, combined
from twin.paths.refit import Refit, Refitter, refit
from twin.paths.report import PathReport

__all__ = ["Contribution", "PathReport", "Refit", "Refitter", "combined", "refit"]
