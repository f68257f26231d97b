"""Compensation: rewrite an NC program so that the machine, with its errors, follows the programmed path.

Manual: `twin doc programs`.
"""

# Stages of a compensation; `parts.ProgramRun` runs them on a program in memory, or on a file of any length part by part.
#
#   program          twin.nc                      bytes                  → Program
#   blocks           Dialect.moves                Program                → Interpretation
#   tool path        follow.follow                Interpretation         → ToolPath
#   pieces           pieces.Pieces                ToolPath               → Pieces
#   correction       correction.correct           Pieces                 → Corrected
#   output           correction.new_positions     Corrected              → NewPositions, text
#   check            parts.check                  NewPositions, output read back
#   report           account.CompensationAccount  Corrected              → Report
#
# `prepared` holds what is common to all programs: the machine, its errors, and which of them are corrected.

from twin.compensation.programs.compensator import Compensation, Compensator, compensate, compensate_file
from twin.compensation.programs.prepared import Options
from twin.compensation.programs.report import Report

__all__ = ["Compensation", "Compensator", "Options", "Report", "compensate", "compensate_file"]
