"""Find the errors that measured data show beyond the model of the machine, and name their causes.

Manual: `twin doc diagnose`.
"""

from twin.diagnosis.answer import Diagnosis
from twin.diagnosis.diagnose import diagnose
from twin.diagnosis.result import Cause

__all__ = ["Cause", "Diagnosis", "diagnose"]
