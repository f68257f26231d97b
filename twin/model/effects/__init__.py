"""Effects that make a real machine differ from its nominal kinematics, one file per effect; a model is an ordered tuple of effects.

To add an effect, write one file with its class and `Specification` and add it to `twin._common.families.EFFECTS`.
"""

from twin.model.effects.base import Effect, Frame, Payload, assemble, split_name, summed, unit_of
from twin.model.effects.control import ControlCorrection
from twin.model.effects.cross_axis import CrossAxis
from twin.model.effects.empirical import Empirical
from twin.model.effects.entries import MACHINE_EFFECTS
from twin.model.effects.error_motion import ErrorMotion
from twin.model.effects.gravity_compliance import GravityCompliance
from twin.model.effects.harmonic import Harmonic
from twin.model.effects.location import AxisLocation, Squareness
from twin.model.effects.pitch_error import PitchError
from twin.model.effects.reversal import Reversal, ReversalCurve
from twin.model.effects.specification import Specification
from twin.model.effects.thermal_drift import ThermalDrift
from twin.model.effects.thermal_expansion import ThermalExpansion

__all__ = [
    "MACHINE_EFFECTS",
    "AxisLocation",
    "ControlCorrection",
    "CrossAxis",
    "Effect",
    "Empirical",
    "ErrorMotion",
    "Frame",
    "GravityCompliance",
    "Harmonic",
    "Payload",
    "PitchError",
    "Reversal",
    "ReversalCurve",
    "Specification",
    "Squareness",
    "ThermalDrift",
    "ThermalExpansion",
    "assemble",
    "split_name",
    "summed",
    "unit_of",
]
