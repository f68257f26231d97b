"""Effects that make a real machine differ from its nominal kinematics, one file per effect; a model is an ordered tuple of effects.

To add an effect, write one file with its class and `Specification` and add it to `twin._common.families.EFFECTS`.
"""

from twin.model.effects.base import Effect, Frame, Parameter, Payload, assemble, split_name, summed, unit_of
from twin.model.effects.control import ControlCorrection
from twin.model.effects.cross_axis import CrossAxis
from twin.model.effects.empirical import Empirical
from twin.model.effects.entries import MACHINE_EFFECTS
from twin.model.effects.error_motion import ErrorMotion
from twin.model.effects.gravity_compliance import GravityCompliance
from twin.model.effects.harmonic import Harmonic
from twin.model.effects.location import AxisLocation, Squareness, ZeroOffset
from twin.model.effects.pitch_error import PitchError
from twin.model.effects.reversal import Reversal, ReversalCurve
from twin.model.effects.specification import Specification
from twin.model.effects.table_load import TableLoad
from twin.model.effects.thermal_drift import SteadyDrift, ThermalDrift
from twin.model.effects.thermal_expansion import ThermalExpansion
from twin.model.effects.thermal_growth import ThermalGrowth

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
    "Parameter",
    "Payload",
    "PitchError",
    "Reversal",
    "ReversalCurve",
    "Specification",
    "Squareness",
    "SteadyDrift",
    "TableLoad",
    "ThermalDrift",
    "ThermalExpansion",
    "ThermalGrowth",
    "ZeroOffset",
    "assemble",
    "split_name",
    "summed",
    "unit_of",
]
