"""Compensation: rewrite an NC program so that the machine, with its errors, follows the programmed path.

Manual: `twin doc programs`.
"""

# Stages of a compensation; `Compensator.compensate` runs them on a program in memory, `stream` on one of any length.
#
#   program          twin.nc                      bytes                  → Program
#   blocks           Dialect.moves                Program                → Reading
#   tool path        toolpath.follow              Reading                → ToolPath
#   pieces           solving.Pieces               ToolPath               → Pieces
#   correction       solving.correct              Pieces                 → Corrected
#   output           solving.new_positions        Corrected              → NewPositions, text
#   check            checked.check                NewPositions, output read back
#   report           account.CompensationAccount  Corrected              → Report
#
# `prepared` holds what is common to all programs: the machine, its errors, and which of them are corrected.

from twin.compensation.programs.compensator import Compensation, Compensator, compensate, compensate_file
from twin.compensation.programs.prepared import Options
from twin.compensation.programs.report import Report

__all__ = ["Compensation", "Compensator", "Options", "Report", "compensate", "compensate_file"]
