"""Report of a compensation: what was corrected, by how much, with which uncertainty, and what was not corrected."""

from twin.compensation.account.account import CompensationAccount
from twin.compensation.account.frames import FrameUse, frame_uses
from twin.compensation.account.report import NO_ERRORS, LineNote, Report, grouped

__all__ = ["NO_ERRORS", "CompensationAccount", "FrameUse", "LineNote", "Report", "frame_uses", "grouped"]
