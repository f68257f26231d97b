"""The account of a compensation: what was corrected, by how much, how well it is known, and what was not."""

from twin.compensation.account.account import CompensationAccount
from twin.compensation.account.report import NO_ERRORS, LineNote, Report, grouped

__all__ = ["NO_ERRORS", "CompensationAccount", "LineNote", "Report", "grouped"]
