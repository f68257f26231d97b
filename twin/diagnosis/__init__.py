"""What the simulation gets wrong about measured data, and why."""

from twin.diagnosis.diagnose import diagnose
from twin.diagnosis.result import Cause, Diagnosis

__all__ = ["Cause", "Diagnosis", "diagnose"]
